"""The heart guards a mission: what it asks of the vehicle, event by event."""

from __future__ import annotations

import msgspec
import pytest

from companion.avoidance.authority import HOLDING, State
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
    ModeRefused,
    Parameter,
    RcChannels,
    Say,
    SetMode,
    SetSpeed,
    TwoAutopilots,
    VehicleParameters,
)
from tests.companion.conftest import Bench, config, mission
from tests.companion.test_core import intruder


@pytest.fixture
def guarded():
    """Flies its mission at 3 m/s due north, to 300 m."""

    def build(items=None, **flight):
        made = msgspec.structs.replace(config(use="guard", **flight), path=None)
        items = items or mission(300.0, 900.0)
        bench = Bench(Companion(made), mission=items, mode=FlightMode.MISSION)
        bench.velocity_ned_mps = (3.0, 0.0, 0.0)
        bench.extra.append(MissionCurrent(seq=0))
        bench.until(lambda: bench.heart.state is State.WATCHING)
        return bench

    return build


def meet(bench, ahead_m=60.0, seconds=2.0):
    """Somebody comes head-on and is heard for a while."""
    for k in range(round(seconds)):
        bench.extra.append(intruder(bench, bench.north_m + ahead_m - 3.0 * k, 3.0))
        bench.step(20)


def taken(bench):
    meet(bench)
    bench.until(lambda: bench.heart.in_control)
    return bench


def over(bench):
    """Until the mission is given back."""
    bench.velocity_ned_mps = (0.0, 0.0, 0.0)
    bench.extra.append(RcChannels())
    for _ in range(800):
        if any(isinstance(c, SetMode) and c.mode is FlightMode.MISSION for c in bench.commands):
            return
        on_path(bench)
    raise AssertionError(bench.heart.state)


def on_path(bench, steps=1):
    """The vehicle is on the path's point, wherever that is."""
    for _ in range(steps):
        point = bench.heart.plan.point(bench.now_s)
        bench.north_m, bench.east_m = point[0], point[1]
        bench.step()


def modes(commands):
    return [c.mode for c in commands if isinstance(c, SetMode)]


def test_watching_needs_the_mission_mode_and_its_items(guarded):
    bench = guarded()
    assert [c for _, c in bench.log if isinstance(c, DownloadMission)]
    bench.mode = FlightMode.HOLD
    bench.step()
    assert bench.heart.state is State.STANDBY
    bench.step(100)
    assert bench.heart.state is State.STANDBY


def test_one_look_at_a_conflict_is_not_enough(guarded):
    bench = guarded()
    bench.extra.append(intruder(bench, 60.0, 3.0))
    bench.until(lambda: bench.heart._control._conflicts == 1)
    bench.heart.traffic.clear()
    bench.step(40)
    assert bench.heart.state is State.WATCHING


def test_what_is_wanted_is_what_the_vehicle_flies(guarded):
    """A path that began only now would be taken at half the speed: the law averages over time before it."""
    bench = taken(guarded())
    made = [(t, c.wanted_ned_mps) for t, c in bench.log if isinstance(c, Decision)]
    before = [wanted for t, wanted in made if t < taken_s(bench)]
    assert before
    for wanted in before:
        assert wanted == pytest.approx((3.0, 0.0, 0.0), abs=1e-6)
    # The way to the item begins at the speed that was flown.
    after = next(wanted for t, wanted in made if t >= taken_s(bench))
    assert after == pytest.approx((3.0, 0.0, 0.0), abs=0.1)


def taken_s(bench):
    return next(t for t, c in bench.log if getattr(c, "trigger", "") == "conflict")


TWO = TwoAutopilots(reason="two autopilots on this link (systems 1 and 2): set vehicle.system_id")


def test_a_mission_that_may_be_a_neighbours_is_not_guarded(guarded):
    bench = guarded()
    bench.extra.append(TWO)
    bench.step()
    assert bench.heart.state is State.STANDBY
    assert bench.heart.waits_for(bench.now_s) == TWO.reason
    before = len(bench.log)
    meet(bench, seconds=4.0)
    assert bench.heart.state is State.STANDBY
    assert not modes(c for _, c in bench.log[before:])
    assert not bench.setpoints([c for _, c in bench.log[before:]])


