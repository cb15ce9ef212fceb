"""A table of encounters: many cells, one line for each, as text and as a stored file."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from ground_tools.campaign.encounters import cells, report
from ground_tools.campaign.encounters.cells import Cell, Row
from ground_tools.campaign.encounters.model import read
from ground_tools.common import table_file
from ground_tools.common.provenance import CannotSampleError

MODELS: Final = "DMUCA_ENCOUNTER_MODELS"
"""Environment variable that names the folder of the published models, which are not part of this project."""
_FIRST: Final = 3
"""Encounters of each line that are stored one by one, for comparison with other software."""


class Line(msgspec.Struct, frozen=True, kw_only=True):
    """A cell and its results."""

    cell: Cell
    found: dict[str, Any]
    """The result of `report.summary`."""
    first: tuple[Row, ...]
    """The encounters of the first seeds."""


class Kept(msgspec.Struct, frozen=True, kw_only=True):
    """A table as it is stored in a file."""

    software: str
    """Digest of the software that flew the table (`cells.software`)."""
    seeds: tuple[int, int]
    """First and last seed of the encounters."""
    lines: tuple[Line, ...]


def line(cell: Cell, rows: Sequence[Row]) -> Line:
    """The line of a cell with these rows."""
    return Line(cell=cell, found=report.summary(cell, rows), first=tuple(rows[:_FIRST]))


def sample(path: Path) -> list[str]:
    """Fly the first encounters of every line of a stored table again. Returns the differences, as text.

    Raises:
        ConfigError: the file or a model cannot be read.
        CannotSampleError: the models are not at hand.
    """
    table = table_file.read(path, Kept)
    if not table.lines:
        return ["the file holds no line"]
    folder = os.environ.get(MODELS)
    if folder is None:
        raise CannotSampleError(f"{MODELS} does not name the folder of the encounter models")
    models = {name: read(Path(folder) / f"{name}.txt") for name in {x.cell.model for x in table.lines}}
    encounters = 1 + table.seeds[1] - table.seeds[0]
    found = []
    for one in table.lines:
        words, model = _words(one.cell), models[one.cell.model]
        if model.digest != one.cell.digest:
            return [f"{one.cell.model}: the file of this model in {folder} is another one"]
        if one.found.get("encounters") != encounters or not one.first:
            return [
                f"{words}: {one.found.get('encounters')} encounters; seeds {table.seeds} are {encounters}"
            ]
        again = cells.fly(one.cell, model, [row.seed for row in one.first])
        found += [
            f"{words}, seed {before.seed}: {before}, now {now}"
            for before, now in zip(one.first, again, strict=True)
            if before != now
        ]
    return found


def markdown(lines: Sequence[Line]) -> str:
    """The table as Markdown, one line for each cell."""
    columns: dict[str, Callable[[Line], str]] = {
        "intruder": lambda x: x.cell.model + ("" if x.cell.taken == "crewed" else ", taken for small"),
        "own, m/s": lambda x: x.cell.own,
        "altitude": lambda x: x.cell.altitude,
        "heard within, km": lambda x: f"{x.cell.range_m / 1000.0:g}",
        "encounters": lambda x: f"{x.found['encounters']:,}",
        "NMAC without, with, induced": lambda x: "{nmac_unavoided}, {nmac}, {nmac_induced}".format(**x.found),
        "risk ratio": lambda x: _ratio(x.found, "risk_ratio"),
        "LoWC ratio": lambda x: _ratio(x.found, "lowc_ratio"),
        "deviation median, largest (m)": lambda x: "{deviation_median_m:.0f}, {deviation_max_m:.0f}".format(
            **x.found
        ),
        "farthest from the path's line (m)": lambda x: f"{x.found['aside_max_m']:.0f}",
        "alert, median (s)": lambda x: _time(x.found["alert_time_median_s"]),
    }
    rows = [list(columns), ["---"] * len(columns)]
    rows += [[value(x) for value in columns.values()] for x in lines]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _ratio(found: dict[str, Any], key: str) -> str:
    if found[key] is None:
        return "-"
    low, high = found[f"{key}_interval"]
    return f"{found[key]:.3f} ({low:.3f} to {high:.3f})"


def _time(value: float | None) -> str:
    return "-" if value is None else f"{value:.0f}"


def _words(cell: Cell) -> str:
    return f"{cell.model}, {cell.own}, {cell.altitude}, {cell.range_m:g} m"
