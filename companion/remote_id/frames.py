"""Remote ID payloads <-> the bytes that a radio sends and hears.

Byte-exact both ways (ASTM F3411-22a sections 5.4.5 to 5.4.8; Bluetooth Core vol. 3 part C section 11 for
advertising data; IEEE 802.11 sections 9.3.3 and 9.4.2 for beacons):

- BLE 4: AdvData of a legacy advertisement, 31 bytes, one message.
- BLE 5: AdvData of an extended advertisement on the Coded PHY, one pack.
- Wi-Fi Beacon: the whole management frame (no radiotap header, no FCS), one pack in a vendor element.

A reader walks every advertising structure or element, because Remote ID may stand behind others. A further
transport is one more `build_...`, one more `parse_...` and a line in `_PARSERS`.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

from companion.errors import PeerDataError
from companion.radio.transport import BLE4, BLE5, WIFI_BEACON
from companion.remote_id.codec import MESSAGE_SIZE, PACK_HEADER_SIZE, PACK_MAX_MESSAGES, PACK_TYPE

_SERVICE_DATA: Final = 0x16
_ASTM_UUID: Final = b"\xfa\xff"
"""0xFFFA, assigned to ASTM International, little-endian."""
_APPLICATION: Final = 0x0D
"""Open Drone ID among ASTM's applications."""
_SERVICE_HEAD: Final = _ASTM_UUID + bytes((_APPLICATION,))

_BEACON_SUBTYPE: Final = 0x80
_MAC_HEADER: Final = struct.Struct("<BBH6s6s6sH")
_BEACON_FIXED: Final = struct.Struct("<QHH")
_CAPABILITIES: Final = 0x0420
_BROADCAST: Final = b"\xff" * 6
_SSID_ELEMENT: Final = 0
_RATES_ELEMENT: Final = b"\x01\x01\x8c"
"""Supported rates: 6 Mb/s, mandatory."""
_VENDOR_ELEMENT: Final = 0xDD
_ASTM_OUI: Final = b"\xfa\x0b\xbc"
_VENDOR_HEAD: Final = _ASTM_OUI + bytes((_APPLICATION,))
_SSID_MAX: Final = 32
_ADDRESS: Final = re.compile("[0-9a-fA-F]{2}(?::[0-9a-fA-F]{2}){5}")
_FCS_SIZE: Final = 4


@dataclass(frozen=True, slots=True)
class Frame:
    """Remote ID as one frame carried it."""

    transport: str
    address: str | None
    """Transmitter, lower-case hex with colons; None where the frame's bytes do not hold it (BLE)."""
    counter: int
    """0-255; a repetition carries the same counter."""
    payload: bytes
    """A message or a pack, perhaps padded: for `codec.read_payload`."""


class NotRemoteIdError(PeerDataError):
    """A sound frame without Remote ID: most of what a radio hears, and no fault of the peer."""


def parse_frame(transport: str, data: bytes) -> Frame:
    """The Remote ID in what arrived on a transport.

    Raises NotRemoteIdError where the frame holds none, PeerDataError where it is broken, ValueError for an
    unknown transport.
    """
    parser = _PARSERS.get(transport)
    if parser is None:
        raise ValueError(f"transport is {transport!r}; allowed: {', '.join(_PARSERS)}")
    return parser(data)


# ---------------------------------------------------------------- Bluetooth


def build_ble4(message: bytes, counter: int) -> bytes:
    """The 31 bytes of AdvData for one 25-byte message. Raises ValueError."""
    if len(message) != MESSAGE_SIZE or message[0] >> 4 == PACK_TYPE:
        raise ValueError(f"payload of {len(message)} bytes; allowed on BLE 4: one message of {MESSAGE_SIZE}")
    return _service_data(message, counter)


def parse_ble4(data: bytes) -> Frame:
    """Remote ID in the AdvData of a legacy advertisement. Raises PeerDataError."""
    return _parse_advertising_data(BLE4, data)


def build_ble5(pack: bytes, counter: int) -> bytes:
    """AdvData of 9 + 25 N bytes for a pack of N messages. Raises ValueError."""
    return _service_data(_check_pack(pack), counter)


def parse_ble5(data: bytes) -> Frame:
    """Remote ID in the (reassembled) AdvData of an extended advertisement. Raises PeerDataError."""
    return _parse_advertising_data(BLE5, data)


def _service_data(payload: bytes, counter: int) -> bytes:
    content = _SERVICE_HEAD + bytes((_check_counter(counter),)) + payload
    return bytes((1 + len(content), _SERVICE_DATA)) + content


