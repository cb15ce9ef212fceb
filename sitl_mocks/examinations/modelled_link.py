"""Model in virtual time of the link between vehicle and companion, with the effects of a kernel and a router.

"Down" is from the vehicle to the companion: a router, which may delay frames, passes them to the kernel's
buffer, and the companion's reader takes portions from there. "Up" is the other direction: a stream accepts no
further data until the previous data has left. The figures were measured on Linux 6.18 (loopback, default
buffers).
"""

from __future__ import annotations

import heapq
import math
from collections import deque
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from companion.runtime.links.byte_link import HELD_S, LATE_S

Kind = Literal["udp", "tcp", "pty"]
KINDS: Final[tuple[Kind, ...]] = ("udp", "tcp", "pty")

_BUFFER_BYTES: Final = {"udp": 212_992, "tcp": 3_990_216, "pty": 19_712}
"""Bytes that the kernel holds for a reader that does not read. For UDP with the overhead of each datagram."""
_PORTION_BYTES: Final = {"tcp": 65_536, "pty": 4_095}
"""Greatest number of bytes that one read returns."""
_PORTION_DATAGRAMS = 64
"""Greatest number of datagrams that the companion's UDP link takes at once."""
_DATAGRAM_BYTES = 1400
_SENDER_BYTES: Final = {"udp": 1 << 30, "tcp": 65_536, "pty": 4_096}
"""Bytes that wait at the vehicle's end of a slow or blocked link. Frames that do not fit are not sent."""
_BITS_PER_BYTE = 10


def datagram_cost(size: int) -> int:
    """Bytes of the kernel's buffer that a datagram of this size takes."""
    return 832 if size <= 192 else 1283 if size <= 700 else 2315


@dataclass(slots=True)
class Weather:
    """Current impairments of the link. Probabilities apply to each datagram (UDP only)."""

    delay_s: float = 0.0
    """Delay that the router adds in the down direction."""
    duplicate: float = 0.0
    """Probability that a datagram arrives a second time, up to 0.1 s later."""
    reorder: float = 0.0
    """Probability that a datagram is delayed by up to 0.1 s, so that later ones may overtake it."""
    rate_bps: float = math.inf
    """Data rate in bits per second: down, and also up if the link is a stream."""
    down_stands: bool = False
    up_stands: bool = False


