"""Rules 11 to 13: how fast a velocity may change, floor and ceiling, the fence."""

from __future__ import annotations

import math
import random

import pytest

from companion.events import FenceArea, FenceDownloaded, GlobalPosition, Parameter, VehicleParameters
from companion.gate.bounds import Bounds
from companion.gate.rules import Broken
from tests.companion.gate.flying import ARDUPILOT, HOME, Flying, config, rectangle

FAST = {"max_speed_mps": 10.0, "max_acceleration_mps2": 2.0}
BOX = rectangle(-100.0, -100.0, 100.0, 100.0)


def taken(fence=(), **limits):
    return Flying(config(limits={**FAST, **limits}, fence=tuple(fence))).taken()


def at(one, place=(0.0, 0.0, -50.0), velocity=(0.0, 0.0, 0.0)):
    one.place, one.velocity = place, velocity
    return one.run()


# ---------------------------------------------------------------- 11: change


def test_what_is_flown_is_the_first_ones_measure():
    """Allowed from the flown velocity: one second of acceleration (2 m/s) and 1 m/s of noise."""
    for velocity, leaves in (((1.95,), False), ((2.05,), True), ((5.0, 2.95), True), ((5.0, 3.05), False)):
        one = at(taken().run(1.1), velocity=(5.0, 0.0, 0.0))
        assert one.flies(*velocity) is leaves
        assert one.refused() == ([] if leaves else [11])


def test_a_vehicle_that_flies_faster_than_allowed_begins_at_what_is_allowed():
    one = at(taken(max_speed_mps=4.0), velocity=(12.0, 0.0, 0.0))
    assert one.flies(4.0)


def steps(one, *speeds):
    """Which of these northward setpoints leave, sent every 50 ms, if the vehicle follows none of them."""
    return [at(one).flies(speed) for speed in speeds]


def test_a_velocity_goes_on_changing_by_the_acceleration():
    one = taken()
    rising = [0.1 * n for n in range(1, 80)]  # 2 m/s each second, from the second to the ninth
    assert all(steps(one, *rising))
    assert steps(one, 7.9 + 1.95) == [True]
    assert steps(one, 9.85 - 2.2) == [False]
    assert one.refused() == [11]


def test_to_and_fro_is_change_all_the_same():
    one = taken()
    assert all(steps(one, *(0.1 * n for n in range(1, 60))))
    # 2 m/s were saved up, and each step of 1 m/s earns 0.1 m/s.
    assert steps(one, 6.9, 5.9, 6.9) == [True, True, False]


def test_what_was_saved_up_is_a_seconds_worth():
    one = taken()
    assert all(steps(one, *(0.1 * n for n in range(1, 60))))
    assert all(steps(one, *(5.9,) * 100))
    assert steps(one, 8.0) == [False]
    one = taken()
    assert all(steps(one, *(0.1 * n for n in range(1, 60))))
    assert all(steps(one, *(5.9,) * 100))
    assert steps(one, 7.85) == [True]


def test_the_slack_for_rounding_does_not_add_up():
    one = taken()
    assert all(steps(one, *(0.1 * n for n in range(1, 60))))
    assert one.flies(7.8)  # all that was saved up
    assert [one.flies(7.8 + 0.0008 * n) for n in (1, 2, 3)] == [True, False, False]


def test_a_standstill_is_commanded_at_any_time():
    one = at(taken(), velocity=(9.0, 0.0, 0.0))
    assert one.flies(9.0)
    one.run()
    assert one.flies()
    one.run()
    assert not one.flies(5.0)


def test_after_a_second_without_setpoints_what_is_flown_counts():
    one = taken()
    assert all(steps(one, *(0.1 * n for n in range(1, 60))))
    one.run(0.9)
    assert one.flies(5.8)
    one.run(1.05)
    assert not one.flies(5.8)


def test_the_vehicles_own_acceleration_counts_where_it_is_lower():
    one = taken()
    own = VehicleParameters(firmware=ARDUPILOT, acceleration_mps2=Parameter(name="A", value=0.5))
    one.gate.hear(own, one.now_s)
    assert not at(one).flies(1.55)
    one.run(3.1)
    assert at(one).flies(1.45)


