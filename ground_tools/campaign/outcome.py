"""Outcome of a flight: least distances, conflicts and their cost, and the record of decisions, in compiled
code."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from companion.arrays import Floats, Integers
from companion.avoidance import kernels as k
from ground_tools.campaign.compiled import compiled
from ground_tools.campaign.vehicles import (
    AVOIDS,
    BAROMETRIC,
    CREWED,
    M_TIME,
    MESSAGE_COLUMNS,
    Fleet,
)
from ground_tools.campaign.world import Conditions

COLLISION_M = 2.0
AWAY_M = 15.0
"""Distance from the timed point beyond which an aircraft counts as away from its path."""
# Entries of a flight's `result`.
(
    F_SEPARATION,  # least distance of any pair, m
    F_TIME,  # time of that least distance, s
    F_FIRST,  # indices of that pair
    F_SECOND,
    F_DEVIATION,  # largest distance of any avoiding aircraft from its timed point, m
    F_AWAY,  # longest time that any avoiding aircraft was away from its timed point, s
    F_BACK,  # largest distance of any avoiding aircraft from its timed point at the end, m
    F_LOST,  # largest delay of a path, s
    F_PATH_RATIO,  # distance flown by all aircraft over the distance planned for all
    F_MANOEUVRES,  # number of conflicts that began, over all avoiding aircraft
    F_INFEASIBLE,  # share of decisions that could not keep every half-space
    F_RECOVERY,  # longest time from the last decision in conflict to the return, s; infinite: no return
    F_CREWED,  # least of the larger of horizontal and vertical distance from crewed traffic, in separations
    F_FENCE,  # largest distance beyond a fence, m
    FLIGHT_ENTRIES,
) = range(15)
# Counts of decisions: all; those that could not keep every half-space; those that began a conflict.
D_ALL, D_INFEASIBLE, D_MANOEUVRES, DECISION_ENTRIES = range(4)
# Entries of a pair: least distance (m); 1 if an avoiding aircraft of the pair was in conflict with the other.
P_SEPARATION, P_ALERT, PAIR_ENTRIES = range(3)


class Log(NamedTuple):
    """Record of D decisions of each of A aircraft; NED, m and m/s. It may be shorter than the flight."""

    time_s: Floats
    """(D, A)."""
    position: Floats
    """(D, A, 3): own position as the aircraft knows it; `velocity` likewise."""
    velocity: Floats
    """(D, A, 3)."""
    wanted: Floats
    """(D, A, 3)."""
    flown: Floats
    """(D, A, 3): velocity flown, which for an aircraft that avoids is the command."""
    feasible: Floats
    """(D, A): 0 or 1; `conflict` and `recovering` likewise."""
    conflict: Floats
    """(D, A)."""
    recovering: Floats
    """(D, A)."""
    late_s: Floats
    """(D, A): delay of the path."""
    message_s: Floats
    """(D, A, A): time at which the latest message of each other aircraft that the decision used was sent;
    NaN: none. On the diagonal: the aircraft's own latest message."""
    others: Floats
    """(D, A, A, columns of `kernels.Other`): the content of that message; on the diagonal only position and
    velocity."""
    views: Floats
    """(D, A, A, columns of `kernels.Seen`): the decision's report on each other aircraft."""


class Tally(NamedTuple):
    """Values accumulated during a flight of A aircraft; m and s."""

    conflict: Floats
    """(A,): 1 if the last decision saw a conflict."""
    conflict_at: Floats
    """(A,): time of the last decision in conflict."""
    recovery: Floats
    """(A,): time from the last conflict to the return to the path; infinite: not back yet."""
    gap: Floats
    """(A,): distance of an avoiding aircraft from its timed point."""
    away_since: Floats
    """(A,): time since which the aircraft is farther than `AWAY_M` from its timed point; infinite if it is
    not."""
    way: Floats
    """(2,): distance flown and distance planned, summed over all aircraft."""
    least2: Floats
    """(A, A): squares of the least distances."""
    decisions: Floats
    """(DECISION_ENTRIES,): counts over all avoiding aircraft."""


_compiled = compiled()
_inlined = compiled(forceinline=True)


def new_log(fleet: int, decisions: int = 0) -> Log:
    """An empty log for the given number of decisions of each aircraft."""
    pairs = decisions, fleet, fleet
    return Log(
        *(np.zeros((decisions, fleet, *more)) for more in ((), (3,), (3,), (3,), (3,), (), (), (), ())),
        *(np.full((*pairs, *more), math.nan) for more in ((), (k.OTHER_COLUMNS,), (k.SEEN_COLUMNS,))),
    )


