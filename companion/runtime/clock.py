"""The single clock that a flight uses."""

from __future__ import annotations

import time


def now_s() -> float:
    """Seconds since the computer booted, including the time for which it was suspended.

    Reads CLOCK_BOOTTIME. Unlike the wall clock it cannot be set. Unlike CLOCK_MONOTONIC it does not stop
    while the computer sleeps, so that after a suspend the core (`companion.core`) sees how old its data is.
    """
    return time.clock_gettime(time.CLOCK_BOOTTIME)
