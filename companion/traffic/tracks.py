"""Tracks of other aircraft, built from heard Remote ID messages (the paper's "orient", its Section 2).

Heard data is untrusted, and every doubt is settled in favour of seeing an aircraft: what cannot be one
aircraft becomes two tracks, and a message is never dropped because of a clock. A track keeps the last
position and velocity at the message's own time; prediction over the delay is the law's. The number of tracks,
of tracks under one identity and of remembered addresses is bounded.

Age. The Location timestamp counts tenths of a second after the full UTC hour, so the moment of the message is
the one nearest to our own UTC among all hours. A sender whose clock leads ours shows a negative age: the lead
is estimated from its last few messages (one wrong timestamp does not count) and added back. A clock that lags
cannot be told from a delay; its age reads too long. Beyond `max_clock_offset_s` either way a timestamp is not
believed: the message then counts from its reception, and only when its content is new.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from companion.avoidance.law import Neighbour
from companion.config import TrafficConfig
from companion.events import RemoteIdHeard, Vec3
from companion.geometry import LocalFrame
from companion.remote_id.messages import BasicId, IdType, Location

SIGMA_UNKNOWN_M = 5.0
"""Horizontal standard deviation taken for a sender that declares no accuracy."""
SIGMA_MOST_M = 15.0
"""A declared accuracy counts up to this: a volume of kilometres would only make every velocity wrong."""
SIGMA_CLOCKLESS_M = 5.0
"""Added (in quadrature) for a message that is dated by its reception."""
VERTICAL_ACCURACY_M = 10.0
"""Worse than this, height does not separate."""
_MAX_RANGE_M = 50_000.0
"""Remote ID is not heard from farther away, and the local frame is too coarse for it."""
_ADDRESSES_PER_TRACK = 4
_TRACKS_PER_IDENTITY = 4
_LEADS = 5
_ESTABLISHED = 3
"""Messages after which a track is not pushed out by a newcomer's first."""
_ECHO_M = 15.0
_OWN_SPACING_S = 0.25
_OWN_SAMPLES = 100


@dataclass(slots=True)
class TrafficCounts:
    """What became of heard Location messages."""

    updates: int = 0
    no_position: int = 0
    old: int = 0
    """Not newer than what the track holds."""
    implausible: int = 0
    """A speed or place that cannot be."""
    split: int = 0
    """Tracks opened beside another of the same identity, because one aircraft could not be at both places."""
    clock: int = 0
    """Timestamp unknown or too far from ours: time of reception taken instead."""
    own_echo: int = 0
    refused_full: int = 0
    evicted: int = 0


@dataclass(slots=True)
class Track:
    """One aircraft as last heard. Position and velocity: local NED at `sample_s` (our monotonic time)."""

    track_id: str
    identity: str
    """What it calls itself, or its radio address while it has not."""
    position_ned_m: Vec3
    velocity_ned_mps: Vec3
    velocity_known: bool
    sample_s: float
    received_s: float
    sigma_m: float
    vertical_known: bool
    content: Location
    leads_s: deque[float]
    """How far the sender's clock led ours at its last messages; negative: behind, or delayed."""
    messages: int = 1


@dataclass(slots=True)
class _Fix:
    """A Location turned into our frame and clock."""

    position: Vec3
    velocity: Vec3 | None
    sigma_m: float
    vertical_known: bool
    stamp_s: float | None
    """Our monotonic time of the message by the sender's clock; None when that cannot be believed."""
    content: Location


