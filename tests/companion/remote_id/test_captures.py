"""Real frames of real transmitters, against what the reference decoder made of them.

The captures hold true serial numbers and positions, so they stay outside the project, beside the checkout.
"""

from __future__ import annotations

import contextlib
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from companion.errors import PeerDataError
from companion.radio.transport import BLE5, WIFI_BEACON
from companion.remote_id.codec import decode_pack, decode_payload
from companion.remote_id.frames import Frame, NotRemoteIdError, build_vendor_element, parse_frame
from companion.remote_id.vector_fields import as_received, message_of

FOLDER = Path(__file__).resolve().parents[4] / "shared" / "data" / "remote_id"
DECODED = FOLDER / "captures_decoded.json"

pytestmark = pytest.mark.skipif(
    not DECODED.is_file(), reason=f"real captures are not here: {DECODED} is missing"
)

BEACONS = [
    "wifi_beacon_esp32.pcap",
    "wifi_nan_and_beacon_esp32.pcap",
    "wifi_beacon_dji_air3.pcapng",
    "wifi_beacon_hostapd.pcapng",
]
LONG_RANGE = "bt5_long_range_aux_adv.pcapng"


def packets(path: Path) -> Iterator[bytes]:
    """Packets of a little-endian pcap or pcapng file."""
    data = path.read_bytes()
    if data[:4] == b"\xd4\xc3\xb2\xa1":
        offset = 24
        while offset < len(data):
            size = struct.unpack_from("<I", data, offset + 8)[0]
            yield data[offset + 16 : offset + 16 + size]
            offset += 16 + size
        return
    offset = 0
    while offset < len(data):
        kind, length = struct.unpack_from("<II", data, offset)
        if kind == 6:  # enhanced packet block
            size = struct.unpack_from("<I", data, offset + 20)[0]
            yield data[offset + 28 : offset + 28 + size]
        offset += length


def expected(name: str) -> list[dict[str, Any]]:
    frames: list[dict[str, Any]] = json.loads(DECODED.read_text())["captures"][name]
    return frames


def after_radiotap(packet: bytes) -> bytes:
    return packet[struct.unpack_from("<H", packet, 2)[0] :]


def advertising_data(packet: bytes) -> bytes:
    """AdvData behind the sniffer's head (17), access address (4), coding (1), PDU head (2), extended head."""
    extended = 24
    return packet[extended + 1 + (packet[extended] & 0x3F) : -3]


def check_messages(frame: Frame, entry: dict[str, Any]) -> None:
    assert frame.counter == entry["counter"]
    assert frame.payload.hex() == entry["payload_hex"]
    if not entry["accepted"]:
        with pytest.raises(PeerDataError):
            decode_pack(frame.payload)
        return
    wanted = tuple(message_of(item["type"], as_received(item["fields"])) for item in entry["messages"])
    assert decode_pack(frame.payload) == wanted
    assert decode_payload(frame.payload) == wanted


@pytest.mark.parametrize("name", BEACONS)
def test_beacons(name: str) -> None:
    entries = expected(name)
    frames = list(packets(FOLDER / name))
    assert len(frames) == len(entries)
    read = 0
    for packet, entry in zip(frames, entries, strict=True):
        data = after_radiotap(packet)
        if entry.get("transport") != "wifi_beacon":
            with pytest.raises(NotRemoteIdError):
                parse_frame(WIFI_BEACON, data)
            continue
        frame = parse_frame(WIFI_BEACON, data)
        assert frame.address == entry["mac"]
        check_messages(frame, entry)
        assert build_vendor_element(frame.payload, frame.counter) in data
        read += 1
    assert read


def test_long_range_advertisements() -> None:
    entries = expected(LONG_RANGE)
    frames = list(packets(FOLDER / LONG_RANGE))
    assert len(frames) == len(entries)
    sound = empty = 0
    for packet, entry in zip(frames, entries, strict=True):
        data = advertising_data(packet)
        if not entry["crc_ok"]:  # a receiver drops these; should one get through, it breaks nothing
            with contextlib.suppress(PeerDataError):
                decode_payload(parse_frame(BLE5, data).payload)
            continue
        frame = parse_frame(BLE5, data)
        assert frame.address is None
        check_messages(frame, entry)
        sound += 1
        if not entry["accepted"]:
            assert decode_payload(frame.payload) == ()
            empty += 1
    assert (sound, empty) == (244, 19)
