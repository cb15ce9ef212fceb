"""How ArduPilot Copter and PX4 multicopters differ, as data and small functions.

The module also holds what they share: both take the same velocity setpoint in the same frame, with one type
mask for a given yaw and one for a held heading.

Mode numbers are those of ArduCopter's `Mode::Number` and of PX4's `px4_custom_mode` (main mode in bits 16-23,
sub mode in bits 24-31). A mode counts as entered only when the heartbeat's `custom_mode` shows it, because
PX4 acknowledges modes that it then does not enter.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.config import FlightConfig
from companion.events import Firmware, FlightMode, Heartbeat

CUSTOM_MODE_ENABLED = 1
"""MAV_MODE_FLAG_CUSTOM_MODE_ENABLED: `custom_mode` is valid. It is also param 1 of DO_SET_MODE."""
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

FIRMWARES = {3: Firmware.ARDUPILOT, 12: Firmware.PX4}
"""MAV_AUTOPILOT values of the supported autopilots."""
AUTOPILOT_INVALID = 8
"""MAV_AUTOPILOT_INVALID: the component is not an autopilot."""

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
    """Command for one flight mode: params 2 and 3 of DO_SET_MODE, and the mode number that confirms it."""

    custom_mode: int
    param2: float
    param3: float


@dataclass(frozen=True, slots=True)
class Wanted:
    """A vehicle parameter that the companion needs."""

    field: str
    """Name of the field in `VehicleParameters`."""
    names: tuple[tuple[str, float], ...]
    """Name of the parameter in each firmware generation, with the factor that converts its unit to SI."""
    lowest: float
    highest: float
    """Plausible range in SI units, from `lowest` to `highest`. A value outside it is rejected."""


@dataclass(frozen=True, slots=True)
class Dialect:
    """One autopilot's mode numbers, parameters, and behaviour when setpoints stop."""

    firmware: Firmware
    modes: dict[int, FlightMode]
    commands: dict[FlightMode, ModeCommand]
    names: dict[int, str]
    mode_known_s: float
    """How long the mode in a heartbeat may be trusted (seconds). ArduPilot announces each change at once, so
    its mode is known until a heartbeat is missing. PX4 reports its mode once a second, so only a heartbeat
    that has just arrived counts. `mode_request.ModeTold` describes what CURRENT_MODE adds."""
    wanted: tuple[Wanted, ...]
    integers_bytewise: bool
    """True: PARAM_VALUE holds an integer's own bytes. False: every value is cast to float."""
    silence: str
    """What the autopilot does when setpoints stop for longer than its timeout, if `loss_action` is not
    known."""
    silence_by_action: dict[int, str]
    """The same for each value of `loss_action`."""
    crashing_actions: frozenset[int]
    """Values of `loss_action` that stop the motors in the air."""
    idle_fence_actions: frozenset[int]
    """Values of `fence_action` with which the vehicle flies through its own fence."""

    def mode(self, base_mode: int, custom_mode: int) -> FlightMode:
        """Convert a heartbeat's mode to a `FlightMode`."""
        if not base_mode & CUSTOM_MODE_ENABLED:
            return FlightMode.OTHER
        return self.modes.get(custom_mode, FlightMode.OTHER)

    def command(self, mode: FlightMode) -> ModeCommand:
        """DO_SET_MODE parameters for a mode.

        Raises:
            ValueError: the mode cannot be commanded (OTHER).
        """
        if mode not in self.commands:
            raise ValueError(f"{mode} cannot be commanded")
        return self.commands[mode]

    def after_silence(self, loss_action: int | None) -> str:
        """What the autopilot does when setpoints stop, in words that follow "it"."""
        if loss_action is None:
            return self.silence
        return self.silence_by_action.get(loss_action, self.silence)

    def name(self, custom_mode: int) -> str:
        """The autopilot's own name for a mode."""
        return self.names.get(custom_mode, f"mode {custom_mode}")


def _ardupilot(number: int) -> ModeCommand:
    return ModeCommand(custom_mode=number, param2=float(number), param3=0.0)


