"""Flies the companion's own core towards something that only a sensor sees, in virtual time in one thread.

The vehicle is that of the attacks (`attacks.craft`) with an attitude: it tilts according to its acceleration,
and its nose turns into the direction of flight. The sensor is the mock vehicle's, and the link's own readers
read its frames, so the tracks come from the code that flies.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np

from companion.autopilot.counts import LinkCounts
from companion.autopilot.sensors import SETTLED_S, Sensors
from companion.autopilot.wire import FrameScanner
from companion.avoidance.law import separation_m
from companion.config import (
    AvoidanceConfig,
    Config,
    FlightConfig,
    IdentityConfig,
    LimitsConfig,
    SensedConfig,
    TrajectoryFile,
    VehicleConfig,
    Waypoint,
)
from companion.errors import PeerDataError
from companion.events import Attitude, Command, Decision, Event, Firmware
from companion.geometry import LocalFrame, Vec3
from ground_tools.campaign.attacks.craft import STEP_S, Guided
from ground_tools.campaign.attacks.messages import geodetic
from ground_tools.campaign.attacks.scene import HOME
from ground_tools.campaign.sensed.scene import BEGIN_S, END_S, Cell, Scene, draw
from sitl_mocks.encounters.lockstep import UTC_AT_START_S
from sitl_mocks.vehicle.sensing import Sensor, SensorOptions

SEPARATION_M: Final = separation_m(AvoidanceConfig(), False)[0]
HIT_M: Final = 2.0
_GRAVITY: Final = 9.81
_TURN_RPS: Final = math.radians(60.0)
"""Turn rate of the nose."""
_SLOW_MPS: Final = 0.7
"""Speed below which the heading does not change."""
_FRAME: Final = LocalFrame(HOME.lat_deg, HOME.lon_deg, HOME.alt_m)


class Row(msgspec.Struct, frozen=True, array_like=True):
    """Outcome of one flight."""

    seed: int
    separation_m: float
    """Least distance from the obstacle."""
    unavoided_m: float
    """The least distance if the aircraft had flown its path without avoiding."""
    deviation_m: float
    """Largest distance from the timed point of the planned path."""
    back_m: float
    """Distance from the timed point at the end."""
    seen_s: float | None
    """Time from the first decision that saw the obstacle to the least distance; None: it was never seen."""

    @property
    def lost(self) -> bool:
        """Whether separation was lost."""
        return self.separation_m < SEPARATION_M

    @property
    def hit(self) -> bool:
        """Whether the aircraft hit the obstacle."""
        return self.separation_m < HIT_M


class Seeing(Guided):
    """A vehicle with a sensor, whose companion is the real core."""

    def __init__(self, cell: Cell, scene: Scene, rng: np.random.Generator) -> None:
        path = (BEGIN_S, scene.planned(BEGIN_S)), (END_S + 60.0, scene.planned(END_S + 60.0))
        firmware = Firmware.PX4 if rng.random() < 0.5 else Firmware.ARDUPILOT
        if cell.message == "proximity":
            firmware = Firmware.ARDUPILOT
        super().__init__("OWN", _config(cell, path), firmware, path, rng)
        options = SensorOptions(
            message=cell.message, range_m=cell.range_m, fov_deg=cell.fov_deg, rate_hz=cell.rate_hz
        )
        self._sensor = Sensor(options, (scene.obstacle,), _FRAME, rng.spawn(1)[0], 1)
        self._scanner = FrameScanner()
        self._readers = Sensors(self.core.config.sensed, LinkCounts(wire=self._scanner.counts))
        self._firmware = firmware
        self._wired = cell.message == "proximity"
        self._yaw = scene.heading_rad
        self._before = self.body.velocity
        self.saw_s: float | None = None
        """Time of the first decision that saw something."""

    def fly(self, now_s: float) -> None:
        """Measure, report to the core, carry out its commands, and move by one step."""
        attitude = self._attitude()
        believed = self._believed()
        events: list[Event] = [
            Attitude(time_boot_s=now_s, roll_rad=attitude[0], pitch_rad=attitude[1], yaw_rad=attitude[2]),
            *self._read(self._measured(now_s, believed, attitude), now_s),
        ]
        self.step(now_s, events)

    def _measured(self, now_s: float, believed: Vec3, attitude: Vec3) -> list[bytes]:
        if self._wired:
            return self._sensor.burst(now_s, self.body.position, attitude)
        return self._sensor.due(now_s, self.body.position, believed, attitude)

    def _obey(self, command: Command, now_s: float) -> None:
        super()._obey(command, now_s)
        if self.saw_s is None and isinstance(command, Decision) and command.tracks:
            self.saw_s = now_s

    def _believed(self) -> Vec3:
        """Position that the vehicle last reported; its true position before the first report."""
        own = self.core.own
        if own.position is None:
            return self.body.position
        return _FRAME.to_ned(own.position.lat_deg, own.position.lon_deg, own.position.alt_msl_m)

    def _attitude(self) -> Vec3:
        """Present roll, pitch and yaw (rad)."""
        (vn, ve, _), (bn, be, _) = self.body.velocity, self._before
        north, east = (vn - bn) / STEP_S, (ve - be) / STEP_S
        self._before = self.body.velocity
        if math.hypot(vn, ve) > _SLOW_MPS:
            turn = math.remainder(math.atan2(ve, vn) - self._yaw, math.tau)
            most = _TURN_RPS * STEP_S
            self._yaw = math.remainder(self._yaw + max(-most, min(most, turn)), math.tau)
        cos, sin = math.cos(self._yaw), math.sin(self._yaw)
        forward, right = cos * north + sin * east, cos * east - sin * north
        return math.atan2(right, _GRAVITY), -math.atan2(forward, _GRAVITY), self._yaw

    def _read(self, frames: Sequence[bytes], now_s: float) -> list[Event]:
        found = []
        for frame in self._scanner.frames(b"".join(frames)):
            try:
                taken = self._readers.takes(frame, 1, self._firmware)
                event = self._readers.event(frame, now_s) if taken else None
            except PeerDataError:
                continue
            if event is not None:
                found.append(event)
        # No further frame of a burst is sent in this step.
        whole = self._readers.advance(now_s + 2.0 * SETTLED_S)
        return found if whole is None else [*found, whole]


def fly(cell: Cell, seed: int) -> Row:
    """Fly the encounter of a seed."""
    scene = draw(cell, seed)
    own = Seeing(cell, scene, np.random.default_rng([seed, 29]))
    least, least_s, unavoided, deviation, away = math.inf, 0.0, math.inf, 0.0, 0.0
    for tick in range(math.ceil(END_S / STEP_S)):
        now_s = tick * STEP_S
        own.fly(now_s)
        after_s = now_s + STEP_S
        planned = scene.planned(after_s)
        distance = scene.obstacle.distance_m(own.body.position, after_s)
        if distance < least:
            least, least_s = distance, after_s
        unavoided = min(unavoided, scene.obstacle.distance_m(planned, after_s))
        away = math.dist(own.body.position, planned)
        if now_s >= BEGIN_S:
            deviation = max(deviation, away)
    return Row(
        seed=seed,
        separation_m=round(least, 3),
        unavoided_m=round(unavoided, 3),
        deviation_m=round(deviation, 3),
        back_m=round(away, 3),
        seen_s=None if own.saw_s is None else round(least_s - own.saw_s, 2),
    )


def _config(cell: Cell, path: tuple[tuple[float, Vec3], tuple[float, Vec3]]) -> Config:
    points = []
    for at_s, place in path:
        lat, lon, alt = geodetic(place)
        points.append(Waypoint(t_s=at_s - BEGIN_S, lat_deg=lat, lon_deg=lon, alt_m=alt))
    return Config(
        identity=IdentityConfig(uas_id="OWN"),
        vehicle=VehicleConfig(system_id=1),
        flight=FlightConfig(
            use="fly", start="utc", start_utc_s=UTC_AT_START_S + BEGIN_S, take_in_flight=True
        ),
        limits=LimitsConfig(max_speed_mps=cell.speed_mps, max_acceleration_mps2=cell.acceleration_mps2),
        sensed=SensedConfig(use=True, latency_s=0.0),
        path=TrajectoryFile(altitude="msl", waypoint=tuple(points)),
    )
