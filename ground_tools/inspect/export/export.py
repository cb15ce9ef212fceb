"""`ground-tools export RUN...`: writes a run as tables, as KML, or as a scenario to fly again."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from companion.errors import ConfigError
from ground_tools.inspect.command import read_all
from ground_tools.inspect.explain import manoeuvres
from ground_tools.inspect.explain.manoeuvres import Manoeuvre
from ground_tools.inspect.export import incident, kml, mcap, rosbag, tables
from ground_tools.inspect.read.flown import Flown, Separation, flown, separations
from ground_tools.inspect.read.read_run import Run
from ground_tools.inspect.read.timeline import together

EXAMPLE = (
    "examples: ground-tools export runs/20260101T000000Z-demo --csv tables --kml run.kml\n"
    "          ground-tools export runs/20260101T000000Z-demo/unavoided --scenario incident.toml\n"
    "          sitl-mocks demo --scenario incident.toml --law dmuca"
)
WriteTable = Callable[[Iterator[tables.Rows], tuple[str, ...], Path], int]
WriteMessages = Callable[[Run, Flown, list[Separation], Path], int]


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
    """Run `ground-tools export`. Every form that can be written is written.

    Returns:
        0, or 2 if one of several inputs could not be read, or one of several forms could not be written. The
        errors of these are printed to standard error.

    Raises:
        ConfigError: No input can be read, or nothing can be written.
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
    for problem in (*whole.problems, *ways.problems):
        print(f"problem: {problem}")
    forms = _forms(args, whole, ways)
    skipped = 0
    for write in forms:
        try:
            write()
        except ConfigError as error:
            if len(forms) == 1:
                raise
            print(f"skipped: {error}", file=sys.stderr)
            skipped += 1
    if skipped == len(forms):
        raise ConfigError("none of the files can be written")
    return 2 if skipped or len(runs) < len(args.run_folder) else 0


def _forms(args: argparse.Namespace, run: Run, ways: Flown) -> list[Callable[[], None]]:
    """Return what writes each form that is asked for, and tells so."""
    pairs = separations(ways.paths)
    forms: list[Callable[[], None]] = []
    if args.csv or args.parquet:
        done = {record.name: manoeuvres.find(record) for record in run.aircraft}
        for folder, ending, write in (
            (args.csv, "csv", tables.write_csv),
            (args.parquet, "parquet", tables.write_parquet),
        ):
            if folder:
                forms.append(partial(_tables, run, ways, pairs, done, folder, ending, write))
    if args.kml:
        forms.append(partial(_kml, run, ways, pairs, args.kml))
    for path, messages in ((args.mcap, mcap.write), (args.rosbag, rosbag.write)):
        if path:
            forms.append(partial(_messages, run, ways, pairs, path, messages))
    if args.scenario:
        forms.append(partial(_scenario, run, ways, args.scenario, args.planned))
    return forms


def _tables(
    run: Run,
    ways: Flown,
    pairs: list[Separation],
    done: Mapping[str, Sequence[Manoeuvre]],
    folder: Path,
    ending: str,
    write: WriteTable,
) -> None:
    _make(folder)
    for name, columns, blocks in (
        ("tracks", tables.TRACK_COLUMNS, tables.tracks(run, ways)),
        ("encounters", tables.ENCOUNTER_COLUMNS, iter([tables.encounters(ways, pairs)])),
        ("manoeuvres", tables.MANOEUVRE_COLUMNS, iter([tables.manoeuvres(ways, done)])),
        ("alternatives", tables.ALTERNATIVE_COLUMNS, iter([tables.alternatives(ways, done)])),
    ):
        path = folder / f"{name}.{ending}"
        print(f"wrote {path}: {write(blocks, columns, path)} rows")


def _kml(run: Run, ways: Flown, pairs: list[Separation], path: Path) -> None:
    kml.write(run, ways, pairs, path)
    print(f"wrote {path}")


def _messages(run: Run, ways: Flown, pairs: list[Separation], path: Path, write: WriteMessages) -> None:
    print(f"wrote {path}: {write(run, ways, pairs, path)} messages")


def _scenario(run: Run, ways: Flown, path: Path, planned: bool) -> None:
    found = incident.planned_again(run) if planned else incident.flown_again(run, ways)
    incident.write(found, path)
    print("\n".join(found.words))
    print(f"wrote {path}; fly it with: sitl-mocks demo --scenario {path}")


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: the folder cannot be created: {error.strerror}") from error
