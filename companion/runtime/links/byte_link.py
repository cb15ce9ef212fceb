"""The interface of every link to an autopilot (UDP, TCP or serial), and the limits on the age of its bytes.

A link loses data rather than deliver it late. Data passed to `send` leaves at once, or is dropped and
counted. Data that the kernel accepted but that does not leave in time is thrown away.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final, Protocol

READ_BYTES: Final = 16 * 1024
"""Bound on the bytes of one call of `receive`, which may exceed it by one datagram. Reading so many bytes
costs well under a millisecond; the parser then takes 2.5 ms on a desktop computer, about 10 ms on a small one
(`bench_links`)."""
HELD_S: Final = 0.1
"""If bytes have waited on this computer for longer than this, nothing newer is queued behind them."""
LATE_S: Final = 0.2
"""Bytes that have waited on this computer for longer than this are thrown away. A link is checked in every
tick, so at 20 Hz no byte leaves older than 0.25 s."""


@dataclass(frozen=True, slots=True)
class Received:
    """Result of one call of `receive`.

    `emptied` means that no received data waits on this computer any more. It does not mean that `data` is
    recent: a kernel whose buffer is full drops the newest data, so after a stall of several seconds even the
    last bytes that waited may be old. Only data of later calls is certain to be recent.
    """

    data: bytes = b""
    emptied: bool = True
    """Whether the kernel reported in this call that nothing more waits; False if the call hit its bound."""


@dataclass(slots=True)
class LinkTrouble:
    """Counts of what went wrong on a link so far, for every kind of link."""

    dropped: int = 0
    """Number of sends dropped completely, because the link was down or had not accepted earlier data."""
    errors: int = 0
    """Number of network errors that were ignored."""
    losses: int = 0
    """Number of times that the link was lost."""
    left_out: int = 0
    """Number of ignored datagrams: from a sender other than the peer, or not MAVLink."""
    discarded: int = 0
    """Number of times that bytes in the kernel were thrown away because they did not leave in time."""


class Link(Protocol):
    """A byte link. `receive`, `send`, `discard` and `abort` never block."""

    def fileno(self) -> int:
        """File descriptor for `select`."""
        ...

    def receive(self, now_s: float) -> Received:
        """Return what has arrived, up to a bound that keeps the call short.

        Raises:
            OSError: the link is lost.
        """
        ...

    def send(self, data: bytes) -> None:
        """Send the data now or drop it: a late setpoint is worse than none.

        Raises:
            OSError: the link is lost.
        """
        ...

    def discard(self) -> None:
        """Throw away data that was sent but has not left.

        Raises:
            OSError: this is possible only by aborting the link.
        """
        ...

    def close(self) -> None:
        """Let data that was sent leave, for `LATE_S` at most, then release the link."""
        ...

    def abort(self) -> None:
        """Release the link at once; data that has not left is thrown away."""
        ...


class Waiting:
    """Tracks for how long bytes that a stream has accepted have waited to leave."""

    def __init__(self) -> None:
        self._given = 0
        self._ends: deque[tuple[int, float]] = deque()

    def add(self, count: int, at_s: float) -> None:
        """Record that `count` bytes were accepted; their age counts from `at_s`."""
        self._given += count
        self._ends.append((self._given, at_s))

    def oldest_s(self, waiting: int) -> float | None:
        """Time from which the age of the oldest of the last `waiting` bytes counts; None if none waits."""
        while self._ends and self._ends[0][0] <= self._given - waiting:
            self._ends.popleft()
        return self._ends[0][1] if self._ends else None
