"""Rules 4 to 6: who has authority, what ends it, what gives it back, and whether what is known is current."""

from __future__ import annotations

import pytest

from companion.events import Firmware, Landed, MissionCurrent, Settings
from tests.companion.gate.flying import (
    ARDUPILOT,
    EXTERNAL,
    HOLD,
    MISSION,
    PX4,
    RTL,
    STEP_S,
    STICKS,
    Flying,
    config,
)

BOTH = pytest.mark.parametrize("firmware", Firmware)
USES = pytest.mark.parametrize("use", ["guard", "fly"])
REARM = pytest.mark.parametrize("rearm", ["mode", "disarm", "never"])


def flying(use="fly", firmware=ARDUPILOT, **flight):
    return Flying(config(use, **flight), firmware).taken()


# ---------------------------------------------------------------- 4: use


@pytest.mark.parametrize("mode", [EXTERNAL, MISSION, HOLD])
def test_who_watches_commands_nothing(mode):
    one = Flying(config("watch")).airborne(mode)
    assert not one.flies()
    assert not one.asks(HOLD)
    assert not one.asks(EXTERNAL)
    assert one.refused() == [4]


@BOTH
@USES
def test_nothing_is_commanded_to_a_vehicle_that_is_disarmed(use, firmware):
    one = flying(use, firmware)
    one.beat(armed=False)
    assert not one.flies()
    assert not one.asks(HOLD)
    assert one.gate.counts == {"use": 2}


@BOTH
def test_a_vehicle_that_says_so_for_twelve_seconds_is_on_the_ground(firmware):
    one = flying(firmware=firmware)
    one.landed = Landed.ON_GROUND
    one.run(11.9)
    assert one.flies()
    one.run(0.3)
    assert not one.flies()
    assert one.refused() == [4]


def test_a_word_of_the_air_between_begins_the_twelve_seconds_anew():
    one = flying()
    for _ in range(3):
        one.landed = Landed.ON_GROUND
        one.run(11.0)
        one.landed = Landed.LANDING
        one.run()
        assert one.flies()


def test_a_vehicle_that_flies_fast_is_not_on_the_ground_whatever_it_says():
    """As docs/authority.md has it: of one faster than 2 m/s it is never believed."""
    one = flying()
    one.landed, one.velocity = Landed.ON_GROUND, (3.0, 0.0, 0.0)
    one.run(20.0)
    assert one.flies(3.0)
    one.velocity = (0.0, 0.0, 0.0)
    one.run(11.0)
    assert one.flies()
    one.run(1.5)
    assert not one.flies()


@BOTH
@USES
def test_disabled_it_may_stand_and_ask_for_a_hold(use, firmware):
    one = flying(use, firmware)
    one.gate.hear(Settings(enable=False), one.now_s)
    assert one.flies()
    assert one.asks(HOLD)
    assert one.asks(STICKS)
    assert not one.flies(0.1)
    assert not one.asks(EXTERNAL)
    assert one.gate.counts == {"use": 2}
    one.gate.hear(Settings(enable=True), one.now_s)
    one.run(3.1)
    assert one.flies(0.1)
    assert one.asks(EXTERNAL)


# ---------------------------------------------------------------- 5: current


def read(one, *, beats=True):
    """One turn of the loop, in time."""
    one.now_s += 0.05
    one.position()
    if beats:
        one.beat()
    one.gate.emptied(one.now_s)
    one.gate.decided(one.now_s)


def late(one, seconds):
    """The loop hangs for so long."""
    one.now_s += seconds
    one.gate.decided(one.now_s)


def test_nothing_is_commanded_before_the_input_was_read_to_its_end():
    one = Flying(config(take_in_flight=True))
    one.mode, one.armed = EXTERNAL, True
    one.position()
    one.beat()
    one.gate.decided(one.now_s)
    assert not one.flies()
    assert one.refused() == [5]
    one.gate.emptied(one.now_s)  # what came before may have waited for long
    assert not one.flies()
    one.beat()
    assert one.flies()


