"""One MAVLink link of the mock vehicle: bytes in, bytes out, and what is due on it when.

The few messages that come and go many times a second are laid out here and in the telemetry as plain structs;
all others go through pymavlink.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.signing import Signing
from companion.autopilot.wire import CURRENT_MODE, Frame, FrameScanner, MavlinkMessage, MavlinkWriter

_MAX_WAITING_BYTES = 1 << 18
_EPSILON_S = 1e-9


_SETPOINT_ID = int(mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED)
_SETPOINT = struct.Struct("<I11fHBBB")


class Payload(NamedTuple):
    """A message that is already laid out."""

    message_id: int
    body: bytes


class SetpointMessage(NamedTuple):
    """SET_POSITION_TARGET_LOCAL_NED in its order on the wire (m, m/s, rad; NED or body by the frame)."""

    time_boot_ms: int
    x: float
    y: float
    z: float
    vx: float
    vy: float
    vz: float
    afx: float
    afy: float
    afz: float
    yaw: float
    yaw_rate: float
    type_mask: int
    target_system: int
    target_component: int
    coordinate_frame: int


class Link:
    """Streams are per link, as on the real ones. Bytes that nobody drains are bounded."""

    def __init__(
        self,
        system_id: int,
        streams: Mapping[int, float],
        now_s: float,
        signing: Signing | None = None,
        link_id: int = 0,
    ) -> None:
        self._signing = signing
        self._link_id = link_id
        self._scanner = FrameScanner()
        self._decoder = mavlink.MAVLink(None)
        self.bytes_dropped = 0
        self.cut = False
        """Nothing crosses, either way."""
        self.mode_is_news = False
        """CURRENT_MODE has something to tell that was not told on this link."""
        self.params_due: deque[int] = deque()
        """Indices of PARAM_VALUE still to send."""
        self._writer = MavlinkWriter(system_id, 1)
        self._out = bytearray()
        self._streams: dict[int, list[float]] = {}
        self._earliest_s = math.inf
        self.reset(streams, now_s)

    def reset(self, streams: Mapping[int, float], now_s: float) -> None:
        """Forget what was asked for: message id -> interval (s)."""
        self._streams = {message_id: [interval, now_s] for message_id, interval in streams.items()}
        self._earliest_s = now_s
        self.params_due.clear()

    def interval(self, message_id: int) -> float | None:
        """Interval of a stream (s), None when it is off."""
        stream = self._streams.get(message_id)
        return None if stream is None else stream[0]

    def set_interval(self, message_id: int, interval_s: float | None, now_s: float) -> None:
        """Turn a stream on, change it, or turn it off (None)."""
        self._streams.pop(message_id, None)
        if interval_s is not None:
            self._streams[message_id] = [interval_s, now_s]
            self._earliest_s = min(self._earliest_s, now_s)

    def due(self, now_s: float) -> list[int]:
        """Ids of the messages due by now; each at most once, and a late one does not come twice. CURRENT_MODE
        is left to `tells_mode`."""
        limit = now_s + _EPSILON_S
        if self._earliest_s > limit:
            return []
        due = []
        earliest = math.inf
        for message_id, stream in self._streams.items():
            if message_id == CURRENT_MODE:
                continue
            interval, at = stream
            if at <= limit:
                due.append(message_id)
                at += interval
                if at <= limit - interval:
                    at = now_s + interval
                stream[1] = at
            if at < earliest:
                earliest = at
        self._earliest_s = earliest
        return due

    def tells_mode(self, now_s: float) -> bool:
        """Whether CURRENT_MODE may be sent now, its interval after the last one; if so, it must be."""
        stream = self._streams.get(CURRENT_MODE)
        if stream is None or stream[1] > now_s + _EPSILON_S:
            return False
        stream[1] = now_s + stream[0]
        return True

    def feed(self, data: bytes) -> list[tuple[Frame, MavlinkMessage | SetpointMessage]]:
        """The messages completed by some bytes, with their frames; what cannot be read is left out."""
        found: list[tuple[Frame, MavlinkMessage | SetpointMessage]] = []
        if self.cut:
            return found
        for frame in self._scanner.frames(data):
            if self._signing is not None and self._signing.refusal(frame) is not None:
                continue
            if frame.message_id == _SETPOINT_ID:
                body = frame.payload.ljust(_SETPOINT.size, b"\0")
                found.append((frame, SetpointMessage._make(_SETPOINT.unpack_from(body))))
                continue
            try:
                found.append((frame, self._decoder.decode(bytearray(frame.raw))))
            except (mavlink.MAVError, ValueError):
                # ValueError: text fields that are not ASCII.
                continue
        return found

    def send(self, message: MavlinkMessage | Payload) -> None:
        """Encode one message of this vehicle."""
        if isinstance(message, Payload):
            frame = self._writer.pack_payload(message.message_id, message.body)
        else:
            frame = self._writer.pack(message)
        self.pass_on(frame if self._signing is None else self._signing.sign(frame, self._link_id))

    def pass_on(self, frame: bytes) -> None:
        """Send bytes as they are."""
        if self.cut:
            return
        if len(self._out) + len(frame) > _MAX_WAITING_BYTES:
            self.bytes_dropped += len(frame)
            return
        self._out += frame

    def drain(self) -> bytes:
        """What waits to be sent."""
        if not self._out:
            return b""
        data = bytes(self._out)
        self._out.clear()
        return data
