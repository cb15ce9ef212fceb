"""Short encounters for campaigns: a few aircraft that turn towards one place and reach it together.

Each aircraft flies at constant speed and turns once, 4 to 9 s before the crossing. All pass within a ball of
3 m at 15 s, so without avoidance every pair comes within 6 m of each other. The first legs do not point at
the crossing. A single encounter has no other aircraft on the air (sparse). Many encounters can also share one
air, side by side (dense). Each then has a cell and a height of its own, so that the others only load the
radio band. Their companions choose transports in the same way.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from companion.arrays import Floats

CROSSING_S: Final = 15.0
END_S: Final = 26.0
BALL_M: Final = 3.0
SPEED_MPS: Final = (3.0, 7.0)
MAX_TURN_DEG: Final = 60.0
TURN_BEFORE_S: Final = (4.0, 9.0)
CLIMB_MPS: Final = 0.5
AIRCRAFT: Final = (2, 4)
APART_M: Final = 40.0
"""Least distance between aircraft at the beginning and at the end."""
HEIGHT_M: Final = 60.0
CELL_M: Final = 250.0
"""Side of a cell. Start points lie up to 105 m from its centre, so that neighbours are 40 m apart."""
LAYER_M: Final = 40.0
CELLS_A_LAYER: Final = 4
MAX_SIDE_BY_SIDE: Final = 32
_MOST_DRAWS: Final = 1_000


def converging(seed: int) -> tuple[Floats, ...]:
    """One encounter around (0, 0), 60 m above the ground. The same seed gives the same paths.

    Returns:
        For each of 2 to 4 aircraft an array of shape (4, 4): rows of time (s), north, east, down (m) at the
        beginning, the turn, the crossing and the end.
    """
    rng = np.random.default_rng([15, seed])
    count = int(rng.integers(AIRCRAFT[0], AIRCRAFT[1] + 1))
    for _ in range(_MOST_DRAWS):
        rows = tuple(_path(rng) for _ in range(count))
        if all(_least_distance(np.stack([row[at, 1:] for row in rows])) > APART_M for at in (0, -1)):
            return rows
    raise AssertionError(
        f"found no start positions {APART_M:g} m apart for {count} aircraft"
    )  # practically impossible


def side_by_side(seeds: tuple[int, ...]) -> tuple[tuple[Floats, ...], ...]:
    """Encounters of several seeds in one air: four to a layer of 500 m by 500 m, layers 40 m apart.

    Returns:
        The paths of each encounter, as from `converging`, moved to its cell.

    Raises:
        ValueError: no seed, or more than `MAX_SIDE_BY_SIDE`.
    """
    if not 1 <= len(seeds) <= MAX_SIDE_BY_SIDE:
        raise ValueError(f"{len(seeds)} encounters side by side; allowed: 1 to {MAX_SIDE_BY_SIDE}")
    found = []
    for number, seed in enumerate(seeds):
        layer, cell = divmod(number, CELLS_A_LAYER)
        shift = np.array([0.0, CELL_M * (cell // 2), CELL_M * (cell % 2), -LAYER_M * layer])
        found.append(tuple(rows + shift for rows in converging(seed)))
    return tuple(found)


def _path(rng: np.random.Generator) -> Floats:
    """One aircraft's path, computed backwards and forwards from its crossing point."""
    direction = rng.normal(size=3)
    direction *= BALL_M * rng.uniform() ** (1.0 / 3.0) / np.linalg.norm(direction)
    crossing = direction + np.array([0.0, 0.0, -HEIGHT_M])
    speed = rng.uniform(*SPEED_MPS)
    heading = rng.uniform(0.0, 2.0 * math.pi)
    before = heading + math.radians(rng.uniform(-MAX_TURN_DEG, MAX_TURN_DEG))
    turn_s = CROSSING_S - rng.uniform(*TURN_BEFORE_S)
    climb = rng.uniform(-CLIMB_MPS, CLIMB_MPS)
    second = np.array([speed * math.cos(heading), speed * math.sin(heading), -climb])
    first = np.array([speed * math.cos(before), speed * math.sin(before), -climb])
    turn = crossing - second * (CROSSING_S - turn_s)
    points = np.stack([turn - first * turn_s, turn, crossing, crossing + second * (END_S - CROSSING_S)])
    return np.column_stack([np.array([0.0, turn_s, CROSSING_S, END_S]), points])


def _least_distance(points: Floats) -> float:
    gaps = np.linalg.norm(points[:, None] - points[None], axis=2)
    return float(gaps[np.triu_indices(len(points), 1)].min())
