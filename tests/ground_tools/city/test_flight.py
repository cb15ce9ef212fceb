"""The city flies like the campaign: the same commands, bit for bit, and the same separations."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from companion.arrays import Floats
from companion.avoidance.law import settings_of
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from companion.errors import ConfigError
from ground_tools.campaign import flight, outcome, vehicles
from ground_tools.campaign.generators import draw
from ground_tools.campaign.world import World
from ground_tools.city.flights import Wish, flights_of
from ground_tools.city.loop import GIVEN
from ground_tools.city.measure import T_GAP_MOST, T_LEAST
from ground_tools.city.simulation import Result, Simulation

AVOIDANCE = AvoidanceConfig()
SPEED_MPS = 5.0
BEGIN_S, LENGTH_S = 95.0, 50.0
"""Part of an encounter that is flown; the aircraft meet at 120 s."""


def encounter(kind: str, seed: int) -> tuple[Floats, Floats]:
    """Five paths around their meeting, from 0 s."""
    times, points = draw(kind, 5, SPEED_MPS, seed)
    ways = (points[:, 1] - points[:, 0]) / (times[:, 1] - times[:, 0])[:, None]
    begin = points[:, 0] + BEGIN_S * ways
    cut = np.stack([begin, begin + LENGTH_S * ways], axis=1)
    return np.tile([0.0, LENGTH_S], (5, 1)), np.ascontiguousarray(cut)


def in_the_campaign(world: World, times: Floats, points: Floats, seed: int) -> tuple[Floats, Floats, float]:
    """Commands (decisions, 5, 3), the campaign's result and the least separation."""
    conditions = world.conditions(AVOIDANCE.period_s)
    limits = LimitsConfig(max_speed_mps=SPEED_MPS)
    settings = np.array(
        [
            settings_of(AVOIDANCE, limits, Trajectory(t.tolist(), p.tolist()))
            for t, p in zip(times, points, strict=True)
        ]
    )
    log = outcome.new_log(5, round(world.end_s / AVOIDANCE.period_s))
    pairs, result = np.zeros((5, 5, outcome.PAIR_ENTRIES)), np.zeros(outcome.FLIGHT_ENTRIES)
    flight.fly(
        np.random.default_rng(seed), conditions, times, points, np.zeros((0, 9)), settings,
        np.full(5, float(vehicles.AVOIDS)), np.zeros((0, 5, 3)), log, pairs, result,
    )  # fmt: skip
    return log.flown, result, float(result[outcome.F_SEPARATION])


def in_the_city(world: World, times: Floats, points: Floats, seed: int) -> tuple[Floats, Result]:
    """Commands (decisions, 5, 3) and result."""
    wishes = [Wish(0.0, t, p, SPEED_MPS) for t, p in zip(times, points, strict=True)]
    rng = np.random.default_rng(seed)
    city = Simulation(
        flights_of(wishes, AVOIDANCE), AVOIDANCE, world, GIVEN, np.array([5000.0, 0.0, 0.0]), rng, rng,
        slots=5, clear_m=0.0,
    )  # fmt: skip
    trace = np.zeros((round(world.end_s / AVOIDANCE.period_s), city.slots, 3))
    result = city.fly(world.end_s, trace)
    return trace[:, :5], result


@pytest.mark.parametrize(
    ("kind", "seed", "delay_s", "loss"), [("circle", 3, 0.5, 0.0), ("random", 5, 2.3, 0.3)]
)
def test_an_encounter_is_flown_as_in_the_campaign(kind: str, seed: int, delay_s: float, loss: float) -> None:
    times, points = encounter(kind, seed)
    world = msgspec.structs.replace(World(), end_s=LENGTH_S, delay_s=(delay_s, delay_s), loss=loss)

    commands, result, separation_m = in_the_campaign(world, times, points, seed)
    same, city = in_the_city(world, times, points, seed)

    assert np.array_equal(commands, same)
    assert len(np.unique(commands[:, 0, 0])) > 50  # the aircraft manoeuvres
    tally = city.state.tally.flights
    assert tally[:, T_LEAST].min() == separation_m
    assert tally[:, T_GAP_MOST].max() == result[outcome.F_DEVIATION]


def test_decisions_that_the_history_of_velocities_does_not_keep_are_refused() -> None:
    often = msgspec.structs.replace(AVOIDANCE, period_s=0.02)
    rng = np.random.default_rng(1)
    with pytest.raises(ConfigError, match=r"avoidance\.period_s: 0\.02; a city allows 0\.04 or more"):
        Simulation(
            flights_of([], often), often, msgspec.structs.replace(World(), step_s=0.02), GIVEN,
            np.array([5000.0, 0.0, 0.0]), rng, rng,
        )  # fmt: skip
