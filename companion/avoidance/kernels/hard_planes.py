"""Finds the command nearest to the law's wish within one period's change that satisfies the hard planes.

If stopping was possible a period ago (`fence_planes`), braking keeps it possible, independent of other
aircraft. So once the aircraft can stop before every wall, this remains true, as long as the vehicle responds
with a lag of about LAG_S, and position and velocity are true.

The planes assume the greatest speed in reach. If no command in reach satisfies all of them, lower speeds are
assumed, because they shorten the stopping distance: the search includes commands up to such a speed, down to
braking with BRAKES of the acceleration limit. There are states from which even this does not stop in time
(taken over next to a wall, a gust). Then the aircraft brakes straight on with the full acceleration limit, if
that ends before every wall. Otherwise it turns away from each wall separately. If that is not possible
either, it violates the planes least, with the greatest weight on the nearest wall.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.arrays import Floats
from companion.avoidance.kernels.compiled import compiled
from companion.avoidance.kernels.fence_planes import (
    BRAKES,
    DOWN_SPEEDS,
    STOP_LAG_S,
    Site,
    allowed,
    wall_planes,
)
from companion.avoidance.kernels.programs import EPSILON, Aim, ball, least_violation
from companion.avoidance.kernels.vectors import (
    PLANE_COLUMNS,
    Point,
    Vector,
    along,
    copy_plane,
    dot,
    length,
    minus,
    plane_at,
    put_plane,
)
from companion.avoidance.kernels.walls import crosses, wall_at

_STEPS = 40
"""Most steps of the search for the nearest velocity in reach."""
_SLOWER = 4
"""Bisection steps of the search for the greatest speed."""


class Bounds(NamedTuple):
    """Bounds on a command, m/s."""

    change: float
    """Greatest change from the last command."""
    least_down: float
    most_down: float
    speed: float


@compiled
def limit(wanted: Vector, previous: Vector, bounds: Bounds) -> Vector:
    """The command on the way from `previous` to `wanted`, with limited change, down speed and total speed.

    The bounds on the down speed may move faster than the change allows (after a jump in altitude at the
    ceiling). Then the bounds have priority over the limit of the change.

    `tests/companion/avoidance/test_proofs.py` proves that speed and down bounds always hold. It proves the
    limit of the change if the last command was within the down bounds and the wish within the speed.
    """
    way = minus(wanted, previous)
    most_change = bounds.change * (1.0 - 1e-9)  # rounding stays under the limit
    change = length(way)
    k = most_change / change if change > most_change else 1.0
    d = previous.d + k * way.d
    down = min(max(d, bounds.least_down), bounds.most_down)
    if down != d:  # the vertical change has priority over the horizontal one
        left = math.sqrt(max(most_change * most_change - (down - previous.d) ** 2, 0.0))
        level = math.sqrt(way.n * way.n + way.e * way.e)
        k = left / level if level > left else 1.0
    n, e = previous.n + k * way.n, previous.e + k * way.e
    most = bounds.speed * (1.0 - 1e-12)
    return _leveled(n, e, min(max(down, -most), most), most)


@compiled
def _leveled(n: float, e: float, down: float, most: float) -> Vector:
    """The velocity, with its horizontal part shortened so that its length is at most `most`."""
    level, room = math.sqrt(n * n + e * e), math.sqrt(max(most * most - down * down, 0.0))
    if level > room:
        return Vector(n * room / level, e * room / level, down)
    return Vector(n, e, down)


@compiled
def in_reach(
    planes: Floats, count: int, wish: Vector, before: Vector, change: float, speed: float
) -> tuple[bool, Vector]:
    """The velocity nearest to `wish` within the planes, the greatest speed and the change from `before`.

    The search moves a point straight from the wish to `before`. The farther it has moved, the nearer to
    `before` is the velocity that satisfies planes and speed nearest to the point. The result is the one whose
    distance from `before` is just the allowed change.

    Returns:
        True and the velocity. If none is within the change: False and the one nearest to `before`.
    """
    kept, v = ball(planes, count, Aim(before, speed, False))
    far = length(minus(v, before)) - change
    if kept < count or far > 0.0:
        return False, v
    kept, tried = ball(planes, count, Aim(wish, speed, False))
    over = length(minus(tried, before)) - change
    if kept == count and over <= 0.0:
        return True, tried
    way = minus(before, wish)
    low, high = 0.0, 1.0
    for step in range(_STEPS):
        # False position, and every third step bisection in case it does not converge.
        k = low + (high - low) * over / (over - far) if step % 3 != 2 else 0.5 * (low + high)
        kept, tried = ball(planes, count, Aim(along(wish, k, way), speed, False))
        gap = length(minus(tried, before)) - change
        if kept < count or gap > 0.0:
            low, over = k, max(gap, 0.0)
        else:
            high, far, v = k, gap, tried
            if far > -1e-10 * change:
                break
        if high - low < 1e-9:
            break
    return True, v


@compiled
def _weigh(planes: Floats, count: int, margin: float, brakes: float) -> None:
    """Divide each wall's plane by the distance (m) before the wall, so that the nearest wall counts most."""
    for j in range(DOWN_SPEEDS, count):
        towards = -plane_at(planes, j).least
        room = margin + towards * STOP_LAG_S + towards * towards / (2.0 * brakes)
        for c in range(PLANE_COLUMNS):
            planes[j, c] /= room


