"""The links between all aircraft within reach, and what is carried over from one search to the next."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.arrays import Floats
from ground_tools.city.links import Grid
from ground_tools.city.tables import NOBODY, Air, Links, new_air

REACH_M = np.array([250.0, 900.0, 2200.0])


def check(links: Links, position: Floats, air: Air) -> dict[tuple[int, int], int]:
    """Each receiver's links are those of a search without a grid, in rising order of the senders. Returns the
    number of the link from each sender to each receiver."""
    numbers = {}
    for i in range(len(position)):
        away = np.linalg.norm(position - position[i], axis=1)
        near = (air.flight != NOBODY) & (away <= REACH_M.max()) & (np.arange(len(position)) != i)
        wanted = np.flatnonzero(near) if air.flight[i] != NOBODY else np.zeros(0, int)
        here = slice(links.start[i], links.start[i + 1])
        assert links.other[here].tolist() == wanted.tolist()
        modes = (away[wanted, None] <= REACH_M) @ np.array([1, 2, 4])
        assert links.modes[here].tolist() == modes.tolist()
        numbers.update({(i, int(j)): int(links.start[i]) + n for n, j in enumerate(wanted)})
    for (i, j), e in numbers.items():
        assert links.back[e] == numbers[j, i]
    return numbers


@pytest.mark.parametrize("slots", [1, 64, 150])
@pytest.mark.parametrize("middle", [(0.0, 0.0), (-9000.0, 5000.0), (5000.0, -9000.0)])
def test_links_are_found_and_carried_over(middle: tuple[float, float], slots: int) -> None:
    rng = np.random.default_rng(slots)
    air, grid = new_air(slots), Grid(slots, REACH_M, 2, 100.0)
    position = rng.uniform(-4000.0, 4000.0, (slots, 3)) * [1.0, 1.0, 0.01] + [*middle, 0.0]
    fresh = np.ones(slots, bool)
    before: dict[tuple[int, int], int] = {}
    links = grid.links
    for _ in range(4):
        old = links._replace(**{name: getattr(links, name).copy() for name in ("row", "due_s", "chance")})
        arrivals = links.arrival.copy()
        air.flight[:] = np.where(rng.random(slots) < 0.8, np.arange(slots), NOBODY)
        position += rng.normal(0.0, 300.0, (slots, 3)) * [1.0, 1.0, 0.01]
        links = grid.find(position, air, fresh)
        numbers = check(links, position, air)
        for (i, j), e in numbers.items():
            at = before.get((i, j)) if not fresh[i] and not fresh[j] else None
            assert links.row[e] == (NOBODY if at is None else old.row[at])
            assert links.due_s[e] == (math.inf if at is None else old.due_s[at])
            assert links.arrival[e].tolist() == ([math.inf] * 2 if at is None else arrivals[at].tolist())
            assert links.chance[e].tolist() == ([0.0] * 3 if at is None else old.chance[at].tolist())
            links.row[e], links.due_s[e] = rng.integers(100), rng.random()
            links.arrival[e], links.chance[e] = rng.random(2), rng.random(3)
        before, fresh = numbers, rng.random(slots) < 0.1
    assert slots < 100 or len(before) > 1000
