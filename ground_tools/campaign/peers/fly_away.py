"""The fly-away rule of ArduPilot's AP_Avoidance, in compiled code.

Equations and constants as in `libraries/AP_Avoidance/AP_Avoidance.cpp` and `ArduCopter/avoidance_adsb.cpp` of
ArduPilot: an aircraft is a threat if it comes within `F_DIST_XY` and `F_DIST_Z` in the next `F_TIME` seconds.
The threat with the least time to its closest approach is avoided, at full speed along the component of the
own relative position perpendicular to its velocity, or straight away from it if it is slower than 1 m/s. The
avoidance ends at the earliest 2 s after the last change of the threat level; then the aircraft resumes its
path. Positions are those in the message; to compensate, the time ahead is longer by the message's age in
whole seconds.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from companion.arrays import Floats
from companion.avoidance import kernels as k
from ground_tools.campaign.compiled import compiled
from ground_tools.campaign.flight import Mind, loop_of, state_of
from ground_tools.campaign.outcome import Log, Tally
from ground_tools.campaign.peers.common import AVOIDS, FIRST, beside, commanded, following, report
from ground_tools.campaign.powers import Powers
from ground_tools.campaign.vehicles import Fleet
from ground_tools.campaign.world import Conditions

_OLDEST_S: Final = 5.0
"""Greatest age of a threat's message: ArduPilot's MAX_OBSTACLE_AGE_MS."""
_KEPT_S: Final = 2.0
"""Time before the avoidance ends: ArduPilot's AP_AVOIDANCE_STATE_RECOVERY_TIME_MS."""
_SLOW_MPS: Final = 1.0
"""Speed below which a threat counts as slow: ArduPilot's _low_velocity_threshold."""
_TINY: Final = 1e-7
# Entries that an aircraft keeps about itself in `Mind.notes`: 1 if its threat level is high, the time at
# which that changed, and the velocity that it flies.
_HIGH, _CHANGED, _VELOCITY = 0, 1, 2


class FlyAway(NamedTuple):
    """Parameters, by their names in ArduPilot."""

    f_dist_xy_m: float
    f_dist_z_m: float
    f_time_s: float
    level: float
    """1: F_ACTION 3, move horizontally; 0: F_ACTION 4, move perpendicularly in three dimensions."""
    predicted: float
    """0: as in ArduPilot; 1: positions are extrapolated by the age of the message."""


_compiled = compiled()


@_compiled
def parameters(settings: Floats, i: int) -> FlyAway:
    """The parameters of aircraft i."""
    p = settings[i, FIRST:]
    return FlyAway(p[0], p[1], p[2], p[3], p[4])


@_compiled
def nearest_level(away: k.Vector, relative: k.Vector, within_s: float) -> float:
    """`closest_approach_xy`: least horizontal distance (m) within a time.

    Args:
        away: the other's position minus ours, m.
        relative: its velocity minus ours, m/s.
    """
    speed2 = relative.n * relative.n + relative.e * relative.e
    t = 0.0
    if speed2 > 0.0:
        t = min(max(-(away.n * relative.n + away.e * relative.e) / speed2, 0.0), within_s)
    return math.sqrt((away.n + t * relative.n) ** 2 + (away.e + t * relative.e) ** 2)


@_compiled
def nearest_above(away: k.Vector, relative: k.Vector, within_s: float) -> float:
    """`closest_approach_z`: least difference of heights (m), as ArduPilot computes it.

    ArduPilot takes the difference of heights in centimetres upwards, but that of vertical speeds in m/s
    downwards, so that the speeds hardly count. This is reproduced here.
    """
    above_cm, sinks = -100.0 * away.d, relative.d
    if (above_cm >= 0.0 and sinks >= 0.0) or (above_cm <= 0.0 and sinks <= 0.0):
        return abs(above_cm) / 100.0
    return abs(above_cm - sinks * within_s) / 100.0


