"""Measures flights in compiled code: losses of separation, and distances from the timed path."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from companion.arrays import Floats, Integers
from companion.avoidance import kernels as k
from companion.config import AvoidanceConfig
from ground_tools.campaign.outcome import least_distance2
from ground_tools.campaign.vehicles import Fleet
from ground_tools.campaign.world import Conditions
from ground_tools.city.compiled import compiled
from ground_tools.city.energy import power_w
from ground_tools.city.flights import Flights
from ground_tools.city.tables import NOBODY, Air, Near

SEPARATION_M = 2.0 * AvoidanceConfig().conflict_radius_m
OVER_M = 1.5 * SEPARATION_M
"""A loss of separation ends when the two aircraft are farther apart than this."""
TERMINAL_M = 50.0
"""Horizontal distance from the start or end of its path within which an aircraft counts as departing or
arriving."""
MOST_LOSSES = 200_000
# Columns of a flight's tally.
(
    T_BEGUN,  # time of departure, s; NaN: it did not depart
    T_ENDED,  # time of arrival, s; NaN: it did not arrive
    T_LEAST,  # least distance from any other aircraft, m; infinite: no other was ever near
    T_GAP_MOST,  # largest distance from the timed point, m
    T_GAP_SUM,  # sum over the steps of the distance from the timed point, m
    T_STEPS,  # steps in the air
    T_FLOWN,  # distance flown, m
    T_ENERGY,  # energy of the flight, J
    T_PLANNED,  # energy that the part of the path behind the timed point costs as planned, J
    T_LATE,  # delay of the path, s
    T_DECISIONS,
    T_INFEASIBLE,  # decisions that could not keep every half-space
    T_CONFLICTS,  # decisions in conflict
    T_MANOEUVRES,  # conflicts that began
    T_ASKED,  # sum over the decisions of the number of neighbours that mattered
    TALLY,
) = range(16)
# Columns of a loss of separation.
(
    L_TIME,  # when it began, s
    L_FIRST,  # both flights
    L_SECOND,
    L_LEAST,  # least distance, m
    L_NORTH,  # where the first one was when it began, NED, m
    L_EAST,
    L_DOWN,
    L_TERMINAL,  # 1: one of them was departing or arriving
    LOSS,
) = range(9)

_compiled = compiled()
_inlined = compiled(forceinline=True)


class Tally(NamedTuple):
    """The measurements so far."""

    flights: Floats
    """(F, TALLY): one row per flight."""
    losses: Floats
    """(MOST_LOSSES, LOSS): one row per loss of separation."""
    number: Integers
    """(1,): number of losses of separation; those beyond the table are counted too."""


def new_tally(flights: int) -> Tally:
    """Nothing measured yet."""
    rows = np.zeros((flights, TALLY))
    rows[:, T_BEGUN] = rows[:, T_ENDED] = math.nan
    rows[:, T_LEAST] = math.inf
    return Tally(rows, np.zeros((MOST_LOSSES, LOSS)), np.zeros(1, np.int64))


def forget(tally: Tally) -> None:
    """Reset the tallies of the flights, so that counting begins now. Departures, arrivals, the delays of the
    paths and the list of losses are kept."""
    for column in range(TALLY):
        if column not in (T_BEGUN, T_ENDED, T_LATE):
            tally.flights[:, column] = math.inf if column == T_LEAST else 0.0


@_inlined
def note_decision(tally: Tally, air: Air, i: int, asked: int, feasible: bool, conflict: bool) -> None:
    """Count one decision of aircraft i."""
    row = tally.flights[air.flight[i]]
    row[T_DECISIONS] += 1.0
    row[T_ASKED] += asked
    if not feasible:
        row[T_INFEASIBLE] += 1.0
    if conflict:
        row[T_CONFLICTS] += 1.0
        if air.conflict[i] == 0.0:
            row[T_MANOEUVRES] += 1.0
    air.conflict[i] = 1.0 if conflict else 0.0


@_inlined
def measure(
    now: float, world: Conditions, flights: Flights, craft: Fleet, air: Air, near: Near, tally: Tally
) -> None:
    """Measure one step that began at `now`, after all aircraft have moved."""
    position, before = craft.position, craft.before
    for i in range(len(air.flight)):
        f = air.flight[i]
        if f == NOBODY:
            continue
        first, after = flights.first[f], flights.first[f] + flights.corners[f]
        at = now + world.step_s - air.begun_s[i] - air.late_s[i]
        n, e, d = k.path_position(flights.times[first:after], flights.points[first:after], at)
        gap = math.sqrt((n - position[i, 0]) ** 2 + (e - position[i, 1]) ** 2 + (d - position[i, 2]) ** 2)
        row = tally.flights[f]
        air.gap_m[i] = gap
        row[T_GAP_MOST] = max(row[T_GAP_MOST], gap)
        row[T_GAP_SUM] += gap
        row[T_STEPS] += 1.0
        # A pause of the path makes it later, and moves the timed point less.
        progress = world.step_s - (air.late_s[i] - row[T_LATE])
        row[T_LATE] = air.late_s[i]
        flown = k.Vector(
            position[i, 0] - before[i, 0], position[i, 1] - before[i, 1], position[i, 2] - before[i, 2]
        )
        row[T_FLOWN] += math.sqrt(flown.n**2 + flown.e**2 + flown.d**2)
        row[T_ENERGY] += _energy(flown, world.step_s)
        # The plan ends with the path: to wait for the arrival costs energy that it does not have.
        progress = min(progress, flights.times[after - 1] - (at - progress))
        if progress > 0.0:
            n0, e0, d0 = k.path_position(
                flights.times[first:after], flights.points[first:after], at - progress
            )
            row[T_PLANNED] += _energy(k.Vector(n - n0, e - e0, d - d0), progress)
        for at_pair in range(near.number[i]):
            j = near.other[i, at_pair]
            if air.flight[j] != NOBODY:
                least2 = least_distance2(position, before, i, j)
                _note_pair(now, flights, craft, air, near, tally, i, at_pair, math.sqrt(least2))


@_inlined
def _energy(way: k.Vector, time_s: float) -> float:
    """Energy of a straight way (m, NED) at constant speed, J."""
    horizontal_mps = math.sqrt(way.n * way.n + way.e * way.e) / time_s
    return time_s * power_w(horizontal_mps, -way.d / time_s)


@_compiled
def _note_pair(
    now: float, flights: Flights, craft: Fleet, air: Air, near: Near, tally: Tally, i: int, at: int,
    least: float,
) -> None:  # fmt: skip
    """Note the least distance (m) of a near pair during a step, and begin or end its loss of separation."""
    j = near.other[i, at]
    f, g = air.flight[i], air.flight[j]
    tally.flights[f, T_LEAST] = min(tally.flights[f, T_LEAST], least)
    tally.flights[g, T_LEAST] = min(tally.flights[g, T_LEAST], least)
    event = near.event[i, at]
    if event == NOBODY and least < SEPARATION_M:
        event = tally.number[0]
        tally.number[0] += 1
        near.event[i, at] = event
        if event < len(tally.losses):
            loss = tally.losses[event]
            loss[L_TIME], loss[L_FIRST], loss[L_SECOND] = now, min(f, g), max(f, g)
            loss[L_LEAST] = least
            for c in range(3):
                loss[L_NORTH + c] = craft.position[i, c]
            terminal = _terminal(flights, craft, air, i) or _terminal(flights, craft, air, j)
            loss[L_TERMINAL] = 1.0 if terminal else 0.0
    elif event != NOBODY:
        if event < len(tally.losses):
            tally.losses[event, L_LEAST] = min(tally.losses[event, L_LEAST], least)
        if least > OVER_M:
            near.event[i, at] = NOBODY


@_compiled
def _terminal(flights: Flights, craft: Fleet, air: Air, i: int) -> bool:
    """Whether aircraft i is within `TERMINAL_M` of the start or the end of its path."""
    f = air.flight[i]
    first, last = flights.first[f], flights.first[f] + flights.corners[f] - 1
    p = craft.position[i]
    for row in (first, last):
        n, e = flights.points[row, 0] - p[0], flights.points[row, 1] - p[1]
        if n * n + e * e < TERMINAL_M * TERMINAL_M:
            return True
    return False
