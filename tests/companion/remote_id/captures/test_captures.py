"""Remote ID in captures: real ones against the reference decoder, and made ones that anybody can run.

The real captures hold true serial numbers and positions, so they stay outside the project, beside the
checkout. Where our reading differs from the reference, on purpose:

- A frame with a bad CRC is reported and left alone; the reference decodes it, and accepts some.
- A pack that announces no messages is an empty one; the reference refuses it.
- A value that the standard does not allow is unknown (`as_received`); the reference gives the number.
"""

from __future__ import annotations

import io
import json
import struct
from collections import Counter
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any

import dpkt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import ConfigError, PeerDataError
from companion.remote_id.captures.remote_id_frames import CapturedFrame, Kind, read_capture
from companion.remote_id.codec import decode_pack, encode, encode_pack
from companion.remote_id.conformance.vector_fields import as_received, message_of
from companion.remote_id.frames import (
    build_beacon,
    build_ble4,
    build_ble5,
    build_nan_action,
    build_nan_sync_beacon,
    build_vendor_element,
)
from companion.remote_id.messages import Location, OperatorId, SelfId
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON, WIFI_NAN

# ---------------------------------------------------------------- real ones

FOLDER = Path(__file__).resolve().parents[5] / "shared" / "data" / "remote_id"
DECODED = FOLDER / "captures_decoded.json"
REAL: dict[str, Counter[Kind]] = {
    "bt5_long_range_aux_adv.pcapng": Counter({Kind.REMOTE_ID: 244, Kind.BAD_CRC: 30}),
    "wifi_beacon_dji_air3.pcapng": Counter({Kind.REMOTE_ID: 9, Kind.FOREIGN: 3}),
    "wifi_beacon_esp32.pcap": Counter({Kind.REMOTE_ID: 21}),
    "wifi_beacon_hostapd.pcapng": Counter({Kind.REMOTE_ID: 21}),
    "wifi_nan_and_beacon_esp32.pcap": Counter({Kind.REMOTE_ID: 42, Kind.SYNC_BEACON: 21}),
}
TRANSPORTS = {"ble_extended": BLE5, "wifi_beacon": WIFI_BEACON, "wifi_nan_action": WIFI_NAN}


@pytest.mark.skipif(not DECODED.is_file(), reason=f"real captures are not here: {DECODED} is missing")
@pytest.mark.parametrize("name", REAL)
def test_a_real_capture_reads_as_the_reference_does(name: str) -> None:
    entries: list[dict[str, Any]] = json.loads(DECODED.read_text())["captures"][name]
    with (FOLDER / name).open("rb") as stream:
        captured = list(read_capture(stream, name))
    assert Counter(frame.kind for frame in captured) == REAL[name]
    for frame, entry in zip(captured, entries, strict=True):
        assert frame.number == entry["frame"]
        assert frame.time_ns == Decimal(entry["time_epoch"]) * 1_000_000_000
        if "rssi_dbm" in entry:
            assert (frame.rssi_dbm, frame.crc_ok) == (entry["rssi_dbm"], entry["crc_ok"])
        check_content(frame, entry)


def check_content(frame: CapturedFrame, entry: dict[str, Any]) -> None:
    if frame.kind is Kind.BAD_CRC:
        assert not entry["crc_ok"]
        assert (frame.address, frame.payload, frame.messages) == (None, None, ())
    elif frame.kind is Kind.FOREIGN:
        assert "transport" not in entry
    elif frame.kind is Kind.SYNC_BEACON:
        assert (entry["transport"], entry["mac"]) == ("wifi_nan_sync_beacon", frame.address)
    else:
        assert frame.payload is not None
        assert frame.transport == TRANSPORTS[entry["transport"]]
        assert (frame.address, frame.counter) == (entry["mac"], entry["counter"])
        assert frame.payload.hex() == entry["payload_hex"]
        assert frame.faults == ()
        if entry["accepted"]:
            items = entry["messages"]
            expected = tuple(message_of(item["type"], as_received(item["fields"])) for item in items)
            assert frame.messages == expected == decode_pack(frame.payload)
        else:
            assert frame.messages == ()
            with pytest.raises(PeerDataError, match="0 messages"):
                decode_pack(frame.payload)


