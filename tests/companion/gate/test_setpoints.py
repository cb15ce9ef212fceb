"""Rules 8 to 10: age, form and speed of a setpoint."""

from __future__ import annotations

import math

import pytest

from companion.events import Firmware, Parameter, VehicleParameters, VehicleTime
from tests.companion.gate.flying import (
    ARDUPILOT,
    HOLD,
    Flying,
    config,
    flown_at,
)

BOTH = pytest.mark.parametrize("firmware", Firmware)


# ---------------------------------------------------------------- 8: age


def test_a_setpoint_leaves_within_a_quarter_of_a_second_of_its_decision(taken):
    decided_s = taken.now_s
    for later_s, leaves in ((0.24, True), (0.26, False)):
        taken.now_s = decided_s + later_s
        taken.beat()
        taken.position()
        taken.gate.emptied(taken.now_s)
        assert taken.flies(0.1) is leaves
    assert taken.refused() == [8]


def test_the_own_position_is_young(taken):
    """If no new position arrives, the last one may be 1.5 s old: 1 s, at which authority ends, and half a
    second."""
    for _ in range(29):
        taken.now_s += 0.05
        taken.beat()
        taken.gate.emptied(taken.now_s)
        taken.gate.decided(taken.now_s)
        assert taken.flies()
    taken.run(0.05)
    for _ in range(31):
        taken.now_s += 0.05
        taken.beat()
        taken.gate.emptied(taken.now_s)
        taken.gate.decided(taken.now_s)
    assert not taken.flies()
    assert taken.refused() == [8]
    taken.run()
    assert taken.flies()


def test_an_old_position_that_comes_late_is_old(taken):
    taken.now_s += 2.0
    taken.position(age_s=1.6)
    taken.beat()
    for _ in range(2):
        taken.gate.emptied(taken.now_s)
        taken.beat()
    taken.gate.decided(taken.now_s)
    assert not taken.flies()
    assert taken.refused() == [5]


def test_a_vehicle_that_has_restarted_counts_its_time_anew(taken):
    taken.boot_s += 90.0
    taken.run(10.2)
    assert taken.flies()


def test_a_vehicle_that_restarts_soon_after_its_start_is_flown_again(taken):
    """Its clock goes back by less than a delayed message could be late."""
    taken.now_s += 4.0
    taken.boot_s += 8.0
    taken.run(10.2)
    assert taken.flies()


def test_after_a_restart_the_last_position_is_not_known_any_more(taken):
    """By the new clock it would have been measured in the future, so it would never be too old."""
    for turn in range(220):
        taken.now_s += 0.05
        taken.gate.hear(VehicleTime(time_boot_s=1.0 + 0.05 * turn), taken.now_s)
        taken.beat()
        taken.gate.emptied(taken.now_s)
        taken.gate.decided(taken.now_s)
    assert not taken.flies()
    assert taken.refused() == [8]
    assert taken.asks(HOLD)


# ---------------------------------------------------------------- 9: form


@pytest.mark.parametrize(
    "fields",
    [
        {"frame": 0},
        {"frame": 7},
        {"frame": 8},
        {"mask": 0xDC7},
        {"mask": 0},
        {"mask": 0xFFF},
        {"mask": 0x1C7},
        {"mask": 0xFC7},
        {"north": math.nan},
        {"east": math.inf},
        {"down": -math.inf},
        {"yaw": math.nan},
        {"yaw_rate": math.inf, "mask": 0x5C7},
        {"yaw_rate": 0.1, "mask": 0x5C7},
        {"place": (0.0, math.nan, 0.0)},
        {"push": (math.nan, 0.0, 0.0)},
    ],
)
def test_a_setpoint_is_a_finite_velocity_in_one_frame(taken, fields):
    assert not taken.flies(**fields)
    assert taken.refused() == [9]


@BOTH
@pytest.mark.parametrize("mask", [0x9C7, 0x5C7])
def test_both_masks_leave(firmware, mask):
    assert Flying(firmware=firmware).taken().flies(0.5, 0.0, 0.1, mask=mask)


# ---------------------------------------------------------------- 10: speed


@pytest.mark.parametrize(
    ("velocity", "leaves"),
    [
        ((5.0, 0.0, 0.0), True),
        ((5.01, 0.0, 0.0), False),
        ((3.6, -3.6, 0.0), False),
        ((4.0, 3.0, 0.2), False),
        ((0.0, 0.0, -2.0), True),
        ((0.0, 0.0, -2.01), False),
        ((0.0, 0.0, 1.5), True),
        ((0.0, 0.0, 1.51), False),
    ],
)
def test_speed_climb_and_descent_are_bounded(velocity, leaves):
    one = Flying(config(limits={"max_speed_mps": 5.0, "max_climb_mps": 2.0, "max_descent_mps": 1.5})).taken()
    assert flown_at(one, *velocity).flies(*velocity) is leaves
    assert one.refused() == ([] if leaves else [10])


@pytest.mark.parametrize(
    ("key", "value", "velocity"),
    [
        ("speed_mps", 3.0, (3.1, 0.0, 0.0)),
        ("climb_mps", 1.0, (0.0, 0.0, -1.1)),
        ("descent_mps", 0.7, (0.0, 0.0, 0.8)),
    ],
)
def test_the_vehicles_own_limits_count_where_they_are_lower(key, value, velocity):
    one = Flying().taken()
    assert flown_at(one, *velocity).flies(*velocity)
    lower = {key: Parameter(name="P", value=value)}
    one.gate.hear(VehicleParameters(firmware=ARDUPILOT, **lower), one.now_s)
    assert not one.flies(*velocity)
    one.run(4.0)
    higher = {key: Parameter(name="P", value=50.0)}
    one.gate.hear(VehicleParameters(firmware=ARDUPILOT, **higher), one.now_s)
    assert one.flies(*velocity)
    assert not flown_at(one, 6.0, 0.0, 0.0).flies(6.0)
    assert one.refused() == [10, 10]
