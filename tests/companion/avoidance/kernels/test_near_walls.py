"""The command before a wall, where not every plane of the fence can be satisfied, by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.avoidance.kernels.fence_planes import Site, wall_planes
from companion.avoidance.kernels.hard_planes import _least_broken, _stops_inside, _weigh, keep

SPEED, ACCELERATION, MARGIN = 8.0, 1.5, 2.0
CHANGE = 0.2 * ACCELERATION
BRAKES = 0.7 * ACCELERATION
AT_REST = k.Vector(0.0, 0.0, 0.0)
WIDE = k.Bounds(CHANGE, -3.0, 3.0, SPEED)


def north_wall(at_m: float) -> Floats:
    """The inclusion area to the south of a wall; its other borders are far."""
    corners = [(-900.0, -900.0), (at_m, -900.0), (at_m, 900.0), (-900.0, 900.0)]
    ends = [*corners[1:], corners[0]]
    return np.array([(0.0, k.IN_POLYGON, *a, *b, 0.0) for a, b in zip(corners, ends, strict=True)])


def kept(free_m: float, before: k.Vector, wish: k.Vector, bounds: k.Bounds = WIDE) -> k.Vector:
    """The command of a vehicle whose place half a second ahead is `free_m` before the wall's margin."""
    ahead = k.Point(0.5 * before.n, 0.5 * before.e)
    fence = north_wall(ahead.n + MARGIN + free_m)
    site = Site(fence, k.Point(0.0, 0.0), ahead, MARGIN, SPEED, ACCELERATION)
    planes = np.zeros((k.plane_rows(len(fence), 0), 4))
    k.put_plane(planes, 0, k.Vector(0.0, 0.0, 1.0), bounds.least_down)
    k.put_plane(planes, 1, k.Vector(0.0, 0.0, -1.0), -bounds.most_down)
    level = math.hypot(before.n, before.e)
    hard, _ = wall_planes(site, before, min(level + CHANGE, SPEED), BRAKES * 0.2, planes, k.DOWN_SPEEDS)
    return keep(site, wish, before, bounds, planes, hard, np.zeros_like(planes))


def way_to_stop_m(speed: float, brakes: float = BRAKES) -> float:
    """With the time until a command is changed."""
    return 0.5 * speed + speed * speed / (2.0 * brakes)


NORTH = k.Vector(SPEED, 0.0, 0.0)


def test_with_room_to_stop_the_wish_is_followed() -> None:
    assert kept(40.0, k.Vector(5.0, 0.0, 0.0), NORTH) == pytest.approx((5.0 + CHANGE, 0.0, 0.0))


@pytest.mark.parametrize("most_mps", [5.25, 5.0])
def test_a_plane_assumes_the_greatest_speed_in_reach(most_mps: float) -> None:
    """5.3 m/s, until they would be braked off."""
    free_m = way_to_stop_m(most_mps)
    command = kept(free_m, k.Vector(5.0, 0.0, 0.0), NORTH)
    assert command == pytest.approx((free_m / (0.5 + 5.3 / (2.0 * BRAKES)), 0.0, 0.0), abs=1e-6)


@pytest.mark.parametrize("most_mps", [4.9, 4.82, 4.8])
@pytest.mark.parametrize("way", [(1.0, 0.0), (0.8, 0.6), (0.8, -0.6)])
def test_if_that_is_out_of_reach_it_still_stops(most_mps: float, way: tuple[float, float]) -> None:
    free_m = way_to_stop_m(most_mps) * way[0]
    command = kept(free_m, k.Vector(5.0 * way[0], 5.0 * way[1], 0.0), NORTH)
    speed = math.hypot(*command)
    assert command.n / speed * way_to_stop_m(speed) <= free_m + 1e-6
    assert math.dist(command, (5.0 * way[0], 5.0 * way[1], 0.0)) <= CHANGE
    assert speed >= 5.0 - CHANGE