def test_a_second_autopilot_while_the_vehicle_is_held_ends_the_guarding_once_the_mission_flies_on(guarded):
    bench = taken(guarded())
    bench.extra.append(TWO)
    over(bench)
    assert bench.heart.state in HOLDING
    bench.mode = FlightMode.MISSION
    bench.until(lambda: bench.heart.state is State.STANDBY)
    assert [c.state for _, c in bench.log if isinstance(c, AuthorityChanged)][-2:] == ["watching", "standby"]
    assert bench.heart.waits_for(bench.now_s) == TWO.reason
    assert not [c for _, c in bench.log if getattr(c, "trigger", "") in ("pilot", "unfit")]


def test_no_setpoint_before_it_is_taken(guarded):
    bench = guarded()
    meet(bench)
    first = next(t for t, c in bench.log if c in bench.setpoints([c]))
    taken_s = next(t for t, c in bench.log if getattr(c, "trigger", "") == "conflict")
    assert first > taken_s


def test_a_conflict_while_the_mission_is_given_back_is_avoided(guarded):
    """The vehicle obeys the request for its mission late: it is taken again, and nobody took it from us."""
    bench = taken(guarded())
    over(bench)
    bench.obeys, bench.mode = False, FlightMode.EXTERNAL
    meet(bench, 40.0)
    assert bench.heart.state is State.AVOIDING
    assert FlightMode.EXTERNAL in modes(c for t, c in bench.log if t > bench.now_s - 2.5)
    bench.mode = FlightMode.MISSION
    before = len(bench.log)
    meet(bench, 40.0)
    assert bench.heart.state is State.AVOIDING
    assert modes(c for _, c in bench.log[before:]) == [FlightMode.EXTERNAL]
    bench.obeys = True
    bench.mode = FlightMode.EXTERNAL
    bench.step(10)
    assert bench.heart.in_control


def test_another_mode_while_the_mission_is_given_back_is_the_pilots(guarded):
    bench = taken(guarded())
    over(bench)
    bench.obeys, bench.mode = False, FlightMode.OTHER
    bench.step(2)
    assert bench.heart.state is State.YIELDED


def test_a_vehicle_that_does_not_take_its_mission_back_is_flown_on(guarded):
    bench = taken(guarded())
    over(bench)
    bench.obeys, bench.mode = False, FlightMode.EXTERNAL
    bench.extra.append(ModeRefused(mode=FlightMode.MISSION, reason="AUTO not entered"))
    before = len(bench.log)
    bench.step(20)
    assert len(bench.setpoints([c for _, c in bench.log[before:]])) == 20
    assert any(isinstance(c, Say) and "AUTO not entered" in c.text for _, c in bench.log[before:])
    on_path(bench, 200)
    assert FlightMode.MISSION in modes(c for _, c in bench.log[before:])
    assert bench.heart.state is State.GUARDING


@pytest.mark.parametrize("firmware", Firmware)
def test_a_fault_lets_go_as_the_firmware_needs_it(guarded, firmware):
    """ArduPilot flies on for seconds without setpoints, so it is stopped; PX4's own failsafe acts."""
    bench = guarded()
    bench.firmware = firmware
    taken(bench)
    bench.fix_type = 1
    commands = bench.step()
    assert bench.heart.state is State.FAULT
    assert not bench.setpoints(commands)
    assert modes(commands) == ([FlightMode.HOLD] if firmware is Firmware.ARDUPILOT else [])


def test_after_a_fault_the_vehicle_is_taken_from_where_we_left_it_and_given_back(guarded):
    bench = guarded()
    bench.firmware = Firmware.ARDUPILOT
    taken(bench)
    bench.fix_type = 1
    bench.step(5)
    assert bench.mode is FlightMode.HOLD
    bench.fix_type = 3
    before = len(bench.log)
    bench.until(lambda: bench.heart.in_control)
    over(bench)
    assert modes(c for _, c in bench.log[before:]) == [FlightMode.EXTERNAL, FlightMode.MISSION]
    bench.until(lambda: bench.heart.state is State.WATCHING)


def test_a_hold_that_is_not_ours_is_the_pilots(guarded):
    bench = guarded()
    bench.firmware = Firmware.ARDUPILOT
    taken(bench)
    bench.mode = FlightMode.HOLD
    bench.step()
    assert bench.heart.state is State.YIELDED


