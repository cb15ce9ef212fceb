"""Converts MAVLink payloads to events, with one small function per message in one table.

A reader gets the message's fields in wire order, as `struct` unpacks them (the tests check that order against
pymavlink's). It returns None when the message says "not known yet", and raises `PeerDataError` for values
that no correct vehicle sends. No non-finite or out-of-range value becomes an event.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.dialect import ARMED, DIALECTS, FIRMWARES, flight_mode
from companion.autopilot.wire import CURRENT_MODE
from companion.errors import PeerDataError
from companion.events import (
    AdsbVehicle,
    AirPressure,
    CurrentMode,
    EstimatorState,
    Event,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    Landed,
    LandedState,
    LocalPosition,
    MissionCurrent,
    RcChannels,
    VehicleTime,
)

Fields = tuple[Any, ...]
"""A payload's fields in wire order."""

MAX_ALTITUDE_M = 50_000.0
MIN_ALTITUDE_M = -1_000.0
MAX_SPEED_MPS = 327.0
"""Largest velocity accepted. Beyond it, GLOBAL_POSITION_INT's 16-bit centimetres per second are saturated."""
MAX_LOCAL_M = 1_000_000.0
UTC_RANGE_S = (1_420_070_400.0, 4_102_444_800.0)
"""Years 2015 to 2100. An autopilot whose clock is outside this range does not know the time."""

PRESSURE_RANGE_HPA = (300.0, 1100.0)
"""Pressures from 9 km above to 700 m below sea level."""

MAX_ICAO = 0xFF_FFFF
"""ICAO addresses have 24 bits."""

_ESTIMATES: int = (
    mavlink.ESTIMATOR_VELOCITY_HORIZ | mavlink.ESTIMATOR_POS_HORIZ_ABS | mavlink.ESTIMATOR_POS_VERT_ABS
)
"""Estimates that must be good, the height included: others are avoided above and below. EKF_STATUS_FLAGS has
the same bits."""
_CONSTANT_POSITION: int = mavlink.ESTIMATOR_CONST_POS_MODE
"""The estimator assumes that the vehicle stands still."""
_RC_RANGE_US = (800, 2200)
"""Valid pulse widths. A channel outside this range is not present (0 or 65535)."""
_MAX_FIX_TYPE = mavlink.GPS_FIX_TYPE_PPP
_UINT32_MAX = 0xFFFF_FFFF
_FAILSAFES = (mavlink.MAV_STATE_CRITICAL, mavlink.MAV_STATE_EMERGENCY)
_LANDED = dict(enumerate(Landed))
_BAROMETRIC, _GEOMETRIC = mavlink.ADSB_ALTITUDE_TYPE_PRESSURE_QNH, mavlink.ADSB_ALTITUDE_TYPE_GEOMETRIC
_UNPACKERS: dict[int, struct.Struct] = {i: m.unpacker for i, m in mavlink.mavlink_map.items()}
# Includes the extension field mission_id, which pymavlink's dialect lacks.
_UNPACKERS[mavlink.MAVLINK_MSG_ID_MISSION_CURRENT] = struct.Struct("<HHBBI")
_UNPACKERS[CURRENT_MODE] = struct.Struct("<IIB")


def unpack(message_id: int, payload: bytes) -> Fields:
    """Fields of a payload in wire order. Truncated zeros are restored, and extensions newer than ours are
    dropped."""
    unpacker = _UNPACKERS[message_id]
    return unpacker.unpack(payload.ljust(unpacker.size, b"\0")[: unpacker.size])


def _position(lat_e7: int, lon_e7: int) -> tuple[float, float]:
    if not (-900_000_000 <= lat_e7 <= 900_000_000 and -1_800_000_000 <= lon_e7 <= 1_800_000_000):
        raise PeerDataError(f"position {lat_e7 / 1e7}, {lon_e7 / 1e7} is not on Earth")
    return lat_e7 / 1e7, lon_e7 / 1e7


def _altitude(name: str, millimetres: int) -> float:
    metres = millimetres / 1e3
    if not MIN_ALTITUDE_M <= metres <= MAX_ALTITUDE_M:
        raise PeerDataError(f"{name} {metres} m is outside {MIN_ALTITUDE_M} to {MAX_ALTITUDE_M}")
    return metres


def _unless(unknown: tuple[int, ...], value: int, scale: float) -> float | None:
    return None if value in unknown else value / scale


def heartbeat(system_id: int, fields: Fields) -> Heartbeat:
    """HEARTBEAT of a supported autopilot.

    Raises:
        PeerDataError: the autopilot is of no known firmware.
    """
    custom_mode, vehicle_type, autopilot, base_mode, status, _version = fields
    firmware = FIRMWARES.get(autopilot)
    if firmware is None:
        known = [f"{dialect.title} ({dialect.autopilot})" for dialect in DIALECTS.values()]
        listed = f"{', '.join(known[:-1])} nor {known[-1]}"
        raise PeerDataError(f"MAV_AUTOPILOT {autopilot} is neither {listed}")
    return Heartbeat(
        system_id=system_id,
        firmware=firmware,
        vehicle_type=vehicle_type,
        custom_mode=custom_mode,
        mode=flight_mode(firmware, vehicle_type, base_mode, custom_mode),
        armed=bool(base_mode & ARMED),
        failsafe=status in _FAILSAFES,
    )