@_compiled
def away_from(away: k.Vector, velocity: k.Vector, law: k.Settings, level: bool) -> tuple[bool, k.Vector]:
    """`get_vector_perpendicular`, and the velocity that the copter flies. The first value is False if there
    is no direction.

    Args:
        away: the other's position minus ours, m.
        velocity: its velocity, m/s.
        level: move horizontally only.
    """
    us = k.Vector(-away.n, -away.e, -away.d)
    speed2 = k.dot(velocity, velocity)
    if speed2 >= _SLOW_MPS * _SLOW_MPS:
        along = k.dot(us, velocity)
        if abs(along) >= _TINY:
            share = along / speed2
            us = k.Vector(us.n - share * velocity.n, us.e - share * velocity.e, us.d - share * velocity.d)
    if level:
        us = k.Vector(us.n, us.e, 0.0)
    size = math.sqrt(k.dot(us, us))
    if size < _TINY:
        return False, us
    down = us.d / size
    down = down * (law.climb_mps if down < 0.0 else law.descent_mps)
    return True, k.Vector(us.n / size * law.speed_mps, us.e / size * law.speed_mps, down)


@_compiled
def _threat(mind: Mind, count: int, own: k.Own, wanted: k.Vector, p: FlyAway, seen: Floats) -> int:
    """Row of the most serious threat, -1 if there is none. Writes the reports."""
    worst, soonest = -1, math.inf
    for row in range(count):
        other = k.other_at(mind.neighbours, row)
        away, velocity = beside(other, own, p.predicted != 0.0)
        relative = k.minus(velocity, own.velocity)
        within = p.f_time_s + (0.0 if p.predicted != 0.0 else math.floor(other.age_s))
        near = nearest_level(away, relative, within)
        high = near < p.f_dist_xy_m and nearest_above(away, relative, within) <= p.f_dist_z_m
        high = high and other.age_s <= _OLDEST_S
        report(seen, row, own, wanted, away, velocity, p.f_dist_xy_m, high)
        if high:
            speed = math.sqrt(relative.n * relative.n + relative.e * relative.e)
            way = math.sqrt(away.n * away.n + away.e * away.e) - near
            soon = way / speed if speed > 0.0 else 0.0
            if soon < soonest:
                worst, soonest = row, soon
    return worst


@_compiled
def decide(
    mind: Mind,
    i: int,
    count: int,
    own: k.Own,
    path: k.Path,
    fence: Floats,
    settings: Floats,
    law: k.Settings,
    work: k.Workspace,
) -> k.Decision:
    """The decision function; see `flight.Decide`."""
    state = state_of(mind, i)
    plain = following(mind, i, own, path, fence, law, work)
    if settings[i, AVOIDS] == 0.0:
        return plain
    p, notes = parameters(settings, i), mind.notes[i, len(mind.notes) :]
    row = _threat(mind, count, own, plain.wanted, p, work.seen)
    high, was = row >= 0, notes[_HIGH] != 0.0
    if high != was and (high or own.now_s - notes[_CHANGED] > _KEPT_S):
        notes[_HIGH], notes[_CHANGED] = 1.0 if high else 0.0, own.now_s
        notes[_VELOCITY], notes[_VELOCITY + 1] = own.velocity.n, own.velocity.e
        notes[_VELOCITY + 2] = own.velocity.d
    if high:
        away, velocity = beside(k.other_at(mind.neighbours, row), own, p.predicted != 0.0)
        found, flown = away_from(away, velocity, law, p.level != 0.0)
        if found:
            notes[_VELOCITY], notes[_VELOCITY + 1], notes[_VELOCITY + 2] = flown.n, flown.e, flown.d
    if notes[_HIGH] == 0.0:
        return commanded(plain, plain.wanted, True, False, own, law, state)
    wish = k.Vector(notes[_VELOCITY], notes[_VELOCITY + 1], notes[_VELOCITY + 2])
    return commanded(plain, wish, True, True, own, law, state)


@_compiled
def fly(
    rng: np.random.Generator,
    world: Conditions,
    path_times: Floats,
    path_points: Floats,
    fence: Floats,
    settings: Floats,
    kinds: Floats,
    trace: Floats,
    log: Log,
    pairs: Floats,
    result: Floats,
    craft: Fleet,
    tally: Tally,
    mind: Mind,
    work: k.Workspace,
    dark: int,
    dark_from: float,
    powers: Powers,
    power_rng: np.random.Generator,
) -> None:
    """The loop of this law; see `flight.Loop`."""
    loop_of(
        decide, rng, world, path_times, path_points, fence, settings, kinds, trace, log, pairs, result, craft,
        tally, mind, work, dark, dark_from, powers, power_rng,
    )  # fmt: skip
