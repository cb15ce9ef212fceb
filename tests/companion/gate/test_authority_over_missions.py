"""Rule 6 for missions that are handed back, and for vehicles that were already flying."""

from __future__ import annotations

import pytest

from companion.events import Landed, MissionCurrent
from tests.companion.gate.authority import BOTH, USES, flying
from tests.companion.gate.flying import (
    EXTERNAL,
    HOLD,
    MISSION,
    PX4,
    RTL,
    STICKS,
    Flying,
    config,
)

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
    """The mission is given back, and a new conflict makes the companion request its mode again at once. The
    vehicle obeys both requests."""
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
    """The vehicle was commanded but never entered our mode, and nothing was sent since. Its pilot may leave
    the mission and select it again, and it is guarded as before."""
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
