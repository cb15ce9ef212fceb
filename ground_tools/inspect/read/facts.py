"""Content of one aircraft's record in columns, gathered in one pass and much smaller than the record.

Frequent data (positions, decisions, messages) is kept as numbers. Rare data (authority changes, alerts,
texts, mode changes) is kept as the events and commands themselves. Times are the aircraft's own `now_s`.
"""

from __future__ import annotations

import itertools
import math
from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import pymap3d

from companion.arrays import Bools, Float32s, Floats
from companion.autopilot.dialect import in_mode
from companion.event_record import Step
from companion.events import (
    AdsbVehicle,
    AlertChanged,
    AnyCommand,
    AnyEvent,
    AuthorityChanged,
    Broadcast,
    BroadcastChanged,
    CurrentMode,
    Decision,
    EstimatorState,
    FenceDownloaded,
    FenceRefused,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    LandedState,
    MissionDownloaded,
    MissionRefused,
    ModeRefused,
    RadioState,
    RemoteIdHeard,
    RemoteIdModule,
    Say,
    SetMode,
    Settings,
    TrackFlagged,
    TransportsChosen,
    VehicleParameters,
    VehicleText,
    VehicleTime,
)
from companion.events.sensed import thing_of
from companion.flight_logs.logged import FIX_3D
from companion.geometry import LocalFrame, Vec3
from companion.ownship import MOST_SEPARATION_M
from companion.remote_id.messages import BasicId, Location
from companion.traffic.fix import make_fix
from ground_tools.inspect.read.conditions import GnssQuality
from ground_tools.inspect.read.nearness import AdsbTally, HeardAdsb, NearestSenders, Sender
from ground_tools.inspect.read.spill import BLOCK, Spill

_OWN_AGE_S = 2.0
"""Maximum age of the own position from which a distance is computed."""
_CLOCK_OFF_S = 5.0
"""A sender's timestamp that differs from the time of reception by more than this is ignored."""

UTC_NOISE_S = 5.0
"""Reports of UTC over a bad telemetry link are late by up to about this."""
_FIX = 8
"""Columns of a fix."""
_RARE = (
    AlertChanged,
    AuthorityChanged,
    BroadcastChanged,
    FenceDownloaded,
    FenceRefused,
    MissionDownloaded,
    MissionRefused,
    ModeRefused,
    RadioState,
    Say,
    SetMode,
    Settings,
    TrackFlagged,
    TransportsChosen,
    VehicleParameters,
    VehicleText,
)


@dataclass(frozen=True, slots=True)
class Heard:
    """Frames received from one radio address."""

    now_s: Floats
    """(n,) reception time of every frame."""
    transports: tuple[str, ...]
    uas_ids: tuple[str, ...]
    """Identities (UAS ids) received from this address."""
    near: Floats
    """(m, 4) approaches to the aircraft's own position, as `nearness.Approaches.rows`. The reported position
    is extrapolated to the time of reception."""


@dataclass(frozen=True, slots=True)
class TrackFacts:
    """How the avoidance law saw one track, with one row for the decisions of each second."""

    now_s: Floats
    """(n,) time of the decision with the smallest distance in each second."""
    distance_m: Floats
    """(n,) smallest slant distance of each second, as the law predicted it; not the true distance."""
    age_s: Floats
    """(n,) largest age of the track's information in each second."""
    conflict: Bools
    """(n,) True if the track was in conflict at any decision of the second."""
    adsb: bool


@dataclass(frozen=True, slots=True)
class Decisions:
    """Every decision of the avoidance law, as numbers."""

    now_s: Floats
    """(n,)"""
    speeds_mps: Float32s
    """(n, 3) flown, wanted and chosen speed."""
    feasible: Bools
    """(n,)"""
    conflict: Bools
    """(n,) True if any track was in conflict."""