@pytest.mark.parametrize("rearm", ["disarm", "mode"])
def test_authority_given_anew_is_the_mission_selected_again(guarded, rearm):
    bench = taken(guarded(rearm=rearm))
    bench.mode = FlightMode.OTHER
    bench.step(20)
    bench.mode = FlightMode.MISSION
    bench.step(20)
    # Whoever came is still there.
    assert (bench.heart.state is State.AVOIDING) is (rearm == "mode")


def test_a_mission_selected_by_the_pilot_in_our_flight_gives_no_authority(guarded):
    bench = taken(guarded(rearm="mode"))
    bench.mode = FlightMode.MISSION
    bench.step(100)
    assert bench.heart.state is State.YIELDED


# ------------------------------------------------------------ sticks, estimator


def test_sticks_that_move_take_the_vehicle_and_get_a_mode_that_takes_them(guarded):
    bench = guarded()
    bench.extra.append(RcChannels(sticks_us=(1500, 1510, 1490)))
    taken(bench)
    bench.extra.append(RcChannels(sticks_us=(1500, 1510, 1490)))
    bench.step(5)
    bench.extra.append(RcChannels(sticks_us=(1500, 1650, 1490)))
    assert bench.setpoints(bench.step()), "one message may be a glitch"
    bench.extra.append(RcChannels(sticks_us=(1500, 1650, 1490)))
    bench.obeys = False
    commands = bench.step()
    # Standing, until the pilot's mode shows: PX4 would go home after a second without setpoints.
    assert [s.velocity_ned_mps for s in bench.setpoints(commands)] == [(0.0, 0.0, 0.0)]
    assert modes(commands) == [FlightMode.STICKS]
    assert bench.heart.state is State.YIELDED
    bench.step(20)
    assert [s.velocity_ned_mps for s in bench.setpoints()] == [(0.0, 0.0, 0.0)]
    bench.mode = FlightMode.STICKS
    assert not bench.setpoints(bench.step())
    bench.mode = FlightMode.EXTERNAL
    assert not bench.setpoints(bench.step(400)), "authority is not given anew"


def sticks_moved(bench):
    bench.extra += [RcChannels(sticks_us=(1500, 1700, 1500))] * 2
    return bench.step()


def at_rest(bench):
    bench.extra.append(RcChannels(sticks_us=(1500, 1500, 1500)))
    return taken(bench)


def test_sticks_without_a_mode_that_follows_are_waited_for_standing_for_seconds_and_no_longer(guarded):
    bench = at_rest(guarded())
    bench.obeys = False
    told = bench.setpoints(sticks_moved(bench) + bench.step(400))
    assert {s.velocity_ned_mps for s in told} == {(0.0, 0.0, 0.0)}
    assert 9.9 < len(told) * 0.05 < 10.1


def test_a_vehicle_that_refuses_the_mode_for_sticks_is_to_hold(guarded):
    """PX4 with a radio that it does not count as calibrated; without setpoints it would go home."""
    bench = at_rest(guarded())
    bench.obeys = False
    sticks_moved(bench)
    bench.step(120)
    bench.extra.append(ModeRefused(mode=FlightMode.STICKS, reason="POSCTL not entered"))
    commands = bench.step()
    assert modes(commands) == [FlightMode.HOLD]
    assert [s.velocity_ned_mps for s in bench.setpoints(commands)] == [(0.0, 0.0, 0.0)]
    bench.mode = FlightMode.HOLD
    assert not bench.setpoints(bench.step(100))
    assert bench.heart.state is State.YIELDED


def test_a_mode_for_sticks_that_is_refused_as_the_pilot_chose_another_leaves_him_that(guarded):
    bench = at_rest(guarded())
    bench.obeys = False
    sticks_moved(bench)
    bench.mode = FlightMode.OTHER
    bench.extra.append(ModeRefused(mode=FlightMode.STICKS, reason="the vehicle went to RTL"))
    assert modes(bench.step()) == []


def test_a_mode_chosen_with_the_sticks_ends_the_standing_for_good(guarded):
    bench = at_rest(guarded())
    bench.obeys = False
    assert bench.setpoints(sticks_moved(bench))
    bench.mode = FlightMode.OTHER
    assert not bench.setpoints(bench.step())
    bench.mode = FlightMode.EXTERNAL
    assert not bench.setpoints(bench.step(100))


