"""What holds for all messages, packs and frames, against a second description of the wire.

Messages are drawn as the integers that lie on the wire; this file lays them out as bytes and says what they
mean on its own, without the codec. Derandomised: every run draws the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.errors import PeerDataError
from companion.remote_id.codec import decode, encode
from companion.remote_id.messages import (
    Authentication,
    BasicId,
    ClassificationType,
    HeightType,
    IdType,
    Location,
    Message,
    OperatorId,
    OperatorLocationType,
    SelfId,
    Status,
    System,
    UaType,
)

EPOCH = 1546300800.0
HORIZONTAL_M = (None, 18520.0, 7408.0, 3704.0, 1852.0, 926.0, 555.6, 185.2, 92.6, 30.0, 10.0, 3.0, 1.0)
VERTICAL_M = (None, 150.0, 45.0, 25.0, 10.0, 3.0, 1.0)
SPEED_MPS = (None, 10.0, 3.0, 1.0, 0.3)

stable = settings(
    derandomize=True,
    deadline=None,
    max_examples=80,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


class Case(NamedTuple):
    """A message and its 25 bytes."""

    message: Message
    data: bytes


def number(value: int, size: int) -> bytes:
    return value.to_bytes(size, "little", signed=value < 0)


def altitude_of(raw: int) -> float | None:
    return raw / 2 - 1000 if raw else None


def utc_of(raw: int) -> float | None:
    return EPOCH + raw if raw else None


def place_of(lat: int, lon: int) -> tuple[float | None, float | None]:
    return (lat / 1e7, lon / 1e7) if lat or lon else (None, None)


BYTE, WORD, LONG, NIBBLE = (st.integers(0, 2**bits - 1) for bits in (8, 16, 32, 4))
LATITUDES = st.integers(-900_000_000, 900_000_000)
LONGITUDES = st.integers(-1_800_000_000, 1_800_000_000)
TEXT = st.text(st.characters(min_codepoint=1, max_codepoint=255))


@st.composite
def basic_ids(draw: st.DrawFn) -> Case:
    id_type, ua_type = draw(NIBBLE), draw(NIBBLE)
    if id_type in (1, 2):
        raw = draw(TEXT.map(lambda text: text[:20])).encode("latin-1")
    else:
        raw = draw(st.binary(max_size=20)).rstrip(b"\0")
    return Case(
        BasicId(id_type=IdType(id_type), ua_type=UaType(ua_type), uas_id=raw.decode("latin-1")),
        bytes((0x02, id_type << 4 | ua_type)) + raw.ljust(20, b"\0") + bytes(3),
    )


@st.composite
def locations(draw: st.DrawFn) -> Case:
    status, height_type = draw(NIBBLE), draw(st.integers(0, 1))
    direction = draw(st.none() | st.integers(0, 359))
    speed = draw(st.none() | st.integers(0, 255 + 254))
    climb = draw(st.none() | st.integers(-124, 124))
    lat, lon = draw(LATITUDES), draw(LONGITUDES)
    baro, geodetic, height = draw(WORD), draw(WORD), draw(WORD)
    horizontal, vertical = draw(st.integers(0, 12)), draw(st.integers(0, 6))
    baro_accuracy, speed_accuracy = draw(st.integers(0, 6)), draw(st.integers(0, 4))
    tenths, time_accuracy = draw(st.none() | st.integers(0, 36000)), draw(NIBBLE)
    fast = speed is None or speed > 255
    east = 1 if direction is None else direction // 180
    lat_deg, lon_deg = place_of(lat, lon)
    message = Location(
        status=Status(status),
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_geodetic_m=altitude_of(geodetic),
        alt_baro_m=altitude_of(baro),
        height_type=HeightType(height_type),
        height_m=altitude_of(height),
        direction_deg=direction,
        speed_mps=None if speed is None else 63.75 + (speed - 255) * 0.75 if fast else speed / 4,
        vertical_speed_mps=None if climb is None else climb / 2,
        horizontal_accuracy_m=HORIZONTAL_M[horizontal],
        vertical_accuracy_m=VERTICAL_M[vertical],
        baro_accuracy_m=VERTICAL_M[baro_accuracy],
        speed_accuracy_mps=SPEED_MPS[speed_accuracy],
        timestamp_s=None if tenths is None else tenths / 10,
        timestamp_accuracy_s=time_accuracy / 10 if time_accuracy else None,
    )
    data = (
        bytes((0x12, status << 4 | height_type << 2 | east << 1 | fast))
        + bytes((181 if direction is None else direction % 180,))
        + bytes((255 if speed is None else speed - 255 if fast else speed,))
        + number(126 if climb is None else climb, 1)
        + number(lat, 4)
        + number(lon, 4)
        + number(baro, 2)
        + number(geodetic, 2)
        + number(height, 2)
        + bytes((vertical << 4 | horizontal, baro_accuracy << 4 | speed_accuracy))
        + number(0xFFFF if tenths is None else tenths, 2)
        + bytes((time_accuracy, 0))
    )
    return Case(message, data)


@st.composite
def authentications(draw: st.DrawFn) -> Case:
    auth_type, page = draw(NIBBLE), draw(NIBBLE)
    if page:
        content = draw(st.binary(min_size=23, max_size=23))
        return Case(
            Authentication(auth_type=auth_type, page=page, data=content),
            bytes((0x22, auth_type << 4 | page)) + content,
        )
    content, last_page, since = draw(st.binary(min_size=17, max_size=17)), draw(NIBBLE), draw(LONG)
    length = draw(st.integers(0, min(255, 17 + 23 * last_page)))
    return Case(
        Authentication(
            auth_type=auth_type,
            page=0,
            data=content,
            last_page=last_page,
            length=length,
            timestamp_utc_s=utc_of(since),
        ),
        bytes((0x22, auth_type << 4, last_page, length)) + number(since, 4) + content,
    )


@st.composite
def self_ids(draw: st.DrawFn) -> Case:
    kind, text = draw(BYTE), draw(TEXT)[:23]
    return Case(
        SelfId(description_type=kind, text=text),
        bytes((0x32, kind)) + text.encode("latin-1").ljust(23, b"\0"),
    )


@st.composite
def systems(draw: st.DrawFn) -> Case:
    where, classification = draw(st.integers(0, 3)), draw(st.integers(0, 7))
    lat, lon, count, radius = draw(LATITUDES), draw(LONGITUDES), draw(WORD), draw(BYTE)
    ceiling, floor, altitude, since = draw(WORD), draw(WORD), draw(WORD), draw(LONG)
    category, kind = draw(NIBBLE), draw(NIBBLE)
    lat_deg, lon_deg = place_of(lat, lon)
    message = System(
        operator_location_type=OperatorLocationType(where),
        classification_type=ClassificationType(classification),
        operator_lat_deg=lat_deg,
        operator_lon_deg=lon_deg,
        operator_alt_geodetic_m=altitude_of(altitude),
        area_count=count,
        area_radius_m=radius * 10,
        area_ceiling_m=altitude_of(ceiling),
        area_floor_m=altitude_of(floor),
        category_eu=category,
        class_eu=kind,
        timestamp_utc_s=utc_of(since),
    )
    data = (
        bytes((0x42, classification << 2 | where))
        + number(lat, 4)
        + number(lon, 4)
        + number(count, 2)
        + bytes((radius,))
        + number(ceiling, 2)
        + number(floor, 2)
        + bytes((category << 4 | kind,))
        + number(altitude, 2)
        + number(since, 4)
        + bytes(1)
    )
    return Case(message, data)


@st.composite
def operator_ids(draw: st.DrawFn) -> Case:
    kind, text = draw(BYTE), draw(TEXT)[:20]
    return Case(
        OperatorId(operator_id_type=kind, operator_id=text),
        bytes((0x52, kind)) + text.encode("latin-1").ljust(20, b"\0") + bytes(3),
    )


KINDS = {
    "BasicId": basic_ids(),
    "Location": locations(),
    "Authentication": authentications(),
    "SelfId": self_ids(),
    "System": systems(),
    "OperatorId": operator_ids(),
}
CASES = st.one_of(*KINDS.values())
PACKS = st.lists(
    CASES, min_size=1, max_size=9, unique_by=lambda case: (type(case.message), case.data[1] & 15)
).filter(lambda cases: _fits_a_pack([case.message for case in cases]))


def _fits_a_pack(messages: Sequence[Message]) -> bool:
    most = {Authentication: 9, BasicId: 2}
    return all(
        sum(type(other) is kind for other in messages) <= most.get(kind, 1) for kind in map(type, messages)
    )


# ---------------------------------------------------------------- messages


@pytest.mark.parametrize("kind", KINDS)
def test_message_and_bytes_are_one_on_the_wire_grid(kind: str) -> None:
    @given(KINDS[kind])
    @stable
    def check(case: Case) -> None:
        assert len(case.data) == 25
        assert encode(case.message) == case.data
        assert decode(case.data) == case.message

    check()


@pytest.mark.parametrize("kind", KINDS)
def test_versions_and_reserved_bits_do_not_matter_on_receipt(kind: str) -> None:
    reserved = {"BasicId": (22, 23, 24), "Location": (24,), "System": (24,), "OperatorId": (22, 23, 24)}

    @given(KINDS[kind], st.integers(0, 15), st.binary(min_size=3, max_size=3), NIBBLE)
    @stable
    def check(case: Case, later: int, noise: bytes, high: int) -> None:
        for version in (0, 1, 2, later):
            data = bytearray(case.data)
            data[0] = data[0] & 0xF0 | version
            for at, byte in zip(reserved.get(kind, ()), noise, strict=False):
                data[at] = byte
            if kind == "Location":
                data[1] |= (high & 1) << 3
                data[23] |= high << 4
            elif kind == "System":
                data[1] |= (high & 7) << 5
            assert decode(bytes(data)) == case.message

    check()


@given(st.binary(min_size=25, max_size=25))
@settings(stable, max_examples=500)
def test_any_25_bytes_are_a_message_that_can_be_sent_on_or_refused(data: bytes) -> None:
    try:
        message = decode(data)
    except PeerDataError:
        return
    again = encode(message)
    assert decode(again) == message
    assert encode(decode(again)) == again


@given(st.binary(max_size=60))
@stable
def test_any_other_length_is_refused(data: bytes) -> None:
    if len(data) != 25:
        with pytest.raises(PeerDataError, match=f"{len(data)} bytes"):
            decode(data)


class Range(NamedTuple):
    """One float field: what it can hold, and its wire step."""

    make: type[Message]
    field: str
    lowest: float
    highest: float
    step: float
    says: str


ALTITUDE = (-1000.0, 31767.5, 0.5, "-1000 to 31767.5 m")
RANGES = [
    Range(Location, "lat_deg", -90, 90, 1e-7, "-90 to 90 degrees"),
    Range(Location, "lon_deg", -180, 180, 1e-7, "-180 to 180 degrees"),
    Range(Location, "alt_geodetic_m", *ALTITUDE),
    Range(Location, "alt_baro_m", *ALTITUDE),
    Range(Location, "height_m", *ALTITUDE),
    Range(Location, "direction_deg", 0, 360, 1.0, "0 to 360 degrees"),
    Range(Location, "speed_mps", 0, 254.25, 0.75, "0 to 254.25 m/s"),
    Range(Location, "vertical_speed_mps", -62, 62, 0.5, "-62 to 62 m/s"),
    Range(Location, "timestamp_s", 0, 3600, 0.1, "0 to 3600 s"),
    Range(System, "operator_lat_deg", -90, 90, 1e-7, "-90 to 90 degrees"),
    Range(System, "operator_lon_deg", -180, 180, 1e-7, "-180 to 180 degrees"),
    Range(System, "operator_alt_geodetic_m", *ALTITUDE),
    Range(System, "area_ceiling_m", *ALTITUDE),
    Range(System, "area_floor_m", *ALTITUDE),
    Range(System, "area_radius_m", 0, 2550, 10.0, "0 to 2550 m"),
    Range(System, "timestamp_utc_s", EPOCH, EPOCH + 2**32 - 1, 1.0, "1546300800 to 5841268095 Unix s"),
    Range(
        Authentication, "timestamp_utc_s", EPOCH, EPOCH + 2**32 - 1, 1.0, "1546300800 to 5841268095 Unix s"
    ),
]
ACCURACIES = [
    Range(Location, field, 0, bounds[1], 0, "0 or more, and finite")  # type: ignore[arg-type]
    for field, bounds in (
        ("horizontal_accuracy_m", HORIZONTAL_M),
        ("vertical_accuracy_m", VERTICAL_M),
        ("baro_accuracy_m", VERTICAL_M),
        ("speed_accuracy_mps", SPEED_MPS),
        ("timestamp_accuracy_s", (None, 1.5)),
    )
]


def named(item: Range) -> str:
    return f"{item.make.__name__}.{item.field}"


def holding(item: Range, value: float) -> Message:
    """A message with that field; its partner, where it has one, is known as well."""
    fields: dict[str, Any] = {"System": {}, "Location": {}}.get(item.make.__name__, {}).copy()
    if item.make is Authentication:
        fields = {"auth_type": 0, "page": 0, "data": b"", "last_page": 0, "length": 0}
    if item.field.endswith(("lat_deg", "lon_deg")):
        prefix = item.field.removesuffix("lat_deg").removesuffix("lon_deg")
        fields = {f"{prefix}lat_deg": 1.0, f"{prefix}lon_deg": 1.0}
    return item.make(**(fields | {item.field: value}))


@pytest.mark.parametrize("item", RANGES, ids=named)
def test_a_value_is_rounded_within_one_step(item: Range) -> None:
    @given(st.floats(item.lowest, item.highest))
    @stable
    def check(value: float) -> None:
        heard = getattr(decode(encode(holding(item, value))), item.field)
        if heard is None:  # the one value that is itself the wire's "unknown"
            assert value == item.lowest
            return
        off = abs(heard - value)
        if item.field == "direction_deg":
            off = min(off, 360 - off)
        assert off <= item.step * (1 + 1e-6)

    check()


@pytest.mark.parametrize("item", ACCURACIES, ids=named)
def test_an_accuracy_is_never_declared_better(item: Range) -> None:
    @given(st.floats(0, 1e6))
    @stable
    def check(value: float) -> None:
        heard = getattr(decode(encode(holding(item, value))), item.field)
        assert value > item.highest if heard is None else heard >= value

    check()


@pytest.mark.parametrize("item", [*RANGES, *ACCURACIES], ids=named)
def test_a_value_that_cannot_be_sent_is_refused_by_field_and_limit(item: Range) -> None:
    beyond = st.floats(max_value=item.lowest, exclude_max=True)
    if item not in ACCURACIES:
        beyond |= st.floats(min_value=item.highest, exclude_min=True)

    @given(beyond | st.sampled_from([float("nan"), float("inf"), float("-inf")]))
    @stable
    def check(value: float) -> None:
        with pytest.raises(ValueError) as refusal:
            encode(holding(item, value))
        assert named(item) in str(refusal.value)
        assert item.says in str(refusal.value)

    check()
