"""What every link to an autopilot offers, whatever it goes through, and how old its bytes may become.

A link loses data rather than deliver it late. What it is given leaves at once, or is dropped and counted;
what does not leave in time although the kernel had taken it is thrown away.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final, Protocol

READ_BYTES: Final = 16 * 1024
"""One call of `receive` takes no more than this and a single datagram. Reading it costs well under a
millisecond; the parser then works 2.5 ms on a desktop computer, some 10 ms on a small one (`bench_links`)."""
HELD_S: Final = 0.1
"""What waits here for longer than this is given nothing newer behind it."""
LATE_S: Final = 0.2
"""Bytes that are here for longer than this are thrown away. A link is looked at in every tick: at 20 Hz none
of them leaves older than 0.25 s."""


@dataclass(frozen=True, slots=True)
class Received:
    """What one call took from a link.

    `emptied` tells that nothing waits in this computer any more. It does not tell that `data` is recent: a
    kernel whose buffer is full drops the newest, so after a stall of several seconds the last of what waited
    may itself be old. Only what comes in later calls is sure to be recent then.
    """

    data: bytes = b""
    emptied: bool = True
    """The kernel said in this call that there is nothing more. False where the call ended at its bound."""


@dataclass(slots=True)
class LinkTrouble:
    """What went wrong on a link so far, whatever it went through."""

    dropped: int = 0
    """Sends dropped whole, because the link was down or had not taken what came before."""
    errors: int = 0
    """Refusals of the network that were passed over."""
    losses: int = 0
    """Times the link was lost."""
    left_out: int = 0
    """Datagrams of another sender than the peer, or that are no MAVLink."""
    discarded: int = 0
    """Times that bytes which the kernel had taken were thrown away, because they did not leave in time."""


class Link(Protocol):
    """A byte link. `receive`, `send`, `discard` and `abort` never block."""

    def fileno(self) -> int:
        """For `select`."""
        ...

    def receive(self, now_s: float) -> Received:
        """What has arrived, up to a bound that keeps the call short.

        Raises:
            OSError: the link is lost.
        """
        ...

    def send(self, data: bytes) -> None:
        """Send now, or lose it: a late setpoint is worse than none.

        Raises:
            OSError: the link is lost.
        """
        ...

    def discard(self) -> None:
        """Throw away what was sent and has not left.

        Raises:
            OSError: only giving the link up does that.
        """
        ...

    def close(self) -> None:
        """Let what was sent leave, for `LATE_S` at most, and release the link."""
        ...

    def abort(self) -> None:
        """Release the link at once; what has not left is thrown away."""
        ...


class Waiting:
    """Which of the bytes that a stream was given are still here, and since when."""

    def __init__(self) -> None:
        self._given = 0
        self._ends: deque[tuple[int, float]] = deque()

    def add(self, count: int, at_s: float) -> None:
        """So many bytes were given; their age counts from `at_s`."""
        self._given += count
        self._ends.append((self._given, at_s))

    def oldest_s(self, waiting: int) -> float | None:
        """When the oldest of the last `waiting` bytes came; None where none waits."""
        while self._ends and self._ends[0][0] <= self._given - waiting:
            self._ends.popleft()
        return self._ends[0][1] if self._ends else None
