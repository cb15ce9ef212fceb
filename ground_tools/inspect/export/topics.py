"""A run as messages with times and topics, for robotics tools: the content of MCAP files and ROS bags.

Positions are given twice: on Earth, and in a local frame with x to the east, y to the north and z up, whose
origin is that of the run. Heights on Earth are above the WGS84 ellipsoid if the aircraft's GNSS receiver
reported the distance of the ellipsoid from mean sea level, otherwise above mean sea level. The orientation is
the course over ground, because a record has no attitude.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from companion.arrays import Floats
from companion.geometry import Vec3
from ground_tools.inspect.export import tables
from ground_tools.inspect.read.flown import Flown, Path, Separation, gap_s, unbroken
from ground_tools.inspect.read.read_run import Run
from ground_tools.inspect.viewer.scene import Aircraft
from ground_tools.inspect.viewer.step_columns import StepColumns

MAP = "map"
"""Name of the local frame."""
SLOWEST_MPS = 0.5
"""Speed below which the course over ground is meaningless; the last course is kept."""
SEPARATION_PERIOD_S = 0.2
"""Least time between two separations of a pair."""
MOST_POINTS = 2000
"""Most points of the line of a path without gaps; each gap adds one at most."""
PIECE = 2000
"""Number of steps that are turned into texts at once."""


@dataclass(frozen=True, slots=True)
class Fix:
    """A position of an aircraft."""

    topic: str
    time_s: float
    """On the run's time line."""
    frame: str
    """Name of the frame that moves with the aircraft."""
    lat_deg: float
    lon_deg: float
    alt_m: float
    enu_m: Vec3
    """Position in the local frame."""
    yaw_rad: float
    """Course over ground, anticlockwise from east."""
    own: bool
    """True if this is what the aircraft itself flew, not what another one heard."""


@dataclass(frozen=True, slots=True)
class Words:
    """A message text about an event."""

    time_s: float
    level: str
    """INFO, WARN, ERROR or CRITICAL."""
    name: str
    """Name of the aircraft or, for a problem, of the run."""
    text: str


@dataclass(frozen=True, slots=True)
class Apart:
    """The separation of a pair at one time."""

    topic: str
    time_s: float
    pair: tuple[str, str]
    distance_m: float
    required_m: float


@dataclass(slots=True)
class Topics:
    """Names of topics and frames: letters, digits and underscores only, beginning with a letter."""

    _given: dict[str, str] = field(default_factory=dict)

    def frame(self, name: str) -> str:
        """The frame of an aircraft. Different aircraft get different ones."""
        if name not in self._given:
            plain = re.sub("[^A-Za-z0-9_]", "_", name) or "_"
            plain = plain if plain[0].isalpha() else f"a_{plain}"
            number, frame = 1, plain
            while frame in self._given.values():
                number += 1
                frame = f"{plain}_{number}"
            self._given[name] = frame
        return self._given[name]


def zero_ns(run: Run, ways: Flown) -> int:
    """Nanoseconds (Unix time) at the time line's zero. Without UTC the earliest record begins at 0."""
    if ways.utc_at_zero_s is not None:
        return round(ways.utc_at_zero_s * 1e9)
    return round(-min(one.facts.start_s + ways.offsets_s[one.name] for one in run.aircraft) * 1e9)


def fixes(run: Run, ways: Flown, topics: Topics) -> Iterator[Fix]:
    """Yield all positions, aircraft by aircraft: what it flew, its true positions if known, what it heard."""
    above_m = {one.name: one.facts.undulation_m for one in run.aircraft}
    yaw: dict[str, float] = {}
    for block in tables.tracks(run, ways):
        for row in zip(*(block[name] for name in tables.TRACK_COLUMNS), strict=True):
            _, name, source, by, time_s, lat, lon, alt, north, east, down, *speeds = row
            v_north, v_east = (float(speed) for speed in speeds[:2])
            frame, topic = topics.frame(name), f"/{topics.frame(name)}/fix"
            if source == "true":
                topic = f"/{frame}/true"
            elif source == "heard":
                topic = f"/{topics.frame(by)}/heard/{frame}"
                frame = f"{frame}_heard_by_{topics.frame(by)}"
            if math.hypot(v_north, v_east) > SLOWEST_MPS:
                yaw[topic] = math.atan2(v_north, v_east)
            yield Fix(
                topic,
                time_s,
                frame,
                lat,
                lon,
                alt + above_m.get(by or name, 0.0),
                (east, north, -down),
                yaw.get(topic, 0.0),
                source == "flown",
            )


def words(run: Run, ways: Flown) -> Iterator[Words]:
    """Yield the problems of the run, then events as texts: modes, arming, authority, alerts, texts, faults;
    aircraft by aircraft."""
    start_s = min(record.facts.start_s + ways.offsets_s[record.name] for record in run.aircraft)
    for problem in (*run.problems, *ways.problems):
        yield Words(start_s, "WARN", run.name, problem)
    for record in run.aircraft:
        config = record.header.config if record.header else None
        offset_s = ways.offsets_s[record.name]
        columns = StepColumns(
            Aircraft(record.name, (0, 0, 0), offset_s, config, record.facts.undulation_m), ways.origin
        )
        told: set[str] = set()
        steps = record.steps()
        while piece := list(itertools.islice(steps, PIECE)):
            found = columns.piece_of(piece)
            for note in found.notes:
                yield Words(note.time_s, note.level, record.name, note.text)
            for lane, states in found.states.items():
                # The notes contain every change, but not the initial state.
                if lane not in told and states[0][1]:
                    yield Words(states[0][0], "INFO", record.name, f"{lane}: {states[0][1]}")
                told.add(lane)


def separations(pairs: list[Separation], topics: Topics) -> Iterator[Apart]:
    """Yield the separations of all pairs, as far as they are known."""
    for pair in pairs:
        topic = f"/separation/{topics.frame(pair.first)}/{topics.frame(pair.second)}"
        last_s = -math.inf
        for time_s, distance_m in zip(pair.time_s.tolist(), pair.distance_m.tolist(), strict=True):
            if not math.isnan(distance_m) and time_s - last_s >= SEPARATION_PERIOD_S - 1e-6:
                last_s = time_s
                yield Apart(topic, time_s, (pair.first, pair.second), distance_m, pair.required_m)


def lines(path: Path) -> Iterator[tuple[float, Floats]]:
    """Yield a path in the spans without gaps: the time at which each begins, and about `MOST_POINTS` points
    in all, (n, 3), in the local frame."""
    step = max(math.ceil(len(path.time_s) / (MOST_POINTS - 1)), 1)
    for span in unbroken(path.time_s, gap_s(path.time_s)):
        flown = path.position_ned_m[span]
        kept = flown[np.unique([*range(0, len(flown), step), len(flown) - 1])]
        yield float(path.time_s[span.start]), np.column_stack([kept[:, 1], kept[:, 0], -kept[:, 2]])
