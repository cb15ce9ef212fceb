"""Who may fly the vehicle: late input, refusals of the gate, settings, and changes of the authority state."""

from __future__ import annotations

from typing import Literal

from companion.events.base import Command, Event


class InputBehind(Event, frozen=True):
    """Messages of the autopilot in this step may be as old as `since_s` (our monotonic time).

    The input was not read until it was empty, or messages waited on the way. The vehicle's mode is then not
    known, so nothing may be commanded in this step.
    """

    since_s: float
    why: str = ""
    """What was measured, in words."""
    by_clock: bool = False
    """The messages look old by the vehicle's own clock."""


class GateRefused(Event, frozen=True):
    """The gate (`companion.gate`) refused to send one of our commands."""

    rule: int
    """Number of the broken rule (`gate.rules`)."""
    text: str
    ends: Literal["nothing", "fault", "authority"] = "nothing"
    """Consequence of the refusal. "fault" ends authority as a fault does, and "authority" ends it until it is
    given back, as when the pilot takes over. "nothing": the command only came too early or too late."""


class GateAuthority(Event, frozen=True):
    """The gate has lost authority over the vehicle, or regained it."""

    lost: str | None = None
    """Why the gate blocks all commands until authority is given back, in words; None if it was given back."""


class Settings(Event, frozen=True, forbid_unknown_fields=True):
    """All settings that ground stations have changed; None where the configured value applies."""

    enable: bool = True
    """False: the companion neither takes nor keeps control of the vehicle."""
    conflict_radius_m: float | None = None
    horizon_s: float | None = None
    max_speed_mps: float | None = None


class AuthorityChanged(Command, frozen=True):
    """The authority state machine changed its state."""

    previous: str
    state: str
    trigger: str
    reason: str


class AllowanceSpent(Command, frozen=True):
    """Unproven traffic has spent an allowance for holding the aircraft (`authority.influence`)."""

    scope: Literal["track", "group", "low", "total", "crewed", "squeeze"]
    """Which allowance: that of one track, of its group, the total without its reserve ("low"), the total, or
    that of crewed traffic. "squeeze" is none of them: tracks that press on the aircraft are avoided only as
    far as another track allows."""
    track_id: str = ""
    """The track, the track of the group that was in conflict last, or the one that is avoided instead."""
    spent: bool = True
    """False: the allowance can be used again."""
    text: str = ""
