"""Results of a run from the true positions: separations, deviations and return to the timed path."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from companion.arrays import Floats
from sitl_mocks.encounters.lockstep import Run
from sitl_mocks.encounters.scenario_file import Scenario

ON_PATH_M = 2.0
"""Closer than this to the timed point, plus the navigation error, counts as on the path."""
NOISE_SIGMAS = 3.0


@dataclass(frozen=True, slots=True)
class Pair:
    """Closest approach of one pair of aircraft, or of an aircraft and an obstacle."""

    first: str
    second: str
    min_separation_m: float
    at_s: float
    """Path time of the closest approach."""


@dataclass(frozen=True, slots=True)
class Deviation:
    """Deviation of one aircraft from its timed path."""

    name: str
    largest_m: float
    final_m: float
    back_s: float | None
    """Time from the largest deviation until the aircraft stays on the path. None: not back, or never left."""


def pairs_of(run: Run) -> list[Pair]:
    """Least separation of every pair of aircraft, also between ticks (positions move straight between ticks);
    then that of every aircraft from every obstacle."""
    found = []
    for a, b in combinations(run.aircraft, 2):
        least, tick = _least(a.position_ned_m - b.position_ned_m)
        found.append(Pair(a.name, b.name, least, float(run.time_s[tick])))
    return found + [Pair(name, what, least, at_s) for (name, what), (least, at_s) in run.obstacles.items()]


def _least(relative: Floats) -> tuple[float, int]:
    start, step = relative[:-1], np.diff(relative, axis=0)
    length2 = np.einsum("ij,ij->i", step, step)
    share = np.clip(-np.einsum("ij,ij->i", start, step) / np.maximum(length2, 1e-12), 0.0, 1.0)
    distance = np.linalg.norm(start + share[:, None] * step, axis=1)
    tick = int(np.argmin(distance))
    return float(distance[tick]), tick


def on_path_limit_m(scenario: Scenario) -> float:
    """Deviation up to which an aircraft is on its path: 2 m plus three sigma of its navigation noise."""
    return ON_PATH_M + NOISE_SIGMAS * scenario.vehicle.gnss_horizontal_sigma_m


def deviations_of(run: Run, paths: list[Floats], limit_m: float) -> list[Deviation]:
    """Deviation of every aircraft from the point of its path at the same time."""
    found = []
    flown = run.time_s >= 0.0
    time_s = run.time_s[flown]
    for aircraft, path in zip(run.aircraft, paths, strict=True):
        planned = np.column_stack([np.interp(time_s, path[:, 0], path[:, k]) for k in (1, 2, 3)])
        away: Floats = np.linalg.norm(aircraft.position_ned_m[flown] - planned, axis=1)
        worst = int(np.argmax(away))
        outside = np.flatnonzero(away > limit_m)
        back = None
        if outside.size and outside[-1] + 1 < away.size:
            back = float(time_s[outside[-1] + 1] - time_s[worst])
        found.append(Deviation(aircraft.name, float(away[worst]), float(away[-1]), back))
    return found
