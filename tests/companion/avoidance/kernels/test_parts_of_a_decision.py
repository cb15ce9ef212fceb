"""What a decision consists of before others are seen: bounds of the down speed, the wish, the start."""

from __future__ import annotations

import math
from typing import Any

import pytest

from companion.avoidance import kernels as k
from companion.avoidance.kernels.decide import _preferred, _started, _turned
from companion.avoidance.law import Law, Situation, settings_of
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig

LIMITS = LimitsConfig(max_speed_mps=5.0, max_climb_mps=2.0, max_descent_mps=1.5, max_acceleration_mps2=1.0)
NORTH = Trajectory([0.0, 500.0], [(0.0, 0.0, -50.0), (1000.0, 0.0, -50.0)])
"""2 m/s."""


def settings(path: Trajectory = NORTH, **avoidance: Any) -> k.Settings:
    return settings_of(AvoidanceConfig(**{"recovery_time_s": 10.0, **avoidance}), LIMITS, path)


def own(position: Any = (0.0, 0.0, -50.0), velocity: Any = (2.0, 0.0, 0.0), **more: float) -> k.Own:
    values = {"sigma_m": 1.0, "now_s": 50.0, "path_time_s": 50.0, "floor_d": math.inf, "ceiling_d": -math.inf}
    return k.Own(k.Vector(*position), k.Vector(*velocity), **{**values, **more})


# ---------------------------------------------------------------- floor and ceiling

STOP = math.sqrt(3.0) - 1.0
"""v + v^2 / 2 = 1: the greatest speed that ends within a metre, at 1 m/s^2 after a second."""


@pytest.mark.parametrize(
    ("floor_m", "ceiling_m", "least", "most"),
    [
        # Distances below and above the vehicle.
        (math.inf, math.inf, -2.0, 1.5),
        (10.0, 10.0, -2.0, 1.5),
        (1.0, math.inf, -2.0, STOP),
        (math.inf, 1.0, -STOP, 1.5),
        (0.0, math.inf, -2.0, 0.0),
        # Beyond one, the way back within a second, no faster than the vehicle climbs or descends.
        (-1.0, math.inf, -2.0, -1.0),
        (-9.0, math.inf, -2.0, -2.0),
        (math.inf, -1.0, 1.0, 1.5),
        (math.inf, -9.0, 1.5, 1.5),
        # Below the floor, with the ceiling near above: the floor precedes.
        (-1.0, 1.0, -1.0, -1.0),
    ],
)
def test_the_down_speed_stops_before_floor_and_ceiling(
    floor_m: float, ceiling_m: float, least: float, most: float
) -> None:
    here = own(floor_d=-50.0 + floor_m, ceiling_d=-50.0 - ceiling_m)
    assert k.down_speeds(here, settings()) == pytest.approx((least, most))


@pytest.mark.parametrize("limit_mps2", [1.0, LimitsConfig().max_acceleration_mps2, 9.0])
@pytest.mark.parametrize("vertical_mps", [2.0, 3.0, 5.0, 8.0])
@pytest.mark.parametrize("downwards", [1.0, -1.0])
def test_a_vehicle_of_1_mps2_vertically_keeps_floor_and_ceiling(
    limit_mps2: float, vertical_mps: float, downwards: float
) -> None:
    """It dives towards a point beyond it, whatever acceleration of the command is configured: it answers with
    a lag of 0.4 s, and accelerates by 1 m/s^2 vertically."""
    limits = LimitsConfig(
        max_speed_mps=10.0, max_descent_mps=vertical_mps, max_climb_mps=vertical_mps,
        max_acceleration_mps2=limit_mps2,
    )  # fmt: skip
    points = [(0.0, 0.0, 0.0), (60.0, 0.0, 60.0 * vertical_mps * downwards)]
    law = Law(AvoidanceConfig(), limits, Trajectory([0.0, 60.0], points))
    down, speed, command, beyond = 0.0, 0.0, 0.0, -math.inf
    for tick in range(600):
        t = 0.1 * tick
        if tick % 2 == 0:
            here = (t, 0.0, down)
            floor, ceiling = (100.0, None) if downwards > 0.0 else (None, -100.0)
            view = Situation(t, t, here, (1.0, 0.0, speed), 1.0, (), floor, ceiling)
            command = law.decide(view).chosen_ned_mps[2]
        speed += 0.1 * min(max((command - speed) / 0.4, -1.0), 1.0)
        down += 0.1 * speed
        beyond = max(beyond, downwards * down - 100.0)
    assert -5.0 < beyond < 0.1


