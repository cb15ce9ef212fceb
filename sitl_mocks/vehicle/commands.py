"""COMMAND_LONG and COMMAND_INT of the mock vehicle: one function per command, which returns its MAV_RESULT.

Every command addressed to the vehicle is acknowledged. Commands that are not in the table are UNSUPPORTED.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkMessage
from sitl_mocks.vehicle.firmware.behaviour import Manners, VehicleMode
from sitl_mocks.vehicle.links import Link
from sitl_mocks.vehicle.motion.flight import FORCE, Flight
from sitl_mocks.vehicle.telemetry import Telemetry
from sitl_mocks.vehicle.troubles import Answers

ACCEPTED = int(mavlink.MAV_RESULT_ACCEPTED)
DENIED = int(mavlink.MAV_RESULT_DENIED)
FAILED = int(mavlink.MAV_RESULT_FAILED)
UNSUPPORTED = int(mavlink.MAV_RESULT_UNSUPPORTED)
_WARNING = int(mavlink.MAV_SEVERITY_WARNING)
_CRITICAL = int(mavlink.MAV_SEVERITY_CRITICAL)
_CUSTOM = int(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
_REBOOT_AUTOPILOT = 1
LATE_S = 0.012
"""Time from PX4's first ACK (result 0) of a mode command to the refusal that follows."""


def told(result: int, answers: Answers) -> int | None:
    """The result to acknowledge for a command that had `result` (see `Answers`); None: no acknowledgement."""
    if result != ACCEPTED or answers in ("right", "disobeyed"):
        return result
    return None if answers == "unanswered" else FAILED


@dataclass(frozen=True, slots=True)
class Command:
    """A command with params 1-7 (7 is the altitude), as COMMAND_LONG and COMMAND_INT carry it."""

    number: int
    params: tuple[float, float, float, float, float, float, float]
    link: Link
    now_s: float


def read_command(message: MavlinkMessage, link: Link, now_s: float) -> Command:
    """Read the command from a COMMAND_LONG or COMMAND_INT. Positions are in degrees."""
    head = (message.param1, message.param2, message.param3, message.param4)
    if message.get_type() == "COMMAND_INT":
        return Command(message.command, (*head, message.x * 1e-7, message.y * 1e-7, message.z), link, now_s)
    tail = (message.param5, message.param6, message.param7)
    return Command(message.command, (*head, *tail), link, now_s)