def test_nobody_stands_on_an_own_state_that_is_not_fit(guarded):
    bench = at_rest(guarded())
    bench.obeys = False
    assert bench.setpoints(sticks_moved(bench))
    bench.fix_type = 1
    assert not bench.setpoints(bench.step(20))


@pytest.mark.parametrize("firmware", Firmware)
def test_sticks_that_move_in_a_fault_get_a_mode_that_takes_them(guarded, firmware):
    """From ArduPilot's BRAKE, which takes none; from PX4 before its own failsafe shows."""
    bench = guarded()
    bench.firmware = firmware
    at_rest(bench)
    bench.fix_type = 1
    bench.step(2)
    assert bench.heart.state is State.FAULT
    assert bench.mode is (FlightMode.HOLD if firmware is Firmware.ARDUPILOT else FlightMode.EXTERNAL)
    commands = sticks_moved(bench)
    assert bench.heart.state is State.YIELDED
    assert modes(commands) == [FlightMode.STICKS]
    assert not bench.setpoints(commands)
    (change,) = [c for c in commands if isinstance(c, AuthorityChanged)]
    assert change.reason == "the pilot moves the sticks"


def test_sticks_that_move_in_a_fault_leave_a_mode_that_is_not_ours_alone(guarded):
    """Our mode was never entered: the vehicle flies its mission on, as the pilot chose."""
    bench = guarded()
    bench.obeys = False
    bench.extra.append(RcChannels(sticks_us=(1500, 1500, 1500)))
    meet(bench, seconds=1.5)
    bench.fix_type = 1
    bench.step(2)
    assert bench.heart.state is State.FAULT
    commands = sticks_moved(bench)
    assert bench.heart.state is State.YIELDED
    assert modes(commands) == []
    (change,) = [c for c in commands if isinstance(c, AuthorityChanged)]
    assert change.reason == "the pilot moves the sticks"


def test_a_glitch_and_sticks_at_rest_are_no_pilot(guarded):
    bench = guarded()
    bench.extra.append(RcChannels(sticks_us=(1400, 1600, 1500)))
    taken(bench)
    for us in (1400, 1700, 1400, 1495):
        bench.extra.append(RcChannels(sticks_us=(us, 1600, 1500)))
        bench.step(4)
    bench.extra.append(RcChannels())
    bench.step(4)
    assert bench.heart.in_control


def test_the_estimators_word_ends_authority_at_once(guarded):
    bench = taken(guarded())
    bench.extra.append(EstimatorState(usable=False))
    assert not bench.setpoints(bench.step())
    assert bench.heart.state is State.FAULT
    bench.extra.append(EstimatorState(usable=True))
    bench.until(lambda: bench.heart.state is not State.FAULT)


# ------------------------------------------------------------ what the path to the item does not show


def test_a_conflict_beyond_the_missions_item_is_avoided(guarded):
    """The way to the item ends short of what the mission flies into: the vehicle is taken all the same."""
    bench = guarded(items=(MissionItem(seq=0, command=20, frame=3, lat_deg=None, lon_deg=None, alt_m=None),))
    bench.velocity_ned_mps = (0.0, 5.0, 0.0)
    for k in range(8):
        bench.extra.append(intruder(bench, 72.0 - 6.0 * k, 6.0, east_m=60.0))
        for _ in range(20):
            bench.east_m += 0.25 if bench.mode is FlightMode.MISSION else 0.0
            bench.step()
        if bench.heart.in_control:
            break
    moves = [c.trigger for _, c in bench.log if isinstance(c, AuthorityChanged)]
    assert moves[1:] == ["conflict"]
    assert bench.heart.in_control


@pytest.mark.parametrize("landed", [Landed.TAKEOFF, Landed.LANDING])
def test_take_offs_and_landings_are_not_guarded(guarded, landed):
    bench = guarded()
    bench.landed = landed
    meet(bench, seconds=5.0)
    assert bench.heart.state is State.WATCHING
    bench.landed = Landed.IN_AIR
    bench.step(20)
    assert bench.heart.state is State.AVOIDING


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
    assert bench.heart.state is State.WATCHING
    meet(bench)
    way = bench.heart.plan.law.trajectory
    assert way.points_ned_m[-1][0] == pytest.approx(-300.0, abs=1.0)