@pytest.mark.parametrize(("pause_s", "leaves"), [(0.24, True), (0.26, False)])
def test_after_a_pause_the_mode_is_not_known_before_it_is_seen(pause_s, leaves):
    one = flying()
    late(one, pause_s)
    assert one.flies() is leaves
    one.beat()
    one.position()
    one.gate.emptied(one.now_s)
    assert one.flies() is leaves
    read(one, beats=False)
    assert one.flies() is leaves
    read(one)
    assert one.flies()
    assert set(one.gate.counts) <= {"current"}


def test_px4_shows_its_mode_between_heartbeats_too():
    one = flying(firmware=PX4)
    late(one, 1.0)
    one.gate.emptied(one.now_s)
    read(one, beats=False)
    assert not one.flies()
    one.current_mode(EXTERNAL)
    assert one.flies()


@pytest.mark.parametrize(("silence_s", "leaves"), [(0.45, True), (0.55, False)])
def test_after_a_silence_of_the_vehicle_the_mode_is_not_known_before_it_is_seen(silence_s, leaves):
    one = flying()
    for _ in range(round(silence_s / STEP_S)):
        one.now_s += STEP_S
        one.gate.emptied(one.now_s)
        one.gate.decided(one.now_s)
    assert one.flies() is leaves
    read(one, beats=False)
    assert one.flies() is leaves
    assert one.asks(HOLD) is leaves
    read(one)
    assert one.asks(HOLD)
    assert set(one.gate.counts) <= {"current"}


def test_an_answer_is_a_word_of_the_vehicle_too():
    one = flying()
    for _ in range(15):
        one.now_s += STEP_S
        one.gate.answered(one.now_s - 0.02, one.now_s)
        one.gate.emptied(one.now_s)
        one.gate.decided(one.now_s)
    assert one.flies()


def test_behind_nothing_leaves_until_the_mode_is_seen_behind_the_backlog():
    one = flying()
    one.gate.behind()
    assert not one.flies()
    one.beat()  # of the backlog
    assert not one.flies()
    one.gate.emptied(one.now_s)
    assert not one.flies()
    one.beat()
    assert one.flies()


def test_a_mode_is_known_for_three_seconds():
    one = flying()
    one.run(2.95, beats=False)
    assert one.flies()
    one.run(0.1, beats=False)
    assert not one.flies()
    assert one.refused() == [5]


def test_a_mode_without_a_heartbeat_says_nothing():
    one = Flying(config(take_in_flight=True), PX4)
    for _ in range(5):
        read(one, beats=False)
        one.current_mode(EXTERNAL)
    assert not one.flies()
    assert one.refused() == [3]


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
    """RTL, then BRAKE, in one batch: BRAKE was asked for, RTL was not."""
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
    """Other modes, a landing without disarming, time, setpoints."""
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
    """The pilot takes the vehicle by its mission: it must be left and selected again."""
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


# ---------------------------------------------------------------- a mission handed back


@BOTH
def test_a_mission_is_handed_back_and_the_vehicle_taken_again(firmware):
    one = flying("guard", firmware)
    for _ in range(3):
        assert one.asks(MISSION)
        one.run(0.3)
        assert one.flies()
        one.mode = MISSION
        one.run(1.0)
        one.beat(HOLD)  # while it is not held, modes are the pilot's business
        one.beat(MISSION)
        assert one.asks(EXTERNAL)
        one.run(0.2)
        one.mode = EXTERNAL
        one.run()
        assert one.flies()
    assert not one.gate.counts


def test_a_mission_that_shows_late_is_the_pilots():
    one = flying("guard")
    assert one.asks(MISSION)
    one.run(10.1)
    one.beat(MISSION)
    assert one.gate.lost is not None


def ended(one):
    one.gate.hear(MissionCurrent(seq=3, complete=True), one.now_s)


def test_a_mission_that_ends_as_it_is_handed_back_ends_in_a_hold():
    one = flying("guard", PX4)
    assert one.asks(MISSION)
    one.beat(HOLD)
    assert not one.flies()
    one.gate.hear(MissionCurrent(seq=3), one.now_s)
    assert one.gate.lost is not None
    ended(one)
    assert one.gate.lost is None
    one.beat(MISSION)
    assert one.asks(EXTERNAL)


