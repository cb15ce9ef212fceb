"""The track of one received aircraft, and tests of where the aircraft can be."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from companion.avoidance import kernels
from companion.geometry import Vec3
from companion.remote_id.messages import Location
from companion.traffic.eviction import Trust
from companion.traffic.fix import Belief, Fix, belief_of, height_error_m, hold
from companion.traffic.latest_messages import LatestMessages
from companion.traffic.plausibility import UNTRUSTED, Doubts, Flag, MotionWindow, noise_m
from companion.traffic.signal_strength import SignalWitness

_CLOCKLESS_S = 0.5
CLOCKLESS_MOST_S = 1.0
"""Largest assumed difference between the delays of two messages that are dated by their reception."""
_CLOCK_S = 0.5
"""Largest assumed error of a timestamp."""
_LEAD_S, _DELAY_S, _CLOCK_MEMORY_S = 2.0, 3.0, 10.0
_LEADING_S = 1.5
"""Largest assumed error of the lead of a clock, which is learnt from messages of unknown delay."""
_QUANTUM_S = 0.1
"""Resolution of a timestamp."""
_DECLARED_S = 2.0
_LASTING_S = 1.3
"""A contradicted state is believed for this much longer than a track may be silent, so that one lost message
hides no aircraft."""
_BELIEFS = 4
"""Most states that a track is believed to be in. The least urgent one is given up."""
HIGH_M = 10.0
"""A height may differ from the predicted one by this, plus the errors that both messages declare."""
ESTABLISHED = 3
"""Number of messages from which a track is established. A full table removes established tracks last."""


@dataclass(slots=True)
class Wander:
    """Distances by which messages miss the predicted place, beyond what noise and manoeuvres explain.

    Two senders with one name and address that are too near to each other for two tracks pull one track back
    and forth. Misses that noise does not explain are summed up; the sum fades. Above `_WANDERS` the largest
    recent miss counts as an error of the position.
    """

    surprise: float = 0.0
    miss_m: float = 0.0
    at_s: float = -math.inf

    def note(self, miss_m: float, elapsed_s: float, sigma_m: float, now_s: float) -> None:
        """Take in the next message.

        Args:
            miss_m: horizontal distance from the predicted place.
            elapsed_s: time of the prediction.
            sigma_m: declared errors of both for each axis.
        """
        unexplained_m = miss_m - elapsed_s * (_TURNS_MPS + _TURNS_MPS2 * elapsed_s)
        surprise = 0.0
        if unexplained_m > 0.0:
            surprise = 0.5 * (unexplained_m / max(sigma_m, _LEAST_SIGMA_M)) ** 2 - _EXPECTED
        if surprise <= 0.0 and self.surprise == 0.0:
            return
        fade = math.exp((self.at_s - now_s) / _WANDER_MEMORY_S)
        self.surprise, self.miss_m, self.at_s = fade * self.surprise, fade * self.miss_m, now_s
        if surprise > 0.0:
            self.surprise += min(surprise, _MOST_SURPRISE)
            self.miss_m = max(self.miss_m, miss_m)
        elif self.surprise < _FORGOTTEN:
            self.surprise = self.miss_m = 0.0

    @property
    def error_m(self) -> float:
        """Error of the position that the misses show; 0 if they can be noise."""
        return self.miss_m if self.surprise > _WANDERS else 0.0


_TURNS_MPS, _TURNS_MPS2 = 2.0, 5.0
_WANDER_MEMORY_S = 10.0
_EXPECTED = 5.0
"""Half of the squared miss, in standard deviations, from which a message is a surprise. White noise reaches
it once in 150 messages, and then exceeds it by 1 on average."""
_WANDERS, _MOST_SURPRISE = 12.0, 6.0
"""Sum of surprises above which a track wanders, and the most that one message adds. One message elsewhere
makes two surprises, there and back, which do not suffice."""
_FORGOTTEN = 0.01
_LEAST_SIGMA_M = 2.0
_DRAGGED = 2.0
"""Largest distance by which forged messages may have dragged a track away from its aircraft, as a multiple of
`near`."""


class Earlier(NamedTuple):
    """Earlier state of a track, from which a quick series of messages must also be reachable; NED."""

    at_s: float
    position: Vec3
    velocity: Vec3
    sigma_m: float
    vertical_known: bool
    height_m: float
    """Error of the height that the sender declared."""
    clocked: bool


_EARLIER_S = 0.9
"""Least age of the earlier state when it is replaced. One message a second, with some jitter, replaces it
each time."""


@dataclass(slots=True, eq=False)
class Track:
    """One aircraft as last received; position and velocity are NED at `sample_s` (our monotonic time)."""

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
    """Lead of the sender's clock over ours at its last messages. Negative: the clock lags or messages were
    late."""
    latest: LatestMessages
    sources: deque[str]
    """Keys (transport/address) of the last few radio addresses that it was received from."""
    motion: MotionWindow
    opened_s: float
    earlier: Earlier | None = None
    """The state of about a second ago; None before the first message was taken."""
    fed_by: dict[str, str] = field(default_factory=dict)
    """Key of the radio address that it was last received from, by transport."""
    beside_s: float = -math.inf
    """Time at which another track of its identity last existed (our monotonic time)."""
    split_from: str | None = None
    """Track from which this one was split, because one radio address sent what cannot be from one aircraft.
    None once this one is established."""
    leapt: bool = False
    """Whether the split was by a distance that no aircraft can fly."""
    hypothesis: bool = False
    """Whether it was split from another track and is not established yet."""
    group: str = ""
    """Name of its group: "together" if it appeared in a burst, else its `eviction.sound_of`."""
    allowance: int = 0
    """Number of the allowance that it shares with tracks that sound alike (`eviction.allowance_of`)."""
    together: bool = False
    """Whether it appeared in a burst of new tracks."""
    threat_s: float = -math.inf
    """When it was last a threat (our monotonic time)."""
    base_lead_s: float = 0.0
    """Lead that shows whether later messages are from the same clock (`note_lead`)."""
    clock_s: float = -math.inf
    """When a message was last dated by that clock (our monotonic time)."""
    wander: Wander = field(default_factory=Wander)
    signal: SignalWitness = field(default_factory=SignalWitness)
    beliefs: tuple[Belief, ...] = ()
    """States in which it was reported lately and that contradict each other."""
    present: Belief | None = None
    """The message that its state is from."""
    aside: tuple[Belief, ...] = ()
    """The `beliefs` that contradict `present`."""
    declared_s: float | None = None
    """Time of the last message that declared a velocity (our monotonic time)."""
    doubts: Doubts = field(default_factory=Doubts)
    vouched_s: float = -math.inf
    """When a signature last proved its identity (our monotonic time)."""
    taken_s: float = -math.inf
    """When a frame from one of its addresses was last used in a crowded step (`flood.choice`)."""
    messages: int = 1
    past: kernels.Past = kernels.NO_PAST
    """Memory of `kernels.note_track`."""
    silent_after_s: float = math.inf
    """Time since the last reception from which it counts as silent (`kernels.silent_after`)."""
    unlocated: bool = False
    """Whether it has sent a Location without a position since it last sent one with a position."""
    past_vertical: bool = False
    """Whether `past` includes heights."""
    past_clocked: bool = False
    """Whether the times in `past` are from the sender's clock."""

    def take_over(self, other: Track) -> None:
        """Merge another track of this aircraft, received on another transport before its Basic ID."""
        self.sources.extend(key for key in other.sources if key not in self.sources)
        self.fed_by |= other.fed_by
        self.messages += other.messages
        self.opened_s = min(self.opened_s, other.opened_s)
        if other.sample_s > self.sample_s:
            self.position_ned_m, self.velocity_ned_mps = other.position_ned_m, other.velocity_ned_mps
            self.velocity_known, self.vertical_known = other.velocity_known, other.vertical_known
            self.sample_s, self.received_s = other.sample_s, max(self.received_s, other.received_s)
            self.sigma_m, self.sigma_mps, self.content = other.sigma_m, other.sigma_mps, other.content
        self.unlocated = self.unlocated or other.unlocated

    def as_fix(self) -> Fix:
        """The message that its state is from."""
        return Fix(
            position=self.position_ned_m,
            velocity=self.velocity_ned_mps if self.velocity_known else None,
            sigma_m=self.sigma_m,
            sigma_mps=self.sigma_mps,
            vertical_known=self.vertical_known,
            stamp_s=self.sample_s if self.past_clocked else None,
            lead_s=None,
            content=self.content,
        )

    def remember(self, fix: Fix) -> None:
        """Learn from the message just taken how fast the aircraft deviates from its predictions.

        Uses the sender's clock, which runs evenly even if our estimate of its lead changes. Without it the
        time of the message is known only to about a second, in which a fast aircraft moves far along its
        path.
        """
        past, p, v = self.past, self.position_ned_m, self.velocity_ned_mps
        clocked = fix.stamp_s is not None
        if clocked != self.past_clocked:
            past, self.past_clocked = past._replace(time_s=-math.inf, since_s=-math.inf), clocked
        at_s = self.sample_s if fix.stamp_s is None else fix.stamp_s
        down, sinking = (p[2], v[2]) if self.vertical_known else (0.0, 0.0)
        if self.vertical_known != self.past_vertical:
            # A height that becomes known or unknown is no manoeuvre, so the earlier height is extrapolated
            # back from this message.
            passed = at_s - past.since_s
            since_d = down - passed * sinking if passed < math.inf else down
            past = past._replace(d=down, vd=0.0, since_d=since_d, since_vd=sinking)
            self.past_vertical = self.vertical_known
        sigma = self.sigma_m if clocked else math.hypot(self.sigma_m, _CLOCKLESS_S * math.hypot(*v))
        if self.earlier is None or abs(self.sample_s - self.earlier.at_s) >= _EARLIER_S:
            height_m = height_error_m(fix.content)
            self.earlier = Earlier(self.sample_s, p, v, self.sigma_m, self.vertical_known, height_m, clocked)
        noted = kernels.note_track(tuple(past), at_s, (p[0], p[1], down), (v[0], v[1], sinking), sigma)
        self.past = kernels.Past._make(noted)
        self.silent_after_s = kernels.silent_after(self.past.gap_s)

    def believe(
        self, fix: Fix, now_s: float, loss_s: Callable[[Belief], float], *, taken: bool = True
    ) -> None:
        """Keep the state that a message reports beside states that contradict it, for `believed_s`. One
        message, which may be forged, thus does not erase what another one reported.

        Args:
            loss_s: time until separation from a state would be lost.
            taken: the track took the message for its present state; it may be older than that.
        """
        told = belief_of(fix, self.velocity_ned_mps, now_s)
        beliefs = [b for b in self.beliefs if now_s - b.agreed_s <= self.believed_s]
        contradicted = self.present is not None and not self.present.agrees(told)
        if self.present is not None and contradicted and taken:
            hold(beliefs, self.present, now_s, 0.0)
        agreeing = None if contradicted else self.present
        hold(beliefs, told, now_s, 0.0 if contradicted and not taken else _EARLIER_S, agreeing)
        while len(beliefs) > _BELIEFS:
            beliefs.remove(max(beliefs, key=loss_s))
        self.present = present = told if taken or self.present is None else self.present
        self.beliefs = tuple(beliefs)
        self.aside = tuple(b for b in beliefs if not b.agrees(present)) if len(beliefs) > 1 else ()

    def note_lead(self, lead_s: float, now_s: float) -> bool:
        """Learn from a timestamp; False if it is from another clock and does not date the message.

        A clock leads ours by a constant minus the delay of the message. Of two clocks, the one that leads
        less is used while it is heard, so that messages which the other clock dates ahead do not make its
        messages old.
        """
        if lead_s > self.base_lead_s + _LEAD_S:
            if now_s - self.clock_s <= _CLOCK_MEMORY_S:
                return False
            self.base_lead_s = lead_s
        elif lead_s < self.base_lead_s - _DELAY_S and now_s + lead_s > self.sample_s:
            self.base_lead_s = lead_s
            self.leads_s.clear()
        self.clock_s = now_s
        self.leads_s.append(lead_s)
        return True

    def note_signal(self, key: str, rssi_dbm: float, here: Vec3, now_s: float) -> bool:
        """Compare the power of a message with the place where the track is then. False if it was not used.

        Args:
            key: radio address that the message came from.
            here: own position.
        """
        age_s = max(0.0, now_s - self.sample_s)
        north, east, down = (
            p + age_s * v - o
            for p, v, o in zip(self.position_ned_m, self.velocity_ned_mps, here, strict=True)
        )
        return self.signal.add(key, rssi_dbm, (north, east, down), now_s)

    def note_miss(self, fix: Fix, sample_s: float, now_s: float) -> None:
        """Compare a message with the place that is predicted for its time."""
        if not self.velocity_known:
            return
        clock_s = _QUANTUM_S if fix.stamp_s is not None and self.past_clocked else CLOCKLESS_MOST_S
        miss_m = off(self, fix, sample_s) - clock_s * math.hypot(*self.velocity_ned_mps)
        self.wander.note(miss_m, abs(sample_s - self.sample_s), math.hypot(self.sigma_m, fix.sigma_m), now_s)

    def inherit(self, others: Iterable[Track], fix: Fix, now_s: float) -> None:
        """Take over the errors of the nearest track that its address feeds, if that was dragged away.

        Otherwise an attacker who drags an aircraft's track away each time that it sends would make each of
        its new tracks look sound.

        Args:
            fix: first message of this track.
        """
        at_s = now_s if fix.stamp_s is None else min(fix.stamp_s, now_s)
        other = min(others, key=lambda track: off(track, fix, at_s))
        if off(other, fix, at_s) <= _DRAGGED * near(fix.sigma_m + other.sigma_m):
            other.note_miss(fix, at_s, now_s)
            self.wander = replace(other.wander)
            growth = other.past.growth_mps, other.past.growth_down_mps
            self.past = self.past._replace(growth_mps=growth[0], growth_down_mps=growth[1])

    @property
    def believed_s(self) -> float:
        """How long (s) a state is believed from the last message that agreed with it."""
        return self.silent_after_s + _LASTING_S

    @property
    def flags(self) -> frozenset[Flag]:
        """Flags that are raised now."""
        return frozenset(self.doubts.flags)

    @property
    def proven(self) -> bool:
        """Whether a signature verified its identity and nobody else is heard under it."""
        flags = self.doubts.flags
        return Flag.SIGNED in flags and not flags & UNTRUSTED

    @property
    def trust(self) -> Trust:
        """How far it is trusted to be an aircraft, for its place in a full table."""
        if self.proven:
            return Trust.PROVEN
        known = self.messages >= ESTABLISHED and not self.doubts.flags & UNTRUSTED
        return Trust.ESTABLISHED if known else Trust.FRESH


