"""Vectors, planes and tables of them.

Tables are arrays that the caller owns, because a compiled loop cannot keep named tuples of unknown number.
The columns of a table are the fields of a named tuple, in order; a function `..._at` reads a row. In Python,
`Wall(*row)` names the entries of a row of walls, and `Wall(*table.T)` its columns.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.arrays import Floats
from companion.avoidance.kernels.compiled import compiled

Triple = tuple[float, float, float]


class Vector(NamedTuple):
    """North, east and down components."""

    n: float
    e: float
    d: float


class Point(NamedTuple):
    """A place or a direction in the horizontal plane."""

    n: float
    e: float


class Plane(NamedTuple):
    """A half-space of velocities: normal . v >= least. Its row in a table has 4 columns."""

    normal: Vector
    """Unit vector."""
    least: float
    """m/s."""


PLANE_COLUMNS = 4


@compiled
def dot(a: Vector, b: Vector) -> float:
    """a . b."""
    return a.n * b.n + a.e * b.e + a.d * b.d


@compiled
def length(a: Vector) -> float:
    """|a|."""
    return math.sqrt(a.n * a.n + a.e * a.e + a.d * a.d)


@compiled
def cross(a: Vector, b: Vector) -> Vector:
    """a x b."""
    return Vector(a.e * b.d - a.d * b.e, a.d * b.n - a.n * b.d, a.n * b.e - a.e * b.n)


@compiled
def minus(a: Vector, b: Vector) -> Vector:
    """a - b."""
    return Vector(a.n - b.n, a.e - b.e, a.d - b.d)


@compiled
def along(a: Vector, k: float, b: Vector) -> Vector:
    """a + k b."""
    return Vector(a.n + k * b.n, a.e + k * b.e, a.d + k * b.d)


@compiled
def times(k: float, a: Vector) -> Vector:
    """k a."""
    return Vector(k * a.n, k * a.e, k * a.d)


@compiled
def clipped(a: Vector, most: float) -> Vector:
    """The vector, shortened to the length `most` if it is longer."""
    size = length(a)
    if size <= most:
        return a
    return times(most / size, a)


@compiled
def plane_at(planes: Floats, row: int) -> Plane:
    """A row of a table of planes."""
    return Plane(Vector(planes[row, 0], planes[row, 1], planes[row, 2]), planes[row, 3])


@compiled
def put_plane(planes: Floats, row: int, normal: Vector, least: float) -> None:
    """Write a row of a table of planes."""
    planes[row, 0], planes[row, 1], planes[row, 2], planes[row, 3] = normal.n, normal.e, normal.d, least


@compiled
def copy_plane(planes: Floats, row: int, to: Floats, to_row: int) -> None:
    """Copy a row of a table of planes into another table, or within it."""
    for column in range(PLANE_COLUMNS):
        to[to_row, column] = planes[row, column]


@compiled
def closest(p: Vector, v: Vector, window_s: float) -> tuple[float, float]:
    """Time (s, in [0, window_s]) and square (m^2) of the least distance, for the relative position p - v
    t."""
    t = 0.0
    v2 = dot(v, v)
    if v2 > 0.0:
        t = min(max(dot(p, v) / v2, 0.0), window_s)
    away = along(p, -t, v)
    return t, dot(away, away)
