"""The core guards a mission: what it watches, and when the vehicle is taken, event by event."""

from __future__ import annotations

import math

import msgspec
import pytest

from companion.authority.table import HOLDING, State
from companion.config import LimitsConfig
from companion.core import Companion
from companion.events import (
    AuthorityChanged,
    Decision,
    DownloadMission,
    EstimatorState,
    Firmware,
    FlightMode,
    Landed,
    MissionCurrent,
    MissionDownloaded,
    MissionItem,
    MissionRefused,
    Parameter,
    Say,
    SecondCompanion,
    TwoAutopilots,
    VehicleParameters,
)
from tests.companion.conftest import Bench, config, mission
from tests.companion.core.conftest import intruder
from tests.companion.core.guarded.guarding import meet, modes, over, taken

TWO = TwoAutopilots(reason="two autopilots on this link (systems 1 and 2): set vehicle.system_id")


def test_watching_needs_the_mission_mode_and_its_items(guarded):
    bench = guarded()
    assert [c for _, c in bench.log if isinstance(c, DownloadMission)]
    bench.mode = FlightMode.HOLD
    bench.step()
    assert bench.core.state is State.STANDBY
    bench.step(100)
    assert bench.core.state is State.STANDBY


def test_one_look_at_a_conflict_is_not_enough(guarded):
    bench = guarded()
    bench.extra.append(intruder(bench, 60.0, 3.0))
    bench.until(lambda: bench.core._control._conflicts == 1)
    bench.core.traffic.clear()
    bench.step(40)
    assert bench.core.state is State.WATCHING


@pytest.mark.parametrize("limits", [LimitsConfig(), LimitsConfig(max_acceleration_mps2=0.1)])
def test_what_is_wanted_is_what_the_vehicle_flies(guarded, limits):
    """A path that began only now would be taken at half the speed: the law averages over time before it, at
    3 m/s with 0.1 m/s^2 over 15 s."""
    bench = taken(guarded(limits=limits))
    made = [(t, c.wanted_ned_mps) for t, c in bench.log if isinstance(c, Decision)]
    before = [wanted for t, wanted in made if t < taken_s(bench)]
    assert before
    for wanted in before:
        assert wanted == pytest.approx((3.0, 0.0, 0.0), abs=1e-6)
    # The way to the item begins at the speed that was flown.
    after = next(wanted for t, wanted in made if t >= taken_s(bench))
    assert after == pytest.approx((3.0, 0.0, 0.0), abs=0.1)


@pytest.mark.parametrize("height_m", [0.0, 48.0, 100.0])
def test_the_way_to_the_item_and_the_floor_are_above_the_home_of_now(guarded, height_m):
    """A pilot may set home in flight, and PX4 corrects its altitude. The mission is flown above the new
    one."""
    bench = guarded()
    bench.height_m = height_m
    bench.step(2)
    course, home_m = taken(bench).core.plan.course, 450.0 - height_m
    end_down_m = course.law.trajectory.points_ned_m[-1][2]
    assert 450.0 - end_down_m == pytest.approx(home_m + 50.0, abs=0.1)
    assert 450.0 - course.boundary_down_m(15.0, bench.core.own, bench.now_s) == pytest.approx(home_m + 15.0)


def taken_s(bench):
    return next(t for t, c in bench.log if getattr(c, "trigger", "") == "conflict")


def test_a_mission_that_may_be_a_neighbours_is_not_guarded(guarded):
    bench = guarded()
    bench.extra.append(TWO)
    bench.step()
    assert bench.core.state is State.STANDBY
    assert bench.core.waits_for(bench.now_s) == TWO.reason
    before = len(bench.log)
    meet(bench, seconds=4.0)
    assert bench.core.state is State.STANDBY
    assert not modes(c for _, c in bench.log[before:])
    assert not bench.setpoints([c for _, c in bench.log[before:]])


def test_a_mission_is_not_guarded_beside_another_companion(guarded):
    bench = guarded()
    bench.extra.append(SecondCompanion(reason="another"))
    bench.step()
    assert bench.core.state is State.STANDBY
    assert [c.reason for _, c in bench.log if isinstance(c, AuthorityChanged)][-1] == "another"
    before = len(bench.log)
    meet(bench, seconds=4.0)
    assert not modes(c for _, c in bench.log[before:])
    assert not bench.setpoints([c for _, c in bench.log[before:]])


def test_another_companion_does_not_end_an_avoidance(guarded):
    bench = taken(guarded())
    bench.extra.append(SecondCompanion(reason="another"))
    bench.step(20)
    assert bench.core.state in HOLDING


