"""Encodes the companion's MAVLink messages as (message id, payload), with the payload in wire order.

Payloads are packed with prepared `struct`s instead of pymavlink's message objects, because a setpoint is sent
twenty times a second per aircraft and many aircraft share one thread in simulation. The tests check every
layout against pymavlink's.
"""

from __future__ import annotations

import hashlib
import math
import struct

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.dialect import (
    AUTOPILOT_INVALID,
    FRAME_LOCAL_NED,
    VELOCITY_YAW_MASK,
    VELOCITY_YAW_RATE_MASK,
)
from companion.autopilot.readers import MAX_ICAO
from companion.events import Threat, TrafficReport
from companion.events.sensed import SENSED_HYPHEN
from companion.geometry import Vec3

Outgoing = tuple[int, bytes]
"""Message id and payload."""

AUTOPILOT_COMPONENT: int = mavlink.MAV_COMP_ID_AUTOPILOT1
MAX_SETPOINT_MPS = 100.0
"""Largest speed of a setpoint. No supported vehicle is ever asked for more, so a larger number is a bug of
ours."""
TEXT_BYTES = 50
"""Length of STATUSTEXT's text field."""
_MAX_CHUNKS = 10
CALLSIGN_BYTES = 8
"""Longest callsign of ADSB_VEHICLE; a zero byte follows it."""

TYPE_ONBOARD_CONTROLLER: int = mavlink.MAV_TYPE_ONBOARD_CONTROLLER
_MAVLINK_VERSION = 3
_HEARTBEAT = struct.Struct("<IBBBBB")
_SETPOINT = struct.Struct("<I11fHBBB")
_COMMAND_LONG = struct.Struct("<7fHBBB")
_STATUSTEXT = struct.Struct("<B50sHB")
_PARAM_READ = struct.Struct("<hBB16s")
_LIST = struct.Struct("<BBB")
_REQUEST = struct.Struct("<HBBB")
_ACK = struct.Struct("<BBBB")
_COLLISION = struct.Struct("<IfffBBB")
_ADSB = struct.Struct("<I3i2Hh2HB9s2B")
_THREAT_LEVELS = (
    mavlink.MAV_COLLISION_THREAT_LEVEL_NONE,
    mavlink.MAV_COLLISION_THREAT_LEVEL_LOW,
    mavlink.MAV_COLLISION_THREAT_LEVEL_HIGH,
)
MAX_TOLD = 1e6
"""Largest time (s) or distance (m) in COLLISION. Larger values are reported as this one, so that encoding
never fails."""


def heartbeat(mav_type: int = TYPE_ONBOARD_CONTROLLER) -> Outgoing:
    """HEARTBEAT of a component that is not an autopilot."""
    return mavlink.MAVLINK_MSG_ID_HEARTBEAT, _HEARTBEAT.pack(
        0, mav_type, AUTOPILOT_INVALID, 0, mavlink.MAV_STATE_ACTIVE, _MAVLINK_VERSION
    )


def check_velocity(velocity_ned_mps: Vec3) -> None:
    """Reject a velocity that must not be sent as a setpoint.

    Raises:
        ValueError: a component is not finite, or the speed is above `MAX_SETPOINT_MPS`. Either is a bug of
            ours.
    """
    north, east, down = velocity_ned_mps
    # A comparison with NaN is false, and infinity exceeds the limit.
    if not math.hypot(north, east, down) <= MAX_SETPOINT_MPS:
        raise ValueError(
            f"velocity setpoint {velocity_ned_mps} m/s is not finite or above {MAX_SETPOINT_MPS}"
        )


