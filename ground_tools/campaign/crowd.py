"""One step of a crowd: each aircraft's neighbours from a grid, its half-spaces and its new velocity.

This is plain ORCA for thousands of aircraft that know each other's state exactly. Half-spaces and linear
programs are the companion's (`companion.avoidance.kernels`); messages, margins and paths are left to
`flight`. A step reads one common state and writes one velocity for each aircraft, so the order of the
aircraft does not matter.

The grid is a torus of cubes that are slightly wider than the reach. A cube's index is taken modulo the size
of the torus, so that any layout fits into the same arrays. Aircraft that are far apart and share a cube are
distinguished by their distance.
"""

from __future__ import annotations

import math

import numpy as np

from companion.arrays import Floats, Integers
from companion.avoidance import kernels as k
from ground_tools.campaign.compiled import compiled

_compiled = compiled()

FARTHEST = 1e6
"""Largest accepted coordinate, in multiples of the reach."""
# Entries of `limits`.
C_RADIUS, C_SPEED, C_HORIZON, C_OVERLAP, C_REACH = range(5)
_WIDER = 1.0 + 1e-6
"""Ratio of cube width to reach. Above 1, so that rounding at a cube's border loses no neighbour, up to the
farthest coordinate."""


@_compiled
def _cube(x: float, width: float, side: int) -> int:
    """Index, along one axis, of the cube that contains a coordinate."""
    return math.floor(x / width) % side


@_compiled
def _urgency(p: k.Vector, v: k.Vector, radius: float, tau: float) -> float:
    """Key by which neighbours are ranked, lowest first; computed without a branch.

    Overlapping neighbours come first, by depth (at most 0). Next come those whose volume would be entered
    within tau at the current velocities, by the time until then, and then all others, by distance. Ranking by
    distance alone would drop a fast, distant neighbour.
    """
    p2 = k.dot(p, p)
    gap2 = p2 - radius * radius
    closing = k.dot(p, v)
    root2 = closing * closing - k.dot(v, v) * gap2
    t = gap2 / (closing + math.sqrt(max(root2, 0.0)))
    meets = (closing > 0.0) & (root2 >= 0.0) & (t <= tau)
    later = t if meets else tau + p2
    return gap2 if gap2 <= 0.0 else later


@_compiled
def _first(place: Floats, key: Floats, near: Integers, slot: int, urgency: float, j: int) -> bool:
    """Whether row j ranks before the row in a slot. Equally urgent rows are ordered by position and velocity,
    never by their number."""
    if urgency != key[slot]:
        return bool(urgency < key[slot])
    for c in range(6):
        if place[j, c] != place[near[slot], c]:
            return bool(place[j, c] < place[near[slot], c])
    return False


@_compiled
def _within(row: int, begin: int, end: int, place: Floats, reach2: float, near: Integers, count: int) -> int:
    """Append those of the rows from `begin` to `end` that are within reach of `row`, which may include `row`
    itself, to the first `count` entries of `near`. Returns the new count."""
    x, y, z = place[row, 0], place[row, 1], place[row, 2]
    for j in range(begin, end):
        px, py, pz = place[j, 0] - x, place[j, 1] - y, place[j, 2] - z
        near[count] = j
        count += int(px * px + py * py + pz * pz <= reach2)
    return count


@_compiled
def _between(place: Floats, row: int, j: int) -> tuple[k.Vector, k.Vector]:
    """Position of row j minus that of `row`, and velocity of `row` minus that of row j."""
    p = k.Vector(place[j, 0] - place[row, 0], place[j, 1] - place[row, 1], place[j, 2] - place[row, 2])
    v = k.Vector(place[row, 3] - place[j, 3], place[row, 4] - place[j, 4], place[row, 5] - place[j, 5])
    return p, v


@_compiled
def _neighbours(
    row: int,
    start: Integers,
    place: Floats,
    limits: Floats,
    side: int,
    most: int,
    key: Floats,
    near: Integers,
) -> int:
    """Write the most urgent rows within reach of `row` to `near`, most urgent first. Returns their number."""
    reach2, width = limits[C_REACH] * limits[C_REACH], limits[C_REACH] * _WIDER
    x, y, z = place[row, 0], place[row, 1], place[row, 2]
    cx, cy, cz = _cube(x, width, side), _cube(y, width, side), _cube(z, width, side)
    count = 0
    for ax in range(cx - 1, cx + 2):
        bx = ax + side if ax < 0 else (ax - side if ax >= side else ax)
        for ay in range(cy - 1, cy + 2):
            by = ay + side if ay < 0 else (ay - side if ay >= side else ay)
            # Cubes that are neighbours along z are adjacent in memory, except where the torus closes.
            base = (bx * side + by) * side
            low, high = start[base + max(cz - 1, 0)], start[base + min(cz + 2, side)]
            count = _within(row, low, high, place, reach2, near, count)
            if cz == 0:
                count = _within(row, start[base + side - 1], start[base + side], place, reach2, near, count)
            elif cz == side - 1:
                count = _within(row, start[base], start[base + 1], place, reach2, near, count)
    for m in range(count):
        p, v = _between(place, row, near[m])
        key[m] = _urgency(p, v, limits[C_RADIUS], limits[C_HORIZON])
    found = 0
    for m in range(count):
        urgency, j = key[m], near[m]
        slot = found
        if j == row or (found == most and not _first(place, key, near, found - 1, urgency, j)):
            continue
        if found < most:
            found += 1
        else:
            slot -= 1
        while slot > 0 and _first(place, key, near, slot - 1, urgency, j):
            key[slot], near[slot] = key[slot - 1], near[slot - 1]
            slot -= 1
        key[slot], near[slot] = urgency, j
    return found


