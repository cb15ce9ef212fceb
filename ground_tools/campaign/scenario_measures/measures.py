"""Measures of the scenarios: time until all fly as planned, arrivals, and needless deviations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import msgspec
import numpy as np

from companion.arrays import AnyFloats, Floats
from ground_tools.campaign import cells as campaign
from ground_tools.campaign import vehicles
from ground_tools.campaign.cells import Cell, Look, Row
from ground_tools.campaign.encounters.volumes import SNMAC, first_inside

ARRIVED_M: Final = 6.0
"""An aircraft within this distance of the end of its path has arrived: four standard deviations of GNSS."""
OFF_M: Final = 10.0
"""An aircraft farther than this from its timed point is off its plan. GNSS errors alone cause up to 8 m."""
SIDE_M: Final = 2.0
"""Least distance at which an aircraft counts as beside its path; nearer, it counts as on the path."""


class Measures(msgspec.Struct, frozen=True):
    """Measures of one flight."""

    row: Row
    snmac: bool
    """Whether two aircraft had a near mid-air collision of small aircraft (`volumes.SNMAC`)."""
    clear_s: float | None
    """Time to clear: from the first to the last moment at which an avoiding aircraft was off its plan. 0 if
    none ever was; None if one still is at the end."""
    end_m: float
    """Largest distance of an avoiding aircraft from its place on its path at the end of the flight."""
    needless_m: float | None
    """Largest deviation of an avoiding aircraft that would have kept separation from everybody without any
    avoidance; None if there is no such aircraft."""
    sides: int
    """Largest number of times that an avoiding aircraft changed from one side of its path to the other."""


def measured(cell: Cell, seed: int) -> Measures:
    """Fly a scenario with and without avoidance and measure it.

    Raises:
        ConfigError: the encounter cannot be drawn, or there is no such law.
    """
    look, free = campaign.look(cell, seed), campaign.look(campaign.baseline(cell), seed)
    avoids = look.kinds == vehicles.AVOIDS
    gaps, lateral = _beside(look)
    apart = _least_distances(free.trace) >= campaign.SEPARATION_M
    needless = gaps[:, avoids & apart]
    at_end = np.array([look.world.end_s])
    places = np.concatenate([_on_path(t, p, at_end) for t, p in zip(look.times, look.points, strict=True)])
    ends = np.linalg.norm(look.trace[-1] - places, axis=1)[avoids]
    return Measures(
        row=look.row,
        snmac=_snmac(look),
        clear_s=_clear(look.log.time_s[1:, avoids], gaps[:, avoids]),
        end_m=float(ends.max(initial=0.0)),
        needless_m=float(needless.max()) if needless.size else None,
        sides=max((_changes(lateral[:, i]) for i in np.flatnonzero(avoids)), default=0),
    )


def figures(flights: Sequence[Measures]) -> dict[str, Any]:
    """The figures that a table reports for one scenario and law. Lengths in m, times in s."""
    rows = [flight.row for flight in flights]
    needless = [flight.needless_m for flight in flights if flight.needless_m is not None]
    ends = [flight.end_m for flight in flights]
    clear = campaign.median([math.inf if flight.clear_s is None else flight.clear_s for flight in flights])
    return {
        "runs": len(rows),
        "losses_of_separation": campaign.lost(rows),
        "snmac": sum(flight.snmac for flight in flights),
        "min_separation_m": min(row.separation_m for row in rows),
        "median_max_deviation_m": campaign.median([row.deviation_m for row in rows]),
        "max_deviation_m": max(row.deviation_m for row in rows),
        "median_end_m": campaign.median(ends),
        "max_end_m": max(ends),
        "everybody_arrived": sum(end <= ARRIVED_M for end in ends),
        "median_clear_s": clear if math.isfinite(clear) else None,
        "not_clear": sum(flight.clear_s is None for flight in flights),
        "median_needless_m": campaign.median(needless) if needless else None,
        "max_needless_m": max(needless, default=None),
        "median_sides": campaign.median([float(flight.sides) for flight in flights]),
    }


def _clear(times: AnyFloats, gaps: AnyFloats) -> float | None:
    """The time to clear.

    Args:
        times, gaps: both of shape (decisions, avoiding aircraft): when each decision was made, and the
            distance from the timed point then.
    """
    off = np.flatnonzero((gaps > OFF_M).any(axis=1))
    if not len(off):
        return 0.0
    if off[-1] == len(gaps) - 1:
        return None
    at = times.max(axis=1)  # an aircraft without GNSS makes no decision, so its time is missing
    return float(at[off[-1]] - at[off[0]])


def _snmac(look: Look) -> bool:
    number = look.trace.shape[1]
    return any(
        first_inside(look.trace[:, i] - look.trace[:, j], look.world.step_s, SNMAC) is not None
        for i in range(number)
        for j in range(i)
    )


def _beside(look: Look) -> tuple[AnyFloats, AnyFloats]:
    """Distance of each aircraft from its timed point, and how far it is to the right of its path there; both
    of shape (decisions after the first, A)."""
    every = int(look.world.conditions(look.avoidance.period_s).period)
    log = look.log
    # The first decision is made before the first step, after which the trace begins.
    places = look.trace[every - 1 : (len(log.time_s) - 1) * every : every]
    gaps, lateral = np.zeros(places.shape[:2]), np.zeros(places.shape[:2])
    for i, (times, points) in enumerate(zip(look.times, look.points, strict=True)):
        # A decision that an aircraft without GNSS did not make is not recorded.
        t = log.time_s[1:, i] - log.late_s[1:, i]
        offset = places[:, i] - _on_path(times, points, t)
        way = _on_path(times, points, t + 0.5) - _on_path(times, points, t - 0.5)
        speed = np.hypot(way[:, 0], way[:, 1])
        right = (offset[:, 1] * way[:, 0] - offset[:, 0] * way[:, 1]) / np.maximum(speed, 1e-9)
        gaps[:, i], lateral[:, i] = np.linalg.norm(offset, axis=1), np.where(speed > 0.1, right, 0.0)
    return gaps, lateral


def _on_path(times: Floats, points: Floats, at: AnyFloats) -> AnyFloats:
    return np.column_stack([np.interp(at, times, points[:, c]) for c in range(3)])


def _changes(lateral: AnyFloats) -> int:
    """Changes of side, from at least `SIDE_M` on one side to as much on the other."""
    sides = np.sign(lateral[np.abs(lateral) >= SIDE_M])
    return int((sides[1:] != sides[:-1]).sum())


def _least_distances(trace: Floats) -> AnyFloats:
    """Least distance of each aircraft from any other; shape (A,)."""
    least = np.full(trace.shape[1], np.inf)
    for i in range(trace.shape[1]):
        others = np.delete(trace, i, axis=1)
        least[i] = np.sqrt(((others - trace[:, i : i + 1]) ** 2).sum(axis=2).min())
    return least