# ---------------------------------------------------------------- 12: floor and ceiling
# Way to stop from a speed v: half a second at v, then braking with 2 m/s2; and a metre of slack.


@pytest.mark.parametrize(
    ("height", "down", "leaves"),
    [
        (21.1, 2.0, True),
        (20.9, 2.0, False),
        (20.0, 1.0, True),
        (19.7, 1.0, False),
        (18.0, 0.1, False),
        (18.0, -2.0, True),
        (18.0, 0.0, True),
        (77.9, -2.0, True),
        (79.1, -2.0, False),
        (81.5, -0.1, False),
        (81.5, 2.0, True),
    ],
)
def test_floor_and_ceiling(height, down, leaves):
    one = taken(floor_height_m=20.0, ceiling_height_m=80.0)
    assert at(one, (0.0, 0.0, -height)).flies(0.0, 0.0, down) is leaves
    assert one.refused() == ([] if leaves else [12])


def test_without_floor_and_ceiling_any_height_will_do():
    one = taken()
    assert at(one, (0.0, 0.0, -1.0)).flies(0.0, 0.0, 2.0)
    assert at(one, (0.0, 0.0, -9000.0)).flies(0.0, 0.0, -2.0)


@pytest.mark.parametrize(("flown", "down", "leaves"), [(2.0, 1.8, True), (2.0, 1.95, False)])
def test_a_vehicle_that_falls_too_fast_may_be_slowed_down(flown, down, leaves):
    one = taken(floor_height_m=20.0)
    assert at(one, (0.0, 0.0, -19.5), (0.0, 0.0, flown)).flies(0.0, 0.0, down) is leaves


def test_a_standstill_leaves_below_the_floor():
    one = taken(floor_height_m=20.0)
    assert at(one, (0.0, 0.0, -5.0), (0.0, 0.0, 2.0)).flies()


def test_the_height_is_carried_on_to_now():
    one = taken(floor_height_m=20.0)
    one.place, one.velocity = (0.0, 0.0, -22.5), (0.0, 0.0, 2.0)
    one.run()
    assert one.flies(0.0, 0.0, 2.0)
    for _ in range(20):
        one.now_s += 0.05
        one.beat()
        one.gate.emptied(one.now_s)
        one.gate.decided(one.now_s)
    assert not one.flies(0.0, 0.0, 2.0)


# ---------------------------------------------------------------- 13: the fence


@pytest.mark.parametrize("side", [(1, 0), (-1, 0), (0, 1), (0, -1)])
@pytest.mark.parametrize(("room", "speed", "leaves"), [(6.1, 4.0, True), (5.9, 4.0, False), (0.5, 0.0, True)])
def test_a_wall_is_met_with_the_room_to_stop(side, room, speed, leaves):
    """Way to stop from 4 m/s: 2 m in half a second, then 4 m with 2 m/s2."""
    n, e = side
    flown = 0.9 * speed
    place, velocity = ((100.0 - room) * n, (100.0 - room) * e, -50.0), (flown * n, flown * e, 0.0)
    one = at(taken([BOX]), place, velocity)
    assert one.flies(speed * n, speed * e) is leaves
    assert one.refused() == ([] if leaves else [13])
    assert at(taken([BOX]), place, velocity).flies(-0.1 * n, -0.1 * e)
    along = at(taken([BOX]), place, (3.0 * e, 3.0 * n, 0.0))
    assert along.flies(4.0 * e, 4.0 * n)


def test_a_vehicle_that_is_too_fast_may_be_slowed_down():
    for speed, leaves in ((4.85, True), (4.95, False)):
        one = at(taken([BOX]), (96.0, 0.0, -50.0), (5.0, 0.0, 0.0))
        assert one.flies(speed) is leaves


@pytest.mark.parametrize(
    ("velocity", "leaves"), [((-2.0, 0.0), True), ((0.5, 0.0), False), ((0.0, 2.0), True)]
)
def test_outside_no_further(velocity, leaves):
    one = at(taken([BOX]), (103.0, 0.0, -50.0))
    assert one.flies(*velocity) is leaves
    assert one.refused() == ([] if leaves else [13])


