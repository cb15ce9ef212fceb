"""The command `ground-tools campaign scenarios`: flies everyday traffic, or files of other projects, with
several laws, and measures the flights."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from rich.console import Console

from companion.errors import ConfigError
from ground_tools.campaign import cells as campaign
from ground_tools.campaign import tables
from ground_tools.campaign.cells import Cell
from ground_tools.campaign.scenario_measures.measures import ARRIVED_M, Measures, figures, measured
from ground_tools.campaign.scenarios import files
from ground_tools.campaign.scenarios.layouts import SCENARIOS
from ground_tools.common import table_file
from ground_tools.common.progress import progress
from ground_tools.common.run_options import processes_of, seeds_of
from ground_tools.common.workers import in_parallel

LAWS: Final = ("none", "dmuca", "orca-constant")
"""Laws of the kept table."""
SEEDS: Final = "90001-90020"
DELAY_S: Final = (1.0, 2.0)
TABLE: Final = tuple(name for name in SCENARIOS if name != "cruise")
"""Scenarios of the table. `cruise` is left out, because it is meant for flights with intruders."""
MOST_EPISODES: Final = 100
_NOTHING: Final = "-"
_MOST_NAMED: Final = 8
"""Most kinds of not understood input that the text output lists; JSON lists all."""


class Flown(NamedTuple):
    """One line of the table: a scenario or a file, flown by one law."""

    cells: tuple[Cell, ...]
    """One cell for each episode; the one with the most aircraft comes first."""


class Source(NamedTuple):
    """One input file."""

    path: Path
    zone_m: float | None
    """Radius to which BlueSky's protected zone is scaled, m; None: no scaling."""
    found: files.Contents


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools campaign scenarios`."""
    command.add_argument("scenarios", nargs="*", metavar="SCENARIO",
                         help=f"what to fly: {', '.join(TABLE)} (default: all)")  # fmt: skip
    command.add_argument("--scn", nargs="+", type=Path, default=(), metavar="FILE",
                         help="fly scenario files of BlueSky (.scn) or flight intentions of Metropolis 2 "
                         "(.csv) instead")  # fmt: skip
    command.add_argument("--zone", type=float, default=None, metavar="M",
                         help="scale .scn files so that BlueSky's protected zone, 5 NM and 1,000 ft, becomes "
                         f"M metres, and speeds to those of small aircraft (default: "
                         f"{files.SMALL_ZONE_M:g})")  # fmt: skip
    command.add_argument("--unscaled", action="store_true",
                         help="fly .scn files with their own lengths and speeds, as .csv files always "
                         "are")  # fmt: skip
    command.add_argument(
        "--episodes", type=int, default=MOST_EPISODES, metavar="N",
        help=f"fly the first N episodes of each file (default: {MOST_EPISODES})",
    )  # fmt: skip
    command.add_argument("--laws", nargs="+", default=LAWS, metavar="NAME",
                         help=f"laws, as in campaign run --law (default: {' '.join(LAWS)})")  # fmt: skip
    command.add_argument("--aircraft", type=int, metavar="N", help="number of aircraft (default: its own)")
    command.add_argument("--seeds", default=SEEDS, metavar="FROM-TO",
                         help=f"range of seeds, one flight each (default: {SEEDS})")  # fmt: skip
    command.add_argument(
        "--processes", type=int, metavar="N", help="worker processes (default: one per core)"
    )
    command.add_argument("--file", type=Path, metavar="FILE", help="also write all numbers as JSON")
    command.add_argument("--json", action="store_true", help="print one JSON object instead of text")
    command.set_defaults(run=run)


def cells(names: Sequence[str], laws: Sequence[str], aircraft: int | None = None) -> list[Cell]:
    """The cells of a table, by scenario and then by law."""
    return [
        Cell(generator=name, aircraft=aircraft or SCENARIOS[name].aircraft, law=law, delay_s=DELAY_S)
        for name in names
        for law in laws
    ]


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools campaign scenarios`. Returns 0.

    Raises:
        ConfigError: an option is wrong, or a file cannot be read or written.
    """
    seeds, sources = seeds_of(args.seeds), _sources(args)
    table_file.check_writable(args.file)
    wanted = _of_files(sources, args.laws) if args.scn else _of_names(args)
    for one in wanted:
        campaign.flown_by(one.cells[0])
    found: dict[Cell, list[Measures]] = {}
    parts = [(cell, seeds) for one in wanted for cell in one.cells]
    with progress("scenarios", len(parts)) as advance:
        for (cell, _), flights in in_parallel(
            _measured, parts, processes_of(args.processes), Console(stderr=True)
        ):
            found[cell] = flights
            advance()
    lines = [
        tables.Line(
            cell=one.cells[0],
            found={**figures([x for cell in one.cells for x in found[cell]]), "episodes": len(one.cells)},
            first=found[one.cells[0]][0].row,
        )
        for one in wanted
    ]
    if args.file is not None:
        state = campaign.software_of([one.cells[0] for one in wanted])
        table_file.write(
            args.file, tables.Kept(software=state, seeds=(seeds[0], seeds[-1]), lines=tuple(lines))
        )
    if args.json:
        report = [{"scenario": _title(x.cell), "law": x.cell.law, **x.found} for x in lines]
        about = [_told(source) for source in sources]
        print(json.dumps({"seeds": args.seeds, "lines": report, "files": about}, allow_nan=False))
    else:
        print(markdown(lines), end="")
        for source in sources:
            print(_sentence(source))
    return 0


def _of_names(args: argparse.Namespace) -> list[Flown]:
    names = args.scenarios or TABLE
    if unknown := [name for name in names if name not in TABLE]:
        raise ConfigError(f"scenario {unknown[0]} is unknown; allowed: {', '.join(TABLE)}")
    if args.aircraft is not None and not 2 <= args.aircraft <= 50:
        raise ConfigError(f"--aircraft: {args.aircraft} is out of range; allowed: 2 to 50")
    return [Flown((cell,)) for cell in cells(names, args.laws, args.aircraft)]


def _zone(args: argparse.Namespace) -> float | None:
    """Radius to which BlueSky's protected zone is scaled, m; None: no scaling."""
    if args.unscaled and args.zone is not None:
        raise ConfigError("--unscaled cannot be combined with --zone")
    zone = files.SMALL_ZONE_M if args.zone is None else float(args.zone)
    if not 1.0 <= zone <= files.ZONE_M:
        raise ConfigError(f"--zone: {zone:g} is out of range; allowed: 1 to {files.ZONE_M:g}")
    return None if args.unscaled else zone


