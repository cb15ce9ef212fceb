"""Asks the vehicle for a mode and for the speed of its mission. Both requests end when the pilot or a
failsafe takes over.

A speed given with a mode is sent right after each request for that mode. A speed given alone is sent until
the vehicle has answered it (MAV_CMD_DO_CHANGE_SPEED), as long as the mission is flown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.counts import LinkCounts
from companion.autopilot.dialect import CMD_DO_CHANGE_SPEED, CMD_DO_SET_MODE, CMD_REQUEST_MESSAGE, DIALECTS
from companion.autopilot.encoders import Outgoing, command_long
from companion.autopilot.heard_vehicle import HeardVehicle
from companion.autopilot.modes.mode_request import ModeRequest, ModeTold
from companion.autopilot.outbox import Outbox
from companion.events import CurrentMode, Event, FlightMode, Heartbeat, ModeRefused, SetMode

_GROUND_SPEED, _THROTTLE_AS_IT_IS = 1.0, -1.0
_SPEED_RETRY_S, _SPEED_TRIES = 1.0, 5
_WANTED_AGAIN_S = 0.2
_HEARTBEAT = float(mavlink.MAVLINK_MSG_ID_HEARTBEAT)


@dataclass(slots=True)
class _SpeedRequest:
    """DO_CHANGE_SPEED, repeated until it is answered or was sent often enough."""

    speed_mps: float
    tries: int = 0
    next_s: float = 0.0


class ModeAndSpeed:
    """At most one mode request and one speed request, the latest of each."""

    def __init__(self, heard: HeardVehicle, outbox: Outbox, events: list[Event], counts: LinkCounts) -> None:
        """`events` receives the refusals of modes."""
        self._heard = heard
        self._outbox = outbox
        self._events = events
        self._counts = counts
        self._told = ModeTold()
        self._mode: ModeRequest | None = None
        self._cancelled: ModeRequest | None = None
        """The latest request that was given up, as long as the vehicle may still obey it."""
        self._mode_speed_mps: float | None = None
        self._speed: _SpeedRequest | None = None
        self._mode_wanted_s = -math.inf
        """When a HEARTBEAT was last requested."""

    @property
    def asked_mode(self) -> FlightMode | None:
        """The mode that is being asked for, or may still be entered by a request that was given up; None if
        there is none."""
        request = self._mode or self._cancelled
        return None if request is None else request.mode

    def ask_mode(self, command: SetMode, now_s: float) -> None:
        """Ask for a mode. This replaces an earlier request.

        Raises:
            ValueError: the mode cannot be commanded.
        """
        mode, vehicle = command.mode, self._heard.vehicle
        if vehicle is None:
            self._events.append(ModeRefused(mode=mode, reason="no vehicle has been heard yet"))
        elif vehicle.refusal is not None:
            self._events.append(ModeRefused(mode=mode, reason=vehicle.refusal))
        else:
            dialect = DIALECTS[vehicle.firmware]
            self._speed = None
            before = self._mode
            if before is None:
                # The vehicle entering the mode of the cancelled request is not the pilot's choice either.
                before = self._obeyable(now_s)
            self._cancelled = None
            self._mode = ModeRequest(mode, dialect, vehicle.system_id, self._told, now_s, before)
            self._mode_speed_mps = command.speed_mps
            self._move_mode(now_s)

    def ask_speed(self, speed_mps: float) -> None:
        """Ask for the speed of the mission, from the next `advance` on."""
        self._speed = _SpeedRequest(speed_mps)

    def cancel(self) -> None:
        """Give up the mode request and the speed request."""
        self._cancelled, self._mode, self._speed = self._mode or self._cancelled, None, None

    def _obeyable(self, now_s: float) -> ModeRequest | None:
        """The request that was given up, if the vehicle may still obey it."""
        given_up = self._cancelled
        return given_up if given_up is not None and given_up.may_be_entered(now_s) else None

    def forget(self, now_s: float) -> None:
        """The input was a backlog, so the mode that it reported may be old. Ask the vehicle to report its
        mode."""
        self._told.forget()
        if self._mode is not None:
            self._mode.forget()
        vehicle = self._heard.vehicle
        if vehicle is not None and now_s - self._mode_wanted_s >= _WANTED_AGAIN_S:
            self._mode_wanted_s = now_s
            self._outbox.queue(command_long(CMD_REQUEST_MESSAGE, (_HEARTBEAT,), vehicle.system_id))

    def on_heartbeat(self, event: Heartbeat, now_s: float) -> None:
        """Take the mode from the vehicle's HEARTBEAT."""
        self._told.heartbeat(event.custom_mode, now_s, DIALECTS[event.firmware].mode_known_s)
        self._on_mode(now_s)

    def on_current_mode(self, event: CurrentMode, now_s: float) -> None:
        """Take the mode from CURRENT_MODE, which comes between two heartbeats."""
        self._told.current_mode(event.custom_mode, now_s)
        self._on_mode(now_s)

    def _on_mode(self, now_s: float) -> None:
        if self._mode is not None:
            self._mode.on_mode(now_s)
            self._settle_mode()

    def on_text(self, text: str) -> None:
        """Take a text of the vehicle, which may explain a refusal."""
        if self._mode is not None:
            self._mode.on_text(text)

    def on_ack(self, command: int, result: int) -> None:
        """Take the vehicle's COMMAND_ACK addressed to us, for any command."""
        if command == CMD_DO_SET_MODE and self._mode is not None:
            self._mode.on_ack(result)
        elif command == CMD_DO_CHANGE_SPEED:
            self._speed = None

    def advance(self, now_s: float) -> None:
        """Send what is due."""
        self._cancelled = self._obeyable(now_s)
        self._move_mode(now_s)
        self._move_speed(now_s)

    def _move_mode(self, now_s: float) -> None:
        vehicle = self._heard.vehicle
        if self._mode is None or vehicle is None:
            return
        outgoing = self._mode.due(now_s)
        if outgoing is not None:
            self._counts.mode_requests += 1
            self._outbox.command(outgoing, now_s)
            if self._mode_speed_mps is not None:
                # Sent right after the mode, because ArduPilot forgets the speed when the mode begins.
                self._outbox.command(_speed_command(self._mode_speed_mps, vehicle.system_id), now_s)
        self._settle_mode()

    def _settle_mode(self) -> None:
        request = self._mode
        if request is None or not (request.confirmed or request.refused):
            return
        if request.refused:
            self._events.append(ModeRefused(mode=request.mode, reason=request.refused))
        self._mode = None

    def _move_speed(self, now_s: float) -> None:
        asked, vehicle = self._speed, self._heard.vehicle
        if asked is None or vehicle is None:
            return
        if DIALECTS[vehicle.firmware].modes.get(self._told.custom_mode) is not FlightMode.MISSION:
            # The speed belongs to the mission, which is not flown any more.
            self._speed = None
            return
        if now_s < asked.next_s:
            return
        self._outbox.command(_speed_command(asked.speed_mps, vehicle.system_id, asked.tries), now_s)
        asked.tries, asked.next_s = asked.tries + 1, now_s + _SPEED_RETRY_S
        if asked.tries == _SPEED_TRIES:
            self._speed = None


def _speed_command(speed_mps: float, system_id: int, confirmation: int = 0) -> Outgoing:
    params = (_GROUND_SPEED, speed_mps, _THROTTLE_AS_IT_IS)
    return command_long(CMD_DO_CHANGE_SPEED, params, system_id, confirmation)
