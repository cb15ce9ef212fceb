"""ArduPilot Copter. Mode numbers are those of ArduCopter's `Mode::Number`."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.dialects.definition import (
    ACCELERATIONS,
    HELICOPTER,
    MULTIROTORS,
    SPEEDS,
    TIMEOUTS,
    Dialect,
    ModeCommand,
    Wanted,
)
from companion.events import Firmware, FlightMode


def _mode(number: int) -> ModeCommand:
    return ModeCommand(custom_mode=number, param2=float(number), param3=0.0)


DIALECT = Dialect(
    firmware=Firmware.ARDUPILOT,
    title="ArduPilot",
    autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
    vehicle_types=MULTIROTORS | {HELICOPTER},
    vehicles="multirotors and helicopters on ArduPilot Copter",
    modes={4: FlightMode.EXTERNAL, 3: FlightMode.MISSION, 5: FlightMode.STICKS, 17: FlightMode.HOLD},
    commands={
        FlightMode.EXTERNAL: _mode(4),
        FlightMode.MISSION: _mode(3),
        # BRAKE rather than LOITER: without a remote control LOITER reads a low throttle and descends.
        FlightMode.HOLD: _mode(17),
        FlightMode.STICKS: _mode(5),
    },
    names={
        number: entry.name.removeprefix("COPTER_MODE_")
        for number, entry in mavlink.enums["COPTER_MODE"].items()
        if not entry.name.endswith("_ENUM_END")
    },
    # LOITER is flown with the sticks and BRAKE is a pilot's emergency stop. We must not end either.
    take_from=frozenset({FlightMode.EXTERNAL, FlightMode.MISSION}),
    take_from_names="GUIDED or AUTO",
    guard_in_name="AUTO",
    # ArduCopter's Copter::set_mode sends a heartbeat at every change.
    mode_known_s=1.5,
    # Since 4.7 the names are WP_*, in metres. Before, they were WPNAV_*, in centimetres.
    wanted=(
        Wanted("speed_mps", (("WP_SPD", 1.0), ("WPNAV_SPEED", 0.01)), *SPEEDS),
        Wanted("climb_mps", (("WP_SPD_UP", 1.0), ("WPNAV_SPEED_UP", 0.01)), *SPEEDS),
        Wanted("descent_mps", (("WP_SPD_DN", 1.0), ("WPNAV_SPEED_DN", 0.01)), *SPEEDS),
        Wanted("acceleration_mps2", (("WP_ACC", 1.0), ("WPNAV_ACCEL", 0.01)), *ACCELERATIONS),
        Wanted("setpoint_timeout_s", (("GUID_TIMEOUT", 1.0),), *TIMEOUTS),
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
    external_needs_setpoints=False,
    flies_last_setpoint=True,
    home_is_item_zero=True,
    mission_ends_in_hold=False,
    forgets_mission_speed=True,
    # The speed that a mission asks for is flown even above the vehicle's own speed parameter.
    own_speed_limits_missions=False,
)
