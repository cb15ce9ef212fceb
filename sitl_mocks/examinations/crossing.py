"""Simulated other aircraft that cross one vehicle's path closely, received by Remote ID twice a second."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from companion.events import RemoteIdHeard
from companion.geometry import LocalFrame, Vec3
from companion.remote_id.messages import BasicId, IdType, Location, Status, UaType

_MEAN_S = 90.0
_LIFE_S = 90.0
_MOST = 3
_PERIOD_S: Final = 0.5
_GEOID_M = 47.0


class _Other(NamedTuple):
    name: str
    since_s: float
    start: tuple[float, float]
    velocity: tuple[float, float]


class Crossing:
    """Other aircraft around one vehicle.

    Args:
        home: local frame of the vehicle.
        height_m: height of the other aircraft above home.
        utc_at_zero_s: UTC when the caller's clock is 0.
    """

    def __init__(
        self, home: LocalFrame, height_m: float, utc_at_zero_s: float, rng: np.random.Generator
    ) -> None:
        self.mean_s = _MEAN_S
        """Mean time between other aircraft that appear by chance. If infinite, none appears."""
        self._home = home
        self._height_m = height_m
        self._utc_at_zero_s = utc_at_zero_s
        self._rng = rng
        self._others: list[_Other] = []
        self._told_s = self._drawn_s = 0.0

    def meet(self, now_s: float, position: Vec3, velocity: Vec3) -> None:
        """Add an aircraft that passes close to the vehicle in 10 to 40 s if both fly straight (m, m/s,
        NED).
        """
        rng = self._rng
        course, ahead_s = float(rng.uniform(0.0, 2.0 * math.pi)), float(rng.uniform(10.0, 40.0))
        speed = float(rng.uniform(1.0, 15.0))
        way = speed * math.cos(course), speed * math.sin(course)
        miss = rng.normal(0.0, 10.0, 2)
        north, east = (position[c] + ahead_s * (velocity[c] - way[c]) + float(miss[c]) for c in (0, 1))
        self._others.append(_Other(f"OTHER{rng.integers(1000)}", now_s, (north, east), way))

    def heard(self, now_s: float, position: Vec3, velocity: Vec3) -> list[RemoteIdHeard]:
        """Remote ID received since the last call. New aircraft may appear."""
        passed_s, self._drawn_s = now_s - self._drawn_s, now_s
        if len(self._others) < _MOST and self._rng.random() < passed_s / self.mean_s:
            self.meet(now_s, position, velocity)
        self._others = [other for other in self._others if now_s - other.since_s < _LIFE_S]
        if now_s - self._told_s < _PERIOD_S - 1e-9:
            return []
        self._told_s = now_s
        return [self._report(other, now_s) for other in self._others]

    def _report(self, other: _Other, now_s: float) -> RemoteIdHeard:
        passed_s = now_s - other.since_s
        north, east = (other.start[c] + passed_s * other.velocity[c] for c in (0, 1))
        lat_deg, lon_deg, _ = self._home.to_geodetic(north, east, 0.0)
        location = Location(
            status=Status.AIRBORNE,
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            alt_geodetic_m=self._home.alt_m + _GEOID_M + self._height_m,
            direction_deg=math.degrees(math.atan2(other.velocity[1], other.velocity[0])) % 360.0,
            speed_mps=math.hypot(*other.velocity),
            vertical_speed_mps=0.0,
            horizontal_accuracy_m=3.0,
            vertical_accuracy_m=3.0,
            speed_accuracy_mps=0.3,
            timestamp_s=math.floor((self._utc_at_zero_s + now_s) * 10.0) / 10.0 % 3600.0,
        )
        identity = BasicId(
            id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id=other.name
        )
        return RemoteIdHeard(transport="wifi", address=other.name, messages=(identity, location))
