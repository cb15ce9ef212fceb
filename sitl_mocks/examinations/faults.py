"""Faults in a flight, as entries of a schedule that is drawn in advance and can be shortened.

Each kind has a function that begins it and, if it lasts, one that ends it. `numbers` and `modes` hold the
values drawn for it, so that an entry describes the fault completely.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, Protocol

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkWriter
from companion.errors import ConfigError
from companion.system import CompanionSystem
from sitl_mocks.examinations.modelled_link import ModelledLink
from sitl_mocks.examinations.rule_judge import Judge
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode
from sitl_mocks.vehicle.mock_vehicle import MockVehicle

_PILOTS: Final = (VehicleMode.RTL, VehicleMode.LAND, VehicleMode.HOLD, VehicleMode.MANUAL)
"""Modes that a pilot selects against a companion: RTL, LAND, LOITER or HOLD, STABILIZE or POSCTL."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One entry of a schedule. The meaning of `numbers` depends on `kind`."""

    kind: str
    at_s: float
    lasts_s: float = 0.0
    numbers: tuple[float, ...] = ()
    modes: tuple[str, ...] = ()


def to_json(fault: Fault) -> dict[str, Any]:
    """Plain values of a fault, without empty fields."""
    return {key: value for key, value in asdict(fault).items() if value not in ((), 0.0) or key == "at_s"}


def from_json(value: dict[str, Any]) -> Fault:
    """Read a fault from plain values.

    Raises:
        ConfigError: the value is not a valid fault.
    """
    try:
        fault = Fault(**value)
        fault = replace(fault, numbers=tuple(map(float, fault.numbers)), modes=tuple(fault.modes))
        for mode in fault.modes:
            VehicleMode(mode)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"schedule: {value}: {error}") from error
    if fault.kind not in _BEGIN:
        raise ConfigError(f"schedule: fault kind {fault.kind!r}; allowed: {', '.join(sorted(_BEGIN))}")
    return fault


class Place(Protocol):
    """External access to a vehicle, its companion and the link between them, real or simulated."""

    traffic_hz: float
    """Rate of foreign frames that a router sends to the companion."""

    @property
    def now_s(self) -> float:
        """Clock of the link and the judge."""

    @property
    def link(self) -> ModelledLink:
        """Modelled link in the router."""

    @property
    def judge(self) -> Judge:
        """Judge of this vehicle and companion."""

    def set_trouble(self, name: str, value: Any) -> None:
        """Set a trouble inside the vehicle (`sitl_mocks.vehicle.troubles.Troubles.set`)."""

    def stop(self, for_s: float, *, in_step: bool) -> None:
        """Stall the companion."""

    def pilot_selects(self, *modes: VehicleMode) -> bool:
        """Select modes as the pilot, one after the other within one step of the vehicle.

        Returns whether the vehicle accepted the last one.
        """


class World(Place, Protocol):
    """A place that also gives access to the internals of the vehicle and the companion."""

    @property
    def vehicle(self) -> MockVehicle:
        """The simulated vehicle."""

    @property
    def onboard(self) -> CompanionSystem:
        """The companion's core."""

    def station_says(self, kind: str, *fields: Any) -> None:
        """Send the vehicle a message from a ground station, by its name in the dialect."""

    def restart_companion(self) -> None:
        """Replace the companion by a new one."""


def begin(world: World, fault: Fault) -> None:
    """Begin a fault now."""
    _BEGIN[fault.kind](world, fault)


def end(world: World, fault: Fault) -> None:
    """End a fault. Faults without duration need no action."""
    if fault.kind in _END:
        _END[fault.kind](world, fault)


def begin_outside(place: Place, fault: Fault) -> None:
    """Begin a fault of a kind in `OUTSIDE` now."""
    _BEGIN_OUTSIDE[fault.kind](place, fault)


def end_outside(place: Place, fault: Fault) -> None:
    """End a fault of a kind in `OUTSIDE`."""
    if fault.kind in _END_OUTSIDE:
        _END_OUTSIDE[fault.kind](place, fault)


