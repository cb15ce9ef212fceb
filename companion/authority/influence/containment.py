"""The volume that the aircraft does not leave while the companion flies it, whatever traffic is received.

It is kept in the same way as a fence, a floor and a ceiling: as an inclusion area with its walls, and as
bounds on the height. Remote ID and ADS-B are unsigned: a transmitter can invent aircraft that push this one.
The volume bounds how far (`allowance` bounds how long).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from companion.arrays import Floats
from companion.authority.course import LEAST_HEIGHT_M, LEAST_LAYER_M, Course
from companion.avoidance import kernels as k
from companion.avoidance.law import Law
from companion.config import AvoidanceConfig, Config, ContainmentConfig
from companion.geometry import Vec3
from companion.laws import kind_of
from companion.ownship import Ownship

_BEYOND_M = 10.0
"""An aircraft that is taken farther outside of a volume than this counts as flown there by its pilot. One
that is less far outside counts as pushed there by traffic, and must not gain a larger volume by that."""
_CORNERS = 12
"""Corners of the area around a single place."""
_MOST_PLACES = 32
"""Most places outside of the mission's volume that are remembered."""
_CREWED_S = 3.0
"""The volume for crewed traffic stays in force for this long after a conflict with such traffic."""
CREWED_REACH = 1.25
"""Distance that crewed traffic may push the aircraft, as a multiple of the separation from crewed traffic. It
leaves room for the whole separation from an aircraft that passes over the mission, and for position
errors."""
_AREA = 1e6
"""Number of the area in the table of walls; no fence has as many areas."""

_Place = tuple[float, float]
"""North and east, m."""


class Containment:
    """The volume of one flight.

    Its area is the convex hull of the mission's or path's places and `side_m` around it. Its heights are
    those of the present leg, `below_m` below and `above_m` above, between floor and ceiling. While crewed
    traffic is in conflict, and until the aircraft is back in that volume, a larger one is in force:
    `crewed_side_m` to the side, `crewed_above_m` above, and down to the floor. The larger one is also in
    force for an aircraft that is more than `_BEYOND_M` outside of the smaller one when it is taken. If the
    aircraft is outside of the larger one too (the mission is not known, or the pilot flew elsewhere), the
    place where it is taken counts as a place of the mission.
    """

    def __init__(self, config: Config, own: Ownship, course: Course) -> None:
        self._own = own
        self._course = course
        self._law: Law | None = None
        """Law of the flight to which the places below belong."""
        self._extra_places: deque[_Place] = deque(maxlen=_MOST_PLACES)
        """Places outside of the mission's volume in which the aircraft was taken."""
        self._extra_heights_m: deque[float] = deque(maxlen=_MOST_PLACES)
        """Heights above home outside of the mission's volume in which the aircraft was taken."""
        self._made_for: tuple[Vec3, ...] | None = None
        """`Course.places` for which the walls were made; None while we do not control the vehicle."""
        self._range_m = 0.0, 0.0
        """Least and greatest height of the mission."""
        self._places: list[_Place] = []
        """Places whose convex hull, widened to all sides, is the area of the volume."""
        self._narrow = self._wide = k.NO_WALLS
        self._crewed_s = -math.inf
        """Time of the last conflict with crewed traffic."""
        self._is_wide = False
        self.configure(config)

    def configure(self, config: Config) -> None:
        """Use another configuration from now on."""
        self._limits = config.limits
        self._config = config.containment
        self._crewed_side_m, self._crewed_above_m = crewed_reach_m(config)
        self._encloses = kind_of(config.avoidance.law).keeps_fence

    def let_go(self) -> None:
        """End the volume, because we no longer control the vehicle."""
        if self._made_for is not None:
            self._made_for, self._is_wide = None, False
            if self._law is not None:
                self._law.enclose(k.NO_WALLS)

    def note_conflict(self, now_s: float, *, crewed: bool) -> None:
        """Take in whether the last decision saw a conflict with crewed traffic."""
        if crewed:
            self._crewed_s = now_s

    def keep(self, now_s: float) -> tuple[float, float]:
        """Let the law keep the volume from now on, and return its floor and ceiling (height above home).

        Call this before every decision while we control the vehicle. Needs a law and an own position.
        """
        law = self._course.law
        assert law is not None
        here, height_m = self._own.position_ned_m(now_s), self._course.own_height_m(self._own)
        if law is not self._law:
            self._law, self._made_for = law, None
            self._extra_places.clear()
            self._extra_heights_m.clear()
        anew = self._made_for is not self._course.places
        if anew:
            self._make(here[:2], height_m)
            self._is_wide = self._is_beyond(now_s, here[:2], height_m, _BEYOND_M)
        wide = self._needs_wide(now_s, here[:2], height_m)
        if self._encloses and (anew or wide != self._is_wide):
            law.enclose(self._wide if wide else self._narrow)
        self._is_wide = wide
        return self._heights_m(now_s, wide)

    def _make(self, here: _Place, height_m: float) -> None:
        """Make the walls and heights of the mission, so that the aircraft is within the larger volume."""
        config, course = self._config, self._course
        self._made_for = course.places
        heights = [*course.heights_m, *self._extra_heights_m]
        if not heights or height_m > max(heights) + self._crewed_above_m + _BEYOND_M:
            self._extra_heights_m.append(height_m)
            heights.append(height_m)
        self._range_m = min(heights), max(heights)
        places = [*(place[:2] for place in course.places), *self._extra_places]
        if not places or not _within(area_around(places, self._crewed_side_m + _BEYOND_M), here):
            self._extra_places.append(here)
            places.append(here)
        self._places = places
        self._narrow = area_around(places, config.side_m)
        self._wide = area_around(places, self._crewed_side_m)

    def _needs_wide(self, now_s: float, here: _Place, height_m: float) -> bool:
        """Whether the larger volume is in force. It lasts until the aircraft is back in the smaller one."""
        if now_s - self._crewed_s < _CREWED_S:
            return True
        if not self._is_wide:
            return False
        return self._is_beyond(now_s, here, height_m, 0.0)

    def _is_beyond(self, now_s: float, here: _Place, height_m: float, by_m: float) -> bool:
        """Whether a place is outside of the smaller volume by more than a distance."""
        floor_m, ceiling_m = self._heights_m(now_s, False)
        if not floor_m - by_m <= height_m <= ceiling_m + by_m:
            return True
        area = self._narrow if by_m == 0.0 else area_around(self._places, self._config.side_m + by_m)
        return not _within(area, here)

    def _heights_m(self, now_s: float, wide: bool) -> tuple[float, float]:
        config, limits, (low, high) = self._config, self._limits, self._range_m
        leg = self._course.leg_heights_m(now_s)
        # The leg may begin where traffic pushed the aircraft. That must not move the volume.
        least, most = (low, high) if leg is None else (min(max(h, low), high) for h in leg)
        floor = self._course.floor_height_m(limits)
        ceiling = self._course.ceiling_height_m(limits)
        top = math.inf if ceiling is None else ceiling
        if wide:
            if limits.floor_height_m is None:
                # A low place, such as a landing, lowers the floor only of its own leg.
                floor = max(floor, min(LEAST_HEIGHT_M, least, top - LEAST_LAYER_M))
            return floor, min(top, max(most + self._crewed_above_m, floor + LEAST_LAYER_M))
        floor = max(floor, min(least - config.below_m, top - LEAST_LAYER_M))
        return floor, min(top, max(most + config.above_m, floor + LEAST_LAYER_M))


