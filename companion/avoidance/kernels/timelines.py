"""Values over time: the timed path, and the history of own velocities."""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.arrays import Floats
from companion.avoidance.kernels.compiled import compiled
from companion.avoidance.kernels.vectors import Triple, Vector, along, dot, minus

HISTORY_SPACING_S = 0.04
"""Least time between two samples in the history of own velocities."""
HISTORY_SAMPLES = 1024
"""Size of that history. When it is full, the newer half is kept: at least 20 s. For a message that is older
than the history, the oldest velocity in it is used."""


class Path(NamedTuple):
    """A timed path of K points, before any delay."""

    times_s: Floats
    """(K,), strictly rising."""
    points: Floats
    """(K, 3), NED, m."""


class History(NamedTuple):
    """Memory for up to H own velocities."""

    times_s: Floats
    """(H,), rising."""
    velocities: Floats
    """(H, 3), NED, m/s."""


@compiled
def _between(times_s: Floats, rows: Floats, count: int, t: float) -> Triple:
    """The row at time t, interpolated linearly between the first `count` rows at rising times; the first or
    last row outside of their times."""
    low, high = 0, count - 1
    if t <= times_s[low]:
        return rows[low, 0], rows[low, 1], rows[low, 2]
    if t >= times_s[high]:
        return rows[high, 0], rows[high, 1], rows[high, 2]
    while high - low > 1:
        middle = (low + high) // 2
        if times_s[middle] <= t:
            low = middle
        else:
            high = middle
    k = (t - times_s[low]) / (times_s[high] - times_s[low])
    return (
        rows[low, 0] + k * (rows[high, 0] - rows[low, 0]),
        rows[low, 1] + k * (rows[high, 1] - rows[low, 1]),
        rows[low, 2] + k * (rows[high, 2] - rows[low, 2]),
    )


@compiled
def path_position(times_s: Floats, points: Floats, t: float) -> Triple:
    """Point of a timed path at a time; its first or last point before its start or after its end.

    Args:
        times_s, points: see `Path`.
    """
    return _between(times_s, points, len(times_s), t)


@compiled
def point_at(path: Path, t: float) -> Vector:
    """`path_position` for the kernels."""
    n, e, d = _between(path.times_s, path.points, len(path.times_s), t)
    return Vector(n, e, d)


@compiled
def path_nearest(times_s: Floats, points: Floats, n: float, e: float, d: float) -> tuple[float, Triple]:
    """Time and place of a path's point nearest to a position; the earliest if several are equally near.

    Args:
        times_s, points: see `Path`.
    """
    least, t, nearest = math.inf, 0.0, Vector(0.0, 0.0, 0.0)
    for i in range(len(times_s) - 1):
        start = Vector(points[i, 0], points[i, 1], points[i, 2])
        leg = minus(Vector(points[i + 1, 0], points[i + 1, 1], points[i + 1, 2]), start)
        gap = minus(Vector(n, e, d), start)
        length2 = dot(leg, leg)
        share = 0.0
        if length2 > 0.0:
            share = min(max(dot(gap, leg) / length2, 0.0), 1.0)
        gap = along(gap, -share, leg)
        gap2 = dot(gap, gap)
        if gap2 < least:
            least = gap2
            t = times_s[i] + share * (times_s[i + 1] - times_s[i])
            nearest = along(start, share, leg)
    return t, (nearest.n, nearest.e, nearest.d)


@compiled
def own_velocity_at(history: History, samples: int, t: float) -> Vector:
    """Own velocity at a time, interpolated in the history; its first or last sample outside of it."""
    n, e, d = _between(history.times_s, history.velocities, samples, t)
    return Vector(n, e, d)


@compiled
def note_velocity(times_s: Floats, velocities: Floats, samples: int, now_s: float, velocity: Triple) -> int:
    """Add an own velocity to the history, oldest first. One that is not newer, or not finite, is ignored.

    Args:
        times_s, velocities: see `History`.
        samples: number of samples in the history.

    Returns:
        The new number of samples.
    """
    count, (vn, ve, vd) = samples, velocity
    if not math.isfinite(now_s + vn + ve + vd) or (count > 0 and now_s <= times_s[count - 1]):
        return count
    if count > 1 and times_s[count - 1] - times_s[count - 2] < HISTORY_SPACING_S:
        count -= 1  # the caller is fast: replace the newest sample
    elif count == len(times_s):
        half = count // 2
        for i in range(half):
            times_s[i] = times_s[count - half + i]
            for c in range(3):
                velocities[i, c] = velocities[count - half + i, c]
        count = half
    times_s[count] = now_s
    velocities[count, 0], velocities[count, 1], velocities[count, 2] = vn, ve, vd
    return count + 1
