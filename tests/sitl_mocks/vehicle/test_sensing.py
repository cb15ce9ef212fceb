"""The mock vehicle's sensor: what it sees, and what it says of it on the link."""

from __future__ import annotations

import argparse
import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkReader
from companion.errors import ConfigError
from companion.events import Firmware
from sitl_mocks.vehicle.options import HOME, VehicleOptions
from sitl_mocks.vehicle.real_time import server
from sitl_mocks.vehicle.sensing import COMPONENT, Obstacle, Sensor, SensorOptions

HERE = (0.0, 0.0, -50.0)
LEVEL = (0.0, 0.0, 0.0)
EXACT = {"range_sigma_m": 0.0, "bearing_sigma_deg": 0.0, "miss": 0.0}


def seen(*obstacles, attitude=LEVEL, here=HERE, now_s=0.0, others=(), **options):
    sensor = Sensor(SensorOptions(**EXACT, **options), obstacles, HOME, np.random.default_rng(1), 1)
    sensor.others = list(others)
    frames = sensor.due(now_s, here, here, attitude)
    messages = MavlinkReader().feed(b"".join(frames))
    assert all(m.get_srcComponent() == COMPONENT for m in messages)
    return messages


def pole(north, east, **more):
    return Obstacle(kind="pole", at_ned_m=(north, east, 0.0), radius_m=0.3, **more)


def hits(message):
    return {i: cm for i, cm in enumerate(message.distances) if cm < message.max_distance}


def test_a_pole_is_in_its_sector_at_its_distance():
    (scan,) = seen(pole(0.0, 20.0))
    assert hits(scan) == {18: 1970}
    assert scan.frame == mavlink.MAV_FRAME_BODY_FRD
    assert scan.increment_f == 5.0
    assert scan.distances[0] == 4001


def test_the_nose_turns_the_sectors():
    (scan,) = seen(pole(0.0, 20.0), attitude=(0.0, 0.0, math.radians(90.0)))
    assert set(hits(scan)) == {0}


def test_what_is_far_or_out_of_view_or_too_low_is_not_seen():
    assert not hits(seen(pole(45.0, 0.0))[0])
    assert not hits(seen(pole(20.0, 0.0, top_m=30.0))[0])
    (scan,) = seen(pole(-20.0, 0.0), fov_deg=90.0)
    assert not hits(scan)
    assert scan.distances[36] == 0xFFFF


def test_a_near_wall_fills_many_sectors():
    wall = Obstacle(kind="wall", at_ned_m=(15.0, -30.0, 0.0), to_ned_m=(15.0, 30.0, 0.0))
    found = hits(seen(wall)[0])
    assert len(found) > 20
    assert min(found.values()) == pytest.approx(1470, abs=40)


def test_a_vehicle_that_leans_sees_the_ground():
    (scan,) = seen(attitude=(math.radians(30.0), 0.0, 0.0), here=(0.0, 0.0, -10.0))
    assert hits(scan)[18] == 2000


def test_other_aircraft_are_seen():
    assert hits(seen(others=[((20.0, 0.0, -50.0), (0.0, 0.0, 0.0))])[0]) == {0: 1950}


def sectors(*obstacles, attitude=LEVEL, sensor=None):
    sensor = sensor or wired(*obstacles)
    return {m.id - 10: m for m in sensor.sectors(0.0, HERE, attitude)}


def wired(*obstacles):
    options = SensorOptions(**EXACT, message="proximity")
    return Sensor(options, obstacles, HOME, np.random.default_rng(1), 1)


def test_a_wired_sensor_has_eight_sectors():
    found = sectors(pole(0.0, 20.0), pole(-10.0, 0.0), pole(10.0, 10.0), pole(20.0, 20.0))
    assert {i: m.current_distance for i, m in found.items()} == {1: 1384, 2: 1970, 4: 970}
    assert all(m.orientation == i for i, m in found.items())
    assert {(m.min_distance, m.max_distance) for m in found.values()} == {(20, 4000)}


def test_the_nose_turns_the_sectors_of_a_wired_sensor():
    assert set(sectors(pole(0.0, 20.0), attitude=(0.0, 0.0, math.radians(90.0)))) == {0}


def test_a_sector_that_saw_something_once_has_the_greatest_distance_later():
    """And while no sector sees anything, ArduPilot sends none."""
    sensor = wired(pole(0.0, 20.0))
    turned = (0.0, 0.0, math.radians(90.0))
    assert set(sectors(sensor=sensor)) == {2}
    later = sectors(sensor=sensor, attitude=turned)
    assert {i: m.current_distance for i, m in later.items()} == {0: 1970, 2: 4000}
    assert not sensor.sectors(0.0, (0.0, 300.0, -50.0), LEVEL)


