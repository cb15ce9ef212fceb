"""The MAVLink link to one vehicle: bytes in, events out; commands in, bytes out.

A pure state machine: time is an argument, nothing here reads a clock or a socket. The caller's cycle is

    events = link.receive(data, now_s)      # as often as bytes come
    events = link.advance(now_s)            # every cycle: heartbeat, retries, timeouts
    link.send(command, now_s)               # what the heart decided
    socket.send(link.drain())               # whole frames; what leaves is what was drained

Who is listened to: component 1 of one system, the configured one or the first that sends an autopilot's
HEARTBEAT. That one may be a neighbour's, which some router or radio forwards: where none was configured, a
second autopilot makes it `unclear` which is ours, for as long as this link lives. Vehicles forward what
others send, so everything else is counted as foreign and left out; ADS-B traffic is the vehicle's own stream
too, of what its receiver told it (a receiver's own frames, which ArduPilot forwards only with ADSB_TYPE = 0,
would be the same aircraft twice). Remote ID comes from others by its nature: `remote_id` says whose.
Parameters of our own, where there are any, are asked for and set by other systems; only those three messages
of theirs, and addressed to us, are taken (`own_parameters`), and requests to tell what we are
(`component_information`).

Who we are: before the vehicle is known (a `udpout` link must speak first) our heartbeat carries the
configured system id, or 1, as other companion software does; never 255, which ArduPilot takes for its ground
station and watches for failsafes. From then on the vehicle's own. Where it is asked for, also the vehicle's
Remote ID component, with a heartbeat, a status and sequence numbers of its own.

With a key (`signing`) nothing unsigned, forged or replayed gets further than its count, and all that leaves
is signed. SETUP_SIGNING is obeyed from nobody, key or not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.config import VehicleConfig
from companion.errors import ConfigError, PeerDataError
from companion.events import (
    ArmStatus,
    Command,
    CurrentMode,
    DownloadFence,
    DownloadMission,
    Event,
    FenceDownloaded,
    FenceRefused,
    Firmware,
    FlightMode,
    GlobalPosition,
    LocalPosition,
    MissionDownloaded,
    MissionRefused,
    ModeRefused,
    Say,
    SetMode,
    SetSpeed,
    Severity,
    Threat,
    TwoAutopilots,
    VehicleParameters,
    VehicleTime,
    VelocitySetpoint,
)
from companion.remote_id.mavlink import COMPONENT_ID
from companion.remote_id.messages import BasicId

from . import encoders, own_parameters, remote_id
from .component_information import ComponentInformation
from .dialect import (
    AUTOPILOT_INVALID,
    CMD_DO_CHANGE_SPEED,
    CMD_DO_SET_MODE,
    CMD_SET_MESSAGE_INTERVAL,
    DIALECTS,
    refusal,
)
from .fence import areas_from_items
from .mission_download import FENCE, MISSION, MissionDownload
from .mode_request import ModeRequest, ModeTold
from .own_parameters import OwnParameters
from .parameters import ParameterReader
from .readers import READERS, Fields, heartbeat, unpack
from .remote_id import RemoteIdComponent, RemoteIdCounts, RemoteIdListener
from .signing import Refusal, Signing
from .statustext import TextAssembler
from .streams import Streams
from .timesync import TimeSync, nanoseconds, read_timesync, timesync
from .wire import MAGIC_V1, Frame, FrameScanner, MavlinkWriter, WireCounts
from .yaw import Nose

HEARTBEAT_PERIOD_S = remote_id.HEARTBEAT_PERIOD_S
LOST_AFTER_S = 3.0
"""Heartbeats further apart than this: the link dropped, or the vehicle restarted."""
REBOOT_STEP_S = 1.0
"""The vehicle's clock going back by more than this is a reboot; less is messages that overtook each other."""
MAX_QUEUED_BYTES = 65536
"""What waits to be drained; a caller that never drains loses it rather than the memory."""
_DEFAULT_SYSTEM_ID = 1
_EPSILON_S = 1e-6
_GOOD_RESULTS = (0, 5)
_GROUND_STATION = 6
_GROUND_SPEED, _THROTTLE_AS_IT_IS = 1.0, -1.0
_SPEED_RETRY_S, _SPEED_TRIES = 1.0, 5
_SAME_REFUSAL_S = 5.0
"""A ground station asks again for what was refused; it is told why no more often."""
_HEARTBEAT_ID = mavlink.MAVLINK_MSG_ID_HEARTBEAT
_ALL_REFUSED = {
    Refusal.UNSIGNED: "unsigned: signing is not set up on the autopilot",
    Refusal.WRONG: "wrongly signed: the autopilot has another key",
    Refusal.REPLAYED: "a replay: somebody sends old frames again, or the autopilot's timestamp went back",
    Refusal.STALE: "dated more than a minute before ours: the autopilot does not hear us, or it is a replay",
    Refusal.CROWDED: "of one sender too many on this link",
}
"""What to say where nothing of the vehicle is believed."""


