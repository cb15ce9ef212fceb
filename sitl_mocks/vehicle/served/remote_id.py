"""Remote ID of the mock vehicle: its own Location, and ArduPilot's handling of received Remote ID data.

The behaviour was observed on ArduPilot Copter 4.7 (DID_ENABLE = 1). The arming checks and their texts were
read in its source.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import Frame, MavlinkMessage
from companion.geometry import Vec3
from companion.remote_id.wire_values import (
    HORIZONTAL_ACCURACY_M,
    SPEED_ACCURACY_MPS,
    VERTICAL_ACCURACY_M,
)
from sitl_mocks.vehicle.links import Payload
from sitl_mocks.vehicle.options import VehicleOptions

EPOCH_2019_UTC_S = 1546300800
_NO_ID = bytes(20)
_UNKNOWN_TIME_S = 65535.0
_DYNAMIC_PERIOD_S = 1.0
_STATIC_SPACING_S = 0.8
"""Time between two static messages. The four of them are sent in turn."""
_MAX_AGE_S = 3.0
_FIRST_COMPLAINT_S = 2.8
_COMPLAINT_PERIOD_S = 5.1
_EPSILON_S = 1e-9

_BASIC_ID = int(mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_BASIC_ID)
_SYSTEM = int(mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_SYSTEM)
_SELF_ID = int(mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_SELF_ID)
_OPERATOR_ID = int(mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_OPERATOR_ID)
_UPDATE = int(mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_SYSTEM_UPDATE)
_ARM_STATUS = int(mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_ARM_STATUS)
_STATIC = (_BASIC_ID, _SYSTEM, _SELF_ID, _OPERATOR_ID)
ODID_MESSAGES = frozenset((*_STATIC, _UPDATE, _ARM_STATUS))
"""Remote ID messages that the relay takes."""
_SYSTEM_BYTES = 54
_UPDATE_BYTES = 18


def location(
    options: VehicleOptions,
    place: Vec3,
    velocity_ned_mps: Vec3,
    utc_s: float | None,
    *,
    on_ground: bool,
) -> MavlinkMessage:
    """Build OPEN_DRONE_ID_LOCATION.

    `place` is latitude and longitude (deg) and altitude (m, mean sea level).
    """
    lat, lon, alt = place
    north, east, down = velocity_ned_mps
    status = mavlink.MAV_ODID_STATUS_GROUND if on_ground else mavlink.MAV_ODID_STATUS_AIRBORNE
    return mavlink.MAVLink_open_drone_id_location_message(
        0,
        0,
        _NO_ID,
        status,
        round(math.degrees(math.atan2(east, north)) % 360.0 * 100.0) % 36000,
        round(math.hypot(north, east) * 100.0),
        round(-down * 100.0),
        round(lat * 1e7),
        round(lon * 1e7),
        alt,
        alt + options.geoid_separation_m,
        mavlink.MAV_ODID_HEIGHT_REF_OVER_TAKEOFF,
        alt - options.home_alt_msl_m,
        HORIZONTAL_ACCURACY_M.category("gnss_horizontal_sigma_m", options.gnss_horizontal_sigma_m),
        VERTICAL_ACCURACY_M.category("gnss_vertical_sigma_m", options.gnss_vertical_sigma_m),
        mavlink.MAV_ODID_VER_ACC_UNKNOWN,
        SPEED_ACCURACY_MPS.category("gnss_velocity_sigma_mps", options.gnss_velocity_sigma_mps),
        _UNKNOWN_TIME_S if utc_s is None else utc_s % 3600.0,
        mavlink.MAV_ODID_TIME_ACC_UNKNOWN if utc_s is None else mavlink.MAV_ODID_TIME_ACC_1_0_SECOND,
    )


def home_system(options: VehicleOptions, utc_s: float | None) -> MavlinkMessage:
    """Build PX4's OPEN_DRONE_ID_SYSTEM with home as the take-off point.

    Without GNSS time PX4's timestamp underflows.
    """
    return mavlink.MAVLink_open_drone_id_system_message(
        0,
        0,
        _NO_ID,
        mavlink.MAV_ODID_OPERATOR_LOCATION_TYPE_TAKEOFF,
        mavlink.MAV_ODID_CLASSIFICATION_TYPE_UNDECLARED,
        round(options.home_lat_deg * 1e7),
        round(options.home_lon_deg * 1e7),
        1,
        0,
        -1000.0,
        -1000.0,
        0,
        0,
        options.home_alt_msl_m,
        (int(utc_s or 0.0) - EPOCH_2019_UTC_S) % 2**32,
    )


class RemoteIdRelay:
    """ArduPilot's relay with DID_ENABLE: stores received Remote ID data, sends it on unchanged, and checks it
    for arming."""

    def __init__(self, location: Callable[[float], MavlinkMessage], start_s: float) -> None:
        """Set up the relay. `location` builds the vehicle's own LOCATION for a now_s."""
        self._location = location
        self._stored = dict.fromkeys(_STATIC, b"")
        self._heard_s: dict[int, float] = {}
        self._arm_refusal: str | None = None
        self._dynamic_due_s = start_s
        self._static_due_s = start_s
        self._turn = 0
        self._complaint_due_s = start_s + _FIRST_COMPLAINT_S
        self._transmitter_lost = True
        self.texts: list[tuple[int, str]] = []

    def handle(self, frame: Frame, message: MavlinkMessage, now_s: float) -> None:
        """Store an OPEN_DRONE_ID_* message.

        The sender is not checked, so messages that a Remote ID receiver passes on count too.
        """
        number = frame.message_id
        if number == _ARM_STATUS:
            if self._transmitter_lost:
                self._transmitter_lost = False
                self.texts.append((int(mavlink.MAV_SEVERITY_INFO), "ODID: transmitter OK"))
            good = message.status == mavlink.MAV_ODID_ARM_STATUS_GOOD_TO_ARM
            self._arm_refusal = None if good else message.error
        elif number == _UPDATE:
            told = frame.payload.ljust(_UPDATE_BYTES, b"\0")
            system = self._stored[_SYSTEM].ljust(_SYSTEM_BYTES, b"\0")
            # Both messages carry latitude, longitude, altitude and timestamp in this order.
            self._stored[_SYSTEM] = told[:8] + system[8:16] + told[8:16] + system[24:]
        elif number in self._stored:
            self._stored[number] = frame.payload
        self._heard_s[number] = now_s

    def due(self, at_s: float) -> list[MavlinkMessage | Payload]:
        """Return the messages to send now."""
        messages: list[MavlinkMessage | Payload] = []
        if at_s >= self._complaint_due_s - _EPSILON_S:
            self._complain(at_s)
        if at_s >= self._dynamic_due_s - _EPSILON_S:
            self._dynamic_due_s += _DYNAMIC_PERIOD_S
            system = self._stored[_SYSTEM].ljust(_SYSTEM_BYTES, b"\0")
            messages.append(self._location(at_s))
            messages.append(Payload(_UPDATE, system[:8] + system[16:24] + bytes(2)))
        if at_s >= self._static_due_s - _EPSILON_S:
            self._static_due_s += _STATIC_SPACING_S
            number = _STATIC[self._turn % len(_STATIC)]
            self._turn += 1
            size = mavlink.mavlink_map[number].unpacker.size
            messages.append(Payload(number, self._stored[number].ljust(size, b"\0")))
        return messages

    def _complain(self, now_s: float) -> None:
        """Report missing data as text."""
        self._complaint_due_s += _COMPLAINT_PERIOD_S
        warning = int(mavlink.MAV_SEVERITY_WARNING)
        if not self._fresh(_ARM_STATUS, now_s):
            self._transmitter_lost = True
            self.texts.append((warning, "ODID: lost transmitter"))
        if not (self._fresh(_SYSTEM, now_s) or self._fresh(_UPDATE, now_s)):
            self.texts.append((warning, "ODID: lost operator location"))

    def refusal(self, now_s: float) -> str | None:
        """Return why the vehicle refuses to arm (DID_OPTIONS = 1), in the order of the firmware's checks."""
        if not any(self._stored[_BASIC_ID][22:23]):
            return "UA_TYPE required in BasicID"
        if not any(self._stored[_SYSTEM][:8]):
            return "operator location must be set"
        if not self._fresh(_ARM_STATUS, now_s):
            return "ARM_STATUS not available"
        if _SYSTEM not in self._heard_s or not (self._fresh(_SYSTEM, now_s) or self._fresh(_UPDATE, now_s)):
            return "SYSTEM not available"
        return self._arm_refusal

    def _fresh(self, number: int, now_s: float) -> bool:
        return now_s - self._heard_s.get(number, -math.inf) <= _MAX_AGE_S