def test_a_wired_sensor_sends_nothing_itself():
    sensor = wired(pole(0.0, 20.0))
    assert sensor.due(0.0, HERE, HERE, LEVEL) == []
    frames = [sensor.burst(0.02 * i, HERE, LEVEL) for i in range(100)]
    (message,) = MavlinkReader().feed(frames[0][0])
    assert (message.get_srcComponent(), message.id) == (1, 12)
    assert sum(map(len, frames)) == 20


def test_only_an_ardupilot_has_a_wired_sensor():
    with pytest.raises(ConfigError, match="proximity"):
        VehicleOptions(firmware=Firmware.PX4, sensor=SensorOptions(message="proximity"))


def test_points_are_along_the_body():
    messages = seen(pole(0.0, 20.0), attitude=(0.0, 0.0, math.radians(90.0)), message="points")
    assert {m.get_type() for m in messages} == {"OBSTACLE_DISTANCE_3D"}
    assert messages[0].x == pytest.approx(20.0, abs=0.1)
    assert messages[0].obstacle_id == 0xFFFF


def test_tracks_have_place_and_velocity():
    other = Obstacle(kind="aircraft", at_ned_m=(20.0, 10.0, -55.0), velocity_ned_mps=(0.0, -5.0, 0.0))
    (track,) = seen(other, now_s=1.0, message="tracks")
    n, e, d = HOME.to_ned(track.lat / 1e7, track.lon / 1e7, track.altitude / 1e3)
    assert (n, e, d) == (
        pytest.approx(20.0, abs=1.0),
        pytest.approx(5.0, abs=1.0),
        pytest.approx(-55.0, abs=1.0),
    )
    assert (track.heading, track.hor_velocity) == (27000, 500)


def test_it_keeps_its_rate():
    sensor = Sensor(SensorOptions(rate_hz=10.0), (), HOME, np.random.default_rng(1), 1)
    sent = [len(sensor.due(i * 0.02, HERE, HERE, LEVEL)) for i in range(100)]
    assert sum(sent) == 20


@pytest.mark.parametrize(
    "wrong",
    [
        {"kind": "pole", "to_ned_m": (1.0, 1.0, 1.0)},
        {"kind": "wall"},
        {"kind": "pole", "velocity_ned_mps": (1.0, 0.0, 0.0)},
        {"kind": "aircraft", "velocity_ned_mps": (math.nan, 0.0, 0.0)},
    ],
)
def test_obstacles_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError):
        Obstacle(at_ned_m=(0.0, 0.0, 0.0), **wrong)


def test_distances_from_things():
    wall = Obstacle(kind="wall", at_ned_m=(10.0, -5.0, 0.0), to_ned_m=(10.0, 5.0, 0.0), top_m=40.0)
    assert wall.distance_m((0.0, 0.0, -20.0), 0.0) == pytest.approx(10.0)
    assert wall.distance_m((10.0, 8.0, -44.0), 0.0) == pytest.approx(5.0)
    flies = Obstacle(kind="aircraft", at_ned_m=(0.0, 0.0, -50.0), velocity_ned_mps=(3.0, 0.0, 0.0))
    assert flies.distance_m((30.0, 4.0, -50.0), 10.0) == pytest.approx(4.0)


def arguments(*words):
    parser = argparse.ArgumentParser()
    server.add_arguments(parser)
    return parser.parse_args(words)


def test_the_server_takes_a_sensor_and_obstacles():
    options = server.options_of(
        arguments("--sensor", "points", "--sensor-range", "60", "--obstacle", "pole:40,0", "--obstacle",
                  "wall:1,2,3,4", "--obstacle", "aircraft:1,2,-30,4,5,6")
    )  # fmt: skip
    assert options.sensor == SensorOptions(message="points", range_m=60.0)
    assert [one.kind for one in options.obstacles] == ["pole", "wall", "aircraft"]
    assert server.options_of(arguments()).sensor is None


@pytest.mark.parametrize("text", ["pole", "pole:1", "tree:1,2", "pole:a,b", "aircraft:1,2,-3,nan,0,0"])
def test_an_obstacle_that_cannot_be_read_is_named(text):
    with pytest.raises(ConfigError, match="--obstacle"):
        server.options_of(arguments("--obstacle", text))


def test_a_range_that_is_not_allowed_is_named():
    with pytest.raises(ConfigError, match="--sensor-range"):
        server.options_of(arguments("--sensor", "scan", "--sensor-range", "0"))
