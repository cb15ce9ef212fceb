"""Conditions of a flight: the quality of the GNSS, and the wind that the autopilot estimated."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.arrays import Floats
from companion.events import GnssFix

FIX_3D = 3
"""GPS_FIX_TYPE from which on a position is three-dimensional."""
MAX_GAP_S = 5.0
"""Longest gap between two reports over which the fix is assumed to be unchanged."""


@dataclass(slots=True)
class GnssQuality:
    """Quality of one receiver, from each of its reports."""

    reports: int = 0
    without_fix_s: float = 0.0
    """Time without a three-dimensional fix, after the first one."""
    best_fix: int = 0
    """Largest GPS_FIX_TYPE."""
    least_satellites: int | None = None
    """Fewest satellites with a three-dimensional fix; None if the number was never reported."""
    worst_accuracy_m: float | None = None
    """Largest horizontal accuracy that the receiver stated with a three-dimensional fix; None if never."""
    _last_s: float = math.nan
    _had_fix: bool = True

    def add(self, now_s: float, fix: GnssFix) -> None:
        """Add a report."""
        self.reports += 1
        if not self._had_fix and now_s - self._last_s <= MAX_GAP_S:
            self.without_fix_s += now_s - self._last_s
        has_fix = fix.fix_type >= FIX_3D
        self._had_fix = has_fix or self.best_fix < FIX_3D
        self._last_s = now_s
        self.best_fix = max(self.best_fix, fix.fix_type)
        if not has_fix:
            return
        if fix.satellites is not None:
            least = self.least_satellites
            self.least_satellites = fix.satellites if least is None else min(fix.satellites, least)
        if fix.horizontal_accuracy_m is not None:
            self.worst_accuracy_m = max(fix.horizontal_accuracy_m, self.worst_accuracy_m or 0.0)

    def figures(self) -> dict[str, Any]:
        """Return the figures, ready for JSON."""
        return {
            "reports": self.reports,
            "best_fix": self.best_fix,
            "without_fix_s": self.without_fix_s if self.best_fix >= FIX_3D else None,
            "least_satellites": self.least_satellites,
            "worst_accuracy_m": self.worst_accuracy_m,
        }


def wind_figures(rows: Floats) -> dict[str, Any] | None:
    """Return the figures of the wind, ready for JSON; None if there are none.

    Args:
        rows: (n, 3) time (s), and the wind towards north and east (m/s).
    """
    if not len(rows):
        return None
    north, east = (float(value) for value in rows[:, 1:].mean(axis=0))
    return {
        "mean_mps": math.hypot(north, east),
        # The direction of wind is the one from which it blows.
        "from_deg": math.degrees(math.atan2(-east, -north)) % 360.0,
        "max_mps": float(np.hypot(rows[:, 1], rows[:, 2]).max()),
    }
