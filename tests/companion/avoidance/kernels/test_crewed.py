"""Crewed traffic: which velocity is chosen, and what it costs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from companion.avoidance import kernels as k
from companion.avoidance.kernels.crewed import LEAST_RISK, _Follow, _free, _place, _predict, _View, _Way
from companion.avoidance.kernels.fence_planes import FENCE_MARGIN_M
from companion.avoidance.kernels.settings import AHEAD_COLUMNS, STEPS
from companion.avoidance.law import settings_of
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig

HOVER = Trajectory([0.0, 500.0], [(0.0, 0.0, -80.0), (0.0, 0.0, -80.0)])
NORTH = Trajectory([0.0, 500.0], [(0.0, 0.0, -80.0), (2500.0, 0.0, -80.0)])
FLOOR_D, CEILING_D = -20.0, -150.0


def other(position: Any, velocity: Any = (0.0, 0.0, 0.0), **more: float) -> k.Other:
    values = {"age_s": 0.0, "sigma_m": 15.0, "sigma_mps": 1.5, "growth_mps": 0.0, "silent": 0.0, "share": 1.0}
    values |= {"vertical_known": 1.0, "crewed": 1.0, "growth_down_mps": 0.0, "turn_rps": 0.0, "yields": 0.0}
    values["relative"] = 0.0
    return k.Other(*map(float, (*position, *velocity)), **{**values, "sigma_down_m": 15.0, **more})


def wish_of(
    *others: k.Other, path: Trajectory = HOVER, walls: Any = k.NO_WALLS, at: Any = (0.0, 0.0, -80.0)
) -> tuple[tuple[float, float, float], bool]:
    """The velocity that is chosen at 0 s, and whether it is another than the path's."""
    table, work = np.zeros((len(others), k.OTHER_COLUMNS)), k.workspace(len(walls), len(others))
    for row, one in enumerate(others):
        k.put_other(table, row, one)
    velocity = k.Vector(*path.velocity(0.0))
    own = k.Own(k.Vector(*at), velocity, 1.5, 0.0, 0.0, FLOOR_D, CEILING_D)
    settings = settings_of(AvoidanceConfig(), LimitsConfig(max_speed_mps=10.0), path)
    wish, gives_way = k.crewed_wish(
        table, len(others), own, velocity, k.Path(*path.arrays), 0.0, walls, settings, velocity, work.ahead
    )
    return tuple(wish), bool(gives_way)


def test_without_crewed_traffic_nothing_changes() -> None:
    """Bit for bit, however near a small aircraft is."""
    wish, gives_way = wish_of(other((5.0, 0.0, -80.0), crewed=0.0), path=NORTH)
    assert (wish, gives_way) == (NORTH.velocity(0.0), False)


@pytest.mark.parametrize("far", [(8000.0, 0.0, -80.0), (0.0, 3000.0, -80.0), (0.0, 0.0, -400.0)])
def test_one_that_stays_far_changes_nothing(far: Any) -> None:
    assert not wish_of(other(far), path=NORTH)[1]


def test_down_comes_first() -> None:
    """It will pass 45 m above: going down suffices."""
    (n, e, d), gives_way = wish_of(other((2200.0, 0.0, -125.0), (-40.0, 0.0, 0.0)))
    assert gives_way
    assert d == pytest.approx(2.0)
    assert math.hypot(n, e) < 0.1


def test_one_below_is_not_passed_below() -> None:
    """It comes 45 m below us, at 35 m."""
    (n, e, d), gives_way = wish_of(other((1500.0, 0.0, -35.0), (-40.0, 0.0, 0.0)))
    assert gives_way
    assert d <= 0.0
    assert d < 0.0 or math.hypot(n, e) > 1.0


@pytest.mark.parametrize("known", [0.0, 1.0])
def test_who_is_near_already_is_left(known: float) -> None:
    """It flies beside us, 90 m to the west and 20 m lower."""
    beside = other((0.0, -90.0, -60.0), (5.0, 0.0, 0.0), vertical_known=known)
    (_, e, d), gives_way = wish_of(beside, path=NORTH)
    assert gives_way
    assert e > 1.0 or d < -1.0
    assert e > 1.0 or known


