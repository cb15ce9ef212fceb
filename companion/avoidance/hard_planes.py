"""The walls of a fence as planes, and the command that keeps them within what can be changed in one period.

What is kept is that it can still stop: a command c' is allowed where stopping from it, straight on, ends
before every wall. With the place p that it reaches in LAG_S as it flies, and a greatest speed u of the commands
that can be reached, it stops no farther than p + c' t, t = STOP_LAG_S + u / (2 b), where b is BRAKES times the
acceleration limit. Each wall (an edge, a circle: convex) lies beyond the plane through its nearest point, so
that n . c' >= -free / t with the room `free` at p less the margin keeps the whole way to a stop on this side
of it, and those of all walls together on this side of all: two walls of a corner, however sharp, and a notch.
Where a period ago the way to a stop was free, braking on keeps it free, whatever is heard; so once it holds it
goes on to hold, as long as the vehicle answers with a lag of about LAG_S and position and velocity are true.

The command is the nearest to what the law wants of those within the change of one period that keep every
plane. Where none does, a lower greatest speed makes t shorter: first those that do not fly faster than that
are looked through, down to braking with b. Only then the largest violation is made least.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.avoidance.compiled import compiled
from companion.avoidance.programs import EPSILON, ball, least_violation

Array = NDArray[np.float64]

# Columns of a row of `fence`, an edge or a circle: number of its area, rising from row to row; what the area
# is; corners north, east, or a circle's middle and radius, m.
W_AREA, W_KIND, W_FROM, W_TO, WALL_COLUMNS = 0, 1, 2, 4, 6
IN_POLYGON, OUT_OF_POLYGON, IN_CIRCLE, OUT_OF_CIRCLE = 0.0, 1.0, 2.0, 3.0

DOWN_SPEEDS = 2
"""First planes of a decision, hard: the least and the greatest down speed."""
WALL_PLANES = 4
"""Most planes of one wall: a circle from within has several."""
OTHER_PLANES = 8
"""The way back into an area and what bounds it, the one out of a margin, and a greatest speed."""
BRAKES = 0.7
"""Share of the acceleration limit that stopping before walls counts on; the rest is for the vertical, and for
what the vehicle does differently."""
LAG_S = 0.5
"""In which the vehicle answers a command."""
STOP_LAG_S = 0.5
"""Until a command is changed: a period, latency, and what of the vehicle's lag is beyond LAG_S."""
BACK_LAG_S = 1.0
"""In which the way back into the margin is made, where it is short."""
FENCE_MARGIN_M = 2.0
"""Kept from a fence besides two standard deviations of the own position."""
FENCE_BACK = 0.2
"""Speed back out of a fence's margin, and back into an area before others are avoided, in parts of the
greatest."""
RETURN_MARGINS = 3.0
"""From outside it flies no faster back than it still stops within twice so many margins."""
FENCE_RETURN = 0.5
"""Speed back into an area where nobody is in the way."""
_STEPS = 24
_SLOWER = 4
"""Steps of a search for the nearest in reach, and for the greatest speed."""
_FAN_RAD = math.radians(60.0)


@compiled
def plane_rows(walls: int, neighbours: int) -> int:
    """Rows that a decision's `planes` and `scratch` need."""
    return 2 * (DOWN_SPEEDS + WALL_PLANES * walls + OTHER_PLANES + neighbours)


@compiled
def nearest_of_wall(wall: Array, n: float, e: float) -> tuple[float, float, float]:
    """Distance (m) to the nearest point of an edge or a circle, and the unit vector from there to (n, e)."""
    if wall[W_KIND] >= IN_CIRCLE:
        dn, de = n - wall[W_FROM], e - wall[W_FROM + 1]
        length = math.sqrt(dn * dn + de * de)
        if length < 1e-9:
            dn, de, length = 1.0, 0.0, 1.0
        room = math.sqrt((n - wall[W_FROM]) ** 2 + (e - wall[W_FROM + 1]) ** 2) - wall[W_TO]
        k = 1.0 / length if room >= 0.0 else -1.0 / length
        return abs(room), k * dn, k * de
    an, ae = wall[W_FROM], wall[W_FROM + 1]
    sn, se = wall[W_TO] - an, wall[W_TO + 1] - ae
    share = min(max(((n - an) * sn + (e - ae) * se) / (sn * sn + se * se), 0.0), 1.0)
    dn, de = n - an - share * sn, e - ae - share * se
    length = math.sqrt(dn * dn + de * de)
    if length < 1e-9:  # on the edge itself: nothing tells the sides apart
        return 0.0, 0.0, 0.0
    return length, dn / length, de / length


