"""Reads a telemetry log (.tlog) of any MAVLink vehicle, with or without a companion.

Every system that sends an autopilot's HEARTBEAT becomes one aircraft. Its messages become the same events
that a companion's link would make of them. Setpoints sent to it by any system become commands. Traffic that
it relays (ADS-B, Remote ID) becomes heard traffic. Data that only a companion has is missing: decisions,
tracks, authority. The log is streamed, and only `Facts` are kept.

Times are the log's own timestamps, corrected so that they never decrease; damaged ones are replaced. They are
UTC by the clock of the program that wrote the log. The vehicles' SYSTEM_TIME gives the error of that clock,
which is stored in `Facts.utc_offset_s`.
"""

from __future__ import annotations

import itertools
import math
from array import array
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot import remote_id
from companion.autopilot.dialect import AUTOPILOT_INVALID, FIRMWARES, FRAME_LOCAL_NED
from companion.autopilot.encoders import AUTOPILOT_COMPONENT, MAX_SETPOINT_MPS
from companion.autopilot.heard_vehicle import REBOOT_STEP_S
from companion.autopilot.readers import READERS, Fields, heartbeat, unpack
from companion.autopilot.remote_id import RemoteIdCounts, RemoteIdListener
from companion.autopilot.statustext import TextAssembler
from companion.autopilot.tlog import TlogCounts, read_tlog
from companion.autopilot.wire import MAGIC_V1, Frame, cut, is_known, message_id_of
from companion.errors import PeerDataError
from companion.event_record import Step
from companion.events import (
    AdsbVehicle,
    AnyEvent,
    GlobalPosition,
    GnssFix,
    LocalPosition,
    RemoteIdHeard,
    VehicleText,
    VehicleTime,
    VelocitySetpoint,
)
from ground_tools.inspect.read.facts import UTC_NOISE_S, Facts, Gatherer
from ground_tools.inspect.read.link_health import LinkHealth, Tally
from ground_tools.inspect.read.modes import mode_name

SET_BACK_S = 1.0
"""A timestamp earlier than the last one by more than this means that the clock was set back; time then
continues from the last timestamp. A smaller step means that records were logged out of order."""
ALONE_S = 3600.0
"""A first or last timestamp that is farther than this from its neighbours is a damaged one."""
_HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
_TEXT = mavlink.MAVLINK_MSG_ID_STATUSTEXT
_RADIO = mavlink.MAVLINK_MSG_ID_RADIO_STATUS
_SETPOINTS = {
    # MAV_FRAMEs whose velocity is in north, east, down. In the others it is relative to the vehicle's
    # heading.
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: (
        FRAME_LOCAL_NED,
        mavlink.MAV_FRAME_LOCAL_OFFSET_NED,
    ),
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: (
        mavlink.MAV_FRAME_GLOBAL_INT,
        mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
        mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT,
    ),
}
_VELOCITY_IGNORED = (
    mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VY_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VZ_IGNORE
)
_WANTED = frozenset({_HEARTBEAT, _TEXT, *READERS, *_SETPOINTS, *remote_id.MESSAGE_IDS})
_FIX_3D = mavlink.GPS_FIX_TYPE_3D_FIX
_STATION_FROM_ID = 240
"""Least system id of a ground station: QGroundControl and Mission Planner use 255."""


@dataclass(frozen=True, slots=True)
class LoggedVehicle:
    """One vehicle in a log."""

    system_id: int
    facts: Facts
    link: LinkHealth
    steps: Callable[[], Iterator[Step]]
    """Yields one step for each relevant message. Each call reads the file again."""
    about: str
    """Kind of vehicle and flight modes used, as text."""
    missing: tuple[str, ...]
    """What the log does not contain about the vehicle, as text."""


@dataclass(frozen=True, slots=True)
class Tlog:
    """Content of one log."""

    vehicles: tuple[LoggedVehicle, ...]
    """Vehicles in order of their system ids; empty if no autopilot's HEARTBEAT was logged."""
    counts: TlogCounts
    problems: tuple[str, ...]
    """Damage, one line each."""
    tells_utc: bool
    """True if a vehicle sent UTC (SYSTEM_TIME)."""


