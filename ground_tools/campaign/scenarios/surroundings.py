"""Optional surroundings of a fleet: crewed traffic that passes, and a fence."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from companion.arrays import Bools, Floats
from companion.avoidance import kernels
from companion.errors import ConfigError

CREWED_MPS: Final = 50.0
FENCE_ASIDE_M: Final = 20.0
_FAR_M: Final = 1e4


def crewed_ways(times: Floats, points: Floats, crewed: Bools, seed: int) -> Floats:
    """Waypoints of the crewed aircraft: level and straight at `CREWED_MPS` through the mean position of the
    others at the middle of the flight, with random headings.

    Args:
        times, points: shapes (A, K) and (A, K, 3).
        crewed: shape (A,), which of the aircraft are crewed.
    """
    rng = np.random.default_rng([seed, 8])
    middle = 0.5 * (times.min() + times.max())
    others = [
        [np.interp(middle, t, p[:, c]) for c in range(3)]
        for t, p in zip(times[~crewed], points[~crewed], strict=True)
    ]
    heading = rng.uniform(0.0, 2.0 * math.pi, crewed.sum())
    way = CREWED_MPS * np.column_stack([np.cos(heading), np.sin(heading), np.zeros_like(heading)])
    ways: Floats = np.mean(others, axis=0) + (times[crewed] - middle)[:, :, None] * way[:, None]
    return ways


def fence_beside(points: Floats) -> Floats:
    """One inclusion area with a border beside all paths and parallel to them, to the right of the first one.

    Raises:
        ConfigError: the paths do not run along one line.
    """
    along = points[0, -1, :2] - points[0, 0, :2]
    along = along / np.linalg.norm(along)
    right = np.array([-along[1], along[0]])
    aside = points[:, :, :2] @ right
    if np.ptp(aside) > 2.0 * FENCE_ASIDE_M:
        raise ConfigError(
            "--world: fence: the paths must be along one line; allowed: head-on or overtaking encounters"
        )
    edge = aside.max() + FENCE_ASIDE_M
    corners = [
        sign * _FAR_M * along + offset * right
        for sign, offset in ((1.0, edge), (-1.0, edge), (-1.0, -_FAR_M), (1.0, -_FAR_M))
    ]
    around = zip(corners, (*corners[1:], corners[0]), strict=True)
    return np.array([kernels.Wall(0.0, kernels.IN_POLYGON, a[0], a[1], b[0], b[1], 0.0) for a, b in around])
