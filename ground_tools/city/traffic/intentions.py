"""Demand from files: flight intentions of Metropolis 2 (`.csv`) and scenarios of BlueSky (`.scn`).

The files are read by `ground_tools.campaign.scenarios`. All flights of a period are flown, without scaling.
Flight intentions contain no heights, so heights are drawn as in `demand`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from companion.arrays import AnyFloats
from companion.errors import ConfigError
from ground_tools.campaign.scenarios import bluesky, files
from ground_tools.city.flights import Wish
from ground_tools.city.traffic.demand import CLIMB_MPS, HIGHEST_M, LOWEST_M, PAD_M, PURPOSES

RESERVE = 0.75
"""Planned speed as a share of the greatest speed."""
_LEAST_MPS = 5.0


def read(path: Path, from_s: float, duration_s: float, seed: int) -> list[Wish]:
    """The flights of a file that depart within a period.

    Args:
        from_s: time in the file at which the run begins.
        seed: draws the heights of flights that have none.

    Raises:
        ConfigError: the file cannot be read, or no flight departs in this time.
    """
    found = files.read(path, "--flights")
    level = path.suffix.lower() == ".csv"
    rng = np.random.default_rng([22, seed])
    heights = rng.uniform(LOWEST_M, HIGHEST_M, len(found.plans)).tolist()
    wishes = [
        _wish(plan, height if level else None, from_s)
        for plan, height in zip(found.plans, heights, strict=True)
        if len(plan.corners) > 1 and 0.0 <= plan.corners[0][0] - from_s < duration_s
    ]
    if not wishes:
        raise ConfigError(
            f"--flights: {path}: none of its {len(found.plans)} aircraft departs from {from_s:g} s on within "
            f"{duration_s:g} s; not understood: {found.not_understood()}"
        )
    return wishes


def _wish(plan: bluesky.Plan, height_m: float | None, from_s: float) -> Wish:
    """A plan as a flight. A plan without heights climbs straight up at its beginning, and descends straight
    down at its end."""
    rows: AnyFloats = np.array(plan.corners)
    times, points = rows[:, 0] - rows[0, 0], rows[:, 1:] * [1.0, 1.0, -1.0]
    if height_m is not None:
        takes_s = (height_m - PAD_M) / CLIMB_MPS
        points[:, 2] = -height_m
        down = [*points[-1, :2].tolist(), -PAD_M]
        points = np.vstack([[*points[0, :2], -PAD_M], points, down])
        times = np.concatenate([[0.0], times + takes_s, [times[-1] + 2.0 * takes_s]])
    ways = np.linalg.norm(np.diff(points, axis=0), axis=1)
    fastest = float((ways / np.diff(times)).max())
    return Wish(
        float(rows[0, 0]) - from_s,
        np.ascontiguousarray(times, float),
        np.ascontiguousarray(points, float),
        max(fastest / RESERVE, _LEAST_MPS),
        PURPOSES.index("file"),
    )