def current_mode(fields: Fields) -> CurrentMode:
    """CURRENT_MODE. The mode that is flown counts; the intended mode differs from it only in a failsafe."""
    return CurrentMode(custom_mode=fields[0])


def global_position(fields: Fields) -> GlobalPosition | None:
    """GLOBAL_POSITION_INT; None at exactly 0, 0, which autopilots send before they know their position."""
    time_ms, lat_e7, lon_e7, alt_mm, height_mm, vx, vy, vz, _heading = fields
    if lat_e7 == 0 and lon_e7 == 0:
        return None
    lat_deg, lon_deg = _position(lat_e7, lon_e7)
    if not (abs(vx) < 32_700 and abs(vy) < 32_700 and abs(vz) < 32_700):
        raise PeerDataError(f"velocity {vx}, {vy}, {vz} cm/s is saturated")
    return GlobalPosition(
        time_boot_s=time_ms / 1e3,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_msl_m=_altitude("altitude", alt_mm),
        height_above_home_m=_altitude("height above home", height_mm),
        velocity_ned_mps=(vx / 100, vy / 100, vz / 100),
    )


def local_position(fields: Fields) -> LocalPosition:
    """LOCAL_POSITION_NED."""
    time_ms, x, y, z, vx, vy, vz = fields
    # NaN and infinity fail these comparisons too.
    if not (abs(x) <= MAX_LOCAL_M and abs(y) <= MAX_LOCAL_M and abs(z) <= MAX_LOCAL_M):
        raise PeerDataError(f"local position {x}, {y}, {z} m is out of range")
    if not (abs(vx) <= MAX_SPEED_MPS and abs(vy) <= MAX_SPEED_MPS and abs(vz) <= MAX_SPEED_MPS):
        raise PeerDataError(f"velocity {vx}, {vy}, {vz} m/s is out of range")
    return LocalPosition(time_boot_s=time_ms / 1e3, position_ned_m=(x, y, z), velocity_ned_mps=(vx, vy, vz))


def gnss_fix(fields: Fields) -> GnssFix:
    """GPS_RAW_INT. An extension field of 0 counts as not filled in (MAVLink 1 has no extensions)."""
    _usec, lat_e7, lon_e7, alt_mm, _eph, _epv, _vel, _cog, fix_type, satellites, ellipsoid_mm = fields[:11]
    h_acc, v_acc, vel_acc = fields[11:14]
    if fix_type > _MAX_FIX_TYPE:
        raise PeerDataError(f"GPS_FIX_TYPE {fix_type} is not defined")
    lat_deg, lon_deg = _position(lat_e7, lon_e7)
    unknown = (0, _UINT32_MAX)
    return GnssFix(
        fix_type=fix_type,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_msl_m=_altitude("altitude", alt_mm),
        alt_ellipsoid_m=_altitude("ellipsoid altitude", ellipsoid_mm) if ellipsoid_mm else None,
        horizontal_accuracy_m=_unless(unknown, h_acc, 1e3),
        vertical_accuracy_m=_unless(unknown, v_acc, 1e3),
        speed_accuracy_mps=_unless(unknown, vel_acc, 1e3),
        satellites=None if satellites == 255 else satellites,
    )


def air_pressure(fields: Fields) -> AirPressure:
    """SCALED_PRESSURE, in the hectopascals of the sensor that both firmwares use first.

    Raises:
        PeerDataError: the pressure is that of no height at which a small aircraft flies.
    """
    pressure_hpa = fields[1]
    if not PRESSURE_RANGE_HPA[0] <= pressure_hpa <= PRESSURE_RANGE_HPA[1]:
        raise PeerDataError(f"absolute pressure {pressure_hpa} hPa is out of range")
    return AirPressure(pressure_hpa=pressure_hpa)


def vehicle_time(fields: Fields) -> VehicleTime:
    """SYSTEM_TIME."""
    unix_usec, boot_ms = fields
    utc_s = unix_usec / 1e6
    known = UTC_RANGE_S[0] <= utc_s <= UTC_RANGE_S[1]
    return VehicleTime(time_boot_s=boot_ms / 1e3, utc_s=utc_s if known else None)


def landed_state(fields: Fields) -> LandedState:
    """EXTENDED_SYS_STATE."""
    landed = _LANDED.get(fields[1])
    if landed is None:
        raise PeerDataError(f"MAV_LANDED_STATE {fields[1]} is not defined")
    return LandedState(landed=landed)


