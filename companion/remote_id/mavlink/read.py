"""Decodes OPEN_DRONE_ID_* payloads to Remote ID messages."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import msgspec

from companion.errors import PeerDataError
from companion.remote_id.codec import PACK_TYPE, encode, read_payload
from companion.remote_id.mavlink.layouts import (
    ALTITUDE_UNKNOWN_M,
    ARM_STATUS_LAYOUT,
    AUTHENTICATION,
    AUTHENTICATION_LAYOUT,
    BASIC_ID,
    BASIC_ID_LAYOUT,
    GOOD_TO_ARM,
    LOCATION,
    LOCATION_LAYOUT,
    MESSAGE_PACK,
    MESSAGE_PACK_LAYOUT,
    NO_ID,
    OPERATOR_ID,
    OPERATOR_ID_LAYOUT,
    SELF_ID,
    SELF_ID_LAYOUT,
    SPEED_UNKNOWN,
    SYSTEM,
    SYSTEM_LAYOUT,
    SYSTEM_UPDATE,
    SYSTEM_UPDATE_LAYOUT,
    UNDERFLOW,
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
from companion.remote_id.wire_values import (
    CLIMB_MAX_MPS,
    HORIZONTAL_ACCURACY_M,
    SPEED_ACCURACY_MPS,
    TIMESTAMP_ACCURACY_S,
    VERTICAL_ACCURACY_M,
    AccuracyScale,
    check_integer,
    raw_text_from_wire,
    text_from_wire,
    utc_from_wire,
)

_PAGE_0_DATA: Final = 17

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


def decode_odid(message_id: int, payload: bytes) -> Odid:
    """Decode a payload of one of the `READABLE` messages. Zeros that MAVLink cut from its end are restored.

    A MESSAGE_PACK is read as far as possible (`codec.read_payload`); its `faults` describe what was left out.

    A direction, a vertical speed or a timestamp that the standard does not allow becomes unknown, as in
    `wire_messages.decode`: receivers pass on what others send.

    Raises:
        PeerDataError: another invalid value, named with field and limit; or a message ID outside `READABLE`.
    """
    reader = _READERS.get(message_id)
    if reader is None:
        raise PeerDataError(f"MAVLink message {message_id} is not a supported OPEN_DRONE_ID message")
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
    status, error = ARM_STATUS_LAYOUT.unpack(
        payload.ljust(ARM_STATUS_LAYOUT.size, b"\0")[: ARM_STATUS_LAYOUT.size]
    )
    return status == GOOD_TO_ARM, text_from_wire(error)


def _position(lat_e7: int, lon_e7: int) -> tuple[float, float] | tuple[None, None]:
    return (lat_e7 / 1e7, lon_e7 / 1e7) if lat_e7 or lon_e7 else (None, None)


def _metres(value: float) -> float | None:
    return None if value == ALTITUDE_UNKNOWN_M else value


def _within(value: float, least: float, most: float) -> float | None:
    """The value, or None if the standard does not allow it: the rest of the message is valid, as that of one
    from the air."""
    return value if least <= value <= most else None


def _utc_s(seconds: int) -> float | None:
    return None if seconds >= UNDERFLOW else utc_from_wire(seconds)


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
        direction_deg=0.0 if direction == 36000 else _within(direction / 100.0, 0.0, 360.0),
        speed_mps=None if speed == SPEED_UNKNOWN else speed / 100.0,
        vertical_speed_mps=_within(climb / 100.0, -CLIMB_MAX_MPS, CLIMB_MAX_MPS),
        horizontal_accuracy_m=_bound(HORIZONTAL_ACCURACY_M, "Location.horizontal_accuracy_m", horizontal),
        vertical_accuracy_m=_bound(VERTICAL_ACCURACY_M, "Location.vertical_accuracy_m", vertical),
        baro_accuracy_m=_bound(VERTICAL_ACCURACY_M, "Location.baro_accuracy_m", baro_acc),
        speed_accuracy_mps=_bound(SPEED_ACCURACY_MPS, "Location.speed_accuracy_mps", speed_acc),
        # Sent in milliseconds. Further digits are rounding noise of the 32-bit float.
        timestamp_s=_within(round(timestamp, 3), 0.0, 3600.0),
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
    return msgspec.structs.replace(
        system,
        operator_lat_deg=update.operator_lat_deg,
        operator_lon_deg=update.operator_lon_deg,
        operator_alt_geodetic_m=update.operator_alt_geodetic_m,
        timestamp_utc_s=update.timestamp_utc_s,
    )


_READERS: Final[dict[int, tuple[struct.Struct, Callable[[tuple[Any, ...]], Odid]]]] = {
    BASIC_ID: (BASIC_ID_LAYOUT, _read_basic_id),
    LOCATION: (LOCATION_LAYOUT, _read_location),
    AUTHENTICATION: (AUTHENTICATION_LAYOUT, _read_authentication),
    SELF_ID: (SELF_ID_LAYOUT, _read_self_id),
    SYSTEM: (SYSTEM_LAYOUT, _read_system),
    OPERATOR_ID: (OPERATOR_ID_LAYOUT, _read_operator_id),
    MESSAGE_PACK: (MESSAGE_PACK_LAYOUT, _read_pack),
    SYSTEM_UPDATE: (SYSTEM_UPDATE_LAYOUT, _read_system_update),
}
READABLE: Final = frozenset(_READERS)
"""IDs of the messages that `decode_odid` reads."""
