"""The watchdog of the flight loop: ends a process whose loop hangs, so that it can be started anew.

A loop that hangs sends nothing, and nothing avoids. What counts is the time for which the process ran without
a report of its loop: a thread counts its own wake-ups. A process that is stopped, swapped out, suspended with
its computer or starved of processor time has no wake-ups either, so that such a stall, however long, does not
end it; the heart, which sees the gap, faults and goes on.

What it cannot see: C code that holds the interpreter's lock for ever stops this thread, too; systemd's
watchdog sees that (`WatchdogSec` of deploy/dmuca-companion.service). What it cannot tell apart: a loop that
waits five seconds for its memory to be read back, while this thread has its own, is taken for one that hangs.
"""

from __future__ import annotations

import contextlib
import faulthandler
import os
import signal
import threading

PERIOD_S = 0.25
WAKE_UPS = 20
"""With the period: five seconds of a process that runs."""
_STDERR = 2
_DUMP_S = 1
"""A terminal that was stopped takes no traceback: the alarm signal then ends the process."""


class Watchdog:
    """Counts from `start` to `stop`.

    Without a `report` in `wake_ups` of its wake-ups, which are `period_s` apart, it writes a traceback of all
    threads to stderr and ends the process with exit code 1.
    """

    def __init__(self, wake_ups: int = WAKE_UPS, period_s: float = PERIOD_S) -> None:
        self._wake_ups = wake_ups
        self._period_s = period_s
        self._reports = 0
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)

    def start(self) -> None:
        """Count from now on. Once only."""
        self._thread.start()

    def report(self) -> None:
        """The loop goes round."""
        self._reports += 1

    def stop(self) -> None:
        """Count no more. May be called without `start`, and twice."""
        self._stopped.set()

    def _watch(self) -> None:
        seen, silent = self._reports, 0
        while not self._stopped.wait(self._period_s):
            if self._reports != seen:
                seen, silent = self._reports, 0
                continue
            silent += 1
            if silent >= self._wake_ups:
                self._end()

    def _end(self) -> None:
        signal.alarm(_DUMP_S)
        passed_s = self._wake_ups * self._period_s
        with contextlib.suppress(OSError):
            os.write(_STDERR, f"watchdog: the loop has hung for {passed_s:g} s; the process ends\n".encode())
        faulthandler.dump_traceback(_STDERR)
        os._exit(1)
