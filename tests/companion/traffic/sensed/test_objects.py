"""Objects over time: what a measurement changes, what moves, what is kept, and for how many there is
room."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from companion.geometry import Vec3
from companion.traffic.sensed import objects as followed_objects
from companion.traffic.sensed.objects import Followed, Objects, _Axis
from companion.traffic.sensed.seen import Seen
from tests.companion.traffic.sensed.made import AT_S, followed, objects, pose, seen

# ------------------------------------------------------------ one measurement


def test_a_measurement_moves_the_object_as_a_filter_along_and_across_the_line_of_sight_does() -> None:
    """Against a filter in two dimensions whose axes are turned, and one for the height."""
    one = followed(
        position=(30.0, 40.0, 2.0), velocity=(1.0, -2.0, 0.5), along=_Axis(0.4, 0.1, 2.0),
        across=_Axis(3.0, 0.6, 4.0), high=_Axis(2.0, 0.3, 1.5), flat=False,
    )  # fmt: skip
    found = objects(range_sigma_m=0.5)
    found.held = [one]
    place = seen(31.0, 39.0, 2.8, across_m=2.0)
    found.see(196, [place], pose(AT_S + 0.5), None)

    t, q = 0.5, 1.5**2
    f = np.array([[1.0, t], [0.0, 1.0]])
    at = np.array([30.5, 39.0, 2.25])
    away = math.dist(place.position, (0.0, 0.0, 0.0))
    across = (2.0**2 / 3.0 + 0.1 * (away * math.radians(1.5)) ** 2) * 0.7 / t
    unit = at[:2] / np.hypot(*at[:2])
    ways = [np.array([*unit, 0.0]), np.array([-unit[1], unit[0], 0.0]), np.array([0.0, 0.0, 1.0])]
    noises = [0.5**2, across, (0.05 * away) ** 2]
    place_now, velocity_now = at.copy(), np.array([1.0, -2.0, 0.5])
    befores = [(0.4, 0.1, 2.0), (3.0, 0.6, 4.0), (2.0, 0.3, 1.5)]
    for way, noise, (pp, pv, vv), after in zip(
        ways, noises, befores, (one.along, one.across, one.high), strict=True
    ):
        p = f @ np.array([[pp, pv], [pv, vv]]) @ f.T + q * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
        gain = p[:, 0] / (p[0, 0] + noise)
        off = way @ (np.array(place.position) - at)
        place_now += gain[0] * off * way
        velocity_now += gain[1] * off * way
        p = (np.eye(2) - np.outer(gain, [1.0, 0.0])) @ p
        assert tuple(after) == pytest.approx((p[0, 0], p[0, 1], p[1, 1]))
    assert one.position == pytest.approx(tuple(place_now))
    assert one.velocity == pytest.approx(tuple(velocity_now))
    assert (one.at_s, one.measured, one.passed) == (AT_S + 0.5, 3, 0)
    assert one.across_m == 2.0
    assert one.distance_m == pytest.approx(away)


def test_what_lies_straight_above_or_below_is_seen_to_the_north() -> None:
    found = objects(seen(0.0, 0.0, 20.0))
    found.see(196, [seen(0.5, 0.0, 20.0)], pose(AT_S + 0.5), None)
    (one,) = found.held
    assert 0.4 < one.position[0] < 0.5
    assert one.position[1] == 0.0


def test_a_thing_that_was_tall_once_stays_so_and_all_else_is_as_it_was_last_seen() -> None:
    found = objects(seen(20.0, 0.0, tall=True, flat=True, vertical_known=True))
    found.see(196, [seen(20.0, 0.0, tall=False, flat=False, vertical_known=False)], pose(AT_S + 0.5), None)
    (one,) = found.held
    assert (one.tall, one.flat, one.vertical_known) == (True, False, False)
    found.see(196, [seen(20.0, 0.0, flat=True)], pose(AT_S + 1.0), None)
    assert (one.tall, one.flat, one.vertical_known) == (True, True, True)
    found = objects(seen(20.0, 0.0))
    assert not found.held[0].tall
    found.see(196, [seen(20.0, 0.0, tall=True)], pose(AT_S + 0.5), None)
    assert found.held[0].tall


def test_a_new_object_knows_its_place_and_not_its_velocity() -> None:
    here = pose(velocity=(3.0, 1.0, 0.0))
    (one,) = objects(seen(30.0, 40.0, -5.0, across_m=2.0, tall=True), here=here).held
    away = math.sqrt(30.0**2 + 40.0**2 + 5.0**2)
    assert one.position == (30.0, 40.0, -5.0)
    assert one.velocity == (0.0, 0.0, 0.0)
    assert tuple(one.along) == pytest.approx((0.3**2, 0.0, 6.0**2))
    across = 2.0**2 / 3.0 + 0.1 * (away * math.radians(1.5)) ** 2
    assert tuple(one.across) == pytest.approx((across, 0.0, 3.0**2))
    assert tuple(one.high) == pytest.approx(((0.05 * away) ** 2, 0.0, 6.0**2))
    assert (one.across_m, one.distance_m, one.met_mps) == (2.0, pytest.approx(away), (3.0, 1.0, 0.0))
    assert (one.measured, one.passed, one.key) == (1, 0, None)
    assert not one.moves
    assert not one.tracked
    assert one.tall


def test_names_are_given_once() -> None:
    found = objects(seen(20.0, 0.0), seen(-20.0, 0.0))
    found.clear()
    assert found.held == []
    found.see(196, [seen(20.0, 0.0)], pose(AT_S + 1.0), None)
    assert found.held[0].name == "3"


# ------------------------------------------------------------ whether it moves


def judged(moves: bool, **values: Any) -> bool:
    """Whether an object to the north-east counts as moving, after it did or did not."""
    one = followed(moves=moves, **values)
    Objects(objects().config)._judge(one, math.sqrt(0.5), math.sqrt(0.5))
    return one.moves


def turned(along: float, across: float, down: float = 0.0) -> Vec3:
    """A velocity along and across the line of sight to the north-east."""
    k = math.sqrt(0.5)
    return k * (along - across), k * (along + across), down


@pytest.mark.parametrize("flat", [True, False])
def test_a_velocity_beyond_three_deviations_moves_and_one_within_two_stands(flat: bool) -> None:
    for way in (turned(3.0, 0.0), turned(0.0, 3.0)):
        for deviations, before, after in (
            (2.95, False, False), (3.05, False, True), (2.05, True, True), (1.95, True, False),
        ):  # fmt: skip
            vv = (3.0 / deviations) ** 2
            # The other direction errs much more, so that it adds nothing.
            along, across = (vv, 1e6) if way == turned(3.0, 0.0) else (1e6, vv)
            values = {"along": _Axis(0.1, 0.0, along), "across": _Axis(0.5, 0.0, across)}
            assert judged(before, velocity=way, flat=flat, high=_Axis(1.0, 0.0, 1e6), **values) is after


def test_deviations_along_and_across_count_together() -> None:
    """2.2 and 2.2 deviations are 3.1."""
    both = {"along": _Axis(0.1, 0.0, 1.0), "across": _Axis(0.5, 0.0, 4.0)}
    assert judged(False, velocity=turned(2.2, 4.4), **both)
    assert not judged(False, velocity=turned(2.0, 4.4), **both)


def test_what_is_slower_than_a_metre_per_second_stands_however_well_it_is_known() -> None:
    sure = {"along": _Axis(0.1, 0.0, 1e-6), "across": _Axis(0.5, 0.0, 1e-6)}
    assert not judged(True, velocity=turned(0.7, 0.7), **sure)
    assert judged(False, velocity=turned(0.75, 0.75), **sure)


def test_what_climbs_moves_unless_its_height_is_that_of_a_plane() -> None:
    sure = {"high": _Axis(1.0, 0.0, 0.01)}
    for climb in (-1.05, 1.05):
        assert judged(False, velocity=(0.0, 0.0, climb), flat=False, **sure)
        assert not judged(True, velocity=(0.0, 0.0, climb), flat=True, **sure)
    assert not judged(True, velocity=(0.0, 0.0, 0.95), flat=False, **sure)
    for deviations, before, after in ((2.95, False, False), (3.05, False, True), (1.95, True, False)):
        high = _Axis(1.0, 0.0, (2.0 / deviations) ** 2)
        assert judged(before, velocity=(0.0, 0.0, 2.0), flat=False, high=high) is after


def test_an_aircraft_that_the_sensor_follows_moves_if_it_says_so() -> None:
    slow, fast = seen(50.0, 0.0, velocity=(0.5, 0.5, 0.5)), seen(50.0, 0.0, velocity=(0.6, 0.6, 0.6))
    assert [objects(place).held[0].moves for place in (slow, fast)] == [False, True]
    found = objects(fast)
    (one,) = found.held
    assert one.tracked
    assert tuple(one.along) == tuple(one.across) == tuple(one.high) == (9.0, 0.0, 1.0)
    found.see(196, [seen(51.0, 1.0, 2.0, velocity=(0.5, 0.5, 0.5))], pose(AT_S + 0.5), None)
    assert (one.position, one.velocity, one.moves) == ((51.0, 1.0, 2.0), (0.5, 0.5, 0.5), False)
    found.see(196, [seen(51.0, 1.0, 2.0, velocity=(0.6, 0.6, 0.6))], pose(AT_S + 1.0), None)
    assert one.moves


def test_a_velocity_that_no_aircraft_has_is_shortened() -> None:
    found = objects(seen(50.0, 0.0, velocity=(0.0, 90.0, 120.0)))
    assert found.held[0].velocity == pytest.approx((0.0, 72.0, 96.0))
    found.see(196, [seen(50.0, 0.0, velocity=(-72.0, 0.0, 95.0))], pose(AT_S + 0.125), None)
    assert found.held[0].velocity == (-72.0, 0.0, 95.0)
    # A place that jumps would be one of an impossible speed, too.
    one = followed(position=(50.0, 0.0, 0.0), along=_Axis(0.1, 0.0, 1e6), velocity=(119.0, 0.0, 0.0))
    found.held = [one]
    found.see(196, [seen(85.0, 0.0)], pose(AT_S + 0.125), None)
    assert one.measured == 3
    assert math.hypot(*one.velocity) == pytest.approx(120.0)


# ------------------------------------------------------------ the velocity that is assumed


def assumed(one: Followed, here: Vec3 = (0.0, 0.0, 0.0)) -> Vec3:
    return one.seen_from(here)


def test_what_stands_has_no_velocity_whatever_the_filter_says() -> None:
    assert assumed(followed(velocity=(0.4, 0.3, 0.2))) == (0.0, 0.0, 0.0)


def test_as_far_as_the_motion_across_is_unknown_it_is_ours_so_that_the_bearing_stays() -> None:
    """We flew to the north-west when it was first seen, in the east."""
    met = (2.0, -3.0, 0.0)
    for vv, share in ((9.0, 1.0), (20.0, 1.0), (4.5, 0.5), (0.9, 0.1)):
        one = followed(
            position=(0.0, 40.0, 0.0), velocity=(0.0, -8.0, 0.0), moves=True, met_mps=met,
            across=_Axis(1.0, 0.0, vv),
        )  # fmt: skip
        assert assumed(one) == pytest.approx((share * 2.0, -8.0, 0.0))
    one = followed(
        position=(30.0, 40.0, 0.0), velocity=(-6.0, -8.0, 0.0), moves=True, met_mps=met,
        across=_Axis(1.0, 0.0, 9.0),
    )  # fmt: skip
    vn, ve, _ = assumed(one)
    across = 0.6 * ve - 0.8 * vn
    assert across == pytest.approx(0.6 * -3.0 - 0.8 * 2.0)
    assert 0.6 * vn + 0.8 * ve == pytest.approx(-10.0)
    away = assumed(one, (30.0, 0.0, 0.0))
    assert away == pytest.approx((-6.0 + 2.0, -8.0, 0.0)), "as seen from here it lies in the east"


def test_the_velocity_that_the_sensor_reports_is_taken_as_it_is() -> None:
    one = followed(
        velocity=(-5.0, 1.0, 2.0), moves=True, tracked=True, flat=False, met_mps=(0.0, 4.0, 0.0),
        across=_Axis(1.0, 0.0, 9.0), high=_Axis(1.0, 0.0, 1e6),
    )  # fmt: skip
    assert assumed(one) == (-5.0, 1.0, 2.0)
    one.flat = True
    assert assumed(one) == (-5.0, 1.0, 0.0)


@pytest.mark.parametrize("down", [2.0, -2.0])
def test_a_climb_counts_once_it_is_beyond_two_deviations(down: float) -> None:
    for deviations, vd in ((1.95, 0.0), (2.05, down)):
        high = _Axis(1.0, 0.0, (2.0 / deviations) ** 2)
        one = followed(velocity=(-5.0, 0.0, down), moves=True, flat=False, high=high)
        assert assumed(one)[2] == vd
        one.flat = True
        assert assumed(one)[2] == 0.0


def test_the_error_of_a_velocity_is_that_of_the_worse_axis() -> None:
    assert followed(along=_Axis(1.0, 0.0, 4.0), across=_Axis(1.0, 0.0, 2.25)).sigma_mps == 2.0
    assert followed(along=_Axis(1.0, 0.0, 4.0), across=_Axis(1.0, 0.0, 6.25)).sigma_mps == 2.5


# ------------------------------------------------------------ for how long, and how many


@pytest.mark.parametrize(
    ("what", "kept_s"),
    [
        ({"moves": True}, 2.0),
        ({"moves": False}, 3.0),
        ({"measured": 1}, 0.6),
        ({"measured": 1, "moves": True}, 0.6),
    ],
)
def test_how_long_an_object_is_kept(what: dict[str, Any], kept_s: float) -> None:
    for now_s, left in (
        (AT_S, 1), (AT_S + kept_s - 0.01, 1), (AT_S + kept_s + 0.01, 0), (AT_S - 0.01, 0),
    ):  # fmt: skip
        found = objects()
        found.held = [followed(**what)]
        found.expire(now_s)
        assert len(found.held) == left
    if kept_s != 0.6:  # which is no binary fraction
        found.held = [followed(**what)]
        found.expire(AT_S + kept_s)
        assert found.held


def test_a_second_measurement_confirms_and_a_number_of_the_sensor_does_so_at_once() -> None:
    found = objects(seen(20.0, 0.0), seen(-20.0, 0.0, number=0))
    assert [one.confirmed for one in found.held] == [False, True]
    found.see(196, [seen(20.0, 0.0)], pose(AT_S + 0.125), None)
    assert [one.confirmed for one in found.held] == [True, True]


class Past:
    """A view that sees past all places, or none, and notes what it is asked."""

    def __init__(self, answer: bool) -> None:
        self.answer, self.asked = answer, []

    def passes(self, position: Vec3, *, flat: bool) -> bool:
        self.asked.append((position, flat))
        return self.answer


def look(found: Objects, *answers: bool, places: tuple[Seen, ...] = ()) -> list[Past]:
    views = [Past(answer) for answer in answers]
    for number, view in enumerate(views):
        found.see(196, places, pose(AT_S + 0.125 * (number + 1)), view)  # type: ignore[arg-type]
    return views


def test_five_scans_one_after_the_other_that_see_past_an_object_remove_it() -> None:
    found = objects(seen(20.0, 0.0, flat=True))
    (view, *_) = look(found, True, True, True, True)
    assert view.asked == [((20.0, 0.0, 0.0), True)]
    assert len(found.held) == 1
    look(found, False, True, True, True, True)
    assert len(found.held) == 1
    look(found, True)
    assert found.held == []


def test_a_measurement_begins_the_count_anew() -> None:
    found = objects(seen(20.0, 0.0))
    look(found, True, True, True, True)
    look(found, True, places=(seen(20.0, 0.0),))
    look(found, True, True, True, True)
    assert len(found.held) == 1


def test_scans_remove_nothing_that_moves_or_that_the_sensor_follows_itself() -> None:
    found = objects(seen(20.0, 0.0, number=4))
    found.held.append(followed(name="9", position=(-30.0, 0.0, 0.0), moves=True))
    views = look(found, *[True] * 8)
    assert len(found.held) == 2
    assert all(view.asked == [] for view in views)


def many(count: int, north: float = 20.0) -> list[Seen]:
    """Places far enough apart, the farther the later."""
    return [seen(north + 4.0 * number, 40.0 * (-1) ** number, number=number) for number in range(count)]


def test_of_more_places_than_there_is_room_for_the_nearest_are_followed() -> None:
    most = followed_objects.MOST
    places = many(most + 6)
    found = objects(*reversed(places))
    assert sorted(one.position for one in found.held) == [place.position for place in places[:most]]
    assert found.refused == 0
    far = pose(position=(140.0, 0.0, 0.0))
    found = objects(*places, here=far)
    assert sorted(one.position for one in found.held) == [place.position for place in places[-most:]]


def full() -> Objects:
    found = objects(*many(followed_objects.MOST))
    assert len(found.held) == followed_objects.MOST == 24
    return found


def places_of(found: Objects) -> set[float]:
    return {one.position[0] for one in found.held}


def test_where_there_is_no_room_a_nearer_thing_takes_the_place_of_the_farthest() -> None:
    found = full()
    farthest = max(places_of(found))
    found.see(196, [seen(farthest + 30.0, 0.0, number=99)], pose(AT_S), None)
    assert found.refused == 1
    assert max(places_of(found)) == farthest
    found.see(196, [seen(-10.0, 0.0, number=98)], pose(AT_S), None)
    assert found.refused == 2
    assert len(found.held) == followed_objects.MOST
    assert farthest not in places_of(found)
    assert -10.0 in places_of(found)


def test_what_was_measured_once_gives_way_first_even_to_something_farther() -> None:
    found = objects(*many(followed_objects.MOST - 1), seen(5.0, 0.0))
    before = places_of(found)
    found.see(196, [seen(200.0, 0.0, number=99)], pose(AT_S), None)
    assert places_of(found) == before - {5.0} | {200.0}
    assert found.refused == 1


def test_there_is_room_for_the_last_one() -> None:
    found = objects(*many(followed_objects.MOST - 1))
    found.see(196, [seen(200.0, 0.0, number=99)], pose(AT_S), None)
    assert len(found.held) == followed_objects.MOST
    assert found.refused == 0
