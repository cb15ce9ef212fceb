"""The command `ground-tools paper city`: the effect of communication against traffic density.

Each method flies the same traffic with the same seeds. Finished runs are kept and not repeated.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from rich.console import Console

from ground_tools.city import parquet, spread
from ground_tools.city.cells import Row
from ground_tools.city.traffic.demand import PATTERNS
from ground_tools.paper.city import capacity, picture, runs, study, table
from ground_tools.paper.city.grid import METHODS, Cell, Grid, inside, ranges_of
from ground_tools.paper.city.verdict import sentences, verdicts

NAME: Final = table.NAME
EXAMPLE: Final = "ground-tools paper city --densities 10 100 --methods policy perfect none --seeds 1-2"
_MOST_AIRCRAFT: Final = 20_000
_PIPED_WIDTH: Final = 200


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools paper city`."""
    add, grid = parser.add_argument, Grid()
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.description = (
        "Fly cities of rising density, with every way to learn of other aircraft, without and with foreign\n"
        "load, and show losses of separation, conflicts, deviation, ages and channel load with intervals of\n"
        "95 % over seeds; then state at which density each method stops keeping the target, and how many\n"
        "aircraft it carries at a given distance from the timed point. The expected CPU time is printed\n"
        "first. Finished runs are kept in --out, so that the same command continues."
    )
    parser.epilog = f"example: {EXAMPLE}\n\nmethods:\n" + "\n".join(
        f"  {k:8s} {m.words}" for k, m in METHODS.items()
    )
    add("--densities", type=float, nargs="+", default=list(grid.densities), metavar="N",
        help=f"aircraft per km² (default: {' '.join(f'{d:g}' for d in grid.densities)})")  # fmt: skip
    add("--methods", nargs="+", choices=METHODS, default=list(grid.methods), metavar="M",
        help="methods of those below (default: all)")  # fmt: skip
    add("--loads", type=float, nargs="+", default=list(grid.loads), metavar="SHARE",
        help="shares of time for which foreign transmissions fill the Wi-Fi channel "
        f"(default: {' '.join(f'{load:g}' for load in grid.loads)})")  # fmt: skip
    add("--pattern", choices=PATTERNS, default=grid.pattern,
        help=f"traffic pattern (default: {grid.pattern})")  # fmt: skip
    add("--region", choices=("us", "eu"), default=grid.region,
        help=f"region whose rules limit the sets of transports (default: {grid.region})")  # fmt: skip
    study.add_options(parser, NAME, "table.md, table.csv and city.png")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Fly the missing runs and show all results; no picture without matplotlib. Returns 0.

    Raises:
        ConfigError: an option is wrong, or a file cannot be read or written.
    """
    grid, words, out = grid_of(args), study.console_of(args), args.out
    spread.jobs_of(args)  # reports wrong options before a folder is made
    file = study.opened(out)
    path = out / f"{NAME}.png"
    with study.figure(path, picture.size_in(len(grid.loads))) as figure:
        command = f"ground-tools paper {NAME}{grid.options}"
        study.fly(file, runs.missing(grid, file.rows), args, words, command)
        rows = runs.rows_of(grid, file.rows)
        if figure is not None:
            picture.draw(figure, rows)
    _tell(args, grid, rows, words)
    made = [
        study.write(out / "table.md", table.markdown(rows) + "\n" + capacity.markdown(rows)),
        study.write(out / "table.csv", table.csv_of(rows)),
        *_parquet(out, grid, rows),
    ]
    study.tell_files(words, made, path)
    return 0


def grid_of(args: argparse.Namespace) -> Grid:
    """The grid that the options describe.

    Raises:
        ConfigError: an option is out of range.
    """
    return study.grid_of(
        args,
        "--densities",
        "--loads",
        densities=tuple(sorted(set(args.densities))),
        methods=tuple(method for method in METHODS if method in args.methods),
        loads=tuple(sorted(set(args.loads))),
        pattern=args.pattern,
        region=args.region,
    )


def edges(grid: Grid) -> list[str]:
    """For each density, which share of the radio range lies inside the area, as text."""
    ranges = ranges_of(grid.city(Cell(0.0, grid.densities[0], grid.methods[0])))
    lines = []
    for density in grid.densities:
        side = grid.side_m(density)
        shares = ", ".join(
            f"{name} {inside(reach, side):.0%}"
            for name, reach in zip(("BLE 4", "BLE 5", "Wi-Fi"), ranges, strict=True)
        )
        lines.append(f"{density:g} per km², {side / 1000.0:g} km: {shares} of the aircraft in range of a "
                     "boundless city")  # fmt: skip
    return lines


def _tell(args: argparse.Namespace, grid: Grid, rows: Mapping[Cell, list[Row]], words: Console) -> None:
    found = verdicts(rows)
    if args.json:
        for line in table.json_rows(rows, found):
            print(json.dumps(line, allow_nan=False))
        return
    table.show(rows, words)
    for text in (
        *sentences(found),
        *capacity.markdown(rows).splitlines(),
        "Edges:",
        *(f"  {line}" for line in edges(grid)),
    ):
        words.print(text, highlight=False, soft_wrap=True, markup=False)


def _parquet(out: Path, grid: Grid, rows: Mapping[Cell, Sequence[Row]]) -> list[Path]:
    """Write all rows as one table. Without pyarrow nothing is written."""
    if importlib.util.find_spec("pyarrow") is None:
        return []
    path = out / "runs.parquet"
    parquet.write_study(
        path, [(grid.city(cell), cell.method, cell.load, found) for cell, found in rows.items()]
    )
    return [path]
