"""Watchdog of the flight loop: ends the process when its loop hangs, so that it can be restarted.

A loop that hangs sends no setpoints, so the aircraft no longer avoids anything. The watchdog measures how
long the process has run without a report from its loop: a thread counts its own wake-ups. A process that is
stopped, swapped out, suspended with its computer or starved of processor time has no wake-ups either. Such a
stall, however long, does not end the process: the core (`companion.core`) sees the gap, faults and
continues.

Limits of this watchdog: C code that never releases the interpreter lock stops this thread, too; systemd's
watchdog detects that case (`WatchdogSec` in deploy/dmuca-companion.service). A loop that waits five seconds
for its memory to be swapped in, while the memory of this thread is present, is treated as a loop that hangs.
"""

from __future__ import annotations

import contextlib
import faulthandler
import os
import signal
import threading

PERIOD_S = 0.25
WAKE_UPS = 20
"""Wake-ups without a report that end the process. Times `PERIOD_S`: five seconds of running time."""
_STDERR = 2
_DUMP_S = 1
"""Time for writing the traceback. A stopped terminal blocks it; the alarm signal then ends the process."""


class Watchdog:
    """Watches the loop from `start` to `stop`.

    The watchdog thread wakes every `period_s`. After `wake_ups` wake-ups in a row without a `report` it
    writes a traceback of all threads to stderr and ends the process with exit code 1.
    """

    def __init__(self, wake_ups: int = WAKE_UPS, period_s: float = PERIOD_S) -> None:
        self._wake_ups = wake_ups
        self._period_s = period_s
        self._reports = 0
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)

    def start(self) -> None:
        """Start counting. May be called only once."""
        self._thread.start()

    def report(self) -> None:
        """Report that the loop is running."""
        self._reports += 1

    def stop(self) -> None:
        """Stop counting. May be called without `start`, and more than once."""
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
