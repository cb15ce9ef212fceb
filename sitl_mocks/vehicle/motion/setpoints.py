"""SET_POSITION_TARGET_LOCAL_NED as each firmware understands it.

Rules, as observed on the real firmwares:
- A frame outside the firmware's list stops ArduPilot. PX4 ignores such a message.
- A velocity vector with a single ignored axis is no velocity: the vehicle stops.
- If a message gives the height as position and the rest as velocity, PX4 flies both and ArduPilot stops.
- A value that is not a finite number stops the vehicle. The message still counts as a setpoint.
"""

from __future__ import annotations

import math

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.geometry import Vec3
from sitl_mocks.vehicle.firmware.behaviour import Manners
from sitl_mocks.vehicle.links import SetpointMessage

_X = mavlink.POSITION_TARGET_TYPEMASK_X_IGNORE
_Y = mavlink.POSITION_TARGET_TYPEMASK_Y_IGNORE
_Z = mavlink.POSITION_TARGET_TYPEMASK_Z_IGNORE
_VX = mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE
_VY = mavlink.POSITION_TARGET_TYPEMASK_VY_IGNORE
_VZ = mavlink.POSITION_TARGET_TYPEMASK_VZ_IGNORE
_YAW = mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
_YAW_RATE = mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
_BODY_OFFSET = mavlink.MAV_FRAME_BODY_OFFSET_NED
_LOCAL_OFFSET = mavlink.MAV_FRAME_LOCAL_OFFSET_NED


class Setpoint(msgspec.Struct, frozen=True):
    """What to fly until the next setpoint: a velocity (NED, m/s), a position to hold (NED, m), a heading."""

    velocity_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    horizontal_ned_m: tuple[float, float] | None = None
    down_m: float | None = None
    yaw_rad: float | None = None
    yaw_rate_radps: float | None = None
    expires: bool = True
    """Whether the setpoint ends when its stream stops.

    ArduPilot flies a position without velocity to its end.
    """
    stop: bool = False
    """The setpoint was not understood, so the vehicle stops."""


STOP = Setpoint(stop=True)


def interpret(
    message: SetpointMessage, manners: Manners, position_ned_m: Vec3, yaw_rad: float
) -> Setpoint | None:
    """Return the setpoint, STOP if the message stops the vehicle, or None if the firmware ignores it."""
    frame = message.coordinate_frame
    if frame not in manners.setpoint_frames:
        return STOP if manners.bad_frame_stops else None
    mask = message.type_mask
    velocity = (message.vx, message.vy, message.vz)
    position = (message.x, message.y, message.z)
    turned = frame in manners.body_frames
    if turned:
        velocity = _turn(velocity, yaw_rad)
    if frame == _BODY_OFFSET:
        position = _turn(position, yaw_rad)
    if frame in (_LOCAL_OFFSET, _BODY_OFFSET):
        north, east, down = position_ned_m
        position = (position[0] + north, position[1] + east, position[2] + down)
    has_position = not mask & _X, not mask & _Y, not mask & _Z
    has_velocity = not mask & _VX, not mask & _VY, not mask & _VZ
    if not manners.needs_whole_velocity and any(has_velocity) and not all(has_velocity):
        north, east, down = (v if has else 0.0 for v, has in zip(velocity, has_velocity, strict=True))
        velocity, has_velocity = (north, east, down), (True, True, True)
    yaw = None if mask & _YAW or not math.isfinite(message.yaw) else message.yaw
    rate = None if mask & _YAW_RATE or not math.isfinite(message.yaw_rate) else message.yaw_rate
    if manners.altitude_with_horizontal_velocity:
        found = _by_axis(position, velocity, has_position, has_velocity)
    else:
        found = _by_vector(position, velocity, has_position, has_velocity)
    if found is None:
        return STOP
    flown, horizontal, down_target = found
    numbers = (*flown, *(horizontal or ()), 0.0 if down_target is None else down_target)
    if not all(map(math.isfinite, numbers)):
        return STOP
    expires = manners.external_needs_stream or any(has_velocity)
    return Setpoint(flown, horizontal, down_target, yaw, rate, expires)


_Found = tuple[Vec3, tuple[float, float] | None, float | None]


def _by_vector(
    position: Vec3, velocity: Vec3, has_p: tuple[bool, ...], has_v: tuple[bool, ...]
) -> _Found | None:
    """ArduPilot's rule: a vector counts only with all three axes."""
    if all(has_p):
        return (velocity if all(has_v) else (0.0, 0.0, 0.0)), position[:2], position[2]
    return (velocity, None, None) if all(has_v) else None


def _by_axis(
    position: Vec3, velocity: Vec3, has_p: tuple[bool, ...], has_v: tuple[bool, ...]
) -> _Found | None:
    """PX4's rule: the horizontal pair and the height may each come from a position, a velocity or both."""
    horizontal_p, horizontal_v = has_p[0] and has_p[1], has_v[0] and has_v[1]
    if not (horizontal_p or horizontal_v) or not (has_p[2] or has_v[2]):
        return None
    flown = (
        velocity[0] if horizontal_v else 0.0,
        velocity[1] if horizontal_v else 0.0,
        velocity[2] if has_v[2] else 0.0,
    )
    return flown, position[:2] if horizontal_p else None, position[2] if has_p[2] else None


def _turn(vector: Vec3, yaw_rad: float) -> Vec3:
    """Rotate a vector from forward-right-down to NED."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return (cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1], vector[2])
