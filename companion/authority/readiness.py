"""Whether the companion may take the vehicle, and if not, what it waits for."""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import attrgetter

from companion.adjustable_parameters import SWITCHED_OFF
from companion.authority.table import State
from companion.autopilot.dialect import DIALECTS
from companion.broadcast.broadcaster import Broadcaster
from companion.config import Config
from companion.events import (
    Command,
    FlightMode,
    GateAuthority,
    Heartbeat,
    Landed,
    Say,
    SecondCompanion,
    Severity,
    TwoAutopilots,
)
from companion.ownship import Ownship

_GUARDED = frozenset({FlightMode.MISSION})
_HOLD = frozenset({FlightMode.HOLD})
_LISTEN_S = 3.0
"""How long after its first heartbeat a vehicle is not taken if `vehicle.system_id` is not configured. In
three heartbeat periods a second autopilot on the link would be heard."""
_UNSEEN_S, _FALLEN_S = 1.0, 10.0
"""An autopilot that restarts in flight is silent for longer than `_UNSEEN_S`, and then disarmed for less than
`_FALLEN_S`: a vehicle with its motors off is on the ground by then."""
_FLYING_ALREADY = "vehicle was flying when the companion started and must land first (flight.take_in_flight)"

_armed = attrgetter("armed")


class Readiness:
    """Readiness of one vehicle to be taken.

    Only settings that no ground station can change are read from the configuration.
    """

    def __init__(self, config: Config, own: Ownship, broadcaster: Broadcaster) -> None:
        self._config = config
        self._own = own
        self._broadcaster = broadcaster
        self._guards = config.flight.use == "guard"
        self.enabled = True
        """DMUCA_ENABLE as set by a ground station."""
        self.unclear: str | None = None
        """Why it is not known which vehicle on the link is ours; None if it is known."""
        self.second: str | None = None
        """Why there is another companion that may command the vehicle; None if there is none."""
        self.lost: str | None = None
        """Why the gate blocks all commands until authority is given back; None if it does not."""
        self.down = False
        """The vehicle was on the ground or disarmed since the last step, if only for a moment. False if it
        was never heard."""
        self.disarmed = False
        """The vehicle was disarmed since the last step, and not because its autopilot restarted in flight."""
        self._flew = False
        """It was armed and not on the ground when it was last seen."""
        self._unseen_s: float | None = None
        """Last time at which a vehicle that flew was not seen; None once it was seen armed again."""
        self._disarmed_s = math.inf
        self._seen_down = config.flight.take_in_flight
        self._flying_told = config.flight.use == "watch"
        """Whether the pilot knows that the vehicle must land first."""
        self._found_s: float | None = None
        """Time at which the vehicle was first heard."""

    def two_autopilots_heard(self, event: TwoAutopilots) -> list[Command]:
        """Note that a second autopilot was heard, so that it is no longer known which vehicle is ours."""
        self.unclear = event.reason
        return [Say(severity=Severity.WARNING, text=f"DMUCA: {event.reason}")]

    def second_companion_heard(self, event: SecondCompanion) -> list[Command]:
        """Note that another companion with our own id was heard, or is gone.

        A vehicle that we control is kept, because released it would be left to the other one.
        """
        self.second = event.reason
        if self._config.flight.use == "watch":
            return []
        if event.reason is None:
            return [Say(severity=Severity.NOTICE, text="DMUCA: the other companion is gone")]
        return [Say(severity=Severity.WARNING, text=f"DMUCA: {event.reason}")]

    def gate_authority_changed(self, event: GateAuthority, state: State) -> list[Command]:
        """Note that the gate has lost authority or regained it.

        The loss is reported here only in states in which it causes no transition.
        """
        self.lost = event.lost
        if event.lost is None or state not in (State.STANDBY, State.WATCHING):
            return []
        return [Say(severity=Severity.WARNING, text=f"DMUCA: cannot take control: {event.lost}")]

    def look(self, now_s: float, shown: Sequence[Heartbeat]) -> list[Command]:
        """Note once a step whether the vehicle has been heard, and been on the ground or disarmed.

        Returns a message if it must land first, once: after a restart in flight the pilot would otherwise
        rely on a companion that does nothing.

        Args:
            shown: reported modes, as in `Control.step`.
        """
        if self._found_s is None and shown:
            self._found_s = now_s
        disarmed, landed = was_disarmed(shown), self._own.landed(now_s)
        self.down = disarmed or (bool(shown) and landed is Landed.ON_GROUND)
        self._note_disarmed(now_s, disarmed, landed)
        self._seen_down = self._seen_down or self.disarmed or (self._unseen_s is None and self.down)
        flies = self._own.armed and landed is Landed.IN_AIR
        if self._seen_down or self._flying_told or not flies:
            return []
        self._flying_told = True
        return [Say(severity=Severity.WARNING, text=f"DMUCA: cannot take control: {_FLYING_ALREADY}")]

    def _note_disarmed(self, now_s: float, disarmed: bool, landed: Landed) -> None:
        """Update `disarmed`. After a silence in flight, it may be a restarted autopilot that is disarmed."""
        own = self._own
        seen = own.age_s(now_s) <= _UNSEEN_S
        if not seen and self._flew:
            self._unseen_s = now_s
        elif seen and own.armed and self._unseen_s is not None and own.heartbeat_s > self._unseen_s:
            self._unseen_s = None
        self._disarmed_s = min(self._disarmed_s, now_s) if disarmed else math.inf
        lasted = own.heartbeat_s - self._disarmed_s >= _FALLEN_S
        self.disarmed = disarmed and (self._unseen_s is None or lasted)
        if self.disarmed:
            self._flew, self._unseen_s = False, None
        elif own.armed and landed is not Landed.UNDEFINED:
            self._flew = landed is not Landed.ON_GROUND

    def mode_is_ours_to_end(self, heartbeat: Heartbeat, ours: frozenset[FlightMode]) -> bool:
        """Whether the vehicle may be taken from the mode in this heartbeat.

        A hold may also be a failsafe's: PX4 holds for a lost radio or ground station, by itself or before it
        returns. That hold is not ours to end.

        Args:
            ours: modes that the vehicle may be in because of our own commands.
        """
        modes = _GUARDED if self._guards else DIALECTS[heartbeat.firmware].take_from
        return heartbeat.mode in ours | (modes - _HOLD if heartbeat.failsafe else modes)

    def waits_for(self, now_s: float, ours: frozenset[FlightMode]) -> str | None:
        """Why the vehicle cannot be taken now, in words; None if it can.

        It must be armed, in the air, with a usable own state, and in a mode that we may end.

        Args:
            ours: as in `mode_is_ours_to_end`.
        """
        own, config = self._own, self._config
        if self.unclear is not None:
            return self.unclear
        if self.lost is not None:
            return f"authority lost: {self.lost}"
        if config.flight.use == "watch":
            return 'flight.use is "watch"'
        if self.second is not None:
            return self.second
        if not self.enabled:
            return SWITCHED_OFF
        if own.heartbeat is None or not own.heartbeat.armed:
            return "vehicle is not armed"
        if config.vehicle.system_id == 0 and (self._found_s is None or now_s - self._found_s < _LISTEN_S):
            return "listening for other autopilots on the link (vehicle.system_id is not set)"
        if not self._seen_down:
            return _FLYING_ALREADY
        if own.landed(now_s) is not Landed.IN_AIR:
            return f"vehicle is not in the air (landed state: {own.landed(now_s).value})"
        if not self.mode_is_ours_to_end(own.heartbeat, ours):
            dialect = DIALECTS[own.heartbeat.firmware]
            modes = dialect.guard_in_name if self._guards else dialect.take_from_names
            mode = mode_name(own.heartbeat)
            if own.heartbeat.failsafe and own.mode is FlightMode.HOLD and own.mode in dialect.take_from:
                mode += ", which a failsafe may have selected (HEARTBEAT.system_status)"
            return f"vehicle is in mode {mode}; the companion takes control only from {modes}"
        if config.region.transport_sets and self._broadcaster.trouble is not None:
            return self._broadcaster.trouble
        return own.unfit(now_s, config.vehicle.stale_after_s)


def was_disarmed(shown: Sequence[Heartbeat]) -> bool:
    """Whether the vehicle was disarmed, if only for a moment."""
    return not all(map(_armed, shown))


def mode_name(heartbeat: Heartbeat | None) -> str:
    """Name that the autopilot gives to the vehicle's mode."""
    return "unknown" if heartbeat is None else DIALECTS[heartbeat.firmware].name(heartbeat.custom_mode)
