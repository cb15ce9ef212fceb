"""ASTM F3411-22a broadcast messages in SI units.

Values are in everyday units (metres, m/s, degrees, Unix seconds); `None` means unknown.
`companion.remote_id.codec` defines the wire format and the value ranges that it can hold.
"""

from __future__ import annotations

import enum

import msgspec


class WireCode(enum.IntEnum):
    """An enumeration that covers every number its bit field can hold.

    A number that the standard reserves becomes a member named `RESERVED_n`, so that a message from a newer
    peer is neither lost nor altered. A number that does not fit the bit field raises ValueError.
    """

    @classmethod
    def _highest(cls) -> int:
        """Return the greatest number that fits the field."""
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
    """Kind of identity that a Basic ID holds."""

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
    """Operational status that a Location reports."""

    UNDECLARED = 0
    GROUND = 1
    AIRBORNE = 2
    EMERGENCY = 3
    REMOTE_ID_SYSTEM_FAILURE = 4


class HeightType(WireCode):
    """Reference from which `Location.height_m` is measured."""

    ABOVE_TAKEOFF = 0
    ABOVE_GROUND = 1

    @classmethod
    def _highest(cls) -> int:
        return 1


class OperatorLocationType(WireCode):
    """Source of the operator position in `System`."""

    TAKEOFF = 0
    LIVE_GNSS = 1
    FIXED = 2

    @classmethod
    def _highest(cls) -> int:
        return 3


class ClassificationType(WireCode):
    """Region whose categories `System` carries."""

    UNDECLARED = 0
    EU = 1

    @classmethod
    def _highest(cls) -> int:
        return 7


class _Message(
    msgspec.Struct, frozen=True, tag=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True
):
    """Base class of all messages."""


class BasicId(_Message, frozen=True):
    """One identity of the aircraft."""

    id_type: IdType
    ua_type: UaType
    uas_id: str
    """Text for a serial number or CAA registration. Other types hold up to 20 raw bytes, one Latin-1
    character per byte, without the trailing padding."""


class Location(_Message, frozen=True):
    """Position and velocity of the aircraft at one moment."""

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
    """Horizontal speed."""
    vertical_speed_mps: float | None = None
    """Vertical speed, positive up."""
    horizontal_accuracy_m: float | None = None
    """Upper bound of the declared accuracy category (95 %)."""
    vertical_accuracy_m: float | None = None
    baro_accuracy_m: float | None = None
    speed_accuracy_mps: float | None = None
    timestamp_s: float | None = None
    """Seconds after the full UTC hour, [0, 3600]."""
    timestamp_accuracy_s: float | None = None


class Authentication(_Message, frozen=True):
    """One page of authentication data. The receiver assembles the pages."""

    auth_type: int
    page: int
    data: bytes
    """Up to 17 bytes on page 0, up to 23 on the others. Received data includes the padding; `length` tells
    where the padding starts."""
    last_page: int | None = None
    """Number of the last page. Only on page 0."""
    length: int | None = None
    """Total bytes of data in all pages. Only on page 0."""
    timestamp_utc_s: float | None = None
    """Unix time. Only on page 0."""


class SelfId(_Message, frozen=True):
    """Free text about the flight."""

    description_type: int
    text: str


class System(_Message, frozen=True):
    """Position of the operator, and area of a group flight."""

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
    """Registration number of the operator."""

    operator_id_type: int
    operator_id: str


Message = BasicId | Location | Authentication | SelfId | System | OperatorId
"""Any message except the pack. A pack is only a way to send several messages at once."""
