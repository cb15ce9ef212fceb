"""Tracks of other aircraft, built from received Remote ID messages (the paper's "orient", its Section 2).

Received data is untrusted, and in doubt an aircraft is tracked: data that cannot be from one aircraft become
two tracks, and no message is dropped because of a clock. A track holds the last position and velocity at the
time of the message; the law predicts them over the delay. The number of tracks, of tracks of one identity and
of addresses is bounded, and no message causes a search through all of them.

Age: a sender whose clock leads ours shows a negative age. The lead is estimated from its last few messages
(one wrong timestamp has no effect) and subtracted from its timestamps. A clock that lags cannot be
distinguished from a delay, so the age reads too long. A timestamp that is off by more than
`max_clock_offset_s` either way is not trusted: the message is then dated by its reception, and used only if
its content is new.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from companion.avoidance.kernels import silent_after
from companion.avoidance.law import Neighbour
from companion.config import TrafficConfig
from companion.events import RemoteIdHeard, TrackFlagged
from companion.geometry import LocalFrame, Vec3
from companion.remote_id.authentication import Assembler, Verifier
from companion.remote_id.messages import Authentication, BasicId, IdType, Location, UaType
from companion.traffic.doubts import Judge
from companion.traffic.eviction import Ranking
from companion.traffic.fix import Fix, make_fix
from companion.traffic.own_flight import OwnFlight
from companion.traffic.plausibility import Flag, MotionWindow, status_doubts
from companion.traffic.reception import Reception
from companion.traffic.right_of_way import rank_of, share_of
from companion.traffic.sender_details import About, Source, Sources
from companion.traffic.track import ESTABLISHED, Track, from_positions, lead, near, off, reach, same

_MAX_RANGE_M = 50_000.0
"""Positions farther from us than this are implausible: Remote ID does not reach that far, and the local frame
is too inaccurate there."""
_ADDRESSES_PER_TRACK = 4
_TRACKS_PER_IDENTITY = 16
"""Most tracks of one identity. Among this many forged copies a second, the owner of the identity still
becomes established with one message a second."""
_LEADS = 5
_JOINED_WITHIN_M = 15.0
"""Two tracks are merged only if they are this near to each other. An aircraft's positions on two transports
come from one GNSS receiver. With a larger distance, a sender with a copied identity could remove another's
track."""
_TWIN_MEMORY_S = 60.0
"""For this long after another track of the same identity was there, a track is matched only to messages near
it; others may still be from the other aircraft."""
_RANKED_EVERY = 8
"""A track is ranked for eviction every so many messages; its distance changes little in between."""


@dataclass(slots=True)
class TrafficCounts:
    """Number of received Location messages by outcome."""

    updates: int = 0
    no_position: int = 0
    old: int = 0
    """The message was not newer than the track."""
    implausible: int = 0
    """The reported speed or position is impossible."""
    split: int = 0
    """The message opened another track of a known identity, because one aircraft cannot be at both places."""
    clock: int = 0
    """The timestamp was unknown or too far from ours, so the time of reception was used."""
    own_echo: int = 0
    refused_full: int = 0
    evicted: int = 0


class Traffic:
    """The table of all tracks from Remote ID.

    Raises:
        ConfigError: an entry of `config.keys` is not a valid public key.
    """

    def __init__(self, config: TrafficConfig, own_uas_id: str, own_type: UaType | None = None) -> None:
        self.config = config
        self._own_rank = rank_of(own_type, None)
        self.own_uas_id = own_uas_id
        self.own_addresses: tuple[str, ...] = ()
        """Radio addresses of our own frames, which a second own receiver may hear."""
        self.counts = TrafficCounts()
        self.tracks: dict[str, Track] = {}
        self._by_identity: dict[str, list[Track]] = {}
        self._ranking = Ranking()
        self._sources = Sources(_ADDRESSES_PER_TRACK * config.max_tracks)
        self._assembler = Assembler()
        self._judge = Judge(own_uas_id, self.tracks, Verifier(config.keys) if config.keys else None)
        self._split_number = 1
        """Number of the last split track. It only increases, so that no track id is tried twice."""
        self._own = OwnFlight()

    def note_own(self, now_s: float, position: Vec3, velocity: Vec3) -> None:
        """Store the own state (local NED), to recognise echoes of own messages and to rank tracks."""
        self._own.note(now_s, position, velocity)

    def hear(
        self,
        heard: RemoteIdHeard,
        now_s: float,
        utc_offset_s: float | None,
        frame: LocalFrame,
        separation_m: float | None,
    ) -> None:
        """Process one received frame.

        Args:
            utc_offset_s: our UTC minus `now_s`; None while unknown.
            frame: local frame (its altitude datum is mean sea level).
            separation_m: height of the geoid above the ellipsoid here; None while unknown.
        """
        source = self._sources.at(heard.transport, heard.address)
        source.about.rssi_dbm = heard.rssi_dbm
        locations = []
        signature = None
        for message in heard.messages:
            if type(message) is Location:
                locations.append(message)
            elif type(message) is BasicId:
                self._learn_name(source, message)
            elif type(message) is Authentication:
                signature = self._assembler.add_page(source.key, message, now_s) or signature
            else:
                source.about.keep(message)
        if locations:
            source.reception.count_frame(heard.counter, now_s)
        genuine = None
        if signature is not None:
            source.about.authentication = signature
            genuine = self._judge.check(source, signature, heard, now_s, utc_offset_s)
        for message in locations:
            fix = make_fix(message, now_s, utc_offset_s, frame, separation_m, self.config.max_clock_offset_s)
            if fix is None or self._is_implausible(fix):
                self._doubt_place(source, message, fix)
                continue
            self.counts.clock += fix.stamp_s is None
            track = self._take(source, fix, now_s)
            if track is not None:
                self._judge.signer(track, source, genuine, now_s, utc_offset_s is not None)
        if genuine is not None:
            for track in self._of(source):
                self._judge.signature(track, genuine)

    def flagged(self, now_s: float) -> list[TrackFlagged]:
        """Flags that were raised or cleared and are to be logged now; the rate of reports is limited."""
        return self._judge.reports.due(now_s)

    def clear(self) -> None:
        """Remove all tracks, because the local frame of their positions is no longer valid."""
        for track in list(self.tracks.values()):
            self._remove(track)
        self._own.clear()

    def expire(self, now_s: float) -> None:
        """Remove tracks older than `expire_after_s`."""
        limit = self.config.expire_after_s
        for track in [t for t in self.tracks.values() if now_s - t.sample_s > limit]:
            self._remove(track)

    def neighbours(self, now_s: float) -> list[Neighbour]:
        """Every track, as input of the law."""
        return [
            Neighbour(
                t.track_id,
                t.position_ned_m,
                t.velocity_ned_mps,
                max(0.0, now_s - t.sample_s),
                t.sigma_m,
                t.sigma_mps,
                t.past.growth_mps,
                now_s - t.received_s > silent_after(t.past.gap_s),
                share_of(self._own_rank, _rank(t)),
                t.vertical_known,
                proven=t.proven,
            )
            for t in self.tracks.values()
        ]

    def receptions(self, track: Track) -> list[tuple[str, Reception]]:
        """Transport and reception statistics of each radio address of a track."""
        held = (self._sources.held(key) for key in track.sources)
        return [(s.about.transport, s.reception) for s in held if s is not None]

    # ------------------------------------------------------------ the table

    def _add(self, track: Track) -> None:
        self.tracks[track.track_id] = track
        self._by_identity.setdefault(track.identity, []).append(track)
        self._rank(track)

    def _remove(self, track: Track) -> None:
        del self.tracks[track.track_id]
        self._ranking.remove(track.track_id)
        self._judge.reports.forget(track.track_id)
        twins = self._by_identity[track.identity]
        twins.remove(track)
        if not twins:
            del self._by_identity[track.identity]

    def _rank(self, track: Track) -> None:
        fresh = track.messages < ESTABLISHED
        self._ranking.place(track.track_id, fresh, math.dist(track.position_ned_m, self._own.position))

    def _of(self, source: Source) -> list[Track]:
        """Tracks that this address feeds."""
        twins = self._by_identity.get(source.identity or source.key, ())
        return [t for t in twins if source.key in t.sources]

    # ------------------------------------------------------------ names

    def _learn_name(self, source: Source, message: BasicId) -> None:
        if message.id_type is IdType.NONE or not message.uas_id:
            return
        if source.identity is None:
            source.identity = message.uas_id
            self._rename(source.key, message.uas_id)
        source.about.keep_id(message, source.identity)

    def _rename(self, old: str, identity: str) -> None:
        """Give the tracks of an address their identity once it is known, up to `_TRACKS_PER_IDENTITY`.

        On BLE 4 an aircraft's Locations may arrive before its Basic ID. If another transport already
        delivered the same aircraft with its identity, both tracks are merged, so that no ghost track remains.
        """
        for track in list(self._by_identity.get(old, ())):
            others = [t for t in self._by_identity.get(identity, ()) if t is not track]
            known = self._same_aircraft(track, others)
            if known is not None and not track.doubts.flags:
                self._remove(track)
                known.take_over(track)
                self._rank(known)
                continue
            if len(self._by_identity.get(identity, ())) >= _TRACKS_PER_IDENTITY:
                return
            self._remove(track)
            track.identity = identity
            if track.track_id == old and identity not in self.tracks:
                track.track_id = identity
            self._add(track)
            if track.doubts.flags != track.doubts.reported:
                self._judge.reports.mark(track.track_id, track.doubts)

    def _same_aircraft(self, track: Track, others: Iterable[Track]) -> Track | None:
        """The track among `others` that is the same aircraft as `track`; the nearest if there are several.

        This is stricter than `_match`, because a merge gives up one of two positions.
        """
        best, least = None, _JOINED_WITHIN_M
        for other in others:
            earlier, later = sorted((track, other), key=lambda t: t.sample_s)
            elapsed = later.sample_s - earlier.sample_s
            moved = [
                p + elapsed * v for p, v in zip(earlier.position_ned_m, earlier.velocity_ned_mps, strict=True)
            ]
            away = math.dist(moved[:2], later.position_ned_m[:2])
            if away < least:
                best, least = other, away
        return best

    # ------------------------------------------------------------ one Location

    def _is_implausible(self, fix: Fix) -> bool:
        (north, east, _), (own_north, own_east, _) = fix.position, self._own.position
        if math.hypot(north - own_north, east - own_east) > _MAX_RANGE_M:
            return True
        return fix.velocity is not None and math.hypot(*fix.velocity) > self.config.max_speed_mps

    def _doubt_place(self, source: Source, message: Location, fix: Fix | None) -> None:
        """Count a Location that updates no track as evidence about the tracks of its address."""
        bad = status_doubts(message)
        if fix is None:
            self.counts.no_position += 1
        else:
            self.counts.implausible += 1
            bad.append(Flag.IMPOSSIBLE_VALUES)
        for track in self._of(source):
            self._judge.note(track, bad)

    def _take(self, source: Source, fix: Fix, now_s: float) -> Track | None:
        """Use a fix; returns the track that it updated or opened, if any."""
        identity = source.identity or source.key
        known = self._by_identity.get(identity, [])
        track, away = self._match(known, source, fix, now_s)
        ours = identity == self.own_uas_id or source.about.address in self.own_addresses
        if ours and self._own.distance_m(fix, now_s) < away:
            self.counts.own_echo += 1
            return None
        if track is None:
            return self._open(identity, known, source, fix, now_s)
        track.fed_by[source.about.transport] = source.key
        if source.key not in track.sources:
            # Also if the content is not new: on two transports the same message arrives twice.
            track.sources.append(source.key)
        if same(track.content, fix.content):
            # A repeated advertisement without new content tells nothing about the present, nor about clocks.
            self.counts.old += 1
            return None
        sample_s = now_s
        if fix.stamp_s is not None:
            track.leads_s.append(fix.stamp_s - now_s)
            sample_s = min(fix.stamp_s - lead(track.leads_s), now_s)
        if sample_s <= track.sample_s:
            self.counts.old += 1
            return None
        self._judge.message(track, known, fix, sample_s, now_s)
        velocity, velocity_known = fix.velocity, True
        if velocity is None:
            velocity, velocity_known = from_positions(track, fix, sample_s)
        track.position_ned_m, track.velocity_ned_mps = fix.position, velocity
        track.velocity_known = velocity_known
        track.sample_s, track.received_s = sample_s, now_s
        track.sigma_m, track.sigma_mps, track.content = fix.sigma_m, fix.sigma_mps, fix.content
        track.vertical_known = fix.vertical_known
        track.remember(fix)
        track.messages += 1
        track.about.update(source.about)
        if track.messages == ESTABLISHED or track.messages % _RANKED_EVERY == 0:
            self._rank(track)
        self.counts.updates += 1
        return track

    def _match(
        self, known: list[Track], source: Source, fix: Fix, now_s: float
    ) -> tuple[Track | None, float]:
        """The track of this identity whose aircraft can have flown to the fix, and its distance from it (m).

        Tracks that the same address fed last come first, then the nearest. Without such a track, the result
        is None and infinity.

        After some silence one aircraft can be nearly anywhere. If two aircraft use the identity, or the
        address is new to the track, the fix must be near the track; otherwise one track would jump between
        two aircraft, and one of them would be lost. An aircraft that changes its address does not return to
        the old one. So if two addresses take turns on a transport, each gets its own track; otherwise one
        sender could pull the track away from the other.
        """
        at = now_s if fix.stamp_s is None else min(fix.stamp_s, now_s)
        best, least = None, (True, math.inf)
        for track in known:
            elapsed, noise = abs(at - track.sample_s), fix.sigma_m + track.sigma_m
            away, allowed = off(track, fix, at), reach(elapsed, noise)
            if len(known) > 1:
                track.beside_s = now_s
            twins = now_s - track.beside_s <= _TWIN_MEMORY_S
            others = track.fed_by.get(source.about.transport) != source.key
            if others and source.key in track.sources:
                continue
            if not track.velocity_known:
                allowed += self.config.max_speed_mps * elapsed
            elif twins or others:
                allowed = near(noise)
            if away <= allowed and (others, away) < least:
                best, least = track, (others, away)
        return best, least[1]

    def _open(
        self, identity: str, known: list[Track], source: Source, fix: Fix, now_s: float
    ) -> Track | None:
        if len(known) >= _TRACKS_PER_IDENTITY:
            known = list(known)
            self._remove(max(known, key=self._dispensable))
            self.counts.evicted += 1
        elif len(self.tracks) >= self.config.max_tracks and not self._make_room(fix):
            self.counts.refused_full += 1
            return None
        track_id = identity
        while track_id in self.tracks:
            self._split_number += 1
            track_id = f"{identity}#{self._split_number}"
        self.counts.split += bool(known)
        first_lead_s = 0.0 if fix.stamp_s is None else fix.stamp_s - now_s
        track = Track(
            track_id=track_id,
            identity=identity,
            position_ned_m=fix.position,
            velocity_ned_mps=fix.velocity or (0.0, 0.0, 0.0),
            velocity_known=fix.velocity is not None,
            sample_s=now_s if fix.stamp_s is None else min(fix.stamp_s, now_s),
            received_s=now_s,
            sigma_m=fix.sigma_m,
            sigma_mps=fix.sigma_mps,
            vertical_known=fix.vertical_known,
            content=fix.content,
            leads_s=deque([first_lead_s], maxlen=_LEADS),
            about=About(source.about.transport, source.about.address),
            sources=deque([source.key], maxlen=_ADDRESSES_PER_TRACK),
            fed_by={source.about.transport: source.key},
            motion=MotionWindow(fix, now_s),
            opened_s=now_s,
        )
        track.about.update(source.about)
        track.remember(fix)
        self._add(track)
        self._judge.first_message(track, known, source, fix, now_s)
        self.counts.updates += 1
        return track

    def _dispensable(self, track: Track) -> tuple[bool, float]:
        """Sort key of the tracks of one identity; the track with the greatest key is removed.

        That is the fresh track that has been silent longest or, if all are established, the farthest. Among
        established tracks silence does not count, because a copied identity that jumps about is heard more
        often than its owner.
        """
        if track.messages < ESTABLISHED:
            return True, -track.received_s
        return False, math.dist(track.position_ned_m, self._own.position)

    def _make_room(self, fix: Fix) -> bool:
        """Remove one track for a new one: fresh tracks before established ones, the farthest first. False if
        the new one is farther away than that track."""
        own = self._own.position
        victim = self.tracks[self._ranking.first()]
        if math.dist(victim.position_ned_m, own) < math.dist(fix.position, own):
            return False
        self._remove(victim)
        self.counts.evicted += 1
        return True


def _rank(track: Track) -> int:
    told = track.about.basic_id
    return rank_of(None if told is None else told.ua_type, track.content.status)