# ------------------------------------------------------------ the kinds

_Act = Callable[[Place, Fault], None]


def _cut(world: Place, stands: bool) -> None:
    weather = world.link.weather
    weather.down_stands = weather.up_stands = stands


def _set(name: str, before: Any) -> tuple[_Act, _Act]:
    """Begin and end of a link fault. Its number is the new value (True if it has none), and `before` is the
    normal value.
    """

    def begins(world: Place, fault: Fault) -> None:
        setattr(world.link.weather, name, fault.numbers[0] if fault.numbers else True)

    def ends(world: Place, fault: Fault) -> None:
        setattr(world.link.weather, name, before)

    return begins, ends


def _late(world: Place, fault: Fault) -> None:
    """Delay everything in the router. The judge then allows as much more time for messages that cross."""
    world.link.weather.delay_s = fault.numbers[0]
    world.judge.crossing_s += fault.numbers[0]


def _in_time(world: Place, fault: Fault) -> None:
    world.link.weather.delay_s = 0.0
    world.judge.crossing_s -= fault.numbers[0]


def _fast(world: Place, fault: Fault) -> None:
    world.link.weather.rate_bps = math.inf
    world.link.hurry(world.now_s)


def _trouble(name: str, value: Any, before: Any) -> tuple[_Act, _Act]:
    """Begin and end of a trouble inside the vehicle, from its value and the normal value."""

    def begins(world: Place, fault: Fault) -> None:
        world.set_trouble(name, value)

    def ends(world: Place, fault: Fault) -> None:
        world.set_trouble(name, before)

    return begins, ends


def _burst(world: Place, fault: Fault) -> None:
    """Send foreign frames, all at once."""
    frames = others_frames()
    world.link.tell(world.now_s, [frames[n % len(frames)] for n in range(int(fault.numbers[0]))])


def _traffic(world: Place, fault: Fault) -> None:
    world.traffic_hz = fault.numbers[0]


def _no_traffic(world: Place, fault: Fault) -> None:
    world.traffic_hz = 0.0


def _stall(world: Place, fault: Fault) -> None:
    """The number selects where the companion stalls: 1 is between a step and its sending."""
    world.stop(fault.lasts_s, in_step=bool(fault.numbers and fault.numbers[0]))


def _modes(world: Place, fault: Fault) -> None:
    world.pilot_selects(*(VehicleMode(mode) for mode in fault.modes))


def _mission(world: World, fault: Fault) -> None:
    """Send MISSION_SET_CURRENT from a ground station."""
    world.station_says("mission_set_current", 1, 1, int(fault.numbers[0]))


def _garbage(world: World, fault: Fault) -> None:
    seed, size = fault.numbers
    world.onboard.receive(np.random.default_rng(int(seed)).bytes(int(size)), world.now_s)


def _sticks(world: Place, fault: Fault) -> None:
    roll, pitch, yaw = fault.numbers
    world.set_trouble("sticks", (roll, pitch, 0.0, yaw))


