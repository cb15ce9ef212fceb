"""Answers requests of ground stations about the companion: messages on request, and files over MAVLink FTP.

MAV_CMD_REQUEST_MESSAGE for COMPONENT_INFORMATION_BASIC, COMPONENT_METADATA or AUTOPILOT_VERSION is answered
with COMMAND_ACK and the message. FILE_TRANSFER_PROTOCOL is answered with FILE_TRANSFER_PROTOCOL. The first
two messages may be requested from all components at once. A request to all for AUTOPILOT_VERSION is left to
the autopilot, because a ground station could take our version for the autopilot's. Any other command to us
alone is refused by COMMAND_ACK, as MAVLink's command protocol requires: a sender without an answer repeats
its command.

Requests are queued, a few at most, and answered one at a time, so that a flood does not fill a slow link.
"""

from __future__ import annotations

import math
import re
import struct
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion import __version__
from companion.autopilot.dialect import CMD_REQUEST_MESSAGE
from companion.autopilot.encoders import Outgoing
from companion.autopilot.readers import unpack
from companion.autopilot.served import ftp
from companion.autopilot.served.ftp import FileServer
from companion.autopilot.served.metadata import GENERAL, MODEL, VENDOR, metadata_files, uri
from companion.autopilot.wire import COMPONENT_INFORMATION_BASIC, COMPONENT_METADATA, Frame
from companion.config import Config

PERIOD_S = 0.1
"""Time from one answer to the next. It limits the answers to 3 kB/s."""
MOST_WAITING = 8
_FTP = mavlink.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL
_COMMANDS = (mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT)
_VERSION = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
_OF_ALL = (COMPONENT_INFORMATION_BASIC, COMPONENT_METADATA)
"""Messages that may be requested from all components at once."""
CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_FTP
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
)
"""MAV_PROTOCOL_CAPABILITY flags. All our parameters are floats, so the C cast encoding fits them too."""
_MAJOR, _MINOR, _PATCH = (int(number) for number in re.findall(r"\d+", __version__)[:3])
_SOFTWARE = _MAJOR << 24 | _MINOR << 16 | _PATCH << 8
"""Version as encoded in AUTOPILOT_VERSION, with FIRMWARE_VERSION_TYPE_DEV."""

_ACK_LAYOUT = struct.Struct("<HBBiBB")
_BASIC_LAYOUT = struct.Struct("<QII32s32s24s24s32s")
_METADATA_LAYOUT = struct.Struct("<II100s")
_VERSION_LAYOUT = struct.Struct("<QQIIIIHH8s8s8s18s")
_FTP_TARGET = struct.Struct("<BBB")


class Answer(NamedTuple):
    """Answer to one request."""

    messages: list[Outgoing]
    refused: bool
    """Whether the request was refused, by a COMMAND_ACK other than ACCEPTED or by a NAK."""


class _Asker(NamedTuple):
    """Sender and content of a request. A repeated request is equal to the first one."""

    system_id: int
    component_id: int
    command: int
    """MAV_CMD; 0 for FTP."""
    message_id: int
    """`_FTP`, or the requested message; -1: a number that no message has; 0: another command."""
    sequence: int
    """FTP sequence number."""


class ComponentInformation:
    """Queues requests and answers them."""

    def __init__(self, config: Config) -> None:
        """Create the files, once."""
        files = metadata_files(config)
        self._general_crc = ftp.crc32(files[GENERAL])
        self._files = FileServer(files)
        self._asked: dict[_Asker, bytes] = {}
        """Requests with their FTP payload, in order of arrival."""
        self._next_s = -math.inf

    def handle(self, frame: Frame, system_id: int, component_id: int) -> bool:
        """Take one message of another system. Returns False if it is not for us, or if too many requests wait
        already.

        Args:
            system_id, component_id: our own.
        """
        if frame.message_id == _FTP:
            data = frame.payload.ljust(_FTP_TARGET.size + ftp.PAYLOAD_BYTES, b"\0")
            _network, *target = _FTP_TARGET.unpack_from(data)
            payload = data[_FTP_TARGET.size :]
            if target != [system_id, component_id] or not ftp.is_request(payload):
                return False
            return self._keep(frame, 0, _FTP, ftp.sequence(payload), payload)
        if frame.message_id not in _COMMANDS:
            return False
        # COMMAND_LONG and COMMAND_INT have these fields in the same places.
        fields = unpack(frame.message_id, frame.payload)
        wanted, command, target_system, target_component = fields[0], *fields[7:10]
        asked_of_us = (target_system, target_component) == (system_id, component_id)
        if command != CMD_REQUEST_MESSAGE:
            return asked_of_us and self._keep(frame, command, 0, 0, b"")
        asked_of_all = target_system in (0, system_id) and target_component in (0, component_id)
        if not asked_of_us and not (asked_of_all and wanted in _OF_ALL):
            return False
        # NaN and infinity are not integers either.
        return self._keep(frame, command, int(wanted) if float(wanted).is_integer() else -1, 0, b"")

    def _keep(self, frame: Frame, command: int, message_id: int, sequence: int, payload: bytes) -> bool:
        asker = _Asker(frame.system_id, frame.component_id, command, message_id, sequence)
        if asker not in self._asked and len(self._asked) >= MOST_WAITING:
            return False
        self._asked[asker] = payload
        return True

    def due(self, now_s: float) -> Answer | None:
        """The next answer, if one is due."""
        if not self._asked or now_s < self._next_s:
            return None
        self._next_s = now_s + PERIOD_S
        asker = next(iter(self._asked))
        payload = self._asked.pop(asker)
        to = asker.system_id, asker.component_id
        if asker.message_id == _FTP:
            reply = self._files.reply(*to, payload)
            return Answer([(_FTP, _FTP_TARGET.pack(0, *to) + reply.payload)], reply.refused)
        content = self._content(asker.message_id, now_s)
        result = mavlink.MAV_RESULT_ACCEPTED
        if content is None:
            result = mavlink.MAV_RESULT_DENIED if asker.message_id < 0 else mavlink.MAV_RESULT_UNSUPPORTED
        ack = _ACK_LAYOUT.pack(asker.command, result, 0, 0, *to)
        messages = [(mavlink.MAVLINK_MSG_ID_COMMAND_ACK, ack)]
        if content is not None:
            messages.append((asker.message_id, content))
        return Answer(messages, refused=content is None)

    def _content(self, message_id: int, now_s: float) -> bytes | None:
        """Payload of a message about us; None if we do not have that message."""
        boot_ms = int(now_s * 1e3) & 0xFFFF_FFFF
        if message_id == COMPONENT_INFORMATION_BASIC:
            names = (VENDOR.encode(), MODEL.encode(), __version__.encode(), b"", b"")
            return _BASIC_LAYOUT.pack(CAPABILITIES, boot_ms, 0, *names)
        if message_id == COMPONENT_METADATA:
            return _METADATA_LAYOUT.pack(boot_ms, self._general_crc, uri(GENERAL).encode())
        if message_id == _VERSION:
            return _VERSION_LAYOUT.pack(CAPABILITIES, 0, _SOFTWARE, 0, 0, 0, 0, 0, b"", b"", b"", b"")
        return None