def off(track: Track, fix: Fix, at_s: float) -> float:
    """Horizontal distance (m) of a fix from the track's predicted position at `at_s`."""
    p, v, along = track.position_ned_m, track.velocity_ned_mps, at_s - track.sample_s
    return math.hypot(p[0] + along * v[0] - fix.position[0], p[1] + along * v[1] - fix.position[1])


def reach(elapsed_s: float, noise: float) -> float:
    """How far (m) from its predicted position an aircraft may be: noise, and 10 m/s^2 in any direction."""
    return 20.0 + 4.0 * noise + 8.0 * elapsed_s + 5.0 * elapsed_s * elapsed_s


def beyond(track: Track, fix: Fix, at_s: float) -> float:
    """Horizontal distance (m) of a fix from where the track's aircraft can be at `at_s` if it flies as
    reported.

    That is a line: both clocks may be off, and an aircraft that reports a wrong velocity is between its last
    place and the predicted one.
    """
    p, v, along = track.position_ned_m, track.velocity_ned_mps, at_s - track.sample_s
    north, east = fix.position[0] - p[0], fix.position[1] - p[1]
    clock_s = clock_error_s(track, fix.stamp_s is not None and track.past_clocked)
    v2 = v[0] * v[0] + v[1] * v[1]
    t = (north * v[0] + east * v[1]) / v2 if v2 > 0.0 else 0.0
    t = min(max(t, min(0.0, along) - clock_s), max(0.0, along) + clock_s)
    return math.hypot(north - t * v[0], east - t * v[1])