@pytest.mark.parametrize(("above_m", "conflict"), [(320.0, False), (150.0, True)])
def test_a_descent_is_flown_ahead(above_m: float, conflict: bool) -> None:
    """It passes over us in 10 s and descends at 10 m/s: by 79 m until then, because descents end."""
    coming = other((400.0, 0.0, -80.0 - above_m), (-40.0, 0.0, 10.0))
    assert wish_of(coming)[1] is conflict


def test_an_unknown_height_leaves_the_side() -> None:
    """And away from the line on which it comes, to the nearer side of it."""
    for side in (-150.0, 150.0):
        coming = other((1500.0, side, -300.0), (-40.0, 0.0, 0.0), vertical_known=0.0)
        (_, e, d), gives_way = wish_of(coming)
        assert gives_way
        assert abs(d) < 1e-9
        assert e * side < 0.0


def test_a_turn_is_flown_ahead() -> None:
    """It flies north, 900 m west of us, and is in a turn to the right that leads over us."""
    near = {"velocity": (40.0, 0.0, 0.0), "vertical_known": 0.0}
    straight, _ = wish_of(other((-600.0, -900.0, -80.0), **near))
    turning, gives_way = wish_of(other((-600.0, -900.0, -80.0), turn_rps=math.radians(3.0), **near))
    assert gives_way
    assert turning != pytest.approx(straight, abs=1.0)


@pytest.mark.parametrize("rate", [0.05, -0.03])
def test_a_turn_fades_with_a_time_constant_of_40_s(rate: float) -> None:
    """Less the noise of 0.01 rad/s. Between two moments, 4 s apart, it flies at 50 m/s."""
    ahead = np.zeros((STEPS, AHEAD_COLUMNS))
    _predict(other((0.0, 0.0, -80.0), (50.0, 0.0, 0.0), turn_rps=rate), -80.0, ahead)
    way = np.diff(ahead[:, :2], axis=0)
    middle_s = 4.0 * np.arange(STEPS - 1) + 2.0
    course = math.copysign(abs(rate) - 0.01, rate) * 40.0 * (1.0 - np.exp(-middle_s / 40.0))
    assert np.arctan2(way[:, 1], way[:, 0]) == pytest.approx(course, abs=0.005)
    assert np.hypot(*way.T) == pytest.approx(200.0, rel=0.005)


@pytest.mark.parametrize("speed_mps", [0.0, 1.0, 3.0])
def test_before_a_slow_one_the_path_waits(speed_mps: float) -> None:
    """A helicopter that hovers ahead, or comes slowly, is not fled from at full speed."""
    (n, e, _), gives_way = wish_of(other((900.0, 0.0, -80.0), (-speed_mps, 0.0, 0.0)), path=NORTH)
    assert gives_way
    assert math.hypot(n, e) < 10.0 - 1e-9


def test_a_wall_is_no_way_out() -> None:
    """What flies east because a slower aircraft comes from the west stays inside of an area 60 m wide."""
    coming = other((1500.0, -200.0, -80.0), (-40.0, 0.0, 0.0), vertical_known=0.0)
    assert wish_of(coming)[0][1] > 5.0
    corners = [(-3000.0, -3000.0), (3000.0, -3000.0), (3000.0, 30.0), (-3000.0, 30.0)]
    walls = np.array(
        [
            k.Wall(0.0, k.IN_POLYGON, *a, *b, 0.0)
            for a, b in zip(corners, (*corners[1:], corners[0]), strict=True)
        ]
    )
    (n, e, _), _ = wish_of(coming, walls=walls)
    assert (n, e) != pytest.approx(wish_of(coming)[0][:2])


