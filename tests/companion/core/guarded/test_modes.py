"""Several modes that the core reads in one step: each counts, in the order of arrival."""

from __future__ import annotations

import pytest

from companion.authority.table import HOLDING, State
from companion.autopilot.dialect import DIALECTS
from companion.events import (
    AuthorityChanged,
    CurrentMode,
    DownloadMission,
    Firmware,
    FlightMode,
    MissionCurrent,
    RcChannels,
    SetMode,
    Settings,
)
from tests.companion.authority.showing import beat
from tests.companion.conftest import mission
from tests.companion.core.guarded.guarding import meet, modes, over, taken

EXTERNAL, MISSION, HOLD, OTHER = (
    FlightMode.EXTERNAL,
    FlightMode.MISSION,
    FlightMode.HOLD,
    FlightMode.OTHER,
)

pytestmark = pytest.mark.parametrize("firmware", Firmware)


def show(bench, *shown):
    """One step that reads all of them, behind the mode that the vehicle is in; returns its commands."""
    before = bench.mode
    bench.extra += [beat(mode, firmware=bench.firmware) for mode in shown]
    commands = bench.step()
    if bench.mode is before:
        bench.mode = shown[-1]
    return commands


def flown(bench, firmware):
    """The bench's vehicle flies the straight path."""
    bench.firmware, bench.mode = firmware, MISSION
    bench.until(lambda: bench.core.in_control)
    bench.step(5)
    return bench


def guards(bench, firmware):
    bench.firmware = firmware
    bench.step()
    return bench


def yielded(bench, commands):
    """The pilot has the vehicle, and keeps it."""
    assert bench.core.state is State.YIELDED
    (change,) = [c for c in commands if isinstance(c, AuthorityChanged)]
    assert change.trigger == "pilot"
    later = commands + bench.step(200)
    assert bench.core.state is State.YIELDED
    assert not bench.setpoints(later)
    assert not [c for c in later if isinstance(c, SetMode)]
    return True


@pytest.mark.parametrize("other", [OTHER, HOLD, MISSION, FlightMode.STICKS])
def test_a_mode_between_two_of_ours_is_the_pilots(make_bench, firmware, other):
    bench = flown(make_bench(), firmware)
    commands = show(bench, other, EXTERNAL)
    assert yielded(bench, commands)


def test_the_modes_name_is_the_one_that_the_pilot_chose(make_bench, firmware):
    bench = flown(make_bench(), firmware)
    custom = DIALECTS[firmware].command(HOLD).custom_mode
    bench.extra += [beat(HOLD, firmware=firmware, custom_mode=custom), beat(EXTERNAL, firmware=firmware)]
    (change,) = [c for c in bench.step() if isinstance(c, AuthorityChanged)]
    assert change.reason == f"mode changed to {DIALECTS[firmware].name(custom)}, not by the companion"


def test_a_mode_told_between_two_heartbeats_counts(make_bench, firmware):
    bench = flown(make_bench(), firmware)
    told = DIALECTS[firmware].command(HOLD).custom_mode
    bench.extra += [CurrentMode(custom_mode=told), beat(EXTERNAL, firmware=firmware)]
    assert yielded(bench, bench.step())


def test_the_pilots_mode_and_our_own_hold_after_a_fault(guarded, firmware):
    """The hold that a fault asked for may be obeyed after the pilot has chosen: it is not ours any more."""
    bench = taken(guards(guarded(), firmware))
    bench.obeys, bench.fix_type = False, 1
    bench.step()
    assert bench.core.state is State.FAULT
    bench.fix_type = 3
    last = HOLD if firmware is Firmware.ARDUPILOT else EXTERNAL
    assert yielded(bench, show(bench, OTHER, last))


def test_without_the_pilots_mode_the_vehicle_is_taken_again_after_a_fault(guarded, firmware):
    bench = taken(guards(guarded(), firmware))
    bench.obeys, bench.fix_type = False, 1
    bench.step()
    bench.obeys, bench.fix_type = True, 3
    show(bench, EXTERNAL, HOLD if firmware is Firmware.ARDUPILOT else EXTERNAL)
    bench.until(lambda: bench.core.in_control)


def test_the_pilots_mode_while_the_vehicle_stands_by_after_a_fault(guarded, firmware):
    """It is not taken from what would have been ours."""
    bench = taken(guards(guarded(), firmware))
    bench.fix_type = 1
    bench.step(2)
    bench.fix_type = 3
    bench.until(lambda: bench.core.state is State.STANDBY)
    bench.obeys = False
    show(bench, OTHER, bench.mode)
    bench.step(400)
    assert bench.core.state is State.STANDBY


@pytest.mark.parametrize("shown", [(OTHER, MISSION), (EXTERNAL, MISSION), (HOLD, EXTERNAL)])
def test_a_mode_that_is_not_ours_while_the_vehicle_is_being_taken(guarded, firmware, shown):
    bench = guards(guarded(), firmware)
    bench.obeys = False
    meet(bench, seconds=1.5)
    assert bench.core.state in HOLDING
    assert not bench.core.in_control
    assert yielded(bench, show(bench, *shown))


def test_the_mode_that_it_is_taken_from_and_then_ours_is_no_pilot(guarded, firmware):
    bench = guards(guarded(), firmware)
    bench.obeys = False
    meet(bench, seconds=1.5)
    show(bench, MISSION, EXTERNAL)
    assert bench.core.in_control


