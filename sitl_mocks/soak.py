"""`sitl-mocks soak`: hours of flights in virtual time with random troubles, watched by rules of its own.

One vehicle flies its mission again and again, with a companion that guards or flies it; others cross its way;
links, navigation, autopilot, pilot and radio fail at random. What may never happen is judged here, from what
crosses the link, and not by what the companion says of itself. A seed fixes everything.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.authority.table import HOLDING, State
from companion.autopilot.dialect import ARMED
from companion.autopilot.readers import unpack
from companion.autopilot.wire import (
    CURRENT_MODE,
    Frame,
    FrameScanner,
    MavlinkMessage,
    MavlinkReader,
    MavlinkWriter,
)
from companion.config import Config, FlightConfig, IdentityConfig, LimitsConfig, NullRadio
from companion.errors import ConfigError
from companion.events import Firmware, Landed, MissionItem, RadioState, RemoteIdHeard
from companion.geometry import LocalFrame
from companion.onboard import Onboard
from companion.remote_id.messages import BasicId, IdType, Location, Status, UaType
from sitl_mocks.autopilot import MockVehicle
from sitl_mocks.vehicle_manners import VehicleMode
from sitl_mocks.vehicle_options import VehicleOptions

Use = Literal["guard", "fly"]
_Flat = tuple[float, float]
"""North, east."""
TICK_S: Final = 0.05
_UTC_AT_ZERO_S: Final = 1_767_225_600.0
_HOME: Final = LocalFrame(47.397, 8.545, 400.0)
_HEIGHT_M: Final = 40.0
_WAYPOINTS: Final = ((0.0, 0.0), (200.0, 0.0), (200.0, 150.0), (0.0, 150.0))
_LAUNCH: Final = 20
_PATIENCE_S: Final = 1800.0
"""A flight that is not over by then is stuck."""
_SETTLED_S: Final = 30.0
"""After the last trouble, until the companion must be at work again."""
_ON_GROUND_S: Final = 5.0
_REACTION_S: Final = 0.1
"""From HEARTBEAT or CURRENT_MODE with another mode to the last setpoint."""
_STALE_S: Final = 1.5
"""Setpoints on an own position older than this."""
_TROUBLES: Final = (
    "link", "reboot", "gnss", "estimator", "mode", "sticks", "garbage", "mission", "companion", "late",
)  # fmt: skip
_LIMITS: Final = LimitsConfig(max_speed_mps=6.0)


class BrokenRuleError(Exception):
    """A rule was broken."""


@dataclass(slots=True)
class Told:
    """What came of a soak."""

    hours: float = 0.0
    flights: int = 0
    taken: int = 0
    given_back: int = 0
    yielded: int = 0
    faults: int = 0
    setpoints: int = 0
    troubles: dict[str, int] = field(default_factory=dict)
    memory_mb: list[float] = field(default_factory=list)
    """Resident, at the end of each simulated hour."""


class Soak:
    """One vehicle with one companion.

    Args:
        rng: every draw.
    """

    def __init__(self, firmware: Firmware, use: Use, rng: np.random.Generator) -> None:
        self.told = Told()
        self._rng = rng
        self._use = use
        first = 1 if firmware is Firmware.ARDUPILOT else 0
        self.vehicle = MockVehicle(
            VehicleOptions(
                firmware=firmware,
                mission=_mission(first),
                utc_at_zero_s=_UTC_AT_ZERO_S,
                gnss_horizontal_sigma_m=1.0,
                gnss_vertical_sigma_m=1.5,
                gnss_velocity_sigma_mps=0.1,
                mission_speed_mps=4.0,
            ),
            np.random.default_rng(rng.integers(1 << 32)),
        )
        self.onboard = self._new_companion()
        self.now_s = 0.0
        self._writer = MavlinkWriter(255, 190)
        self._reader = MavlinkReader()  # of what the companion sends
        self._heard = FrameScanner()  # of what it is sent
        self._linked = True
        self._heals: list[tuple[float, Callable[[], None]]] = []
        self._next_trouble_s = 60.0
        self._quiet_from_s = 0.0
        """End of the last trouble."""
        self._flight_s = 0.0
        self._armed_s = 0.0
        self._on_mission_s = 0.0
        """Since when the vehicle flies its mission in the air."""
        self._pilot_s: float | None = None
        """When the pilot acts next."""
        self._others: list[tuple[str, float, _Flat, _Flat]] = []
        self._state = State.STANDBY
        self._pilots_s: float | None = None
        """When a mode that the pilot has chosen was shown."""
        self._chosen: int | None = None
        self._position_s = -math.inf
        self._authority = True
        """Not lost in this flight."""

    def _new_companion(self) -> Onboard:
        fly = {"trajectory": "mission", "mission_speed_mps": 4.0} if self._use == "fly" else {}
        onboard = Onboard(
            Config(
                identity=IdentityConfig(uas_id="SOAK"),
                flight=FlightConfig(use=self._use, **fly),  # type: ignore[arg-type]
                limits=_LIMITS,
                radio=(NullRadio(),),
            )
        )
        onboard.hear(RadioState(can_send=("wifi",)))
        return onboard

    # ------------------------------------------------------------ one step

    def step(self) -> None:
        """One tick of everything.

        Raises:
            BrokenRuleError: a rule was broken.
        """
        self.now_s = round(self.now_s + TICK_S, 6)
        self._heal()
        self._trouble()
        now_s = self.now_s  # later, where the loop was hung
        self._pilot()
        self._cross()
        self.vehicle.advance(now_s)
        self.vehicle.drain(1)
        data = self.vehicle.drain()
        if data and self._linked:
            self.onboard.receive(data, now_s)
            for frame in self._heard.frames(data):
                self._note(frame)
        self.onboard.tick(now_s)
        sent = self.onboard.drain(now_s)
        if self._linked:
            self.vehicle.receive(sent, now_s)
        self._judge(self._reader.feed(sent))

    # ------------------------------------------------------------ rules

    def _note(self, frame: Frame) -> None:
        if frame.message_id == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
            self._position_s = self.now_s
        elif frame.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            mode, _, _, base_mode, *_ = unpack(frame.message_id, frame.payload)
            if base_mode & ARMED:
                self._note_mode(mode)
            else:
                self._pilots_s = self._chosen = None
                self._authority = True
        elif frame.message_id == CURRENT_MODE:
            self._note_mode(unpack(frame.message_id, frame.payload)[0])

    def _note_mode(self, mode: int) -> None:
        if mode == self._chosen and self._pilots_s is None:
            self._pilots_s = self.now_s

    def _judge(self, messages: list[MavlinkMessage]) -> None:
        setpoints = [m for m in messages if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
        self.told.setpoints += len(setpoints)
        state = self.onboard.heart.state
        self._count(state)
        for m in setpoints:
            speed = math.sqrt(m.vx**2 + m.vy**2 + m.vz**2)
            if not speed <= _LIMITS.max_speed_mps + 1e-3:
                raise BrokenRuleError(f"a setpoint of {speed} m/s")
            if not -_LIMITS.max_climb_mps - 1e-3 <= m.vz <= _LIMITS.max_descent_mps + 1e-3:
                raise BrokenRuleError(f"a setpoint that sinks by {m.vz} m/s")
        if not setpoints:
            return
        if self.now_s - self._position_s > _STALE_S:
            raise BrokenRuleError(f"a setpoint on a position {self.now_s - self._position_s:.2f} s old")
        if self._pilots_s is not None and self.now_s - self._pilots_s > _REACTION_S:
            raise BrokenRuleError(
                f"a setpoint {self.now_s - self._pilots_s:.2f} s after the pilot's mode was seen"
            )

    def _count(self, state: State) -> None:
        if state is self._state:
            return
        before, self._state = self._state, state
        told = self.told
        told.taken += state in HOLDING and before not in HOLDING
        told.given_back += state is State.WATCHING and before in HOLDING
        told.faults += state is State.FAULT
        if state is State.YIELDED:
            told.yielded += 1
            self._authority = False

    def _at_work(self) -> bool:
        """What must be so when nothing has been wrong for a while."""
        on_mission = self.vehicle.mode is VehicleMode.MISSION
        return self.onboard.heart.state in HOLDING | ({State.WATCHING} if on_mission else set())

    # ------------------------------------------------------------ the pilot

    def _pilot(self) -> None:
        """Starts the next flight from the ground; brings a vehicle back that hangs somewhere."""
        now_s, vehicle = self.now_s, self.vehicle
        if self._pilot_s is not None and now_s < self._pilot_s:
            return
        self._pilot_s = now_s + 1.0
        if not vehicle.armed:
            if now_s - self._armed_s > _ON_GROUND_S:
                self._begin_flight()
            return
        self._armed_s = now_s
        if now_s - self._flight_s > _PATIENCE_S:
            raise BrokenRuleError(f"a flight of {now_s - self._flight_s:.0f} s: {self._words()}")
        if vehicle.mode is not VehicleMode.MISSION or vehicle.landed is not Landed.IN_AIR:
            self._on_mission_s = now_s
        quiet = now_s - self._quiet_from_s
        if quiet > _SETTLED_S and vehicle.landed is Landed.IN_AIR and not self._at_work():
            if not self._authority:
                self._go_home()
            elif vehicle.mode is not VehicleMode.MISSION:
                self._select(VehicleMode.MISSION)
            elif now_s - self._on_mission_s > _SETTLED_S:
                raise BrokenRuleError(f"nothing wrong for {quiet:.0f} s, and: {self._words()}")
        if self._use == "fly" and now_s - self._flight_s > 600.0:
            self._go_home()  # its path ends in the air

    def _go_home(self) -> None:
        if self.vehicle.mode not in (VehicleMode.RTL, VehicleMode.LAND):
            self._select(VehicleMode.RTL)

    def _begin_flight(self) -> None:
        self.told.flights += 1
        self._flight_s = self.now_s
        self._pilot_s = self.now_s + 5.0
        self.vehicle.pilot_selects(VehicleMode.HOLD)
        self._say(lambda e: e.command_long_encode(1, 1, 400, 0, 1.0, 0, 0, 0, 0, 0, 0))
        if self.vehicle.armed:
            self._say(lambda e: e.mission_set_current_encode(1, 1, 0))
            self.vehicle.pilot_selects(VehicleMode.MISSION)
            self._say(lambda e: e.command_long_encode(1, 1, 300, 0, 0, 0, 0, 0, 0, 0, 0))

    def _select(self, mode: VehicleMode) -> None:
        before = self.vehicle.custom_mode
        # The mode that is flown already, as while the vehicle is being taken, shows in no message.
        if self.vehicle.pilot_selects(mode) and self.vehicle.custom_mode != before and self._state in HOLDING:
            self._chosen = self.vehicle.custom_mode

    def _say(self, pack: Callable[[Any], MavlinkMessage]) -> None:
        """A ground station's message, on a link of its own."""
        self.vehicle.receive(self._writer.pack(pack(self._writer.encoder)), self.now_s, 1)

    def _words(self) -> str:
        heart = self.onboard.heart
        return (
            f"{heart.state.value}, vehicle {self.vehicle.mode.value}, armed {self.vehicle.armed}, waits for "
            f"{heart.waits_for(self.now_s)}, at {[round(x) for x in self.vehicle.position_ned_m]}"
        )

    # ------------------------------------------------------------ troubles

    def _heal(self) -> None:
        due = [heal for at_s, heal in self._heals if at_s <= self.now_s]
        self._heals = [(at_s, heal) for at_s, heal in self._heals if at_s > self.now_s]
        for heal in due:
            heal()

    def _trouble(self) -> None:
        if self.now_s < self._next_trouble_s:
            return
        rng = self._rng
        kind = _TROUBLES[int(rng.integers(len(_TROUBLES)))]
        lasts_s = float(rng.uniform(1.0, 40.0))
        self._next_trouble_s = self.now_s + lasts_s + float(rng.exponential(90.0))
        self._quiet_from_s = self.now_s + lasts_s
        self.told.troubles[kind] = self.told.troubles.get(kind, 0) + 1
        getattr(self, f"_trouble_{kind}")(self.now_s + lasts_s)

    def _trouble_link(self, until_s: float) -> None:
        self._linked = False
        self._heals.append((until_s, lambda: setattr(self, "_linked", True)))

    def _trouble_reboot(self, until_s: float) -> None:
        self.vehicle.reboot(flies_on=True)

    def _trouble_gnss(self, until_s: float) -> None:
        troubles = self.vehicle.troubles
        troubles.gnss_lost = True
        self._heals.append((until_s, lambda: setattr(troubles, "gnss_lost", False)))

    def _trouble_estimator(self, until_s: float) -> None:
        troubles = self.vehicle.troubles
        troubles.estimator_bad = True
        self._heals.append((until_s, lambda: setattr(troubles, "estimator_bad", False)))

    def _trouble_mode(self, until_s: float) -> None:
        modes = (VehicleMode.HOLD, VehicleMode.RTL, VehicleMode.LAND, VehicleMode.MISSION)
        self._select(modes[int(self._rng.integers(len(modes)))])

    def _trouble_sticks(self, until_s: float) -> None:
        troubles, rng = self.vehicle.troubles, self._rng
        roll, pitch, yaw = (float(rng.uniform(-1.0, 1.0)) for _ in range(3))
        troubles.sticks = (roll, pitch, 0.0, yaw)
        self._heals.append((until_s, lambda: setattr(troubles, "sticks", (0.0, 0.0, 0.0, 0.0))))

    def _trouble_garbage(self, until_s: float) -> None:
        data = self._rng.bytes(int(self._rng.integers(1, 5000)))
        self.onboard.receive(data, self.now_s)

    def _trouble_mission(self, until_s: float) -> None:
        """A ground station sends the vehicle to another item."""
        seq = int(self._rng.integers(1, 5))
        self._say(lambda e: e.mission_set_current_encode(1, 1, seq))

    def _trouble_companion(self, until_s: float) -> None:
        """It is started anew, in flight or not."""
        self.onboard = self._new_companion()
        self._reader = MavlinkReader()
        self._state = State.STANDBY
        if self.vehicle.armed:
            self._authority = False

    def _trouble_late(self, until_s: float) -> None:
        """The loop hangs for a while: nothing is taken in meanwhile, nothing leaves."""
        for _ in range(int(self._rng.integers(2, 80))):
            self.now_s = round(self.now_s + TICK_S, 6)
            self.vehicle.advance(self.now_s)

    # ------------------------------------------------------------ traffic

    def _cross(self) -> None:
        """Others that cross the vehicle's way near to it, heard twice a second."""
        rng, now_s = self._rng, self.now_s
        if len(self._others) < 3 and rng.random() < TICK_S / 90.0:
            course, ahead_s = float(rng.uniform(0.0, 2.0 * math.pi)), float(rng.uniform(10.0, 40.0))
            speed = float(rng.uniform(1.0, 15.0))
            velocity = speed * math.cos(course), speed * math.sin(course)
            own, v = self.vehicle.position_ned_m, self.vehicle.velocity_ned_mps
            miss = rng.normal(0.0, 10.0, 2)
            start = tuple(own[c] + ahead_s * (v[c] - velocity[c]) + float(miss[c]) for c in (0, 1))
            self._others.append((f"OTHER{rng.integers(1000)}", now_s, (start[0], start[1]), velocity))
        self._others = [other for other in self._others if now_s - other[1] < 90.0]
        if round(now_s / TICK_S) % 10:
            return
        for name, since_s, start, velocity in self._others:
            passed = now_s - since_s
            north, east = start[0] + passed * velocity[0], start[1] + passed * velocity[1]
            self.onboard.hear(_heard(name, now_s, (north, east), velocity))