# ---------------------------------------------------------------- the wish


@pytest.mark.parametrize(
    ("position", "wanted"),
    [
        # The path's point is at (100, 0, -50); the gap is closed within 10 s.
        ((100.0, 0.0, -50.0), (2.0, 0.0, 0.0)),
        ((100.0, 5.0, -50.0), (2.0, -0.5, 0.0)),
        ((110.0, 0.0, -40.0), (1.0, 0.0, -1.0)),
        # No faster than the vehicle climbs, descends and flies.
        ((100.0, 0.0, -20.0), (2.0, 0.0, -2.0)),
        ((100.0, 0.0, -80.0), (2.0, 0.0, 1.5)),
        ((40.0, 0.0, -50.0), (5.0, 0.0, 0.0)),
    ],
)
def test_the_wish_is_the_paths_velocity_and_the_way_back(position: Any, wanted: Any) -> None:
    path = k.Path(*NORTH.arrays)
    made, _ = _preferred(own(position), path, settings(), 0.0, -2.0, 1.5)
    assert made == pytest.approx(wanted)
    # A path that is 10 s late is 20 m behind.
    behind = (position[0] - 20.0, *position[1:])
    made, _ = _preferred(own(behind), path, settings(), 10.0, -2.0, 1.5)
    assert made == pytest.approx(wanted)


def test_before_and_after_the_path_only_the_gap_leads() -> None:
    path = k.Path(*NORTH.arrays)
    for time_s, n in ((-5.0, 0.0), (505.0, 1000.0)):
        made, slower = _preferred(
            own((n - 10.0, 0.0, -50.0), path_time_s=time_s), path, settings(), 0.0, -2.0, 1.5
        )
        assert made == pytest.approx((1.0, 0.0, 0.0))
        assert slower == 0.0


def test_a_corner_is_turned_over_the_time_that_the_acceleration_needs() -> None:
    """2 m/s are turned by a right angle: a change of 2.83 m/s, half of it ahead of the corner."""
    corner = Trajectory([0.0, 50.0, 100.0], [(0.0, 0.0, -50.0), (100.0, 0.0, -50.0), (100.0, 100.0, -50.0)])
    made = settings(corner)
    assert made.turn_s == pytest.approx(math.sqrt(2.0))
    wanted, _ = _preferred(own((100.0, 0.0, -50.0)), k.Path(*corner.arrays), made, 0.0, -2.0, 1.5)
    assert wanted == pytest.approx((1.0, 1.0, 0.0))


@pytest.mark.parametrize(
    ("behind_m", "slower"),
    [
        # 3 m/s in reserve make up for 90 m in 30 s. What is more is given up within 10 s.
        (89.0, 0.0),
        (92.0, 0.1),
        (100.0, 0.5),
        (300.0, 1.0),
        (-100.0, 0.0),
    ],
)
def test_a_path_that_cannot_be_caught_up_with_waits(behind_m: float, slower: float) -> None:
    path = k.Path(*NORTH.arrays)
    here = own((100.0 - behind_m, 20.0, -50.0))
    assert _preferred(here, path, settings(), 0.0, -2.0, 1.5)[1] == pytest.approx(slower)
    assert _preferred(here, path, settings(law="paper"), 0.0, -2.0, 1.5)[1] == 0.0


@pytest.mark.parametrize(
    ("sinking_mps", "most_mps"),
    [
        # The whole velocity is limited by its vertical part: 2 m/s up, 1.5 m/s down.
        (-1.0, math.sqrt(5.0) * 2.0),
        (1.0, math.sqrt(5.0) * 1.5),
        (-0.1, 5.0),
        (0.1, 5.0),
    ],
)
def test_a_climb_or_descent_leaves_less_in_reserve(sinking_mps: float, most_mps: float) -> None:
    path = Trajectory([0.0, 500.0], [(0.0, 0.0, -500.0), (1000.0, 0.0, -500.0 + 500.0 * sinking_mps)])
    speed = math.hypot(2.0, sinking_mps)
    reserve = min(most_mps, 5.0) - speed
    behind_s = (30.0 * reserve + 4.0 * speed) / speed  # 4 s more than can be made up for
    here = own(path.position(50.0 - behind_s))
    slower = _preferred(here, k.Path(*path.arrays), settings(path), 0.0, -2.0, 1.5)[1]
    assert slower == pytest.approx(0.4)


