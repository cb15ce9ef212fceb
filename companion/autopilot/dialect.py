"""How ArduPilot Copter and PX4 multicopters differ, as data and small functions.

Mode numbers are those of ArduCopter's `Mode::Number` and of PX4's `px4_custom_mode` (main mode in bits 16-23,
sub mode in bits 24-31). A mode counts as entered only when the heartbeat's `custom_mode` says so: PX4
acknowledges modes that it then does not enter.
"""

from __future__ import annotations

from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.config import FlightConfig
from companion.events import Firmware, FlightMode

CUSTOM_MODE_ENABLED = 1
"""MAV_MODE_FLAG_CUSTOM_MODE_ENABLED: `custom_mode` means something; also param 1 of DO_SET_MODE."""
ARMED = 128
"""MAV_MODE_FLAG_SAFETY_ARMED."""
CMD_DO_SET_MODE = 176
CMD_SET_MESSAGE_INTERVAL = 511

VELOCITY_MASK = 0xDC7
"""POSITION_TARGET_TYPEMASK: only the three velocity axes count. ArduPilot drops a vector with any axis
ignored, and without yaw and yaw rate both autopilots steer the nose themselves."""
FRAME_LOCAL_NED = 1
"""MAV_FRAME_LOCAL_NED, the one frame that both fly as velocity north, east, down."""

FIRMWARES = {3: Firmware.ARDUPILOT, 12: Firmware.PX4}
"""MAV_AUTOPILOT of the autopilots that we know."""
AUTOPILOT_INVALID = 8
"""MAV_AUTOPILOT_INVALID: a component that is no autopilot."""

_MULTIROTORS = frozenset({2, 3, 13, 14, 15, 29, 35, 43})
_HELICOPTER = 4
_UNSUPPORTED = {
    1: "fixed-wing aircraft",
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


@dataclass(frozen=True, slots=True)
class ModeCommand:
    """One flight mode as commanded: params 2 and 3 of DO_SET_MODE and the number that confirms it."""

    custom_mode: int
    param2: float
    param3: float


@dataclass(frozen=True, slots=True)
class Dialect:
    """One autopilot's mode numbers."""

    firmware: Firmware
    modes: dict[int, FlightMode]
    commands: dict[FlightMode, ModeCommand]
    names: dict[int, str]

    def mode(self, base_mode: int, custom_mode: int) -> FlightMode:
        """What the companion makes of a heartbeat's mode."""
        if not base_mode & CUSTOM_MODE_ENABLED:
            return FlightMode.OTHER
        return self.modes.get(custom_mode, FlightMode.OTHER)

    def command(self, mode: FlightMode) -> ModeCommand:
        """How to ask for a mode.

        Raises:
            ValueError: OTHER is not a mode that can be asked for.
        """
        if mode not in self.commands:
            raise ValueError(f"{mode} cannot be commanded")
        return self.commands[mode]

    def name(self, custom_mode: int) -> str:
        """The mode's name in the autopilot's own words."""
        return self.names.get(custom_mode, f"mode {custom_mode}")


def _ardupilot(number: int) -> ModeCommand:
    return ModeCommand(custom_mode=number, param2=float(number), param3=0.0)


def _px4_number(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


def _px4(main: int, sub: int = 0) -> ModeCommand:
    return ModeCommand(custom_mode=_px4_number(main, sub), param2=float(main), param3=float(sub))


ARDUPILOT = Dialect(
    firmware=Firmware.ARDUPILOT,
    modes={4: FlightMode.EXTERNAL, 3: FlightMode.MISSION, 5: FlightMode.HOLD, 17: FlightMode.HOLD},
    commands={
        FlightMode.EXTERNAL: _ardupilot(4),
        FlightMode.MISSION: _ardupilot(3),
        # BRAKE, not LOITER: without a remote control LOITER reads a low throttle and descends.
        FlightMode.HOLD: _ardupilot(17),
    },
    names={
        number: entry.name.removeprefix("COPTER_MODE_")
        for number, entry in mavlink.enums["COPTER_MODE"].items()
        if not entry.name.endswith("_ENUM_END")
    },
)

PX4 = Dialect(
    firmware=Firmware.PX4,
    modes={
        _px4_number(6): FlightMode.EXTERNAL,
        _px4_number(4, 4): FlightMode.MISSION,
        _px4_number(4, 3): FlightMode.HOLD,
    },
    commands={
        FlightMode.EXTERNAL: _px4(6),
        FlightMode.MISSION: _px4(4, 4),
        FlightMode.HOLD: _px4(4, 3),
    },
    names={
        _px4_number(1): "MANUAL",
        _px4_number(2): "ALTCTL",
        _px4_number(3): "POSCTL",
        _px4_number(4, 1): "AUTO.READY",
        _px4_number(4, 2): "AUTO.TAKEOFF",
        _px4_number(4, 3): "AUTO.LOITER",
        _px4_number(4, 4): "AUTO.MISSION",
        _px4_number(4, 5): "AUTO.RTL",
        _px4_number(4, 6): "AUTO.LAND",
        _px4_number(4, 8): "AUTO.FOLLOW_TARGET",
        _px4_number(4, 9): "AUTO.PRECLAND",
        _px4_number(5): "ACRO",
        _px4_number(6): "OFFBOARD",
        _px4_number(7): "STABILIZED",
    },
)

DIALECTS = {Firmware.ARDUPILOT: ARDUPILOT, Firmware.PX4: PX4}


def refusal(firmware: Firmware, vehicle_type: int) -> str | None:
    """Why this kind of vehicle (MAV_TYPE) cannot be commanded, in words; None when it can.

    Mode numbers and the answer to velocity setpoints are those of multirotors: ArduPlane's mode 4 is ACRO.
    """
    if vehicle_type in _MULTIROTORS:
        return None
    if vehicle_type == _HELICOPTER and firmware is Firmware.ARDUPILOT:
        return None
    kind = "helicopter" if vehicle_type == _HELICOPTER else _UNSUPPORTED.get(vehicle_type, "vehicle")
    return (
        f"{firmware.value} {kind} (MAV_TYPE {vehicle_type}) is not supported; supported are multirotors and "
        "helicopters on ArduPilot Copter and multirotors on PX4"
    )


def impossible_rearm(firmware: Firmware, flight: FlightConfig) -> str | None:
    """Why a pilot cannot give this autopilot back as `flight.rearm` says, in words; None when he can.

    PX4 lets nobody select OFFBOARD while no setpoints stream, and none do once the pilot has taken over.
    """
    if flight.use != "fly" or flight.rearm != "mode" or firmware is not Firmware.PX4:
        return None
    return (
        'flight.rearm: "mode" gives nothing back on PX4, which refuses OFFBOARD while no setpoints stream: '
        'use "disarm" or "never"'
    )
