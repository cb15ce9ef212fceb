"""Encodes Remote ID messages as OPEN_DRONE_ID_* payloads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from companion.remote_id.codec import MESSAGE_SIZE, encode, encode_pack
from companion.remote_id.mavlink.layouts import (
    ALTITUDE_UNKNOWN_M,
    ARM_STATUS,
    ARM_STATUS_LAYOUT,
    AUTHENTICATION,
    AUTHENTICATION_LAYOUT,
    BASIC_ID,
    BASIC_ID_LAYOUT,
    CLIMB_UNKNOWN,
    DIRECTION_UNKNOWN,
    GOOD_TO_ARM,
    LOCATION,
    LOCATION_LAYOUT,
    MESSAGE_PACK,
    MESSAGE_PACK_LAYOUT,
    NO_ID,
    OPERATOR_ID,
    OPERATOR_ID_LAYOUT,
    PRE_ARM_FAIL,
    SELF_ID,
    SELF_ID_LAYOUT,
    SPEED_UNKNOWN,
    SYSTEM,
    SYSTEM_LAYOUT,
    TIMESTAMP_UNKNOWN_S,
    UNDERFLOW,
)
from companion.remote_id.messages import (
    Authentication,
    BasicId,
    Location,
    Message,
    OperatorId,
    SelfId,
    System,
)
from companion.remote_id.wire_values import (
    EPOCH_2019_UTC_S,
    HORIZONTAL_ACCURACY_M,
    SPEED_ACCURACY_MPS,
    TIMESTAMP_ACCURACY_S,
    VERTICAL_ACCURACY_M,
    check_integer,
    position_to_wire,
    refuse,
    utc_to_wire,
)

_ALTITUDE_LOWEST_M: Final = -999.9999
"""Lowest known altitude. As a 32-bit float it is still distinct from "unknown", -1000 m."""
_ERROR_BYTES: Final = 50


@dataclass(frozen=True, slots=True)
class _To:
    """Fields that most messages share."""

    target: tuple[int, int]
    id_or_mac: bytes


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
    return MESSAGE_PACK, MESSAGE_PACK_LAYOUT.pack(
        *to.target, to.id_or_mac, MESSAGE_SIZE, len(messages), packed
    )


def encode_arm_status(ready: bool, text: str) -> tuple[int, bytes]:
    """Encode OPEN_DRONE_ID_ARM_STATUS. The text is cut at 50 bytes; non-ASCII characters become "?"."""
    error = text.encode("ascii", "replace").replace(b"\0", b"?")[:_ERROR_BYTES]
    return ARM_STATUS, ARM_STATUS_LAYOUT.pack(GOOD_TO_ARM if ready else PRE_ARM_FAIL, error)


def _to(target_system: int, target_component: int, id_or_mac: bytes) -> _To:
    check_integer("target_system", target_system, 255)
    check_integer("target_component", target_component, 255)
    if len(id_or_mac) != len(NO_ID):
        refuse("id_or_mac", id_or_mac, "20 bytes")
    return _To((target_system, target_component), id_or_mac)


def _altitude(metres: float | None) -> float:
    if metres is None or metres <= ALTITUDE_UNKNOWN_M:
        return ALTITUDE_UNKNOWN_M
    return max(metres, _ALTITUDE_LOWEST_M)


def _hundredths(value: float | None, unknown: int) -> int:
    return unknown if value is None else round(value * 100.0)


def _utc(field: str, utc_s: float | None) -> int:
    seconds = utc_to_wire(field, utc_s)
    if seconds >= UNDERFLOW:
        refuse(field, utc_s, f"below {EPOCH_2019_UTC_S + UNDERFLOW:.0f} Unix s")
    return seconds


def _write_basic_id(m: BasicId, to: _To) -> bytes:
    return BASIC_ID_LAYOUT.pack(*to.target, to.id_or_mac, m.id_type, m.ua_type, m.uas_id.encode("latin-1"))


def _write_location(m: Location, to: _To) -> bytes:
    direction = _hundredths(m.direction_deg, DIRECTION_UNKNOWN)
    return LOCATION_LAYOUT.pack(
        *position_to_wire("Location.", m.lat_deg, m.lon_deg),
        _altitude(m.alt_baro_m),
        _altitude(m.alt_geodetic_m),
        _altitude(m.height_m),
        TIMESTAMP_UNKNOWN_S if m.timestamp_s is None else m.timestamp_s,
        direction if direction == DIRECTION_UNKNOWN else direction % 36000,
        _hundredths(m.speed_mps, SPEED_UNKNOWN),
        _hundredths(m.vertical_speed_mps, CLIMB_UNKNOWN),
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
    return AUTHENTICATION_LAYOUT.pack(
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
    return SELF_ID_LAYOUT.pack(*to.target, to.id_or_mac, m.description_type, m.text.encode("latin-1"))


def _write_system(m: System, to: _To) -> bytes:
    return SYSTEM_LAYOUT.pack(
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
    return OPERATOR_ID_LAYOUT.pack(
        *to.target, to.id_or_mac, m.operator_id_type, m.operator_id.encode("latin-1")
    )


_WRITERS: Final[dict[type[Message], tuple[int, Callable[..., bytes]]]] = {
    BasicId: (BASIC_ID, _write_basic_id),
    Location: (LOCATION, _write_location),
    Authentication: (AUTHENTICATION, _write_authentication),
    SelfId: (SELF_ID, _write_self_id),
    System: (SYSTEM, _write_system),
    OperatorId: (OPERATOR_ID, _write_operator_id),
}
