"""`python -m bench.commands.honest_conflicts TABLE SEEDS`: how long and how far honest traffic moves us.

It flies the cells of a table of docs/safety.md (without the twins and the paper's law) and prints one line of
JSON for each: the median, the 99 % and 99.9 % quantiles and the greatest value over all avoiding aircraft.
The defaults of `[containment]` are above these values (docs/containment.md).
"""

from __future__ import annotations

import json
import sys

import numpy as np

from companion.arrays import Bools, Floats
from companion.authority.influence.allowance import HELD_S
from ground_tools.campaign import cells, vehicles
from ground_tools.campaign.cells import Cell, Look
from ground_tools.campaign.tables import TABLES

NAMES = ("track_s", "inside_s", "presses_s", "held_s", "side_m", "below_m", "above_m")
DECISION_S = 0.2
_CLEAR_S = 3.0
_LEG_S = (-30.0, -15.0, 0.0, 15.0, 30.0)


def of_aircraft(look: Look, i: int) -> list[float]:
    """The values of `NAMES` for one aircraft of a flight."""
    views, here = look.log.views[:, i], look.log.position[:, i]
    crewed = (look.kinds == vehicles.CREWED) | (look.kinds == vehicles.BAROMETRIC)
    acting = (np.nan_to_num(views[:, :, 4]) != 0.0) | (np.nan_to_num(views[:, :, 7]) != 0.0)
    away = views[:, :, :3] - here[:, None]
    away[:, :, 2] *= views[:, :, 3] / views[:, :, 8]
    inside = acting & (np.linalg.norm(away, axis=2) < views[:, :, 3]) & ~crewed
    track_s = DECISION_S * (acting & ~crewed).sum(axis=0).max()
    inside_s = DECISION_S * inside.sum(axis=0).max()
    return [track_s, inside_s, _pressed_s(inside), _held_s(look, i), *_reach(look, i)]


def _pressed_s(inside: Bools) -> float:
    """Longest time inside a volume of another aircraft, s; time outside subtracts half of itself."""
    longest, now = np.zeros(inside.shape[1]), np.zeros(inside.shape[1])
    for row in inside:
        now = np.where(row, now + DECISION_S, np.maximum(now - 0.5 * DECISION_S, 0.0))
        longest = np.maximum(longest, now)
    return float(longest.max())


def _held_s(look: Look, i: int) -> float:
    """Time in conflict and on the way back to the path, s."""
    time_s = look.log.time_s[:, i]
    conflict, recovering = look.log.conflict[:, i] != 0.0, look.log.recovering[:, i] != 0.0
    since_s = time_s - np.maximum.accumulate(np.where(conflict, time_s, -np.inf))
    held = conflict | (since_s < _CLEAR_S) | (recovering & (since_s <= HELD_S))
    return float(DECISION_S * held.sum())


def _reach(look: Look, i: int) -> tuple[float, float, float]:
    """Largest distances (m) to the side of the path, below its present leg, and above it."""
    place, points = look.trace[:, i], look.points[i]
    start, way = points[:-1, :2], np.diff(points[:, :2], axis=0)
    length2 = np.maximum((way**2).sum(axis=1), 1e-9)
    to: Floats = place[:, None, :2] - start
    share = np.clip((to * way).sum(axis=2) / length2, 0.0, 1.0)
    side = np.linalg.norm(to - share[:, :, None] * way, axis=2).min(axis=1).max()
    time_s = look.world.start_s + look.world.step_s * np.arange(1, len(place) + 1)
    time_s = time_s - np.interp(time_s, look.log.time_s[:, i], look.log.late_s[:, i])
    leg = np.stack([np.interp(time_s + off_s, look.times[i], points[:, 2]) for off_s in _LEG_S])
    below, above = place[:, 2] - leg.max(axis=0), leg.min(axis=0) - place[:, 2]
    return float(side), float(below.max()), float(above.max())


def measure(cell: Cell, seeds: int) -> dict[str, list[float]]:
    """Quantiles of each of `NAMES` over all avoiding aircraft of flights with seeds from 1."""
    rows: list[list[float]] = []
    for seed in range(1, seeds + 1):
        look = cells.look(cell, seed)
        rows += [of_aircraft(look, i) for i in np.flatnonzero(look.kinds == vehicles.AVOIDS).tolist()]
    found = np.quantile(np.array(rows), (0.5, 0.99, 0.999, 1.0), axis=0).T.round(1).tolist()
    return dict(zip(NAMES, found, strict=True))


if __name__ == "__main__":
    for one in TABLES[sys.argv[1]]():
        if one.law == "dmuca" and not one.twins:
            settings = {"encounter": one.generator, "aircraft": one.aircraft, "world": one.world}
            if one.intruders:
                settings["intruder"] = one.intruder
            print(json.dumps({**settings, **measure(one, int(sys.argv[2]))}), flush=True)