def nothing_yet(fleet: int, pairs: Floats, result: Floats) -> Tally:
    """The tally at the start of a flight. Also resets `result` and the alerts in `pairs` of `flight.fly`."""
    pairs[:, :, P_ALERT] = 0.0
    result[:] = 0.0
    result[F_SEPARATION] = result[F_CREWED] = math.inf
    return Tally(
        conflict=np.zeros(fleet),
        conflict_at=np.zeros(fleet),
        recovery=np.zeros(fleet),
        gap=np.zeros(fleet),
        away_since=np.full(fleet, math.inf),
        way=np.zeros(2),
        least2=np.full((fleet, fleet), math.inf),
        decisions=np.zeros(DECISION_ENTRIES),
    )


@_inlined
def count_decision(tally: Tally, now: float, i: int, feasible: bool, conflict: bool) -> None:
    """Count one decision of the avoiding aircraft i."""
    tally.decisions[D_ALL] += 1.0
    if not feasible:
        tally.decisions[D_INFEASIBLE] += 1.0
    if conflict and tally.conflict[i] == 0.0:
        tally.decisions[D_MANOEUVRES] += 1.0
    tally.conflict[i] = 1.0 if conflict else 0.0
    if conflict:
        tally.conflict_at[i], tally.recovery[i] = now, math.inf


@_compiled
def beyond(fence: Floats, n: float, e: float) -> float:
    """Largest distance (m) of a point beyond the border of an area that it violates; 0 if there is none."""
    worst, first, p = 0.0, 0, k.Point(n, e)
    while first < len(fence):
        after, near = k.after_area(fence, first), math.inf
        for row in range(first, after):
            room, _ = k.nearest_of_wall(k.wall_at(fence, row), p)
            near = min(near, room)
        kind = k.wall_at(fence, first).kind
        if k.inside(fence, first, after, p) != (kind in (k.IN_POLYGON, k.IN_CIRCLE)):
            worst = max(worst, near)
        first = after
    return worst


@_compiled
def least_distance2(position: Floats, before: Floats, i: int, j: int) -> float:
    """Square of the least distance of two aircraft during one step, on straight lines between its ends.

    0 if a position is not a number, so that a flight that nobody can judge counts as lost.
    """
    px, py, pz = before[j, 0] - before[i, 0], before[j, 1] - before[i, 1], before[j, 2] - before[i, 2]
    dx, dy, dz = (
        position[j, 0] - position[i, 0] - px,
        position[j, 1] - position[i, 1] - py,
        position[j, 2] - position[i, 2] - pz,
    )
    d2 = dx * dx + dy * dy + dz * dz
    if d2 > 0.0:
        share = min(max(-(px * dx + py * dy + pz * dz) / d2, 0.0), 1.0)
        px, py, pz = px + share * dx, py + share * dy, pz + share * dz
    least2 = px * px + py * py + pz * pz
    return float(least2) if d2 >= 0.0 and least2 >= 0.0 else 0.0


@_inlined
def measure(
    world: Conditions,
    tick: int,
    path_times: Floats,
    path_points: Floats,
    late: Floats,
    fence: Floats,
    settings: Floats,
    kinds: Floats,
    craft: Fleet,
    tally: Tally,
    result: Floats,
) -> None:
    """Measure one step, after all aircraft have moved. Arguments not listed here are those of `flight.fly`.

    Args:
        late: shape (A,): delay of each path, s.
    """
    now = world.start_s + tick * world.step_s
    position, before, way, gaps = craft.position, craft.before, tally.way, tally.gap
    conflict_at, recovery, away_since = tally.conflict_at, tally.recovery, tally.away_since
    for i in range(len(kinds)):
        n, e, d = k.path_position(path_times[i], path_points[i], now + world.step_s - late[i])
        pn, pe, pd = k.path_position(path_times[i], path_points[i], now - late[i])
        way[1] += math.sqrt((n - pn) ** 2 + (e - pe) ** 2 + (d - pd) ** 2)
        way[0] += math.sqrt(
            (position[i, 0] - before[i, 0]) ** 2
            + (position[i, 1] - before[i, 1]) ** 2
            + (position[i, 2] - before[i, 2]) ** 2
        )
        if kinds[i] != AVOIDS:
            continue
        gap = math.sqrt((n - position[i, 0]) ** 2 + (e - position[i, 1]) ** 2 + (d - position[i, 2]) ** 2)
        gaps[i] = gap
        result[F_DEVIATION] = max(result[F_DEVIATION], gap)
        away_since[i] = min(away_since[i], now) if gap > AWAY_M else math.inf
        result[F_AWAY] = max(result[F_AWAY], now - away_since[i])
        if recovery[i] == math.inf and gap <= k.settings_at(settings, i).regained_m:
            recovery[i] = now - conflict_at[i]
        result[F_FENCE] = max(result[F_FENCE], beyond(fence, position[i, 0], position[i, 1]))
    _measure_crewed(settings, kinds, position, result)
    _measure_pairs(now, position, before, tally.least2, result)


