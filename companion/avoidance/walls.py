"""Converts a geofence into walls in the local frame for the kernels, and checks that a path keeps it.

All areas must be kept. Firmwares differ in the meaning of several inclusion areas (ArduPilot: all of them, or
optionally any; PX4: any in older releases, all in newer ones), and the fence itself does not say which. The
stricter reading is valid for both.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.avoidance.trajectory import Trajectory
from companion.errors import ConfigError
from companion.events import FenceArea
from companion.geometry import LocalFrame


def walls_of(
    areas: Sequence[FenceArea], frame: LocalFrame, trajectory: Trajectory | None, sigma_m: float
) -> Floats:
    """The walls (edges and circles) of a fence, a table with the columns of `kernels.Wall`.

    Args:
        areas: areas of the fence, already checked (`geofence.check_areas`).
        trajectory: path to check against the walls; None: no check.
        sigma_m: own horizontal standard deviation. The margin that the law keeps from walls grows with it,
            and a path within that margin could not be flown to its end.

    Raises:
        ConfigError: the path leaves an inclusion area, enters an exclusion area, or comes too near to a
            border.
    """
    rows: list[k.Wall] = []
    points = None if trajectory is None else np.array(trajectory.points_ned_m)[:, :2]
    margin = k.FENCE_MARGIN_M + 2.0 * sigma_m
    for number, area in enumerate(areas):
        walls = _walls(number, area, frame)
        trouble = None if points is None else _trouble(area, np.array(walls), points, margin)
        if trouble is not None:
            kind = "inclusion" if area.inclusion else "exclusion"
            raise ConfigError(f"fence: area[{number}] ({kind}): the path {trouble}")
        rows += walls
    return np.array(rows) if rows else k.NO_WALLS


def _walls(number: int, area: FenceArea, frame: LocalFrame) -> list[k.Wall]:
    corners = [frame.to_ned(lat, lon, frame.alt_m)[:2] for lat, lon in area.points]
    if area.radius_m is not None:
        kind = k.IN_CIRCLE if area.inclusion else k.OUT_OF_CIRCLE
        return [k.Wall(number, kind, *corners[0], *corners[0], area.radius_m)]
    kind = k.IN_POLYGON if area.inclusion else k.OUT_OF_POLYGON
    corners = [c for c, after in zip(corners, (*corners[1:], corners[0]), strict=True) if c != after]
    edges = zip(corners, (*corners[1:], corners[0]), strict=True)
    return [k.Wall(number, kind, *a, *b, 0.0) for a, b in edges]


def _trouble(area: FenceArea, walls: Floats, points: Floats, margin: float) -> str | None:
    """How the path, shape (K, 2), violates the area, in words; None if it does not."""
    if k.inside(walls, 0, len(walls), k.Point(*points[0].tolist())) != area.inclusion:
        return "begins outside of it" if area.inclusion else "begins in it"
    for number, (a, b) in enumerate(itertools.pairwise(points)):
        room = (
            _from_circle(k.Wall(*walls[0].tolist()), a, b)
            if area.radius_m is not None
            else _from_edges(walls, a, b)
        )
        if room < margin:
            how = "crosses its border" if room <= 0.0 else f"comes within {room:.1f} m of its border"
            return (
                f"{how} between waypoint[{number}] and waypoint[{number + 1}]; at least {margin:.1f} m are "
                "kept (2 m and two standard deviations of the own position)"
            )
    return None


def _from_circle(circle: k.Wall, a: Floats, b: Floats) -> float:
    """Least distance of a leg from a circle, m; 0 if it crosses it."""
    middle, radius = np.array([circle.n, circle.e]), circle.radius_m
    near = float(_from_leg(middle[None], a[None], b[None])[0])
    far = float(max(np.linalg.norm(a - middle), np.linalg.norm(b - middle)))
    return 0.0 if near <= radius <= far else min(abs(near - radius), abs(far - radius))


def _from_edges(walls: Floats, a: Floats, b: Floats) -> float:
    """Least distance of a leg from edges, m; 0 if it crosses one."""
    columns = k.Wall(*walls.T)
    start, end = np.stack([columns.n, columns.e], axis=1), np.stack([columns.end_n, columns.end_e], axis=1)
    one, other = np.broadcast_to(a, start.shape), np.broadcast_to(b, start.shape)
    crosses = (_side(start, end, one) * _side(start, end, other) < 0.0) & (
        _side(one, other, start) * _side(one, other, end) < 0.0
    )
    if crosses.any():
        return 0.0
    rooms = (
        _from_leg(one, start, end),
        _from_leg(other, start, end),
        _from_leg(start, one, other),
        _from_leg(end, one, other),
    )
    return float(np.min(rooms))


def _from_leg(point: Floats, a: Floats, b: Floats) -> Floats:
    """Distances of points from the straight lines between two others, all of shape (F, 2)."""
    along = b - a
    length2 = np.einsum("ij,ij->i", along, along)
    share = np.einsum("ij,ij->i", point - a, along) / np.where(length2 > 0.0, length2, 1.0)
    away: Floats = np.linalg.norm(point - a - np.clip(share, 0.0, 1.0)[:, None] * along, axis=1)
    return away


def _side(a: Floats, b: Floats, c: Floats) -> Floats:
    """Positive if c lies on one side of the line from a to b, negative on the other; arguments of shape (F,
    2)."""
    side: Floats = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    return side