@pytest.mark.parametrize("most_mps", [4.9, 4.8])
@pytest.mark.parametrize("along_mps", [-3.0, 3.0])
def test_what_is_flown_along_the_wall_is_not_braked_off(most_mps: float, along_mps: float) -> None:
    """It flies at it at a slant and would like to fly on so."""
    before = k.Vector(4.0, along_mps, 0.0)
    command = kept(way_to_stop_m(most_mps) * 0.8, before, before)
    assert 3.7 < command.n < 3.73
    assert command.e == pytest.approx(along_mps, abs=1e-6)


@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_along_a_wall_it_flies_on(way: float) -> None:
    """The wall bounds only the speed towards it."""
    before = k.Vector(0.4, 5.0 * way, 0.0)
    command = kept(1.0, before, k.Vector(4.0, 6.0 * way, 0.0))
    stop_s = 0.5 + math.hypot(*command) / (2.0 * BRAKES)
    assert command.n <= 1.0 / stop_s + 1e-6
    assert command.e * way > 4.9


@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_along_a_wall_it_flies_no_faster_than_it_may(way: float) -> None:
    """It wants to be faster, and nearer to the wall than it may come."""
    command = kept(0.2, k.Vector(0.0, 7.9 * way, 0.0), k.Vector(5.0, 9.0 * way, 0.0))
    assert math.hypot(*command) <= SPEED
    assert command.e * way > 7.9


def test_it_brakes_with_all_of_the_limit_if_only_that_stops_it() -> None:
    """5 m/s: 8.33 m with 1.5 m/s^2, 11.9 m with the share of it that is planned with."""
    before = k.Vector(4.0, 3.0, 0.4)
    free_m = 4.0 / 5.0 * 25.0 / (2.0 * ACCELERATION) - MARGIN + 0.1
    command = kept(free_m, before, NORTH)
    assert command == pytest.approx((4.0 * (1.0 - CHANGE / 5.0), 3.0 * (1.0 - CHANGE / 5.0), 0.4))


def test_a_vehicle_that_cannot_stop_any_more_turns_away_with_all_of_the_change() -> None:
    command = kept(1.0, k.Vector(5.0, 0.0, 0.0), NORTH)
    assert command == pytest.approx((5.0 - CHANGE, 0.0, 0.0), abs=1e-6)


def test_floor_and_ceiling_precede_a_wall() -> None:
    """Far too fast a climb takes all of the change."""
    bounds = k.Bounds(CHANGE, -1.0, 3.0, SPEED)
    command = kept(1.0, k.Vector(2.0, 0.0, -2.0), AT_REST, bounds)
    assert command.d == -1.0
    assert command.n == pytest.approx(2.0)


@pytest.mark.parametrize(("excess_m", "inside"), [(-0.01, False), (0.01, True)])
def test_where_braking_straight_on_ends(excess_m: float, inside: bool) -> None:
    """The way of all commands to come, each of which holds for a period, from half a second ahead on."""
    period_s = CHANGE / ACCELERATION
    wall_m = excess_m + sum(period_s * (6.0 - k * CHANGE) for k in range(1, round(6.0 / CHANGE) + 1))
    fence = north_wall(3.0 + wall_m)
    site = Site(fence, k.Point(0.0, 0.0), k.Point(3.0, 0.0), MARGIN, SPEED, ACCELERATION)
    assert _stops_inside(site, k.Vector(6.0, 0.0, 0.0), 6.0, CHANGE) is inside
    assert _stops_inside(site, k.Vector(0.0, 6.0, 0.0), 6.0, CHANGE)


def test_the_nearest_wall_weighs_most() -> None:
    """A plane that allows 2 m/s is 2 m, the margin, and the way to stop from 2 m/s away."""
    planes = np.array([(0, 0, 1, -3.0), (0, 0, -1, -3.0), (-1.0, 0, 0, -2.0), (0.6, 0.8, 0, 0.0)])
    _weigh(planes, 4, MARGIN, BRAKES)
    assert planes[:2].tolist() == [[0, 0, 1, -3], [0, 0, -1, -3]]
    room_m = MARGIN + way_to_stop_m(2.0)
    assert planes[2].tolist() == pytest.approx([-1.0 / room_m, 0.0, 0.0, -2.0 / room_m])
    assert planes[3].tolist() == pytest.approx([0.3, 0.4, 0.0, 0.0])