def read(path: Path) -> Tlog:
    """Read a log in one pass.

    Raises:
        PeerDataError: The file is not a telemetry log.
        OSError: The file cannot be read.
    """
    counts, clock, tally = TlogCounts(), _Clock(), Tally()
    vehicles: dict[int, _Vehicle] = {}
    gatherers: dict[int, Gatherer] = {}
    for now_s, frame in _frames(path, counts, clock, tally):
        if frame.component_id == AUTOPILOT_COMPONENT and frame.system_id not in vehicles:
            vehicles[frame.system_id] = _Vehicle(frame.system_id)
            gatherers[frame.system_id] = Gatherer()
        for system_id, vehicle in _concerned(frame, vehicles):
            step = vehicle.step(now_s, frame)
            if step is not None:
                gatherers[system_id].step(step)
    known = {system: one for system, one in sorted(vehicles.items()) if one.is_vehicle}
    facts = {system: gatherers[system].facts() for system in known}
    told = [one.utc_offset_s for one in facts.values() if one.utc_offset_s is not None]
    # One log has one clock, so its error is the same for all vehicles.
    offset = float(np.median(told)) if told else 0.0
    problems = _damage(path.name, counts, clock)
    if told and max(told) - min(told) > UTC_NOISE_S:
        offset = min(told, key=abs)
        problems += (
            f"{path.name}: its vehicles report UTCs {max(told) - min(told):.0f} s apart; the one that "
            "is nearest to the log's own time stamps is used",
        )
    return Tlog(
        tuple(
            LoggedVehicle(
                system_id=system,
                facts=replace(facts[system], utc_offset_s=offset),
                link=tally.health(one.reboots, counts, one.bad_values),
                steps=partial(_steps, path, system),
                about=one.kind_and_modes(),
                missing=_missing(facts[system], one),
            )
            for system, one in known.items()
        ),
        counts,
        problems,
        bool(told),
    )


def read_health(path: Path) -> LinkHealth:
    """Read only the quality of the link, without reboots and bad values, and what is damaged."""
    counts, clock, tally = TlogCounts(), _Clock(), Tally()
    failed: tuple[str, ...] = ()
    try:
        for _ in _frames(path, counts, clock, tally, frozenset()):
            pass
    except PeerDataError as error:
        failed = (str(error),)
    except OSError as error:
        failed = (f"{path.name}: cannot be read: {error.strerror}",)
    problems = (*_damage(path.name, counts, clock), *failed)
    return replace(tally.health(array("d"), counts, 0), problems=problems)


def _steps(path: Path, system_id: int) -> Iterator[Step]:
    vehicles = {system_id: _Vehicle(system_id)}
    for now_s, frame in _frames(path, TlogCounts(), _Clock(), None):
        for _, vehicle in _concerned(frame, vehicles):
            step = vehicle.step(now_s, frame)
            if step is not None:
                yield step


def _frames(
    path: Path,
    counts: TlogCounts,
    clock: _Clock,
    tally: Tally | None,
    wanted: frozenset[int] = _WANTED,
) -> Iterator[tuple[float, Frame]]:
    """Yield the frames of the wanted messages with their times; count all frames in `counts` and `tally`."""
    with path.open("rb") as stream:
        for now_s, raw in clock.rising(read_tlog(stream, path.name, counts)):
            message_id = message_id_of(raw)
            if tally is not None:
                number, system, component = raw[2:5] if raw[0] == MAGIC_V1 else raw[4:7]
                tally.frame(now_s, system, component, number)
                tally.unknown += not is_known(message_id)
            # All wanted messages are known ones, so the log reader has verified their checksums.
            if message_id in wanted:
                yield now_s, cut(raw)
            elif message_id == _RADIO and tally is not None:
                tally.radio(now_s, unpack(message_id, cut(raw).payload))


def _concerned(frame: Frame, vehicles: dict[int, _Vehicle]) -> Iterable[tuple[int, _Vehicle]]:
    """Return the vehicles that a frame may concern. Other systems send setpoints and Remote ID, too."""
    if frame.message_id in _SETPOINTS or frame.message_id in remote_id.MESSAGE_IDS:
        return vehicles.items()
    one = vehicles.get(frame.system_id)
    return () if one is None else ((frame.system_id, one),)


