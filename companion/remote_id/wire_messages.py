"""Converts between one Remote ID message and its 25 bytes.

The layouts are those of ASTM F3411-22a section 5.4, read off the public reference implementation
opendroneid-core-c. `wire_values` holds the scalings, `codec` the packs and the rules for reading.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Final

from companion.errors import PeerDataError
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
from companion.remote_id.wire_values import (
    CLIMBS_MPS,
    DIRECTIONS_DEG,
    HORIZONTAL_ACCURACY_M,
    SPEED_ACCURACY_MPS,
    SPEEDS_MPS,
    TIMESTAMP_ACCURACY_S,
    VERTICAL_ACCURACY_M,
    altitude_from_wire,
    altitude_to_wire,
    check_integer,
    climb_to_wire,
    direction_to_wire,
    hour_time_from_wire,
    hour_time_to_wire,
    position_from_wire,
    position_to_wire,
    radius_to_wire,
    raw_text_from_wire,
    raw_text_to_wire,
    refuse,
    speed_to_wire,
    text_from_wire,
    text_to_wire,
    utc_from_wire,
    utc_to_wire,
)

MESSAGE_SIZE: Final = 25
PROTOCOL_VERSION: Final = 2
"""Protocol version of F3411-22a, used for every message that we send."""
PACK_TYPE: Final = 0xF

_PAGE_0_DATA: Final = 17
_PAGE_DATA: Final = 23
_LAST_PAGE_MAX: Final = 15

# The first byte of every layout holds type and version; x is reserved.
_BASIC_ID: Final = struct.Struct("<BB20s3x")
_LOCATION: Final = struct.Struct("<BBBBBiiHHHBBHBx")
_AUTH_PAGE_0: Final = struct.Struct("<BBBBI17s")
_AUTH_PAGE: Final = struct.Struct("<BB23s")
_SELF_ID: Final = struct.Struct("<BB23s")
_SYSTEM: Final = struct.Struct("<BBiiHBHHBHIx")
_OPERATOR_ID: Final = struct.Struct("<BB20s3x")

# Lookup by number, because calling the enumeration takes ten times as long.
_ID_TYPES: Final = tuple(IdType(code) for code in range(16))
_UA_TYPES: Final = tuple(UaType(code) for code in range(16))
_STATUSES: Final = tuple(Status(code) for code in range(16))
_HEIGHT_TYPES: Final = tuple(HeightType(code) for code in range(2))
_OPERATOR_LOCATION_TYPES: Final = tuple(OperatorLocationType(code) for code in range(4))
_CLASSIFICATION_TYPES: Final = tuple(ClassificationType(code) for code in range(8))

_HORIZONTAL_BOUNDS: Final = HORIZONTAL_ACCURACY_M.bounds
_VERTICAL_BOUNDS: Final = VERTICAL_ACCURACY_M.bounds
_SPEED_BOUNDS: Final = SPEED_ACCURACY_MPS.bounds
_TIMESTAMP_BOUNDS: Final = TIMESTAMP_ACCURACY_S.bounds
_TEXT_IDS: Final = (IdType.SERIAL_NUMBER, IdType.CAA_REGISTRATION)


def encode(message: Message) -> bytes:
    """Encode a message in 25 bytes, protocol version 2. Raises ValueError for values that do not fit."""
    writer = _WRITERS.get(type(message))
    if writer is None:
        raise TypeError(f"{type(message).__name__} is not a Remote ID message")
    return writer(message)


def decode(data: bytes) -> Message:
    """Decode the message in exactly 25 bytes. Raises PeerDataError."""
    if len(data) != MESSAGE_SIZE:
        raise PeerDataError(f"message of {len(data)} bytes, expected {MESSAGE_SIZE}")
    reader = _READERS[data[0] >> 4]
    if reader is None:
        kind = "is a pack inside a pack" if data[0] >> 4 == PACK_TYPE else "is reserved"
        raise PeerDataError(f"message type {data[0] >> 4} at offset 0 {kind}")
    return reader(data)


def message_type(message: Message) -> int:
    """Return the number of a message's type on the wire, 0 to 5."""
    return _TYPES[type(message)]


def _encode_basic_id(message: BasicId) -> bytes:
    id_type = check_integer("BasicId.id_type", message.id_type, 15)
    ua_type = check_integer("BasicId.ua_type", message.ua_type, 15)
    write = text_to_wire if id_type in _TEXT_IDS else raw_text_to_wire
    return _BASIC_ID.pack(
        PROTOCOL_VERSION, id_type << 4 | ua_type, write("BasicId.uas_id", message.uas_id, 20)
    )


