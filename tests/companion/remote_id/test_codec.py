"""Messages and packs to bytes and back: within half a step, refused beyond the limits, unknown as None."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import PeerDataError
from companion.remote_id import wire_values
from companion.remote_id.codec import (
    decode,
    encode,
)
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
LATIN = st.characters(min_codepoint=1, max_codepoint=255)


def codes(kind: type[Any], highest: int) -> st.SearchStrategy[Any]:
    return st.integers(0, highest).map(kind)


def maybe(lowest: float, highest: float) -> st.SearchStrategy[float | None]:
    return st.none() | st.floats(lowest, highest)


# The end of a range where a number is itself the wire's unknown is left out.
ALTITUDES = st.none() | st.floats(-1000.0, 31767.5, exclude_min=True)
POSITIONS = st.just((None, None)) | st.tuples(st.floats(-90, 90), st.floats(-180, 180)).filter(
    lambda at: abs(at[0]) > 1e-7 or abs(at[1]) > 1e-7
)
UTC = st.none() | st.floats(EPOCH, EPOCH + 2**32 - 1, exclude_min=True)

RAW_IDS = st.sampled_from([0, 3, 4, 5, 15]).map(IdType)
BASIC_IDS = st.one_of(
    st.builds(
        BasicId,
        id_type=st.sampled_from([IdType.SERIAL_NUMBER, IdType.CAA_REGISTRATION]),
        ua_type=codes(UaType, 15),
        uas_id=st.text(LATIN, max_size=20),
    ),
    st.builds(
        BasicId,
        id_type=RAW_IDS,
        ua_type=codes(UaType, 15),
        uas_id=st.binary(max_size=20).map(lambda raw: raw.rstrip(b"\0").decode("latin-1")),
    ),
)


@st.composite
def locations(draw: st.DrawFn) -> Location:
    lat_deg, lon_deg = draw(POSITIONS)
    return Location(
        status=draw(codes(Status, 15)),
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_geodetic_m=draw(ALTITUDES),
        alt_baro_m=draw(ALTITUDES),
        height_type=draw(codes(HeightType, 1)),
        height_m=draw(ALTITUDES),
        direction_deg=draw(maybe(0, 360)),
        speed_mps=draw(maybe(0, 254.25)),
        vertical_speed_mps=draw(maybe(-62, 62)),
        horizontal_accuracy_m=draw(maybe(0, 18520)),
        vertical_accuracy_m=draw(maybe(0, 150)),
        baro_accuracy_m=draw(maybe(0, 150)),
        speed_accuracy_mps=draw(maybe(0, 10)),
        timestamp_s=draw(maybe(0, 3600)),
        timestamp_accuracy_s=draw(maybe(0, 1.5)),
    )


@st.composite
def authentications(draw: st.DrawFn) -> Authentication:
    auth_type, page = draw(st.integers(0, 15)), draw(st.integers(0, 15))
    if page:
        return Authentication(auth_type=auth_type, page=page, data=draw(st.binary(max_size=23)))
    last_page = draw(st.integers(0, 15))
    return Authentication(
        auth_type=auth_type,
        page=0,
        data=draw(st.binary(max_size=17)),
        last_page=last_page,
        length=draw(st.integers(0, min(255, 17 + 23 * last_page))),
        timestamp_utc_s=draw(UTC),
    )


@st.composite
def systems(draw: st.DrawFn) -> System:
    lat_deg, lon_deg = draw(POSITIONS)
    return System(
        operator_location_type=draw(codes(OperatorLocationType, 3)),
        classification_type=draw(codes(ClassificationType, 7)),
        operator_lat_deg=lat_deg,
        operator_lon_deg=lon_deg,
        operator_alt_geodetic_m=draw(ALTITUDES),
        area_count=draw(st.integers(0, 65535)),
        area_radius_m=draw(st.floats(0, 2550)),
        area_ceiling_m=draw(ALTITUDES),
        area_floor_m=draw(ALTITUDES),
        category_eu=draw(st.integers(0, 15)),
        class_eu=draw(st.integers(0, 15)),
        timestamp_utc_s=draw(UTC),
    )


SELF_IDS = st.builds(SelfId, description_type=st.integers(0, 255), text=st.text(LATIN, max_size=23))
OPERATOR_IDS = st.builds(
    OperatorId, operator_id_type=st.integers(0, 255), operator_id=st.text(LATIN, max_size=20)
)
MESSAGES: st.SearchStrategy[Message] = st.one_of(
    BASIC_IDS, locations(), authentications(), SELF_IDS, systems(), OPERATOR_IDS
)

HALF_STEP = {
    "lat_deg": 0.5e-7,
    "lon_deg": 0.5e-7,
    "operator_lat_deg": 0.5e-7,
    "operator_lon_deg": 0.5e-7,
    "direction_deg": 0.5,
    "vertical_speed_mps": 0.25,
    "timestamp_s": 0.05,
    "timestamp_utc_s": 0.5,
    "area_radius_m": 5.0,
}
ACCURACIES = {
    "horizontal_accuracy_m",
    "vertical_accuracy_m",
    "baro_accuracy_m",
    "speed_accuracy_mps",
    "timestamp_accuracy_s",
}
SLACK = 1e-9


def assert_near(name: str, sent: Any, heard: Any) -> None:
    """`heard` is what `sent` may have become on the way."""
    if name in ACCURACIES and sent is not None:
        assert heard >= sent
    elif isinstance(sent, float):
        assert heard is not None, name
        off = abs(heard - sent)
        limit = HALF_STEP.get(name)
        if name == "direction_deg":
            off = min(off, 360 - off)
        elif name == "speed_mps":
            limit = 0.125 if sent <= 63.75 else 0.375
        elif limit is None:  # an altitude; at the very bottom the step to "unknown" is avoided
            limit = 0.25 if sent >= -999.75 else 0.5
        elif name == "timestamp_utc_s" and sent < EPOCH + 0.5:
            limit = 1.0
        assert limit is not None
        assert off <= limit + SLACK * max(1.0, abs(sent) * 1e-6), (name, sent, heard)
    elif isinstance(sent, bytes):
        assert heard[: len(sent)] == sent
        assert not heard[len(sent) :].strip(b"\0")
    else:
        assert heard == sent, name


@given(MESSAGES)
def test_a_message_comes_back_within_half_a_step(message: Message) -> None:
    data = encode(message)
    assert len(data) == 25
    assert data[0] & 15 == 2
    heard = decode(data)
    assert type(heard) is type(message)
    for info in msgspec.structs.fields(message):
        assert_near(info.name, getattr(message, info.name), getattr(heard, info.name))


@given(MESSAGES)
def test_what_was_decoded_encodes_to_the_same_bytes(message: Message) -> None:
    data = encode(message)
    assert encode(decode(data)) == data


@given(st.binary(min_size=25, max_size=25))
def test_whatever_decodes_can_be_sent_on(data: bytes) -> None:
    try:
        message = decode(data)
    except PeerDataError:
        return
    assert decode(encode(message)) == message


@dataclass(frozen=True)
class Limit:
    """The range of one float field."""

    make: type[Message]
    field: str
    lowest: float
    highest: float
    step: float

    def __str__(self) -> str:
        return f"{self.make.__name__}.{self.field}"


ALTITUDE = (-1000.0, 31767.5, 0.25)
LIMITS = [
    Limit(Location, "alt_geodetic_m", *ALTITUDE),
    Limit(Location, "alt_baro_m", *ALTITUDE),
    Limit(Location, "height_m", *ALTITUDE),
    Limit(Location, "direction_deg", 0.0, 360.0, 0.1),
    Limit(Location, "speed_mps", 0.0, 254.25, 0.01),
    Limit(Location, "vertical_speed_mps", -62.0, 62.0, 0.1),
    Limit(Location, "timestamp_s", 0.0, 3600.0, 0.05),
    Limit(Location, "lat_deg", -90.0, 90.0, 1e-7),
    Limit(Location, "lon_deg", -180.0, 180.0, 1e-7),
    Limit(System, "operator_lat_deg", -90.0, 90.0, 1e-7),
    Limit(System, "operator_lon_deg", -180.0, 180.0, 1e-7),
    Limit(System, "operator_alt_geodetic_m", *ALTITUDE),
    Limit(System, "area_ceiling_m", *ALTITUDE),
    Limit(System, "area_floor_m", *ALTITUDE),
    Limit(System, "area_radius_m", 0.0, 2550.0, 0.5),
    Limit(System, "timestamp_utc_s", EPOCH, EPOCH + 2**32 - 1, 0.5),
]


def with_value(limit: Limit, value: float) -> Message:
    fields: dict[str, float] = {limit.field: value}
    for lat, lon in (("lat_deg", "lon_deg"), ("operator_lat_deg", "operator_lon_deg")):
        if limit.field in (lat, lon):
            fields = {lat: 1.0, lon: 1.0} | fields
    return limit.make(**fields)  # type: ignore[arg-type]


@pytest.mark.parametrize("limit", LIMITS, ids=str)
def test_a_value_beyond_its_limits_is_refused_by_name_value_and_limit(limit: Limit) -> None:
    encode(with_value(limit, limit.lowest))
    encode(with_value(limit, limit.highest))
    for value in (limit.lowest - limit.step, limit.highest + limit.step, math.nan, math.inf, -math.inf):
        with pytest.raises(ValueError) as refusal:
            encode(with_value(limit, value))
        assert str(limit) in str(refusal.value)
        assert repr(value) in str(refusal.value)
        assert f"{limit.highest:.10g}" in str(refusal.value)


@pytest.mark.parametrize("field", sorted(ACCURACIES))
@pytest.mark.parametrize("value", [-0.1, math.nan, math.inf])
def test_an_accuracy_that_is_none_is_refused(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"Location.{field}"):
        encode(Location(**{field: value}))  # type: ignore[arg-type]


def auth(**changes: Any) -> Authentication:
    fields: dict[str, Any] = {"auth_type": 1, "page": 0, "data": b"", "last_page": 1, "length": 40}
    return Authentication(**(fields | changes))


REFUSED: list[tuple[str, Message]] = [
    ("BasicId.id_type", BasicId(id_type=16, ua_type=UaType.NONE, uas_id="")),  # type: ignore[arg-type]
    ("BasicId.ua_type", BasicId(id_type=IdType.NONE, ua_type=-1, uas_id="")),  # type: ignore[arg-type]
    ("BasicId.uas_id", BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.NONE, uas_id="x" * 21)),
    ("BasicId.uas_id", BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.NONE, uas_id="a\0b")),
    ("BasicId.uas_id", BasicId(id_type=IdType.UTM_ASSIGNED_UUID, ua_type=UaType.NONE, uas_id="\u0416")),
    ("Location.status", Location(status=16)),  # type: ignore[arg-type]
    ("Location.height_type", Location(height_type=2)),  # type: ignore[arg-type]
    ("Location.lat_deg", Location(lon_deg=3.0)),
    ("System.operator_lat_deg", System(operator_lat_deg=3.0)),
    ("Authentication.auth_type", auth(auth_type=16)),
    ("Authentication.page", auth(page=16)),
    ("Authentication.last_page", auth(last_page=16)),
    ("Authentication.last_page", auth(last_page=None)),
    ("Authentication.length", auth(length=41)),
    ("Authentication.length", auth(last_page=15, length=256)),
    ("Authentication.data", auth(data=bytes(18))),
    ("Authentication.data", Authentication(auth_type=1, page=1, data=bytes(24))),
    ("Authentication.length", auth(page=1, last_page=None)),
    ("SelfId.description_type", SelfId(description_type=256, text="")),
    ("SelfId.text", SelfId(description_type=0, text="x" * 24)),
    ("System.operator_location_type", System(operator_location_type=4)),  # type: ignore[arg-type]
    ("System.classification_type", System(classification_type=8)),  # type: ignore[arg-type]
    ("System.area_count", System(area_count=65536)),
    ("System.category_eu", System(category_eu=16)),
    ("System.class_eu", System(class_eu=-1)),
    ("OperatorId.operator_id_type", OperatorId(operator_id_type=-1, operator_id="")),
    ("OperatorId.operator_id", OperatorId(operator_id_type=0, operator_id="x" * 21)),
]


@pytest.mark.parametrize(("field", "message"), REFUSED)
def test_what_the_wire_cannot_hold_is_refused_by_name(field: str, message: Message) -> None:
    with pytest.raises(ValueError, match=field):
        encode(message)


def test_unknown_is_none_both_ways() -> None:
    data = encode(Location())
    assert data.hex() == "1203b5ff7e" + "00" * 16 + "ffff0000"
    assert decode(data) == Location()
    assert decode(encode(System())) == System()


def test_values_that_no_standard_allows_are_unknown() -> None:
    data = bytearray(encode(Location(lat_deg=47.0, lon_deg=8.0, alt_geodetic_m=500.0, timestamp_s=1.0)))
    data[5:9] = (1_112_865_576).to_bytes(4, "little")
    data[4] = 127
    data[2] = 250
    data[21:23] = (58766).to_bytes(2, "little")
    data[19] = 0xFF
    heard = decode(bytes(data))
    assert heard == Location(alt_geodetic_m=500.0)


@pytest.mark.parametrize(
    ("east_west", "byte", "degrees"),
    [(0, 179, 179.0), (0, 235, 235.0), (1, 0, 180.0), (1, 180, 0.0), (1, 181, None), (1, 250, None)],
)
def test_every_way_to_write_a_direction_is_read(east_west: int, byte: int, degrees: float | None) -> None:
    data = bytearray(encode(Location(direction_deg=0.0)))
    data[1] |= east_west << 1
    data[2] = byte
    heard = decode(bytes(data))
    assert isinstance(heard, Location)
    assert heard.direction_deg == degrees


def test_a_receiver_without_fix_says_unknown() -> None:
    heard = decode(encode(Location(lat_deg=0.0, lon_deg=0.0, alt_geodetic_m=-1000.0)))
    assert heard == Location(speed_mps=None)
    on_the_equator = Location(lat_deg=0.0, lon_deg=8.5)
    assert decode(encode(on_the_equator)) == on_the_equator


@pytest.mark.parametrize(
    ("field", "value", "heard"),
    [
        ("alt_geodetic_m", 100.26, 100.5),
        ("alt_geodetic_m", -0.3, -0.5),
        ("vertical_speed_mps", -1.3, -1.5),
        ("vertical_speed_mps", 1.3, 1.5),
        ("direction_deg", 359.6, 0.0),
        ("speed_mps", 63.75, 63.75),
        ("speed_mps", 64.2, 64.5),
        ("timestamp_s", 3599.96, 3600.0),
        ("alt_geodetic_m", -999.9, -999.5),
    ],
)
def test_rounding_is_to_nearest(field: str, value: float, heard: float) -> None:
    assert getattr(decode(encode(Location(**{field: value}))), field) == heard  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("accuracy", "heard"),
    [(0.0, 1.0), (1.0, 1.0), (1.01, 3.0), (3.0, 3.0), (29.0, 30.0), (18520.0, 18520.0), (18521.0, None)],
)
def test_an_accuracy_is_never_declared_better_than_it_is(accuracy: float, heard: float | None) -> None:
    result = decode(encode(Location(horizontal_accuracy_m=accuracy)))
    assert isinstance(result, Location)
    assert result.horizontal_accuracy_m == heard


@pytest.mark.parametrize(
    "scale",
    [
        wire_values.HORIZONTAL_ACCURACY_M,
        wire_values.VERTICAL_ACCURACY_M,
        wire_values.SPEED_ACCURACY_MPS,
        wire_values.TIMESTAMP_ACCURACY_S,
    ],
)
def test_every_category_is_its_bounds(scale: wire_values.AccuracyScale) -> None:
    for category in range(16):
        known = category <= scale.highest
        assert scale.category("x", scale.bound(category)) == (category if known else 0)
    with pytest.raises(ValueError):
        scale.bound(16)


@pytest.mark.parametrize("version", [0, 1, 2, 3, 15])
def test_every_version_is_read(version: int) -> None:
    data = encode(SelfId(description_type=1, text="hello"))
    assert decode(bytes((0x30 | version,)) + data[1:]) == SelfId(description_type=1, text="hello")


def test_reserved_numbers_survive() -> None:
    message = BasicId(id_type=IdType(9), ua_type=UaType.GLIDER, uas_id="\x00\xff\x01")
    assert decode(encode(message)) == message
    as_json = msgspec.json.encode(message)
    assert msgspec.json.decode(as_json, type=BasicId) == message
    assert IdType(9) is IdType(9)
    with pytest.raises(ValueError):
        IdType(16)