@dataclass(slots=True)
class Traffic:
    """All tracks."""

    config: TrafficConfig
    own_uas_id: str
    counts: TrafficCounts = field(default_factory=TrafficCounts)
    tracks: dict[str, Track] = field(default_factory=dict)
    _names: dict[str, str] = field(default_factory=dict)
    """Radio address -> identity from its Basic ID."""
    _own: deque[tuple[float, Vec3]] = field(default_factory=lambda: deque(maxlen=_OWN_SAMPLES))
    """Where we were."""

    def note_own(self, now_s: float, position: Vec3) -> None:
        """Remember the own position (local NED), to know an echo and to rank tracks."""
        if not self._own or now_s - self._own[-1][0] >= _OWN_SPACING_S:
            self._own.append((now_s, position))

    def hear(
        self,
        heard: RemoteIdHeard,
        now_s: float,
        utc_offset_s: float | None,
        frame: LocalFrame,
        separation_m: float | None,
    ) -> None:
        """Take in one heard frame.

        Args:
            utc_offset_s: our UTC minus `now_s`; None while unknown.
            frame: local frame (its altitude datum is mean sea level).
            separation_m: height of the geoid above the ellipsoid here; None while unknown.
        """
        source = f"{heard.transport}/{heard.address}"
        for message in heard.messages:
            if isinstance(message, BasicId):
                self._learn_name(source, message)
        for message in heard.messages:
            if isinstance(message, Location):
                fix = self._fix(message, now_s, utc_offset_s, frame, separation_m)
                if fix is not None:
                    self._take(self._names.get(source, source), fix, now_s)

    def clear(self) -> None:
        """Forget all places: the frame they were given in is no more."""
        self.tracks.clear()
        self._own.clear()

    def expire(self, now_s: float) -> None:
        """Forget what is older than `expire_after_s`."""
        limit = self.config.expire_after_s
        for track_id in [k for k, t in self.tracks.items() if now_s - t.sample_s > limit]:
            del self.tracks[track_id]

    def neighbours(self, now_s: float) -> list[Neighbour]:
        """Every live track, as the law takes it."""
        return [
            Neighbour(
                t.track_id,
                t.position_ned_m,
                t.velocity_ned_mps,
                max(0.0, now_s - t.sample_s),
                t.sigma_m,
                t.vertical_known,
            )
            for t in self.tracks.values()
        ]

    # ------------------------------------------------------------ names

    def _learn_name(self, source: str, message: BasicId) -> None:
        if message.id_type is IdType.NONE or not message.uas_id:
            return
        known = self._names.pop(source, None)
        # A second Basic ID (registration beside serial) must not rename the track back and forth.
        self._names[source] = known or message.uas_id
        if len(self._names) > _ADDRESSES_PER_TRACK * self.config.max_tracks:
            del self._names[next(iter(self._names))]
        if known is None:
            for nameless in [t for t in self.tracks.values() if t.identity == source]:
                nameless.identity = message.uas_id
                if nameless.track_id == source and message.uas_id not in self.tracks:
                    del self.tracks[source]
                    nameless.track_id = message.uas_id
                    self.tracks[message.uas_id] = nameless

    # ------------------------------------------------------------ one Location

    def _fix(
        self,
        message: Location,
        now_s: float,
        utc_offset_s: float | None,
        frame: LocalFrame,
        separation_m: float | None,
    ) -> _Fix | None:
        if message.lat_deg is None or message.lon_deg is None:
            self.counts.no_position += 1
            return None
        vertical_known = message.alt_geodetic_m is not None and separation_m is not None
        if message.vertical_accuracy_m is not None and message.vertical_accuracy_m > VERTICAL_ACCURACY_M:
            vertical_known = False
        alt_msl_m = frame.alt_m
        if message.alt_geodetic_m is not None and separation_m is not None:
            alt_msl_m = message.alt_geodetic_m - separation_m
        position = frame.to_ned(message.lat_deg, message.lon_deg, alt_msl_m)
        velocity = _velocity(message)
        speed = math.hypot(*velocity) if velocity is not None else 0.0
        own = self._own[-1][1] if self._own else (0.0, 0.0, 0.0)
        if math.dist(position[:2], own[:2]) > _MAX_RANGE_M or speed > self.config.max_speed_mps:
            self.counts.implausible += 1
            return None
        # Senders put their receiver's own figure here, which is nearer to one sigma than to the 95 % bound.
        accuracy = message.horizontal_accuracy_m
        sigma = SIGMA_UNKNOWN_M if accuracy is None else min(accuracy, SIGMA_MOST_M)
        stamp = self._stamp(message, now_s, utc_offset_s)
        if stamp is None:
            self.counts.clock += 1
            sigma = math.hypot(sigma, SIGMA_CLOCKLESS_M)
        return _Fix(position, velocity, sigma, vertical_known, stamp, message)

    def _stamp(self, message: Location, now_s: float, utc_offset_s: float | None) -> float | None:
        if message.timestamp_s is None or utc_offset_s is None:
            return None
        utc_now = now_s + utc_offset_s
        hours = round((utc_now - message.timestamp_s) / 3600.0)
        stamp_s = message.timestamp_s + 3600.0 * hours - utc_offset_s
        return stamp_s if abs(now_s - stamp_s) <= self.config.max_clock_offset_s else None

    def _take(self, identity: str, fix: _Fix, now_s: float) -> None:
        if identity == self.own_uas_id and self._is_echo(fix, now_s):
            self.counts.own_echo += 1
            return
        known = [t for t in self.tracks.values() if t.identity == identity]
        track = self._match(known, fix, now_s)
        if track is None:
            self._open(identity, known, fix, now_s)
            return
        if _same(track.content, fix.content):
            # An advertisement that goes on without news says nothing about now, nor about clocks.
            self.counts.old += 1
            return
        sample_s = now_s
        if fix.stamp_s is not None:
            track.leads_s.append(fix.stamp_s - now_s)
            sample_s = min(fix.stamp_s - _lead(track.leads_s), now_s)
        if sample_s <= track.sample_s:
            self.counts.old += 1
            return
        velocity, velocity_known = fix.velocity, True
        if velocity is None:
            velocity, velocity_known = _from_positions(track, fix, sample_s)
        track.position_ned_m, track.velocity_ned_mps = fix.position, velocity
        track.velocity_known = velocity_known
        track.sample_s, track.received_s = sample_s, now_s
        track.sigma_m, track.vertical_known, track.content = fix.sigma_m, fix.vertical_known, fix.content
        track.messages += 1
        self.counts.updates += 1

    def _is_echo(self, fix: _Fix, now_s: float) -> bool:
        """Own identity where we were: our own broadcast come back, or a second transmitter of ours."""
        if not self._own:
            return False
        at = now_s if fix.stamp_s is None else fix.stamp_s
        _, place = min(self._own, key=lambda sample: abs(sample[0] - at))
        return math.hypot(place[0] - fix.position[0], place[1] - fix.position[1]) <= _ECHO_M

    def _match(self, known: list[Track], fix: _Fix, now_s: float) -> Track | None:
        """The track of this identity whose aircraft can have flown to the fix; the nearest of several."""
        at = now_s if fix.stamp_s is None else min(fix.stamp_s, now_s)
        best, least = None, math.inf
        for track in known:
            elapsed = abs(at - track.sample_s)
            p, v = track.position_ned_m, track.velocity_ned_mps
            along = at - track.sample_s
            off = math.hypot(p[0] + along * v[0] - fix.position[0], p[1] + along * v[1] - fix.position[1])
            allowed = 20.0 + 4.0 * (fix.sigma_m + track.sigma_m) + 8.0 * elapsed + 5.0 * elapsed * elapsed
            if not track.velocity_known:
                allowed += self.config.max_speed_mps * elapsed
            if off <= allowed and off < least:
                best, least = track, off
        return best

    def _open(self, identity: str, known: list[Track], fix: _Fix, now_s: float) -> None:
        if len(known) >= _TRACKS_PER_IDENTITY:
            stalest = min(known, key=lambda t: t.received_s)
            del self.tracks[stalest.track_id]
            self.counts.evicted += 1
        elif len(self.tracks) >= self.config.max_tracks and not self._make_room(fix):
            self.counts.refused_full += 1
            return
        track_id, number = identity, 2
        while track_id in self.tracks:
            track_id, number = f"{identity}#{number}", number + 1
        self.counts.split += bool(known)
        lead = 0.0 if fix.stamp_s is None else fix.stamp_s - now_s
        self.tracks[track_id] = Track(
            track_id=track_id,
            identity=identity,
            position_ned_m=fix.position,
            velocity_ned_mps=fix.velocity or (0.0, 0.0, 0.0),
            velocity_known=fix.velocity is not None,
            sample_s=now_s if fix.stamp_s is None else min(fix.stamp_s, now_s),
            received_s=now_s,
            sigma_m=fix.sigma_m,
            vertical_known=fix.vertical_known,
            content=fix.content,
            leads_s=deque([lead], maxlen=_LEADS),
        )
        self.counts.updates += 1

    def _make_room(self, fix: _Fix) -> bool:
        """Give up one track for a newcomer: a fresh one before an established one, the farthest first."""
        own = self._own[-1][1] if self._own else (0.0, 0.0, 0.0)

        def rank(track: Track) -> tuple[bool, float]:
            return track.messages < _ESTABLISHED, math.dist(track.position_ned_m, own)

        victim = max(self.tracks.values(), key=rank)
        if rank(victim) < (victim.messages < _ESTABLISHED, math.dist(fix.position, own)):
            return False
        del self.tracks[victim.track_id]
        self.counts.evicted += 1
        return True


