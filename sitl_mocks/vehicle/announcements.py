"""Unrequested messages of the mock vehicle on all links: changes of its state, its status, texts."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_mocks.vehicle.firmware.behaviour import Manners, VehicleMode
from sitl_mocks.vehicle.link_set import LinkSet
from sitl_mocks.vehicle.motion.flight import Flight
from sitl_mocks.vehicle.served.mission import MissionBook
from sitl_mocks.vehicle.served.remote_id import RemoteIdRelay
from sitl_mocks.vehicle.telemetry import Telemetry

STATUS_S = 0.5
"""Period at which PX4 publishes its status; it also publishes at each change. CURRENT_MODE follows."""
_EPSILON_S = 1e-9


class Announcer:
    """Sends on all links what has changed since the last call of `tell_changes`."""

    def __init__(
        self,
        manners: Manners,
        links: LinkSet,
        flight: Flight,
        telemetry: Telemetry,
        books: tuple[MissionBook, ...],
        remote_id: RemoteIdRelay | None,
    ) -> None:
        self._manners = manners
        self._links = links
        self._flight = flight
        self._telemetry = telemetry
        self._speakers = (flight, *(() if remote_id is None else (remote_id,)), *books)
        self._shown_mode = flight.mode
        self._shown_armed = flight.armed
        self._status_s = -math.inf

    def tell_changes(self, now_s: float) -> None:
        """Send everything that a step or a message has changed."""
        flight, runner = self._flight, self._flight.runner
        if flight.mode is not self._shown_mode:
            self._tell_mode_left(self._shown_mode, now_s)
            self._shown_mode = flight.mode
            if self._manners.heartbeat_on_mode_change:
                self._links.send(self._telemetry.heartbeat(now_s))
        if flight.armed is not self._shown_armed:
            self._shown_armed = flight.armed
            self.publish_status(now_s)
            if flight.armed:
                self._links.send(self._telemetry.home_position(now_s))
        for speaker in self._speakers:
            if speaker.texts:
                for severity, text in speaker.texts:
                    self.say(severity, text)
                speaker.texts.clear()
        if runner.reached or runner.texts:
            for seq in runner.reached:
                self._links.send(mavlink.MAVLink_mission_item_reached_message(seq))
            for text in runner.texts:
                self.say(int(mavlink.MAV_SEVERITY_INFO), text)
            runner.reached.clear()
            runner.texts.clear()

    def tell_status(self, now_s: float) -> None:
        """Publish the status if its period has passed."""
        if now_s - self._status_s >= STATUS_S - _EPSILON_S:
            self.publish_status(now_s)

    def publish_status(self, now_s: float) -> None:
        """Publish the status now, so that CURRENT_MODE follows on links that requested it."""
        self._status_s = now_s
        for link in self._links.values():
            link.mode_is_news = self._manners.tells_current_mode

    def say(self, severity: int, text: str) -> None:
        """Send a STATUSTEXT, if this firmware sends any."""
        if self._manners.speaks:
            self._links.send(mavlink.MAVLink_statustext_message(severity, text[:50].encode()))

    def _tell_mode_left(self, mode: VehicleMode, now_s: float) -> None:
        """Report the old mode once more, on links whose CURRENT_MODE interval allows it.

        PX4 publishes its status when it takes a command, and again when it has changed the mode. The new mode
        therefore follows one interval later.
        """
        if not self._manners.tells_current_mode:
            return
        for link in self._links.values():
            if link.tells_mode(now_s):
                link.send(self._telemetry.mode_told(mode, mode))
        self.publish_status(now_s)
