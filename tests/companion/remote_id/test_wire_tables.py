"""Numbers on the wire, written down from the standard and not from our own tables: both directions of a
coding may be wrong alike, and round trips would not notice."""

from __future__ import annotations

from typing import Any

import pytest

from companion.remote_id import wire_values
from companion.remote_id.codec import decode, encode
from companion.remote_id.frames import (
    Counters,
    build_beacon,
    build_ble4,
    build_ble5,
    build_nan_action,
    build_nan_sync_beacon,
)
from companion.remote_id.messages import (
    Authentication,
    BasicId,
    ClassificationType,
    HeightType,
    IdType,
    Location,
    OperatorId,
    OperatorLocationType,
    SelfId,
    Status,
    System,
    UaType,
)

NM = 1852.0

# ---------------------------------------------------------------- values


@pytest.mark.parametrize(
    ("scale", "bounds"),
    [
        (
            wire_values.HORIZONTAL_ACCURACY_M,
            [10 * NM, 4 * NM, 2 * NM, NM, 0.5 * NM, 0.3 * NM, 0.1 * NM, 0.05 * NM, 30.0, 10.0, 3.0, 1.0],
        ),
        (wire_values.VERTICAL_ACCURACY_M, [150.0, 45.0, 25.0, 10.0, 3.0, 1.0]),
        (wire_values.SPEED_ACCURACY_MPS, [10.0, 3.0, 1.0, 0.3]),
        (wire_values.TIMESTAMP_ACCURACY_S, [0.1 * tenths for tenths in range(1, 16)]),
    ],
)
def test_categories_of_accuracy(scale: wire_values.AccuracyScale, bounds: list[float]) -> None:
    """0 is unknown, and so is what the standard reserves."""
    reserved = [None] * (15 - len(bounds))
    known = [None if bound is None else pytest.approx(bound) for bound in (None, *bounds, *reserved)]
    assert list(scale.bounds) == known
    assert [scale.bound(category) for category in range(16)] == known
    for category, bound in enumerate(bounds, start=1):
        assert scale.category("x", 0.99 * bound) == category


@pytest.mark.parametrize(
    ("raw", "metres"), [(0, None), (1, -999.5), (2000, 0.0), (2001, 0.5), (0xFFFF, 31767.5)]
)
def test_altitudes_are_half_metres_from_minus_1000(raw: int, metres: float | None) -> None:
    assert wire_values.altitude_from_wire(raw) == metres
    assert wire_values.altitude_to_wire("x", metres) == raw


@pytest.mark.parametrize(
    ("raw", "place"),
    [
        ((473_970_000, -85_450_000), (47.397, -8.545)),
        ((900_000_000, 1_800_000_000), (90.0, 180.0)),
        ((-900_000_000, -1_800_000_000), (-90.0, -180.0)),
        ((900_000_001, 0), (None, None)),
        ((-900_000_001, 0), (None, None)),
        ((0, 1_800_000_001), (None, None)),
        ((0, -1_800_000_001), (None, None)),
        ((0, 0), (None, None)),
        ((1, 0), (1e-7, 0.0)),
        ((0, -1), (0.0, -1e-7)),
    ],
)
def test_positions_are_tenths_of_a_microdegree(raw: tuple[int, int], place: tuple[Any, Any]) -> None:
    assert wire_values.position_from_wire(*raw) == place
    if place[0] is not None:
        assert wire_values.position_to_wire("", *place) == raw


@pytest.mark.parametrize(
    ("degrees", "raw"),
    [(0.0, (0, 0)), (179.4, (0, 179)), (179.6, (1, 0)), (359.0, (1, 179)), (None, (1, 181))],
)
def test_directions_are_degrees_in_two_halves(degrees: float | None, raw: tuple[int, int]) -> None:
    assert wire_values.direction_to_wire("x", degrees) == raw
    heard = wire_values.DIRECTIONS_DEG[raw[0] << 8 | raw[1]]
    assert heard == (None if degrees is None else round(degrees))


@pytest.mark.parametrize(
    ("mps", "raw"),
    [
        (0.0, (0, 0)),
        (0.25, (0, 1)),
        (63.75, (0, 255)),
        (64.5, (1, 1)),
        (254.25, (1, 254)),
        (None, (1, 255)),
    ],
)
def test_speeds_are_quarters_then_three_quarters(mps: float | None, raw: tuple[int, int]) -> None:
    assert wire_values.speed_to_wire("x", mps) == raw
    assert wire_values.SPEEDS_MPS[raw[0] << 8 | raw[1]] == mps


@pytest.mark.parametrize(
    ("byte", "mps"),
    [
        *((0, 0.0), (1, 0.5), (124, 62.0), (132, -62.0), (255, -0.5)),
        *((byte, None) for byte in (125, 126, 127, 128, 131)),
    ],
)
def test_climbs_are_half_metres_a_second(byte: int, mps: float | None) -> None:
    assert wire_values.CLIMBS_MPS[byte] == mps
    if mps is not None:
        assert wire_values.climb_to_wire("x", mps) & 0xFF == byte


