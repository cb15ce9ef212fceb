"""The authority table: every pair of state and trigger, and the rules that the table keeps."""

from __future__ import annotations

from itertools import product

from companion.authority.table import HOLDING, TRANSITIONS, State, Trigger, next_state
from tests.support import states


def test_every_pair_of_state_and_trigger():
    """Transitions in the table are made. Pairs that are not in the table change nothing."""
    for state, trigger in product(State, Trigger):
        expected = TRANSITIONS.get((state, trigger))
        moved = next_state(state, frozenset({trigger}))
        assert moved == (None if expected is None else (expected, trigger)), (state, trigger)


def test_rules_of_the_table():
    for state in HOLDING:
        assert TRANSITIONS[state, Trigger.PILOT] is State.YIELDED
        assert TRANSITIONS[state, Trigger.UNFIT] is State.FAULT
        assert TRANSITIONS[state, Trigger.RELEASE] is State.STANDBY
    assert {t for s, t in TRANSITIONS if s is State.YIELDED} == {Trigger.REARM}
    assert {s for (s, _), to in TRANSITIONS.items() if to is State.GUARDING} == {
        State.STANDBY,
        State.RECOVERING,
    }
    assert all(
        s in {State.GUARDING, State.RECOVERING, State.WATCHING}
        for (s, _), to in TRANSITIONS.items()
        if to is State.AVOIDING
    )
    # In WATCHING the companion does not hold the vehicle, so the pilot takes nothing from it.
    assert (State.WATCHING, Trigger.PILOT) not in TRANSITIONS


def test_the_pilot_is_judged_before_everything_else():
    everything = frozenset(Trigger)
    for state in HOLDING | {State.FAULT}:
        assert next_state(state, everything) == (State.YIELDED, Trigger.PILOT)


def test_the_page_shows_this_table():
    assert states.page_with_diagram(states.PAGE.read_text()) == states.PAGE.read_text()
