"""One aircraft flown by its law in a loop: a point mass that answers a velocity command with a lag of 0.5 s.

Fences here are tables of local metres, as `walls.walls_of` makes them of areas.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.avoidance.law import Law, LawResult, Neighbour, Situation
from companion.avoidance.walls import _walls
from companion.events import FenceArea
from companion.geometry import LocalFrame, Vec3

STEP_S, PERIOD_S, LAG_S = 0.1, 0.2, 0.5
NOISE_MEMORY_S = 30.0

Hears = Callable[[float, Floats, Floats], Sequence[Neighbour]]
"""From time, true position and velocity to what is heard."""


@dataclass(frozen=True)
class Flight:
    """One row for each step, and the answers of the law."""

    time_s: Floats
    position: Floats
    """True, NED, m, shape (K, 3)."""
    error: Floats
    """Of the measured position, m, shape (K, 3)."""
    results: list[LawResult]
    late_s: Floats
    """Of each decision."""


def fly(
    law: Law,
    until_s: float,
    *,
    position: Any = None,
    velocity: Any = (0.0, 0.0, 0.0),
    hears: Hears = lambda now, p, v: (),
    sigma_m: float = 0.0,
    seed: int | None = None,
    start_s: float = 0.0,
) -> Flight:
    """Fly from the path's point or `position`; `seed`: GNSS noise of sigma_m on each axis, 30 s long."""
    rng = np.random.default_rng(seed)
    noisy = 0.0 if seed is None else sigma_m
    p = np.array(law.trajectory.position(start_s) if position is None else position, dtype=float)
    v = np.array(velocity, dtype=float)
    command, error = v.copy(), rng.normal(0.0, 1.0, 3) * noisy
    keep = math.exp(-STEP_S / NOISE_MEMORY_S)
    times, places, errors, results, late = [], [], [], [], []
    for tick in range(round((until_s - start_s) / STEP_S)):
        now = start_s + tick * STEP_S
        if tick % round(PERIOD_S / STEP_S) == 0:
            measured = tuple((p + error).tolist())
            view = Situation(now, now, measured, tuple(v.tolist()), sigma_m, hears(now, p, v))
            results.append(law.decide(view))
            late.append(law.late_s)
            command = np.array(results[-1].chosen_ned_mps)
        v = v + (command - v) * (STEP_S / LAG_S)
        p = p + v * STEP_S
        error = keep * error + math.sqrt(1.0 - keep * keep) * rng.normal(0.0, 1.0, 3) * noisy
        times.append(now + STEP_S)
        places.append(p)
        errors.append(error)
    return Flight(np.array(times), np.array(places), np.array(errors), results, np.array(late))


class _Metres:
    """A frame in which latitude and longitude are metres."""

    alt_m = 0.0

    def to_ned(self, north: float, east: float, alt_m: float) -> Vec3:
        return north, east, -alt_m


def polygon(kind: float, *corners: tuple[float, float], number: int = 0) -> Floats:
    """Edges of an area, corners north, east in m."""
    return _rows(number, FenceArea(inclusion=kind == k.IN_POLYGON, points=corners, radius_m=None))


def circle(kind: float, middle: tuple[float, float], radius: float, number: int = 0) -> Floats:
    """A circular area."""
    return _rows(number, FenceArea(inclusion=kind == k.IN_CIRCLE, points=(middle,), radius_m=radius))


def _rows(number: int, area: FenceArea) -> Floats:
    return np.array(_walls(number, area, cast(LocalFrame, _Metres())))


def room(fence: Floats, places: Floats) -> Floats:
    """Distance (m) of every place from the fence's border; negative: on the wrong side of an area.

    By complex numbers, and by the angle that a polygon's corners sweep around the place.
    """
    least = np.full(len(places), np.inf)
    z = places[:, 0] + 1j * places[:, 1]
    for number in np.unique(k.Wall(*fence.T).area):
        walls = k.Wall(*fence[k.Wall(*fence.T).area == number].T)
        kind, a, b = walls.kind[0], walls.n + 1j * walls.e, walls.end_n + 1j * walls.end_e
        if kind in (k.IN_CIRCLE, k.OUT_OF_CIRCLE):
            depth = walls.radius_m[0] - abs(z - a[0])
        else:
            from_a, from_b = a - z[:, None], b - z[:, None]
            turns = np.angle(from_b / from_a).sum(axis=1) / (2.0 * np.pi)
            along = np.clip(-(from_a * (b - a).conj()).real / abs(b - a) ** 2, 0.0, 1.0)
            depth = abs(from_a + along * (b - a)).min(axis=1) * np.where(abs(turns) > 0.5, 1.0, -1.0)
        least = np.minimum(least, depth if kind in (k.IN_POLYGON, k.IN_CIRCLE) else -depth)
    return least
