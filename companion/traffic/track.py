"""The track of one received aircraft, and tests of where the aircraft can be."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from companion.avoidance import kernels
from companion.geometry import Vec3
from companion.remote_id.messages import Location
from companion.traffic.fix import Fix
from companion.traffic.plausibility import Doubts, Flag, MotionWindow, noise_m
from companion.traffic.sender_details import About

_CLOCKLESS_S = 0.5
ESTABLISHED = 3
"""Number of messages from which a track is established. A full table removes established tracks last."""


@dataclass(slots=True, eq=False)
class Track:
    """One aircraft as last received; position and velocity are local NED at `sample_s` (our monotonic
    time)."""

    track_id: str
    identity: str
    """UAS ID that it reports, or its source key (transport/address) before a Basic ID arrives."""
    position_ned_m: Vec3
    velocity_ned_mps: Vec3
    velocity_known: bool
    sample_s: float
    received_s: float
    sigma_m: float
    sigma_mps: float
    vertical_known: bool
    content: Location
    leads_s: deque[float]
    """How far the sender's clock led ours at its last messages. Negative: its clock lags, or delay."""
    about: About
    sources: deque[str]
    """Keys (transport/address) of the last few radio addresses that it was received from."""
    motion: MotionWindow
    opened_s: float
    fed_by: dict[str, str] = field(default_factory=dict)
    """Key of the radio address that it was last received from, by transport."""
    beside_s: float = -math.inf
    """When there was last another track of its identity (our monotonic time)."""
    split_from: str | None = None
    """Track from which this one was split: one radio address sent positions too far apart for one
    aircraft."""
    doubts: Doubts = field(default_factory=Doubts)
    vouched_s: float = -math.inf
    """When a signature of its key was last valid (our monotonic time)."""
    messages: int = 1
    past: kernels.Past = kernels.NO_PAST
    """Memory of `kernels.note_track`."""
    past_vertical: bool = False
    """Whether `past` includes heights."""
    past_clocked: bool = False
    """Whether the times in `past` are from the sender's clock."""

    def take_over(self, other: Track) -> None:
        """Merge another track of this aircraft, received on another transport before its Basic ID arrived."""
        self.sources.extend(key for key in other.sources if key not in self.sources)
        self.fed_by |= other.fed_by
        self.messages += other.messages
        self.opened_s = min(self.opened_s, other.opened_s)
        if other.sample_s > self.sample_s:
            self.position_ned_m, self.velocity_ned_mps = other.position_ned_m, other.velocity_ned_mps
            self.velocity_known, self.vertical_known = other.velocity_known, other.vertical_known
            self.sample_s, self.received_s = other.sample_s, max(self.received_s, other.received_s)
            self.sigma_m, self.sigma_mps, self.content = other.sigma_m, other.sigma_mps, other.content

    def remember(self, fix: Fix) -> None:
        """Learn from the message just taken how fast the aircraft deviates from its predictions.

        Uses the sender's clock, which runs evenly even if our estimate of its lead changes. Without it the
        time of the message is known only to about a second, in which a fast aircraft moves far along its
        path.
        """
        past, p, v = self.past, self.position_ned_m, self.velocity_ned_mps
        clocked = fix.stamp_s is not None
        if clocked != self.past_clocked:
            past, self.past_clocked = past._replace(time_s=-math.inf), clocked
        down, sinking = (p[2], v[2]) if self.vertical_known else (0.0, 0.0)
        if self.vertical_known != self.past_vertical:
            # A height that becomes known or unknown is no manoeuvre.
            past = past._replace(d=down, vd=0.0)
            self.past_vertical = self.vertical_known
        at_s = self.sample_s if fix.stamp_s is None else fix.stamp_s
        sigma = self.sigma_m if clocked else math.hypot(self.sigma_m, _CLOCKLESS_S * math.hypot(*v))
        noted = kernels.note_track(tuple(past), at_s, (p[0], p[1], down), (v[0], v[1], sinking), sigma)
        self.past = kernels.Past._make(noted)

    @property
    def flags(self) -> frozenset[Flag]:
        """Flags that are raised now."""
        return frozenset(self.doubts.flags)

    @property
    def proven(self) -> bool:
        """Whether a signature verified its identity and nobody else is heard under it."""
        flags = self.doubts.flags
        return Flag.SIGNED in flags and Flag.DUPLICATE_IDENTITY not in flags


def off(track: Track, fix: Fix, at_s: float) -> float:
    """Horizontal distance (m) of a fix from the track's predicted position at `at_s`."""
    p, v, along = track.position_ned_m, track.velocity_ned_mps, at_s - track.sample_s
    return math.hypot(p[0] + along * v[0] - fix.position[0], p[1] + along * v[1] - fix.position[1])


def reach(elapsed_s: float, noise: float) -> float:
    """How far (m) from its predicted position an aircraft may be: noise, and 10 m/s^2 in any direction."""
    return 20.0 + 4.0 * noise + 8.0 * elapsed_s + 5.0 * elapsed_s * elapsed_s


def near(noise: float) -> float:
    """How far (m) from a track's predicted position a message is taken for that aircraft's even if it might
    come from another one."""
    return 10.0 + 2.0 * noise


def apart(track: Track, fix: Fix, now_s: float) -> bool:
    """Whether track and fix cannot be one aircraft, given the accuracies that both declare."""
    at_s = now_s if fix.stamp_s is None else min(fix.stamp_s, now_s)
    noise = noise_m(track.content) + noise_m(fix.content)
    return off(track, fix, at_s) > reach(abs(at_s - track.sample_s), noise)


def lead(leads_s: deque[float]) -> float:
    """How far the sender's clock leads ours: the second largest lead, so that one wrong timestamp has no
    effect; at least 0."""
    ordered = sorted(leads_s)
    return max(0.0, ordered[-2] if len(ordered) > 1 else ordered[-1])


def same(a: Location, b: Location) -> bool:
    """Whether one Location is a repetition of the other."""
    return (a.timestamp_s, a.lat_deg, a.lon_deg) == (b.timestamp_s, b.lat_deg, b.lon_deg)


def from_positions(track: Track, fix: Fix, sample_s: float) -> tuple[Vec3, bool]:
    """Velocity for a sender that declares none, and whether it is known.

    It is computed from the fix and the position held in `Track.past`, which is old enough at any message
    rate.
    """
    past = track.past
    elapsed = (sample_s if fix.stamp_s is None else fix.stamp_s) - past.time_s
    if not 0.5 <= elapsed < math.inf or track.past_clocked != (fix.stamp_s is not None):
        return track.velocity_ned_mps, track.velocity_known
    p = fix.position
    sinking = (p[2] - past.d) / elapsed if track.past_vertical and fix.vertical_known else 0.0
    return ((p[0] - past.n) / elapsed, (p[1] - past.e) / elapsed, sinking), True
