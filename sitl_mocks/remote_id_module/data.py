"""Converts OPEN_DRONE_ID_* messages from pymavlink to Remote ID messages, as the module's firmware does.

This conversion is independent of the companion's. Numbers and units are those of MAVLink's common.xml.
"""

from __future__ import annotations

from collections.abc import Callable

from companion.autopilot.wire import MavlinkMessage
from companion.remote_id.messages import (
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

_EPOCH_S = 1_546_300_800
_HORIZONTAL_M = (None, 18520.0, 7408.0, 3704.0, 1852.0, 926.0, 555.6, 185.2, 92.6, 30.0, 10.0, 3.0, 1.0)
_VERTICAL_M = (None, 150.0, 45.0, 25.0, 10.0, 3.0, 1.0)
_SPEED_MPS = (None, 10.0, 3.0, 1.0, 0.3)


def _basic_id(id_type: int, ua_type: int, text: str) -> Callable[[], Message]:
    return lambda: BasicId(id_type=IdType(id_type), ua_type=UaType(ua_type), uas_id=text)


def _location(m: MavlinkMessage) -> Callable[[], Message]:
    def make() -> Message:
        known = m.latitude != 0 or m.longitude != 0
        return Location(
            status=Status(m.status),
            lat_deg=m.latitude / 1e7 if known else None,
            lon_deg=m.longitude / 1e7 if known else None,
            alt_baro_m=_altitude(m.altitude_barometric),
            alt_geodetic_m=_altitude(m.altitude_geodetic),
            height_type=HeightType(m.height_reference),
            height_m=_altitude(m.height),
            direction_deg=None if m.direction == 36100 else m.direction / 100,
            speed_mps=None if m.speed_horizontal == 25500 else m.speed_horizontal / 100,
            vertical_speed_mps=None if m.speed_vertical == 6300 else m.speed_vertical / 100,
            horizontal_accuracy_m=_bound(_HORIZONTAL_M, m.horizontal_accuracy),
            vertical_accuracy_m=_bound(_VERTICAL_M, m.vertical_accuracy),
            baro_accuracy_m=_bound(_VERTICAL_M, m.barometer_accuracy),
            speed_accuracy_mps=_bound(_SPEED_MPS, m.speed_accuracy),
            timestamp_s=None if m.timestamp == 65535 else m.timestamp,
            timestamp_accuracy_s=None if m.timestamp_accuracy == 0 else m.timestamp_accuracy / 10,
        )

    return make


def _self_id(m: MavlinkMessage) -> Callable[[], Message]:
    return lambda: SelfId(description_type=m.description_type, text=m.description)


def _system(m: MavlinkMessage) -> Callable[[], Message]:
    def make() -> Message:
        known = m.operator_latitude != 0 or m.operator_longitude != 0
        return System(
            operator_location_type=OperatorLocationType(m.operator_location_type),
            classification_type=ClassificationType(m.classification_type),
            operator_lat_deg=m.operator_latitude / 1e7 if known else None,
            operator_lon_deg=m.operator_longitude / 1e7 if known else None,
            operator_alt_geodetic_m=_altitude(m.operator_altitude_geo),
            area_count=m.area_count,
            area_radius_m=float(m.area_radius),
            area_ceiling_m=_altitude(m.area_ceiling),
            area_floor_m=_altitude(m.area_floor),
            category_eu=m.category_eu,
            class_eu=m.class_eu,
            timestamp_utc_s=float(m.timestamp + _EPOCH_S),
        )

    return make


def _operator_id(m: MavlinkMessage) -> Callable[[], Message]:
    return lambda: OperatorId(operator_id_type=m.operator_id_type, operator_id=m.operator_id)


def _altitude(metres: float) -> float | None:
    return None if metres == -1000.0 else metres


def _bound(bounds: tuple[float | None, ...], category: int) -> float | None:
    if category >= len(bounds):
        raise ValueError(f"accuracy category {category}")
    return bounds[category]


READERS: dict[str, Callable[..., Callable[[], Message]]] = {
    "BASIC_ID": _basic_id,
    "LOCATION": _location,
    "SELF_ID": _self_id,
    "SYSTEM": _system,
    "OPERATOR_ID": _operator_id,
}
"""Converter for each message.

The function that it returns raises ValueError for data that the encoder refuses.
"""
