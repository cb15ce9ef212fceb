"""Which track a message belongs to.

Everything in a message can be copied, the radio address too. So a message belongs to a track only if that
track's aircraft can have sent it: it must be near the predicted place, with a velocity that the aircraft can
have by now. A message that fits no track of its name opens another one, a second hypothesis of where the
aircraft is. Both go on, and both are avoided.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from companion.geometry import Vec3
from companion.traffic.fix import Fix, height_error_m
from companion.traffic.plausibility import Flag
from companion.traffic.senders.source import Source
from companion.traffic.track import (
    CLOCKLESS_MOST_S,
    HIGH_M,
    Track,
    beyond,
    clock_error_s,
    flown,
    lead,
    near,
    off,
    reach,
)

_JOINED_WITHIN_M = 15.0
"""Two tracks are merged only if they are this near to each other. An aircraft's positions on two transports
come from one GNSS receiver. With a larger distance, a sender with a copied identity could remove another's
track."""
_TWIN_MEMORY_S = 60.0
"""For this long after another track of the same identity existed, a track is matched only to messages near
it, because others may still be from the other aircraft."""
_TURN_MPS2, _TURN_MPS = 6.0, 3.5
"""A velocity may differ from the track's by `_TURN_MPS`, and by `_TURN_MPS2` times the time between."""
_PRETENDED_MPS2, _PRETENDED_MPS = 12.0, 6.0
"""As above, for a sender without a usable clock. In one of the kept captures, a module that simulates
circling turns by 27 m/s in a second."""
_GROWS_S = 2.0
"""Limit of the time over which a possible manoeuvre is extrapolated if two senders use one name."""
_CLOCK_MPS = 5.0
"""Penalty in metres for each second of difference between two clocks, if several tracks fit."""
_OLD_M = 1000.0
"""Penalty in metres if a message is not newer than a track, if several tracks fit."""


def match(
    known: Sequence[Track], source: Source, fix: Fix, now_s: float, max_speed_mps: float
) -> tuple[Track | None, float]:
    """The track whose aircraft can have sent the fix, and its distance from it (m).

    Tracks that the same address fed last come first, then the one that it fits best. Without such a track,
    the result is None and infinity.

    After some silence one aircraft can be nearly anywhere. If two aircraft use the identity, or the address
    is new to the track, the fix must be near the track; otherwise one track would jump between two aircraft,
    and one of them would be lost. An aircraft that changes its address does not return to the old one. So if
    two addresses take turns on a transport, each gets its own track; otherwise one sender could pull the
    track away from the other.

    Args:
        known: the tracks of its identity.
        max_speed_mps: how fast an aircraft of unknown velocity may fly.
    """
    at = now_s if fix.stamp_s is None else min(fix.stamp_s, now_s)
    several = len(known) > 1
    best, least, nearest = None, (True, math.inf), math.inf
    for track in known:
        elapsed, noise = abs(at - track.sample_s), fix.sigma_m + track.sigma_m
        if several:
            track.beside_s = now_s
        twins = now_s - track.beside_s <= _TWIN_MEMORY_S
        others = track.fed_by.get(source.latest.transport) != source.key
        if others and source.key in track.sources:
            continue
        away = off(track, fix, at)
        if not track.velocity_known:
            allowed = reach(elapsed, noise) + max_speed_mps * elapsed
        elif twins or others:
            allowed = near(noise)
        else:
            away, allowed = beyond(track, fix, at), flown(elapsed, noise)
        if away > allowed or not _turned(track, fix, track.velocity_ned_mps, elapsed):
            continue
        if not _follows(track, fix, at, others=twins or others):
            continue
        penalty_m = away + (_penalty_m(track, fix, now_s) if several else 0.0)
        if (others, penalty_m) < least:
            best, least, nearest = track, (others, penalty_m), away
    return best, nearest


