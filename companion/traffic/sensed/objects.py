"""Objects that a sensor sees, tracked over time: places become tracks with a velocity and its error.

Each track has a constant-velocity filter along the line of sight and another one across it, because a sensor
measures distances far better than directions. The error across is that of a sector's width. It does not
average out, because an object that stays in its sector is always reported in the middle of it. Consecutive
measurements are therefore weighted as if they came `CORRELATED_S` apart.

A track counts as standing until its velocity exceeds both three standard deviations and `STANDING_MPS`. So a
pole stands from the first measurement on, and an aircraft moves as soon as its motion is significant.

A few measurements show that an object comes nearer, but it takes seconds to measure where it will pass. Until
then a moving object is assumed to be on a collision course: its bearing stays constant, which means that it
moves across the line of sight as fast as we do (`Followed.seen_from`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from companion.config import SensedConfig
from companion.geometry import Vec3
from companion.traffic.sensed.pose import Pose
from companion.traffic.sensed.seen import Seen, View, bearing_sigma_rad

MOST: Final = 24
"""Largest number of objects that are tracked."""
CONFIRMED: Final = 2
"""Number of measurements after which an object is avoided. A single one may be a bird, rain or noise. An
object that the sensor tracks itself is avoided at once."""
EXPIRE_S, STANDING_EXPIRE_S, UNCONFIRMED_S = 2.0, 3.0, 0.6
"""How long an object is kept after its last measurement if it moves, if it stands, and if it was measured
once."""
FIRST_SIGMA_MPS, FIRST_ACROSS_MPS = 6.0, 3.0
"""Deviation of an unknown velocity along the line of sight and in height, and across it."""
CORRELATED_S: Final = 0.7
MANOEUVRE_MPS2: Final = 1.5
"""Change of velocity in a second, one standard deviation."""
STANDING_MPS: Final = 1.0
MOST_MPS: Final = 120.0
TRACKED_SIGMA_M: Final = 3.0
"""Error of the position of an aircraft that the sensor tracks itself, on each axis, one standard
deviation."""
TRACKED_SIGMA_MPS: Final = 1.0
_GATE: Final = 3.0
_ROOM_M: Final = 1.5
_HIGH_M: Final = 8.0
_FAR_M: Final = 60.0
"""A place farther than this from where an object is expected, along or across the line of sight, is never
that object."""
_HEIGHT_SHARE: Final = 0.05
"""Error of a height as a share of the distance."""
_SIGNIFICANT2, _INSIGNIFICANT2 = 9.0, 4.0
"""Squares of the ratio of a velocity to its error, above which a standing object moves, and below which a
moving one stands."""
_PASSED: Final = 5
"""An object that stands is removed after this many consecutive scans that see past it. Thin objects are
sometimes missed."""


class _Axis(NamedTuple):
    """Covariance of place and velocity along one direction."""

    pp: float
    pv: float
    vv: float

    def later(self, passed_s: float) -> _Axis:
        a = MANOEUVRE_MPS2 * MANOEUVRE_MPS2 * passed_s
        t = passed_s
        return _Axis(
            self.pp + 2.0 * t * self.pv + t * t * self.vv + a * t * t / 3.0,
            self.pv + t * self.vv + 0.5 * a * t,
            self.vv + a,
        )

    def measured(self, noise2: float) -> tuple[_Axis, float, float]:
        """After a measurement of the place; and how much of the difference changes place and velocity."""
        s = self.pp + noise2
        kp, kv = self.pp / s, self.pv / s
        return _Axis((1.0 - kp) * self.pp, (1.0 - kp) * self.pv, self.vv - kv * self.pv), kp, kv


@dataclass(slots=True)
class Followed:
    """One object."""

    name: str
    key: tuple[int, int] | None
    """Component and number, if the sensor follows it itself."""
    at_s: float
    position: Vec3
    velocity: Vec3
    along: _Axis
    across: _Axis
    high: _Axis
    across_m: float
    """Half the width within which it lies."""
    distance_m: float
    """Distance from us at its last measurement."""
    flat: bool
    tall: bool
    vertical_known: bool
    tracked: bool
    """Whether the sensor reports its velocity."""
    met_mps: Vec3
    """Own velocity when it was first seen."""
    component: int
    """Component that measured it last. Only scans of that component show that it is gone, because another
    sensor may look over it or through it."""
    measured: int = 1
    moves: bool = False
    passed: int = 0
    """Number of consecutive scans of its component that saw past it since its last measurement."""

    @property
    def confirmed(self) -> bool:
        """Whether it is avoided."""
        return self.measured >= CONFIRMED

    @property
    def kept_s(self) -> float:
        """How long after its last measurement it is kept."""
        if not self.confirmed:
            return UNCONFIRMED_S
        return EXPIRE_S if self.moves else STANDING_EXPIRE_S

    @property
    def sigma_mps(self) -> float:
        """Error of its velocity, one standard deviation on the worse axis."""
        return math.sqrt(max(self.along.vv, self.across.vv))

    def seen_from(self, here: Vec3) -> Vec3:
        """Velocity to assume (NED, m/s): zero if it stands; on a collision course as far as its motion across
        the line of sight is not known.

        Args:
            here: own position (NED, m).
        """
        if not self.moves:
            return 0.0, 0.0, 0.0
        vn, ve, vd = self.velocity
        if not self.tracked:
            un, ue = _sight(here, self.position)
            unknown = min(1.0, self.across.vv / FIRST_ACROSS_MPS**2)
            across = unknown * (un * self.met_mps[1] - ue * self.met_mps[0])
            vn, ve = vn - across * ue, ve + across * un
        sinks = not self.flat and (self.tracked or vd * vd > _INSIGNIFICANT2 * self.high.vv)
        return vn, ve, vd if sinks else 0.0

    def at(self, at_s: float) -> Vec3:
        """Its place at a time, if it keeps its velocity; it stands unless it is known to move."""
        (n, e, d), (vn, ve, vd), t = self.position, self.velocity, at_s - self.at_s
        return n + t * vn, e + t * ve, d + t * vd


class _Expected:
    """Where an object is expected at the time of a measurement, and the variances of that."""

    __slots__ = ("across", "along", "d", "e", "high", "n", "one", "passed_s", "sight")

    def __init__(self, one: Followed, pose: Pose) -> None:
        self.one = one
        self.passed_s = pose.at_s - one.at_s
        self.n, self.e, self.d = one.at(pose.at_s)
        self.sight = _sight(pose.position, (self.n, self.e, self.d))
        self.along = one.along.later(self.passed_s).pp
        self.across = one.across.later(self.passed_s).pp
        self.high = one.high.later(self.passed_s).pp


@dataclass(slots=True)
class Objects:
    """At most `MOST` objects."""

    config: SensedConfig
    held: list[Followed] = field(default_factory=list)
    refused: int = 0
    """Objects for which there was no room."""
    _last: int = 0

    def clear(self) -> None:
        """Forget all of them."""
        self.held.clear()

    def expire(self, now_s: float) -> None:
        """Remove those that were not seen for too long."""
        self.held = [one for one in self.held if 0.0 <= now_s - one.at_s <= one.kept_s]

    def see(self, component: int, places: Sequence[Seen], pose: Pose, view: View | None) -> None:
        """Take in what one component saw at a time.

        Args:
            view: whether the scan sees past a known object that it did not report; None if that is not known.
        """
        if len(places) > MOST:
            places = sorted(places, key=lambda place: math.dist(place.position, pose.position))[:MOST]
        free = [one for one in self.held if one.at_s <= pose.at_s]
        expected = [_Expected(one, pose) for one in free]
        keys = [None if place.number is None else (component, place.number) for place in places]
        near = []
        for number, place in enumerate(places):
            for where in expected:
                off = self._off(where, place, keys[number], pose)
                if off is not None:
                    near.append((off, number, where.one))
        near.sort(key=lambda entry: (entry[0], entry[1]))
        used: set[int] = set()
        fed: set[str] = set()
        for _, number, one in near:
            if number not in used and one.name not in fed:
                used.add(number)
                fed.add(one.name)
                self._update(component, one, places[number], pose)
        if view is not None:
            # A moving object is soon forgotten anyway, and its present place is only a prediction.
            for one in free:
                if one.name in fed or one.component != component or one.key is not None or one.moves:
                    continue
                one.passed = one.passed + 1 if view.passes(one.position, flat=one.flat) else 0
            self.held = [one for one in self.held if one.passed < _PASSED]
        for number, place in enumerate(places):
            if number not in used:
                self._open(component, place, pose)

    # ------------------------------------------------------------ one measurement

    def _noise(self, place: Seen, pose: Pose, passed_s: float) -> tuple[float, float, float]:
        """Variances of a measurement along the line of sight, across it, and in height."""
        away = math.dist(place.position, pose.position)
        lasting = max(1.0, CORRELATED_S / max(passed_s, 0.02))
        if place.velocity is not None:
            return TRACKED_SIGMA_M**2, TRACKED_SIGMA_M**2, TRACKED_SIGMA_M**2
        aim = away * bearing_sigma_rad(pose, self.config)
        across = (place.across_m**2 / 3.0 + 0.1 * aim * aim) * lasting
        high = max(1.0, _HEIGHT_SHARE * away)
        return self.config.range_sigma_m**2, max(across, 0.01), high * high

    def _off(self, where: _Expected, place: Seen, key: tuple[int, int] | None, pose: Pose) -> float | None:
        """Distance of a place from where an object is expected, in standard deviations; None if it cannot be
        it."""
        one = where.one
        if key is not None and one.key is not None and key != one.key:
            return None
        off_n, off_e = place.position[0] - where.n, place.position[1] - where.e
        un, ue = where.sight
        along, across = un * off_n + ue * off_e, un * off_e - ue * off_n
        if abs(along) > _FAR_M or abs(across) > _FAR_M:
            return None
        noise = self._noise(place, pose, where.passed_s)
        s_along = math.sqrt(where.along + noise[0])
        s_across = math.sqrt(where.across + noise[1])
        if abs(along) > _GATE * s_along + _ROOM_M or abs(across) > _GATE * s_across + _ROOM_M:
            return None
        upright = place.flat or one.flat or one.tall or place.tall
        if place.vertical_known and one.vertical_known and not upright:
            high = math.sqrt(where.high + noise[2])
            if abs(place.position[2] - where.d) > _GATE * high + _HIGH_M:
                return None
        same = key is not None and key == one.key
        return -1.0 if same else math.hypot(along / s_along, across / s_across)

    def _update(self, component: int, one: Followed, place: Seen, pose: Pose) -> None:
        passed_s = pose.at_s - one.at_s
        noise = self._noise(place, pose, passed_s)
        n, e, d = one.at(pose.at_s)
        un, ue = _sight(pose.position, (n, e, d))
        off_n, off_e, off_d = place.position[0] - n, place.position[1] - e, place.position[2] - d
        one.along, kp, kv = one.along.later(passed_s).measured(noise[0])
        one.across, cp, cv = one.across.later(passed_s).measured(noise[1])
        one.high, hp, hv = one.high.later(passed_s).measured(noise[2])
        along, across = un * off_n + ue * off_e, un * off_e - ue * off_n
        vn, ve, vd = one.velocity
        one.position = (
            n + kp * along * un - cp * across * ue,
            e + kp * along * ue + cp * across * un,
            d + hp * off_d,
        )
        one.velocity = _bounded(
            (
                vn + kv * along * un - cv * across * ue,
                ve + kv * along * ue + cv * across * un,
                vd + hv * off_d,
            )
        )
        one.at_s, one.measured, one.passed = pose.at_s, one.measured + 1, 0
        one.component, one.across_m = component, place.across_m
        one.distance_m = math.dist(place.position, pose.position)
        one.flat, one.tall = place.flat, place.tall or one.tall
        one.vertical_known = place.vertical_known
        if place.velocity is not None:
            one.position, one.velocity = place.position, _bounded(place.velocity)
            one.tracked = True
        self._judge(one, un, ue)

    def _judge(self, one: Followed, un: float, ue: float) -> None:
        """Decide whether it moves."""
        if one.tracked:
            one.moves = math.hypot(*one.velocity) > STANDING_MPS
            return
        vn, ve, vd = one.velocity
        along, across = un * vn + ue * ve, un * ve - ue * vn
        ratio2 = along * along / one.along.vv + across * across / one.across.vv
        fast = math.hypot(vn, ve) > STANDING_MPS
        if not one.flat:
            ratio2 = max(ratio2, vd * vd / one.high.vv)
            fast = fast or abs(vd) > STANDING_MPS
        one.moves = fast and ratio2 > (_INSIGNIFICANT2 if one.moves else _SIGNIFICANT2)

    def _open(self, component: int, place: Seen, pose: Pose) -> None:
        if len(self.held) >= MOST:
            self.refused += 1
            last = max(self.held, key=lambda one: (not one.confirmed, one.distance_m))
            if last.confirmed and last.distance_m <= math.dist(place.position, pose.position):
                return
            self.held.remove(last)
        self._last += 1
        noise = self._noise(place, pose, 1.0)
        tracked = place.velocity is not None
        sigmas = (FIRST_SIGMA_MPS, FIRST_ACROSS_MPS, FIRST_SIGMA_MPS)
        if tracked:
            sigmas = (TRACKED_SIGMA_MPS,) * 3
        axes = [_Axis(pp, 0.0, sigma * sigma) for pp, sigma in zip(noise, sigmas, strict=True)]
        one = Followed(
            name=str(self._last),
            key=None if place.number is None else (component, place.number),
            at_s=pose.at_s,
            position=place.position,
            velocity=_bounded(place.velocity or (0.0, 0.0, 0.0)),
            along=axes[0],
            across=axes[1],
            high=axes[2],
            across_m=place.across_m,
            distance_m=math.dist(place.position, pose.position),
            flat=place.flat,
            tall=place.tall,
            vertical_known=place.vertical_known,
            tracked=tracked,
            met_mps=pose.velocity,
            component=component,
            measured=CONFIRMED if place.number is not None else 1,
        )
        one.moves = tracked and math.hypot(*one.velocity) > STANDING_MPS
        self.held.append(one)


def _sight(here: Vec3, there: Vec3) -> tuple[float, float]:
    """Horizontal direction from one place to another one; north if they lie above each other."""
    north, east = there[0] - here[0], there[1] - here[1]
    size = math.hypot(north, east)
    return (north / size, east / size) if size > 1e-6 else (1.0, 0.0)


def _bounded(velocity: Vec3) -> Vec3:
    size = math.hypot(*velocity)
    if size <= MOST_MPS:
        return velocity
    n, e, d = (v * MOST_MPS / size for v in velocity)
    return n, e, d
