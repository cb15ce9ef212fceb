"""The picture: a panel for each measure and load, each a curve over density for every method."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from ground_tools.city.cells import Row
from ground_tools.common.rates import Estimate
from ground_tools.paper.city.grid import METHODS, Cell
from ground_tools.paper.city.numbers import MEASURES, Measure, estimates

SHOWN: Final = tuple(measure for measure in MEASURES if measure.panel)
_ROWS: Final = (len(SHOWN) + 1) // 2
COLOURS: Final = {
    "ble4": "#56b4e9", "ble5": "#0072b2", "wifi": "#e69f00", "wifi-2": "#a6761d", "wifi-1": "#f0c419",
    "all-2": "#882255", "ble4-wifi-2": "#332288", "fixed": "#d55e00", "rule": "#cc79a7",
    "policy": "#009e73", "ideal": "#999933", "perfect": "#000000", "none": "#8c8c8c",
}  # fmt: skip
"""Colour of each method."""
MARKS: Final = dict(zip(METHODS, "ovs<>pd^DPhX*", strict=True))
"""Marker of each method."""
_LEGEND_ROWS: Final = 2
"""All methods in one row would be wider than the picture."""
_APART: Final = 0.03
"""Horizontal offset between methods, in decades of density, so that no interval hides another."""


@dataclass(frozen=True, slots=True)
class Curve:
    """One method in one panel."""

    method: str
    points: tuple[tuple[float, Estimate], ...]
    """Density and value, by ascending density."""


def size_in(loads: int) -> tuple[float, float]:
    """Width and height of the picture for a number of loads, in inches."""
    return 11.0 * loads, 3.9 * _ROWS


def curves(cells: Mapping[Cell, Sequence[Row]], load: float, measure: Measure) -> list[Curve]:
    """The curves of a panel. A method to which the measure does not apply has none."""
    found = estimates({cell: rows for cell, rows in cells.items() if cell.load == load})
    drawn = []
    for method in METHODS:
        points = [
            (cell.density, value)
            for cell, values in found.items()
            if cell.method == method and (value := values[measure.key]) is not None
        ]
        if points:
            drawn.append(Curve(method, tuple(sorted(points, key=lambda point: point[0]))))
    return drawn


def draw(figure: Any, cells: Mapping[Cell, Sequence[Row]]) -> None:
    """Draw all panels. The panels of one measure are side by side and share their scale."""
    loads = list(dict.fromkeys(cell.load for cell in cells))
    figure.suptitle(
        "A city against density. Bars: 95 % intervals over runs.\n"
        "Open triangles: no loss at all, at the upper end of the interval.",
        fontsize=15,
    )
    grid = figure.add_gridspec(_ROWS, 2 * len(loads))
    handles: dict[str, Any] = {}
    for number, measure in enumerate(SHOWN):
        first = None
        for place, load in enumerate(loads):
            column = len(loads) * (number % 2) + place
            axes = figure.add_subplot(grid[number // 2, column], sharey=first)
            first = first or axes
            air = f"foreign load {load:g}" if load else "no foreign load"
            axes.set_title(f"({chr(97 + number)}) {air}", fontsize=12)
            axes.set_xscale("log")
            if measure.logarithmic:
                axes.set_yscale("log")
            for curve in curves(cells, load, measure):
                handles[METHODS[curve.method].words] = _draw(axes, curve, measure)
            if measure.logarithmic and place == len(loads) - 1:
                _end_below(axes, [curve for one in loads for curve in curves(cells, one, measure)], measure)
            axes.set_xlabel("aircraft per km²")
            densities = sorted({cell.density for cell in cells})
            axes.set_xticks(densities, [f"{density:g}" for density in densities])
            axes.minorticks_off()
            if place == 0:
                axes.set_ylabel(measure.title, fontsize=11)
    columns = math.ceil(len(handles) / _LEGEND_ROWS)
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=columns, frameon=False)


def _draw(axes: Any, curve: Curve, measure: Measure) -> Any:
    """Draw a curve. Returns its line, for the legend."""
    colour, scale = COLOURS[curve.method], measure.scale
    shift = 10.0 ** (_APART * (list(METHODS).index(curve.method) - len(METHODS) // 2))
    places = [density * shift for density, _ in curve.points]
    values = [scale * value.value for _, value in curve.points]
    shown = [value if value > 0.0 or not measure.logarithmic else math.nan for value in values]
    (line,) = axes.plot(places, shown, color=colour, marker=MARKS[curve.method], ms=6, lw=1.6)
    for place, value, (_, found) in zip(places, values, curve.points, strict=True):
        if not math.isfinite(found.low) or not math.isfinite(found.high):
            continue
        low, high = scale * found.low, scale * found.high
        if measure.logarithmic and value == 0.0:
            if high > 0.0:
                axes.plot([place], [high], color=colour, marker="v", ms=8, mfc="none", ls="none")
            continue
        if measure.logarithmic:  # cannot show an interval down to 0: see `_end_below`
            low = max(low, 1e-9 * value)
        axes.plot([place, place], [low, high], color=colour, lw=1.4, alpha=0.8)
    return line


def _end_below(axes: Any, drawn: Sequence[Curve], measure: Measure) -> None:
    """Make a logarithmic scale end just below the least value, regardless of the intervals."""
    values = [value.value or value.high for curve in drawn for _, value in curve.points]
    least = min((value for value in values if 0.0 < value < math.inf), default=None)
    if least is not None:
        axes.set_ylim(bottom=0.4 * measure.scale * least)
