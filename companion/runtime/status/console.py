"""What a flight says, printed by a thread of its own.

A terminal can stop taking lines and a pipe can break; neither may hold up a setpoint or end a flight.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable

_LINES = 200
_PATIENCE_S = 1.0


class Voice:
    """Lines for whoever watches. What cannot be printed is dropped and counted."""

    def __init__(self, out: Callable[[str], None]) -> None:
        self._out = out
        self._queue: queue.Queue[str | None] = queue.Queue(_LINES)
        self._overflowed = 0
        self._refused = 0
        self._thread = threading.Thread(target=self._print, name="voice", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Lines that nobody saw."""
        return self._overflowed + self._refused

    def say(self, line: str) -> None:
        """Have a line printed; never waits.

        Names in it come from strangers: what could steer a terminal is shown as "?".
        """
        try:
            self._queue.put_nowait("".join(c if c.isprintable() else "?" for c in line))
        except queue.Full:
            self._overflowed += 1

    def close(self) -> None:
        """Let the last lines out; waits for a moment, not for ever."""
        with contextlib.suppress(queue.Full):
            self._queue.put(None, timeout=_PATIENCE_S)
        self._thread.join(_PATIENCE_S)

    def _print(self) -> None:
        while (line := self._queue.get()) is not None:
            try:
                self._out(line)
            except (OSError, ValueError):
                # A broken pipe or closed terminal; a closed file or a character that it cannot show.
                self._refused += 1
