"""Frames of each transport, counters, and hostile bytes through every reader."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import PeerDataError
from companion.radio.transport import BLE4, BLE5, WIFI_BEACON
from companion.remote_id.codec import decode, decode_pack, decode_payload, encode, encode_pack, read_payload
from companion.remote_id.frames import (
    Counters,
    NotRemoteIdError,
    build_beacon,
    build_ble4,
    build_ble5,
    build_vendor_element,
    parse_frame,
)
from companion.remote_id.messages import (
    Authentication,
    BasicId,
    IdType,
    Location,
    Message,
    OperatorId,
    SelfId,
    System,
    UaType,
)

ADDRESS = "02:00:5e:10:20:30"
TEXT = SelfId(description_type=0, text="survey")
EVERY_MESSAGE: tuple[Message, ...] = (
    BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.GLIDER, uas_id="1581F6N8A23B2ML3Y3KR"),
    Location(lat_deg=47.1, lon_deg=8.5, alt_geodetic_m=500.0, speed_mps=12.0, direction_deg=90.0),
    Authentication(auth_type=1, page=0, data=b"s" * 17, last_page=1, length=30),
    Authentication(auth_type=1, page=1, data=b"s" * 13),
    TEXT,
    System(operator_lat_deg=47.1, operator_lon_deg=8.5),
    OperatorId(operator_id_type=0, operator_id="FIN87astrdge12k8"),
)
PACK = encode_pack(EVERY_MESSAGE)


def ble4_frame() -> bytes:
    return build_ble4(encode(TEXT), 7)


def ble5_frame() -> bytes:
    return build_ble5(PACK, 7)


def beacon_frame() -> bytes:
    return build_beacon(PACK, 7, ADDRESS, ssid="UAV")


FRAMES: list[tuple[str, Callable[[], bytes], bytes, str | None]] = [
    (BLE4, ble4_frame, encode(TEXT), None),
    (BLE5, ble5_frame, PACK, None),
    (WIFI_BEACON, beacon_frame, PACK, ADDRESS),
]


@pytest.mark.parametrize(("transport", "build", "payload", "address"), FRAMES)
def test_what_is_built_is_read(
    transport: str, build: Callable[[], bytes], payload: bytes, address: str | None
) -> None:
    frame = parse_frame(transport, build())
    assert (frame.transport, frame.counter, frame.payload, frame.address) == (transport, 7, payload, address)


def test_sizes_on_the_air() -> None:
    assert len(ble4_frame()) == 31
    assert len(ble5_frame()) == 9 + 25 * 7
    assert len(beacon_frame()) == 51 + 3 + 25 * 7


FLAGS = b"\x02\x01\x06"
FOREIGN = b"\x05\x16\xfa\xff\x0c\x00"  # ASTM's UUID, another application


@pytest.mark.parametrize("transport", [BLE4, BLE5])
def test_structures_before_and_padding_behind_are_passed_over(transport: str) -> None:
    frame = parse_frame(transport, FLAGS + FOREIGN + ble4_frame() + bytes(5))
    assert frame.payload == encode(TEXT)


def test_elements_before_and_an_fcs_behind_are_passed_over() -> None:
    head = beacon_frame()[: 24 + 12]
    foreign = b"\xdd\x05\x00\x50\xf2\x01\x01" + b"\xdd\x04\xfa\x0b\xbc\x0c"
    frame = parse_frame(WIFI_BEACON, head + foreign + build_vendor_element(PACK, 9) + b"\xff\xff\x00\x01")
    assert (frame.counter, frame.payload) == (9, PACK)


@pytest.mark.parametrize(
    ("transport", "data"),
    [
        (BLE4, b""),
        (BLE4, FLAGS + FOREIGN),
        (BLE5, bytes(31)),
        (WIFI_BEACON, b"\x40" + beacon_frame()[1:]),
        (WIFI_BEACON, beacon_frame()[: 24 + 12 + 5 + 3]),
        (WIFI_BEACON, beacon_frame()[: 24 + 12 + 5 + 3] + b"\x12\xff\x56\x78"),
    ],
)
def test_a_sound_frame_without_remote_id_is_told_apart(transport: str, data: bytes) -> None:
    with pytest.raises(NotRemoteIdError):
        parse_frame(transport, data)


@pytest.mark.parametrize(
    ("transport", "data"),
    [
        (BLE4, ble4_frame()[:-1]),
        (BLE5, ble5_frame()[:40]),
        (BLE4, b"\x05\x16\xfa\xff\x0d\x01"),
        (WIFI_BEACON, b""),
        (WIFI_BEACON, beacon_frame()[:30]),
        (WIFI_BEACON, beacon_frame()[:-1]),
    ],
)
def test_a_torn_frame_is_the_peers_fault(transport: str, data: bytes) -> None:
    with pytest.raises(PeerDataError) as error:
        parse_frame(transport, data)
    assert not isinstance(error.value, NotRemoteIdError)


@pytest.mark.parametrize(
    "build",
    [
        lambda: build_ble4(PACK, 0),
        lambda: build_ble4(PACK[:25], 0),
        lambda: build_ble5(encode(TEXT), 0),
        lambda: build_ble5(PACK[:-1], 0),
        lambda: build_ble5(PACK, 256),
        lambda: build_beacon(PACK, 0, "02:00:5e:10:20"),
        lambda: build_beacon(PACK, 0, "02:00:5e:10:20:+3"),
        lambda: build_beacon(PACK, 0, ADDRESS, ssid="x" * 33),
        lambda: build_beacon(PACK, 0, ADDRESS, interval_tu=0),
        lambda: build_beacon(PACK, 0, ADDRESS, tsf_us=-1),
        lambda: parse_frame("smoke", b""),
    ],
)
def test_what_cannot_be_sent_is_refused(build: Callable[[], object]) -> None:
    with pytest.raises(ValueError, match="allowed"):
        build()


def test_counters_step_when_the_content_changes() -> None:
    counters = Counters()
    first, second = encode(TEXT), encode(SelfId(description_type=0, text="other"))
    assert [counters.next(BLE4, data) for data in (first, first, second, second, first)] == [0, 0, 1, 1, 2]
    assert counters.next(BLE4, encode(Location())) == 0  # its own per message type
    assert counters.next(BLE5, PACK) == 0  # and per transport
    packs = [encode_pack((OperatorId(operator_id_type=i % 256, operator_id=""),)) for i in range(257)]
    changes = [counters.next(WIFI_BEACON, pack) for pack in packs]
    assert changes == [*range(256), 0]


# ---------------------------------------------------------------- hostile bytes

READERS: list[Callable[[bytes], object]] = [
    decode,
    decode_pack,
    decode_payload,
    read_payload,
    lambda data: parse_frame(BLE4, data),
    lambda data: parse_frame(BLE5, data),
    lambda data: parse_frame(WIFI_BEACON, data),
]
SEEDS = [*(encode(message) for message in EVERY_MESSAGE), PACK, ble4_frame(), ble5_frame(), beacon_frame()]


@st.composite
def mutated(draw: st.DrawFn) -> bytes:
    """Something sound with bytes overwritten, dropped, doubled or cut off."""
    data = bytearray(draw(st.sampled_from(SEEDS)))
    for _ in range(draw(st.integers(1, 6))):
        if not data:
            break
        at = draw(st.integers(0, len(data) - 1))
        change = draw(st.sampled_from(["set", "drop", "cut", "insert"]))
        if change == "set":
            data[at] = draw(st.integers(0, 255))
        elif change == "drop":
            del data[at]
        elif change == "cut":
            del data[at:]
        else:
            data[at:at] = draw(st.binary(max_size=30))
    return bytes(data)


def only_peer_data_errors(data: bytes) -> None:
    for reader in READERS:
        with contextlib.suppress(PeerDataError):
            assert reader(data) is not None


@given(st.binary(max_size=300))
def test_random_bytes_break_no_reader(data: bytes) -> None:
    only_peer_data_errors(data)


@given(st.sampled_from([bytes((kind << 4 | 2,)) for kind in range(16)]), st.binary(min_size=24, max_size=24))
def test_random_messages_break_no_reader(head: bytes, rest: bytes) -> None:
    only_peer_data_errors(head + rest)


@given(mutated())
def test_mutated_frames_break_no_reader(data: bytes) -> None:
    only_peer_data_errors(data)
