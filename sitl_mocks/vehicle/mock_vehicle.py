"""A mock MAVLink vehicle that behaves like ArduPilot Copter or PX4: bytes in, bytes out.

The vehicle uses no clock, socket or file. The caller passes in time and the random generator, so the same
bytes at the same times give the same flight, bit for bit. Use:

    vehicle = MockVehicle(VehicleOptions(firmware=Firmware.PX4), numpy.random.default_rng(1))
    vehicle.receive(data, now_s)
    vehicle.advance(now_s)
    data = vehicle.drain()
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Callable, Sequence

import numpy
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.signing import Signing, timestamp_at
from companion.autopilot.wire import MavlinkMessage
from companion.events import Landed
from companion.geometry import LocalFrame, Vec3
from sitl_mocks.vehicle.announcements import Announcer
from sitl_mocks.vehicle.commands import LATE_S, Command, CommandDesk, read_command, told
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode
from sitl_mocks.vehicle.link_set import LinkSet
from sitl_mocks.vehicle.links import Link, SetpointMessage
from sitl_mocks.vehicle.motion.dynamics import STEP_S
from sitl_mocks.vehicle.motion.flight import Flight
from sitl_mocks.vehicle.motion.navigation import NOISE_STEPS, NavigationError
from sitl_mocks.vehicle.motion.setpoints import interpret
from sitl_mocks.vehicle.options import VehicleOptions
from sitl_mocks.vehicle.sensing import Sensor
from sitl_mocks.vehicle.served.mission import MissionBook, checked_items, home_item, stored_fence
from sitl_mocks.vehicle.served.mission_desk import MissionDesk
from sitl_mocks.vehicle.served.params import ParamBook
from sitl_mocks.vehicle.served.remote_id import ODID_MESSAGES, RemoteIdRelay
from sitl_mocks.vehicle.telemetry import LISTS, Telemetry
from sitl_mocks.vehicle.traffic import Traffic
from sitl_mocks.vehicle.troubles import Answers, Troubles

__all__ = ["STEP_S", "MockVehicle", "VehicleMode", "VehicleOptions"]

COMPONENT = 1
REBOOT_S = 2.4
_LINKS_OWN = frozenset({mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE})
"""Commands that the link handles by itself. They do not make the vehicle publish its status."""
KEPT_COLLISIONS = 100
_DO_SET_MODE = int(mavlink.MAV_CMD_DO_SET_MODE)
_ADSB = int(mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE)
_EPSILON_S = 1e-9


class MockVehicle:
    """One vehicle on any number of links. Its motion begins at now_s = `start_s`.

    Raises ConfigError for a mission in the options that cannot be flown.
    """

    def __init__(self, options: VehicleOptions, rng: numpy.random.Generator, start_s: float = 0.0) -> None:
        self.options = options
        self.setpoints_received = 0
        """Number of SET_POSITION_TARGET_LOCAL_NED messages addressed to this vehicle, flown or not."""
        self.largest_setpoint_gap_s = 0.0
        """Longest time between two setpoint messages."""
        self.setpoint_gaps_over_100ms = 0
        self.reboots = 0
        self.collisions: deque[tuple[float, MavlinkMessage]] = deque(maxlen=KEPT_COLLISIONS)
        """The latest COLLISION messages, each with its time of arrival."""
        self._manners = options.manners
        self._last_setpoint_s: float | None = None
        self._late_acks: list[tuple[Command, tuple[int, int]]] = []
        self._start_s = start_s
        self._steps = 0
        self._down_until_s = -math.inf
        self._errors = NavigationError(options, rng, NOISE_STEPS * STEP_S)
        self.signing: Signing | None = None
        """MAVLink signing state, shared by all links as on the real autopilots."""
        if options.signing_key is not None:
            utc_s = 0.0 if options.utc_at_zero_s is None else options.utc_at_zero_s + start_s
            self.signing = Signing(options.signing_key, timestamp_at(utc_s), start_s)
        self._links = LinkSet((options.system_id, COMPONENT), self._manners, self.signing)
        self._handlers = self._make_handlers()
        self._params = ParamBook(
            self._manners,
            options.parameters,
            system_id=options.system_id,
            legacy_names=options.legacy_parameter_names,
        )
        home = LocalFrame(options.home_lat_deg, options.home_lon_deg, options.home_alt_msl_m)
        self._book = MissionBook(self._manners, home_item(home), checked_items(options.mission))
        fence = MissionBook(self._manners, None, stored_fence(options.fence, self._manners))
        self._missions = MissionDesk(self._manners, (self._book, fence))
        self.troubles = Troubles(self._manners, self._params, fence, home, rc_connected=options.rc_connected)
        """Battery, estimator, GNSS, sticks and wrong answers. The caller sets them."""
        self.traffic = Traffic(
            options.traffic,
            home,
            options.geoid_separation_m,
            listed=self._manners.adsb_listed,
        )
        self.sensor: Sensor | None = None
        """Sensor for obstacles. It has a random generator of its own, apart from the navigation errors."""
        if options.sensor is not None:
            sensor_rng = rng.spawn(1)[0]
            self.sensor = Sensor(options.sensor, options.obstacles, home, sensor_rng, options.system_id)
        self._boot(options, start_s, boot_s=-options.boot_time_offset_s)
        self.open_link(0)

    def _make_handlers(self) -> dict[str, Callable[[MavlinkMessage, Link, float], None]]:
        return {
            "COMMAND_LONG": self._take_command,
            "COMMAND_INT": self._take_command,
            "SET_MODE": self._take_set_mode,
            "TIMESYNC": self._answer_timesync,
            "PARAM_REQUEST_LIST": self._answer_param,
            "PARAM_REQUEST_READ": self._answer_param,
            "PARAM_SET": self._answer_param,
            "REQUEST_DATA_STREAM": self._take_data_stream,
            "COLLISION": self._note_collision,
            "HEARTBEAT": self._note_heartbeat,
        }

    def _boot(self, options: VehicleOptions, now_s: float, boot_s: float) -> None:
        manners = self._manners
        self._flight = Flight(options, manners, self._params, self._book, now_s)
        self._telemetry = Telemetry(
            options, manners, self._flight, self._book, self._errors, self.troubles, boot_s
        )
        self._remote_id = None
        if options.did_enable:
            self._remote_id = RemoteIdRelay(self._telemetry.remote_id_location, now_s)
        self._announcer = Announcer(
            manners, self._links, self._flight, self._telemetry, self._missions.books, self._remote_id
        )
        self._desk = CommandDesk(
            manners,
            self._flight,
            self._telemetry,
            options.home_alt_msl_m,
            self._announcer.say,
            self._remote_id_refusal,
        )

    # ------------------------------------------------------------ truth

    @property
    def now_s(self) -> float:
        """Time up to which the motion is integrated."""
        return self._start_s + self._steps * STEP_S

    @property
    def position_ned_m(self) -> Vec3:
        """True position (m, NED) in the LocalFrame of home, whose altitude is above mean sea level."""
        body = self._flight.body
        return body.north, body.east, body.down

    @property
    def velocity_ned_mps(self) -> Vec3:
        """True velocity over ground (NED)."""
        body = self._flight.body
        return body.vn, body.ve, body.vd

    @property
    def _uses_traffic(self) -> bool:
        """Whether the autopilot uses reports of other components, and reports them as its own."""
        return not self._manners.adsb_listed or self._params.get("ADSB_TYPE") != 0

    @property
    def yaw_rad(self) -> float:
        """True heading, clockwise from north."""
        return self._flight.body.yaw

    @property
    def mode(self) -> VehicleMode:
        """The present flight mode."""
        return self._flight.mode

    @property
    def custom_mode(self) -> int:
        """The present mode's number in this firmware's heartbeat."""
        return self._manners.custom_modes[self._flight.mode]

    @property
    def armed(self) -> bool:
        """Whether the motors may turn."""
        return self._flight.armed

    @property
    def failsafe(self) -> bool:
        """Whether a failsafe chose the present mode: setpoint loss, or one of the `troubles`."""
        return self._flight.failsafe

    @property
    def landed(self) -> Landed:
        """Landed state as EXTENDED_SYS_STATE reports it."""
        return self._flight.landed

    @property
    def mission_seq(self) -> int:
        """Mission item being flown, in the firmware's own numbering."""
        return self._flight.runner.seq

    # ------------------------------------------------------------ the pilot

    def pilot_selects(self, mode: VehicleMode) -> bool:
        """Select a mode by the pilot's radio switch, not by MAVLink.

        Return whether the vehicle entered it.
        """
        refused = self._flight.set_mode(mode, self.now_s)
        self._after_change()
        return refused is None

    # ------------------------------------------------------------ links

    def open_link(self, link: int) -> None:
        """Open or reopen a link with only the message streams that every fresh link carries."""
        self._links.open(link, self.now_s)

    def close_link(self, link: int) -> None:
        """Forget a link with its message rates and its unsent bytes."""
        self._links.forget(link)

    def cut_link(self, link: int = 0) -> None:
        """Interrupt a link in both directions. Everything sent meanwhile is lost."""
        self._links[link].cut = True

    def mend_link(self, link: int = 0) -> None:
        """Restore a cut link with the message rates that were requested before."""
        self._links[link].cut = False

    def reboot(self, *, flies_on: bool = False) -> None:
        """Restart the autopilot, also in flight.

        For REBOOT_S the vehicle neither receives nor sends; then its state is that after a boot. In the air
        the motors stop and it falls. With `flies_on` it hovers instead and is armed afterwards, in the boot
        mode (as after a watchdog reset).
        """
        self.reboots += 1
        self._down_until_s = self.now_s + REBOOT_S
        if self._flight.on_ground or not flies_on:
            self._flight.disarm(force=True)
        else:
            self._flight.fail_over(self._manners.boot_mode)
        self._flight.texts.clear()

    def drain(self, link: int = 0) -> bytes:
        """Return and remove the bytes to send on a link."""
        if link not in self._links:
            self.open_link(link)
        return self._links[link].drain()

    def receive(self, data: bytes, now_s: float, link: int = 0) -> None:
        """Process bytes that arrived at `now_s` on a link. During a reboot messages are discarded."""
        if link not in self._links:
            self.open_link(link)
        endpoint = self._links[link]
        if self.signing is not None:
            self.signing.advance(now_s)
        messages = endpoint.feed(data)
        if now_s < self._down_until_s:
            return
        for frame, message in messages:
            kept = frame.message_id == _ADSB and self._uses_traffic
            if kept:
                self.traffic.receive(message)
            if len(self._links) > 1 and self._manners.forwards and not kept:
                self._links.forward(frame, message, link)
            system = getattr(message, "target_system", 0)
            component = getattr(message, "target_component", 0)
            if system in (0, self.options.system_id) and component in (0, COMPONENT):
                if isinstance(message, SetpointMessage):
                    self._take_setpoint(message, now_s)
                else:
                    self._handle(message, endpoint, link, now_s)
                    if self._remote_id is not None and frame.message_id in ODID_MESSAGES:
                        self._remote_id.handle(frame, message, now_s)
        self._after_change()

    def advance(self, now_s: float) -> None:
        """Fly in whole steps up to `now_s`, and send the messages that fall due on the way."""
        if self._steps == 0:
            self._send_due(self._start_s)
        while self._start_s + (self._steps + 1) * STEP_S <= now_s + _EPSILON_S:
            if self._steps % NOISE_STEPS == 0:
                self._errors.advance()
                self.troubles.step(self._flight, self._start_s + self._steps * STEP_S)
            self._flight.step(self._start_s + self._steps * STEP_S)
            self._steps += 1
            self._send_due(self._start_s + self._steps * STEP_S)

    # ------------------------------------------------------------ sending

    def _send_due(self, at_s: float) -> None:
        if self.signing is not None:
            self.signing.advance(at_s)
        if at_s < self._down_until_s:
            return
        if self._down_until_s > -math.inf:
            self._down_until_s = -math.inf
            self._wake(at_s)
        while self._late_acks and self._late_acks[0][0].now_s + LATE_S <= at_s:
            command, to = self._late_acks.pop(0)
            self._acknowledge(command, self._desk.set_mode_late(command), to)
        self._after_change()
        self._announcer.tell_status(at_s)
        builders = self._telemetry.builders
        for number, link in self._links.items():
            for message_id in link.due(at_s):
                if message_id in LISTS:
                    for report in self._listed(message_id, number, at_s):
                        link.send(report)
                elif (built := builders[message_id](at_s)) is not None:
                    link.send(built)
            if link.mode_is_news and link.tells_mode(at_s):
                link.mode_is_news = False
                link.send(self._telemetry.current_mode(at_s))
            if link.params_due:
                index = link.params_due.popleft()
                link.send(self._params.message(self._params.names[index], index))
        if self._remote_id is not None:
            for message in self._remote_id.due(at_s):
                self._links.send(message)
        if self.sensor is not None:
            for seen in self.sensor.due(at_s, self.position_ned_m, *self._telemetry.pose()):
                self._links.pass_on(seen)
        for asked, request in self._missions.tick(at_s):
            if asked in self._links:
                self._links[asked].send(request)

    def _listed(self, message_id: int, link: int, at_s: float) -> Sequence[MavlinkMessage]:
        if message_id == _ADSB:
            return self.traffic.due(link, at_s)
        if self.sensor is None or self.troubles.proximity_lost:
            return ()
        return self.sensor.sectors(at_s, self.position_ned_m, self._telemetry.attitude_rad())

    def _after_change(self) -> None:
        """Send everything that a step or a message has changed."""
        self._announcer.tell_changes(self.now_s)

    def _remote_id_refusal(self, now_s: float) -> str | None:
        if self._remote_id is None or not self.options.did_require:
            return None
        return self._remote_id.refusal(now_s)

    def _wake(self, at_s: float) -> None:
        """Boot again at the same place. Missions and parameters are kept, requested message rates are not."""
        body, on_ground = self._flight.body, self._flight.on_ground
        standing = dataclasses.replace(
            self.options,
            airborne=self._flight.armed and not on_ground,
            start_position_ned_m=self.position_ned_m,
            start_velocity_ned_mps=self.velocity_ned_mps,
            start_yaw_rad=self.yaw_rad,
            start_mode=self._manners.boot_mode,
        )
        self._missions.reboot()
        self.troubles.reboot()
        self._boot(standing, at_s, boot_s=at_s)
        if not self._flight.armed and not on_ground:
            # The vehicle is still falling.
            fallen, self._flight.on_ground = self._flight.body, False
            fallen.down, fallen.vn, fallen.ve, fallen.vd = body.down, body.vn, body.ve, body.vd
        for link in self._links.values():
            link.drain()
            link.reset(self._manners.fresh_streams, at_s)

    # ------------------------------------------------------------ taking messages

    def _handle(self, message: MavlinkMessage, endpoint: Link, link: int, now_s: float) -> None:
        kind = message.get_type()
        handler = self._handlers.get(kind)
        if handler is not None:
            handler(message, endpoint, now_s)
        elif kind.startswith("MISSION_"):
            self._book.current_seq = self._flight.runner.seq
            for answer in self._missions.handle(message, now_s, link):
                endpoint.send(answer)
            self._flight.runner.sync()

    def _take_setpoint(self, message: SetpointMessage, now_s: float) -> None:
        self.setpoints_received += 1
        if self._last_setpoint_s is not None:
            gap_s = now_s - self._last_setpoint_s
            self.largest_setpoint_gap_s = max(self.largest_setpoint_gap_s, gap_s)
            self.setpoint_gaps_over_100ms += gap_s > 0.1
        self._last_setpoint_s = now_s
        setpoint = interpret(message, self._manners, self.position_ned_m, self.yaw_rad)
        if setpoint is not None:
            self._flight.set_setpoint(setpoint, now_s)

    def _take_command(self, message: MavlinkMessage, endpoint: Link, now_s: float) -> None:
        to = (message.get_srcSystem(), message.get_srcComponent())
        command = read_command(message, endpoint, now_s)
        if command.number not in _LINKS_OWN:
            # PX4's Commander publishes its status with every command, accepted or not.
            self._announcer.publish_status(now_s)
        for result in self._desk.execute(command, self._answers(command, to)):
            if result is None:
                self._late_acks.append((command, to))
            else:
                self._acknowledge(command, result, to)
        if self._desk.reboot_asked:
            self._desk.reboot_asked = False
            self.reboots += 1
            self._down_until_s = now_s + REBOOT_S

    def _answers(self, command: Command, sender: tuple[int, int]) -> Answers:
        aboard = sender[0] == self.options.system_id
        return self.troubles.answers if aboard and command.number == _DO_SET_MODE else "right"

    def _acknowledge(self, command: Command, result: int, to: tuple[int, int]) -> None:
        shown = told(result, self._answers(command, to))
        if shown is not None:
            command.link.send(mavlink.MAVLink_command_ack_message(command.number, shown, 0, 0, *to))

    def _take_set_mode(self, message: MavlinkMessage, endpoint: Link, now_s: float) -> None:
        if message.target_system != self.options.system_id:
            return
        result = self._desk.enter_custom(message.custom_mode, now_s)
        if self._manners.set_mode_acked:
            to = (message.get_srcSystem(), message.get_srcComponent())
            endpoint.send(
                mavlink.MAVLink_command_ack_message(mavlink.MAVLINK_MSG_ID_SET_MODE, result, 0, 0, *to)
            )

    def _answer_timesync(self, message: MavlinkMessage, endpoint: Link, now_s: float) -> None:
        if message.tc1 == 0:
            endpoint.answer_timesync(self._telemetry.boot_ns(now_s), message.ts1)

    def _note_heartbeat(self, message: MavlinkMessage, endpoint: Link, now_s: float) -> None:
        self.troubles.hear(message, now_s)

    def _note_collision(self, message: MavlinkMessage, endpoint: Link, now_s: float) -> None:
        self.collisions.append((now_s, message))

    def _answer_param(self, message: MavlinkMessage, endpoint: Link, now_s: float) -> None:
        if (answer := self._params.answer(message, endpoint.params_due)) is not None:
            endpoint.send(answer)

    def _take_data_stream(self, message: MavlinkMessage, endpoint: Link, now_s: float) -> None:
        if self._manners.data_streams:
            on = message.start_stop and message.req_message_rate
            interval_s = 1.0 / message.req_message_rate if on else None
            endpoint.set_data_stream(message.req_stream_id, interval_s, now_s)
