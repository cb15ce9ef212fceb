"""Replays recorded input through the core.

An event record holds the input and the commands of the core. The same input must give the same commands, bit
for bit if software and machine are the same. A tlog holds a vehicle's MAVLink. It is passed through the link
and the core as if that vehicle flew now, but nothing is commanded. An onboard log's events go to the core.
"""

from __future__ import annotations

import bisect
import dataclasses
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import cast

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.counts import LinkCounts
from companion.autopilot.dialect import CMD_DO_SET_MODE, DIALECTS
from companion.autopilot.dialects.definition import CUSTOM_MODE_ENABLED
from companion.autopilot.encoders import Outgoing, command_long, velocity_setpoint
from companion.autopilot.wire import MavlinkWriter, message_id_of
from companion.config import Config, IdentityConfig
from companion.core import Companion
from companion.errors import PeerDataError
from companion.event_record import Header, Record, Step
from companion.events import (
    AnyCommand,
    AnyEvent,
    Broadcast,
    Command,
    GateRefused,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    InputBehind,
    RadioState,
    RemoteIdModule,
    SetMode,
    VelocitySetpoint,
)
from companion.gate.gate import STALL_S, Gate
from companion.gate.rules import Rule
from companion.remote_id import codec
from companion.remote_id.messages import Location
from companion.system import CompanionSystem

STEP_S = 0.05
ELSEWHERE = 1e-9
"""Largest relative difference of a number that is accepted from another machine or version."""
_NEAR_ZERO = 10.0
"""Factor from the relative tolerance to the absolute one, which applies near zero. Positions are differences
of Earth-centred coordinates of about 6e6 m, where adjacent floating-point numbers are 9.3e-10 m apart, and
another machine's rounding changes the result by a few of these steps."""

_SILENT_S = 5.1
"""The gate reports the same rule at most once in five seconds."""
_LATER_S = 1.0
"""A command may wait this long for the vehicle's answer, and be refused only then."""
_TIMED = frozenset(
    rule.value.name for rule in (Rule.WHOLE, Rule.KIND, Rule.CURRENT, Rule.AUTHORITY, Rule.AGE, Rule.ANSWER)
)
"""Rules about frames that no record holds, or about when messages arrived between two steps. By them the gate
of a replay judges some commands otherwise, without any change of the software."""
_RULES = {rule.number: rule for rule in Rule}
_TEXTS = frozenset({"text", "reason"})
"""Fields of commands that are written for people. A new version may say them in other words."""


@dataclass(slots=True)
class RecordReplay:
    """Result of replaying one event record."""

    aircraft: str = ""
    steps: int = 0
    commands: int = 0
    differences: int = 0
    """Number of steps whose commands differ beyond the tolerance."""
    inexact: int = 0
    """Number of steps whose commands differ, but within the tolerance."""
    reworded: int = 0
    """Number of the differing steps whose commands differ only in texts for people."""
    first: str | None = None
    """The first difference, in words; None if there is none."""
    refused: dict[str, int] = field(default_factory=dict)
    """Number of commands that the gate would refuse now, by the name of the rule."""
    refused_anew: dict[str, int] = field(default_factory=dict)
    """Those of them that were not refused in flight, according to the record."""
    passed_anew: dict[str, int] = field(default_factory=dict)
    """Number of refusals in the record that the gate would not repeat now, by the name of the rule."""
    unread_bytes: int = 0
    """Size of an incomplete record at the end of the file, which is not compared."""


def replay_record(records: Iterable[Record], name: str, tolerance: float) -> RecordReplay:
    """Run the core on a record's input and compare the commands with the recorded ones.

    Args:
        records: from `companion.event_record.read`.
        name: name of the file, for messages.
        tolerance: largest relative difference of numbers that count as equal. The absolute tolerance (m, m/s)
            is ten times this number. 0 compares bit for bit.

    Raises:
        PeerDataError: the record does not begin with its header.
    """
    result = RecordReplay()
    core: Companion | None = None
    gate: _GateAgain | None = None
    for item in records:
        if isinstance(item, Header):
            core, result.aircraft = Companion(item.config, item.policy), item.aircraft
            gate = _GateAgain(item.config)
            continue
        if core is None or gate is None:
            raise PeerDataError(f"{name}: the first record is not a header")
        commands = tuple(core.step(item.now_s, item.events))
        gate.run(item, commands)
        result.steps += 1
        result.commands += len(commands)
        if commands == item.commands:
            continue
        if _close(msgspec.to_builtins(commands), msgspec.to_builtins(item.commands), tolerance):
            result.inexact += 1
            continue
        result.differences += 1
        result.reworded += _close(_without_texts(commands), _without_texts(item.commands), tolerance)
        if result.first is None:
            result.first = f"{name}: step {result.steps} at {item.now_s:.3f} s: {_differing(item, commands)}"
    if gate is not None:
        gate.compare(result)
    return result


