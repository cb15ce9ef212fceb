"""A history in which the vehicle's bytes reach the gate through a whole companion, as in flight.

Only the core and the commands that the link would send are replaced by the hostile program. What the gate is
told (each event, when the input was read to its end, when the vehicle answered, when a decision was made) is
told by the companion's own code. Heartbeats, modes, positions, clocks, landed states, missions and answers
arrive as MAVLink. The results of whole dialogues (parameters, fence, settings, a second autopilot) are
handed over as events.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from typing import Any, cast

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.link import AutopilotLink
from companion.autopilot.polled.timesync import nanoseconds, read_timesync, timesync
from companion.autopilot.wire import CURRENT_MODE, FrameScanner, MavlinkWriter
from companion.config import Config
from companion.events import (
    AnyCommand,
    CurrentMode,
    Event,
    Firmware,
    GlobalPosition,
    Heartbeat,
    Landed,
    LandedState,
    LocalPosition,
    MissionCurrent,
    VehicleTime,
)
from companion.gate.gate import Gate
from companion.system import CompanionSystem
from tests.companion.gate.hostile.history import AnyGate, History

_BEHIND_S = 0.3
_FORGED = 0.02
"""Share of answers to questions that nobody has asked."""
_AUTOPILOTS = {
    Firmware.ARDUPILOT: mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
    Firmware.PX4: mavlink.MAV_AUTOPILOT_PX4,
}
_LANDED = tuple(Landed)


class _HostileCore:
    """Decides nothing: the hostile program's frames are put into the link instead."""

    def step(self, now_s: float, events: list[Event]) -> list[AnyCommand]:
        return []


class _HostileLink:
    """The companion's link, which also sends the hostile program's frames and reports injected events."""

    def __init__(self, link: AutopilotLink) -> None:
        self._link = link
        self.offered: bytes | None = None
        """Frames that wait to be sent."""
        self.asks_first = True
        """Wait until the companion permits commands, as the real link does."""
        self.events: list[Event] = []
        self.own = b""
        """What the real link has sent in the last `drain`."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._link, name)

    def receive(self, data: bytes, now_s: float) -> list[Event]:
        events, self.events = self._link.receive(data, now_s) + self.events, []
        return events

    @property
    def holds(self) -> bool:
        return self.offered is not None

    def drain(self, *, commanding: bool = True) -> bytes:
        self.own = self._link.drain(commanding=commanding)
        if self.offered is None or (self.asks_first and not commanding):
            return self.own
        offered, self.offered = self.offered, None
        return self.own + offered


class SystemHistory(History):
    """See the module."""

    longest_alone_s = 0.5
    """In this time the vehicle sends fewer than 128 messages, so that sequence numbers show their order."""

    def __init__(
        self, seed: int, number: int, commands: int, make: Callable[[Config], AnyGate] = Gate
    ) -> None:
        """As `History`. `make` must make a `Gate`, because the companion uses all of its methods."""
        super().__init__(seed, number, commands, make)
        self._companion = CompanionSystem(self.config)
        self._companion.gate = cast("Gate", self.gate)
        self._companion.core = cast("Any", _HostileCore())
        self._link = _HostileLink(self._companion.link)
        self._companion.link = cast("AutopilotLink", self._link)
        self._writer = MavlinkWriter(self.system, 1)
        self._reader = FrameScanner()
        self._sequences: deque[tuple[float, int]] = deque(maxlen=2000)
        """Time and sequence number of each frame, in order."""
        self._questions: list[int] = []
        """Unanswered questions, as their TIMESYNC time (ns), the newest last."""
        self._link.asks_first = self.rng.random() < 0.5

    def _hear(self, event: Event) -> None:
        packed = _packed(event)
        if packed is None:
            self._link.events.append(event)
            self._companion.receive(b"", self.now_s, emptied=False)
        else:
            self._receive(*packed)

    def _hear_old(self, event: Heartbeat | CurrentMode) -> None:
        self._hear(event)

    def _receive(self, message_id: int, payload: bytes) -> None:
        sequence = self._writer.encoder.seq
        if self.delayed_s > 0.0:
            self._writer.encoder.seq = self._sequence_at(self.now_s - self.delayed_s)
            frame = self._writer.pack_payload(message_id, payload)
            self._writer.encoder.seq = sequence
        else:
            self._sequences.append((self.now_s, sequence))
            frame = self._writer.pack_payload(message_id, payload)
        self._companion.receive(frame, self.now_s, emptied=False)

    def _sequence_at(self, written_s: float) -> int:
        """Sequence number of a frame that the vehicle wrote before the first one after `written_s`."""
        for at_s, sequence in self._sequences:
            if at_s > written_s:
                return (sequence - 1) % 256
        raise AssertionError("no newer frame was sent")

    def _emptied(self) -> None:
        self._companion.receive(b"", self.now_s, emptied=True)
        self.oracle.emptied(self.now_s)

    def _behind(self) -> None:
        self._companion.tick(self.now_s, read_s=self.now_s - _BEHIND_S)
        self.oracle.behind()
        self.oracle.decided_s = self.now_s

    def _decided(self) -> None:
        self._companion.tick(self.now_s, read_s=self.oracle.emptied_s)
        self.oracle.decided_s = self.now_s

    def _answer(self) -> None:
        """Answer one of the questions, mostly the newest."""
        rng = self.rng
        boot_ns = max(1, nanoseconds(self.now_s + self.boot_s))
        if rng.random() < _FORGED:
            asked_ns = nanoseconds(self.now_s - rng.uniform(-1.0, 1.0))
            self._receive(*timesync(boot_ns, asked_ns, 1, 191))
        if not self._questions:
            return
        at = len(self._questions) - 1 if rng.random() < 0.9 else rng.randrange(len(self._questions))
        asked_ns = self._questions.pop(at)
        self._receive(*timesync(boot_ns, asked_ns, 1, 191))
        if self._is_ours:
            self.oracle.answered(asked_ns / 1e9, self.now_s)

    @property
    def _is_ours(self) -> bool:
        """Whether the companion's link listens to this vehicle."""
        vehicle = self._companion.link.vehicle
        return vehicle is not None and vehicle.system_id == self.system

    def _release(self, data: bytes) -> bytes | None:
        self._link.offered = data
        out = self._companion.drain(self.now_s)
        asked, self._link.offered = self._link.offered is None, None
        own = self._link.own
        assert out.startswith(own), "the gate has refused a frame of the companion's link"
        for frame in self._reader.frames(own):
            if frame.message_id == mavlink.MAVLINK_MSG_ID_TIMESYNC:
                self._questions.append(read_timesync(frame.payload)[1])
        return out[len(own) :] if asked else None


