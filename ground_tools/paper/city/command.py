"""The command `ground-tools paper city`: the effect of communication against traffic density.

Each method flies the same traffic with the same seeds. Finished runs are kept and not repeated.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import shutil
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Final

import msgspec
from rich.console import Console

from companion.errors import ConfigError
from companion.shipped import given, how_to_install
from ground_tools.channel import options
from ground_tools.city import parquet, spread
from ground_tools.city.cells import City, Row
from ground_tools.city.traffic.demand import PATTERNS
from ground_tools.common.figure import drawn
from ground_tools.common.run_options import seeds_of
from ground_tools.paper.city import capacity, picture, runs, table
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
    seeds = f"{grid.seeds[0]}-{grid.seeds[-1]}"
    add("--seeds", default=seeds, metavar="FROM-TO",
        help=f"range of seeds, one run of each cell for each (default: {seeds})")  # fmt: skip
    add("--aircraft", type=int, default=grid.aircraft, metavar="N",
        help="aircraft in the air, which determine the area: a square of 2 to 20 km "
        f"(default: {grid.aircraft})")  # fmt: skip
    add("--pattern", choices=PATTERNS, default=grid.pattern,
        help=f"traffic pattern (default: {grid.pattern})")  # fmt: skip
    add("--region", choices=("us", "eu"), default=grid.region,
        help=f"region whose rules limit the sets of transports (default: {grid.region})")  # fmt: skip
    add("--minutes", type=float, default=grid.duration_s / 60.0, metavar="N",
        help=f"length of a run (default: {grid.duration_s / 60.0:g})")  # fmt: skip
    add("--settle", type=float, default=grid.settle_s, metavar="S",
        help=f"simulated time at which counting begins (default: {grid.settle_s:g})")  # fmt: skip
    add("--out", type=Path, default=Path("runs/paper/city"), metavar="FOLDER",
        help="folder of runs, table.md, table.csv and city.png (default: runs/paper/city)")  # fmt: skip
    spread.add_options(parser)
    add("--json", action="store_true", help="print one JSON object per line instead of tables")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Fly the missing runs and show all results; no picture without matplotlib. Returns 0.

    Raises:
        ConfigError: an option is wrong, or a file cannot be read or written.
    """
    grid, jobs = grid_of(args), spread.jobs_of(args)
    words = Console(stderr=args.json)
    words = words if words.is_terminal else Console(stderr=args.json, width=_PIPED_WIDTH)
    out: Path = args.out
    ours = given(str(out))
    options.make_folder(out)
    if ours != out:  # the runs that are part of an installed copy, or of another checkout
        shutil.copytree(ours, out, dirs_exist_ok=True)
    file = runs.kept(out)
    missing = runs.missing(grid, file.rows)
    draws = importlib.util.find_spec("matplotlib") is not None
    path = out / f"{NAME}.png"
    with drawn(path, picture.size_in(len(grid.loads)), dpi=80) if draws else nullcontext() as figure:
        if missing:
            words.print(runs.estimate(missing, jobs), highlight=False, soft_wrap=True)
            runs.fly_missing(file, missing, args, words, f"ground-tools paper city{grid.options} --out {out}")
        rows = runs.rows_of(grid, file.rows)
        if draws:
            picture.draw(figure, rows)
    _tell(args, grid, rows, words)
    _write(out / "table.md", table.markdown(rows) + "\n" + capacity.markdown(rows))
    _write(out / "table.csv", table.csv_of(rows))
    made = [out / "table.md", out / "table.csv", *([path] if draws else []), *_parquet(out, grid, rows)]
    words.print(f"wrote {', '.join(map(str, made))}", soft_wrap=True, highlight=False, markup=False)
    if not draws:
        words.print(f"no picture: {how_to_install('matplotlib', 'inspect')}", soft_wrap=True, markup=False)
    return 0


def grid_of(args: argparse.Namespace) -> Grid:
    """The grid that the options describe.

    Raises:
        ConfigError: an option is out of range.
    """
    grid = Grid(
        densities=tuple(sorted(set(args.densities))),
        methods=tuple(method for method in METHODS if method in args.methods),
        loads=tuple(sorted(set(args.loads))),
        seeds=seeds_of(args.seeds),
        aircraft=args.aircraft,
        pattern=args.pattern,
        region=args.region,
        duration_s=60.0 * args.minutes,
        settle_s=args.settle,
    )
    return checked(grid)


def checked(grid: Grid, densities: str = "--densities", loads: str = "--loads") -> Grid:
    """The grid itself, if it can be flown.

    Args:
        densities, loads: names of the options that set them, for messages.

    Raises:
        ConfigError: a number is out of range.
    """
    for density in grid.densities:
        if not 0.0 < density <= 200.0:
            raise ConfigError(f"{densities}: {density:g} is out of range; allowed: above 0, up to 200")
    for load in grid.loads:
        if not 0.0 <= load < 1.0:
            raise ConfigError(f"{loads}: {load:g} is out of range; allowed: 0 up to, but not, 1")
    if not 2 <= grid.aircraft <= _MOST_AIRCRAFT:
        raise ConfigError(f"--aircraft: {grid.aircraft} is out of range; allowed: 2 to {_MOST_AIRCRAFT:,}")
    if not 10.0 <= grid.duration_s <= 86_400.0:
        minutes = grid.duration_s / 60.0
        raise ConfigError(f"--minutes: {minutes:g} is out of range; allowed: 1/6 to 1440")
    if not 0.0 <= grid.settle_s < grid.duration_s:
        raise ConfigError(f"--settle: {grid.settle_s:g}; allowed: 0 up to, but not, the length of a run")
    try:
        for cell in grid.cells():
            msgspec.convert(msgspec.to_builtins(grid.city(cell)), City)
    except msgspec.ValidationError as error:
        raise ConfigError(f"the options are not allowed: {error}") from error
    return grid


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


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text)
    except OSError as error:
        raise ConfigError(f"--out: {path}: cannot be written: {error.strerror}") from error