def velocity_setpoint(
    velocity_ned_mps: Vec3, yaw_rad: float | None, time_boot_ms: int, system_id: int
) -> Outgoing:
    """SET_POSITION_TARGET_LOCAL_NED with a velocity north, east, down (m/s) and a yaw.

    Args:
        yaw_rad: clockwise from north. None: the heading is held (yaw rate 0).

    Raises:
        ValueError: see `check_velocity`.
    """
    check_velocity(velocity_ned_mps)
    north, east, down = velocity_ned_mps
    return mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED, _SETPOINT.pack(
        time_boot_ms & 0xFFFF_FFFF,
        0.0,
        0.0,
        0.0,
        north,
        east,
        down,
        0.0,
        0.0,
        0.0,
        0.0 if yaw_rad is None else yaw_rad,
        0.0,
        VELOCITY_YAW_RATE_MASK if yaw_rad is None else VELOCITY_YAW_MASK,
        system_id,
        AUTOPILOT_COMPONENT,
        FRAME_LOCAL_NED,
    )


def command_long(command: int, params: tuple[float, ...], system_id: int, confirmation: int = 0) -> Outgoing:
    """COMMAND_LONG to the autopilot. Params that are not given are 0."""
    seven = (*params, *(0.0,) * (7 - len(params)))
    return mavlink.MAVLINK_MSG_ID_COMMAND_LONG, _COMMAND_LONG.pack(
        *seven, command, system_id, AUTOPILOT_COMPONENT, confirmation
    )


def param_request_read(name: str, system_id: int) -> Outgoing:
    """PARAM_REQUEST_READ by name."""
    return mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ, _PARAM_READ.pack(
        -1, system_id, AUTOPILOT_COMPONENT, name.encode("ascii")
    )