@compiled
def _least_broken(
    planes: Floats, count: int, wish: Vector, before: Vector, bounds: Bounds, outside: bool, scratch: Floats
) -> Vector:
    """The command within the change that violates the walls' planes least.

    The planes of the down speeds are satisfied. With `outside`, so is the first plane of a wall if that is
    possible, so that nothing leads further out.
    """
    hard, change = DOWN_SPEEDS, bounds.change
    if outside:
        first = plane_at(planes, hard).normal
        room = math.sqrt(first.n * first.n + first.e * first.e)
        for c in range(PLANE_COLUMNS):
            planes[hard, c] /= room
        hard += 1
    for j in range(count):  # around the present command
        plane = plane_at(planes, j)
        put_plane(planes, j, plane.normal, plane.least - dot(plane.normal, before))
    kept, v = ball(planes, hard, Aim(Vector(0.0, 0.0, 0.0), change, False))
    if outside and kept < hard:  # use the full change against going further out
        left = math.sqrt(max(change * change - v.d * v.d, 0.0))
        out = plane_at(planes, kept).normal
        v = Vector(left * out.n, left * out.e, v.d)
    else:
        v = least_violation(planes, kept, count, change, v, kept, scratch)
    # Walls do not constrain the vertical, which gets the rest of the change.
    left = math.sqrt(max(change * change - v.n * v.n - v.e * v.e, 0.0))
    down = before.d + min(max(wish.d - before.d, -left), left)
    down = min(max(down, bounds.least_down), bounds.most_down)
    n, e = before.n + v.n, before.e + v.e
    top = bounds.speed * (1.0 - 1e-12)
    fast = math.sqrt(n * n + e * e + down * down)
    if fast > top:
        n, e = n * top / fast, e * top / fast
        down = min(max(down * top / fast, bounds.least_down), bounds.most_down)
        return _leveled(n, e, down, top)
    return Vector(n, e, down)


@compiled
def _stops_inside(site: Site, before: Vector, level: float, change: float) -> bool:
    """Whether braking straight on with the full acceleration limit ends before every wall.

    Args:
        before, level: the last command and its horizontal speed, m/s.
        change: of a command, m/s. The first one holds for a whole period, so that the way is shorter than
            that of a steady deceleration by half a period at the present speed.
    """
    stop_s = max(level - change, 0.0) / (2.0 * site.acceleration)
    end = Point(site.ahead.n + stop_s * before.n, site.ahead.e + stop_s * before.e)
    for i in range(len(site.fence)):  # noqa: SIM110 (numba knows no generator in all())
        if crosses(wall_at(site.fence, i), site.here, end):
            return False
    return True


@compiled
def _slower(
    site: Site, wish: Vector, before: Vector, change: float, nearest: Vector, scratch: Floats
) -> tuple[bool, Vector]:
    """The command in reach at the greatest speed whose stopping distance keeps the fence's planes.

    Args:
        nearest: returned, with False, if there is none.
        scratch: table of planes with those of the down speeds; the rows after them are overwritten.
    """
    level, top = math.sqrt(before.n * before.n + before.e * before.e), site.speed * (1.0 - 1e-12)
    low, high = max(level - BRAKES * change, 0.0), min(level + change, site.speed)
    most_speed, found = high, nearest
    for step in range(_SLOWER + 2):
        bound = high if step == 0 else math.sqrt(most_speed * most_speed + change * change)
        count, _ = wall_planes(site, before, bound, -math.inf, scratch, DOWN_SPEEDS)
        if step > 0 and level > EPSILON:
            put_plane(scratch, count, Vector(-before.n / level, -before.e / level, 0.0), -most_speed)
            count += 1
        ok, v = in_reach(scratch, count, wish, before, change, top)
        if ok:
            found = v
            if step == 0:
                return True, found
            low = most_speed
        elif step == 1:
            return False, found
        else:
            high = most_speed
        most_speed = low if step == 0 else 0.5 * (low + high)
    return True, found


@compiled
def keep(
    site: Site, wish: Vector, before: Vector, bounds: Bounds, planes: Floats, hard: int, scratch: Floats
) -> Vector:
    """The command: that of `limit` if it satisfies the walls' planes, else the nearest to the wish that does.

    Args:
        wish: velocity that the law wants, m/s.
        before: the last command, m/s.
        planes: the first `hard` rows are the planes of the down speeds, then those of `wall_planes` for all
            commands in reach; the rows after them are overwritten.
        hard: number of hard planes.
        scratch: table as large as `planes`; overwritten.
    """
    v = limit(wish, before, bounds)
    if allowed(planes, DOWN_SPEEDS, hard, Point(v.n, v.e), 1.0):
        return v
    change, top = bounds.change * (1.0 - 1e-9), site.speed * (1.0 - 1e-12)
    if not bounds.least_down - change <= before.d <= bounds.most_down + change:
        return v  # the vertical needs the full change
    found, v = in_reach(planes, hard, wish, before, change, top)
    if found:
        return v
    for j in range(DOWN_SPEEDS):
        copy_plane(planes, j, scratch, j)
    found, v = _slower(site, wish, before, change, v, scratch)
    if found:
        return v
    # The planes that rely on BRAKES and keep the margin cannot be satisfied.
    count, after = wall_planes(site, before, 0.0, -math.inf, scratch, DOWN_SPEEDS)
    level = math.sqrt(before.n * before.n + before.e * before.e)
    if after == count and _stops_inside(site, before, level, change):
        k = max(1.0 - change / max(level, EPSILON), 0.0)
        down = min(max(before.d, bounds.least_down), bounds.most_down)
        return _leveled(k * before.n, k * before.e, down, top)
    found, v = in_reach(scratch, count, wish, before, change, top)
    if found:
        return v
    _weigh(scratch, count, site.margin, BRAKES * site.acceleration)
    less = Bounds(change, bounds.least_down, bounds.most_down, bounds.speed)
    return _least_broken(scratch, count, wish, before, less, after > count, planes[hard:])
