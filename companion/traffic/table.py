"""The table of tracks: its contents, the keys by which they are found, and eviction when it is full."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

from companion.avoidance.kernels.neighbours import GROWTH_AHEAD_S
from companion.geometry import Vec3
from companion.traffic.eviction import (
    HOLD_S,
    Burst,
    FullTable,
    Judgement,
    Motion,
    Ranking,
    Standing,
    Trust,
    Value,
    allowance_of,
    margin_m,
    sound_of,
)
from companion.traffic.fix import Fix
from companion.traffic.senders.source import Source, Sources
from companion.traffic.track import ESTABLISHED, Track

ADDRESSES_PER_TRACK = 4
TRACKS_PER_IDENTITY = 16
"""Most tracks of one identity."""
_RANKED_S, _RANKED_AT_ONCE = 0.2, 512
"""While the table is at least half full, all tracks are ranked this often, at most this many at a time.
Otherwise a track is ranked with some of its messages."""


@dataclass(frozen=True, slots=True)
class Newcomer:
    """What is known of an aircraft before its track is built, because a flood brings many that find no
    room."""

    track_id: str
    sample_s: float
    sound: str
    together: bool
    allowance: int
    standing: Standing
    threat: bool


class Table:
    """At most `most` tracks, by id and by identity.

    Args:
        forget: called with the id of each track that is removed.
    """

    def __init__(self, most: int, judgement: Judgement, forget: Callable[[str], None]) -> None:
        self.tracks: dict[str, Track] = {}
        self.most = most
        self.judgement = judgement
        self.by_identity: dict[str, list[Track]] = {}
        self.ranking = Ranking()
        self.burst = Burst()
        self.groups: dict[str, int] = {}
        """Number of tracks by `Track.group`."""
        self.full = FullTable("Remote ID traffic", most)
        self.sources = Sources(ADDRESSES_PER_TRACK * most)
        self._forget = forget
        self._ranked_s = -math.inf
        self._turns: Iterator[str] = iter(())
        """Tracks that are still to be ranked in this round."""

    def note_own(self, now_s: float, position: Vec3, velocity: Vec3) -> None:
        """Take in the own state (local NED), by which tracks are ranked."""
        self.judgement.position, self.judgement.velocity = position, velocity
        if 2 * len(self.tracks) >= self.most and now_s >= self._ranked_s + _RANKED_S:
            self._ranked_s = now_s
            self._rank_all(now_s)

    def add(self, track: Track, now_s: float, judged: Newcomer | None = None) -> None:
        """Add a track for which there is room.

        Args:
            judged: its standing, if it is known.
        """
        self.tracks[track.track_id] = track
        self.by_identity.setdefault(track.identity, []).append(track)
        for key in track.sources:
            self.sources.feed(key)
        self.groups[track.group] = self.groups.get(track.group, 0) + 1
        if judged is None:
            self.rank(track, now_s)
            return
        if judged.threat:
            track.threat_s = now_s
        self.ranking.place(track.track_id, judged.standing)

    def remove(self, track: Track) -> None:
        """Remove a track that is held."""
        del self.tracks[track.track_id]
        self.ranking.remove(track.track_id)
        self._forget(track.track_id)
        for key in track.sources:
            self.sources.release(key)
        self.groups[track.group] -= 1
        if not self.groups[track.group]:
            del self.groups[track.group]
        twins = self.by_identity[track.identity]
        twins.remove(track)
        if not twins:
            del self.by_identity[track.identity]
        elif track.hypothesis and len(twins) == 1:
            # The removed track was never confirmed, so the other one counts as alone again.
            twins[0].beside_s = -math.inf

    def feed(self, track: Track, key: str) -> None:
        """Note that an address feeds a track that is held; of more than four, the first is forgotten."""
        if len(track.sources) == ADDRESSES_PER_TRACK:
            self.sources.release(track.sources[0])
        track.sources.append(key)
        self.sources.feed(key)

    def rank(self, track: Track, now_s: float) -> None:
        """Update a track's standing in the ranking."""
        age_s = max(0.0, now_s - track.sample_s)
        growth_mps = max(track.past.growth_mps, track.past.growth_down_mps)
        growth_m = growth_mps * (age_s + GROWTH_AHEAD_S) + track.wander.error_m
        motion = Motion(
            track.position_ned_m,
            track.velocity_ned_mps,
            age_s,
            margin_m(track.sigma_m, track.sigma_mps, age_s, growth_m),
            track.vertical_known,
        )
        was_threat = now_s - track.threat_s <= HOLD_S
        standing, threat = self.judgement.standing(
            motion, track.trust, track.together, track.allowance, was_threat
        )
        if threat:
            track.threat_s = now_s
        self.ranking.place(track.track_id, standing)

    def _rank_all(self, now_s: float) -> None:
        turn = list(islice(self._turns, _RANKED_AT_ONCE))
        if len(turn) < _RANKED_AT_ONCE:
            self._turns = iter(tuple(self.tracks))
            turn += islice(self._turns, _RANKED_AT_ONCE - len(turn))
        for track_id in turn:
            track = self.tracks.get(track_id)
            if track is not None:
                self.rank(track, now_s)

    def newcomer(self, track_id: str, source: Source, fix: Fix, now_s: float) -> Newcomer:
        """Judge an aircraft that has no track yet."""
        sample_s = now_s if fix.stamp_s is None else min(fix.stamp_s, now_s)
        age_s, latest = now_s - sample_s, source.latest
        margin = margin_m(fix.sigma_m, fix.sigma_mps, age_s, 0.0)
        velocity = fix.velocity or (0.0, 0.0, 0.0)
        motion = Motion(fix.position, velocity, age_s, margin, fix.vertical_known)
        sound = sound_of(latest.transport, latest.address, latest.rssi_dbm)
        together, allowance = self.burst.note(now_s), allowance_of(sound)
        standing, threat = self.judgement.standing(motion, Trust.FRESH, together, allowance, False)
        return Newcomer(track_id, sample_s, sound, together, allowance, standing, threat)

    def make_room(self, newcomer: Newcomer, others: Sequence[Track], now_s: float) -> tuple[bool, bool]:
        """Remove a track if there would be too many, all in all or of the newcomer's identity.

        Args:
            others: the tracks of its identity.

        Returns:
            Whether there is room for the newcomer, and whether a track was removed for it.
        """
        ranking = self.ranking
        if len(others) >= TRACKS_PER_IDENTITY:
            victim = max(others, key=self._dispensable)
            if newcomer.standing.tier < ranking.standing(victim.track_id).tier:
                return False, False
        elif len(self.tracks) >= self.most:
            ranking.place(newcomer.track_id, newcomer.standing)
            first = ranking.first()
            self.full.note(now_s, ranking.standing(first).threat)
            if first == newcomer.track_id:
                ranking.remove(first)
                return False, False
            victim = self.tracks[first]
        else:
            return True, False
        self.remove(victim)
        return True, True

    def _dispensable(self, track: Track) -> tuple[int, bool, float, Value]:
        """Sort key of the tracks of one identity; the track with the greatest key is removed.

        That is the fresh track that has been silent longest or, if all are established, the least in the
        ranking; threats last. Among established tracks silence does not count, because a copied identity that
        jumps about is heard more often than its owner.
        """
        standing = self.ranking.standing(track.track_id)
        fresh = track.messages < ESTABLISHED
        return -standing.tier, fresh, -track.received_s if fresh else 0.0, standing.value