@pytest.mark.parametrize("enabled", [False, True])
def test_a_vehicle_that_stands_is_let_go_for_a_mode_in_between(guarded, firmware, enabled):
    """Switched off, or by the sticks."""
    bench = guards(guarded(), firmware)
    bench.extra.append(RcChannels(sticks_us=(1500, 1500, 1500)))
    taken(bench)
    bench.obeys = False
    bench.extra += [RcChannels(sticks_us=(1500, 1700, 1500))] * 2 if enabled else [Settings(enable=False)]
    assert bench.setpoints(bench.step(5))
    assert bench.core.state is (State.YIELDED if enabled else State.FAULT)
    assert not bench.setpoints(show(bench, OTHER, EXTERNAL) + bench.step(100))
    assert bench.core.state is State.YIELDED


@pytest.mark.parametrize("other", [OTHER, HOLD, EXTERNAL])
def test_a_mission_left_and_selected_again_within_a_step_is_watched_only_once_it_is_fetched_again(
    guarded, firmware, other
):
    """The pilot may have selected another one."""
    bench = guards(guarded(), firmware)
    before, bench.mission = len(bench.log), mission(-300.0)
    show(bench, other, MISSION)
    assert bench.core.state is State.STANDBY
    bench.until(lambda: bench.core.state is State.WATCHING)
    assert [c for _, c in bench.log[before:] if isinstance(c, DownloadMission)]
    meet(bench)
    assert bench.core.plan.course.law.trajectory.points_ned_m[-1][0] == pytest.approx(-300.0, abs=1.0)


def test_a_mission_left_and_selected_again_while_the_core_stands_by_is_fetched_again(guarded, firmware):
    bench = guards(guarded(), firmware)
    bench.fix_type = 1
    bench.step()
    assert bench.core.state is State.STANDBY
    before = len(bench.log)
    show(bench, OTHER, MISSION)
    bench.fix_type = 3
    bench.until(lambda: bench.core.state is State.WATCHING)
    assert [c for _, c in bench.log[before:] if isinstance(c, DownloadMission)]


def given_back(guarded, firmware):
    """Its mission was just asked for, and the vehicle has not obeyed yet."""
    bench = taken(guards(guarded(), firmware))
    bench.core.traffic.clear()
    over(bench)
    assert bench.core.state is State.GUARDING
    bench.obeys, bench.mode = False, EXTERNAL
    return bench


def test_a_mission_that_is_entered_within_a_step_is_watched(guarded, firmware):
    bench = given_back(guarded, firmware)
    show(bench, EXTERNAL, MISSION)
    assert bench.core.state is State.WATCHING


@pytest.mark.parametrize("shown", [(OTHER, MISSION), (MISSION, EXTERNAL), (MISSION, OTHER, MISSION)])
def test_a_mode_that_is_not_ours_while_the_mission_is_given_back(guarded, firmware, shown):
    bench = given_back(guarded, firmware)
    assert yielded(bench, show(bench, *shown))


def test_the_missions_end_within_a_step_is_the_pilots_but_where_the_vehicle_tells_of_it(guarded, firmware):
    bench = given_back(guarded, firmware)
    bench.extra.append(MissionCurrent(seq=1, complete=True))
    show(bench, MISSION, HOLD)
    assert bench.core.state is (State.STANDBY if firmware is Firmware.PX4 else State.YIELDED)


def test_the_mission_and_then_ours_that_was_asked_for_again_is_no_pilot(guarded, firmware):
    bench = given_back(guarded, firmware)
    meet(bench, 40.0)
    assert bench.core.state is State.AVOIDING
    show(bench, MISSION, EXTERNAL)
    assert bench.core.state is State.AVOIDING
    assert bench.setpoints()


@pytest.mark.parametrize(
    ("shown", "anew"), [((OTHER, EXTERNAL), True), ((OTHER,), False), ((EXTERNAL, OTHER), False)]
)
def test_the_mode_that_gives_authority_must_be_the_last_one(make_bench, firmware, shown, anew):
    bench = flown(make_bench(rearm="mode"), firmware)
    bench.obeys = False
    # In the step that ends our authority nothing gives it anew, whatever follows.
    show(bench, OTHER, EXTERNAL)
    bench.step(20)
    assert bench.core.state is State.YIELDED
    show(bench, *shown)
    bench.step()
    assert (bench.core.state in HOLDING) is anew


def disarmed_within(bench):
    """One step in which the vehicle disarms and is armed again."""
    bench.extra += [beat(bench.mode, firmware=bench.firmware, armed=armed) for armed in (False, True)]
    return bench.step()


def test_a_vehicle_that_disarms_within_a_step_is_released(make_bench, firmware):
    bench = flown(make_bench(), firmware)
    law = bench.core.plan.course.law
    assert not bench.setpoints(disarmed_within(bench))
    assert bench.core.state is State.STANDBY
    bench.until(lambda: bench.core.state in HOLDING)
    assert bench.core.plan.course.law is not law, "the flight was over"


@pytest.mark.parametrize(("rearm", "anew"), [("disarm", True), ("never", False)])
def test_a_pilot_who_disarms_within_a_step_gives_authority_back(make_bench, firmware, rearm, anew):
    bench = flown(make_bench(rearm=rearm), firmware)
    bench.mode = OTHER
    bench.step(5)
    assert bench.core.state is State.YIELDED
    disarmed_within(bench)
    assert (bench.core.state is State.STANDBY) is anew
    assert modes(bench.step(20)) == []


def test_a_start_in_flight_sees_a_landing_within_a_step(make_bench, firmware):
    bench = make_bench(take_in_flight=False)
    bench.firmware, bench.mode = firmware, MISSION
    bench.step(100)
    assert bench.core.state is State.STANDBY
    disarmed_within(bench)
    bench.until(lambda: bench.core.state in HOLDING)
