"""Finds the track to give up when a table is full, without a search through all tracks.

An attacker who fills the table must displace only forged tracks, not the aircraft that we are about to meet.

- A threat (`Judgement`) is given up only when there is nothing else to give up.
- Of the others, tracks that were heard only a few times go first, then those that appeared together, then
  those that are not proven. Among equals, one of the most crowded allowance goes (tracks that sound alike,
  that is, with the same `sound_of`, share an allowance), and within it the farthest.
- If the table holds only threats, and more than half of them sound alike, one of those goes. Otherwise one
  from the most crowded direction goes; within it, one from the most crowded class of time and range; within
  that, one of the most crowded allowance: the least trusted, among equals the one whose separation would be
  lost last, and among those the farthest. A threat that is alone in its direction, or alone in its class in a
  crowded direction, is therefore kept, whatever the others sound like.
"""

from __future__ import annotations

import enum
import math
import zlib
from bisect import bisect_left, insort
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from companion.arrays import Floats, Integers
from companion.avoidance.alerts import Approach, approach
from companion.avoidance.law import LEAST_MARGIN_M, SIGMAS, horizon_s, separation_m
from companion.config import AvoidanceConfig
from companion.events import Say, Severity
from companion.geometry import Vec3

Value = tuple[int, int, int]
"""Sort key within a part; the greatest one is given up first."""


class Trust(enum.IntEnum):
    """How far a track is trusted to be an aircraft."""

    FRESH = 0
    """Heard only a few times, or doubted."""
    ESTABLISHED = 1
    PROVEN = 2
    """Its identity was verified by a signature."""


class Standing(NamedTuple):
    """Where a track stands in a `Ranking`."""

    tier: int
    """The lowest goes first; `THREAT` is the highest."""
    allowance: int
    """Number of the allowance that it shares with tracks that sound alike."""
    sector: int
    """Direction of a threat; otherwise 0."""
    part: int
    """Class of time to the loss of separation and range of a threat; otherwise 0."""
    value: Value

    @property
    def threat(self) -> bool:
        """Whether separation from it may be lost within the horizon."""
        return self.tier == THREAT


class Motion(NamedTuple):
    """An aircraft as last received, NED."""

    position: Vec3
    velocity: Vec3
    age_s: float
    margin_m: float
    """Largest assumed error of its position."""
    vertical_known: bool = True
    crewed: bool = False


