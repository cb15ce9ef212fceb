"""What TCP and serial share: frames leave whole and soon, or not at all; reading ends at a bound."""

from __future__ import annotations

import contextlib
import time
from abc import ABC, abstractmethod

from companion.runtime import clock
from companion.runtime.links.byte_link import LATE_S, READ_BYTES, LinkTrouble, Received, Waiting

_READS = 64
"""A writer that delivers byte by byte must not hold a call."""
_CLOSING_LOOK_S = 0.005
_UNHEARD_BYTES = 1024
"""What goes to a far end without a byte coming back, where a stopped program would find it later: 15
setpoints. A vehicle that is flown is heard several times a second, far more often than this needs."""
_UNHEARD_S = 5.0
"""After that one more send goes out, and so on: a far end may wait until it is spoken to."""


class StreamLink(ABC):
    """A byte stream.

    Args:
        trouble: counts what goes wrong.
        keeps: whether the far end's kernel keeps what nobody reads there. A stopped program acts on that when
            it goes on, and nothing here can recall it. So a far end that says nothing is given little.
    """

    def __init__(self, trouble: LinkTrouble, *, keeps: bool) -> None:
        self._trouble = trouble
        self._keeps = keeps
        self._unheard = 0
        self._given_s = float("-inf")
        self._unsent = b""
        self._waiting = Waiting()

    def receive(self, now_s: float) -> Received:
        """What has arrived.

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
                break  # the next call finds the end again
            parts.append(part)
            room -= len(part)
            if room <= 0:
                break
        if parts:
            self._unheard = 0
        return Received(b"".join(parts), emptied)

    def send(self, data: bytes) -> None:
        """Send the rest of what was sent before, then the new data, if nothing old waits in front of it.

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
        taken = self._try_write(data)
        if not taken:
            self._trouble.dropped += 1
            return
        self._unsent = data[taken:]
        self._unheard += len(data)
        self._given_s = now
        self._waiting.add(len(data), self._counts_from(len(data), now))

    def close(self) -> None:
        """Let what was sent leave, for `LATE_S` at most, and release the link."""
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
        """Bytes that were sent and have not left."""
        return self._queued() + len(self._unsent)

    def _oldest_s(self) -> float | None:
        return self._waiting.oldest_s(self._here())

    def _look(self, now_s: float) -> None:
        """Throw away what should have left by now."""
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
        """From when on the age of what is sent now counts."""
        return now_s

    def _late_after_s(self) -> float:
        """At what age it is thrown away."""
        return LATE_S

    @abstractmethod
    def discard(self) -> None:
        """Throw away what was sent and has not left; OSError where only giving the link up does that."""

    @abstractmethod
    def abort(self) -> None:
        """Release the link at once; what has not left is thrown away."""

    @abstractmethod
    def _release(self) -> None:
        """Release the link, after what was sent has had its time."""

    @abstractmethod
    def _read(self, count: int) -> bytes:
        """At most so many bytes; OSError at the end of the stream."""

    @abstractmethod
    def _write(self, data: bytes) -> int:
        """Hand data to the kernel; how much it took."""

    @abstractmethod
    def _queued(self) -> int:
        """Bytes that the kernel has taken, and the line or the peer's kernel has not."""

    @abstractmethod
    def _takes_more(self, now_s: float) -> bool:
        """Whether the kernel is to be given more."""
