"""The aircraft of an attacked flight: a vehicle model with the companion's core, and aircraft without one.

The vehicle model is that of the other campaigns: the velocity follows a command with a lag and a limited
acceleration. It reports to the core in events, as the link would read them from its telemetry.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from companion.autopilot.dialect import DIALECTS
from companion.config import (
    Config,
    FlightConfig,
    IdentityConfig,
    LimitsConfig,
    RemoteIdConfig,
    TrajectoryFile,
    VehicleConfig,
    Waypoint,
)
from companion.core import Companion
from companion.events import (
    Broadcast,
    Command,
    DownloadMission,
    Event,
    FenceArea,
    Firmware,
    FlightMode,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    Landed,
    LandedState,
    MissionCurrent,
    MissionDownloaded,
    MissionItem,
    RadioState,
    SetMode,
    VehicleTime,
    VelocitySetpoint,
)
from companion.geometry import Vec3
from companion.radio.frames_io import radio_address
from companion.remote_id.transports import WIFI_BEACON
from ground_tools.campaign.attacks.messages import SEPARATION_M, geodetic
from ground_tools.campaign.attacks.scene import BEGIN_S, HOME, Scene
from ground_tools.campaign.world import World
from sitl_mocks.encounters.lockstep import UTC_AT_START_S

STEP_S: Final = 0.05
OWN, PEER = "OWN", "PEER"
"""Identity of the own aircraft, and prefix of the identities of honest aircraft."""
_WORLD: Final = World()
_LAG_S, _ACCELERATION_MPS2 = _WORLD.lag_s, _WORLD.acceleration_mps2
_SIGMA_M, _SIGMA_MEMORY_S = _WORLD.sigma_m, _WORLD.sigma_memory_s
_SILENT_S: Final = 1.0
"""Time without setpoints after which the vehicle stops."""
_REACHED_M: Final = 3.0
_LANDING_MPS: Final = 1.0
_WAYPOINT: Final = 16
_RELATIVE_ALTITUDE: Final = 3


class Navigation:
    """Error of a GNSS position, correlated over time."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._error = _SIGMA_M * rng.standard_normal(3)

    def of(self, place: Vec3, elapsed_s: float) -> Vec3:
        """Measured position (NED, m) for a true one, `elapsed_s` after the last measurement."""
        keep = math.exp(-elapsed_s / _SIGMA_MEMORY_S)
        fresh = math.sqrt(1.0 - keep * keep) * _SIGMA_M
        self._error = keep * self._error + fresh * self._rng.standard_normal(3)
        n, e, d = (np.array(place) + self._error).tolist()
        return n, e, d


class Body:
    """A point mass that follows a commanded velocity (NED, m, m/s)."""

    def __init__(self, position: Vec3, velocity: Vec3) -> None:
        self.position, self.velocity, self.command = position, velocity, velocity

    def move(self) -> None:
        """Move by one time step."""
        a = [(c - v) / _LAG_S for c, v in zip(self.command, self.velocity, strict=True)]
        size = math.hypot(*a)
        if size > _ACCELERATION_MPS2:
            a = [x * _ACCELERATION_MPS2 / size for x in a]
        (n, e, d), (vn, ve, vd), (an, ae, ad) = self.position, self.velocity, a
        half = 0.5 * STEP_S
        down = d + STEP_S * (vd + half * ad)
        self.position = n + STEP_S * (vn + half * an), e + STEP_S * (ve + half * ae), min(down, 0.0)
        self.velocity = vn + STEP_S * an, ve + STEP_S * ae, vd + STEP_S * ad


