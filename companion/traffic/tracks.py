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
from collections.abc import Sequence
from dataclasses import dataclass

from companion.avoidance import kernels
from companion.avoidance.law import Neighbour
from companion.config import AvoidanceConfig, TrafficConfig
from companion.events import RemoteIdHeard, Say, TrackFlagged
from companion.geometry import LocalFrame, Vec3
from companion.remote_id.authentication import SPECIFIC_METHOD, Assembler, AuthenticationData
from companion.remote_id.drip.trust import Trust
from companion.remote_id.messages import Authentication, BasicId, IdType, Location, UaType
from companion.traffic.doubts import Judge
from companion.traffic.eviction import Judgement
from companion.traffic.fix import Belief, Fix, make_fix
from companion.traffic.flood.choice import chosen
from companion.traffic.latest_messages import LatestMessages
from companion.traffic.matching import match, same_aircraft
from companion.traffic.own_flight import OwnFlight
from companion.traffic.places import neighbours_of
from companion.traffic.plausibility import UNTRUSTED, Flag, MotionWindow, Reports, status_doubts
from companion.traffic.right_of_way import rank_of
from companion.traffic.senders.reception import Reception
from companion.traffic.senders.source import Source
from companion.traffic.signatures import Signatures
from companion.traffic.table import ADDRESSES_PER_TRACK, TRACKS_PER_IDENTITY, Newcomer, Table
from companion.traffic.track import ESTABLISHED, Track, from_positions, lead, same

_MAX_RANGE_M = 50_000.0
"""Positions farther from us than this are implausible: Remote ID does not reach that far, and the local frame
is too inaccurate there."""
_LEADS = 5
_RANKED_EVERY = 8
"""A track is ranked for eviction once in this many messages; its standing changes little in between."""


@dataclass(slots=True)
class TrafficCounts:
    """Number of received Location messages by outcome."""

    updates: int = 0
    no_position: int = 0
    old: int = 0
    """The message was not newer than the track."""
    implausible: int = 0
    """The reported position is impossible, and the message dropped; or the speed is, and only the position
    used."""
    split: int = 0
    """The message opened another track of a known identity, because one aircraft cannot be at both places."""
    clock: int = 0
    """The timestamp was unknown or too far from ours, so the time of reception was used."""
    own_echo: int = 0
    refused_full: int = 0
    evicted: int = 0
    crowded: int = 0
    """Frames (not only Locations) that a crowded step left out."""