def test_a_second_autopilot_while_the_vehicle_is_held_ends_the_guarding_once_the_mission_flies_on(guarded):
    bench = taken(guarded())
    bench.extra.append(TWO)
    over(bench)
    assert bench.core.state in HOLDING
    bench.mode = FlightMode.MISSION
    bench.until(lambda: bench.core.state is State.STANDBY)
    assert [c.state for _, c in bench.log if isinstance(c, AuthorityChanged)][-2:] == ["watching", "standby"]
    assert bench.core.waits_for(bench.now_s) == TWO.reason
    assert not [c for _, c in bench.log if getattr(c, "trigger", "") in ("pilot", "unfit")]


@pytest.mark.parametrize("held", [False, True])
def test_a_home_that_is_set_in_flight_moves_the_heights_of_the_mission(guarded, held):
    """The autopilot counts them from its present home, so the vehicle would be led to another height."""
    bench = taken(guarded()) if held else guarded()
    bench.height_m = 30.0  # home is 20 m higher from now on
    bench.step(20)
    if not held:
        taken(bench)
    bench.step(20)
    course, own = bench.core.plan.course, bench.core.own
    assert course.law.trajectory.points_ned_m[-1][2] == pytest.approx(-20.0, abs=0.1)  # 50 m above home
    assert course.boundary_down_m(80.0, own, bench.now_s) == pytest.approx(-50.0, abs=0.1)


def test_a_home_that_is_set_while_the_mission_is_fetched_again_moves_its_heights_too(guarded):
    bench = guarded()
    known, bench.mission = bench.mission, None  # the vehicle does not answer
    taken(bench)
    bench.height_m = 30.0
    bench.step(10)
    bench.extra.append(MissionDownloaded(items=known))
    bench.step(10)
    course = bench.core.plan.course
    assert course.law.trajectory.points_ned_m[-1][2] == pytest.approx(-20.0, abs=0.1)
    assert course.lowest_height_m == pytest.approx(30.0, abs=0.5)  # the vehicle's own height


def test_no_setpoint_before_it_is_taken(guarded):
    bench = guarded()
    meet(bench)
    first = next(t for t, c in bench.log if c in bench.setpoints([c]))
    taken_s = next(t for t, c in bench.log if getattr(c, "trigger", "") == "conflict")
    assert first > taken_s


@pytest.mark.parametrize("firmware", Firmware)
def test_a_fault_lets_go_as_the_firmware_needs_it(guarded, firmware):
    """ArduPilot flies on for seconds without setpoints, so it is stopped; PX4's own failsafe acts."""
    bench = guarded()
    bench.firmware = firmware
    taken(bench)
    bench.fix_type = 1
    commands = bench.step()
    assert bench.core.state is State.FAULT
    assert not bench.setpoints(commands)
    assert modes(commands) == ([FlightMode.HOLD] if firmware is Firmware.ARDUPILOT else [])


def test_a_hold_that_is_not_ours_is_the_pilots(guarded):
    bench = guarded()
    bench.firmware = Firmware.ARDUPILOT
    taken(bench)
    bench.mode = FlightMode.HOLD
    bench.step()
    assert bench.core.state is State.YIELDED


@pytest.mark.parametrize("rearm", ["disarm", "mode"])
def test_authority_given_anew_is_the_mission_selected_again(guarded, rearm):
    bench = taken(guarded(rearm=rearm))
    bench.mode = FlightMode.OTHER
    bench.step(20)
    bench.mode = FlightMode.MISSION
    bench.step(20)
    # Whoever came is still there.
    assert (bench.core.state is State.AVOIDING) is (rearm == "mode")


def test_a_mission_selected_by_the_pilot_in_our_flight_gives_no_authority(guarded):
    bench = taken(guarded(rearm="mode"))
    bench.mode = FlightMode.MISSION
    bench.step(100)
    assert bench.core.state is State.YIELDED


def test_the_estimators_word_ends_authority_at_once(guarded):
    bench = taken(guarded())
    bench.extra.append(EstimatorState(usable=False))
    assert not bench.setpoints(bench.step())
    assert bench.core.state is State.FAULT
    bench.extra.append(EstimatorState(usable=True))
    bench.until(lambda: bench.core.state is not State.FAULT)


