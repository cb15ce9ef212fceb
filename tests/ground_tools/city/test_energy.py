"""Energy of flights in a city: the power model, and what is charged to a flight and to its plan."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from companion.arrays import Floats
from companion.config import AvoidanceConfig
from ground_tools.campaign.world import World
from ground_tools.city.energy import WEIGHT_N, power_w
from ground_tools.city.flights import Wish, flights_of
from ground_tools.city.loop import GIVEN
from ground_tools.city.measure import T_ENDED, T_ENERGY, T_LATE, T_PLANNED, forget
from ground_tools.city.simulation import Simulation
from tests.ground_tools.city.test_flight import encounter

AVOIDANCE = AvoidanceConfig()


def flown(
    paths: list[tuple[Floats, Floats]], end_s: float, *, law: str = "dmuca", settle_s: float = 0.0
) -> Floats:
    """The tallies (flights, TALLY) of aircraft that hear each other with a delay of 0.5 s."""
    avoidance = msgspec.structs.replace(AVOIDANCE, law=law)
    world = msgspec.structs.replace(World(), end_s=end_s, delay_s=(0.5, 0.5))
    rng = np.random.default_rng(1)
    wishes = [Wish(0.0, times, points, 10.0) for times, points in paths]
    city = Simulation(
        flights_of(wishes, avoidance), avoidance, world, GIVEN, np.array([5000.0, 0.0, 0.0]), rng, rng,
        slots=len(paths), clear_m=0.0,
    )  # fmt: skip
    if settle_s:
        city.fly(settle_s)
        forget(city.state.tally)
    return city.fly(end_s - settle_s).state.tally.flights


def test_the_power_is_the_published_one():
    """Hovering takes P0 + Pi. The paper's figure has its minimum of about 126 W near 10 m/s."""
    assert power_w(0.0, 0.0) == pytest.approx(168.49)
    speeds = np.linspace(0.0, 30.0, 301)
    powers = [power_w(speed, 0.0) for speed in speeds]
    assert speeds[int(np.argmin(powers))] == pytest.approx(10.2, abs=0.15)
    assert min(powers) == pytest.approx(126.0, abs=1.0)
    assert power_w(20.0, 0.0) == pytest.approx(178.3, abs=0.5)


def test_a_climb_costs_the_lifted_weight_and_a_descent_saves_nothing():
    assert power_w(5.0, 2.0) == pytest.approx(power_w(5.0, 0.0) + 2.0 * WEIGHT_N)
    assert power_w(5.0, -2.0) == power_w(5.0, 0.0)


@pytest.mark.parametrize("climb_m", [0.0, 60.0])
def test_the_plan_costs_the_power_at_its_speed_for_its_time(climb_m):
    times = np.array([0.0, 40.0])
    points = np.array([[0.0, 0.0, -50.0], [320.0, 240.0, -50.0 - climb_m]])
    tally = flown([(times, points)], 60.0, law="none")[0]

    assert tally[T_ENDED] <= 60.0
    assert tally[T_PLANNED] == pytest.approx(40.0 * power_w(10.0, climb_m / 40.0), rel=1e-6)


def test_only_what_happens_after_the_settling_counts():
    times, points = np.array([0.0, 100.0]), np.array([[0.0, 0.0, -50.0], [1000.0, 0.0, -50.0]])
    tally = flown([(times, points)], 60.0, law="none", settle_s=40.0)[0]

    assert tally[T_PLANNED] == pytest.approx(20.0 * power_w(10.0, 0.0), rel=1e-6)
    assert tally[T_ENERGY] == pytest.approx(tally[T_PLANNED], rel=0.02)


def test_a_delayed_path_completes_less_of_its_plan():
    """The path asks for 15 m/s, the aircraft flies at most 10 m/s: its plan is charged up to its timed
    point, for the shorter time and the higher power."""
    times, points = np.array([0.0, 100.0]), np.array([[0.0, 0.0, -50.0], [1500.0, 0.0, -50.0]])
    tally = flown([(times, points)], 60.0)[0]

    assert tally[T_LATE] > 14.0
    assert tally[T_PLANNED] == pytest.approx((60.0 - tally[T_LATE]) * power_w(15.0, 0.0), rel=1e-6)


def test_avoiding_costs_energy():
    times, points = encounter("circle", 3)
    paths = list(zip(times, points, strict=True))
    extra = {
        law: tallies[:, T_ENERGY].sum() / tallies[:, T_PLANNED].sum() - 1.0
        for law in ("none", "dmuca")
        for tallies in [flown(paths, 45.0, law=law)]
    }
    assert abs(extra["none"]) < 0.01
    assert extra["dmuca"] > extra["none"] + 0.01
