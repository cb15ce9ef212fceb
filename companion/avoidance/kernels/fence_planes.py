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
from typing import NamedTuple

from companion.arrays import Floats
from companion.avoidance.kernels.compiled import compiled
from companion.avoidance.kernels.programs import EPSILON
from companion.avoidance.kernels.vectors import Point, Vector, copy_plane, plane_at, put_plane
from companion.avoidance.kernels.walls import (
    IN_CIRCLE,
    IN_POLYGON,
    after_area,
    inside,
    nearest_of_wall,
    wall_at,
)

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


class Site(NamedTuple):
    """Where the aircraft is in its fence, and what it can do there."""

    fence: Floats
    """Table of walls."""
    here: Point
    """Own position, m."""
    ahead: Point
    """Own position in LAG_S, m."""
    margin: float
    """Distance to keep from walls, m."""
    speed: float
    """Greatest speed, m/s."""
    acceleration: float
    """Acceleration limit, m/s^2."""


class Stop(NamedTuple):
    """How the aircraft stops."""

    time_s: float
    """Time for which a command's speed counts as flown on, until the aircraft stands."""
    brakes: float
    """m/s^2."""
    speed: float
    """Greatest speed, m/s."""


@compiled
def plane_rows(walls: int, neighbours: int) -> int:
    """Number of rows that `planes` and `scratch` of a decision need."""
    return 2 * (DOWN_SPEEDS + WALL_PLANES * walls + OTHER_PLANES + neighbours)


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
def _stopping(planes: Floats, at: int, inwards: Point, free: float, stop: Stop) -> int:
    """Write a wall's plane into row `at` if the wall is within reach. Returns the next free row."""
    towards = min(closing(max(free, 0.0), stop.brakes, STOP_LAG_S), max(free, 0.0) / stop.time_s)
    if towards >= stop.speed:
        return at
    put_plane(planes, at, Vector(inwards.n, inwards.e, 0.0), -towards)
    return at + 1


@compiled
def _from_within(ahead: Point, radius: float, command: Vector, stop: Stop, planes: Floats, at: int) -> int:
    """Write the planes of an inclusion circle. Returns the next free row.

    They are tangents of the circle: at the point nearest to the position ahead (from the centre), to both
    sides of it, and where the aircraft would stop from the present command. No tangent cuts off a part of the
    circle.
    """
    for turn in (0.0, _FAN_RAD, -_FAN_RAD, math.nan):
        if math.isnan(turn):
            on, oe = ahead.n + stop.time_s * command.n, ahead.e + stop.time_s * command.e
        else:
            c, s = math.cos(turn), math.sin(turn)
            on, oe = c * ahead.n - s * ahead.e, s * ahead.n + c * ahead.e
        size = math.sqrt(on * on + oe * oe)
        if size > 1e-9:
            on, oe = on / size, oe / size
            free = radius - (on * ahead.n + oe * ahead.e)
            at = _stopping(planes, at, Point(-on, -oe), free, stop)
    return at


@compiled
def _wall_plane(
    site: Site, row: int, room: float, inwards: Point, command: Vector, stop: Stop, planes: Floats, at: int
) -> int:
    """Write the planes of the wall in a row of the fence from row `at` on. Returns the next free row.

    Args:
        room, inwards: distance to the wall, and the unit vector from it.
    """
    wall = wall_at(site.fence, row)
    if wall.kind == IN_CIRCLE:
        ahead = Point(site.ahead.n - wall.n, site.ahead.e - wall.e)
        return _from_within(ahead, wall.radius_m - site.margin, command, stop, planes, at)
    free = (
        room
        + inwards.n * (site.ahead.n - site.here.n)
        + inwards.e * (site.ahead.e - site.here.e)
        - site.margin
    )
    return _stopping(planes, at, inwards, free, stop)


