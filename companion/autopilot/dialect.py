"""The dialects of all firmwares, and what the firmwares share.

A dialect is what one firmware does in its own way: `companion.autopilot.dialects` has one file for each. All
of them take the same velocity setpoint in the same frame, with one type mask for a given yaw and one for a
held heading. A mode counts as entered only when the heartbeat's `custom_mode` shows it, because PX4
acknowledges modes that it then does not enter.
"""

from __future__ import annotations

import importlib

import msgspec

from companion.autopilot.dialects.definition import CUSTOM_MODE_ENABLED, HELICOPTER, Dialect
from companion.config import FlightConfig
from companion.events import Firmware, FlightMode, Heartbeat

ARMED = 128
"""MAV_MODE_FLAG_SAFETY_ARMED."""
CMD_DO_SET_MODE = 176
CMD_DO_CHANGE_SPEED = 178
CMD_SET_MESSAGE_INTERVAL = 511
CMD_REQUEST_MESSAGE = 512

VELOCITY_YAW_MASK = 0x9C7
"""POSITION_TARGET_TYPEMASK that uses the three velocity axes and the yaw. ArduPilot drops the whole velocity
vector if any axis is ignored."""
VELOCITY_YAW_RATE_MASK = 0x5C7
"""POSITION_TARGET_TYPEMASK that uses the three velocity axes and the yaw rate. With a yaw rate of 0, both
firmwares hold the heading. With neither yaw nor yaw rate (0xDC7), PX4 still holds it, but ArduPilot turns the
nose as WP_YAW_BEHAVIOR says."""
FRAME_LOCAL_NED = 1
"""MAV_FRAME_LOCAL_NED. This is the frame in which both firmwares take a velocity as north, east, down."""

AUTOPILOT_INVALID = 8
"""MAV_AUTOPILOT_INVALID: the component is not an autopilot."""

DIALECTS: dict[Firmware, Dialect] = {
    firmware: importlib.import_module(f"companion.autopilot.dialects.{firmware.value}").DIALECT
    for firmware in Firmware
}
"""The dialect of each firmware, from the file of its name. `companion.events.Firmware` is the registry."""
FIRMWARES = {dialect.autopilot: firmware for firmware, dialect in DIALECTS.items()}
"""MAV_AUTOPILOT values of the supported autopilots."""

_UNSUPPORTED = {
    1: "fixed-wing aircraft",
    HELICOPTER: "helicopter",
    5: "antenna tracker",
    7: "airship",
    8: "balloon",
    9: "rocket",
    10: "rover",
    11: "boat",
    12: "submarine",
    16: "flapping wing",
    17: "kite",
    28: "parafoil",
    46: "walking robot",
    **dict.fromkeys((19, 20, 21, 22, 23, 24, 25, 47), "VTOL"),
}


def refusal(firmware: Firmware, vehicle_type: int) -> str | None:
    """Why this kind of vehicle (MAV_TYPE) cannot be commanded, in words; None when it can.

    The mode numbers and the response to velocity setpoints are those of multirotors. On ArduPlane, for
    example, mode 4 is ACRO.
    """
    if vehicle_type in DIALECTS[firmware].vehicle_types:
        return None
    kind = _UNSUPPORTED.get(vehicle_type, "vehicle")
    supported = " and ".join(dialect.vehicles for dialect in DIALECTS.values())
    return f"{firmware.value} {kind} (MAV_TYPE {vehicle_type}) is not supported; supported are {supported}"


def flight_mode(firmware: Firmware, vehicle_type: int, base_mode: int, custom_mode: int) -> FlightMode:
    """Convert a vehicle's mode to a `FlightMode`; OTHER if the vehicle cannot be commanded."""
    if refusal(firmware, vehicle_type) is not None:
        return FlightMode.OTHER
    return DIALECTS[firmware].mode(base_mode, custom_mode)


def in_mode(beat: Heartbeat, custom_mode: int) -> Heartbeat:
    """Copy of a vehicle's last heartbeat with the mode that a later CURRENT_MODE reported."""
    mode = flight_mode(beat.firmware, beat.vehicle_type, CUSTOM_MODE_ENABLED, custom_mode)
    return msgspec.structs.replace(beat, custom_mode=custom_mode, mode=mode)


def impossible_rearm(firmware: Firmware, flight: FlightConfig) -> str | None:
    """Why a pilot cannot give control back to the companion as `flight.rearm` says, in words; None when
    possible.

    A firmware may refuse the mode that flies setpoints while none are streamed, and none are once the pilot
    has taken over.
    """
    dialect = DIALECTS[firmware]
    if flight.use != "fly" or flight.rearm != "mode" or not dialect.external_needs_setpoints:
        return None
    mode = dialect.name(dialect.command(FlightMode.EXTERNAL).custom_mode)
    return (
        f'flight.rearm: "mode" cannot restore authority on {dialect.title}, which refuses {mode} '
        'while no setpoints are streamed; use "disarm" or "never"'
    )