def test_a_turn_to_the_right() -> None:
    assert _turned(k.Vector(2.0, 0.0, 1.0), math.radians(90.0)) == pytest.approx((0.0, 2.0, 1.0))
    assert _turned(k.Vector(0.0, 2.0, 1.0), math.radians(30.0)) == pytest.approx((-1.0, math.sqrt(3.0), 1.0))
    assert _turned(k.Vector(1.0, 2.0, 3.0), 0.0) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("speed", [11.0, 20.0, 40.0])
def test_a_fast_aircraft_turns_aside_with_two_metres_per_second(speed: float) -> None:
    turned = _turned(k.Vector(0.0, speed, 1.0), 0.2)
    assert turned == pytest.approx((-2.0, math.sqrt(speed * speed - 4.0), 1.0))
    assert _turned(k.Vector(0.0, 10.0, 1.0), 0.2) == (-10.0 * math.sin(0.2), 10.0 * math.cos(0.2), 1.0)


# ---------------------------------------------------------------- the start

COMMAND = k.Vector(1.0, 2.0, -0.5)


@pytest.mark.parametrize(
    ("period_s", "passed_s", "goes_on"),
    [
        # One second, or five periods if those are longer.
        (0.1, 0.9, True),
        (0.1, 1.1, False),
        (0.2, 0.2, True),
        (0.5, 2.4, True),
        (0.5, 2.6, False),
        (0.2, math.nan, False),
    ],
)
def test_the_change_begins_at_the_last_command_or_after_a_pause_at_the_velocity(
    period_s: float, passed_s: float, goes_on: bool
) -> None:
    state = k.State(COMMAND, 50.0 - passed_s, 0.0, 0.0, 0)
    before, change = _started(own(velocity=(0.5, -0.5, 0.2)), state, settings(period_s=period_s))
    assert before == pytest.approx(COMMAND if goes_on else (0.5, -0.5, 0.2))
    assert change == pytest.approx(passed_s if goes_on else period_s)


@pytest.mark.parametrize(
    ("velocity", "before"),
    [
        ((0.0, 0.0, -9.0), (0.0, 0.0, -2.0)),
        ((0.0, 0.0, 9.0), (0.0, 0.0, 1.5)),
        ((6.0, 8.0, 0.0), (3.0, 4.0, 0.0)),
    ],
)
def test_a_start_is_within_the_limits(velocity: Any, before: Any) -> None:
    state = k.State(COMMAND, math.nan, 0.0, 0.0, 0)
    assert _started(own(velocity=velocity), state, settings())[0] == pytest.approx(before)


def test_time_that_does_not_pass_allows_no_change() -> None:
    assert _started(own(), k.State(COMMAND, 50.5, 0.0, 0.0, 0), settings()) == (COMMAND, 0.0)


# ---------------------------------------------------------------- whole decisions


def at(now_s: float, position: Any, path_time_s: float = 50.0) -> Situation:
    return Situation(now_s, path_time_s, position, (2.0, 0.0, 0.0), 1.0, ())


@pytest.mark.parametrize(("pause_s", "late_s"), [(0.2, 0.1), (0.9, 0.45), (1.1, 0.0)])
def test_the_path_waits_while_decisions_follow_each_other(pause_s: float, late_s: float) -> None:
    """100 m behind it waits for half of the time; a pause counts for nothing."""
    law = Law(AvoidanceConfig(recovery_time_s=10.0), LIMITS, NORTH)
    law.decide(at(50.0, (0.0, 0.0, -50.0)))
    assert law.late_s == 0.0
    law.decide(at(50.0 + pause_s, (0.0, 0.0, -50.0)))
    assert law.late_s == pytest.approx(late_s)


@pytest.mark.parametrize(("off_m", "recovering"), [(1.9, False), (2.1, True), (-2.1, True)])
@pytest.mark.parametrize("law", ["dmuca", "none"])
def test_off_its_path_it_recovers(law: Any, off_m: float, recovering: bool) -> None:
    made = Law(AvoidanceConfig(law=law, regained_m=2.0), LIMITS, NORTH)
    assert made.decide(at(50.0, (100.0, off_m, -50.0))).recovering == recovering
