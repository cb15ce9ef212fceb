"""The flight's link: closed and opened anew when it is lost, for as long as the flight lasts.

Nobody is told but the user: the heart sees the silence and faults by itself, and the loop, with its Remote ID
broadcast, goes on.
"""

from __future__ import annotations

import queue
import select
import threading
import time
from collections.abc import Callable

from companion.runtime.links import Link, LinkTrouble, open_link

_PAUSE_S = 1.0
"""Before each attempt to open the link again."""
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

    def receive(self, now_s: float) -> bytes:
        """What has arrived; empty when nothing has, or while the link is down."""
        if self._link is None and not self._take_opened():
            return b""
        assert self._link is not None
        try:
            data = self._link.receive(now_s)
        except OSError as error:
            self._lose(error)
            return b""
        self.received_bytes += len(data)
        return data

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

    def close(self) -> None:
        """Release it, for good."""
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

    def _lose(self, error: OSError) -> None:
        assert self._link is not None
        self._link.close()
        self._link = None
        self.trouble.losses += 1
        self._say(f"link {self._name}: lost: {error.strerror or error}; opening it again")
        # In a thread: looking up a name, connecting or opening a device can take seconds.
        threading.Thread(target=self._reopen, name="reopen", daemon=True).start()

    def _reopen(self) -> None:
        while not self._closed.wait(_PAUSE_S):
            try:
                link = self._open(self._name, self.trouble)
            except Exception:
                # Whatever it was: if this thread ended, the flight would be without a link for good.
                continue
            self._opened.put(link)
            return
