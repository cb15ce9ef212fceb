"""The MAVLink link to one vehicle. It turns received bytes into events, and commands into bytes to send.

The link is a pure state machine: time is an argument, and nothing here reads a clock or a socket. The
caller's cycle is

    events = link.receive(data, now_s)      # whenever bytes arrive
    link.begin_step(now_s, behind=False)    # every cycle
    events = link.advance(now_s)            # every cycle: heartbeat, retries, timeouts
    link.send(command, now_s)               # a command that the core has decided
    socket.send(link.drain())               # whole frames; drained bytes count as sent

This module passes each frame to the part that handles it, and each command to the part that sends it. The
parts share only which vehicle is ours (`heard_vehicle`) and the send queue (`outbox`):

    polling             streams, parameters and the clock of the vehicle
    mode_and_speed      the mode that the vehicle is asked for, and the speed of its mission
    downloads           the vehicle's mission and fence
    requests            requests of other systems to us
    remote_id           Remote ID of all senders, and the vehicle's own Remote ID component
    belief, signing     which frames are accepted on a link with a signing key

The link listens to our vehicle. Vehicles forward messages of other systems, so everything else is counted as
foreign and ignored. ADS-B traffic is the vehicle's own stream of what its receiver reported; a receiver's own
frames, which ArduPilot forwards only with ADSB_TYPE = 0, would report the same aircraft twice. Remote ID
comes from other senders by its nature; `remote_id` defines which of them are accepted. Of the requests of
other systems, only those addressed to us are taken (`served.requests`).

With a signing key (`signing`), unsigned, forged and replayed frames are only counted, and everything that
leaves is signed. SETUP_SIGNING is never obeyed, with or without a key.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot import encoders, remote_id
from companion.autopilot.belief import Belief
from companion.autopilot.counts import LinkCounts
from companion.autopilot.dialect import use
from companion.autopilot.heard_vehicle import HeardVehicle, Vehicle, from_autopilot
from companion.autopilot.lists.downloads import Downloads
from companion.autopilot.lists.list_download import FENCE, MISSION
from companion.autopilot.message_order import MessageOrder
from companion.autopilot.modes.mode_and_speed import ModeAndSpeed
from companion.autopilot.modes.yaw import Nose
from companion.autopilot.outbox import Outbox
from companion.autopilot.polled.polling import Polling
from companion.autopilot.readers import READERS, Fields, heartbeat, unpack
from companion.autopilot.remote_id import RemoteIdComponent, RemoteIdListener
from companion.autopilot.sensors import Sensors
from companion.autopilot.served.component_information import ComponentInformation
from companion.autopilot.served.own_parameters import OwnParameters
from companion.autopilot.served.requests import GroundStations
from companion.autopilot.signing import Signing
from companion.autopilot.statustext import TextAssembler
from companion.autopilot.wire import Frame, FrameScanner
from companion.config import SensedConfig, VehicleConfig
from companion.errors import ConfigError, PeerDataError
from companion.events import (
    ArmStatus,
    Command,
    CurrentMode,
    DownloadFence,
    DownloadMission,
    Event,
    Firmware,
    FlightMode,
    GlobalPosition,
    LocalPosition,
    MissionCurrent,
    Say,
    SetMode,
    SetSpeed,
    Threat,
    TrafficReport,
    VehicleParameters,
    VehicleTime,
    VelocitySetpoint,
)
from companion.remote_id.mavlink import COMPONENT_ID
from companion.remote_id.messages import BasicId

HEARTBEAT_PERIOD_S = remote_id.HEARTBEAT_PERIOD_S
_EPSILON_S = 1e-6
_HEARTBEAT_ID = mavlink.MAVLINK_MSG_ID_HEARTBEAT
_STAMPED = (GlobalPosition, LocalPosition, VehicleTime)
"""Events with the vehicle's time since boot."""