@compiled
def _way_back(
    site: Site, back: Point, command: Vector, slow: float, stop: Stop, planes: Floats, start: int, at: int
) -> int:
    """Write the hard planes outside of areas; the way back becomes the first plane. Returns the next free
    row.

    Args:
        back: direction to the nearest wall that has to be crossed back.
        slow: speed back that is required if that violates no other plane.
        start: first row of the fence's planes.
    """
    # To bound the speed: the aircraft must stop within a circle that it is on the border of, with its
    # centre on the way back.
    round_m = RETURN_MARGINS * site.margin
    ahead = Point(
        site.ahead.n - site.here.n - round_m * back.n, site.ahead.e - site.here.e - round_m * back.e
    )
    at = _from_within(ahead, round_m, command, stop, planes, at)
    if slow <= 0.0 or not allowed(planes, start, at, back, slow):
        slow = 0.0
    copy_plane(planes, start, planes, at)
    put_plane(planes, start, Vector(back.n, back.e, 0.0), slow)
    return at + 1


@compiled
def wall_planes(
    site: Site, command: Vector, bound: float, gain: float, planes: Floats, at: int
) -> tuple[int, int]:
    """Write the planes of the fence from row `at` on: hard planes, then at most one soft plane.

    On the allowed side of an area, each wall within reach requires that the aircraft can still stop a margin
    before it; standing still is always allowed. If the nearest wall is closer than the margin, a plane
    requires a way back, if that violates no other plane. On the wrong side of areas, the aircraft has to
    cross the nearest of their walls back. The first plane, which is hard, then lets nothing lead further out,
    and requires a slow way back if that violates no other plane. Further hard planes bound the speed, and a
    soft one requires a faster way back.

    Args:
        command: the present command, m/s.
        bound: greatest horizontal speed of the commands that can be chosen, m/s.
        gain: most that a way back may require beyond the present command's speed in its direction, m/s;
            -infinity: no way back is required, the planes only let nothing lead further out.
        planes: table of at least `plane_rows` planes; written.
        at: first row to write.

    Returns:
        The row after the hard planes, and the row after all planes.
    """
    brakes = BRAKES * site.acceleration
    stop = Stop(STOP_LAG_S + bound / (2.0 * brakes), brakes, site.speed)
    outside, back = math.inf, Point(0.0, 0.0)
    least_room, away = site.margin, Point(0.0, 0.0)
    start, first = at, 0
    while first < len(site.fence):
        after = after_area(site.fence, first)
        kind = wall_at(site.fence, first).kind
        right = inside(site.fence, first, after, site.here) == (kind in (IN_POLYGON, IN_CIRCLE))
        for i in range(first, after):
            room, d = nearest_of_wall(wall_at(site.fence, i), site.here)
            if d.n * d.n + d.e * d.e == 0.0:  # on the border itself the side is not defined
                continue
            if right:
                if room < least_room:
                    least_room, away = room, d
                at = _wall_plane(site, i, room, d, command, stop, planes, at)
            elif room < outside:
                outside, back = room, Point(-d.n, -d.e)
        first = after
    slowly = FENCE_BACK * site.speed
    if outside < math.inf:
        need = (outside + site.margin) / BACK_LAG_S
        slow = min(need, slowly, command.n * back.n + command.e * back.e + gain)
        at = _way_back(site, back, command, slow, stop, planes, start, at)
    if least_room < site.margin:
        need = (site.margin - least_room) / BACK_LAG_S
        slow = min(need, slowly, command.n * away.n + command.e * away.e + gain)
        if slow > 0.0 and allowed(planes, start, at, away, slow):
            put_plane(planes, at, Vector(away.n, away.e, 0.0), slow)
            at += 1
    hard = at
    if outside < math.inf:
        need = min((outside + site.margin) / BACK_LAG_S, FENCE_RETURN * site.speed)
        put_plane(planes, at, Vector(back.n, back.e, 0.0), need)
        at += 1
    return hard, at


@compiled
def allowed(planes: Floats, start: int, after: int, way: Point, speed: float) -> bool:
    """Whether a speed in a horizontal direction satisfies the planes of the rows from `start` to before
    `after`."""
    for j in range(start, after):
        plane = plane_at(planes, j)
        if speed * (plane.normal.n * way.n + plane.normal.e * way.e) < plane.least - EPSILON:
            return False
    return True
