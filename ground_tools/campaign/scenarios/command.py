"""The command `ground-tools campaign scenarios`: everyday traffic, and what the laws make of it."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from companion.errors import ConfigError
from ground_tools.campaign import cells as campaign
from ground_tools.campaign import tables
from ground_tools.campaign.cells import Cell
from ground_tools.campaign.scenarios.layouts import SCENARIOS
from ground_tools.campaign.scenarios.measures import ARRIVED_M, Measures, figures, measured
from ground_tools.common.progress import progress
from ground_tools.common.run_options import processes_of, seeds_of
from ground_tools.common.workers import in_parallel

LAWS: Final = ("none", "dmuca", "orca-constant")
"""Laws of the kept table."""
SEEDS: Final = "90001-90020"
DELAY_S: Final = (1.0, 2.0)
TABLE: Final = tuple(name for name in SCENARIOS if name != "cruise")
"""Scenarios of the table; `cruise` is for intruders."""
_NOTHING: Final = "-"


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools campaign scenarios`."""
    command.add_argument("scenarios", nargs="*", metavar="SCENARIO",
                         help=f"what to fly: {', '.join(TABLE)} (default: all)")  # fmt: skip
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
        ConfigError: an option is wrong, or a file cannot be written.
    """
    names = args.scenarios or TABLE
    if unknown := [name for name in names if name not in TABLE]:
        raise ConfigError(f"scenario {unknown[0]} is unknown; allowed: {', '.join(TABLE)}")
    if args.aircraft is not None and not 2 <= args.aircraft <= 50:
        raise ConfigError(f"--aircraft: {args.aircraft} is out of range; allowed: 2 to 50")
    seeds, wanted = seeds_of(args.seeds), cells(names, args.laws, args.aircraft)
    for cell in wanted:
        campaign.flown_by(cell)
    found: dict[Cell, list[Measures]] = {}
    with progress("scenarios", len(wanted)) as advance:
        parts = [(cell, seeds) for cell in wanted]
        for (cell, _), flights in in_parallel(
            _measured, parts, processes_of(args.processes), Console(stderr=True)
        ):
            found[cell] = flights
            advance()
    lines = [tables.Line(cell=cell, found=figures(found[cell]), first=found[cell][0].row) for cell in wanted]
    if args.file is not None:
        state = campaign.software_of(wanted)
        tables.write(args.file, tables.Kept(software=state, seeds=(seeds[0], seeds[-1]), lines=tuple(lines)))
    if args.json:
        report = [{"scenario": x.cell.generator, "law": x.cell.law, **x.found} for x in lines]
        print(json.dumps({"seeds": args.seeds, "lines": report}, allow_nan=False))
    else:
        print(markdown(lines), end="")
    return 0


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
        line.cell.generator,
        str(line.cell.aircraft),
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


def _pair(median: Any, worst: Any) -> str:
    return _NOTHING if median is None else f"{median:.1f} / {worst:.1f}"
