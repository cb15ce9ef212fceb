"""How ArduPilot Copter and PX4 differ, as data: the mock vehicle asks this table and names no firmware.

The values were seen on Copter 4.7 and PX4 1.17 in their own simulations.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.events import Firmware

ParamTable = Mapping[str, tuple[float, int]]
"""Name -> (value, MAV_PARAM_TYPE)."""

INT32 = int(mavlink.MAV_PARAM_TYPE_INT32)
INT16 = int(mavlink.MAV_PARAM_TYPE_INT16)
INT8 = int(mavlink.MAV_PARAM_TYPE_INT8)
REAL32 = int(mavlink.MAV_PARAM_TYPE_REAL32)


class VehicleMode(enum.Enum):
    """What the mock can fly; each firmware has its own number for it."""

    MANUAL = "manual"
    """A pilot's mode: ArduPilot STABILIZE, PX4 POSCTL. The mock's pilot keeps the sticks centred."""
    EXTERNAL = "external"
    """ArduPilot GUIDED, PX4 OFFBOARD."""
    MISSION = "mission"
    HOLD = "hold"
    """ArduPilot LOITER, PX4 AUTO.LOITER."""
    BRAKE = "brake"
    """ArduPilot only."""
    TAKEOFF = "takeoff"
    """PX4 only: ArduPilot takes off inside GUIDED."""
    RTL = "rtl"
    LAND = "land"


@dataclass(frozen=True, slots=True, kw_only=True)
class Manners:
    """One firmware's ways. Speeds in m/s, accelerations in m/s^2, times in s."""

    firmware: Firmware
    autopilot_id: int
    """MAV_AUTOPILOT."""
    custom_modes: Mapping[VehicleMode, int]
    base_modes: Mapping[VehicleMode, int]
    """base_mode without the armed bit."""
    vtol_state: int
    gps_fix_type: int
    boot_mode: VehicleMode
    # telemetry
    fresh_streams: Mapping[int, float]
    """Message id -> interval of a link nobody has asked anything of."""
    data_streams: bool
    """Answers REQUEST_DATA_STREAM."""
    forwards: bool
    """Passes frames on from one link to the others."""
    has_did_params: bool
    """Can be told to relay Remote ID data (ArduPilot's DID_*)."""
    heartbeat_on_mode_change: bool
    refuses_interval_param3: bool
    unsupported_interval_result: int
    unsupported_request_result: int
    no_such_message_text: bool
    # modes and arming
    mode_ack_first: bool
    """A mode command is answered by ACK 0 at once, and by the truth a moment later."""
    set_mode_acked: bool
    """The old SET_MODE message gets a COMMAND_ACK."""
    arms_in_external: bool
    arms_in: frozenset[VehicleMode]
    failure_result: int
    """ACK of a refused arming or take-off."""
    disarm_after_landing_s: float | None
    """Disarms by itself after a touch-down in a mode that does not land; None: stays armed."""
    disarm_preflight_s: float | None
    # take-off
    takeoff_in_external: bool
    takeoff_altitude_is_amsl: bool
    takeoff_param: str | None
    """Holds the height (m) of a take-off whose command names none; None: such a command is refused."""
    spin_up_s: float
    takeoff_speed_mps: float
    # setpoints
    setpoint_frames: frozenset[int]
    body_frames: frozenset[int]
    bad_frame_stops: bool
    """A setpoint in an unknown frame stops the vehicle; False: it is as if it had never come."""
    external_needs_stream: bool
    setpoint_timeout_s: float
    loss_mode: VehicleMode | None
    """Where the loss of the stream leads; None: it brakes and stays."""
    altitude_with_horizontal_velocity: bool
    nose_follows_velocity: bool
    # flight
    max_horizontal_speed_mps: float
    max_climb_mps: float
    max_descent_mps: float
    max_vertical_acceleration_mps2: float
    mission_speed_mps: float
    acceptance_radius_m: float
    rtl_height_m: float
    land_speed_mps: float
    # mission
    mission_request_int: bool
    home_is_item_zero: bool
    mission_end_mode: VehicleMode | None
    upload_timeout_s: float
    upload_retry_s: float
    mission_texts: bool
    one_transfer: bool
    """Serves one list at a time, to one partner, item by item in order; False: answers every request."""
    fence_frames: Mapping[int, int]
    """MAV_FRAME of a fence's items as given -> as told; others are refused."""
    fence_altitudes: bool
    """Keeps the altitudes of a fence's items."""
    adsb_listed: bool
    """Streams a list of the aircraft heard, one per interval; False: passes each report on once."""
    # parameters
    param_bytewise: bool
    params: ParamTable
    legacy_names: Mapping[str, str] = field(default_factory=dict)
    """Today's name -> the name before the last renaming."""
    timeout_param: str
    cruise_param: str
    cruise_param_scale: float
    """SI value = parameter value times this."""

    def mode_of(self, custom_mode: int) -> VehicleMode | None:
        """The mode of this number, None where the mock does not fly it."""
        return next((mode for mode, number in self.custom_modes.items() if number == custom_mode), None)


