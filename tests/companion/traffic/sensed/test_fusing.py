"""A transmitted track and a sensed object that are one aircraft are avoided once, and never less than
that."""

from __future__ import annotations

import math

import pytest

from companion.avoidance.law import ASIDE, Law, Neighbour, Situation
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from tests.companion.traffic.sensed.world import World, off


def heard(world: World, north: float, east: float, velocity=(0.0, 0.0, 0.0), **more) -> Neighbour:
    values = {"track_id": "OTHER", "age_s": 0.5, "sigma_m": 2.0} | more
    n, e = north - 0.5 * velocity[0], east - 0.5 * velocity[1]
    return Neighbour(position_ned_m=(n, e, 0.0), velocity_ned_mps=velocity, **values)


def hovering() -> World:
    world = World(things=lambda _: [(25.0, 3.0, 0.5)])
    world.run(3.0)
    return world


def agree(world: World, seconds: float, *others: Neighbour) -> list[str]:
    names: list[str] = []
    for _ in range(round(seconds / 0.2)):
        world.run(0.2)
        names = [other.track_id for other in world.fused(*others)]
    return names


def test_a_hovering_aircraft_that_sends_is_one_neighbour():
    world = hovering()
    names = agree(world, 3.0, heard(world, 25.5, 2.0))
    assert len(names) == 1
    assert names[0].startswith("sensed")
    assert world.sensed.fused == {(False, "OTHER"): names[0]}


def test_a_flying_aircraft_that_sends_is_one_neighbour():
    world = World(things=lambda t: [(38.0 - 5.0 * (t - 10.0), 3.0, 0.5)])
    world.run(1.5)
    names: list[str] = []
    for _ in range(15):
        world.run(0.2)
        north = 38.0 - 5.0 * (world.now_s - 10.0)
        names = [other.track_id for other in world.fused(heard(world, north, 2.5, (-5.0, 0.0, 0.0)))]
    assert len(names) == 1
    assert names[0].startswith("sensed")


def test_both_are_avoided_until_they_have_agreed_for_two_seconds():
    world = hovering()
    assert len(agree(world, 1.6, heard(world, 25.5, 2.0))) == 2


@pytest.mark.parametrize(
    "other",
    [
        {"north": 60.0, "east": 2.0},
        {"north": 25.0, "east": 2.0, "velocity": (5.0, 0.0, 0.0)},
        {"north": 25.0, "east": 2.0, "crewed": True},
        {"north": 25.0, "east": 2.0, "silent": True},
        {"north": 25.0, "east": 2.0, "age_s": 5.0},
    ],
)
def test_in_doubt_both_are_avoided(other):
    world = hovering()
    assert len(agree(world, 4.0, heard(world, **other))) == 2


@pytest.mark.parametrize(("sigma_m", "beside_m"), [(10.0, 20.0), (10.0, 30.0), (15.0, 45.0)])
def test_an_aircraft_far_beside_an_obstacle_is_not_left_out_for_it(sigma_m, beside_m):
    """However large the error is that it declares."""
    world = hovering()
    names = agree(world, 3.0, heard(world, 25.0, 3.0 + beside_m, sigma_m=sigma_m))
    assert "OTHER" in names


def test_two_that_claim_one_place_are_both_avoided():
    world = hovering()
    names = agree(world, 4.0, heard(world, 25.5, 2.0), heard(world, 24.5, 3.0, track_id="SECOND"))
    assert len(names) == 3


def test_a_track_with_another_place_is_avoided():
    world = hovering()
    names = agree(world, 4.0, heard(world, 25.5, 2.0), heard(world, 80.0, 2.0, track_id=f"OTHER{ASIDE}1"))
    assert len(names) == 3


def test_a_ghost_at_an_obstacle_takes_nothing_away_and_is_avoided_again_when_it_leaves():
    world = hovering()
    assert len(agree(world, 3.0, heard(world, 25.5, 2.0))) == 1
    names = [other.track_id for other in world.fused(heard(world, 60.0, 2.0))]
    assert len(names) == 2
    assert any(name.startswith("sensed") for name in names)
    world.fused()
    assert len(world.fused()) == 1, "the obstacle stays when nobody claims to be there"


def test_a_sensed_object_that_goes_gives_the_transmitted_track_back():
    world = World(things=lambda t: [(25.0, 3.0, 0.5)] if t < 16.0 else [])
    world.run(3.0)
    assert len(agree(world, 2.6, heard(world, 25.5, 2.0))) == 1
    names = agree(world, 4.0, heard(world, 25.5, 2.0))
    assert names == ["OTHER"]


def test_what_stands_for_a_transmitted_track_too_is_kept_away_from_by_the_larger_error():
    """That it is one aircraft is an inference. Its sender's place beside ours holds the error of ours, and
    the track may be another aircraft, which is where it says."""
    world = hovering()
    world.accuracy_m = 4.0
    agree(world, 1.6, heard(world, 25.5, 2.0))
    (alone,) = [other for other in world.fused() if other.track_id.startswith("sensed")]
    assert alone.relative
    agree(world, 3.0, heard(world, 25.5, 2.0))
    (both,) = world.fused(heard(world, 25.5, 2.0))
    assert not both.relative
    apart_m = off(both, 25.5, 2.0)
    assert 0.3 < apart_m < 2.0
    assert 4.0 * math.hypot(both.sigma_m, world.own.sigma_m) == pytest.approx(16.0 + apart_m, abs=0.01)
    (again,) = world.fused()
    assert again.relative
    assert again.sigma_m > 0.5


@pytest.mark.parametrize(("beside_m", "error_m"), [(11.5, 0.0), (11.5, -2.5), (13.5, -2.5)])
def test_an_aircraft_that_the_sensor_does_not_see_is_not_hidden_by_a_pole_beside_it(beside_m, error_m):
    """It hovers 60 m ahead, beside a pole and near our path. Taken for the pole, it was passed at 4 m."""
    path_m = 12.0
    world = World(things=lambda _: [(60.0, -path_m, 0.3)], velocity=(3.0, 0.0, 0.0))
    place, path = (60.0, beside_m - path_m, 0.0), Trajectory([0, 60], [(0, 0, 0), (180, 0, 0)])
    law, began_s, fused, nearest = Law(AvoidanceConfig(), LimitsConfig(), path), world.now_s, False, math.inf
    command = world.velocity
    for tick in range(700):
        world.step()
        now_s = world.now_s - began_s
        if tick % 4 == 0:
            track = Neighbour("OTHER", (60.0, place[1] + error_m, 0.0), (0.0, 0.0, 0.0), now_s % 1.0, 3.0)
            neighbours = world.fused(track)
            fused = fused or track not in neighbours
            view = Situation(now_s, now_s, world.position, world.velocity, world.own.sigma_m, neighbours)
            command = law.decide(view).chosen_ned_mps
        n, e, d = (v + 0.1 * (c - v) for v, c in zip(world.velocity, command, strict=True))
        world.velocity = n, e, d
        nearest = min(nearest, math.dist(world.position, place))
    assert fused
    assert nearest > 10.0
