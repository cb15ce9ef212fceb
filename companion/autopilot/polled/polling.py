"""Requests to the vehicle while it is heard: for its telemetry, its parameters and its clock."""

from __future__ import annotations

from companion.autopilot.counts import LinkCounts
from companion.autopilot.dialect import CMD_SET_MESSAGE_INTERVAL, DIALECTS
from companion.autopilot.encoders import AUTOPILOT_COMPONENT, command_long, param_request_read
from companion.autopilot.heard_vehicle import HeardVehicle
from companion.autopilot.outbox import Outbox
from companion.autopilot.polled.parameters import ParameterReader
from companion.autopilot.polled.streams import Streams
from companion.autopilot.polled.timesync import TimeSync, nanoseconds, read_timesync, timesync
from companion.autopilot.readers import Fields
from companion.autopilot.wire import Frame
from companion.events import Event, VehicleParameters


class Polling:
    """Polls the vehicle from its first heartbeat on."""

    def __init__(
        self,
        heard: HeardVehicle,
        outbox: Outbox,
        events: list[Event],
        counts: LinkCounts,
        *,
        sensed: bool = False,
    ) -> None:
        """`events` receives readings of the vehicle's clock. `sensed`: as for `Streams`."""
        self.streams = Streams(sensed=sensed)
        self._heard = heard
        self._outbox = outbox
        self._events = events
        self._counts = counts
        self._timesync = TimeSync()
        self._parameters: ParameterReader | None = None
        """Set once the vehicle is known to be one that can be commanded."""
        self._parameters_told: VehicleParameters | None = None

    @property
    def parameters(self) -> VehicleParameters | None:
        """Known parameters of the vehicle; None while the vehicle is unknown or cannot be commanded."""
        return None if self._parameters is None else self._parameters.known

    @property
    def asking(self) -> bool:
        """Whether the vehicle is still being asked for its parameters."""
        return self._parameters is not None and not self._parameters.finished()

    def new_parameters(self) -> VehicleParameters | None:
        """Known parameters, if they have changed since the last call; else None."""
        known = self.parameters
        if known is None or known == self._parameters_told:
            return None
        self._parameters_told = known
        return known

    def on_heartbeat(self, now_s: float, *, anew: bool) -> None:
        """Take a heartbeat of our vehicle. `anew`: the vehicle is new, or was away."""
        vehicle = self._heard.vehicle
        if self._parameters is None and vehicle is not None and vehicle.refusal is None:
            self._parameters = ParameterReader(DIALECTS[vehicle.firmware])
            self._parameters_told = self._parameters.known
            self._parameters.restart(now_s)
        if anew:
            self._restart(now_s)

    def on_reboot(self, now_s: float) -> None:
        """The vehicle has rebooted, and its clock has restarted."""
        self._restart(now_s)
        self._timesync.restart()

    def _restart(self, now_s: float) -> None:
        """The vehicle may have forgotten our requests, and its parameters may have changed."""
        if self._heard.vehicle is not None:
            self.streams.restart(now_s, self._heard.vehicle.firmware)
        if self._parameters is not None:
            self._parameters.restart(now_s)

    def on_param_value(self, frame: Frame, fields: Fields, _now_s: float) -> None:
        """Take PARAM_VALUE of our vehicle.

        Raises:
            PeerDataError: see `ParameterReader.on_value`.
        """
        if self._parameters is not None:
            _value, _count, _index, name, kind = fields
            self._parameters.on_value(frame.payload, name, kind)

    def on_timesync(self, frame: Frame, _fields: Fields, now_s: float) -> None:
        """Take TIMESYNC of our vehicle: the answer to ours, or a question, which is answered."""
        tc1, ts1, target_system, target_component = read_timesync(frame.payload)
        if tc1 != 0:
            event = self._timesync.answered(tc1, ts1, now_s)
            if event is not None:
                self._counts.clock_reads += 1
                self._events.append(event)
        elif self._heard.is_for_us(target_system, target_component):
            self._counts.clock_answers += 1
            self._outbox.queue(timesync(nanoseconds(now_s), ts1, frame.system_id, frame.component_id))

    def advance(self, now_s: float) -> None:
        """Send the requests that are due, if the vehicle is connected."""
        vehicle = self._heard.vehicle
        if vehicle is None or not self._heard.is_connected(now_s):
            return
        for message_id, interval_us in self.streams.due(now_s):
            self._counts.stream_requests += 1
            params = (float(message_id), float(interval_us))
            self._outbox.queue(command_long(CMD_SET_MESSAGE_INTERVAL, params, vehicle.system_id))
        for name in () if self._parameters is None else self._parameters.due(now_s):
            self._counts.parameter_requests += 1
            self._outbox.queue(param_request_read(name, vehicle.system_id))
        self._ask_clock(self._timesync.due(now_s), vehicle.system_id)

    def ask_for_answer(self, now_s: float) -> None:
        """Ask the vehicle for its clock now. The answer shows that the vehicle reads what it is sent."""
        vehicle = self._heard.vehicle
        if vehicle is not None:
            self._ask_clock(self._timesync.ask(now_s), vehicle.system_id)

    @property
    def answered_s(self) -> float | None:
        """When the latest question that the vehicle has answered was asked; None if it has answered none."""
        return self._timesync.answered_s

    def _ask_clock(self, asked_ns: int | None, system_id: int) -> None:
        if asked_ns is not None:
            self._outbox.queue(timesync(0, asked_ns, system_id, AUTOPILOT_COMPONENT))
