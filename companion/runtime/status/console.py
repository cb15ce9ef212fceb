"""Console output of a flight, printed by a separate thread.

A terminal can stop accepting lines and a pipe can break. Neither may delay a setpoint or end a flight.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable

_LINES = 200
_PATIENCE_S = 1.0


class Voice:
    """Prints lines for the user. Lines that cannot be printed are dropped and counted."""

    def __init__(self, out: Callable[[str], None]) -> None:
        self._out = out
        self._queue: queue.Queue[str | None] = queue.Queue(_LINES)
        self._overflowed = 0
        self._refused = 0
        self._thread = threading.Thread(target=self._print, name="voice", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Number of lines that were not printed."""
        return self._overflowed + self._refused

    def say(self, line: str) -> None:
        """Queue a line for printing; never waits.

        Lines may hold names from received messages, so unprintable characters, which could control a
        terminal, are shown as "?".
        """
        try:
            self._queue.put_nowait("".join(c if c.isprintable() else "?" for c in line))
        except queue.Full:
            self._overflowed += 1

    def close(self) -> None:
        """Print the lines that are queued. Waits for a bounded time only."""
        with contextlib.suppress(queue.Full):
            self._queue.put(None, timeout=_PATIENCE_S)
        self._thread.join(_PATIENCE_S)

    def _print(self) -> None:
        while (line := self._queue.get()) is not None:
            try:
                self._out(line)
            except (OSError, ValueError):
                # OSError: a broken pipe or closed terminal. ValueError: a closed file, or a character that
                # cannot be encoded.
                self._refused += 1
