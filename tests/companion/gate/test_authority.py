"""Rule 6: events that end authority and events that restore it."""

from __future__ import annotations

import pytest

from companion.events import Landed
from tests.companion.gate.authority import BOTH, USES, flying
from tests.companion.gate.flying import (
    ARDUPILOT,
    EXTERNAL,
    HOLD,
    MISSION,
    PX4,
    RTL,
    STICKS,
    Flying,
    config,
)

REARM = pytest.mark.parametrize("rearm", ["mode", "disarm", "never"])


# ---------------------------------------------------------------- 6: what ends authority


@BOTH
@USES
@pytest.mark.parametrize("mode", [RTL, HOLD, STICKS, MISSION])
def test_a_mode_that_was_not_asked_for_ends_it_at_once(use, firmware, mode):
    one = flying(use, firmware)
    one.beat(mode)
    assert one.gate.lost is not None
    assert not one.flies()
    assert not one.asks(HOLD)
    assert not one.asks(EXTERNAL)
    assert one.gate.counts == {"authority": 3}
    (told,) = one.broken()
    assert (told.rule, told.ends) == (6, "authority")


@USES
def test_the_mode_between_heartbeats_ends_it_too(use):
    one = flying(use, PX4)
    one.current_mode(RTL)
    assert not one.flies()
    one.current_mode(EXTERNAL)
    one.run(1.0)
    assert not one.flies()


@BOTH
@USES
def test_what_was_asked_for_does_not_excuse_what_came_before_it(use, firmware):
    """RTL and then BRAKE arrive in one batch. BRAKE was requested, RTL was not."""
    one = flying(use, firmware)
    assert one.asks(HOLD)
    one.beat(RTL)
    one.beat(HOLD)
    assert not one.flies()
    assert not one.asks(EXTERNAL)
    assert one.refused() == [6]


@BOTH
@USES
def test_a_pilot_who_comes_back_within_one_batch_was_there(use, firmware):
    one = flying(use, firmware, rearm="disarm")
    one.beat(RTL)
    one.beat(EXTERNAL)
    one.run(1.0)
    assert not one.flies()
    assert one.refused() == [6]


@BOTH
@USES
@pytest.mark.parametrize("mode", [HOLD, STICKS])
def test_a_mode_that_was_asked_for_keeps_it(use, firmware, mode):
    one = flying(use, firmware)
    assert one.asks(mode)
    one.run(9.9)
    one.mode = mode
    one.run(30.0)
    assert one.flies()
    assert one.asks(EXTERNAL)
    assert not one.gate.counts


@BOTH
def test_a_mode_that_was_asked_for_ten_seconds_ago_is_the_pilots(firmware):
    one = flying("guard", firmware)
    assert one.asks(HOLD)
    one.run(10.1)
    one.beat(HOLD)
    assert not one.flies()


@BOTH
@USES
def test_while_it_is_taken_the_vehicle_may_stay_in_its_mode_and_go_to_no_third_one(use, firmware):
    one = Flying(config(use), firmware).airborne(MISSION)
    assert one.asks(EXTERNAL)
    one.run(2.0)
    assert one.flies()
    assert one.asks(EXTERNAL)
    one.beat(RTL)
    assert not one.asks(EXTERNAL)
    assert one.refused() == [6]


def test_a_vehicle_that_has_left_its_mission_does_not_go_back_by_itself():
    one = flying("guard")
    one.beat(MISSION)
    assert not one.asks(EXTERNAL)


@pytest.mark.parametrize("firmware", [ARDUPILOT])
def test_in_guided_that_the_pilot_chose_the_vehicle_is_flown(firmware):
    one = Flying(config("fly"), firmware).airborne(EXTERNAL)
    assert one.flies()
    assert one.asks(HOLD)
    one.mode = HOLD
    one.run()
    one.mode = EXTERNAL
    one.run()
    assert one.flies()
    assert not one.gate.counts


