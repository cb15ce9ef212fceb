"""Handles requests of other systems to us: for our own parameters, if there are any, and for information
about us.

Only such messages that are addressed to us are taken (`own_parameters`, `component_information`). They are
taken only once the vehicle is known, because our address contains its system id.
"""

from __future__ import annotations

import math

from companion.autopilot.counts import LinkCounts
from companion.autopilot.heard_vehicle import HeardVehicle
from companion.autopilot.outbox import Outbox
from companion.autopilot.served import own_parameters
from companion.autopilot.served.component_information import ComponentInformation
from companion.autopilot.served.own_parameters import OwnParameters
from companion.autopilot.wire import Frame
from companion.events import Event, Severity

_SAME_REFUSAL_S = 5.0
"""A ground station repeats a refused request. The same reason is sent again only after this time."""


class GroundStations:
    """Takes requests of ground stations and answers them when an answer is due."""

    def __init__(
        self,
        settings: OwnParameters | None,
        information: ComponentInformation | None,
        component_id: int,
        *,
        heard: HeardVehicle,
        outbox: Outbox,
        events: list[Event],
        counts: LinkCounts,
    ) -> None:
        """Create with no request.

        Args:
            component_id: our own.
            events: receives changed settings.
        """
        self._settings = settings
        self._information = information
        self._component_id = component_id
        self._heard = heard
        self._outbox = outbox
        self._events = events
        self._counts = counts
        self._refusal_said: tuple[str, float] = "", -math.inf

    def handle(self, frame: Frame) -> bool:
        """Take a frame that is not the vehicle's. Returns False if it is not a request to us."""
        vehicle = self._heard.vehicle
        if vehicle is None or frame.system_id == vehicle.system_id:
            return False
        if frame.message_id in own_parameters.MESSAGE_IDS:
            settings = self._settings
            if settings is None or not settings.handle(frame, vehicle.system_id, self._component_id):
                return False
            self._counts.settings_requests += 1
            return True
        information = self._information
        if information is None or not information.handle(frame, vehicle.system_id, self._component_id):
            return False
        self._counts.information_requests += 1
        return True

    def advance(self, now_s: float) -> None:
        """Send the answers that are due."""
        self._answer_for_settings(now_s)
        self._tell_about_us(now_s)

    def _answer_for_settings(self, now_s: float) -> None:
        answer = None if self._settings is None else self._settings.due(now_s)
        if answer is None:
            return
        self._outbox.queue(answer.value)
        if answer.changed is not None:
            self._events.append(answer.changed)
        if answer.refused is not None:
            self._counts.settings_refused += 1
            text, said_s = self._refusal_said
            if answer.refused != text or now_s - said_s > _SAME_REFUSAL_S:
                self._refusal_said = answer.refused, now_s
                self._outbox.say(Severity.WARNING, f"DMUCA: {answer.refused}")

    def _tell_about_us(self, now_s: float) -> None:
        answer = None if self._information is None else self._information.due(now_s)
        if answer is not None:
            self._counts.information_refused += answer.refused
            for outgoing in answer.messages:
                self._outbox.queue(outgoing)
