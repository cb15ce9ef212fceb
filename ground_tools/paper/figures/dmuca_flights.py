"""Flights of five aircraft as in the paper's section V, by each law with each delay; separation of each pair.

In the paper all aircraft converge inside a box of 500 m x 500 m x 300 m at 250 s; it gives no paths.
Crossing points anywhere in that box hardly ever conflict (`conflicts_in_the_box`), so S2 of
`sitl_mocks.encounters.scenario` is flown.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

import msgspec
import numpy as np

from companion.arrays import Floats
from companion.avoidance.kernels import NO_WALLS
from companion.avoidance.law import settings_of
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from ground_tools.campaign import flight, outcome, vehicles
from ground_tools.campaign.cells import LAWS, SEPARATION_M, WORLDS, Law
from ground_tools.campaign.world import World
from sitl_mocks.encounters.scenario import DURATION_S, Kind, encounter

Air = Literal["exact", "noisy"]

AIRCRAFT: Final = 5
PAIRS: Final = tuple(itertools.combinations(range(AIRCRAFT), 2))
SPEED_MPS: Final = 5.0
DELAYS_S: Final = ((0.0, 1.0), (1.0, 2.0), (2.0, 3.0))
IN: Final[dict[Air, World]] = {
    # The paper mentions no error of the sent values.
    "exact": World(sigma_m=0.0, sigma_mps=0.0, declared_m=0.0, quantised=False),
    "noisy": WORLDS["calm"],
}
MOST_FLIGHTS: Final = 200
"""Largest number of flights of each case, which takes a minute on one core. `ground-tools campaign` flies
thousands."""
BOX_M: Final = (500.0, 500.0, 300.0)
"""Size of the box in which the paper's aircraft converge."""


@dataclass(frozen=True, slots=True)
class Case:
    """Flights that differ only in their seeds."""

    law: Law
    delay_s: tuple[float, float]
    """Bounds of the message delay, drawn uniformly for every message."""
    air: Air


FLOWN_LAWS: Final[tuple[Law, ...]] = ("paper", "dmuca", "none")
CASES: Final = tuple(
    Case(law, delay_s, air)
    for air in IN
    for law in FLOWN_LAWS
    for delay_s in (DELAYS_S if law != "none" else DELAYS_S[:1])
)
"""All cases. The law "none" has only one delay, because the delay does not affect its flights."""
Table = dict[Case, Floats]
"""Least distances in m, shape (flights, pairs)."""


def fly(case: Case, seed: int) -> tuple[Floats, Floats]:
    """Fly one flight. If noisy, it equals that of the campaign's cell with the same law, delays and seed.

    Returns:
        Times in s, shape (steps,), and true positions, shape (steps, AIRCRAFT, 3), NED in m.
    """
    trace, _ = flown(LAWS[case.law], IN[case.air], case.delay_s, seed)
    return IN[case.air].step_s * np.arange(1.0, len(trace) + 1.0, dtype=np.float64), trace


def flown(
    avoidance: AvoidanceConfig,
    world: World,
    delay_s: tuple[float, float],
    seed: int,
    geometry: Kind = "S2",
) -> tuple[Floats, Floats]:
    """Fly one flight with any parameters of the law.

    Returns:
        True positions, shape (steps, AIRCRAFT, 3), NED in m, and the least distance of each pair, shape
        (pairs,), in the order of PAIRS, in m.
    """
    rows = np.array(encounter(geometry, AIRCRAFT, seed))
    times, points = np.ascontiguousarray(rows[:, :, 0]), np.ascontiguousarray(rows[:, :, 1:])
    limits = LimitsConfig(max_speed_mps=SPEED_MPS)
    paths = [Trajectory(t.tolist(), p.tolist()) for t, p in zip(times, points, strict=True)]
    world = msgspec.structs.replace(world, start_s=0.0, end_s=DURATION_S, delay_s=delay_s)
    trace = np.zeros((round(DURATION_S / world.step_s), AIRCRAFT, 3))
    pairs = np.zeros((AIRCRAFT, AIRCRAFT, outcome.PAIR_ENTRIES))
    flight.fly(
        np.random.default_rng([seed, 7]),
        world.conditions(avoidance.period_s),
        times,
        points,
        NO_WALLS,
        np.array([settings_of(avoidance, limits, path) for path in paths]),
        np.full(AIRCRAFT, float(vehicles.AVOIDS)),
        trace,
        outcome.new_log(AIRCRAFT),
        pairs,
        np.zeros(outcome.FLIGHT_ENTRIES),
    )
    first, second = np.triu_indices(AIRCRAFT, 1)  # in the order of PAIRS
    return trace, np.array(pairs[second, first, outcome.P_SEPARATION])


def gaps(places: Floats) -> Floats:
    """Vector from the first to the second aircraft of each pair, shape (steps, pairs, 3).

    Args:
        places: positions, shape (steps, aircraft, 3).
    """
    first, second = np.triu_indices(places.shape[1], 1)  # in the order of PAIRS
    return places[:, second] - places[:, first]


def least_distances(places: Floats) -> Floats:
    """Least distance of each pair, shape (pairs,), on straight lines between positions.

    Args:
        places: positions, shape (steps, aircraft, 3).
    """
    gap = gaps(places)
    begin, way = gap[:-1], np.diff(gap, axis=0)
    length2 = (way * way).sum(axis=2)
    along = -(begin * way).sum(axis=2) / np.where(length2 > 0.0, length2, 1.0)
    nearest = begin + np.clip(along, 0.0, 1.0)[:, :, None] * way
    return np.asarray(np.linalg.norm(nearest, axis=2).min(axis=0), dtype=np.float64)


def table_of(samples: int, seed: int, advance: Callable[[], None] = lambda: None) -> Table:
    """Fly all cases. The result is cached, so that picture and report share one set of flights.

    Args:
        samples: number of flights of each case; MOST_FLIGHTS at most are flown.
        seed: first seed. All cases use the same consecutive seeds.
        advance: called after each case.
    """
    flights = min(samples, MOST_FLIGHTS)
    table = {}
    for case in CASES:
        table[case] = _flown(case, flights, seed)
        advance()
    return table


@functools.lru_cache(maxsize=2 * len(CASES))
def _flown(case: Case, flights: int, seed: int) -> Floats:
    return np.array([least_distances(fly(case, one)[1]) for one in range(seed, seed + flights)])


def conflicts_in_the_box(flights: int, seed: int) -> int:
    """Number of draws that lose separation without avoidance, with crossing points anywhere in `BOX_M`.

    The paths are those of S2, each moved by a random offset within the box.
    """
    lost = 0
    for one in range(seed, seed + flights):
        points = np.array(encounter("S2", AIRCRAFT, one))[:, :, 1:]
        moved = np.random.default_rng([one, 8]).uniform(-0.5, 0.5, (AIRCRAFT, 1, 3)) * BOX_M
        lost += bool(least_distances((points + moved).transpose(1, 0, 2)).min() < SEPARATION_M)
    return lost