def test_a_guard_leaves_guided_that_the_pilot_chose_alone():
    one = Flying(config("guard")).airborne(EXTERNAL)
    assert not one.flies()
    assert one.refused() == [6]


def test_modes_of_a_vehicle_that_is_not_held_end_nothing():
    one = Flying(config("guard")).airborne(MISSION)
    for mode in (RTL, HOLD, STICKS, EXTERNAL, MISSION):
        one.beat(mode)
    assert one.asks(EXTERNAL)


# ---------------------------------------------------------------- 6: what gives it back


def lost(use, firmware, rearm):
    one = flying(use, firmware, rearm=rearm)
    one.beat(RTL)
    return one.run(1.0)


@BOTH
@USES
@REARM
def test_what_gives_authority_back(use, firmware, rearm):
    given = MISSION if use == "guard" else EXTERNAL
    one = lost(use, firmware, rearm)
    one.beat(given)
    one.run(1.0)
    assert (one.gate.lost is None) is (rearm == "mode")
    assert one.asks(EXTERNAL) is (rearm == "mode")

    one = lost(use, firmware, rearm)
    one.beat(armed=False)
    one.beat(given, armed=True)
    one.run(1.0)
    assert one.asks(EXTERNAL) is (rearm != "never")


@BOTH
@USES
@REARM
def test_what_gives_nothing_back(use, firmware, rearm):
    """Authority is not restored by other modes, a landing without disarming, time or setpoints."""
    one = lost(use, firmware, rearm)
    other = EXTERNAL if use == "guard" else MISSION
    for mode in (HOLD, STICKS, other, RTL):
        one.mode = mode
        one.run(1.0)
        assert not one.flies()
        assert not one.asks(EXTERNAL)
        assert not one.asks(mode)
    one.landed = Landed.ON_GROUND
    one.run(15.0)
    one.landed = Landed.IN_AIR
    one.run(60.0)
    assert not one.flies()
    assert not one.asks(HOLD)
    assert one.gate.lost is not None


def test_of_a_guard_the_mission_that_ended_authority_does_not_give_it_back():
    """The pilot takes the vehicle by selecting its mission. To restore authority it must be left and selected
    again."""
    one = flying("guard", rearm="mode")
    one.beat(MISSION)
    one.run(1.0)
    assert not one.asks(EXTERNAL)
    one.beat(HOLD)
    one.beat(MISSION)
    assert one.asks(EXTERNAL)


def test_the_modes_of_before_do_not_count_after_it_is_given_back():
    one = flying("guard", rearm="mode")
    assert one.asks(HOLD)
    one.beat(RTL)
    one.beat(MISSION)
    one.run()
    assert one.asks(EXTERNAL)
    one.beat(EXTERNAL)
    one.beat(HOLD)
    assert not one.flies()


@BOTH
@USES
def test_disarmed_in_the_middle_of_a_batch(use, firmware):
    one = flying(use, firmware)
    one.beat(armed=False)
    one.beat(RTL, armed=True)
    one.run(1.0)
    assert not one.flies()
    one.mode = MISSION
    one.run()
    assert one.asks(EXTERNAL)


@BOTH
@USES
@pytest.mark.parametrize("rearm", ["mode", "disarm"])
def test_a_restart_in_flight_is_no_landing(use, firmware, rearm):
    """After a silence, the autopilot reports that it is disarmed and on the ground."""
    one = lost(use, firmware, rearm)
    one.now_s += 1.2
    one.landed = Landed.ON_GROUND
    one.beat(armed=False)
    one.run(5.0)
    assert one.gate.lost is not None
    one.landed = Landed.IN_AIR
    one.beat(MISSION if use == "fly" else EXTERNAL, armed=True)
    one.run(5.0)
    assert one.gate.lost is not None
    one.beat(armed=False)
    one.run(1.0)
    assert one.gate.lost is None, "it was seen armed, so now it has landed"


