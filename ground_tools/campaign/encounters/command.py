"""The command `ground-tools campaign encounters`: meets aircraft drawn from published encounter models."""

from __future__ import annotations

import argparse
import itertools
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import msgspec
import numba
import numpy as np
from rich.console import Console

from companion.errors import ConfigError
from ground_tools.campaign.encounters import cells, pairing, report, table
from ground_tools.campaign.encounters.cells import ALTITUDES, OWN, TAKEN, Cell, Row
from ground_tools.campaign.encounters.model import Model, read
from ground_tools.channel import options
from ground_tools.common import table_file
from ground_tools.common.cluster import on_ray
from ground_tools.common.kept_lines import Kept
from ground_tools.common.progress import progress
from ground_tools.common.run_options import add_ray, processes_unless_ray, seeds_of
from ground_tools.common.workers import in_parallel

_AT_ONCE: Final = 50
"""Encounters that a worker flies before it returns their results."""

Part = tuple[Cell, Model, list[int]]
"""One unit of work for a worker: some seeds of a cell."""
Work = Callable[[Sequence[Part]], Iterator[tuple[Part, list[Row]]]]


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools campaign encounters`."""
    add = command.add_argument
    add("--model", type=Path, required=True, nargs="+", metavar="FILE",
        help="parameter files of encounter models")  # fmt: skip
    add("--own", choices=OWN, nargs="+", default=["hover"],
        help="speeds of the own aircraft in m/s (default: hover)")  # fmt: skip
    add("--altitude", choices=ALTITUDES, nargs="+", default=["geometric"],
        help="altitudes that the crewed aircraft sends by ADS-B; pressure: its pressure altitude, and ours "
        "is known; barometric: the same, and ours is not known; unheard: it sends nothing (default: "
        "geometric)")  # fmt: skip
    add("--as", dest="taken", choices=TAKEN, default="crewed",
        help="what the law takes the crewed aircraft for; small: a small aircraft, as all traffic that only "
        "Remote ID or a sensor aboard tells of (default: crewed, as by ADS-B)")  # fmt: skip
    separations = Cell(model="", digest="")
    add("--separation", type=float, nargs=2, metavar=("H", "V"),
        default=(separations.horizontal_m, separations.vertical_m),
        help="avoidance.crewed_horizontal_m and crewed_vertical_m of the law (default: "
        f"{separations.horizontal_m:g} {separations.vertical_m:g})")  # fmt: skip
    add("--loss", type=float, default=0.0, metavar="SHARE",
        help="share of its messages that are lost, 0 to 1 (default: 0)")  # fmt: skip
    add("--range", type=float, nargs="+", default=[separations.range_m], metavar="M",
        help=f"distances within which it is received or seen (default: {separations.range_m:g})")  # fmt: skip
    add("--window", type=float, nargs=2, metavar=("H", "V"),
        default=(separations.aside_m, separations.height_m),
        help="the crewed aircraft passes within these distances to the side and in height, m (default: "
        f"{separations.aside_m:g} {separations.height_m:g}, the volume of well clear)")  # fmt: skip
    add("--seeds", default="1-1000", metavar="FROM-TO",
        help="range of seeds, one encounter each (default: 1-1000)")  # fmt: skip
    add("--out", type=Path, metavar="FOLDER",
        help="keep results in this folder, and do not repeat encounters whose results are there")  # fmt: skip
    add("--file", type=Path, metavar="FILE", help="also write all numbers as JSON")
    add("--processes", type=int, metavar="N", help="worker processes (default: one per core)")
    add_ray(command)
    add("--json", action="store_true", help="print one JSON object instead of text")
    command.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools campaign encounters`. Returns 0.

    Raises:
        ConfigError: an option or the model's file is wrong, or a file cannot be read or written.
    """
    seeds = seeds_of(args.seeds)
    wanted = _cells(args)
    table_file.check_writable(args.file)
    began = time.perf_counter()
    rows, flown = fly_missing(wanted, seeds, args.out, _work(args, Console(stderr=True)))
    lines = [table.line(cell, rows[cell]) for cell in wanted]
    wall = time.perf_counter() - began
    if args.file is not None:
        kept = table.Kept(software=cells.software(), seeds=(seeds[0], seeds[-1]), lines=tuple(lines))
        table_file.write(args.file, kept)
    effort = {"flown": flown, "wall_s": round(wall, 3), "flight_s": 2 * flown * pairing.DURATION_S}
    if args.json:
        several = {"lines": [msgspec.to_builtins(line.cell) | line.found for line in lines]}
        print(json.dumps((lines[0].found if len(lines) == 1 else several) | effort, allow_nan=False))
        return 0
    words = Console()
    if len(lines) == 1:
        for text in report.lines(lines[0].cell, lines[0].found):
            words.print(text, highlight=False, soft_wrap=True)
    else:
        print(table.markdown(lines), end="")
    words.print(f"{flown:,} encounters flown in {wall:.1f} s", highlight=False, soft_wrap=True)
    return 0


def fly_missing(
    wanted: Mapping[Cell, Model], seeds: Sequence[int], folder: Path | None, work: Work
) -> tuple[dict[Cell, list[Row]], int]:
    """Fly the encounters that the folder does not hold. Returns the rows of each cell, in the order of the
    seeds, and the number flown.

    Args:
        wanted: cells with their models.
        folder: folder in which rows are stored and looked up; None: rows are not stored.
        work: see `_work`.

    Raises:
        ConfigError: a file cannot be read or written, or a model cannot be drawn from.
    """
    rows: dict[Cell, dict[int, Row]] = {cell: {} for cell in wanted}
    files: dict[Cell, Kept[Row]] = {}
    if folder is not None:
        options.make_folder(folder)
        files = {cell: cells.kept(folder, cell) for cell in wanted}
        rows = {cell: dict(file.rows) for cell, file in files.items()}
    parts: list[Part] = []
    for cell, model in wanted.items():
        missing = [seed for seed in seeds if seed not in rows[cell]]
        parts += [(cell, model, missing[at : at + _AT_ONCE]) for at in range(0, len(missing), _AT_ONCE)]
    with progress("encounters", len(parts)) as advance:
        for (cell, _, _), found in work(parts):
            if cell in files:
                files[cell].add(found)
            rows[cell].update((row.seed, row) for row in found)
            advance()
    flown = sum(len(missing) for _, _, missing in parts)
    return {cell: [rows[cell][seed] for seed in seeds] for cell in wanted}, flown


def _work(args: argparse.Namespace, words: Console) -> Work:
    """The function that runs the work: in processes on this machine, or on a cluster."""
    processes = processes_unless_ray(args.processes, args.ray)
    if processes is not None:

        def here(parts: Sequence[Part]) -> Iterator[tuple[Part, list[Row]]]:
            if parts:
                cells.warm_up()  # compiles once, for all workers
            return in_parallel(_fly, parts, processes, words)

        return here
    return lambda parts: on_ray(_fly, parts, args.ray, _state, words)


def _fly(part: Part) -> list[Row]:
    return cells.fly(*part)


def _state() -> str:
    """The versions of all software that the rows depend on. Also compiles the flight code once, so that the
    cached result serves the other workers of the machine."""
    cells.warm_up()
    return f"{cells.software()}, numba {numba.__version__}, numpy {np.__version__}"


def _cells(args: argparse.Namespace) -> dict[Cell, Model]:
    """The cells of all combinations of the options, with their models."""
    horizontal, vertical = args.separation
    aside, height = args.window
    for option, value, least, most in (
        ("separation", horizontal, 1.0, 5000.0),
        ("separation", vertical, 1.0, 1000.0),
        ("loss", args.loss, 0.0, 1.0),
        *(("range", range_m, 1.0, 1e6) for range_m in args.range),
        ("window", aside, 1.0, 5000.0),
        ("window", height, 1.0, 1000.0),
    ):
        if not least <= value <= most:
            raise ConfigError(f"--{option}: {value:g} is out of range; allowed: {least:g} to {most:g}")
    models = [read(path) for path in args.model]
    return {
        Cell(
            model=model.name,
            digest=model.digest,
            own=own,
            altitude=altitude,
            taken=args.taken,
            horizontal_m=horizontal,
            vertical_m=vertical,
            loss=args.loss,
            range_m=range_m,
            aside_m=aside,
            height_m=height,
        ): model
        for range_m, altitude, own, model in itertools.product(args.range, args.altitude, args.own, models)
    }
