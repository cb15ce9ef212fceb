"""Tracks of other aircraft, built from heard Remote ID messages (the paper's "orient", its Section 2).

Heard data is untrusted. A track keeps the last plausible position and velocity at the message's own time;
prediction over the delay is the law's. The number of tracks and of remembered addresses is bounded.

Age. The Location timestamp counts tenths of a second after the full UTC hour, so the moment of the message
is the one nearest to our own UTC among all hours. A sender whose clock leads ours shows a negative age: the
lead is estimated per track as the most negative age seen and added back, up to `max_clock_offset_s`. A clock
that lags cannot be told from a delay; its age reads too long, never too short.
"""

from __future__ import annotations

import math
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
_MAX_RANGE_M = 50_000.0
"""Remote ID is not heard from farther away, and the local frame is too coarse for it."""
_ADDRESSES_PER_TRACK = 4
_SUSPECTS_BEFORE_RESTART = 3
_LEAD_DECAY = 0.02
"""Seconds of clock lead forgotten per second: one wrong timestamp must not age a track for good."""


@dataclass(slots=True)
class TrafficCounts:
    """Why heard messages did not become tracks."""

    updates: int = 0
    no_position: int = 0
    old: int = 0
    """Not newer than what the track holds, or beyond the expiry age."""
    implausible: int = 0
    clock: int = 0
    """Timestamp unknown or too far from ours: time of reception taken instead."""
    own_echo: int = 0
    refused_full: int = 0
    evicted: int = 0


@dataclass(slots=True)
class Track:
    """One aircraft as last heard. Position and velocity: local NED at `sample_s` (our monotonic time)."""

    track_id: str
    address: str
    position_ned_m: Vec3
    velocity_ned_mps: Vec3
    velocity_known: bool
    sample_s: float
    received_s: float
    sigma_m: float
    vertical_known: bool
    stamp_s: float | None
    """UTC of the message by the sender's clock."""
    clock_lead_s: float = 0.0
    suspects: int = 0


@dataclass(slots=True)
class _Fix:
    """A Location turned into our frame and clock."""

    position: Vec3
    velocity: Vec3 | None
    sigma_m: float
    vertical_known: bool
    stamp_s: float | None
    sample_s: float