def test_an_area_to_be_stayed_out_of():
    tower = rectangle(20.0, -10.0, 40.0, 10.0, inclusion=False)
    assert not at(taken([tower]), (14.5, 0.0, -50.0), (3.0, 0.0, 0.0)).flies(4.0)
    assert at(taken([tower]), (13.5, 0.0, -50.0), (3.0, 0.0, 0.0)).flies(4.0)
    assert at(taken([tower]), (14.5, 0.0, -50.0), (-3.0, 0.0, 0.0)).flies(-4.0)
    assert at(taken([tower]), (30.0, 15.0, -50.0), (3.0, 0.0, 0.0)).flies(4.0)
    assert at(taken([tower]), (30.0, 5.0, -50.0)).flies(0.0, 2.0)
    assert not at(taken([tower]), (30.0, 5.0, -50.0)).flies(0.0, -2.0)


@pytest.mark.parametrize("inclusion", [True, False])
def test_a_circle(inclusion):
    circle = FenceArea(inclusion=inclusion, points=((HOME.lat_deg, HOME.lon_deg),), radius_m=50.0)
    outward = 1.0 if inclusion else -1.0
    for room, leaves in ((6.1, True), (5.9, False)):
        one = at(taken([circle]), (0.0, 50.0 - outward * room, -50.0), (0.0, outward * 3.6, 0.0))
        assert one.flies(0.0, outward * 4.0) is leaves
    one = at(taken([circle]), (0.0, 50.0 + outward * 2.0, -50.0))
    assert one.flies(0.0, -outward * 2.0)
    assert not one.flies(0.0, outward * 0.5)


def test_all_areas_bind():
    one = at(taken([BOX, rectangle(-100.0, -100.0, 20.0, 100.0)]), (18.0, 0.0, -50.0))
    assert not one.flies(3.0)


def test_in_the_middle_of_a_circle_every_way_is_open():
    circle = FenceArea(inclusion=True, points=((HOME.lat_deg, HOME.lon_deg),), radius_m=50.0)
    assert at(taken([circle])).flies(2.0, 2.0)


def test_the_place_is_carried_on_to_now():
    one = at(taken([BOX]), (90.0, 0.0, -50.0), (4.0, 0.0, 0.0))
    assert one.flies(4.0)
    for _ in range(22):
        one.now_s += 0.05
        one.beat()
        one.gate.emptied(one.now_s)
        one.gate.decided(one.now_s)
    assert not one.flies(4.0)
    assert one.refused() == [13]


def test_far_from_every_wall_and_then_near():
    one = taken([BOX])
    for north in range(0, 100, 2):
        leaves = at(one, (float(north), 0.0, -50.0), (2.0, 0.0, 0.0)).flies(2.0)
        assert leaves is (100.0 - north > 1.9), north


def test_a_fence_of_the_vehicles_counts_at_once_where_it_is_to_be_kept():
    """A narrower fence applies too if it comes after a wider one."""
    small = FenceDownloaded(areas=(rectangle(-100.0, -100.0, 5.0, 100.0),))
    for fence, leaves in (("vehicle", False), (None, True)):
        one = Flying(config(limits={**FAST, "fence": fence})).taken()
        one.gate.hear(FenceDownloaded(areas=(rectangle(-900.0, -900.0, 900.0, 900.0),)), one.now_s)
        assert at(one, velocity=(4.0, 0.0, 0.0)).flies(4.0)
        one.gate.hear(small, one.now_s)
        assert one.flies(4.0) is leaves
        one.run(3.1)
        one.gate.hear(FenceDownloaded(areas=()), one.now_s)
        assert one.flies(4.0)


def test_up_and_down_no_wall_counts():
    one = at(taken([BOX]), (99.9, 0.0, -50.0))
    assert one.flies(0.0, 0.0, -2.0)


def braked(one, steps):
    """Which of these northward setpoints leave, each with the velocity that the vehicle then flies towards a
    wall."""
    left, north = [], 96.0
    for flown, speed in steps:
        left.append(at(one, (north, 0.0, -50.0), (flown, 0.0, 0.0)).flies(speed))
        north += 0.05 * speed
    return left


