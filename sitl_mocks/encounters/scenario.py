"""Encounters of several aircraft on timed straight paths, after the paper's section V.

The paper has a 1 km x 1 km airspace, flights of 500 s, all aircraft converging at 250 s inside a box of
500 m x 500 m x 300 m, and v_max 5 m/s. Crossing points spread over the whole box do not conflict at all, so
the sets used here draw them close together:

- S1 and S2: crossing points are uniform in a ball of 30 m radius (S1) or 8 m radius (S2). Each aircraft flies
  straight through its own crossing point at 250 s, in a direction drawn uniformly from the compass.
- S3: an exactly symmetric circle: all at one height, from equal angles and equal distances through one point.
  The seed sets the rotation and the radius of the circle.

The centre of all sets is (0, 0), 100 m above the ground, the middle of the airspace. On S1 and S2 a path
begins and ends between 75 % and 98 % of the way to the edge of the airspace, so speeds lie between 1.4 and
2.8 m/s. This is clearly below v_max, because an aircraft without speed in reserve cannot catch up with a
timed path. The height changes by up to 25 m on either side of the crossing. Draws in which two aircraft are
nearer than 60 m to each other at the beginning or the end are repeated with the same generator.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from companion.arrays import Floats

Kind = Literal["S1", "S2", "S3"]

DURATION_S = 500.0
CROSSING_S = 250.0
HALF_AIRSPACE_M = 500.0
HEIGHT_M = 100.0
CROSSING_BALL_M = {"S1": 30.0, "S2": 8.0}
CLIMB_M = 25.0
APART_M = 60.0
_MOST_DRAWS = 100_000
"""Twenty aircraft on S1 or S2 occasionally need some thousand draws."""


def encounter(kind: Kind, aircraft: int, seed: int) -> tuple[Floats, ...]:
    """One encounter. The same arguments give the same paths.

    Args:
        kind: kind of set.
        aircraft: number of aircraft, at least 2.
        seed: seed of the draw.

    Returns:
        For each aircraft an array of shape (3, 4): rows of time (s), north, east, down (m) at the beginning,
        the crossing and the end.

    Raises:
        ValueError: an unknown kind, fewer than 2 aircraft, or more than fit 60 m apart.
    """
    if kind not in ("S1", "S2", "S3"):
        raise ValueError(f"kind {kind!r}; allowed: 'S1', 'S2', 'S3'")
    if aircraft < 2:
        raise ValueError(f"{aircraft} aircraft; allowed: 2 or more")
    rng = np.random.default_rng([int(kind[1]), aircraft, seed])
    for _ in range(_MOST_DRAWS):
        rows = _circle(aircraft, rng) if kind == "S3" else _ball(CROSSING_BALL_M[kind], aircraft, rng)
        if min(_least_distance(rows[:, 0, 1:]), _least_distance(rows[:, 2, 1:])) > APART_M:
            return tuple(rows)
    raise ValueError(f"{aircraft} aircraft cannot be placed {APART_M:g} m apart")


def _ball(radius_m: float, aircraft: int, rng: np.random.Generator) -> Floats:
    """Paths with crossings uniform in a ball, shape (aircraft, 3, 4)."""
    direction = rng.normal(size=(aircraft, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    crossing = direction * radius_m * rng.uniform(size=(aircraft, 1)) ** (1.0 / 3.0)
    heading = rng.uniform(0.0, 2.0 * math.pi, size=aircraft)
    level = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    to_edge = HALF_AIRSPACE_M - np.abs(crossing[:, :2]).max(axis=1)
    reach = to_edge / np.abs(level).max(axis=1) * rng.uniform(0.75, 0.98, size=aircraft)
    climb = rng.uniform(-CLIMB_M, CLIMB_M, size=aircraft)
    return _straight(crossing, np.column_stack([level * reach[:, None], -climb]))


def _circle(aircraft: int, rng: np.random.Generator) -> Floats:
    """Paths of the symmetric circle, shape (aircraft, 3, 4)."""
    turn, radius = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(400.0, 490.0)
    heading = turn + 2.0 * math.pi * np.arange(aircraft) / aircraft
    half = radius * np.column_stack([np.cos(heading), np.sin(heading), np.zeros(aircraft)])
    return _straight(np.zeros((aircraft, 3)), half)


def _straight(crossing: Floats, half: Floats) -> Floats:
    """Paths from crossing - half to crossing + half, with the centre raised to its height."""
    centre = crossing + np.array([0.0, 0.0, -HEIGHT_M])
    points = np.stack([centre - half, centre, centre + half], axis=1)
    times = np.broadcast_to(np.array([0.0, CROSSING_S, DURATION_S])[:, None], (*points.shape[:2], 1))
    return np.concatenate([times, points], axis=2)


def _least_distance(points: Floats) -> float:
    gaps = np.linalg.norm(points[:, None] - points[None], axis=2)
    return float(gaps[np.triu_indices(len(points), 1)].min())
