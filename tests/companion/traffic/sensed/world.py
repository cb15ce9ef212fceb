"""A vehicle with a sensor in a world of poles, walls and aircraft, for the tests of what is sensed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from companion.avoidance.law import Neighbour
from companion.config import SensedConfig
from companion.events import (
    AdsbVehicle,
    Attitude,
    Event,
    Firmware,
    FlightMode,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    ObstaclePoint,
    ObstacleScan,
    SensedAircraft,
    VehicleTime,
)
from companion.events.sensed import NOTHING
from companion.geometry import Vec3
from companion.ownship import Ownship
from companion.traffic.sensed import SensedTraffic
from tests.support.place import HOME

STEP_S, BOOT_S, HEIGHT_M = 0.05, 100.0, 50.0
Round = tuple[float, float, float]
"""North, east and radius of something round that stands upright, or of the whole of its height."""


@dataclass
class World:
    """Steps of 0.05 s; a scan every other step. Positions are NED from home's place, 50 m above it."""

    config: SensedConfig = field(
        default_factory=lambda: SensedConfig(use=True, latency_s=0.0, range_sigma_m=0.2)
    )
    position: Vec3 = (0.0, 0.0, 0.0)
    velocity: Vec3 = (0.0, 0.0, 0.0)
    yaw_rad: float = 0.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    things: Callable[[float], list[Round]] = lambda _: []
    walls: list[tuple[Vec3, Vec3]] = field(default_factory=list)
    """Ends of upright walls."""
    range_m: float = 40.0
    step_deg: float = 5.0
    noise_m: float = 0.1
    now_s: float = 10.0
    seed: int = 1
    accuracy_m: float = 1.0
    """Of the own position."""

    def __post_init__(self) -> None:
        self.sensed = SensedTraffic(self.config, 1.0)
        self.own = Ownship()
        self._rng = np.random.default_rng(self.seed)
        self._tick = 0

    def telemetry(self) -> None:
        boot_s = BOOT_S + self.now_s
        lat, lon, alt = HOME.to_geodetic(self.position[0], self.position[1], self.position[2])
        events: list[Event] = [
            Heartbeat(
                system_id=1, firmware=Firmware.PX4, vehicle_type=2, custom_mode=0, mode=FlightMode.HOLD,
                armed=True
            ),
            GnssFix(
                fix_type=3, lat_deg=lat, lon_deg=lon, alt_msl_m=alt, alt_ellipsoid_m=alt + 47.0,
                horizontal_accuracy_m=self.accuracy_m,
            ),
            VehicleTime(time_boot_s=boot_s, utc_s=1.75e9 + self.now_s),
            GlobalPosition(
                time_boot_s=boot_s, lat_deg=lat, lon_deg=lon, alt_msl_m=alt,
                height_above_home_m=HEIGHT_M - self.position[2], velocity_ned_mps=self.velocity,
            ),
        ]  # fmt: skip
        for event in events:
            self.own.observe(event, self.now_s)

    def attitude(self) -> Attitude:
        return Attitude(
            time_boot_s=BOOT_S + self.now_s,
            roll_rad=self.roll_rad,
            pitch_rad=self.pitch_rad,
            yaw_rad=self.yaw_rad,
        )

    def scan(self, axes: Literal["body", "nose", "north"] = "body", component: int = 196) -> ObstacleScan:
        count = round(360.0 / self.step_deg)
        distances = [self._sees(i, count) for i in range(count)]
        return ObstacleScan(
            component=component, axes=axes, first_deg=0.0, step_deg=self.step_deg,
            distances_cm=tuple(distances), max_cm=round(100 * self.range_m),
        )  # fmt: skip

    def _sees(self, number: int, count: int) -> int:
        """The nearest thing in a sector, of five rays."""
        nearest = math.inf
        width = math.tau / count
        for part in np.linspace(-0.49, 0.49, 15):
            angle = self.yaw_rad + (number + part) * width
            nearest = min(nearest, self._ray(math.cos(angle), math.sin(angle)))
        nearest += self.noise_m * float(self._rng.standard_normal())
        return round(100 * nearest) if nearest < self.range_m else NOTHING

    def _ray(self, un: float, ue: float) -> float:
        found = math.inf
        n0, e0, _ = self.position
        for n, e, radius in self.things(self.now_s):
            along = (n - n0) * un + (e - e0) * ue
            aside = (e - e0) * un - (n - n0) * ue
            if along > 0.0 and abs(aside) <= radius:
                found = min(found, along - math.sqrt(radius * radius - aside * aside))
        for (an, ae, _), (bn, be, _) in self.walls:
            dn, de = bn - an, be - ae
            cross = un * de - ue * dn
            if abs(cross) > 1e-9:
                t = ((an - n0) * de - (ae - e0) * dn) / cross
                s = ((an - n0) * ue - (ae - e0) * un) / cross
                if t > 0.0 and 0.0 <= s <= 1.0:
                    found = min(found, t)
        return found

    def step(self, *extra: Event, scans: bool = True, attitude: bool = True, telemetry: bool = True) -> None:
        self.now_s = round(self.now_s + STEP_S, 6)
        n, e, d = self.position
        self.position = (
            n + STEP_S * self.velocity[0], e + STEP_S * self.velocity[1], d + STEP_S * self.velocity[2]
        )  # fmt: skip
        if telemetry:
            self.telemetry()
        events: list[Event] = [self.attitude()] if attitude else []
        if scans and self._tick % 2 == 0:
            events.append(self.scan())
        self._tick += 1
        self.sensed.hear([*events, *extra], self.now_s, self.own, sent_s=self.now_s)
        self.sensed.expire(self.now_s)

    def run(self, seconds: float, **how: bool) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.step(**how)

    def seen(self) -> list[Neighbour]:
        return self.sensed.look(self.now_s, self.own)

    def fused(self, *heard: Neighbour) -> list[Neighbour]:
        return self.sensed.joined(self.now_s, self.own, heard)


def place(other: Neighbour) -> Vec3:
    """Where a neighbour is now."""
    (n, e, d), (vn, ve, vd), age = other.position_ned_m, other.velocity_ned_mps, other.age_s
    return n + age * vn, e + age * ve, d + age * vd


def one(world: World) -> Neighbour:
    """The only thing that is seen."""
    seen = world.seen()
    assert len(seen) == 1, [(o.track_id, place(o)) for o in seen]
    return seen[0]


def off(other: Neighbour, north: float, east: float) -> float:
    n, e, _ = place(other)
    return math.hypot(n - north, e - east)


def point(
    n: float,
    e: float,
    d: float,
    axes: Literal["body", "offset", "local"] = "offset",
    number: int | None = None,
) -> ObstaclePoint:
    return ObstaclePoint(component=196, axes=axes, position_m=(n, e, d), number=number)


def aircraft(world: World, n: float, e: float, d: float, velocity=(0.0, 0.0, 0.0), **more) -> SensedAircraft:
    lat, lon, alt = HOME.to_geodetic(n, e, d)
    report = AdsbVehicle(icao=7, lat_deg=lat, lon_deg=lon, alt_m=alt, velocity_ned_mps=velocity, **more)
    return SensedAircraft(component=196, report=report)
