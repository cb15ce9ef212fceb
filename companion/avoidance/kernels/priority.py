"""The order in which the planes of a decision count: limits and fence, aircraft, and aircraft that yield.

A track yields if it may be forged to press on us (`companion.authority.influence`). If its plane counted as
much as the others, a ghost that stays inside its volume could push us into another aircraft, because the
violation is divided between planes that cannot all be kept.
"""

from __future__ import annotations

from typing import NamedTuple

from companion.arrays import Floats
from companion.avoidance.kernels.compiled import compiled
from companion.avoidance.kernels.neighbours import NEVER_MPS, other_at
from companion.avoidance.kernels.programs import solve
from companion.avoidance.kernels.vectors import Vector, dot, plane_at, put_plane

SLACK_MPS = 0.02
"""Slack for `programs.solve` in a decision that cannot satisfy every plane."""


class Asked(NamedTuple):
    """The planes of a decision, in the order in which they count."""

    planes: Floats
    hard: int
    """Number of hard planes, which come first."""
    last: int
    """Row of the first plane that is kept only as far as all planes before it allow."""
    rows: int
    """Number of all planes."""
    scratch: Floats
    """Working memory, as large as `planes`."""


@compiled
def put_last(neighbours: Floats, count: int, planes: Floats, first: int, last: int, asked: Floats) -> int:
    """Move the planes of neighbours that yield behind all others. Returns the first row of the moved ones.

    Args:
        neighbours, count: table of neighbours, and how many of its rows count.
        planes: their planes are in the rows `first` to `last`; written.
        asked: as `neighbour_planes` has written it.
    """
    yielding = 0
    for j in range(count):
        yielding += 1 if other_at(neighbours, j).yields != 0.0 else 0
    if yielding == 0:
        return last
    at, split = first, last
    for turn in range(2):
        for j in range(count):
            if (other_at(neighbours, j).yields != 0.0) == (turn == 1):
                for which in range(2):
                    plane = plane_at(asked[j], which)
                    if dot(plane.normal, plane.normal) > 0.0:
                        put_plane(planes, at, plane.normal, plane.least)
                        at += 1
        if turn == 0:
            split = at
    while at < last:  # crewed traffic has no planes
        put_plane(planes, at, Vector(0.0, 0.0, 1.0), -NEVER_MPS)
        at += 1
    return split


@compiled
def solve_in_order(asked: Asked, speed: float, wish: Vector) -> tuple[bool, Vector]:
    """Find the velocity as `solve` does; the last planes count only where all others leave a choice.

    If not even the others can all be kept, the last planes may use any velocity that violates none of the
    others by more than the largest violation without the last planes.

    Args:
        asked: the planes; those after the hard ones are reordered, the last ones among themselves.
        speed: greatest speed, m/s.
        wish: m/s.

    Returns:
        Whether every plane is satisfied, and the velocity.
    """
    planes, hard, last, scratch = asked.planes, asked.hard, asked.last, asked.scratch
    feasible, v = solve(planes, hard, last, speed, SLACK_MPS, wish, scratch)
    if last == asked.rows:
        return feasible, v
    more = 0.0
    if not feasible:
        for row in range(hard, last):
            plane = plane_at(planes, row)
            more = max(more, plane.least - dot(plane.normal, v))
        for row in range(hard, last):
            planes[row, 3] -= more
    kept, v = solve(planes, last, asked.rows, speed, SLACK_MPS, wish, scratch)
    if not feasible:
        for row in range(hard, last):
            planes[row, 3] += more
    return feasible and kept, v