@_inlined
def _measure_crewed(settings: Floats, kinds: Floats, position: Floats, result: Floats) -> None:
    """Update the least distance of the avoiding aircraft from crewed traffic."""
    for j in range(len(kinds)):
        if kinds[j] == CREWED or kinds[j] == BAROMETRIC:
            for i in range(len(kinds)):
                if kinds[i] == AVOIDS:
                    own = k.settings_at(settings, i)
                    level = own.crewed_m / math.sqrt(2.0)
                    n, e = position[i, 0] - position[j, 0], position[i, 1] - position[j, 1]
                    aside = math.hypot(n, e) / level
                    above = abs(position[i, 2] - position[j, 2]) * own.crewed_vertical / level
                    result[F_CREWED] = min(result[F_CREWED], max(aside, above))


@_inlined
def _measure_pairs(now: float, position: Floats, before: Floats, least2: Floats, result: Floats) -> None:
    for i in range(len(position)):
        for j in range(i):
            near2 = least_distance2(position, before, i, j)
            if near2 < least2[i, j]:
                least2[i, j] = near2
                if near2 < result[F_SEPARATION]:
                    result[F_SEPARATION], result[F_TIME] = near2, now
                    result[F_FIRST], result[F_SECOND] = j, i


def land(kinds: Floats, late: Floats, tally: Tally, pairs: Floats, result: Floats) -> None:
    """Write the final tally to `pairs` and `result` of `flight.fly`; `late` as in `measure`."""
    for i in range(len(kinds)):
        if kinds[i] == AVOIDS:
            result[F_BACK] = max(result[F_BACK], tally.gap[i])
            result[F_LOST] = max(result[F_LOST], late[i])
            result[F_RECOVERY] = max(result[F_RECOVERY], tally.recovery[i])
    pairs[:, :, P_SEPARATION] = np.sqrt(tally.least2)
    result[F_SEPARATION] = math.sqrt(result[F_SEPARATION])
    result[F_PATH_RATIO] = tally.way[0] / tally.way[1] if tally.way[1] > 0.0 else 1.0
    result[F_MANOEUVRES] = tally.decisions[D_MANOEUVRES]
    result[F_INFEASIBLE] = tally.decisions[D_INFEASIBLE] / max(tally.decisions[D_ALL], 1.0)


@_compiled
def write_down(
    log: Log,
    d: int,
    i: int,
    own: k.Own,
    decision: k.Decision,
    count: int,
    craft: Fleet,
    heard: Floats,
    neighbours: Floats,
    senders: Integers,
    seen: Floats,
) -> None:
    """Record decision d of aircraft i, as it was flown.

    Args:
        heard, neighbours, senders: as in `flight.Mind`.
        seen: the reports of the decision.
    """
    log.time_s[d, i], log.late_s[d, i] = own.now_s, decision.state.delay_s
    log.position[d, i, 0], log.position[d, i, 1], log.position[d, i, 2] = own.position
    log.velocity[d, i, 0], log.velocity[d, i, 1], log.velocity[d, i, 2] = own.velocity
    log.wanted[d, i, 0], log.wanted[d, i, 1], log.wanted[d, i, 2] = decision.wanted
    log.feasible[d, i], log.conflict[d, i] = decision.feasible, decision.conflict
    log.recovering[d, i] = decision.recovering
    for c in range(3):
        log.flown[d, i, c] = craft.command[i, c]
    log.message_s[d, i, i] = heard[i, i, M_TIME]
    for c in range(MESSAGE_COLUMNS - 1):
        log.others[d, i, i, c] = heard[i, i, 1 + c]
    for n in range(count):
        j = senders[n]
        if n > 0 and senders[n - 1] == j:
            continue  # second row of the same aircraft, at the position that its signal strength suggests
        log.message_s[d, i, j] = heard[i, j, M_TIME]
        for c in range(k.OTHER_COLUMNS):
            log.others[d, i, j, c] = neighbours[n, c]
        for c in range(k.SEEN_COLUMNS):
            log.views[d, i, j, c] = seen[n, c]