def _turned(track: Track, fix: Fix, velocity: Vec3, elapsed_s: float) -> bool:
    """Whether the aircraft can have changed its velocity to that of a fix. If its positions do not follow its
    velocity, that is no reason to tell messages apart.

    Args:
        velocity: the aircraft's, `elapsed_s` before.
    """
    if fix.velocity is None or track.declared_s is None or Flag.VELOCITY_MISMATCH in track.doubts.flags:
        return True
    clocked = track.past_clocked if track.earlier is None else track.earlier.clocked
    if clocked:
        allowed = _TURN_MPS + _TURN_MPS2 * elapsed_s
    else:
        allowed = _PRETENDED_MPS + _PRETENDED_MPS2 * (elapsed_s + CLOCKLESS_MOST_S)
    return math.dist(fix.velocity, velocity) <= allowed


def _follows(track: Track, fix: Fix, at_s: float, *, others: bool) -> bool:
    """Whether the aircraft can also have come to a fix from its earlier state.

    A quick series of forged messages could move a track by many small steps. Each step alone is possible, but
    all together are not. Heights are compared only here.

    Args:
        others: whether the message may be from another aircraft, which after some silence may be anywhere.
    """
    earlier = track.earlier
    if earlier is None:
        return True
    elapsed_s = max(0.0, at_s - earlier.at_s)
    grown_s = min(elapsed_s, _GROWS_S) if others else elapsed_s
    slack_s = clock_error_s(track, earlier.clocked)
    p, v, now = earlier.position, earlier.velocity, fix.position
    # Allow any height between the last and the predicted one, because some send heights without vertical
    # speed.
    if fix.vertical_known and earlier.vertical_known:
        ends = [p[2] + along * v[2] for along in (-slack_s, elapsed_s + slack_s)]
        off_m = max(min(ends) - now[2], now[2] - max(ends))
        if off_m > HIGH_M + earlier.height_m + height_error_m(fix.content) + grown_s * (4.0 + 5.0 * grown_s):
            return False
    if not track.velocity_known:
        return True
    north, east, v2 = now[0] - p[0], now[1] - p[1], v[0] * v[0] + v[1] * v[1]
    along = (north * v[0] + east * v[1]) / v2 if v2 > 0.0 else 0.0
    along = min(max(along, -slack_s), elapsed_s + slack_s)
    away_m = math.hypot(north - along * v[0], east - along * v[1])
    if away_m > flown(grown_s, fix.sigma_m + earlier.sigma_m):
        return False
    return _turned(track, fix, v, elapsed_s)


def _penalty_m(track: Track, fix: Fix, now_s: float) -> float:
    """Penalty (m) for what does not fit between a fix and a track, apart from the place."""
    penalty_m = 0.0
    if fix.velocity is not None:
        penalty_m += math.dist(fix.velocity, track.velocity_ned_mps)
    if fix.stamp_s is not None:
        penalty_m += _CLOCK_MPS * abs(fix.stamp_s - now_s - track.leads_s[-1])
        if fix.stamp_s - lead(track.leads_s) <= track.sample_s:
            penalty_m += _OLD_M
    return penalty_m


def same_aircraft(track: Track, others: Iterable[Track]) -> Track | None:
    """The track among `others` that is the same aircraft as `track`; the nearest if there are several.

    This is stricter than `match`, because a merge gives up one of two positions and velocities.
    """
    best, least = None, _JOINED_WITHIN_M
    for other in others:
        earlier, later = sorted((track, other), key=lambda t: t.sample_s)
        elapsed = later.sample_s - earlier.sample_s
        moved = [
            p + elapsed * v for p, v in zip(earlier.position_ned_m, earlier.velocity_ned_mps, strict=True)
        ]
        away = math.dist(moved[:2], later.position_ned_m[:2])
        if track.vertical_known and other.vertical_known:
            errors_m = height_error_m(track.content) + height_error_m(other.content)
            if abs(moved[2] - later.position_ned_m[2]) > HIGH_M + errors_m:
                continue
        if track.velocity_known and other.velocity_known:
            turned = math.dist(track.velocity_ned_mps, other.velocity_ned_mps)
            if turned > _TURN_MPS + _TURN_MPS2 * elapsed:
                continue
        if away < least:
            best, least = other, away
    return best