@dataclass(frozen=True, slots=True)
class Facts:
    """Everything gathered from one aircraft's record."""

    steps: int
    """Number of steps."""
    start_s: float
    """`now_s` of the first step; 0 if there are no steps."""
    end_s: float
    """`now_s` of the last step; 0 if there are no steps."""
    fixes: Floats
    """Own positions, (n, 8): now_s, lat_deg, lon_deg, alt_msl_m, north, east, down (m/s), height above home
    (m), with strictly rising now_s. A long table lies in a temporary file (`spill`)."""
    decided: Floats
    """Positions as in `fixes`, but from the decisions, without a height above home. Empty if there are any
    fixes."""
    decisions: Decisions
    utc_offset_s: float | None
    """Offset from `now_s` to UTC; None if the aircraft never knew UTC."""
    utc_off_s: float
    """Largest difference of a single report of UTC from `utc_offset_s`; 0 if the aircraft never knew UTC."""
    undulation_m: float
    """Height of mean sea level above the ellipsoid (m); 0 if the GNSS does not report it."""
    sent: dict[str, Floats]
    """now_s of every broadcast, by transport."""
    heard: dict[str, Heard]
    """Received frames, by radio address."""
    heard_left_out: int
    """Number of received frames of further addresses, which were farther away."""
    gnss: GnssQuality
    adsb: dict[str, HeardAdsb]
    """Aircraft heard by ADS-B, by their ICAO addresses."""
    adsb_left_out: int
    """Number of ADS-B reports of further aircraft, which were farther away."""
    tracks: dict[str, TrackFacts]
    """Tracks in the law's decisions, by track id."""
    rare: tuple[tuple[float, AnyEvent | AnyCommand], ...]
    """(now_s, event or command) in order, for all data that is not kept as numbers. Of periodically repeated
    events (heartbeat, landed state, estimator state, Remote ID module) only the changes are kept."""

    @property
    def duration_s(self) -> float:
        """Time from the first step to the last."""
        return self.end_s - self.start_s


@dataclass(slots=True)
class _Track:
    adsb: bool
    rows: array[float] = field(default_factory=lambda: array("d"))
    second: float = -math.inf


@dataclass(slots=True)
class _Frames(Sender):
    now_s: array[float] = field(default_factory=lambda: array("d"))
    transports: set[str] = field(default_factory=set)
    uas_ids: set[str] = field(default_factory=set)


