"""Lock-step simulation of several aircraft in virtual time, in one thread, over real bytes.

Each aircraft has a vehicle, a link and a companion core; all share the air. Data between two parts has the
same form as in flight: MAVLink frames between vehicle and companion, Remote ID frames between companions.
Time is a number that this loop increments.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import msgspec
import numpy as np

from companion.arrays import Floats
from companion.atmc.chooser import Chooser
from companion.autopilot.tlog import ByteSink, TlogWriter
from companion.config import (
    AtmcConfig,
    Config,
    FlightConfig,
    IdentityConfig,
    LimitsConfig,
    RemoteIdConfig,
    SensedConfig,
    TrajectoryFile,
    VehicleConfig,
    Waypoint,
)
from companion.event_record import Step
from companion.events import Firmware, RadioState, RemoteIdHeard
from companion.radio.frames_io import TRANSPORTS, FrameReceiver, FrameSender, radio_address
from companion.system import CompanionSystem
from sitl_mocks.air.air_settings import channel_of
from sitl_mocks.air.ether import Ether
from sitl_mocks.air.pair_statistics import PairStats
from sitl_mocks.encounters.choosing import Chosen, RandomMind, with_agent
from sitl_mocks.encounters.scenario import encounter
from sitl_mocks.encounters.scenario_file import RANDOM, Scenario
from sitl_mocks.vehicle.firmware.behaviour import MANNERS
from sitl_mocks.vehicle.mock_vehicle import MockVehicle
from sitl_mocks.vehicle.options import HOME, VehicleOptions
from sitl_mocks.vehicle.sensing import Obstacle

TICK_S = 0.05
UTC_AT_START_S = 1_767_225_590.0
"""2025-12-31 23:59:50 UTC, so that the hour of the Remote ID timestamp wraps ten seconds into every run."""
_PREFIX = "1596"
"""Manufacturer code of simulated serial numbers, for regions that require their form."""
_OPERATOR_EU = "FIN87astrdge12k8-xyz"
"""Sample operator number of ASD-STAN EN 4709-002."""
_DECODED = 4096
"""Number of decoded frames that are cached, because the air and all receivers of one frame decode the
same bytes."""
SETTLE_S = 3.0
"""Time for the companions to connect to their vehicles and take control, before the paths' clock starts."""


@dataclass(slots=True)
class Flown:
    """True positions of one aircraft at every tick."""

    name: str
    position_ned_m: Floats
    """Shape (ticks, 3), local NED at home."""


@dataclass(slots=True)
class Run:
    """Result of one lock-step run."""

    aircraft: list[Flown]
    air: dict[tuple[str, str], PairStats]
    time_s: Floats
    """Path time of every tick."""
    chosen: dict[str, Chosen]
    """Transports that each aircraft used, by name."""
    faults: dict[str, str] = field(default_factory=dict)
    """Aircraft -> why its law failed. Aircraft whose law did not fail are missing."""
    obstacles: dict[tuple[str, str], tuple[float, float]] = field(default_factory=dict)
    """(Aircraft, obstacle) -> least distance at a tick (m), and the path time of that tick."""


class Aircraft:
    """One vehicle with its companion and radio."""

    def __init__(
        self,
        name: str,
        options: VehicleOptions,
        config: Config,
        rng: np.random.Generator,
        record: Callable[[Step], None] | None,
        tlog: ByteSink | None,
        policy: bytes | None = None,
        random_choice: np.random.Generator | None = None,
    ) -> None:
        self.name = name
        self.config = config
        self.chosen = Chosen()
        self.law_fault: str | None = None
        """Why its law failed, in words; None if it did not."""
        self._record = record
        self.vehicle = MockVehicle(options, rng)
        self.onboard = CompanionSystem(
            config,
            self._take,
            policy=policy,
            tlog=None if tlog is None else TlogWriter(tlog),
            utc_guess_s=UTC_AT_START_S,
        )
        if random_choice is not None:
            self.onboard.core.chooser = Chooser(config, RandomMind(random_choice), "policy")
        address = radio_address(name)
        self.onboard.hear(RadioState(can_send=tuple(sorted(TRANSPORTS)), own_addresses=(address,)))
        self.sender = FrameSender(address)

    def _take(self, step: Step) -> None:
        """Process one step of the companion core."""
        self.chosen.add_step(step)
        self.law_fault = self.law_fault or self.onboard.core.law_fault
        if self._record is not None:
            self._record(step)


