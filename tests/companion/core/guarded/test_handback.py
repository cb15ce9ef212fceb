"""The core gives a guarded vehicle back to its mission, event by event."""

from __future__ import annotations

import msgspec
import pytest

from companion.authority.table import HOLDING, State
from companion.events import (
    AuthorityChanged,
    DownloadMission,
    Firmware,
    FlightMode,
    MissionCurrent,
    MissionItem,
    MissionRefused,
    ModeRefused,
    Parameter,
    Say,
    SetMode,
    SetSpeed,
    VehicleParameters,
)
from tests.companion.conftest import mission
from tests.companion.core.guarded.guarding import meet, modes, on_path, over, taken


def test_a_conflict_while_the_mission_is_given_back_is_avoided(guarded):
    """The vehicle obeys the request for its mission late: it is taken again, and nobody took it from us."""
    bench = taken(guarded())
    over(bench)
    bench.obeys, bench.mode = False, FlightMode.EXTERNAL
    meet(bench, 40.0)
    assert bench.core.state is State.AVOIDING
    assert FlightMode.EXTERNAL in modes(c for t, c in bench.log if t > bench.now_s - 2.5)
    bench.mode = FlightMode.MISSION
    before = len(bench.log)
    meet(bench, 40.0)
    assert bench.core.state is State.AVOIDING
    assert modes(c for _, c in bench.log[before:]) == [FlightMode.EXTERNAL]
    bench.obeys = True
    bench.mode = FlightMode.EXTERNAL
    bench.step(10)
    assert bench.core.in_control


def test_another_mode_while_the_mission_is_given_back_is_the_pilots(guarded):
    bench = taken(guarded())
    over(bench)
    bench.obeys, bench.mode = False, FlightMode.OTHER
    bench.step(2)
    assert bench.core.state is State.YIELDED


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
    assert bench.core.state is State.GUARDING


def test_after_a_fault_the_mission_is_given_back_no_sooner_than_after_a_conflict(guarded):
    """One look that sees no conflict does not end the one that the fault came into."""
    bench = guarded()
    bench.firmware = Firmware.ARDUPILOT
    taken(bench)
    bench.fix_type = 1
    bench.step(300)  # longer than the mission is not asked for again
    bench.fix_type = 3
    bench.until(lambda: bench.core.state in HOLDING)
    begun_s = bench.now_s
    over(bench)
    assert bench.now_s - begun_s >= 3.0 - 0.1


def test_after_a_fault_the_vehicle_is_taken_from_where_we_left_it_and_given_back(guarded):
    bench = guarded()
    bench.firmware = Firmware.ARDUPILOT
    taken(bench)
    bench.fix_type = 1
    bench.step(5)
    assert bench.mode is FlightMode.HOLD
    bench.fix_type = 3
    before = len(bench.log)
    bench.until(lambda: bench.core.in_control)
    over(bench)
    assert modes(c for _, c in bench.log[before:]) == [FlightMode.EXTERNAL, FlightMode.MISSION]
    bench.until(lambda: bench.core.state is State.WATCHING)


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
    bench.core.traffic.clear()
    over(bench)
    bench.until(lambda: bench.core.state is State.WATCHING)
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
    bench.core.traffic.clear()
    since = bench.now_s
    over(bench)
    bench.until(lambda: bench.core.state is State.WATCHING)
    return bench.now_s - since


def test_a_vehicle_that_is_taken_again_and_again_is_given_back_ever_later(guarded):
    """As of crossing traffic that lasts: it is always taken at once, and not given back and forth."""
    bench = guarded()
    waited = [given_back_after_s(bench) for _ in range(4)]
    assert waited == [pytest.approx(s, abs=1.0) for s in (3.0, 6.0, 12.0, 24.0)]
    assert any(isinstance(c, Say) and "after 24 s without conflict" in c.text for _, c in bench.log)
    bench.step(round(61.0 / 0.05))
    assert given_back_after_s(bench) == pytest.approx(3.0, abs=1.0)


