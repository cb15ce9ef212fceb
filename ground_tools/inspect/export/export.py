"""`ground-tools export RUN...`: writes a run as tables, as KML, or as a scenario to fly again."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path

from companion.errors import ConfigError
from ground_tools.inspect.command import read_all
from ground_tools.inspect.explain import manoeuvres
from ground_tools.inspect.export import incident, kml, mcap, rosbag, tables
from ground_tools.inspect.read.flown import flown, separations
from ground_tools.inspect.read.timeline import together

EXAMPLE = (
    "examples: ground-tools export runs/20260101T000000Z-demo --csv tables --kml run.kml\n"
    "          ground-tools export runs/20260101T000000Z-demo/unavoided --scenario incident.toml\n"
    "          sitl-mocks demo --scenario incident.toml --law dmuca"
)
Write = Callable[[Iterator[tables.Rows], tuple[str, ...], Path], int]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools export` to `parser`."""
    parser.description = "Export runs for other software. Several RUNs are put on one UTC time line."
    parser.epilog = EXAMPLE
    parser.add_argument(
        "run_folder", nargs="+", type=Path, metavar="RUN", help="run folder, or .tlog, .bin or .ulg file"
    )
    parser.add_argument(
        "--csv",
        type=Path,
        metavar="DIR",
        help="write tracks, encounters, manoeuvres and alternatives as .csv",
    )
    parser.add_argument("--parquet", type=Path, metavar="DIR", help="write the same tables as .parquet")
    parser.add_argument("--kml", type=Path, metavar="FILE", help="write the paths for Google Earth")
    parser.add_argument("--mcap", type=Path, metavar="FILE.mcap", help="write the run for Foxglove")
    parser.add_argument("--rosbag", type=Path, metavar="DIR", help="write the run as a ROS 2 bag")
    parser.add_argument(
        "--scenario",
        type=Path,
        metavar="FILE.toml",
        help="write the closest approach as it was flown, as a scenario for sitl-mocks demo",
    )
    parser.add_argument(
        "--planned",
        action="store_true",
        help="with --scenario: write the planned timed paths of all aircraft instead",
    )


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools export`. Returns 0, or 2 if one of several inputs could not be read.

    Raises:
        ConfigError: No input can be read, the run cannot be exported in the requested form, or a file cannot
            be written.
    """
    if not any((args.csv, args.parquet, args.kml, args.mcap, args.rosbag, args.scenario)):
        raise ConfigError(
            "there is nothing to write; give --csv, --parquet, --kml, --mcap, --rosbag or --scenario"
        )
    if args.planned and not args.scenario:
        raise ConfigError("--planned is allowed only with --scenario")
    runs = read_all(args.run_folder)
    whole = together(runs)
    ways = flown(whole)
    pairs = separations(ways.paths)
    for problem in (*whole.problems, *ways.problems):
        print(f"problem: {problem}")
    formats: list[tuple[Path | None, str, Write]] = [
        (args.csv, "csv", tables.write_csv),
        (args.parquet, "parquet", tables.write_parquet),
    ]
    done = (
        {record.name: manoeuvres.find(record) for record in whole.aircraft}
        if args.csv or args.parquet
        else {}
    )
    for folder, ending, write in formats:
        if folder is None:
            continue
        _make(folder)
        for name, columns, blocks in (
            ("tracks", tables.TRACK_COLUMNS, tables.tracks(whole, ways)),
            ("encounters", tables.ENCOUNTER_COLUMNS, iter([tables.encounters(ways, pairs)])),
            ("manoeuvres", tables.MANOEUVRE_COLUMNS, iter([tables.manoeuvres(ways, done)])),
            ("alternatives", tables.ALTERNATIVE_COLUMNS, iter([tables.alternatives(ways, done)])),
        ):
            path = folder / f"{name}.{ending}"
            print(f"wrote {path}: {write(blocks, columns, path)} rows")
    if args.kml:
        kml.write(whole, ways, pairs, args.kml)
        print(f"wrote {args.kml}")
    if args.mcap:
        print(f"wrote {args.mcap}: {mcap.write(whole, ways, pairs, args.mcap)} messages")
    if args.rosbag:
        print(f"wrote {args.rosbag}: {rosbag.write(whole, ways, pairs, args.rosbag)} messages")
    if args.scenario:
        found = incident.planned_again(whole) if args.planned else incident.flown_again(whole, ways)
        incident.write(found, args.scenario)
        print("\n".join(found.words))
        print(f"wrote {args.scenario}; fly it with: sitl-mocks demo --scenario {args.scenario}")
    return 0 if len(runs) == len(args.run_folder) else 2


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: the folder cannot be created: {error.strerror}") from error
