"""Draws tracks from an encounter model, as `dbn_sample.m`, `resample_events.m` and `dediscretize.m` do.

The initial network gives the first bin of each variable, the transition network those of acceleration,
vertical rate and turn rate one second later. A value is uniform within its bin, and 0 in the bin that holds
0. While its bin stays the same, the value is redrawn with the probability `resample_rates` per second. If a
combination of parents was never observed, the bin stays the same (`setTransitionPriors.m`).
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from companion.arrays import Floats, Integers
from ground_tools.campaign.encounters.model import (
    ACCELERATION,
    CLASS,
    CLIMB,
    LAYER,
    REGION,
    SPEED,
    TURN,
    Model,
    Variable,
)
from ground_tools.campaign.encounters.transitions import walk

KNOT_MPS: Final = 1852.0 / 3600.0
FOOT_M: Final = 0.3048
LEAST_SPEED_MPS: Final = 1.7 * FOOT_M
"""Least airspeed of any track, as in `UncorEncounterModel.track`."""
UNCONTROLLED: Final = 3
"""Bin of the airspace class for airspace other than B, C and D."""
_MOST_TRIES: Final = 10_000


class Course(NamedTuple):
    """Speeds and rates of a track in SI units. The rates are constant within each second."""

    speeds: Floats
    """(seconds + 1,): airspeed at the beginning of each second, and at the end; the air is still."""
    rates: Floats
    """(seconds, 3): acceleration (m/s^2), vertical rate (m/s) and turn rate (rad/s)."""


class Track(NamedTuple):
    """Motion of an aircraft, one row for each step. Its heading begins at 0 (north) and its position at the
    origin: `pairing` places it. NED, m and m/s."""

    position: Floats
    """(N + 1, 3)."""
    velocity: Floats
    """(N + 1, 3)."""


def draw_bin(rng: np.random.Generator, variable: Variable, bins: Sequence[int]) -> int | None:
    """Draw the bin of a variable, given those of its parents; None if they were never observed together."""
    row = 0
    for parent, stride in zip(variable.parents, variable.strides, strict=True):
        row += stride * bins[parent]
    sums = variable.cumulative[row]
    if sums[-1] == 0.0:
        return None
    return min(bisect_right(sums, rng.random() * sums[-1]), variable.bins - 1)  # guards against rounding up


def draw_value(rng: np.random.Generator, model: Model, variable: int, bin_: int) -> float:
    """A value within a bin of an initial variable, in the file's units. For a variable without boundaries:
    the number of the bin, from 1."""
    edges = model.boundaries[variable]
    if edges is None:
        return float(bin_ + 1)
    if model.zero_bins[variable] == bin_:
        return 0.0
    return edges[bin_] + rng.random() * (edges[bin_ + 1] - edges[bin_])


def draw_initial(
    rng: np.random.Generator, model: Model, given: Mapping[int, int] | None = None
) -> list[int] | None:
    """Draw the bins of all variables of the initial network.

    Args:
        given: bins that variables must have.

    Returns:
        The bins; None if a drawn bin differs from the given one.

    Raises:
        ValueError: a drawn combination of parents was never observed.
    """
    bins = [0] * len(model.initial)
    for i in model.order:
        bin_ = draw_bin(rng, model.initial[i], bins)
        if bin_ is None:
            raise ValueError(
                f"the model {model.name} has no counts of {model.initial[i].label} for bins of its parents "
                "that it draws itself"
            )
        if given and given.get(i, bin_) != bin_:
            return None
        bins[i] = bin_
    return bins


def draw_lowest(rng: np.random.Generator, model: Model) -> list[int]:
    """Like `draw_initial`, for the lowest altitude layer and, if the model has airspace classes, class
    `UNCONTROLLED`.

    Raises:
        ValueError: as in `draw_initial`, or the model hardly ever draws that layer.
    """
    given, airspace = {model.at(LAYER): 0}, model.index(CLASS)
    if airspace is not None:
        given[airspace] = UNCONTROLLED
    for _ in range(_MOST_TRIES):
        bins = draw_initial(rng, model, given)
        if bins is not None:
            return bins
    raise ValueError(
        f"the model {model.name} hardly ever draws its lowest altitude layer, outside classes B, C and D"
    )


class Limits(NamedTuple):
    """Limits of a track; one that exceeds them is not used."""

    least_mps: float
    """Least airspeed; `most_mps` is the greatest."""
    most_mps: float
    climb_mps: float
    """Greatest vertical rate, either way."""


def limits(model: Model, bins: Sequence[int]) -> Limits:
    """The limits of a track that begins with these bins: the bins in which the 1st and the 99th percentile
    lie, given region, class and layer.

    The transition network does not keep the speed in its bin. Without limits it would drift away from the
    observed range. `getDynamicLimits.m` takes the upper edge of both bins. Here it is the lower edge of the
    lower bin, because the upper edge would exclude slow aircraft that were observed, such as all
    single-engine aircraft below 60 kt.
    """
    fixed = {i: bins[i] for i in (model.index(label) for label in (REGION, CLASS, LAYER)) if i is not None}
    least, most = _percentiles(model, model.at(SPEED), fixed)
    climbs = map(abs, _percentiles(model, model.at(CLIMB), fixed))
    return Limits(max(least * KNOT_MPS, LEAST_SPEED_MPS), most * KNOT_MPS, max(climbs) * FOOT_M / 60.0)


def _percentiles(model: Model, variable: int, fixed: Mapping[int, int]) -> tuple[float, float]:
    """Lower edge of the bin of the 1st percentile of an initial variable and upper edge of that of the 99th,
    given some bins."""
    one, edges = model.initial[variable], model.boundaries[variable]
    assert edges is not None, "checked when the file was read"
    rows = np.arange(len(one.counts))
    wanted = np.ones(len(rows), bool)
    for parent, stride in zip(one.parents, one.strides, strict=True):
        if parent in fixed:
            wanted &= rows // stride % model.initial[parent].bins == fixed[parent]
    sums = np.cumsum(one.counts[wanted].sum(axis=0))
    low, high = np.searchsorted(sums, sums[-1] * np.array([0.01, 0.99]))
    return edges[low], edges[high + 1]


def _first(rng: np.random.Generator, model: Model) -> tuple[list[int], list[float]]:
    """Bins and values of a first state in the lowest layer that does not climb faster than it flies."""
    speed_at, climb_at = model.at(SPEED), model.at(CLIMB)
    for _ in range(_MOST_TRIES):
        bins = draw_lowest(rng, model)
        values = [draw_value(rng, model, i, bin_) for i, bin_ in enumerate(bins)]
        if values[speed_at] * KNOT_MPS > abs(values[climb_at]) * FOOT_M / 60.0:
            return bins, values
    raise ValueError(f"the model {model.name} nearly always climbs faster than it flies")


def draw_course(rng: np.random.Generator, model: Model, seconds: int) -> Course | None:
    """Draw a course that begins in the lowest layer (`draw_lowest`). None if it exceeds its `limits`.

    A first state whose vertical rate exceeds its airspeed is drawn again.

    Raises:
        ValueError: as in `draw_lowest`, or nearly all first states climb faster than they fly.
    """
    speed_at = model.at(SPEED)
    first, start = _first(rng, model)
    _, values = states(rng, model, first, start, seconds)
    units = {ACCELERATION: KNOT_MPS, CLIMB: FOOT_M / 60.0, TURN: math.pi / 180.0}
    at = model.tables.at_t.tolist()
    rates = np.column_stack([values[:, at.index(model.at(label))] * unit for label, unit in units.items()])
    speeds = start[speed_at] * KNOT_MPS + np.append(0.0, np.cumsum(rates[:, 0]))
    most = limits(model, first)
    if speeds.min() < most.least_mps or speeds.max() > most.most_mps:
        return None
    return Course(speeds, rates) if np.abs(rates[:, 1]).max() <= most.climb_mps else None


def states(
    rng: np.random.Generator, model: Model, first: Sequence[int], start: Sequence[float], seconds: int
) -> tuple[Integers, Floats]:
    """Draw the states that follow a first state.

    Args:
        first, start: bins and values of the initial variables.

    Returns:
        The bins of the initial variables in each second, (seconds, variables), and the values of the dynamic
        ones in the order of `model.tables`, (seconds, D), in the file's units. The first row is the given
        state.
    """
    bins = np.zeros((seconds, len(first)), np.int64)
    values = np.zeros((seconds, len(model.tables.at_t)))
    bins[0], values[0] = first, np.array(start)[model.tables.at_t]
    walk(rng, model.tables, bins, np.zeros(len(model.next), np.int64), values)
    return bins, values


def integrated(course: Course, step_s: float) -> Track:
    """The track of a course.

    Args:
        step_s: time between two rows of the track; a second must be a multiple of it.
    """
    speeds, rates = course
    per_second = round(1.0 / step_s)
    headings = np.concatenate([[0.0], np.cumsum(rates[:, 2])])
    share = np.linspace(0.0, 1.0, per_second, endpoint=False)
    speed = _filled(speeds[:-1], np.diff(speeds), share, float(speeds[-1]))
    heading = _filled(headings[:-1], rates[:, 2], share, float(headings[-1]))
    climb = np.append(np.repeat(rates[:, 1], per_second), rates[-1, 1])
    level = np.sqrt(np.maximum(speed**2 - climb**2, 0.0))
    velocity = np.column_stack([level * np.cos(heading), level * np.sin(heading), -climb])
    position = np.zeros_like(velocity)
    # The vertical rate is constant within a second and changes at its end.
    position[1:, :2] = np.cumsum(0.5 * step_s * (velocity[1:, :2] + velocity[:-1, :2]), axis=0)
    position[1:, 2] = np.cumsum(step_s * velocity[:-1, 2])
    return Track(position, velocity)


def _filled(starts: Floats, slopes: Floats, share: Floats, last: float) -> Floats:
    """Values at every step of every second, from those at its start and their slopes, and the last value."""
    found: Floats = np.append((starts[:, None] + slopes[:, None] * share).ravel(), last)
    return found
