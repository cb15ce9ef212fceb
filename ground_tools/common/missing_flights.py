"""Flies the seeds of several cells that are not yet in the kept result files."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Final, TypeVar

import msgspec
from rich.console import Console

from ground_tools.common.kept_lines import Kept
from ground_tools.common.progress import progress
from ground_tools.common.workers import in_parallel

_AT_ONCE: Final = 5
"""Flights in one unit of work for a worker."""


Cell = TypeVar("Cell", bound=Hashable)
Row = TypeVar("Row", bound=msgspec.Struct)


def fly_missing(
    fly: Callable[[tuple[Cell, list[int]]], list[Row]],
    cells: Sequence[Cell],
    seeds: Sequence[int],
    files: Mapping[Cell, Kept[Row]],
    seed_of: Callable[[Row], int],
    processes: int,
) -> dict[Cell, list[Row]]:
    """Fly the seeds of all cells that are not in the files. Returns the rows of each cell in the order of the
    seeds.

    Args:
        fly: flies some seeds of a cell; a top-level function of a module.
        files: kept rows of the cells; new rows are added. Rows of a cell without a file are not kept.
        seed_of: gives the seed of a row.

    Raises:
        ConfigError: a file cannot be written.
    """
    rows: dict[Cell, dict[int, Row]] = {
        cell: dict(files[cell].rows) if cell in files else {} for cell in cells
    }
    parts: list[tuple[Cell, list[int]]] = []
    for cell in cells:
        missing = [seed for seed in seeds if seed not in rows[cell]]
        parts += [(cell, missing[at : at + _AT_ONCE]) for at in range(0, len(missing), _AT_ONCE)]
    with progress("flights", len(parts)) as advance:
        for (cell, _), found in in_parallel(fly, parts, processes, Console(stderr=True)):
            if cell in files:
                files[cell].add(found)
            rows[cell].update((seed_of(row), row) for row in found)
            advance()
    return {cell: [rows[cell][seed] for seed in seeds] for cell in cells}