class Guided:
    """A vehicle whose companion is the real core.

    Args:
        path: time (s) and position (NED, m) of the two ends of its straight path.
    """

    def __init__(
        self,
        name: str,
        config: Config,
        firmware: Firmware,
        path: tuple[tuple[float, Vec3], tuple[float, Vec3]],
        rng: np.random.Generator,
    ) -> None:
        (begin_s, begin), (end_s, self._goal) = path
        velocity = tuple((q - p) / (end_s - begin_s) for p, q in zip(begin, self._goal, strict=True))
        v_north, v_east, v_down = velocity
        start_n, start_e, start_d = (p - begin_s * v for p, v in zip(begin, velocity, strict=True))
        self._start = start_n, start_e, start_d
        self.name = name
        self.core = Companion(config)
        self.body = Body(self._start, (v_north, v_east, v_down))
        self.guards = config.flight.use == "guard"
        self.mode = FlightMode.MISSION
        if not self.guards:
            self.mode = FlightMode.HOLD if firmware is Firmware.PX4 else FlightMode.EXTERNAL
        self.address = radio_address(name)
        self._firmware = firmware
        self._speed_mps = math.hypot(*velocity)
        self._navigation = Navigation(rng)
        self._setpoint_s = -math.inf
        self._count = 0
        self._events: list[Event] = [
            RadioState(can_send=(WIFI_BEACON,), own_addresses=(self.address,)),
        ]

    def step(self, now_s: float, heard: Sequence[Event]) -> list[Broadcast]:
        """Report to the core, carry out its commands and move by one step. Returns what it broadcasts."""
        events = [*self._events, *self._telemetry(now_s), *heard]
        self._events = []
        commands = self.core.step(now_s, events)
        for command in commands:
            self._obey(command, now_s)
        self._count += 1
        self.body.command = self._wanted(now_s)
        self.body.move()
        return [c for c in commands if isinstance(c, Broadcast)]

    def _obey(self, command: Command, now_s: float) -> None:
        match command:
            case VelocitySetpoint():
                self._setpoint_s = now_s
                if self.mode is FlightMode.EXTERNAL:
                    self.body.command = command.velocity_ned_mps
            case SetMode():
                self.mode = command.mode
            case DownloadMission():
                self._events.append(MissionDownloaded(items=self._mission()))
            case _:
                pass

    def _wanted(self, now_s: float) -> Vec3:
        """Velocity that the vehicle's own mode commands; in `EXTERNAL`, the latest setpoint."""
        if self.mode is FlightMode.EXTERNAL:
            silent = now_s - self._setpoint_s > _SILENT_S
            return (0.0, 0.0, 0.0) if silent else self.body.command
        if self.mode is FlightMode.MISSION:
            way = [q - p for p, q in zip(self.body.position, self._goal, strict=True)]
            length = math.hypot(*way)
            if length < _REACHED_M:
                return 0.0, 0.0, 0.0
            north, east, down = (self._speed_mps * x / length for x in way)
            return north, east, down
        # A companion that lands asks for a mode of that name.
        return 0.0, 0.0, _LANDING_MPS if self.mode.name == "LAND" else 0.0

    def _mission(self) -> tuple[MissionItem, ...]:
        items = []
        for seq, place in enumerate((self._start, self._goal)):
            lat, lon, alt = geodetic(place)
            item = MissionItem(
                seq=seq, command=_WAYPOINT, frame=_RELATIVE_ALTITUDE,
                lat_deg=lat, lon_deg=lon, alt_m=alt - HOME.alt_m,
            )  # fmt: skip
            items.append(item)
        return tuple(items)

    def _telemetry(self, now_s: float) -> list[Event]:
        """The telemetry that is due in this step: positions ten times a second, modes and states once a
        second."""
        found: list[Event] = []
        if self._count % 20 == 0:
            dialect = DIALECTS[self._firmware]
            on_ground = self.body.position[2] >= -0.1
            command = dialect.commands.get(self.mode)
            found += [
                Heartbeat(
                    system_id=1, firmware=self._firmware, vehicle_type=2, armed=True, mode=self.mode,
                    custom_mode=0 if command is None else command.custom_mode,
                ),
                LandedState(landed=Landed.ON_GROUND if on_ground else Landed.IN_AIR),
                VehicleTime(time_boot_s=now_s, utc_s=UTC_AT_START_S + now_s),
            ]  # fmt: skip
            if self.guards:
                found.append(MissionCurrent(seq=1, total=2, mission_id=7))
        if self._count % 2 == 0:
            lat, lon, alt = geodetic(self._navigation.of(self.body.position, 2.0 * STEP_S))
            if self._count % 20 == 0:
                found.append(
                    GnssFix(
                        fix_type=3, lat_deg=lat, lon_deg=lon, alt_msl_m=alt,
                        alt_ellipsoid_m=alt + SEPARATION_M,
                        horizontal_accuracy_m=_SIGMA_M, vertical_accuracy_m=_SIGMA_M,
                    )
                )  # fmt: skip
            found.append(
                GlobalPosition(
                    time_boot_s=now_s, lat_deg=lat, lon_deg=lon, alt_msl_m=alt,
                    height_above_home_m=alt - HOME.alt_m, velocity_ned_mps=self.body.velocity,
                )
            )  # fmt: skip
        return found