def paths_of(scenario: Scenario, seed: int) -> list[Floats]:
    """Timed paths of all aircraft, each of shape (points, 4): time (s), north, east, down (m)."""
    if scenario.geometry is not None:
        return [np.asarray(p, float) for p in encounter(scenario.geometry, scenario.aircraft, seed)]
    return [np.asarray(p.points, float) for p in scenario.path]


def names_of(scenario: Scenario, seed: int) -> list[str]:
    """Names of the aircraft. They are also their identities on the air."""
    return [f"DMUCA{number:03d}" for number in range(1, len(paths_of(scenario, seed)) + 1)]


def vehicle_options(scenario: Scenario, number: int, path: Floats) -> VehicleOptions:
    """Options of the mock vehicle, which begins airborne at the path's start."""
    v, limits = scenario.vehicle, scenario.limits
    firmware = Firmware.PX4 if number % 2 else Firmware.ARDUPILOT
    if v.firmware != "mixed":
        firmware = Firmware(v.firmware)
    return VehicleOptions(
        firmware=firmware,
        system_id=number + 1,
        home_lat_deg=HOME.lat_deg,
        home_lon_deg=HOME.lon_deg,
        home_alt_msl_m=HOME.alt_m,
        airborne=True,
        start_mode=MANNERS[firmware].waits_in,
        start_position_ned_m=(float(path[0, 1]), float(path[0, 2]), float(path[0, 3])),
        utc_at_zero_s=UTC_AT_START_S,
        parameters=_parameters(firmware, limits),
        max_horizontal_speed_mps=2.0 * limits.max_speed_mps,
        max_climb_mps=limits.max_climb_mps,
        max_descent_mps=limits.max_descent_mps,
        max_acceleration_mps2=v.max_acceleration_mps2,
        velocity_lag_s=v.lag_s,
        wind_ned_mps=v.wind_ned_mps,
        gnss_horizontal_sigma_m=v.gnss_horizontal_sigma_m,
        gnss_vertical_sigma_m=v.gnss_vertical_sigma_m,
        gnss_velocity_sigma_mps=v.gnss_velocity_sigma_mps,
        gnss_correlation_s=v.gnss_correlation_s,
        sensor=scenario.sensor,
        obstacles=tuple(from_settling(obstacle) for obstacle in scenario.obstacle),
    )


def from_settling(obstacle: Obstacle) -> Obstacle:
    """Convert an obstacle from the paths' clock to the vehicles' clock, which starts SETTLE_S earlier."""
    return msgspec.structs.replace(obstacle, at_ned_m=obstacle.place(-SETTLE_S))


def obstacle_names(scenario: Scenario) -> list[str]:
    """Names of the obstacles of a scenario."""
    return [f"{obstacle.kind} {number}" for number, obstacle in enumerate(scenario.obstacle, 1)]


def _parameters(firmware: Firmware, limits: LimitsConfig) -> dict[str, float]:
    """Parameters that make the vehicle's own limits so wide that only the scenario's limits apply."""
    speed, climb, descent = 2.0 * limits.max_speed_mps, limits.max_climb_mps, limits.max_descent_mps
    if firmware is Firmware.PX4:
        return {"MPC_XY_VEL_MAX": speed, "MPC_Z_VEL_MAX_UP": climb, "MPC_Z_VEL_MAX_DN": descent}
    return {
        "WPNAV_SPEED": 100.0 * speed,
        "WPNAV_SPEED_UP": 100.0 * climb,
        "WPNAV_SPEED_DN": 100.0 * descent,
    }


