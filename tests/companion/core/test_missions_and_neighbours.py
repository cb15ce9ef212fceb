"""A vehicle's mission is given back, and a vehicle that may be another's is not taken."""

from __future__ import annotations

import msgspec
import pytest

from companion.authority.table import HOLDING, State
from companion.core import Companion
from companion.events import (
    FlightMode,
    Landed,
    MissionCurrent,
    Say,
    SecondCompanion,
    SetMode,
    TwoAutopilots,
    VelocitySetpoint,
)
from tests.companion.conftest import ALT_MSL, LAT, Bench, config, mission
from tests.companion.core.conftest import intruder

# ---------------------------------------------------------------- the vehicle's mission, given back


def test_a_mission_that_is_still_the_same_is_flown_on(on_mission):
    assert on_mission.core.state is State.YIELDED
    on_mission.mode = FlightMode.EXTERNAL
    on_mission.step(5)
    assert on_mission.core.state in HOLDING
    assert on_mission.core.plan.course.path_time_s(on_mission.now_s) == pytest.approx(199.0 / 3.0, abs=1.0)


def test_a_mission_that_the_pilot_changed_is_not_resumed(on_mission):
    on_mission.mission = on_mission.mission[:1]
    on_mission.mode = FlightMode.EXTERNAL
    said = [c.text for c in on_mission.step(600) if isinstance(c, Say)]
    assert on_mission.core.state is State.STANDBY
    assert sum("mission was changed" in text for text in said) == 1
    # The pilot flies it from MISSION: it is taken from there.
    on_mission.mode = FlightMode.MISSION
    on_mission.extra = [MissionCurrent(seq=0)]
    on_mission.until(lambda: on_mission.core.state in HOLDING)
    end = on_mission.core.plan.course.law.trajectory.points_ned_m[-1]
    assert end[0] == pytest.approx(300.0, abs=1.0)


def test_a_changed_mission_is_flown_after_a_landing(on_mission):
    on_mission.mission = on_mission.mission[:1]
    on_mission.mode = FlightMode.EXTERNAL
    on_mission.step(100)
    on_mission.landed, on_mission.armed, on_mission.mode = Landed.ON_GROUND, False, FlightMode.HOLD
    on_mission.step(20)
    on_mission.landed, on_mission.armed = Landed.IN_AIR, True
    on_mission.until(lambda: on_mission.core.state in HOLDING)


def test_a_path_that_waits_for_long_is_told_of(flying):
    """The vehicle does not move, whatever it is told."""
    said = [(t, c.text) for t, c in flying.log if isinstance(c, Say)]
    assert not any("late" in text for _, text in said)
    flying.log.clear()
    flying.step(round(120.0 / 0.05))
    late = flying.core.plan.course.late_s
    assert late > 60.0
    told = [c.text for _, c in flying.log if isinstance(c, Say) and "late" in c.text]
    assert len(told) == int(late / 30.0)
    assert told[0].startswith("DMUCA: path 30 s late")
    assert flying.core.plan.course.path_time_s(flying.now_s) - late < 60.0


def test_a_ceiling_below_the_default_floor_takes_the_floor_with_it(make_bench, make_config):
    """No floor is given: the one that is taken stays below a low ceiling."""
    made, bench = make_config(), make_bench()
    limits = msgspec.structs.replace(made.limits, ceiling_height_m=10.0)
    bench.core = Companion(msgspec.structs.replace(made, limits=limits))
    bench.until(lambda: bench.mode is FlightMode.EXTERNAL)
    bench.extra = [intruder(bench, 120.0, 3.0)]
    bench.step(200)
    assert bench.core.state in HOLDING
    assert bench.core.plan.course.floor_height_m(bench.core.config.limits) == 5.0


def test_a_mission_that_the_vehicle_flew_on_meanwhile_is_planned_anew():
    """Taken in vain: its path begins where the vehicle is no more."""
    made = msgspec.structs.replace(config(trajectory="mission", mission_speed_mps=3.0), path=None)
    bench = Bench(Companion(made), mission=mission(300.0, 900.0), mode=FlightMode.MISSION)
    bench.extra.append(MissionCurrent(seq=0))
    bench.obeys = False
    bench.until(lambda: bench.core.state is State.GUARDING)
    bench.silent = True
    bench.step(40)
    assert bench.core.state is State.FAULT
    bench.silent = False
    bench.north_m = 250.0
    bench.until(lambda: bench.core.state is State.GUARDING)
    assert bench.core.plan.near(bench.core.own, bench.now_s)


# ------------------------------------------------------------ whose vehicle it is

TWO = TwoAutopilots(reason="two autopilots on this link (systems 1 and 2): set vehicle.system_id")


def said(bench):
    return [c.text for _, c in bench.log if isinstance(c, Say) and "two autopilots" in c.text]


