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

import numpy as np
from numpy.typing import NDArray

from companion.avoidance.compiled import compiled
from companion.avoidance.fence_planes import BRAKES, DOWN_SPEEDS, STOP_LAG_S, allowed, crosses, wall_planes
from companion.avoidance.programs import EPSILON, ball, least_violation

Array = NDArray[np.float64]

_STEPS = 40
"""Most steps of the search for the nearest velocity in reach."""
_SLOWER = 4
"""Bisection steps of the search for the greatest speed."""


@compiled
def limit(
    wanted: Array, previous: Array, most_change: float, least_down: float, most_down: float, speed: float
) -> tuple[float, float, float]:
    """The command on the way from `previous` to `wanted`, with limited change, down speed and total speed.

    The bounds on the down speed may move faster than the change allows (after a jump in altitude at the
    ceiling). Then the bounds have priority over the limit of the change.

    `tests/companion/avoidance/test_proofs.py` proves that speed and down bounds always hold. It proves the
    limit of the change if the last command was within the down bounds and the wish within the speed.
    """
    dn, de, dd = wanted[0] - previous[0], wanted[1] - previous[1], wanted[2] - previous[2]
    most_change *= 1.0 - 1e-9  # rounding stays under the limit
    change = math.sqrt(dn * dn + de * de + dd * dd)
    k = most_change / change if change > most_change else 1.0
    d = previous[2] + k * dd
    down = min(max(d, least_down), most_down)
    if down != d:  # the vertical change has priority over the horizontal one
        left = math.sqrt(max(most_change * most_change - (down - previous[2]) ** 2, 0.0))
        level = math.sqrt(dn * dn + de * de)
        k = left / level if level > left else 1.0
    n, e = previous[0] + k * dn, previous[1] + k * de
    most = speed * (1.0 - 1e-12)
    down = min(max(down, -most), most)
    level, room = math.sqrt(n * n + e * e), math.sqrt(max(most * most - down * down, 0.0))
    if level > room:
        n, e = n * room / level, e * room / level
    return n, e, down


@compiled
def in_reach(
    planes: Array, count: int, wish: Array, before: Array, change: float, speed: float
) -> tuple[bool, float, float, float]:
    """The velocity nearest to `wish` within the planes, the greatest speed and the change from `before`.

    The search moves a point straight from the wish to `before`. The farther it has moved, the nearer to
    `before` is the velocity that satisfies planes and speed nearest to the point. The result is the one whose
    distance from `before` is just the allowed change.

    Returns:
        True and the velocity. If none is within the change: False and the one nearest to `before`.
    """
    kept, x, y, z = ball(planes, count, speed, before[0], before[1], before[2], False)
    far = _gap(before, x, y, z) - change
    if kept < count or far > 0.0:
        return False, x, y, z
    kept, tx, ty, tz = ball(planes, count, speed, wish[0], wish[1], wish[2], False)
    over = _gap(before, tx, ty, tz) - change
    if kept == count and over <= 0.0:
        return True, tx, ty, tz
    low, high = 0.0, 1.0
    for step in range(_STEPS):
        # False position, and every third step bisection in case it does not converge.
        k = low + (high - low) * over / (over - far) if step % 3 != 2 else 0.5 * (low + high)
        on, oe, od = (
            wish[0] + k * (before[0] - wish[0]),
            wish[1] + k * (before[1] - wish[1]),
            wish[2] + k * (before[2] - wish[2]),
        )
        kept, tx, ty, tz = ball(planes, count, speed, on, oe, od, False)
        gap = _gap(before, tx, ty, tz) - change
        if kept < count or gap > 0.0:
            low, over = k, max(gap, 0.0)
        else:
            high, far, x, y, z = k, gap, tx, ty, tz
            if far > -1e-10 * change:
                break
        if high - low < 1e-9:
            break
    return True, x, y, z


@compiled
def _gap(before: Array, x: float, y: float, z: float) -> float:
    return math.sqrt((x - before[0]) ** 2 + (y - before[1]) ** 2 + (z - before[2]) ** 2)


@compiled
def _weigh(planes: Array, count: int, margin: float, brakes: float) -> None:
    """Divide each wall's plane by the distance (m) before the wall, so that the nearest wall counts most."""
    for j in range(DOWN_SPEEDS, count):
        towards = -planes[j, 3]
        room = margin + towards * STOP_LAG_S + towards * towards / (2.0 * brakes)
        for c in range(4):
            planes[j, c] /= room


