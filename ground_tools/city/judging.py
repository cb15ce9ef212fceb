"""Which track a full table gives up: `companion.traffic.eviction` in compiled code, without signal strengths.

Tests compare the result with `eviction.Ranking`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.arrays import Floats, Integers
from companion.avoidance import kernels as k
from companion.avoidance.kernels.neighbours import GROWTH_AHEAD_S
from companion.avoidance.law import LEAST_MARGIN_M, SIGMAS, horizon_s, separation_m
from companion.config import AvoidanceConfig
from companion.traffic.eviction import (
    AZIMUTHS,
    HOLD_S,
    HORIZONS,
    LOSS_S,
    NEARLY_M,
    OWN_SIGMA_M,
    RANGE_M,
    THREAT,
)
from companion.traffic.track import ESTABLISHED
from ground_tools.campaign.vehicles import M_POSITION, M_TIME, M_VELOCITY, Fleet
from ground_tools.campaign.world import Conditions
from ground_tools.city.compiled import compiled
from ground_tools.city.tables import NOBODY, Tracks

# Columns of a standing: tier, direction, class of time to loss and range, then the sort key within a class.
S_TIER, S_SECTOR, S_PART, S_TRUST, S_LOSS, S_DISTANCE, COLUMNS = range(7)
_PARTS = len(RANGE_M) * (len(LOSS_S) + 1)
PLACES = max(3 * AZIMUTHS, _PARTS)
_compiled = compiled()


class Judge(NamedTuple):
    """The criteria for a threat, which are those of `eviction.Judgement`."""

    radius_m: float
    scale: float
    ahead_s: float


def judge_of(avoidance: AvoidanceConfig) -> Judge:
    """The threat criteria for a law's settings."""
    radius, scale = separation_m(avoidance, False)
    return Judge(radius, scale, HORIZONS * horizon_s(avoidance, False))


@_compiled
def _loss(
    away: tuple[float, float, float], closing: tuple[float, float, float], radius: float, scale: float
) -> float:
    """`companion.avoidance.alerts.approach`, the time until the separation is lost."""
    (px, py, down), (vx, vy, sinking) = away, closing
    pz, vz = scale * down, scale * sinking
    v2, pv = vx * vx + vy * vy + vz * vz, px * vx + py * vy + pz * vz
    gap2 = px * px + py * py + pz * pz - radius * radius
    if gap2 <= 0.0:
        return 0.0
    root = pv * pv - v2 * gap2
    if pv > 0.0 and root >= 0.0:
        return gap2 / (pv + math.sqrt(root))
    return math.inf


@_compiled
def _away(i: int, message: Floats, age: float, craft: Fleet) -> tuple[float, float, float]:
    p, e = craft.position, craft.error
    return (
        message[M_POSITION] + age * message[M_VELOCITY] - (p[i, 0] + e[i, 0]),
        message[M_POSITION + 1] + age * message[M_VELOCITY + 1] - (p[i, 1] + e[i, 1]),
        message[M_POSITION + 2] + age * message[M_VELOCITY + 2] - (p[i, 2] + e[i, 2]),
    )


@_compiled
def loss_s(
    world: Conditions, i: int, message: Floats, age: float, growth_mps: float, craft: Fleet, judge: Judge
) -> float:
    """Time until aircraft i loses separation from the sender of a message, s; infinite: it does not."""
    v, f = craft.velocity, craft.own_error
    closing = (
        v[i, 0] + f[i, 0] - message[M_VELOCITY],
        v[i, 1] + f[i, 1] - message[M_VELOCITY + 1],
        v[i, 2] + f[i, 2] - message[M_VELOCITY + 2],
    )
    drift = world.sigma_mps * age
    sigma = math.sqrt(world.declared_m * world.declared_m + drift * drift + OWN_SIGMA_M * OWN_SIGMA_M)
    margin = max(LEAST_MARGIN_M, SIGMAS * sigma) + growth_mps * (age + GROWTH_AHEAD_S)
    radius = judge.radius_m + margin + NEARLY_M
    return _loss(_away(i, message, age, craft), closing, radius, judge.scale)


@_compiled
def threatens(
    now: float, world: Conditions, i: int, row: int, craft: Fleet, tracks: Tracks, judge: Judge
) -> bool:
    """Whether a track of aircraft i is a threat."""
    return _track_loss(now, world, i, row, craft, tracks, judge) <= judge.ahead_s


@_compiled
def _track_loss(
    now: float, world: Conditions, i: int, row: int, craft: Fleet, tracks: Tracks, judge: Judge
) -> float:
    message = tracks.heard[i, row]
    age = max(now - message[M_TIME], 0.0)
    past = k.past_at(tracks.past[i], row)
    growth = max(past.growth_mps, past.growth_down_mps)
    return loss_s(world, i, message, age, growth, craft, judge)


