"""The planes that another aircraft asks for: where it flies on, and where it may have stopped."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from companion.avoidance import kernels as k
from companion.avoidance.kernels.neighbours import neighbour_planes, volume_of
from companion.avoidance.law import settings_of
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig

PATH = Trajectory([0.0, 500.0], [(0.0, 0.0, -50.0), (1000.0, 0.0, -50.0)])
NOW_S = 50.0
PLACE = (7.0, -4.0, -50.0)
EAST, NORTH = (0.0, 2.0, 0.0), (2.0, 0.0, 0.0)
EAST_THEN_NORTH = [(40.0, EAST), (47.0, EAST), (47.5, NORTH), (50.0, NORTH)]
"""Own velocities by time."""


def asked_of(
    *neighbours: k.Other, wanted: Any = (2.0, 0.0, 0.0), first: int = 3, **avoidance: Any
) -> tuple[np.ndarray, list[k.Seen], np.ndarray, bool, bool]:
    """The rows of planes, the reports, what each asks for, whether there is a conflict, and whether one of
    those in conflict passes on our right."""
    settings = settings_of(AvoidanceConfig(**avoidance), LimitsConfig(), PATH)
    own = k.Own(k.Vector(*PLACE), k.Vector(2.0, 0.0, 0.0), 0.0, NOW_S, NOW_S, math.inf, -math.inf)
    history = k.History(np.array([t for t, _ in EAST_THEN_NORTH]), np.array([v for _, v in EAST_THEN_NORTH]))
    table = np.zeros((len(neighbours), k.OTHER_COLUMNS))
    for row, neighbour in enumerate(neighbours):
        k.put_other(table, row, neighbour)
    work = k.workspace(0, len(neighbours))
    work.planes[:] = np.nan
    work.asked[:] = np.nan
    after, conflict, on_right = neighbour_planes(
        table, len(neighbours), own, k.Vector(*wanted), settings, history, len(EAST_THEN_NORTH),
        work.planes, first, work.seen, work.asked, own.velocity,
    )  # fmt: skip
    assert np.isnan(work.planes[:first]).all()
    assert np.isnan(work.planes[after:]).all()
    seen = [k.seen_at(work.seen, row) for row in range(len(neighbours))]
    return work.planes[first:after], seen, work.asked, bool(conflict), bool(on_right)


def planes_of(*neighbours: k.Other, **more: Any) -> tuple[np.ndarray, list[k.Seen], np.ndarray, bool]:
    """The same without the last."""
    return asked_of(*neighbours, **more)[:4]


def on_right(*neighbours: k.Other, **more: Any) -> bool:
    """Whether one of those in conflict passes on our right."""
    return asked_of(*neighbours, **more)[4]


def other(position: Any, velocity: Any = (0.0, 0.0, 0.0), age_s: float = 0.0, **more: float) -> k.Other:
    """Positions are given from ours."""
    values = {"sigma_m": 0.0, "sigma_mps": 0.0, "growth_mps": 0.0, "silent": 0.0, "share": 0.5}
    values |= {"vertical_known": 1.0, "crewed": 0.0, "growth_down_mps": 0.0, "turn_rps": 0.0}
    values |= {"sigma_down_m": 0.0, "yields": 0.0, "relative": 0.0, **more}
    n, e, d = (a + b for a, b in zip(position, PLACE, strict=True))
    return k.Other(n, e, d, *velocity, age_s, **values)


def level_plane(away: Any, own: Any, velocity: Any, radius_m: float, share: float = 0.5) -> Any:
    """The plane of a level encounter, in which the volume's height does not matter."""
    relative = k.Vector(own[0] - velocity[0], own[1] - velocity[1], 0.0)
    n, s = k.half_space(k.Vector(*away, 0.0), relative, radius_m, 20.0, 1.0)
    return pytest.approx([*n, n.n * own[0] + n.e * own[1] + share * s])


