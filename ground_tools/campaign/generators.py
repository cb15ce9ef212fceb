"""Encounter generators: timed straight paths in local NED, drawn from a seed.

Each generator draws a fleet that meets around (0, 0), 100 m above the ground, at `MEETING_S`. Flown as
planned, nearly every draw loses separation. Planned speeds are 0.5 to 0.75 of the greatest speed, because an
aircraft without a reserve of speed cannot catch up with a timed path. The exceptions are S1 to S3, which are
those of `sitl_mocks.encounters.scenario`. A draw in which two aircraft begin or end nearer than `APART_M` is
repeated.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, cast, get_args

import numpy as np

from companion.arrays import AnyFloats, Floats
from sitl_mocks.encounters.scenario import Kind, encounter

MEETING_S: Final = 120.0
END_S: Final = 240.0
HEIGHT_M: Final = 100.0
APART_M: Final = 40.0
LIFT_M: Final = 25.0
"""Height difference between the beginning of a lift and the meeting point."""
_SLOW, _FAST = 0.5, 0.75
"""Planned speeds, as fractions of the greatest speed."""
_MISS_M = 5.0
"""Largest offset from the exact meeting point along north and east; half of it in height."""
_IN_TRAIL_S = 15.0
_MOST_DRAWS = 1_000

Drawn = tuple[AnyFloats, AnyFloats, AnyFloats]
"""Positions at the meeting time (A, 3), headings (A,) and speeds (A,)."""
Generator = Callable[[int, float, np.random.Generator], Drawn]
"""Takes the number of aircraft, the greatest speed (m/s) and a random generator."""


def draw(name: str, aircraft: int, speed_mps: float, seed: int) -> tuple[Floats, Floats]:
    """Draw one encounter. The same arguments give the same paths.

    Args:
        name: one of `NAMES`.
        aircraft: number of aircraft, at least 2.
        speed_mps: greatest speed of each aircraft; S1 to S3 need at least 5.

    Returns:
        Times (A, K) in s and waypoints (A, K, 3), NED, m.

    Raises:
        ValueError: the name is unknown, or there are too few aircraft, or more than fit `APART_M` apart.
    """
    if name in get_args(Kind):
        rows = np.array(encounter(cast(Kind, name), aircraft, seed))
        # The same paths at another speed: the scenario's times are for 5 m/s, so all are scaled.
        rows[:, :, 0] *= 5.0 / speed_mps
        return np.array(rows[:, :, 0], np.float64), np.array(rows[:, :, 1:], np.float64)
    if name not in _GENERATORS:
        raise ValueError(f"generator {name!r} is unknown; allowed: {', '.join(NAMES)}")
    if aircraft < 2:
        raise ValueError(f"{aircraft} aircraft: an encounter needs at least 2")
    number = list(_GENERATORS).index(name) + 10
    rng = np.random.default_rng([number, aircraft, seed])
    for _ in range(_MOST_DRAWS):
        place, heading, speed = _GENERATORS[name](aircraft, speed_mps, rng)
        way = speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading), np.zeros(aircraft)])
        if name == "lift":
            way[:, 2] = LIFT_M / MEETING_S * np.where(np.arange(aircraft) % 2, 1.0, -1.0)
        place = place + np.array([0.0, 0.0, -HEIGHT_M])
        begin, end = place - MEETING_S * way, place + (END_S - MEETING_S) * way
        if min(_least_distance(begin), _least_distance(end)) > APART_M:
            times = np.tile([0.0, END_S], (aircraft, 1))
            return times, np.array(np.stack([begin, end], axis=1), np.float64)
    raise ValueError(f"generator {name}: it cannot place {aircraft} aircraft at least {APART_M:g} m apart")


def _offsets(aircraft: int, rng: np.random.Generator) -> AnyFloats:
    return rng.uniform(-_MISS_M, _MISS_M, (aircraft, 3)) * [1.0, 1.0, 0.5]


def _speeds(aircraft: int, most: float, rng: np.random.Generator) -> AnyFloats:
    return most * rng.uniform(_SLOW, _FAST, aircraft)


def _along(heading: AnyFloats, distance: AnyFloats) -> AnyFloats:
    """Points (A, 3) at a distance (m) along a heading."""
    return np.column_stack([np.cos(heading) * distance, np.sin(heading) * distance, np.zeros(len(heading))])


def _in_trail(aircraft: int, sides: AnyFloats, most: float, rng: np.random.Generator) -> Drawn:
    """Streams of equal speed through the middle, in each of which the aircraft fly one behind the other.

    Args:
        sides: heading of each stream.
    """
    stream = np.arange(aircraft) % len(sides)
    heading = sides[stream]
    speed = _speeds(1, most, rng).repeat(aircraft)
    number = np.arange(aircraft) // len(sides)
    behind = (number - number.mean()) * max(_IN_TRAIL_S * speed[0], APART_M * 1.05)
    return _along(heading, -behind) + _offsets(aircraft, rng), heading, speed


def _head_on(aircraft: int, most: float, rng: np.random.Generator) -> Drawn:
    turn = rng.uniform(0.0, 2.0 * math.pi)
    return _in_trail(aircraft, np.array([turn, turn + math.pi]), most, rng)


def _crossing(aircraft: int, most: float, rng: np.random.Generator) -> Drawn:
    """Two lanes that cross at 30 to 150 degrees."""
    turn = rng.uniform(0.0, 2.0 * math.pi)
    between = rng.choice([-1.0, 1.0]) * rng.uniform(math.radians(30.0), math.radians(150.0))
    return _in_trail(aircraft, np.array([turn, turn + between]), most, rng)


def _streams(aircraft: int, most: float, rng: np.random.Generator) -> Drawn:
    """Four streams from four sides, 90 degrees apart."""
    turn = rng.uniform(0.0, 2.0 * math.pi)
    return _in_trail(aircraft, turn + 0.5 * math.pi * np.arange(4.0), most, rng)


def _overtaking(aircraft: int, most: float, rng: np.random.Generator) -> Drawn:
    """All aircraft fly in the same direction. Groups of up to five, each aircraft at its own speed, pass one
    place at the same time; the groups fly side by side."""
    turn = rng.uniform(0.0, 2.0 * math.pi)
    number, five = np.arange(aircraft) % 5, np.arange(aircraft) // 5
    speed = most * (0.25 + 0.5 * number / max(1, min(aircraft, 5) - 1))
    across = _along(np.full(aircraft, turn + math.pi / 2.0), five * 2.0 * APART_M)
    return across + _offsets(aircraft, rng), np.full(aircraft, turn), speed


def _circle(aircraft: int, most: float, rng: np.random.Generator) -> Drawn:
    """Every aircraft flies through the middle with a random heading and speed."""
    heading = rng.uniform(0.0, 2.0 * math.pi, aircraft)
    return _offsets(aircraft, rng), heading, _speeds(aircraft, most, rng)


def _mixed(aircraft: int, most: float, rng: np.random.Generator) -> Drawn:
    """As `_circle`, but with slow and fast aircraft: 0.1 to 0.75 of the greatest speed."""
    heading = rng.uniform(0.0, 2.0 * math.pi, aircraft)
    return _offsets(aircraft, rng), heading, most * rng.uniform(0.1, _FAST, aircraft)


def _lift(aircraft: int, most: float, rng: np.random.Generator) -> Drawn:
    """Pairs of aircraft exchange heights in columns that are side by side. No aircraft moves horizontally."""
    column = np.arange(aircraft) // 2
    across = _along(np.zeros(aircraft), column * APART_M * 1.3)
    return across + _offsets(aircraft, rng) * [1.0, 1.0, 0.0], np.zeros(aircraft), np.zeros(aircraft)


def _wall(aircraft: int, most: float, rng: np.random.Generator) -> Drawn:
    """One aircraft flies towards a row of all others, which fly side by side."""
    turn = rng.uniform(0.0, 2.0 * math.pi)
    heading = np.full(aircraft, turn + math.pi)
    heading[0] = turn
    across = np.zeros(aircraft)
    across[1:] = (np.arange(aircraft - 1) - (aircraft - 1) // 2) * APART_M * 1.3
    sideways = np.full(aircraft, turn + math.pi / 2.0)
    speed = _speeds(1, most, rng).repeat(aircraft)
    return _along(sideways, across) + _offsets(aircraft, rng), heading, speed


def _matrix(aircraft: int, most: float, rng: np.random.Generator) -> Drawn:
    """Two rows of aircraft side by side cross at right angles: each aircraft meets one of the other row."""
    turn = rng.uniform(0.0, 2.0 * math.pi)
    row = np.arange(aircraft) % 2
    heading = turn + 0.5 * math.pi * row
    number = np.arange(aircraft) // 2
    across = (number - number.max() / 2.0) * APART_M * 1.3
    speed = _speeds(1, most, rng).repeat(aircraft)
    return _along(heading + 0.5 * math.pi, across) + _offsets(aircraft, rng), heading, speed


def _funnel(aircraft: int, most: float, rng: np.random.Generator) -> Drawn:
    """Aircraft come from an arc (90 degrees, or 8 for each aircraft if that is more), pass one place shortly
    one after the other, and separate again."""
    turn = rng.uniform(0.0, 2.0 * math.pi)
    arc = math.radians(max(90.0, 8.0 * aircraft))
    heading = turn + arc * ((np.arange(aircraft) + 0.5) / aircraft - 0.5)
    speed = _speeds(1, most, rng).repeat(aircraft)
    behind = rng.permutation(aircraft) * 1.0 * speed
    return _along(heading, -behind + behind.mean()) + _offsets(aircraft, rng), heading, speed


def _random(aircraft: int, most: float, rng: np.random.Generator) -> Drawn:
    """Random positions in a box at the meeting time: 4,000 m^2 for each aircraft, 10 m high."""
    side = math.sqrt(4_000.0 * aircraft)
    place = rng.uniform(-0.5, 0.5, (aircraft, 3)) * [side, side, 10.0]
    return place, rng.uniform(0.0, 2.0 * math.pi, aircraft), _speeds(aircraft, most, rng)


_GENERATORS: Final[dict[str, Generator]] = {
    "head-on": _head_on,
    "crossing": _crossing,
    "overtaking": _overtaking,
    "circle": _circle,
    "wall": _wall,
    "matrix": _matrix,
    "funnel": _funnel,
    "streams": _streams,
    "random": _random,
    "mixed": _mixed,
    "lift": _lift,
}
NAMES: Final[tuple[str, ...]] = (*get_args(Kind), *_GENERATORS)


def _least_distance(points: AnyFloats) -> float:
    gaps = np.linalg.norm(points[:, None] - points[None], axis=2)
    return float(gaps[np.triu_indices(len(points), 1)].min())