class CommandDesk:
    """Carries out commands.

    Args:
        say: sends a STATUSTEXT with a severity and a text to all links.
        remote_id: returns why Remote ID forbids arming at a now_s, or None.
    """

    def __init__(
        self,
        manners: Manners,
        flight: Flight,
        telemetry: Telemetry,
        home_alt_msl_m: float,
        say: Callable[[int, str], None],
        remote_id: Callable[[float], str | None],
    ) -> None:
        self.reboot_asked = False
        self._manners = manners
        self._flight = flight
        self._telemetry = telemetry
        self._home_alt_msl_m = home_alt_msl_m
        self._say = say
        self._remote_id = remote_id
        self._table: dict[int, Callable[[Command], int]] = {
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm,
            mavlink.MAV_CMD_NAV_TAKEOFF: self._take_off,
            mavlink.MAV_CMD_NAV_LAND: self._land,
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: self._return,
            mavlink.MAV_CMD_MISSION_START: self._start_mission,
            mavlink.MAV_CMD_DO_SET_MODE: self._set_mode,
            mavlink.MAV_CMD_DO_CHANGE_SPEED: self._change_speed,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            mavlink.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._send_version,
            mavlink.MAV_CMD_GET_HOME_POSITION: self._send_home,
            mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: self._reboot,
        }

    def execute(self, command: Command, answers: Answers = "right") -> list[int | None]:
        """Carry out a command. Return the results to acknowledge, in order.

        None stands for a result that `set_mode_late` gives LATE_S later. PX4 refuses a mode only then, so a
        setpoint that arrives just after the command still counts.
        """
        handler = self._table.get(command.number)
        if handler is None:
            return [UNSUPPORTED]
        if answers == "disobeyed":
            return [ACCEPTED]
        result = handler(command)
        if command.number == mavlink.MAV_CMD_DO_SET_MODE and self._manners.mode_ack_first:
            return [ACCEPTED, None if result == self._manners.failure_result else result]
        return [result]

    def set_mode_late(self, command: Command) -> int:
        """Return the delayed result of a mode command, LATE_S after it arrived."""
        return self._set_mode(replace(command, now_s=command.now_s + LATE_S))

    def enter(self, mode: VehicleMode, now_s: float) -> int:
        """Change the mode. A refusal is sent as text and returned as result."""
        refusal = self._flight.set_mode(mode, now_s)
        if refusal is None:
            return ACCEPTED
        self._say(_WARNING, refusal)
        return self._manners.failure_result

    def enter_custom(self, custom_mode: int, now_s: float) -> int:
        """Change to the mode with this firmware number."""
        mode = self._manners.mode_of(custom_mode)
        if mode is None:
            self._say(_WARNING, f"No such mode {custom_mode}")
            return self._manners.failure_result
        return self.enter(mode, now_s)

    def _set_mode(self, command: Command) -> int:
        base, main, sub = command.params[:3]
        if not all(map(math.isfinite, (base, main, sub))) or not int(base) & _CUSTOM:
            return DENIED
        number = int(main) << 16 | int(sub) << 24 if self._manners.mode_ack_first else int(main)
        return self.enter_custom(number, command.now_s)

    def _arm(self, command: Command) -> int:
        force = command.params[1] == FORCE
        if command.params[0] >= 0.5:
            refusals = self._arm_refusals(command.now_s, force=force)
        else:
            refusals = [self._flight.disarm(force=force)]
        reasons = [reason for reason in refusals if reason is not None]
        # The autopilots report the reasons only as text.
        for reason in reasons:
            self._say(_CRITICAL, f"Arm: {reason}")
        return self._manners.failure_result if reasons else ACCEPTED

    def _arm_refusals(self, now_s: float, *, force: bool) -> list[str | None]:
        """Arm, or return all reasons of the refusal."""
        missing = None if self._flight.armed else self._remote_id(now_s)
        if missing is None:
            return [self._flight.arm(now_s, force=force)]
        return [self._flight.arm_refusal(now_s, force=force), f"OpenDroneID: {missing}"]

    def _take_off(self, command: Command) -> int:
        altitude = command.params[6]
        if self._manners.takeoff_altitude_is_amsl:
            altitude -= self._home_alt_msl_m
        refusal = self._flight.take_off(altitude)
        return ACCEPTED if refusal is None else self._manners.failure_result

    def _land(self, command: Command) -> int:
        return self.enter(VehicleMode.LAND, command.now_s)

    def _return(self, command: Command) -> int:
        return self.enter(VehicleMode.RTL, command.now_s)

    def _start_mission(self, command: Command) -> int:
        return self.enter(VehicleMode.MISSION, command.now_s)

    def _change_speed(self, command: Command) -> int:
        speed = command.params[1]
        if not speed > 0.0:
            return DENIED
        self._flight.change_speed(speed)
        return ACCEPTED

    def _set_interval(self, command: Command) -> int:
        message_id, interval_us = command.params[0], command.params[1]
        if not math.isfinite(message_id) or not math.isfinite(interval_us):
            return DENIED
        if self._manners.refuses_interval_param3 and command.params[2] != 0.0:
            return DENIED
        number = int(message_id)
        if number not in self._telemetry.known:
            self._say_unknown(number)
            return self._manners.unsupported_interval_result
        if interval_us < 0.0:
            interval = None
        elif interval_us == 0.0:
            interval = self._manners.fresh_streams.get(number)
        else:
            interval = interval_us * 1e-6
        command.link.set_interval(number, interval, command.now_s)
        return ACCEPTED

    def _get_interval(self, command: Command) -> int:
        if not math.isfinite(command.params[0]):
            return DENIED
        number = int(command.params[0])
        known = number in self._telemetry.known
        interval = command.link.interval(number)
        # 0: not available; -1: off.
        shown = 0 if not known else -1 if interval is None else round(interval * 1e6)
        command.link.send(mavlink.MAVLink_message_interval_message(number, shown))
        return ACCEPTED if known else FAILED

    def _request_message(self, command: Command) -> int:
        if not math.isfinite(command.params[0]):
            return DENIED
        number = int(command.params[0])
        builder = self._telemetry.builders.get(number)
        if builder is None:
            self._say_unknown(number)
            return self._manners.unsupported_request_result
        answer = builder(command.now_s)
        if answer is None:
            return self._manners.unsupported_request_result
        command.link.send(answer)
        return ACCEPTED

    def _send_version(self, command: Command) -> int:
        command.link.send(self._telemetry.autopilot_version(command.now_s))
        return ACCEPTED

    def _send_home(self, command: Command) -> int:
        command.link.send(self._telemetry.home_position(command.now_s))
        return ACCEPTED

    def _reboot(self, command: Command) -> int:
        if command.params[0] != _REBOOT_AUTOPILOT:
            return DENIED
        if self._flight.armed:
            return self._manners.failure_result
        self.reboot_asked = True
        return ACCEPTED

    def _say_unknown(self, message_id: int) -> None:
        if self._manners.no_such_message_text:
            self._say(_WARNING, f"No ap_message for mavlink id ({message_id})")