@compiled
def inside(fence: Array, first: int, after: int, n: float, e: float) -> bool:
    """Whether a point is inside the polygon or circle of the rows from `first` to before `after`."""
    if fence[first, W_KIND] >= IN_CIRCLE:
        dn, de = n - fence[first, W_FROM], e - fence[first, W_FROM + 1]
        return bool(dn * dn + de * de < fence[first, W_TO] ** 2)
    inside = False
    for i in range(first, after):
        an, ae = fence[i, W_FROM], fence[i, W_FROM + 1]
        bn, be = fence[i, W_TO], fence[i, W_TO + 1]
        if (ae > e) != (be > e) and n < an + (e - ae) / (be - ae) * (bn - an):
            inside = not inside
    return inside


@compiled
def closing(room: float, acceleration: float, lag_s: float) -> float:
    """Speed at which it still stops at a boundary: v lag + v^2 / (2 a) = room; beyond it, the way back."""
    if room <= 0.0:
        return room / lag_s
    lag = acceleration * lag_s
    return math.sqrt(lag * lag + 2.0 * acceleration * room) - lag


@compiled
def _stopping(
    planes: Array, at: int, dn: float, de: float, free: float, stop_s: float, brakes: float, speed: float
) -> int:
    """A wall's plane into row `at`, where it is within reach; the row after it."""
    towards = min(closing(max(free, 0.0), brakes, STOP_LAG_S), max(free, 0.0) / stop_s)
    if towards >= speed:
        return at
    planes[at, 0], planes[at, 1], planes[at, 2], planes[at, 3] = dn, de, 0.0, -towards
    return at + 1


@compiled
def _from_within(
    yn: float,
    ye: float,
    radius: float,
    cn: float,
    ce: float,
    speed: float,
    stop_s: float,
    brakes: float,
    planes: Array,
    at: int,
) -> int:
    """Planes of a circle to be stayed in: its tangents nearest to the place ahead (yn, ye from its middle), to
    both sides, and where it would stop from the present command (cn, ce). None cuts off any of the circle."""
    for turn in (0.0, _FAN_RAD, -_FAN_RAD, math.nan):
        if math.isnan(turn):
            on, oe = yn + stop_s * cn, ye + stop_s * ce
        else:
            c, s = math.cos(turn), math.sin(turn)
            on, oe = c * yn - s * ye, s * yn + c * ye
        length = math.sqrt(on * on + oe * oe)
        if length > 1e-9:
            on, oe = on / length, oe / length
            at = _stopping(planes, at, -on, -oe, radius - (on * yn + oe * ye), stop_s, brakes, speed)
    return at


