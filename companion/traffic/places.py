"""Tracks as input of the law: where each is, and where else it may be.

A track whose messages contradict one another is avoided at each place that they reported (`Belief`). The id
of such a place is that of the track with `ASIDE` and a number. A track whose signal strength contradicts its
position is also avoided at the place that the signal strength suggests; the id of that place is that of the
track with `SIGNAL_PLACE`. A track whose positions do not follow its velocity is also avoided with the
velocity that the positions show, under its id with `MOVED_PLACE`.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Mapping
from operator import itemgetter
from typing import Final

import msgspec

from companion.avoidance import kernels
from companion.avoidance.law import ASIDE, SIGMAS, Neighbour
from companion.traffic.fix import Belief
from companion.traffic.plausibility import Flag
from companion.traffic.right_of_way import rank_of, share_of
from companion.traffic.signal_strength import Suspicion
from companion.traffic.track import Track

SIGNAL_PLACE: Final = f"{ASIDE}signal"
"""Suffix of a track's id for the place that its signal strength points to."""
MOVED_PLACE: Final = f"{ASIDE}moved"
"""Suffix of a track's id for the track with the velocity that its positions show."""
_MOST_ASIDE: Final = 50
"""Largest number of places of contradicting messages that the law is given. Tracks, and places that a signal
strength points to, are not counted."""
_CROWD: Final = 5
"""Tracks that sound alike are a group from this many on."""


def neighbours_of(
    tracks: Collection[Track],
    groups: Mapping[str, int],
    own_rank: int,
    loss_s: Callable[[Belief], float],
    now_s: float,
) -> list[Neighbour]:
    """Every track, in order; then where their signal strength points to, and where they were lately reported.

    Args:
        groups: number of tracks in each group.
        own_rank: rank of this aircraft in the right of way.
        loss_s: time until separation from a place would be lost.
    """
    present = [
        Neighbour(
            t.track_id,
            t.position_ned_m,
            t.velocity_ned_mps,
            max(0.0, now_s - t.sample_s),
            t.sigma_m + t.wander.error_m / SIGMAS,
            t.sigma_mps,
            t.past.growth_mps,
            t.unlocated or now_s - t.received_s > t.silent_after_s,
            share_of(own_rank, _rank(t)),
            t.vertical_known,
            proven=t.proven,
            group=t.group if groups[t.group] >= _CROWD else "",
            growth_down_mps=t.past.growth_down_mps,
            together=t.together,
            split=t.track_id != t.identity,
            known_s=now_s - t.opened_s,
            unheard=now_s - t.received_s > t.silent_after_s,
        )
        for t in tracks
    ]
    odd = [
        (other, track)
        for other, track in zip(present, tracks, strict=True)
        if track.signal.suspicion.beside > kernels.BESIDE or track.doubts.flags or track.aside
    ]
    if not odd:
        return present
    signalled = [
        _signalled(other, track.signal.suspicion)
        for other, track in odd
        if track.signal.suspicion.beside > kernels.BESIDE
    ]
    moved = [_moved(other, track) for other, track in odd if Flag.VELOCITY_MISMATCH in track.doubts.flags]
    aside = [
        (loss_s(belief), f"{other.track_id}{ASIDE}{number}", other, belief)
        for other, track in odd
        for number, belief in enumerate(track.aside, 1)
        if now_s - belief.agreed_s <= track.believed_s
    ]
    if len(aside) > _MOST_ASIDE:
        aside = heapq.nsmallest(_MOST_ASIDE, aside, key=itemgetter(0, 1))
    return (
        present
        + signalled
        + moved
        + [
            msgspec.structs.replace(
                other,
                track_id=name,
                position_ned_m=belief.position,
                velocity_ned_mps=belief.velocity,
                age_s=max(0.0, now_s - belief.at_s),
                sigma_m=belief.sigma_m,
                sigma_mps=belief.sigma_mps,
                vertical_known=belief.vertical_known,
            )
            for _, name, other, belief in aside
        ]
    )


def _signalled(there: Neighbour, suspicion: Suspicion) -> Neighbour:
    """A track at the place that its signal strength points to. Nobody has proven that place."""
    north, east, down = there.position_ned_m
    return msgspec.structs.replace(
        there,
        track_id=there.track_id + SIGNAL_PLACE,
        position_ned_m=(north + suspicion.north_m, east + suspicion.east_m, down),
        proven=False,
    )


def _moved(there: Neighbour, track: Track) -> Neighbour:
    """A track with the velocity that its positions show. Nobody has proven that velocity."""
    (north, east), (_, _, down) = track.motion.moved_mps, there.velocity_ned_mps
    return msgspec.structs.replace(
        there,
        track_id=there.track_id + MOVED_PLACE,
        velocity_ned_mps=(north, east, down),
        proven=False,
    )


def _rank(track: Track) -> int:
    told = track.latest.basic_id
    return rank_of(None if told is None else told.ua_type, track.content.status)
