"""Walls of a fence: the edges of its polygons and its circles, in the horizontal plane."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from companion.arrays import Floats
from companion.avoidance.kernels.compiled import compiled
from companion.avoidance.kernels.vectors import Point

IN_POLYGON, OUT_OF_POLYGON, IN_CIRCLE, OUT_OF_CIRCLE = 0.0, 1.0, 2.0, 3.0
"""Kinds of areas."""


class Wall(NamedTuple):
    """An edge or a circle; its row in a fence. The walls of an area stand one after the other."""

    area: float
    """Number of its area, increasing with the rows."""
    kind: float
    """Kind of its area."""
    n: float
    """North of one end of the edge, or of the circle's centre, m."""
    e: float
    end_n: float
    """North of the other end of the edge, m."""
    end_e: float
    radius_m: float
    """Radius of the circle."""


NO_WALLS: Floats = np.zeros((0, len(Wall._fields)))
"""A fence without walls."""


@compiled
def wall_at(fence: Floats, row: int) -> Wall:
    """A row of a fence."""
    return Wall(
        fence[row, 0], fence[row, 1], fence[row, 2], fence[row, 3], fence[row, 4], fence[row, 5],
        fence[row, 6],
    )  # fmt: skip


@compiled
def nearest_of_wall(wall: Wall, p: Point) -> tuple[float, Point]:
    """Distance (m) to the nearest point of an edge or a circle, and the unit vector from there to p."""
    if wall.kind >= IN_CIRCLE:
        dn, de = p.n - wall.n, p.e - wall.e
        size = math.sqrt(dn * dn + de * de)
        if size < 1e-9:
            dn, de, size = 1.0, 0.0, 1.0
        room = math.sqrt((p.n - wall.n) ** 2 + (p.e - wall.e) ** 2) - wall.radius_m
        k = 1.0 / size if room >= 0.0 else -1.0 / size
        return abs(room), Point(k * dn, k * de)
    sn, se = wall.end_n - wall.n, wall.end_e - wall.e
    share = min(max(((p.n - wall.n) * sn + (p.e - wall.e) * se) / (sn * sn + se * se), 0.0), 1.0)
    dn, de = p.n - wall.n - share * sn, p.e - wall.e - share * se
    size = math.sqrt(dn * dn + de * de)
    if size < 1e-9:  # on the edge itself the side is not defined
        return 0.0, Point(0.0, 0.0)
    return size, Point(dn / size, de / size)


@compiled
def after_area(fence: Floats, first: int) -> int:
    """The row after the last wall of the area that begins in row `first`."""
    after = first + 1
    while after < len(fence) and wall_at(fence, after).area == wall_at(fence, first).area:
        after += 1
    return after


@compiled
def inside(fence: Floats, first: int, after: int, p: Point) -> bool:
    """Whether a point is inside the polygon or circle of the rows from `first` to before `after`."""
    circle = wall_at(fence, first)
    if circle.kind >= IN_CIRCLE:
        dn, de = p.n - circle.n, p.e - circle.e
        return dn * dn + de * de < circle.radius_m**2
    within = False
    for i in range(first, after):
        wall = wall_at(fence, i)
        if (wall.e > p.e) != (wall.end_e > p.e):
            rise = (p.e - wall.e) / (wall.end_e - wall.e) * (wall.end_n - wall.n)
            if p.n < wall.n + rise:
                within = not within
    return within


@compiled
def crosses(wall: Wall, a: Point, b: Point) -> bool:
    """Whether the straight line from a to b, which begins on the allowed side of a wall, crosses it."""
    if wall.kind == IN_CIRCLE:
        return math.sqrt((b.n - wall.n) ** 2 + (b.e - wall.e) ** 2) > wall.radius_m
    dn, de = b.n - a.n, b.e - a.e
    if wall.kind == OUT_OF_CIRCLE:
        on, oe = wall.n - a.n, wall.e - a.e
        share = min(max((on * dn + oe * de) / max(dn * dn + de * de, 1e-12), 0.0), 1.0)
        return math.sqrt((share * dn - on) ** 2 + (share * de - oe) ** 2) < wall.radius_m
    pn, pe = wall.n - a.n, wall.e - a.e
    qn, qe = wall.end_n - a.n, wall.end_e - a.e
    sn, se = qn - pn, qe - pe
    ends = (dn * pe - de * pn) * (dn * qe - de * qn)
    sides = (sn * pe - se * pn) * (sn * (pe - de) - se * (pn - dn))
    return ends <= 0.0 and sides <= 0.0