class _GateAgain:
    """The gate, run on what a record holds of its input: events, but no bytes and no answers of the vehicle.

    The link repeats mode requests. Only the first request is judged here.
    """

    def __init__(self, config: Config) -> None:
        self._gate = Gate(config)
        self._refused_s: dict[str, list[float]] = {}
        """Times of the refusals, in order, by rule."""
        self._told_s: dict[str, list[float]] = {}
        """Times of the steps whose events report a refusal in flight, by rule."""
        self._setpoints = self._passed = 0
        """Numbers of setpoints that the gate was asked about, and of those that it passed."""
        self._writer = MavlinkWriter(1, config.vehicle.component_id)
        self._vehicle: Heartbeat | None = None
        self._last_s = -math.inf

    def run(self, step: Step, commands: Iterable[Command]) -> None:
        """Pass one step and the core's commands in it through the gate."""
        gate, now_s = self._gate, step.now_s
        behind = any(isinstance(event, InputBehind) for event in step.events)
        if not behind and now_s - self._last_s <= STALL_S:
            gate.emptied(now_s)
        before = Counter(gate.counts)
        for event in step.events:
            gate.hear(event, now_s)
            if isinstance(event, GateRefused):
                self._told_s.setdefault(_RULES[event.rule].value.name, []).append(now_s)
            self._vehicle = event if isinstance(event, Heartbeat) else self._vehicle
        if behind:
            gate.behind()
        else:
            gate.emptied(now_s)
        self._last_s = now_s
        gate.decided(now_s)
        for command in commands:
            outgoing = self._outgoing(command)
            if outgoing is not None:
                left = gate.release(self._writer.pack_payload(*outgoing), now_s)
                if isinstance(command, VelocitySetpoint):
                    self._setpoints += 1
                    self._passed += bool(left)
        for rule in (gate.counts - before).elements():
            self._refused_s.setdefault(rule, []).append(now_s)

    def compare(self, result: RecordReplay) -> None:
        """Enter the refusals into the result, and those that differ from the record's.

        The record reports a refusal in a later step, so it says nothing about the last one. Refusals by the
        rules of `_TIMED` differ only if the gate passes no setpoint at all.
        """
        result.refused.update(self._gate.counts)
        unsure = _TIMED if self._passed or not self._setpoints else frozenset()
        for rule in self._refused_s.keys() - unsure:
            told_s = self._told_s.get(rule, [])
            times_s = [t for t in self._refused_s[rule] if t < self._last_s]
            anew = sum(not _any_in(told_s, t - _SILENT_S, t + _LATER_S) for t in times_s)
            if anew:
                result.refused_anew[rule] = anew
        for rule in self._told_s.keys() - _TIMED:
            refused_s = self._refused_s.get(rule, [])
            passed = sum(not _any_in(refused_s, t - _LATER_S, t) for t in self._told_s[rule])
            if passed:
                result.passed_anew[rule] = passed

    def _outgoing(self, command: Command) -> Outgoing | None:
        vehicle = self._vehicle
        if vehicle is None:
            return None
        if isinstance(command, VelocitySetpoint):
            return velocity_setpoint(command.velocity_ned_mps, None, 0, vehicle.system_id)
        if isinstance(command, SetMode):
            asked = DIALECTS[vehicle.firmware].command(command.mode)
            params = (float(CUSTOM_MODE_ENABLED), asked.param2, asked.param3)
            return command_long(CMD_DO_SET_MODE, params, vehicle.system_id)
        return None


def _any_in(times_s: Sequence[float], begin_s: float, end_s: float) -> bool:
    """Whether a sorted sequence holds a time of a span."""
    at = bisect.bisect_left(times_s, begin_s)
    return at < len(times_s) and times_s[at] <= end_s


def _differing(step: Step, now: tuple[Command, ...]) -> str:
    for then_command, now_command in zip(step.commands, now, strict=False):
        if then_command != now_command:
            return f"then {then_command}, now {now_command}"
    return f"then {len(step.commands)} commands, now {len(now)}"


def _without_texts(commands: Iterable[Command]) -> object:
    """Commands as plain values, with the texts for people left out."""
    plain = msgspec.to_builtins(tuple(commands))
    return [{key: value for key, value in command.items() if key not in _TEXTS} for command in plain]


def _close(a: object, b: object, tolerance: float) -> bool:
    if isinstance(a, float) and isinstance(b, float):
        return math.isclose(a, b, rel_tol=tolerance, abs_tol=_NEAR_ZERO * tolerance)
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_close(a[k], b[k], tolerance) for k in a)
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(_close(x, y, tolerance) for x, y in zip(a, b, strict=True))
    return a == b


