"""The measures that the figure shows for each cell, with 95 % intervals over runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from ground_tools.city.cells import Row
from ground_tools.common.rates import Estimate, dispersion, mean, rate
from ground_tools.paper.city.grid import Cell


@dataclass(frozen=True, slots=True)
class Measure:
    """One panel of the picture and one column of the table."""

    key: str
    title: str
    of: Callable[[Row], float | None]
    """Value for a run, or the count of an event; None: the measure does not apply."""
    events: bool = False
    """Whether the measure counts events; the figure then shows the rate per flight hour."""
    share: bool = False
    """Whether the value lies between 0 and 1."""
    scale: float = 1.0
    """Factor for the table, such as 100 for percent."""
    digits: int = 2
    panel: bool = True
    """Whether the picture has a panel for it."""
    logarithmic: bool = False


LOSSES: Final = Measure(
    "losses_per_h", "losses of separation (1/h)", lambda r: r.losses, events=True, digits=3, logarithmic=True
)
CRUISE: Final = Measure(
    "cruise_losses_per_h", "losses in cruise (1/h)", lambda r: r.cruise_losses, events=True, digits=3,
    logarithmic=True,
)  # fmt: skip
MEASURES: Final = (
    LOSSES,
    CRUISE,
    Measure("collisions_per_h", "collisions (1/h)", lambda r: r.collisions, events=True, digits=3,
            panel=False),
    Measure("conflict", "decisions in conflict (%)", lambda r: r.conflict, share=True, scale=100.0, digits=1),
    Measure("infeasible", "decisions that keep not all planes (%)", lambda r: r.infeasible, share=True,
            scale=100.0, panel=False),
    Measure("deviation_m", "distance from the timed point (m)", lambda r: r.deviation_m, digits=1,
            logarithmic=True),
    Measure("largest_deviation_m", "largest of a flight, median (m)", lambda r: r.largest_deviation_m,
            digits=1, panel=False),
    Measure("extra_energy", "extra energy (%)", lambda r: r.extra_energy, scale=100.0, digits=1),
    Measure("age_s", "age of information within 500 m (s)", lambda r: r.age_s, logarithmic=True),
    Measure("old", "of it older than 3 s (%)", lambda r: r.old, share=True, scale=100.0, digits=1),
    Measure("unheard", "unheard aircraft within 500 m (%)", lambda r: r.unheard, share=True, scale=100.0,
            digits=1),
    Measure("wifi_load", "Wi-Fi load of the city", lambda r: r.wifi_load, logarithmic=True),
)  # fmt: skip
"""All measures, in the order of the columns."""


def estimate(rows: Sequence[Row], measure: Measure) -> Estimate | None:
    """A measure of a cell with its interval; None if it does not apply, or if there is no flight time.

    Events are pooled over runs. Their interval is that of the Poisson distribution, widened if the runs
    differ more than that distribution allows. Any other measure is the mean of the runs, with Student's
    interval.
    """
    values = [value for row in rows if (value := measure.of(row)) is not None]
    if len(values) < len(rows):
        return None
    if measure.events:
        counts, hours = [round(value) for value in values], [row.flight_h for row in rows]
        return rate(counts, hours, dispersion(counts, hours))
    found = mean(values)
    if found is None:
        return None
    most = 1.0 if measure.share else math.inf
    return Estimate(found.value, max(found.low, 0.0), min(found.high, most))


def estimates(cells: Mapping[Cell, Sequence[Row]]) -> dict[Cell, dict[str, Estimate | None]]:
    """All measures of all cells, by the key of the measure."""
    return {cell: {m.key: estimate(rows, m) for m in MEASURES} for cell, rows in cells.items()}