def _px4_number(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


def _px4(main: int, sub: int = 0) -> ModeCommand:
    return ModeCommand(custom_mode=_px4_number(main, sub), param2=float(main), param3=float(sub))


_SPEED = (0.1, 100.0)
_ACCELERATION = (0.1, 100.0)
_TIMEOUT = (0.0, 3600.0)

ARDUPILOT = Dialect(
    firmware=Firmware.ARDUPILOT,
    modes={4: FlightMode.EXTERNAL, 3: FlightMode.MISSION, 5: FlightMode.STICKS, 17: FlightMode.HOLD},
    commands={
        FlightMode.EXTERNAL: _ardupilot(4),
        FlightMode.MISSION: _ardupilot(3),
        # BRAKE rather than LOITER: without a remote control LOITER reads a low throttle and descends.
        FlightMode.HOLD: _ardupilot(17),
        FlightMode.STICKS: _ardupilot(5),
    },
    names={
        number: entry.name.removeprefix("COPTER_MODE_")
        for number, entry in mavlink.enums["COPTER_MODE"].items()
        if not entry.name.endswith("_ENUM_END")
    },
    # ArduCopter's Copter::set_mode sends a heartbeat at every change.
    mode_known_s=1.5,
    # Since 4.7 the names are WP_*, in metres. Before, they were WPNAV_*, in centimetres.
    wanted=(
        Wanted("speed_mps", (("WP_SPD", 1.0), ("WPNAV_SPEED", 0.01)), *_SPEED),
        Wanted("climb_mps", (("WP_SPD_UP", 1.0), ("WPNAV_SPEED_UP", 0.01)), *_SPEED),
        Wanted("descent_mps", (("WP_SPD_DN", 1.0), ("WPNAV_SPEED_DN", 0.01)), *_SPEED),
        Wanted("acceleration_mps2", (("WP_ACC", 1.0), ("WPNAV_ACCEL", 0.01)), *_ACCELERATION),
        Wanted("setpoint_timeout_s", (("GUID_TIMEOUT", 1.0),), *_TIMEOUT),
        Wanted("fence_action", (("FENCE_ENABLE", 1.0),), 0, 1),
        Wanted("mission_restart", (("MIS_RESTART", 1.0),), 0, 1),
        # Before 4.1 the name was ADSB_ENABLE.
        Wanted("adsb_type", (("ADSB_TYPE", 1.0), ("ADSB_ENABLE", 1.0)), 0, 127),
        Wanted("adsb_radius_m", (("ADSB_LIST_RADIUS", 1.0),), 0, 1e6),
    ),
    integers_bytewise=False,
    silence="brakes and stays in GUIDED",
    silence_by_action={},
    crashing_actions=frozenset(),
    idle_fence_actions=frozenset({0}),
)

PX4 = Dialect(
    firmware=Firmware.PX4,
    modes={
        _px4_number(6): FlightMode.EXTERNAL,
        _px4_number(4, 4): FlightMode.MISSION,
        _px4_number(4, 3): FlightMode.HOLD,
        _px4_number(3): FlightMode.STICKS,
    },
    commands={
        FlightMode.EXTERNAL: _px4(6),
        FlightMode.MISSION: _px4(4, 4),
        FlightMode.HOLD: _px4(4, 3),
        FlightMode.STICKS: _px4(3),
    },
    names={
        _px4_number(1): "MANUAL",
        _px4_number(2): "ALTCTL",
        _px4_number(3): "POSCTL",
        _px4_number(3, 1): "POSCTL.ORBIT",
        _px4_number(3, 2): "POSCTL.SLOW",
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
        _px4_number(10): "TERMINATION",
        **{_px4_number(4, 10 + n): f"AUTO.EXTERNAL{n}" for n in range(1, 9)},
    },
    mode_known_s=0.1,
    wanted=(
        Wanted("speed_mps", (("MPC_XY_VEL_MAX", 1.0),), *_SPEED),
        Wanted("cruise_mps", (("MPC_XY_CRUISE", 1.0),), *_SPEED),
        Wanted("climb_mps", (("MPC_Z_VEL_MAX_UP", 1.0),), *_SPEED),
        Wanted("descent_mps", (("MPC_Z_VEL_MAX_DN", 1.0),), *_SPEED),
        Wanted("acceleration_mps2", (("MPC_ACC_HOR", 1.0),), *_ACCELERATION),
        Wanted("setpoint_timeout_s", (("COM_OF_LOSS_T", 1.0),), *_TIMEOUT),
        Wanted("loss_action", (("COM_OBL_RC_ACT", 1.0),), 0, 7),
        Wanted("fence_action", (("GF_ACTION", 1.0),), 0, 5),
    ),
    integers_bytewise=True,
    silence="does what COM_OBL_RC_ACT says",
    silence_by_action={
        0: "goes to Position mode, without a remote control to what NAV_RCL_ACT says",
        1: "goes to Altitude mode, without a remote control to what NAV_RCL_ACT says",
        2: "goes to Stabilized mode, without a remote control to what NAV_RCL_ACT says",
        3: "returns",
        4: "lands",
        5: "holds",
        6: "terminates the flight",
        7: "disarms",
    },
    crashing_actions=frozenset({6, 7}),
    # GF_ACTION 0 is none, 1 is warning.
    idle_fence_actions=frozenset({0, 1}),
)

DIALECTS = {Firmware.ARDUPILOT: ARDUPILOT, Firmware.PX4: PX4}


def refusal(firmware: Firmware, vehicle_type: int) -> str | None:
    """Why this kind of vehicle (MAV_TYPE) cannot be commanded, in words; None when it can.

    The mode numbers and the response to velocity setpoints are those of multirotors. On ArduPlane, for
    example, mode 4 is ACRO.
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

    PX4 refuses OFFBOARD while no setpoints are streamed, and none are once the pilot has taken over.
    """
    if flight.use != "fly" or flight.rearm != "mode" or firmware is not Firmware.PX4:
        return None
    return (
        'flight.rearm: "mode" gives nothing back on PX4, which refuses OFFBOARD while no setpoints stream: '
        'use "disarm" or "never"'
    )