@_compiled
def _stand(
    standing: Integers, away: tuple[float, float, float], loss: float, ahead_s: float, trust: int,
    together: bool, was_threat: bool,
) -> None:  # fmt: skip
    """Write a standing, as `eviction.Judgement.standing`."""
    n, e, d = away
    distance = math.sqrt(n * n + e * e + d * d)
    threat = loss <= ahead_s
    standing[S_DISTANCE] = int(distance)
    if not (threat or was_threat):
        standing[S_TIER] = trust + 1 if trust > 0 and not together else trust
        standing[S_SECTOR] = standing[S_PART] = standing[S_TRUST] = standing[S_LOSS] = 0
        return
    late = 0
    while late < len(LOSS_S) and LOSS_S[late] < loss:
        late += 1
    ranged = 0
    while ranged < len(RANGE_M) - 1 and RANGE_M[ranged] < distance:
        ranged += 1
    level = math.hypot(n, e)
    azimuth = int(AZIMUTHS * (0.5 + math.atan2(e, n) / (2.0 * math.pi))) % AZIMUTHS
    height = 0 if abs(d) <= 0.6 * level else (1 if d > 0.0 else 2)
    standing[S_TIER] = THREAT if threat else THREAT - 1
    standing[S_SECTOR], standing[S_PART] = 3 * azimuth + height, len(RANGE_M) * late + ranged
    standing[S_TRUST], standing[S_LOSS] = -trust, int(min(2.0 * loss, 1000.0))


@_compiled
def give_up(
    now: float, world: Conditions, i: int, sent: Floats, who: int, craft: Fleet, tracks: Tracks,
    judge: Judge, standings: Integers, crowds: Integers,
) -> int:  # fmt: skip
    """The track that aircraft i gives up for a newcomer, or NOBODY if the newcomer is the least important.

    Args:
        sent: the newcomer's message.
        who: the newcomer's flight.
        standings, crowds: working space; overwritten.
    """
    most = tracks.who.shape[1]
    for row in range(most):
        loss = _track_loss(now, world, i, row, craft, tracks, judge)
        if loss <= judge.ahead_s:
            tracks.threat_s[i, row] = now
        heard = tracks.heard[i, row]
        _stand(
            standings[row], _away(i, heard, max(now - heard[M_TIME], 0.0), craft), loss, judge.ahead_s,
            1 if tracks.messages[i, row] >= ESTABLISHED else 0, tracks.together[i, row] != 0.0,
            now - tracks.threat_s[i, row] <= HOLD_S,
        )  # fmt: skip
    age = max(now - sent[M_TIME], 0.0)
    loss = loss_s(world, i, sent, age, 0.0, craft, judge)
    _stand(standings[most], _away(i, sent, age, craft), loss, judge.ahead_s, 0, False, False)
    row = _first(standings, tracks.who[i], who, crowds)
    return NOBODY if row == most else row


@_compiled
def _first(standings: Integers, names: Integers, newcomer: int, crowds: Integers) -> int:
    """The row to give up: in the lowest tier, take the most crowded direction, in it the most crowded class,
    and in that the first row in the order of `_after`. Of equally crowded ones, take the highest index."""
    tier = standings[0, S_TIER]
    for row in range(1, len(standings)):
        tier = min(tier, standings[row, S_TIER])
    sector = _largest(standings, tier, -1, crowds)
    part = _largest(standings, tier, sector, crowds)
    first = -1
    for row in range(len(standings)):
        s = standings[row]
        if s[S_TIER] != tier or s[S_SECTOR] != sector or s[S_PART] != part:
            continue
        if first < 0 or _after(standings, names, newcomer, row, first):
            first = row
    return first


@_compiled
def _largest(standings: Integers, tier: int, sector: int, crowds: Integers) -> int:
    """The most crowded direction of a tier or, given a direction, its most crowded class."""
    crowds[:] = 0
    for row in range(len(standings)):
        s = standings[row]
        if s[S_TIER] == tier and (sector < 0 or s[S_SECTOR] == sector):
            crowds[s[S_SECTOR] if sector < 0 else s[S_PART]] += 1
    best = 0
    for place in range(len(crowds)):
        if crowds[place] >= crowds[best]:
            best = place
    return best


@_compiled
def _after(standings: Integers, names: Integers, newcomer: int, row: int, other: int) -> bool:
    """Whether a row is given up before another one of the same class."""
    for c in (S_TRUST, S_LOSS, S_DISTANCE):
        if standings[row, c] != standings[other, c]:
            return bool(standings[row, c] > standings[other, c])
    mine = newcomer if row == len(names) else names[row]
    theirs = newcomer if other == len(names) else names[other]
    return bool(mine > theirs)
