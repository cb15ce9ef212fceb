"""Walls and their planes, case by case, with places and speeds that were computed by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.avoidance.kernels.fence_planes import Site, wall_planes

Place = tuple[float, float]


def polygon(kind: float, *corners: Place, area: float = 0.0) -> Floats:
    ends = (*corners[1:], corners[0])
    return np.array([(area, kind, *a, *b, 0.0) for a, b in zip(corners, ends, strict=True)])


def circle(kind: float, n: float, e: float, radius_m: float, area: float = 0.0) -> Floats:
    return np.array([(area, kind, n, e, 0.0, 0.0, radius_m)])


# ---------------------------------------------------------------- walls


@pytest.mark.parametrize(
    ("place", "room_m", "way"),
    [
        ((55.0, 10.0), 40.0, (0.6, -0.8)),  # 30 m north and 40 m west of the centre
        ((28.0, 54.0), 5.0, (-0.6, -0.8)),  # 5 m from the centre: the wall is beyond, seen from within
        ((25.0, 60.0), 0.0, (0.0, 1.0)),
    ],
)
@pytest.mark.parametrize("kind", [k.IN_CIRCLE, k.OUT_OF_CIRCLE])
def test_the_nearest_point_of_a_circle(kind: float, place: Place, room_m: float, way: Place) -> None:
    room, direction = k.nearest_of_wall(k.Wall(0.0, kind, 25.0, 50.0, 0.0, 0.0, 10.0), k.Point(*place))
    assert room == pytest.approx(room_m)
    assert direction == pytest.approx(way)


def test_at_the_centre_of_a_circle_any_direction_is_as_good() -> None:
    room, direction = k.nearest_of_wall(
        k.Wall(0.0, k.IN_CIRCLE, 25.0, 50.0, 0.0, 0.0, 10.0), k.Point(25.0, 50.0)
    )
    assert room == pytest.approx(10.0)
    assert math.hypot(*direction) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("place", "room_m", "way"),
    [
        ((11.0, 23.0), 5.0, (-0.8, 0.6)),  # beside its middle
        ((19.0, 17.0), 5.0, (0.8, -0.6)),
        ((-3.0, -4.0), 5.0, (-0.6, -0.8)),  # beyond either end
        ((36.0, 48.0), 10.0, (0.6, 0.8)),
        ((15.0, 20.0), 0.0, (0.0, 0.0)),  # on it, the side is not defined
    ],
)
def test_the_nearest_point_of_an_edge(place: Place, room_m: float, way: Place) -> None:
    room, direction = k.nearest_of_wall(k.Wall(0.0, k.IN_POLYGON, 0.0, 0.0, 30.0, 40.0, 0.0), k.Point(*place))
    assert room == pytest.approx(room_m)
    assert direction == pytest.approx(way)


def test_areas_end_where_the_next_one_begins() -> None:
    triangle = polygon(k.IN_POLYGON, (0.0, 0.0), (10.0, 0.0), (0.0, 10.0))
    hole = polygon(k.OUT_OF_POLYGON, (1.0, 1.0), (3.0, 1.0), (3.0, 3.0), (1.0, 3.0), area=1.0)
    round_one = circle(k.OUT_OF_CIRCLE, 6.0, 2.0, 1.0, area=2.0)
    fence = np.vstack([triangle, hole, round_one])
    assert [k.after_area(fence, first) for first in (0, 3, 7)] == [3, 7, 8]
    where = {(2.0, 2.0): (True, True, False), (6.0, 2.5): (True, False, True), (8.0, 8.0): (False,) * 3}
    for place, expected in where.items():
        rows = ((0, 3), (3, 7), (7, 8))
        assert tuple(k.inside(fence, *row, k.Point(*place)) for row in rows) == expected


EDGE = k.Wall(0.0, k.IN_POLYGON, 10.0, -10.0, 10.0, 10.0, 0.0)
AROUND = k.Wall(0.0, k.OUT_OF_CIRCLE, 10.0, 0.0, 0.0, 0.0, 3.0)
WITHIN = k.Wall(0.0, k.IN_CIRCLE, 10.0, 0.0, 0.0, 0.0, 15.0)


@pytest.mark.parametrize(
    ("wall", "to", "crossed"),
    [
        (EDGE, (9.9, 0.0), False),
        (EDGE, (10.1, 0.0), True),
        (EDGE, (20.0, 15.0), True),  # 7.5 m from the edge's middle
        (EDGE, (20.0, -15.0), True),
        (EDGE, (20.0, 30.0), False),  # past its end
        (EDGE, (20.0, -30.0), False),
        (EDGE, (-20.0, 0.0), False),
        (AROUND, (20.0, 4.0), True),  # 1.96 m from the centre
        (AROUND, (20.0, -8.0), False),  # 3.71 m
        (AROUND, (6.9, 0.0), False),
        (AROUND, (7.1, 0.0), True),
        (AROUND, (-20.0, 0.0), False),
        (AROUND, (0.0, 0.0), False),
        (WITHIN, (24.9, 0.0), False),
        (WITHIN, (25.1, 0.0), True),
        (WITHIN, (10.0, -15.1), True),
        (k.Wall(0.0, k.IN_CIRCLE, 10.0, 5.0, 0.0, 0.0, 15.0), (10.0, 19.9), False),
        (k.Wall(0.0, k.IN_CIRCLE, 10.0, 5.0, 0.0, 0.0, 15.0), (10.0, -10.1), True),
    ],
)
def test_ways_from_the_origin_that_cross_a_wall(wall: k.Wall, to: Place, crossed: bool) -> None:
    assert k.crosses(wall, k.Point(0.0, 0.0), k.Point(*to)) is crossed


# ---------------------------------------------------------------- planes

SPEED, MARGIN, ACCELERATION = 10.0, 2.0, 2.0
BRAKES = k.BRAKES * ACCELERATION
ROOM = polygon(k.IN_POLYGON, (-900.0, -900.0), (100.0, -900.0), (100.0, 900.0), (-900.0, 900.0))
"""Its wall in the north is 100 m away from the origin, the others are out of reach."""


def planes_at(
    fence: Floats, here: Place, command: Place = (0.0, 0.0), *, bound: float = 8.0, gain: float = -math.inf
) -> tuple[list[Any], list[Any]]:
    """Hard and soft planes of a vehicle that flies its command: normal and least speed (n, e, least)."""
    ahead = [x + k.LAG_S * v for x, v in zip(here, command, strict=True)]
    site = Site(fence, k.Point(*here), k.Point(*ahead), MARGIN, SPEED, ACCELERATION)
    table = np.full((k.plane_rows(len(fence), 0), 4), np.nan)
    hard, after = wall_planes(site, k.Vector(*command, 0.0), bound, gain, table, k.DOWN_SPEEDS)
    assert np.isnan(table[: k.DOWN_SPEEDS]).all()  # the rows before are not ours
    assert np.isnan(table[after:]).all()
    assert (table[k.DOWN_SPEEDS : after, 2] == 0.0).all()  # fences are upright
    rows = [(n, e, least) for n, e, _, least in table.tolist()]
    return rows[k.DOWN_SPEEDS : hard], rows[hard:after]


def stops_within(speed: float, free_m: float, bound: float) -> bool:
    """Whether this is the greatest speed that stops within the room: at constant speed until `bound` would
    be braked off, and by the braking distance after a reaction."""
    flown_on = speed * (k.STOP_LAG_S + bound / (2.0 * BRAKES))
    braked = speed * k.STOP_LAG_S + speed * speed / (2.0 * BRAKES)
    return max(flown_on, braked) == pytest.approx(free_m)


@pytest.mark.parametrize("bound", [0.0, 1.0, 8.0])
@pytest.mark.parametrize(("here_n", "command_n"), [(80.0, 8.0), (80.0, 0.0), (80.0, -8.0), (97.0, 0.0)])
def test_a_wall_lets_the_vehicle_come_only_so_fast_that_it_stops(
    here_n: float, command_n: float, bound: float
) -> None:
    (plane,), soft = planes_at(ROOM, (here_n, 0.0), (command_n, 0.0), bound=bound)
    assert soft == []
    assert plane[:2] == (-1.0, 0.0)
    assert stops_within(-plane[2], 100.0 - here_n - 0.5 * command_n - MARGIN, bound)


@pytest.mark.parametrize(("room_m", "count"), [(42.6, 1), (42.8, 0)])
def test_a_wall_beyond_the_way_to_stop_from_full_speed_asks_for_nothing(room_m: float, count: int) -> None:
    """From 10 m/s: 5 m in half a second, 100 / 2.8 m of braking, and the margin."""
    hard, soft = planes_at(ROOM, (100.0 - room_m, 0.0), bound=0.0)
    assert (len(hard), soft) == (count, [])


@pytest.mark.parametrize(
    ("room_m", "command_n", "gain", "asked"),
    [
        (1.0, 0.0, 5.0, 1.0),  # what is missing of the margin, in a second
        (1.9, 0.0, 5.0, 0.1),
        (2.1, 0.0, 5.0, None),
        (1.0, 0.0, 0.3, 0.3),  # no more than can be reached
        (1.0, -0.4, 0.3, 0.7),
        (1.0, 0.5, 0.3, None),  # it flies out still, and cannot fly back yet
        (1.0, 0.0, -math.inf, None),
    ],
)
def test_within_a_walls_margin_the_way_back_is_asked_for(
    room_m: float, command_n: float, gain: float, asked: float | None
) -> None:
    hard, soft = planes_at(ROOM, (100.0 - room_m, 0.0), (command_n, 0.0), bound=0.0, gain=gain)
    assert soft == []
    assert len(hard) == (1 if asked is None else 2)
    assert all(plane[:2] == (-1.0, 0.0) for plane in hard)
    if asked is not None:
        assert hard[1][2] == pytest.approx(asked)


def test_out_of_a_wide_margin_it_flies_slowly() -> None:
    """A fifth of the greatest speed, though 5 m are missing."""
    site = Site(ROOM, k.Point(99.0, 0.0), k.Point(99.0, 0.0), 6.0, SPEED, ACCELERATION)
    table = np.zeros((k.plane_rows(len(ROOM), 0), 4))
    assert wall_planes(site, k.Vector(0.0, 0.0, 0.0), 0.0, 9.0, table, 0) == (2, 2)
    assert table[1].tolist() == pytest.approx([-1.0, 0.0, 0.0, 0.2 * SPEED])


def test_a_way_back_that_another_wall_forbids_is_not_asked_for() -> None:
    """In a gap of 3 m, the margins of both sides overlap: whoever flies back to one comes nearer to the
    other."""
    gap = polygon(k.IN_POLYGON, (97.0, -900.0), (100.0, -900.0), (100.0, 900.0), (97.0, 900.0))
    hard, _ = planes_at(gap, (99.0, 0.0), bound=0.0, gain=9.0)
    assert sorted(hard) == [(-1.0, 0.0, 0.0), (1.0, 0.0, 0.0)]


@pytest.mark.parametrize(
    ("here_n", "gain", "slow", "fast"),
    [
        # 10 m outside: a fifth of the greatest speed must be, half of it shall be.
        (110.0, 9.0, 2.0, 5.0),
        (110.0, 0.5, 0.5, 5.0),
        (110.0, -math.inf, 0.0, 5.0),
        # 1 m outside: the margin too is to be regained in a second.
        (101.0, 9.0, 2.0, 3.0),
    ],
)
def test_outside_nothing_leads_out_and_something_leads_back(
    here_n: float, gain: float, slow: float, fast: float
) -> None:
    hard, soft = planes_at(ROOM, (here_n, 0.0), bound=0.0, gain=gain)
    assert hard[0] == pytest.approx((-1.0, 0.0, slow))
    assert soft == [pytest.approx((-1.0, 0.0, fast))]
    # It stops within a circle of three margins whose border it is on.
    free_m = {(-1.0, 0.0): 0.0, (-0.5, -0.866025): 3.0, (-0.5, 0.866025): 3.0}
    assert {(round(n, 6), round(e, 6)) for n, e, _ in hard[1:]} == set(free_m)
    for n, e, least in hard[1:]:
        assert stops_within(-least, free_m[round(n, 6), round(e, 6)], 0.0)


def test_a_way_back_through_a_forbidden_circle_is_not_required() -> None:
    inside_of = [ROOM, circle(k.OUT_OF_CIRCLE, 104.0, 0.0, 3.0, area=1.0)]
    hard, soft = planes_at(np.vstack(inside_of), (110.0, 0.0), bound=1.0, gain=9.0)
    assert hard[0] == pytest.approx((-1.0, 0.0, 0.0))
    assert len(soft) == 1
    # The circle's own plane: 3 m to it, and 2 m of margin.
    (own,) = [plane for plane in hard if plane[0] == 1.0]
    assert stops_within(-own[2], 1.0, 1.0)


@pytest.mark.parametrize("command", [(0.0, 8.0), (0.0, 0.0), (-3.0, 4.0)])
@pytest.mark.parametrize("bound", [1.0, 8.0])
def test_an_inclusion_circle_is_seen_as_tangents(command: Place, bound: float) -> None:
    """Towards the place ahead, 60 degrees to either side of it, and where the vehicle would stop."""
    radius_m = 30.0
    hard, soft = planes_at(circle(k.IN_CIRCLE, 5.0, -7.0, radius_m), (25.0, -7.0), command, bound=bound)
    assert soft == []
    stop_s = k.STOP_LAG_S + bound / (2.0 * BRAKES)
    ahead = complex(20.0 + 0.5 * command[0], 0.5 * command[1])
    third = complex(0.5, math.sqrt(0.75))
    tangents = [ahead, ahead * third, ahead * third.conjugate(), ahead + stop_s * complex(*command)]
    expected = []
    for tangent in tangents:
        unit = tangent / abs(tangent)
        free_m = radius_m - MARGIN - (ahead * unit.conjugate()).real
        if free_m < 40.7:  # the way to stop from the greatest speed
            expected.append((-unit.real, -unit.imag, free_m))
    assert len(hard) == len(expected)
    for (n, e, least), (north, east, free_m) in zip(hard, expected, strict=True):
        assert (n, e) == pytest.approx((north, east))
        assert stops_within(-least, free_m, bound)


def test_from_the_centre_of_a_circle_only_the_way_that_is_flown_is_bounded() -> None:
    fence = circle(k.IN_CIRCLE, -2.5, 0.0, 20.0)
    (plane,), _ = planes_at(fence, (-5.0, 0.0), (5.0, 0.0))
    assert plane[:2] == (-1.0, 0.0)
    assert stops_within(-plane[2], 18.0, 8.0)


@pytest.mark.parametrize("corner", [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)])
def test_a_corner_right_across_is_seen(corner: Place) -> None:
    """Both edges of a forbidden square have the same nearest point, in an exactly diagonal direction."""
    fence = polygon(k.OUT_OF_POLYGON, (-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-5.0, 5.0))
    hard, _ = planes_at(fence, (8.0 * corner[0], 8.0 * corner[1]), bound=1.0)
    root = math.sqrt(0.5)
    to_corner = [plane for plane in hard if plane[:2] == pytest.approx((root * corner[0], root * corner[1]))]
    assert len(to_corner) == 2
    for plane in to_corner:
        assert stops_within(-plane[2], 3.0 * math.sqrt(2.0) - MARGIN, 1.0)