def test_an_unknown_climb_is_126() -> None:
    assert wire_values.climb_to_wire("x", None) == 126


@pytest.mark.parametrize(
    ("raw", "seconds"), [(0, 0.0), (1, 0.1), (36_000, 3600.0), (36_001, None), (0xFFFF, None)]
)
def test_times_are_tenths_after_the_hour(raw: int, seconds: float | None) -> None:
    assert wire_values.hour_time_from_wire(raw) == seconds
    assert wire_values.hour_time_to_wire("x", seconds) == (0xFFFF if seconds is None else raw)


@pytest.mark.parametrize(
    ("utc_s", "raw"),
    [(None, 0), (1_546_300_801.0, 1), (1_546_300_800.2, 1), (1_577_836_800.0, 365 * 86_400)],
)
def test_utc_is_seconds_since_2019(utc_s: float | None, raw: int) -> None:
    """A moment after its beginning is not 0, which is unknown."""
    assert wire_values.utc_to_wire("x", utc_s) == raw
    heard = wire_values.utc_from_wire(raw)
    assert heard == (None if utc_s is None else 1_546_300_800.0 + raw)


@pytest.mark.parametrize(("metres", "raw"), [(0.0, 0), (14.0, 1), (16.0, 2), (2550.0, 255)])
def test_radii_are_tens_of_metres(metres: float, raw: int) -> None:
    assert wire_values.radius_to_wire("x", metres) == raw


# ---------------------------------------------------------------- messages


def test_the_bytes_of_a_location() -> None:
    message = Location(
        status=Status.EMERGENCY,
        lat_deg=1.0,
        lon_deg=-1.0,
        alt_geodetic_m=0.5,
        alt_baro_m=0.0,
        height_type=HeightType(1),
        height_m=-0.5,
        direction_deg=181.0,
        speed_mps=65.25,
        vertical_speed_mps=-1.0,
        horizontal_accuracy_m=10.0,
        vertical_accuracy_m=3.0,
        baro_accuracy_m=25.0,
        speed_accuracy_mps=0.3,
        timestamp_s=25.7,
        timestamp_accuracy_s=1.5,
    )
    data = "12 37 01 02 fe 80969800 806967ff d007 d107 cf07 5a 34 0101 0f 00"
    assert encode(message) == bytes.fromhex(data)
    assert decode(bytes.fromhex(data)) == message


def test_the_bytes_of_a_system_message() -> None:
    message = System(
        operator_location_type=OperatorLocationType(1),
        classification_type=ClassificationType(1),
        operator_lat_deg=1.0,
        operator_lon_deg=-1.0,
        operator_alt_geodetic_m=0.5,
        area_count=0x102,
        area_radius_m=30.0,
        area_ceiling_m=1.0,
        area_floor_m=-1.0,
        category_eu=2,
        class_eu=5,
        timestamp_utc_s=1_546_300_800.0 + 0x01020304,
    )
    data = "42 05 80969800 806967ff 0201 03 d207 ce07 25 d107 04030201 00"
    assert encode(message) == bytes.fromhex(data)
    assert decode(bytes.fromhex(data)) == message


@pytest.mark.parametrize(
    ("message", "data"),
    [
        (
            BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.GLIDER, uas_id="A1"),
            "02 16 4131" + "00" * 21,
        ),
        (
            Authentication(
                auth_type=3,
                page=0,
                data=bytes(range(17)),
                last_page=3,
                length=64,
                timestamp_utc_s=1_546_300_800.0 + 5,
            ),
            "22 30 03 40 05000000 000102030405060708090a0b0c0d0e0f10",
        ),
        (Authentication(auth_type=3, page=2, data=bytes(range(23))), "22 32" + bytes(range(23)).hex()),
        (SelfId(description_type=1, text="ab"), "32 01 6162" + "00" * 21),
        (OperatorId(operator_id_type=2, operator_id="ab"), "52 02 6162" + "00" * 21),
    ],
)
def test_the_bytes_of_the_other_messages(message: Any, data: str) -> None:
    assert encode(message) == bytes.fromhex(data)
    assert decode(bytes.fromhex(data)) == message


@pytest.mark.parametrize(
    ("kind", "numbers"),
    [
        (IdType, "NONE SERIAL_NUMBER CAA_REGISTRATION UTM_ASSIGNED_UUID SPECIFIC_SESSION"),
        (Status, "UNDECLARED GROUND AIRBORNE EMERGENCY REMOTE_ID_SYSTEM_FAILURE"),
        (OperatorLocationType, "TAKEOFF LIVE_GNSS FIXED"),
        (ClassificationType, "UNDECLARED EU"),
        (
            UaType,
            "NONE AEROPLANE HELICOPTER_OR_MULTIROTOR GYROPLANE HYBRID_LIFT ORNITHOPTER GLIDER KITE "
            "FREE_BALLOON CAPTIVE_BALLOON AIRSHIP FREE_FALL_PARACHUTE ROCKET TETHERED_POWERED_AIRCRAFT "
            "GROUND_OBSTACLE OTHER",
        ),
    ],
)
def test_numbers_of_enumerations(kind: Any, numbers: str) -> None:
    """In the order of the standard, from 0 on."""
    names = numbers.split()
    assert [kind(number).name for number in range(len(names))] == names


