"""The Modified Voltage Potential (MVP) as published in the BlueSky simulator, in compiled code.

J. M. Hoekstra, R. N. H. W. van Gent, R. C. J. Ruigrok, "Designing for safety: the free flight air traffic
management concept" (2002); equations as in BlueSky 22fdf9e: state-based detection
(`traffic/asas/statebased.py`), resolution (`mvp.py`, without priorities) and the rule for going back to the
path (`resolution.py`). A velocity change along the vector of least distance resolves a conflict pair. It is
computed once a second; the aircraft flies the result until it has passed all aircraft with which it was in
conflict. Lengths are scaled from airliners to small aircraft by the parameters. Numbers that would divide by
zero are bounded by _TINY.
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

_TINY: Final = 1e-6
_EVERY_S: Final = 1.0
"""Time between two resolutions; BlueSky's default."""
_BOUNCING_RAD: Final = math.radians(30.0)
# Entries that an aircraft keeps about itself in `Mind.notes`, after an entry of each other aircraft (1: it is
# in conflict with this one, or has not passed it yet): 1 after the first resolution, the time of the last
# one, 1 if it flies a resolution, and the velocity of that.
_BEGUN, _TIME, _ACTIVE, _VELOCITY = 0, 1, 2, 3


class Mvp(NamedTuple):
    """Parameters."""

    radius_m: float
    """Radius of the protected zone."""
    height_m: float
    """Half height of the protected zone."""
    look_s: float
    """Time ahead in which conflicts are detected."""
    level: float
    """1: resolutions are horizontal only, BlueSky's default; 0: in three dimensions."""
    margin: float
    """Factor on the protected zone in a resolution; BlueSky's default is 1.01."""
    head_on_m: float
    """Lower bound of the distance at closest approach in the computation of a resolution; 10 m in BlueSky."""
    predicted: float
    """1: positions are extrapolated by the age of the message; 0: they are those of the message."""


class Meeting(NamedTuple):
    """The state-based prediction for one pair."""

    conflict: bool
    nearest_s: float
    """Time to the horizontal closest approach; negative after it."""
    entry_s: float
    """Time to the entry into the protected zone."""


_compiled = compiled()


@_compiled
def parameters(settings: Floats, i: int) -> Mvp:
    """The parameters of aircraft i."""
    p = settings[i, FIRST:]
    return Mvp(p[0], p[1], p[2], p[3], p[4], p[5], p[6])


@_compiled
def detect(away: k.Vector, relative: k.Vector, p: Mvp) -> Meeting:
    """The state-based conflict detection.

    Args:
        away: the other's position minus ours, m.
        relative: its velocity minus ours, m/s.
    """
    speed2 = max(relative.n * relative.n + relative.e * relative.e, _TINY)
    nearest_s = -(relative.n * away.n + relative.e * away.e) / speed2
    distance2 = away.n * away.n + away.e * away.e
    least2 = abs(distance2 - nearest_s * nearest_s * speed2)
    if least2 >= p.radius_m * p.radius_m:
        return Meeting(False, nearest_s, math.inf)
    inside_s = math.sqrt((p.radius_m * p.radius_m - least2) / speed2)
    closing = relative.d
    if abs(closing) < _TINY:
        if abs(away.d) >= p.height_m:
            return Meeting(False, nearest_s, math.inf)
        first_s, last_s = -math.inf, math.inf
    else:
        one, two = (p.height_m - away.d) / closing, (-p.height_m - away.d) / closing
        first_s, last_s = min(one, two), max(one, two)
    entry_s, exit_s = max(first_s, nearest_s - inside_s), min(last_s, nearest_s + inside_s)
    return Meeting(entry_s <= exit_s and exit_s > 0.0 and entry_s < p.look_s, nearest_s, entry_s)


