"""ASTM F3411-22a broadcast messages in SI units.

A value is what a person means (metres, m/s, degrees, Unix seconds); `None` is unknown. How it lies on the
wire, and what the wire can hold, is `companion.remote_id.codec`'s.
"""

from __future__ import annotations

import enum

import msgspec


class WireCode(enum.IntEnum):
    """An enumeration as wide as its bits on the wire.

    A number that the standard reserves is kept as a member named `RESERVED_n`, so that a newer peer's message
    is neither lost nor altered; a number that does not fit the bits raises ValueError.
    """

    @classmethod
    def _highest(cls) -> int:
        """Greatest number that fits the field."""
        return 15

    @classmethod
    def _missing_(cls, value: object) -> WireCode | None:
        if not isinstance(value, int) or not 0 <= value <= cls._highest():
            return None
        member = int.__new__(cls, value)
        member._name_ = f"RESERVED_{value}"
        member._value_ = value
        cls._value2member_map_[value] = member  # one object per number, as for named members
        return member


class IdType(WireCode):
    """What a Basic ID holds."""

    NONE = 0
    SERIAL_NUMBER = 1
    CAA_REGISTRATION = 2
    UTM_ASSIGNED_UUID = 3
    SPECIFIC_SESSION = 4


class UaType(WireCode):
    """Kind of aircraft."""

    NONE = 0
    AEROPLANE = 1
    HELICOPTER_OR_MULTIROTOR = 2
    GYROPLANE = 3
    HYBRID_LIFT = 4
    ORNITHOPTER = 5
    GLIDER = 6
    KITE = 7
    FREE_BALLOON = 8
    CAPTIVE_BALLOON = 9
    AIRSHIP = 10
    FREE_FALL_PARACHUTE = 11
    ROCKET = 12
    TETHERED_POWERED_AIRCRAFT = 13
    GROUND_OBSTACLE = 14
    OTHER = 15


class Status(WireCode):
    """Operational status in a Location."""

    UNDECLARED = 0
    GROUND = 1
    AIRBORNE = 2
    EMERGENCY = 3
    REMOTE_ID_SYSTEM_FAILURE = 4


class HeightType(WireCode):
    """What `Location.height_m` is measured from."""

    ABOVE_TAKEOFF = 0
    ABOVE_GROUND = 1

    @classmethod
    def _highest(cls) -> int:
        return 1


class OperatorLocationType(WireCode):
    """Where `System`'s operator position comes from."""

    TAKEOFF = 0
    LIVE_GNSS = 1
    FIXED = 2

    @classmethod
    def _highest(cls) -> int:
        return 3


class ClassificationType(WireCode):
    """Whose categories `System` carries."""

    UNDECLARED = 0
    EU = 1

    @classmethod
    def _highest(cls) -> int:
        return 7


class _Message(
    msgspec.Struct, frozen=True, tag=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True
):
    """Common to all messages."""


class BasicId(_Message, frozen=True):
    """Who: one identity of the aircraft."""

    id_type: IdType
    ua_type: UaType
    uas_id: str
    """Serial number and CAA registration: text. Every other type: up to 20 raw bytes, one character (Latin-1)
    for each, without the padding behind them."""


class Location(_Message, frozen=True):
    """Where and how fast, at one moment."""

    status: Status = Status.UNDECLARED
    lat_deg: float | None = None
    lon_deg: float | None = None
    alt_geodetic_m: float | None = None
    alt_baro_m: float | None = None
    height_type: HeightType = HeightType.ABOVE_TAKEOFF
    height_m: float | None = None
    direction_deg: float | None = None
    """Course over ground, clockwise from true north, [0, 360)."""
    speed_mps: float | None = None
    """Horizontal."""
    vertical_speed_mps: float | None = None
    """Positive up."""
    horizontal_accuracy_m: float | None = None
    """Upper bound of the declared category (95 %)."""
    vertical_accuracy_m: float | None = None
    baro_accuracy_m: float | None = None
    speed_accuracy_mps: float | None = None
    timestamp_s: float | None = None
    """Seconds after the full UTC hour, [0, 3600]."""
    timestamp_accuracy_s: float | None = None


class Authentication(_Message, frozen=True):
    """One page of authentication data. Pages are assembled by the receiver."""

    auth_type: int
    page: int
    data: bytes
    """Page 0: up to 17 bytes; others: up to 23. As received: with the padding, which `length` tells apart."""
    last_page: int | None = None
    """Page 0 only."""
    length: int | None = None
    """Page 0 only: bytes in all pages together."""
    timestamp_utc_s: float | None = None
    """Page 0 only."""


class SelfId(_Message, frozen=True):
    """Free text about the flight."""

    description_type: int
    text: str


class System(_Message, frozen=True):
    """Where the operator is, and the area of a group flight."""

    operator_location_type: OperatorLocationType = OperatorLocationType.TAKEOFF
    classification_type: ClassificationType = ClassificationType.UNDECLARED
    operator_lat_deg: float | None = None
    operator_lon_deg: float | None = None
    operator_alt_geodetic_m: float | None = None
    area_count: int = 1
    area_radius_m: float = 0.0
    area_ceiling_m: float | None = None
    area_floor_m: float | None = None
    category_eu: int = 0
    class_eu: int = 0
    timestamp_utc_s: float | None = None


class OperatorId(_Message, frozen=True):
    """Registration of the operator."""

    operator_id_type: int
    operator_id: str


Message = BasicId | Location | Authentication | SelfId | System | OperatorId
"""Every message but the pack, which is a way to send several at once and never a value of its own."""
