"""Converts between Remote ID messages and MAVLink OPEN_DRONE_ID_* payloads (common.xml, 12900-12919).

MAVLink carries the same fields as ASTM F3411-22a in its own units: 1e-7 degrees, centimetres a second,
hundredths of a degree, metres as 32-bit floats. Its special values for "unknown" are `None` here. A payload
is laid out in wire order (fields sorted by size, as in MAVLink). The tests compare every layout with
pymavlink's.

The limits of `codec` apply in both directions: a message that is encoded or decoded here can also go on the
air. MAVLink has the finer resolution, so a message received over the air passes through it unaltered. Two
kinds of timestamp are treated as unknown although they are numbers: 0, and 2106 or later. A sender whose
clock is before 2019 (PX4 without GNSS time) produces the latter.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from companion.errors import PeerDataError
from companion.remote_id.codec import MESSAGE_SIZE, PACK_TYPE, encode, encode_pack, read_payload
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
    EPOCH_2019_UTC_S,
    HORIZONTAL_ACCURACY_M,
    SPEED_ACCURACY_MPS,
    TIMESTAMP_ACCURACY_S,
    VERTICAL_ACCURACY_M,
    AccuracyScale,
    check_integer,
    position_to_wire,
    raw_text_from_wire,
    refuse,
    text_from_wire,
    utc_from_wire,
    utc_to_wire,
)

BASIC_ID: Final = 12900
LOCATION: Final = 12901
AUTHENTICATION: Final = 12902
SELF_ID: Final = 12903
SYSTEM: Final = 12904
OPERATOR_ID: Final = 12905
MESSAGE_PACK: Final = 12915
ARM_STATUS: Final = 12918
SYSTEM_UPDATE: Final = 12919

COMPONENT_ID: Final = 236
"""MAV_COMP_ID_ODID_TXRX_1: the usual component ID of a vehicle's Remote ID transmitter."""
MAV_TYPE: Final = 34
"""MAV_TYPE_ODID."""
NO_ID: Final = bytes(20)
"""`id_or_mac` for own data. Any other value marks data that a receiver got from another aircraft."""

_DIRECTION_UNKNOWN: Final = 36100
_SPEED_UNKNOWN: Final = 25500
_CLIMB_UNKNOWN: Final = 6300
_ALTITUDE_UNKNOWN_M: Final = -1000.0
_ALTITUDE_LOWEST_M: Final = -999.9999
"""Lowest known altitude. As a 32-bit float it is still distinct from "unknown", -1000 m."""
_TIMESTAMP_UNKNOWN_S: Final = 65535.0
_UNDERFLOW: Final = 2**32 - round(EPOCH_2019_UTC_S)
"""Unix time 0 as seconds since 2019, wrapped to an unsigned 32-bit integer."""
_PAGE_0_DATA: Final = 17
_PACK_ROOM: Final = 225
_GOOD_TO_ARM: Final = 0
_PRE_ARM_FAIL: Final = 1
_ERROR_BYTES: Final = 50

# All but ARM_STATUS hold target_system and target_component; of these, all but SYSTEM_UPDATE also hold
# id_or_mac.
_BASIC_ID: Final = struct.Struct("<BB20sBB20s")
_LOCATION: Final = struct.Struct("<iiffffHHhBB20sBBBBBBB")
_AUTHENTICATION: Final = struct.Struct("<IBB20sBBBB23s")
_SELF_ID: Final = struct.Struct("<BB20sB23s")
_SYSTEM: Final = struct.Struct("<iifffIHHBB20sBBBB")
_OPERATOR_ID: Final = struct.Struct("<BB20sB20s")
_PACK: Final = struct.Struct("<BB20sBB225s")
_ARM_STATUS: Final = struct.Struct("<B50s")
_SYSTEM_UPDATE: Final = struct.Struct("<iifIBB")

_TEXT_IDS: Final = (IdType.SERIAL_NUMBER, IdType.CAA_REGISTRATION)


