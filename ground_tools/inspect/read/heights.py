"""Heights above home, and samples among them that no aircraft can have flown."""

from __future__ import annotations

import numpy as np

from companion.arrays import Bools, Floats
from ground_tools.inspect.read.spill import BLOCK

SPIKE_M = 30.0
"""A height farther than this from the median of its neighbours counts as an error."""
_SIDE = 4
"""Number of neighbours on each side that are compared. Steady climbs and descents pass, however fast."""
_NEAR_S = 5.0
"""Neighbours farther away in time are ignored."""


def spikes(time_s: Floats, height_m: Floats) -> Bools:
    """Mark samples that stand out from their neighbours, (n,): single bad altitudes, up to four in a row.

    Args:
        time_s: (n,) rising times.
        height_m: (n,) heights.
    """
    found = np.zeros(len(time_s), bool)
    if len(time_s) < 3:
        return found
    for at in range(0, len(time_s), BLOCK):
        first, last = max(at - _SIDE, 0), at + BLOCK + _SIDE
        block = _spikes(time_s[first:last], height_m[first:last])
        found[at : at + BLOCK] = block[at - first : at - first + BLOCK]
    return found


def _spikes(time_s: Floats, height_m: Floats) -> Bools:
    padded = np.pad(height_m, _SIDE, constant_values=np.nan)
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * _SIDE + 1)
    times = np.pad(time_s, _SIDE, constant_values=np.nan)
    later = np.lib.stride_tricks.sliding_window_view(times, 2 * _SIDE + 1) - time_s[:, None]
    near = np.where(abs(later) <= _NEAR_S, around, np.nan)
    near[:, _SIDE] = height_m
    found = np.asarray(abs(height_m - np.nanmedian(near, axis=1)) > SPIKE_M)
    # At the ends of a log, and at gaps, all neighbours are on one side, and those of a climb are lower.
    rows = np.flatnonzero(found)
    level = near[rows] - _slope(later[rows], near[rows])[:, None] * later[rows]
    found[rows] = abs(height_m[rows] - np.nanmedian(level, axis=1)) > SPIKE_M
    return found


def _slope(time_s: Floats, height_m: Floats) -> Floats:
    """Return the median slope (n,) between consecutive ones of samples (n, m), NaN where there is none; of
    two middle slopes the flatter one, so that a spike among few samples is no climb."""
    steps = np.diff(height_m) / np.diff(time_s)
    steps[np.isnan(steps).all(axis=1)] = 0.0
    low, high = (np.nanpercentile(steps, 50, axis=1, method=side) for side in ("lower", "higher"))
    return np.where(abs(low) < abs(high), low, high)