def broken(
    *walls: Any, before: Any, wish: Any = AT_REST, bounds: k.Bounds = WIDE, outside: bool = False
) -> k.Vector:
    planes = np.zeros((12, 4))
    planes[:2] = (0.0, 0.0, 1.0, bounds.least_down), (0.0, 0.0, -1.0, -bounds.most_down)
    planes[2 : 2 + len(walls)] = walls
    return _least_broken(
        planes, 2 + len(walls), k.Vector(*wish), k.Vector(*before), bounds, outside, np.zeros_like(planes)
    )


def test_a_plane_out_of_reach_gets_all_of_the_change() -> None:
    command = broken((-0.6, 0.8, 0.0, 9.0), before=(3.0, 0.0, 0.5), wish=(0.0, 0.0, 3.0))
    assert command == pytest.approx((3.0 - 0.6 * CHANGE, 0.8 * CHANGE, 0.5), abs=1e-6)


def test_of_two_opposing_planes_neither_is_preferred() -> None:
    """Both ask for 4 m/s; the vertical gets what is left of the change."""
    command = broken(
        (-1.0, 0.0, 0.0, 4.0), (1.0, 0.0, 0.0, 4.0), before=(0.1, 2.0, 0.0), wish=(0.0, 0.0, 3.0)
    )
    assert command.n == pytest.approx(0.0, abs=1e-6)
    assert math.dist(command, (0.1, 2.0, 0.0)) == pytest.approx(CHANGE)
    assert command.d > 0.0


@pytest.mark.parametrize(("wish_d", "down"), [(3.0, 0.6), (-3.0, 0.35), (0.45, 0.45)])
def test_the_vertical_gets_the_rest_of_the_change_within_its_bounds(wish_d: float, down: float) -> None:
    """A wall that asks for nothing leaves all 0.3 m/s of it."""
    bounds = k.Bounds(CHANGE, 0.35, 3.0, SPEED)
    command = broken((-1.0, 0.0, 0.0, -9.0), before=(1.0, 0.0, 0.4), wish=(0.0, 0.0, wish_d), bounds=bounds)
    assert command.d == pytest.approx(down if wish_d < 1.0 else 0.4 + CHANGE)
    assert command[:2] == pytest.approx((1.0, 0.0))


def test_outside_the_way_back_precedes_the_other_walls() -> None:
    command = broken((1.0, 0.0, 0.0, 0.2), (-1.0, 0.0, 0.0, 9.0), before=(0.0, 0.0, 0.0), outside=True)
    assert command.n == pytest.approx(0.2, abs=1e-6)


def test_outside_all_of_the_change_leads_back_if_the_plane_is_out_of_reach() -> None:
    """What the down speed must change comes first: 0.18 of 0.3 m/s leave 0.24 m/s."""
    bounds = k.Bounds(CHANGE, 0.18, 3.0, SPEED)
    command = broken((0.3, 0.4, 0.0, 4.5), before=(-5.0, 0.0, 0.0), bounds=bounds, outside=True)
    assert command == pytest.approx((-5.0 + 0.6 * 0.24, 0.8 * 0.24, 0.18), abs=1e-6)


def test_the_greatest_speed_holds() -> None:
    """All of the change to the side would be 8.006 m/s: the whole velocity is shortened."""
    command = broken((0.0, 1.0, 0.0, 9.0), before=(SPEED, 0.0, 0.0))
    assert math.hypot(*command) == pytest.approx(SPEED)
    assert math.hypot(*command) <= SPEED
    assert command.e / command.n == pytest.approx(CHANGE / SPEED)


def test_the_greatest_speed_holds_where_the_down_speed_may_not_be_shortened() -> None:
    bounds = k.Bounds(CHANGE, 1.19, 1.2, 7.9)
    command = broken((0.0, 1.0, 0.0, 9.0), before=(7.9, 0.0, 1.2), wish=(0.0, 0.0, 1.2), bounds=bounds)
    assert command.d == 1.19
    assert math.hypot(*command) == pytest.approx(7.9)
    assert command.e / command.n == pytest.approx(CHANGE / 7.9)