@dataclass(frozen=True, slots=True)
class SystemUpdate:
    """OPEN_DRONE_ID_SYSTEM_UPDATE: the fields of a System that change while the operator moves."""

    operator_lat_deg: float | None
    operator_lon_deg: float | None
    operator_alt_geodetic_m: float | None
    timestamp_utc_s: float | None


@dataclass(frozen=True, slots=True)
class Odid:
    """Content of one OPEN_DRONE_ID_* message."""

    target_system: int
    """0 addresses all systems."""
    target_component: int
    id_or_mac: bytes
    """20 bytes; `NO_ID` for own data."""
    messages: tuple[Message, ...] = ()
    """One message; any number from a MESSAGE_PACK; none from a SYSTEM_UPDATE."""
    system_update: SystemUpdate | None = None
    faults: tuple[str, ...] = ()
    """Descriptions of the parts of a MESSAGE_PACK that had to be left out."""

    @property
    def address(self) -> str:
        """`id_or_mac` in the notation of radios: a MAC with colons, anything longer as plain hexadecimal."""
        data = self.id_or_mac.rstrip(b"\0")
        if not data:
            return ""
        # A MAC may itself end with zeros.
        return data.ljust(6, b"\0").hex(":") if len(data) <= 6 else data.hex()


@dataclass(frozen=True, slots=True)
class _To:
    """Fields that most messages share."""

    target: tuple[int, int]
    id_or_mac: bytes


# ---------------------------------------------------------------- messages to payloads


def encode_odid(
    message: Message, target_system: int, target_component: int, id_or_mac: bytes = NO_ID
) -> tuple[int, bytes]:
    """Encode a message. Return its message ID and payload.

    Raises:
        ValueError: a message that cannot go on the air (`codec.encode`); one that MAVLink cannot hold (a
            timestamp in 2106 or later); a target or `id_or_mac` that does not fit.
    """
    encode(message)
    to = _to(target_system, target_component, id_or_mac)
    message_id, write = _WRITERS[type(message)]
    return message_id, write(message, to)


def encode_message_pack(
    messages: Sequence[Message], target_system: int, target_component: int, id_or_mac: bytes = NO_ID
) -> tuple[int, bytes]:
    """Encode 1 to 9 messages as one OPEN_DRONE_ID_MESSAGE_PACK. Raises ValueError (`codec.encode_pack`)."""
    to = _to(target_system, target_component, id_or_mac)
    packed = encode_pack(messages)[-MESSAGE_SIZE * len(messages) :]
    return MESSAGE_PACK, _PACK.pack(*to.target, to.id_or_mac, MESSAGE_SIZE, len(messages), packed)


def encode_arm_status(ready: bool, text: str) -> tuple[int, bytes]:
    """Encode OPEN_DRONE_ID_ARM_STATUS. The text is cut at 50 bytes; non-ASCII characters become "?"."""
    error = text.encode("ascii", "replace").replace(b"\0", b"?")[:_ERROR_BYTES]
    return ARM_STATUS, _ARM_STATUS.pack(_GOOD_TO_ARM if ready else _PRE_ARM_FAIL, error)


def _to(target_system: int, target_component: int, id_or_mac: bytes) -> _To:
    check_integer("target_system", target_system, 255)
    check_integer("target_component", target_component, 255)
    if len(id_or_mac) != len(NO_ID):
        refuse("id_or_mac", id_or_mac, "20 bytes")
    return _To((target_system, target_component), id_or_mac)


def _altitude(metres: float | None) -> float:
    if metres is None or metres <= _ALTITUDE_UNKNOWN_M:
        return _ALTITUDE_UNKNOWN_M
    return max(metres, _ALTITUDE_LOWEST_M)


def _hundredths(value: float | None, unknown: int) -> int:
    return unknown if value is None else round(value * 100.0)


def _utc(field: str, utc_s: float | None) -> int:
    seconds = utc_to_wire(field, utc_s)
    if seconds >= _UNDERFLOW:
        refuse(field, utc_s, f"below {EPOCH_2019_UTC_S + _UNDERFLOW:.0f} Unix s")
    return seconds


