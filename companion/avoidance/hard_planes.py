"""The command: the nearest to what the law wants within the change of one period that keeps the hard planes.

Where stopping was possible a period ago (`fence_planes`), braking on keeps it possible, whatever is heard. So
once every wall can be stopped at, it stays so, as long as the vehicle answers with a lag of about LAG_S and
position and velocity are true.

Where no command in reach keeps every plane for the greatest speed in reach, a lower speed makes the way to a
stop shorter: those that do not fly faster than that are looked through, down to braking with BRAKES of the
acceleration limit. A state from which even that does not stop in time (taken over next to a wall, a gust) is
left by braking straight on with all of the acceleration limit, where that ends before every wall; else by
turning off each wall by itself; and where that is too much, too, by breaking least what is nearest.
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
_SLOWER = 4
"""Steps of a search for the nearest in reach, and for the greatest speed."""


@compiled
def limit(
    wanted: Array, previous: Array, most_change: float, least_down: float, most_down: float, speed: float
) -> tuple[float, float, float]:
    """The command nearest to `wanted` on the way from `previous`: change, down speed and speed limited.

    The bounds on the down speed may move faster than the change allows (a jump in altitude at the ceiling);
    then they win, and the change is what it has to be.

    `tests/companion/avoidance/test_proofs.py` proves that speed and down bounds always hold, and the change
    where the last command was within the down bounds and the wish within the speed.
    """
    dn, de, dd = wanted[0] - previous[0], wanted[1] - previous[1], wanted[2] - previous[2]
    most_change *= 1.0 - 1e-9  # rounding stays under the limit
    change = math.sqrt(dn * dn + de * de + dd * dd)
    k = most_change / change if change > most_change else 1.0
    d = previous[2] + k * dd
    down = min(max(d, least_down), most_down)
    if down != d:  # what the vertical needs is taken from the horizontal
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
    """The velocity nearest to `wish` of those that keep the planes, the speed and the change from `before`.

    What keeps planes and speed nearest to a point on the straight way from the wish to `before` comes the
    nearer to `before` the farther the point has gone, and is the answer where it has come as near as it must.

    Returns:
        False and what keeps the planes nearest to `before`, where that is too far from it.
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
        # False position, and halves where it does not get on.
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
    """Divide the planes of walls, each by the room (m) left before its wall: the nearest one counts most."""
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
    """The command within the change that breaks the walls' planes least; the down speeds are kept, and
    outside of an area the first plane of a wall, where it can be: nothing leads further out."""
    hard = DOWN_SPEEDS
    if outside:
        room = math.sqrt(planes[hard, 0] * planes[hard, 0] + planes[hard, 1] * planes[hard, 1])
        for c in range(4):
            planes[hard, c] /= room
        hard += 1
    for j in range(count):  # around the present command
        planes[j, 3] -= planes[j, 0] * before[0] + planes[j, 1] * before[1] + planes[j, 2] * before[2]
    kept, x, y, z = ball(planes, hard, change, 0.0, 0.0, 0.0, False)
    if outside and kept < hard:  # all that there is, not to go further out
        left = math.sqrt(max(change * change - z * z, 0.0))
        x, y = left * planes[kept, 0], left * planes[kept, 1]
    else:
        x, y, z = least_violation(planes, kept, count, change, x, y, z, kept, scratch)
    # Walls say nothing of the vertical: it gets what they leave.
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
    """Whether braking straight on with all of the acceleration limit ends before every wall."""
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
    """The command: as `limit` says where that keeps the walls' planes, else the nearest that keeps them.

    Args:
        fence, n, e, ahead_n, ahead_e, margin, speed, acceleration: as of `wall_planes`.
        wish: shape (at least 3,), what the law wants, m/s.
        before: shape (at least 3,), the last command, m/s.
        change: most that it may change, m/s.
        least, most: of the down speed, m/s.
        planes: the `hard` first rows are the planes of `wall_planes` for all that can be reached, after those
            of the down speeds; the rows after them are written.
        scratch: as `planes`; written.
    """
    x, y, z = limit(wish, before, change, least, most, speed)
    if allowed(planes, DOWN_SPEEDS, hard, x, y, 1.0):
        return x, y, z
    change *= 1.0 - 1e-9
    top = speed * (1.0 - 1e-12)
    if not least - change <= before[2] <= most + change:  # the vertical needs all of the change
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
    # No planes hold that count on BRAKES and keep the margin.
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