@dataclass(slots=True)
class _Clock:
    """Turns timestamps into times that never decrease.

    A timestamp has no checksum. One that jumps, while the next one goes on from the one before, is damaged: a
    single wrong bit may put it years away.
    """

    last_s: float = -math.inf
    shift_s: float = 0.0
    set_back: int = 0
    damaged: int = 0

    def rising(self, records: Iterable[tuple[float, bytes]]) -> Iterator[tuple[float, bytes]]:
        """Yield records with corrected times: the timestamp, or the last one if that is later."""
        coming = iter(records)
        ahead = deque(itertools.islice(coming, 3))
        before_s: float | None = None
        """The last undamaged timestamp."""
        while ahead:
            utc_s, raw = ahead.popleft()
            if before_s is None:
                instead_s = _instead_of_first(utc_s, [later_s for later_s, _ in ahead])
            else:
                instead_s = _instead(before_s, utc_s, ahead[0][0] if ahead else None)
            if instead_s is not None:
                self.damaged += 1
            before_s = utc_s if instead_s is None else instead_s
            yield self._next(before_s), raw
            ahead.extend(itertools.islice(coming, 1))

    def _next(self, utc_s: float) -> float:
        now_s = utc_s + self.shift_s
        if now_s < self.last_s - SET_BACK_S:
            self.set_back += 1
            self.shift_s += self.last_s - now_s
            now_s = self.last_s
        self.last_s = max(now_s, self.last_s)
        return self.last_s


def _instead(before_s: float, utc_s: float, after_s: float | None) -> float | None:
    """Return the time to use instead of a timestamp between two others; None if it is not damaged."""
    if abs(utc_s - before_s) <= SET_BACK_S:
        return None
    if after_s is None:
        return before_s if abs(utc_s - before_s) > ALONE_S else None
    goes_on = after_s >= before_s - SET_BACK_S
    leaps = utc_s > after_s + SET_BACK_S or utc_s < before_s - SET_BACK_S
    return before_s if goes_on and leaps else None


def _instead_of_first(utc_s: float, later_s: Sequence[float]) -> float | None:
    """Return the time to use instead of the first timestamp; None if it is not damaged."""
    far = bool(later_s) and all(abs(utc_s - one_s) > ALONE_S for one_s in later_s)
    return later_s[0] if far else None


@dataclass(slots=True)
class _Vehicle:
    """Converts messages from, to and about one vehicle to events and commands."""

    system_id: int
    is_vehicle: bool = False
    bad_values: int = 0
    turned_setpoints: int = 0
    """Number of setpoints that are not a velocity in north, east, down."""
    own_remote_id: int = 0
    """Number of own Remote ID messages over MAVLink, from any component of this system."""
    has_fix: bool = False
    """True if there was a 3D GNSS fix."""
    reboots: array[float] = field(default_factory=lambda: array("d"))
    seen: set[type] = field(default_factory=set)
    kinds: dict[str, None] = field(default_factory=dict)
    modes: dict[str, None] = field(default_factory=dict)
    _boot_s: float = 0.0
    _texts: TextAssembler = field(default_factory=TextAssembler)
    _listener: RemoteIdListener = field(
        default_factory=lambda: RemoteIdListener(RemoteIdCounts(), frozenset({AUTOPILOT_COMPONENT}), None)
    )

    def step(self, now_s: float, frame: Frame) -> Step | None:
        """Return the events and commands of a frame; None if there are none."""
        try:
            commands = self._setpoint(frame) if frame.message_id in _SETPOINTS else ()
            events = () if frame.message_id in _SETPOINTS else tuple(self._events(now_s, frame))
        except PeerDataError:
            self.bad_values += 1
            return None
        if not events and not commands:
            return None
        self.seen.update(map(type, events), map(type, commands))
        return Step(now_s=now_s, events=events, commands=commands)

    def kind_and_modes(self) -> str:
        """Return the kind of vehicle and the flight modes used."""
        modes = f"; modes {', '.join(self.modes)}" if self.modes else ""
        return f"{' then '.join(self.kinds)}{modes}"

    def _events(self, now_s: float, frame: Frame) -> Sequence[AnyEvent]:
        message_id = frame.message_id
        if message_id in remote_id.MESSAGE_IDS:
            return self._remote_id(now_s, frame)
        fields = unpack(message_id, frame.payload)
        if message_id == _TEXT:
            return self._text(now_s, frame.component_id, fields)
        if frame.component_id != AUTOPILOT_COMPONENT:
            return []
        if message_id == _HEARTBEAT:
            return [*self._texts.overdue(now_s), *self._beat(fields)]
        event = READERS[message_id](fields)
        if event is None:
            return []
        if isinstance(event, GlobalPosition | LocalPosition | VehicleTime):
            if event.time_boot_s < self._boot_s - REBOOT_STEP_S:
                self.reboots.append(now_s)
            self._boot_s = event.time_boot_s
        elif isinstance(event, GnssFix):
            self.has_fix |= event.fix_type >= _FIX_3D
        return [event]  # type: ignore[list-item]

    def _beat(self, fields: Fields) -> Sequence[AnyEvent]:
        _mode, vehicle_type, autopilot, *_ = fields
        if vehicle_type == mavlink.MAV_TYPE_GCS or autopilot == AUTOPILOT_INVALID:
            return []
        self.is_vehicle = True
        self.kinds[f"{_word('MAV_AUTOPILOT', autopilot)} {_word('MAV_TYPE', vehicle_type)}"] = None
        if autopilot not in FIRMWARES:
            return []
        beat = heartbeat(self.system_id, fields)
        self.modes[mode_name(beat)] = None
        return [beat]

    def _text(self, now_s: float, component_id: int, fields: Fields) -> Sequence[AnyEvent]:
        if component_id == AUTOPILOT_COMPONENT:
            return [*self._texts.feed(fields, now_s)]
        # Texts of other components are rare, so each chunk is shown on its own.
        chunk = (*fields[:2], 0, 0)
        return [
            VehicleText(severity=text.severity, text=f"component {component_id}: {text.text}")
            for text in TextAssembler().feed(chunk, now_s)
        ]

    def _setpoint(self, frame: Frame) -> tuple[VelocitySetpoint, ...]:
        fields = unpack(frame.message_id, frame.payload)
        velocity = fields[4:7]
        mask, target_system, target_component, axes = fields[12:16]
        if target_system not in (0, self.system_id) or target_component not in (0, AUTOPILOT_COMPONENT):
            return ()
        # NaN fails the comparison, infinity exceeds it.
        sane = math.hypot(*velocity) <= MAX_SETPOINT_MPS
        if mask & _VELOCITY_IGNORED or axes not in _SETPOINTS[frame.message_id] or not sane:
            self.turned_setpoints += 1
            return ()
        return (VelocitySetpoint(velocity_ned_mps=velocity),)

    def _remote_id(self, now_s: float, frame: Frame) -> Sequence[AnyEvent]:
        if frame.system_id != self.system_id and frame.system_id < _STATION_FROM_ID:
            return []
        self._listener.begin()
        event = self._listener.event(frame, self.system_id, now_s)
        if event is None:
            self.own_remote_id += frame.system_id == self.system_id
            return []
        return [event]  # type: ignore[list-item]