def test_a_conflict_beyond_the_missions_item_is_avoided(guarded):
    """The way to the item ends short of what the mission flies into: the vehicle is taken all the same."""
    bench = guarded(items=(MissionItem(seq=0, command=20, frame=3, lat_deg=None, lon_deg=None, alt_m=None),))
    bench.velocity_ned_mps = (0.0, 5.0, 0.0)
    for k in range(8):
        bench.extra.append(intruder(bench, 72.0 - 6.0 * k, 6.0, east_m=60.0))
        for _ in range(20):
            bench.east_m += 0.25 if bench.mode is FlightMode.MISSION else 0.0
            bench.step()
        if bench.core.in_control:
            break
    moves = [c.trigger for _, c in bench.log if isinstance(c, AuthorityChanged)]
    assert moves[1:] == ["conflict"]
    assert bench.core.in_control


@pytest.mark.parametrize("landed", [Landed.TAKEOFF, Landed.LANDING])
def test_take_offs_and_landings_are_not_guarded(guarded, landed):
    bench = guarded()
    bench.landed = landed
    meet(bench, seconds=5.0)
    assert bench.core.state is State.WATCHING
    bench.landed = Landed.IN_AIR
    bench.step(20)
    assert bench.core.state is State.AVOIDING


@pytest.mark.parametrize("unfit", [False, True])
def test_a_mission_selected_again_is_fetched_again(guarded, unfit):
    """It may have been changed while the pilot flew."""
    bench = guarded()
    bench.fix_type = 1 if unfit else 3
    bench.step()
    bench.mode, bench.mission = FlightMode.OTHER, mission(-300.0)
    bench.step(20)
    bench.mode, bench.fix_type = FlightMode.MISSION, 3
    bench.step(20)
    assert bench.core.state is State.WATCHING
    meet(bench)
    way = bench.core.plan.course.law.trajectory
    assert way.points_ned_m[-1][0] == pytest.approx(-300.0, abs=1.0)


def way_end_m(bench):
    return bench.core.plan.course.law.trajectory.points_ned_m[-1][0]


@pytest.mark.parametrize("told", [{"total": 3}, {"mission_id": 9}])
def test_a_mission_that_is_replaced_while_it_is_watched_is_fetched_again(guarded, told):
    bench = guarded()
    bench.extra.append(MissionCurrent(seq=0, total=2, mission_id=8))
    bench.step(20)
    before = len(bench.log)
    bench.step(100)
    assert not [c for _, c in bench.log[before:] if isinstance(c, DownloadMission)]
    bench.mission = mission(-300.0)
    bench.extra.append(MissionCurrent(seq=0, **{"total": 2, "mission_id": 8, **told}))
    bench.step(20)
    assert len([c for _, c in bench.log[before:] if isinstance(c, DownloadMission)]) == 1
    meet(bench, seconds=0.8)
    assert way_end_m(bench) == pytest.approx(-300.0, abs=1.0)


def replaced(bench):
    """The vehicle tells of another mission, which does not come."""
    bench.extra.append(MissionCurrent(seq=0, total=2))
    bench.step(20)
    bench.mission = None
    bench.extra.append(MissionCurrent(seq=0, total=1))
    return bench


def test_a_download_that_is_refused_while_the_mission_is_watched_is_asked_for_again(guarded):
    bench = replaced(guarded())
    bench.step(20)
    bench.extra.append(MissionRefused(reason="the vehicle answered: denied"))
    bench.step(20)
    before, bench.mission = len(bench.log), mission(-300.0)
    bench.step(220)
    assert len([c for _, c in bench.log[before:] if isinstance(c, DownloadMission)]) == 1
    meet(bench, seconds=0.8)
    assert way_end_m(bench) == pytest.approx(-300.0, abs=1.0)


def test_a_mission_that_is_known_to_be_another_is_not_led_to_before_it_is_fetched(guarded):
    bench = replaced(guarded())
    taken(bench)
    assert way_end_m(bench) == pytest.approx(bench.north_m, abs=1.0)
    bench.extra.append(MissionDownloaded(items=mission(-300.0)))
    bench.step(10)
    assert way_end_m(bench) == pytest.approx(-300.0, abs=1.0)


def test_a_mission_that_was_replaced_unsaid_is_found_when_the_vehicle_is_taken(guarded):
    """ArduPilot says nothing of a mission with as many items: it leads to its item, and is given back."""
    bench = guarded()
    bench.mission = mission(-300.0, -900.0)
    taken(bench)
    bench.step(10)
    assert way_end_m(bench) == pytest.approx(-300.0, abs=1.0)
    over(bench)
    bench.until(lambda: bench.core.state is State.WATCHING)


def test_a_position_at_the_other_end_of_the_earth_is_not_flown_on(guarded):
    bench = guarded()
    bench.lat_deg, bench.lon_deg = -bench.lat_deg, bench.lon_deg - 180.0
    bench.step(200)
    assert bench.core.state is State.STANDBY


