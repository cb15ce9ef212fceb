"""Frames of each transport, counters, and hostile bytes through every reader."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import PeerDataError
from companion.remote_id.codec import decode, decode_pack, decode_payload, encode, encode_pack, read_payload
from companion.remote_id.frames import (
    Counters,
    NanSyncBeaconError,
    NotRemoteIdError,
    build_beacon,
    build_ble4,
    build_ble5,
    build_nan_action,
    build_nan_sync_beacon,
    build_vendor_element,
    parse_frame,
    parse_frames,
    parse_wifi,
    parse_wifi_frames,
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
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON, WIFI_NAN

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


def nan_frame() -> bytes:
    return build_nan_action(PACK, 7, ADDRESS)


FRAMES: list[tuple[str, Callable[[], bytes], bytes, str | None]] = [
    (BLE4, ble4_frame, encode(TEXT), None),
    (BLE5, ble5_frame, PACK, None),
    (WIFI_BEACON, beacon_frame, PACK, ADDRESS),
    (WIFI_NAN, nan_frame, PACK, ADDRESS),
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
    assert len(nan_frame()) == 54 + 25 * 7
    assert len(build_nan_sync_beacon(ADDRESS)) == 72


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
        (WIFI_BEACON, nan_frame()),
        (WIFI_NAN, beacon_frame()),
        (WIFI_NAN, b"\xd0" + nan_frame()[1:24] + b"\x03\x09" + nan_frame()[26:]),
        (WIFI_NAN, nan_frame()[: 24 + 6]),
        (WIFI_NAN, build_nan_sync_beacon(ADDRESS)),
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
        (BLE4, FLAGS + b"\x09\x08torn"),
        (BLE4, b"\x05\x16\xfa\xff\x0d\x01"),
        (BLE4, b"\x1e\x16\xfa\xff\x0d\x01"),  # real modules before they hold any message
        (BLE4, b"\x04\x16\xfa\xff\x0d"),
        (WIFI_BEACON, b""),
        (WIFI_BEACON, b"\x80"),
        (WIFI_BEACON, beacon_frame()[:20]),
        (WIFI_BEACON, beacon_frame()[:30]),
        (WIFI_BEACON, beacon_frame()[:36] + b"\x00\x20torn SSID"),
        (WIFI_NAN, nan_frame()[:20]),
        (WIFI_NAN, nan_frame()[:30] + b"\x05\x20\x00torn"),
        (WIFI_NAN, nan_frame()[:43]),
    ],
)
def test_a_torn_frame_is_the_peers_fault(transport: str, data: bytes) -> None:
    with pytest.raises(PeerDataError) as error:
        parse_frame(transport, data)
    assert not isinstance(error.value, NotRemoteIdError)


@pytest.mark.parametrize(
    ("transport", "frame"),
    [(BLE5, ble5_frame()), (WIFI_BEACON, beacon_frame()), (WIFI_NAN, nan_frame()[:-7])],
)
def test_of_a_torn_structure_the_payload_is_given_as_far_as_it_came(transport: str, frame: bytes) -> None:
    """`read_payload` says what it lacks; so a receiver keeps the sound messages before the tear."""
    torn = parse_frame(transport, frame[:-30])
    assert torn.payload == PACK[:-30]
    messages, faults = read_payload(torn.payload)
    assert len(messages) == 5
    assert "cut short" in faults[0]


@pytest.mark.parametrize("transport", [BLE4, BLE5])
def test_a_torn_structure_behind_a_sound_one_does_not_hide_it(transport: str) -> None:
    frames = parse_frames(transport, FLAGS + ble4_frame() + b"\x20\x09torn name")
    assert [frame.payload for frame in frames] == [encode(TEXT)]


def test_every_remote_id_structure_of_a_frame_is_given() -> None:
    other = encode(OperatorId(operator_id_type=0, operator_id="FIN87astrdge12k8"))
    advertised = parse_frames(BLE5, ble5_frame() + FLAGS + build_ble4(other, 9) + b"\x05\x16\xfa\xff\x0d\x01")
    assert [(frame.counter, frame.payload) for frame in advertised] == [(7, PACK), (9, other)]

    small = encode_pack((TEXT,))
    beacon = beacon_frame() + build_vendor_element(small, 9)
    assert [(f.counter, f.payload) for f in parse_wifi_frames(beacon)] == [(7, PACK), (9, small)]

    action = nan_frame() + build_nan_action(small, 9, ADDRESS)[24 + 6 :]
    assert [(f.counter, f.payload) for f in parse_wifi_frames(action)] == [(7, PACK), (9, small)]


# ---------------------------------------------------------------- 802.11 as a monitor interface brings it

FCS = b"\x12\xff\x56\x78"


@pytest.mark.parametrize(
    ("frame", "transport"),
    [
        (beacon_frame(), WIFI_BEACON),
        (b"\x50" + beacon_frame()[1:], WIFI_BEACON),  # probe response: the same body
        (nan_frame(), WIFI_NAN),
    ],
)
@pytest.mark.parametrize("behind", [b"", FCS])
@pytest.mark.parametrize("htc", [b"", b"\x03\x00\x00\x00"])
def test_one_reader_takes_any_wifi_frame(frame: bytes, transport: str, behind: bytes, htc: bytes) -> None:
    """With and without FCS, with and without HT Control, and whatever the other flags say."""
    flags = 0x88 if htc else 0x08
    data = frame[:1] + bytes((flags,)) + frame[2:24] + htc + frame[24:] + behind
    read = parse_wifi(data)
    assert (read.transport, read.address, read.counter, read.payload) == (transport, ADDRESS, 7, PACK)


def no_remote_id(data: bytes) -> bool:
    try:
        parse_wifi(data)
    except NotRemoteIdError:
        return True
    return False


def test_other_kinds_of_wifi_frame_are_no_remote_id() -> None:
    frame, ours = beacon_frame(), {0x50, 0x80, 0xD0}
    others = [kind for kind in range(256) if kind not in ours]
    assert [kind for kind in others if not no_remote_id(bytes((kind,)) + frame[1:])] == []


@pytest.mark.parametrize("cluster", ["506f9a0100ff", "506f9a010179"])
def test_a_sync_beacon_is_recognised(cluster: str) -> None:
    beacon = build_nan_sync_beacon(ADDRESS, 5)
    with pytest.raises(NanSyncBeaconError) as error:
        parse_wifi(beacon[:16] + bytes.fromhex(cluster) + beacon[22:] + FCS)
    assert error.value.address == ADDRESS


def test_a_sync_beacon_of_other_services_is_plainly_foreign() -> None:
    beacon = build_nan_sync_beacon(ADDRESS)
    with pytest.raises(NotRemoteIdError) as error:
        parse_wifi(beacon[:-1] + b"\x08")
    assert not isinstance(error.value, NanSyncBeaconError)


def test_the_clock_stands_in_a_beacon() -> None:
    for beacon in (build_nan_sync_beacon(ADDRESS, 0x0102), build_beacon(PACK, 0, ADDRESS, tsf_us=0x0102)):
        assert beacon[24:32] == b"\x02\x01" + bytes(6)


@pytest.mark.parametrize(
    ("control", "between"),
    [
        (0x10, b""),
        (0x14, b"\x02ab"),
        (0x18, b"\x03abc"),
        (0x50, b"\xff\xff"),
        (0x5C, b"\xff\xff\x02ab\x03abc"),
    ],
)
def test_what_a_service_descriptor_may_hold_before_the_info_is_passed_over(
    control: int, between: bytes
) -> None:
    """The order of the Service Descriptor attribute: bitmap, matching filter, response filter, info."""
    frame = nan_frame()
    size = int.from_bytes(frame[31:33], "little") + len(between)
    head = frame[:31] + size.to_bytes(2, "little") + frame[33:41] + bytes((control,))
    read = parse_wifi(head + between + frame[42:])
    assert (read.counter, read.payload) == (7, PACK)


@pytest.mark.parametrize("change", [{41: 0x01}, {33: 0x89}])
def test_a_subscriber_or_another_service_is_no_remote_id(change: dict[int, int]) -> None:
    frame = bytearray(nan_frame())
    for at, value in change.items():
        frame[at] = value
    with pytest.raises(NotRemoteIdError):
        parse_wifi(bytes(frame))


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
        lambda: build_nan_action(PACK[:-1], 0, ADDRESS),
        lambda: build_nan_action(PACK, -1, ADDRESS),
        lambda: build_nan_action(PACK, 0, "nowhere"),
        lambda: build_nan_sync_beacon("nowhere"),
        lambda: build_nan_sync_beacon(ADDRESS, 1 << 64),
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
    lambda data: parse_frames(WIFI_NAN, data),
    parse_wifi,
]
SEEDS = [*(encode(message) for message in EVERY_MESSAGE), PACK, *(build() for _, build, _, _ in FRAMES)]
SEEDS.append(build_nan_sync_beacon(ADDRESS))


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