def _word(enum: str, value: int) -> str:
    """Return the name of a MAVLink enum entry in words: MAV_TYPE_GROUND_ROVER is a "ground rover"."""
    entry = mavlink.enums[enum].get(value)
    if entry is None:
        return f"{enum} {value}"
    words: str = entry.name.removeprefix(f"{enum}_").replace("_", " ").lower()
    return {"ardupilotmega": "ArduPilot", "px4": "PX4", "generic": "unknown autopilot"}.get(words, words)


def _missing(facts: Facts, vehicle: _Vehicle) -> tuple[str, ...]:
    """List what the log does not contain."""
    words = []
    if not vehicle.modes:
        words.append("flight modes (its autopilot is neither ArduPilot nor PX4)")
    if not len(facts.fixes):
        words.append("position")
    if GlobalPosition not in vehicle.seen and LocalPosition in vehicle.seen:
        words[-1] = "position on Earth (only relative to its own origin)"
    if not vehicle.has_fix:
        words.append("GNSS fix")
    if VelocitySetpoint not in vehicle.seen:
        turned = f" ({vehicle.turned_setpoints} of other kinds)" if vehicle.turned_setpoints else ""
        words.append(f"velocity setpoints{turned}")
    if RemoteIdHeard not in vehicle.seen:
        words.append("Remote ID of others")
    if not vehicle.own_remote_id:
        words.append("own Remote ID")
    if AdsbVehicle not in vehicle.seen:
        words.append("ADS-B traffic")
    return (*words, "a companion's decisions")


def _damage(name: str, counts: TlogCounts, clock: _Clock) -> tuple[str, ...]:
    found = []
    if counts.corrupt_spans:
        found.append(
            f"{name}: {counts.corrupt_spans} damaged spans ({counts.corrupt_bytes} bytes) were skipped"
        )
    if counts.torn_bytes:
        found.append(
            f"{name}: the file is cut off; its last {counts.torn_bytes} bytes are not a whole record"
        )
    if clock.damaged:
        found.append(
            f"{name}: {clock.damaged} records have a damaged time stamp; that of a neighbour is used instead"
        )
    if clock.set_back:
        found.append(
            f"{name}: its clock was set back {clock.set_back} times; times continue from the last one before"
        )
    return tuple(found)
