"""The numbers of the figure as Markdown, CSV, JSON, and tables for the terminal."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from rich import box
from rich.console import Console
from rich.table import Table

from ground_tools.city.cells import Row
from ground_tools.common.rates import Estimate
from ground_tools.paper.city.grid import METHODS, Cell
from ground_tools.paper.city.numbers import MEASURES, Measure, estimates
from ground_tools.paper.city.verdict import Verdict

NAME: Final = "city"
_SHOWN: Final = ("losses_per_h", "conflict", "deviation_m", "age_s", "unheard")
"""Keys of the measures that fit on a terminal."""
_HEADS: Final = ("load", "density", "method", "runs", "flight_h", "losses", "cruise_losses")

Cells = Mapping[Cell, Sequence[Row]]


def text_of(found: Estimate | None, measure: Measure) -> str:
    """Text of a value with its interval."""
    if found is None:
        return "-"
    value = f"{measure.scale * found.value:.{measure.digits}f}"
    if found.high - found.low == math.inf and not measure.events:
        return value
    if measure.share and found.low == 0.0 and found.high == 1.0:
        return value
    low, high = (f"{measure.scale * bound:.{measure.digits}f}" for bound in (found.low, found.high))
    return f"{value} ({low} to {high})"


def markdown(cells: Cells) -> str:
    """One table for each load."""
    found, lines = estimates(cells), []
    for load in dict.fromkeys(cell.load for cell in cells):
        lines += [f"Foreign load {load:g}:" if load else "No foreign load:", ""]
        heads = ["per km²", "method", "runs", "hours", "losses", *(m.title for m in MEASURES)]
        lines += ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
        for cell, rows in cells.items():
            if cell.load == load:
                hours, losses = _sums(rows)
                head = [f"{cell.density:g}", METHODS[cell.method].words, str(len(rows)), f"{hours:.1f}"]
                words = [text_of(found[cell][m.key], m) for m in MEASURES]
                lines.append("| " + " | ".join([*head, str(losses), *words]) + " |")
        lines.append("")
    return "\n".join(lines)


def brief(cells: Cells) -> str:
    """A short table: losses, distance from the timed point, and share of unheard aircraft, by method and
    density."""
    densities = sorted({cell.density for cell in cells})
    lines = []
    for load in dict.fromkeys(cell.load for cell in cells):
        air = f"foreign load {load:g}" if load else "no foreign load"
        lines += [f"| {air} | " + " | ".join(f"{density:g} per km²" for density in densities) + " |"]
        lines += ["|---|" + "---|" * len(densities)]
        for method in dict.fromkeys(cell.method for cell in cells):
            found = [cells.get(Cell(load, density, method)) for density in densities]
            words = " | ".join("-" if rows is None else _brief(rows) for rows in found)
            lines.append(f"| {METHODS[method].words} | {words} |")
        lines.append("")
    return "\n".join(lines)


def _brief(rows: Sequence[Row]) -> str:
    values = estimates({Cell(0.0, 0.0, ""): rows})[Cell(0.0, 0.0, "")]
    deviation, unheard = values["deviation_m"], values["unheard"]
    text = f"{_sums(rows)[1]} / {0.0 if deviation is None else deviation.value:.1f} m"
    return text if unheard is None else f"{text} / {unheard.value:.0%}"


def _sums(rows: Sequence[Row]) -> tuple[float, int]:
    return sum(row.flight_h for row in rows), sum(row.losses for row in rows)


def csv_of(cells: Cells) -> str:
    """CSV with a line for each cell: for each measure the value and both ends of its interval, empty if
    unknown."""
    found, out = estimates(cells), io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    ends = ("", "_low", "_high")
    writer.writerow([*_HEADS, *(f"{m.key}{end}" for m in MEASURES for end in ends)])
    for cell, rows in cells.items():
        head = [cell.load, cell.density, cell.method, len(rows), *_counted(rows)]
        numbers: list[float | None] = []
        for measure in MEASURES:
            numbers += _plain(found[cell][measure.key])
        writer.writerow([*head, *numbers])
    return out.getvalue()


def _counted(rows: Sequence[Row]) -> list[float]:
    hours, losses = _sums(rows)
    return [round(hours, 4), losses, sum(row.cruise_losses for row in rows)]


def _plain(found: Estimate | None) -> list[float | None]:
    if found is None:
        return [None, None, None]
    return [round(x, 6) if math.isfinite(x) else None for x in (found.value, found.low, found.high)]


def json_rows(cells: Cells, verdicts: Sequence[Verdict]) -> Iterator[dict[str, Any]]:
    """An object for each cell and one for each verdict."""
    found = estimates(cells)
    for cell, rows in cells.items():
        hours, losses, cruise = _counted(rows)
        yield {
            "figure": NAME, "kind": "cell", "load": cell.load, "density": cell.density, "method": cell.method,
            "runs": len(rows), "flight_h": hours, "losses": losses, "cruise_losses": cruise,
            **{m.key: _value(found[cell][m.key]) for m in MEASURES},
        }  # fmt: skip
    for one in verdicts:
        judged = [
            {"density": density, "standing": j.standing, "times": _value(j.times)}
            for density, j in one.judged.items()
        ]
        yield {
            "figure": NAME, "kind": "verdict", "target": one.target, "load": one.load, "method": one.method,
            "stops": one.stops, "judged": judged, "words": one.words,
        }  # fmt: skip


def _value(found: Estimate | None) -> dict[str, Any]:
    value, low, high = _plain(found)
    return {"value": value, "interval": [low, high]}


def show(cells: Cells, console: Console) -> None:
    """Print the tables on the terminal."""
    found, measures = estimates(cells), [m for m in MEASURES if m.key in _SHOWN]
    for load in dict.fromkeys(cell.load for cell in cells):
        title = f"foreign load {load:g}, intervals of 95 %"
        table = Table(title=title, box=box.SIMPLE_HEAD, pad_edge=False)
        for words in ("per km²", "method", "runs", "hours", "losses", *(m.title for m in measures)):
            table.add_column(
                words, justify="left" if words == "method" else "right", no_wrap=words == "method"
            )
        for cell, rows in cells.items():
            if cell.load == load:
                hours, losses = _sums(rows)
                head = [f"{cell.density:g}", METHODS[cell.method].words, str(len(rows)), f"{hours:.1f}"]
                table.add_row(*head, str(losses), *(text_of(found[cell][m.key], m) for m in measures))
        console.print(table)
