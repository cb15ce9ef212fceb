"""Script of commands that probes and sets up a Bluetooth controller, from after the Reset to the scan.

Bluetooth Core 5.4 vol. 4 part E: section 6.27 (supported commands), vol. 6 part B section 4.6 (LE features).
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, field
from typing import Final

from companion.errors import PeerDataError
from companion.radio.hci import packets
from companion.radio.hci.advertising import NAMES, LegacyCommands, SetCommands
from companion.radio.hci.packets import HciCommand, Opcode, Phy, Status, status_words
from companion.remote_id.codec import MESSAGE_SIZE, PACK_HEADER_SIZE, PACK_MAX_MESSAGES
from companion.remote_id.transports import BLE4, BLE5

_BLE5_OVERHEAD: Final = 6 + PACK_HEADER_SIZE
"""Bytes of advertising data in addition to the messages of a pack."""
_EXTENDED_FEATURE: Final = 1 << 12
_CODED_FEATURE: Final = 1 << 11
_EXTENDED_SEND: Final = ((36, 1), (36, 2), (36, 3), (36, 5), (36, 6), (36, 7))
"""Octet and bit of each command in the answer to Read Local Supported Commands."""
_EXTENDED_SCAN: Final = ((37, 5), (37, 6))
_LEGACY_SEND: Final = ((25, 5), (25, 7), (26, 1))
_LEGACY_SCAN: Final = ((26, 2), (26, 3))

_SCAN_INTERVAL: Final = 172
"""107.5 ms. This does not divide a second, so a sender at a whole rate in Hz cannot always fall into the same
gap."""
_HALF_WINDOW: Final = _SCAN_INTERVAL // 2
"""Scan window if two PHYs are scanned, each for half of the time."""

_MISSING: Final = f"{NAMES[BLE5]} is missing"


class RefusedError(Exception):
    """The controller answered a set-up command with an error."""

    def __init__(self, command: HciCommand, status: int) -> None:
        super().__init__(f"{command.opcode.words}: {status_words(status)}")
        self.status = status


@dataclass(slots=True)
class Abilities:
    """Abilities of a controller, and how it is set up."""

    extended: bool = False
    coded: bool = False
    max_data: int = packets.LEGACY_DATA_SIZE
    """Maximum bytes of advertising data in a set."""
    sets: dict[str, SetCommands | LegacyCommands] = field(default_factory=dict)
    """Commands that send on each transport."""
    hears: frozenset[str] = frozenset()
    scan_check: HciCommand | None = None
    """Command that this controller refuses while it scans (sections 7.8.10 and 7.8.64), and accepts if it no
    longer does, because it was reset; None if it does not scan or does not refuse."""
    missing: list[str] = field(default_factory=list)
    """One sentence for each function that needs other hardware."""

    @property
    def messages_per_pack(self) -> int:
        """Number of messages that fit into one BLE 5 advertisement."""
        return max(0, min(PACK_MAX_MESSAGES, (self.max_data - _BLE5_OVERHEAD) // MESSAGE_SIZE))


Script = Generator[HciCommand, bytes, None]


def set_up(address: str, *, send: bool, listen: bool) -> Generator[HciCommand, bytes, Abilities]:
    """Yield each command. The value sent back holds the return parameters after the status of its answer.

    The caller throws RefusedError into the generator if the status is an error. Raises RefusedError or
    PeerDataError if the controller cannot do what is required.
    """
    can = Abilities()
    yield HciCommand(Opcode.READ_LOCAL_VERSION_INFORMATION)
    commands = yield HciCommand(Opcode.READ_LOCAL_SUPPORTED_COMMANDS)
    try:
        features = _number((yield HciCommand(Opcode.LE_READ_LOCAL_SUPPORTED_FEATURES)), 8)
    except RefusedError as error:
        raise PeerDataError(f"this controller has no Bluetooth Low Energy ({error})") from error
    yield packets.event_mask()
    yield packets.le_event_mask()
    yield packets.random_address(address)
    needed = _EXTENDED_SEND * send + _EXTENDED_SCAN * listen
    can.extended = bool(features & _EXTENDED_FEATURE) and _has(commands, needed)
    can.coded = can.extended and bool(features & _CODED_FEATURE)
    if not can.coded:
        lacks = "Coded PHY" if can.extended else "Extended Advertising"
        can.missing.append(f"{_MISSING}: this controller has no LE {lacks}; use another controller")
    if send:
        yield from _set_up_extended(can, address) if can.extended else _set_up_legacy(can, commands)
    if listen:
        yield from _scan_extended(can) if can.extended else _scan_legacy(can, commands)
    return can


def _set_up_extended(can: Abilities, address: str) -> Script:
    sets = _number((yield HciCommand(Opcode.LE_READ_NUMBER_OF_SUPPORTED_ADVERTISING_SETS)), 1)
    can.max_data = _number((yield HciCommand(Opcode.LE_READ_MAXIMUM_ADVERTISING_DATA_LENGTH)), 2)
    plan = [(BLE4, 0, Phy.LE_1M)]
    if can.coded and can.messages_per_pack:
        plan.insert(0, (BLE5, 1, Phy.CODED))
    if can.coded and can.messages_per_pack < PACK_MAX_MESSAGES:
        can.missing.append(
            f"BLE 5 packs of {PACK_MAX_MESSAGES} messages are missing: this controller supports "
            f"{can.max_data} bytes of advertising data, {can.messages_per_pack} messages"
        )
    if sets < len(plan):
        can.missing.append(
            f"BLE 4 together with BLE 5 Long Range is missing: it needs 2 advertising sets, here: {sets}"
        )
    for transport, handle, phy in plan[:sets]:
        try:
            yield packets.set_parameters(handle, legacy=transport == BLE4, phy=phy)
            yield packets.set_random_address(handle, address)
        except RefusedError as error:
            can.missing.append(f"{NAMES[transport]} is missing: this controller refuses {error}")
        else:
            can.sets[transport] = SetCommands(handle)
    if not can.sets:
        raise PeerDataError("nothing can be sent: " + "; ".join(can.missing))


def _set_up_legacy(can: Abilities, commands: bytes) -> Script:
    if not _has(commands, _LEGACY_SEND):
        raise PeerDataError("this controller cannot advertise; use another, or set send = false")
    yield packets.legacy_parameters()
    can.sets[BLE4] = LegacyCommands()


def _scan_extended(can: Abilities) -> Script:
    if can.coded:
        parameters = packets.scan_parameters((Phy.LE_1M, Phy.CODED), _SCAN_INTERVAL, _HALF_WINDOW)
    else:
        parameters = packets.scan_parameters((Phy.LE_1M,), _SCAN_INTERVAL, _SCAN_INTERVAL)
    yield parameters
    yield packets.scan_enable()
    yield from _find_scan_check(can, parameters)
    can.hears = frozenset((BLE4, BLE5) if can.coded else (BLE4,))


def _scan_legacy(can: Abilities, commands: bytes) -> Script:
    if not _has(commands, _LEGACY_SCAN):
        raise PeerDataError("this controller cannot scan; use another, or set listen = false")
    parameters = packets.legacy_scan_parameters(_SCAN_INTERVAL, _SCAN_INTERVAL)
    yield parameters
    yield packets.legacy_scan_enable()
    yield from _find_scan_check(can, parameters)
    can.hears = frozenset((BLE4,))


def _find_scan_check(can: Abilities, parameters: HciCommand) -> Script:
    """Learn whether the controller refuses scan parameters while it scans, as the standard requires."""
    try:
        yield parameters
    except RefusedError as error:
        if error.status == Status.COMMAND_DISALLOWED:
            can.scan_check = parameters


def _has(commands: bytes, bits: Sequence[tuple[int, int]]) -> bool:
    return all(octet < len(commands) and commands[octet] >> bit & 1 for octet, bit in bits)


def _number(data: bytes, size: int) -> int:
    """Decode a return parameter. Raises PeerDataError if it is cut short."""
    if len(data) < size:
        raise PeerDataError(f"an answer of {len(data)} bytes during set-up; expected {size}")
    return int.from_bytes(data[:size], "little")
