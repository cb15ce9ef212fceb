"""A reference with perfect knowledge: the true present and future of everybody, without delay or error.

The paths of all avoiding aircraft are planned together before the flight. The plan minimises the sum of
squared distances from the timed paths, over all motions that keep everybody apart within the limits of speed,
climb and acceleration. The true future positions of aircraft that do not avoid are known. The plan is found
by the alternating direction method of multipliers, with one set of copies for every limit and for every pair
(J. Bento, N. Derbinsky, J. Alonso-Mora, J. Yedidia, "A message-passing algorithm for multi-agent trajectory
planning", 2013). The set of allowed relative positions is not convex, so the result is a local optimum near
the initial guess. It shows what is possible, but not what is impossible.

Then the aircraft fly the plan, with the vehicle's lag and with the same limits on commands as any law.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from companion.arrays import AnyFloats, Floats
from companion.avoidance import kernels as k
from ground_tools.campaign.compiled import compiled
from ground_tools.campaign.outcome import Log, Tally, land, measure, nothing_yet
from ground_tools.campaign.vehicles import AVOIDS, Fleet, begin, move, on_the_ground
from ground_tools.campaign.world import Conditions

NAME: Final = "omniscient"
STEP_S: Final = 0.5
"""Time step of the plan."""
APART_M: Final = 11.0
"""Distance that the plan keeps: the required 10 m plus the error with which aircraft follow the plan."""
_WITHIN: Final = (0.5, 0.85)
"""Shares of the limits that a plan uses; the rest is a reserve for following it. A larger share is used only
where no plan within a smaller one keeps everybody apart: vehicles follow a sharper plan with more error."""
_TOLERANCE_M: Final = 0.5
_LINEARISED, _ROUNDS = 4, 60
_STILL_M: Final = 2e-3
_BEGINNINGS: Final = 3
_MOST_MOVES: Final = 300
_AWHILE_S: Final = 4.0
"""Standard deviation in time of the bump with which the initial guess moves an aircraft aside."""
_NOWHERE_M: Final = 0.01
_PULL: Final = (4.0, 1.0, 1.0)
"""Weights of the copies of accelerations, velocities and pairs."""
_FOLLOW: Final = 0.8
"""Gain from the distance to the plan to the commanded velocity, 1/s."""


class Limits(NamedTuple):
    """Limits of the avoiding aircraft, each of shape (A,); m/s and m/s^2."""

    speed: AnyFloats
    climb: AnyFloats
    descent: AnyFloats
    acceleration: AnyFloats


def fly(
    rng: np.random.Generator,
    world: Conditions,
    path_times: Floats,
    path_points: Floats,
    fence: Floats,
    settings: Floats,
    kinds: Floats,
    futures: Floats,
    trace: Floats,
    log: Log,
    pairs: Floats,
    result: Floats,
) -> None:
    """Fly a fleet along its paths. Arguments that are not listed here are those of `flight.fly`.

    Args:
        rng: source of the plan's random initial guesses.
        futures: shape (steps, A, 3): true positions at the end of each step, if nobody avoids.
    """
    avoids = kinds == AVOIDS
    times = np.arange(world.start_s, world.end_s + 0.5 * STEP_S, STEP_S)
    wanted = np.stack([_along(times, t, p) for t, p in zip(path_times, path_points, strict=True)])
    ends = world.start_s + world.step_s * np.arange(1, len(futures) + 1)
    others = np.array([_along(times, ends, futures[:, j]) for j in np.flatnonzero(~avoids)])
    plans = np.zeros(wanted.shape)
    plans[avoids] = plan(rng, wanted[avoids], others.reshape(-1, len(times), 3), _limits(settings[avoids]))
    craft, tally = on_the_ground(len(kinds), world), nothing_yet(len(kinds), pairs, result)
    late = np.zeros(len(kinds))
    begin(rng, world, path_times, path_points, kinds, craft)
    _fly(
        rng, world, path_times, path_points, fence, settings, kinds, futures, plans, late, trace, log, craft,
        tally, result,
    )  # fmt: skip
    land(kinds, late, tally, pairs, result)


def plan(rng: np.random.Generator, wanted: AnyFloats, others: AnyFloats, limits: Limits) -> AnyFloats:
    """Plan the motion of all avoiding aircraft together.

    Args:
        wanted: shape (A, T, 3): wanted position of each aircraft at each time step.
        others: shape (B, T, 3): positions of the aircraft that do not avoid.

    Returns:
        Planned positions at each time step, (A, T, 3). If a plan does not keep everybody apart, more are made
        from other initial guesses, and then with more of the limits. If none does, the plan with the least
        shortfall is returned.
    """
    if _least_distance(wanted, others) >= APART_M:
        return wanted
    found: list[tuple[float, int, AnyFloats]] = []
    for within in _WITHIN:
        for beginning in range(_BEGINNINGS):
            first = _parted(None if beginning == 0 else rng, wanted, others)
            one = _optimised(first, wanted, others, limits, within)
            short = APART_M - _TOLERANCE_M - _least_distance(one, others)
            found.append((short, len(found), one))
            if short <= 0.0:
                return one
    return min(found)[2]


def _parted(rng: np.random.Generator | None, wanted: AnyFloats, others: AnyFloats) -> AnyFloats:
    """An initial guess: repeatedly, the two aircraft that come nearest to each other are moved aside around
    that time.

    Args:
        rng: draws the sides; None: each aircraft moves to the side on which it already passes.
    """
    x, (number, steps, _) = wanted.copy(), wanted.shape
    everyone = np.concatenate([x, others])
    a, b = np.triu_indices(len(everyone), 1)
    a, b = a[a < number], b[a < number]
    away = everyone[a] - everyone[b]
    for _ in range(_MOST_MOVES):
        nearest = _nearest(away)
        square = (nearest**2).sum(axis=2)
        pair, step = np.unravel_index(int(square.argmin()), square.shape)
        if square[pair, step] >= APART_M**2:
            break
        both = b[pair] < number
        side = _side(rng, nearest[pair, step], away[pair, step + 1] - away[pair, step])
        short = APART_M + 1.0 - float(nearest[pair, step] @ side)
        bump = np.exp(-0.5 * ((np.arange(steps) - step - 0.5) * STEP_S / _AWHILE_S) ** 2)
        bump *= np.minimum(np.arange(steps) * STEP_S / _AWHILE_S, 1.0)  # all aircraft begin on their paths
        move = short * bump[:, None] * side
        for i, share in ((a[pair], 0.5 if both else 1.0), (b[pair], -0.5 if both else 0.0)):
            away[a == i] += share * move
            away[b == i] -= share * move
            if i < number:
                x[i] += share * move
    return x


def _side(rng: np.random.Generator | None, beside: AnyFloats, way: AnyFloats) -> AnyFloats:
    """The direction in which one of a pair is moved: perpendicular to the relative motion.

    Args:
        beside: the relative position at the closest approach.
        way: the relative motion there.
    """
    way = way / max(float(np.linalg.norm(way)), 1e-9)
    if rng is not None:
        beside = rng.normal(0.0, [1.0, 1.0, 0.7])
    across = beside - (beside @ way) * way
    if np.linalg.norm(across) < _NOWHERE_M:
        across = np.array([-way[1], way[0] + 1e-9, 0.0])  # to the right, even for a vertical motion
    return np.asarray(across / np.linalg.norm(across))


def _nearest(away: AnyFloats) -> AnyFloats:
    """The nearest relative position on each straight line between two time steps; time is the second-last
    axis."""
    p, d = away[..., :-1, :], np.diff(away, axis=-2)
    square = np.maximum((d**2).sum(axis=-1, keepdims=True), 1e-12)
    return np.asarray(p + np.clip(-(p * d).sum(axis=-1, keepdims=True) / square, 0.0, 1.0) * d)


def _optimised(
    first: AnyFloats, wanted: AnyFloats, others: AnyFloats, limits: Limits, within: float
) -> AnyFloats:
    """A local optimum near `first`. Around every relative position, the set of allowed positions is replaced
    by a half-space. The resulting convex problem is solved; this is repeated a few times."""
    number, steps, _ = wanted.shape
    solved = _solved(steps, number, len(others))
    a, b = np.triu_indices(number, 1)
    ends = np.zeros((number, len(a)))
    ends[a, np.arange(len(a))], ends[b, np.arange(len(a))] = 1.0, -1.0
    pull_bend, pull_rate, pull_pair = _PULL
    x = first.copy()
    off = [np.zeros((number, steps - 2, 3)), np.zeros((number, steps - 1, 3)),
           np.zeros((len(a), steps, 3)), np.zeros((number, len(others), steps, 3))]  # fmt: skip
    for _ in range(_LINEARISED):
        sides = [_directions(x[a] - x[b]), _directions(x[:, None] - others[None])]
        for _ in range(_ROUNDS):
            copies = [
                _in_ball(_rate(_rate(x)) + off[0], within * limits.acceleration[:, None, None]),
                _in_limits(_rate(x) + off[1], limits, within),
                _beyond(x[a] - x[b] + off[2], sides[0]),
                _beyond(x[:, None] - others[None] + off[3], sides[1]),
            ]
            pulls = [copy - part for copy, part in zip(copies, off, strict=True)]
            right = wanted + pull_bend * _back(_back(pulls[0])) + pull_rate * _back(pulls[1])
            right += pull_pair * (ends @ pulls[2].reshape(len(a), 3 * steps)).reshape(wanted.shape)
            right += pull_pair * (pulls[3] + others[None]).sum(axis=1)
            before, x = x, _solve(solved, right, wanted)
            ways = [_rate(_rate(x)), _rate(x), x[a] - x[b], x[:, None] - others[None]]
            off = [part + way - copy for part, way, copy in zip(off, ways, copies, strict=True)]
            if np.abs(x - before).max() < _STILL_M:
                break
    return x


def _directions(away: AnyFloats) -> AnyFloats:
    """For every time step, the direction of the nearest relative position in the two intervals that meet at
    it. Both ends of the interval of closest approach get the same direction, so the whole interval stays
    separated."""
    nearest = _nearest(away)
    size = np.linalg.norm(nearest, axis=-1, keepdims=True)
    side = nearest / np.maximum(size, 1e-9)
    before = np.concatenate([side[..., :1, :], side], axis=-2)
    after = np.concatenate([side, side[..., -1:, :]], axis=-2)
    far_before = np.concatenate([size[..., :1, :], size], axis=-2)
    far_after = np.concatenate([size, size[..., -1:, :]], axis=-2)
    return np.where(far_before < far_after, before, after)


def _beyond(away: AnyFloats, side: AnyFloats) -> AnyFloats:
    """The nearest relative positions that are at least `APART_M` away in a direction."""
    short = APART_M - (away * side).sum(axis=-1, keepdims=True)
    return np.asarray(away + np.maximum(short, 0.0) * side)


def _in_ball(way: AnyFloats, most: AnyFloats) -> AnyFloats:
    size = np.linalg.norm(way, axis=-1, keepdims=True)
    return np.asarray(way * np.minimum(1.0, most / np.maximum(size, 1e-9)))


def _in_limits(velocity: AnyFloats, limits: Limits, within: float) -> AnyFloats:
    """Velocities within the limits, close to the nearest ones: first the vertical speed is limited, then the
    horizontal one."""
    down = np.clip(velocity[..., 2], -within * limits.climb[:, None], within * limits.descent[:, None])
    room = np.sqrt(np.maximum(limits.speed[:, None] ** 2 * _FAST**2 - down**2, 0.0))
    return np.concatenate([_in_ball(velocity[..., :2], room[..., None]), down[..., None]], axis=-1)


_FAST: Final = 0.97
"""Share of the greatest speed that the plan uses."""


def _rate(x: AnyFloats) -> AnyFloats:
    """Velocities from positions; time is the second-last axis."""
    return np.diff(x, axis=-2) / STEP_S


def _back(y: AnyFloats) -> AnyFloats:
    """The transpose of `_rate`."""
    found = np.zeros((*y.shape[:-2], y.shape[-2] + 1, y.shape[-1]))
    found[..., 1:, :] += y
    found[..., :-1, :] -= y
    return found / STEP_S


class _Solved(NamedTuple):
    """Matrices of the linear problem of one round. The first two positions of each plan are given."""

    each: AnyFloats
    """(T - 2, T - 2): from the right-hand side of one aircraft to its other positions."""
    mean: AnyFloats
    """(T - 2, T - 2): added term, from the mean right-hand side of all aircraft."""
    each_first: AnyFloats
    """(T - 2, 2): from the given positions of one aircraft."""
    mean_first: AnyFloats
    """(T - 2, 2): added term, from the mean given positions of all aircraft."""


@lru_cache(maxsize=4)
def _solved(steps: int, number: int, others: int) -> _Solved:
    rate = _rate(np.eye(steps))
    bend = _rate(rate)
    pull_bend, pull_rate, pull_pair = _PULL
    same = np.eye(steps) + pull_bend * bend.T @ bend + pull_rate * rate.T @ rate
    # The pair terms couple the aircraft: only non-avoiding aircraft act on the mean, all act on the
    # differences.
    inverses, firsts = [], []
    for pairs in (others + number, others):
        matrix = same + pull_pair * pairs * np.eye(steps)
        inverses.append(np.linalg.inv(matrix[2:, 2:]))
        firsts.append(-inverses[-1] @ matrix[2:, :2])
    return _Solved(inverses[0], inverses[1] - inverses[0], firsts[0], firsts[1] - firsts[0])


def _solve(m: _Solved, right: AnyFloats, wanted: AnyFloats) -> AnyFloats:
    """The positions after one round, (A, T, 3)."""
    number, steps, _ = wanted.shape
    x, start = wanted.copy(), wanted[:, :2]
    sides = right[:, 2:].transpose(1, 0, 2).reshape(steps - 2, 3 * number)
    x[:, 2:] = (m.each @ sides).reshape(steps - 2, number, 3).transpose(1, 0, 2)
    x[:, 2:] += m.each_first @ start
    x[:, 2:] += m.mean @ right[:, 2:].mean(axis=0) + m.mean_first @ start.mean(axis=0)
    return x


def _limits(settings: Floats) -> Limits:
    rows = [k.Settings(*row[: len(k.Settings._fields)]) for row in settings.tolist()]
    return Limits(
        np.array([row.speed_mps for row in rows]),
        np.array([row.climb_mps for row in rows]),
        np.array([row.descent_mps for row in rows]),
        np.array([row.acceleration_mps2 for row in rows]),
    )


def _along(at: AnyFloats, times: AnyFloats, points: AnyFloats) -> AnyFloats:
    return np.column_stack([np.interp(at, times, points[:, c]) for c in range(3)])


def _least_distance(plans: AnyFloats, others: AnyFloats) -> float:
    """Least distance of an avoiding aircraft from anyone, on straight lines between the time steps."""
    everyone = np.concatenate([plans, others])
    least = math.inf
    for i in range(len(plans)):
        for j in range(i + 1, len(everyone)):
            least = min(least, float(np.linalg.norm(_nearest(everyone[j] - everyone[i]), axis=1).min()))
    return least


@compiled()
def _fly(
    rng: np.random.Generator,
    world: Conditions,
    path_times: Floats,
    path_points: Floats,
    fence: Floats,
    settings: Floats,
    kinds: Floats,
    futures: Floats,
    plans: Floats,
    late: Floats,
    trace: Floats,
    log: Log,
    craft: Fleet,
    tally: Tally,
    result: Floats,
) -> None:
    """Fly plans, shape (A, T, 3), one row for each `STEP_S`."""
    every = int(world.period)
    for tick in range(len(futures)):
        now = world.start_s + tick * world.step_s
        if tick % every == 0:
            for i in range(len(kinds)):
                if kinds[i] == AVOIDS:
                    _command(world, now, plans[i], k.settings_at(settings, i), craft, i)
                if tick // every < len(log.time_s):
                    d = tick // every
                    log.time_s[d, i], log.feasible[d, i] = now, 1.0
                    for c in range(3):
                        log.position[d, i, c] = craft.position[i, c]
                        log.velocity[d, i, c] = craft.velocity[i, c]
                        log.flown[d, i, c] = craft.command[i, c]
        move(rng, world, craft)
        for i in range(len(kinds)):
            for c in range(3):
                if kinds[i] != AVOIDS:
                    craft.position[i, c] = futures[tick, i, c]
                if tick < len(trace):
                    trace[tick, i, c] = craft.position[i, c]
        measure(world, tick, path_times, path_points, late, fence, settings, kinds, craft, tally, result)


@compiled(inline="always")
def _command(world: Conditions, now: float, plan: Floats, law: k.Settings, craft: Fleet, i: int) -> None:
    """Command aircraft i to follow its plan."""
    p, v, b = craft.position[i], craft.velocity[i], craft.command[i]
    wish = k.Vector(
        _wish(world, now, plan, law.period_s, craft, i, 0),
        _wish(world, now, plan, law.period_s, craft, i, 1),
        _wish(world, now, plan, law.period_s, craft, i, 2),
    )
    own = k.Own(
        k.Vector(p[0], p[1], p[2]), k.Vector(v[0], v[1], v[2]), 0.0, now, now,
        world.floor_down_m, world.ceiling_down_m,
    )  # fmt: skip
    least, most = k.down_speeds(own, law)
    bounds = k.Bounds(law.acceleration_mps2 * law.period_s, least, most, law.speed_mps)
    chosen = k.limit(wish, k.Vector(b[0], b[1], b[2]), bounds)
    craft.command[i, 0], craft.command[i, 1], craft.command[i, 2] = chosen


@compiled(inline="always")
def _wish(
    world: Conditions, now: float, plan: Floats, period_s: float, craft: Fleet, i: int, c: int
) -> float:
    """One axis of the velocity that follows the plan: the plan's velocity half a period later, plus a term
    that compensates the vehicle's lag, plus a share of the distance from the plan."""
    row = (now + 0.5 * period_s - world.start_s) / STEP_S
    first = min(max(int(row), 0), len(plan) - 3)
    share = min(row - first, 2.0)
    before, after = plan[first + 1, c] - plan[first, c], plan[first + 2, c] - plan[first + 1, c]
    at = plan[first, c] + share * before
    here = craft.position[i, c] + 0.5 * period_s * craft.velocity[i, c]
    mean = before + (after - before) * min(share, 1.0)
    return float((mean + world.lag_s * (after - before) / STEP_S) / STEP_S + _FOLLOW * (at - here))