def _sources(args: argparse.Namespace) -> list[Source]:
    """The files to fly.

    Raises:
        ConfigError: an option is wrong, or a file cannot be read.
    """
    zone = _zone(args)
    if not args.scn:
        if args.unscaled or args.zone is not None:
            raise ConfigError("--zone and --unscaled need --scn")
        return []
    if args.scenarios or args.aircraft is not None:
        raise ConfigError("--scn cannot be combined with names of scenarios or with --aircraft")
    if not 1 <= args.episodes <= 10_000:
        raise ConfigError(f"--episodes: {args.episodes} is out of range; allowed: 1 to 10000")
    zones = [None if path.suffix.lower() == ".csv" else zone for path in args.scn]
    return [
        Source(path, one, files.contents(path, one, args.episodes))
        for path, one in zip(args.scn, zones, strict=True)
    ]


def _of_files(sources: Sequence[Source], laws: Sequence[str]) -> list[Flown]:
    wanted = []
    for path, zone, found in sources:
        largest_first = sorted(range(len(found.episodes)), key=lambda i: -found.episodes[i].aircraft)
        for law in laws:
            episodes = [
                Cell(
                    generator=files.name_of(path, i, zone),
                    aircraft=found.episodes[i].aircraft,
                    law=law,
                    speed_mps=found.speed_mps,
                    delay_s=DELAY_S,
                )
                for i in largest_first
            ]
            wanted.append(Flown(tuple(episodes)))
    return wanted


def _told(source: Source) -> dict[str, Any]:
    return {
        "file": str(source.path),
        "aircraft": source.found.aircraft,
        "episodes": len(source.found.episodes),
        "all_episodes": source.found.whole,
        "conflicts_left_out": source.found.left_out,
        "not_understood": dict(source.found.skipped),
    }


def _sentence(source: Source) -> str:
    found, skipped = source.found, source.found.skipped
    named = ", ".join(f"{name} ({count:,})" for name, count in skipped[:_MOST_NAMED])
    rest = sum(count for _, count in skipped[_MOST_NAMED:])
    number = len(found.episodes)
    flown = f"{number:,} {'episode' if number == 1 else 'episodes'}{'' if found.whole else ' of more'}"
    return (
        f"{source.path}: {found.aircraft:,} aircraft, {flown}; conflicts of the plan that are in none: "
        f"{found.left_out:,}; not understood: {named or 'nothing'}{f' and {rest:,} more' if rest else ''}"
    )


def _measured(part: tuple[Cell, Sequence[int]]) -> list[Measures]:
    cell, seeds = part
    return [measured(cell, seed) for seed in seeds]


def markdown(lines: Sequence[tables.Line]) -> str:
    """The table as Markdown."""
    titles = [
        "scenario", "aircraft", "law", "flights", "below 10 m", "sNMAC", "deviation, median / worst (m)",
        "off its place at the end, median / worst (m)", f"all within {ARRIVED_M:g} m of it",
        "needless deviation, median / worst (m)", "time to clear, median (s) / not clear at the end",
        "changes of side",
    ]  # fmt: skip
    rows = [titles, ["---"] * len(titles), *(_row(line) for line in lines)]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _row(line: tables.Line) -> list[str]:
    f = line.found
    return [
        _title(line.cell),
        f"up to {line.cell.aircraft}" if f.get("episodes", 1) > 1 else str(line.cell.aircraft),
        line.cell.law,
        str(f["runs"]),
        str(f["losses_of_separation"]),
        str(f["snmac"]),
        _pair(f["median_max_deviation_m"], f["max_deviation_m"]),
        _pair(f["median_end_m"], f["max_end_m"]),
        str(f["everybody_arrived"]),
        _pair(f["median_needless_m"], f["max_needless_m"]),
        f"{_NOTHING if f['median_clear_s'] is None else round(f['median_clear_s'])} / {f['not_clear']}",
        f"{f['median_sides']:.0f}",
    ]


def _title(cell: Cell) -> str:
    if not cell.generator.startswith(files.PREFIX):
        return cell.generator
    return Path(cell.generator.split(":", 3)[3]).stem


def _pair(median: Any, worst: Any) -> str:
    return _NOTHING if median is None else f"{median:.1f} / {worst:.1f}"
