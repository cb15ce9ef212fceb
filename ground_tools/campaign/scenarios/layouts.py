"""Scenarios of everyday traffic: timed paths in local NED, drawn from a seed.

As in `generators`, a fleet meets around (0, 0), 100 m above the ground, at `MEETING_S`. Here aircraft begin,
end or fly nearer to each other than in `generators`, or stop at separate places. A path that ends at a place
stays there until `END_S`, so that a flight shows whether everybody arrives.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.arrays import AnyFloats, Floats
from ground_tools.campaign.generators import END_S, HEIGHT_M, MEETING_S

_ORDER: Final = 100
"""First number in the seeds of the random draws of these generators."""
_SLOW, _FAST = 0.5, 0.75
_JITTER_M: Final = 1.0
"""Largest offset of a path from its exact place, along each axis."""
_TRAIL_M: Final = 42.0
_RING_M: Final = 100.0
"""Distance from which aircraft approach their places."""

Way = tuple[AnyFloats, AnyFloats]
"""Times (A, K), s, and level points (A, K, 2), m. Heights are added if the points have no third column."""
Layout = Callable[[int, float, np.random.Generator], Way]
"""Takes the number of aircraft, the greatest speed (m/s) and a random generator."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """One scenario."""

    words: str
    """Description of the scenario."""
    aircraft: int
    """Number of aircraft with which the tables fly it."""
    layout: Layout


def draw(name: str, aircraft: int, speed_mps: float, seed: int) -> tuple[Floats, Floats]:
    """Draw one scenario; arguments and result are those of `generators.draw`.

    Raises:
        ValueError: the name is unknown, or there are too few aircraft.
    """
    if name not in SCENARIOS:
        raise ValueError(f"scenario {name!r} is unknown; allowed: {', '.join(SCENARIOS)}")
    if aircraft < 2:
        raise ValueError(f"{aircraft} aircraft: an encounter needs at least 2")
    rng = np.random.default_rng([_ORDER + list(SCENARIOS).index(name), aircraft, seed])
    times, ways = SCENARIOS[name].layout(aircraft, speed_mps, rng)
    turn = rng.uniform(0.0, 2.0 * math.pi)
    cosine, sine = math.cos(turn), math.sin(turn)
    n, e = ways[:, :, 0], ways[:, :, 1]
    down = ways[:, :, 2] if ways.shape[2] == 3 else np.zeros(n.shape)
    points = np.stack([cosine * n - sine * e, sine * n + cosine * e, down - HEIGHT_M], axis=2)
    points = points + rng.uniform(-_JITTER_M, _JITTER_M, (aircraft, 1, 3))
    return np.array(times, np.float64), np.array(points, np.float64)


def _speed(most: float, rng: np.random.Generator) -> float:
    return float(most * rng.uniform(_SLOW, _FAST))


def _straight(heading: AnyFloats, place: AnyFloats, speed: float) -> Way:
    """Straight paths that pass the given place (A, 2 or 3) of each aircraft at the meeting time."""
    way = np.zeros(place.shape)
    way[:, 0], way[:, 1] = speed * np.cos(heading), speed * np.sin(heading)
    times = np.tile([0.0, END_S], (len(heading), 1))
    return times, np.stack([place - MEETING_S * way, place + (END_S - MEETING_S) * way], axis=1)


def _lanes(apart_m: float) -> Layout:
    """Two opposite lanes; each aircraft has the oncoming lane on its right."""

    def layout(aircraft: int, most: float, rng: np.random.Generator) -> Way:
        number, lane = np.arange(aircraft) // 2, np.arange(aircraft) % 2
        place = np.zeros((aircraft, 2))
        place[:, 0] = (number - number.max() / 2.0) * _TRAIL_M * np.where(lane, -1.0, 1.0)
        place[:, 1] = lane * apart_m
        return _straight(math.pi * lane, place, _speed(most, rng))

    return layout


def _formation(apart_m: float, axis: int) -> Layout:
    """A formation in one direction, side by side (axis 1) or stacked (axis 2)."""

    def layout(aircraft: int, most: float, rng: np.random.Generator) -> Way:
        place = np.zeros((aircraft, 3))
        place[:, axis] = (np.arange(aircraft) - (aircraft - 1) / 2.0) * apart_m
        return _straight(np.zeros(aircraft), place, _speed(most, rng))

    return layout


def _arriving(starts: AnyFloats, ends: AnyFloats, speed: float, after_s: AnyFloats, via: bool) -> Way:
    """Paths from each start to an end, where the aircraft stays; via (0, 0) if `via`.

    Args:
        after_s: time of each departure.
    """
    fixes = [starts, np.zeros(starts.shape), ends] if via else [starts, 0.5 * (starts + ends), ends]
    legs = np.linalg.norm(np.diff(np.stack(fixes, axis=1), axis=1), axis=2) / speed
    at = after_s[:, None] + np.cumsum(np.column_stack([np.zeros(len(starts)), legs]), axis=1)
    # The aircraft stands at its start before its departure, and at its end after its arrival.
    points = np.stack([starts, *fixes, ends], axis=1)
    times = np.column_stack([np.full(len(starts), -1.0), at, np.full(len(starts), END_S)])
    return times, points


def _parking(aircraft: int, most: float, rng: np.random.Generator) -> Way:
    """Aircraft come from all sides to places in a row, 15 m apart, where all arrive at the same time."""
    speed = _speed(most, rng)
    bearing = 2.0 * math.pi * (np.arange(aircraft) + rng.uniform()) / aircraft
    starts = _RING_M * np.column_stack([np.cos(bearing), np.sin(bearing)])
    ends = np.zeros((aircraft, 2))
    # Each aircraft flies to the place on its own side, so that paths do not cross.
    ends[np.argsort(starts[:, 1]), 1] = (np.arange(aircraft) - (aircraft - 1) / 2.0) * 15.0
    needs_s = np.linalg.norm(ends - starts, axis=1) / speed
    return _arriving(starts, ends, speed, needs_s.max() - needs_s, via=False)


def _landing(aircraft: int, most: float, rng: np.random.Generator, ends: AnyFloats) -> Way:
    """Aircraft come from an arc of 90 degrees over one fix, 2 s apart, and fly from there to separate
    places."""
    speed = _speed(most, rng)
    bearing = math.pi + 0.5 * math.pi * ((np.arange(aircraft) + 0.5) / aircraft - 0.5)
    far = _RING_M + rng.permutation(aircraft) * 2.0 * speed
    starts = far[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    return _arriving(starts, ends[rng.permutation(aircraft)], speed, np.zeros(aircraft), via=True)


def _landing_ring(aircraft: int, most: float, rng: np.random.Generator) -> Way:
    """A landing queue: pads in a ring around the fix, 20 m apart."""
    bearing = 2.0 * math.pi * (np.arange(aircraft) + 0.5) / aircraft
    radius = 10.0 / math.sin(math.pi / aircraft)
    return _landing(aircraft, most, rng, radius * np.column_stack([np.cos(bearing), np.sin(bearing)]))


def _landing_row(aircraft: int, most: float, rng: np.random.Generator) -> Way:
    """A landing queue: pads in a row behind the fix, 20 m apart."""
    ends = np.column_stack([20.0 * (1.0 + np.arange(aircraft)), np.zeros(aircraft)])
    return _landing(aircraft, most, rng, ends)


def _merge(aircraft: int, most: float, rng: np.random.Generator) -> Way:
    """Two streams, 60 degrees apart, merge into one lane, in which the plan keeps aircraft 2 s apart."""
    speed = _speed(most, rng)
    side = np.where(np.arange(aircraft) % 2, 1.0, -1.0) * math.radians(30.0)
    merge_s = MEETING_S / 2.0 + 2.0 * np.arange(aircraft)
    back = np.column_stack([-np.cos(side), np.sin(side)]) * speed
    starts, fix = back * merge_s[:, None], np.zeros((aircraft, 2))
    ends = np.column_stack([(END_S - merge_s) * speed, np.zeros(aircraft)])
    times = np.column_stack([np.zeros(aircraft), merge_s, np.full(aircraft, END_S)])
    return times, np.stack([starts, fix, ends], axis=1)


def _turns_back(aircraft: int, most: float, rng: np.random.Generator) -> Way:
    """A column in trail, 30 m apart, whose first aircraft turns back along the line of the others."""
    speed = _speed(most, rng)
    begin = -30.0 * np.arange(aircraft) - MEETING_S / 2.0 * speed
    place = np.zeros((aircraft, 3, 2))
    place[:, 0, 0], place[:, 1, 0] = begin, begin + MEETING_S / 2.0 * speed
    onward = np.where(np.arange(aircraft) == 0, -1.0, 1.0)
    place[:, 2, 0] = place[:, 1, 0] + onward * (END_S - MEETING_S / 2.0) * speed
    return np.tile([0.0, MEETING_S / 2.0, END_S], (aircraft, 1)), place


def _dense(aircraft: int, most: float, rng: np.random.Generator) -> Way:
    """Straight paths between random places at least 20 m apart in a square of 200 m, flown at the same
    time."""
    speed = _speed(most, rng)
    starts, ends = (_places(aircraft, rng) for _ in range(2))
    return _arriving(starts, ends, speed, np.full(aircraft, 20.0), via=False)


def _places(number: int, rng: np.random.Generator) -> AnyFloats:
    found: list[AnyFloats] = []
    while len(found) < number:
        place = rng.uniform(-100.0, 100.0, 2)
        if all(np.linalg.norm(place - other) >= 20.0 for other in found):
            found.append(place)
    return np.array(found)


def _cruise(aircraft: int, most: float, rng: np.random.Generator) -> Way:
    """Straight, level paths through one place, from random sides, at half of the greatest speed."""
    heading = rng.uniform(0.0, 2.0 * math.pi, aircraft)
    return _straight(heading, np.zeros((aircraft, 2)), 0.5 * most)


SCENARIOS: Final[dict[str, Scenario]] = {
    "lanes-15": Scenario("opposite lanes 15 m apart, the oncoming one to the right", 6, _lanes(15.0)),
    "lanes-20": Scenario("opposite lanes 20 m apart, the oncoming one to the right", 6, _lanes(20.0)),
    "abreast-25": Scenario("a formation side by side, 25 m apart", 5, _formation(25.0, 1)),
    "stacked-25": Scenario("a formation stacked, 25 m apart", 5, _formation(25.0, 2)),
    "parking": Scenario("from all sides to places in a row, 15 m apart", 5, _parking),
    "landing-ring": Scenario("a landing queue to pads in a ring, 20 m apart", 5, _landing_ring),
    "landing-row": Scenario("a landing queue to pads in a row, 20 m apart", 5, _landing_row),
    "merge": Scenario("two streams merge into one lane, planned 2 s apart", 5, _merge),
    "turns-back": Scenario("the first of a column turns back along it", 3, _turns_back),
    "dense": Scenario("random straight paths in a square of 200 m", 30, _dense),
    "cruise": Scenario("straight paths through one place at half of the greatest speed", 2, _cruise),
}
