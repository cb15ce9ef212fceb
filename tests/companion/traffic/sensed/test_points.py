"""Points and aircraft that a sensor follows itself, and the bounds of sensed traffic."""

from __future__ import annotations

import math

import pytest

from companion.config import SensedConfig
from companion.events import Attitude
from companion.events.sensed import is_sensed
from companion.traffic.sensed import objects, surfaces
from companion.traffic.sensed.seen import MOST_POINTS
from tests.companion.traffic.sensed.world import World, aircraft, off, one, place, point


def test_points_of_a_pole_are_one_object_whose_top_is_not_known():
    world = World()
    for _ in range(4):
        world.step(*[point(25.0, 3.0, float(d)) for d in range(-6, 7, 2)], scans=False)
    other = one(world)
    assert off(other, 25.0, 3.0) < 0.5
    assert not other.vertical_known


def test_points_of_a_wall_are_several_places():
    world = World()
    for _ in range(4):
        world.step(*[point(25.0, float(e), 0.0) for e in range(-20, 21, 2)], scans=False)
    assert 5 <= len(world.seen()) <= 8
    assert all(other.velocity_ned_mps == (0.0, 0.0, 0.0) for other in world.seen())


def test_points_along_the_body_turn_with_it():
    world = World(yaw_rad=math.radians(90.0), pitch_rad=math.radians(-20.0))
    for _ in range(4):
        world.step(point(30.0, 0.0, 0.0, "body"), scans=False)
    n, e, d = place(one(world))
    assert (n, e) == (
        pytest.approx(0.0, abs=0.1),
        pytest.approx(30.0 * math.cos(math.radians(20.0)), abs=0.1),
    )
    assert d == pytest.approx(30.0 * math.sin(math.radians(20.0)), abs=0.1)


def test_points_in_the_autopilots_frame_need_its_position():
    from companion.events import LocalPosition

    world = World()
    for _ in range(3):
        world.step(point(125.0, 40.0, -50.0, "local"), scans=False)
    assert world.seen() == []
    for _ in range(3):
        told = LocalPosition(
            time_boot_s=1.0, position_ned_m=(100.0, 40.0, -50.0), velocity_ned_mps=(0.0, 0.0, 0.0)
        )
        world.step(told, point(125.0, 40.0, -50.0, "local"), scans=False)
    assert off(one(world), 25.0, 0.0) < 0.1


def test_an_obstacle_with_a_number_keeps_its_track_where_others_cross_it():
    world = World()
    for number in range(40):
        t = number * 0.05
        world.step(
            point(20.0, -8.0 + 8.0 * t, 0.0, number=1), point(20.5, 8.0 - 8.0 * t, 0.0, number=2), scans=False
        )
    names = {round(other.velocity_ned_mps[1] / 8.0): other.track_id for other in world.seen()}
    assert names.keys() == {1, -1}


def test_an_aircraft_that_the_sensor_follows_is_where_it_says():
    world = World()
    for number in range(10):
        world.step(aircraft(world, 100.0 - 0.75 * number, 5.0, -20.0, (-15.0, 0.0, 0.0)), scans=False)
    other = one(world)
    assert off(other, 93.25, 5.0) < 0.5
    assert other.velocity_ned_mps == (-15.0, 0.0, 0.0)
    assert other.vertical_known
    assert not other.crewed
    assert place(other)[2] == pytest.approx(-20.0, abs=0.1)


@pytest.mark.parametrize(
    "wrong",
    [{"n": 900.0}, {"velocity": (200.0, 0.0, 0.0)}, {"age_s": 5.0}, {"n": 0.1, "e": 0.0, "d": 0.0}],
)
def test_what_no_sensor_sees_is_no_track(wrong):
    world = World()
    for _ in range(5):
        at = {"n": 100.0, "e": 0.0, "d": 0.0} | wrong
        world.step(aircraft(world, **at), scans=False)
    assert world.seen() == []


# ------------------------------------------------------------ bounds


def test_there_are_never_more_tracks_than_the_bound():
    world = World(SensedConfig(use=True, latency_s=0.0))
    for _ in range(30):
        points = [point(20.0 + 8.0 * (i // 12), -80.0 + 13.0 * (i % 12), 0.0, number=i) for i in range(100)]
        world.step(*points, scans=False)
        world.step(*[point(-30.0, float(e), 0.0) for e in range(-100, 100, 2)], scans=False)
        assert len(world.seen()) <= objects.MOST + surfaces.MOST
    before = world.sensed._objects.refused
    for _ in range(3):
        world.step(*[point(90.0 + i, -40.0 + 7.0 * i, 0.0, number=200 + i) for i in range(12)], scans=False)
    assert world.sensed._objects.refused > before, "farther ones find no room"
    assert MOST_POINTS < 100


def test_the_nearest_objects_are_the_ones_that_are_kept():
    world = World()
    for _ in range(5):
        many = [point(40.0 + i, 30.0 - 7.0 * i, 0.0, number=i) for i in range(objects.MOST)]
        world.step(*many, scans=False)
    world.step(point(15.0, 0.0, 0.0, number=999), scans=False)
    assert any(off(other, 15.0, 0.0) < 1.0 for other in world.seen())


def test_names_are_those_of_no_transmitted_track():
    world = World(things=lambda _: [(20.0, 0.0, 0.3)])
    world.run(0.5)
    assert is_sensed(one(world).track_id)
    assert not is_sensed("sensed 1"), "a Remote ID sender can call itself this"
    with pytest.raises(UnicodeEncodeError):
        one(world).track_id.encode("latin-1")


def test_the_same_input_gives_the_same_tracks():
    worlds = [
        World(things=lambda t: [(30.0 - 5 * (t - 10), 1.0, 0.5), (25.0, 15.0, 0.2)], seed=3) for _ in range(2)
    ]
    for world in worlds:
        world.run(3.0)
    assert worlds[0].seen() == worlds[1].seen()


def test_attitudes_of_the_future_are_forgotten():
    world = World(things=lambda _: [(20.0, 0.0, 0.3)])
    world.run(1.0)
    ahead = Attitude(time_boot_s=0.0, roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0)
    world.sensed._poses.note_attitude(ahead, world.now_s + 100.0)
    world.run(1.0)
    assert off(one(world), 20.0, 0.0) < 1.5