# ---------------------------------------------------------------- frames

MESSAGE = encode(SelfId(description_type=0, text="ab"))
PACK = bytes((0xF2, 25, 1)) + MESSAGE
MAC, MAC_HEX = "02:00:00:ab:cd:ef", "020000abcdef"


def test_the_bytes_of_advertisements() -> None:
    assert build_ble4(MESSAGE, 7) == bytes.fromhex("1e 16 faff 0d 07") + MESSAGE
    assert build_ble5(PACK, 255) == bytes.fromhex("21 16 faff 0d ff") + PACK


def test_the_bytes_of_a_beacon() -> None:
    head = f"8000 0000 ffffffffffff {MAC_HEX} {MAC_HEX} 0000 0807060504030201 c800 2004 0002 6869 01018c"
    vendor = f"dd {5 + len(PACK):02x} fa0bbc 0d 07"
    made = build_beacon(PACK, 7, MAC, ssid="hi", interval_tu=200, tsf_us=0x0102030405060708)
    assert made == bytes.fromhex(head + vendor) + PACK
    assert build_beacon(PACK, 7, MAC)[32:36] == bytes.fromhex("6400 2004")


def test_the_bytes_of_a_nan_action_frame() -> None:
    head = f"d000 0000 516f9a010000 {MAC_HEX} 506f9a0100ff 0000 0409 506f9a13"
    descriptor = f"03 {10 + 1 + len(PACK):02x}00 8869199d9209 01 00 10 {1 + len(PACK):02x} 07"
    extension = "0e 0400 01 0002 07"
    assert build_nan_action(PACK, 7, MAC) == bytes.fromhex(head + descriptor) + PACK + bytes.fromhex(
        extension
    )


def test_the_bytes_of_a_nan_sync_beacon() -> None:
    head = f"8000 0000 ffffffffffff {MAC_HEX} 506f9a0100ff 0000 0100000000000000 0002 2004"
    master, cluster = "00 0200 fe ea", f"01 0d00 {MAC_HEX} ea fe 00 00000000"
    services = "02 0600 8869199d9209"
    content = bytes.fromhex("506f9a13" + master + cluster + services)
    made = build_nan_sync_beacon(MAC, tsf_us=1)
    assert made == bytes.fromhex(head) + bytes((0xDD, len(content))) + content
    assert len(made) == 72


@pytest.mark.parametrize("tsf_us", [-1, 1 << 64])
def test_a_clock_that_no_beacon_holds_is_refused(tsf_us: int) -> None:
    build_nan_sync_beacon(MAC, tsf_us=(1 << 64) - 1)
    with pytest.raises(ValueError, match="tsf_us"):
        build_nan_sync_beacon(MAC, tsf_us=tsf_us)


@pytest.mark.parametrize(("interval_tu", "sound"), [(0, False), (1, True), (0xFFFF, True), (0x10000, False)])
def test_the_interval_of_a_beacon(interval_tu: int, sound: bool) -> None:
    if sound:
        build_beacon(PACK, 0, MAC, interval_tu=interval_tu)
        return
    with pytest.raises(ValueError, match="interval_tu"):
        build_beacon(PACK, 0, MAC, interval_tu=interval_tu)


def test_an_ssid_has_32_bytes_at_most() -> None:
    build_beacon(PACK, 0, MAC, ssid="x" * 32)
    with pytest.raises(ValueError, match="ssid"):
        build_beacon(PACK, 0, MAC, ssid="x" * 33)


@pytest.mark.parametrize(
    "pack",
    [
        bytes((0xF2, 25, 0)),
        bytes((0xF2, 25, 1)),
        PACK[:-1],
        PACK + b"\0",
        bytes((0xF2, 25, 10)) + 10 * MESSAGE,
        bytes((0xF2, 24, 1)) + MESSAGE,
        bytes((0x02, 25, 1)) + MESSAGE,
    ],
)
def test_a_pack_whose_head_and_length_differ_is_not_sent(pack: bytes) -> None:
    for build in (
        lambda: build_ble5(pack, 0),
        lambda: build_beacon(pack, 0, MAC),
        lambda: build_nan_action(pack, 0, MAC),
    ):
        with pytest.raises(ValueError, match="a pack of 1 to 9 messages"):
            build()


def test_a_counter_wraps_after_255() -> None:
    counters = Counters()
    numbers = [counters.next("ble5", bytes((0xF2, k % 2))) for k in range(258)]
    assert numbers == [*range(256), 0, 1]