def statustext(severity: int, text: str, text_id: int) -> list[Outgoing]:
    """STATUSTEXT. A longer text is split into chunks under `text_id` (1-65535) and cut off after ten of them.

    Characters that are not printable ASCII become "?", because ground stations differ in which others they
    show, and names in a text come from unknown senders. The special hyphen in the ids of sensed tracks
    (`events.sensed`) becomes a plain one.
    """
    plain = text.replace(SENSED_HYPHEN, "-").encode("ascii", "replace")
    data = bytes(code if 0x20 <= code < 0x7F else 0x3F for code in plain)
    if len(data) <= TEXT_BYTES:
        return [(mavlink.MAVLINK_MSG_ID_STATUSTEXT, _STATUSTEXT.pack(severity, data, 0, 0))]
    # A zero byte ends the text, so a text that fills its last chunk would need one more, empty chunk.
    data = data[: TEXT_BYTES * _MAX_CHUNKS - 1]
    return [
        (
            mavlink.MAVLINK_MSG_ID_STATUSTEXT,
            _STATUSTEXT.pack(severity, data[at : at + TEXT_BYTES], text_id, at // TEXT_BYTES),
        )
        for at in range(0, len(data) + 1, TEXT_BYTES)
    ]


def collision(threat: Threat) -> Outgoing:
    """COLLISION. `id` is the ICAO address if `src` is ADSB.

    MAVLink has no source for Remote ID. It is reported as MAVLINK_GPS_GLOBAL_INT, the source for other
    aircraft's own reports. Its `id` is the first four bytes of the SHA-256 of the track's name. This id is
    the same on every aircraft, and two among a hundred tracks share one with a probability of 1e-6.

    `action` is REPORT, or MOVE_PERPENDICULAR while the companion avoids the other aircraft.
    MOVE_PERPENDICULAR is the only evasive action that is neither horizontal nor vertical alone, and the law's
    manoeuvres are neither.

    Raises:
        ValueError: a level that MAVLink does not have, or an ADS-B track whose name does not begin with
            24 bits in hexadecimal digits. Both are bugs of ours.
    """
    if threat.level not in _THREAT_LEVELS:
        raise ValueError(f"MAV_COLLISION_THREAT_LEVEL {threat.level} is not defined")
    if threat.adsb:
        source, number = mavlink.MAV_COLLISION_SRC_ADSB, int(threat.track_id.partition("/")[0], 16)
        if not 0 <= number <= MAX_ICAO:
            raise ValueError(f"{threat.track_id} is not an ICAO address")
    else:
        digest = hashlib.sha256(threat.track_id.encode("utf-8", "replace")).digest()
        source, number = mavlink.MAV_COLLISION_SRC_MAVLINK_GPS_GLOBAL_INT, int.from_bytes(digest[:4], "big")
    return mavlink.MAVLINK_MSG_ID_COLLISION, _COLLISION.pack(
        number,
        _told(threat.time_to_closest_s),
        _told(threat.vertical_m),
        _told(threat.horizontal_m),
        source,
        mavlink.MAV_COLLISION_ACTION_MOVE_PERPENDICULAR
        if threat.acting
        else mavlink.MAV_COLLISION_ACTION_REPORT,
        threat.level,
    )


def adsb_vehicle(report: TrafficReport) -> Outgoing:
    """ADSB_VEHICLE of an aircraft heard by Remote ID, with the emitter type UAV.

    The altitude is above mean sea level, as the message defines it, and of the type GEOMETRIC: it comes from
    a GNSS receiver. Speeds beyond the fields' range are limited to it.

    Raises:
        ValueError: an address of more than 24 bits or a longer callsign than 8 characters, both bugs of ours.
    """
    callsign = report.callsign.encode("ascii")
    if not 0 <= report.icao <= MAX_ICAO or len(callsign) > CALLSIGN_BYTES:
        raise ValueError(f"{report.icao:#x} {report.callsign!r} does not fit into ADSB_VEHICLE")
    north, east, down = report.velocity_ned_mps
    flags = mavlink.ADSB_FLAGS_VALID_COORDS | mavlink.ADSB_FLAGS_VALID_CALLSIGN
    flags |= mavlink.ADSB_FLAGS_VALID_VELOCITY | mavlink.ADSB_FLAGS_VERTICAL_VELOCITY_VALID
    if report.alt_msl_m is not None:
        flags |= mavlink.ADSB_FLAGS_VALID_ALTITUDE
    if not report.hovers:
        flags |= mavlink.ADSB_FLAGS_VALID_HEADING
    return mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE, _ADSB.pack(
        report.icao,
        round(report.lat_deg * 1e7),
        round(report.lon_deg * 1e7),
        round((report.alt_msl_m or 0.0) * 1e3),
        0 if report.hovers else round(math.degrees(math.atan2(east, north)) % 360.0 * 100.0) % 36000,
        min(round(math.hypot(north, east) * 100.0), 0xFFFF),
        min(max(round(-down * 100.0), -0x8000), 0x7FFF),
        flags,
        0,
        mavlink.ADSB_ALTITUDE_TYPE_GEOMETRIC,
        callsign,
        mavlink.ADSB_EMITTER_TYPE_UAV,
        min(int(report.age_s), 0xFF),
    )


def _told(value: float) -> float:
    """Value limited to the range of the field. NaN stays NaN, which is MAVLink's "not known"."""
    return min(max(value, 0.0), MAX_TOLD)


def mission_request_list(system_id: int, mission_type: int) -> Outgoing:
    """MISSION_REQUEST_LIST: asks how many items a list has."""
    return (
        mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST,
        _LIST.pack(system_id, AUTOPILOT_COMPONENT, mission_type),
    )


def mission_request(seq: int, system_id: int, mission_type: int, *, as_int: bool) -> Outgoing:
    """MISSION_REQUEST_INT, or the older MISSION_REQUEST, for one item."""
    message_id = (
        mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT if as_int else mavlink.MAVLINK_MSG_ID_MISSION_REQUEST
    )
    return message_id, _REQUEST.pack(seq, system_id, AUTOPILOT_COMPONENT, mission_type)


def mission_ack(system_id: int, mission_type: int, *, cancelled: bool = False) -> Outgoing:
    """MISSION_ACK: the download is complete, or cancelled."""
    result = mavlink.MAV_MISSION_OPERATION_CANCELLED if cancelled else mavlink.MAV_MISSION_ACCEPTED
    return mavlink.MAVLINK_MSG_ID_MISSION_ACK, _ACK.pack(system_id, AUTOPILOT_COMPONENT, result, mission_type)
