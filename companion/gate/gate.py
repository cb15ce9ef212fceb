"""The gate takes in the vehicle's messages and lets only permitted frames pass to it. See `rules`.

    gate.hear(event, now_s)     # every event of the link, in order of arrival
    gate.emptied(now_s)         # the input was read until it was empty
    gate.answered(asked_s, now_s)   # the vehicle answered the question that was asked at asked_s
    gate.decided(now_s)         # the following commands were decided now
    gate.release(data, now_s)   # takes whole frames, returns those that may be sent

A frame that breaks a rule is not sent, and `broken` reports it. After a fault of the calling program, of all
commands only a request to hold is sent for three seconds.
"""

from __future__ import annotations

import math
import struct
from collections import Counter
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.dialect import (
    CMD_DO_CHANGE_SPEED,
    CMD_DO_SET_MODE,
    CMD_REQUEST_MESSAGE,
    CMD_SET_MESSAGE_INTERVAL,
    FRAME_LOCAL_NED,
    VELOCITY_YAW_MASK,
    VELOCITY_YAW_RATE_MASK,
)
from companion.autopilot.wire import (
    COMPONENT_INFORMATION_BASIC,
    COMPONENT_METADATA,
    MAGIC_V2,
    frame_length,
    message_id_of,
)
from companion.config import Config
from companion.events import (
    ClockRead,
    CurrentMode,
    Event,
    FenceDownloaded,
    FlightMode,
    GateRefused,
    GlobalPosition,
    Heartbeat,
    Landed,
    LandedState,
    LocalPosition,
    MissionCurrent,
    Settings,
    TwoAutopilots,
    VehicleParameters,
    VehicleTime,
)
from companion.gate.bounds import Bounds
from companion.gate.mandate import Mandate
from companion.gate.rules import Broken, Rule
from companion.geometry import Vec3

STALL_S = 0.25
"""A longer pause in reading the input is a stall: messages read after it may be old."""
_SILENCE_S = 0.5
"""A mode may have been missed in a longer pause between the vehicle's messages."""
_RESTART_S = 1.0
"""An autopilot that restarts is silent for longer than this."""
_FRESH_S = 0.25
_ANSWER_S = 0.1
"""How long a TIMESYNC answer counts as proof that the vehicle reads its input."""
_DEAF_S = 1.0
_SHUT_S = 3.0
_AGAIN_S = 5.0
"""Least time between two reports of the same rule. A fault that shuts the gate again is always reported."""
_AUTOPILOT = mavlink.MAV_COMP_ID_AUTOPILOT1
_SETPOINT = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
_COMMAND = mavlink.MAVLINK_MSG_ID_COMMAND_LONG
_FREE = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_STATUSTEXT,
        mavlink.MAVLINK_MSG_ID_TIMESYNC,
        mavlink.MAVLINK_MSG_ID_COLLISION,
        mavlink.MAVLINK_MSG_ID_COMMAND_ACK,
        mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
        mavlink.MAVLINK_MSG_ID_PARAM_VALUE,
        mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST,
        mavlink.MAVLINK_MSG_ID_MISSION_REQUEST,
        mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT,
        mavlink.MAVLINK_MSG_ID_MISSION_ACK,
        mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
        COMPONENT_INFORMATION_BASIC,
        COMPONENT_METADATA,
        mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_BASIC_ID,
        mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_ARM_STATUS,
    }
)
"""Messages that command nothing and may always be sent."""
_PUBLISHED = frozenset({mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE})
"""Sent only with traffic.publish: an autopilot may act on them by itself."""
_OF_THE_VEHICLE = frozenset({GlobalPosition, LocalPosition, VehicleTime, Heartbeat, CurrentMode, LandedState})
_FILES = mavlink.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL
_FILES_OPCODE_AT = 6
_FILES_ANSWERS = (mavlink.MAV_FTP_OPCODE_ACK, mavlink.MAV_FTP_OPCODE_NAK)
"""All other opcodes are requests, and may ask the vehicle to write."""
_FREE_COMMANDS = frozenset({CMD_SET_MESSAGE_INTERVAL, CMD_REQUEST_MESSAGE})
_MASKS = (VELOCITY_YAW_MASK, VELOCITY_YAW_RATE_MASK)
_GROUND_SPEED, _SAME_THROTTLE = 1.0, -1.0
"""Parameters of DO_CHANGE_SPEED that set the ground speed and nothing else."""
_SETPOINT_LAYOUT = struct.Struct("<I11fHBBB")
_COMMAND_LAYOUT = struct.Struct("<7fHBBB")


