"""Rules 4 and 5: what the use allows, and that the vehicle's mode is known."""

from __future__ import annotations

import pytest

from companion.events import Landed, Settings
from tests.companion.gate.authority import BOTH, USES, flying
from tests.companion.gate.flying import (
    EXTERNAL,
    HOLD,
    MISSION,
    PX4,
    STEP_S,
    STICKS,
    Flying,
    config,
)

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
    """As docs/troubles.md says, a landed state of a vehicle faster than 2 m/s is never believed."""
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
    """One cycle of the loop, in time."""
    one.now_s += 0.05
    one.position()
    if beats:
        one.beat()
    one.gate.emptied(one.now_s)
    one.gate.decided(one.now_s)


def late(one, seconds):
    """The loop hangs for `seconds`."""
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


def test_an_answer_that_is_told_again_is_no_new_word_of_the_vehicle():
    """`CompanionSystem.receive` tells the gate the latest answer at every read, also of an empty input."""
    one = flying()
    asked_s = one.now_s - 0.02
    for _ in range(15):
        one.gate.answered(asked_s, one.now_s)
        one.now_s += STEP_S
        one.gate.emptied(one.now_s)
        one.gate.decided(one.now_s)
    assert not one.gate.current(one.now_s)
    one.gate.answered(one.now_s - 0.02, one.now_s)
    assert not one.flies()
    assert not one.asks(HOLD)
    assert set(one.gate.counts) == {"current"}
    read(one)
    one.gate.answered(one.now_s - 0.01, one.now_s)
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


@pytest.mark.parametrize("delay_s", [2.0, 9.0, 12.0, 60.0])
def test_what_waited_on_the_way_is_old_however_long_it_waited(delay_s):
    one = Flying().airborne(MISSION)
    for _ in range(round(delay_s / STEP_S)):
        one.now_s += STEP_S
        one.gate.emptied(one.now_s)
    for _ in range(10):
        one.now_s += STEP_S
        one.position(age_s=delay_s)
        one.beat()
        one.gate.emptied(one.now_s)
    assert not one.asks(EXTERNAL)
    assert one.refused() == [5]


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


@pytest.mark.parametrize("report", ["beat", "current_mode"])
def test_a_mode_that_was_overtaken_on_the_way_is_no_news(report):
    one = flying("fly", PX4)
    one.gate.behind()
    one.run(beats=False)
    getattr(one, report)(EXTERNAL, overtaken=True)
    assert not one.flies()
    assert one.refused() == [5]
    getattr(one, report)(EXTERNAL)
    assert one.flies()


@pytest.mark.parametrize("delay_s", [0.8, 2.5, 9.0])
def test_after_an_old_message_among_new_ones_no_mode_counts_until_that_delay_has_passed(delay_s):
    one = flying()
    one.position(age_s=delay_s)
    one.position()
    assert not one.flies()
    one.run(delay_s - 0.1)
    assert not one.flies()
    one.run(0.2)
    assert one.flies()
    assert set(one.gate.counts) == {"current"}


def test_a_message_that_is_a_little_late_does_not_stop_the_flight():
    one = flying()
    one.position(age_s=0.45)
    one.position()
    assert one.flies()


def test_a_clock_that_has_restarted_stops_the_flight_for_ten_seconds():
    """It cannot be distinguished from a message that was delayed for as long."""
    one = flying()
    one.boot_s += 90.0
    one.run(9.9)
    assert not one.flies()
    one.run(0.2)
    assert one.flies()


@pytest.mark.parametrize("report", ["beat", "current_mode"])
def test_among_old_messages_a_mode_ends_authority_and_never_gives_it_back(report):
    one = flying("fly", PX4, rearm="mode")
    one.position(age_s=2.0)
    getattr(one, report)(STICKS)
    assert one.gate.lost
    one.beat(EXTERNAL, armed=False)
    assert one.gate.lost
    one.run(2.1)
    getattr(one, report)(STICKS)
    getattr(one, report)(EXTERNAL)
    assert not one.gate.lost


@pytest.mark.parametrize("rearm", ["mode", "disarm"])
def test_among_old_messages_a_mission_that_the_pilot_selects_ends_authority(rearm):
    """He selects the mission and then GUIDED, while no message tells by its time what came first."""
    one = flying("guard", rearm=rearm)
    one.position(age_s=2.0)
    one.beat(MISSION)
    assert one.gate.lost
    one.beat(EXTERNAL)
    one.run(2.1)
    assert one.gate.lost
    assert not one.flies()