class Judgement:
    """Decides which aircraft are threats, from the own motion. A threat is one whose separation, with its
    margin, would be lost within 1.5 horizons if both keep their velocities. It stays one for `HOLD_S`
    afterwards, because our own avoidance is what ends most conflicts.

    Args:
        avoidance: configuration of the law, for separations and horizons.
    """

    def __init__(self, avoidance: AvoidanceConfig) -> None:
        self.position: Vec3 = (0.0, 0.0, 0.0)
        self.velocity: Vec3 = (0.0, 0.0, 0.0)
        self.configure(avoidance)

    def configure(self, avoidance: AvoidanceConfig) -> None:
        """Use other separations and horizons from now on."""
        self._separations = separation_m(avoidance, False), separation_m(avoidance, True)
        self._ahead_s = tuple(HORIZONS * horizon_s(avoidance, crewed) for crewed in (False, True))

    def loss_s(self, position: Vec3, velocity: Vec3) -> float:
        """Time (s) until separation from an aircraft that is at `position` now is lost; infinite if it is
        not."""
        return self._loss(Motion(position, velocity, 0.0, LEAST_MARGIN_M))[1].loss_s

    def _loss(self, motion: Motion) -> tuple[Vec3, Approach, bool]:
        (n, e, d), (vn, ve, vd), age = motion.position, motion.velocity, motion.age_s
        (on, oe, od), (ovn, ove, ovd) = self.position, self.velocity
        away = n + age * vn - on, e + age * ve - oe, d + age * vd - od
        closing = ovn - vn, ove - ve, ovd - vd
        if not motion.vertical_known:
            away, closing = (away[0], away[1], 0.0), (closing[0], closing[1], 0.0)
        radius, scale = self._separations[motion.crewed]
        way = approach(away, closing, radius + motion.margin_m + NEARLY_M, scale)
        return away, way, way.loss_s <= self._ahead_s[motion.crewed]

    def standing(
        self, motion: Motion, trust: Trust, together: bool, allowance: int, was_threat: bool
    ) -> tuple[Standing, bool]:
        """The standing of a track, and whether it is a threat by its present motion.

        Args:
            together: it appeared in a burst of new tracks.
            allowance: number of its allowance (`allowance_of`).
            was_threat: it was a threat within `HOLD_S`.
        """
        away, way, threat = self._loss(motion)
        distance_m = math.sqrt(away[0] * away[0] + away[1] * away[1] + away[2] * away[2])
        if not (threat or was_threat):
            tier = trust + 1 if trust is Trust.PROVEN or (trust and not together) else trust
            return Standing(tier, allowance, 0, 0, (0, 0, int(distance_m))), False
        late = bisect_left(LOSS_S, way.loss_s)
        part = len(RANGE_M) * late + min(bisect_left(RANGE_M, distance_m), len(RANGE_M) - 1)
        loss = int(min(2.0 * way.loss_s, 1000.0))
        tier = THREAT if threat else THREAT - 1
        return Standing(tier, allowance, _sector(away), part, (-trust, loss, int(distance_m))), threat

    def urgency(self, rows: Floats) -> tuple[Floats, Floats, Integers, Integers]:
        """Approximate urgency of many aircraft. Its margins are some metres wider than those of `standing`.

        Args:
            rows: position, velocity and declared error (NED, m and m/s) of each. A height that is NaN is
                unknown.

        Returns:
            The time until the separation is lost (infinite: no threat), the distance (m), and the direction
            and the class of time and range as in a `Standing`; 0 for aircraft that are no threats.
        """
        away, closing = rows[:, :3] - self.position, np.asarray(self.velocity) - rows[:, 3:6]
        level = np.isnan(away[:, 2])
        away[level, 2] = closing[level, 2] = 0.0
        azimuth = np.floor(AZIMUTHS * (0.5 + np.arctan2(away[:, 1], away[:, 0]) / math.tau))
        flat = np.abs(away[:, 2]) <= 0.6 * np.hypot(away[:, 0], away[:, 1])
        height = np.where(flat, 0, np.where(away[:, 2] > 0.0, 1, 2))
        distance = np.sqrt((away * away).sum(axis=1))
        radius, scale = self._separations[False]
        margin = np.maximum(LEAST_MARGIN_M, SIGMAS * np.hypot(rows[:, 6], OWN_SIGMA_M))
        margin += NEARLY_M + _AGE_S * np.sqrt((closing * closing).sum(axis=1))
        away[:, 2] *= scale
        closing[:, 2] *= scale
        towards = (away * closing).sum(axis=1)
        gap2 = (away * away).sum(axis=1) - (radius + margin) ** 2
        root = towards * towards - (closing * closing).sum(axis=1) * gap2
        with np.errstate(divide="ignore", invalid="ignore"):
            loss = gap2 / (towards + np.sqrt(root))
        loss[~((towards > 0.0) & (root >= 0.0))] = np.inf
        loss[gap2 <= 0.0] = 0.0
        loss[~(loss <= self._ahead_s[False])] = np.inf
        late = np.searchsorted(LOSS_S, loss)
        part = len(RANGE_M) * late + np.minimum(np.searchsorted(RANGE_M, distance), len(RANGE_M) - 1)
        threat = np.isfinite(loss)
        sector = 3 * (azimuth.astype(np.int64) % AZIMUTHS) + height
        return loss, distance, np.where(threat, sector, 0), np.where(threat, part, 0)


