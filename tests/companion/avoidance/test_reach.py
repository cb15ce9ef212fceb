"""How far ahead and how old traffic counts, and how fast an overlap is left."""

from __future__ import annotations

import math
from typing import Any

import pytest

from companion.avoidance.law import Law, Neighbour, Situation
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig

HERE = (0.0, 0.0, -50.0)
STANDING = Trajectory([0.0, 1000.0], [HERE, HERE])


def other(north_m: float, speed_mps: float = 0.0, age_s: float = 0.0, **more: Any) -> Neighbour:
    """North of us, flying north; its position is exact."""
    values = {"sigma_m": 0.0, "sigma_mps": 0.0, **more}
    return Neighbour("X", (north_m, 0.0, -50.0), (speed_mps, 0.0, 0.0), age_s, **values)


def decided(neighbour: Neighbour, **avoidance: Any) -> tuple[Any, Law]:
    law = Law(AvoidanceConfig(**avoidance), LimitsConfig(), STANDING)
    return law.decide(Situation(10.0, 10.0, HERE, (0.0, 0.0, 0.0), 0.0, (neighbour,))), law


# A conflict radius of 5 m each, and the least margin of 2 m.


@pytest.mark.parametrize(
    ("north_m", "avoidance", "conflict"),
    [
        # At 2 m/s, 60 m are flown in the 30 s that are looked ahead.
        (71.9, {}, True),
        (72.1, {}, False),
        # A longer horizon is looked ahead for.
        (92.0, {"horizon_s": 40.0}, False),
        (91.9, {"horizon_s": 40.0}, True),
    ],
)
def test_a_conflict_is_one_that_begins_within_the_time_looked_ahead(
    north_m: float, avoidance: dict[str, float], conflict: bool
) -> None:
    result, _ = decided(other(north_m, -2.0), **avoidance)
    assert result.conflict == conflict
    assert result.tracks[0].conflict == conflict


@pytest.mark.parametrize(("north_m", "speed_mps"), [(8.0, 2.0), (11.0, 0.5)])
def test_an_overlap_is_left_within_a_second_by_half_of_each(north_m: float, speed_mps: float) -> None:
    _, law = decided(other(north_m))
    assert law._solved[0] == pytest.approx(-speed_mps, abs=0.01)
    _, law = decided(other(north_m, share=1.0))
    assert law._solved[0] == pytest.approx(-2.0 * speed_mps, abs=0.01)


@pytest.mark.parametrize(
    ("age_s", "used"), [(0.0, True), (29.9, True), (30.1, False), (-29.9, True), (-30.1, False)]
)
def test_how_old_a_message_may_be(age_s: float, used: bool) -> None:
    result, _ = decided(other(100.0, 1.0, age_s))
    assert len(result.tracks) == used
    if used:
        # A message from the future is of now.
        assert result.tracks[0].position_ned_m[0] == pytest.approx(100.0 + max(age_s, 0.0))


@pytest.mark.parametrize(
    ("north_m", "used"), [(0.9e7, True), (1.1e7, False), (-1.1e7, False), (math.nan, False)]
)
def test_who_is_on_another_planet_is_left_out(north_m: float, used: bool) -> None:
    result, _ = decided(other(north_m))
    assert len(result.tracks) == used


@pytest.mark.parametrize(
    ("sigma_m", "margin_m"), [(0.0, 2.0), (0.5, 2.0), (0.6, 0.6 * 4.0), (3.0, 3.0 * 4.0)]
)
def test_the_margin_is_a_number_of_deviations_and_at_least_two_metres(
    sigma_m: float, margin_m: float
) -> None:
    result, _ = decided(other(100.0, sigma_m=sigma_m))
    assert result.tracks[0].radius_m == pytest.approx(10.0 + margin_m)


@pytest.mark.parametrize(("growth_mps", "more_m"), [(0.0, 0.4), (0.05, 0.4), (1.0, 6.0), (3.0, 18.0)])
def test_the_age_of_a_message_widens_by_its_resolution_or_its_manoeuvres(
    growth_mps: float, more_m: float
) -> None:
    """At 2 s: 0.2 m/s of resolution; or the growth until 4 s from now."""
    result, _ = decided(other(100.0, age_s=2.0, growth_mps=growth_mps))
    assert result.tracks[0].radius_m == pytest.approx(12.0 + more_m)