# ---------------------------------------------------------------- made ones

ADDRESS = "c2:01:02:03:04:05"
TEXT = SelfId(description_type=0, text="survey")
OPERATOR = OperatorId(operator_id_type=0, operator_id="FIN87astrdge12k8")
PACK = encode_pack((TEXT, OPERATOR, Location()))
ON_AIR_ADDRESS = bytes.fromhex(ADDRESS.replace(":", ""))[::-1]


def crc(pdu: bytes) -> bytes:
    """Bluetooth Core vol. 6 part B section 3.1.1, as drawn there: bits in, register of 24."""
    register = 0x555555
    for bit in (byte >> n & 1 for byte in pdu for n in range(8)):
        feedback = register >> 23 ^ bit
        register = register << 1 & 0xFFFFFF
        register ^= 0x00065B if feedback else 0
    sent = [register >> n & 1 for n in range(23, -1, -1)]
    return bytes(sum(bit << n for n, bit in enumerate(sent[at : at + 8])) for at in (0, 8, 16))


def legacy(data: bytes, kind: int = 2, address: bytes = ON_AIR_ADDRESS) -> bytes:
    """PDU of a legacy advertisement."""
    return bytes((0x40 | kind, len(address + data))) + address + data


def extended(data: bytes, header: bytes = b"\x09" + ON_AIR_ADDRESS + b"\x34\x12") -> bytes:
    """PDU of an AUX_ADV_IND; its header usually holds address and ADI."""
    content = bytes((len(header),)) + header + data
    return bytes((0x47, len(content))) + content


def link_layer(pdu: bytes, *, coded: bool = False, access: str = "d6be898e") -> bytes:
    return bytes.fromhex(access) + (b"\x00" if coded else b"") + pdu + crc(pdu)


def nordic(packet: bytes, *, flags: int = 0x01, version: int = 3, kind: int = 2, channel: int = 37) -> bytes:
    size = 10 + len(packet)
    lengths = bytes((6, size)) if version == 1 else struct.pack("<H", size)
    head = bytes((3,)) + lengths + struct.pack("<BHB", version, 7, kind)
    return head + bytes((10, flags, channel, 61)) + bytes(6) + packet


def pseudo(packet: bytes, *, flags: int = 0x0C03) -> bytes:
    return struct.pack("<BbbB4sH", 37, -61, 0, 0, b"\xd6\xbe\x89\x8e", flags) + packet


def radiotap(frame: bytes, *, flags: int = 0) -> bytes:
    return struct.pack("<BBHIBb", 0, 0, 10, 0x22, flags, -61) + frame


def pcap(link_type: int, packets: Sequence[bytes]) -> bytes:
    stream = io.BytesIO()
    writer = dpkt.pcap.Writer(stream, linktype=link_type)
    for number, packet in enumerate(packets):
        writer.writepkt(packet, ts=1_700_000_000 + number)
    return stream.getvalue()


def read(data: bytes) -> list[CapturedFrame]:
    return list(read_capture(io.BytesIO(data), "made.pcap"))


BEACON = build_beacon(PACK, 7, ADDRESS, ssid="UAV")
ACTION = build_nan_action(PACK, 7, ADDRESS)
ADV4, ADV5 = legacy(build_ble4(encode(TEXT), 7)), extended(build_ble5(PACK, 7))


