"""Intruders that fly a mission and avoid nobody: the kinds `survey`, `shuttle`, `orbit` and `stop-and-go`.

Each sends its state like all aircraft. At the middle of the flight, its level path passes the mean position
of the other aircraft within `PASS_M`. It is then in the middle of its mission.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from companion.arrays import Bools, Floats

PASS_M: Final = 5.0
"""Largest distance, at the middle of the flight, between the intruder and the mean position of the others."""
_ORBIT_STEP_RAD: Final = math.radians(15.0)
_ORDER: Final = 10
"""Number that separates this stream of random draws from the others of a seed."""

Legs = list[tuple[float, float, float]]
"""Time (s), north and east (m) of the corners of a path, from its beginning on."""
Mission = Callable[[np.random.Generator, float], Legs]
"""Draws a path that lasts at least the given number of seconds, with its axis to the north."""


def _survey(rng: np.random.Generator, lasts_s: float) -> Legs:
    """Parallel lanes, flown back and forth: legs of 40 to 120 m, 10 to 30 m apart, at 2.5 to 6 m/s."""
    speed, leg, apart = rng.uniform(2.5, 6.0), rng.uniform(40.0, 120.0), rng.uniform(10.0, 30.0)
    legs: Legs = [(0.0, 0.0, 0.0)]
    while legs[-1][0] < lasts_s:
        t, north, east = legs[-1]
        if len(legs) % 2:
            legs.append((t + leg / speed, leg - north, east))
        else:
            legs.append((t + apart / speed, north, east + apart))
    return legs


def _shuttle(rng: np.random.Generator, lasts_s: float) -> Legs:
    """Back and forth along one leg of 30 to 120 m, at 2.5 to 6 m/s."""
    speed, leg = rng.uniform(2.5, 6.0), rng.uniform(30.0, 120.0)
    number = math.ceil(lasts_s * speed / leg) + 1
    return [(i * leg / speed, leg * (i % 2), 0.0) for i in range(number)]


def _orbit(rng: np.random.Generator, lasts_s: float) -> Legs:
    """Around one place: a radius of 10 to 40 m, at 2 to 5 m/s, in either direction."""
    speed, radius, way = rng.uniform(2.0, 5.0), rng.uniform(10.0, 40.0), rng.choice([-1.0, 1.0])
    step_s = _ORBIT_STEP_RAD * radius / speed
    number = math.ceil(lasts_s / step_s) + 1
    turns = [way * _ORBIT_STEP_RAD * i for i in range(number)]
    return [(i * step_s, radius * math.cos(turn), radius * math.sin(turn)) for i, turn in enumerate(turns)]


def _stop_and_go(rng: np.random.Generator, lasts_s: float) -> Legs:
    """Legs of 20 to 80 m at 3 to 8 m/s along one line, with a stop of 3 to 12 s after each."""
    speed = rng.uniform(3.0, 8.0)
    legs: Legs = [(0.0, 0.0, 0.0)]
    while legs[-1][0] < lasts_s:
        t, north, east = legs[-1]
        leg, stop_s = rng.uniform(20.0, 80.0), rng.uniform(3.0, 12.0)
        legs.append((t + leg / speed, north + leg, east))
        legs.append((t + leg / speed + stop_s, north + leg, east))
    return legs


MISSIONS: Final[dict[str, Mission]] = {
    "survey": _survey,
    "shuttle": _shuttle,
    "orbit": _orbit,
    "stop-and-go": _stop_and_go,
}


def flown(name: str, times: Floats, points: Floats, on_mission: Bools, seed: int) -> tuple[Floats, Floats]:
    """The paths of a fleet in which some aircraft fly missions instead of their own paths.

    Args:
        name: a key of `MISSIONS`.
        times, points: shapes (A, K) and (A, K, 3): paths of the fleet, NED, from `generators.draw`.
        on_mission: shape (A,): which aircraft fly missions.

    Returns:
        Times (A, L) and points (A, L, 3). Paths with fewer corners get additional points on their straight
        parts.
    """
    start_s, end_s = float(times.min()), float(times.max())
    middle_s = 0.5 * (start_s + end_s)
    others = ~on_mission if not on_mission.all() else on_mission
    place = np.mean(
        [
            [np.interp(middle_s, t, p[:, c]) for c in range(3)]
            for t, p in zip(times[others], points[others], strict=True)
        ],
        axis=0,
    )
    paths = [
        _path(name, np.random.default_rng([seed, _ORDER, i]), start_s, end_s, place)
        if on_mission[i]
        else (times[i], points[i])
        for i in range(len(times))
    ]
    most = max(len(t) for t, _ in paths)
    filled = [_with_points(t, p, most) for t, p in paths]
    return np.stack([t for t, _ in filled]), np.stack([p for _, p in filled])


def _path(
    name: str, rng: np.random.Generator, start_s: float, end_s: float, place: Floats
) -> tuple[Floats, Floats]:
    """One intruder's path from start to end, turned to a random heading."""
    lasts_s = end_s - start_s
    # Twice as long as the flight, so that the flight can begin anywhere in the first half of it.
    t, north, east = np.array(MISSIONS[name](rng, 2.0 * lasts_s)).T
    from_s = rng.uniform(0.0, lasts_s)
    inner = (t > from_s) & (t < from_s + lasts_s)
    at = np.concatenate([[from_s], t[inner], [from_s + lasts_s]])
    heading = rng.uniform(0.0, 2.0 * math.pi)
    cosine, sine = math.cos(heading), math.sin(heading)
    n, e = np.interp(at, t, north), np.interp(at, t, east)
    points = np.column_stack([cosine * n - sine * e, sine * n + cosine * e, np.zeros(len(at))])
    middle = [np.interp(from_s + 0.5 * lasts_s, at, points[:, c]) for c in range(3)]
    bearing, miss = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.0, PASS_M)
    aside = np.array([miss * math.cos(bearing), miss * math.sin(bearing), 0.0])
    times = at - from_s + start_s
    times[-1] = end_s
    return times, np.asarray(points - middle + place + aside, np.float64)


def _with_points(times: Floats, points: Floats, number: int) -> tuple[Floats, Floats]:
    """The same path with the given number of points: the longest part (by time) is halved repeatedly."""
    at = times.tolist()
    while len(at) < number:
        longest = int(np.argmax(np.diff(at)))
        at.insert(longest + 1, 0.5 * (at[longest] + at[longest + 1]))
    every = np.array(at)
    filled = np.column_stack([np.interp(every, times, points[:, c]) for c in range(3)])
    return every, filled
