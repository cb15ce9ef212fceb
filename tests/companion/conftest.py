"""A simulated vehicle that consists of events and drives the core without bytes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import msgspec
import pytest

from companion.authority.table import State
from companion.config import (
    Config,
    FlightConfig,
    IdentityConfig,
    LimitsConfig,
    TrajectoryFile,
    VehicleConfig,
    Waypoint,
)
from companion.core import Companion
from companion.events import (
    Command,
    DownloadMission,
    Event,
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
from tests.support.place import HOME

UTC_AT_ZERO_S = 1_767_225_600.0
LAT, LON, ALT_MSL = HOME.lat_deg, HOME.lon_deg, 450.0
STEP_S = 0.05


def straight_path(speed_mps: float = 3.0) -> TrajectoryFile:
    """Due north from the vehicle's place, 400 s long."""
    north_deg = 400.0 * speed_mps / 111_194.9
    return TrajectoryFile(
        altitude="msl",
        waypoint=(
            Waypoint(t_s=0.0, lat_deg=LAT, lon_deg=LON, alt_m=ALT_MSL),
            Waypoint(t_s=400.0, lat_deg=LAT + north_deg, lon_deg=LON, alt_m=ALT_MSL),
        ),
    )


def config(**flight: object) -> Config:
    """A companion that flies the straight path; keywords replace [flight] keys."""
    made = Config(
        identity=IdentityConfig(uas_id="OWN"), vehicle=VehicleConfig(system_id=1), path=straight_path()
    )
    return msgspec.structs.replace(
        made, flight=FlightConfig(**{"use": "fly", "take_in_flight": True, **flight})
    )  # type: ignore[arg-type]


@dataclass
class Bench:
    """Drives one core; every attribute may be changed between steps."""

    core: Companion
    now_s: float = 0.0
    mode: FlightMode = FlightMode.HOLD
    custom_mode: int = 0
    """0: one number for each mode."""
    firmware: Firmware = Firmware.PX4
    armed: bool = True
    failsafe: bool = False
    landed: Landed = Landed.IN_AIR
    north_m: float = 0.0
    east_m: float = 0.0
    velocity_ned_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    fix_type: int = 3
    obeys: bool = True
    """Follows SetMode."""
    silent: bool = False
    """Sends nothing."""
    stuck_position: bool = False
    """Heartbeats, but no position."""
    utc_error_s: float = 0.0
    boot_offset_s: float = 100.0
    height_m: float = 50.0
    """Above home. Changed without `alt_m`, it moves home."""
    alt_m: float = ALT_MSL
    lat_deg: float = LAT
    lon_deg: float = LON
    mission: tuple[MissionItem, ...] | None = None
    """What a download brings; None: no answer."""
    extra: list[Event] = field(default_factory=lambda: [RadioState(can_send=("wifi",))])
    commands: list[Command] = field(default_factory=list)
    """Of the last step."""
    log: list[tuple[float, Command]] = field(default_factory=list)

    def events(self) -> list[Event]:
        if self.silent:
            return []
        found: list[Event] = [
            Heartbeat(
                system_id=1,
                firmware=self.firmware,
                vehicle_type=2,
                custom_mode=self.custom_mode or list(FlightMode).index(self.mode),
                mode=self.mode,
                armed=self.armed,
                failsafe=self.failsafe,
            ),
            LandedState(landed=self.landed),
            GnssFix(
                fix_type=self.fix_type,
                lat_deg=LAT,
                lon_deg=LON,
                alt_msl_m=ALT_MSL,
                alt_ellipsoid_m=ALT_MSL + 47.0,
                horizontal_accuracy_m=1.0,
            ),
            VehicleTime(
                time_boot_s=self.now_s + self.boot_offset_s,
                utc_s=UTC_AT_ZERO_S + self.now_s + self.utc_error_s,
            ),
        ]
        if not self.stuck_position:
            found.append(
                GlobalPosition(
                    time_boot_s=self.now_s + self.boot_offset_s,
                    lat_deg=self.lat_deg + self.north_m / 111_194.9,
                    lon_deg=self.lon_deg + self.east_m / 75_370.0,
                    alt_msl_m=self.alt_m,
                    height_above_home_m=self.height_m,
                    velocity_ned_mps=self.velocity_ned_mps,
                )
            )
        return found

    def step(self, count: int = 1, gap_s: float = STEP_S) -> list[Command]:
        """Advance by `count` steps; returns all commands of them."""
        all_commands: list[Command] = []
        for _ in range(count):
            self.now_s = round(self.now_s + gap_s, 6)
            events = self.events() + self.extra
            self.extra = []
            self.commands = self.core.step(self.now_s, events)
            all_commands += self.commands
            self.log += [(self.now_s, c) for c in self.commands]
            for command in self.commands:
                if isinstance(command, SetMode) and self.obeys:
                    self.mode = command.mode
                elif isinstance(command, DownloadMission) and self.mission is not None:
                    self.extra.append(MissionDownloaded(items=self.mission))
        return all_commands

    def until(self, done: Callable[[], bool], limit: int = 400) -> None:
        """Step until `done`, or fail."""
        for _ in range(limit):
            if done():
                return
            self.step()
        raise AssertionError(f"not reached in {limit} steps; state {self.core.state}")

    def setpoints(self, commands: Sequence[Command] | None = None) -> list[VelocitySetpoint]:
        """Setpoints among commands (of the last step by default)."""
        return [
            c for c in (self.commands if commands is None else commands) if isinstance(c, VelocitySetpoint)
        ]


@pytest.fixture
def make_bench() -> Callable[..., Bench]:
    """Build a bench; keywords replace [flight] keys of the configuration."""

    def build(**flight: object) -> Bench:
        return Bench(Companion(config(**flight)))

    return build


@pytest.fixture
def on_mission() -> Bench:
    """Flies the vehicle's mission, taken from HOLD; after 200 m its pilot has taken over."""
    made = msgspec.structs.replace(
        config(trajectory="mission", mission_speed_mps=3.0, rearm="mode"), path=None
    )
    bench = Bench(Companion(made), mission=mission(300.0, 900.0))
    bench.until(lambda: bench.mode is FlightMode.EXTERNAL)
    bench.step(5)
    bench.mode = FlightMode.HOLD
    for north_m in range(200):
        bench.north_m = north_m
        bench.step()
    return bench


@pytest.fixture
def guarded() -> Callable[..., Bench]:
    """Build a bench that flies its mission, which is guarded, at 3 m/s due north, to 300 m."""

    def build(
        items: tuple[MissionItem, ...] | None = None, limits: LimitsConfig | None = None, **flight: object
    ) -> Bench:
        made = msgspec.structs.replace(
            config(use="guard", **flight), path=None, limits=limits or LimitsConfig()
        )
        items = items or mission(300.0, 900.0)
        bench = Bench(Companion(made), mission=items, mode=FlightMode.MISSION)
        bench.velocity_ned_mps = (3.0, 0.0, 0.0)
        bench.extra.append(MissionCurrent(seq=0))
        bench.until(lambda: bench.core.state is State.WATCHING)
        return bench

    return build


def mission(*norths_m: float) -> tuple[MissionItem, ...]:
    """Waypoints due north of the vehicle's place."""
    return tuple(
        MissionItem(seq=seq, command=16, frame=3, lat_deg=LAT + north / 111_194.9, lon_deg=LON, alt_m=50.0)
        for seq, north in enumerate(norths_m)
    )


@pytest.fixture
def make_config() -> Callable[..., Config]:
    """Build the configuration that `make_bench` uses."""
    return config
