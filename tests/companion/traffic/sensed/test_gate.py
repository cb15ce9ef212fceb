"""Which measurement is of which object: within three deviations of both, and some room."""

from __future__ import annotations

import math
from typing import Any

import pytest

from companion.traffic.sensed.seen import Seen
from tests.companion.traffic.sensed.made import AT_S, edge, objects, pose, seen

ROOM_M, HIGH_M, FAR_M = 1.5, 8.0, 60.0


def variance(first: float, unknown_mps: float, passed_s: float) -> float:
    """Of the place along one direction, when its velocity was not known at first."""
    return first + (unknown_mps * passed_s) ** 2 + 1.5**2 * passed_s**3 / 3.0


def joins(before: Seen, after: Seen, passed_s: float, **config: Any) -> bool:
    """Whether a place is taken for the object that was seen before. If not, there are two."""
    found = objects(before, **config)
    found.see(196, [after], pose(AT_S + passed_s), None)
    assert len(found.held) in (1, 2)
    return len(found.held) == 1


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("passed_s", "range_sigma_m"), [(0.125, 0.3), (1.0, 0.3), (2.0, 1.0)])
def test_the_edge_along_the_line_of_sight(sign: float, passed_s: float, range_sigma_m: float) -> None:
    # The second measurement makes two, after which the first has to be kept for as long as this takes.
    first = seen(60.0, 0.0, number=1)
    found = edge(
        lambda off: joins(first, seen(60.0 + sign * off, 0.0), passed_s, range_sigma_m=range_sigma_m), 59.0
    )
    noise = range_sigma_m**2
    assert found == pytest.approx(ROOM_M + 3.0 * math.sqrt(variance(noise, 6.0, passed_s) + noise), rel=1e-3)


def across_noise(across_m: float, away_m: float, sigma_deg: float, passed_s: float) -> float:
    """The width is that of an even distribution. What follows within 0.7 s counts the less for that, because
    the thing is seen in the same sector."""
    aim = away_m * math.radians(sigma_deg)
    return (across_m**2 / 3.0 + 0.1 * aim**2) * max(1.0, 0.7 / passed_s)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("passed_s", [0.125, 0.5, 1.0])
@pytest.mark.parametrize(("across_m", "sigma_deg"), [(0.0, 1.5), (2.0, 1.5), (0.5, 10.0)])
def test_the_edge_across_it(sign: float, passed_s: float, across_m: float, sigma_deg: float) -> None:
    wide = {"across_m": across_m}
    first = seen(30.0, 0.0, number=1, **wide)
    found = edge(
        lambda off: joins(first, seen(30.0, sign * off, **wide), passed_s, bearing_sigma_deg=sigma_deg), 59.0
    )
    before = across_noise(across_m, 30.0, sigma_deg, 1.0)
    after = across_noise(across_m, math.hypot(30.0, found), sigma_deg, passed_s)
    assert found == pytest.approx(ROOM_M + 3.0 * math.sqrt(variance(before, 3.0, passed_s) + after), rel=1e-3)


def test_the_error_across_is_never_taken_for_less_than_a_decimetre() -> None:
    first, sharp = seen(3.0, 0.0, number=1), {"bearing_sigma_deg": 0.1}
    found = edge(lambda off: joins(first, seen(3.0, off), 1.0, **sharp), 59.0)
    assert found == pytest.approx(ROOM_M + 3.0 * math.sqrt(variance(0.1**2, 3.0, 1.0) + 0.1**2), rel=1e-3)


def test_measurements_of_one_moment_are_not_counted_as_infinitely_alike() -> None:
    first = seen(30.0, 0.0, across_m=2.0)
    found = edge(lambda off: joins(first, seen(30.0, off, across_m=2.0), 0.0), 59.0)
    before, after = across_noise(2.0, 30.0, 1.5, 1.0), across_noise(2.0, math.hypot(30.0, found), 1.5, 0.02)
    assert found == pytest.approx(ROOM_M + 3.0 * math.sqrt(before + after), rel=1e-3)


def test_a_vehicle_that_turns_errs_more_across() -> None:
    def joined(off: float, turn_rps: float) -> bool:
        found = objects(seen(30.0, 0.0))
        found.see(196, [seen(30.0, off)], pose(AT_S + 0.5, turn_rps=turn_rps), None)
        return len(found.held) == 1

    assert edge(lambda off: joined(off, 1.5), 59.0) > 1.05 * edge(lambda off: joined(off, 0.0), 59.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("away_m", "sigma_m"), [(10.0, 1.0), (50.0, 2.5)])
