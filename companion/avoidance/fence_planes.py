"""The walls of a fence as planes of a decision.

What is kept is that it can still stop: a command c' is allowed where stopping from it, straight on, ends
before every wall. With the place p that it reaches in LAG_S as it flies, and a greatest speed u of the
commands that can be reached, it stops no farther than p + c' t, t = STOP_LAG_S + u / (2 b), where b is BRAKES
times the acceleration limit. Each wall (an edge, a circle: convex) lies beyond the plane through its nearest
point, so that n . c' >= -free / t with the room `free` at p less the margin keeps the whole way to a stop on
this side of it, and those of all walls together on this side of all: two walls of a corner, however sharp,
and a notch.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.avoidance.compiled import compiled
from companion.avoidance.programs import EPSILON

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
def crosses(wall: Array, an: float, ae: float, bn: float, be: float) -> bool:
    """Whether the straight way from a to b, which begins on the right side of a wall, crosses it."""
    if wall[W_KIND] == IN_CIRCLE:
        return bool(math.sqrt((bn - wall[W_FROM]) ** 2 + (be - wall[W_FROM + 1]) ** 2) > wall[W_TO])
    dn, de = bn - an, be - ae
    if wall[W_KIND] == OUT_OF_CIRCLE:
        on, oe = wall[W_FROM] - an, wall[W_FROM + 1] - ae
        share = min(max((on * dn + oe * de) / max(dn * dn + de * de, 1e-12), 0.0), 1.0)
        return bool(math.sqrt((share * dn - on) ** 2 + (share * de - oe) ** 2) < wall[W_TO])
    pn, pe = wall[W_FROM] - an, wall[W_FROM + 1] - ae
    qn, qe = wall[W_TO] - an, wall[W_TO + 1] - ae
    sn, se = qn - pn, qe - pe
    ends = (dn * pe - de * pn) * (dn * qe - de * qn)
    sides = (sn * pe - se * pn) * (sn * (pe - de) - se * (pn - dn))
    return bool(ends <= 0.0 and sides <= 0.0)


@compiled
def closing(room: float, acceleration: float, lag_s: float) -> float:
    """Speed at which it still stops at a boundary: v lag + v^2 / (2 a) = room; beyond it, the way back.

    `tests/companion/avoidance/test_proofs.py` proves it, for one reaction and for any number of periods.
    """
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
    """Planes of a circle to be stayed in: its tangents nearest to the place ahead (yn, ye from its middle),
    to both sides, and where it would stop from the present command (cn, ce). None cuts off any of it."""
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
    breaks no other. On the wrong side of areas, the nearest of their walls is to be crossed back: a hard
    plane, the first, that lets nothing lead further out and asks for a slow way back where that breaks no
    other, some that bound the speed, and a soft one for a faster way.

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
        if slow <= 0.0 or not allowed(planes, start, at, bn, be, slow):
            slow = 0.0
        for c in range(4):
            planes[at, c] = planes[start, c]
        planes[start, 0], planes[start, 1], planes[start, 2], planes[start, 3] = bn, be, 0.0, slow
        at += 1
    if back and least_room < margin:
        slow = min((margin - least_room) / BACK_LAG_S, FENCE_BACK * speed, cn * wn + ce * we + gain)
        if slow > 0.0 and allowed(planes, start, at, wn, we, slow):
            planes[at, 0], planes[at, 1], planes[at, 2], planes[at, 3] = wn, we, 0.0, slow
            at += 1
    hard = at
    if outside < math.inf:
        planes[at, 0], planes[at, 1], planes[at, 2] = bn, be, 0.0
        planes[at, 3] = min((outside + margin) / BACK_LAG_S, FENCE_RETURN * speed)
        at += 1
    return hard, at


@compiled
def allowed(planes: Array, start: int, after: int, dn: float, de: float, speed: float) -> bool:
    """Whether a speed along a level direction keeps the planes of these rows."""
    for j in range(start, after):
        if speed * (planes[j, 0] * dn + planes[j, 1] * de) < planes[j, 3] - EPSILON:
            return False
    return True