class Gatherer:
    """Collects steps one by one; `facts` returns what was collected."""

    def __init__(self) -> None:
        self.steps = 0
        self.start_s = self.end_s = 0.0
        self.fixes = array("d")
        """The latest fixes; earlier ones are in `_spill`."""
        self._spill = Spill(_FIX)
        self.decided = array("d")
        self.decisions = array("d")
        self.speeds = array("f")
        self.feasible, self.conflict = bytearray(), bytearray()
        self.utc = array("d")
        self.undulation = array("d")
        self.sent: dict[str, array[float]] = {}
        self.heard: NearestSenders[str, _Frames] = NearestSenders(_Frames)
        self.gnss = GnssQuality()
        self.adsb = AdsbTally()
        self.frame: LocalFrame | None = None
        self.tracks: dict[str, _Track] = {}
        self.rare: list[tuple[float, AnyEvent | AnyCommand]] = []
        self.last: dict[object, object] = {}
        self._beat: Heartbeat | None = None

    def step(self, step: Step) -> None:
        """Add the next step."""
        self.start_s = step.now_s if self.steps == 0 else self.start_s
        self.end_s = step.now_s
        self.steps += 1
        for item in itertools.chain(step.events, step.commands):
            self._item(step.now_s, item)

    def _item(self, now_s: float, item: AnyEvent | AnyCommand) -> None:
        match item:
            case GlobalPosition():
                del self.decided[:]
                if len(self.fixes) >= _FIX and self.fixes[-_FIX] >= now_s:
                    del self.fixes[-_FIX:]  # the last of several fixes in one step counts
                place = (item.lat_deg, item.lon_deg, item.alt_msl_m)
                if len(self.fixes) >= _FIX * BLOCK:
                    # Keep the last fix in memory, because it may still be replaced.
                    self._spill.write(memoryview(self.fixes)[:-_FIX])
                    del self.fixes[:-_FIX]
                self.fixes.extend((now_s, *place, *item.velocity_ned_mps, item.height_above_home_m))
            case RemoteIdHeard():
                self._hear(now_s, item)
            case AdsbVehicle():
                self.adsb.hear(now_s, item, self._own(now_s), self._undulation_m())
            case Broadcast():
                self.sent.setdefault(item.transport, array("d")).append(now_s)
            case Decision():
                self._decide(now_s, item)
            case GnssFix():
                self.gnss.add(now_s, item)
                if item.alt_ellipsoid_m is not None and item.fix_type >= FIX_3D:
                    height_m = item.alt_ellipsoid_m - item.alt_msl_m
                    # As in flight: a wrong one would show every other aircraft far above or below.
                    if abs(height_m) <= MOST_SEPARATION_M:
                        self.undulation.append(height_m)
            case VehicleTime():
                if item.utc_s is not None:
                    self.utc.append(item.utc_s - now_s)
            case Heartbeat():
                self._beat = item
                self._change(now_s, item, (item.custom_mode, item.armed, item.firmware))
            case CurrentMode():
                if self._beat is not None:
                    self._item(now_s, in_mode(self._beat, item.custom_mode))
            case LandedState() | EstimatorState():
                self._change(now_s, item, item)
            case RemoteIdModule():
                self._change(now_s, item, item, item.component_id)
            case _ if isinstance(item, _RARE):
                self.rare.append((now_s, item))

    def _change(self, now_s: float, item: AnyEvent, state: object, of: int = 0) -> None:
        if self.last.get((type(item), of)) != state:
            self.last[type(item), of] = state
            self.rare.append((now_s, item))

    def _hear(self, now_s: float, event: RemoteIdHeard) -> None:
        places = [self._away(now_s, message) for message in event.messages if isinstance(message, Location)]
        known = [place for place in places if place is not None]
        nearest = min((away_m for away_m, _ in known), key=lambda away_m: math.hypot(*away_m), default=None)
        one = self.heard.of(event.address, nearest)
        if one is None:
            return
        one.now_s.append(now_s)
        one.transports.add(event.transport)
        one.uas_ids.update(m.uas_id for m in event.messages if isinstance(m, BasicId) and m.uas_id)
        for away_m, vertical_known in known:
            one.near.add(now_s, away_m, vertical_known=vertical_known)

    def _own(self, now_s: float) -> tuple[float, float, float] | None:
        """Own latitude, longitude and altitude above mean sea level; None if it is unknown or old."""
        if len(self.fixes) < _FIX or now_s - self.fixes[-_FIX] > _OWN_AGE_S:
            return None
        _, lat_deg, lon_deg, alt_msl_m = self.fixes[-_FIX : 4 - _FIX]
        return lat_deg, lon_deg, alt_msl_m

    def _undulation_m(self) -> float | None:
        """Height of the geoid above the ellipsoid, as the autopilot knows it; None while unknown."""
        return self.undulation[-1] if self.undulation else None

    def _away(self, now_s: float, message: Location) -> tuple[Vec3, bool] | None:
        """Return a reported position (NED, m), extrapolated to now, relative to the own one, and whether its
        height is known; None if one of the positions is unknown."""
        here = self._own(now_s)
        if here is None:
            return None
        lat, lon, alt = here
        self.frame = self.frame or LocalFrame(lat, lon, alt)
        utc = self.utc[-1] if self.utc else None
        fix = make_fix(message, now_s, utc, self.frame, self._undulation_m(), _CLOCK_OFF_S)
        if fix is None:
            return None
        age = 0.0 if fix.stamp_s is None else max(now_s - fix.stamp_s, 0.0)
        velocity = fix.velocity or (0.0, 0.0, 0.0)
        own = self.frame.to_ned(lat, lon, alt)
        north, east, down = (p + v * age - o for p, v, o in zip(fix.position, velocity, own, strict=True))
        return (north, east, down if fix.vertical_known else 0.0), fix.vertical_known

    def _decide(self, now_s: float, one: Decision) -> None:
        conflict = False
        for track in one.tracks:
            conflict |= track.conflict
            found = self.tracks.setdefault(thing_of(track.track_id), _Track(track.adsb))
            distance = math.dist(track.position_ned_m, one.position_ned_m)
            if now_s - found.second >= 1.0:
                found.second = math.floor(now_s)
                found.rows.extend((now_s, distance, track.age_s, track.conflict))
                continue
            rows = found.rows
            if distance < rows[-3]:
                rows[-4], rows[-3] = now_s, distance
            rows[-2], rows[-1] = max(rows[-2], track.age_s), max(rows[-1], track.conflict)
        self.decisions.append(now_s)
        velocities = one.velocity_ned_mps, one.wanted_ned_mps, one.chosen_ned_mps
        self.speeds.extend(math.hypot(*velocity) for velocity in velocities)
        self.feasible.append(one.feasible)
        self.conflict.append(conflict)
        if not self.fixes:
            if len(self.decided) >= _FIX and self.decided[-_FIX] >= now_s:
                del self.decided[-_FIX:]
            place = pymap3d.ned2geodetic(*one.position_ned_m, *one.origin)
            self.decided.extend((now_s, *place, *one.velocity_ned_mps, math.nan))

    def facts(self) -> Facts:
        """Return everything gathered. The arrays are shared, not copied, so no further step can be added."""
        utc = np.asarray(self.utc)
        return Facts(
            steps=self.steps,
            start_s=self.start_s,
            end_s=self.end_s,
            fixes=self._all_fixes(),
            decided=np.asarray(self.decided).reshape(-1, _FIX),
            decisions=Decisions(
                now_s=np.asarray(self.decisions),
                speeds_mps=np.asarray(self.speeds).reshape(-1, 3),
                feasible=np.frombuffer(self.feasible, dtype=np.bool_),
                conflict=np.frombuffer(self.conflict, dtype=np.bool_),
            ),
            utc_offset_s=float(np.median(utc)) if len(utc) else None,
            utc_off_s=float(abs(utc - np.median(utc)).max()) if len(utc) else 0.0,
            undulation_m=float(np.median(self.undulation)) if self.undulation else 0.0,
            sent={name: np.asarray(times) for name, times in self.sent.items()},
            heard={
                address: Heard(
                    np.asarray(one.now_s),
                    tuple(sorted(one.transports)),
                    tuple(sorted(one.uas_ids)),
                    one.near.rows(),
                )
                for address, one in self.heard.kept.items()
            },
            heard_left_out=self.heard.left_out,
            gnss=self.gnss,
            adsb=self.adsb.heard(),
            adsb_left_out=self.adsb.left_out,
            tracks={name: _track_facts(found) for name, found in self.tracks.items()},
            rare=tuple(self.rare),
        )

    def _all_fixes(self) -> Floats:
        if self._spill:
            self._spill.write(memoryview(self.fixes))
            return self._spill.rows()
        return np.asarray(self.fixes).reshape(-1, _FIX)


def _track_facts(found: _Track) -> TrackFacts:
    rows = np.asarray(found.rows).reshape(-1, 4)
    return TrackFacts(rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3] > 0, found.adsb)


def gather(steps: Iterable[Step]) -> Facts:
    """Gather the facts of one aircraft's steps in one pass."""
    gatherer = Gatherer()
    for step in steps:
        gatherer.step(step)
    return gatherer.facts()