HOLD_S = 6.0
"""How long a track stays a threat after it was last judged one."""
THREAT = 5
"""Tier of threats. The tiers below are, in descending order: tracks that were threats shortly before, proven
tracks, established tracks, established tracks that appeared together, and fresh tracks."""
HORIZONS = 1.5
"""A conflict within this many horizons of the law is a threat."""
NEARLY_M = 4.0
"""Added to the volume, so that an aircraft that is being passed at its border counts as a threat."""
OWN_SIGMA_M = 2.0
"""Assumed standard deviation of the own position."""
_AGE_S = 1.0
"""Age of a message that `urgency` allows for."""
LOSS_S = (1.0, 4.0, 8.0, 15.0)
"""Bounds of the classes of the time to loss of separation."""
RANGE_M = (30.0, 60.0, 120.0, 240.0, math.inf)
"""Bounds of the classes of distance."""
AZIMUTHS = 12
"""Number of classes of direction."""
_ALLOWANCES = 32


def margin_m(sigma_m: float, sigma_mps: float, age_s: float, growth_m: float) -> float:
    """Margin for declared errors and manoeuvres, as the law has it with an own error of 2 m."""
    drift = sigma_mps * age_s
    sigma = math.sqrt(sigma_m * sigma_m + drift * drift + OWN_SIGMA_M * OWN_SIGMA_M)
    return max(LEAST_MARGIN_M, SIGMAS * sigma) + growth_m


def _sector(away: Vec3) -> int:
    """Direction from us: one of twelve azimuths, below, level with or above us."""
    level = math.hypot(away[0], away[1])
    azimuth = int(AZIMUTHS * (0.5 + math.atan2(away[1], away[0]) / math.tau)) % AZIMUTHS
    height = 0 if abs(away[2]) <= 0.6 * level else (1 if away[2] > 0.0 else 2)
    return 3 * azimuth + height


def sound_of(transport: str, address: str, rssi_dbm: float | None) -> str:
    """Characteristics of a sender's signal: transport, kind of radio address, signal strength in steps of 6
    dB."""
    strength = "" if rssi_dbm is None else f" {6 * round(rssi_dbm / 6.0)} dBm"
    return f"{transport} {_pattern(address)}{strength}"


def _pattern(address: str) -> str:
    """Manufacturer of a MAC address; "random" if it is locally administered; otherwise the part before its
    number."""
    if len(address) == 17 and address[2::3] == ":::::":
        try:
            local = int(address[:2], 16) & 0x02
        except ValueError:
            local = 0
        return "random" if local else address[:8].lower()
    return address.rstrip("0123456789 ")


def allowance_of(sound: str) -> int:
    """Number of the allowance of a `sound_of`. There are 32, so that no search grows with their number."""
    return zlib.crc32(sound.encode("utf-8", "replace")) % _ALLOWANCES


OPENED, OPENED_S = 10, 2.0


@dataclass(slots=True)
class Burst:
    """Recognises tracks that appear together: more than `OPENED` within `OPENED_S`."""

    _times_s: deque[float] = field(default_factory=lambda: deque(maxlen=OPENED))

    def note(self, now_s: float) -> bool:
        """Note that a track appears; True if it appears together with many others."""
        together = len(self._times_s) == OPENED and now_s - self._times_s[0] <= OPENED_S
        self._times_s.append(now_s)
        return together


@dataclass(slots=True)
class _Crowd:
    """A tree of tracks. Each path through its parts leads to a list, sorted by value."""

    size: int = 0
    parts: dict[int, _Crowd] = field(default_factory=dict)
    members: list[tuple[Value, str]] = field(default_factory=list)

    def add(self, path: tuple[int, ...], member: tuple[Value, str]) -> None:
        crowd = self
        crowd.size += 1
        for key in path:
            below = crowd.parts.get(key)
            if below is None:
                below = crowd.parts[key] = _Crowd()
            crowd = below
            crowd.size += 1
        insort(crowd.members, member)

    def remove(self, path: tuple[int, ...], member: tuple[Value, str]) -> None:
        crowd = self
        crowd.size -= 1
        for key in path:
            below = crowd.parts[key]
            below.size -= 1
            if not below.size:
                del crowd.parts[key]
            crowd = below
        del crowd.members[bisect_left(crowd.members, member)]

    def largest(self) -> _Crowd:
        """The largest part; of equal ones the one with the greatest key, which is the latest for times."""
        parts = self.parts
        return parts[max(parts, key=lambda key: (parts[key].size, key))]

    def last(self) -> tuple[Value, str]:
        """The track of the greatest value in the most crowded part, with that value."""
        crowd = self
        while crowd.parts:
            crowd = crowd.largest()
        return crowd.members[-1]