def _write_basic_id(m: BasicId, to: _To) -> bytes:
    return _BASIC_ID.pack(*to.target, to.id_or_mac, m.id_type, m.ua_type, m.uas_id.encode("latin-1"))


def _write_location(m: Location, to: _To) -> bytes:
    direction = _hundredths(m.direction_deg, _DIRECTION_UNKNOWN)
    return _LOCATION.pack(
        *position_to_wire("Location.", m.lat_deg, m.lon_deg),
        _altitude(m.alt_baro_m),
        _altitude(m.alt_geodetic_m),
        _altitude(m.height_m),
        _TIMESTAMP_UNKNOWN_S if m.timestamp_s is None else m.timestamp_s,
        direction if direction == _DIRECTION_UNKNOWN else direction % 36000,
        _hundredths(m.speed_mps, _SPEED_UNKNOWN),
        _hundredths(m.vertical_speed_mps, _CLIMB_UNKNOWN),
        *to.target,
        to.id_or_mac,
        m.status,
        m.height_type,
        HORIZONTAL_ACCURACY_M.category("Location.horizontal_accuracy_m", m.horizontal_accuracy_m),
        VERTICAL_ACCURACY_M.category("Location.vertical_accuracy_m", m.vertical_accuracy_m),
        VERTICAL_ACCURACY_M.category("Location.baro_accuracy_m", m.baro_accuracy_m),
        SPEED_ACCURACY_MPS.category("Location.speed_accuracy_mps", m.speed_accuracy_mps),
        TIMESTAMP_ACCURACY_S.category("Location.timestamp_accuracy_s", m.timestamp_accuracy_s),
    )


def _write_authentication(m: Authentication, to: _To) -> bytes:
    return _AUTHENTICATION.pack(
        _utc("Authentication.timestamp_utc_s", m.timestamp_utc_s),
        *to.target,
        to.id_or_mac,
        m.auth_type,
        m.page,
        m.last_page or 0,
        m.length or 0,
        m.data,
    )


def _write_self_id(m: SelfId, to: _To) -> bytes:
    return _SELF_ID.pack(*to.target, to.id_or_mac, m.description_type, m.text.encode("latin-1"))


def _write_system(m: System, to: _To) -> bytes:
    return _SYSTEM.pack(
        *position_to_wire("System.operator_", m.operator_lat_deg, m.operator_lon_deg),
        _altitude(m.area_ceiling_m),
        _altitude(m.area_floor_m),
        _altitude(m.operator_alt_geodetic_m),
        _utc("System.timestamp_utc_s", m.timestamp_utc_s),
        m.area_count,
        round(m.area_radius_m),
        *to.target,
        to.id_or_mac,
        m.operator_location_type,
        m.classification_type,
        m.category_eu,
        m.class_eu,
    )


def _write_operator_id(m: OperatorId, to: _To) -> bytes:
    return _OPERATOR_ID.pack(*to.target, to.id_or_mac, m.operator_id_type, m.operator_id.encode("latin-1"))


_WRITERS: Final[dict[type[Message], tuple[int, Callable[..., bytes]]]] = {
    BasicId: (BASIC_ID, _write_basic_id),
    Location: (LOCATION, _write_location),
    Authentication: (AUTHENTICATION, _write_authentication),
    SelfId: (SELF_ID, _write_self_id),
    System: (SYSTEM, _write_system),
    OperatorId: (OPERATOR_ID, _write_operator_id),
}


# ---------------------------------------------------------------- payloads to messages


def decode_odid(message_id: int, payload: bytes) -> Odid:
    """Decode a payload of one of the `READABLE` messages. Zeros that MAVLink cut from its end are restored.

    A MESSAGE_PACK is read as far as possible (`codec.read_payload`); its `faults` describe what was left out.

    Raises:
        PeerDataError: an invalid value, named with field and limit; or a message ID outside `READABLE`.
    """
    reader = _READERS.get(message_id)
    if reader is None:
        raise PeerDataError(f"MAVLink message {message_id} is no OPEN_DRONE_ID message that is read here")
    layout, read = reader
    fields = layout.unpack(payload.ljust(layout.size, b"\0")[: layout.size])
    try:
        odid = read(fields)
        for message in odid.messages:
            encode(message)  # checks every limit
    except ValueError as error:
        raise PeerDataError(str(error)) from error
    return odid