def uas_id_of(scenario: Scenario, name: str) -> str:
    """Remote ID identity of an aircraft: its name, as a serial number if the region requires its form."""
    if scenario.region.serial_number == "any":
        return name
    return f"{_PREFIX}{len(name):X}{name}"


def companion_config(scenario: Scenario, name: str, path: Floats, law: str | None) -> Config:
    """The companion's configuration for one aircraft. `law` replaces the scenario's law."""
    waypoints = []
    for t, north, east, down in path:
        lat, lon, alt = HOME.to_geodetic(float(north), float(east), float(down))
        waypoints.append(Waypoint(t_s=float(t), lat_deg=lat, lon_deg=lon, alt_m=alt))
    avoidance = scenario.avoidance
    if law is not None:
        avoidance = msgspec.structs.replace(avoidance, law=law)
    atmc = scenario.atmc
    if atmc.policy == RANDOM:
        atmc = AtmcConfig(period_s=atmc.period_s)
    return Config(
        identity=IdentityConfig(uas_id=uas_id_of(scenario, name)),
        vehicle=VehicleConfig(system_id=int(name.removeprefix("DMUCA"))),
        flight=FlightConfig(
            use="fly", start="utc", start_utc_s=UTC_AT_START_S + SETTLE_S, take_in_flight=True
        ),
        limits=scenario.limits,
        avoidance=avoidance,
        sensed=SensedConfig(use=scenario.sensor is not None),
        remote_id=RemoteIdConfig(
            transports=scenario.air.transports,
            rate=scenario.air.rate,
            operator_id=_OPERATOR_EU if scenario.region.operator_id == "eu" else None,
        ),
        region=scenario.region,
        atmc=atmc,
        path=TrajectoryFile(altitude="msl", waypoint=tuple(waypoints)),
    )


def fly(
    scenario: Scenario,
    seed: int,
    *,
    law: str | None = None,
    policy: bytes | None = None,
    record: Callable[[str, Config], Callable[[Step], None]] | None = None,
    tlog: Callable[[str], ByteSink] | None = None,
    progress: Callable[[float], None] | None = None,
    watch: Callable[[Ether], None] | None = None,
) -> Run:
    """Fly a scenario once.

    Args:
        seed: determines paths (drawn geometries), navigation errors and the channel.
        law: replaces the scenario's law ("none" is the baseline without avoidance).
        policy: content of the policy file that chooses the transports of all aircraft, in the form that
            `CompanionSystem` takes. An event record must hold it in its header.
        record: called once per aircraft with its name and configuration; returns the function that receives
            its steps.
        tlog: called once per aircraft with its name; returns the sink for its MAVLink.
        progress: called with the completed share, about once per simulated second.
        watch: called with the air at the end of every tick.
    """
    paths = paths_of(scenario, seed)
    streams = np.random.SeedSequence(seed).spawn(len(paths) + 1)
    fleet = [
        _aircraft(scenario, number, name, path, streams[number], law, policy, record, tlog)
        for number, (name, path) in enumerate(zip(names_of(scenario, seed), paths, strict=True))
    ]
    channel = channel_of(scenario.air, scenario.channel)
    read = lru_cache(_DECODED)(FrameReceiver().receive)
    ether = Ether(channel, np.random.default_rng(streams[-1]), read=read)
    for aircraft in fleet:
        ether.join(aircraft.name)
    end_s = scenario.duration_s or max(float(p[-1, 0]) for p in paths)
    ticks = math.ceil((end_s + SETTLE_S) / TICK_S) + 1
    truth = np.empty((len(fleet), ticks, 3))
    by_name = {aircraft.name: aircraft for aircraft in fleet}
    near = {(a.name, name): (math.inf, 0.0) for a in fleet for name in obstacle_names(scenario)}
    for tick in range(ticks):
        now_s = tick * TICK_S
        _tick(now_s, fleet, by_name, ether, read)
        if watch is not None:
            watch(ether)
        for number, aircraft in enumerate(fleet):
            truth[number, tick] = aircraft.vehicle.position_ned_m
            if scenario.obstacle:
                _measure(aircraft, scenario, now_s - SETTLE_S, near)
        if progress is not None and tick % 20 == 0:
            progress(tick / ticks)
    ether.finish((ticks - 1) * TICK_S)
    for aircraft in fleet:
        aircraft.chosen.end((ticks - 1) * TICK_S)
    flown = [Flown(a.name, truth[number]) for number, a in enumerate(fleet)]
    time_s = np.arange(ticks, dtype=np.float64) * TICK_S - SETTLE_S
    faults = {a.name: a.law_fault for a in fleet if a.law_fault is not None}
    return Run(flown, ether.stats, time_s, {a.name: a.chosen for a in fleet}, faults, near)


