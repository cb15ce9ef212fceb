"""Converts between Remote ID payloads and the bytes that a radio sends and receives.

Both directions are byte-exact (ASTM F3411-22a sections 5.4.5 to 5.4.8; Bluetooth Core vol. 3 part C section
11 for advertising data; IEEE 802.11 sections 9.3.3 and 9.4.2 for beacons; Wi-Fi Alliance, Neighbor Awareness
Networking, for service discovery):

- BLE 4: AdvData of a legacy advertisement, 31 bytes, one message.
- BLE 5: AdvData of an extended advertisement on the Coded PHY, one pack.
- Wi-Fi Beacon: the whole management frame (no radiotap header, no FCS), one pack in a vendor element.
- Wi-Fi NAN: the service discovery action frame, one pack in a service descriptor. A transmitter also sends a
  synchronisation beacon, which holds no Remote ID.

A reader walks through every structure, element or attribute, because Remote ID may follow others or occur
more than once. If one is truncated, whatever follows it cannot be found, but everything before it is
returned. A truncated Remote ID structure is returned as far as it was received; `codec.read_payload` reports
what its payload lacks.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

from companion.errors import PeerDataError
from companion.remote_id.codec import MESSAGE_SIZE, PACK_HEADER_SIZE, PACK_MAX_MESSAGES, PACK_TYPE
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON, WIFI_NAN

_SERVICE_DATA: Final = 0x16
_ASTM_UUID: Final = b"\xfa\xff"
"""0xFFFA, assigned to ASTM International, little-endian."""
_APPLICATION: Final = 0x0D
"""Open Drone ID, one of ASTM's application codes."""
_SERVICE_DATA_HEAD: Final = bytes((_SERVICE_DATA,)) + _ASTM_UUID + bytes((_APPLICATION,))

_BEACON: Final = 0x80
_PROBE_RESPONSE: Final = 0x50
_ACTION: Final = 0xD0
_ORDER: Final = 0x80
"""Flag in the second byte of a management frame: four bytes of HT Control follow the header."""
_HT_CONTROL_SIZE: Final = 4
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

_NAN_GROUP: Final = b"\x51\x6f\x9a\x01\x00\x00"
"""Destination address of the NAN action frames."""
_NAN_CLUSTER: Final = b"\x50\x6f\x9a\x01\x00\xff"
_NAN_HEAD: Final = b"\x50\x6f\x9a\x13"
"""OUI of the Wi-Fi Alliance and its type number for NAN."""
_NAN_ACTION_HEAD: Final = b"\x04\x09" + _NAN_HEAD
"""Category public action, action vendor specific."""
_NAN_SERVICE_ID: Final = bytes.fromhex("8869199d9209")
"""First bytes of the SHA-256 of "org.opendroneid.remoteid"."""
_NAN_INTERVAL_TU: Final = 512
_MASTER_PREFERENCE: Final = 0xFE
_RANDOM_FACTOR: Final = 0xEA
_MASTER_INDICATION, _CLUSTER, _SERVICE_IDS, _SERVICE_DESCRIPTOR, _DESCRIPTOR_EXTENSION = 0, 1, 2, 3, 0x0E
_INSTANCE: Final = 1
_DESCRIPTOR_FIXED: Final = struct.Struct("<6sBBB")
"""Service ID, instance ID, requestor instance ID, service control."""
_MATCHING_FILTER, _RESPONSE_FILTER, _SERVICE_INFO, _BINDING_BITMAP = 0x04, 0x08, 0x10, 0x40
"""Service control bits that indicate further parts of the descriptor."""
_UPDATE_INDICATOR: Final = 0x0200
"""Extension control bit: a service update indicator follows."""


class Frame(NamedTuple):
    """One Remote ID structure, as received in a frame."""

    transport: str
    address: str | None
    """Address of the transmitter, lower-case hex with colons; None if the frame does not hold it (BLE)."""
    counter: int
    """Message counter, 0-255. A repetition carries the same counter."""
    payload: bytes
    """A message or a pack, possibly padded or truncated, as input for `codec.read_payload`."""


class NotRemoteIdError(PeerDataError):
    """A valid frame without Remote ID. Most received frames are of this kind; it is no fault of the peer."""


class NanSyncBeaconError(NotRemoteIdError):
    """The synchronisation beacon of a NAN transmitter of Remote ID. It holds no Remote ID itself."""

    def __init__(self, address: str) -> None:
        super().__init__(f"NAN synchronisation beacon of {address}")
        self.address = address


