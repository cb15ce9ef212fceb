"""When a guarded vehicle is given back: patience, how long it may obey, how long a download is waited for."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from companion.authority.handback import HandBack
from companion.authority.table import Trigger
from companion.events import Firmware, FlightMode, Say, SetMode, SetSpeed
from tests.companion.authority.showing import beat

CLEAR_S = 4.0


class Guard:
    """The plan of a mission of which a test says whether it may be resumed."""

    def __init__(self):
        self.same, self.why_not, self.left = True, None, 0
        self.speed_mps, self.open = None, False

    def leave(self, own, now_s):
        self.left += 1

    def give_back(self, own, now_s):
        return self.same, []

    def mission_speed_mps(self, own):
        return self.speed_mps

    def speed_is_open(self, own):
        return self.open


def made(firmware=Firmware.PX4, *, complete=False):
    own = SimpleNamespace(
        heartbeat=beat(FlightMode.EXTERNAL, firmware=firmware), mission_complete=complete, mission_seq=3
    )
    guard = Guard()
    return HandBack(guard, own, CLEAR_S), guard


def texts(commands):
    return [c.text for c in commands if isinstance(c, Say)]


def test_who_is_taken_again_soon_is_given_back_later_each_time():
    """Twice as late each time, a minute at most; after a minute of its mission it begins anew."""
    handback, guard = made()
    assert handback.begin(0.0) == []
    waits, now_s = [], 10.0
    for pause_s in (59.9, 30.0, 5.0, 59.9, 59.9, 60.1, 59.9):
        handback.resumed(now_s)
        now_s += pause_s
        said = texts(handback.begin(now_s))
        waits.append(said[0] if said else None)
        now_s += 10.0
    expected = [8, 16, 32, 60, 60, None, 8]
    assert waits == [
        None if wait is None else f"DMUCA: control taken again; next handback after {wait} s without conflict"
        for wait in expected
    ]
    assert guard.left == 8


def test_it_is_given_back_once_it_was_clear_for_long_enough():
    handback, _ = made()
    handback.begin(0.0)
    handback.resumed(10.0)
    handback.begin(20.0)  # 8 s from now on
    assert handback.ask(30.0, 7.9) == ([], False)
    assert handback.ask(30.0, 8.1) == ([SetMode(mode=FlightMode.MISSION)], False)


def test_it_is_asked_again_after_eight_seconds():
    handback, _ = made()
    handback.begin(0.0)
    assert not handback.asked(0.0)
    assert handback.ask(100.0, 50.0)[0]
    assert handback.asked(107.9)
    assert handback.ask(107.9, 57.9) == ([], False)
    assert not handback.asked(108.1)
    assert handback.ask(108.1, 58.1)[0]
    handback.begin(109.0)
    assert not handback.asked(109.0)


def test_a_mission_that_cannot_be_read_is_waited_for_ninety_seconds():
    handback, guard = made()
    handback.begin(0.0)
    guard.same = None
    assert [handback.ask(now_s, 50.0)[1] for now_s in (100.0, 150.0, 189.9, 190.1)] == [False] * 3 + [True]
    handback.interrupted()
    assert [handback.ask(now_s, 50.0)[1] for now_s in (200.0, 289.9, 290.1)] == [False, False, True]


def test_a_mission_that_was_changed_is_not_waited_for():
    handback, guard = made()
    guard.same = False
    assert handback.ask(100.0, 50.0) == ([], True)


@pytest.mark.parametrize("firmware", Firmware)
def test_the_missions_speed_is_set_where_it_is_forgotten(firmware):
    handback, guard = made(firmware)
    guard.speed_mps = 4.0
    forgets = firmware is Firmware.ARDUPILOT
    (mission,), _ = handback.ask(100.0, 50.0)
    assert mission == SetMode(mode=FlightMode.MISSION, speed_mps=4.0 if forgets else None)
    assert handback.resumed(101.0) == ([SetSpeed(speed_mps=4.0)] if forgets else [])


@pytest.mark.parametrize("firmware", Firmware)
@pytest.mark.parametrize("is_open", [True, False])
def test_a_speed_that_is_not_known_is_said_where_it_is_forgotten(firmware, is_open):
    handback, guard = made(firmware)
    guard.open = is_open
    said = texts(handback.resumed(101.0))
    assert len(said) == (is_open and firmware is Firmware.ARDUPILOT)


@pytest.mark.parametrize("complete", [True, False])
@pytest.mark.parametrize("firmware", Firmware)
def test_a_hold_just_after_the_request_is_the_missions_end_if_it_is_complete(firmware, complete):
    handback, _ = made(firmware, complete=complete)
    hold = beat(FlightMode.HOLD, firmware=firmware)
    assert not handback.obeyed(hold, 100.0)
    handback.ask(100.0, 50.0)
    ends = firmware is Firmware.PX4
    assert handback.ends_in_hold(hold, 107.9) is ends
    assert not handback.ends_in_hold(hold, 108.1)
    assert handback.ended(hold, 101.0) is handback.obeyed(hold, 101.0) is (ends and complete)
    found = handback.triggers([hold], 101.0)
    assert found[Trigger.LEFT] is hold
    assert (Trigger.ENDED in found) is (ends and complete)
    assert Trigger.RESUMED not in found


def test_the_missions_mode_is_ours_only_after_the_request():
    handback, _ = made()
    mission = beat(FlightMode.MISSION)
    assert handback.triggers([mission], 99.0) == {}
    assert handback.triggers([], 99.0) == {}
    assert not handback.obeyed(mission, 99.0)
    handback.ask(100.0, 50.0)
    assert handback.obeyed(mission, 101.0)
    assert handback.done(mission, 101.0)
    assert handback.triggers([mission], 101.0) == {Trigger.RESUMED: None}
    other = beat(FlightMode.OTHER)
    assert handback.triggers([other, mission], 101.0) == {Trigger.LEFT: other, Trigger.RESUMED: None}


def test_a_recalled_vehicle_is_asked_for_our_mode_and_has_not_done_what_it_was_asked():
    handback, _ = made()
    assert handback.recall(99.0) == []
    handback.ask(100.0, 50.0)
    assert handback.recall(101.0) == [SetMode(mode=FlightMode.EXTERNAL)]
    assert handback.obeyed(beat(FlightMode.MISSION), 101.5)
    assert not handback.done(beat(FlightMode.MISSION), 101.5)
    assert handback.recall(108.1) == []
    handback.ask(109.0, 50.0)
    assert handback.done(beat(FlightMode.MISSION), 109.5)