@pytest.mark.parametrize("share", [0.5, 0.75, 1.0])
def test_a_plane_is_of_the_place_now_and_of_the_own_velocity_then(share: float) -> None:
    """A message of 4 s ago, when we still flew east."""
    neighbour = other((80.0, 5.0, 0.0), (-3.0, -1.0, 0.0), 4.0, share=share)
    planes, (seen,), asked, conflict = planes_of(neighbour)
    radius_m = 12.0 + 0.2 * 4.0  # the resolution of its velocity
    assert seen.radius_m == pytest.approx(radius_m)
    assert (seen.n - PLACE[0], seen.e - PLACE[1], seen.d) == pytest.approx((68.0, 1.0, -50.0))
    assert len(planes) == 1
    assert planes[0] == level_plane((68.0, 1.0), (0.0, 2.0), (-3.0, -1.0), radius_m, share)
    assert asked[0, 0].tolist() == planes[0].tolist()
    assert asked[0, 1].tolist() == [0.0] * 4
    # By the wish of 2 m/s north, the relative velocity is (5, 1): it passes 12.4 m aside, within the volume.
    assert conflict
    assert seen.conflict == 1.0
    assert seen.time_s == pytest.approx((68.0 * 5.0 + 1.0) / 26.0)
    assert seen.distance_m == pytest.approx((68.0 - 5.0) / math.sqrt(26.0))


def test_one_that_fell_silent_may_also_stand_where_it_was_a_second_later() -> None:
    neighbour = other((80.0, 30.0, 0.0), (-3.0, 4.0, 0.0), 4.0, silent=1.0, growth_mps=1.0)
    planes, (seen,), asked, _ = planes_of(neighbour)
    radius_m = 12.0 + 1.0 * (4.0 + 4.0)  # its manoeuvres until 4 s from now
    assert seen.radius_m == pytest.approx(radius_m)
    assert len(planes) == 2
    assert planes[0] == level_plane((68.0, 46.0), (0.0, 2.0), (-3.0, 4.0), radius_m)
    # Against one that stands, our velocity of now counts.
    assert planes[1] == level_plane((77.0, 34.0), (2.0, 0.0), (0.0, 0.0), radius_m)
    assert asked[0].tolist() == planes.tolist()


@pytest.mark.parametrize(("law", "count"), [("dmuca", 2), ("paper", 1)])
def test_the_published_law_knows_no_silence(law: str, count: int) -> None:
    planes, _, _, _ = planes_of(other((80.0, 30.0, 0.0), age_s=4.0, silent=1.0), law=law)
    assert len(planes) == count


def test_planes_for_places_follow_those_of_all_aircraft() -> None:
    """In the order of the neighbours, whichever of them are silent."""
    far = [(300.0, 90.0, 0.0), (90.0, 300.0, 0.0), (-90.0, 300.0, 0.0)]
    heard = [
        other(place, (-2.0, 1.0, 0.0), 3.0, silent=silent)
        for place, silent in zip(far, (1.0, 0.0, 1.0), strict=True)
    ]
    planes, seen, asked, conflict = planes_of(*heard)
    assert not conflict
    assert [row.conflict for row in seen] == [0.0] * 3
    assert planes.tolist() == [*asked[:, 0].tolist(), asked[0, 1].tolist(), asked[2, 1].tolist()]
    assert asked[1, 1].tolist() == [0.0] * 4


@pytest.mark.parametrize(("silent", "conflict"), [(0.0, False), (1.0, True)])
def test_a_place_where_one_may_stand_is_a_conflict_too(silent: float, conflict: bool) -> None:
    """It crosses our way ahead, and is past it by now; it could have stopped on it."""
    crossing = other((40.0, -6.0, 0.0), (0.0, 6.0, 0.0), 8.0, silent=silent)
    _, (seen,), _, found = planes_of(crossing)
    assert found == conflict
    assert seen.conflict == float(conflict)
    assert seen.e - PLACE[1] == pytest.approx(42.0)


