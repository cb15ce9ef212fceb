"""The timed path."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.avoidance.trajectory import Trajectory, check_speeds
from companion.config import LimitsConfig
from companion.errors import ConfigError

# North for 10 s, a hover of 5 s, then east and down.
PATH = Trajectory([10, 20, 25, 35], [(0, 0, -50), (20, 0, -50), (20, 0, -50), (20, 30, -45)])


@pytest.mark.parametrize(
    ("t", "position", "velocity"),
    [
        (-5, (0, 0, -50), (0, 0, 0)),
        (10, (0, 0, -50), (2, 0, 0)),
        (15, (10, 0, -50), (2, 0, 0)),
        (20, (20, 0, -50), (0, 0, 0)),
        (22, (20, 0, -50), (0, 0, 0)),
        (30, (20, 15, -47.5), (0, 3, 0.5)),
        (35, (20, 30, -45), (0, 0, 0)),
        (1e9, (20, 30, -45), (0, 0, 0)),
    ],
)
def test_position_and_velocity(t: float, position: tuple[float, ...], velocity: tuple[float, ...]) -> None:
    assert PATH.position(t) == pytest.approx(position)
    assert PATH.velocity(t) == pytest.approx(velocity)


def test_ends_and_speed() -> None:
    assert (PATH.start_s, PATH.end_s) == (10, 35)
    assert PATH.max_speed() == pytest.approx(math.hypot(3, 0.5))


@pytest.mark.parametrize(
    ("position", "t", "point"),
    [
        ((10, 7, -40), 15, (10, 0, -50)),
        ((-30, 0, -50), 10, (0, 0, -50)),
        ((20, -5, -50), 20, (20, 0, -50)),  # the hover: its first moment
        ((20, 90, -35), 35, (20, 30, -45)),
    ],
)
def test_nearest(position: tuple[float, ...], t: float, point: tuple[float, ...]) -> None:
    t_nearest, nearest = PATH.nearest(position)  # type: ignore[arg-type]
    assert t_nearest == pytest.approx(t)
    assert nearest == pytest.approx(point)


def test_nearest_is_nearest() -> None:
    rng = np.random.default_rng(3)
    for position in rng.uniform(-60, 60, (50, 3)).tolist():
        _, nearest = PATH.nearest(tuple(position))
        some = [math.dist(PATH.position(t), position) for t in np.linspace(10, 35, 400)]
        assert math.dist(nearest, position) <= min(some) + 1e-9


def test_delayed_moves_only_the_times() -> None:
    later = PATH.delayed(4.0)
    assert (later.start_s, later.end_s) == (14, 39)
    assert later.position(19) == pytest.approx(PATH.position(15))
    assert PATH.end_s == 35


def test_a_wait_of_a_rounding_error_can_be_delayed() -> None:
    """0.3 s and 0.1 + 0.2 s differ by less than the rounding of the delayed times."""
    path = Trajectory([0.0, 0.3, 0.1 + 0.2, 1.0], [(0, 0, 0), (3, 0, 0), (3, 0, 0), (10, 0, 0)])
    later = path.delayed(100.0)
    assert later.times_s[1] == later.times_s[2]
    assert later.position(100.3) == pytest.approx((3, 0, 0))
    assert later.position(100.65) == pytest.approx((6.5, 0, 0))
    assert later.nearest((6.5, 1.0, 0.0))[0] == pytest.approx(100.65)


def test_from_rows() -> None:
    rows = np.array([[0.0, 1, 2, -3], [10.0, 4, 5, -6]])
    path = Trajectory.from_rows(rows)
    assert path.times_s == (0.0, 10.0)
    assert path.points_ned_m == ((1, 2, -3), (4, 5, -6))


@pytest.mark.parametrize(
    ("times", "points", "words"),
    [
        ([0], [(0, 0, 0)], "two or more"),
        ([0, 1], [(0, 0, 0)], "two or more"),
        ([0, 5, 5], [(0, 0, 0)] * 3, r"waypoint\[2\].*not after"),
        ([0, 5, 4], [(0, 0, 0)] * 3, r"waypoint\[2\].*not after"),
        ([0, math.nan], [(0, 0, 0)] * 2, r"waypoint\[1\].*not finite"),
        ([0, 1], [(0, 0, 0), (0, math.inf, 0)], r"waypoint\[1\].*not finite"),
    ],
)
def test_wrong_waypoints_are_named(times: list[float], points: list[object], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        Trajectory(times, points)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("step", "words"),
    [
        ((5.1, 0, 0), "horizontal speed 5.100 m/s is above limits.max_speed_mps 5"),
        ((0, 0, -2.1), "climb 2.100 m/s is above limits.max_climb_mps 2"),
        ((0, 0, 1.6), "descent 1.600 m/s is above limits.max_descent_mps 1.5"),
        ((4.9, 0, 1.4), "total speed 5.096 m/s is above limits.max_speed_mps 5"),
    ],
)
def test_too_fast_a_leg_is_named(step: tuple[float, ...], words: str) -> None:
    limits = LimitsConfig(max_descent_mps=1.5)
    end = tuple(10 * s for s in step)
    path = Trajectory([0, 10, 20], [(0, 0, 0), (0, 0, 0), end])  # type: ignore[list-item]
    with pytest.raises(ConfigError) as error:
        check_speeds(path, limits)
    assert words in str(error.value)
    assert "leg from waypoint[1] to waypoint[2]" in str(error.value)


def test_a_leg_at_the_limit_passes() -> None:
    check_speeds(Trajectory([0, 3], [(0, 0, 0), (15 + 1e-6, 0, 0)]), LimitsConfig())
    check_speeds(Trajectory([0, 7], [(0, 0, 0), (0, 0, -14)]), LimitsConfig())