def _packed(event: Event) -> tuple[int, bytes] | None:
    """MAVLink message and payload of an event; None if it is no single message."""
    match event:
        case Heartbeat():
            base_mode = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            base_mode |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED if event.armed else 0
            fields = event.custom_mode, event.vehicle_type, _AUTOPILOTS[event.firmware], base_mode, 4, 3
            return mavlink.MAVLINK_MSG_ID_HEARTBEAT, struct.pack("<IBBBBB", *fields)
        case CurrentMode():
            return CURRENT_MODE, struct.pack("<IIB", event.custom_mode, event.custom_mode, 0)
        case GlobalPosition():
            degrees = round(event.lat_deg * 1e7), round(event.lon_deg * 1e7)
            metres = round(event.alt_msl_m * 1e3), round(event.height_above_home_m * 1e3)
            velocity = (round(v * 100.0) for v in event.velocity_ned_mps)
            fields = round(event.time_boot_s * 1e3), *degrees, *metres, *velocity, 0xFFFF
            return mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, struct.pack("<IiiiihhhH", *fields)
        case LocalPosition():
            fields = round(event.time_boot_s * 1e3), *event.position_ned_m, *event.velocity_ned_mps
            return mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, struct.pack("<I6f", *fields)
        case VehicleTime():
            return mavlink.MAVLINK_MSG_ID_SYSTEM_TIME, struct.pack("<QI", 0, round(event.time_boot_s * 1e3))
        case LandedState():
            return mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, bytes((0, _LANDED.index(event.landed)))
        case MissionCurrent():
            state = mavlink.MISSION_STATE_COMPLETE if event.complete else mavlink.MISSION_STATE_ACTIVE
            return mavlink.MAVLINK_MSG_ID_MISSION_CURRENT, struct.pack("<HHBBI", event.seq, 2, state, 0, 0)
    return None
