"""One flight's path and clock, and the heights between which it is flown."""

from __future__ import annotations

import math

import pytest

from companion.authority.course import Course
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
