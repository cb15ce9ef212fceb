"""Judges a companion from outside: from the bytes at the vehicle's end and the pilot's timed choices.

The judge knows the frames that left the companion and those that reached the vehicle, what the vehicle sent
and when the companion could first read it, the vehicle's own modes, the pilot's choices, and the limits. It
does not use the companion's internal state. Times are seconds on the caller's clock. The rules, by name:

    request    a command that changes the flight left after the mode that ended our authority could be read
    setpoint   a setpoint left more than 0.1 s after that
    left       the vehicle left the pilot's mode because of us
    unread     like "left", but the mode could not be read: its message was lost, or had not arrived yet
    refused    a mode that the pilot selected, and the vehicle accepted, was not entered
    stale      a setpoint left on an own position older than 1.5 s
    old        a setpoint or a mode request reached the vehicle more than 0.25 s after it was decided
    bounds     a setpoint beyond the limits on speed, climb or descent, or not a number
    form       a setpoint with another mask, frame or target than the two firmwares fly

"We" is the companion. Authority ends with any mode that is not ours, selected by the pilot or by a failsafe.
If we controlled the vehicle, authority returns with disarming (`flight.rearm = "disarm"`), else with a mode
that gives it.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import CURRENT_MODE, FrameScanner

_HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
_POSITION = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
_SET_MODE = mavlink.MAVLINK_MSG_ID_SET_MODE
_COMMAND_INT = mavlink.MAVLINK_MSG_ID_COMMAND_INT
_COMMAND_LONG = mavlink.MAVLINK_MSG_ID_COMMAND_LONG
_SETPOINT = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
_DO_SET_MODE = mavlink.MAV_CMD_DO_SET_MODE
_CHANGE_SPEED = mavlink.MAV_CMD_DO_CHANGE_SPEED
_MODE_COMMANDS: Final = frozenset(
    {
        _DO_SET_MODE,
        _CHANGE_SPEED,
        mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH,
        mavlink.MAV_CMD_NAV_LAND,
        mavlink.MAV_CMD_NAV_TAKEOFF,
        mavlink.MAV_CMD_DO_REPOSITION,
        mavlink.MAV_CMD_MISSION_START,
        mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
    }
)
"""Commands that change the flight."""
_LONG = struct.Struct("<7fHBBB")
_LOCAL_NED = struct.Struct("<I11fHBBB")
_VELOCITY_ALONE = sum(
    getattr(mavlink, f"POSITION_TARGET_TYPEMASK_{axis}_IGNORE") for axis in ("X", "Y", "Z", "AX", "AY", "AZ")
)
_MASKS: Final = frozenset(
    {
        _VELOCITY_ALONE | mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE,
        _VELOCITY_ALONE | mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE,
    }
)
"""Type masks of a velocity vector with a yaw, and with a yaw rate."""
_FRAME_LOCAL_NED = mavlink.MAV_FRAME_LOCAL_NED
_AUTOPILOT = mavlink.MAV_COMP_ID_AUTOPILOT1

REACTION_S: Final = 0.1
"""Longest time from when the pilot's mode can be read to the last setpoint."""
STALE_S: Final = 1.5
"""Greatest age of the own position on which a setpoint may be based."""
OLD_S: Final = 0.25
"""Longest time from the decision to the arrival at the vehicle."""
PILOTS: Final = "the pilot's"
_ALIKE_S = 8.0
"""A mode that we requested within this time cannot be attributed to the pilot."""
_GAP_S = 0.15
"""A companion that did not read for longer than this stood still."""
_SLACK = 1e-3


class Breach(NamedTuple):
    """A breach of a rule."""

    at_s: float
    rule: str
    words: str


@dataclass(frozen=True, slots=True)
class Bounds:
    """Limits of setpoints (m/s), and the modes (`custom_mode`) that affect authority."""

    max_speed_mps: float
    max_climb_mps: float
    max_descent_mps: float
    external: int
    """The mode in which the vehicle flies setpoints."""
    given: frozenset[int]
    """Modes from which the companion may take a vehicle that it did not control before."""
    px4_modes: bool
    """Whether modes are requested as PX4's main and sub mode."""


class _Request(NamedTuple):
    left_s: float
    custom_mode: int