def crewed_reach_m(config: Config) -> tuple[float, float]:
    """How far crewed traffic may push the aircraft to the side, and above the present leg (m)."""
    return reach_m(config.containment, config.avoidance)


def reach_m(own: ContainmentConfig, separations: AvoidanceConfig) -> tuple[float, float]:
    """As `crewed_reach_m`, from the two sections that decide it."""
    side_m, above_m = own.crewed_side_m, own.crewed_above_m
    if side_m is None:
        side_m = max(CREWED_REACH * separations.crewed_horizontal_m, own.side_m)
    if above_m is None:
        above_m = max(CREWED_REACH * separations.crewed_vertical_m, own.above_m)
    return side_m, above_m


def extent(places: Sequence[Vec3], config: Config) -> tuple[tuple[float, float], tuple[float, float]]:
    """Bounds of the area around some places (NED, m): (south, north) and (west, east) ends, in metres."""
    corners = area_around([place[:2] for place in places], config.containment.side_m)[:, 2:4]
    (south, west), (north, east) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    return (south, north), (west, east)


def area_around(places: Sequence[_Place], side_m: float) -> Floats:
    """Walls of an inclusion area around all places (north, east, m). No point of the area is farther than
    `side_m` from their convex hull."""
    angles = [2.0 * math.pi * i / _CORNERS for i in range(_CORNERS)]
    corners = _hull(
        [(n + side_m * math.cos(a), e + side_m * math.sin(a)) for n, e in _hull(places) for a in angles]
    )
    edges = zip(corners, (*corners[1:], corners[0]), strict=True)
    return np.array([k.Wall(_AREA, k.IN_POLYGON, *a, *b, 0.0) for a, b in edges])


def _hull(places: Sequence[_Place]) -> list[_Place]:
    """Corners of the convex hull, in order (Andrew's monotone chain)."""
    points = sorted(set(places))
    if len(points) < 3:
        return points
    chains: list[list[_Place]] = []
    for ordered in (points, points[::-1]):
        chain: list[_Place] = []
        for p in ordered:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], p) <= 0.0:
                chain.pop()
            chain.append(p)
        chains.append(chain[:-1])
    return chains[0] + chains[1]


def _turn(a: _Place, b: _Place, c: _Place) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _within(walls: Floats, here: _Place) -> bool:
    return bool(k.inside(walls, 0, len(walls), k.Point(*here)))