class Traffic:
    """The table of all tracks from Remote ID.

    Args:
        avoidance: configuration of the law, which says what a threat is.

    Raises:
        ConfigError: an entry of `config.keys` or `config.anchors` is not a valid public key.
    """

    def __init__(
        self,
        config: TrafficConfig,
        own_uas_id: str,
        own_type: UaType | None = None,
        avoidance: AvoidanceConfig | None = None,
    ) -> None:
        self.config = config
        self._own_rank = rank_of(own_type, None)
        self.own_uas_id = own_uas_id
        self.own_addresses: tuple[str, ...] = ()
        """Radio addresses of our own frames, which a second own receiver may hear."""
        self.counts = TrafficCounts()
        self._assembler = Assembler()
        reports = Reports()
        self.judgement = Judgement(avoidance or AvoidanceConfig())
        self._table = Table(config.max_tracks, self.judgement, reports.forget)
        self.tracks = self._table.tracks
        trust = Trust(config.keys, config.anchors)
        self.signatures = Signatures(trust) if trust else None
        """Verifies signatures; None if neither keys nor anchors are configured."""
        self._judge = Judge(own_uas_id, self.tracks, self.signatures, reports)
        self._split_number = 1
        """Number of the last split track. It only increases, so that no track id is tried twice."""
        self._own = OwnFlight()

    def note_own(self, now_s: float, position: Vec3, velocity: Vec3) -> None:
        """Store the own state (local NED), to recognise echoes of own messages and to rank tracks."""
        self._own.note(now_s, position, velocity)
        self._table.note_own(now_s, position, velocity)

    def hear_all(
        self,
        frames: Sequence[RemoteIdHeard],
        now_s: float,
        utc_offset_s: float | None,
        frame: LocalFrame,
        separation_m: float | None,
    ) -> None:
        """Process the frames of one step, or of a flood those that matter (`flood.choice`).

        Arguments are those of `hear`.
        """
        used = chosen(
            frames,
            now_s,
            held=self._table.sources.of,
            tracks_of=self._of,
            judgement=self.judgement,
            frame=frame,
            separation_m=separation_m,
        )
        self.counts.crowded += len(frames) - len(used)
        for heard in used:
            self.hear(heard, now_s, utc_offset_s, frame, separation_m)

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
        source = self._table.sources.at(heard.transport, heard.address)
        source.latest.rssi_dbm = heard.rssi_dbm
        locations = []
        # Authentication that this frame completes, and whether it ends a set of which pages are missing.
        whole, torn = None, False
        for message in heard.messages:
            if type(message) is Location:
                locations.append(message)
            elif type(message) is BasicId:
                self._learn_name(source, message, now_s)
            elif type(message) is Authentication:
                whole = self._add_page(source, message, heard, now_s) or whole
                torn = torn or (self._assembler.gave_up and message.auth_type == SPECIFIC_METHOD)
            else:
                source.latest.keep(message)
        if locations:
            source.reception.count_frame(heard.counter, now_s)
        if whole is not None:
            source.latest.authentication = whole
        fed: list[Track] = []
        for message in locations:
            fix = make_fix(message, now_s, utc_offset_s, frame, separation_m, self.config.max_clock_offset_s)
            if fix is None or self._is_too_far(fix):
                self._doubt_place(source, message, fix)
                continue
            if fix.velocity is not None and math.hypot(*fix.velocity) > self.config.max_speed_mps:
                fix.velocity, fix.too_fast = None, True
                self.counts.implausible += 1
            source.placed = message
            source.redate(fix, now_s)
            self.counts.clock += fix.stamp_s is None
            source.fed.clear()
            track = self._take(source, fix, now_s)
            if track is not None:
                self._judge.signer(track, now_s, utc_offset_s is not None)
            if heard.rssi_dbm is not None:
                self._witness(source, heard.rssi_dbm, now_s)
            fed += source.fed
        if self.signatures is not None:
            if fed:
                self.signatures.heard(source, heard, fed)
            for ended in (None,) * torn + (() if whole is None else (whole,)):
                self._judge.proves(source, self._of(source), ended, heard, now_s, utc_offset_s)

    def _witness(self, source: Source, rssi_dbm: float, now_s: float) -> None:
        """Compare the power of a Location with the track that it fed, also if its content is not new."""
        for track in source.fed:
            if self.tracks.get(track.track_id) is track and track.note_signal(
                source.key, rssi_dbm, self._own.position, now_s
            ):
                self._judge.signal(track, track.signal.suspicion.log_ratio)

    def _add_page(
        self, source: Source, page: Authentication, heard: RemoteIdHeard, now_s: float
    ) -> AuthenticationData | None:
        counter = heard.counter if len(heard.messages) == 1 else 0  # the pages of one pack are of one set
        vouched = self.signatures is not None and self.signatures.is_vouched(source, now_s)
        return self._assembler.add_page(source.key, page, now_s, counter, vouched=vouched)

    def flagged(self, now_s: float) -> list[TrackFlagged | Say]:
        """Flags that were raised or cleared and are to be logged now, and the alert of a full table; the rate
        of both is limited."""
        return [*self._judge.reports.due(now_s), *self._table.full.due(now_s)]

    def clear(self) -> None:
        """Remove all tracks, because the local frame of their positions is no longer valid."""
        for track in list(self.tracks.values()):
            self._table.remove(track)
        self._own.clear()

    def expire(self, now_s: float) -> None:
        """Remove tracks older than `expire_after_s`, or than their gaps explain (`kernels.kept_for`)."""
        least = self.config.expire_after_s
        old = [t for t in self.tracks.values() if now_s - t.sample_s > least]
        for track in old:
            if now_s - track.sample_s > kernels.kept_for(track.past.gap_s, least):
                self._table.remove(track)

    def neighbours(self, now_s: float) -> list[Neighbour]:
        """Every track, and where else it was lately reported to be, as input of the law."""
        tracks, groups = self.tracks.values(), self._table.groups
        return neighbours_of(tracks, groups, self._own_rank, self._loss_s, now_s)

    def receptions(self, track: Track) -> list[tuple[str, Reception]]:
        """Transport and reception statistics of each radio address of a track."""
        held = (self._table.sources.held(key) for key in track.sources)
        return [(s.latest.transport, s.reception) for s in held if s is not None]

    def _loss_s(self, belief: Belief) -> float:
        return self.judgement.loss_s(belief.position, belief.velocity)

    def _of(self, source: Source) -> list[Track]:
        """Tracks that this address feeds."""
        names = (source.key,) if source.identity is None else (source.identity, source.key)
        return [t for name in names for t in self._table.by_identity.get(name, ()) if source.key in t.sources]

    # ------------------------------------------------------------ names

    def _learn_name(self, source: Source, message: BasicId, now_s: float) -> None:
        if message.id_type is IdType.NONE or not message.uas_id:
            return
        if source.identity is None:
            source.identity = message.uas_id
            self._rename(source.key, message.uas_id, now_s)
        if message.uas_id == self.own_uas_id and not source.ours:
            source.ours = True
            self._forget_echoes(source, now_s)
        source.latest.keep_id(message, source.identity)

    def _forget_echoes(self, source: Source, now_s: float) -> None:
        """Remove the tracks that our own transmitter opened before it named us (BLE 4)."""
        for track in self._of(source):
            alone = list(track.sources) == [source.key]
            if alone and self._own.distance_m(track.as_fix(), now_s) < math.inf:
                self.counts.own_echo += 1
                self._table.remove(track)

    def _rename(self, old: str, identity: str, now_s: float) -> None:
        """Give the tracks of an address their identity once it is known, up to `TRACKS_PER_IDENTITY`.

        On BLE 4 an aircraft's Locations may arrive before its Basic ID. If another transport already
        delivered the same aircraft with its identity, both tracks are merged, so that no ghost track remains.
        """
        for track in list(self._table.by_identity.get(old, ())):
            others = [t for t in self._table.by_identity.get(identity, ()) if t is not track]
            known = same_aircraft(track, others)
            if known is not None and not track.doubts.flags & UNTRUSTED:
                self._table.remove(track)
                for key in track.sources:
                    if key not in known.sources:
                        self._table.feed(known, key)
                known.take_over(track)
                self._table.rank(known, now_s)
                continue
            if len(self._table.by_identity.get(identity, ())) >= TRACKS_PER_IDENTITY:
                return
            self._table.remove(track)
            track.identity = identity
            if track.track_id == old and identity not in self.tracks:
                track.track_id = identity
            self._table.add(track, now_s)
            if track.doubts.flags != track.doubts.reported:
                self._judge.reports.mark(track.track_id, track.doubts)

    # ------------------------------------------------------------ one Location

    def _is_too_far(self, fix: Fix) -> bool:
        (north, east, _), (own_north, own_east, _) = fix.position, self._own.position
        return math.hypot(north - own_north, east - own_east) > _MAX_RANGE_M

    def _doubt_place(self, source: Source, message: Location, fix: Fix | None) -> None:
        """Count a Location that updates no track as evidence about the tracks of its address."""
        bad = status_doubts(message)
        if fix is None:
            self.counts.no_position += 1
        else:
            self.counts.implausible += 1
            bad.append(Flag.IMPOSSIBLE_VALUES)
        for track in self._of(source):
            track.unlocated = track.unlocated or (fix is None and _located_by(track, source))
            self._judge.note(track, bad)

    def _take(self, source: Source, fix: Fix, now_s: float) -> Track | None:
        """Use a fix; returns the track that it updated or opened, if any."""
        identity = source.identity or source.key
        known = self._table.by_identity.get(identity, [])
        if len(known) >= TRACKS_PER_IDENTITY and not any(source.key in t.sources for t in known):
            # Copies of an identity must not keep its aircraft out, so it is tracked by its address instead.
            known = self._table.by_identity.get(source.key, [])
            identity = source.key
        track, away = match(known, source, fix, now_s, self.config.max_speed_mps)
        ours = source.ours or source.latest.address in self.own_addresses
        if ours and self._own.distance_m(fix, now_s) < away:
            self.counts.own_echo += 1
            return None
        if track is None:
            return self._open(identity, known, source, fix, now_s)
        source.fed.append(track)
        track.fed_by[source.latest.transport] = source.key
        if source.key not in track.sources:
            # Also if the content is not new: on two transports the same message arrives twice.
            self._table.feed(track, source.key)
        elif not source.tracks:
            self._table.sources.feed(source.key)
        if same(track.content, fix.content):
            # A repeated advertisement without new content tells nothing about the present, nor about clocks.
            self.counts.old += 1
            return None
        return self._update(track, known, source, fix, now_s)

    def _update(
        self, track: Track, known: list[Track], source: Source, fix: Fix, now_s: float
    ) -> Track | None:
        """Update a track with a message of new content; None if the message is older than the track."""
        sample_s = now_s
        if fix.stamp_s is not None and track.note_lead(fix.stamp_s - now_s, now_s):
            sample_s = min(fix.stamp_s - lead(track.leads_s), now_s)
        track.note_miss(fix, sample_s, now_s)
        if sample_s <= track.sample_s:
            self.counts.old += 1
            track.believe(fix, now_s, self._loss_s, taken=False)
            return None
        self._judge.message(track, known, fix, sample_s, now_s)
        velocity, velocity_known = fix.velocity, True
        if velocity is None:
            velocity, velocity_known = from_positions(track, fix, sample_s)
        else:
            track.declared_s = sample_s
        track.position_ned_m, track.velocity_ned_mps = fix.position, velocity
        track.velocity_known = velocity_known
        track.sample_s, track.received_s = sample_s, now_s
        track.sigma_m, track.sigma_mps, track.content = fix.sigma_m, fix.sigma_mps, fix.content
        track.vertical_known, track.unlocated = fix.vertical_known, False
        track.remember(fix)
        track.believe(fix, now_s, self._loss_s)
        track.messages += 1
        track.hypothesis = track.hypothesis and track.messages < ESTABLISHED
        track.latest.update(source.latest)
        if track.messages == ESTABLISHED or track.messages % _RANKED_EVERY == 0:
            self._table.rank(track, now_s)
        self.counts.updates += 1
        return track

    def _open(
        self, identity: str, known: list[Track], source: Source, fix: Fix, now_s: float
    ) -> Track | None:
        others = list(known)
        track_id = identity
        while track_id in self.tracks:
            self._split_number += 1
            track_id = f"{identity}#{self._split_number}"
        newcomer = self._table.newcomer(track_id, source, fix, now_s)
        room, evicted = self._table.make_room(newcomer, others, now_s)
        if not room:
            self.counts.refused_full += 1
            return None
        track = _new_track(identity, newcomer, source, fix, now_s)
        track.believe(fix, now_s, self._loss_s)
        self._table.add(track, now_s, newcomer)
        source.fed.append(track)
        self.counts.evicted += evicted
        self.counts.split += bool(others)
        self._judge.first_message(track, known, source, fix, now_s)
        self.counts.updates += 1
        return track