def test_the_mission_is_compared_before_it_is_given_back_however_soon(guarded):
    """What was fetched when the vehicle was taken says nothing of what came after."""
    bench = taken(guarded())
    bench.step(5)
    bench.mission = mission(-300.0, -900.0)
    bench.core.traffic.clear()
    bench.velocity_ned_mps = (0.0, 0.0, 0.0)
    for _ in range(200):
        on_path(bench)
        if bench.core.state is State.YIELDED:
            break
    assert bench.core.state is State.YIELDED
    assert FlightMode.MISSION not in modes(c for _, c in bench.log)


@pytest.mark.parametrize("firmware", Firmware)
def test_a_mission_that_cannot_be_read_is_not_waited_for_for_ever(guarded, firmware):
    bench = guarded()
    bench.firmware = firmware
    taken(bench)
    bench.mission = None
    bench.velocity_ned_mps = (0.0, 0.0, 0.0)
    bench.core.traffic.clear()
    since = None
    for _ in range(round(120.0 / 0.05)):
        on_path(bench)
        if any(isinstance(c, DownloadMission) for c in bench.commands):
            bench.extra.append(MissionRefused(reason="the vehicle answered: denied"))
        if bench.core.state is State.GUARDING:
            since = since or bench.now_s
        if bench.core.state is State.YIELDED:
            break
    assert bench.core.state is State.YIELDED
    assert bench.now_s - since == pytest.approx(90.0, abs=1.0)
    assert modes(c for _, c in bench.log) == [FlightMode.EXTERNAL, FlightMode.HOLD]
    (text,) = [c.text for _, c in bench.log if isinstance(c, Say) and "could not be read for 90 s" in c.text]
    assert text.endswith(
        f"Select {'AUTO' if firmware is Firmware.ARDUPILOT else 'AUTO.MISSION'} to fly the mission"
    )


def unseen(guarded):
    """The link goes down while the vehicle is being taken."""
    bench = guarded()
    bench.obeys = False
    meet(bench, seconds=1.5)
    assert modes(c for _, c in bench.log) == [FlightMode.EXTERNAL]
    bench.silent = True
    bench.step(60)
    assert bench.core.state is State.FAULT
    bench.silent = False
    return bench


def test_a_mode_that_was_entered_unseen_is_given_back(guarded):
    bench = unseen(guarded)
    bench.obeys, bench.mode = True, FlightMode.EXTERNAL
    bench.until(lambda: bench.core.in_control)
    over(bench)
    assert bench.mode is FlightMode.MISSION


def test_a_mode_that_was_not_entered_is_the_pilots_later(guarded):
    bench = unseen(guarded)
    bench.core.traffic.clear()
    bench.until(lambda: bench.core.state is State.WATCHING)
    bench.mode = FlightMode.EXTERNAL
    bench.step(100)
    assert bench.core.state is State.STANDBY


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
        if bench.core.state is State.YIELDED:
            break
    assert modes(c for _, c in bench.log) == [FlightMode.EXTERNAL, FlightMode.HOLD]
    assert any(isinstance(c, Say) and "already complete" in c.text for _, c in bench.log)


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
    assert bench.core.state is State.STANDBY
    assert not bench.setpoints(commands)
    assert not modes(commands)
    assert any(isinstance(c, Say) and "the mission ended during handback" in c.text for c in commands)
    assert not bench.setpoints(bench.step(100))
    bench.mode, bench.custom_mode = FlightMode.MISSION, 0
    bench.extra.append(MissionCurrent(seq=0))
    bench.until(lambda: bench.core.state is State.WATCHING)


@pytest.mark.parametrize(
    ("firmware", "words"),
    [
        (Firmware.PX4, "AUTO.LOITER during handback: the mission ended, or the pilot changed it"),
        (Firmware.ARDUPILOT, "not by the companion"),
    ],
)
def test_a_hold_whose_cause_is_not_known_is_the_pilots(guarded, firmware, words):
    bench, commands = ends_as_it_is_given_back(guarded, firmware, complete=False)
    assert bench.core.state is State.YIELDED
    assert not bench.setpoints(commands)
    (change,) = [c for c in commands if isinstance(c, AuthorityChanged)]
    assert change.reason.endswith(words)


