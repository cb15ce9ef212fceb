"""Age of aircraft's knowledge of each other, weighted by how soon they could be in conflict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from companion.arrays import Floats
from companion.atmc.observation import conflict_weight
from sitl_mocks.air.ether import Ether
from sitl_mocks.encounters.lockstep import TICK_S, Run

NEAR_WEIGHT = 0.5
"""The largest age is evaluated where the weight is at least this, that is, for an aircraft that could be in
conflict within `companion.atmc.observation.LOOK_AHEAD_S`.
"""


@dataclass(slots=True)
class AgeLog:
    """Ages of information of selected pairs at every tick. Pass it to `lockstep.fly` as `watch`."""

    pairs: Sequence[tuple[str, str]]
    """Pairs of (sender, receiver)."""
    _rows: list[list[float]] = field(default_factory=list)

    def __call__(self, ether: Ether) -> None:
        """Record the ages of one tick."""
        ages = (ether.information_age_s(sender, receiver) for sender, receiver in self.pairs)
        self._rows.append([np.nan if age_s is None else age_s for age_s in ages])

    def ages_s(self) -> Floats:
        """Ages of information (s), shape (ticks, pairs). Before the first reception, the age is the time
        since the start of the run.
        """
        ages = np.array(self._rows).reshape(len(self._rows), len(self.pairs))
        elapsed_s = np.arange(len(ages))[:, None] * TICK_S
        return np.where(np.isnan(ages), elapsed_s, ages)

    def unheard(self) -> int:
        """Number of pairs of which the receiver received nothing."""
        return sum(all(np.isnan(column)) for column in zip(*self._rows, strict=True))


@dataclass(frozen=True, slots=True)
class Awareness:
    """Statistics of ages of information (s) over time and pairs."""

    mean_s: float
    p95_s: float
    """Weighted 95th percentile: 95 % of the weight lies at or below it."""
    largest_s: float
    """Largest age where the weight is at least `NEAR_WEIGHT`."""


def weights_of(run: Run, pairs: Sequence[tuple[str, str]]) -> Floats:
    """`conflict_weight` from the true positions, shape (ticks, pairs); 0 before the paths begin."""
    place = {aircraft.name: aircraft.position_ned_m for aircraft in run.aircraft}
    columns = []
    for first, second in pairs:
        distance_m = np.linalg.norm(place[first] - place[second], axis=1)
        columns.append(conflict_weight(np, distance_m, -np.gradient(distance_m, TICK_S)))
    return np.stack(columns, axis=1) * (run.time_s >= 0.0)[:, None]


def awareness_of(age_s: Floats, weight: Floats) -> Awareness:
    """Weighted mean, 95th percentile and largest age.

    Args:
        age_s: any shape.
        weight: same shape, at least 0; not all 0.
    """
    order = np.argsort(age_s, axis=None)
    age, share = age_s.ravel()[order], weight.ravel()[order]
    below = np.cumsum(share)
    at = int(np.searchsorted(below, 0.95 * below[-1]))
    near = age_s[weight >= NEAR_WEIGHT]
    return Awareness(
        mean_s=float((age * share).sum() / below[-1]),
        p95_s=float(age[min(at, len(age) - 1)]),
        largest_s=float(near.max()) if near.size else 0.0,
    )
