"""One MAVLink link of the mock vehicle: bytes in, bytes out, and what is due on it when."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

from companion.autopilot.wire import MavlinkMessage, MavlinkReader, MavlinkWriter

_MAX_WAITING_BYTES = 1 << 18
_EPSILON_S = 1e-9


class Link:
    """Streams are per link, as on the real ones. Bytes that nobody drains are bounded."""

    def __init__(self, system_id: int, streams: Mapping[int, float], now_s: float) -> None:
        self.reader = MavlinkReader()
        self.bytes_dropped = 0
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
        """Ids of the messages due by now; each at most once, and a late one does not come twice."""
        limit = now_s + _EPSILON_S
        if self._earliest_s > limit:
            return []
        due = []
        earliest = math.inf
        for message_id, stream in self._streams.items():
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

    def send(self, message: MavlinkMessage) -> None:
        """Encode one message of this vehicle."""
        self.pass_on(self._writer.pack(message))

    def pass_on(self, frame: bytes) -> None:
        """Send bytes as they are."""
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