@compiled
def wall_planes(
    fence: Array,
    n: float,
    e: float,
    ahead_n: float,
    ahead_e: float,
    cn: float,
    ce: float,
    margin: float,
    speed: float,
    acceleration: float,
    bound: float,
    back: bool,
    gain: float,
    planes: Array,
    at: int,
) -> tuple[int, int]:
    """Planes of the fence, from row `at` on: hard ones, then a soft one; the rows after each.

    On the right side of an area, each wall within reach asks that it can still be stopped at, a margin before
    it; standing still is allowed. Within the margin of the nearest of them there is a way back, where that
    breaks no other. On the wrong side of areas, the nearest of their walls is to be crossed back: a hard plane
    that lets nothing lead further out and asks for a slow way back where that breaks no other, and a soft one
    for a faster way.

    Args:
        fence: shape (F, WALL_COLUMNS); areas one after the other.
        n, e: own position, m; ahead_n, ahead_e: where it will be in LAG_S.
        cn, ce: the present command, m/s.
        margin: kept from walls, m.
        speed: greatest speed, m/s.
        acceleration: its limit, m/s^2.
        bound: greatest horizontal speed of what is to be chosen from, m/s.
        back: whether the ways back are asked for; without it only that nothing leads further out.
        gain: most that they ask for beyond what the present command has of them, m/s.
        planes: shape (at least `plane_rows`, 4); written.
    """
    brakes = BRAKES * acceleration
    stop_s = STOP_LAG_S + bound / (2.0 * brakes)
    outside, bn, be = math.inf, 0.0, 0.0
    least_room, wn, we = margin, 0.0, 0.0
    start, first = at, 0
    while first < len(fence):
        after = first + 1
        while after < len(fence) and fence[after, W_AREA] == fence[first, W_AREA]:
            after += 1
        kind = fence[first, W_KIND]
        right = inside(fence, first, after, n, e) == (kind in (IN_POLYGON, IN_CIRCLE))
        for i in range(first, after):
            room, dn, de = nearest_of_wall(fence[i], n, e)
            if dn * dn + de * de == 0.0:  # on the border itself: nothing tells the sides apart
                continue
            if not right:
                if room < outside:
                    outside, bn, be = room, -dn, -de
                continue
            if room < least_room:
                least_room, wn, we = room, dn, de
            if kind == IN_CIRCLE:
                at = _from_within(
                    ahead_n - fence[i, W_FROM], ahead_e - fence[i, W_FROM + 1], fence[i, W_TO] - margin,
                    cn, ce, speed, stop_s, brakes, planes, at,
                )  # fmt: skip
            else:
                free = room + dn * (ahead_n - n) + de * (ahead_e - e) - margin
                at = _stopping(planes, at, dn, de, free, stop_s, brakes, speed)
        first = after
    if outside < math.inf:
        # It stops before long: in a circle that it stands on the border of, with its middle on the way back.
        round_m = RETURN_MARGINS * margin
        at = _from_within(
            ahead_n - n - round_m * bn, ahead_e - e - round_m * be, round_m, cn, ce, speed, stop_s, brakes,
            planes, at,
        )  # fmt: skip
        slow = 0.0
        if back:
            slow = min((outside + margin) / BACK_LAG_S, FENCE_BACK * speed, cn * bn + ce * be + gain)
        if slow <= 0.0 or not _allowed(planes, start, at, bn, be, slow):
            slow = 0.0
        for c in range(4):
            planes[at, c] = planes[start, c]
        planes[start, 0], planes[start, 1], planes[start, 2], planes[start, 3] = bn, be, 0.0, slow
        at += 1
    if back and least_room < margin:
        slow = min((margin - least_room) / BACK_LAG_S, FENCE_BACK * speed, cn * wn + ce * we + gain)
        if slow > 0.0 and _allowed(planes, start, at, wn, we, slow):
            planes[at, 0], planes[at, 1], planes[at, 2], planes[at, 3] = wn, we, 0.0, slow
            at += 1
    hard = at
    if outside < math.inf:
        planes[at, 0], planes[at, 1], planes[at, 2] = bn, be, 0.0
        planes[at, 3] = min((outside + margin) / BACK_LAG_S, FENCE_RETURN * speed)
        at += 1
    return hard, at


@compiled
def _allowed(planes: Array, start: int, after: int, dn: float, de: float, speed: float) -> bool:
    """Whether a speed along a level direction keeps the planes of these rows."""
    for j in range(start, after):
        if speed * (planes[j, 0] * dn + planes[j, 1] * de) < planes[j, 3] - EPSILON:
            return False
    return True


@compiled
def limit(
    wanted: Array, previous: Array, most_change: float, least_down: float, most_down: float, speed: float
) -> tuple[float, float, float]:
    """The command nearest to `wanted` on the way from `previous`: change, down speed and speed limited.

    The bounds on the down speed may move faster than the change allows (a jump in altitude at the ceiling);
    then they win, and the change is what it has to be.
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
            if far > -1e-6 * change:
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
    if _allowed(planes, DOWN_SPEEDS, hard, x, y, 1.0):
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
            fence, n, e, ahead_n, ahead_e, before[0], before[1], margin, speed, acceleration, bound, False, 0.0,
            scratch, DOWN_SPEEDS,
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
    # It cannot stop straight on before all of them: each by itself, by turning off it.
    count, after = wall_planes(
        fence, n, e, ahead_n, ahead_e, before[0], before[1], margin, speed, acceleration, 0.0, False, 0.0,
        scratch, DOWN_SPEEDS,
    )  # fmt: skip
    found, x, y, z = in_reach(scratch, count, wish, before, change, top)
    if found:
        return x, y, z
    _weigh(scratch, count, margin, BRAKES * acceleration)
    return _least_broken(
        scratch, count, wish, before, change, least, most, speed, after > count, planes[hard:]
    )