def test_a_vehicle_that_stays_disarmed_after_a_restart_has_landed():
    one = lost("fly", ARDUPILOT, "disarm")
    one.now_s += 1.2
    one.beat(armed=False)
    one.run(9.9)
    assert one.gate.lost is not None
    one.run(0.2)
    assert one.gate.lost is None


def test_a_vehicle_that_was_flying_at_the_start_has_not_landed_by_a_restart():
    one = Flying(config("fly", take_in_flight=False))
    one.landed, one.armed, one.mode = Landed.IN_AIR, True, MISSION
    one.run(1.0)
    one.now_s += 1.2
    one.landed = Landed.ON_GROUND
    one.beat(armed=False)
    one.run(5.0)
    one.landed = Landed.IN_AIR
    one.beat(armed=True)
    one.run(1.0)
    assert not one.asks(EXTERNAL)
    assert one.refused() == [6]


# ---------------------------------------------------------------- 6: a request that is obeyed too late


def overruled(use, firmware, rearm, mode=STICKS):
    """The vehicle has obeyed the request for our mode after the pilot had selected his."""
    one = Flying(config(use, rearm=rearm), firmware).airborne(MISSION)
    assert one.asks(EXTERNAL)
    one.beat(mode)
    one.run(0.3)
    one.beat(EXTERNAL)
    one.run()
    return one


@BOTH
@USES
@REARM
def test_a_request_that_is_obeyed_after_the_pilots_choice_gives_nothing_back(use, firmware, rearm):
    one = overruled(use, firmware, rearm)
    one.run(5.0)
    assert not one.flies()
    assert not one.asks(EXTERNAL)
    assert one.gate.lost is not None
    one.beat(RTL)
    one.beat(MISSION if use == "guard" else EXTERNAL)
    assert (one.gate.lost is None) is (rearm == "mode")


@BOTH
@USES
def test_what_was_obeyed_in_a_silence_gives_nothing_back(use, firmware):
    """It may have happened at the beginning of the silence."""
    one = Flying(config(use, rearm="mode"), firmware).airborne(MISSION)
    given = EXTERNAL
    if use == "guard":
        assert one.asks(EXTERNAL)
        one.beat(EXTERNAL)
        one.run()
        given = MISSION
    assert one.asks(given)
    one.beat(STICKS)
    one.run(0.3)
    one.now_s += 10.0
    one.beat(given)
    one.run(1.0)
    assert one.gate.lost is not None


@BOTH
@REARM
def test_a_handback_that_is_obeyed_after_the_pilots_choice_gives_nothing_back(firmware, rearm):
    one = flying("guard", firmware, rearm=rearm)
    assert one.asks(MISSION)
    one.beat(STICKS)
    one.run(0.3)
    one.beat(MISSION)
    one.run(5.0)
    assert one.gate.lost is not None
    assert one.asks(STICKS)


@BOTH
@USES
@REARM
@pytest.mark.parametrize("mode", [STICKS, HOLD])
def test_then_only_the_pilots_own_mode_may_be_requested(use, firmware, rearm, mode):
    one = overruled(use, firmware, rearm, mode)
    for other in {EXTERNAL, MISSION, HOLD, STICKS} - {mode}:
        assert not one.asks(other)
    one.run(3.0)
    assert one.asks(mode)
    one.beat(mode)
    one.run()
    assert not one.asks(mode)
    assert not one.flies()
    one.beat(EXTERNAL)
    one.run()
    assert one.asks(EXTERNAL) is (use == "fly" and rearm == "mode"), "now it is his own choice"


@BOTH
@USES
def test_a_mode_that_was_entered_before_the_pilots_choice_is_his_when_he_selects_it(use, firmware):
    one = flying(use, firmware)
    one.beat(STICKS)
    one.beat(EXTERNAL)
    one.run()
    assert not one.asks(STICKS)
    assert one.gate.lost is not None