def test_the_edge_in_height(sign: float, away_m: float, sigma_m: float) -> None:
    """A height errs by a metre, or by a twentieth of the distance."""
    first = seen(away_m, 0.0, number=1)
    found = edge(lambda off: joins(first, seen(away_m, 0.0, sign * off), 0.5), 40.0)
    error2 = max(1.0, 0.05 * math.hypot(away_m, found)) ** 2
    expected = HIGH_M + 3.0 * math.sqrt(variance(sigma_m**2, 6.0, 0.5) + error2)
    assert found == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("which", [{"flat": True}, {"tall": True}, {"vertical_known": False}])
@pytest.mark.parametrize("first", [True, False])
def test_a_height_that_is_not_known_separates_nothing(which: dict[str, bool], first: bool) -> None:
    low, high = (
        seen(20.0, 0.0, **(which if first else {})),
        seen(20.0, 0.0, -35.0, **({} if first else which)),
    )
    assert joins(low, high, 0.5)
    assert not joins(seen(20.0, 0.0), seen(20.0, 0.0, -35.0), 0.5)


def test_nothing_farther_off_than_the_limit_is_one_thing_however_large_the_errors() -> None:
    first = seen(100.0, 0.0, number=1, across_m=80.0)
    for step in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)):
        found = edge(
            lambda off, step=step: joins(
                first, seen(100.0 + off * step[0], off * step[1], across_m=80.0), 2.0, range_sigma_m=20.0
            ),
            99.0,
        )
        assert found == pytest.approx(FAR_M, rel=1e-3)


def test_an_aircraft_that_the_sensor_follows_errs_by_three_metres_whatever_its_distance() -> None:
    def joined(off: float, east: float) -> bool:
        found = objects(seen(80.0, 0.0, velocity=(2.0, 0.0, 0.0)))
        found.see(196, [seen(81.0 + off, east, velocity=(2.0, 0.0, 0.0))], pose(AT_S + 0.5), None)
        return len(found.held) == 1

    expected = ROOM_M + 3.0 * math.sqrt(variance(9.0, 1.0, 0.5) + 9.0)
    assert edge(lambda off: joined(off, 0.0), 59.0) == pytest.approx(expected, rel=1e-3)
    assert edge(lambda off: joined(0.0, off), 59.0) == pytest.approx(expected, rel=1e-3)


def test_a_number_of_another_obstacle_is_another_thing_and_one_without_a_number_may_be_any() -> None:
    assert not joins(seen(20.0, 0.0, number=1), seen(20.0, 0.0, number=2), 0.5)
    assert joins(seen(20.0, 0.0, number=1), seen(20.0, 0.0, number=1), 0.5)
    assert joins(seen(20.0, 0.0, number=1), seen(20.0, 0.0), 0.5)
    assert joins(seen(20.0, 0.0), seen(20.0, 0.0, number=1), 0.5)
    found = objects(seen(20.0, 0.0, number=1))
    found.see(197, [seen(20.0, 0.0, number=1)], pose(AT_S + 0.5), None)
    assert len(found.held) == 2, "numbers are those of each component"


def test_each_place_goes_to_the_object_that_it_fits_best_and_each_object_gets_one() -> None:
    found = objects(seen(30.0, 0.0), seen(30.0, 4.0))
    found.see(196, [seen(30.0, 3.2), seen(30.0, 0.4)], pose(AT_S + 0.5), None)
    assert [one.measured for one in found.held] == [2, 2]
    left, right = (one.position[1] for one in found.held)
    assert 0.0 < left < 0.4
    assert 3.2 < right < 4.0
    found = objects(seen(30.0, 0.0))
    found.see(196, [seen(30.0, 1.5), seen(30.0, 0.5)], pose(AT_S + 0.5), None)
    assert [one.measured for one in found.held] == [2, 1], "the second place is a thing of its own"
    assert 0.0 < found.held[0].position[1] < 0.5
    assert found.held[1].position == (30.0, 1.5, 0.0)


def test_deviations_decide_what_fits_best_and_not_metres() -> None:
    """Two metres along the line of sight say more than three across it, where a sector is wide."""
    wide = {"across_m": 4.0}
    found = objects(seen(30.0, 0.0, **wide), seen(34.0, 3.0, **wide))
    found.see(196, [seen(32.4, 1.0, **wide)], pose(AT_S + 0.125), None)
    assert [one.measured for one in found.held] == [1, 2]


def test_the_number_counts_more_than_the_place() -> None:
    found = objects(seen(30.0, 0.0, number=1), seen(30.0, 3.0))
    found.see(196, [seen(30.0, 2.8, number=1)], pose(AT_S + 0.5), None)
    assert [one.measured for one in found.held] == [3, 1]


def test_two_components_may_see_one_thing_at_one_time_but_nothing_goes_back_in_time() -> None:
    found = objects(seen(20.0, 0.0))
    found.see(197, [seen(20.0, 0.0)], pose(AT_S), None)
    assert [one.measured for one in found.held] == [2]
    found.see(196, [seen(20.0, 0.0)], pose(AT_S - 0.125), None)
    assert [one.measured for one in found.held] == [2, 1]