def _px4_mode(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


def _ardupilot_params() -> ParamTable:
    return MappingProxyType(
        {
            "MAV_SYSID": (1.0, INT16),
            "MAV_GCS_SYSID": (255.0, INT16),
            "MAV1_POSITION": (0.0, INT16),
            "MAV1_EXTRA1": (0.0, INT16),
            "GUID_TIMEOUT": (3.0, REAL32),
            "GUID_OPTIONS": (0.0, INT32),
            "WPNAV_SPEED": (1000.0, REAL32),
            "WPNAV_SPEED_UP": (250.0, REAL32),
            "WPNAV_SPEED_DN": (150.0, REAL32),
            "WPNAV_ACCEL": (250.0, REAL32),
            "WPNAV_RADIUS": (200.0, REAL32),
            "RTL_ALT": (1500.0, INT32),
            "LAND_SPEED": (50.0, INT16),
            "DISARM_DELAY": (10.0, INT8),
            "FRAME_CLASS": (1.0, INT8),
            "FENCE_ENABLE": (0.0, INT8),
            "SERIAL0_PROTOCOL": (2.0, INT8),
            "STAT_RUNTIME": (152.0, INT32),
        }
    )


def _px4_params() -> ParamTable:
    return MappingProxyType(
        {
            "MAV_SYS_ID": (1.0, INT32),
            "MAV_COMP_ID": (1.0, INT32),
            "COM_OF_LOSS_T": (1.0, REAL32),
            "COM_OBL_RC_ACT": (0.0, INT32),
            "COM_RC_IN_MODE": (4.0, INT32),
            "COM_DISARM_LAND": (2.0, REAL32),
            "MPC_XY_CRUISE": (5.0, REAL32),
            "MPC_XY_VEL_MAX": (12.0, REAL32),
            "MPC_ACC_HOR": (3.0, REAL32),
            "MPC_Z_VEL_MAX_UP": (3.0, REAL32),
            "MPC_Z_VEL_MAX_DN": (1.5, REAL32),
            "GF_ACTION": (2.0, INT32),
            "MIS_TAKEOFF_ALT": (2.5, REAL32),
            "NAV_ACC_RAD": (10.0, REAL32),
            "RTL_RETURN_ALT": (60.0, REAL32),
            "SYS_AUTOSTART": (10040.0, INT32),
            "CAL_ACC0_ID": (1310988.0, INT32),
        }
    )


_AUTO_ARDUPILOT = 1 | 8 | 16 | 64
_MANUAL_ARDUPILOT = 1 | 16 | 64
_AUTO_PX4 = 1 | 4 | 8 | 16

ARDUPILOT = Manners(
    firmware=Firmware.ARDUPILOT,
    autopilot_id=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
    custom_modes=MappingProxyType(
        {
            VehicleMode.MANUAL: 0,
            VehicleMode.MISSION: 3,
            VehicleMode.EXTERNAL: 4,
            VehicleMode.HOLD: 5,
            VehicleMode.RTL: 6,
            VehicleMode.LAND: 9,
            VehicleMode.BRAKE: 17,
        }
    ),
    base_modes=MappingProxyType(
        {
            VehicleMode.MANUAL: _MANUAL_ARDUPILOT,
            VehicleMode.MISSION: _AUTO_ARDUPILOT,
            VehicleMode.EXTERNAL: _AUTO_ARDUPILOT,
            VehicleMode.HOLD: _AUTO_ARDUPILOT,
            VehicleMode.RTL: _AUTO_ARDUPILOT,
            VehicleMode.LAND: _AUTO_ARDUPILOT,
            VehicleMode.BRAKE: _AUTO_ARDUPILOT,
        }
    ),
    vtol_state=mavlink.MAV_VTOL_STATE_MC,
    gps_fix_type=mavlink.GPS_FIX_TYPE_RTK_FIXED,
    boot_mode=VehicleMode.MANUAL,
    fresh_streams=MappingProxyType(
        {mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0, mavlink.MAVLINK_MSG_ID_TIMESYNC: 10.0}
    ),
    data_streams=True,
    forwards=True,
    has_did_params=True,
    heartbeat_on_mode_change=True,
    refuses_interval_param3=True,
    unsupported_interval_result=mavlink.MAV_RESULT_DENIED,
    unsupported_request_result=mavlink.MAV_RESULT_FAILED,
    no_such_message_text=True,
    mode_ack_first=False,
    set_mode_acked=True,
    arms_in_external=True,
    arms_in=frozenset({VehicleMode.MANUAL, VehicleMode.EXTERNAL, VehicleMode.HOLD}),
    failure_result=mavlink.MAV_RESULT_FAILED,
    disarm_after_landing_s=None,
    disarm_preflight_s=None,
    takeoff_in_external=True,
    takeoff_altitude_is_amsl=False,
    takeoff_param=None,
    spin_up_s=4.0,
    takeoff_speed_mps=2.5,
    setpoint_frames=frozenset({1, 7, 8, 9}),
    body_frames=frozenset({8, 9}),
    bad_frame_stops=True,
    external_needs_stream=False,
    setpoint_timeout_s=3.0,
    loss_mode=None,
    altitude_with_horizontal_velocity=False,
    nose_follows_velocity=True,
    max_horizontal_speed_mps=10.0,
    # GUIDED velocities are not capped by the mission's climb rates: 3 m/s was flown up and down.
    max_climb_mps=5.0,
    max_descent_mps=5.0,
    max_vertical_acceleration_mps2=1.0,
    mission_speed_mps=10.0,
    acceptance_radius_m=2.0,
    rtl_height_m=15.0,
    land_speed_mps=0.5,
    mission_request_int=False,
    home_is_item_zero=True,
    mission_end_mode=None,
    upload_timeout_s=8.0,
    upload_retry_s=1.0,
    mission_texts=True,
    one_transfer=False,
    fence_frames=MappingProxyType(dict.fromkeys((0, 3, 5, 6, 10, 11), 0)),
    fence_altitudes=False,
    adsb_listed=True,
    param_bytewise=False,
    params=_ardupilot_params(),
    legacy_names=MappingProxyType(
        {
            "MAV_SYSID": "SYSID_THISMAV",
            "MAV_GCS_SYSID": "SYSID_MYGCS",
            "MAV1_POSITION": "SR0_POSITION",
            "MAV1_EXTRA1": "SR0_EXTRA1",
        }
    ),
    timeout_param="GUID_TIMEOUT",
    cruise_param="WPNAV_SPEED",
    cruise_param_scale=0.01,
)

PX4 = Manners(
    firmware=Firmware.PX4,
    autopilot_id=mavlink.MAV_AUTOPILOT_PX4,
    custom_modes=MappingProxyType(
        {
            VehicleMode.MANUAL: _px4_mode(3),
            VehicleMode.EXTERNAL: _px4_mode(6),
            VehicleMode.TAKEOFF: _px4_mode(4, 2),
            VehicleMode.HOLD: _px4_mode(4, 3),
            VehicleMode.MISSION: _px4_mode(4, 4),
            VehicleMode.RTL: _px4_mode(4, 5),
            VehicleMode.LAND: _px4_mode(4, 6),
        }
    ),
    base_modes=MappingProxyType(
        {
            VehicleMode.MANUAL: 1 | 16 | 64,
            VehicleMode.EXTERNAL: 1 | 16,
            VehicleMode.TAKEOFF: _AUTO_PX4,
            VehicleMode.HOLD: _AUTO_PX4,
            VehicleMode.MISSION: _AUTO_PX4,
            VehicleMode.RTL: _AUTO_PX4,
            VehicleMode.LAND: _AUTO_PX4,
        }
    ),
    vtol_state=mavlink.MAV_VTOL_STATE_UNDEFINED,
    gps_fix_type=mavlink.GPS_FIX_TYPE_3D_FIX,
    boot_mode=VehicleMode.HOLD,
    fresh_streams=MappingProxyType(
        {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: 0.1,
            # 99 Hz on the real one; the mock sends a message at most once per step.
            mavlink.MAVLINK_MSG_ID_ATTITUDE: 0.02,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 0.02,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 1 / 30,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 0.125,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
            mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: 2.0,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: 0.5,
            # As fast as they come on the real one; the mock's receiver reports once a second.
            mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE: 1.0,
            mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION: 1.0,
            mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_SYSTEM: 1.0,
        }
    ),
    data_streams=False,
    forwards=False,
    has_did_params=False,
    heartbeat_on_mode_change=False,
    refuses_interval_param3=False,
    unsupported_interval_result=mavlink.MAV_RESULT_FAILED,
    unsupported_request_result=mavlink.MAV_RESULT_DENIED,
    no_such_message_text=False,
    mode_ack_first=True,
    set_mode_acked=False,
    arms_in_external=False,
    arms_in=frozenset({VehicleMode.MANUAL, VehicleMode.HOLD, VehicleMode.MISSION, VehicleMode.TAKEOFF}),
    failure_result=mavlink.MAV_RESULT_TEMPORARILY_REJECTED,
    disarm_after_landing_s=4.0,
    disarm_preflight_s=10.0,
    takeoff_in_external=False,
    takeoff_altitude_is_amsl=True,
    takeoff_param="MIS_TAKEOFF_ALT",
    spin_up_s=4.5,
    takeoff_speed_mps=2.3,
    setpoint_frames=frozenset({1, 8}),
    body_frames=frozenset({8}),
    bad_frame_stops=False,
    external_needs_stream=True,
    setpoint_timeout_s=1.0,
    loss_mode=VehicleMode.RTL,
    altitude_with_horizontal_velocity=True,
    nose_follows_velocity=False,
    max_horizontal_speed_mps=12.0,
    max_climb_mps=3.0,
    max_descent_mps=1.5,
    max_vertical_acceleration_mps2=4.0,
    mission_speed_mps=5.0,
    acceptance_radius_m=10.0,
    rtl_height_m=30.0,
    land_speed_mps=0.7,
    mission_request_int=True,
    home_is_item_zero=False,
    mission_end_mode=VehicleMode.HOLD,
    upload_timeout_s=5.0,
    upload_retry_s=0.25,
    mission_texts=False,
    one_transfer=True,
    fence_frames=MappingProxyType({0: 5, 3: 6, 5: 5, 6: 6}),
    fence_altitudes=True,
    adsb_listed=False,
    param_bytewise=True,
    params=_px4_params(),
    timeout_param="COM_OF_LOSS_T",
    cruise_param="MPC_XY_CRUISE",
    cruise_param_scale=1.0,
)

MANNERS: Mapping[Firmware, Manners] = MappingProxyType({Firmware.ARDUPILOT: ARDUPILOT, Firmware.PX4: PX4})