@compiled
def _least_broken(
    planes: Array,
    count: int,
    wish: Array,
    before: Array,
    change: float,
    least: float,
    most: float,
    speed: float,
    outside: bool,
    scratch: Array,
) -> tuple[float, float, float]:
    """The command within the change that violates the walls' planes least.

    The planes of the down speeds are satisfied. With `outside`, so is the first plane of a wall if that is
    possible, so that nothing leads further out.
    """
    hard = DOWN_SPEEDS
    if outside:
        room = math.sqrt(planes[hard, 0] * planes[hard, 0] + planes[hard, 1] * planes[hard, 1])
        for c in range(4):
            planes[hard, c] /= room
        hard += 1
    for j in range(count):  # around the present command
        planes[j, 3] -= planes[j, 0] * before[0] + planes[j, 1] * before[1] + planes[j, 2] * before[2]
    kept, x, y, z = ball(planes, hard, change, 0.0, 0.0, 0.0, False)
    if outside and kept < hard:  # use the full change against going further out
        left = math.sqrt(max(change * change - z * z, 0.0))
        x, y = left * planes[kept, 0], left * planes[kept, 1]
    else:
        x, y, z = least_violation(planes, kept, count, change, x, y, z, kept, scratch)
    # Walls do not constrain the vertical, which gets the rest of the change.
    left = math.sqrt(max(change * change - x * x - y * y, 0.0))
    down = before[2] + min(max(wish[2] - before[2], -left), left)
    down = min(max(down, least), most)
    n, e = before[0] + x, before[1] + y
    top = speed * (1.0 - 1e-12)
    fast = math.sqrt(n * n + e * e + down * down)
    if fast > top:
        n, e, down = n * top / fast, e * top / fast, min(max(down * top / fast, least), most)
        level, room = math.sqrt(n * n + e * e), math.sqrt(max(top * top - down * down, 0.0))
        if level > room:
            n, e = n * room / level, e * room / level
    return n, e, down


@compiled
def _stops_inside(
    fence: Array,
    n: float,
    e: float,
    ahead_n: float,
    ahead_e: float,
    before: Array,
    level: float,
    acceleration: float,
) -> bool:
    """Whether braking straight on with the full acceleration limit ends before every wall."""
    stop_s = level / (2.0 * acceleration)
    for i in range(len(fence)):
        if crosses(fence[i], n, e, ahead_n + stop_s * before[0], ahead_e + stop_s * before[1]):
            return False
    return True


@compiled
def keep(
    fence: Array,
    n: float,
    e: float,
    ahead_n: float,
    ahead_e: float,
    margin: float,
    speed: float,
    acceleration: float,
    wish: Array,
    before: Array,
    change: float,
    least: float,
    most: float,
    planes: Array,
    hard: int,
    scratch: Array,
) -> tuple[float, float, float]:
    """The command: that of `limit` if it satisfies the walls' planes, else the nearest to the wish that does.

    Args:
        fence, n, e, ahead_n, ahead_e, margin, speed, acceleration: see `wall_planes`.
        wish: shape (at least 3,), velocity that the law wants, m/s.
        before: shape (at least 3,), the last command, m/s.
        change: greatest change of the command, m/s.
        least, most: bounds of the down speed, m/s.
        planes: the first `hard` rows are the planes of the down speeds, then those of `wall_planes` for all
            commands in reach; the rows after them are overwritten.
        hard: number of hard planes.
        scratch: shape of `planes`; overwritten.
    """
    x, y, z = limit(wish, before, change, least, most, speed)
    if allowed(planes, DOWN_SPEEDS, hard, x, y, 1.0):
        return x, y, z
    change *= 1.0 - 1e-9
    top = speed * (1.0 - 1e-12)
    if not least - change <= before[2] <= most + change:  # the vertical needs the full change
        return x, y, z
    found, x, y, z = in_reach(planes, hard, wish, before, change, top)
    if found:
        return x, y, z
    for j in range(DOWN_SPEEDS):
        for c in range(4):
            scratch[j, c] = planes[j, c]
    level = math.sqrt(before[0] * before[0] + before[1] * before[1])
    low, high = max(level - BRAKES * change, 0.0), min(level + change, speed)
    most_speed = high
    for step in range(_SLOWER + 2):
        bound = high if step == 0 else math.sqrt(most_speed * most_speed + change * change)
        count, _ = wall_planes(
            fence, n, e, ahead_n, ahead_e, before[0], before[1], margin, speed, acceleration, bound, False,
            0.0, scratch, DOWN_SPEEDS,
        )  # fmt: skip
        if step > 0 and level > EPSILON:
            scratch[count, 0], scratch[count, 1] = -before[0] / level, -before[1] / level
            scratch[count, 2], scratch[count, 3] = 0.0, -most_speed
            count += 1
        found, tx, ty, tz = in_reach(scratch, count, wish, before, change, top)
        if found:
            x, y, z = tx, ty, tz
            if step == 0:
                return x, y, z
            low = most_speed
        elif step == 1:
            break
        else:
            high = most_speed
        most_speed = low if step == 0 else 0.5 * (low + high)
    else:
        return x, y, z
    # The planes that rely on BRAKES and keep the margin cannot be satisfied.
    count, after = wall_planes(
        fence, n, e, ahead_n, ahead_e, before[0], before[1], margin, speed, acceleration, 0.0, False, 0.0,
        scratch, DOWN_SPEEDS,
    )  # fmt: skip
    if after == count and _stops_inside(fence, n, e, ahead_n, ahead_e, before, level, acceleration):
        k = max(1.0 - change / max(level, EPSILON), 0.0)
        return k * before[0], k * before[1], min(max(before[2], least), most)
    found, x, y, z = in_reach(scratch, count, wish, before, change, top)
    if found:
        return x, y, z
    _weigh(scratch, count, margin, BRAKES * acceleration)
    return _least_broken(
        scratch, count, wish, before, change, least, most, speed, after > count, planes[hard:]
    )
