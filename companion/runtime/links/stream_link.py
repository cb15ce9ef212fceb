"""Common part of the TCP and serial links: frames leave whole and soon or not at all; reading is bounded."""

from __future__ import annotations

import contextlib
import time
from abc import ABC, abstractmethod

from companion.runtime import clock
from companion.runtime.links.byte_link import HELD_S, LATE_S, READ_BYTES, LinkTrouble, Received, Waiting

_READS = 64
"""Largest number of reads in one call, so that a far end that writes byte by byte does not hold the call."""
_CLOSING_LOOK_S = 0.005
_UNHEARD_BYTES = 1024
"""Largest number of bytes sent without a byte received, on links whose far end keeps unread data (`keeps`),
where a stopped program would find them later. This is about 15 setpoints. A vehicle in flight sends several
times a second, far more often than this bound requires."""
_UNHEARD_S = 5.0
"""After this time without a send, one more send is allowed in spite of `_UNHEARD_BYTES`, and so on, because a
far end may wait until it receives something."""


class StreamLink(ABC):
    """A byte stream.

    Args:
        trouble: counts what goes wrong.
        keeps: whether the far end's kernel keeps data that its program does not read. A stopped program would
            act on this data when it continues, and we cannot recall it. A far end that sends nothing
            therefore receives only a little data.
    """

    def __init__(self, trouble: LinkTrouble, *, keeps: bool) -> None:
        self._trouble = trouble
        self._keeps = keeps
        self._unheard = 0
        self._given_s = float("-inf")
        self._unsent = b""
        self._waiting = Waiting()

    def receive(self, now_s: float) -> Received:
        """Return what has arrived.

        Raises:
            OSError: the link is lost.
        """
        self._look(clock.now_s())
        parts: list[bytes] = []
        room, emptied = READ_BYTES, False
        for _ in range(_READS):
            try:
                part = self._read(room)
            except BlockingIOError:
                emptied = True
                break
            except OSError:
                if not parts:
                    raise
                break  # the next call meets the same error again
            parts.append(part)
            room -= len(part)
            if room <= 0:
                break
        if parts:
            self._unheard = 0
        return Received(b"".join(parts), emptied)

    def send(self, data: bytes) -> None:
        """Send the unsent rest of earlier data, then the new data. If older data still waits, or the link is
        not to be given more, the new data is dropped.

        Raises:
            OSError: the link is lost.
        """
        now = clock.now_s()
        self._look(now)
        self._push()
        if not data:
            return
        if self._unsent or self._unanswered(len(data), now) or not self._takes_more(now):
            self._trouble.dropped += 1
            return
        # The checks above call the kernel, which may have held up this process.
        taken = 0 if clock.now_s() - now > HELD_S else self._try_write(data)
        if not taken:
            self._trouble.dropped += 1
            return
        self._unsent = data[taken:]
        self._unheard += len(data)
        self._given_s = now
        self._waiting.add(len(data), self._counts_from(len(data), now))

    def close(self) -> None:
        """Let data that was sent leave, for `LATE_S` at most, then release the link."""
        end = clock.now_s() + LATE_S
        with contextlib.suppress(OSError):
            while self._here() and clock.now_s() < end:
                self._push()
                time.sleep(_CLOSING_LOOK_S)
        self._release()

    def _unanswered(self, count: int, now_s: float) -> bool:
        too_much = self._unheard > 0 and self._unheard + count > _UNHEARD_BYTES
        return self._keeps and too_much and now_s - self._given_s < _UNHEARD_S

    def _here(self) -> int:
        """Number of bytes that were sent but have not left."""
        return self._queued() + len(self._unsent)

    def _oldest_s(self) -> float | None:
        return self._waiting.oldest_s(self._here())

    def _look(self, now_s: float) -> None:
        """Throw away data that should have left by now."""
        oldest = self._oldest_s()
        if oldest is not None and now_s - oldest > self._late_after_s():
            self._trouble.discarded += 1
            self.discard()

    def _push(self) -> None:
        if self._unsent:
            self._unsent = self._unsent[self._try_write(self._unsent) :]

    def _try_write(self, data: bytes) -> int:
        try:
            return self._write(data)
        except BlockingIOError:
            return 0

    def _counts_from(self, count: int, now_s: float) -> float:
        """Time from which the age of bytes that are sent now counts."""
        return now_s

    def _late_after_s(self) -> float:
        """Age at which bytes are thrown away."""
        return LATE_S

    @abstractmethod
    def discard(self) -> None:
        """Throw away data that was sent but has not left. Raises OSError if only `abort` can do that."""

    @abstractmethod
    def abort(self) -> None:
        """Release the link at once; data that has not left is thrown away."""

    @abstractmethod
    def _release(self) -> None:
        """Release the link, after data that was sent has had time to leave."""

    @abstractmethod
    def _read(self, count: int) -> bytes:
        """Read at most `count` bytes. Raises OSError at the end of the stream."""

    @abstractmethod
    def _write(self, data: bytes) -> int:
        """Pass data to the kernel. Returns how many bytes it accepted."""

    @abstractmethod
    def _queued(self) -> int:
        """Number of bytes that our kernel has accepted but the line or the peer's kernel has not."""

    @abstractmethod
    def _takes_more(self, now_s: float) -> bool:
        """Whether more data should be passed to the kernel."""
