"""One MAVLink link of the mock vehicle: bytes in, bytes out, and the schedule of its message streams.

The few messages that are exchanged many times a second are packed as plain structs, here and in the
telemetry. All others are handled by pymavlink.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Mapping

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.signing import Signing
from companion.autopilot.wire import CURRENT_MODE, Frame, FrameScanner, MavlinkMessage, MavlinkWriter

_MAX_WAITING_BYTES = 1 << 18
_EPSILON_S = 1e-9


_SETPOINT_ID = int(mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED)
_SETPOINT = struct.Struct("<I11fHBBB")
_TIMESYNC_ID = int(mavlink.MAVLINK_MSG_ID_TIMESYNC)
_TIMESYNC = struct.Struct("<qq")
_DATA_STREAMS = {
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
        mavlink.MAVLINK_MSG_ID_MISSION_CURRENT,
    ),
    mavlink.MAV_DATA_STREAM_POSITION: (
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    ),
    mavlink.MAV_DATA_STREAM_EXTRA1: (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
    mavlink.MAV_DATA_STREAM_EXTRA2: (mavlink.MAVLINK_MSG_ID_VFR_HUD,),
    mavlink.MAV_DATA_STREAM_EXTRA3: (
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
    ),
}
"""Message ids of each stream of REQUEST_DATA_STREAM."""


class Payload(msgspec.Struct, frozen=True, gc=False):
    """A message whose payload is already packed."""

    message_id: int
    body: bytes


def packed(kind: type[MavlinkMessage], *fields: float) -> Payload:
    """A message of one of pymavlink's classes, without an object of that class, which takes three times as
    long to make and to encode.

    Args:
        fields: fields in wire order, which is that of `kind.ordered_fieldnames`. Extensions may be left out;
            another version of pymavlink may know more of them.
    """
    extensions = len(kind.ordered_fieldnames) - len(fields)
    return Payload(kind.id, kind.unpacker.pack(*fields, *[0] * extensions))


class SetpointMessage(msgspec.Struct, frozen=True, gc=False):
    """SET_POSITION_TARGET_LOCAL_NED, fields in wire order (m, m/s, rad; NED or body axes by the frame)."""

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


class TimesyncMessage(msgspec.Struct, frozen=True, gc=False):
    """TIMESYNC, fields in wire order (ns)."""

    tc1: int
    ts1: int

    def get_type(self) -> str:
        """Name of the message, as of pymavlink's."""
        return "TIMESYNC"


class Link:
    """One link with its own message streams, as on the real autopilots.

    The buffer of unsent bytes is bounded.
    """

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
        self.cut = False
        """The link is interrupted in both directions."""
        self.mode_is_news = False
        """The status was published, and no CURRENT_MODE has reported it on this link yet."""
        self.params_due: deque[int] = deque()
        """Indices of the parameters whose PARAM_VALUE is still to be sent."""
        self._writer = MavlinkWriter(system_id, 1)
        self._out = bytearray()
        self._streams: dict[int, list[float]] = {}
        self._earliest_s = math.inf
        self.reset(streams, now_s)

    def reset(self, streams: Mapping[int, float], now_s: float) -> None:
        """Replace all requested streams by `streams` (message id -> interval in s)."""
        self._streams = {message_id: [interval, now_s] for message_id, interval in streams.items()}
        self._earliest_s = now_s
        self.params_due.clear()

    def interval(self, message_id: int) -> float | None:
        """Interval of a stream (s); None if it is off."""
        stream = self._streams.get(message_id)
        return None if stream is None else stream[0]

    def set_interval(self, message_id: int, interval_s: float | None, now_s: float) -> None:
        """Turn a stream on, change its interval, or turn it off (None)."""
        self._streams.pop(message_id, None)
        if interval_s is not None:
            self._streams[message_id] = [interval_s, now_s]
            self._earliest_s = min(self._earliest_s, now_s)

    def set_data_stream(self, wanted: int, interval_s: float | None, now_s: float) -> None:
        """Set the interval of all messages of a stream of REQUEST_DATA_STREAM; None turns them off."""
        for stream, message_ids in _DATA_STREAMS.items():
            if wanted in (mavlink.MAV_DATA_STREAM_ALL, stream):
                for message_id in message_ids:
                    self.set_interval(message_id, interval_s, now_s)

    def due(self, now_s: float) -> list[int]:
        """Ids of the messages that are due.

        A message that is late by several intervals is returned only once. CURRENT_MODE is left to
        `tells_mode`.
        """
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
        """Whether the interval of CURRENT_MODE has passed.

        If so, it restarts and the caller must send one.
        """
        stream = self._streams.get(CURRENT_MODE)
        if stream is None or stream[1] > now_s + _EPSILON_S:
            return False
        stream[1] = now_s + stream[0]
        return True

    def feed(self, data: bytes) -> list[tuple[Frame, MavlinkMessage | SetpointMessage | TimesyncMessage]]:
        """Return the messages that these bytes complete, with their frames. Unreadable frames are skipped."""
        found: list[tuple[Frame, MavlinkMessage | SetpointMessage | TimesyncMessage]] = []
        if self.cut:
            return found
        for frame in self._scanner.frames(data):
            if self._signing is not None and self._signing.refusal(frame) is not None:
                continue
            if frame.message_id == _SETPOINT_ID:
                body = frame.payload.ljust(_SETPOINT.size, b"\0")
                found.append((frame, SetpointMessage(*_SETPOINT.unpack_from(body))))
                continue
            if frame.message_id == _TIMESYNC_ID:
                body = frame.payload.ljust(_TIMESYNC.size, b"\0")
                found.append((frame, TimesyncMessage(*_TIMESYNC.unpack_from(body))))
                continue
            try:
                found.append((frame, self._decoder.decode(bytearray(frame.raw))))
            except (mavlink.MAVError, ValueError):
                # pymavlink raises ValueError for text fields that are not ASCII.
                continue
        return found

    def send(self, message: MavlinkMessage | Payload) -> None:
        """Encode one message of this vehicle and queue it."""
        if isinstance(message, Payload):
            frame = self._writer.pack_payload(message.message_id, message.body)
        else:
            frame = self._writer.pack(message)
        self.pass_on(frame if self._signing is None else self._signing.sign(frame, self._link_id))

    def answer_timesync(self, tc1: int, ts1: int) -> None:
        """Send TIMESYNC (ns)."""
        self.send(Payload(_TIMESYNC_ID, _TIMESYNC.pack(tc1, ts1)))

    def pass_on(self, frame: bytes) -> None:
        """Queue a frame unchanged."""
        if self.cut:
            return
        if len(self._out) + len(frame) <= _MAX_WAITING_BYTES:
            self._out += frame

    def drain(self) -> bytes:
        """Return and remove the bytes that wait to be sent."""
        if not self._out:
            return b""
        data = bytes(self._out)
        self._out.clear()
        return data
