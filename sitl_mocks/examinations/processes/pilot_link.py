"""A pilot's own MAVLink link to a served vehicle (UDP, loopback): modes, arming, the vehicle's answers."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable
from typing import Final

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.readers import unpack
from companion.autopilot.wire import CURRENT_MODE, FrameScanner, MavlinkWriter
from companion.events import Firmware
from sitl_mocks.vehicle.firmware.behaviour import MANNERS, VehicleMode
from sitl_mocks.vehicle.motion.flight import FORCE

SET_MODE: Final[int] = mavlink.MAV_CMD_DO_SET_MODE
ARM: Final[int] = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
_SET_INTERVAL = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
_MODE_INTERVAL_US = 5e4
_READ_BYTES = 65536


class PilotLink:
    """Sends commands to one vehicle and receives its answers. No method blocks.

    Args:
        port: port on which the vehicle listens for this link only.
    """

    def __init__(self, firmware: Firmware, port: int, system_id: int = 1) -> None:
        self.modes = MANNERS[firmware].custom_modes
        self.answers: list[tuple[int, int]] = []
        """Commands and their results since the last command was sent."""
        self._px4 = firmware is Firmware.PX4
        self._system_id = system_id
        self._scanner = FrameScanner()
        self._writer = MavlinkWriter(255, 190)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port))
        self._socket.setblocking(False)
        self._send(self._command(_SET_INTERVAL, float(CURRENT_MODE), _MODE_INTERVAL_US))

    def close(self) -> None:
        """Release the socket."""
        self._socket.close()

    def ask_modes(self, *modes: VehicleMode) -> None:
        """Request modes once, in one datagram, so that the vehicle takes all of them within one step."""
        commands = []
        for mode in modes:
            number = self.modes[mode]
            params = (number >> 16 & 0xFF, number >> 24) if self._px4 else (number, 0)
            commands.append(self._command(SET_MODE, 1.0, *map(float, params)))
        self._send(b"".join(commands))

    @property
    def mode_results(self) -> list[int]:
        """Results of the mode requests so far. PX4 acknowledges twice, and the second one is the result."""
        results = [result for number, result in self.answers if number == SET_MODE]
        return results[1::2] if self._px4 else results

    def arm(self, *, armed: bool) -> None:
        """Arm or disarm the vehicle, also in the air."""
        self._send(self._command(ARM, float(armed), FORCE))

    def _command(self, number: int, *params: float) -> bytes:
        filled = (*params, *([0.0] * (7 - len(params))))
        return self._writer.pack(mavlink.MAVLink_command_long_message(self._system_id, 1, number, 0, *filled))

    def _send(self, commands: bytes) -> None:
        self.answers.clear()
        with contextlib.suppress(OSError):
            self._socket.send(commands)

    def hear(self, shown: Callable[[int, bool | None], None] | None = None) -> None:
        """Read all messages that have arrived.

        Args:
            shown: called with the result of `mode_told` for each message that reports a mode.
        """
        with contextlib.suppress(BlockingIOError, ConnectionError):
            while True:
                for frame in self._scanner.frames(self._socket.recv(_READ_BYTES)):
                    if frame.system_id != self._system_id or frame.component_id != 1:
                        continue
                    if frame.message_id == mavlink.MAVLINK_MSG_ID_COMMAND_ACK:
                        fields = unpack(frame.message_id, frame.payload)
                        self.answers.append((fields[0], fields[1]))
                    elif shown is not None and (told := mode_told(frame.message_id, frame.payload)):
                        shown(*told)


def mode_told(message_id: int, payload: bytes) -> tuple[int, bool | None] | None:
    """Mode (`custom_mode`) reported by an autopilot's message, and whether the vehicle is armed.

    The second value is None if the message does not contain it. The result is None for all other messages.
    """
    if message_id == CURRENT_MODE:
        return unpack(message_id, payload)[0], None
    if message_id != mavlink.MAVLINK_MSG_ID_HEARTBEAT:
        return None
    fields = unpack(message_id, payload)
    return fields[0], bool(fields[3] & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