def _advertising_structures(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Offset, type and content of each structure; one that runs past the end raises PeerDataError."""
    offset = 0
    while offset < len(data) and data[offset]:  # a length of 0 ends the data early; what follows is padding
        end = offset + 1 + data[offset]
        if end > len(data):
            raise PeerDataError(
                f"advertising structure of {data[offset]} bytes at offset {offset} "
                f"runs past the end of {len(data)} bytes"
            )
        yield offset, data[offset + 1], data[offset + 2 : end]
        offset = end


def _parse_advertising_data(transport: str, data: bytes) -> Frame:
    for offset, kind, content in _advertising_structures(data):
        if kind == _SERVICE_DATA and content.startswith(_SERVICE_HEAD):
            return _frame(transport, None, content[len(_SERVICE_HEAD) :], offset)
    raise NotRemoteIdError("no Remote ID service data in the advertisement")


# ---------------------------------------------------------------- Wi-Fi Beacon


def build_beacon(
    pack: bytes, counter: int, address: str, *, ssid: str = "", interval_tu: int = 100, tsf_us: int = 0
) -> bytes:
    """The management frame, without FCS, of 51 + SSID + 25 N bytes. Raises ValueError.

    `interval_tu` is in units of 1024 us. The sequence number is 0: the transmitting driver numbers frames.
    """
    name = ssid.encode("utf-8")
    if len(name) > _SSID_MAX:
        raise ValueError(f"ssid is {ssid!r}; allowed: at most {_SSID_MAX} bytes")
    if not 0 < interval_tu <= 0xFFFF:
        raise ValueError(f"interval_tu is {interval_tu!r}; allowed: 1 to 65535")
    if not 0 <= tsf_us < 1 << 64:
        raise ValueError(f"tsf_us is {tsf_us!r}; allowed: 0 to 2**64 - 1")
    mac = _address_bytes(address)
    return b"".join(
        (
            _MAC_HEADER.pack(_BEACON_SUBTYPE, 0, 0, _BROADCAST, mac, mac, 0),
            _BEACON_FIXED.pack(tsf_us, interval_tu, _CAPABILITIES),
            bytes((_SSID_ELEMENT, len(name))),
            name,
            _RATES_ELEMENT,
            build_vendor_element(pack, counter),
        )
    )


def build_vendor_element(pack: bytes, counter: int) -> bytes:
    """The vendor element alone, for an access point that builds its own beacons. Raises ValueError."""
    content = _VENDOR_HEAD + bytes((_check_counter(counter),)) + _check_pack(pack)
    return bytes((_VENDOR_ELEMENT, len(content))) + content


def parse_beacon(data: bytes) -> Frame:
    """Remote ID in a beacon from its frame control on, with or without FCS. Raises PeerDataError."""
    if not data:
        raise PeerDataError("empty Wi-Fi frame")
    if data[0] != _BEACON_SUBTYPE:  # the second byte holds flags that do not matter here
        raise NotRemoteIdError(f"frame control 0x{data[0]:02x} is not a beacon's")
    elements_at = _MAC_HEADER.size + _BEACON_FIXED.size
    if len(data) < elements_at:
        raise PeerDataError(f"beacon of {len(data)} bytes, shorter than its {elements_at} fixed ones")
    source = _MAC_HEADER.unpack_from(data)[4]
    for offset, kind, content in _elements(data, elements_at):
        if kind == _VENDOR_ELEMENT and content.startswith(_VENDOR_HEAD):
            return _frame(WIFI_BEACON, source.hex(":"), content[len(_VENDOR_HEAD) :], offset)
    raise NotRemoteIdError("no Remote ID vendor element in the beacon")


def _elements(data: bytes, offset: int) -> Iterator[tuple[int, int, bytes]]:
    """Offset, ID and content of each element; one that runs past the end raises PeerDataError."""
    while offset + 2 <= len(data):
        end = offset + 2 + data[offset + 1]
        if end > len(data):
            if len(data) - offset <= _FCS_SIZE:
                return  # the frame check sequence that some receivers leave on
            raise PeerDataError(
                f"element 0x{data[offset]:02x} of {data[offset + 1]} bytes at offset {offset} "
                f"runs past the end of {len(data)} bytes"
            )
        yield offset, data[offset], data[offset + 2 : end]
        offset = end


# ---------------------------------------------------------------- common


def _frame(transport: str, address: str | None, content: bytes, offset: int) -> Frame:
    """Counter and payload, behind the head of the structure at `offset`."""
    if len(content) < 1 + PACK_HEADER_SIZE:
        raise PeerDataError(
            f"Remote ID at offset {offset} ends after {len(content)} bytes of counter and payload"
        )
    return Frame(transport=transport, address=address, counter=content[0], payload=content[1:])


def _check_counter(counter: int) -> int:
    if not 0 <= counter <= 0xFF:
        raise ValueError(f"counter is {counter!r}; allowed: 0 to 255")
    return counter


def _check_pack(pack: bytes) -> bytes:
    """The pack, where head and length agree."""
    sound = len(pack) > PACK_HEADER_SIZE and pack[0] >> 4 == PACK_TYPE and pack[1] == MESSAGE_SIZE
    if not sound or pack[2] > PACK_MAX_MESSAGES or len(pack) != PACK_HEADER_SIZE + pack[2] * MESSAGE_SIZE:
        raise ValueError(f"payload {pack.hex()}; allowed: a pack of 1 to {PACK_MAX_MESSAGES} messages")
    return pack


def _address_bytes(address: str) -> bytes:
    if not _ADDRESS.fullmatch(address):
        raise ValueError(f"address is {address!r}; allowed: six octets like 02:00:00:ab:cd:ef")
    return bytes.fromhex(address.replace(":", ""))


_PARSERS: Final[dict[str, Callable[[bytes], Frame]]] = {
    BLE4: parse_ble4,
    BLE5: parse_ble5,
    WIFI_BEACON: parse_beacon,
}


class Counters:
    """Message counters of one transmitter, steady per transport.

    On BLE 4 every message type has its own, elsewhere the pack has one. A counter steps by 1 when the content
    changes, and wraps from 255 to 0; so a receiver knows a repetition without comparing.
    """

    def __init__(self) -> None:
        self._last: dict[tuple[str, int], tuple[int, bytes]] = {}

    def next(self, transport: str, payload: bytes) -> int:
        """The counter to send with this payload (a message or a pack, not empty)."""
        key = (transport, payload[0] >> 4)
        last = self._last.get(key)
        if last is None:
            counter = 0
        elif last[1] == payload:
            return last[0]
        else:
            counter = (last[0] + 1) & 0xFF
        self._last[key] = (counter, payload)
        return counter
