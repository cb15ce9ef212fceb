"""What the writer of a recording knows before the first step: names, clocks, colours, where to look.

Nothing here needs the whole run: a live view makes its scene from the headers alone.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from companion.config import AvoidanceConfig, Config
from companion.geometry import Vec3
from ground_tools.inspect.read.flown import Array, Separation

PIECE_S = 600.0
"""A recording is written in pieces of at most so much of the time line. A whole piece is in memory at once;
until the file is closed its index is, some 6 kB for every entity of every piece: shorter pieces take more."""
BEFORE_S, AFTER_S = 10.0, 20.0
"""What belongs to an encounter besides its conflicts."""
CALM_S = 20.0
"""Conflicts farther apart than this belong to two encounters."""
LONGEST_S = 300.0
APPROACH_S = 40.0
"""Where there was no conflict: the time before and after the closest approach."""


_DEFAULT = AvoidanceConfig()


@dataclass(frozen=True, slots=True)
class Encounter:
    """The part of the time line that a viewer opens on, and its time 0."""

    start_s: float
    zero_s: float
    end_s: float
    what: str
    """What happens at time 0."""

    def clipped(self, time_s: Array) -> Array:
        """Times from its zero; what lies outside is at its ends."""
        inside: Array = np.clip(time_s, self.start_s, self.end_s) - self.zero_s
        return inside


@dataclass(frozen=True, slots=True)
class Aircraft:
    """One aircraft of a scene."""

    name: str
    rgb: tuple[int, int, int]
    offset_s: float = 0.0
    """What to add to its `now_s` for the common time line."""
    config: Config | None = None
    """Of its record's header; None: not known."""
    undulation_m: float = 0.0
    """How far mean sea level lies above the ellipsoid."""

    @property
    def avoidance(self) -> AvoidanceConfig:
        """As configured; the defaults where that is not known."""
        return _DEFAULT if self.config is None else self.config.avoidance


@dataclass(frozen=True, slots=True)
class Scene:
    """One run."""

    origin: Vec3
    """lat_deg, lon_deg, alt_msl_m of the frame that all is drawn in."""
    aircraft: tuple[Aircraft, ...]
    encounter: Encounter | None = None
    root: str = ""
    """Entity path that the run's entities stand under."""
    name: str = ""
    """Of the run, where it is one of several: its lines' names begin with it."""
    span_s: tuple[float, float] | None = None
    """Its first and last time; None while it goes on."""

    def piece(self, time_s: float) -> tuple[int, bool]:
        """Which piece of the time line a time belongs to: a number, and whether it is in the encounter."""
        one = self.encounter
        return math.floor(time_s / PIECE_S), one is not None and one.start_s <= time_s <= one.end_s

    def pieces(self, time_s: Array) -> list[slice]:
        """Rows of one piece each."""
        if not len(time_s):
            return []
        one = self.encounter
        key = 2.0 * np.floor(time_s / PIECE_S)
        if one is not None:
            key += (time_s >= one.start_s) & (time_s <= one.end_s)
        edges = [0, *(np.flatnonzero(np.diff(key)) + 1).tolist(), len(time_s)]
        return [slice(a, b) for a, b in itertools.pairwise(edges)]


def first_encounter(conflicts_s: Array, closest: Separation | None) -> Encounter | None:
    """The first conflict and all that follow it soon; without any, the closest approach.

    Args:
        conflicts_s: (n,) when any aircraft was in conflict, on the common time line, in any order.
        closest: the pair that came closest.
    """
    if len(conflicts_s):
        times = np.sort(conflicts_s)
        first = float(times[0])
        apart = np.flatnonzero(np.diff(times) > CALM_S)
        last = float(times[apart[0]] if len(apart) else times[-1])
        end = min(last + AFTER_S, first + LONGEST_S)
        return Encounter(first - BEFORE_S, first, end, "the first conflict")
    if closest is None or closest.minimum_time_s is None:
        return None
    zero = closest.minimum_time_s
    what = f"the closest approach, {closest.first} - {closest.second}"
    return Encounter(zero - APPROACH_S, zero, zero + APPROACH_S, what)
