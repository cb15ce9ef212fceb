"""Who flies. One table; a pair (state, trigger) that is not in it changes nothing.

Rules, in the order they are judged at every step (the first trigger that the table knows is taken):

1. The pilot wins. A mode that we did not command, seen once while we hold the vehicle, ends our authority at
   once, whatever mode follows it, and nothing but `REARM` brings it back.
2. Without a fit own state, or after a late loop, nothing is commanded (`FAULT`). The fault ends when the
   cause has been gone for a while, and then in standby, never straight back in control.
3. A vehicle that is disarmed or on the ground is released.
4. Control is taken only from standby and only of a vehicle that is ready: armed, in the air, fit, with a
   path, and in a mode we may take it from. Where the autopilot flies its mission and is only guarded
   (`WATCHING`), it is taken for a conflict alone, and the mission is handed back (`RESUMED`), or
   comes to its end as it is (`ENDED`).
5. Among the states that hold the vehicle, the law's conflict decides.

`tests/companion/authority/test_proofs.py` goes through every state with every set of triggers.
"""

from __future__ import annotations

import enum
from collections.abc import Container

from companion.events import Heartbeat


class State(enum.Enum):
    """Who flies, and to what end."""

    STANDBY = "standby"
    """Not in control; waiting for a vehicle that is ready."""
    WATCHING = "watching"
    """Not in control: the autopilot flies its mission, the law looks on."""
    GUARDING = "guarding"
    """In control, on the path, no conflict; a mission that is guarded is being handed back."""
    AVOIDING = "avoiding"
    """In control; a conflict shapes the velocity."""
    RECOVERING = "recovering"
    """In control; no conflict, on the way back to the timed path."""
    YIELDED = "yielded"
    """The pilot took over."""
    FAULT = "fault"
    """Own state unfit or loop late: no setpoints."""


class Trigger(enum.Enum):
    """What moves the table, in the order judged."""

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
    CONFLICT = "conflict"
    CLEAR = "clear"
    AWAY = "away"
    REGAINED = "regained"


HOLDING = frozenset({State.GUARDING, State.AVOIDING, State.RECOVERING})
"""States in which setpoints leave."""

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
    (State.GUARDING, Trigger.CONFLICT): State.AVOIDING,
    (State.GUARDING, Trigger.AWAY): State.RECOVERING,
    (State.RECOVERING, Trigger.CONFLICT): State.AVOIDING,
    (State.AVOIDING, Trigger.CLEAR): State.RECOVERING,
    (State.RECOVERING, Trigger.REGAINED): State.GUARDING,
}


Found = dict[Trigger, Heartbeat | None]
"""Triggers that were found, each with what the vehicle showed of it, where that is a mode."""


def next_state(state: State, triggers: Container[Trigger]) -> tuple[State, Trigger] | None:
    """The move that `triggers` cause in `state`, or None."""
    for trigger, following in _MOVES[state]:
        if trigger in triggers:
            return following, trigger
    return None


_MOVES = {
    state: tuple((t, TRANSITIONS[state, t]) for t in Trigger if (state, t) in TRANSITIONS) for state in State
}
"""The table by state, triggers in the order judged: this runs twenty times a second."""
