"""A geofence in the local frame, as the kernels take it, and whether a path keeps it.

Every area binds. Firmwares differ in what several inclusion areas mean (ArduPilot: all of them, or any by
option; PX4: any in older releases, all in newer ones), and the fence does not tell: the stricter reading is
right for both.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from companion.avoidance import kernels as k
from companion.avoidance.trajectory import Trajectory
from companion.errors import ConfigError
from companion.events import FenceArea, Vec3
from companion.geometry import LocalFrame

Point = tuple[float, float]


def walls_of(areas: Sequence[FenceArea], frame: LocalFrame, trajectory: Trajectory) -> k.Array:
    """The walls that an aircraft on this path keeps, shape (F, WALL_COLUMNS).

    Args:
        areas: checked (`fence.check_areas`).

    Raises:
        ConfigError: the path leaves what it must stay in, or enters or grazes what it must stay out of.
    """
    rows: list[tuple[float, ...]] = []
    for number, area in enumerate(areas):
        walls = _walls(number, area, frame)
        trouble = _trouble(area, walls, trajectory)
        if trouble is not None:
            kind = "in" if area.inclusion else "out of"
            raise ConfigError(f"fence: area[{number}] (to be stayed {kind}): the path {trouble}")
        rows += walls
    return np.array(rows) if rows else np.zeros((0, k.WALL_COLUMNS))


def _walls(number: int, area: FenceArea, frame: LocalFrame) -> list[tuple[float, ...]]:
    corners: list[Point] = [frame.to_ned(lat, lon, frame.alt_m)[:2] for lat, lon in area.points]
    if area.radius_m is not None:
        kind = k.IN_CIRCLE if area.inclusion else k.OUT_OF_CIRCLE
        return [(number, kind, *corners[0], area.radius_m, 0.0)]
    kind = k.IN_POLYGON if area.inclusion else k.OUT_OF_POLYGON
    edges = zip(corners, (*corners[1:], corners[0]), strict=True)
    return [(number, kind, *a, *b) for a, b in edges if a != b]


def _trouble(area: FenceArea, walls: list[tuple[float, ...]], trajectory: Trajectory) -> str | None:
    """What the path does that it must not, in words."""
    table = np.array(walls)
    n, e, _ = trajectory.points_ned_m[0]
    if k.inside(table, 0, len(table), n, e) != area.inclusion:
        return "begins outside of it" if area.inclusion else "begins in it"
    for number, (a, b) in enumerate(itertools.pairwise(trajectory.points_ned_m)):
        room = min(_room(wall, a, b) for wall in walls)
        if room < k.FENCE_MARGIN_M:
            how = "crosses its border" if room <= 0.0 else f"comes within {room:.1f} m of its border"
            return (
                f"{how} between waypoint[{number}] and waypoint[{number + 1}]; allowed are "
                f"{k.FENCE_MARGIN_M:g} m"
            )
    return None


def _room(wall: tuple[float, ...], a: Vec3, b: Vec3) -> float:
    """Least horizontal distance of a leg from a wall, m; 0 where it crosses."""
    _, kind, n, e, other_n, other_e = wall
    start, end = (a[0], a[1]), (b[0], b[1])
    if kind in (k.IN_CIRCLE, k.OUT_OF_CIRCLE):
        middle, radius = (n, e), other_n
        near = _from_leg(middle, start, end)
        far = max(math.dist(middle, start), math.dist(middle, end))
        return 0.0 if near <= radius <= far else min(abs(near - radius), abs(far - radius))
    corner, other = (n, e), (other_n, other_e)
    if _crosses(corner, other, start, end):
        return 0.0
    return min(
        _from_leg(start, corner, other),
        _from_leg(end, corner, other),
        _from_leg(corner, start, end),
        _from_leg(other, start, end),
    )


def _from_leg(point: Point, a: Point, b: Point) -> float:
    """Distance of a point from the straight way between two."""
    sn, se = b[0] - a[0], b[1] - a[1]
    length2 = sn * sn + se * se
    share = 0.0
    if length2 > 0.0:
        share = min(max(((point[0] - a[0]) * sn + (point[1] - a[1]) * se) / length2, 0.0), 1.0)
    return math.dist(point, (a[0] + share * sn, a[1] + share * se))


def _crosses(a: Point, b: Point, c: Point, d: Point) -> bool:
    """Whether the way from a to b and that from c to d cross inside both."""
    return _side(a, b, c) * _side(a, b, d) < 0.0 and _side(c, d, a) * _side(c, d, b) < 0.0


def _side(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