def _heard(
    name: str, now_s: float, place: tuple[float, float], velocity: tuple[float, float]
) -> RemoteIdHeard:
    lat_deg, lon_deg, _ = _HOME.to_geodetic(*place, 0.0)
    location = Location(
        status=Status.AIRBORNE,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_geodetic_m=_HOME.alt_m + 47.0 + _HEIGHT_M,
        direction_deg=math.degrees(math.atan2(velocity[1], velocity[0])) % 360.0,
        speed_mps=math.hypot(*velocity),
        vertical_speed_mps=0.0,
        horizontal_accuracy_m=3.0,
        vertical_accuracy_m=3.0,
        speed_accuracy_mps=0.3,
        timestamp_s=math.floor((_UTC_AT_ZERO_S + now_s) * 10.0) / 10.0 % 3600.0,
    )
    identity = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id=name)
    return RemoteIdHeard(transport="wifi", address=name, messages=(identity, location))


def _mission(first: int) -> tuple[MissionItem, ...]:
    """Take-off, three rounds of a rectangle, home."""
    points = [(22, *_WAYPOINTS[0]), *((16, *point) for point in 3 * _WAYPOINTS[1:] + _WAYPOINTS[:1])]
    items = []
    for number, (command, north, east) in enumerate(points):
        lat_deg, lon_deg, _ = _HOME.to_geodetic(north, east, 0.0)
        items.append(
            MissionItem(
                seq=first + number,
                command=command,
                frame=6,
                lat_deg=lat_deg,
                lon_deg=lon_deg,
                alt_m=_HEIGHT_M,
            )
        )
    return (*items, MissionItem(seq=first + len(items), command=_LAUNCH, frame=6))