@dataclass(frozen=True, slots=True)
class Vehicle:
    """The vehicle at the other end."""

    system_id: int
    firmware: Firmware
    vehicle_type: int
    """MAV_TYPE."""
    refusal: str | None
    """Why it cannot be commanded, in words; None when it can. Telemetry is read either way."""

    def __str__(self) -> str:
        """For a status line."""
        words = f"{self.firmware.value}, system {self.system_id}, MAV_TYPE {self.vehicle_type}"
        return words if self.refusal is None else f"{words}: {self.refusal}"


@dataclass(slots=True, kw_only=True)
class LinkCounts(RemoteIdCounts):
    """What the link has met and done so far."""

    wire: WireCounts
    """Framing: messages, unknown, corrupt, skipped bytes."""
    taken: int = 0
    """Messages of our vehicle that were decoded."""
    unneeded: int = 0
    """Messages of our vehicle that nothing here needs: checked, not decoded."""
    foreign: int = 0
    """Messages of other systems and components, or answers meant for them."""
    bad_values: int = 0
    """Messages with values that no honest vehicle sends."""
    no_position: int = 0
    """GLOBAL_POSITION_INT before the vehicle knew where it is, ADSB_VEHICLE without a position."""
    acks_accepted: int = 0
    acks_refused: int = 0
    reboots: int = 0
    drops: int = 0
    """Gaps between heartbeats of more than `LOST_AFTER_S`."""
    stream_requests: int = 0
    parameter_requests: int = 0
    settings_requests: int = 0
    """Requests of ground stations for parameters of our own."""
    settings_refused: int = 0
    """PARAM_SET with a value that is not allowed."""
    information_requests: int = 0
    """Requests of ground stations for messages and files about us."""
    information_refused: int = 0
    """Of them, damaged ones, and those for what there is not."""
    mode_requests: int = 0
    setpoints: int = 0
    setpoints_dropped: int = 0
    """Setpoints not sent: no vehicle, one that cannot be commanded, or replaced before they were drained."""
    overflows: int = 0
    """Times the undrained queue was thrown away."""
    clock_reads: int = 0
    """Answers to our TIMESYNC that tell something."""
    clock_answers: int = 0
    """Answers of ours to the vehicle's TIMESYNC."""


@dataclass(slots=True)
class _SpeedRequest:
    """DO_CHANGE_SPEED, until it is answered or was sent often enough."""

    speed_mps: float
    tries: int = 0
    next_s: float = 0.0


