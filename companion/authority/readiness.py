"""Whether the vehicle may be taken, and what it waits for."""

from __future__ import annotations

from collections.abc import Sequence

from companion.adjustable_parameters import SWITCHED_OFF
from companion.authority.table import State
from companion.autopilot.dialect import DIALECTS
from companion.broadcast.broadcaster import Broadcaster
from companion.config import Config
from companion.events import (
    Command,
    Firmware,
    FlightMode,
    GateAuthority,
    Heartbeat,
    Landed,
    Say,
    Severity,
    TwoAutopilots,
)
from companion.ownship import Ownship

_TAKE_FROM = {
    # LOITER is flown with the sticks, BRAKE is a pilot's emergency stop: neither is ours to end.
    Firmware.ARDUPILOT: frozenset({FlightMode.EXTERNAL, FlightMode.MISSION}),
    Firmware.PX4: frozenset({FlightMode.EXTERNAL, FlightMode.MISSION, FlightMode.HOLD}),
}
"""Modes that the companion may take the vehicle from."""
_GUARDED = frozenset({FlightMode.MISSION})
_LISTEN_S = 3.0
"""Three heartbeats: a vehicle that was not configured is not taken before so long, as another one on the link
would be heard by then."""


class Readiness:
    """Of one vehicle. Of the configuration only what no ground station may set is used."""

    def __init__(self, config: Config, own: Ownship, broadcaster: Broadcaster) -> None:
        self._config = config
        self._own = own
        self._broadcaster = broadcaster
        self._guards = config.flight.use == "guard"
        self.enabled = True
        """As a ground station has switched it."""
        self.unclear: str | None = None
        """Why it is not known which vehicle on the link is ours."""
        self.lost: str | None = None
        """Why the gate lets nothing leave before authority is given back."""
        self._seen_down = config.flight.take_in_flight
        self._found_s: float | None = None
        """When the vehicle was first heard."""

    def take(self, event: TwoAutopilots) -> list[Command]:
        """From now on it is not known which vehicle is ours."""
        self.unclear = event.reason
        return [Say(severity=Severity.WARNING, text=f"DMUCA: {event.reason}")]

    def take_authority(self, event: GateAuthority, state: State) -> list[Command]:
        """The gate has lost authority or got it back. Where the loss ends nothing it is told here."""
        self.lost = event.lost
        if event.lost is None or state not in (State.STANDBY, State.WATCHING):
            return []
        return [Say(severity=Severity.WARNING, text=f"DMUCA: takes nothing: {event.lost}")]

    def look(self, now_s: float, shown: Sequence[Heartbeat]) -> None:
        """Note whether the vehicle is there, and was down.

        Args:
            shown: as of `Control.step`.
        """
        if self._found_s is None and shown:
            self._found_s = now_s
        self._seen_down = self._seen_down or self.down(now_s, shown)

    def down(self, now_s: float, shown: Sequence[Heartbeat]) -> bool:
        """The vehicle is there, and on the ground or disarmed, if only for a moment.

        Args:
            shown: as of `Control.step`.
        """
        return was_disarmed(shown) or (bool(shown) and self._own.landed(now_s) is Landed.ON_GROUND)

    def mode_is_ours_to_end(self, heartbeat: Heartbeat, ours: frozenset[FlightMode]) -> bool:
        """The vehicle may be taken from the mode that this shows.

        Args:
            ours: modes that it may be in by our own doing.
        """
        return heartbeat.mode in ours | (_GUARDED if self._guards else _TAKE_FROM[heartbeat.firmware])

    def waits_for(self, now_s: float, ours: frozenset[FlightMode]) -> str | None:
        """Why the vehicle cannot be taken now, in words; None when it can: it must be armed, in the air, fit,
        and in a mode that is ours to end.

        Args:
            ours: as of `mode_is_ours_to_end`.
        """
        own, config = self._own, self._config
        if self.unclear is not None:
            return self.unclear
        if self.lost is not None:
            return f"authority to be given back: {self.lost}"
        if config.flight.use == "watch":
            return 'flight.use is "watch"'
        if not self.enabled:
            return SWITCHED_OFF
        if own.heartbeat is None or not own.heartbeat.armed:
            return "vehicle to be armed"
        if config.vehicle.system_id == 0 and (self._found_s is None or now_s - self._found_s < _LISTEN_S):
            return "other autopilots on the link to show (vehicle.system_id is not set)"
        if not self._seen_down:
            return "a landing: the vehicle was flying when this started (flight.take_in_flight)"
        if own.landed(now_s) is not Landed.IN_AIR:
            return f"vehicle to be in the air (landed state: {own.landed(now_s).value})"
        if not self.mode_is_ours_to_end(own.heartbeat, ours):
            modes = "GUIDED or AUTO" if own.heartbeat.firmware is Firmware.ARDUPILOT else "HOLD or MISSION"
            if self._guards:
                modes = "AUTO" if own.heartbeat.firmware is Firmware.ARDUPILOT else "MISSION"
            return f"mode {modes} (now {mode_name(own.heartbeat)})"
        if config.region.transport_sets and self._broadcaster.trouble is not None:
            return self._broadcaster.trouble
        return own.unfit(now_s, config.vehicle.stale_after_s)


def was_disarmed(shown: Sequence[Heartbeat]) -> bool:
    """The vehicle was disarmed, if only for a moment."""
    return any(not heartbeat.armed for heartbeat in shown)


def mode_name(heartbeat: Heartbeat | None) -> str:
    """The vehicle's mode in the autopilot's own words."""
    return "unknown" if heartbeat is None else DIALECTS[heartbeat.firmware].name(heartbeat.custom_mode)
