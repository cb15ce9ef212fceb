"""What sensors see becomes tracks: poles stand, aircraft move, walls are a bounded number of places."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from companion.avoidance.law import SIGMAS, Law, Situation
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from companion.events import ObstacleScan
from companion.events.sensed import NOTHING, SENSED_WALL, UNKNOWN
from companion.traffic.sensed import objects, surfaces
from tests.companion.traffic.sensed.world import World, aircraft, off, one, place, point


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("east", [-8.0, 2.0, 14.0])
def test_a_pole_stands_while_we_fly_past_it(seed, east):
    world = World(things=lambda _: [(38.0, east, 0.2)], velocity=(5.0, 0.0, 0.0), seed=seed)
    for _ in range(70):
        world.run(0.1)
        for other in world.seen():
            assert other.velocity_ned_mps == (0.0, 0.0, 0.0)
            assert off(other, 38.0, east) < 3.0
    assert world.seen()


@pytest.mark.parametrize("yaw_deg", [0, 90, 181, 355])
@pytest.mark.parametrize("axes", ["body", "nose", "north"])
def test_the_heading_turns_what_is_measured_from_the_nose(yaw_deg, axes):
    world = World(things=lambda _: [(20.0, 0.0, 0.3)], yaw_rad=math.radians(yaw_deg))
    if axes == "north":
        world.yaw_rad = 0.0
        scan = world.scan("north")
        world.yaw_rad = math.radians(yaw_deg)
    else:
        scan = world.scan(axes)
    for _ in range(3):
        world.step(scan, scans=False)
    assert off(one(world), 20.0, 0.0) < 1.5


@pytest.mark.parametrize("speed", [5.0, 10.0])
@pytest.mark.parametrize("course_deg", [180.0, 90.0, 225.0])
@pytest.mark.parametrize("seed", range(3))
def test_an_aircraft_gets_its_velocity_within_its_own_error(speed, course_deg, seed):
    vn, ve = speed * math.cos(math.radians(course_deg)), speed * math.sin(math.radians(course_deg))

    def away(t):
        return 30.0 + vn * (t - 12.5), 3.0 + ve * (t - 12.5)

    world = World(things=lambda t: [(*away(t), 0.5)], seed=seed)
    world.run(2.5)
    other = one(world)
    assert off(other, *away(world.now_s)) < 3.0
    error = math.hypot(other.velocity_ned_mps[0] - vn, other.velocity_ned_mps[1] - ve)
    assert error < 3.0 * other.sigma_mps
    assert error < 2.5
    assert other.share == 1.0
    assert other.proven


def test_an_aircraft_that_is_not_known_to_move_yet_stands():
    world = World(things=lambda t: [(35.0 - 3.0 * (t - 10.0), 0.0, 0.5)])
    world.run(0.15)
    assert one(world).velocity_ned_mps == (0.0, 0.0, 0.0)
    world.run(1.0)
    assert one(world).velocity_ned_mps[0] == pytest.approx(-3.0, abs=1.0)


def test_what_moves_is_on_collision_course_until_its_motion_across_is_known():
    """Its bearing stays as it is, as seen from an aircraft that flies north at 5 m/s."""

    def ahead(t):
        return 30.0 - 6.0 * (t - 10.0), 26.0 - 8.0 * (t - 10.0)

    world = World(things=lambda t: [(*ahead(t), 0.5)], velocity=(5.0, 0.0, 0.0))
    world.run(0.5)
    other = one(world)
    n, e = ahead(world.now_s)[0] - world.position[0], ahead(world.now_s)[1]
    un, ue = n / math.hypot(n, e), e / math.hypot(n, e)
    vn, ve, _ = other.velocity_ned_mps
    across = (un * ve - ue * vn) - (un * 0.0 - ue * 5.0)
    assert abs(across) < 2.0, "relative to us it does not move across"
    world.run(1.5)
    assert one(world).velocity_ned_mps[:2] == (pytest.approx(-6.0, abs=2.0), pytest.approx(-8.0, abs=2.0))


@pytest.mark.parametrize("east_mps", [0.0, 2.0])
def test_a_wall_is_a_bounded_number_of_places_that_stand_and_leave_no_gap(east_mps):
    world = World(walls=[((45.0, -60.0, 0.0), (45.0, 60.0, 0.0))], velocity=(4.0, east_mps, 0.0))
    for _ in range(17):
        world.run(0.5)
        assert len(world.seen()) <= surfaces.MOST + 2
        for other in world.seen():
            assert other.velocity_ned_mps == (0.0, 0.0, 0.0)
            assert abs(place(other)[0] - 45.0) < 3.0
    east = world.position[1]
    places = sorted(place(other)[1] for other in world.seen() if abs(place(other)[1] - east) < 25.0)
    assert places[0] < east - 12.0
    assert places[-1] > east + 12.0
    assert max(b - a for a, b in pairwise(places)) < 12.0


def test_a_wall_in_two_wide_sectors_has_a_place_in_each():
    """One place in their middle would have a margin of nearly its distance."""
    world = World(walls=[((20.0, -60.0, 0.0), (20.0, 60.0, 0.0))], step_deg=45.0, noise_m=0.0)
    world.yaw_rad = math.radians(22.5)
    world.run(2.0)
    seen = world.seen()
    assert len(seen) >= 2
    assert all(other.track_id.startswith(SENSED_WALL) for other in seen)
    for other in seen:
        away = math.hypot(*place(other)[:2])
        quarter = 0.5 * away * math.sin(math.radians(22.5))
        assert quarter + 0.9 < SIGMAS * other.sigma_m < quarter + 4.0, "and three standard deviations"
        assert away > 19.0


def test_two_narrow_sectors_that_see_one_thing_far_away_are_an_object():
    """Each is wider than an object there, too, but neither is wide beside its distance."""
    world = World(things=lambda _: [(70.0, 3.0, 3.2)], range_m=80.0, noise_m=0.0)
    world.run(2.0)
    assert sum(cm > NOTHING for cm in world.scan().distances_cm) == 2
    assert not one(world).track_id.startswith(SENSED_WALL)


def test_a_pole_in_one_wide_sector_is_an_object_somewhere_in_it():
    world = World(things=lambda _: [(20.0, 3.0, 1.0)], step_deg=45.0, noise_m=0.0)
    world.run(2.0)
    (seen,) = world.seen()
    assert not seen.track_id.startswith(SENSED_WALL)
    n, e, _ = place(seen)
    assert math.dist((n, e), (20.0, 3.0)) < SIGMAS * seen.sigma_m


def test_the_margin_holds_the_sector_and_the_errors():
    narrow = World(things=lambda _: [(30.0, 0.0, 0.2)])
    wide = World(things=lambda _: [(30.0, 0.0, 0.2)], step_deg=45.0)
    for world in (narrow, wide):
        world.run(1.0)
    # A sector of 5 deg is 2.6 m wide there, 1.3 m to either side, and one of 45 deg 23 m.
    assert 4.0 * one(narrow).sigma_m == pytest.approx(1.3 + 3.0 * 0.8, abs=0.1)
    assert 4.0 * one(wide).sigma_m == pytest.approx(11.5 + 3.0 * 0.8, abs=1.0)


def radius_of(world: World) -> float:
    """Radius that the law keeps from the only thing that is seen."""
    path = Trajectory([0.0, 100.0], [(0.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
    here = world.own.position_ned_m(world.now_s)
    given = Situation(
        world.now_s, 50.0, here, world.own.velocity_ned_mps, world.own.sigma_m, world.fused(), None, None
    )
    (view,) = Law(AvoidanceConfig(), LimitsConfig(), path).decide(given).tracks
    return view.radius_m


@pytest.mark.parametrize("accuracy_m", [0.5, 1.0, 3.0])
def test_the_error_of_the_own_position_is_no_part_of_what_is_measured_from_it(accuracy_m):
    pole, wall = World(things=lambda _: [(12.0, 0.0, 0.2)]), World()
    ahead = point(12.0, 0.0, 0.0)
    for world in (pole, wall):
        world.accuracy_m = accuracy_m
    pole.run(1.0)
    for _ in range(4):
        wall.step(*[point(12.0, float(e), 0.0) for e in range(-6, 7, 2)], ahead, scans=False)
    assert radius_of(pole) == pytest.approx(12.0, abs=0.05), "10 m, and the least margin of 2 m"
    assert {other.relative for other in wall.seen()} == {True}
    assert all(4.0 * other.sigma_m < 3.0 for other in wall.seen())


def test_the_error_of_an_own_position_that_changes_counts_the_more_the_longer_a_thing_was_not_seen():
    world = World(things=lambda _: [(12.0, 0.0, 0.2)])
    world.run(1.0)
    assert radius_of(world) == pytest.approx(12.0, abs=0.05)
    world.run(2.5, scans=False)
    other = one(world)
    assert other.age_s == pytest.approx(2.55, abs=0.06)
    # By half a metre each second; and the law adds its 0.2 m for each second of age.
    drift_m = 0.5 * other.age_s
    expected = 10.0 + 4.0 * math.hypot(other.sigma_m, drift_m) + 0.2 * other.age_s
    assert radius_of(world) == pytest.approx(expected, abs=0.01)


def test_an_aircraft_that_the_sensor_follows_is_told_by_latitude_and_longitude_and_errs_as_we_do():
    world = World(accuracy_m=6.0)
    for _ in range(4):
        world.step(aircraft(world, 40.0, 0.0, 0.0), scans=False)
    assert not one(world).relative
    assert radius_of(world) == pytest.approx(10.0 + 4.0 * 6.0, abs=0.2)


def test_the_error_of_a_place_of_a_wall_is_that_of_the_distance_from_which_it_was_seen():
    world = World(velocity=(10.0, 0.0, 0.0))
    places = [point(35.0, float(e), 0.0) for e in range(-4, 5, 2)]
    for _ in range(3):
        world.step(*places, scans=False)
    before = world.seen()
    world.run(2.0, scans=False)
    assert [other.sigma_m for other in world.seen()] == [other.sigma_m for other in before]


def test_the_height_of_a_scan_is_not_known_and_nothing_is_passed_above():
    world = World(things=lambda _: [(20.0, 0.0, 0.3)])
    world.run(0.5)
    assert not one(world).vertical_known


# ------------------------------------------------------------ what must not be taken for an obstacle


def test_a_vehicle_that_rolls_sees_the_ground_and_takes_it_for_none():
    world = World(roll_rad=math.radians(30.0), position=(0.0, 0.0, 35.0))  # 15 m above home
    ground = ObstacleScan(
        component=196, axes="body", first_deg=0.0, step_deg=5.0, max_cm=4000, distances_cm=tuple(round(1500 /
        math.sin(math.radians(30.0))) if 15 <= i <= 21 else NOTHING for i in range(72)),
    )  # fmt: skip
    for _ in range(20):
        world.step(ground, scans=False)
    assert world.seen() == []
    assert world.sensed.trouble is None


def test_what_a_rolled_vehicle_sees_above_the_ground_lies_lower_than_it_flies():
    world = World(roll_rad=math.radians(30.0))
    right = ObstacleScan(
        component=196, axes="body", first_deg=90.0, step_deg=5.0, max_cm=4000, distances_cm=(3000,)
    )
    for _ in range(5):
        world.step(right, scans=False)
    other = one(world)
    assert place(other)[2] == pytest.approx(15.0, abs=1.0)
    assert other.vertical_known, "it lies 15 m below, and need not be passed to the side"


def test_the_own_rotor_is_no_obstacle():
    world = World(things=lambda _: [(0.3, 0.0, 0.05)])
    world.run(1.0)
    assert world.seen() == []


def test_sectors_join_around_the_nose():
    """A thing dead ahead lies in the last and the first sector."""
    scan = ObstacleScan(
        component=196, axes="body", first_deg=0.0, step_deg=5.0, max_cm=4000,
        distances_cm=(2000, *[NOTHING] * 70, 2000),
    )  # fmt: skip
    world = World()
    for _ in range(3):
        world.step(scan, scans=False)
    assert off(one(world), 20.0, -0.9) < 0.5


@pytest.mark.parametrize("step_deg", [5.0, -5.0])
def test_sectors_may_be_counted_either_way(step_deg):
    scan = ObstacleScan(
        component=196, axes="nose", first_deg=0.0, step_deg=step_deg, max_cm=4000,
        distances_cm=(*[NOTHING] * 18, 2000, *[NOTHING] * 53),
    )  # fmt: skip
    world = World()
    for _ in range(3):
        world.step(scan, scans=False)
    assert off(one(world), 0.0, math.copysign(20.0, step_deg)) < 0.5


def test_two_scans_of_one_component_in_a_step_may_cover_a_half_each():
    halves = [
        ObstacleScan(
            component=196, axes="nose", first_deg=first, step_deg=5.0, max_cm=4000,
            distances_cm=(*[NOTHING] * 18, 2000, *[NOTHING] * 17),
        )
        for first in (-90.0, 90.0)
    ]  # fmt: skip
    world = World()
    for _ in range(5):
        world.step(*halves, scans=False)
    assert sorted(round(place(other)[0]) for other in world.seen()) == [-20, 20]


def test_a_flood_of_scans_in_one_step_is_bounded():
    world = World()
    flood = [
        ObstacleScan(
            component=196, axes="nose", first_deg=float(i), step_deg=5.0, max_cm=4000, distances_cm=(2000,)
        )
        for i in range(100)
    ]
    for _ in range(3):
        world.step(*flood, scans=False)
    assert world.sensed.counts.scans == 300
    assert len(world.seen()) <= objects.MOST + surfaces.MOST


def test_one_measurement_is_not_enough():
    world = World(things=lambda t: [(20.0, 0.0, 0.3)] if t < 10.06 else [])
    world.run(0.1)
    assert world.seen() == []
    world.run(2.0)
    assert world.seen() == []


# ------------------------------------------------------------ when nothing is used


@pytest.mark.parametrize(
    ("how", "why"),
    [
        ({"attitude": False}, "attitude"),
        ({"telemetry": False}, "own position older"),
    ],
)
def test_measurements_without_a_fresh_attitude_or_position_are_refused(how, why):
    world = World(things=lambda _: [(20.0, 0.0, 0.3)])
    world.run(1.2, scans=False)
    world.run(1.2, scans=False, **how)
    world.run(0.5, **how)
    assert world.seen() == []
    assert why in (world.sensed.trouble or "")
    assert world.sensed.counts.refused > 0
    world.run(2.5)
    assert world.seen()
    assert world.sensed.trouble is None


def test_a_vehicle_that_leans_or_turns_too_much_measures_nothing():
    world = World(things=lambda _: [(20.0, 0.0, 0.3)], roll_rad=math.radians(50.0))
    world.run(0.5)
    assert world.sensed.trouble == "leaning more than 45 deg"
    world.roll_rad = 0.0
    for number in range(20):
        world.yaw_rad = math.remainder(number * math.radians(10.0), math.tau)  # 200 deg/s
        world.step()
    assert world.sensed.trouble == "turning faster than 90 deg/s"
    assert world.seen() == []


def test_measurements_that_waited_are_refused():
    world = World(things=lambda _: [(20.0, 0.0, 0.3)])
    world.run(1.0, scans=False)
    for _ in range(5):
        world.step(scans=False)
        world.sensed.hear([world.scan()], world.now_s, world.own, sent_s=world.now_s - 0.5)
    assert world.seen() == []
    assert world.sensed.trouble == "input is behind"


def test_a_new_local_frame_forgets_everything():
    world = World(things=lambda _: [(20.0, 0.0, 0.3)], walls=[((-20.0, -30.0, 0.0), (-20.0, 30.0, 0.0))])
    world.run(1.0)
    assert len(world.seen()) > 3
    world.sensed.clear()
    assert world.seen() == []


# ------------------------------------------------------------ the end of tracks


def test_a_moving_object_is_kept_for_two_seconds_and_a_standing_one_for_three():
    world = World(things=lambda t: [(25.0, -20.0 + 7.0 * (t - 10.0), 0.5), (-20.0, 0.0, 0.3)])
    world.run(2.0)
    assert len(world.seen()) == 2
    world.run(1.8, scans=False)
    assert len(world.seen()) == 2
    world.run(0.3, scans=False)
    assert one(world).velocity_ned_mps == (0.0, 0.0, 0.0)
    world.run(1.0, scans=False)
    assert world.seen() == []


def test_a_scan_that_sees_past_a_place_removes_what_stood_there():
    gone_s = 12.0
    world = World(things=lambda t: [(20.0, 0.0, 0.3)] if t < gone_s else [])
    world.run(2.0)
    assert world.seen()
    world.run(0.9)
    assert world.seen() == []


def test_a_pole_out_of_view_is_remembered_while_the_scan_does_not_reach_it():
    world = World(things=lambda _: [(20.0, 0.0, 0.3)])
    world.run(1.0)
    blind = ObstacleScan(
        component=196,
        axes="body",
        first_deg=0.0,
        step_deg=5.0,
        max_cm=4000,
        distances_cm=(UNKNOWN,) * 71 + (NOTHING,),
    )
    for _ in range(40):
        world.step(blind, scans=False)
    assert off(one(world), 20.0, 0.0) < 1.5


@pytest.mark.parametrize("every", [2, 4, 10])
@pytest.mark.parametrize("wall", [False, True])
def test_a_sensor_that_does_not_see_a_thing_takes_nothing_from_the_one_that_does(wall, every):
    """A second sensor looks over a wall or a pole, 10 times a second; the first sees it 2 to 10 times."""
    world = World()
    if wall:
        world.walls = [((20.0, -30.0, 0.0), (20.0, 30.0, 0.0))]
    else:
        world.things = lambda _: [(20.0, 0.0, 0.3)]
    empty = ObstacleScan(
        component=1, axes="body", first_deg=0.0, step_deg=5.0, max_cm=4000, distances_cm=(NOTHING,) * 72
    )
    for number in range(120):
        scans = [world.scan()] if number % every == 0 else []
        world.step(*scans, *([empty] if number % 2 else []), scans=False)
        assert world.seen() or number <= every
