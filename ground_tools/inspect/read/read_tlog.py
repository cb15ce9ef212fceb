"""Reading a telemetry log (.tlog) of any MAVLink vehicle, with or without a companion.

Every system with an autopilot's HEARTBEAT becomes an aircraft of its own. Its messages become the same events
that a companion's link makes of them, setpoints that anybody sends it become commands, and what it relays of
others (ADS-B, Remote ID) becomes heard traffic. What only a companion knows is not there: decisions, tracks,
authority. The log is streamed: nothing of it is kept but `Facts`.

Times are the log's own stamps, made to rise: UTC by the clock of whoever wrote it. The vehicles' SYSTEM_TIME
says how far that clock was off, and `Facts.utc_offset_s` is that.
"""

from __future__ import annotations

import math
from array import array
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
from ground_tools.inspect.read.facts import Facts, Gatherer
from ground_tools.inspect.read.link_health import LinkHealth, Tally
from ground_tools.inspect.read.modes import mode_name

SET_BACK_S = 1.0
"""A stamp this much before the last one: the clock was set back, and the log goes on from where it was. Less
is records that overtook each other."""
_HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
_TEXT = mavlink.MAVLINK_MSG_ID_STATUSTEXT
_RADIO = mavlink.MAVLINK_MSG_ID_RADIO_STATUS
_SETPOINTS = {
    # MAV_FRAME in which the velocity is north, east, down; in the others it turns with the nose.
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
_VELOCITY_IGNORED = 8 | 16 | 32
"""POSITION_TARGET_TYPEMASK of the three velocity axes."""
_WANTED = frozenset({_HEARTBEAT, _TEXT, *READERS, *_SETPOINTS, *remote_id.MESSAGE_IDS})
_FIX_3D = 3
_STATION_FROM_ID = 240
"""Ground stations have system ids from here on: QGroundControl and Mission Planner are 255."""


@dataclass(frozen=True, slots=True)
class LoggedVehicle:
    """One vehicle of a log."""

    system_id: int
    facts: Facts
    link: LinkHealth
    steps: Callable[[], Iterator[Step]]
    """One for each message that tells something, read from the file anew."""
    about: str
    """Kind of vehicle and modes flown, in words."""
    missing: tuple[str, ...]
    """What the log does not tell of it, in words."""


@dataclass(frozen=True, slots=True)
class Tlog:
    """What one log held."""

    vehicles: tuple[LoggedVehicle, ...]
    """In order of their system ids; none where nobody sent an autopilot's HEARTBEAT."""
    counts: TlogCounts
    problems: tuple[str, ...]
    """Damage, one line each."""
    tells_utc: bool
    """A vehicle told UTC: SYSTEM_TIME."""


def read(path: Path) -> Tlog:
    """Read a log once.

    Raises:
        PeerDataError: not a telemetry log.
        OSError: it cannot be read.
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
    # One log has one clock: it was off by the same for all.
    offset = float(np.median(told)) if told else 0.0
    problems = _damage(path.name, counts, clock)
    return Tlog(
        tuple(
            LoggedVehicle(
                system_id=system,
                facts=replace(facts[system], utc_offset_s=offset),
                link=tally.health(one.reboots, counts, one.bad_values),
                steps=partial(_steps, path, system),
                about=one.about(),
                missing=_missing(facts[system], one),
            )
            for system, one in known.items()
        ),
        counts,
        problems,
        bool(told),
    )


def read_health(path: Path) -> LinkHealth:
    """Only how well the link carried; reboots and bad values are not looked for.

    Raises:
        PeerDataError: not a telemetry log.
        OSError: it cannot be read.
    """
    counts, tally = TlogCounts(), Tally()
    for _ in _frames(path, counts, _Clock(), tally, frozenset()):
        pass
    return tally.health(array("d"), counts, 0)


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
    """Frames of the wanted messages, all of them counted."""
    with path.open("rb") as stream:
        for utc_s, raw in read_tlog(stream, path.name, counts):
            now_s = clock.rising(utc_s)
            message_id = message_id_of(raw)
            if tally is not None:
                number, system, component = raw[2:5] if raw[0] == MAGIC_V1 else raw[4:7]
                tally.frame(now_s, system, component, number)
                tally.unknown += not is_known(message_id)
            # Of messages that are known, which all of these are, the log's reader has seen the checksum.
            if message_id in wanted:
                yield now_s, cut(raw)
            elif message_id == _RADIO and tally is not None:
                tally.radio(now_s, unpack(message_id, cut(raw).payload))


def _concerned(frame: Frame, vehicles: dict[int, _Vehicle]) -> Iterable[tuple[int, _Vehicle]]:
    """Whom a frame may tell something: setpoints and Remote ID come from others, too."""
    if frame.message_id in _SETPOINTS or frame.message_id in remote_id.MESSAGE_IDS:
        return vehicles.items()
    one = vehicles.get(frame.system_id)
    return () if one is None else ((frame.system_id, one),)


@dataclass(slots=True)
class _Clock:
    """Stamps that never fall."""

    last_s: float = -math.inf
    shift_s: float = 0.0
    set_back: int = 0

    def rising(self, utc_s: float) -> float:
        """The stamp, or the last one where it is earlier."""
        now_s = utc_s + self.shift_s
        if now_s < self.last_s - SET_BACK_S:
            self.set_back += 1
            self.shift_s += self.last_s - now_s
            now_s = self.last_s
        self.last_s = max(now_s, self.last_s)
        return self.last_s


@dataclass(slots=True)
class _Vehicle:
    """Messages of, to and about one vehicle, to events and commands."""

    system_id: int
    is_vehicle: bool = False
    bad_values: int = 0
    turned_setpoints: int = 0
    """Setpoints that are no velocity north, east, down."""
    own_remote_id: int = 0
    """Own Remote ID told over MAVLink, by whomever of this system."""
    has_fix: bool = False
    """GNSS, in three dimensions."""
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
        """What the frame told, if anything."""
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

    def about(self) -> str:
        """Kind of vehicle and modes flown."""
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
        # Components send chunks of their own; theirs are rare, and shown as they come.
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
    """A name of MAVLink's, in words: MAV_TYPE_GROUND_ROVER is a ground rover."""
    entry = mavlink.enums[enum].get(value)
    if entry is None:
        return f"{enum} {value}"
    words: str = entry.name.removeprefix(f"{enum}_").replace("_", " ").lower()
    return {"ardupilotmega": "ArduPilot", "px4": "PX4", "generic": "unknown autopilot"}.get(words, words)


def _missing(facts: Facts, vehicle: _Vehicle) -> tuple[str, ...]:
    """What the log does not tell."""
    words = []
    if not vehicle.modes:
        words.append("flight modes (its autopilot is neither ArduPilot nor PX4)")
    if not len(facts.fixes):
        words.append("position")
    if GlobalPosition not in vehicle.seen and LocalPosition in vehicle.seen:
        words[-1] = "position on Earth (only one from its own origin)"
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
            f"{name}: {counts.corrupt_spans} damaged spans ({counts.corrupt_bytes} bytes) stepped over"
        )
    if counts.torn_bytes:
        found.append(f"{name}: torn: the last {counts.torn_bytes} bytes are no whole record")
    if clock.set_back:
        found.append(f"{name}: its clock was set back {clock.set_back} times; time goes on from there")
    return tuple(found)
