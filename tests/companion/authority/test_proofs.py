"""Theorems on the authority table, checked for every state with every set of triggers.

The table is asked through `next_state` alone, with every set of the 16 triggers in each of the 7 states:
458 752 cases.
"""

from __future__ import annotations

from functools import cache

from companion.authority.table import State, Trigger, next_state

HELD = {State.GUARDING, State.AVOIDING, State.RECOVERING}
ALL = tuple(Trigger)


@cache
def moves() -> list[tuple[State, frozenset[Trigger], State, Trigger]]:
    """Every case in which the state changes: state, triggers found, next state, and the trigger that was
    taken."""
    found = [frozenset(t for n, t in enumerate(ALL) if bits >> n & 1) for bits in range(1 << len(ALL))]
    return [
        (state, triggers, *move)
        for state in State
        for triggers in found
        if (move := next_state(state, triggers)) is not None
    ]


def test_nothing_but_rearm_leads_away_from_the_pilot():
    away = {trigger for state, _, to, trigger in moves() if state is State.YIELDED and to is not state}
    assert away == {Trigger.REARM}
    assert {to for state, _, to, _ in moves() if state is State.YIELDED} == {State.STANDBY}


def test_a_fault_never_ends_in_control():
    ends = {to for state, _, to, _ in moves() if state is State.FAULT}
    assert ends == {State.YIELDED, State.STANDBY}


def test_control_is_taken_in_two_ways_only():
    taken = {(state, trigger) for state, _, to, trigger in moves() if to in HELD and state not in HELD}
    assert taken == {(State.STANDBY, Trigger.READY), (State.WATCHING, Trigger.CONFLICT)}


def test_the_pilot_precedes_everything():
    """With the trigger PILOT, whatever other triggers come with it, a companion that holds the vehicle or is
    in FAULT yields."""
    cases = [case for case in moves() if Trigger.PILOT in case[1] and case[0] in HELD | {State.FAULT}]
    assert len(cases) == 4 << 15
    assert all(to is State.YIELDED and trigger is Trigger.PILOT for _, _, to, trigger in cases)
