"""The runs of the figure: flown in parallel and stored in one file, each with its city."""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
from rich.console import Console

from ground_tools.city import spread
from ground_tools.city.cells import ROOTS, City, Row, fly
from ground_tools.city.spread import DATA
from ground_tools.common import provenance
from ground_tools.common.kept_lines import Kept, read_lines
from ground_tools.common.progress import progress
from ground_tools.common.provenance import Provenance
from ground_tools.paper.city.grid import START_S, Cell, Grid, cost_s

FILE: Final = "runs.jsonl"
PACKAGES: Final = ("numpy", "numba")
COMMAND: Final = "ground-tools paper city --out results/city-paper"
SEPARATION_COMMAND: Final = (
    "ground-tools paper city-separation --methods ble4 policy ideal perfect --out results/city-separation"
)
_TOLD_S: Final = 60.0
"""Interval between lines about the progress, if no progress bar can be shown."""


class Run(msgspec.Struct, frozen=True):
    """One stored run. A setting that a later version adds to `City` has its default value in older runs."""

    city: City
    row: Row


Rows = Mapping[Cell, list[Row]]
"""The runs of each cell, by seed."""


@dataclass(frozen=True, slots=True)
class Work:
    """A run that has to be flown."""

    method: str
    city: City
    seed: int

    @property
    def cost_s(self) -> float:
        """Expected CPU time, s."""
        return cost_s(self.city, self.method)


def number_of(city: City, seed: int) -> int:
    """Key of a run in its file."""
    content = msgspec.json.encode([city, seed])
    return int(hashlib.sha256(content).hexdigest()[:15], 16)


def made_by_now(command: str = COMMAND) -> Provenance:
    """The provenance record of runs that the present software flies."""
    return provenance.now(command, ROOTS, DATA, PACKAGES)


def kept(folder: Path) -> Kept[Run]:
    """The runs in an existing folder. Runs by other software are read, but never mixed with new ones.

    Raises:
        ConfigError: the file cannot be read, or belongs to another study.
    """
    now = made_by_now()
    software = hashlib.sha256(repr((now.sources, now.data)).encode()).hexdigest()[:12]
    return Kept(
        folder / FILE, {"study": "city"}, Run, lambda run: number_of(run.city, run.row.seed), software
    )


def missing(grid: Grid, runs: Mapping[int, Run]) -> list[Work]:
    """The missing runs of a grid, the most costly ones first, so that no worker is idle at the end."""
    found: dict[int, Work] = {}
    for cell in grid.cells():
        city = grid.city(cell)
        for seed in grid.seeds:
            number = number_of(city, seed)
            if number not in runs:
                found[number] = Work(cell.method, city, seed)
    return sorted(found.values(), key=lambda work: -work.cost_s)


def rows_of(grid: Grid, runs: Mapping[int, Run]) -> dict[Cell, list[Row]]:
    """The runs of each cell of a grid, in the order of their seeds. Cells without any are left out."""
    found = {}
    for cell in grid.cells():
        city = grid.city(cell)
        numbers = [number_of(city, seed) for seed in grid.seeds]
        rows = [runs[number].row for number in numbers if number in runs]
        if rows:
            found[cell] = rows
    return found


def estimate(works: list[Work], jobs: int | None) -> str:
    """The expected cost of the missing runs, as text.

    Args:
        jobs: number of runs at the same time; None on a cluster, whose CPUs are not known here.
    """
    cpu_s = sum(work.cost_s for work in works) + START_S * min(jobs or 1, len(works))
    at_once = f", {_minutes(cpu_s / jobs)} with {jobs} at a time" if jobs else ""
    return (
        f"{len(works)} runs are to be flown: about {_minutes(cpu_s)} of CPU time{at_once}. "
        "Finished runs are kept."
    )


def fly_missing(
    file: Kept[Run], works: list[Work], args: argparse.Namespace, words: Console, command: str
) -> None:
    """Fly runs and store each as soon as it is finished, with a provenance record beside the file.

    Args:
        args: options of `spread.add_options`.
        command: the command, for the record.

    Raises:
        ConfigError: a file cannot be written, or its runs were flown by other software.
    """
    if not works:
        return
    # Open the file now, not after the first run: it is refused if its runs were flown by other software.
    file.add([])
    provenance.write(file.path, made_by_now(command))
    told = _teller(works, words)
    with progress("runs", len(works)) as advance:
        for work, row in spread.in_any_order(_fly, works, args, words):
            file.add([Run(work.city, row)])
            told(work)
            advance()


def _fly(work: Work) -> Row:
    return fly(work.city, work.seed)[0]


def _teller(works: list[Work], words: Console) -> Callable[[Work], None]:
    """A function that prints progress lines, for log files. The remaining time is estimated from the finished
    cost."""
    whole_s, began_s = sum(work.cost_s for work in works), time.monotonic()
    state: dict[str, Any] = {"done": 0, "cost": 0.0, "told": began_s}

    def tell(work: Work) -> None:
        state["done"] += 1
        state["cost"] += work.cost_s
        now_s = time.monotonic()
        if sys.stderr.isatty() or now_s - state["told"] < _TOLD_S:
            return
        state["told"] = now_s
        left_s = (now_s - began_s) * (whole_s - state["cost"]) / state["cost"]
        words.print(f"{state['done']} of {len(works)} runs, about {_minutes(left_s)} left", highlight=False)

    return tell


def _minutes(time_s: float) -> str:
    return f"{time_s / 60.0:.0f} min" if time_s < 7200.0 else f"{time_s / 3600.0:.1f} h"


def sample(path: Path) -> list[str]:
    """Fly the shortest kept run of each method again. Returns the differences, as text."""
    first: dict[tuple[str, str, str], Run] = {}
    for run in read_lines(path, Run)[1]:
        key = (run.city.law, run.city.knows, run.city.transports)
        if key not in first or _size(run) < _size(first[key]):
            first[key] = run
    found = []
    for run in first.values():
        again, _ = fly(run.city, run.row.seed)
        if again != run.row:
            kept, now = (json.loads(msgspec.json.encode(row)) for row in (run.row, again))
            names = ", ".join(name for name in kept if kept[name] != now[name])
            found.append(f"{run.city.name}, seed {run.row.seed}: other values of {names}")
    return found


def _size(run: Run) -> tuple[float, float]:
    return run.city.demand.aircraft * run.city.duration_s, run.city.demand.per_km2
