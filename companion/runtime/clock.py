"""The one clock that a flight goes by."""

from __future__ import annotations

import time


def now_s() -> float:
    """Seconds since the computer was started, those included in which it was suspended.

    CLOCK_BOOTTIME. Nobody can set it, unlike the wall clock; and unlike CLOCK_MONOTONIC (`clock.now_s`) it
    does not stop while the computer sleeps: after a suspend the heart sees how old its data is.
    """
    return time.clock_gettime(time.CLOCK_BOOTTIME)