def _decode_basic_id(data: bytes) -> BasicId:
    _, types, text = _BASIC_ID.unpack(data)
    id_type = _ID_TYPES[types >> 4]
    read = text_from_wire if id_type in _TEXT_IDS else raw_text_from_wire
    return BasicId(id_type=id_type, ua_type=_UA_TYPES[types & 15], uas_id=read(text))


def _encode_location(m: Location) -> bytes:
    status, height_type = m.status, m.height_type
    if not 0 <= status <= 15:
        refuse("Location.status", status, "0 to 15")
    if not 0 <= height_type <= 1:
        refuse("Location.height_type", height_type, "0 to 1")
    east_west, direction = direction_to_wire("Location.direction_deg", m.direction_deg)
    multiplier, speed = speed_to_wire("Location.speed_mps", m.speed_mps)
    lat, lon = position_to_wire("Location.", m.lat_deg, m.lon_deg)
    horizontal = HORIZONTAL_ACCURACY_M.category("Location.horizontal_accuracy_m", m.horizontal_accuracy_m)
    vertical = VERTICAL_ACCURACY_M.category("Location.vertical_accuracy_m", m.vertical_accuracy_m)
    baro = VERTICAL_ACCURACY_M.category("Location.baro_accuracy_m", m.baro_accuracy_m)
    speed_accuracy = SPEED_ACCURACY_MPS.category("Location.speed_accuracy_mps", m.speed_accuracy_mps)
    return _LOCATION.pack(
        0x10 | PROTOCOL_VERSION,
        status << 4 | height_type << 2 | east_west << 1 | multiplier,
        direction,
        speed,
        climb_to_wire("Location.vertical_speed_mps", m.vertical_speed_mps) & 0xFF,
        lat,
        lon,
        altitude_to_wire("Location.alt_baro_m", m.alt_baro_m),
        altitude_to_wire("Location.alt_geodetic_m", m.alt_geodetic_m),
        altitude_to_wire("Location.height_m", m.height_m),
        vertical << 4 | horizontal,
        baro << 4 | speed_accuracy,
        hour_time_to_wire("Location.timestamp_s", m.timestamp_s),
        TIMESTAMP_ACCURACY_S.category("Location.timestamp_accuracy_s", m.timestamp_accuracy_s),
    )


def _decode_location(data: bytes) -> Location:
    (
        _,
        flags,
        direction,
        speed,
        climb,
        lat,
        lon,
        baro,
        geodetic,
        height,
        position_accuracies,
        other_accuracies,
        timestamp,
        timestamp_accuracy,
    ) = _LOCATION.unpack(data)
    lat_deg, lon_deg = position_from_wire(lat, lon)
    return Location(
        status=_STATUSES[flags >> 4],
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_geodetic_m=altitude_from_wire(geodetic),
        alt_baro_m=altitude_from_wire(baro),
        height_type=_HEIGHT_TYPES[flags >> 2 & 1],
        height_m=altitude_from_wire(height),
        direction_deg=DIRECTIONS_DEG[(flags & 2) << 7 | direction],
        speed_mps=SPEEDS_MPS[(flags & 1) << 8 | speed],
        vertical_speed_mps=CLIMBS_MPS[climb],
        horizontal_accuracy_m=_HORIZONTAL_BOUNDS[position_accuracies & 15],
        vertical_accuracy_m=_VERTICAL_BOUNDS[position_accuracies >> 4],
        baro_accuracy_m=_VERTICAL_BOUNDS[other_accuracies >> 4],
        speed_accuracy_mps=_SPEED_BOUNDS[other_accuracies & 15],
        timestamp_s=hour_time_from_wire(timestamp),
        timestamp_accuracy_s=_TIMESTAMP_BOUNDS[timestamp_accuracy & 15],
    )


def _encode_authentication(message: Authentication) -> bytes:
    auth_type = check_integer("Authentication.auth_type", message.auth_type, 15)
    page = check_integer("Authentication.page", message.page, _LAST_PAGE_MAX)
    room = _PAGE_DATA if page else _PAGE_0_DATA
    if len(message.data) > room:
        refuse("Authentication.data", message.data, f"at most {room} bytes on page {page}")
    head = 0x20 | PROTOCOL_VERSION
    if page:
        for field in ("last_page", "length", "timestamp_utc_s"):
            if getattr(message, field) is not None:
                refuse(f"Authentication.{field}", getattr(message, field), f"None on page {page}")
        return _AUTH_PAGE.pack(head, auth_type << 4 | page, message.data)
    if message.last_page is None or message.length is None:
        refuse("Authentication.last_page, length", (message.last_page, message.length), "both, on page 0")
    last_page = check_integer("Authentication.last_page", message.last_page, _LAST_PAGE_MAX)
    capacity = min(255, _PAGE_0_DATA + _PAGE_DATA * last_page)
    length = check_integer("Authentication.length", message.length, capacity)
    utc = utc_to_wire("Authentication.timestamp_utc_s", message.timestamp_utc_s)
    return _AUTH_PAGE_0.pack(head, auth_type << 4, last_page, length, utc, message.data)


