"""How many aircraft per square kilometre a method carries, if they may be no farther from their timed points
than some distance in the mean."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from ground_tools.city.cells import Row
from ground_tools.paper.city.grid import METHODS, NOBODY, Cell
from ground_tools.paper.city.numbers import MEASURES, estimate
from ground_tools.paper.city.verdict import verdicts

DISTANCES_M: Final = (4.0, 6.0, 10.0)
_TARGET: Final = "prevented"
_DEVIATION: Final = next(measure for measure in MEASURES if measure.key == "deviation_m")


@dataclass(frozen=True, slots=True)
class Capacity:
    """Density at which the mean distance from the timed point reaches a given one."""

    density: float
    """Aircraft per square kilometre."""
    bound: str = ""
    """"below": the distance is larger at the least density already. "above": it is not reached at any density
    at which the method still prevents losses. Empty: neither."""

    @property
    def words(self) -> str:
        """The density as text."""
        sign = {"below": "< ", "above": "> ", "": ""}[self.bound]
        return f"{sign}{self.density:.2g}" if self.density < 10.0 else f"{sign}{self.density:.0f}"


def capacity(cells: Mapping[Cell, Sequence[Row]], load: float, method: str, distance_m: float) -> Capacity:
    """The least density at which the mean distance reaches `distance_m`. Between the densities flown, both
    logarithms are interpolated. Densities from the first one at which the method misses the target
    "prevented" are left out: aircraft that do not hear each other stay on their paths.

    Raises:
        ValueError: no density is left.
    """
    missed = [v.stops for v in verdicts(cells) if (v.target, v.load, v.method) == (_TARGET, load, method)]
    end = next((stop for stop in missed if stop is not None), math.inf)
    points = []
    for cell, rows in cells.items():
        found = estimate(rows, _DEVIATION)
        if (cell.load, cell.method) == (load, method) and cell.density < end and found is not None:
            points.append((cell.density, found.value))
    points.sort()
    if not points:
        raise ValueError(f"{method}: no density at which losses are prevented")
    if points[0][1] >= distance_m:
        return Capacity(points[0][0], "below")
    for (low, before), (high, after) in pairwise(points):
        if after >= distance_m:
            share = math.log(distance_m / before) / math.log(after / before)
            return Capacity(low * (high / low) ** share)
    return Capacity(points[-1][0], "above")


def markdown(cells: Mapping[Cell, Sequence[Row]]) -> str:
    """One table for each load; empty if nobody was flown without avoidance, with whom the methods are
    compared."""
    lines = []
    for load in dict.fromkeys(cell.load for cell in cells if cell.method == NOBODY):
        air = f"foreign load {load:g}" if load else "no foreign load"
        heads = [f"{distance_m:g} m" for distance_m in DISTANCES_M]
        lines += [f"| aircraft per km² at a mean distance of; {air} | " + " | ".join(heads) + " |"]
        lines += ["|---|" + "---|" * len(heads)]
        for method in dict.fromkeys(cell.method for cell in cells if cell.method != NOBODY):
            try:
                words = [capacity(cells, load, method, distance_m).words for distance_m in DISTANCES_M]
            except ValueError:
                words = ["-"] * len(heads)
            lines.append(f"| {METHODS[method].words} | " + " | ".join(words) + " |")
        lines.append("")
    return "\n".join(lines)