class AutopilotLink:
    """MAVLink link to one vehicle (see the module). Create one object per vehicle and give it every byte of
    the link."""

    def __init__(
        self,
        config: VehicleConfig,
        *,
        signing: Signing | None = None,
        remote_id_component: bool = False,
        identity: BasicId | None = None,
        yaw: Literal["face", "hold"] = "face",
        settings: OwnParameters | None = None,
        information: ComponentInformation | None = None,
        sensed: SensedConfig | None = None,
    ) -> None:
        """Create a link that has received nothing yet.

        Args:
            signing: checks received frames and signs sent ones. None: signatures are ignored.
            yaw: yaw policy of every setpoint, as in `flight.yaw`.
            remote_id_component: also act as the vehicle's Remote ID component (236), from the first ArmStatus
                on.
            identity: Basic ID that this component sends to the autopilot.
            settings: our own parameters that ground stations may read and set. None: there are none.
            information: answers ground stations' requests for information about the companion. None: not
                answered.
            sensed: which sensors of obstacles are read. None: none is read.

        Raises:
            ConfigError: `vehicle.component_id` is already the id of the Remote ID component.
        """
        if remote_id_component and config.component_id == COMPONENT_ID:
            raise ConfigError(
                f"vehicle.component_id: {COMPONENT_ID} is the Remote ID component's, which "
                "remote_id.component = true takes: choose another, such as 191"
            )
        use(config.dialect)
        self._scanner = FrameScanner()
        self.counts = LinkCounts(wire=self._scanner.counts)
        self.last_bad: str | None = None
        """The latest invalid value in words, for the status line."""
        self._events: list[Event] = []
        self._signing = signing
        self._heard = heard = HeardVehicle(config, self.counts)
        self._belief = None if signing is None else Belief(signing, heard)
        self._outbox = outbox = Outbox(config, self.counts, signing)
        self._heartbeat_sent_s: float | None = None
        self._sensors = Sensors(sensed, self.counts)
        self._polling = Polling(heard, outbox, self._events, self.counts, sensed=self._sensors.used)
        self._mode_and_speed = ModeAndSpeed(heard, outbox, self._events, self.counts)
        self._downloads = Downloads(heard, outbox, self._events)
        self._ground_stations = GroundStations(
            settings,
            information,
            config.component_id,
            heard=heard,
            outbox=outbox,
            events=self._events,
            counts=self.counts,
        )
        self._nose = Nose(yaw)
        self._order = MessageOrder()
        self._texts = TextAssembler()
        self._component = RemoteIdComponent(identity) if remote_id_component else None
        own = frozenset({encoders.AUTOPILOT_COMPONENT, config.component_id})
        self._remote_id = RemoteIdListener(self.counts, own, self._component)
        self._handlers: dict[int, Callable[[Frame, Fields, float], None]] = {
            _HEARTBEAT_ID: self._on_heartbeat,
            mavlink.MAVLINK_MSG_ID_STATUSTEXT: self._on_statustext,
            mavlink.MAVLINK_MSG_ID_COMMAND_ACK: self._on_command_ack,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._polling.on_timesync,
            mavlink.MAVLINK_MSG_ID_MISSION_COUNT: self._downloads.on_count,
            mavlink.MAVLINK_MSG_ID_MISSION_ITEM: self._downloads.on_item,
            mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT: self._downloads.on_item,
            mavlink.MAVLINK_MSG_ID_MISSION_ACK: self._downloads.on_ack,
            mavlink.MAVLINK_MSG_ID_PARAM_VALUE: self._polling.on_param_value,
        }

    @property
    def vehicle(self) -> Vehicle | None:
        """The vehicle; None until its first heartbeat."""
        return self._heard.vehicle

    @property
    def unclear(self) -> str | None:
        """Why it is not known which vehicle is ours, in words; None when it is."""
        return self._heard.unclear

    @property
    def parameters(self) -> VehicleParameters | None:
        """Known parameters of the vehicle; None while the vehicle is unknown or cannot be commanded."""
        return self._polling.parameters

    @property
    def asking(self) -> bool:
        """Whether the vehicle is still being asked for its parameters."""
        return self._polling.asking

    def disbelief(self, now_s: float) -> str | None:
        """What signing rejects, in words for the status line; None when nothing is rejected."""
        return None if self._belief is None else self._belief.disbelief(now_s)

    # ------------------------------------------------------------ input

    def receive(self, data: bytes, now_s: float) -> list[Event]:
        """Take bytes of the link and return their events. Damaged or invalid input is only counted."""
        self._remote_id.begin()
        if self._signing is not None:
            self._signing.advance(now_s)
        for frame in self._scanner.frames(data):
            if self._belief is not None and not self._belief.believes(frame, now_s):
                continue
            try:
                if frame.message_id in remote_id.MESSAGE_IDS:
                    self._take_remote_id(frame, now_s)
                elif self._sensors.used and self._sensors.takes(frame, self._vehicle_system, self._firmware):
                    self._take_sensed(frame, now_s)
                elif self._heard.is_ours(frame):
                    self._take(frame, now_s)
                elif not self._ground_stations.handle(frame):
                    self._leave(frame, now_s)
            except PeerDataError as error:
                self.counts.bad_values += 1
                self.last_bad = str(error)
        return self._take_events()

    @property
    def _vehicle_system(self) -> int | None:
        return None if self.vehicle is None else self.vehicle.system_id

    @property
    def _firmware(self) -> Firmware | None:
        return None if self.vehicle is None else self.vehicle.firmware

    def _leave(self, frame: Frame, now_s: float) -> None:
        self.counts.foreign += 1
        if frame.message_id == _HEARTBEAT_ID:
            self._remote_id.note_heartbeat(frame, self._vehicle_system)
            two = self._heard.second_autopilot(frame) or self._heard.second_companion(frame, now_s)
            self._events += [] if two is None else [two]

    def _take_remote_id(self, frame: Frame, now_s: float) -> None:
        event = self._remote_id.event(frame, self._vehicle_system, now_s)
        if event is not None:
            self._events.append(event)
        elif self._heard.is_ours(frame):
            self.counts.unneeded += 1
        else:
            self.counts.foreign += 1

    def _take_sensed(self, frame: Frame, now_s: float) -> None:
        if frame.component_id == encoders.AUTOPILOT_COMPONENT:
            self._polling.streams.received(frame.message_id)
        event = self._sensors.event(frame, now_s)
        if event is not None:
            self._events.append(event)

    def _take(self, frame: Frame, now_s: float) -> None:
        message_id = frame.message_id
        reader = READERS.get(message_id)
        if reader is None:
            handler = self._handlers.get(message_id)
            if handler is None:
                self.counts.unneeded += 1
                return
            self.counts.taken += 1
            handler(frame, unpack(message_id, frame.payload), now_s)
            return
        self.counts.taken += 1
        # Counted before its values are checked: a stream of bad values still arrives, and asking again would
        # not help.
        self._polling.streams.received(message_id)
        fields = unpack(message_id, frame.payload)
        event = reader(fields)
        if event is None:
            self.counts.no_position += 1
            return
        if type(event) is GlobalPosition:
            self._nose.heard(fields[8])
        if type(event) is MissionCurrent:
            self._downloads.on_current(event, now_s)
        if isinstance(event, _STAMPED):
            self._order.stamped(frame.sequence, event.time_boot_s)
            self._on_boot_time(event.time_boot_s, now_s)
        if type(event) is CurrentMode and self._order.is_overtaken(frame.sequence):
            event = msgspec.structs.replace(event, overtaken=True)
        self._events.append(event)
        if type(event) is CurrentMode:
            self._mode_and_speed.on_current_mode(event, now_s)

    def _on_boot_time(self, time_boot_s: float, now_s: float) -> None:
        """After a reboot, signalled by the vehicle's clock going back, its stream rates must be requested
        again."""
        if self._heard.on_boot_time(time_boot_s, now_s):
            self._polling.on_reboot(now_s)
            two = self._heard.second_clock(now_s)
            if two is not None:
                self._events.append(two)

    def _on_heartbeat(self, frame: Frame, fields: Fields, now_s: float) -> None:
        if not from_autopilot(fields):
            self.counts.foreign += 1
            return
        event = heartbeat(frame.system_id, fields)
        if self._heard.is_of_another(event, now_s):
            self.counts.foreign += 1
            two = self._heard.second_with_our_id()
            self._events += [] if two is None else [two]
            return
        if self._order.is_overtaken(frame.sequence):
            event = msgspec.structs.replace(event, overtaken=True)
        anew = self._heard.on_heartbeat(event, now_s)
        self._outbox.speak_as(event.system_id)
        self._polling.on_heartbeat(now_s, anew=anew)
        self._events.append(event)
        self._mode_and_speed.on_heartbeat(event, now_s)

    def _on_statustext(self, _frame: Frame, fields: Fields, now_s: float) -> None:
        for text in self._texts.feed(fields, now_s):
            self._events.append(text)
            self._mode_and_speed.on_text(text.text)

    def _on_command_ack(self, _frame: Frame, fields: Fields, _now_s: float) -> None:
        command, result, _progress, _param2, target_system, target_component = fields
        if not self._heard.is_for_us(target_system, target_component):
            return
        self._mode_and_speed.on_ack(command, result)

    # ------------------------------------------------------------ time

    def begin_step(self, now_s: float, *, behind: bool) -> None:
        """Begin a step, before a new decision is made: commands and setpoints that are too old by now are
        dropped.

        Args:
            behind: the input since the last step was a backlog, or is not complete. No mode is asked for
                until the vehicle shows its mode again, which it is asked to do.
        """
        self._outbox.drop_old(now_s)
        if behind:
            self._mode_and_speed.forget(now_s)

    def advance(self, now_s: float) -> list[Event]:
        """Do what is due at this time (our heartbeat, stream requests, retries) and return the resulting
        events."""
        if self._signing is not None:
            self._signing.advance(now_s)
        last_s = self._heartbeat_sent_s
        if last_s is None or now_s - last_s >= HEARTBEAT_PERIOD_S - _EPSILON_S:
            self._heartbeat_sent_s = now_s
            self._heard.heartbeat_sent(self._outbox.next_sequence)
            self._outbox.queue(encoders.heartbeat())
        gone = self._heard.second_companion_gone(now_s)
        self._events += [] if gone is None else [gone]
        self._polling.advance(now_s)
        if self._component is not None and self.vehicle is not None:
            for frame in self._component.due(self.vehicle.system_id, now_s):
                self._outbox.queue_frame(frame)
        self._ground_stations.advance(now_s)
        self._mode_and_speed.advance(now_s)
        self._downloads.advance(now_s)
        self._events += self._texts.overdue(now_s)
        seen = self._sensors.advance(now_s)
        if seen is not None:
            self._events.append(seen)
        return self._take_events()

    def _take_events(self) -> list[Event]:
        """All pending events. The list object itself is kept, because the parts append to it."""
        parameters = self._polling.new_parameters()
        if parameters is not None:
            self._events.append(parameters)
        events = self._events.copy()
        self._events.clear()
        return events

    # ------------------------------------------------------------ output

    def send(self, command: Command, now_s: float) -> None:
        """Queue one command. If it cannot be carried out, an event of the next `receive` or `advance` reports
        that.

        Passing a command that is not for the autopilot (radio, log) is a bug of the caller. An ArmStatus is
        sent with the next `advance` once the vehicle is known, and is repeated from then on.

        Raises:
            ValueError: a bug of ours: a setpoint that is not finite or absurdly fast, a mode that cannot be
                commanded, a Threat that `encoders.collision` refuses, an ArmStatus although we are not the
                Remote ID component, or a command that is not for the autopilot.
        """
        match command:
            case VelocitySetpoint():
                self._send_setpoint(command, now_s)
            case SetMode():
                self._mode_and_speed.ask_mode(command, now_s)
            case SetSpeed():
                self._mode_and_speed.ask_speed(command.speed_mps)
            case DownloadMission():
                self._downloads.fetch(MISSION, now_s)
            case DownloadFence():
                self._downloads.fetch(FENCE, now_s)
            case Threat():
                self._outbox.queue(encoders.collision(command))
            case TrafficReport():
                self._outbox.queue(encoders.adsb_vehicle(command))
            case ArmStatus() if self._component is not None:
                self._component.report(command)
            case Say():
                self._outbox.say(command.severity, command.text)
            case _:
                raise ValueError(f"{type(command).__name__} is not a command for the autopilot")

    @property
    def asked_mode(self) -> FlightMode | None:
        """Mode that the vehicle is asked for, or may still enter by a request given up; None if none."""
        return self._mode_and_speed.asked_mode

    def cancel_mode(self) -> None:
        """Stop asking for a mode or a speed, because the caller has given up the vehicle."""
        self._mode_and_speed.cancel()

    def drain(self, *, commanding: bool = True) -> bytes:
        """Return the bytes to send now: whole frames, the newest setpoint last.

        Args:
            commanding: False: the setpoint, mode and speed stay in the queue.
        """
        return self._outbox.drain(commanding=commanding)

    def ask_for_answer(self, now_s: float) -> None:
        """Ask the vehicle for its clock. The answer (`answered_s`) shows that the vehicle reads what it is
        sent."""
        self._polling.ask_for_answer(now_s)

    @property
    def holds(self) -> bool:
        """Whether a setpoint, a mode or a speed waits to be sent."""
        return self._outbox.holds

    @property
    def answered_s(self) -> float | None:
        """When the latest question that the vehicle has answered was asked; None if it has answered none."""
        return self._polling.answered_s

    def _send_setpoint(self, command: VelocitySetpoint, now_s: float) -> None:
        encoders.check_velocity(command.velocity_ned_mps)
        vehicle = self.vehicle
        if vehicle is None or vehicle.refusal is not None:
            self.counts.setpoints_dropped += 1
            return
        yaw_rad = self._nose.yaw_rad(command.velocity_ned_mps, now_s)
        self._outbox.replace_setpoint(
            encoders.velocity_setpoint(
                command.velocity_ned_mps, yaw_rad, self._heard.boot_ms(now_s), vehicle.system_id
            )
        )