class Gate:
    """The gate of one vehicle. Times are monotonic seconds that never go back."""

    def __init__(self, config: Config) -> None:
        """Create a gate that is closed until the input has been read and the vehicle has been heard."""
        self.counts: Counter[str] = Counter()
        """Number of refused frames by the name of the rule."""
        self._free = _FREE if config.traffic.publish == "off" else _FREE | _PUBLISHED
        self._mandate = Mandate(config)
        self._bounds = Bounds(config)
        self._emptied_s = self._decided_s = -math.inf
        self._bounds_s = -math.inf
        """Time at which the vehicle last reported a limit or its fence."""
        self._fresh = False
        """The vehicle's mode was reported since the input was last behind or the vehicle was silent."""
        self._heard_s = -math.inf
        """Time of the vehicle's last message."""
        self._asked_s: float | None = None
        """Time of the latest question that the vehicle has answered; None if it has answered none."""
        self._answer_s = -math.inf
        """Time at which that answer arrived; minus infinity once a command has used it."""
        self._waits_s: float | None = None
        self._shut_s = -math.inf
        self._broken: list[GateRefused] = []
        self._told: dict[Rule, float] = {}

    @property
    def lost(self) -> str | None:
        """Why authority over the vehicle was lost, in words; None if it was not."""
        return self._mandate.lost

    def current(self, now_s: float) -> bool:
        """Whether the known mode is current: read without a backlog, and the vehicle not silent since."""
        return self._fresh and now_s - self._emptied_s <= STALL_S and now_s - self._heard_s <= _SILENCE_S

    def behind_because(self, now_s: float) -> tuple[str, bool]:
        """Why messages of the vehicle may be old, in words, and whether its own clock says so."""
        if now_s - self._emptied_s > STALL_S or self.current(now_s):
            return "the vehicle's messages were not read in time here", False
        if self._heard_s == -math.inf:
            return "no message of the vehicle has arrived", False
        if self._bounds.mixed(now_s):
            return "old messages of the vehicle arrive after newer ones", False
        if now_s - self._heard_s > _SILENCE_S:
            return f"the vehicle has sent nothing for {now_s - self._heard_s:.1f} s", False
        if self._bounds.late(now_s):
            return f"by its own clock, the vehicle's messages arrive {self._bounds.delay(now_s)}", True
        return "no message has shown the vehicle's mode since its messages were last late or missing", False

    # ------------------------------------------------------------ in

    def hear(self, event: Event, now_s: float) -> None:
        """Take in one event of the link. Irrelevant events are ignored."""
        if type(event) in _OF_THE_VEHICLE:
            self._note_heard(now_s)
        match event:
            case GlobalPosition():
                self._bounds.hear_position(event, now_s)
                self._fresh = self._fresh and not self._bounds.late(now_s)
            case LocalPosition() | VehicleTime():
                self._bounds.hear_clock(event.time_boot_s, now_s)
                self._fresh = self._fresh and not self._bounds.late(now_s)
            case ClockRead():
                self._bounds.hear_answer(event, now_s)
            case Heartbeat() | CurrentMode():
                overtaken = event.overtaken or self._bounds.mixed(now_s)
                self._fresh = self._fresh or (self._is_news(now_s) and not overtaken)
                self._mandate.hear_mode_message(event, now_s, overtaken=overtaken)
            case LandedState():
                landed = event.landed if not self._bounds.flies_fast else Landed.IN_AIR
                self._mandate.hear_landed(landed, now_s)
            case MissionCurrent() if event.complete:
                self._mandate.mission_ended()
            case VehicleParameters():
                self._bounds.hear_parameters(event)
                self._bounds_s = now_s
            case FenceDownloaded():
                self._bounds.hear_fence(event.areas)
                self._bounds_s = now_s
            case Settings():
                self._mandate.enabled = event.enable
            case TwoAutopilots():
                self._mandate.two_autopilots = True

    def _note_heard(self, now_s: float) -> None:
        self._fresh = self._fresh and now_s - self._heard_s <= _SILENCE_S
        if now_s - self._heard_s > _RESTART_S:
            self._mandate.unheard()
        self._heard_s = now_s

    def _is_news(self, now_s: float) -> bool:
        """Whether messages received now are current: delayed neither here nor, by their clock, on the way."""
        return now_s - self._emptied_s <= STALL_S and not self._bounds.late(now_s)

    def emptied(self, now_s: float) -> None:
        """Note that the input was read until it was empty."""
        if now_s - self._emptied_s > STALL_S:
            self._fresh = False
            self._waits_s = None  # Our own pause does not count as silence of the vehicle.
        self._emptied_s = now_s

    def behind(self) -> None:
        """Note that the input holds more than could be read now."""
        self._fresh, self._emptied_s = False, -math.inf

    def decided(self, now_s: float) -> None:
        """Note that the commands released from now on were decided from what is known at `now_s`."""
        self._decided_s = now_s

    def answered(self, asked_s: float, now_s: float) -> None:
        """Note that the vehicle has answered a question (TIMESYNC) that was asked at `asked_s`."""
        if self._asked_s is None or asked_s > self._asked_s:
            self._note_heard(now_s)
            self._asked_s = asked_s
            if now_s - asked_s <= _FRESH_S:
                self._answer_s = now_s

    def answers(self, now_s: float, *, waiting: bool) -> bool:
        """Whether waiting commands may be sent: an answer just arrived, or the vehicle has never answered.

        Args:
            waiting: commands wait for an answer. After a second without one this breaks the rule `ANSWER`.
        """
        if self._asked_s is None or now_s - self._answer_s <= _ANSWER_S:
            self._waits_s = None
            return True
        if not waiting:
            self._waits_s = None
        elif self._waits_s is None:
            self._waits_s = now_s
        elif now_s - self._waits_s > _DEAF_S:
            self._waits_s = now_s
            self._refuse(Broken(Rule.ANSWER, f"no answer from the vehicle for {_DEAF_S:g} s"), now_s)
        return False

    def in_time(self, now_s: float) -> bool:
        """Whether the latest decision is still young enough to be sent."""
        return 0.0 <= now_s - self._decided_s <= _FRESH_S

    def broken(self) -> list[GateRefused]:
        """Reports of rules broken since the last call.

        The same rule is reported at most once in five seconds, except for a fault that shuts the gate again.
        """
        broken, self._broken = self._broken, []
        return broken

    # ------------------------------------------------------------ out

    def release(self, data: bytes, now_s: float) -> bytes:
        """Return those of some whole frames that may be sent now, in their order."""
        if not data:
            return data
        kept: list[bytes] = []
        at, commanded = 0, False
        while at < len(data):
            length = frame_length(data, at) if data[at] == MAGIC_V2 else -1
            if length <= 0 or at + length > len(data):
                self._refuse(Broken(Rule.WHOLE, f"no whole frame begins at byte {at} of {len(data)}"), now_s)
                break
            frame = data[at : at + length]
            at += length
            try:
                commanded = self._judge(message_id_of(frame), frame[10 : 10 + frame[1]], now_s) or commanded
            except Broken as broken:
                self._refuse(broken, now_s)
            else:
                kept.append(frame)
        if commanded:
            self._answer_s = -math.inf  # The next command waits for the next answer.
        return b"".join(kept)

    def _judge(self, message_id: int, payload: bytes, now_s: float) -> bool:
        """Whether a permitted frame commands the vehicle. Raises Broken if the frame must not leave."""
        if message_id == _SETPOINT:
            self._setpoint(payload, now_s)
            return True
        if message_id == _COMMAND:
            return self._command(payload, now_s)
        if message_id == _FILES:
            _check_files(payload)
        elif message_id not in self._free:
            raise Broken(Rule.KIND, f"message {message_id} is not allowed")
        return False

    def _setpoint(self, payload: bytes, now_s: float) -> None:
        _, *numbers, mask, system, component, frame = _unpacked(_SETPOINT_LAYOUT, payload)
        velocity = numbers[3], numbers[4], numbers[5]
        standing = velocity == (0.0, 0.0, 0.0)
        self._commands(system, component, now_s)
        self._mandate.check_setpoint(standing)
        if not self.in_time(now_s):
            raise Broken(Rule.AGE, f"decided {now_s - self._decided_s:.2f} s ago")
        turning = numbers[-1] != 0.0
        if frame != FRAME_LOCAL_NED or mask not in _MASKS or turning or not all(map(math.isfinite, numbers)):
            raise Broken(Rule.FORM, f"frame {frame}, mask {mask:#x}, velocity {velocity}")
        self._check_bounds(velocity, now_s)
        self._check_moment(now_s)
        self._mandate.setpoint_left(now_s)
        self._bounds.left(velocity, now_s)

    def _check_bounds(self, velocity: Vec3, now_s: float) -> None:
        try:
            self._bounds.check(velocity, now_s)
        except Broken as broken:
            if self._decided_s < self._bounds_s and broken.rule.ends == "fault":
                # The decision was made before the new limit was known, so it is no fault.
                raise Broken(
                    Rule.AGE, f"decided before a new limit or fence was known; {broken.why}"
                ) from None
            raise

    def _command(self, payload: bytes, now_s: float) -> bool:
        *params, command, system, component, _ = _unpacked(_COMMAND_LAYOUT, payload)
        if command in _FREE_COMMANDS:
            return False
        if command not in (CMD_DO_SET_MODE, CMD_DO_CHANGE_SPEED):
            raise Broken(Rule.KIND, f"command {command} is not allowed")
        asked = self._mandate.custom_of(*params[1:3]) if command == CMD_DO_SET_MODE else None
        self._commands(system, component, now_s, None if asked is None else asked[0])
        if command == CMD_DO_CHANGE_SPEED:
            self._mandate.check_speed()
            if params[0] != _GROUND_SPEED or params[2] != _SAME_THROTTLE or not 0.0 < params[1] <= 100.0:
                raise Broken(
                    Rule.SPEED, f"DO_CHANGE_SPEED {params[:3]}; allowed: ground speed above 0, up to 100 m/s"
                )
            self._check_moment(now_s)
            return True
        if asked is None or params[0] != 1.0:
            raise Broken(Rule.MODE, f"mode {params[:3]} must not be requested")
        custom, mode = asked
        self._mandate.check_request(mode, now_s)
        self._check_moment(now_s, holds=mode is FlightMode.HOLD)
        self._mandate.request_left(custom, now_s)
        return True

    def _commands(self, system: int, component: int, now_s: float, custom: int | None = None) -> None:
        """Check the rules target, use, current and authority for a frame that commands the vehicle.

        Args:
            custom: custom_mode that the frame requests; None for any other command.
        """
        heartbeat = self._mandate.heartbeat
        if heartbeat is None or (system, component) != (heartbeat.system_id, _AUTOPILOT):
            raise Broken(Rule.TARGET, f"system {system}, component {component} is not the vehicle")
        if not self.current(now_s):
            raise Broken(Rule.CURRENT, "not all input was read, or no mode was reported since")
        self._mandate.check(now_s, custom)

    def _check_moment(self, now_s: float, *, holds: bool = False) -> None:
        """Check that no fault keeps the gate shut, except for a hold, and that an answer just arrived."""
        if now_s < self._shut_s and not holds:
            raise Broken(Rule.AGE, "after a fault")
        if self._asked_s is not None and now_s - self._answer_s > _ANSWER_S:
            raise Broken(Rule.ANSWER, "no answer from the vehicle since the last command")

    def _refuse(self, broken: Broken, now_s: float) -> None:
        rule = broken.rule
        self.counts[rule.value.name] += 1
        # Always report a fault that shuts the gate again: otherwise the program would fly on with it shut.
        anew = rule.ends == "fault" and now_s >= self._shut_s
        if rule.ends == "fault":
            self._shut_s = now_s + _SHUT_S
        if anew or now_s - self._told.get(rule, -math.inf) >= _AGAIN_S:
            self._told[rule] = now_s
            self._broken.append(GateRefused(rule=rule.number, text=str(broken), ends=rule.ends))


def _unpacked(layout: struct.Struct, payload: bytes) -> tuple[Any, ...]:
    """Unpack a payload. Refuse one that is longer than its message: receivers would truncate it."""
    if len(payload) > layout.size:
        raise Broken(Rule.WHOLE, f"payload of {len(payload)} bytes; allowed: up to {layout.size}")
    return layout.unpack(payload.ljust(layout.size, b"\0"))


def _check_files(payload: bytes) -> None:
    """Allow only answers of FILE_TRANSFER_PROTOCOL: we serve our own files and request none."""
    opcode = payload[_FILES_OPCODE_AT] if len(payload) > _FILES_OPCODE_AT else 0
    if opcode not in _FILES_ANSWERS:
        raise Broken(Rule.KIND, f"file transfer opcode {opcode} is not allowed")
