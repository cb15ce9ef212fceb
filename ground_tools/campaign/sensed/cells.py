"""Stores and summarises the outcomes of flights towards things that transmit nothing."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from ground_tools.campaign.sensed import flight
from ground_tools.campaign.sensed.flight import HIT_M, SEPARATION_M, Row
from ground_tools.campaign.sensed.scene import KINDS, Cell
from ground_tools.common import sources, table_file
from ground_tools.common.intervals import wilson
from ground_tools.common.kept_lines import Kept

_WHOLE: Final = tuple(Cell(kind=kind) for kind in KINDS)
"""Cells of the kept table: those of the command without options."""
_HEAD: Final = (
    "| in the way | sensor, m | flights | unavoided: lost / hit | lost | hit | least, m | 1 % / median, m "
    "| deviation, m | seen before, s |"
)


class Line(msgspec.Struct, frozen=True, kw_only=True):
    """A cell and its results."""

    cell: Cell
    found: dict[str, Any]
    """The result of `summary`."""
    first: Row
    """The flight of the first seed, for comparison with a flight by other software."""


class Table(msgspec.Struct, frozen=True, kw_only=True):
    """Several cells as they are stored in a file."""

    software: str
    """The result of `software`."""
    seeds: tuple[int, int]
    """First and last seed of the flights."""
    lines: tuple[Line, ...]


def sample(path: Path) -> list[str]:
    """Fly the first seed of every line of the kept table again. Returns the differences, as text.

    Raises:
        ConfigError: the file cannot be read.
    """
    table = table_file.read(path, Table)
    for number, (cell, line) in enumerate(itertools.zip_longest(_WHOLE, table.lines), 1):
        if cell is None or line is None or cell != line.cell:
            there = "missing" if line is None else line.cell
            expected = "the end of the table" if cell is None else cell
            return [f"{path}: line {number} of the table is {there}; expected: {expected}"]
    flights = 1 + table.seeds[1] - table.seeds[0]
    found = []
    for one in table.lines:
        words = f"{one.cell.kind} at {one.cell.range_m:g} m"
        if one.found.get("flights") != flights:
            return [f"{words}: {one.found.get('flights')} flights; seeds {table.seeds} are {flights}"]
        again = flight.fly(one.cell, one.first.seed)
        if again != one.first:
            found.append(
                f"{words}, seed {again.seed}: least separation {one.first.separation_m:g} m, "
                f"now {again.separation_m:g} m"
            )
    return found


def kept(folder: Path, cell: Cell) -> Kept[Row]:
    """The stored results of a cell: rows by seed.

    Raises:
        ConfigError: the results come from other software, or cannot be read.
    """
    made_with: dict[str, Any] = {**msgspec.to_builtins(cell), "software": software()}
    digest = hashlib.sha256(msgspec.json.encode(cell)).hexdigest()[:8]
    return Kept(folder / f"{cell.kind}-{cell.range_m:g}-{digest}.jsonl", made_with, Row, attrgetter("seed"))


def software() -> str:
    """Digest of the code on which the outcomes depend."""
    return sources.digest(["ground_tools.campaign.sensed.flight"])


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """Outcome of the flights of a cell, at least one."""
    away = np.array([row.separation_m for row in rows])
    seen = [row.seen_s for row in rows if row.seen_s is not None]
    lost, hit = sum(row.lost for row in rows), sum(row.hit for row in rows)
    return {
        "flights": len(rows),
        "lost_unavoided": sum(row.unavoided_m < SEPARATION_M for row in rows),
        "hit_unavoided": sum(row.unavoided_m < HIT_M for row in rows),
        "lost": lost,
        "lost_interval": wilson(lost, len(rows)),
        "hit": hit,
        "hit_interval": wilson(hit, len(rows)),
        "least_m": round(float(away.min()), 3),
        "p1_m": round(float(np.quantile(away, 0.01)), 3),
        "median_m": round(float(np.median(away)), 3),
        "deviation_median_m": round(float(np.median([row.deviation_m for row in rows])), 3),
        "deviation_most_m": round(max(row.deviation_m for row in rows), 3),
        "back_median_m": round(float(np.median([row.back_m for row in rows])), 3),
        "seen_median_s": round(float(np.median(seen)), 2) if seen else None,
        "not_seen": len(rows) - len(seen),
        "worst_seeds": [row.seed for row in sorted(rows, key=attrgetter("separation_m"))[:5]],
    }


def markdown(found: Mapping[Cell, Mapping[str, Any]]) -> str:
    """A table with a line for each cell."""
    lines = [_HEAD, "|" + "---|" * (_HEAD.count("|") - 1)]
    for cell, one in found.items():
        seen = "-" if one["seen_median_s"] is None else f"{one['seen_median_s']:.1f}"
        lines.append(
            f"| {cell.kind} | {cell.range_m:g} | {one['flights']:,} "
            f"| {one['lost_unavoided']:,} / {one['hit_unavoided']:,} | {one['lost']:,} | {one['hit']:,} "
            f"| {one['least_m']:.2f} | {one['p1_m']:.1f} / {one['median_m']:.1f} "
            f"| {one['deviation_median_m']:.1f} | {seen} |"
        )
    note = (
        f"Lost: nearer than {SEPARATION_M:g} m; hit: nearer than {HIT_M:g} m. Deviation, and the time from "
        "the first decision that saw it to the least distance, are medians."
    )
    return "\n".join([*lines, "", note, ""])