@pytest.mark.parametrize("use", ["guard", "fly"])
@pytest.mark.parametrize("rearm", ["mode", "disarm"])
@pytest.mark.parametrize("order_known_again", [False, True])
def test_among_old_messages_the_mode_taken_from_ends_authority_once_ours_was_shown(
    use, rearm, order_known_again
):
    one = Flying(config(use, rearm=rearm)).airborne(MISSION)
    assert one.asks(EXTERNAL)
    one.position(age_s=2.0)
    one.beat(MISSION)  # the request is on its way
    one.beat(EXTERNAL)
    assert not one.gate.lost
    if order_known_again:
        one.mode = EXTERNAL
        one.now_s += 2.1
        one.mode = MISSION
    one.beat(MISSION)
    assert one.gate.lost
    one.run(2.1)
    assert one.gate.lost
    assert not one.asks(EXTERNAL)


def test_a_loss_by_an_old_message_is_not_ended_by_the_mission_that_the_pilot_then_selects():
    """As if the old message had not been: he has to leave the mission first."""
    one = flying("guard", rearm="mode")
    one.position(age_s=2.0)
    one.beat(MISSION)  # from before; nothing tells so
    one.beat(EXTERNAL)
    one.run(2.1)
    assert one.gate.lost
    one.mode = MISSION
    one.run(1.0)
    assert one.gate.lost
    one.beat(HOLD)
    one.beat(MISSION)
    assert not one.gate.lost


def test_after_a_loss_by_an_old_message_our_own_mode_does_not_give_authority():
    """Only once another mode has shown that the pilot has taken over, GUIDED is his."""
    one = Flying(config("fly", rearm="mode")).airborne(MISSION)
    assert one.asks(EXTERNAL)
    one.position(age_s=2.0)
    one.beat(EXTERNAL)  # from before; nothing tells so
    one.beat(MISSION)
    assert one.gate.lost
    one.mode = EXTERNAL  # our request is obeyed
    one.run(3.1)
    assert one.gate.lost
    one.beat(HOLD)
    one.beat(EXTERNAL)
    assert not one.gate.lost


def test_a_mode_that_was_entered_among_old_messages_stays_ours():
    """Also when they go on for longer than a request counts."""
    one = Flying(config("guard")).airborne(MISSION)
    assert one.asks(EXTERNAL)
    one.mode = EXTERNAL
    for _ in range(3):
        one.position(age_s=9.0)
        one.run(5.0)
    assert not one.gate.lost
    one.run(9.0)
    assert one.flies()


def test_a_mission_that_is_handed_back_among_old_messages_ends_authority():
    one = flying("guard")
    assert one.asks(MISSION)
    one.position(age_s=2.0)
    one.beat(MISSION)
    one.beat(EXTERNAL)  # by the pilot
    one.run(2.1)
    assert not one.flies()


def test_a_mission_that_newer_messages_have_overtaken_may_be_from_before():
    one = flying("guard")
    one.beat(MISSION, overtaken=True)
    assert not one.gate.lost
    assert one.flies()


@pytest.mark.parametrize("report", ["beat", "current_mode"])
def test_a_mode_that_was_overtaken_ends_authority_and_never_gives_it_back(report):
    one = flying("fly", PX4, rearm="mode")
    getattr(one, report)(STICKS, overtaken=True)
    assert one.gate.lost
    one.beat(STICKS)
    getattr(one, report)(EXTERNAL, overtaken=True)
    assert one.gate.lost
    one.beat(EXTERNAL, armed=False, overtaken=True)
    assert one.gate.lost
    one.beat(EXTERNAL, armed=True)
    assert not one.gate.lost


def test_our_own_pause_is_no_silence_of_the_vehicle():
    """Commands that waited when we were stopped have not waited for an answer meanwhile."""
    one = flying()
    one.gate.answered(one.now_s - 0.02, one.now_s)
    one.now_s += 0.2
    assert not one.gate.answers(one.now_s, waiting=True)
    one.now_s += 5.0
    read(one)
    for _ in range(9):
        one.now_s += 0.1
        one.gate.emptied(one.now_s)
        assert not one.gate.answers(one.now_s, waiting=True)
    assert not one.gate.broken()
    for _ in range(3):
        one.now_s += 0.1
        one.gate.emptied(one.now_s)
        one.gate.answers(one.now_s, waiting=True)
    assert [refused.rule for refused in one.gate.broken()] == [14]
