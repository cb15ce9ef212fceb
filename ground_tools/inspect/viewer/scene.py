"""What the writer of a recording knows before the first step: names, clocks, colours and the encounter.

A scene does not need the whole run. A live view makes its scene from the beginning of the records.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from companion.arrays import Floats
from companion.config import AvoidanceConfig, Config
from companion.geometry import Vec3
from ground_tools.inspect.read.flown import Separation

PIECE_S = 600.0
"""Longest piece of the time line that is written at once.

A whole piece is in memory at once. The index of all pieces, about 6 kB for every entity of every piece, stays
in memory until the file is closed, so shorter pieces take more memory in total.
"""
BEFORE_S, AFTER_S = 10.0, 20.0
"""Time before the first and after the last conflict that belongs to an encounter."""
CALM_S = 20.0
"""Conflicts farther apart than this belong to different encounters."""
LONGEST_S = 300.0
"""Longest time from the first conflict to the end of an encounter."""
APPROACH_S = 40.0
"""Time before and after the closest approach that belongs to an encounter without a conflict."""


_DEFAULT = AvoidanceConfig()


@dataclass(frozen=True, slots=True)
class Encounter:
    """The part of the time line that a viewer shows first, and its time 0."""

    start_s: float
    zero_s: float
    end_s: float
    what: str
    """Description of what happens at time 0."""

    def clipped(self, time_s: Floats) -> Floats:
        """Return times relative to `zero_s`, limited to the encounter's start and end."""
        inside: Floats = np.clip(time_s, self.start_s, self.end_s) - self.zero_s
        return inside


@dataclass(frozen=True, slots=True)
class Aircraft:
    """One aircraft of a scene."""

    name: str
    rgb: tuple[int, int, int]
    offset_s: float = 0.0
    """Offset from its `now_s` to the common time line."""
    config: Config | None = None
    """Configuration from its record's header; None if unknown."""
    undulation_m: float = 0.0
    """Height of mean sea level above the ellipsoid."""

    @property
    def avoidance(self) -> AvoidanceConfig:
        """Avoidance configuration; the defaults if it is unknown."""
        return _DEFAULT if self.config is None else self.config.avoidance


@dataclass(frozen=True, slots=True)
class Scene:
    """One run, as far as it is known before its first step is written."""

    origin: Vec3
    """lat_deg, lon_deg, alt_msl_m of the frame in which everything is drawn."""
    aircraft: tuple[Aircraft, ...]
    encounter: Encounter | None = None
    root: str = ""
    """Entity path that contains the run's entities."""
    name: str = ""
    """Name of the run if it is one of several. The names of its lines begin with it."""
    span_s: tuple[float, float] | None = None
    """First and last time of the run; None while it is in progress."""

    def piece(self, time_s: float) -> tuple[int, bool]:
        """Return the piece of the time line for a time: its number, and whether it is in the encounter."""
        one = self.encounter
        return math.floor(time_s / PIECE_S), one is not None and one.start_s <= time_s <= one.end_s

    def pieces(self, time_s: Floats) -> list[slice]:
        """Return slices of the rows, one for each piece."""
        if not len(time_s):
            return []
        one = self.encounter
        key = 2.0 * np.floor(time_s / PIECE_S)
        if one is not None:
            key += (time_s >= one.start_s) & (time_s <= one.end_s)
        edges = [0, *(np.flatnonzero(np.diff(key)) + 1).tolist(), len(time_s)]
        return [slice(a, b) for a, b in itertools.pairwise(edges)]


def first_encounter(conflicts_s: Floats, closest: Separation | None) -> Encounter | None:
    """Return the first conflict and all that follow it closely; without conflicts, the closest approach.

    Args:
        conflicts_s: (n,) times at which any aircraft was in conflict, on the common time line, in any order.
        closest: The pair that came closest.
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