_BEGIN_OUTSIDE: Final[dict[str, _Act]] = {
    "link": lambda w, f: _cut(w, stands=True),
    "mode": _modes,
    "stall": _stall,
    "burst": _burst,
    "traffic": _traffic,
    "late": _late,
    "duplicate": _set("duplicate", 0.0)[0],
    "reorder": _set("reorder", 0.0)[0],
    "slow": _set("rate_bps", math.inf)[0],
    "down": _set("down_stands", False)[0],
    "up": _set("up_stands", False)[0],
    "disobeyed": _trouble("answers", "disobeyed", "right")[0],
    "unanswered": _trouble("answers", "unanswered", "right")[0],
    "denied": _trouble("answers", "denied", "right")[0],
}
_END_OUTSIDE: Final[dict[str, _Act]] = {
    "link": lambda w, f: _cut(w, stands=False),
    "traffic": _no_traffic,
    "late": _in_time,
    "duplicate": _set("duplicate", 0.0)[1],
    "reorder": _set("reorder", 0.0)[1],
    "slow": _fast,
    "down": _set("down_stands", False)[1],
    "up": _set("up_stands", False)[1],
    "disobeyed": _trouble("answers", "disobeyed", "right")[1],
    "unanswered": _trouble("answers", "unanswered", "right")[1],
    "denied": _trouble("answers", "denied", "right")[1],
}
OUTSIDE: Final = tuple(_BEGIN_OUTSIDE)
"""Kinds that need only external access to vehicle and companion."""
_BEGIN: Final[dict[str, Callable[[World, Fault], None]]] = {
    **_BEGIN_OUTSIDE,
    "reboot": lambda w, f: w.vehicle.reboot(flies_on=True),
    "gnss": _trouble("gnss_lost", True, False)[0],
    "estimator": _trouble("estimator_bad", True, False)[0],
    "sticks": _sticks,
    "garbage": _garbage,
    "mission": _mission,
    "companion": lambda w, f: w.restart_companion(),
}
_END: Final[dict[str, Callable[[World, Fault], None]]] = {
    **_END_OUTSIDE,
    "gnss": _trouble("gnss_lost", True, False)[1],
    "estimator": _trouble("estimator_bad", True, False)[1],
    "sticks": _trouble("sticks", None, (0.0, 0.0, 0.0, 0.0))[1],
}
KINDS: Final = tuple(_BEGIN)


def others_frames() -> list[bytes]:
    """Foreign frames that a router sends: a neighbour's telemetry, a ground station, a radio."""
    neighbour, station, radio = MavlinkWriter(77, 1), MavlinkWriter(255, 190), MavlinkWriter(51, 68)
    frames = []
    for n in range(20):
        messages: list[tuple[MavlinkWriter, Any]] = [
            (neighbour, mavlink.MAVLink_attitude_message(1000 + 50 * n, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0)),
            (neighbour, mavlink.MAVLink_vfr_hud_message(5.0, 5.0, 90, 30, 440.0, 0.1)),
            (neighbour, mavlink.MAVLink_servo_output_raw_message(n, 0, *range(1500, 1508))),
        ]
        if n % 10 == 0:
            messages.append((station, mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)))
        if n % 5 == 0:
            messages.append((radio, mavlink.MAVLink_radio_status_message(200, 190, 90, 40, 40, 0, 0)))
        frames += [writer.pack(message) for writer, message in messages]
    return frames


# ------------------------------------------------------------ drawing


def drawn(kind: str, at_s: float, lasts_s: float, rng: np.random.Generator) -> Fault:
    """Draw a fault of a kind with all its values."""
    numbers: tuple[float, ...] = ()
    modes: tuple[str, ...] = ()
    match kind:
        case "mode":
            modes = tuple(str(rng.choice([m.value for m in _PILOTS])) for _ in range(1 + rng.integers(2)))
        case "sticks":
            numbers = tuple(float(rng.uniform(-1.0, 1.0)) for _ in range(3))
        case "garbage":
            numbers = float(rng.integers(1 << 32)), float(rng.integers(1, 5000))
        case "mission":
            numbers = (float(rng.integers(1, 5)),)
        case "stall":
            lasts_s = float(np.exp(rng.uniform(np.log(0.05), np.log(20.0))))
            numbers = (float(rng.random() < 0.3),)
        case "burst":
            numbers = (float(rng.integers(10, 1000)),)
        case "traffic":
            numbers = (float(np.exp(rng.uniform(np.log(10.0), np.log(500.0)))),)
        case "late":
            numbers = (float(rng.uniform(0.02, 3.0)),)
        case "duplicate" | "reorder":
            numbers = (float(rng.uniform(0.05, 0.5)),)
        case "slow":
            numbers = (float(rng.uniform(2e3, 1e5)),)
    moment = kind in ("reboot", "mode", "garbage", "mission", "companion", "burst")
    return Fault(kind, round(at_s, 3), 0.0 if moment else round(lasts_s, 3), numbers, modes)
