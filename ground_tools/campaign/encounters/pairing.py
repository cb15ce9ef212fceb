"""Places a track so that it meets our own aircraft: one encounter, with its importance weight.

Both aircraft move independently of each other until one avoids (an uncorrelated encounter). `CONFLICT_S`
after the beginning the crewed aircraft passes ours within a window: the offset to the side is uniform,
perpendicular to the relative motion; the offset in height follows from the track and the layer. Draws that
violate the conditions are repeated as a whole. The method is that of em-pairing-geospatial and
em-pairing-uncor-importancesampling of MIT Lincoln Laboratory (BSD 2-Clause, X11).

The number of aircraft that pass the window is proportional to their relative speed. The relative heading is
drawn in proportion to the relative speed, so the weight of an encounter is the mean of the relative speed
over all headings (as in `initializeUncorrelatedEncounter.m`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.arrays import Floats
from ground_tools.campaign.encounters.model import LAYER, Model
from ground_tools.campaign.encounters.sampling import FOOT_M, Course, Track, draw_course, integrated
from ground_tools.campaign.encounters.volumes import Volume

CONFLICT_S: Final = 180
"""Time from the beginning until the crewed aircraft passes the window."""
DURATION_S: Final = 240
BEYOND_S: Final = 60.0
APART_M: Final = 1000.0
"""Least horizontal distance at the beginning. It is larger than any volume that the law keeps clear or that
is evaluated, so that no encounter begins inside."""
OWN_HEIGHT_M: Final = (60.0, 110.0)
"""Height of our own aircraft above ground."""
_HEADINGS: Final = 360
"""Number of headings over which the relative speed is averaged."""
_MOST_TRIES: Final = 20_000


@dataclass(frozen=True, slots=True)
class Encounter:
    """One drawn encounter. NED; the ground is at down = 0."""

    weight: float
    """Importance weight, m/s."""
    own_times_s: Floats
    """(2,): beginning and end of our own path, s. They are `BEYOND_S` before and after those of the
    encounter, so that our aircraft neither starts nor stops in it."""
    own_points: Floats
    """(2, 3): points of our own straight path at these times, m."""
    position: Floats
    """(N + 1, 3): track of the crewed aircraft, one row for each step, m."""
    velocity: Floats
    """(N + 1, 3): its velocity, m/s."""


def draw(rng: np.random.Generator, model: Model, own_mps: float, window: Volume, step_s: float) -> Encounter:
    """Draw an encounter.

    Args:
        own_mps: speed of our own aircraft over ground; 0: it hovers.
        window: distances to the side and in height within which the crewed aircraft passes.
        step_s: time between two rows of the track.

    Raises:
        ValueError: the model has no counts for a required combination, or its tracks hardly ever meet the
            conditions.
    """
    for _ in range(_MOST_TRIES):
        course = draw_course(rng, model, DURATION_S)
        found = None if course is None else _placed(rng, model, course, (own_mps, window, step_s))
        if found is not None:
            return found
    raise ValueError(f"the model {model.name} hardly ever flies at the height of our own aircraft")


def _placed(
    rng: np.random.Generator, model: Model, course: Course, wanted: tuple[float, Volume, float]
) -> Encounter | None:
    """The encounter of a course; None if the course violates the conditions.

    Args:
        wanted: `own_mps`, `window` and `step_s` of `draw`.
    """
    own_mps, window, step_s = wanted
    layers = [edge * FOOT_M for edge in model.bounds(LAYER)]
    own_height, start = rng.uniform(*OWN_HEIGHT_M), rng.uniform(layers[0], layers[1])
    heights = start + np.append(0.0, np.cumsum(course.rates[:, 1]))
    height = float(heights[CONFLICT_S])
    passed = abs(height - own_height) <= window.height_m
    if not passed or heights.min() < layers[0] or heights.max() > layers[-1]:
        return None
    track, at = integrated(course, step_s), round(CONFLICT_S / step_s)
    own_heading = rng.uniform(0.0, 2.0 * math.pi)
    own_way = own_mps * np.array([math.cos(own_heading), math.sin(own_heading), 0.0])
    heading, weight = _heading(rng, track.velocity[at], own_way)
    position, velocity = _turned(track, at, heading)
    relative = velocity[at, :2] - own_way[:2]
    speed = math.hypot(*relative)
    if speed == 0.0:
        return None
    aside = rng.uniform(-window.aside_m, window.aside_m)
    place = aside / speed * np.array([-relative[1], relative[0]])
    position = position - position[at] + np.append(place, -height)
    if math.hypot(*(position[0, :2] + CONFLICT_S * own_way[:2])) < APART_M:
        return None
    own_times = np.array([-BEYOND_S, DURATION_S + BEYOND_S])
    own_points = (own_times[:, None] - CONFLICT_S) * own_way - [0.0, 0.0, own_height]
    return Encounter(weight, own_times, own_points, position, velocity)


def _heading(rng: np.random.Generator, velocity: Floats, own: Floats) -> tuple[float, float]:
    """A heading of the crewed aircraft, drawn in proportion to the relative speed, and the mean of the
    relative speed over all headings.

    Args:
        velocity, own: velocities, NED; of the first only the size of its horizontal part counts.
    """
    level = math.hypot(velocity[0], velocity[1])

    def relative(heading: float) -> float:
        n, e = level * math.cos(heading) - own[0], level * math.sin(heading) - own[1]
        return math.hypot(n, e, velocity[2] - own[2])

    mean = sum(relative(i * 2.0 * math.pi / _HEADINGS) for i in range(_HEADINGS)) / _HEADINGS
    most = math.hypot(level + math.hypot(own[0], own[1]), velocity[2] - own[2])
    while True:
        heading = rng.uniform(0.0, 2.0 * math.pi)
        if rng.random() * most <= relative(heading):
            return heading, mean


def _turned(track: Track, at: int, heading: float) -> tuple[Floats, Floats]:
    """Positions and velocities of a track, turned so that it has a heading at a row."""
    n, e = track.velocity[at, :2].tolist()
    turn = heading - math.atan2(e, n)
    c, s = math.cos(turn), math.sin(turn)
    matrix = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return track.position @ matrix.T, track.velocity @ matrix.T