def mission_current(fields: Fields) -> MissionCurrent:
    """MISSION_CURRENT. On ArduPilot item 0 is home, so the first item flown is 1. When the mission is
    replaced, PX4 reports another `mission_id` (a checksum), and ArduPilot only another `total`."""
    seq, total, state, _mode, mission_id = fields
    complete = state == mavlink.MISSION_STATE_COMPLETE
    return MissionCurrent(seq=seq, complete=complete, total=total, mission_id=mission_id)


def ekf_status_report(fields: Fields) -> EstimatorState:
    """EKF_STATUS_REPORT (ArduPilot)."""
    flags = fields[5]
    return EstimatorState(usable=_estimates(flags) and not flags & _CONSTANT_POSITION)


def estimator_status(fields: Fields) -> EstimatorState:
    """ESTIMATOR_STATUS (PX4). It has the same flags, but PX4 also reports a constant position while the
    vehicle rests on the ground (Ekf::get_ekf_soln_status), so that flag is not used. When the position is
    only assumed, the flags of the horizontal estimates soon disappear."""
    return EstimatorState(usable=_estimates(fields[9]))


def _estimates(flags: int) -> bool:
    return flags & _ESTIMATES == _ESTIMATES


def rc_channels(fields: Fields) -> RcChannels:
    """RC_CHANNELS. Roll, pitch and yaw are read from the channels that both firmwares use unless mapped
    otherwise."""
    sticks = (fields[1], fields[2], fields[4])
    if fields[19] == 0 or not all(_RC_RANGE_US[0] <= us <= _RC_RANGE_US[1] for us in sticks):
        return RcChannels()
    return RcChannels(sticks_us=sticks)


def adsb_vehicle(fields: Fields) -> AdsbVehicle | None:
    """ADSB_VEHICLE; None without a valid position, or at exactly 0, 0, which ArduPilot drops too.

    `flags` shows which fields are known. The velocity needs both VALID_VELOCITY and VALID_HEADING. The
    vertical speed (positive up) then counts even without VERTICAL_VELOCITY_VALID, as it does in ArduPilot
    (AP_Avoidance) and PX4: PX4 passes on the first six flags only, so it never sets that one. SIMULATED and
    SOURCE_UAT traffic is treated like any other.

    `age_s` is the age that the receiver reported. ArduPilot keeps an aircraft for 5 s after it was last
    heard, repeats it every second and leaves `tslc` unchanged (AP_ADSB), so there the data may be older by
    that much.

    Raises:
        PeerDataError: an address of more than 24 bits, a place or altitude not on Earth, an undefined type of
            altitude.
    """
    icao, lat_e7, lon_e7, alt_mm, course, speed, climb, flags, _squawk, alt_type, name, emitter, tslc = fields
    if not flags & mavlink.ADSB_FLAGS_VALID_COORDS or (lat_e7 == 0 and lon_e7 == 0):
        return None
    if icao > MAX_ICAO:
        raise PeerDataError(f"ICAO address {icao:#x} has more than 24 bits")
    lat_deg, lon_deg = _position(lat_e7, lon_e7)
    alt_m = None
    if flags & mavlink.ADSB_FLAGS_VALID_ALTITUDE:
        if alt_type not in (_BAROMETRIC, _GEOMETRIC):
            raise PeerDataError(f"ADSB_ALTITUDE_TYPE {alt_type} is not defined")
        alt_m = _altitude("altitude", alt_mm)
    velocity = None
    known = flags & mavlink.ADSB_FLAGS_VALID_VELOCITY and flags & mavlink.ADSB_FLAGS_VALID_HEADING
    # PX4's range of course includes 36000. An impossible velocity is unknown: the place may be true.
    if known and course <= 36_000 and speed != 0xFFFF and abs(climb) < 0x7FFF:
        angle = math.radians(course / 100)
        velocity = (speed / 100 * math.cos(angle), speed / 100 * math.sin(angle), -climb / 100)
    return AdsbVehicle(
        icao=icao,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_m=alt_m,
        alt_geometric=alt_m is not None and alt_type == _GEOMETRIC,
        velocity_ned_mps=velocity,
        age_s=float(tslc),
        callsign=_callsign(name) if flags & mavlink.ADSB_FLAGS_VALID_CALLSIGN else "",
        emitter=emitter,
    )


def _callsign(field: bytes) -> str:
    """Text up to the first zero byte. Characters that are not printable ASCII become "?", because the text
    comes from unknown senders."""
    text = field.split(b"\0", 1)[0]
    return "".join(chr(code) if 0x20 <= code < 0x7F else "?" for code in text).strip()


READERS: dict[int, Callable[[Fields], Event | None]] = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: global_position,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: local_position,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: gnss_fix,
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: air_pressure,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: vehicle_time,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: landed_state,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: mission_current,
    mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE: adsb_vehicle,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: ekf_status_report,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: estimator_status,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: rc_channels,
    CURRENT_MODE: current_mode,
}


def finite_or_none(value: float) -> float | None:
    """None for NaN and infinity, which mean "not given" in mission params."""
    return value if math.isfinite(value) else None
