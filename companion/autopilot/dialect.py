"""The dialects of all firmwares, and what the firmwares share.

A dialect is what one firmware does in its own way: `companion.autopilot.dialects` has one file for each. All
of them take the same velocity setpoint in the same frame, with one type mask for a given yaw and one for a
held heading. A mode counts as entered only when the heartbeat's `custom_mode` shows it, because PX4
acknowledges modes that it then does not enter.
"""

from __future__ import annotations

import dataclasses
import importlib

import msgspec

from companion import plugins
from companion.autopilot.dialects.definition import CUSTOM_MODE_ENABLED, HELICOPTER, Dialect
from companion.config import FlightConfig
from companion.errors import ConfigError
from companion.events import Firmware, FlightMode, Heartbeat, VehicleParameters

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
_OWN = dict(DIALECTS)
"""Built-in dialects, which `use` restores when no plug-in replaces them."""
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


def use(plugin: str | None) -> None:
    """Replace the dialect of a firmware by that of a plug-in, which names the firmware, in this process.

    A vehicle with the original firmware is then no longer recognised, because its modes would be misread.
    Every link and every core calls this with its configuration.

    Args:
        plugin: name of the plug-in; None for the dialects of this project.

    Raises:
        ConfigError: the plug-in cannot be loaded, or its dialect is invalid (`check_dialect`).
    """
    wanted = dict(_OWN)
    if plugin is not None:
        try:
            dialect = plugins.load(plugins.FIRMWARES, plugin).loaded
            check_dialect(dialect)
        except ConfigError as error:
            raise ConfigError(f"vehicle.dialect: {error}") from error
        wanted[dialect.firmware] = dialect
    if wanted != DIALECTS:
        DIALECTS.update(wanted)
        FIRMWARES.clear()
        FIRMWARES.update({dialect.autopilot: firmware for firmware, dialect in DIALECTS.items()})


def check_dialect(dialect: object) -> None:
    """Check that a dialect is complete and consistent.

    Raises:
        ConfigError: it is no `Dialect`, a value has a wrong type, a commanded mode would not be read back as
            itself, a mode that the companion needs is missing, a wanted parameter is unknown, or another
            firmware has its MAV_AUTOPILOT.
    """
    if not isinstance(dialect, Dialect):
        raise ConfigError(f"{dialect!r:.80} is not a companion.autopilot.dialects.definition.Dialect")
    _check_types(dialect)
    for mode in (FlightMode.EXTERNAL, FlightMode.MISSION, FlightMode.HOLD):
        command = dialect.commands.get(mode)
        if command is None or dialect.modes.get(command.custom_mode) is not mode:
            raise ConfigError(
                f"{dialect.title}: mode {mode.value} is not commanded, or not read back as itself"
            )
    known = {field.name for field in msgspec.structs.fields(VehicleParameters)}
    if unknown := [wanted.field for wanted in dialect.wanted if wanted.field not in known]:
        raise ConfigError(
            f"{dialect.title}: wanted parameter {unknown[0]!r} is no field of VehicleParameters"
        )
    for firmware, other in _OWN.items():
        if firmware is not dialect.firmware and other.autopilot == dialect.autopilot:
            raise ConfigError(f"{dialect.title}: MAV_AUTOPILOT {dialect.autopilot} is that of {other.title}")


def _check_types(dialect: Dialect) -> None:
    """Check the types of all values. With the text of a mode in place of the mode, for example, no vehicle
    would ever be taken."""
    try:
        typed = msgspec.convert(msgspec.to_builtins(dialect), Dialect)
    except (msgspec.ValidationError, TypeError) as error:
        raise ConfigError(f"{dialect.title}: {error}") from error
    for field in dataclasses.fields(Dialect):
        # A mode and its text convert to the same mode, but are not equal; NaN is not even equal to itself.
        if getattr(typed, field.name) != getattr(dialect, field.name):
            raise ConfigError(f"{dialect.title}: {field.name}: a value has a wrong type, or is not a number")


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
    """Copy of a vehicle's last heartbeat with the mode that a later CURRENT_MODE reported.

    Only the next heartbeat tells whether a failsafe has caused a change.
    """
    mode = flight_mode(beat.firmware, beat.vehicle_type, CUSTOM_MODE_ENABLED, custom_mode)
    failsafe = beat.failsafe or custom_mode != beat.custom_mode
    return msgspec.structs.replace(beat, custom_mode=custom_mode, mode=mode, failsafe=failsafe)


def impossible_rearm(firmware: Firmware, flight: FlightConfig) -> str | None:
    """Why a pilot cannot give control back to the companion as `flight.rearm` says, in words; None when
    possible.

    A firmware may refuse the mode that flies setpoints while no setpoints are streamed. The companion streams
    none once the pilot has taken over.
    """
    dialect = DIALECTS[firmware]
    if flight.use != "fly" or flight.rearm != "mode" or not dialect.external_needs_setpoints:
        return None
    mode = dialect.name(dialect.command(FlightMode.EXTERNAL).custom_mode)
    return (
        f'flight.rearm: "mode" cannot restore authority on {dialect.title}, which refuses {mode} '
        'while no setpoints are streamed; use "disarm" or "never"'
    )