@pytest.mark.parametrize("firmware", Firmware)
@pytest.mark.parametrize("jumps", [False, True])
def test_a_speed_that_a_jump_leaves_open_is_not_set_and_that_is_said(guarded, firmware, jumps):
    way, last = mission(300.0, 900.0)
    speed = [
        MissionItem(seq=s, command=178, frame=2, params=(1.0, v, -1.0, 0.0)) for s, v in ((1, 3.0), (3, 8.0))
    ]
    jump = (MissionItem(seq=5, command=177, frame=2, params=(2.0, 1.0, 0.0, 0.0)),) if jumps else ()
    at = [msgspec.structs.replace(item, seq=s) for item, s in ((way, 2), (last, 4))]
    bench = guarded(items=(speed[0], at[0], speed[1], at[1], *jump))
    bench.firmware = firmware
    bench.extra.append(MissionCurrent(seq=2))
    taken(bench)
    bench.heart.traffic.clear()
    over(bench)
    bench.until(lambda: bench.heart.state is State.WATCHING)
    ardupilot = firmware is Firmware.ARDUPILOT
    (back,) = [c for _, c in bench.log if isinstance(c, SetMode) and c.mode is FlightMode.MISSION]
    assert back.speed_mps == (3.0 if ardupilot and not jumps else None)
    asked = [c.speed_mps for _, c in bench.log if isinstance(c, SetSpeed)]
    assert asked == ([3.0] if ardupilot and not jumps else [])
    told = any(isinstance(c, Say) and "jumps" in c.text for _, c in bench.log)
    assert told is (ardupilot and jumps)


def given_back_after_s(bench):
    """Taken for somebody who is gone soon: how long until the mission is asked for."""
    bench.velocity_ned_mps = (3.0, 0.0, 0.0)
    taken(bench)
    bench.step(4)
    bench.heart.traffic.clear()
    since = bench.now_s
    over(bench)
    bench.until(lambda: bench.heart.state is State.WATCHING)
    return bench.now_s - since


def test_a_vehicle_that_is_taken_again_and_again_is_given_back_ever_later(guarded):
    """As of crossing traffic that lasts: it is always taken at once, and not given back and forth."""
    bench = guarded()
    waited = [given_back_after_s(bench) for _ in range(4)]
    assert waited == [pytest.approx(s, abs=1.0) for s in (3.0, 6.0, 12.0, 24.0)]
    assert any(isinstance(c, Say) and "after 24 s without a conflict" in c.text for _, c in bench.log)
    bench.step(round(61.0 / 0.05))
    assert given_back_after_s(bench) == pytest.approx(3.0, abs=1.0)


def way_end_m(bench):
    return bench.heart.plan.law.trajectory.points_ned_m[-1][0]


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


def test_a_download_that_is_refused_while_the_mission_is_watched_is_asked_for_again(guarded):
    bench = guarded()
    bench.extra.append(MissionCurrent(seq=0, total=2))
    bench.step(20)
    bench.mission = None
    bench.extra.append(MissionCurrent(seq=0, total=1))
    bench.step(20)
    bench.extra.append(MissionRefused(reason="the vehicle answered: denied"))
    bench.step(20)
    before, bench.mission = len(bench.log), mission(-300.0)
    bench.step(220)
    assert len([c for _, c in bench.log[before:] if isinstance(c, DownloadMission)]) == 1
    meet(bench, seconds=0.8)
    assert way_end_m(bench) == pytest.approx(-300.0, abs=1.0)


def test_a_mission_that_is_known_to_be_another_is_not_led_to_before_it_is_fetched(guarded):
    bench = guarded()
    bench.extra.append(MissionCurrent(seq=0, total=2))
    bench.step(20)
    bench.mission = None
    bench.extra.append(MissionCurrent(seq=0, total=1))
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
    bench.until(lambda: bench.heart.state is State.WATCHING)


def test_the_mission_is_compared_before_it_is_given_back_however_soon(guarded):
    """What was fetched when the vehicle was taken says nothing of what came after."""
    bench = taken(guarded())
    bench.step(5)
    bench.mission = mission(-300.0, -900.0)
    bench.heart.traffic.clear()
    bench.velocity_ned_mps = (0.0, 0.0, 0.0)
    for _ in range(200):
        on_path(bench)
        if bench.heart.state is State.YIELDED:
            break
    assert bench.heart.state is State.YIELDED
    assert FlightMode.MISSION not in modes(c for _, c in bench.log)


