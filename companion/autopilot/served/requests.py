"""What other systems ask of us: parameters of our own, where there are any, and what we are.

Only those messages of theirs are taken, addressed to us (`own_parameters`, `component_information`), once the
vehicle is known and so are we.
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
"""A ground station asks again for what was refused; it is told why no more often."""


class GroundStations:
    """Takes what they ask, and answers when time makes it due."""

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
        """Nothing asked yet.

        Args:
            component_id: ours.
            events: takes the settings that were changed.
        """
        self._settings = settings
        self._information = information
        self._component_id = component_id
        self._heard = heard
        self._outbox = outbox
        self._events = events
        self._counts = counts
        self._refusal_said: tuple[str, float] = "", -math.inf

    def take(self, frame: Frame) -> bool:
        """A frame that is not the vehicle's; False: it asks nothing of us."""
        vehicle = self._heard.vehicle
        if vehicle is None or frame.system_id == vehicle.system_id:
            return False
        if frame.message_id in own_parameters.MESSAGE_IDS:
            settings = self._settings
            if settings is None or not settings.take(frame, vehicle.system_id, self._component_id):
                return False
            self._counts.settings_requests += 1
            return True
        information = self._information
        if information is None or not information.take(frame, vehicle.system_id, self._component_id):
            return False
        self._counts.information_requests += 1
        return True

    def advance(self, now_s: float) -> None:
        """Answer what is due."""
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