@pytest.mark.parametrize(("known", "conflict"), [(1.0, False), (0.0, True)])
@pytest.mark.parametrize("silent", [0.0, 1.0])
def test_an_unknown_height_does_not_separate(known: float, conflict: bool, silent: float) -> None:
    above = other((60.0, 1.0, -80.0), (-2.0, 0.0, 2.0), 1.0, vertical_known=known, silent=silent)
    planes, (seen,), _, found = planes_of(above)
    assert found == conflict
    if not known:
        assert (planes[:, 2] == 0.0).all()
        assert seen.d == PLACE[2]
        assert seen.distance_m == pytest.approx(1.0)
    else:
        assert (planes[:, 2] != 0.0).all()
        assert seen.d == pytest.approx(PLACE[2] - 78.0)


@pytest.mark.parametrize(
    ("down_m", "conflict"),
    # 12 m aside are 14.1 m in height: volumes are 1 / 0.85 as tall as wide.
    [(14.0, True), (-14.0, True), (14.2, False), (-14.2, False)],
)
def test_volumes_are_taller_than_wide(down_m: float, conflict: bool) -> None:
    assert planes_of(other((30.0, 0.0, down_m)))[3] == conflict


@pytest.mark.parametrize(("east_m", "conflict"), [(11.9, True), (12.1, False)])
def test_volumes_are_as_wide_as_both_radii_and_the_margin(east_m: float, conflict: bool) -> None:
    assert planes_of(other((30.0, east_m, 0.0)))[3] == conflict


def test_crewed_aircraft_have_volumes_of_their_own() -> None:
    """An ellipsoid around the cylinder of both separations, and a longer horizon, in the published law."""
    sizes = {"crewed_horizontal_m": 100.0, "crewed_vertical_m": 50.0}
    _, (seen,), _, _ = planes_of(other((300.0, 0.0, 0.0), crewed=1.0), **sizes)
    assert seen.radius_m == pytest.approx(100.0 * math.sqrt(2.0) + 2.0)
    for north_m, conflict in ((140.0, True), (300.0, False)):
        found = planes_of(
            other((north_m, 0.0, 0.0), crewed=1.0), law="paper", wanted=(0.5, 0.0, 0.0), **sizes
        )
        assert found[3] == conflict


def test_crewed_aircraft_ask_for_no_plane() -> None:
    """Another part of the law avoids them."""
    planes, (seen,), asked, conflict = planes_of(other((100.0, 0.0, 0.0), (-50.0, 0.0, 0.0), crewed=1.0))
    assert (seen.conflict, conflict) == (0.0, False)
    assert not asked.any()
    assert all(planes[0, :3] @ v > planes[0, 3] for v in np.eye(3) * -100.0)


@pytest.mark.parametrize(("east_m", "right"), [(5.1, True), (4.9, False), (0.0, False), (-8.0, False)])
@pytest.mark.parametrize("course", [0.0, 1.0, 2.5, -2.0])
def test_one_that_comes_towards_us_passes_on_the_right_beyond_five_metres(
    east_m: float, right: bool, course: float
) -> None:
    """Whatever our course is; `east_m` is to its right."""
    ahead, aside = (math.cos(course), math.sin(course)), (-math.sin(course), math.cos(course))
    n, e = (60.0 * a + east_m * b for a, b in zip(ahead, aside, strict=True))
    meets = other((n, e, 1.0), (-2.0 * ahead[0], -2.0 * ahead[1], 0.5))
    assert on_right(meets, wanted=(2.0 * ahead[0], 2.0 * ahead[1], 0.3)) is right


