"""One flight's path and clock, and the heights between which it is flown."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from companion.authority.course import Course
from companion.authority.guard import _way
from companion.avoidance.law import Law
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig


def begun(start_s):
    course = Course()
    path = Trajectory([0.0, 100.0], [(0.0, 0.0, -50.0), (300.0, 0.0, -50.0)])
    course.begin(Law(AvoidanceConfig(), LimitsConfig(), path), 400.0, start_s)
    return course


def test_the_paths_clock_stands_until_the_vehicle_flies_it():
    course = begun(None)
    assert course.path_time_s(70.0) == 0.0
    assert course.point(70.0) == pytest.approx((0.0, 0.0, -50.0))
    course.engage(70.0)
    course.engage(75.0)
    assert course.path_time_s(80.0) == 10.0
    assert course.point(80.0) == pytest.approx((30.0, 0.0, -50.0))


def test_a_start_that_is_given_is_kept():
    course = begun(60.0)
    course.engage(70.0)
    assert course.path_time_s(80.0) == 20.0
    course.end()
    assert course.law is None
    assert course.path_time_s(80.0) == 0.0


@pytest.mark.parametrize(
    ("floor_m", "ceiling_m", "lowest_m", "expected_m"),
    [
        (20.0, 100.0, 50.0, 20.0),
        (20.0, 100.0, 8.0, 20.0),
        # By default 15 m, or the path's lowest point, with 5 m below the ceiling.
        (None, None, 50.0, 15.0),
        (None, None, 14.0, 14.0),
        (None, None, -3.0, -3.0),
        (None, 100.0, 50.0, 15.0),
        (None, 18.0, 50.0, 13.0),
        (None, None, math.inf, 15.0),
    ],
)
def test_the_floor(floor_m, ceiling_m, lowest_m, expected_m):
    course = Course()
    course.lowest_height_m = lowest_m
    limits = LimitsConfig(floor_height_m=floor_m, ceiling_height_m=ceiling_m)
    assert course.floor_height_m(limits) == expected_m


def test_before_the_first_flight_nothing_is_as_low_as_the_ground():
    assert Course().floor_height_m(LimitsConfig()) == 0.0


@pytest.mark.parametrize(
    ("there", "seconds"),
    [
        # 30 m at 3 m/s; 80 m up at 2 m/s, 30 m down at 1.5 m/s: from 50 m above the frame's origin.
        ((30.0, 0.0, -50.0), 10.0),
        ((0.0, 0.0, -130.0), 40.0),
        ((0.0, 0.0, -20.0), 20.0),
        ((30.0, 40.0, -49.0), math.sqrt(2501.0) / 3.0),
    ],
)
def test_the_way_to_an_item_is_as_fast_as_it_climbs_or_descends(there, seconds):
    limits = LimitsConfig(max_climb_mps=2.0, max_descent_mps=1.5)
    way = _way((0.0, 0.0, -50.0), (3.0, 0.0, 1.0), there, 3.0, limits)
    assert way.end_s == pytest.approx(seconds)
    assert way.position(0.0) == pytest.approx((0.0, 0.0, -50.0))
    assert way.position(way.end_s) == pytest.approx(there)
    # Before, it continues the velocity that was flown.
    assert way.position(-2.0) == pytest.approx((-6.0, 0.0, -52.0))


@pytest.mark.parametrize(("away_m", "stands"), [(0.4, True), (0.6, False)])
def test_an_item_within_half_a_metre_has_been_reached(away_m, stands):
    way = _way((0.0, 0.0, -50.0), (3.0, 0.0, 0.0), (away_m, 0.0, -50.0), 3.0, LimitsConfig())
    assert (way.max_speed() == 0.0) is stands


@pytest.mark.parametrize(("home_m", "height_m"), [(400.0, 50.0), (400.6, 49.4), (420.0, 50.0)])
def test_own_heights_are_above_the_flights_home_once_the_vehicles_has_moved(home_m, height_m):
    course = Course()
    course.home_alt_msl_m = 400.0
    position = SimpleNamespace(alt_msl_m=450.0, height_above_home_m=450.0 - home_m)
    own = SimpleNamespace(position=position, home_alt_msl_m=home_m)
    assert course.own_height_m(own) == pytest.approx(height_m)
