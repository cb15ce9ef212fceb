"""The flight's link: when it is lost it is closed and reopened, for as long as the flight lasts.

Only the user is informed of a loss. The core (`companion.core`) sees the silence and faults by itself, and
the loop continues, with its Remote ID broadcast. A stream that does not deliver what was sent counts as lost,
too, because only aborting it keeps old setpoints from leaving later.
"""

from __future__ import annotations

import contextlib
import queue
import select
import threading
import time
from collections.abc import Callable

from companion.runtime import clock
from companion.runtime.links.byte_link import Link, LinkTrouble, Received
from companion.runtime.links.open_link import open_link

_FIRST_PAUSE_S = 0.1
"""Pause before the first attempt to reopen the link; an aborted connection mostly reopens at once."""
_PAUSE_S = 1.0
"""Pause before each further attempt."""
_SAY_AGAIN_S = 10.0
"""Shortest time between two messages that a link which stays up does not deliver what is sent."""
_LOOK_S = 0.05
"""Period of the checks of a link that is down."""


class KeptLink:
    """A link with a given name that is reopened after each loss.

    Raises:
        ConfigError: the link cannot be opened when this object is constructed.
    """

    def __init__(
        self,
        name: str,
        say: Callable[[str], None],
        opener: Callable[[str, LinkTrouble], Link] = open_link,
    ) -> None:
        self.trouble = LinkTrouble()
        self.received_bytes = 0
        self._name = name
        self._say = say
        self._open = opener
        self._closed = threading.Event()
        self._opened: queue.SimpleQueue[Link] = queue.SimpleQueue()
        self._discarded = 0
        self._said_s = float("-inf")
        self._link: Link | None = opener(name, self.trouble)

    @property
    def up(self) -> bool:
        """Whether the link is open now."""
        return self._link is not None

    def wait(self, timeout_s: float) -> None:
        """Wait for bytes, for `timeout_s` at most."""
        if self._link is None:
            time.sleep(min(timeout_s, _LOOK_S))
        else:
            select.select([self._link], [], [], timeout_s)

    def receive(self, now_s: float) -> Received:
        """Return what has arrived, in portions. If the link is down (see `up`), the result is empty, with
        `emptied` True."""
        if self._link is None and not self._take_opened():
            return Received()
        assert self._link is not None
        try:
            received = self._link.receive(now_s)
        except OSError as error:
            self._lose(error)
            return Received()
        self.received_bytes += len(received.data)
        self._tell_discarded()
        return received

    def send(self, data: bytes) -> None:
        """Send the data now or drop it."""
        if self._link is None:
            self.trouble.dropped += bool(data)
            return
        try:
            self._link.send(data)
        except OSError as error:
            self.trouble.dropped += bool(data)
            self._lose(error)
        else:
            self._tell_discarded()

    def discard(self) -> None:
        """Throw away data that was sent before and has not left, as far as this computer can.

        Call this when the data may have become old: after this process was held up, or when the vehicle no
        longer answers. A serial queue is flushed. A TCP connection is aborted and reopened, unless the far
        end's kernel has acknowledged everything. A datagram cannot be recalled.
        """
        if self._link is None:
            return
        try:
            self._link.discard()
        except OSError as error:
            self._lose(error)

    def close(self) -> None:
        """Let data that was sent leave, for 0.2 s at most, then release the link for good."""
        self._closed.set()
        self._take_opened()
        if self._link is not None:
            self._link.close()
            self._link = None

    def _take_opened(self) -> bool:
        try:
            self._link = self._opened.get_nowait()
        except queue.Empty:
            return False
        self._say(f"link {self._name}: restored")
        return True

    def _tell_discarded(self) -> None:
        if self.trouble.discarded == self._discarded:
            return
        self._discarded = self.trouble.discarded
        now = clock.now_s()
        if now - self._said_s > _SAY_AGAIN_S:
            self._said_s = now
            self._say(
                f"link {self._name}: nothing gets through; data that waited too long to be sent was discarded"
            )

    def _lose(self, error: OSError) -> None:
        assert self._link is not None
        # A link that is already broken may fail to abort.
        with contextlib.suppress(OSError):
            self._link.abort()
        self._link = None
        self._discarded = self.trouble.discarded
        self.trouble.losses += 1
        self._say(f"link {self._name}: lost: {error.strerror or error}; reopening it")
        # In a thread: looking up a name, connecting or opening a device can take seconds.
        threading.Thread(target=self._reopen, name="reopen", daemon=True).start()

    def _reopen(self) -> None:
        pause_s = _FIRST_PAUSE_S
        while not self._closed.wait(pause_s):
            pause_s = _PAUSE_S
            try:
                link = self._open(self._name, self.trouble)
            except Exception:
                # Retry after any exception: if this thread ended, the flight would have no link for good.
                continue
            self._opened.put(link)
            return