def test_a_vehicle_that_may_be_a_neighbours_is_not_taken(make_bench):
    bench = make_bench()
    bench.extra.append(TWO)
    bench.step(600)
    assert bench.core.state is State.STANDBY
    assert bench.core.waits_for(bench.now_s) == TWO.reason
    assert not [c for _, c in bench.log if isinstance(c, SetMode | VelocitySetpoint)]
    assert said(bench) == [f"DMUCA: {TWO.reason}"]


def test_a_vehicle_that_another_companion_may_command_is_not_taken_until_that_one_is_gone(make_bench):
    bench = make_bench()
    bench.extra.append(SecondCompanion(reason="another"))
    bench.step(600)
    assert bench.core.state is State.STANDBY
    assert bench.core.waits_for(bench.now_s) == "another"
    assert not [c for _, c in bench.log if isinstance(c, SetMode | VelocitySetpoint)]
    bench.extra.append(SecondCompanion())
    bench.until(lambda: bench.core.state is State.GUARDING)
    told = [c.text for _, c in bench.log if isinstance(c, Say) and "other" in c.text]
    assert told == ["DMUCA: another", "DMUCA: the other companion is gone"]


def test_a_vehicle_that_is_only_watched_shows_it_too(make_bench):
    bench = make_bench(use="watch")
    bench.extra.append(TWO)
    bench.step()
    assert bench.core.waits_for(bench.now_s) == TWO.reason


def test_a_second_autopilot_does_not_end_an_avoidance_nor_is_the_vehicle_taken_again(flying):
    for k in range(3):
        flying.extra.append(intruder(flying, 60.0 - 3.0 * k, 3.0))
        flying.step(20)
    assert flying.core.state is State.AVOIDING
    flying.extra.append(TWO)
    before = len(flying.log)
    for _ in range(400):
        (setpoint,) = flying.setpoints(flying.step())
        assert flying.core.state in HOLDING
        flying.north_m += 0.05 * setpoint.velocity_ned_mps[0]
        flying.east_m += 0.05 * setpoint.velocity_ned_mps[1]
    assert not [c for _, c in flying.log[before:] if isinstance(c, SetMode)]
    assert said(flying) == [f"DMUCA: {TWO.reason}"]
    # A fault ends it: from there the vehicle is not taken again.
    flying.fix_type = 0
    flying.step()
    assert flying.core.state is State.FAULT
    flying.fix_type = 3
    flying.step(400)
    assert flying.core.state is State.STANDBY
    assert flying.core.waits_for(flying.now_s) == TWO.reason


def test_a_vehicle_that_is_not_configured_is_taken_once_others_would_have_been_heard(make_bench):
    """The second autopilot's first heartbeat may come a second after the first one's."""
    took_s = []
    for system_id in (0, 1):
        bench = make_bench()
        vehicle = msgspec.structs.replace(bench.core.config.vehicle, system_id=system_id)
        bench.core = Companion(msgspec.structs.replace(bench.core.config, vehicle=vehicle))
        bench.step()
        assert ("other autopilots" in (bench.core.waits_for(bench.now_s) or "")) is (system_id == 0)
        bench.until(lambda b=bench: b.core.state is State.GUARDING)
        took_s.append(bench.now_s)
    assert took_s[1] < 1.0
    assert 3.0 <= took_s[0] < 4.0


@pytest.mark.parametrize(
    ("mode", "first_m"),
    [(FlightMode.MISSION, 600.0), (FlightMode.HOLD, 300.0)],
    ids=["in progress", "not begun"],
)
def test_a_mission_in_progress_goes_on_at_its_item_any_other_begins_at_the_first(mode, first_m):
    made = msgspec.structs.replace(config(trajectory="mission", mission_speed_mps=3.0), path=None)
    bench = Bench(Companion(made), mission=mission(300.0, 600.0, 900.0), mode=mode)
    bench.extra.append(MissionCurrent(seq=1))
    bench.until(lambda: bench.core.state in HOLDING)
    points = bench.core.plan.course.law.trajectory.points_ned_m
    assert [point[0] for point in points[1:]] == [
        pytest.approx(north_m, abs=1.0) for north_m in (300.0, 600.0, 900.0) if north_m >= first_m
    ]


def test_a_long_leg_follows_the_round_earth():
    """Straight through it, the middle of a leg of 60 km was 70 m too low, below home."""
    made = msgspec.structs.replace(config(trajectory="mission", mission_speed_mps=3.0), path=None)
    bench = Bench(Companion(made), mission=mission(60_000.0))
    bench.until(lambda: bench.core.state in HOLDING)
    course, frame = bench.core.plan.course, bench.core.own.frame
    path = course.law.trajectory
    for share in (0.04, 0.25, 0.5, 0.75, 0.96):
        time_s = share * path.end_s
        lat_deg, _, alt_m = frame.to_geodetic(*path.position(time_s))
        assert alt_m - ALT_MSL == pytest.approx(0.0, abs=0.6)
        assert (lat_deg - LAT) * 111_194.9 == pytest.approx(share * 60_000.0, abs=10.0)
        assert course.leg_heights_m(bench.now_s + time_s) == pytest.approx((50.0, 50.0))