@pytest.mark.parametrize("firmware", Firmware)
def test_a_mission_that_cannot_be_read_is_not_waited_for_for_ever(guarded, firmware):
    bench = guarded()
    bench.firmware = firmware
    taken(bench)
    bench.mission = None
    bench.velocity_ned_mps = (0.0, 0.0, 0.0)
    bench.heart.traffic.clear()
    since = None
    for _ in range(round(120.0 / 0.05)):
        on_path(bench)
        if any(isinstance(c, DownloadMission) for c in bench.commands):
            bench.extra.append(MissionRefused(reason="the vehicle answered: denied"))
        if bench.heart.state is State.GUARDING:
            since = since or bench.now_s
        if bench.heart.state is State.YIELDED:
            break
    assert bench.heart.state is State.YIELDED
    assert bench.now_s - since == pytest.approx(90.0, abs=1.0)
    assert modes(c for _, c in bench.log) == [FlightMode.EXTERNAL, FlightMode.HOLD]
    (text,) = [c.text for _, c in bench.log if isinstance(c, Say) and "could not be read for 90 s" in c.text]
    assert text.endswith("select AUTO" if firmware is Firmware.ARDUPILOT else "select AUTO.MISSION")


def unseen(guarded):
    """The link goes down while the vehicle is being taken."""
    bench = guarded()
    bench.obeys = False
    meet(bench, seconds=1.5)
    assert modes(c for _, c in bench.log) == [FlightMode.EXTERNAL]
    bench.silent = True
    bench.step(60)
    assert bench.heart.state is State.FAULT
    bench.silent = False
    return bench


def test_a_mode_that_was_entered_unseen_is_given_back(guarded):
    bench = unseen(guarded)
    bench.obeys, bench.mode = True, FlightMode.EXTERNAL
    bench.until(lambda: bench.heart.in_control)
    over(bench)
    assert bench.mode is FlightMode.MISSION


def test_a_mode_that_was_not_entered_is_the_pilots_later(guarded):
    bench = unseen(guarded)
    bench.heart.traffic.clear()
    bench.until(lambda: bench.heart.state is State.WATCHING)
    bench.mode = FlightMode.EXTERNAL
    bench.step(100)
    assert bench.heart.state is State.STANDBY


def test_a_mission_that_is_complete_is_not_entered_again(guarded):
    """ArduPilot would fly it from its beginning."""
    bench = guarded()
    bench.extra.append(MissionCurrent(seq=1, complete=True))
    bench.step()
    taken(bench)
    bench.extra.append(MissionCurrent(seq=1))
    bench.velocity_ned_mps = (0.0, 0.0, 0.0)
    for _ in range(800):
        on_path(bench)
        if bench.heart.state is State.YIELDED:
            break
    assert modes(c for _, c in bench.log) == [FlightMode.EXTERNAL, FlightMode.HOLD]
    assert any(isinstance(c, Say) and "come to its end" in c.text for _, c in bench.log)


def ends_as_it_is_given_back(guarded, firmware, complete):
    bench = guarded()
    bench.firmware = firmware
    taken(bench)
    over(bench)
    bench.mode, bench.custom_mode = FlightMode.HOLD, 0x03040000
    bench.extra.append(MissionCurrent(seq=0, complete=complete))
    return bench, bench.step()


def test_a_mission_that_ends_as_it_is_given_back_is_not_the_pilots_takeover(guarded):
    """PX4 holds then. Another mission that the pilot starts is guarded again."""
    bench, commands = ends_as_it_is_given_back(guarded, Firmware.PX4, complete=True)
    assert bench.heart.state is State.STANDBY
    assert not bench.setpoints(commands)
    assert not modes(commands)
    assert any(isinstance(c, Say) and "came to its end as it was given back" in c.text for c in commands)
    assert not bench.setpoints(bench.step(100))
    bench.mode, bench.custom_mode = FlightMode.MISSION, 0
    bench.extra.append(MissionCurrent(seq=0))
    bench.until(lambda: bench.heart.state is State.WATCHING)


