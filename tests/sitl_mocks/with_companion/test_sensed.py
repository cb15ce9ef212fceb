"""One companion with one mock vehicle whose sensor sees poles, walls and aircraft that send nothing."""

from __future__ import annotations

import io
import math

import msgspec
import pytest

from companion import event_record, replay
from companion.config import (
    Config,
    FlightConfig,
    IdentityConfig,
    SensedConfig,
    TrajectoryFile,
    VehicleConfig,
    Waypoint,
)
from companion.events import (
    Decision,
    Firmware,
    ObstaclePoint,
    ObstacleScan,
    Say,
    SensedAircraft,
    VelocitySetpoint,
)
from companion.events.sensed import NOTHING, UNKNOWN, is_sensed
from sitl_mocks.vehicle.sensing import Obstacle, SensorOptions
from tests.sitl_mocks.with_companion.pair import Pair
from tests.support.place import HOME

SPEED_MPS, HEIGHT_M, BEGINS_S = 3.0, 50.0, 3.0
SENSOR = SensorOptions()
MESSAGES = pytest.mark.parametrize("message", ["scan", "points", "tracks"])
BOTH = pytest.mark.parametrize("firmware", Firmware)


def config(*, use: bool = True) -> Config:
    """Due north at 3 m/s, 50 m above home."""
    places = [HOME.to_geodetic(north, 0.0, -HEIGHT_M) for north in (0.0, 400.0 * SPEED_MPS)]
    path = TrajectoryFile(
        altitude="msl",
        waypoint=tuple(
            Waypoint(t_s=t, lat_deg=lat, lon_deg=lon, alt_m=alt)
            for t, (lat, lon, alt) in zip((0.0, 400.0), places, strict=True)
        ),
    )
    return Config(
        identity=IdentityConfig(uas_id="OWN"),
        vehicle=VehicleConfig(system_id=1),
        flight=FlightConfig(use="fly", take_in_flight=True),
        sensed=SensedConfig(use=use),
        path=path,
    )


def flown(
    *obstacles: Obstacle,
    firmware: Firmware = Firmware.PX4,
    seconds: float = 60.0,
    use: bool = True,
    sensor: SensorOptions | None = SENSOR,
    **options: object,
) -> Pair:
    pair = Pair(firmware, config(use=use), sensor=sensor, obstacles=obstacles, **options)
    return pair.run(seconds)


def least_m(pair: Pair, obstacle: Obstacle) -> float:
    """Least distance from an obstacle at any tick."""
    return min(obstacle.distance_m(place, tick * 0.05) for tick, place in enumerate(pair.places))


def sensor(message: str, **more: object) -> SensorOptions:
    return msgspec.convert({"message": message, **more}, SensorOptions)


def pole(north: float = 70.0, east: float = 0.5) -> Obstacle:
    return Obstacle(kind="pole", at_ned_m=(north, east, 0.0), radius_m=0.3)


def aircraft(speed_mps: float, course_deg: float, meets_s: float = 25.0) -> Obstacle:
    """Meets the path's point at a time."""
    vn = speed_mps * math.cos(math.radians(course_deg))
    ve = speed_mps * math.sin(math.radians(course_deg))
    north = SPEED_MPS * (meets_s - BEGINS_S)
    return Obstacle(
        kind="aircraft",
        at_ned_m=(north - vn * meets_s, 0.5 - ve * meets_s, -HEIGHT_M),
        velocity_ned_mps=(vn, ve, 0.0),
    )


@BOTH
@MESSAGES
def test_a_pole_is_avoided(firmware, message):
    pair = flown(pole(), firmware=firmware, sensor=sensor(message))
    assert least_m(pair, pole()) > 10.0
    assert pair.places[-1][0] > 90.0, "it flies on behind it"
    kind = {"scan": ObstacleScan, "points": ObstaclePoint, "tracks": SensedAircraft}[message]
    assert pair.events(kind)


def test_without_the_sensor_it_flies_into_the_pole():
    assert least_m(flown(pole(), sensor=None), pole()) < 2.0
    assert least_m(flown(pole(), use=False), pole()) < 2.0


@MESSAGES
def test_a_wall_beside_the_path_is_avoided(message):
    wall = Obstacle(kind="wall", at_ned_m=(60.0, -40.0, 0.0), to_ned_m=(75.0, 2.0, 0.0))
    pair = flown(wall, sensor=sensor(message))
    assert least_m(pair, wall) > 8.0
    assert pair.places[-1][0] > 80.0


def test_nobody_flies_through_a_wall_across_the_path():
    wall = Obstacle(kind="wall", at_ned_m=(70.0, -200.0, 0.0), to_ned_m=(70.0, 200.0, 0.0))
    pair = flown(wall, seconds=90.0)
    assert max(place[0] for place in pair.places) < 62.0