class AutopilotLink:
    """See the module. One object per vehicle; give it every byte of the link."""

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
    ) -> None:
        """A link that has heard nothing yet.

        Args:
            signing: checks what is heard and signs what is sent. None: signatures are not looked at.
            yaw: as `flight.yaw`, for every setpoint.
            remote_id_component: also be the vehicle's Remote ID component (236), from the first ArmStatus on.
            identity: what that component tells the autopilot of whom it broadcasts.
            settings: parameters of our own that ground stations may read and set. None: there are none.
            information: tells ground stations what we are. None: nobody does.

        Raises:
            ConfigError: we would be that component twice.
        """
        if remote_id_component and config.component_id == COMPONENT_ID:
            raise ConfigError(
                f"vehicle.component_id: {COMPONENT_ID} is the Remote ID component's, which "
                "remote_id.component = true takes: choose another, such as 191"
            )
        self._config = config
        self._scanner = FrameScanner()
        self._signing = signing
        self._believed_s: float | None = None
        self._refused: tuple[Refusal, float] | None = None
        """Why the vehicle's last refused frame was, and when."""
        self.counts = LinkCounts(wire=self._scanner.counts)
        self.last_bad: str | None = None
        """The latest bad value in words, for the status line."""
        self._writer = MavlinkWriter(config.system_id or _DEFAULT_SYSTEM_ID, config.component_id)
        self._vehicle: Vehicle | None = None
        self.unclear: str | None = None
        """Why it is not known which vehicle is ours, in words; None when it is."""
        self._told = ModeTold()
        self._boot_s: float | None = None
        self._boot_heard_s = 0.0
        self._heartbeat_heard_s: float | None = None
        self._heartbeat_sent_s: float | None = None
        self._streams = Streams()
        self._parameters: ParameterReader | None = None
        """Of a vehicle that can be commanded."""
        self._parameters_told: VehicleParameters | None = None
        self._own_parameters = settings
        self._information = information
        self._refusal_said: tuple[str, float] = "", -math.inf
        self._nose = Nose(yaw)
        self._timesync = TimeSync()
        self._texts = TextAssembler()
        self._text_id = 0
        self._mode: ModeRequest | None = None
        self._cancelled: ModeRequest | None = None
        """The last one that was given up."""
        self._mode_speed_mps: float | None = None
        self._speed: _SpeedRequest | None = None
        self._download: MissionDownload | None = None
        self._download_next: int | None = None
        """Type of the list to be fetched after the one under way: PX4 serves one at a time."""
        self._component = RemoteIdComponent(identity) if remote_id_component else None
        own = frozenset({encoders.AUTOPILOT_COMPONENT, config.component_id})
        self._remote_id = RemoteIdListener(self.counts, own, self._component)
        self._events: list[Event] = []
        self._out = bytearray()
        self._setpoint: encoders.Outgoing | None = None
        self._handlers: dict[int, Callable[[Frame, Fields, float], None]] = {
            _HEARTBEAT_ID: self._on_heartbeat,
            mavlink.MAVLINK_MSG_ID_STATUSTEXT: self._on_statustext,
            mavlink.MAVLINK_MSG_ID_COMMAND_ACK: self._on_command_ack,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
            mavlink.MAVLINK_MSG_ID_MISSION_COUNT: self._on_mission_count,
            mavlink.MAVLINK_MSG_ID_MISSION_ITEM: self._on_mission_item,
            mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT: self._on_mission_item,
            mavlink.MAVLINK_MSG_ID_MISSION_ACK: self._on_mission_ack,
            mavlink.MAVLINK_MSG_ID_PARAM_VALUE: self._on_param_value,
        }

    @property
    def vehicle(self) -> Vehicle | None:
        """The vehicle, once its first heartbeat has come."""
        return self._vehicle

    @property
    def parameters(self) -> VehicleParameters | None:
        """What the vehicle has told of its parameters; None while it is not known, or cannot be commanded."""
        return None if self._parameters is None else self._parameters.known

    @property
    def asking(self) -> bool:
        """Whether the vehicle is still being asked for its parameters."""
        return self._parameters is not None and not self._parameters.finished()

    # ------------------------------------------------------------ in

    def receive(self, data: bytes, now_s: float) -> list[Event]:
        """Take bytes of the link; return what they told. Damaged or senseless input is only counted."""
        self._remote_id.begin()
        if self._signing is not None:
            self._signing.advance(now_s)
        for frame in self._scanner.frames(data):
            if self._signing is not None and not self._believes(frame, self._signing, now_s):
                continue
            try:
                if frame.message_id in remote_id.MESSAGE_IDS:
                    self._take_remote_id(frame, now_s)
                elif self._ours(frame):
                    self._take(frame, now_s)
                elif self._of_our_parameters(frame):
                    self.counts.settings_requests += 1
                elif self._about_us(frame):
                    self.counts.information_requests += 1
                else:
                    self._leave(frame)
            except PeerDataError as error:
                self.counts.bad_values += 1
                self.last_bad = str(error)
        return self._take_events()

    def _believes(self, frame: Frame, signing: Signing, now_s: float) -> bool:
        refused = signing.refusal(frame)
        wanted = self._config.system_id if self._vehicle is None else self._vehicle.system_id
        if frame.component_id == encoders.AUTOPILOT_COMPONENT and wanted in (0, frame.system_id):
            if refused is None:
                self._believed_s = now_s
            else:
                self._refused = refused, now_s
        return refused is None

    def disbelief(self, now_s: float) -> str | None:
        """What signing keeps out, in words for the status line; None when that is nothing."""
        if self._signing is None:
            return None
        heard_s = self._believed_s
        if self._refused is not None and (heard_s is None or now_s - heard_s > LOST_AFTER_S):
            reason, refused_s = self._refused
            if now_s - refused_s <= LOST_AFTER_S:
                return f"every frame of the vehicle is {_ALL_REFUSED[reason]}"
        return self._signing.counts.refused()

    def _of_our_parameters(self, frame: Frame) -> bool:
        """Whether another system wants something of our parameters; it is answered by `advance`."""
        ours, vehicle = self._own_parameters, self._vehicle
        if ours is None or vehicle is None or frame.system_id == vehicle.system_id:
            return False
        if frame.message_id not in own_parameters.MESSAGE_IDS:
            return False
        return ours.take(frame, vehicle.system_id, self._config.component_id)

    def _about_us(self, frame: Frame) -> bool:
        """Whether another system wants to know what we are; it is answered by `advance`."""
        information, vehicle = self._information, self._vehicle
        if information is None or vehicle is None or frame.system_id == vehicle.system_id:
            return False
        return information.take(frame, vehicle.system_id, self._config.component_id)

    def _leave(self, frame: Frame) -> None:
        self.counts.foreign += 1
        if frame.message_id == _HEARTBEAT_ID:
            self._remote_id.note_heartbeat(frame)
            self._note_autopilot(frame)

    def _note_autopilot(self, frame: Frame) -> None:
        """The vehicle was not configured: is this another one?"""
        vehicle = self._vehicle
        if self._config.system_id != 0 or self.unclear is not None or vehicle is None:
            return
        if frame.component_id != encoders.AUTOPILOT_COMPONENT:
            return
        if _from_autopilot(unpack(frame.message_id, frame.payload)):
            first, second = sorted((vehicle.system_id, frame.system_id))
            self.unclear = (
                f"two autopilots on this link (systems {first} and {second}): set vehicle.system_id"
            )
            self._events.append(TwoAutopilots(reason=self.unclear))

    def _take_remote_id(self, frame: Frame, now_s: float) -> None:
        system_id = None if self._vehicle is None else self._vehicle.system_id
        event = self._remote_id.event(frame, system_id, now_s)
        if event is not None:
            self._events.append(event)
        elif self._ours(frame):
            self.counts.unneeded += 1
        else:
            self.counts.foreign += 1

    def _ours(self, frame: Frame) -> bool:
        if frame.component_id != encoders.AUTOPILOT_COMPONENT:
            return False
        if self._vehicle is not None:
            return frame.system_id == self._vehicle.system_id
        wanted = self._config.system_id
        return frame.message_id == _HEARTBEAT_ID and (wanted == 0 or frame.system_id == wanted)

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
        # Counted before it is judged: a stream of bad values still arrives, asking again would not mend it.
        self._streams.received(message_id)
        fields = unpack(message_id, frame.payload)
        event = reader(fields)
        if event is None:
            self.counts.no_position += 1
            return
        if isinstance(event, GlobalPosition):
            self._nose.heard(fields[8])
        if isinstance(event, GlobalPosition | LocalPosition | VehicleTime):
            self._on_boot_time(event.time_boot_s, now_s)
        self._events.append(event)
        if isinstance(event, CurrentMode):
            self._told.current_mode(event.custom_mode, now_s)
            self._on_mode(now_s)

    def _on_boot_time(self, time_boot_s: float, now_s: float) -> None:
        """Follow the vehicle's clock; when it begins anew, so have its stream rates."""
        if self._boot_s is not None and time_boot_s < self._boot_s - REBOOT_STEP_S:
            self.counts.reboots += 1
            self._ask_anew(now_s)
            self._timesync.restart()
        self._boot_s = time_boot_s
        self._boot_heard_s = now_s

    def _ask_anew(self, now_s: float) -> None:
        """The vehicle is new, has begun anew or was away: it may have forgotten what was asked of it, and its
        parameters may be others."""
        if self._vehicle is not None:
            self._streams.restart(now_s, self._vehicle.firmware)
        if self._parameters is not None:
            self._parameters.restart(now_s)

    def _on_heartbeat(self, frame: Frame, fields: Fields, now_s: float) -> None:
        system_id = frame.system_id
        if not _from_autopilot(fields):
            self.counts.foreign += 1
            return
        event = heartbeat(system_id, fields)
        last_s = self._heartbeat_heard_s
        self._heartbeat_heard_s = now_s
        new = self._vehicle is None
        dropped = last_s is not None and now_s - last_s > LOST_AFTER_S
        if new:
            self._writer.encoder.srcSystem = system_id
        self.counts.drops += dropped
        if self._vehicle is None or self._vehicle.vehicle_type != event.vehicle_type:
            self._vehicle = Vehicle(
                system_id=system_id,
                firmware=event.firmware,
                vehicle_type=event.vehicle_type,
                refusal=refusal(event.firmware, event.vehicle_type),
            )
            if self._parameters is None and self._vehicle.refusal is None:
                self._parameters = ParameterReader(DIALECTS[event.firmware])
                self._parameters_told = self._parameters.known
                self._parameters.restart(now_s)
        if new or dropped:
            self._ask_anew(now_s)
        self._events.append(event)
        self._told.heartbeat(event.custom_mode, now_s, DIALECTS[event.firmware].mode_known_s)
        self._on_mode(now_s)

    def _on_mode(self, now_s: float) -> None:
        if self._mode is not None:
            self._mode.on_mode(now_s)
            self._settle_mode()

    def _on_statustext(self, _frame: Frame, fields: Fields, now_s: float) -> None:
        for text in self._texts.feed(fields, now_s):
            self._events.append(text)
            if self._mode is not None:
                self._mode.on_text(text.text)

    def _on_command_ack(self, _frame: Frame, fields: Fields, _now_s: float) -> None:
        command, result, _progress, _param2, target_system, target_component = fields
        if not self._for_us(target_system, target_component):
            return
        if result in _GOOD_RESULTS:
            self.counts.acks_accepted += 1
        else:
            self.counts.acks_refused += 1
        if command == CMD_DO_SET_MODE and self._mode is not None:
            self._mode.on_ack(result)
        elif command == CMD_DO_CHANGE_SPEED:
            self._speed = None

    def _on_param_value(self, frame: Frame, fields: Fields, _now_s: float) -> None:
        if self._parameters is not None:
            _value, _count, _index, name, kind = fields
            self._parameters.take(frame.payload, name, kind)

    def _on_timesync(self, frame: Frame, _fields: Fields, now_s: float) -> None:
        tc1, ts1, target_system, target_component = read_timesync(frame.payload)
        if tc1 != 0:
            event = self._timesync.answered(tc1, ts1, now_s)
            if event is not None:
                self.counts.clock_reads += 1
                self._events.append(event)
        elif self._for_us(target_system, target_component):
            self.counts.clock_answers += 1
            self._queue(timesync(nanoseconds(now_s), ts1, frame.system_id, frame.component_id))

    def _on_mission_count(self, frame: Frame, fields: Fields, now_s: float) -> None:
        download = self._answered(frame, fields[1], fields[2])
        if download is not None:
            download.on_count(fields, now_s)
            self._move_download(now_s)

    def _on_mission_item(self, frame: Frame, fields: Fields, now_s: float) -> None:
        download = self._answered(frame, fields[9], fields[10])
        if download is not None:
            try:
                download.on_item(frame.message_id, fields, now_s)
            finally:
                self._move_download(now_s)

    def _on_mission_ack(self, frame: Frame, fields: Fields, now_s: float) -> None:
        download = self._answered(frame, fields[0], fields[1])
        if download is not None:
            download.on_ack(fields)
            self._move_download(now_s)

    def _answered(self, frame: Frame, target_system: int, target_component: int) -> MissionDownload | None:
        """The download under way, where an answer of the mission protocol is for us."""
        if self._download is None or not self._for_us(target_system, target_component):
            return None
        if frame.raw[0] == MAGIC_V1:
            self._download.on_mavlink1()
        return self._download

    def _for_us(self, target_system: int, target_component: int) -> bool:
        """Whether an answer is meant for us; 0 is everybody, and what MAVLink 1 has no field for."""
        encoder = self._writer.encoder
        ours = target_system in (0, encoder.srcSystem) and target_component in (0, encoder.srcComponent)
        if not ours:
            self.counts.foreign += 1
        return ours

    # ------------------------------------------------------------ time

    def advance(self, now_s: float) -> list[Event]:
        """Do what time makes due: our heartbeat, requests for streams, retries; return what came of it."""
        if self._signing is not None:
            self._signing.advance(now_s)
        last_s = self._heartbeat_sent_s
        if last_s is None or now_s - last_s >= HEARTBEAT_PERIOD_S - _EPSILON_S:
            self._heartbeat_sent_s = now_s
            self._queue(encoders.heartbeat())
        vehicle = self._vehicle
        if vehicle is not None and self._connected(now_s):
            for message_id, interval_us in self._streams.due(now_s):
                self.counts.stream_requests += 1
                params = (float(message_id), float(interval_us))
                self._queue(encoders.command_long(CMD_SET_MESSAGE_INTERVAL, params, vehicle.system_id))
            for name in () if self._parameters is None else self._parameters.due(now_s):
                self.counts.parameter_requests += 1
                self._queue(encoders.param_request_read(name, vehicle.system_id))
            asked_ns = self._timesync.due(now_s)
            if asked_ns is not None:
                self._queue(timesync(0, asked_ns, vehicle.system_id, encoders.AUTOPILOT_COMPONENT))
        if self._component is not None and vehicle is not None:
            for frame in self._component.due(vehicle.system_id, now_s):
                self._queue_frame(frame)
        self._answer_for_parameters(now_s)
        self._tell_about_us(now_s)
        self._move_mode(now_s)
        self._move_speed(now_s)
        self._move_download(now_s)
        self._events += self._texts.overdue(now_s)
        return self._take_events()

    def _answer_for_parameters(self, now_s: float) -> None:
        answer = None if self._own_parameters is None else self._own_parameters.due(now_s)
        if answer is None:
            return
        self._queue(answer.value)
        if answer.changed is not None:
            self._events.append(answer.changed)
        if answer.refused is not None:
            self.counts.settings_refused += 1
            text, said_s = self._refusal_said
            if answer.refused != text or now_s - said_s > _SAME_REFUSAL_S:
                self._refusal_said = answer.refused, now_s
                self.send(Say(severity=Severity.WARNING, text=f"DMUCA: {answer.refused}"), now_s)

    def _tell_about_us(self, now_s: float) -> None:
        answer = None if self._information is None else self._information.due(now_s)
        if answer is not None:
            self.counts.information_refused += answer.refused
            for outgoing in answer.messages:
                self._queue(outgoing)

    def _move_speed(self, now_s: float) -> None:
        asked, vehicle = self._speed, self._vehicle
        if asked is None or vehicle is None:
            return
        if DIALECTS[vehicle.firmware].modes.get(self._told.custom_mode) is not FlightMode.MISSION:
            # It is the mission's speed: whoever flies now has another.
            self._speed = None
            return
        if now_s < asked.next_s:
            return
        self._queue(self._speed_command(asked.speed_mps, asked.tries))
        asked.tries, asked.next_s = asked.tries + 1, now_s + _SPEED_RETRY_S
        if asked.tries == _SPEED_TRIES:
            self._speed = None

    def _speed_command(self, speed_mps: float, confirmation: int = 0) -> encoders.Outgoing:
        assert self._vehicle is not None
        params = (_GROUND_SPEED, speed_mps, _THROTTLE_AS_IT_IS)
        return encoders.command_long(CMD_DO_CHANGE_SPEED, params, self._vehicle.system_id, confirmation)

    def _connected(self, now_s: float) -> bool:
        return self._heartbeat_heard_s is not None and now_s - self._heartbeat_heard_s <= LOST_AFTER_S

    # ------------------------------------------------------------ out

    def send(self, command: Command, now_s: float) -> None:
        """Queue one command; what cannot be done is told by an event of the next `receive` or `advance`.

        Commands that are not for the autopilot (radio, log) are a bug of the caller. An ArmStatus leaves with
        the next `advance`, once the vehicle is known, and is repeated from then on.

        Raises:
            ValueError: a setpoint that is not finite or absurdly fast, a mode that cannot be commanded, a
                Threat that `encoders.collision` refuses, an ArmStatus of who is not the Remote ID component,
                a command that is not the autopilot's: all bugs of ours.
        """
        match command:
            case VelocitySetpoint():
                self._send_setpoint(command, now_s)
            case SetMode():
                self._send_mode(command, now_s)
            case SetSpeed():
                self._speed = _SpeedRequest(command.speed_mps)
            case DownloadMission():
                self._send_download(MISSION, now_s)
            case DownloadFence():
                self._send_download(FENCE, now_s)
            case Threat():
                self._queue(encoders.collision(command))
            case ArmStatus() if self._component is not None:
                self._component.report(command)
            case Say():
                self._text_id = self._text_id % 0xFFFF + 1
                for chunk in encoders.statustext(int(command.severity), command.text, self._text_id):
                    self._queue(chunk)
            case _:
                raise ValueError(f"{type(command).__name__} is not a command for the autopilot")

    def drain(self) -> bytes:
        """What must be sent now: whole frames, the newest setpoint last."""
        if self._setpoint is not None:
            self._out += self._signed(self._writer.pack_payload(*self._setpoint))
            self._setpoint = None
            self.counts.setpoints += 1
        out = bytes(self._out)
        self._out.clear()
        return out

    def _send_setpoint(self, command: VelocitySetpoint, now_s: float) -> None:
        encoders.check_velocity(command.velocity_ned_mps)
        vehicle = self._vehicle
        if vehicle is None or vehicle.refusal is not None:
            self.counts.setpoints_dropped += 1
            return
        if self._setpoint is not None:
            self.counts.setpoints_dropped += 1
        boot_ms = 0
        if self._boot_s is not None:
            boot_ms = round((self._boot_s + max(0.0, now_s - self._boot_heard_s)) * 1e3)
        yaw_rad = self._nose.yaw_rad(command.velocity_ned_mps, now_s)
        self._setpoint = encoders.velocity_setpoint(
            command.velocity_ned_mps, yaw_rad, boot_ms, vehicle.system_id
        )

    def _send_mode(self, command: SetMode, now_s: float) -> None:
        mode, vehicle = command.mode, self._vehicle
        if vehicle is None:
            self._events.append(ModeRefused(mode=mode, reason="no vehicle has been heard yet"))
        elif vehicle.refusal is not None:
            self._events.append(ModeRefused(mode=mode, reason=vehicle.refusal))
        else:
            dialect = DIALECTS[vehicle.firmware]
            self._speed = None
            before = self._mode
            if before is None and self._cancelled is not None and self._cancelled.may_be_entered(now_s):
                # Its mode is no choice of the pilot's either.
                before = self._cancelled
            self._cancelled = None
            self._mode = ModeRequest(mode, dialect, vehicle.system_id, self._told, now_s, before)
            self._mode_speed_mps = command.speed_mps
            self._move_mode(now_s)

    def cancel_mode(self) -> None:
        """Ask for no mode and no speed any more: who asked has given up the vehicle."""
        self._cancelled, self._mode, self._speed = self._mode or self._cancelled, None, None

    def _move_mode(self, now_s: float) -> None:
        if self._mode is None:
            return
        outgoing = self._mode.due(now_s)
        if outgoing is not None:
            self.counts.mode_requests += 1
            self._queue(outgoing)
            if self._mode_speed_mps is not None:
                # Right behind it: ArduPilot forgets the speed when the mode begins.
                self._queue(self._speed_command(self._mode_speed_mps))
        self._settle_mode()

    def _settle_mode(self) -> None:
        request = self._mode
        if request is None or not (request.confirmed or request.refused):
            return
        if request.refused:
            self._events.append(ModeRefused(mode=request.mode, reason=request.refused))
        self._mode = None

    def _send_download(self, mission_type: int, now_s: float) -> None:
        """Fetch a list; the same one anew, or after the other one."""
        vehicle = self._vehicle
        if vehicle is None:
            self._refuse_download(mission_type, "no vehicle has been heard yet")
        elif self._download is not None and self._download.mission_type != mission_type:
            self._download_next = mission_type
        else:
            # ArduPilot's item 0 is its home, not a part of the mission.
            skip_home = mission_type == MISSION and vehicle.firmware is Firmware.ARDUPILOT
            self._download = MissionDownload(
                vehicle.system_id, now_s, mission_type=mission_type, skip_home=skip_home
            )
            self._move_download(now_s)

    def _move_download(self, now_s: float) -> None:
        download = self._download
        if download is None:
            return
        outgoing = download.due(now_s)
        if outgoing is not None:
            self._queue(outgoing)
        if download.failed is not None:
            self._refuse_download(download.mission_type, download.failed)
        elif download.items is None:
            return
        elif download.mission_type == MISSION:
            self._events.append(MissionDownloaded(items=download.items))
        else:
            try:
                self._events.append(FenceDownloaded(areas=areas_from_items(download.items)))
            except PeerDataError as error:
                self._refuse_download(FENCE, str(error))
        self._download = None
        if self._download_next is not None:
            mission_type, self._download_next = self._download_next, None
            self._send_download(mission_type, now_s)

    def _refuse_download(self, mission_type: int, reason: str) -> None:
        refused = MissionRefused if mission_type == MISSION else FenceRefused
        self._events.append(refused(reason=reason))

    def _queue(self, outgoing: encoders.Outgoing) -> None:
        self._queue_frame(self._writer.pack_payload(*outgoing))

    def _queue_frame(self, frame: bytes) -> None:
        if len(self._out) > MAX_QUEUED_BYTES:
            self._out.clear()
            self.counts.overflows += 1
        self._out += self._signed(frame)

    def _signed(self, frame: bytes) -> bytes:
        return frame if self._signing is None else self._signing.sign(frame)

    def _take_events(self) -> list[Event]:
        known = self.parameters
        if known is not None and known != self._parameters_told:
            self._parameters_told = known
            self._events.append(known)
        events, self._events = self._events, []
        return events


def _from_autopilot(fields: Fields) -> bool:
    """Whether a HEARTBEAT of component 1 is an autopilot's: some ground stations call themselves that too."""
    return bool(fields[1] != _GROUND_STATION and fields[2] != AUTOPILOT_INVALID)
