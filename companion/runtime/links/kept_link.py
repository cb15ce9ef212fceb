"""The flight's link: closed and opened anew when it is lost, for as long as the flight lasts.

Nobody is told but the user: the heart sees the silence and faults by itself, and the loop, with its Remote ID
broadcast, goes on. A stream that does not carry what it was given is lost, too: only aborting it keeps old
setpoints from leaving later.
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
"""Before the first attempt to open the link again: an aborted connection is mostly had anew at once."""
_PAUSE_S = 1.0
"""Before each further one."""
_SAY_AGAIN_S = 10.0
"""That a link which stays up does not carry what it is given is said this often at most."""
_LOOK_S = 0.05
"""How often a link that is down is looked at."""


class KeptLink:
    """One link by name, through all its losses.

    Raises:
        ConfigError: it cannot be opened at first.
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
        """Whether there is a link now."""
        return self._link is not None

    def wait(self, timeout_s: float) -> None:
        """Wait for bytes; no longer than `timeout_s`."""
        if self._link is None:
            time.sleep(min(timeout_s, _LOOK_S))
        else:
            select.select([self._link], [], [], timeout_s)

    def receive(self, now_s: float) -> Received:
        """What has arrived, in portions; of a link that is down nothing, and nothing waits (see `up`)."""
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
        """Send now, or lose it."""
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
        """Let nothing leave any more that was sent before, as far as this computer decides it.

        To be called where what was sent may have become old: after this process was held up, or when the
        vehicle does not answer any more. A serial queue is flushed; a TCP connection is aborted and opened
        anew, unless the far end's kernel has acknowledged all. A datagram cannot be recalled.
        """
        if self._link is None:
            return
        try:
            self._link.discard()
        except OSError as error:
            self._lose(error)

    def close(self) -> None:
        """Let what was sent leave, for a fifth of a second at most, and release the link for good."""
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
        self._say(f"link {self._name}: back")
        return True

    def _tell_discarded(self) -> None:
        if self.trouble.discarded == self._discarded:
            return
        self._discarded = self.trouble.discarded
        now = clock.now_s()
        if now - self._said_s > _SAY_AGAIN_S:
            self._said_s = now
            self._say(f"link {self._name}: does not carry what is sent; what waited too long was thrown away")

    def _lose(self, error: OSError) -> None:
        assert self._link is not None
        # Of a link that is broken already nothing may be left to abort.
        with contextlib.suppress(OSError):
            self._link.abort()
        self._link = None
        self._discarded = self.trouble.discarded
        self.trouble.losses += 1
        self._say(f"link {self._name}: lost: {error.strerror or error}; opening it again")
        # In a thread: looking up a name, connecting or opening a device can take seconds.
        threading.Thread(target=self._reopen, name="reopen", daemon=True).start()

    def _reopen(self) -> None:
        pause_s = _FIRST_PAUSE_S
        while not self._closed.wait(pause_s):
            pause_s = _PAUSE_S
            try:
                link = self._open(self._name, self.trouble)
            except Exception:
                # Whatever it was: if this thread ended, the flight would be without a link for good.
                continue
            self._opened.put(link)
            return