@pytest.mark.parametrize(
    ("link_type", "packet", "transport", "rssi_dbm", "crc_ok"),
    [
        (105, BEACON, WIFI_BEACON, None, None),
        (105, BEACON + b"\x12\xff\x56\x78", WIFI_BEACON, None, None),
        (105, ACTION, WIFI_NAN, None, None),
        (127, radiotap(BEACON), WIFI_BEACON, -61.0, True),
        (127, radiotap(ACTION + b"\x12\xff\x56\x78", flags=0x10), WIFI_NAN, -61.0, True),
        (251, link_layer(ADV4), BLE4, None, True),
        (251, link_layer(legacy(build_ble4(encode(TEXT), 7), kind=0)), BLE4, None, True),
        (251, link_layer(ADV5), BLE5, None, True),
        (256, pseudo(link_layer(ADV4)), BLE4, -61.0, True),
        (256, pseudo(link_layer(ADV4), flags=0x0003), BLE4, -61.0, True),
        (256, pseudo(link_layer(ADV4), flags=0x0001), BLE4, None, True),
        (256, pseudo(link_layer(ADV5, coded=True), flags=0x8C03), BLE5, -61.0, True),
        (272, nordic(link_layer(ADV4)), BLE4, -61.0, True),
        (272, nordic(link_layer(ADV4), version=1, kind=6), BLE4, -61.0, True),
        (272, nordic(link_layer(ADV5, coded=True), flags=0x21, channel=10), BLE5, -61.0, True),
    ],
)
def test_every_link_type_is_read(
    link_type: int, packet: bytes, transport: str, rssi_dbm: float | None, crc_ok: bool | None
) -> None:
    (frame,) = read(pcap(link_type, [packet]))
    payload, messages = (encode(TEXT), (TEXT,)) if transport == BLE4 else (PACK, (TEXT, OPERATOR, Location()))
    assert frame == CapturedFrame(
        number=1,
        time_ns=1_700_000_000_000_000_000,
        kind=Kind.REMOTE_ID,
        transport=transport,
        address=ADDRESS,
        rssi_dbm=rssi_dbm,
        crc_ok=crc_ok,
        counter=7,
        payload=payload,
        messages=messages,
    )


def flipped(packet: bytes) -> bytes:
    return packet[:-1] + bytes((packet[-1] ^ 1,))


@pytest.mark.parametrize(
    ("link_type", "packet"),
    [
        (127, radiotap(BEACON, flags=0x40)),
        (251, flipped(link_layer(ADV4))),
        (251, link_layer(ADV4)[:20] + b"\xff" + link_layer(ADV4)[21:]),
        (256, pseudo(link_layer(ADV4), flags=0x0403)),
        (256, pseudo(flipped(link_layer(ADV4)), flags=0x0003)),
        (272, nordic(link_layer(ADV4), flags=0x00)),
    ],
)
def test_a_bad_crc_is_reported_and_nothing_of_the_frame_believed(link_type: int, packet: bytes) -> None:
    (frame,) = read(pcap(link_type, [packet]))
    assert (frame.kind, frame.crc_ok) == (Kind.BAD_CRC, False)
    assert (frame.transport, frame.address, frame.payload, frame.messages) == (None, None, None, ())


@pytest.mark.parametrize(
    ("link_type", "packet"),
    [
        (105, b"\x40" + BEACON[1:]),
        (127, radiotap(BEACON[:43])),
        (251, link_layer(legacy(b"\x02\x01\x06"))),
        (272, nordic(link_layer(legacy(b"\x02\x01\x06")))),
        (251, link_layer(legacy(b"", kind=5))),
        (251, link_layer(extended(b"", header=b"\x18\x34\x12\x00\x00\x00"))),
        (251, link_layer(extended(b"", header=b""))),
        (251, link_layer(ADV4, access="12345678")),
        (256, pseudo(link_layer(ADV5, coded=True), flags=0x9C83)),  # AUX_CHAIN_IND
        (272, nordic(link_layer(ADV5, coded=True), flags=0x23, channel=10)),  # AUX_CHAIN_IND
        (272, nordic(b"", kind=14)),
    ],
)
def test_what_holds_no_remote_id_is_foreign(link_type: int, packet: bytes) -> None:
    (frame,) = read(pcap(link_type, [packet]))
    assert (frame.kind, frame.faults) == (Kind.FOREIGN, ())


@pytest.mark.parametrize(
    ("link_type", "packet"),
    [
        (105, b""),
        (127, b"\x00\x00\xff\xff"),
        (251, b"\xd6\xbe"),
        (251, link_layer(ADV4)[:5]),
        (251, link_layer(ADV4)[:-1]),
        (251, link_layer(legacy(b"", address=b"\x01\x02"))),
        (251, link_layer(b"\x07\x00")),
        (251, link_layer(b"\x07\x02\x3f\x01")),
        (251, link_layer(extended(b"", header=b"\x01\x02"))),
        (251, link_layer(legacy(b"\x09\x08torn"))),
        (256, pseudo(link_layer(ADV4))[:9]),
        (256, pseudo(link_layer(ADV4), flags=0x0C02)),
        (272, b"\x03"),
        (272, nordic(link_layer(ADV4), version=9)),
        (272, nordic(link_layer(ADV4))[:12]),
    ],
)
def test_what_breaks_its_link_is_told_with_the_fault(link_type: int, packet: bytes) -> None:
    broken, sound = read(pcap(link_type, [packet, SOUND[link_type]]))
    assert broken.kind is Kind.BROKEN
    assert len(broken.faults) == 1
    assert sound.kind is Kind.REMOTE_ID