@dataclass(slots=True)
class Traffic:
    """All tracks."""

    config: TrafficConfig
    own_uas_id: str
    counts: TrafficCounts = field(default_factory=TrafficCounts)
    tracks: dict[str, Track] = field(default_factory=dict)
    _identity: dict[str, str] = field(default_factory=dict)
    """Radio address -> identity from its Basic ID."""

    def hear(
        self,
        heard: RemoteIdHeard,
        now_s: float,
        utc_offset_s: float | None,
        frame: LocalFrame,
        separation_m: float | None,
        own_position: Vec3,
        sent: frozenset[tuple[float | None, float | None, float | None]],
    ) -> None:
        """Take in one heard frame.

        Args:
            utc_offset_s: our UTC minus `now_s`; None while unknown.
            frame: local frame (its altitude datum is mean sea level).
            separation_m: height of the geoid above the ellipsoid here; None while unknown.
            own_position: local NED (m), to rank tracks when there are too many.
            sent: (timestamp_s, lat_deg, lon_deg) of our own last messages, to know an echo.
        """
        source = f"{heard.transport}/{heard.address}"
        for message in heard.messages:
            if isinstance(message, BasicId):
                self._learn_identity(source, message)
        for message in heard.messages:
            if isinstance(message, Location):
                if (message.timestamp_s, message.lat_deg, message.lon_deg) in sent:
                    self.counts.own_echo += 1
                    continue
                fix = self._fix(message, now_s, utc_offset_s, frame, separation_m)
                if fix is not None:
                    self._update(source, fix, now_s, own_position)

    def expire(self, now_s: float) -> None:
        """Forget what is older than `expire_after_s`."""
        limit = self.config.expire_after_s
        for track_id in [k for k, t in self.tracks.items() if now_s - t.sample_s > limit]:
            del self.tracks[track_id]

    def neighbours(self, now_s: float) -> list[Neighbour]:
        """Every live track, as the law takes it."""
        return [
            Neighbour(
                track_id=t.track_id,
                position_ned_m=t.position_ned_m,
                velocity_ned_mps=t.velocity_ned_mps,
                age_s=max(0.0, now_s - t.sample_s),
                sigma_m=t.sigma_m,
                vertical_known=t.vertical_known,
            )
            for t in self.tracks.values()
        ]

    def _learn_identity(self, source: str, message: BasicId) -> None:
        if message.id_type is IdType.NONE or not message.uas_id:
            return
        known = self._identity.pop(source, None)
        # A second Basic ID (registration beside serial) must not rename the track back and forth.
        self._identity[source] = known or message.uas_id
        if len(self._identity) > _ADDRESSES_PER_TRACK * self.config.max_tracks:
            del self._identity[next(iter(self._identity))]
        if known is None and source in self.tracks:
            track = self.tracks.pop(source)
            track.track_id = message.uas_id
            self.tracks.setdefault(message.uas_id, track)

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
        alt_msl_m = frame.alt_m
        if message.alt_geodetic_m is not None and separation_m is not None:
            alt_msl_m = message.alt_geodetic_m - separation_m
        position = frame.to_ned(message.lat_deg, message.lon_deg, alt_msl_m)
        velocity = _velocity(message)
        speed = math.hypot(*velocity) if velocity is not None else 0.0
        if math.hypot(position[0], position[1]) > _MAX_RANGE_M or speed > self.config.max_speed_mps:
            self.counts.implausible += 1
            return None
        stamp = None
        if message.timestamp_s is not None and utc_offset_s is not None:
            utc_now = now_s + utc_offset_s
            hours = round((utc_now - message.timestamp_s) / 3600.0)
            stamp = message.timestamp_s + 3600.0 * hours
            if utc_now - stamp < -self.config.max_clock_offset_s:
                stamp = None
        if stamp is None:
            self.counts.clock += 1
        sigma = SIGMA_UNKNOWN_M
        if message.horizontal_accuracy_m is not None:
            sigma = min(message.horizontal_accuracy_m / 2.0, SIGMA_MOST_M)
        sample_s = now_s if stamp is None or utc_offset_s is None else stamp - utc_offset_s
        return _Fix(position, velocity, sigma, vertical_known, stamp, sample_s)

    def _update(self, source: str, fix: _Fix, now_s: float, own_position: Vec3) -> None:
        track_id = self._identity.get(source, source)
        track = self.tracks.get(track_id)
        if track is not None and track.address != source and not self._reachable(track, fix):
            # Two transmitters under one identity that cannot be one aircraft: keep both in sight.
            track_id = f"{track_id}@{source}"
            track = self.tracks.get(track_id)
        lead = max(fix.sample_s - now_s, 0.0)
        if track is not None:
            lead = max(lead, track.clock_lead_s - _LEAD_DECAY * (now_s - track.received_s))
        sample_s = fix.sample_s - lead if fix.stamp_s is not None else now_s
        if now_s - sample_s > self.config.expire_after_s:
            self.counts.old += 1
            return
        if track is None:
            self._insert(source, track_id, fix, sample_s, lead, now_s, own_position)
            return
        if sample_s <= track.sample_s:
            self.counts.old += 1
            return
        if not self._reachable(track, fix):
            track.suspects += 1
            if track.suspects < _SUSPECTS_BEFORE_RESTART:
                self.counts.implausible += 1
                return
        velocity, known = fix.velocity, True
        if velocity is None:
            velocity, known = _from_positions(track, fix, sample_s)
        track.address = source
        track.position_ned_m, track.velocity_ned_mps, track.velocity_known = fix.position, velocity, known
        track.sample_s, track.received_s, track.stamp_s = sample_s, now_s, fix.stamp_s
        track.sigma_m, track.vertical_known = fix.sigma_m, fix.vertical_known
        track.clock_lead_s, track.suspects = lead, 0
        self.counts.updates += 1

    def _reachable(self, track: Track, fix: _Fix) -> bool:
        """Could the track's aircraft be at the fix by now, within the plausible speed and both accuracies?"""
        elapsed = abs(fix.sample_s - track.clock_lead_s - track.sample_s)
        allowed = self.config.max_speed_mps * elapsed + 4.0 * (fix.sigma_m + track.sigma_m)
        a, b = fix.position, track.position_ned_m
        return math.hypot(a[0] - b[0], a[1] - b[1]) <= allowed

    def _insert(
        self,
        source: str,
        track_id: str,
        fix: _Fix,
        sample_s: float,
        lead: float,
        now_s: float,
        own_position: Vec3,
    ) -> None:
        if len(self.tracks) >= self.config.max_tracks:
            # Flooding with far ghosts must not push out what is near.
            farthest = max(self.tracks.values(), key=lambda t: math.dist(t.position_ned_m, own_position))
            if math.dist(fix.position, own_position) >= math.dist(farthest.position_ned_m, own_position):
                self.counts.refused_full += 1
                return
            del self.tracks[farthest.track_id]
            self.counts.evicted += 1
        self.tracks[track_id] = Track(
            track_id=track_id,
            address=source,
            position_ned_m=fix.position,
            velocity_ned_mps=fix.velocity or (0.0, 0.0, 0.0),
            velocity_known=fix.velocity is not None,
            sample_s=sample_s,
            received_s=now_s,
            sigma_m=fix.sigma_m,
            vertical_known=fix.vertical_known,
            stamp_s=fix.stamp_s,
            clock_lead_s=lead,
        )
        self.counts.updates += 1


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
