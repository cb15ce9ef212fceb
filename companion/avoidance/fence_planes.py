"""Converts the walls of a fence into planes of a decision.

The rule is that the aircraft can always stop: a command c' is allowed if stopping straight on from it ends
before every wall. Let p be the position in LAG_S at the present velocity, and u the greatest speed of the
commands that can be reached. The aircraft stops no farther than p + c' t, with t = STOP_LAG_S + u / (2 b),
where b is BRAKES times the acceleration limit. Each wall (an edge or a circle) is convex and lies beyond the
plane through its nearest point. So n . c' >= -free / t, where `free` is the distance at p minus the margin,
keeps the whole stopping path on this side of the wall. The planes of all walls together keep it on this side
of all walls, also at a sharp corner or a notch.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.avoidance.compiled import compiled
from companion.avoidance.programs import EPSILON

Array = NDArray[np.float64]

# Columns of a row of `fence`, which is an edge or a circle: number of its area, increasing with the rows;
# kind of the area; both ends of the edge (north, east), or centre and radius of the circle, m.
W_AREA, W_KIND, W_FROM, W_TO, WALL_COLUMNS = 0, 1, 2, 4, 6
IN_POLYGON, OUT_OF_POLYGON, IN_CIRCLE, OUT_OF_CIRCLE = 0.0, 1.0, 2.0, 3.0

DOWN_SPEEDS = 2
"""Number of the first planes of a decision, which are hard: the least and the greatest down speed."""
WALL_PLANES = 4
"""Most planes of one wall: a circle seen from its inside has several."""
OTHER_PLANES = 8
"""Most further planes: those of the way back into an area, of the way out of a margin, and of a greatest
speed."""
BRAKES = 0.7
"""Share of the acceleration limit that is used to stop before walls. The rest is reserved for vertical
changes and for deviations of the vehicle."""
LAG_S = 0.5
"""Time in which the vehicle responds to a command."""
STOP_LAG_S = 0.5
"""Time until a command is changed: a period, latency, and the part of the vehicle's lag beyond LAG_S."""
BACK_LAG_S = 1.0
"""Time in which a short way back to a fence's margin is flown."""
FENCE_MARGIN_M = 2.0
"""Distance kept from a fence, in addition to two standard deviations of the own position."""
FENCE_BACK = 0.2
"""Greatest speed, as a fraction of the speed limit, out of a fence's margin, and back into an area where this
has priority over avoiding other aircraft."""
RETURN_MARGINS = 3.0
"""From outside an area, the aircraft flies back no faster than it can stop within twice this many margins."""
FENCE_RETURN = 0.5
"""Greatest speed, as a fraction of the speed limit, back into an area if no other aircraft is in the way."""
_FAN_RAD = math.radians(60.0)


@compiled
def plane_rows(walls: int, neighbours: int) -> int:
    """Number of rows that `planes` and `scratch` of a decision need."""
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
    if length < 1e-9:  # on the edge itself the side is not defined
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
    """Whether the straight line from a to b, which begins on the allowed side of a wall, crosses it."""
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
    """Greatest speed v towards a boundary from which the aircraft still stops: v lag + v^2 / (2 a) = room.

    Beyond the boundary (`room` at most 0) the speed is negative: the way back.
    `tests/companion/avoidance/test_proofs.py` proves this for one reaction and for any number of periods.
    """
    if room <= 0.0:
        return room / lag_s
    lag = acceleration * lag_s
    return math.sqrt(lag * lag + 2.0 * acceleration * room) - lag


@compiled
def _stopping(
    planes: Array, at: int, dn: float, de: float, free: float, stop_s: float, brakes: float, speed: float
) -> int:
    """Write a wall's plane into row `at` if the wall is within reach. Returns the next free row."""
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
    """Write the planes of an inclusion circle. Returns the next free row.

    They are tangents of the circle: at the point nearest to the position ahead (yn, ye from the centre), to
    both sides of it, and where the aircraft would stop from the present command (cn, ce). No tangent cuts off
    a part of the circle.
    """
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
    """Write the planes of the fence from row `at` on: hard planes, then at most one soft plane.

    On the allowed side of an area, each wall within reach requires that the aircraft can still stop a margin
    before it; standing still is always allowed. If the nearest wall is closer than the margin, a plane
    requires a way back, if that violates no other plane. On the wrong side of areas, the aircraft has to
    cross the nearest of their walls back. The first plane, which is hard, then lets nothing lead further out,
    and requires a slow way back if that violates no other plane. Further hard planes bound the speed, and a
    soft one requires a faster way back.

    Args:
        fence: shape (F, WALL_COLUMNS); areas one after the other.
        n, e: own position, m.
        ahead_n, ahead_e: own position in LAG_S, m.
        cn, ce: the present command, m/s.
        margin: distance to keep from walls, m.
        speed: greatest speed, m/s.
        acceleration: acceleration limit, m/s^2.
        bound: greatest horizontal speed of the commands that can be chosen, m/s.
        back: whether to require ways back; if not, the planes only let nothing lead further out.
        gain: most that a way back may require beyond the present command's speed in its direction, m/s.
        planes: shape (at least `plane_rows`, 4); written.
        at: first row to write.

    Returns:
        The row after the hard planes, and the row after all planes.
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
            if dn * dn + de * de == 0.0:  # on the border itself the side is not defined
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
        # To bound the speed: the aircraft must stop within a circle that it is on the border of, with its
        # centre on the way back.
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
    """Whether a speed in a horizontal direction satisfies the planes of the rows from `start` to before
    `after`."""
    for j in range(start, after):
        if speed * (planes[j, 0] * dn + planes[j, 1] * de) < planes[j, 3] - EPSILON:
            return False
    return True
