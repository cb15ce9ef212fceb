"""PX4 multicopters. Mode numbers are those of PX4's `px4_custom_mode`: main mode in bits 16-23, sub mode in
bits 24-31."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.dialects.definition import (
    ACCELERATIONS,
    MULTIROTORS,
    SPEEDS,
    TIMEOUTS,
    Dialect,
    ModeCommand,
    Wanted,
)
from companion.events import Firmware, FlightMode


def _number(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


def _mode(main: int, sub: int = 0) -> ModeCommand:
    return ModeCommand(custom_mode=_number(main, sub), param2=float(main), param3=float(sub))


DIALECT = Dialect(
    firmware=Firmware.PX4,
    title="PX4",
    autopilot=mavlink.MAV_AUTOPILOT_PX4,
    vehicle_types=MULTIROTORS,
    vehicles="multirotors on PX4",
    modes={
        _number(6): FlightMode.EXTERNAL,
        _number(4, 4): FlightMode.MISSION,
        _number(4, 3): FlightMode.HOLD,
        _number(3): FlightMode.STICKS,
    },
    commands={
        FlightMode.EXTERNAL: _mode(6),
        FlightMode.MISSION: _mode(4, 4),
        FlightMode.HOLD: _mode(4, 3),
        FlightMode.STICKS: _mode(3),
    },
    names={
        _number(1): "MANUAL",
        _number(2): "ALTCTL",
        _number(3): "POSCTL",
        _number(3, 1): "POSCTL.ORBIT",
        _number(3, 2): "POSCTL.SLOW",
        _number(4, 1): "AUTO.READY",
        _number(4, 2): "AUTO.TAKEOFF",
        _number(4, 3): "AUTO.LOITER",
        _number(4, 4): "AUTO.MISSION",
        _number(4, 5): "AUTO.RTL",
        _number(4, 6): "AUTO.LAND",
        _number(4, 8): "AUTO.FOLLOW_TARGET",
        _number(4, 9): "AUTO.PRECLAND",
        _number(5): "ACRO",
        _number(6): "OFFBOARD",
        _number(7): "STABILIZED",
        _number(10): "TERMINATION",
        **{_number(4, 10 + n): f"AUTO.EXTERNAL{n}" for n in range(1, 9)},
    },
    take_from=frozenset({FlightMode.EXTERNAL, FlightMode.MISSION, FlightMode.HOLD}),
    take_from_names="HOLD or MISSION",
    guard_in_name="MISSION",
    mode_known_s=0.1,
    wanted=(
        Wanted("speed_mps", (("MPC_XY_VEL_MAX", 1.0),), *SPEEDS),
        Wanted("cruise_mps", (("MPC_XY_CRUISE", 1.0),), *SPEEDS),
        Wanted("climb_mps", (("MPC_Z_VEL_MAX_UP", 1.0),), *SPEEDS),
        Wanted("descent_mps", (("MPC_Z_VEL_MAX_DN", 1.0),), *SPEEDS),
        Wanted("acceleration_mps2", (("MPC_ACC_HOR", 1.0),), *ACCELERATIONS),
        Wanted("setpoint_timeout_s", (("COM_OF_LOSS_T", 1.0),), *TIMEOUTS),
        Wanted("loss_action", (("COM_OBL_RC_ACT", 1.0),), 0, 7),
        Wanted("fence_action", (("GF_ACTION", 1.0),), 0, 5),
        Wanted("traffic_action", (("NAV_TRAFF_AVOID", 1.0),), 0, 4),
    ),
    integers_bytewise=True,
    silence="follows COM_OBL_RC_ACT",
    silence_by_action={
        0: "switches to Position mode, or without a remote control follows NAV_RCL_ACT",
        1: "switches to Altitude mode, or without a remote control follows NAV_RCL_ACT",
        2: "switches to Stabilized mode, or without a remote control follows NAV_RCL_ACT",
        3: "returns",
        4: "lands",
        5: "holds",
        6: "terminates the flight",
        7: "disarms",
    },
    crashing_actions=frozenset({6, 7}),
    # GF_ACTION 0 is none, 1 is warning.
    idle_fence_actions=frozenset({0, 1}),
    external_needs_setpoints=True,
    # The end of the setpoints is noticed at once.
    flies_last_setpoint=False,
    home_is_item_zero=False,
    mission_ends_in_hold=True,
    forgets_mission_speed=False,
    own_speed_limits_missions=True,
)
