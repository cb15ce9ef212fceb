"""The planned flights: many timed paths, each with its time of departure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.arrays import Floats, Integers
from companion.avoidance.law import settings_of
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from companion.errors import ConfigError

MOST_FLIGHTS = 1_000_000


class Flights(NamedTuple):
    """F flights in the order of their departures; NED, m and s. The points of all paths are in one table."""

    depart_s: Floats
    """(F,): when the flight is due."""
    first: Integers
    """(F,): row of its first point."""
    corners: Integers
    """(F,): number of its points, at least 2."""
    times: Floats
    """(P,): times of the points, rising within a flight from 0 at its departure."""
    points: Floats
    """(P, 3): the points, NED, m."""
    settings: Floats
    """(F, fields of `kernels.Settings`): settings of the avoidance law."""
    purpose: Integers
    """(F,): index into `demand.PURPOSES`."""

    @property
    def end_s(self) -> Floats:
        """(F,): when each flight ends as planned."""
        return np.asarray(self.depart_s + self.times[self.first + self.corners - 1], float)


@dataclass(frozen=True, slots=True)
class Wish:
    """A requested flight, before it gets a number and the settings of its avoidance law."""

    depart_s: float
    times: Floats
    """(K,): seconds after departure, rising from 0."""
    points: Floats
    """(K, 3): NED, m."""
    speed_mps: float
    """Greatest speed of the aircraft."""
    purpose: int = 0


def flights_of(wishes: Sequence[Wish], avoidance: AvoidanceConfig) -> Flights:
    """The flights in the order of their departures; of equal ones, in the order given.

    Raises:
        ConfigError: there are too many flights, or a path is not a timed path of at least two points.
    """
    if len(wishes) > MOST_FLIGHTS:
        raise ConfigError(f"{len(wishes):,} flights are too many; allowed: up to {MOST_FLIGHTS:,}")
    order = sorted(range(len(wishes)), key=lambda i: wishes[i].depart_s)
    settings = np.zeros((len(wishes), 0))
    rows = []
    for number, i in enumerate(order):
        wish = wishes[i]
        steps = np.diff(wish.times)
        if len(wish.times) < 2 or wish.times[0] != 0.0 or not (steps > 0.0).all():
            raise ConfigError(f"flight {number}: its times do not rise from 0: {wish.times[:5].tolist()}")
        limits = LimitsConfig(max_speed_mps=wish.speed_mps)
        path = Trajectory(wish.times.tolist(), wish.points.tolist())
        rows.append(settings_of(avoidance, limits, path))
    counts = np.array([len(wishes[i].times) for i in order], np.int64)
    if rows:
        settings = np.array(rows, float)
    return Flights(
        depart_s=np.array([wishes[i].depart_s for i in order], float),
        first=np.cumsum(counts) - counts,
        corners=counts,
        times=np.concatenate([np.zeros(0), *(wishes[i].times for i in order)]),
        points=np.concatenate([np.zeros((0, 3)), *(wishes[i].points for i in order)]),
        settings=settings,
        purpose=np.array([wishes[i].purpose for i in order], np.int64),
    )


def largest_number_in_the_air(flights: Flights) -> int:
    """Greatest number of aircraft in the air at the same time if all fly as planned."""
    if not len(flights.depart_s):
        return 0
    at = np.concatenate([flights.depart_s, flights.end_s])
    change = np.concatenate([np.ones(len(flights.depart_s)), -np.ones(len(flights.depart_s))])
    order = np.lexsort([change, at])
    return int(np.cumsum(change[order]).max())