def _lead(leads_s: deque[float]) -> float:
    """How far the sender's clock leads ours: the largest lead but one; one wrong timestamp is nothing."""
    ordered = sorted(leads_s)
    return max(0.0, ordered[-2] if len(ordered) > 1 else ordered[-1])


def _same(a: Location, b: Location) -> bool:
    return (a.timestamp_s, a.lat_deg, a.lon_deg) == (b.timestamp_s, b.lat_deg, b.lon_deg)


def _velocity(message: Location) -> Vec3 | None:
    """Velocity (local NED, m/s) that a Location declares; None when speed or direction is unknown."""
    down = -(message.vertical_speed_mps or 0.0)
    if message.speed_mps is None:
        return None
    if message.direction_deg is None:
        return (0.0, 0.0, down) if message.speed_mps == 0.0 else None
    course = math.radians(message.direction_deg)
    return message.speed_mps * math.cos(course), message.speed_mps * math.sin(course), down


def _from_positions(track: Track, fix: _Fix, sample_s: float) -> tuple[Vec3, bool]:
    """Velocity from two positions, for a sender that declares none."""
    elapsed = sample_s - track.sample_s
    if elapsed < 0.5:
        return track.velocity_ned_mps, track.velocity_known
    a, b = track.position_ned_m, fix.position
    return ((b[0] - a[0]) / elapsed, (b[1] - a[1]) / elapsed, (b[2] - a[2]) / elapsed), True
