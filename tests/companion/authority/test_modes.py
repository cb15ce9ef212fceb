"""Finds, among the modes that a vehicle reports between two steps, the one that the companion did not
cause."""

from __future__ import annotations

from itertools import product

import pytest

from companion.authority.guard import GuardPlan
from companion.authority.handback import HandBack
from companion.authority.modes import OurModes
from companion.config import Config, FlightConfig, IdentityConfig
from companion.events import Firmware, FlightMode, SetMode
from companion.ownship import Ownship
from tests.companion.authority.showing import beat, beats

EXTERNAL, MISSION, HOLD, OTHER = (
    FlightMode.EXTERNAL,
    FlightMode.MISSION,
    FlightMode.HOLD,
    FlightMode.OTHER,
)


class Asked(HandBack):
    """The mission has just been given back."""

    def __init__(self, own):
        config = Config(identity=IdentityConfig(uas_id="OWN"), flight=FlightConfig(use="guard"))
        super().__init__(GuardPlan(config), own, 3.0)
        self._asked_s = 0.0


def modes_of(shows, *, handback=False, firmware=Firmware.PX4, sought=True):
    """Modes of a vehicle that shows these heartbeats while the companion takes it."""
    own = Ownship(heartbeat=beat(shows, firmware=firmware))
    made = OurModes(own, Asked(own) if handback else None)
    if sought:
        made.seek(0.0)
    return made, own


def judged(made, *modes, held=True, firmware=Firmware.PX4):
    """The first mode that the companion did not cause; None if it caused all."""
    found = made.judge(beats(*modes, firmware=firmware), 1.0, held)
    return None if found is None else found.mode


@pytest.mark.parametrize("firmware", Firmware)
@pytest.mark.parametrize(
    ("shown", "foreign"),
    [
        ((EXTERNAL,), None),
        ((EXTERNAL, EXTERNAL), None),
        ((OTHER, EXTERNAL), OTHER),
        ((EXTERNAL, OTHER, EXTERNAL), OTHER),
        ((HOLD, OTHER, EXTERNAL), HOLD),
        ((MISSION, EXTERNAL), MISSION),
    ],
)
def test_while_the_vehicle_is_flown_every_mode_but_ours_is_foreign(firmware, shown, foreign):
    made, own = modes_of(HOLD, firmware=firmware)
    own.heartbeat = beat(EXTERNAL, firmware=firmware)
    made.keep(0.5)
    assert made.confirmed
    assert judged(made, *shown, firmware=firmware) is foreign


@pytest.mark.parametrize("firmware", Firmware)
@pytest.mark.parametrize("before", [HOLD, MISSION])
def test_the_mode_that_it_is_taken_from_is_expected_until_ours_is_shown(firmware, before):
    cases = {
        (before,): None,
        (before, EXTERNAL): None,
        (before, before, EXTERNAL, EXTERNAL): None,
        (EXTERNAL, before): before,
        (before, EXTERNAL, before): before,
        (OTHER, before): OTHER,
        (before, OTHER, EXTERNAL): OTHER,
    }
    for shown, foreign in cases.items():
        made, _ = modes_of(before, firmware=firmware)
        assert judged(made, *shown, firmware=firmware) is foreign, shown


def test_ours_once_shown_is_remembered_though_the_step_was_too_late_to_command():
    made, _ = modes_of(HOLD)
    assert judged(made, EXTERNAL) is None
    assert judged(made, HOLD) is HOLD
    made.seek(2.0)
    assert judged(made, HOLD) is None


def test_another_mode_of_the_same_kind_is_not_the_one_that_it_is_taken_from():
    made, _ = modes_of(HOLD)
    shown = [beat(HOLD, custom_mode=17), beat(HOLD)]
    assert made.judge(shown, 1.0, held=True) is shown[0]


@pytest.mark.parametrize("firmware", Firmware)
def test_what_a_fault_left_the_vehicle_in_is_expected_until_it_leaves_that(firmware):
    def left():
        made, own = modes_of(HOLD, firmware=firmware)
        own.heartbeat = beat(EXTERNAL, firmware=firmware)
        made.keep(0.5)
        assert made.let_go(asks_hold=True) == [SetMode(mode=HOLD)]
        return made

    for shown in ((EXTERNAL, HOLD), (HOLD,), (HOLD, EXTERNAL, HOLD)):
        made = left()
        assert judged(made, *shown, held=False, firmware=firmware) is None
        assert made.left_in == {EXTERNAL, HOLD}
    for shown in ((OTHER, HOLD), (EXTERNAL, OTHER, HOLD), (HOLD, MISSION, EXTERNAL)):
        made = left()
        assert judged(made, *shown, held=False, firmware=firmware) in {OTHER, MISSION}
        assert made.left_in == frozenset(), "our hold is the pilot's, once he has chosen another mode"


@pytest.mark.parametrize(("firmware", "complete"), list(product(Firmware, (False, True))))
def test_a_mission_that_is_given_back_is_expected_and_so_is_its_end_on_px4(firmware, complete):
    ends = firmware is Firmware.PX4 and complete
    cases = {
        (EXTERNAL, MISSION): None,
        (MISSION,): None,
        (OTHER, MISSION): OTHER,
        (MISSION, OTHER): OTHER,
        (MISSION, OTHER, MISSION): OTHER,
        (EXTERNAL, HOLD): None if ends else HOLD,
        (MISSION, HOLD): None if ends else HOLD,
        # After the mission was entered, a change to our mode is the pilot's.
        (MISSION, EXTERNAL): EXTERNAL,
        (HOLD, EXTERNAL): EXTERNAL if ends else HOLD,
    }
    for shown, foreign in cases.items():
        made, own = modes_of(MISSION, handback=True, firmware=firmware)
        own.heartbeat, own.mission_complete = beat(EXTERNAL, firmware=firmware), complete
        made.keep(0.5)
        assert judged(made, *shown, firmware=firmware) is foreign, shown


def test_our_mode_that_is_asked_for_again_may_follow_the_mission():
    own = Ownship(heartbeat=beat(MISSION))
    handback = Asked(own)
    made = OurModes(own, handback)
    made.seek(0.0)
    own.heartbeat = beat(EXTERNAL)
    made.keep(0.5)
    assert handback.recall(0.8) == [SetMode(mode=EXTERNAL)]
    assert judged(made, MISSION, EXTERNAL) is None
    assert judged(made, MISSION, OTHER, EXTERNAL) is OTHER


def test_a_mission_that_was_asked_for_too_long_ago_is_the_pilots():
    made, own = modes_of(MISSION, handback=True)
    own.heartbeat = beat(EXTERNAL)
    made.keep(0.5)
    assert made.judge(beats(MISSION, EXTERNAL), 9.0, held=True).mode is MISSION