def test_a_mission_that_would_begin_anew_is_not_guarded(guarded):
    """ArduPilot with MIS_RESTART = 1."""
    made = msgspec.structs.replace(config(use="guard"), path=None)
    bench = Bench(Companion(made), mission=mission(300.0), mode=FlightMode.MISSION)
    restart = Parameter(name="MIS_RESTART", value=1.0)
    bench.extra += [
        MissionCurrent(seq=0),
        VehicleParameters(firmware=Firmware.ARDUPILOT, mission_restart=restart),
    ]
    bench.step(400)
    assert bench.core.state is State.STANDBY
    assert any(isinstance(c, Say) and "MIS_RESTART 1" in c.text for _, c in bench.log)


def leading_to(bench, height_m, north_m=300.0):
    """Taken on the way to an item at this height above home; 0 leaves its height open."""
    bench.mission = tuple(msgspec.structs.replace(item, alt_m=height_m) for item in mission(north_m, 900.0))
    taken(bench)
    bench.step(10)
    assert way_end_m(bench) == pytest.approx(north_m, abs=1.0)
    return bench


@pytest.mark.parametrize(
    ("height_m", "item_m", "floor_m"),
    [
        (50.0, 50.0, 15.0),
        (8.0, 50.0, 8.0),
        (50.0, 8.0, 8.0),
        (8.0, 4.0, 4.0),
        (50.0, 0.0, 15.0),
        (8.0, 0.0, 8.0),
    ],
)
def test_the_floor_is_above_neither_the_vehicle_nor_its_item(guarded, height_m, item_m, floor_m):
    bench = guarded()
    bench.height_m = height_m
    bench.step(20)
    limits = bench.core.config.limits
    assert bench.core.plan.course.floor_height_m(limits) == min(15.0, height_m)
    leading_to(bench, item_m)
    assert bench.core.plan.course.floor_height_m(limits) == floor_m


def test_an_item_without_a_height_is_led_to_level(guarded):
    points_ned_m = leading_to(guarded(), 0.0).core.plan.course.law.trajectory.points_ned_m
    assert points_ned_m[-1][2] == pytest.approx(points_ned_m[-2][2], abs=0.1)


@pytest.mark.parametrize(
    ("north_m", "item_m", "seconds"),
    [
        (300.0, 50.0, 300.0 / 3.0),
        (400.0, 250.0, math.hypot(400.0, 200.0) / 3.0),
        (90.0, 170.0, 120.0 / 1.5),
        (20.0, 5.0, 45.0 / 2.5),
    ],
    ids=["level", "slanting", "steep up", "steep down"],
)
def test_the_way_takes_as_long_as_its_length_or_its_climb(guarded, north_m, item_m, seconds):
    """At the 3 m/s that were flown, climbing at most at 1.5 m/s and descending at most at 2.5 m/s."""
    bench = guarded(limits=LimitsConfig(max_climb_mps=1.5, max_descent_mps=2.5))
    assert leading_to(bench, item_m, north_m).core.plan.course.law.trajectory.times_s[-1] == pytest.approx(
        seconds, rel=0.02
    )


@pytest.mark.parametrize(("flown_mps", "way_mps"), [(0.4, 1.0), (1.5, 1.5), (4.5, 4.5), (7.0, 5.0)], ids=str)
def test_the_way_is_flown_as_fast_as_before_within_the_limit_and_not_at_a_crawl(guarded, flown_mps, way_mps):
    bench = guarded()
    bench.velocity_ned_mps = (flown_mps, 0.0, 0.0)
    way = leading_to(bench, 50.0).core.plan.course.law.trajectory
    assert way.times_s[-1] == pytest.approx(300.0 / way_mps, rel=0.02)


def test_taken_again_at_the_height_to_which_traffic_pushed_it_the_leg_is_the_same(guarded):
    """Or the leg would be lower each time, down to the lowest place of the mission."""
    bench = taken(guarded())
    guard, own = bench.core.plan, bench.core.own
    before = guard.course.leg_heights_m(bench.now_s)
    height_m = bench.height_m
    bench.height_m -= 25.0
    bench.alt_m -= 25.0
    bench.step(20)
    guard.leave(own, bench.now_s)
    assert guard.course.leg_heights_m(bench.now_s) == pytest.approx(before, abs=0.5)
    assert guard.course.lowest_height_m == pytest.approx(height_m, abs=0.5)
    # Whoever flies there for longer has descended himself.
    guard.leave(own, bench.now_s + 61.0)
    assert guard.course.leg_heights_m(bench.now_s + 61.0)[0] == pytest.approx(before[0] - 25.0, abs=0.5)