def parse_frames(transport: str, data: bytes) -> tuple[Frame, ...]:
    """Return every Remote ID structure (at least one, usually just one) of a frame received on a transport.

    Raises NotRemoteIdError if the frame holds none for that transport, PeerDataError if it is broken,
    ValueError for an unknown transport.
    """
    parser = _PARSERS.get(transport)
    if parser is None:
        raise ValueError(f"transport is {transport!r}; allowed: {', '.join(_PARSERS)}")
    frames = parser(data)
    if frames[0].transport != transport:
        raise NotRemoteIdError(f"Remote ID of transport {frames[0].transport}, not {transport}")
    return frames


def parse_frame(transport: str, data: bytes) -> Frame:
    """Return the first result of `parse_frames`. Raises the same errors."""
    return parse_frames(transport, data)[0]


# ---------------------------------------------------------------- Bluetooth


def build_ble4(message: bytes, counter: int) -> bytes:
    """Build the 31 bytes of AdvData for one 25-byte message. Raises ValueError."""
    if len(message) != MESSAGE_SIZE or message[0] >> 4 == PACK_TYPE:
        raise ValueError(f"payload of {len(message)} bytes; allowed on BLE 4: one message of {MESSAGE_SIZE}")
    return _service_data(message, counter)


def build_ble5(pack: bytes, counter: int) -> bytes:
    """Build AdvData of 9 + 25 N bytes for a pack of N messages. Raises ValueError."""
    return _service_data(_check_pack(pack), counter)


def _service_data(payload: bytes, counter: int) -> bytes:
    structure = _SERVICE_DATA_HEAD + bytes((_check_counter(counter),)) + payload
    return bytes((len(structure),)) + structure


def _parse_advertising_data(transport: str, data: bytes) -> tuple[Frame, ...]:
    """Find Remote ID in AdvData. AdvData received in several PDUs must be reassembled before."""
    found = []
    fault = None
    offset = 0
    while offset < len(data) and data[offset]:  # a length of 0 ends the data early; the rest is padding
        end = offset + 1 + data[offset]
        if end > len(data):
            fault = _torn("advertising structure", data[offset], offset, len(data))
        structure = data[offset + 1 : end]
        if structure.startswith(_SERVICE_DATA_HEAD):
            found.append(structure[len(_SERVICE_DATA_HEAD) :])
        offset = end
    return _frames(transport, None, found, fault)


# ---------------------------------------------------------------- Wi-Fi


def parse_wifi(data: bytes) -> Frame:
    """Return the first result of `parse_wifi_frames`. Raises the same errors."""
    return parse_wifi_frames(data)[0]


def parse_wifi_frames(data: bytes) -> tuple[Frame, ...]:
    """Return every Remote ID structure (at least one) of an 802.11 frame that starts at frame control.

    Reads beacons and probe responses (transport `WIFI_BEACON`) and NAN action frames (`WIFI_NAN`), with or
    without FCS. Raises NotRemoteIdError if the frame holds none, its subclass NanSyncBeaconError for the
    synchronisation beacon of a NAN transmitter, and PeerDataError if the frame is broken.
    """
    if len(data) < 2:
        raise PeerDataError(f"Wi-Fi frame of {len(data)} bytes")
    kind, flags = data[0], data[1]  # the other flags are irrelevant here
    if kind not in (_BEACON, _PROBE_RESPONSE, _ACTION):
        raise NotRemoteIdError(f"frame control 0x{kind:02x} is not of a kind that carries Remote ID")
    body_at = _MAC_HEADER.size + (_HT_CONTROL_SIZE if flags & _ORDER else 0)
    if len(data) < body_at:
        raise PeerDataError(f"Wi-Fi frame of {len(data)} bytes, shorter than its header of {body_at}")
    address = _MAC_HEADER.unpack_from(data)[4].hex(":")
    if kind == _ACTION:
        return _parse_action(data, body_at, address)
    return _parse_elements(data, body_at + _BEACON_FIXED.size, address)


def _type_length_content(
    data: bytes, offset: int, length_size: int, what: str
) -> tuple[list[tuple[int, bytes]], str | None]:
    """Return type and content of every element or attribute, and a text about a truncated one.

    The content of a truncated one is returned as far as it goes.
    """
    found = []
    head = 1 + length_size
    while offset + head <= len(data):
        size = int.from_bytes(data[offset + 1 : offset + head], "little")
        end = offset + head + size
        if end > len(data) and len(data) - offset <= _FCS_SIZE:
            break  # the frame check sequence, which some receivers do not remove
        found.append((data[offset], data[offset + head : end]))
        if end > len(data):
            return found, _torn(f"{what} 0x{data[offset]:02x}", size, offset, len(data))
        offset = end
    return found, None


# ---------------------------------------------------------------- Wi-Fi Beacon