@_compiled
def change(away: k.Vector, relative: k.Vector, meeting: Meeting, p: Mvp) -> k.Vector:
    """The change of the own velocity that resolves one conflict pair; arguments as in `detect`."""
    radius, height, t = p.margin * p.radius_m, p.margin * p.height_m, meeting.nearest_s
    distance = max(math.sqrt(away.n * away.n + away.e * away.e), _TINY)
    n, e = away.n + t * relative.n, away.e + t * relative.e
    least = math.sqrt(n * n + e * e)
    intrusion = radius - least
    if least <= p.head_on_m:
        least = p.head_on_m
        # BlueSky's (east, north) = (north, -east): to the right of the other aircraft.
        n, e = -away.e / distance * least, away.n / distance * least
    if radius < distance and least < distance:
        erratum = math.cos(math.asin(radius / distance) - math.asin(least / distance))
        intrusion = radius / erratum - least
    push = intrusion / max(abs(t) * least, _TINY)
    rate, below = relative.d, away.d
    solve_s = abs(below / rate) if abs(rate) > 0.0 else meeting.entry_s
    tall = height if abs(rate) > 0.0 else height - abs(below)
    if solve_s > p.look_s:
        solve_s, tall = meeting.entry_s, height
    if abs(solve_s) < _TINY:
        solve_s = _TINY
    # BlueSky's vertical axis points up, ours down: changes and rates have the opposite sign.
    climb = tall / solve_s
    if rate != 0.0:
        climb = climb * (1.0 if rate > 0.0 else -1.0)
    # Both aircraft resolve. As in BlueSky, each takes the whole horizontal change and half of the vertical
    # one.
    return k.Vector(-push * n, -push * e, 0.5 * climb)


@_compiled
def passed(away: k.Vector, relative: k.Vector, own: k.Vector, other: k.Vector, p: Mvp) -> bool:
    """Whether an aircraft no longer has to be avoided: it is past its closest approach, not in the protected
    zone, and does not fly beside us just outside the zone."""
    past = away.n * relative.n + away.e * relative.e > 0.0
    distance = math.sqrt(away.n * away.n + away.e * away.e)
    tracks = abs(math.atan2(own.e, own.n) - math.atan2(other.e, other.n))
    bouncing = tracks < _BOUNCING_RAD and distance < p.margin * p.radius_m
    return past and distance >= p.radius_m and not bouncing


@_compiled
def _resolve(mind: Mind, i: int, count: int, own: k.Own, wanted: k.Vector, p: Mvp, law: k.Settings) -> None:
    """Compute a new resolution of aircraft i and write it to its notes."""
    own_notes, pairs = mind.notes[i, len(mind.notes) :], mind.notes[i]
    v = own.velocity
    n, e, d = v.n, v.e, v.d
    active, resolved = False, False
    for j in range(len(mind.notes)):
        if pairs[j] == 1.0:
            pairs[j] = 2.0  # cleared below unless the aircraft is still known
    for row in range(count):
        j = mind.senders[row]
        away, velocity = beside(k.other_at(mind.neighbours, row), own, p.predicted != 0.0)
        relative = k.minus(velocity, v)
        meeting = detect(away, relative, p)
        if meeting.conflict:
            dv = change(away, relative, meeting, p)
            n, e, d = n + dv.n, e + dv.e, d + dv.d
            resolved = True
        still = (meeting.conflict or pairs[j] != 0.0) and not passed(away, relative, v, velocity, p)
        pairs[j] = 1.0 if still else 0.0
        active = active or still
    for j in range(len(mind.notes)):
        if pairs[j] == 2.0:
            pairs[j] = 0.0
    if p.level != 0.0 or not resolved:
        d = wanted.d
    # `kernels.limit` keeps the limit of the change only for wishes within the greatest speed. As there, the
    # vertical part has priority.
    d = min(max(d, -law.climb_mps), law.descent_mps)
    level, room = math.sqrt(n * n + e * e), math.sqrt(max(law.speed_mps * law.speed_mps - d * d, 0.0))
    if level > room:
        n, e = n * room / level, e * room / level
    own_notes[_BEGUN], own_notes[_TIME], own_notes[_ACTIVE] = 1.0, own.now_s, 1.0 if active else 0.0
    own_notes[_VELOCITY], own_notes[_VELOCITY + 1], own_notes[_VELOCITY + 2] = n, e, d


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
    if notes[_BEGUN] == 0.0 or own.now_s - notes[_TIME] >= _EVERY_S - _TINY:
        _resolve(mind, i, count, own, plain.wanted, p, law)
    active = notes[_ACTIVE] != 0.0
    for row in range(count):
        away, velocity = beside(k.other_at(mind.neighbours, row), own, p.predicted != 0.0)
        avoided = active and mind.notes[i, mind.senders[row]] != 0.0
        report(work.seen, row, own, plain.wanted, away, velocity, p.radius_m, avoided)
    found = plain.wanted
    if active:
        found = k.Vector(notes[_VELOCITY], notes[_VELOCITY + 1], notes[_VELOCITY + 2])
    return commanded(plain, found, True, active, own, law, state)


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