@pytest.mark.parametrize("sigma_m", [1.0, 6.0])
def test_the_way_to_a_wall_leaves_its_margin_and_the_error_of_the_own_position(sigma_m: float) -> None:
    wall = np.array([k.Wall(0.0, k.IN_POLYGON, 100.0, -900.0, 100.0, 900.0, 0.0)])
    own = k.Own(k.Vector(20.0, 0.0, -80.0), k.Vector(0.0, 0.0, 0.0), sigma_m, 0.0, 0.0, FLOOR_D, CEILING_D)
    assert _free(wall, own, 3.0, 0.0) == pytest.approx(80.0 - FENCE_MARGIN_M - 2.0 * sigma_m)
    assert _free(wall, own, -3.0, 0.0) == math.inf


@pytest.mark.parametrize(("t_s", "left"), [(0.0, 1.0), (2.0, 0.6), (5.0, 0.0), (20.0, 0.0)])
def test_the_way_along_the_path_closes_the_gap_to_it(t_s: float, left: float) -> None:
    """The path leads north at 5 m/s; the aircraft is 13 m from it, and returns at 2.6 m/s."""
    own = k.Own(k.Vector(3.0, 4.0, -92.0), k.Vector(0.0, 0.0, 0.0), 1.5, 0.0, 0.0, FLOOR_D, CEILING_D)
    follow = _Follow(k.Vector(3.0, 4.0, -12.0), 2.6, 0.0)
    view = _View(0, np.zeros((0, 1, 1)), own, k.Path(*NORTH.arrays), follow, 600.0, 75.0)
    place = _place(_Way(k.Vector(5.0, 0.0, 0.0), 0.0, math.inf, 1.0, 1.0), t_s, view)
    assert place == pytest.approx((5.0 * t_s + 3.0 * left, 4.0 * left, -80.0 - 12.0 * left))


def test_only_the_place_relative_to_us_counts() -> None:
    """One that comes first of more than can be weighed, and far from the origin."""
    n, e = 20_000.0, -30_000.0
    there = Trajectory([0.0, 500.0], [(n, e, -80.0), (n, e, -80.0)])
    crowd = [(9000.0, 100.0 * i, -80.0) for i in range(40)]
    places = [*crowd, (1500.0, 100.0, -85.0)]
    here = wish_of(*(other(place, (-40.0, 0.0, 0.0)) for place in places))
    moved = (other((x + n, y + e, z), (-40.0, 0.0, 0.0)) for x, y, z in places)
    wish, gives_way = wish_of(*moved, path=there, at=(n, e, -80.0))
    assert gives_way
    assert wish == pytest.approx(here[0])


def test_two_cost_more_than_one() -> None:
    """Between two that pass on both sides, above, it goes down."""
    two = [other((1500.0, side, -110.0), (-40.0, 0.0, 0.0)) for side in (-300.0, 300.0)]
    (_, _, d), gives_way = wish_of(*two)
    assert gives_way
    assert d > 1.5


def test_of_a_crowd_those_count_that_could_come_first() -> None:
    """However many others are farther away, and wherever in the table it stands."""
    crowd = [other((5000.0, 10.0 * i, -80.0), (-40.0, 0.0, 0.0)) for i in range(60)]
    near = other((1500.0, 100.0, -85.0), (-40.0, 0.0, 0.0))
    for row in (0, 30, 60):
        wish, gives_way = wish_of(*crowd[:row], near, *crowd[row:])
        assert gives_way
        assert wish != NORTH.velocity(0.0)
    assert not wish_of(*crowd)[1]


@pytest.mark.parametrize("degrees", [-12.0, 0.0, 3.0])
def test_turn_rates(degrees: float) -> None:
    rate, before = 0.0, (30.0, 0.0, 0.0)
    for t in range(1, 30):
        course = math.radians(degrees * t)
        now = (30.0 * math.cos(course), 30.0 * math.sin(course), 1.0)
        rate = k.turn_rate(rate, before, now, 1.0)
        before = now
    assert math.degrees(rate) == pytest.approx(degrees, abs=1e-4)


def test_turn_rates_are_bounded_and_those_of_hovering_aircraft_are_zero() -> None:
    assert k.turn_rate(0.0, (30.0, 0.0, 0.0), (-30.0, 1.0, 0.0), 0.1) <= 0.35
    assert k.turn_rate(0.0, (0.5, 0.0, 0.0), (0.0, 0.5, 0.0), 1.0) == 0.0
    assert k.turn_rate(0.1, (30.0, 0.0, 0.0), (0.0, 30.0, 0.0), 0.0) == 0.1
    assert k.turn_rate(0.0, (0.0, 0.0, 0.0), (0.0, 30.0, 0.0), math.inf) == 0.0


