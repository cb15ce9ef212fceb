"""Up to which density a method keeps a target, judged by the interval of a ratio of two rates of losses.

The ratio is the method's losses per flight hour divided by those of a reference in the same traffic. A method
keeps a target if the whole 95 % interval of the ratio is at most the target's number, and misses it if the
whole interval is above. If the interval contains the number, there were too few losses to decide, which is
reported as such.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Final, Literal

from ground_tools.city.cells import Row
from ground_tools.common.rates import Estimate, ratio
from ground_tools.paper.city.grid import METHODS, NOBODY, PERFECT, Cell
from ground_tools.paper.city.numbers import CRUISE, LOSSES, Measure, estimate


@dataclass(frozen=True, slots=True)
class Target:
    """A target that a method has to keep."""

    measure: Measure
    """Measure of the losses that count."""
    reference: str
    """Key of the method for comparison."""
    most: float
    """Greatest allowed ratio of the method's loss rate to that of the reference."""

    @property
    def words(self) -> str:
        """The target as text."""
        which = "losses of separation" if self.measure is LOSSES else "losses in cruise"
        return f"at most {self.most:g} times the {which} per flight hour of: {METHODS[self.reference].words}"


TARGETS: Final = {
    "perfect": Target(LOSSES, PERFECT, 2.0),
    "perfect-cruise": Target(CRUISE, PERFECT, 2.0),
    "prevented": Target(LOSSES, NOBODY, 0.1),
}
"""The targets. perfect: at most twice the losses of perfect information. perfect-cruise: the same, far from
departures and arrivals. prevented: at most a tenth of the losses without avoidance; this one is decided with
fewer runs."""
Standing = Literal["kept", "missed", "open"]


@dataclass(frozen=True, slots=True)
class Judged:
    """One cell compared with the reference of a target."""

    standing: Standing
    times: Estimate | None
    """Losses per flight hour divided by those of the reference; None: neither had any."""

    @property
    def words(self) -> str:
        """The ratio with its interval."""
        if self.times is None:
            return "no loss in either"
        if math.isinf(self.times.value):
            return f"at least {_number(self.times.low)} times"
        value, low, high = (_number(x) for x in (self.times.value, self.times.low, self.times.high))
        return f"{value} times, {low} to {high}"


@dataclass(frozen=True, slots=True)
class Verdict:
    """The verdict on one method under one load."""

    target: str
    """A key of `TARGETS`."""
    load: float
    method: str
    judged: dict[float, Judged]
    """Comparison with the reference, by ascending density."""

    def at(self, standing: Standing) -> list[float]:
        """The densities with this result, ascending."""
        return [density for density, one in self.judged.items() if one.standing == standing]

    @property
    def stops(self) -> float | None:
        """The lowest density at which the target is missed; None: it is missed at no flown density."""
        return next(iter(self.at("missed")), None)

    @property
    def words(self) -> str:
        """The verdict as a sentence."""
        name, missed, parts = METHODS[self.method].words, self.stops, []
        if kept := self.at("kept"):
            parts.append(f"keeps the target at {_list(kept)}")
        if missed is not None:
            others = self.at("missed")[1:]
            also = f", and at {_list(others)}" if others else ""
            parts.append(f"misses it from {missed:g} ({self.judged[missed].words}){also}")
            if any(density > missed for density in kept):
                parts.append("which does not grow with density: the order is not settled by these runs")
        if unknown := self.at("open"):
            groups = groupby(unknown, lambda density: self.judged[density].words)
            why = ", ".join(f"{_list(list(densities))} ({words})" for words, densities in groups)
            parts.append(f"too few losses to tell at {why}")
        return f"{name}: {'; '.join(parts)}."


def judge(first: Estimate, reference: Estimate, most: float) -> Judged:
    """Compare a rate of losses with that of the reference."""
    times = ratio(first, reference)
    if times is None or times.low <= most < times.high:
        return Judged("open", times)
    return Judged("kept" if times.high <= most else "missed", times)


def verdicts(cells: Mapping[Cell, Sequence[Row]]) -> list[Verdict]:
    """The verdicts for all methods and loads for which the reference was flown, target by target."""
    found = []
    for name, target in TARGETS.items():
        for load in dict.fromkeys(cell.load for cell in cells):
            for method in METHODS:
                judged = {} if method == target.reference else _judged(cells, target, load, method)
                if judged:
                    found.append(Verdict(name, load, method, judged))
    return found


def _judged(
    cells: Mapping[Cell, Sequence[Row]], target: Target, load: float, method: str
) -> dict[float, Judged]:
    found = {}
    for density in sorted({cell.density for cell in cells}):
        ours, theirs = (cells.get(Cell(load, density, name)) for name in (method, target.reference))
        if ours and theirs:
            first, second = estimate(ours, target.measure), estimate(theirs, target.measure)
            if first is not None and second is not None:
                found[density] = judge(first, second, target.most)
    return found


def sentences(found: Sequence[Verdict]) -> list[str]:
    """The verdicts as text, below lines that state the targets."""
    if not found:
        return ["No verdict: --methods needs a method to judge and a reference (perfect or none)."]
    lines = []
    for name, load in dict.fromkeys((one.target, one.load) for one in found):
        air = f"foreign load {load:g}" if load else "no foreign load"
        lines.append(f"Target: {TARGETS[name].words}; {air}; densities in aircraft per km².")
        lines += [f"  {one.words}" for one in found if (one.target, one.load) == (name, load)]
    return lines


def _list(densities: Sequence[float]) -> str:
    return ", ".join(f"{density:g}" for density in densities)


def _number(value: float) -> str:
    if math.isinf(value):
        return "without bound"
    return f"{value:.2g}" if value < 10.0 else f"{value:.0f}"