@pytest.mark.parametrize(
    ("firmware", "words"),
    [
        (Firmware.PX4, "AUTO.LOITER as the mission was given back: by its end, or by the pilot"),
        (Firmware.ARDUPILOT, "not by us"),
    ],
)
def test_a_hold_whose_cause_is_not_known_is_the_pilots(guarded, firmware, words):
    bench, commands = ends_as_it_is_given_back(guarded, firmware, complete=False)
    assert bench.heart.state is State.YIELDED
    assert not bench.setpoints(commands)
    (change,) = [c for c in commands if isinstance(c, AuthorityChanged)]
    assert change.reason.endswith(words)


def test_a_vehicle_that_is_kept_off_its_way_is_given_back(guarded):
    """Such as by a floor above its mission."""
    bench = taken(guarded())
    bench.velocity_ned_mps = (0.0, 0.0, 0.0)
    bench.heart.traffic.clear()
    bench.east_m = 30.0
    bench.step(round(50.0 / 0.05))
    assert bench.heart.state is State.RECOVERING
    bench.step(round(12.0 / 0.05))
    assert bench.heart.state is State.WATCHING


def test_a_position_at_the_other_end_of_the_earth_is_not_flown_on(guarded):
    bench = guarded()
    bench.lat_deg, bench.lon_deg = -bench.lat_deg, bench.lon_deg - 180.0
    bench.step(200)
    assert bench.heart.state is State.STANDBY


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
    assert bench.heart.state is State.STANDBY
    assert any(isinstance(c, Say) and "MIS_RESTART 1" in c.text for _, c in bench.log)


def test_a_mission_that_would_begin_anew_since_a_moment_ago_is_not_resumed(guarded):
    """A ground station sets MIS_RESTART while the companion flies."""
    bench = guarded()
    bench.firmware = Firmware.ARDUPILOT
    taken(bench)
    restart = Parameter(name="MIS_RESTART", value=1.0)
    bench.extra.append(VehicleParameters(firmware=Firmware.ARDUPILOT, mission_restart=restart))
    bench.velocity_ned_mps = (0.0, 0.0, 0.0)
    bench.heart.traffic.clear()
    for _ in range(200):
        on_path(bench)
        if bench.heart.state is State.YIELDED:
            break
    assert modes(c for _, c in bench.log) == [FlightMode.EXTERNAL, FlightMode.HOLD]
    (text,) = [c.text for _, c in bench.log if isinstance(c, Say) and "yielded" in c.text]
    assert "MIS_RESTART 1" in text


@pytest.mark.parametrize("mode", [FlightMode.MISSION, FlightMode.OTHER])
def test_sticks_that_move_while_the_vehicle_is_being_taken(guarded, mode):
    """Our mode may be entered yet: the one that takes sticks is asked for, unless the pilot chose another."""
    bench = guarded()
    bench.obeys = False
    bench.extra.append(RcChannels(sticks_us=(1500, 1500, 1500)))
    meet(bench, seconds=1.5)
    before = len(bench.log)
    bench.mode = mode
    bench.extra += [RcChannels(sticks_us=(1500, 1700, 1500))] * 2
    bench.step()
    assert bench.heart.state is State.YIELDED
    assert modes(c for _, c in bench.log[before:]) == (
        [FlightMode.STICKS] if mode is FlightMode.MISSION else []
    )


def test_a_vehicle_that_obeys_while_it_recovers_is_left_alone(guarded):
    """The mission was asked for and is entered unseen: flying on, the vehicle leaves our path."""
    bench = taken(guarded())
    over(bench)
    bench.obeys, bench.mode = False, FlightMode.EXTERNAL
    bench.east_m += 12.0
    bench.step(8)
    assert bench.heart.state is State.RECOVERING
    before = len(bench.log)
    bench.mode = FlightMode.MISSION
    bench.step(40)
    assert bench.heart.state is State.WATCHING
    assert not modes(c for _, c in bench.log[before:])


def test_a_vehicle_that_is_slow_to_be_taken_is_not_taken_for_one_that_resumed(guarded):
    """The conflict is over before a heartbeat shows our mode, which the vehicle has entered."""
    bench = guarded()
    bench.obeys = False
    meet(bench, seconds=0.8)
    assert bench.heart.state is State.AVOIDING
    bench.heart.traffic.clear()
    bench.step(76)
    assert bench.heart.state in HOLDING
    bench.obeys, bench.mode = True, FlightMode.EXTERNAL
    over(bench)
    bench.until(lambda: bench.heart.state is State.WATCHING)