def test_the_noise_of_courses_is_no_turn() -> None:
    """Or each message would tell it to leave on another side."""
    coming = {"position": (1500.0, 40.0, -80.0), "velocity": (-50.0, 0.0, 0.0), "vertical_known": 0.0}
    left, right = (wish_of(other(**coming, turn_rps=rate))[0] for rate in (-0.009, 0.009))
    assert left == right
    assert left[1] < -5.0


@pytest.mark.parametrize("known", [0.0, 1.0])
def test_too_late_to_stay_clear_it_still_makes_room(known: float) -> None:
    """Seven seconds before an aircraft on the same line, no velocity leaves the volume of a near miss."""
    coming = other((350.0, 10.0, -80.0), (-50.0, 0.0, 0.0), vertical_known=known)
    (n, e, d), gives_way = wish_of(coming)
    assert gives_way
    assert e < -5.0 or (known and abs(d) > 1.0)
    assert math.sqrt(n * n + e * e + d * d) > 2.0


def test_ghosts_far_above_crowd_nobody_out() -> None:
    """A hundred of them hover in the sky over us, in earlier rows of the table."""
    ghosts = [other((0.0, 0.0, -9000.0 + i)) for i in range(100)]
    coming = other((1500.0, 0.0, -80.0), (-40.0, 0.0, 0.0))
    assert not wish_of(*ghosts)[1]
    assert wish_of(*ghosts, coming) == wish_of(coming)


def test_a_conflict_has_a_name_even_if_nobody_alone_would_be_one() -> None:
    table, work = np.zeros((2, k.OTHER_COLUMNS)), k.workspace(0, 2)
    for row in range(2):
        k.put_other(table, row, other((0.0, 300.0, -204.72)))
    settings = settings_of(AvoidanceConfig(), LimitsConfig(max_speed_mps=10.0), HOVER)
    own = k.Own(k.Vector(0.0, 0.0, -80.0), k.Vector(0.0, 0.0, 0.0), 1.5, 0.0, 0.0, -50.0, CEILING_D)
    still, path = k.Vector(0.0, 0.0, 0.0), k.Path(*HOVER.arrays)
    for count, conflict in ((1, False), (2, True)):
        found = k.crewed_wish(table, count, own, still, path, 0.0, k.NO_WALLS, settings, still, work.ahead)
        assert found[1] is conflict
        assert bool(work.ahead[:count, 0, 7].max() >= LEAST_RISK) is conflict


def test_one_that_comes_slowly_from_near_is_backed_off_from() -> None:
    """60 m away it is within the volume of a near miss; passing through would be the shortest way out."""
    (n, _, _), gives_way = wish_of(other((60.0, 0.0, -80.0), (-5.0, 0.0, 0.0)))
    assert gives_way
    assert n < 0.0


def test_a_height_without_an_error_is_no_nan() -> None:
    exact = other((0.0, 300.0, -157.0), sigma_down_m=0.0)
    assert wish_of(exact, other((400.0, 0.0, -80.0), (-5.0, 0.0, 0.0)))[1]


@pytest.mark.parametrize("known", [0.0, 1.0])
def test_of_a_crowd_that_is_near_already_the_nearest_count(known: float) -> None:
    """40 circle 500 m around us; one is 60 m away, and comes last in the table."""
    turns = [math.tau * i / 40 for i in range(40)]
    ring = [other((500.0 * math.cos(a), 500.0 * math.sin(a), -80.0), vertical_known=known) for a in turns]
    near = other((0.0, -60.0, -75.0), vertical_known=known)
    alone, _ = wish_of(*ring)
    for row in (0, 40):
        wish, gives_way = wish_of(*ring[:row], near, *ring[row:])
        assert gives_way
        assert wish != pytest.approx(alone)
        assert wish[1] > 1.0 or wish[2] != 0.0
