"""Truth files of a run in real time: read, checked for completeness, and brought to one clock.

A file `NAME.truth.csv` has the UTC (s) and the true position (m, local NED at home) of one vehicle, ten rows
a second (`sitl_mocks.vehicle.real_time.server`). A verdict from incomplete positions would be worth nothing,
so whatever is missing is named.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np

from companion.arrays import Floats
from sitl_mocks.encounters.lockstep import TICK_S, Flown, Run

LONGEST_GAP_S: Final = 1.0
"""Longest time between two rows, which are 0.1 s apart unless the machine is overloaded."""
_COLUMNS: Final = 4


def read_truth(path: Path, start_utc_s: float, duration_s: float) -> tuple[Floats, str | None]:
    """Read one file. Returns its rows of shape (rows, 4), with times from `start_utc_s`, and why they do not
    show the whole flight; None if they do.

    Args:
        path: the file, which may be missing, cut off or damaged.
        start_utc_s: UTC at which the paths began.
        duration_s: time from then on that the rows must show.
    """
    try:
        lines = path.read_text().splitlines()[1:]
        rows = np.array([[float(field) for field in line.split(",")] for line in lines])
    except (OSError, ValueError) as error:
        return np.empty((0, _COLUMNS)), f"its true positions cannot be read: {error}"
    if rows.ndim != 2 or rows.shape[1] != _COLUMNS:
        return np.empty((0, _COLUMNS)), "there are no true positions"
    rows = rows - (start_utc_s, 0.0, 0.0, 0.0)
    if not np.isfinite(rows).all():
        return rows, "a true position is not finite"
    gaps = np.diff(np.concatenate([[min(rows[0, 0], 0.0)], rows[:, 0], [max(rows[-1, 0], duration_s)]]))
    if gaps.min() < 0.0:
        return rows, "the times of its true positions run backwards"
    first_s = float(rows[0, 0])
    if max(first_s, float(gaps.max())) > LONGEST_GAP_S:
        lacks_s = max(first_s, float(gaps.max()))
        return rows, f"its true positions are missing for {lacks_s:.1f} s of the {duration_s:g} s flown"
    return rows, None


def run_of(
    folder: Path, names: Iterable[str], start_utc_s: float, duration_s: float
) -> tuple[Run, dict[str, str]]:
    """The flight of all aircraft on one clock, and why an aircraft's positions are incomplete, by its name.

    Positions between two rows lie on a straight line. Aircraft without usable positions are left out, and the
    flight ends where the positions of one of the others end.
    """
    usable, missing = {}, {}
    for name in names:
        rows, why = read_truth(folder / f"{name}.truth.csv", start_utc_s, duration_s)
        if why is not None:
            missing[name] = why
        if len(rows) and np.isfinite(rows).all():
            usable[name] = rows
    end_s = min([duration_s, *(float(rows[-1, 0]) for rows in usable.values())])
    if end_s < TICK_S:
        return Run([], {}, np.empty(0), {}), missing
    time_s = np.arange(0.0, end_s + 0.5 * TICK_S, TICK_S)
    flown = [
        Flown(name, np.column_stack([np.interp(time_s, rows[:, 0], rows[:, k]) for k in (1, 2, 3)]))
        for name, rows in usable.items()
    ]
    return Run(flown, {}, time_s, {}), missing