def _located_by(track: Track, source: Source) -> bool:
    """Whether a track's position is from an address. Of two transmitters of an aircraft, the one without a
    position says nothing about where it is while the other one does."""
    latest = track.latest
    if (latest.transport, latest.address) == (source.latest.transport, source.latest.address):
        return True
    return source.placed is not None and same(source.placed, track.content)


def _new_track(identity: str, newcomer: Newcomer, source: Source, fix: Fix, now_s: float) -> Track:
    latest, key = source.latest, source.key
    first_lead_s = 0.0 if fix.stamp_s is None else fix.stamp_s - now_s
    track = Track(
        track_id=newcomer.track_id,
        identity=identity,
        position_ned_m=fix.position,
        velocity_ned_mps=fix.velocity or (0.0, 0.0, 0.0),
        velocity_known=fix.velocity is not None,
        sample_s=newcomer.sample_s,
        received_s=now_s,
        sigma_m=fix.sigma_m,
        sigma_mps=fix.sigma_mps,
        vertical_known=fix.vertical_known,
        content=fix.content,
        leads_s=deque([first_lead_s], maxlen=_LEADS),
        latest=LatestMessages(latest.transport, latest.address),
        sources=deque([key], maxlen=ADDRESSES_PER_TRACK),
        fed_by={latest.transport: key},
        motion=MotionWindow(fix, now_s),
        opened_s=now_s,
        group="together" if newcomer.together else newcomer.sound,
        allowance=newcomer.allowance,
        together=newcomer.together,
        base_lead_s=first_lead_s,
        clock_s=now_s,
        declared_s=None if fix.velocity is None else now_s,
    )
    track.latest.update(latest)
    track.remember(fix)
    return track
