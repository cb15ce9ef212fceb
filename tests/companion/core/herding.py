"""An aircraft with dynamics, driven through the core, and transmitters that try to move it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec
import numpy as np

from companion.authority.table import HOLDING, State
from companion.config import ContainmentConfig, LimitsConfig
from companion.core import Companion
from companion.events import (
    AdsbVehicle,
    AllowanceSpent,
    Firmware,
    FlightMode,
    GlobalPosition,
    MissionCurrent,
    RemoteIdHeard,
    Say,
)
from companion.remote_id.messages import BasicId, IdType, Location, Status, UaType
from tests.companion.conftest import ALT_MSL, LAT, LON, UTC_AT_ZERO_S, Bench, config, mission

UNBOUNDED = ContainmentConfig(
    side_m=1e5, below_m=1e4, above_m=1e4, track_s=86_400.0, inside_s=86_400.0, group_s=86_400.0,
    total_s=86_400.0, crewed_side_m=1e5, crewed_above_m=1e4, crewed_total_s=86_400.0,
)  # fmt: skip
"""A containment that bounds nothing."""
NORTH_M, EAST_M = 111_194.9, 75_370.0
SPEED_MPS = 3.0
HOME_HEIGHT_M = 50.0

Place = Callable[["Herded"], tuple[np.ndarray, np.ndarray] | None]
"""Where a sender claims to be, and its velocity, NED; None: it is silent."""


@dataclass
class Herded(Bench):
    """Answers velocities with a lag of 0.5 s; in its own mission it flies north at 3 m/s at 50 m."""

    place: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, -HOME_HEIGHT_M]))
    speed: np.ndarray = field(default_factory=lambda: np.array([SPEED_MPS, 0.0, 0.0]))
    way: list[np.ndarray] = field(default_factory=list)
    """True place after every step."""
    held: list[bool] = field(default_factory=list)

    def events(self):
        n, e, d = self.place.tolist()
        lat, lon = LAT + n / NORTH_M, LON + e / EAST_M
        at = GlobalPosition(
            time_boot_s=self.now_s + self.boot_offset_s,
            lat_deg=lat,
            lon_deg=lon,
            alt_msl_m=ALT_MSL - HOME_HEIGHT_M - d,
            height_above_home_m=-d,
            velocity_ned_mps=tuple(self.speed.tolist()),
        )
        return [at if isinstance(e, GlobalPosition) else e for e in super().events()]

    def fly(self, seconds, *senders):
        """Fly on; each sender transmits twice a second."""
        for _ in range(round(seconds / 0.05)):
            if len(self.way) % 10 == 0:
                self.extra += [heard for send in senders if (heard := send(self)) is not None]
            self.step()
            found = self.setpoints()
            wanted = self.speed
            if self.mode is FlightMode.MISSION:
                # Back to the mission's line, as an autopilot does.
                aside = np.array([0.0, self.place[1], self.place[2] + HOME_HEIGHT_M])
                wanted = np.array([SPEED_MPS, 0.0, 0.0]) - 0.3 * np.clip(aside, -5.0, 5.0)
            elif self.mode is FlightMode.HOLD:
                wanted = np.zeros(3)
            elif found:
                wanted = np.array(found[-1].velocity_ned_mps)
            self.speed = self.speed + 0.1 * (wanted - self.speed)
            self.place = self.place + 0.05 * self.speed
            self.way.append(self.place)
            self.held.append(self.core.state in HOLDING)
        return self

    @property
    def texts(self):
        return [c.text for _, c in self.log if isinstance(c, Say)]

    @property
    def spent(self):
        return [c for _, c in self.log if isinstance(c, AllowanceSpent)]

    def off_m(self):
        """Largest distances of the way: to the side of the mission, above it, below it."""
        way = np.array(self.way)
        return abs(way[:, 1]).max(), (-way[:, 2]).max() - HOME_HEIGHT_M, HOME_HEIGHT_M + way[:, 2].max()

    def held_s(self):
        return 0.05 * sum(self.held)


def herded(use="guard", firmware=Firmware.PX4, containment=None, limits=None, length_m=6000.0, **flight):
    """An aircraft that flies a mission or path due north at 50 m above home."""
    made = config(use=use, **flight)
    if use == "guard":
        made = msgspec.structs.replace(made, path=None)
    else:
        waypoints = [msgspec.structs.replace(w, alt_m=ALT_MSL) for w in made.path.waypoint]
        made = msgspec.structs.replace(made, path=msgspec.structs.replace(made.path, waypoint=waypoints))
    made = msgspec.structs.replace(
        made,
        containment=containment or ContainmentConfig(),
        limits=limits or LimitsConfig(),
    )
    bench = Herded(Companion(made), firmware=firmware, mission=mission(length_m))
    if use == "fly" and firmware is Firmware.ARDUPILOT:
        bench.mode = FlightMode.EXTERNAL
    if use == "guard":
        bench.mode = FlightMode.MISSION
        bench.extra.append(MissionCurrent(seq=0))
    bench.fly(5.0)
    assert bench.core.state is (State.WATCHING if use == "guard" else State.GUARDING)
    bench.way.clear()
    bench.held.clear()
    return bench


def sender(name, where: Place):
    """A Remote ID transmitter; `name` may be a function of the time."""

    def send(bench):
        found = where(bench)
        if found is None:
            return None
        uas_id = name(bench.now_s) if callable(name) else name
        return heard(bench, uas_id, *found)

    return send


def heard(bench, uas_id, place, velocity):
    n, e, d = (float(x) for x in place)
    vn, ve, vd = (float(x) for x in velocity)
    return RemoteIdHeard(
        transport="wifi",
        address=uas_id,
        messages=(
            BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id=uas_id),
            Location(
                status=Status.AIRBORNE,
                lat_deg=LAT + n / NORTH_M,
                lon_deg=LON + e / EAST_M,
                alt_geodetic_m=ALT_MSL + 47.0 - HOME_HEIGHT_M - d,
                direction_deg=math.degrees(math.atan2(ve, vn)) % 360.0,
                speed_mps=math.hypot(vn, ve),
                vertical_speed_mps=-vd,
                horizontal_accuracy_m=3.0,
                timestamp_s=math.floor(((UTC_AT_ZERO_S + bench.now_s) % 3600.0) * 10) / 10,
            ),
        ),
    )


def follower(offset):
    """Claims to be beside the aircraft, whatever it does."""

    def where(bench):
        return bench.place + np.array(offset), bench.speed

    return where


def straight(start, velocity, since_s=0.0):
    """Keeps its way, avoids nobody; silent before `since_s`."""

    def where(bench):
        if bench.now_s < since_s:
            return None
        return np.array(start) + (bench.now_s - since_s) * np.array(velocity), np.array(velocity)

    return where


def helicopter(where: Place, *, geometric, icao=0x400123):
    """An ADS-B report, with a height above the ellipsoid or a pressure altitude."""

    def send(bench):
        found = where(bench)
        if found is None:
            return None
        (n, e, d), velocity = found
        above = ALT_MSL - HOME_HEIGHT_M - d
        return AdsbVehicle(
            icao=icao,
            lat_deg=LAT + n / NORTH_M,
            lon_deg=LON + e / EAST_M,
            alt_m=float(above + (47.0 if geometric else 0.0)),
            alt_geometric=geometric,
            velocity_ned_mps=tuple(float(v) for v in velocity),
            emitter=7,
        )

    return send