def build_beacon(
    pack: bytes, counter: int, address: str, *, ssid: str = "", interval_tu: int = 100, tsf_us: int = 0
) -> bytes:
    """Build the beacon frame, without FCS, of 51 + SSID + 25 N bytes. Raises ValueError.

    `interval_tu` is in units of 1024 us. The sequence number is 0, because the transmitting driver numbers
    frames.
    """
    name = ssid.encode("utf-8")
    if len(name) > _SSID_MAX:
        raise ValueError(f"ssid is {ssid!r}; allowed: at most {_SSID_MAX} bytes")
    if not 0 < interval_tu <= 0xFFFF:
        raise ValueError(f"interval_tu is {interval_tu!r}; allowed: 1 to 65535")
    mac = address_bytes(address)
    return b"".join(
        (
            _beacon_head(mac, mac, tsf_us, interval_tu),
            bytes((_SSID_ELEMENT, len(name))),
            name,
            _RATES_ELEMENT,
            build_vendor_element(pack, counter),
        )
    )


def build_vendor_element(pack: bytes, counter: int) -> bytes:
    """Build the vendor element alone, for an access point that builds its own beacons. Raises ValueError."""
    content = _VENDOR_HEAD + bytes((_check_counter(counter),)) + _check_pack(pack)
    return bytes((_VENDOR_ELEMENT, len(content))) + content


def _beacon_head(source: bytes, bssid: bytes, tsf_us: int, interval_tu: int) -> bytes:
    if not 0 <= tsf_us < 1 << 64:
        raise ValueError(f"tsf_us is {tsf_us!r}; allowed: 0 to 2**64 - 1")
    header = _MAC_HEADER.pack(_BEACON, 0, 0, _BROADCAST, source, bssid, 0)
    return header + _BEACON_FIXED.pack(tsf_us, interval_tu, _CAPABILITIES)


def _parse_elements(data: bytes, offset: int, address: str) -> tuple[Frame, ...]:
    if len(data) < offset:
        raise PeerDataError(f"beacon of {len(data)} bytes, shorter than its {offset} fixed ones")
    elements, fault = _type_length_content(data, offset, 1, "element")
    vendor = [content for kind, content in elements if kind == _VENDOR_ELEMENT]
    found = [content[len(_VENDOR_HEAD) :] for content in vendor if content.startswith(_VENDOR_HEAD)]
    if not found and any(map(_announces_remote_id, vendor)):
        raise NanSyncBeaconError(address)
    return _frames(WIFI_BEACON, address, found, fault)


# ---------------------------------------------------------------- Wi-Fi NAN


def build_nan_action(pack: bytes, counter: int, address: str) -> bytes:
    """Build the service discovery action frame, without FCS, of 54 + 25 N bytes. Raises ValueError.

    The sequence number is 0, because the transmitting driver numbers frames.
    """
    info = bytes((_check_counter(counter),)) + _check_pack(pack)
    descriptor = _DESCRIPTOR_FIXED.pack(_NAN_SERVICE_ID, _INSTANCE, 0, _SERVICE_INFO)
    return b"".join(
        (
            _MAC_HEADER.pack(_ACTION, 0, 0, _NAN_GROUP, address_bytes(address), _NAN_CLUSTER, 0),
            _NAN_ACTION_HEAD,
            _attribute(_SERVICE_DESCRIPTOR, descriptor + bytes((len(info),)) + info),
            _attribute(_DESCRIPTOR_EXTENSION, struct.pack("<BHB", _INSTANCE, _UPDATE_INDICATOR, counter)),
        )
    )


def build_nan_sync_beacon(address: str, tsf_us: int = 0) -> bytes:
    """Build the synchronisation beacon, 72 bytes without FCS, of a cluster whose anchor master we are.

    It must be sent every 512 TU in addition to the action frames. Otherwise receivers do not wake up for
    them. `tsf_us` is the sender's clock, which most drivers fill in themselves. Raises ValueError.
    """
    mac = address_bytes(address)
    rank = mac + bytes((_RANDOM_FACTOR, _MASTER_PREFERENCE))
    hops_and_anchor_time = bytes(1 + 4)  # both 0: we are the anchor master
    content = b"".join(
        (
            _NAN_HEAD,
            _attribute(_MASTER_INDICATION, bytes((_MASTER_PREFERENCE, _RANDOM_FACTOR))),
            _attribute(_CLUSTER, rank + hops_and_anchor_time),
            _attribute(_SERVICE_IDS, _NAN_SERVICE_ID),
        )
    )
    head = _beacon_head(mac, _NAN_CLUSTER, tsf_us, _NAN_INTERVAL_TU)
    return head + bytes((_VENDOR_ELEMENT, len(content))) + content


def _attribute(kind: int, content: bytes) -> bytes:
    return struct.pack("<BH", kind, len(content)) + content