def decode_arm_status(payload: bytes) -> tuple[bool, str]:
    """Decode OPEN_DRONE_ID_ARM_STATUS: whether it is good to arm, and the reason if not."""
    status, error = _ARM_STATUS.unpack(payload.ljust(_ARM_STATUS.size, b"\0")[: _ARM_STATUS.size])
    return status == _GOOD_TO_ARM, text_from_wire(error)


def _position(lat_e7: int, lon_e7: int) -> tuple[float, float] | tuple[None, None]:
    return (lat_e7 / 1e7, lon_e7 / 1e7) if lat_e7 or lon_e7 else (None, None)


def _metres(value: float) -> float | None:
    return None if value == _ALTITUDE_UNKNOWN_M else value


def _unless(unknown: int, hundredths: int) -> float | None:
    return None if hundredths == unknown else hundredths / 100.0


def _utc_s(seconds: int) -> float | None:
    return None if seconds >= _UNDERFLOW else utc_from_wire(seconds)


def _bound(scale: AccuracyScale, field: str, category: int) -> float | None:
    return scale.bounds[check_integer(field, category, 15)]


def _read_basic_id(fields: tuple[Any, ...]) -> Odid:
    system, component, id_or_mac, id_code, ua_code, uas_id = fields
    id_type = IdType(check_integer("BasicId.id_type", id_code, 15))
    ua_type = UaType(check_integer("BasicId.ua_type", ua_code, 15))
    text = text_from_wire(uas_id) if id_type in _TEXT_IDS else raw_text_from_wire(uas_id)
    return Odid(system, component, id_or_mac, (BasicId(id_type=id_type, ua_type=ua_type, uas_id=text),))


def _read_location(fields: tuple[Any, ...]) -> Odid:
    lat_e7, lon_e7, baro, geodetic, height, timestamp, direction, speed, climb, *rest = fields
    system, component, id_or_mac, status, reference, horizontal, vertical, baro_acc, speed_acc, time_acc = (
        rest
    )
    lat_deg, lon_deg = _position(lat_e7, lon_e7)
    location = Location(
        status=Status(check_integer("Location.status", status, 15)),
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_geodetic_m=_metres(geodetic),
        alt_baro_m=_metres(baro),
        height_type=HeightType(check_integer("Location.height_type", reference, 1)),
        height_m=_metres(height),
        direction_deg=0.0 if direction == 36000 else _unless(_DIRECTION_UNKNOWN, direction),
        speed_mps=_unless(_SPEED_UNKNOWN, speed),
        vertical_speed_mps=_unless(_CLIMB_UNKNOWN, climb),
        horizontal_accuracy_m=_bound(HORIZONTAL_ACCURACY_M, "Location.horizontal_accuracy_m", horizontal),
        vertical_accuracy_m=_bound(VERTICAL_ACCURACY_M, "Location.vertical_accuracy_m", vertical),
        baro_accuracy_m=_bound(VERTICAL_ACCURACY_M, "Location.baro_accuracy_m", baro_acc),
        speed_accuracy_mps=_bound(SPEED_ACCURACY_MPS, "Location.speed_accuracy_mps", speed_acc),
        # Sent in milliseconds. Further digits are rounding noise of the 32-bit float.
        timestamp_s=None if timestamp == _TIMESTAMP_UNKNOWN_S else round(timestamp, 3),
        timestamp_accuracy_s=_bound(TIMESTAMP_ACCURACY_S, "Location.timestamp_accuracy_s", time_acc),
    )
    return Odid(system, component, id_or_mac, (location,))


