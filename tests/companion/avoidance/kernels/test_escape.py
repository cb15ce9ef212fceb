"""Where no velocity within reach keeps the volume of what a sensor sees clear, the law moves aside."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from companion.avoidance import kernels as k
from companion.avoidance.kernels.escape import SAME_SIDE_M, escape, way_aside
from companion.avoidance.law import Law, LawResult, Neighbour, Situation, settings_of
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig

LIMITS = LimitsConfig(max_speed_mps=5.0, max_acceleration_mps2=2.0)
PATH = Trajectory([-100.0, 100.0], [(-300.0, 0.0, -50.0), (300.0, 0.0, -50.0)])
SETTINGS = settings_of(AvoidanceConfig(), LIMITS, PATH)
HERE = 0.0, 0.0, -50.0


def escape_of(
    away: Any, velocity: Any, own: Any = (3.0, 0.0, 0.0), turned: Any = (0.0, 0.0, 0.0), radius: float = 12.0
) -> tuple[tuple[float, float, float], float] | None:
    """Normal and least speed of the plane; None: the plane of ORCA stays."""
    state = k.Own(k.Vector(*HERE), k.Vector(*own), 1.5, 0.0, 0.0, math.inf, -math.inf)
    late, (normal, least) = escape(
        k.Vector(*away), k.Vector(*velocity), state, k.Vector(*turned), radius, SETTINGS
    )
    return ((normal.n, normal.e, normal.d), least) if late else None


@pytest.mark.parametrize(
    ("more", "t"), [(3.0, 1.0), (3.0, 1.5), (3.0, 4.0), (0.0, 2.0), (-1.0, 2.0), (3.0, 0.0)]
)
def test_the_way_aside_is_that_of_a_limited_acceleration_up_to_a_speed(more: float, t: float) -> None:
    times = np.linspace(0.0, t, 100_001)
    speeds = np.minimum(2.0 * times, max(more, 0.0))
    way_m = float((speeds[1:] + speeds[:-1]).sum()) / 2.0 * t / 100_000
    assert way_aside(more, t, 2.0) == pytest.approx(way_m, abs=1e-3)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_it_moves_across_the_relative_motion_to_the_side_that_it_passes_less(side: float) -> None:
    """It passes 1 m beside us, with 13 m/s along and 2 m/s across relative to us."""
    normal, least = escape_of((26.0, side * (4.0 + 1.0), 0.0), (-10.0, -side * 2.0, 0.0)) or (None, 0.0)
    assert normal is not None
    across = np.array([2.0, -13.0]) / math.hypot(13.0, 2.0)
    assert np.array(normal[:2]) == pytest.approx(np.array([across[0], side * across[1]]), abs=1e-9)
    assert normal[2] == 0.0
    drift = 3.0 * normal[0]
    assert least == pytest.approx(drift + 2.0 * (26.0 * 13.0 + 5.0 * 2.0) / (13.0**2 + 2.0**2))


def test_what_can_be_kept_clear_is_left_to_orca() -> None:
    """13 m/s, and half a second until the vehicle answers: a volume of 12 m needs 3.9 s, 51 m."""
    needed_m = 13.0 * (0.5 + 2.5 + (12.0 - 6.25) / 5.0)
    assert escape_of((needed_m + 0.1, 0.0, 0.0), (-10.0, 0.0, 0.0)) is None
    assert escape_of((needed_m - 0.1, 0.0, 0.0), (-10.0, 0.0, 0.0)) is not None
    assert escape_of((20.0, 12.1, 0.0), (-10.0, 0.0, 0.0)) is None, "it passes outside"
    assert escape_of((20.0, 0.0, 0.0), (-10.0, 0.0, 0.0), radius=1.0) is None


@pytest.mark.parametrize(
    ("away", "velocity"),
    [
        ((20.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((-20.0, 0.0, 0.0), (-10.0, 0.0, 0.0)),
        ((20.0, 0.0, 0.0), (3.0, 0.0, 0.0)),
        ((20.0, 0.0, 0.0), (10.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (-10.0, 0.0, 0.0)),
    ],
)
def test_nothing_escapes_from_what_stands_or_comes_no_nearer(away: Any, velocity: Any) -> None:
    assert escape_of(away, velocity) is None


def test_the_side_is_the_one_where_more_can_be_had() -> None:
    """From the right, as if to meet us. At 4.9 of 5 m/s there is nothing ahead, and all behind."""
    away, velocity = (4.9 * 2.0, 20.0, 0.0), (0.0, -10.0, 0.0)
    normal, _ = escape_of(away, velocity, own=(4.9, 0.0, 0.0)) or (None, 0.0)
    assert normal is not None
    assert normal[0] < -0.8
    # It passes a little behind us; and so far behind that more is gained ahead.
    normal, _ = escape_of((away[0] - 0.5, 20.0, 0.0), velocity, own=(4.9, 0.0, 0.0)) or (None, 0.0)
    assert normal is not None
    assert normal[0] < -0.8
    normal, _ = escape_of((away[0] - 3.0, 20.0, 0.0), velocity, own=(4.9, 0.0, 0.0)) or (None, 0.0)
    assert normal is not None
    assert normal[0] > 0.8


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_it_stays_on_the_side_to_which_the_command_has_turned(side: float) -> None:
    """Unless the other one is better by more than what is not known at first."""

    def chosen(off_m: float, turned_mps: float) -> float:
        """The side for something that passes so far on the same side."""
        normal, _ = escape_of(
            (20.0, side * off_m, 0.0), (-10.0, 0.0, 0.0), turned=(0.0, side * turned_mps, 0.0)
        ) or ((0.0, 0.0, 0.0), 0.0)
        return side * normal[1]

    assert chosen(0.5, 0.0) == -1.0
    assert chosen(0.5, 0.4) == 1.0
    assert chosen(0.49 * SAME_SIDE_M, 4.0) == 1.0
    assert chosen(0.51 * SAME_SIDE_M, 4.0) == -1.0
    assert chosen(0.5, 0.02) == -1.0


def decided(relative: bool, **more: Any) -> LawResult:
    """Something at 10 m/s, 26 m ahead and 1 m to the right, on the opposite course."""
    law = Law(AvoidanceConfig(**more), LIMITS, PATH)
    other = Neighbour(
        "A", (26.0, 1.0, -50.0), (-10.0, 0.0, 0.0), 0.0, 0.5, share=1.0, vertical_known=False,
        relative=relative,
    )  # fmt: skip
    return law.decide(Situation(0.0, 0.0, HERE, (3.0, 0.0, 0.0), 0.5, [other]))


def test_the_command_goes_aside_where_it_would_brake() -> None:
    aside, brakes = decided(True).chosen_ned_mps, decided(False).chosen_ned_mps
    assert brakes[0] < 2.8
    assert aside[0] > 2.9
    assert aside[1] < -0.35
    assert abs(aside[1]) > 1.2 * abs(brakes[1])


def test_the_published_law_stays_the_published_one() -> None:
    alike = [decided(relative, law="paper") for relative in (True, False)]
    assert alike[0].chosen_ned_mps == alike[1].chosen_ned_mps


def test_what_passes_above_is_not_avoided_to_the_side() -> None:
    law = Law(AvoidanceConfig(), LIMITS, PATH)
    above = Neighbour("A", (26.0, 1.0, -90.0), (-10.0, 0.0, 0.0), 0.0, 0.5, share=1.0, relative=True)
    result = law.decide(Situation(0.0, 0.0, HERE, (3.0, 0.0, 0.0), 0.5, [above]))
    assert result.chosen_ned_mps == pytest.approx((3.0, 0.0, 0.0), abs=0.01)