def test_a_missions_end_gives_nothing_back_that_it_did_not_end():
    one = flying("guard", PX4)
    one.beat(HOLD)  # the pilot's: no mission was asked for
    ended(one)
    assert one.gate.lost is not None
    one = flying("guard", PX4)
    assert one.asks(MISSION)
    one.beat(RTL)
    ended(one)
    assert one.gate.lost is not None


def test_a_pilot_who_went_another_way_before_holding_is_not_the_missions_end():
    one = flying("guard", PX4)
    assert one.asks(MISSION)
    one.beat(RTL)
    one.beat(HOLD)
    ended(one)
    assert one.gate.lost is not None


def test_a_hold_long_after_a_mission_was_asked_for_is_not_its_end():
    one = flying("guard", PX4)
    assert one.asks(MISSION)
    one.run(30.0)
    one.beat(HOLD)
    ended(one)
    assert one.gate.lost is not None


# ---------------------------------------------------------------- a vehicle that was flying already


@BOTH
@USES
@pytest.mark.parametrize("take_in_flight", [True, False])
def test_a_vehicle_that_was_flying_already(use, firmware, take_in_flight):
    one = Flying(config(use, take_in_flight=take_in_flight), firmware)
    one.mode, one.armed, one.landed = MISSION, True, Landed.IN_AIR
    one.run(20.0)
    assert one.asks(EXTERNAL) is take_in_flight
    assert one.refused() == ([] if take_in_flight else [6])
    one.landed = Landed.ON_GROUND
    one.run(1.4)
    one.landed = Landed.IN_AIR
    one.run(1.0)
    assert one.asks(EXTERNAL) is take_in_flight
    one.landed = Landed.ON_GROUND
    one.run(1.6)
    one.landed = Landed.IN_AIR
    one.run(1.0)
    assert one.asks(EXTERNAL)


def test_a_vehicle_that_was_disarmed_was_down():
    one = Flying(config("guard"))
    one.landed = Landed.IN_AIR
    one.run(0.2)
    one.mode, one.armed = MISSION, True
    one.run(1.0)
    assert one.asks(EXTERNAL)


def test_a_landing_ends_what_was_held():
    one = flying("guard")
    one.landed = Landed.ON_GROUND
    one.run(13.0)
    one.beat(RTL)
    assert one.gate.lost is None
    one.landed, one.mode = Landed.IN_AIR, MISSION
    one.run()
    assert one.asks(EXTERNAL)


# ---------------------------------------------------------------- what is still ours, and what is not


@BOTH
@pytest.mark.parametrize("flies_between", [False, True])
def test_a_mission_that_was_recalled_and_shows_for_a_moment_is_no_handing_back(firmware, flies_between):
    """Given back, and asked for our mode again at once as somebody comes: the vehicle obeys both."""
    one = flying("guard", firmware)
    assert one.asks(MISSION)
    one.run()
    assert one.asks(EXTERNAL)
    one.beat(MISSION)
    if flies_between:
        one.run()
        assert one.flies()
    one.beat(EXTERNAL)
    one.run()
    assert one.flies()
    assert one.gate.lost is None


@BOTH
def test_a_vehicle_that_was_left_in_its_mission_is_its_pilots_again(firmware):
    """It was commanded, never entered our mode, and has been let alone since: its pilot may leave the mission
    and select it again, and it is guarded as before."""
    one = Flying(config("guard"), firmware).airborne(MISSION)
    assert one.flies()
    assert one.asks(EXTERNAL)
    one.run(10.5)
    one.mode = STICKS
    one.run(5.0)
    one.mode = MISSION
    one.run(1.0)
    assert one.gate.lost is None
    assert one.flies()


@BOTH
def test_a_pilot_who_acts_while_the_vehicle_is_being_taken_from_its_mission_ends_authority(firmware):
    one = Flying(config("guard"), firmware).airborne(MISSION)
    assert one.flies()
    one.run(9.0)
    one.mode = STICKS
    one.run()
    one.mode = MISSION
    one.run()
    assert not one.flies()
    assert one.refused() == [6]