def _announces_remote_id(vendor: bytes) -> bool:
    """Whether a vendor element belongs to NAN and lists the Remote ID service."""
    if not vendor.startswith(_NAN_HEAD):
        return False
    attributes, _ = _type_length_content(vendor, len(_NAN_HEAD), 2, "attribute")
    return any(
        kind == _SERVICE_IDS and _NAN_SERVICE_ID in (content[at : at + 6] for at in range(0, len(content), 6))
        for kind, content in attributes
    )


def _parse_action(data: bytes, offset: int, address: str) -> tuple[Frame, ...]:
    if data[offset : offset + len(_NAN_ACTION_HEAD)] != _NAN_ACTION_HEAD:
        raise NotRemoteIdError("an action frame, but not a NAN frame")
    attributes, fault = _type_length_content(data, offset + len(_NAN_ACTION_HEAD), 2, "attribute")
    infos = [_service_info(content) for kind, content in attributes if kind == _SERVICE_DESCRIPTOR]
    return _frames(WIFI_NAN, address, [info for info in infos if info is not None], fault)


def _service_info(descriptor: bytes) -> bytes | None:
    """Return the service info of a descriptor.

    None if the descriptor belongs to another service or holds no service info (a subscriber).
    """
    if len(descriptor) < _DESCRIPTOR_FIXED.size:
        return None
    service, _, _, control = _DESCRIPTOR_FIXED.unpack_from(descriptor)
    if service != _NAN_SERVICE_ID or not control & _SERVICE_INFO:
        return None
    at = _DESCRIPTOR_FIXED.size + (2 if control & _BINDING_BITMAP else 0)
    for part in (_MATCHING_FILTER, _RESPONSE_FILTER):
        if control & part:
            at += 1 + _length(descriptor, at)
    return descriptor[at + 1 : at + 1 + _length(descriptor, at)]


def _length(data: bytes, at: int) -> int:
    """Return a length byte; 0 if it was cut off."""
    return data[at] if at < len(data) else 0


# ---------------------------------------------------------------- common


def _torn(what: str, size: int, offset: int, total: int) -> str:
    return f"{what} of {size} bytes at offset {offset} runs past the end of {total} bytes"


def _frames(
    transport: str, address: str | None, found: Sequence[bytes], fault: str | None
) -> tuple[Frame, ...]:
    """Return the frames of the structures found. Raises an error that says why there are none."""
    frames = tuple(
        Frame(transport=transport, address=address, counter=content[0], payload=content[1:])
        for content in found
        if len(content) > 1
    )
    if frames:
        return frames
    if found:
        raise PeerDataError(fault or "Remote ID without a payload")
    if fault:
        raise PeerDataError(fault)
    raise NotRemoteIdError("no Remote ID in the frame")


def _check_counter(counter: int) -> int:
    if not 0 <= counter <= 0xFF:
        raise ValueError(f"counter is {counter!r}; allowed: 0 to 255")
    return counter


def _check_pack(pack: bytes) -> bytes:
    """Return the pack if its header and length agree; raise ValueError otherwise."""
    sound = len(pack) > PACK_HEADER_SIZE and pack[0] >> 4 == PACK_TYPE and pack[1] == MESSAGE_SIZE
    if not sound or pack[2] > PACK_MAX_MESSAGES or len(pack) != PACK_HEADER_SIZE + pack[2] * MESSAGE_SIZE:
        raise ValueError(f"payload {pack.hex()}; allowed: a pack of 1 to {PACK_MAX_MESSAGES} messages")
    return pack


def address_bytes(address: str) -> bytes:
    """Convert a radio address to its six octets. Raises ValueError."""
    if not _ADDRESS.fullmatch(address):
        raise ValueError(f"address is {address!r}; allowed: six octets like 02:00:00:ab:cd:ef")
    return bytes.fromhex(address.replace(":", ""))


_PARSERS: Final[dict[str, Callable[[bytes], tuple[Frame, ...]]]] = {
    BLE4: lambda data: _parse_advertising_data(BLE4, data),
    BLE5: lambda data: _parse_advertising_data(BLE5, data),
    WIFI_BEACON: parse_wifi_frames,
    WIFI_NAN: parse_wifi_frames,
}


class Counters:
    """Message counters of one transmitter, kept per transport.

    On BLE 4 every message type has its own counter; elsewhere the pack has one. A counter increases by 1 when
    the content changes, and wraps from 255 to 0. A receiver can therefore recognise a repetition without
    comparing contents.
    """

    def __init__(self) -> None:
        self._last: dict[tuple[str, int], tuple[int, bytes]] = {}

    def next(self, transport: str, payload: bytes) -> int:
        """Return the counter to send with this payload (a message or a pack, not empty)."""
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
