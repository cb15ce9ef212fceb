"""Distribution of the lateness of the loop's ticks, in bounded memory; and how the loop is scheduled."""

from __future__ import annotations

import os

_BIN_S = 1e-4
_BINS = 1000
"""Number of bins; the last bin counts everything that is later."""


class Lateness:
    """Histogram of how long after their deadline ticks began."""

    def __init__(self) -> None:
        self.worst_s = 0.0
        self._counts = [0] * _BINS

    def add(self, late_s: float) -> None:
        """Count one tick that began `late_s` seconds after its deadline."""
        self.worst_s = max(self.worst_s, late_s)
        self._counts[min(max(int(late_s / _BIN_S), 0), _BINS - 1)] += 1

    def percentile_s(self, percent: float) -> float:
        """Lateness, in seconds, that `percent` of the ticks did not exceed; 0 without ticks.

        The value is rounded up to 0.1 ms. If it lies beyond 0.1 s, the worst lateness is returned.
        """
        left = sum(self._counts) * percent / 100.0
        for number, count in enumerate(self._counts[:-1]):
            left -= count
            if left <= 0.0:
                return min((number + 1) * _BIN_S, self.worst_s)
        return self.worst_s


def scheduling() -> str:
    """How this process is scheduled, in words."""
    policy, priority = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    names = {os.SCHED_FIFO: "FIFO", os.SCHED_RR: "round robin"}
    if policy in names:
        return f"real-time, {names[policy]} {priority}"
    return f"not real-time (nice {os.getpriority(os.PRIO_PROCESS, 0)}): ticks may be late on a busy computer"
