"""The table that decides who flies. A pair (state, trigger) that is not in it changes nothing.

These are the rules in the order in which they are judged at every step. The first trigger that the table
lists for the present state applies:

1. The pilot wins. A mode that we did not command, seen once while we control the vehicle, ends our authority
   at once, whichever mode follows it. Only `REARM` brings authority back.
2. If the own state is not usable, or after a late loop, nothing is commanded (`FAULT`). The fault ends when
   its cause has been gone for a while. It ends in standby, never directly in control.
3. A vehicle that is disarmed or on the ground is released.
4. Control is taken only from standby, and only of a vehicle that is ready: armed, in the air, with a usable
   own state and a path, and in a mode from which we may take it. If the autopilot flies its mission and is
   only guarded (`WATCHING`), the vehicle is taken only because of a conflict. The mission is then handed back
   (`RESUMED`), or ends during the handback (`ENDED`).
5. If traffic has held the vehicle for longer than it may (`SPENT`), the vehicle is left to the pilot.
6. Among the states that control the vehicle, the law's conflict decides.

`tests/companion/authority/test_proofs.py` checks every state with every set of triggers.
"""

from __future__ import annotations

import enum
from collections.abc import Container

from companion.events import Heartbeat


class State(enum.Enum):
    """Who flies, and for what purpose."""

    STANDBY = "standby"
    """Not in control; waiting for a vehicle that is ready."""
    WATCHING = "watching"
    """Not in control. The autopilot flies its mission and the law only observes."""
    GUARDING = "guarding"
    """In control, on the path, no conflict. A guarded mission is being handed back."""
    AVOIDING = "avoiding"
    """In control. A conflict shapes the velocity."""
    RECOVERING = "recovering"
    """In control, no conflict, on the way back to the timed path."""
    YIELDED = "yielded"
    """Not in control, because the pilot took over."""
    FAULT = "fault"
    """Not in control, because the own state is not usable or the loop was late."""

    __hash__ = object.__hash__  # Enum.__hash__ is Python code, and slow for lookups at every step.


class Trigger(enum.Enum):
    """Causes of transitions, in the order in which they are judged."""

    PILOT = "pilot"
    UNFIT = "unfit"
    RELEASE = "release"
    REARM = "rearm"
    HEALTHY = "healthy"
    READY = "ready"
    WATCH = "watch"
    LEFT = "left"
    RESUMED = "resumed"
    ENDED = "ended"
    CHANGED = "changed"
    SPENT = "spent"
    CONFLICT = "conflict"
    CLEAR = "clear"
    AWAY = "away"
    REGAINED = "regained"

    __hash__ = object.__hash__  # faster, as in `State`


HOLDING = frozenset({State.GUARDING, State.AVOIDING, State.RECOVERING})
"""States in which we control the vehicle and send setpoints."""

TRANSITIONS: dict[tuple[State, Trigger], State] = {
    (State.STANDBY, Trigger.READY): State.GUARDING,
    (State.STANDBY, Trigger.WATCH): State.WATCHING,
    (State.WATCHING, Trigger.UNFIT): State.STANDBY,
    (State.WATCHING, Trigger.RELEASE): State.STANDBY,
    (State.WATCHING, Trigger.LEFT): State.STANDBY,
    (State.WATCHING, Trigger.CONFLICT): State.AVOIDING,
    (State.GUARDING, Trigger.PILOT): State.YIELDED,
    (State.AVOIDING, Trigger.PILOT): State.YIELDED,
    (State.RECOVERING, Trigger.PILOT): State.YIELDED,
    (State.GUARDING, Trigger.UNFIT): State.FAULT,
    (State.AVOIDING, Trigger.UNFIT): State.FAULT,
    (State.RECOVERING, Trigger.UNFIT): State.FAULT,
    (State.GUARDING, Trigger.RELEASE): State.STANDBY,
    (State.AVOIDING, Trigger.RELEASE): State.STANDBY,
    (State.RECOVERING, Trigger.RELEASE): State.STANDBY,
    (State.FAULT, Trigger.PILOT): State.YIELDED,
    (State.FAULT, Trigger.HEALTHY): State.STANDBY,
    (State.YIELDED, Trigger.REARM): State.STANDBY,
    (State.GUARDING, Trigger.RESUMED): State.WATCHING,
    (State.RECOVERING, Trigger.RESUMED): State.WATCHING,
    (State.GUARDING, Trigger.ENDED): State.STANDBY,
    (State.AVOIDING, Trigger.ENDED): State.STANDBY,
    (State.RECOVERING, Trigger.ENDED): State.STANDBY,
    (State.GUARDING, Trigger.CHANGED): State.YIELDED,
    (State.GUARDING, Trigger.SPENT): State.YIELDED,
    (State.AVOIDING, Trigger.SPENT): State.YIELDED,
    (State.RECOVERING, Trigger.SPENT): State.YIELDED,
    (State.GUARDING, Trigger.CONFLICT): State.AVOIDING,
    (State.GUARDING, Trigger.AWAY): State.RECOVERING,
    (State.RECOVERING, Trigger.CONFLICT): State.AVOIDING,
    (State.AVOIDING, Trigger.CLEAR): State.RECOVERING,
    (State.RECOVERING, Trigger.REGAINED): State.GUARDING,
}


Found = dict[Trigger, Heartbeat | None]
"""Triggers found in a step, each with the heartbeat that caused it if a reported mode did."""


def next_state(state: State, triggers: Container[Trigger]) -> tuple[State, Trigger] | None:
    """Next state and the trigger that leads to it, or None if no trigger changes `state`."""
    for trigger, following in _MOVES[state]:
        if trigger in triggers:
            return following, trigger
    return None


_MOVES = {
    state: tuple((t, TRANSITIONS[state, t]) for t in Trigger if (state, t) in TRANSITIONS) for state in State
}
"""The table by state, with triggers in the order in which they are judged. It is prepared once because
`next_state` runs twenty times a second."""