def _read_authentication(fields: tuple[Any, ...]) -> Odid:
    timestamp, system, component, id_or_mac, auth_type, page, last_page, length, data = fields
    if page:
        message = Authentication(auth_type=auth_type, page=page, data=data)
    else:
        message = Authentication(
            auth_type=auth_type,
            page=0,
            data=data[:_PAGE_0_DATA],
            last_page=last_page,
            length=length,
            timestamp_utc_s=_utc_s(timestamp),
        )
    return Odid(system, component, id_or_mac, (message,))


def _read_self_id(fields: tuple[Any, ...]) -> Odid:
    system, component, id_or_mac, kind, text = fields
    return Odid(system, component, id_or_mac, (SelfId(description_type=kind, text=text_from_wire(text)),))


def _read_system(fields: tuple[Any, ...]) -> Odid:
    lat_e7, lon_e7, ceiling, floor, altitude, timestamp, count, radius, *rest = fields
    system, component, id_or_mac, location_type, classification, category, eu_class = rest
    lat_deg, lon_deg = _position(lat_e7, lon_e7)
    message = System(
        operator_location_type=OperatorLocationType(
            check_integer("System.operator_location_type", location_type, 3)
        ),
        classification_type=ClassificationType(
            check_integer("System.classification_type", classification, 7)
        ),
        operator_lat_deg=lat_deg,
        operator_lon_deg=lon_deg,
        operator_alt_geodetic_m=_metres(altitude),
        area_count=count,
        area_radius_m=float(radius),
        area_ceiling_m=_metres(ceiling),
        area_floor_m=_metres(floor),
        category_eu=category,
        class_eu=eu_class,
        timestamp_utc_s=_utc_s(timestamp),
    )
    return Odid(system, component, id_or_mac, (message,))


def _read_operator_id(fields: tuple[Any, ...]) -> Odid:
    system, component, id_or_mac, kind, text = fields
    return Odid(
        system,
        component,
        id_or_mac,
        (OperatorId(operator_id_type=kind, operator_id=text_from_wire(text)),),
    )


def _read_system_update(fields: tuple[Any, ...]) -> Odid:
    lat_e7, lon_e7, altitude, timestamp, system, component = fields
    lat_deg, lon_deg = _position(lat_e7, lon_e7)
    update = SystemUpdate(lat_deg, lon_deg, _metres(altitude), _utc_s(timestamp))
    encode(updated(System(), update))  # checks the limits, which are those of a System
    return Odid(system, component, NO_ID, system_update=update)


def _read_pack(fields: tuple[Any, ...]) -> Odid:
    system, component, id_or_mac, size, count, data = fields
    messages, faults = read_payload(bytes((PACK_TYPE << 4, size, count)) + data)
    return Odid(system, component, id_or_mac, messages, faults=faults)


def updated(system: System, update: SystemUpdate) -> System:
    """Return the System with the operator position and timestamp of the update."""
    return System(
        operator_location_type=system.operator_location_type,
        classification_type=system.classification_type,
        operator_lat_deg=update.operator_lat_deg,
        operator_lon_deg=update.operator_lon_deg,
        operator_alt_geodetic_m=update.operator_alt_geodetic_m,
        area_count=system.area_count,
        area_radius_m=system.area_radius_m,
        area_ceiling_m=system.area_ceiling_m,
        area_floor_m=system.area_floor_m,
        category_eu=system.category_eu,
        class_eu=system.class_eu,
        timestamp_utc_s=update.timestamp_utc_s,
    )


_READERS: Final[dict[int, tuple[struct.Struct, Callable[[tuple[Any, ...]], Odid]]]] = {
    BASIC_ID: (_BASIC_ID, _read_basic_id),
    LOCATION: (_LOCATION, _read_location),
    AUTHENTICATION: (_AUTHENTICATION, _read_authentication),
    SELF_ID: (_SELF_ID, _read_self_id),
    SYSTEM: (_SYSTEM, _read_system),
    OPERATOR_ID: (_OPERATOR_ID, _read_operator_id),
    MESSAGE_PACK: (_PACK, _read_pack),
    SYSTEM_UPDATE: (_SYSTEM_UPDATE, _read_system_update),
}
READABLE: Final = frozenset(_READERS)
"""IDs of the messages that `decode_odid` reads."""
