"""OPEN_DRONE_ID_*: layouts against pymavlink's, unknowns, what cannot be, packs."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from companion.autopilot.wire import Frame, FrameScanner, MavlinkWriter
from companion.errors import PeerDataError
from companion.remote_id import codec, mavlink
from companion.remote_id.mavlink import (
    NO_ID,
    Odid,
    SystemUpdate,
    decode_arm_status,
    decode_odid,
    encode_arm_status,
    encode_message_pack,
    encode_odid,
    updated,
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
from tests.companion.remote_id.odid import EPOCH, LAST_SECOND, MAC
from tests.support.place import HOME, LAT_E7, LON_E7

# ---------------------------------------------------------------- layouts

LOCATION = Location(
    status=Status.AIRBORNE,
    lat_deg=HOME.lat_deg,
    lon_deg=-HOME.lon_deg,
    alt_geodetic_m=430.25,
    alt_baro_m=399.5,
    height_type=HeightType.ABOVE_GROUND,
    height_m=30.0,
    direction_deg=359.25,
    speed_mps=5.07,
    vertical_speed_mps=-1.23,
    horizontal_accuracy_m=10.0,
    vertical_accuracy_m=3.0,
    baro_accuracy_m=150.0,
    speed_accuracy_mps=0.3,
    timestamp_s=1424.8,
    timestamp_accuracy_s=1.0,
)
SYSTEM = System(
    operator_location_type=OperatorLocationType.LIVE_GNSS,
    classification_type=ClassificationType.EU,
    operator_lat_deg=47.3969,
    operator_lon_deg=8.5449,
    operator_alt_geodetic_m=390.0,
    area_count=3,
    area_radius_m=120.0,
    area_ceiling_m=500.0,
    area_floor_m=400.5,
    category_eu=1,
    class_eu=2,
    timestamp_utc_s=EPOCH + 1000,
)
UNKNOWN_LOCATION_FIELDS = {
    "direction": 36100,
    "speed_horizontal": 25500,
    "speed_vertical": 6300,
    "latitude": 0,
    "longitude": 0,
    "altitude_barometric": -1000.0,
    "altitude_geodetic": -1000.0,
    "height": -1000.0,
    "timestamp": 65535.0,
}


def theirs_location(**over: Any) -> Any:
    fields = {
        "status": 2,
        "direction": 35925,
        "speed_horizontal": 507,
        "speed_vertical": -123,
        "latitude": LAT_E7,
        "longitude": -LON_E7,
        "altitude_barometric": 399.5,
        "altitude_geodetic": 430.25,
        "height_reference": 1,
        "height": 30.0,
        "horizontal_accuracy": 10,
        "vertical_accuracy": 5,
        "barometer_accuracy": 1,
        "speed_accuracy": 4,
        "timestamp": 1424.8,
        "timestamp_accuracy": 10,
    }
    return dialect.MAVLink_open_drone_id_location_message(7, 236, MAC, **{**fields, **over})


def theirs_system(**over: Any) -> Any:
    fields = {
        "operator_location_type": 1,
        "classification_type": 1,
        "operator_latitude": 473969000,
        "operator_longitude": 85449000,
        "area_count": 3,
        "area_radius": 120,
        "area_ceiling": 500.0,
        "area_floor": 400.5,
        "category_eu": 1,
        "class_eu": 2,
        "operator_altitude_geo": 390.0,
        "timestamp": 1000,
    }
    return dialect.MAVLink_open_drone_id_system_message(7, 236, MAC, **{**fields, **over})


def theirs_authentication(**over: Any) -> Any:
    fields = {"authentication_type": 1, "data_page": 0, "last_page_index": 2, "length": 50, "timestamp": 77}
    data = bytes(range(1, 18)).ljust(23, b"\0")
    return dialect.MAVLink_open_drone_id_authentication_message(
        7, 236, MAC, **{**fields, "authentication_data": data, **over}
    )


PAIRS: list[tuple[Message, Any]] = [
    (
        BasicId(
            id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id="SITLTEST0123456789"
        ),
        dialect.MAVLink_open_drone_id_basic_id_message(
            7, 236, MAC, 1, 2, b"SITLTEST0123456789".ljust(20, b"\0")
        ),
    ),
    (LOCATION, theirs_location()),
    (
        Authentication(
            auth_type=1,
            page=0,
            data=bytes(range(1, 18)),
            last_page=2,
            length=50,
            timestamp_utc_s=EPOCH + 77,
        ),
        theirs_authentication(),
    ),
    (
        Authentication(auth_type=3, page=2, data=bytes(range(200, 223))),
        dialect.MAVLink_open_drone_id_authentication_message(
            7, 236, MAC, 3, 2, 0, 0, 0, bytes(range(200, 223))
        ),
    ),
    (
        SelfId(description_type=1, text="survey of the north"),
        dialect.MAVLink_open_drone_id_self_id_message(7, 236, MAC, 1, b"survey of the north"),
    ),
    (SYSTEM, theirs_system()),
    (
        OperatorId(operator_id_type=0, operator_id="FIN87astrdge12k8"),
        dialect.MAVLink_open_drone_id_operator_id_message(7, 236, MAC, 0, b"FIN87astrdge12k8"),
    ),
]
NAMES = [theirs.get_type() for _, theirs in PAIRS]


def frame_of(message: Any) -> Frame:
    (frame,) = FrameScanner().frames(MavlinkWriter(1, 1).pack(message))
    return frame


def read(message: Any) -> Odid:
    frame = frame_of(message)
    return decode_odid(frame.message_id, frame.payload)


@pytest.mark.parametrize(("ours", "theirs"), PAIRS, ids=NAMES)
def test_layout_is_pymavlinks_both_ways(ours: Message, theirs: Any) -> None:
    packed = MavlinkWriter(1, 1).pack_payload(*encode_odid(ours, 7, 236, MAC))
    assert packed == MavlinkWriter(1, 1).pack(theirs)
    assert read(theirs) == Odid(7, 236, MAC, (ours,))


def test_a_pack_and_an_arm_status_are_laid_out_as_pymavlink_does() -> None:
    messages = tuple(ours for ours, _ in PAIRS)
    data = b"".join(map(codec.encode, messages)).ljust(225, b"\0")
    theirs = dialect.MAVLink_open_drone_id_message_pack_message(7, 236, MAC, 25, 7, data)
    packed = MavlinkWriter(1, 1).pack_payload(*encode_message_pack(messages, 7, 236, MAC))
    assert packed == MavlinkWriter(1, 1).pack(theirs)
    assert read(theirs).messages == codec.decode_pack(codec.encode_pack(messages))
    status = MavlinkWriter(1, 236).pack_payload(*encode_arm_status(False, "missing basic_id message"))
    assert status == MavlinkWriter(1, 236).pack(
        dialect.MAVLink_open_drone_id_arm_status_message(1, b"missing basic_id message")
    )


@pytest.mark.parametrize("ready", [True, False])
def test_arm_status_comes_back(ready: bool) -> None:
    assert decode_arm_status(encode_arm_status(ready, "x" * 60)[1].rstrip(b"\0")) == (ready, "x" * 50)
    assert decode_arm_status(encode_arm_status(ready, "höhe\0")[1]) == (ready, "h?he?")
    assert decode_arm_status(b"") == (True, "")
    assert decode_arm_status(b"\x07") == (False, "")  # no MAV_ODID_ARM_STATUS that exists


def test_system_update_is_a_part_of_a_system() -> None:
    odid = read(dialect.MAVLink_open_drone_id_system_update_message(7, 0, 473969000, 85449000, 390.5, 1000))
    update = SystemUpdate(47.3969, 8.5449, 390.5, EPOCH + 1000)
    assert odid == Odid(7, 0, NO_ID, system_update=update)
    merged = updated(SYSTEM, update)
    assert merged.operator_alt_geodetic_m == 390.5
    assert (merged.area_count, merged.category_eu) == (SYSTEM.area_count, SYSTEM.category_eu)
    nothing = read(dialect.MAVLink_open_drone_id_system_update_message(0, 0, 0, 0, -1000.0, 0))
    assert nothing.system_update == SystemUpdate(None, None, None, None)


# ---------------------------------------------------------------- unknown


def test_unknown_is_none_both_ways() -> None:
    theirs = theirs_location(
        **UNKNOWN_LOCATION_FIELDS,
        horizontal_accuracy=0,
        vertical_accuracy=0,
        barometer_accuracy=0,
        speed_accuracy=0,
        timestamp_accuracy=0,
    )
    nothing = Location(status=Status.AIRBORNE, height_type=HeightType.ABOVE_GROUND)
    assert read(theirs).messages == (nothing,)
    assert encode_odid(nothing, 7, 236, MAC)[1].rstrip(b"\0") == frame_of(theirs).payload
    theirs = theirs_system(
        operator_latitude=0,
        operator_longitude=0,
        operator_altitude_geo=-1000.0,
        area_ceiling=-1000.0,
        area_floor=-1000.0,
        timestamp=0,
    )
    (system,) = read(theirs).messages
    assert isinstance(system, System)
    assert system.operator_lat_deg is system.operator_lon_deg is system.operator_alt_geodetic_m is None
    assert system.area_ceiling_m is system.area_floor_m is system.timestamp_utc_s is None
    assert encode_odid(system, 7, 236, MAC)[1].rstrip(b"\0") == frame_of(theirs).payload


@pytest.mark.parametrize("seconds", [LAST_SECOND + 1, LAST_SECOND + 50, 2**32 - 1])
def test_a_clock_before_2019_is_no_time(seconds: int) -> None:
    (system,) = read(theirs_system(timestamp=seconds)).messages
    assert isinstance(system, System)
    assert system.timestamp_utc_s is None
    update = dialect.MAVLink_open_drone_id_system_update_message(0, 0, 1, 1, 0.0, seconds)
    assert read(update).system_update == SystemUpdate(1e-7, 1e-7, 0.0, None)
    with pytest.raises(ValueError, match=r"System\.timestamp_utc_s"):
        encode_odid(System(timestamp_utc_s=EPOCH + seconds), 0, 0)


def test_a_direction_of_360_degrees_is_north() -> None:
    (location,) = read(theirs_location(direction=36000)).messages
    assert isinstance(location, Location)
    assert location.direction_deg == 0.0
    assert read(theirs_location(direction=0)).messages == (location,)


@pytest.mark.parametrize(
    ("field", "value", "name"),
    [
        ("direction", 36001, "direction_deg"),
        ("direction", 43500, "direction_deg"),
        ("speed_vertical", 6350, "vertical_speed_mps"),
        ("speed_vertical", -6400, "vertical_speed_mps"),
        ("timestamp", 3600.5, "timestamp_s"),
        ("timestamp", 6553.4, "timestamp_s"),
        ("timestamp", math.nan, "timestamp_s"),
        ("timestamp", -math.inf, "timestamp_s"),
    ],
)
def test_what_others_send_against_the_standard_does_not_hide_their_place(
    field: str, value: float, name: str
) -> None:
    """From our own radio, such a value is unknown. From a receiver on the link, it hid the aircraft."""
    (sound,) = read(theirs_location()).messages
    (odd,) = read(theirs_location(**{field: value})).messages
    assert getattr(sound, name) is not None
    assert odd == msgspec.structs.replace(sound, **{name: None})


# ---------------------------------------------------------------- what cannot be

REFUSED = [
    (theirs_location(speed_horizontal=25426), "Location.speed_mps", "254.25"),
    (theirs_location(latitude=900000001), "Location.lat_deg", "90"),
    (theirs_location(longitude=-1800000001), "Location.lon_deg", "-180"),
    (theirs_location(altitude_barometric=-1000.5), "Location.alt_baro_m", "-1000"),
    (theirs_location(altitude_geodetic=math.nan), "Location.alt_geodetic_m", "-1000"),
    (theirs_location(height=math.inf), "Location.height_m", "31767.5"),
    (theirs_location(status=16), "Location.status", "15"),
    (theirs_location(height_reference=2), "Location.height_type", "1"),
    (theirs_location(horizontal_accuracy=16), "Location.horizontal_accuracy_m", "15"),
    (theirs_system(area_radius=2551), "System.area_radius_m", "2550"),
    (theirs_system(operator_latitude=900000001), "System.operator_lat_deg", "90"),
    (theirs_system(operator_location_type=4), "System.operator_location_type", "3"),
    (theirs_system(classification_type=8), "System.classification_type", "7"),
    (theirs_system(category_eu=16), "System.category_eu", "15"),
    (theirs_system(area_ceiling=math.nan), "System.area_ceiling_m", "31767.5"),
    (theirs_authentication(data_page=16), "Authentication.page", "15"),
    (theirs_authentication(authentication_type=16), "Authentication.auth_type", "15"),
    (theirs_authentication(length=64), "Authentication.length", "63"),
    (theirs_authentication(last_page_index=16), "Authentication.last_page", "15"),
    (
        dialect.MAVLink_open_drone_id_basic_id_message(0, 0, NO_ID, 16, 2, NO_ID),
        "BasicId.id_type",
        "15",
    ),
    (
        dialect.MAVLink_open_drone_id_basic_id_message(0, 0, NO_ID, 1, 16, NO_ID),
        "BasicId.ua_type",
        "15",
    ),
    (
        dialect.MAVLink_open_drone_id_system_update_message(0, 0, 900000001, 0, 0.0, 0),
        "System.operator_lat_deg",
        "90",
    ),
    (
        dialect.MAVLink_open_drone_id_system_update_message(0, 0, 0, 0, math.nan, 0),
        "System.operator_alt_geodetic_m",
        "31767.5",
    ),
]


@pytest.mark.parametrize(("theirs", "field", "limit"), REFUSED)
def test_values_that_cannot_be_are_refused_by_field_and_limit(theirs: Any, field: str, limit: str) -> None:
    with pytest.raises(PeerDataError, match=field) as error:
        read(theirs)
    assert limit in str(error.value)


@pytest.mark.parametrize("message_id", [0, 12906, mavlink.ARM_STATUS])
def test_other_messages_are_refused(message_id: int) -> None:
    with pytest.raises(PeerDataError, match=str(message_id)):
        decode_odid(message_id, b"")


@pytest.mark.parametrize(
    "message",
    [Location(alt_baro_m=math.nan), Location(lat_deg=1.0), SelfId(description_type=0, text="x" * 24)],
)
def test_what_cannot_go_on_the_air_is_not_sent(message: Message) -> None:
    with pytest.raises(ValueError, match="allowed"):
        encode_odid(message, 0, 0)


def test_targets_and_addresses_must_fit() -> None:
    with pytest.raises(ValueError, match="target_system"):
        encode_odid(LOCATION, 256, 0)
    with pytest.raises(ValueError, match="target_component"):
        encode_message_pack([LOCATION], 0, -1)
    with pytest.raises(ValueError, match="id_or_mac"):
        encode_odid(LOCATION, 0, 0, b"short")
    with pytest.raises(ValueError, match="0 messages"):
        encode_message_pack([], 0, 0)


# ---------------------------------------------------------------- packs


def pack(size: int, count: int, data: bytes) -> Odid:
    return read(
        dialect.MAVLink_open_drone_id_message_pack_message(0, 0, MAC, size, count, data.ljust(225, b"\0"))
    )


def test_a_pack_that_claims_ten_messages_is_survived() -> None:
    page = codec.encode(Authentication(auth_type=1, page=3, data=b"x"))
    odid = pack(25, 10, codec.encode(LOCATION) + page * 8)
    assert len(odid.messages) == 9
    assert isinstance(odid.messages[0], Location)
    assert any("10 messages" in fault for fault in odid.faults)


def test_a_pack_is_read_as_far_as_it_can_be() -> None:
    odid = pack(25, 3, codec.encode(SYSTEM) + b"\xa2".ljust(25, b"\0") + codec.encode(LOCATION))
    assert [type(m) for m in odid.messages] == [System, Location]
    assert len(odid.faults) == 1
    assert pack(25, 0, b"").messages == ()
    with pytest.raises(PeerDataError, match="message size 24"):
        pack(24, 1, b"")


@pytest.mark.parametrize(
    ("id_or_mac", "address"),
    [
        (MAC, "c0:ff:ee:12:34:56"),
        (bytes.fromhex("c0ffee120000").ljust(20, b"\0"), "c0:ff:ee:12:00:00"),
        (b"ABCDEFGH".ljust(20, b"\0"), b"ABCDEFGH".hex()),
        (NO_ID, ""),
    ],
)
def test_addresses(id_or_mac: bytes, address: str) -> None:
    assert Odid(0, 0, id_or_mac).address == address