class ModelledLink:
    """One modelled link. Times must not decrease.

    Args:
        portions: number of portions that the reader takes directly after a stall, before the companion
            decides; None: until nothing waits. At all other times it reads until nothing waits.
        routed: True: a router sends each frame as a separate datagram. False: frames that the vehicle sends
            at once share datagrams.
        buffered: False: a real kernel follows the router, and arriving frames are only in `news`.
    """

    def __init__(
        self,
        kind: Kind,
        rng: np.random.Generator,
        *,
        portions: int | None = None,
        routed: bool = True,
        buffered: bool = True,
    ) -> None:
        self.kind: Kind = kind
        self.weather = Weather()
        self.portions = portions
        self.dropped = 0
        """Number of frames lost because the buffer was full."""
        self._rng = rng
        self._routed = routed
        self._buffered = buffered
        self._count = 0
        self._way: list[tuple[float, int, float, tuple[bytes, ...]]] = []
        """Down: time of arrival, a number that breaks ties, time of sending, frames."""
        self._held: list[tuple[float, tuple[bytes, ...]]] = []
        """Down: time of sending, and frames that wait on a blocked stream."""
        self._free_s = self._up_free_s = -math.inf
        """Time until which each direction of a slow link is busy."""
        self._buffer: deque[bytes] = deque()
        self._buffer_bytes = 0
        self._stream = bytearray()
        self._news: list[tuple[float, bytes]] = []
        self._up: deque[tuple[float, float, bytes]] = deque()
        """Up: time of arrival, time of decision, bytes."""
        self._up_held: tuple[float, float, bytes] | None = None
        """Up: time of sending, time of decision and bytes of the data that waits on a blocked stream."""

    # ------------------------------------------------------------ down

    def tell(self, now_s: float, frames: list[bytes]) -> None:
        """Send frames down from the vehicle or from another sender on its network."""
        self._release(now_s)
        if self.kind == "udp" and not self._routed:
            for datagram in _packed(frames):
                self._send(now_s, datagram)
            return
        for frame in frames:
            self._send(now_s, (frame,))

    def _send(self, now_s: float, frames: tuple[bytes, ...]) -> None:
        weather = self.weather
        if weather.down_stands:
            waiting = sum(len(f) for _, held in self._held for f in held)
            if self.kind != "udp" and waiting < _SENDER_BYTES[self.kind]:
                self._held.append((now_s, frames))
            else:
                self.dropped += len(frames)
            return
        at_s = now_s + weather.delay_s
        if weather.rate_bps < math.inf:
            took_s = sum(map(len, frames)) * _BITS_PER_BYTE / weather.rate_bps
            begins_s = max(self._free_s, at_s)
            if (begins_s - at_s) * weather.rate_bps / _BITS_PER_BYTE > _SENDER_BYTES[self.kind]:
                self.dropped += len(frames)
                return
            at_s = self._free_s = begins_s + took_s
        elif self.kind != "udp":
            at_s = self._free_s = max(self._free_s, at_s)  # a stream keeps its order
        if self.kind == "udp" and weather.reorder and self._rng.random() < weather.reorder:
            at_s += float(self._rng.uniform(0.0, 0.1))
        if at_s <= now_s and not self._way:
            self._arrive(now_s, frames)
        else:
            heapq.heappush(self._way, (at_s, self._next(), now_s, frames))
        if self.kind == "udp" and weather.duplicate and self._rng.random() < weather.duplicate:
            again_s = at_s + float(self._rng.uniform(0.0, 0.1))
            heapq.heappush(self._way, (again_s, self._next(), now_s, frames))

    def _next(self) -> int:
        self._count += 1
        return self._count

    def _release(self, now_s: float) -> None:
        """Forward frames that are no longer blocked or are due."""
        if self._held and not self.weather.down_stands:
            held, self._held = self._held, []
            for sent_s, frames in held:
                heapq.heappush(self._way, (now_s, self._next(), sent_s, frames))
        while self._way and self._way[0][0] <= now_s:
            _, _, sent_s, frames = heapq.heappop(self._way)
            self._arrive(sent_s, frames)

    def hurry(self, now_s: float) -> None:
        """Restore the full data rate: data that is under way arrives now."""
        self._way = [(min(at_s, now_s), number, sent_s, frames) for at_s, number, sent_s, frames in self._way]
        self._way.sort(key=lambda item: item[1])
        self._up = deque((min(at_s, now_s), decided_s, data) for at_s, decided_s, data in self._up)
        self._free_s = self._up_free_s = -math.inf

    def _arrive(self, sent_s: float, frames: tuple[bytes, ...]) -> None:
        """Put frames into the kernel's buffer. Frames that do not fit are lost, so the newest are dropped."""
        if not self._buffered:
            self._news += [(sent_s, frame) for frame in frames]
            return
        size = sum(map(len, frames))
        cost = datagram_cost(size) if self.kind == "udp" else size
        if self._buffer_bytes + cost > _BUFFER_BYTES[self.kind]:
            self.dropped += len(frames)
            return
        self._buffer_bytes += cost
        if self.kind == "udp":
            self._buffer.append(b"".join(frames))
        else:
            for frame in frames:
                self._stream += frame
        self._news += [(sent_s, frame) for frame in frames]

    def news(self, now_s: float) -> list[tuple[float, bytes]]:
        """Frames that have entered the kernel's buffer since the last call, each with its time of sending."""
        self._release(now_s)
        news, self._news = self._news, []
        return news

    @property
    def under_way(self) -> bool:
        """Whether data is still to arrive."""
        return bool(self._way or self._up)

    @property
    def waiting(self) -> bool:
        """Whether data can be read."""
        return bool(self._buffer or self._stream)

    def read(self) -> bytes:
        """Read one portion, as the companion's link does; empty when nothing waits."""
        if self.kind == "udp":
            parts = [self._buffer.popleft() for _ in range(min(_PORTION_DATAGRAMS, len(self._buffer)))]
            self._buffer_bytes -= sum(datagram_cost(len(part)) for part in parts)
            return b"".join(parts)
        data = bytes(self._stream[: _PORTION_BYTES[self.kind]])
        del self._stream[: len(data)]
        self._buffer_bytes -= len(data)
        return data

    def clear(self) -> None:
        """Discard data that is under way or waits, as for a new connection."""
        self._way.clear()
        self._held.clear()
        self._buffer.clear()
        self._stream.clear()
        self._news.clear()
        self._up.clear()
        self._buffer_bytes, self._up_held = 0, None

    # ------------------------------------------------------------ up

    def send(self, now_s: float, data: bytes, decided_s: float) -> None:
        """Send data from the companion. A stream that still holds earlier data accepts nothing."""
        if not data:
            return
        weather = self.weather
        if weather.up_stands:
            if self.kind != "udp" and self._up_held is None and self._up_free_s <= now_s:
                self._up_held = now_s, decided_s, data
            return
        if self.kind == "udp":
            self._up.append((now_s, decided_s, data))
            return
        queue_s = HELD_S if self.kind == "pty" else 0.0
        if self._up_held is not None or self._up_free_s - now_s > queue_s:
            return
        gone_s = max(self._up_free_s, now_s) + len(data) * _BITS_PER_BYTE / weather.rate_bps
        if gone_s - now_s > LATE_S:
            return  # The companion discards data that cannot leave in time.
        self._up_free_s = gone_s
        self._up.append((gone_s, decided_s, data))

    def arrived(self, now_s: float) -> list[tuple[float, bytes]]:
        """Data that has reached the vehicle's end: the decision time of each piece, and its bytes."""
        if self._up_held is not None:
            sent_s, decided_s, data = self._up_held
            if now_s - sent_s > LATE_S:
                self._up_held = None  # A stream's link discards data that does not leave in time.
            elif not self.weather.up_stands:
                self._up_held = None
                self._up.append((now_s, decided_s, data))
        found = []
        while self._up and self._up[0][0] <= now_s:
            _, decided_s, data = self._up.popleft()
            found.append((decided_s, data))
        return found


def _packed(frames: list[bytes]) -> list[tuple[bytes, ...]]:
    """Frames grouped into datagrams."""
    datagrams: list[tuple[bytes, ...]] = []
    at, size = 0, 0
    for number, frame in enumerate(frames):
        if size + len(frame) > _DATAGRAM_BYTES and number > at:
            datagrams.append(tuple(frames[at:number]))
            at, size = number, 0
        size += len(frame)
    if frames[at:]:
        datagrams.append(tuple(frames[at:]))
    return datagrams