def test_slowing_down_is_not_begun_anew_again_and_again():
    """If the velocity is reported ten times a second, 0.1 m/s less each time is half of the deceleration that
    is needed."""
    assert all(braked(taken([BOX]), [(5.0 - 0.11 * n, 4.89 - 0.11 * n) for n in range(30)]))
    half = [5.0 - 0.101 * (n // 2) for n in range(30)]
    left = braked(taken([BOX]), [(flown, flown - 0.101) for flown in half])
    assert left[0]
    assert not left[1]


def test_out_of_the_fence_it_does_not_creep_on():
    one = at(taken([BOX]), (101.0, 0.0, -50.0))
    assert not one.flies(0.2)
    assert at(taken([BOX]), (101.0, 0.0, -50.0)).flies(0.0, 2.0)


def verdict(bounds, velocity, now_s):
    try:
        bounds.check(velocity, now_s)
    except Broken as broken:
        return str(broken)
    bounds.left(velocity, now_s)
    return None


def test_distances_to_the_fence_that_were_measured_before_give_the_verdict_of_new_ones():
    """A box to stay in, a box and a circle to stay out of; flown across them in all directions."""
    verdicts = [flown_across(random.Random(seed)) for seed in range(20)]
    assert sum(refused for refused, _ in verdicts) > 200
    assert all(same for _, same in verdicts)


def flown_across(rng):
    """Number of setpoints that the fence refuses, and whether new distances give the same verdicts."""
    areas = (
        rectangle(-60.0, -60.0, 60.0, 60.0),
        rectangle(-10.0, 5.0, 15.0, 30.0, inclusion=False),
        FenceArea(inclusion=False, points=(HOME.to_geodetic(-30.0, -20.0, 0.0)[:2],), radius_m=12.0),
    )
    kept, anew = (Bounds(config(limits=FAST, fence=areas)) for _ in range(2))
    place, velocity = (rng.uniform(-50.0, 50.0), rng.uniform(-50.0, 50.0)), (0.0, 0.0, 0.0)
    refused, same = 0, True
    for step in range(300):
        now_s = 0.1 * step
        place = place[0] + 0.1 * velocity[0], place[1] + 0.1 * velocity[1]
        lat, lon, _ = HOME.to_geodetic(*place, 0.0)
        event = GlobalPosition(
            time_boot_s=now_s, lat_deg=lat, lon_deg=lon, alt_msl_m=500.0, height_above_home_m=50.0,
            velocity_ned_mps=velocity,
        )  # fmt: skip
        kept.hear_position(event, now_s)
        anew.hear_position(event, now_s)
        if step % 15 == 0:
            aim = rng.uniform(-8.0, 8.0), rng.uniform(-8.0, 8.0)
        change = [max(-0.15, min(0.15, a - v)) for a, v in zip(aim, velocity, strict=False)]
        velocity = velocity[0] + change[0], velocity[1] + change[1], 0.0
        anew._walls_at = (math.inf, math.inf)
        said = verdict(anew, velocity, now_s)
        same = same and verdict(kept, velocity, now_s) == said
        refused += said is not None and "(fence)" in said
    return refused, same


@pytest.mark.parametrize("first", [(48.3, 8.5, 0.0), (0.0001, 0.0001, 0.0)])
def test_a_first_position_far_away_does_not_move_the_fence(first):
    """The companion was started elsewhere, or before its vehicle knew its place. On a tangent plane there,
    the fence would be tens of metres off, or would be refused at any distance."""
    assert least_room_m(None) == pytest.approx(8.5, abs=1.0)
    assert least_room_m(first) == pytest.approx(least_room_m(None), abs=0.5)


def least_room_m(first):
    """How near to the northern wall of `BOX` a northward setpoint still leaves, 2 km above home."""
    bounds = Bounds(config(limits=FAST, fence=(BOX,)))
    places = [] if first is None else [first]
    places += [HOME.to_geodetic(0.25 * step, 0.0, -2000.0) for step in range(800)]
    for step, (lat, lon, alt) in enumerate(places):
        now_s = 0.05 * step
        event = GlobalPosition(
            time_boot_s=now_s, lat_deg=lat, lon_deg=lon, alt_msl_m=alt, height_above_home_m=50.0,
            velocity_ned_mps=(5.0, 0.0, 0.0),
        )  # fmt: skip
        bounds.hear_position(event, now_s)
        if places[step] != first and verdict(bounds, (5.0, 0.0, 0.0), now_s) is not None:
            break
    return 100.0 - 0.25 * (step - len(places) + 800)