@dataclass(slots=True)
class TlogReplay:
    """Result of replaying a recorded vehicle's MAVLink, or its onboard log, through the core."""

    vehicle: str | None = None
    duration_s: float = 0.0
    frames: int = 0
    """Number of MAVLink frames, or of events of an onboard log."""
    gnss_states: int = 0
    """Number of GLOBAL_POSITION_INT messages taken in."""
    gnss_fixes: int = 0
    """Number of GPS_RAW_INT messages taken in."""
    first: tuple[float, float, float] | None = None
    """First position: latitude, longitude (deg), altitude (m above mean sea level)."""
    last: tuple[float, float, float] | None = None
    broadcasts: int = 0
    locations_with_position: int = 0
    counts: dict[str, int] = field(default_factory=dict)


def replay_tlog(frames: Iterable[tuple[float, bytes]]) -> tuple[TlogReplay, Iterator[Location]]:
    """Feed (utc_s, frame) pairs to the link and the core.

    Returns:
        The result, complete once the second value is exhausted, and the Location messages that would have
        been broadcast.
    """
    result = TlogReplay()
    return result, _fly_tlog(frames, result)


def _fly_tlog(frames: Iterable[tuple[float, bytes]], result: TlogReplay) -> Iterator[Location]:
    steps: list[Step] = []
    onboard = CompanionSystem(
        Config(identity=IdentityConfig(uas_id="REPLAY")), steps.append, commanding=False
    )
    onboard.hear(RadioState(can_send=("wifi",)))
    start_s: float | None = None
    now_s = next_s = 0.0
    for utc_s, frame in frames:
        if start_s is None:
            start_s, now_s, next_s = utc_s, utc_s, utc_s + STEP_S
        # Time stamps of a log may jump back, but the core's time must not.
        now_s = max(now_s, utc_s)
        result.frames += 1
        if now_s >= next_s:
            next_s = now_s + STEP_S
            onboard.tick(now_s)
            onboard.drain(now_s)
            yield from _note(steps, result)
        if message_id_of(frame) != mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_ARM_STATUS:
            # A log holds both directions, so this may be the recorded companion's own message. The core would
            # take it for another Remote ID module and broadcast nothing.
            onboard.receive(frame, now_s)
    if start_s is not None:
        onboard.tick(now_s)
        onboard.drain(now_s)
        yield from _note(steps, result)
        result.duration_s = now_s - start_s
    vehicle = onboard.link.vehicle
    result.vehicle = None if vehicle is None else str(vehicle)
    result.counts = _flat(onboard.link.counts)


def replay_steps(steps: Iterable[Step]) -> tuple[TlogReplay, Iterator[Location]]:
    """Feed the events of an onboard log (`companion.flight_logs`) to the core. As `replay_tlog`."""
    result = TlogReplay()
    return result, _fly_steps(steps, result)


def _fly_steps(steps: Iterable[Step], result: TlogReplay) -> Iterator[Location]:
    core = Companion(Config(identity=IdentityConfig(uas_id="REPLAY")))
    waiting: list[AnyEvent] = [RadioState(can_send=("wifi",))]
    start_s: float | None = None
    now_s = next_s = 0.0
    for step in steps:
        if start_s is None:
            start_s, next_s = step.now_s, step.now_s + STEP_S
        now_s = step.now_s
        if now_s >= next_s:
            next_s = now_s + STEP_S
            yield from _take_step(core, now_s, waiting, result)
        result.frames += len(step.events)
        for event in step.events:
            if isinstance(event, Heartbeat):
                kind = f"MAV_TYPE {event.vehicle_type}"
                result.vehicle = f"{event.firmware.value}, system {event.system_id}, {kind}"
            if not isinstance(event, RemoteIdModule):
                # The core would take it for a module that flies along, and broadcast nothing.
                waiting.append(event)
    if start_s is not None:
        yield from _take_step(core, now_s, waiting, result)
        result.duration_s = now_s - start_s


def _take_step(
    core: Companion, now_s: float, waiting: list[AnyEvent], result: TlogReplay
) -> Iterator[Location]:
    events = tuple(waiting)
    waiting.clear()
    commands = cast("tuple[AnyCommand, ...]", tuple(core.step(now_s, events)))
    yield from _note([Step(now_s=now_s, events=events, commands=commands)], result)


def _flat(counts: LinkCounts) -> dict[str, int]:
    plain = dataclasses.asdict(counts)
    wire = plain.pop("wire")
    return {**wire, **plain}


def _note(steps: list[Step], result: TlogReplay) -> Iterator[Location]:
    for step in steps:
        for event in step.events:
            if isinstance(event, GlobalPosition):
                result.gnss_states += 1
                result.last = (event.lat_deg, event.lon_deg, event.alt_msl_m)
                result.first = result.first or result.last
            elif isinstance(event, GnssFix):
                result.gnss_fixes += 1
        for command in step.commands:
            if isinstance(command, Broadcast):
                result.broadcasts += 1
                for message in command.messages:
                    if isinstance(message, Location):
                        result.locations_with_position += message.lat_deg is not None
                        yield message
    steps.clear()


def on_air(location: Location) -> Location:
    """Location as a receiver reads it, after encoding and decoding."""
    decoded = codec.decode(codec.encode(location))
    assert isinstance(decoded, Location)
    return decoded