@dataclass(slots=True)
class _Choice:
    """A mode that is not ours, its start time, and the time at which the companion could first read it."""

    custom_mode: int
    at_s: float
    whose: str
    readable_s: float = math.inf


class Judge:
    """Judge of one vehicle with one companion.

    Args:
        system_id: MAVLink system of the vehicle. Other vehicles' frames may reach the companion too, and tell
            nothing about this one. None: every frame is the vehicle's.
        grace_s: longest time that a step of a running companion may still take when a message arrives; 0 in
            virtual time.
        cause_s: a change of the mode within this time after our request arrived is its effect.
        crossing_s: a request within this time after the pilot's choice may have crossed the message that
            shows it.
    """

    def __init__(
        self,
        bounds: Bounds,
        *,
        system_id: int | None = None,
        grace_s: float = 0.0,
        cause_s: float = 0.1,
        crossing_s: float = 0.7,
    ) -> None:
        self.breaches: list[Breach] = []
        self.crossed = 0
        """Number of choices undone by a request of ours that was already on its way, which we could not
        know.
        """
        self.alike = 0
        """Number of choices that were not judged, because we had requested the same mode."""
        self.setpoints = 0
        self.setpoint_s = -math.inf
        """Time at which the last setpoint left."""
        self.crossing_s = crossing_s
        self._bounds = bounds
        self._system_id = system_id
        self._grace_s = grace_s
        self._cause_s = cause_s
        self._scanner = FrameScanner()
        self._parsed: tuple[bytes, list[tuple[int, bytes]]] = (b"", [])
        self._mode: int | None = None
        self._armed = False
        self._ours = False
        """Whether the mode was entered by our request."""
        self._selected: tuple[float, int] | None = None
        self._choices: list[_Choice] = []
        """Modes that are not ours since authority ended, oldest first. The last is the one to be in."""
        self._final = False
        """Whether only disarming gives authority back."""
        self._gone_s = math.inf
        """Time at which the companion could first read that authority has ended."""
        self._asked: deque[_Request] = deque(maxlen=50)
        self._reached: deque[tuple[float, int]] = deque(maxlen=50)
        self._sampled_s = -math.inf
        """Time at which the newest readable position was sent."""
        self._read_s = -math.inf
        self._resumed_s = -math.inf

    def first(self) -> tuple[Breach, ...]:
        """First breach of each rule, in their order."""
        found: dict[str, Breach] = {}
        for breach in self.breaches:
            found.setdefault(breach.rule, breach)
        return tuple(found.values())

    def _breach(self, at_s: float, rule: str, words: str) -> None:
        self.breaches.append(Breach(round(at_s, 4), rule, words))

    # ------------------------------------------------------------ the vehicle and its pilot

    @property
    def held(self) -> bool:
        """Whether we control the vehicle: in the setpoint mode, or in a mode in which we asked it to wait."""
        return self._mode == self._bounds.external or (self._ours and self._mode not in self._bounds.given)

    def selects(self, now_s: float, custom_mode: int) -> None:
        """Report that the pilot selects a mode. If the vehicle accepts it, call `shows`, then `accepted`."""
        self._selected = now_s, custom_mode

    def accepted(self, now_s: float) -> None:
        """Judge whether the vehicle, which accepted the choice and has shown its mode, entered that mode."""
        if self._selected is not None and self._mode != self._selected[1]:
            self._breach(now_s, "refused", f"mode {self._selected[1]} was accepted but not entered")
        self._selected = None

    def declined(self) -> None:
        """Report that the vehicle has not accepted the choice."""
        self._selected = None

    def shows(self, now_s: float, custom_mode: int, *, armed: bool) -> None:
        """Report the vehicle's own mode. Call it whenever the mode may have changed."""
        if not armed:
            self._mode, self._armed, self._ours = custom_mode, False, False
            self._choices.clear()
            self._gone_s, self._final = math.inf, False
            return
        if custom_mode == self._mode and self._armed:
            return
        before, held = self._mode, self.held and self._armed
        known = self._armed
        self._mode, self._armed = custom_mode, True
        whose = self._whose(now_s, custom_mode)
        self._ours = whose == "ours"
        if not known:
            return
        if self._ours:
            self._judge_left(now_s, before, custom_mode)
            return
        self._choose(now_s, custom_mode, whose, held=held)

    def _whose(self, now_s: float, custom_mode: int) -> str:
        selected = self._selected
        if selected is not None and selected[1] == custom_mode and now_s - selected[0] <= self._cause_s:
            return PILOTS
        if any(m == custom_mode and now_s - at <= self._cause_s for at, m in self._reached):
            return "ours"
        # Setpoints that resume end PX4's failsafe for their loss, so only we can cause a change to this mode.
        return "ours" if custom_mode == self._bounds.external else "the vehicle's"

    def _choose(self, now_s: float, custom_mode: int, whose: str, *, held: bool) -> None:
        if any(r.custom_mode == custom_mode and now_s - r.left_s <= _ALIKE_S for r in self._asked):
            self.alike += 1
            return
        if not self._final and not held and custom_mode in self._bounds.given:
            self._choices.clear()
            self._gone_s = math.inf
            return
        self._final = self._final or held
        selected = self._selected
        at_s = now_s if whose != PILOTS or selected is None else selected[0]
        self._choices.append(_Choice(custom_mode, at_s, whose))

    def _judge_left(self, now_s: float, before: int | None, custom_mode: int) -> None:
        """The vehicle is in a mode of ours. Check whether it left a mode that we must not end."""
        if not self._choices or self._choices[-1].custom_mode != before:
            return
        choice = self._choices[-1]
        request = next((r for r in reversed(self._asked) if r.custom_mode == custom_mode), None)
        asked_s = now_s if request is None else request.left_s
        words = (
            f"{choice.whose} mode {choice.custom_mode} was left after {now_s - choice.at_s:.3f} s for mode "
            f"{custom_mode}, which was requested {asked_s - choice.at_s:.3f} s after it was entered"
        )
        if asked_s >= choice.readable_s:
            self._breach(now_s, "left", words)
        elif asked_s <= choice.at_s or (
            asked_s - choice.at_s <= self.crossing_s and not choice.at_s < self._resumed_s <= asked_s
        ):
            self.crossed += 1
        else:
            self._breach(now_s, "unread", words)

    # ------------------------------------------------------------ what the companion can know

    def reads(self, now_s: float, told: Iterable[tuple[float, bytes]]) -> None:
        """Report that the companion runs and can read these frames, now at the latest.

        Args:
            told: time at which each frame left the vehicle, and its bytes; only frames that really wait to be
                read.
        """
        if now_s - self._read_s > _GAP_S:
            self._resumed_s = now_s
        self._read_s = now_s
        for sent_s, raw in told:
            if len(raw) < 12 or raw[0] != 0xFD or raw[6] != _AUTOPILOT:
                continue
            if self._system_id not in (None, raw[5]):
                continue
            message_id = raw[7] | raw[8] << 8 | raw[9] << 16
            if message_id == _POSITION:
                self._sampled_s = max(self._sampled_s, sent_s)
            elif self._choices and message_id in (_HEARTBEAT, CURRENT_MODE):
                payload = raw[10 : 10 + min(raw[1], 4)].ljust(4, b"\0")
                self._note_shown(now_s, sent_s, int.from_bytes(payload, "little"))

    def stops(self, now_s: float) -> None:
        """Report that the companion stands still from now on.

        When it resumes, pass the frames that it may not have read yet to `reads` again.
        """
        if not now_s < self._gone_s < math.inf:
            return
        for choice in self._choices:
            if choice.readable_s > now_s:
                choice.readable_s = math.inf
        self._gone_s = min((choice.readable_s for choice in self._choices), default=math.inf)

    def _note_shown(self, now_s: float, sent_s: float, custom_mode: int) -> None:
        for choice in self._choices:
            if choice.custom_mode == custom_mode and sent_s >= choice.at_s - 1e-6:
                # A companion that stood still had no step under way, so it gets no grace time.
                known_s = now_s if now_s == self._resumed_s else now_s + self._grace_s
                choice.readable_s = min(choice.readable_s, known_s)
                self._gone_s = min(self._gone_s, known_s)

    # ------------------------------------------------------------ what it sends

    def leaves(self, now_s: float, data: bytes) -> None:
        """Judge bytes that leave the companion."""
        for message_id, payload in self._frames(data):
            if message_id == _SETPOINT:
                self._judge_setpoint(now_s, payload)
            elif (custom_mode := self._mode_asked(message_id, payload)) is not None:
                self._judge_request(now_s, custom_mode)

    def _judge_setpoint(self, now_s: float, payload: bytes) -> None:
        self.setpoints += 1
        self.setpoint_s = now_s
        fields = _LOCAL_NED.unpack(payload.ljust(_LOCAL_NED.size, b"\0"))
        velocity, (mask, system, component, frame) = fields[4:7], fields[12:16]
        if mask not in _MASKS or frame != _FRAME_LOCAL_NED or component != _AUTOPILOT or system == 0:
            self._breach(
                now_s,
                "form",
                f"a setpoint with type mask {mask:#x}, frame {frame}, target {system}/{component}",
            )
        speed, down, bounds = math.hypot(*velocity), velocity[2], self._bounds
        if not speed <= bounds.max_speed_mps + _SLACK:
            self._breach(now_s, "bounds", f"a setpoint of {speed:.3f} m/s")
        if not -bounds.max_climb_mps - _SLACK <= down <= bounds.max_descent_mps + _SLACK:
            self._breach(now_s, "bounds", f"a setpoint of {down:.3f} m/s down")
        age_s = now_s - self._sampled_s
        if age_s > STALE_S + self._grace_s:
            self._breach(now_s, "stale", f"a setpoint based on a position {age_s:.2f} s old")
        if now_s > self._gone_s + REACTION_S:
            late_s = now_s - self._gone_s
            words = f"a setpoint was sent {late_s:.3f} s after the report of {self._end} could be read"
            self._breach(now_s, "setpoint", words)

    @property
    def _end(self) -> str:
        choice = next((c for c in self._choices if c.readable_s < math.inf), None)
        return "a mode" if choice is None else f"{choice.whose} mode {choice.custom_mode}"

    def _judge_request(self, now_s: float, custom_mode: int) -> None:
        self._asked.append(_Request(now_s, custom_mode))
        if now_s >= self._gone_s:
            what = "a change of the flight" if custom_mode < 0 else f"mode {custom_mode}"
            late_s = now_s - self._gone_s
            words = f"{what} was requested {late_s:.3f} s after the report of {self._end} could be read"
            self._breach(now_s, "request", words)
        last = self._choices[-1] if self._choices else None
        if last is not None and last.custom_mode == custom_mode and last.readable_s == math.inf:
            # From here on the pilot's choice cannot be distinguished from our request.
            self._choices.pop()
            self.alike += 1

    def reaches(self, now_s: float, data: bytes, decided_s: float) -> None:
        """Bytes of the companion, decided at `decided_s`, reach the vehicle. Call before it processes
        them.
        """
        age_s = now_s - decided_s
        for message_id, payload in self._frames(data):
            custom_mode = self._mode_asked(message_id, payload)
            if custom_mode is not None:
                self._reached.append((now_s, custom_mode))
            if age_s > OLD_S + self._grace_s and (message_id == _SETPOINT or custom_mode is not None):
                what = "a setpoint" if custom_mode is None else f"a request for mode {custom_mode}"
                self._breach(now_s, "old", f"{what} reached the vehicle {age_s:.2f} s after the decision")

    def _frames(self, data: bytes) -> list[tuple[int, bytes]]:
        """Parse frames. Bytes mostly arrive as they left, so the last result is cached."""
        if self._parsed[0] is not data:
            self._parsed = data, [(f.message_id, f.payload) for f in self._scanner.frames(data)]
        return self._parsed[1]

    def _mode_asked(self, message_id: int, payload: bytes) -> int | None:
        """The mode (`custom_mode`) that a message requests, -1 for another command that changes the flight,
        else None.
        """
        if message_id == _SET_MODE:
            return int.from_bytes(payload[:4].ljust(4, b"\0"), "little")
        if message_id not in (_COMMAND_LONG, _COMMAND_INT):
            return None
        whole = payload.ljust(_LONG.size, b"\0")
        command = int.from_bytes(whole[28:30], "little")
        if command != _DO_SET_MODE:
            return -1 if command in _MODE_COMMANDS else None
        _, main, sub = struct.unpack_from("<3f", whole)
        return int(main) << 16 | int(sub) << 24 if self._bounds.px4_modes else int(main)