def soak(firmware: Firmware, use: Use, seed: int, hours: float) -> Told:
    """Fly one pair for some simulated hours.

    Raises:
        BrokenRuleError: with the seed and the time.
    """
    run = Soak(firmware, use, np.random.default_rng(seed))
    steps = round(hours * 3600.0 / TICK_S)
    hour = round(3600.0 / TICK_S)
    for number in range(1, steps + 1):
        try:
            run.step()
        except Exception as error:
            raise BrokenRuleError(
                f"{firmware.value}, {use}, seed {seed}, at {run.now_s:.2f} s: {type(error).__name__}: {error}"
            ) from error
        if number % hour == 0 or number == steps:
            run.told.memory_mb.append(round(_resident_mb(), 1))
    run.told.hours = hours
    return run.told


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `sitl-mocks soak`."""
    parser.description = (
        "Hours of flights with random troubles, in virtual time: both firmwares' manners, guarded and flown. "
        "Ends with 1 when a rule is broken, and says with which seed and when."
    )
    parser.epilog = "example: sitl-mocks soak --hours 24 --seed 1"
    parser.add_argument(
        "--hours", type=float, default=1.0, metavar="H", help="simulated, in all (default: 1)"
    )
    parser.add_argument("--seed", type=int, default=1, help="default: 1")


def run(args: argparse.Namespace) -> int:
    """`sitl-mocks soak`. Returns 0, or 1 where a rule was broken.

    Raises:
        ConfigError: an option out of range.
    """
    if not 0.0 < args.hours <= 1000.0:
        raise ConfigError(f"--hours: {args.hours:g}: allowed above 0 to 1000")
    if args.seed < 0:
        raise ConfigError(f"--seed: {args.seed}: allowed 0 and above")
    pairs: list[tuple[Firmware, Use]] = list(product(Firmware, ("guard", "fly")))
    hours, broken = args.hours / len(pairs), False
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(len(pairs), os.cpu_count() or 1), mp_context=spawn) as pool:
        began = time.monotonic()
        flown = {pool.submit(soak, *pair, args.seed, hours): pair for pair in pairs}
        for future in as_completed(flown):
            firmware, use = flown[future]
            try:
                told = future.result()
            except BrokenRuleError as error:
                print(f"broken: {error}", flush=True)
                broken = True
                continue
            report = {"firmware": firmware.value, "use": use, "after_s": round(time.monotonic() - began, 1)}
            print(json.dumps(report | asdict(told)), flush=True)
    if not broken:
        print(f"{args.hours:g} simulated hours, seed {args.seed}: no rule broken", flush=True)
    return int(broken)
