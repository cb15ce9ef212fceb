"""Bluetooth HCI as bytes: addresses, error codes and commands. `controller_events` holds the events.

Bluetooth Core 5.4: vol. 4 part E section 7 (commands), vol. 4 part A (H4, the UART framing), vol. 1 part F
(error codes). All values are little-endian, including addresses.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

H4_COMMAND: Final = 0x01

MAX_FRAGMENT: Final = 251
"""Maximum bytes of advertising data in one LE Set Extended Advertising Data command."""
LEGACY_DATA_SIZE: Final = 31

_INTERVAL_100_MS: Final = 160
_ALL_CHANNELS: Final = 0x07
_RANDOM_ADDRESS: Final = 0x01
_NO_PREFERENCE: Final = 0x7F
_NONCONNECTABLE: Final = 0x03


class Opcode(enum.IntEnum):
    """OGF << 10 | OCF; sections 7.3, 7.4 and 7.8."""

    NOP = 0x0000
    SET_EVENT_MASK = 0x0C01
    RESET = 0x0C03
    READ_LOCAL_VERSION_INFORMATION = 0x1001
    READ_LOCAL_SUPPORTED_COMMANDS = 0x1002
    LE_SET_EVENT_MASK = 0x2001
    LE_READ_LOCAL_SUPPORTED_FEATURES = 0x2003
    LE_SET_RANDOM_ADDRESS = 0x2005
    LE_SET_ADVERTISING_PARAMETERS = 0x2006
    LE_SET_ADVERTISING_DATA = 0x2008
    LE_SET_ADVERTISING_ENABLE = 0x200A
    LE_SET_SCAN_PARAMETERS = 0x200B
    LE_SET_SCAN_ENABLE = 0x200C
    LE_SET_ADVERTISING_SET_RANDOM_ADDRESS = 0x2035
    LE_SET_EXTENDED_ADVERTISING_PARAMETERS = 0x2036
    LE_SET_EXTENDED_ADVERTISING_DATA = 0x2037
    LE_SET_EXTENDED_ADVERTISING_ENABLE = 0x2039
    LE_READ_MAXIMUM_ADVERTISING_DATA_LENGTH = 0x203A
    LE_READ_NUMBER_OF_SUPPORTED_ADVERTISING_SETS = 0x203B
    LE_SET_EXTENDED_SCAN_PARAMETERS = 0x2041
    LE_SET_EXTENDED_SCAN_ENABLE = 0x2042

    @property
    def words(self) -> str:
        """Name of the command in the standard."""
        return self.name.replace("_", " ").title().replace("Le ", "LE ").replace(" Of ", " of ")


class Phy(enum.IntEnum):
    """PHYs, section 7.8.53."""

    LE_1M = 1
    CODED = 3


class Status(enum.IntEnum):
    """Error codes that are used here; vol. 1 part F section 1.3."""

    SUCCESS = 0x00
    UNKNOWN_COMMAND = 0x01
    MEMORY_CAPACITY_EXCEEDED = 0x07
    COMMAND_DISALLOWED = 0x0C
    UNSUPPORTED_FEATURE = 0x11
    INVALID_PARAMETERS = 0x12
    UNSPECIFIED_ERROR = 0x1F
    ADVERTISING_TIMEOUT = 0x3C
    UNKNOWN_ADVERTISING_IDENTIFIER = 0x42
    LIMIT_REACHED = 0x43
    PACKET_TOO_LONG = 0x45


_STATUS_WORDS: Final = {
    Status.UNKNOWN_COMMAND: "Unknown HCI Command",
    Status.MEMORY_CAPACITY_EXCEEDED: "Memory Capacity Exceeded",
    Status.COMMAND_DISALLOWED: "Command Disallowed: legacy and extended commands were mixed, or it is busy",
    Status.UNSUPPORTED_FEATURE: "Unsupported Feature or Parameter Value",
    Status.INVALID_PARAMETERS: "Invalid HCI Command Parameters",
    Status.UNSPECIFIED_ERROR: "Unspecified Error",
    Status.ADVERTISING_TIMEOUT: "Advertising Timeout",
    Status.UNKNOWN_ADVERTISING_IDENTIFIER: "Unknown Advertising Identifier: the controller forgot its set",
    Status.LIMIT_REACHED: "Limit Reached",
    Status.PACKET_TOO_LONG: "Packet Too Long",
}


def status_words(status: int) -> str:
    """Describe an error code in words."""
    words = {int(code): text for code, text in _STATUS_WORDS.items()}.get(status)
    return words or f"error code 0x{status:02x}"


@dataclass(frozen=True, slots=True)
class HciCommand:
    """A command: its opcode, and the parameter bytes after opcode and length."""

    opcode: Opcode
    parameters: bytes = b""

    def packet(self) -> bytes:
        """Return the packet with the H4 type in front, as every channel expects it."""
        return struct.pack("<BHB", H4_COMMAND, self.opcode, len(self.parameters)) + self.parameters


def address_bytes(address: str) -> bytes:
    """Convert six octets with colons to wire order, lowest first. Raises ValueError."""
    octets = bytes.fromhex(address.replace(":", ""))
    if len(octets) != 6:
        raise ValueError(f"address is {address!r}; allowed: six octets like c2:00:00:ab:cd:ef")
    return octets[::-1]


def address_text(octets: bytes) -> str:
    """Convert wire octets to lower-case hex with colons, most significant octet first."""
    return octets[::-1].hex(":")


def event_mask() -> HciCommand:
    """Enable Hardware Error (bit 15) and LE Meta (bit 61); section 7.3.1."""
    return HciCommand(Opcode.SET_EVENT_MASK, struct.pack("<Q", 1 << 15 | 1 << 61))


def le_event_mask() -> HciCommand:
    """Enable advertising reports (bits 1 and 12) and Advertising Set Terminated (bit 17); section 7.8.1."""
    return HciCommand(Opcode.LE_SET_EVENT_MASK, struct.pack("<Q", 1 << 1 | 1 << 12 | 1 << 17))


def random_address(address: str) -> HciCommand:
    """Set the random address of the controller; section 7.8.4."""
    return HciCommand(Opcode.LE_SET_RANDOM_ADDRESS, address_bytes(address))


def set_parameters(handle: int, *, legacy: bool, phy: Phy) -> HciCommand:
    """Set up a non-connectable, non-scannable, undirected advertising set; section 7.8.53.

    Args:
        handle: Handle of the set; also its SID (0 to 15).
        legacy: True sends BLE 4 PDUs.
        phy: Primary and secondary PHY.
    """
    interval = _INTERVAL_100_MS.to_bytes(3, "little")
    return HciCommand(
        Opcode.LE_SET_EXTENDED_ADVERTISING_PARAMETERS,
        b"".join(
            (
                struct.pack("<BH", handle, 0x0010 if legacy else 0x0000),
                interval,
                interval,
                bytes((_ALL_CHANNELS, _RANDOM_ADDRESS)),
                bytes(7),  # no peer
                bytes(
                    (0, _NO_PREFERENCE, phy, 0, phy, handle, 0)
                ),  # filter, power, PHY, skip, PHY, SID, notice
            )
        ),
    )


def set_random_address(handle: int, address: str) -> HciCommand:
    """Set the random address of an advertising set; section 7.8.52."""
    return HciCommand(Opcode.LE_SET_ADVERTISING_SET_RANDOM_ADDRESS, bytes((handle,)) + address_bytes(address))


def set_data(handle: int, data: bytes) -> list[HciCommand]:
    """Return the commands that load advertising data, in fragments if it is long; section 7.8.54."""
    pieces = [data[start : start + MAX_FRAGMENT] for start in range(0, len(data), MAX_FRAGMENT)] or [b""]
    complete, first, middle, last = 3, 1, 0, 2
    operations = [complete] if len(pieces) == 1 else [first, *[middle] * (len(pieces) - 2), last]
    should_not_fragment = 1
    return [
        HciCommand(
            Opcode.LE_SET_EXTENDED_ADVERTISING_DATA,
            bytes((handle, operation, should_not_fragment, len(piece))) + piece,
        )
        for operation, piece in zip(operations, pieces, strict=True)
    ]


def set_enable(handle: int, max_events: int) -> HciCommand:
    """Advertise this many events (1 to 255), after which the set stops by itself; section 7.8.56."""
    return HciCommand(
        Opcode.LE_SET_EXTENDED_ADVERTISING_ENABLE, struct.pack("<BBBHB", 1, 1, handle, 0, max_events)
    )


def set_disable(handle: int) -> HciCommand:
    """Stop one advertising set."""
    return HciCommand(Opcode.LE_SET_EXTENDED_ADVERTISING_ENABLE, struct.pack("<BBBHB", 0, 1, handle, 0, 0))


def scan_parameters(phys: Sequence[Phy], interval: int, window: int) -> HciCommand:
    """Scan passively and accept all advertisers; section 7.8.64.

    `interval` and `window` are in units of 0.625 ms and apply to each PHY.
    """
    bits = sum(1 << (phy - 1) for phy in phys)
    return HciCommand(
        Opcode.LE_SET_EXTENDED_SCAN_PARAMETERS,
        bytes((_RANDOM_ADDRESS, 0, bits)) + struct.pack("<BHH", 0, interval, window) * len(phys),
    )


def scan_enable() -> HciCommand:
    """Scan without duplicate filter until disabled; section 7.8.65."""
    return HciCommand(Opcode.LE_SET_EXTENDED_SCAN_ENABLE, struct.pack("<BBHH", 1, 0, 0, 0))


def legacy_parameters() -> HciCommand:
    """Advertise ADV_NONCONN_IND from the random address, every 100 ms; section 7.8.5."""
    return HciCommand(
        Opcode.LE_SET_ADVERTISING_PARAMETERS,
        struct.pack("<HHBB", _INTERVAL_100_MS, _INTERVAL_100_MS, _NONCONNECTABLE, _RANDOM_ADDRESS)
        + bytes(7)
        + bytes((_ALL_CHANNELS, 0)),
    )


def legacy_data(data: bytes) -> HciCommand:
    """Set up to 31 bytes of advertising data; section 7.8.7."""
    return HciCommand(
        Opcode.LE_SET_ADVERTISING_DATA, bytes((len(data),)) + data.ljust(LEGACY_DATA_SIZE, b"\0")
    )


def legacy_enable(on: bool) -> HciCommand:
    """Switch legacy advertising on or off; section 7.8.9."""
    return HciCommand(Opcode.LE_SET_ADVERTISING_ENABLE, bytes((on,)))


def legacy_scan_parameters(interval: int, window: int) -> HciCommand:
    """Scan passively; section 7.8.10."""
    return HciCommand(
        Opcode.LE_SET_SCAN_PARAMETERS, struct.pack("<BHHBB", 0, interval, window, _RANDOM_ADDRESS, 0)
    )


def legacy_scan_enable() -> HciCommand:
    """Scan without duplicate filter; section 7.8.11."""
    return HciCommand(Opcode.LE_SET_SCAN_ENABLE, bytes((1, 0)))