@dataclass(slots=True)
class Ranking:
    """Tracks by their standing."""

    _tiers: dict[int, _Crowd] = field(default_factory=dict)
    """Tier, allowance, direction, class of time and range."""
    _places: _Crowd = field(default_factory=_Crowd)
    """Threats only: direction, class of time and range, allowance."""
    _held: dict[str, Standing] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of tracks held."""
        return len(self._held)

    def place(self, track_id: str, standing: Standing) -> None:
        """Add a track, or move it to its present standing."""
        held = self._held.get(track_id)
        if held == standing:
            return
        if held is not None:
            self.remove(track_id)
        self._held[track_id] = standing
        tier, allowance, sector, part, value = standing
        self._tiers.setdefault(tier, _Crowd()).add((allowance, sector, part), (value, track_id))
        if tier == THREAT:
            self._places.add((sector, part, allowance), (value, track_id))

    def remove(self, track_id: str) -> None:
        """Remove a track."""
        tier, allowance, sector, part, value = self._held.pop(track_id)
        self._tiers[tier].remove((allowance, sector, part), (value, track_id))
        if tier == THREAT:
            self._places.remove((sector, part, allowance), (value, track_id))

    def standing(self, track_id: str) -> Standing:
        """The standing of a track that is held."""
        return self._held[track_id]

    def first(self) -> str:
        """The track to give up. There must be one."""
        tier = min(tier for tier, crowd in self._tiers.items() if crowd.size)
        crowd = self._tiers[tier]
        if tier < THREAT:
            most = crowd.largest().size
            return max(part.last() for part in crowd.parts.values() if part.size == most)[1]
        if 2 * crowd.largest().size <= crowd.size:
            return self._places.last()[1]
        return crowd.last()[1]


@dataclass(slots=True)
class FullTable:
    """Tells the pilot that a table is full, at once and then every `TELL_S` while aircraft are left out."""

    name: str
    most: int
    left_out: int = 0
    threats: int = 0
    """Number of left-out aircraft that were threats, because there were more threats than the table holds."""
    _left_s: float = -math.inf
    _told_s: float = -math.inf
    _told: int = 0
    """0: nothing was told, 1: the table is full, 2: threats were left out."""
    _told_threats: int = 0

    def note(self, now_s: float, threat: bool) -> None:
        """Note that an aircraft was left out."""
        self.left_out += 1
        self.threats += threat
        self._left_s = now_s

    def due(self, now_s: float) -> list[Say]:
        """The text to send now, if any."""
        if now_s - self._left_s > TELL_S:
            told, self._told, self._told_s = self._told, 0, -math.inf
            return [Say(severity=Severity.INFO, text=f"DMUCA: {self.name} has room again")] if told else []
        level = 2 if self.threats > self._told_threats else 1
        if level <= self._told and (now_s - self._told_s < TELL_S or self._left_s <= self._told_s):
            return []
        self._told, self._told_s, self._told_threats = level, now_s, self.threats
        if level == 2:
            text = f"DMUCA: more than {self.most} conflicts in {self.name}: not all are avoided"
            return [Say(severity=Severity.CRITICAL, text=text)]
        return [
            Say(severity=Severity.WARNING, text=f"DMUCA: {self.name} full ({self.most}): a crowd, or forged")
        ]


TELL_S = 30.0