@MESSAGES
@pytest.mark.parametrize("course_deg", [180.0, 90.0, 235.0])
def test_an_aircraft_at_5_mps_that_sends_nothing_is_avoided(message, course_deg):
    other = aircraft(5.0, course_deg)
    assert least_m(flown(other, sensor=None, seconds=40.0), other) < 5.0
    assert least_m(flown(other, sensor=sensor(message), seconds=40.0), other) > 8.0


@pytest.mark.parametrize("course_deg", [180.0, 90.0, 235.0])
def test_one_at_10_mps_is_not_hit(course_deg):
    """At 40 m it is seen three seconds before it would hit: that is not enough for 10 m."""
    other = aircraft(10.0, course_deg)
    assert least_m(flown(other, sensor=None, seconds=40.0), other) < 2.0
    assert least_m(flown(other, seconds=40.0), other) > 2.0


def test_a_narrow_view_suffices_for_what_lies_ahead():
    pair = flown(pole(), sensor=SensorOptions(fov_deg=90.0))
    assert least_m(pair, pole()) > 8.0


def wired(*obstacles: Obstacle, seconds: float = 60.0, **options: object) -> Pair:
    """An ArduPilot that reports the sensor that is wired to it."""
    return flown(
        *obstacles, firmware=Firmware.ARDUPILOT, sensor=sensor("proximity"), seconds=seconds, **options
    )


def test_what_ardupilot_reports_of_a_pole_is_avoided():
    pair = wired(pole(), seconds=80.0)
    assert least_m(pair, pole()) > 10.0
    assert pair.places[-1][0] > 90.0, "it flies on behind it"
    scans = [scan for scan in pair.events(ObstacleScan) if max(scan.distances_cm) > NOTHING]
    assert {scan.step_deg for scan in scans} == {45.0}
    assert {scan.component for scan in scans} == {1}


def test_a_wall_across_the_path_in_sectors_of_45_deg():
    """It stays well clear of it, and does not fly away."""
    wall = Obstacle(kind="wall", at_ned_m=(70.0, -200.0, 0.0), to_ned_m=(70.0, 200.0, 0.0))
    pair = wired(wall, seconds=90.0)
    assert 12.0 < least_m(pair, wall) < 30.0
    assert min(place[0] for place in pair.places) > -1.0


def test_a_short_wall_in_sectors_of_45_deg_is_passed():
    wall = Obstacle(kind="wall", at_ned_m=(60.0, -5.0, 0.0), to_ned_m=(60.0, 5.0, 0.0))
    pair = wired(wall, seconds=100.0)
    assert least_m(pair, wall) > 10.0
    assert pair.places[-1][0] > 90.0


def test_a_wired_sensor_that_nobody_uses_changes_no_command():
    silent, heard = (
        flown(pole(), firmware=Firmware.ARDUPILOT, use=False, sensor=which, seconds=20.0)
        for which in (None, sensor("proximity"))
    )
    assert silent.sent == heard.sent
    assert not heard.events(ObstacleScan)


def test_the_pilot_is_told_when_a_wired_sensor_fails_and_not_when_it_sees_nothing():
    pair = wired(pole(north=-20.0), seconds=30.0)
    scans = pair.events(ObstacleScan)
    assert any(max(scan.distances_cm) > NOTHING for scan in scans)
    assert max(scans[-1].distances_cm) == UNKNOWN, "the pole is out of range"
    assert not silent_texts(pair)
    pair.vehicle.troubles.proximity_lost = True
    pair.run(10.0)
    assert len(silent_texts(pair)) == 1


def silent_texts(pair: Pair) -> list[str]:
    return [said.text for said in pair.commands(Say) if "obstacle sensor" in said.text]


def test_sensed_tracks_are_named_and_the_flight_replays_bit_for_bit():
    pair = flown(pole(), aircraft(5.0, 90.0, 40.0), seconds=50.0)
    names = {view.track_id for decision in pair.commands(Decision) for view in decision.tracks}
    assert names
    assert all(map(is_sensed, names))
    header = event_record.Header(aircraft="OWN", software="test", config=pair.config)
    data = event_record.MAGIC + b"".join(event_record.encode(item) for item in (header, *pair.steps))
    result = replay.replay_record(event_record.read(io.BytesIO(data), "OWN"), "OWN", 0.0)
    assert result.steps == len(pair.steps)
    assert result.differences == 0


@BOTH
def test_a_section_without_a_sensor_changes_no_command(firmware):
    without, with_section = (
        flown(firmware=firmware, use=use, sensor=None, seconds=30.0) for use in (False, True)
    )
    assert without.commands(VelocitySetpoint)
    assert [step.commands for step in without.steps] == [step.commands for step in with_section.steps]
    assert without.places == with_section.places


def test_a_sensor_that_nobody_asked_for_changes_no_command():
    silent, heard = (
        flown(pole(), use=False, sensor=which, seconds=30.0) for which in (None, SensorOptions())
    )
    assert [step.commands for step in silent.steps] == [step.commands for step in heard.steps]
    assert not heard.events(ObstacleScan)