def clock_error_s(track: Track, clocked: bool) -> float:
    """Largest error (s) of the times of a track's messages, depending on whether the sender's clock dates
    them."""
    if not clocked:
        return CLOCKLESS_MOST_S
    return _LEADING_S if lead(track.leads_s) > _CLOCK_S else _CLOCK_S


def flown(elapsed_s: float, noise: float) -> float:
    """How far (m) an aircraft that is alone under its name and address may be from there: noise, an error of
    the velocity, and 10 m/s^2 in any direction."""
    return near(noise) + elapsed_s * (4.0 + 5.0 * elapsed_s)


def near(noise: float) -> float:
    """How far (m) from a track's predicted position a message is taken for that aircraft's even if it might
    come from another one."""
    return 10.0 + 2.0 * noise


def apart(track: Track, fix: Fix, now_s: float) -> bool:
    """Whether track and fix cannot be one aircraft, given the accuracies that both declare."""
    at_s = now_s if fix.stamp_s is None else min(fix.stamp_s, now_s)
    noise = noise_m(track.content) + noise_m(fix.content)
    return off(track, fix, at_s) > reach(abs(at_s - track.sample_s), noise)


def beside(track: Track, fix: Fix, now_s: float) -> bool:
    """Whether track and fix, if they are from one address, are two senders: an aircraft is near where it is
    predicted."""
    at_s = now_s if fix.stamp_s is None else min(fix.stamp_s, now_s)
    if off(track, fix, at_s) > near(noise_m(track.content) + noise_m(fix.content)):
        return True
    if not (track.vertical_known and fix.vertical_known):
        return False
    down = track.position_ned_m[2] + (at_s - track.sample_s) * track.velocity_ned_mps[2]
    return abs(fix.position[2] - down) > HIGH_M + height_error_m(track.content) + height_error_m(fix.content)


