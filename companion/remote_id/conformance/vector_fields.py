"""Converts between the fields of a vector file and our messages, for the conformance check.

A vector file gives values in SI units and decimal degrees under the names of the public reference
implementation (opendroneid-core-c). Enumerations and accuracies are given as their wire numbers. "Unknown" is
given as the reference's special values (direction 361, horizontal speed 255, vertical speed 63, altitude
-1000, position 0/0, time after the hour 65535, time since 2019 0).

`stated` reads those values from the bytes independently of the codec. The two thus check each other, and
values that our messages treat as unknown are compared too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from companion.errors import ConfigError
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
)

Fields = Mapping[str, object]
Stated = dict[str, float | str]

DIRECTION_UNKNOWN: Final = 361.0
SPEED_UNKNOWN: Final = 255.0
CLIMB_UNKNOWN: Final = 63.0
ALTITUDE_UNKNOWN: Final = -1000.0
HOUR_TIME_UNKNOWN: Final = 65535.0

TRUNCATED_STEPS: Final[Mapping[str, float]] = {
    "speed_vertical_m_s": 0.5,
    "altitude_baro_m": 0.5,
    "altitude_geo_m": 0.5,
    "height_m": 0.5,
    "area_ceiling_m": 0.5,
    "area_floor_m": 0.5,
    "operator_altitude_geo_m": 0.5,
    "area_radius_m": 10.0,
}
"""Wire step of each field that the reference truncates and we round to nearest."""

HIGHEST_CATEGORY: Final[Mapping[str, int]] = {
    "horiz_accuracy": HORIZONTAL_ACCURACY_M.highest,
    "vert_accuracy": VERTICAL_ACCURACY_M.highest,
    "baro_accuracy": VERTICAL_ACCURACY_M.highest,
    "speed_accuracy": SPEED_ACCURACY_MPS.highest,
}
"""Accuracies above these are reserved. Our messages hold bounds, so they send those as unknown, 0."""


def text_of(fields: Fields, name: str) -> str:
    """Return a text field. Raises ConfigError if it is missing or no text."""
    value = fields.get(name)
    if not isinstance(value, str):
        raise ConfigError(f"field {name!r} is {value!r}, expected text")
    return value


def bytes_of(fields: Fields, name: str) -> bytes:
    """Return the bytes of a hexadecimal field. Raises ConfigError."""
    text = text_of(fields, name)
    try:
        return bytes.fromhex(text)
    except ValueError:
        raise ConfigError(f"field {name!r} is {text!r}, expected hexadecimal bytes") from None


def number_of(fields: Fields, name: str) -> float:
    """Return a numeric field. Raises ConfigError."""
    value = fields.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"field {name!r} is {value!r}, expected a number")
    return value


def integer_of(fields: Fields, name: str) -> int:
    """Return an integer field. Raises ConfigError."""
    value = number_of(fields, name)
    if not isinstance(value, int):
        raise ConfigError(f"field {name!r} is {value!r}, expected a whole number")
    return value


def message_of(kind: str, fields: Fields) -> Message:
    """Return the message that a vector's fields represent.

    Raises ValueError if a message cannot hold them, ConfigError if they are not fields of this kind.
    """
    maker = _MAKERS.get(kind)
    if maker is None:
        raise ConfigError(f"unknown message type {kind!r}")
    return maker(fields)


def stated(data: bytes) -> tuple[str, Stated]:
    """Return kind and fields of 25 bytes as a vector file gives them, including invalid values."""
    kind, read = _STATERS[data[0] >> 4]
    return kind, read(data)


def as_received(fields: Fields) -> Fields:
    """Return the fields with every value that the standard does not allow replaced by the one for unknown."""
    result = dict(fields)
    for prefix in ("", "operator_"):
        lat, lon = f"{prefix}latitude_deg", f"{prefix}longitude_deg"
        if lat in result:
            lat_deg, lon_deg = number_of(result, lat), number_of(result, lon)
            if abs(lat_deg) > 90 or abs(lon_deg) > 180:
                result[lat] = result[lon] = 0.0
    limits = (
        ("direction_deg", 360.0, DIRECTION_UNKNOWN),
        ("speed_vertical_m_s", 62.0, CLIMB_UNKNOWN),
        ("timestamp_s_after_hour", 3600.0, HOUR_TIME_UNKNOWN),
    )
    for name, highest, unknown in limits:
        if name in result and abs(number_of(result, name)) > highest:
            result[name] = unknown
    if result.get("direction_deg") == 360.0:
        result["direction_deg"] = 0.0
    return result


def fields_of(value: object) -> Fields:
    """Return the JSON object. Raises ConfigError for anything else."""
    if not isinstance(value, dict):
        raise ConfigError(f"{str(value)[:40]!r} stands where an object was expected")
    return value


def list_of(vector: Fields, name: str) -> list[Fields]:
    """Return the list of JSON objects in a field. Raises ConfigError for anything else."""
    value = vector.get(name)
    if not isinstance(value, list):
        raise ConfigError(f"field {name!r} is not a list")
    return [fields_of(item) for item in value]


def accepted_of(vector: Fields) -> bool:
    """Return whether the reference accepted the vector. Raises ConfigError unless the field says so."""
    accepted = vector.get("accepted")
    if not isinstance(accepted, bool):
        raise ConfigError(f"field 'accepted' is {accepted!r}, expected true or false")
    return accepted


def contradiction(vector: Fields) -> str | None:
    """Describe a vector in which `accepted` and `hex` contradict each other.

    A vector that the reference encoded has bytes; one that it refused has none.
    """
    if "hex" in vector and accepted_of(vector) is (vector["hex"] is None):
        return f"'accepted' is {accepted_of(vector)}, which 'hex' contradicts: {vector['hex']!r}"
    return None


# ---------------------------------------------------------------- fields -> message


def _unless(value: float, unknown: float) -> float | None:
    return None if value == unknown else value


def _altitude(fields: Fields, name: str) -> float | None:
    return _unless(number_of(fields, name), ALTITUDE_UNKNOWN)


def _position(fields: Fields, prefix: str) -> tuple[float, float] | tuple[None, None]:
    lat, lon = number_of(fields, f"{prefix}latitude_deg"), number_of(fields, f"{prefix}longitude_deg")
    return (lat, lon) if lat or lon else (None, None)


def _since_2019(fields: Fields) -> float | None:
    seconds = number_of(fields, "timestamp_s_since_2019")
    return seconds + EPOCH_2019_UTC_S if seconds else None


def _basic_id(fields: Fields) -> BasicId:
    id_type = IdType(integer_of(fields, "id_type"))
    raw = bytes_of(fields, "uas_id_hex")
    if "uas_id" in fields and text_of(fields, "uas_id") != _text(raw):
        raise ConfigError(f"field 'uas_id' is {fields['uas_id']!r}, 'uas_id_hex' is that of {_text(raw)!r}")
    if id_type in (IdType.SERIAL_NUMBER, IdType.CAA_REGISTRATION):
        uas_id = _text(raw)
    else:
        uas_id = raw.rstrip(b"\0").decode("latin-1")
    return BasicId(id_type=id_type, ua_type=UaType(integer_of(fields, "ua_type")), uas_id=uas_id)


def _location(fields: Fields) -> Location:
    lat_deg, lon_deg = _position(fields, "")
    return Location(
        status=Status(integer_of(fields, "status")),
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_geodetic_m=_altitude(fields, "altitude_geo_m"),
        alt_baro_m=_altitude(fields, "altitude_baro_m"),
        height_type=HeightType(integer_of(fields, "height_type")),
        height_m=_altitude(fields, "height_m"),
        direction_deg=_unless(number_of(fields, "direction_deg"), DIRECTION_UNKNOWN),
        speed_mps=_unless(number_of(fields, "speed_horizontal_m_s"), SPEED_UNKNOWN),
        vertical_speed_mps=_unless(number_of(fields, "speed_vertical_m_s"), CLIMB_UNKNOWN),
        horizontal_accuracy_m=HORIZONTAL_ACCURACY_M.bound(integer_of(fields, "horiz_accuracy")),
        vertical_accuracy_m=VERTICAL_ACCURACY_M.bound(integer_of(fields, "vert_accuracy")),
        baro_accuracy_m=VERTICAL_ACCURACY_M.bound(integer_of(fields, "baro_accuracy")),
        speed_accuracy_mps=SPEED_ACCURACY_MPS.bound(integer_of(fields, "speed_accuracy")),
        timestamp_s=_unless(number_of(fields, "timestamp_s_after_hour"), HOUR_TIME_UNKNOWN),
        timestamp_accuracy_s=TIMESTAMP_ACCURACY_S.bound(integer_of(fields, "timestamp_accuracy")),
    )


def _authentication(fields: Fields) -> Authentication:
    auth_type, page = integer_of(fields, "auth_type"), integer_of(fields, "data_page")
    data = bytes_of(fields, "auth_data_hex")
    if page:
        return Authentication(auth_type=auth_type, page=page, data=data)
    return Authentication(
        auth_type=auth_type,
        page=0,
        data=data,
        last_page=integer_of(fields, "last_page_index"),
        length=integer_of(fields, "length"),
        timestamp_utc_s=_since_2019(fields),
    )


def _self_id(fields: Fields) -> SelfId:
    return SelfId(
        description_type=integer_of(fields, "description_type"), text=text_of(fields, "description")
    )


def _system(fields: Fields) -> System:
    lat_deg, lon_deg = _position(fields, "operator_")
    return System(
        operator_location_type=OperatorLocationType(integer_of(fields, "operator_location_type")),
        classification_type=ClassificationType(integer_of(fields, "classification_type")),
        operator_lat_deg=lat_deg,
        operator_lon_deg=lon_deg,
        operator_alt_geodetic_m=_altitude(fields, "operator_altitude_geo_m"),
        area_count=integer_of(fields, "area_count"),
        area_radius_m=number_of(fields, "area_radius_m"),
        area_ceiling_m=_altitude(fields, "area_ceiling_m"),
        area_floor_m=_altitude(fields, "area_floor_m"),
        category_eu=integer_of(fields, "category_eu"),
        class_eu=integer_of(fields, "class_eu"),
        timestamp_utc_s=_since_2019(fields),
    )


def _operator_id(fields: Fields) -> OperatorId:
    return OperatorId(
        operator_id_type=integer_of(fields, "operator_id_type"), operator_id=text_of(fields, "operator_id")
    )


_MAKERS: Final[Mapping[str, Callable[[Fields], Message]]] = {
    "basic_id": _basic_id,
    "location": _location,
    "auth": _authentication,
    "self_id": _self_id,
    "system": _system,
    "operator_id": _operator_id,
}


# ---------------------------------------------------------------- bytes -> fields


def _unsigned(data: bytes, at: int, size: int) -> int:
    return int.from_bytes(data[at : at + size], "little")


def _degrees(data: bytes, at: int) -> float:
    return int.from_bytes(data[at : at + 4], "little", signed=True) / 1e7


def _metres(data: bytes, at: int) -> float:
    return _unsigned(data, at, 2) / 2 - 1000


def _text(data: bytes) -> str:
    return data.split(b"\0")[0].decode("latin-1")


def _state_basic_id(data: bytes) -> Stated:
    result: Stated = {"id_type": data[1] >> 4, "ua_type": data[1] & 15, "uas_id_hex": data[2:22].hex()}
    if data[1] >> 4 in (1, 2):
        result["uas_id"] = _text(data[2:22])
        # The content after the end of the text is ignored.
        result["uas_id_hex"] = data[2:22].split(b"\0")[0].ljust(20, b"\0").hex()
    return result


def _state_location(data: bytes) -> Stated:
    tenths = _unsigned(data, 21, 2)
    return {
        "status": data[1] >> 4,
        "direction_deg": data[2] + (180 if data[1] & 2 else 0),
        "speed_horizontal_m_s": data[3] * 0.75 + 63.75 if data[1] & 1 else data[3] * 0.25,
        "speed_vertical_m_s": int.from_bytes(data[4:5], "little", signed=True) / 2,
        "latitude_deg": _degrees(data, 5),
        "longitude_deg": _degrees(data, 9),
        "altitude_baro_m": _metres(data, 13),
        "altitude_geo_m": _metres(data, 15),
        "height_type": data[1] >> 2 & 1,
        "height_m": _metres(data, 17),
        "horiz_accuracy": data[19] & 15,
        "vert_accuracy": data[19] >> 4,
        "baro_accuracy": data[20] >> 4,
        "speed_accuracy": data[20] & 15,
        "timestamp_accuracy": data[23] & 15,
        "timestamp_s_after_hour": HOUR_TIME_UNKNOWN if tenths == 0xFFFF else tenths / 10,
    }


def _state_authentication(data: bytes) -> Stated:
    result: Stated = {"auth_type": data[1] >> 4, "data_page": data[1] & 15}
    if data[1] & 15:
        return {**result, "auth_data_hex": data[2:].hex()}
    return {
        **result,
        "last_page_index": data[2],
        "length": data[3],
        "timestamp_s_since_2019": _unsigned(data, 4, 4),
        "auth_data_hex": data[8:].hex(),
    }


def _state_self_id(data: bytes) -> Stated:
    return {"description_type": data[1], "description": _text(data[2:])}


def _state_system(data: bytes) -> Stated:
    return {
        "operator_location_type": data[1] & 3,
        "classification_type": data[1] >> 2 & 7,
        "operator_latitude_deg": _degrees(data, 2),
        "operator_longitude_deg": _degrees(data, 6),
        "area_count": _unsigned(data, 10, 2),
        "area_radius_m": data[12] * 10,
        "area_ceiling_m": _metres(data, 13),
        "area_floor_m": _metres(data, 15),
        "category_eu": data[17] >> 4,
        "class_eu": data[17] & 15,
        "operator_altitude_geo_m": _metres(data, 18),
        "timestamp_s_since_2019": _unsigned(data, 20, 4),
    }


def _state_operator_id(data: bytes) -> Stated:
    return {"operator_id_type": data[1], "operator_id": _text(data[2:22])}


_STATERS: Final[Mapping[int, tuple[str, Callable[[bytes], Stated]]]] = {
    0: ("basic_id", _state_basic_id),
    1: ("location", _state_location),
    2: ("auth", _state_authentication),
    3: ("self_id", _state_self_id),
    4: ("system", _state_system),
    5: ("operator_id", _state_operator_id),
}