def own_aircraft(scene: Scene, rng: np.random.Generator) -> Guided:
    """The own aircraft of a scene."""
    path = (BEGIN_S, scene.planned(BEGIN_S)), (scene.end_s + 60.0, scene.planned(scene.end_s + 60.0))
    fence = () if scene.fence_m is None else (_lane(scene, scene.fence_m),)
    config = _config(OWN, path, scene.max_speed_mps, scene.use, rate=1, fence=fence)
    return Guided(OWN, config, scene.firmware, path, rng)


def avoiding_aircraft(scene: Scene, number: int, rng: np.random.Generator) -> Guided:
    """One of a scene's honest aircraft that avoid others, with its companion."""
    honest, name = scene.honest[number], f"{PEER}{number}"
    times = BEGIN_S - scene.meeting_s, scene.end_s + 60.0 - scene.meeting_s
    begin, end = ((scene.meeting_s + t, honest.state(t)[0]) for t in times)
    config = _config(name, (begin, end), 1.4 * honest.speed_mps, "fly", rate=honest.rate)
    return Guided(name, config, scene.firmware, (begin, end), rng)


def _config(
    name: str,
    path: tuple[tuple[float, Vec3], tuple[float, Vec3]],
    max_speed_mps: float,
    use: str,
    *,
    rate: int,
    fence: tuple[FenceArea, ...] = (),
) -> Config:
    """Configuration of a companion: the defaults, except for what the scene sets."""
    points = []
    for at_s, place in path:
        lat, lon, alt = geodetic(place)
        points.append(Waypoint(t_s=at_s - BEGIN_S, lat_deg=lat, lon_deg=lon, alt_m=alt))
    flies = use == "fly"
    return Config(
        identity=IdentityConfig(uas_id=name),
        vehicle=VehicleConfig(system_id=1),
        flight=FlightConfig(
            use="fly" if flies else "guard",
            start="utc" if flies else "engage",
            start_utc_s=UTC_AT_START_S + BEGIN_S if flies else None,
            take_in_flight=True,
        ),
        limits=LimitsConfig(max_speed_mps=max_speed_mps),
        remote_id=RemoteIdConfig(rate=rate),
        path=TrajectoryFile(altitude="msl", waypoint=tuple(points)) if flies else None,
        fence=fence,
    )


def _lane(scene: Scene, half_width_m: float) -> FenceArea:
    """A fence around the own path: one inclusion area."""
    corners = []
    for at_s, side in ((0.0, -1.0), (scene.end_s + 90.0, -1.0), (scene.end_s + 90.0, 1.0), (0.0, 1.0)):
        north, east, down = scene.planned(at_s if at_s else -30.0)
        aside = side * half_width_m
        corner = north - aside * math.sin(scene.heading_rad), east + aside * math.cos(scene.heading_rad), down
        corners.append(geodetic(corner)[:2])
    return FenceArea(inclusion=True, points=tuple(corners))