def lead(leads_s: deque[float]) -> float:
    """How far the sender's clock leads ours: the second largest lead, so that one wrong timestamp has no
    effect; at least 0."""
    if max(leads_s) <= 0.0:  # of most senders, because messages are delayed
        return 0.0
    return max(0.0, sorted(leads_s)[-2:][0])


def same(a: Location, b: Location) -> bool:
    """Whether one Location is a repetition of the other.

    Without a timestamp, one that differs in anything is new: an aircraft may climb above one place.
    """
    if a.timestamp_s is None:
        return a == b
    return (a.timestamp_s, a.lat_deg, a.lon_deg) == (b.timestamp_s, b.lat_deg, b.lon_deg)


def from_positions(track: Track, fix: Fix, sample_s: float) -> tuple[Vec3, bool]:
    """Velocity for a sender that declares none, and whether it is known.

    It is computed from the fix and the position held in `Track.past`, which is old enough at any message
    rate. A sender that has declared velocities before is not believed to have changed its own because one
    message leaves it out.
    """
    past = track.past
    elapsed = (sample_s if fix.stamp_s is None else fix.stamp_s) - past.time_s
    if not 0.5 <= elapsed < math.inf or track.past_clocked != (fix.stamp_s is not None):
        return track.velocity_ned_mps, track.velocity_known
    if track.declared_s is not None and sample_s - track.declared_s <= _DECLARED_S:
        return track.velocity_ned_mps, track.velocity_known
    p = fix.position
    sinking = (p[2] - past.d) / elapsed if track.past_vertical and fix.vertical_known else 0.0
    return ((p[0] - past.n) / elapsed, (p[1] - past.e) / elapsed, sinking), True