def test_a_vehicle_that_is_kept_off_its_way_is_given_back(guarded):
    """Such as by a floor above its mission."""
    bench = taken(guarded())
    bench.velocity_ned_mps = (0.0, 0.0, 0.0)
    bench.core.traffic.clear()
    bench.east_m = 30.0
    bench.step(round(50.0 / 0.05))
    assert bench.core.state is State.RECOVERING
    bench.step(round(12.0 / 0.05))
    assert bench.core.state is State.WATCHING


def test_a_mission_that_would_begin_anew_since_a_moment_ago_is_not_resumed(guarded):
    """A ground station sets MIS_RESTART while the companion flies."""
    bench = guarded()
    bench.firmware = Firmware.ARDUPILOT
    taken(bench)
    restart = Parameter(name="MIS_RESTART", value=1.0)
    bench.extra.append(VehicleParameters(firmware=Firmware.ARDUPILOT, mission_restart=restart))
    bench.velocity_ned_mps = (0.0, 0.0, 0.0)
    bench.core.traffic.clear()
    for _ in range(200):
        on_path(bench)
        if bench.core.state is State.YIELDED:
            break
    assert modes(c for _, c in bench.log) == [FlightMode.EXTERNAL, FlightMode.HOLD]
    (text,) = [c.text for _, c in bench.log if isinstance(c, Say) and "yielded" in c.text]
    assert "MIS_RESTART 1" in text


def test_a_vehicle_that_obeys_while_it_recovers_is_left_alone(guarded):
    """The mission was asked for and is entered unseen: flying on, the vehicle leaves our path."""
    bench = taken(guarded())
    over(bench)
    bench.obeys, bench.mode = False, FlightMode.EXTERNAL
    bench.east_m += 12.0
    bench.step(8)
    assert bench.core.state is State.RECOVERING
    before = len(bench.log)
    bench.mode = FlightMode.MISSION
    bench.step(40)
    assert bench.core.state is State.WATCHING
    assert not modes(c for _, c in bench.log[before:])


def test_a_vehicle_that_is_slow_to_be_taken_is_not_taken_for_one_that_resumed(guarded):
    """The conflict is over before a heartbeat shows our mode, which the vehicle has entered."""
    bench = guarded()
    bench.obeys = False
    meet(bench, seconds=0.8)
    assert bench.core.state is State.AVOIDING
    bench.core.traffic.clear()
    bench.step(76)
    assert bench.core.state in HOLDING
    bench.obeys, bench.mode = True, FlightMode.EXTERNAL
    over(bench)
    bench.until(lambda: bench.core.state is State.WATCHING)


def test_a_handback_that_the_vehicle_obeys_after_the_pilots_choice_gives_no_authority(guarded):
    """The request was on its way as he selected his mode. Only what he selects after that counts."""
    bench = taken(guarded(rearm="mode"))
    bench.obeys = False
    over(bench)
    bench.mode = FlightMode.STICKS
    bench.step(2)
    assert bench.core.state is State.YIELDED
    bench.mode = FlightMode.MISSION
    bench.step(200)
    assert bench.core.state is State.YIELDED
    bench.mode = FlightMode.STICKS
    bench.step(2)
    bench.mode = FlightMode.MISSION
    bench.until(lambda: bench.core.state is State.WATCHING)


@pytest.mark.parametrize("mode", [FlightMode.STICKS, FlightMode.HOLD])
def test_the_pilots_mode_that_a_late_handback_ended_is_restored(guarded, mode):
    bench = guarded()
    customs = {FlightMode.MISSION: 3, FlightMode.EXTERNAL: 4, FlightMode.STICKS: 5, FlightMode.HOLD: 17}

    def shows(shown):
        bench.mode, bench.custom_mode = shown, customs[shown]

    bench.firmware = Firmware.ARDUPILOT
    shows(FlightMode.MISSION)
    taken(bench)
    shows(FlightMode.EXTERNAL)
    bench.obeys = False
    over(bench)
    shows(mode)
    bench.step(2)
    shows(FlightMode.MISSION)
    assert [c.mode for c in bench.step(5) if isinstance(c, SetMode)] == [mode]
    assert bench.core.state is State.YIELDED