@pytest.mark.parametrize(
    ("place", "velocity", "right"),
    # We fly north at 2 m/s. At the closest approach the other one lies where it passes, not where it is now.
    [
        ((40.0, 48.0), (0.0, -2.0), True),  # from the right, after us: 4 m north and 4 m east of us then
        ((40.0, 32.0), (0.0, -2.0), False),  # from the right, before us
        ((40.0, -32.0), (0.0, 2.0), True),  # from the left, before us
        ((40.0, -48.0), (0.0, 2.0), False),
        ((0.0, 10.0), (2.0, 0.0), True),  # abreast
        ((0.0, -10.0), (2.0, 0.0), False),
        ((-6.0, 7.0), (0.0, 0.0), True),  # behind us already, but within its volume
    ],
)
def test_the_side_is_that_of_the_closest_approach(place: Any, velocity: Any, right: bool) -> None:
    scaled = tuple(1.5 * value if abs(value) > 20.0 else value for value in place)
    crossing = other((*scaled, 0.0), (*velocity, 0.0), growth_mps=1.0)
    _, _, _, conflict, found = asked_of(crossing)
    assert conflict
    assert found is right


def test_one_on_the_right_that_is_not_in_conflict_does_not_count() -> None:
    ahead, aside = other((60.0, 0.0, 0.0), (-2.0, 0.0, 0.0)), other((60.0, 40.0, 0.0), (-2.0, 0.0, 0.0))
    assert not on_right(ahead, aside)
    assert on_right(ahead, other((60.0, 8.0, 0.0), (-2.0, 0.0, 0.0)))


def test_without_a_course_nothing_is_on_the_right() -> None:
    near = other((0.0, 8.0, 0.0))
    assert on_right(near)
    assert not on_right(near, wanted=(0.0, 0.0, 0.0))
    assert not on_right(near, wanted=(0.0, 0.0, -1.0))


@pytest.mark.parametrize("silent", [0.0, 1.0])
@pytest.mark.parametrize(("east_m", "right"), [(52.0, True), (40.0, False)])
def test_where_a_silent_one_passes_counts_as_for_any_other(silent: float, east_m: float, right: bool) -> None:
    """From the right, 40 m ahead; where it may have stopped is off our way. With 40 m it would hit us, and a
    turn to the right leads behind it."""
    crossing = other((40.0, east_m + 8.0, 0.0), (0.0, -2.0, 0.0), 4.0, silent=silent, growth_mps=0.5)
    _, _, _, conflict, found = asked_of(crossing)
    assert conflict
    assert found is right


@pytest.mark.parametrize(("east_m", "right"), [(8.0, True), (2.0, False), (-8.0, False)])
def test_the_side_of_the_place_where_a_silent_one_may_stand(east_m: float, right: bool) -> None:
    """It crossed our way from right to left, or is about to; flying on, it is far away when we come there."""
    stood_s = 7.0
    crossing = other((40.0, east_m + 6.0, 0.0), (0.0, -6.0, 0.0), 1.0 + stood_s, silent=1.0)
    _, (seen,), _, conflict, found = asked_of(crossing)
    assert conflict
    assert seen.e - PLACE[1] < -20.0
    assert found is right


@pytest.mark.parametrize(("own_m", "measured_m"), [(1.5, 0.7), (6.0, 0.7), (1.5, 4.0), (1.5, 0.1)])
def test_what_was_measured_from_ours_errs_by_the_measurement_alone(own_m: float, measured_m: float) -> None:
    settings = settings_of(AvoidanceConfig(), LimitsConfig(), PATH)
    own = k.Own(k.Vector(*PLACE), k.Vector(2.0, 0.0, 0.0), own_m, NOW_S, NOW_S, math.inf, -math.inf)
    volume = {
        relative: volume_of(other((40.0, 0.0, 0.0), sigma_m=measured_m, relative=relative), own, settings)
        for relative in (0.0, 1.0)
    }
    assert volume[1.0].radius == pytest.approx(settings.radius_m + max(2.0, 4.0 * measured_m))
    assert volume[0.0].radius == pytest.approx(
        settings.radius_m + max(2.0, 4.0 * math.hypot(measured_m, own_m))
    )