SOUND = {
    105: BEACON,
    127: radiotap(BEACON),
    251: link_layer(ADV4),
    256: pseudo(link_layer(ADV4)),
    272: nordic(link_layer(ADV4)),
}


def test_an_anonymous_advertisement_has_no_address() -> None:
    (frame,) = read(pcap(251, [link_layer(extended(build_ble5(PACK, 7), header=b"\x08\x34\x12"))]))
    assert (frame.address, len(frame.messages)) == (None, 3)


def test_of_an_advertisement_in_several_pdus_the_first_is_read_and_the_rest_said_to_be_missing() -> None:
    header = b"\x19" + ON_AIR_ADDRESS + b"\x34\x12" + b"\x00\x00\x00"
    (frame,) = read(pcap(251, [link_layer(extended(build_ble5(PACK, 7)[:60], header=header))]))
    assert frame.messages == (TEXT, OPERATOR)
    assert "cut short" in frame.faults[0]
    assert "another PDU" in frame.faults[1]
    (whole,) = read(pcap(251, [link_layer(extended(build_ble5(PACK, 7), header=header))]))
    assert whole.faults == ()


def test_a_damaged_pack_gives_its_sound_messages_and_the_fault() -> None:
    damaged = bytearray(BEACON)
    damaged[-3 * 25] = 0x72
    (frame,) = read(pcap(105, [bytes(damaged)]))
    assert frame.messages == (OPERATOR, Location())
    assert "reserved" in frame.faults[0]
    unreadable = BEACON[:-78] + b"\x32" + BEACON[-77:-60]
    (frame,) = read(pcap(105, [unreadable]))
    assert (frame.kind, frame.messages, len(frame.faults)) == (Kind.REMOTE_ID, (), 1)


def test_two_structures_of_one_frame_come_one_after_the_other() -> None:
    small = encode_pack((TEXT,))
    first, second = read(pcap(105, [BEACON + build_vendor_element(small, 9)]))
    assert (first.number, first.counter, len(first.messages)) == (1, 7, 3)
    assert (second.number, second.counter, second.messages) == (1, 9, (TEXT,))


def test_a_sync_beacon_is_told_apart() -> None:
    (frame,) = read(pcap(127, [radiotap(build_nan_sync_beacon(ADDRESS))]))
    assert (frame.kind, frame.transport, frame.address) == (Kind.SYNC_BEACON, WIFI_NAN, ADDRESS)


def test_another_link_type_is_named_with_those_that_are_read() -> None:
    with pytest.raises(
        ConfigError, match=r"made.pcap: packet 1 has link type 1; .*127 \(802.11 with radiotap\)"
    ) as refused:
        read(pcap(1, [BEACON]))
    assert all(f" {link_type} (" in str(refused.value) for link_type in SOUND)


@given(
    st.sampled_from(sorted(SOUND)),
    st.lists(st.tuples(st.integers(0, 300), st.integers(0, 255)), min_size=1, max_size=5),
    st.integers(0, 300),
)
def test_damage_breaks_no_reader(link_type: int, changes: list[tuple[int, int]], cut: int) -> None:
    packet = bytearray(SOUND[link_type])
    for at, value in changes:
        packet[at % len(packet)] = value
    frames = read(pcap(link_type, [bytes(packet[: len(packet) - cut % 40]), SOUND[link_type]]))
    assert frames[-1].kind is Kind.REMOTE_ID


@given(st.sampled_from(sorted(SOUND)), st.binary(max_size=80))
def test_random_packets_break_no_reader(link_type: int, packet: bytes) -> None:
    assert read(pcap(link_type, [packet]))[0].number == 1
