"""Bluetooth HCI events as bytes, and their framing in a stream.

Bluetooth Core 5.4: vol. 4 part E section 7.7, vol. 4 part A (H4). Parsers raise `PeerDataError`.
"""

from __future__ import annotations

import enum
import struct
from dataclasses import dataclass
from typing import Final

from companion.errors import PeerDataError
from companion.radio.hci.packets import Opcode, Status

H4_EVENT: Final = 0x04
UNKNOWN_RSSI: Final = 127

_COMMAND_COMPLETE: Final = 0x0E
_COMMAND_STATUS: Final = 0x0F
_HARDWARE_ERROR: Final = 0x10
_LE_META: Final = 0x3E
_VENDOR: Final = 0xFF
_HIGHEST_CODE: Final = 0x60
_LE_ADVERTISING_REPORT: Final = 0x02
_LE_EXTENDED_ADVERTISING_REPORT: Final = 0x0D
_LE_ADVERTISING_SET_TERMINATED: Final = 0x12

_EXTENDED_REPORT: Final = struct.Struct("<HB6sBBBbbHB6sB")
_LEGACY_REPORT: Final = struct.Struct("<BB6sB")
_LEGACY_BIT: Final = 0x0010


class DataStatus(enum.IntEnum):
    """Bits 5 and 6 of an extended report's event type."""

    COMPLETE = 0
    MORE_TO_COME = 1
    TRUNCATED = 2
    RESERVED = 3


@dataclass(frozen=True, slots=True)
class CommandResult:
    """Command Complete (7.7.14) or Command Status (7.7.15)."""

    opcode: int
    credit: int
    """Num_HCI_Command_Packets: number of commands that the controller accepts now."""
    status: int
    data: bytes = b""
    """The return parameters that follow the status."""


@dataclass(frozen=True, slots=True)
class HardwareError:
    """Hardware Error, section 7.7.16."""

    code: int


@dataclass(frozen=True, slots=True)
class SetTerminated:
    """LE Advertising Set Terminated (7.7.65.18)."""

    status: int
    handle: int
    events: int


@dataclass(frozen=True, slots=True)
class Report:
    """One report of an LE (Extended) Advertising Report event (7.7.65.2, 7.7.65.13)."""

    legacy: bool
    address: bytes
    """Address in wire order, lowest octet first."""
    sid: int
    rssi_dbm: float | None
    data_status: DataStatus
    data: bytes


@dataclass(frozen=True, slots=True)
class Reports:
    """All reports of one event."""

    reports: tuple[Report, ...]


HciEvent = CommandResult | HardwareError | SetTerminated | Reports


def parse_event(packet: bytes) -> HciEvent | None:
    """Parse an event that starts with its code. Return None for an event that is not used here.

    Raises:
        PeerDataError: the event is cut short, or its lengths disagree.
    """
    if len(packet) < 2 or len(packet) != 2 + packet[1]:
        raise PeerDataError(f"HCI event of {len(packet)} bytes differs from the length that it announces")
    code, body = packet[0], packet[2:]
    try:
        if code == _LE_META:
            return _parse_le_meta(body)
        if code == _COMMAND_COMPLETE:
            credit, opcode = struct.unpack_from("<BH", body)
            if opcode == Opcode.NOP:  # has no return parameters
                return CommandResult(opcode, credit, Status.SUCCESS)
            return CommandResult(opcode, credit, body[3], body[4:])
        if code == _COMMAND_STATUS:
            status, credit, opcode = struct.unpack("<BBH", body)
            return CommandResult(opcode, credit, status)
        if code == _HARDWARE_ERROR:
            return HardwareError(body[0])
    except (struct.error, IndexError) as error:
        raise PeerDataError(f"HCI event 0x{code:02x} of {len(body)} bytes is cut short") from error
    return None


def _parse_le_meta(body: bytes) -> HciEvent | None:
    subevent = body[0]
    if subevent == _LE_EXTENDED_ADVERTISING_REPORT:
        return Reports(_parse_extended_reports(body))
    if subevent == _LE_ADVERTISING_REPORT:
        return Reports(_parse_legacy_reports(body))
    if subevent == _LE_ADVERTISING_SET_TERMINATED:
        _, status, handle, _, events = struct.unpack("<BBBHB", body)
        return SetTerminated(status, handle, events)
    return None


def _parse_extended_reports(body: bytes) -> tuple[Report, ...]:
    reports = []
    offset = 2
    for _ in range(body[1]):
        kind, _, address, _, _, sid, _, rssi, _, _, _, length = _EXTENDED_REPORT.unpack_from(body, offset)
        offset += _EXTENDED_REPORT.size
        reports.append(
            Report(
                legacy=bool(kind & _LEGACY_BIT),
                address=address,
                sid=sid,
                rssi_dbm=None if rssi == UNKNOWN_RSSI else float(rssi),
                data_status=DataStatus(kind >> 5 & 0b11),
                data=_data(body, offset, length),
            )
        )
        offset += length
    _check_end(body, offset)
    return tuple(reports)


def _parse_legacy_reports(body: bytes) -> tuple[Report, ...]:
    reports = []
    offset = 2
    for _ in range(body[1]):
        _, _, address, length = _LEGACY_REPORT.unpack_from(body, offset)
        offset += _LEGACY_REPORT.size
        data = _data(body, offset, length)
        offset += length
        (rssi,) = struct.unpack_from("<b", body, offset)
        offset += 1
        rssi_dbm = None if rssi == UNKNOWN_RSSI else float(rssi)
        reports.append(Report(True, address, 0, rssi_dbm, DataStatus.COMPLETE, data))
    _check_end(body, offset)
    return tuple(reports)


def _data(body: bytes, offset: int, length: int) -> bytes:
    data = body[offset : offset + length]
    if len(data) != length:
        raise PeerDataError(f"report announces {length} bytes at offset {offset}, but holds {len(data)}")
    return data


def _check_end(body: bytes, offset: int) -> None:
    if offset != len(body):
        raise PeerDataError(f"{len(body) - offset} bytes after the last report of the event")


class H4Reader:
    """Splits a stream into HCI events.

    A byte that cannot start an event means that the stream is out of step. Bytes are then dropped up to the
    next one that looks like the start of an event which this host expects.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._in_step = True
        self.dropped = 0
        """Number of bytes that belonged to no event."""
        self.dropped_in_row = 0
        """Number of bytes dropped since the last complete event."""

    def feed(self, data: bytes) -> list[bytes]:
        """Return the events that are now complete, starting with their code."""
        buffer = self._buffer
        buffer += data
        events = []
        start = 0
        while len(buffer) - start >= 3:
            kind, code, length = buffer[start : start + 3]
            if not self._may_start(kind, code, length):
                self._in_step = False
                start += 1
                self.dropped += 1
                self.dropped_in_row += 1
                continue
            end = start + 3 + length
            if end > len(buffer):
                break
            events.append(bytes(buffer[start + 1 : end]))
            self._in_step = True
            self.dropped_in_row = 0
            start = end
        del buffer[:start]
        return events

    def _may_start(self, kind: int, code: int, length: int) -> bool:
        if kind != H4_EVENT:
            return False
        if self._in_step:
            return 0 < code <= _HIGHEST_CODE or code == _VENDOR
        return (code == _COMMAND_STATUS and length == 4) or (
            code in (_COMMAND_COMPLETE, _LE_META) and length >= 3
        )
