"""The command after the acceleration limit: in reach, and keeping every hard plane that can be kept."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.avoidance.kernels import crosses, in_reach
from companion.avoidance.law import Law, Neighbour, Situation
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from ground_tools.campaign import fences
from tests.companion.avoidance.flown.flying import circle, polygon, room

LIMITS = LimitsConfig(max_speed_mps=8.0, max_acceleration_mps2=1.5)
CHANGE = 1.5 * 0.2

# ---------------------------------------------------------------- the program


def ball(rng: np.random.Generator, count: int, middle: Any, radius: float) -> Floats:
    """Points in a ball, half of them on its surface."""
    way = rng.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    far = np.minimum(2.0 * rng.random((count, 1)), 1.0) ** (1.0 / 3.0)
    points: Floats = np.asarray(middle) + radius * far * way
    return points


def test_the_nearest_in_reach_that_keeps_every_plane() -> None:
    """Against 4,000 points of the reach: none that keeps all is nearer, and if one does, one is found."""
    for seed in range(300):
        rng = np.random.default_rng(seed)
        speed, change = 5.0, rng.uniform(0.05, 2.0)
        before = ball(rng, 1, np.zeros(3), 0.99 * speed)[0]
        wish = ball(rng, 1, np.zeros(3), speed)[0]
        count = int(rng.integers(1, 7))
        planes = np.zeros((count, 4))
        planes[:, :2] = rng.normal(size=(count, 2))
        planes[: rng.integers(0, 2), :3] = (0.0, 0.0, rng.choice([-1.0, 1.0]))
        planes[:, :3] /= np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
        planes[:, 3] = planes[:, :3] @ before + rng.uniform(-1.0, 0.6, count) * change
        found, velocity = in_reach(planes, count, k.Vector(*wish), k.Vector(*before), change, speed)
        tried = ball(rng, 4000, before, change)
        good = (tried @ planes[:, :3].T >= planes[:, 3]).all(axis=1)
        good &= np.linalg.norm(tried, axis=1) <= speed
        assert found or not good.any(), seed
        if found:
            assert (planes[:, :3] @ velocity >= planes[:, 3] - 1e-7).all(), seed
            assert math.dist(velocity, before) <= change + 1e-12, seed
            assert math.hypot(*velocity) <= speed + 1e-7, seed
            if good.any():
                nearest = np.linalg.norm(tried[good] - wish, axis=1).min()
                assert math.dist(velocity, wish) <= nearest + 1e-3, seed


# ---------------------------------------------------------------- decisions

number = st.floats(-60.0, 60.0)
ways = st.tuples(st.floats(-7.0, 7.0), st.floats(-7.0, 7.0), st.floats(-1.0, 1.0))
heard = st.lists(
    st.builds(
        Neighbour,
        track_id=st.sampled_from("abcde"),
        position_ned_m=st.tuples(number, number, st.floats(-60.0, -40.0)),
        velocity_ned_mps=ways,
        age_s=st.floats(0.0, 3.0),
        sigma_m=st.just(0.5),
    ),
    max_size=4,
)
areas = st.one_of(
    st.builds(
        polygon,
        st.sampled_from([k.IN_POLYGON, k.OUT_OF_POLYGON]),
        st.just((-41.0, -43.0)),
        st.tuples(st.floats(1, 60), st.floats(-60, -50)),
        st.tuples(st.floats(61, 90), st.floats(1, 60)),
    ),
    st.builds(
        circle,
        st.sampled_from([k.IN_CIRCLE, k.OUT_OF_CIRCLE]),
        st.tuples(number, number),
        st.floats(5.0, 80.0),
    ),
)


def decided(fence: Floats, at: Any, way: Any, others: Any) -> tuple[Law, Floats]:
    """The first command of a vehicle that flies `way`, its limits a little above that."""
    here = (*at, -50.0)
    law = Law(AvoidanceConfig(), LIMITS, Trajectory([0, 100], [here, (at[0] + 300.0, at[1], -50.0)]), fence)
    found = law.decide(Situation(0.0, 0.0, here, way, 0.0, others)).chosen_ned_mps
    return law, np.array(found)


@settings(max_examples=150, deadline=None)
@given(fence=areas, at=st.tuples(number, number), way=ways, others=heard, seed=st.integers(0, 99))
def test_a_command_in_reach_that_keeps_every_hard_plane_is_found(
    fence: Floats, at: Any, way: Any, others: Any, seed: int
) -> None:
    before = np.array(way)
    assume(np.linalg.norm(before) < LIMITS.max_speed_mps)
    law, found = decided(fence, at, way, others)
    assert np.linalg.norm(found - before) <= CHANGE * (1.0 + 1e-9)
    planes = law._work.planes[: law._hard]
    tried = ball(np.random.default_rng(seed), 2000, before, CHANGE)
    good = (tried @ planes[:, :3].T >= planes[:, 3]).all(axis=1)
    good &= np.linalg.norm(tried, axis=1) <= LIMITS.max_speed_mps
    if good.any():
        assert (planes[:, :3] @ found >= planes[:, 3] - 1e-6).all()


@settings(max_examples=150, deadline=None)
@given(fence=areas, at=st.tuples(number, number), way=ways, others=heard)
def test_outside_nothing_leads_further_out_that_need_not(
    fence: Floats, at: Any, way: Any, others: Any
) -> None:
    place = np.array([[*at, -50.0]])
    assume(room(fence, place)[0] < -1e-3)
    assume(math.hypot(*way) < LIMITS.max_speed_mps)
    _, found = decided(fence, at, way, others)
    _, (n, e) = min(k.nearest_of_wall(k.Wall(*wall), k.Point(*at)) for wall in fence.tolist())
    inward = -n * found[0] - e * found[1]
    if -n * way[0] - e * way[1] + CHANGE > 1e-6:  # zero is in reach
        assert inward >= -1e-6
    else:
        assert inward >= -n * way[0] - e * way[1] + 0.99 * CHANGE


@settings(max_examples=300, deadline=None)
@given(fence=areas, at=st.tuples(number, number), to=st.tuples(number, number))
def test_a_way_crosses_a_fence_where_its_points_are_on_both_sides(fence: Floats, at: Any, to: Any) -> None:
    share = np.linspace(0.0, 1.0, 2001)[:, None]
    way = np.hstack([np.array(at) + share * (np.array(to) - np.array(at)), np.full_like(share, -50.0)])
    rooms = room(fence, way)
    assume(rooms[0] > 1e-3)  # it begins on the right side
    found = any(crosses(k.Wall(*wall), k.Point(*at), k.Point(*to)) for wall in fence.tolist())
    if rooms.min() < -1e-6:
        assert found
    elif rooms.min() > 0.1:  # more than between two of the points
        assert not found


# ---------------------------------------------------------------- attacks


@pytest.mark.parametrize("seed", [5081, 5925])
def test_who_can_stop_only_with_all_of_the_limit_does(seed: int) -> None:
    """Flown past the corner of a forbidden area, at 10 and 13 m/s."""
    assert fences.fly(seed).crossed_m == 0.0


@pytest.mark.parametrize("noisy", [False, True])
def test_no_attack_crosses_a_fence_where_it_could_stop(noisy: bool) -> None:
    """Random areas and neighbours; with the error of navigation no farther than that."""
    rows = [fences.fly(seed, noisy=noisy) for seed in range(60)]
    assert not [row.seed for row in rows if row.over_m > 0.0 and row.could_stop]
    summary = fences.summary(rows)
    assert sum(summary[others]["runs"] for others in ("none", "honest", "turning", "ghosts")) == 60


def test_ghosts_push_nobody_further_out() -> None:
    rows = [fences.fly(seed, outside=True) for seed in range(40)]
    summary = fences.summary_outside(rows)
    assert summary["median_further_m"] == 0.0
    assert summary["max_further_m"] < 10.0


def test_a_climb_as_fast_as_the_speed_limit_leaves_a_wall_no_speed() -> None:
    """2 m below the floor and 2.2 m from the fence: it brakes before the wall, and climbs at the limit."""
    limits = LimitsConfig(max_speed_mps=2.0)
    fence = polygon(k.IN_POLYGON, (-30.0, -30.0), (-30.0, 30.0), (30.0, 30.0), (30.0, -30.0))
    law = Law(AvoidanceConfig(), limits, Trajectory([0, 100], [(-20, 0, 0), (20, 0, 0)]), fence)
    climbs = (-0.8, 0.4524, -1.6148)
    situation = Situation(0.0, 0.0, (0.0, 27.8464, 0.0), climbs, 0.0, (), floor_down_m=-1.9988)
    command = law.decide(situation).chosen_ned_mps
    assert command[2] == pytest.approx(-1.9988)
    assert math.hypot(*command) <= limits.max_speed_mps