def _measure(
    aircraft: Aircraft, scenario: Scenario, path_s: float, near: dict[tuple[str, str], tuple[float, float]]
) -> None:
    """Update the least distance of an aircraft from each obstacle."""
    for name, obstacle in zip(obstacle_names(scenario), scenario.obstacle, strict=True):
        away_m = obstacle.distance_m(aircraft.vehicle.position_ned_m, path_s)
        if away_m < near[aircraft.name, name][0]:
            near[aircraft.name, name] = away_m, path_s


def _aircraft(
    scenario: Scenario,
    number: int,
    name: str,
    path: Floats,
    seed_sequence: np.random.SeedSequence,
    law: str | None,
    policy: bytes | None,
    record: Callable[[str, Config], Callable[[Step], None]] | None,
    tlog: Callable[[str], ByteSink] | None,
) -> Aircraft:
    """Create one aircraft of `fly`. Random choices have a generator separate from navigation errors."""
    config = with_agent(companion_config(scenario, name, path, law), policy, number)
    drawn = np.random.default_rng(seed_sequence.spawn(1)[0]) if scenario.atmc.policy == RANDOM else None
    return Aircraft(
        name,
        vehicle_options(scenario, number, path),
        config,
        np.random.default_rng(seed_sequence),
        None if record is None else record(name, config),
        None if tlog is None else tlog(name),
        policy,
        drawn,
    )


def _tick(
    now_s: float,
    fleet: Sequence[Aircraft],
    by_name: dict[str, Aircraft],
    ether: Ether,
    read: Callable[[str, str, bytes], RemoteIdHeard | None],
) -> None:
    # All aircraft do one thing before any does the next: the processor's caches then hold the code of it.
    for aircraft in fleet:
        sensor = aircraft.vehicle.sensor
        if sensor is not None:
            others = (other.vehicle for other in fleet if other is not aircraft)
            sensor.others = [(other.position_ned_m, other.velocity_ned_mps) for other in others]
        aircraft.vehicle.advance(now_s)
    for aircraft in fleet:
        data = aircraft.vehicle.drain()
        if data:
            aircraft.onboard.receive(data, now_s)
        ether.place(aircraft.name, aircraft.vehicle.position_ned_m)
    for delivery in ether.due(now_s):
        receiver = by_name[delivery.receiver]
        heard = read(delivery.transport, delivery.address, delivery.frame)
        if heard is not None:
            receiver.onboard.hear(heard)
    for aircraft in fleet:
        for broadcast in aircraft.onboard.tick(now_s):
            for frame in aircraft.sender.frames(broadcast.transport, broadcast.messages):
                ether.transmit(
                    now_s, aircraft.name, broadcast.transport, frame, address=aircraft.sender.address
                )
    for aircraft in fleet:
        aircraft.vehicle.receive(aircraft.onboard.drain(now_s), now_s)