def _decode_authentication(data: bytes) -> Authentication:
    page = data[1] & 15
    if page:
        return Authentication(auth_type=data[1] >> 4, page=page, data=data[2:])
    _, types, last_page, length, timestamp, content = _AUTH_PAGE_0.unpack(data)
    if last_page > _LAST_PAGE_MAX:
        raise PeerDataError(f"authentication last page {last_page} at offset 2, at most {_LAST_PAGE_MAX}")
    if length > _PAGE_0_DATA + _PAGE_DATA * last_page:
        raise PeerDataError(f"authentication length {length} at offset 3 exceeds its {last_page + 1} pages")
    return Authentication(
        auth_type=types >> 4,
        page=0,
        data=content,
        last_page=last_page,
        length=length,
        timestamp_utc_s=utc_from_wire(timestamp),
    )


def _encode_self_id(message: SelfId) -> bytes:
    kind = check_integer("SelfId.description_type", message.description_type, 255)
    return _SELF_ID.pack(0x30 | PROTOCOL_VERSION, kind, text_to_wire("SelfId.text", message.text, 23))


def _decode_self_id(data: bytes) -> SelfId:
    return SelfId(description_type=data[1], text=text_from_wire(data[2:]))


def _encode_system(m: System) -> bytes:
    location_type = check_integer("System.operator_location_type", m.operator_location_type, 3)
    classification = check_integer("System.classification_type", m.classification_type, 7)
    lat, lon = position_to_wire("System.operator_", m.operator_lat_deg, m.operator_lon_deg)
    category = check_integer("System.category_eu", m.category_eu, 15)
    return _SYSTEM.pack(
        0x40 | PROTOCOL_VERSION,
        classification << 2 | location_type,
        lat,
        lon,
        check_integer("System.area_count", m.area_count, 0xFFFF),
        radius_to_wire("System.area_radius_m", m.area_radius_m),
        altitude_to_wire("System.area_ceiling_m", m.area_ceiling_m),
        altitude_to_wire("System.area_floor_m", m.area_floor_m),
        category << 4 | check_integer("System.class_eu", m.class_eu, 15),
        altitude_to_wire("System.operator_alt_geodetic_m", m.operator_alt_geodetic_m),
        utc_to_wire("System.timestamp_utc_s", m.timestamp_utc_s),
    )


def _decode_system(data: bytes) -> System:
    _, flags, lat, lon, count, radius, ceiling, floor, eu, altitude, timestamp = _SYSTEM.unpack(data)
    lat_deg, lon_deg = position_from_wire(lat, lon)
    return System(
        operator_location_type=_OPERATOR_LOCATION_TYPES[flags & 3],
        classification_type=_CLASSIFICATION_TYPES[flags >> 2 & 7],
        operator_lat_deg=lat_deg,
        operator_lon_deg=lon_deg,
        operator_alt_geodetic_m=altitude_from_wire(altitude),
        area_count=count,
        area_radius_m=radius * 10.0,
        area_ceiling_m=altitude_from_wire(ceiling),
        area_floor_m=altitude_from_wire(floor),
        category_eu=eu >> 4,
        class_eu=eu & 15,
        timestamp_utc_s=utc_from_wire(timestamp),
    )


def _encode_operator_id(message: OperatorId) -> bytes:
    kind = check_integer("OperatorId.operator_id_type", message.operator_id_type, 255)
    text = text_to_wire("OperatorId.operator_id", message.operator_id, 20)
    return _OPERATOR_ID.pack(0x50 | PROTOCOL_VERSION, kind, text)


def _decode_operator_id(data: bytes) -> OperatorId:
    return OperatorId(operator_id_type=data[1], operator_id=text_from_wire(data[2:22]))


_TYPES: Final[dict[type[Message], int]] = {
    BasicId: 0,
    Location: 1,
    Authentication: 2,
    SelfId: 3,
    System: 4,
    OperatorId: 5,
}
_WRITERS: Final[dict[type[Message], Callable[..., bytes]]] = {
    BasicId: _encode_basic_id,
    Location: _encode_location,
    Authentication: _encode_authentication,
    SelfId: _encode_self_id,
    System: _encode_system,
    OperatorId: _encode_operator_id,
}
_READERS: Final[tuple[Callable[[bytes], Message] | None, ...]] = (
    _decode_basic_id,
    _decode_location,
    _decode_authentication,
    _decode_self_id,
    _decode_system,
    _decode_operator_id,
    *([None] * 10),
)