@_compiled
def _sort(
    position: Floats, velocity: Floats, width: float, side: int, cell: Integers, start: Integers,
    place: Floats, who: Integers,
) -> None:  # fmt: skip
    """Counting sort of the aircraft into the cubes of the torus.

    Cube c gets rows start[c] to start[c + 1] of `place` (position and velocity) and of `who` (index of the
    aircraft).
    """
    start[:] = 0
    for i in range(len(position)):
        index = 0
        for c in range(3):
            index = index * side + _cube(position[i, c], width, side)
        cell[i] = index
        start[index + 2] += 1
    for index in range(2, len(start)):
        start[index] += start[index - 1]
    for i in range(len(position)):
        row = start[cell[i] + 1]  # advances to the end of the cube
        start[cell[i] + 1] += 1
        who[row] = i
        for c in range(3):
            place[row, c], place[row, 3 + c] = position[i, c], velocity[i, c]


@_compiled
def _step(
    position: Floats, velocity: Floats, wish: Floats, limits: Floats, side: int, cell: Integers,
    start: Integers, place: Floats, who: Integers, key: Floats, near: Integers, planes: Floats,
    scratch: Floats, new: Floats,
) -> int:  # fmt: skip
    """Compute the new velocities of all aircraft.

    Returns:
        -1, or the number of an aircraft whose state is invalid; then nothing is written.
    """
    farthest = FARTHEST * limits[C_REACH]
    for i in range(len(position)):
        for c in range(3):
            if not (abs(position[i, c]) <= farthest and math.isfinite(velocity[i, c] + wish[i, c])):
                return i
    _sort(position, velocity, limits[C_REACH] * _WIDER, side, cell, start, place, who)
    for row in range(len(position)):
        found = _neighbours(row, start, place, limits, side, len(planes), key, near)
        own = k.Vector(place[row, 3], place[row, 4], place[row, 5])
        for slot in range(found):
            p, v = _between(place, row, near[slot])
            n, s = k.half_space(p, v, limits[C_RADIUS], limits[C_HORIZON], limits[C_OVERLAP])
            k.put_plane(planes, slot, n, k.dot(n, own) + 0.5 * s)
        one = who[row]
        wanted = k.Vector(wish[one, 0], wish[one, 1], wish[one, 2])
        _, solved = k.solve(planes, 0, found, limits[C_SPEED], 0.0, wanted, scratch)
        new[one, 0], new[one, 1], new[one, 2] = solved.n, solved.e, solved.d
    return -1


class Crowd:
    """Computes the steps of a crowd in preallocated arrays; a step allocates none."""

    def __init__(
        self,
        aircraft: int,
        *,
        radius_m: float,
        speed_mps: float,
        horizon_s: float,
        overlap_s: float,
        reach_m: float,
        neighbours: int,
    ) -> None:
        """
        Args:
            aircraft: number of aircraft.
            radius_m: combined radius R of two aircraft.
            speed_mps: greatest speed.
            horizon_s: time horizon tau.
            overlap_s: time in which overlapping aircraft are to separate.
            reach_m: radius of the search for neighbours. With R + tau times the greatest relative speed, no
                neighbour on a collision course within tau is missed.
            neighbours: largest number of neighbours that are considered. The most urgent ones are taken:
                those that overlap, by depth; those that meet within tau at the current velocities, by the
                time until then; the others, by distance.

        Raises:
            ValueError: a number is not above 0.
        """
        named = {
            "aircraft": aircraft, "radius_m": radius_m, "speed_mps": speed_mps, "horizon_s": horizon_s,
            "overlap_s": overlap_s, "reach_m": reach_m, "neighbours": neighbours,
        }  # fmt: skip
        for name, value in named.items():
            if not 0 < value < math.inf:
                raise ValueError(f"{name} is {value}; allowed: finite and more than 0")
        self._limits = np.array([radius_m, speed_mps, horizon_s, overlap_s, reach_m], dtype=float)
        self._side = max(3, round(aircraft ** (1 / 3)))
        self._cell, self._who = np.zeros(aircraft, np.int64), np.zeros(aircraft, np.int64)
        self._start = np.zeros(self._side**3 + 2, np.int64)
        self._place = np.zeros((aircraft, 6))
        self._key, self._near = np.zeros(aircraft + 1), np.zeros(aircraft + 1, np.int64)
        self._planes, self._scratch = np.zeros((neighbours, 4)), np.zeros((neighbours, 4))

    def step(self, position: Floats, velocity: Floats, wish: Floats, new: Floats) -> None:
        """Compute the ORCA velocity of every aircraft, all from the same state.

        Args:
            position: shape (aircraft, 3), m, coordinates up to FARTHEST times the reach.
            velocity: shape (aircraft, 3), m/s.
            wish: shape (aircraft, 3), the preferred velocities without other aircraft, m/s.
            new: shape (aircraft, 3), m/s; written.

        Raises:
            ValueError: a shape is wrong, a number is not finite, or a position is too far away.
        """
        for name, array in (("position", position), ("velocity", velocity), ("wish", wish), ("new", new)):
            if array.shape != (len(self._who), 3):
                raise ValueError(f"{name} has shape {array.shape}; allowed: ({len(self._who)}, 3)")
        bad = _step(
            position, velocity, wish, self._limits, self._side, self._cell, self._start, self._place,
            self._who, self._key, self._near, self._planes, self._scratch, new,
        )  # fmt: skip
        if bad >= 0:
            most = FARTHEST * self._limits[C_REACH]
            raise ValueError(
                f"aircraft {bad}: position {position[bad]}, velocity {velocity[bad]}, wish {wish[bad]}; "
                f"allowed: finite numbers, and coordinates up to {most:g} m"
            )
