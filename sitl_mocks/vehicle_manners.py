"""How ArduPilot Copter and PX4 differ, as data: the mock vehicle asks this table and names no firmware.

The values were seen on Copter 4.7 and PX4 1.17 in their own simulations.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, get_type_hints

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.errors import ConfigError
from companion.events import Firmware
from sitl_mocks.vehicle_param_tables import ParamTable, ardupilot_params, px4_params


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


@dataclass(frozen=True, slots=True, eq=False)
class Failsafe:
    """What one trouble leads to."""

    param: str | None
    """Holds the action; None: it cannot be chosen, and is action 0."""
    modes: Mapping[int, VehicleMode]
    """By action. One that is not here does nothing, or is flown by no mode of the mock."""
    text: str | None
    deferred: bool
    """PX4 holds for COM_FAIL_ACT_T first, so that a pilot may choose otherwise."""


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
    speaks: bool
    """Sends STATUSTEXT; PX4 has events in their place."""
    target_always_told: bool
    """POSITION_TARGET_LOCAL_NED in every mode; False: only where it flies setpoints."""
    # modes and arming
    mode_ack_first: bool
    """A mode command is answered by ACK 0 at once, and by the truth a moment later."""
    set_mode_acked: bool
    """The old SET_MODE message gets a COMMAND_ACK."""
    arms_in_external: bool
    arms_in: frozenset[VehicleMode]
    failure_result: int
    """ACK of a refused arming or take-off."""
    land_detect_s: float
    """From touch-down until it says that it has landed."""
    landed_disarm_s: float
    """From touch-down until it disarms, in a mode that lands."""
    disarm_rewinds_mission: bool
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
    slow_takeoff_m: float
    """Up to this height over home; above it climbs with max_climb_mps."""
    # setpoints
    setpoint_frames: frozenset[int]
    body_frames: frozenset[int]
    bad_frame_stops: bool
    """A setpoint in an unknown frame stops the vehicle; False: it is as if it had never come."""
    external_needs_stream: bool
    loss_noticed_s: float
    """How much later than its parameter says it acts on the loss of the stream."""
    loss_mode: VehicleMode | None
    """Where the loss of the stream leads; None: it brakes and stays."""
    altitude_with_horizontal_velocity: bool
    nose_follows_velocity: bool
    # flight
    max_horizontal_speed_mps: float
    max_climb_mps: float
    max_descent_mps: float
    max_vertical_acceleration_mps2: float
    height_acceleration_mps2: float
    """With which it stops at a height."""
    acceleration_mps2: float
    """Of setpoints."""
    auto_acceleration_mps2: float
    auto_brake_mps2: float
    auto_jerk_mps3: float
    velocity_lag_s: float
    vertical_lag_s: float
    velocity_gain: float
    """Velocity reached / asked."""
    slow_share: float
    """Part of a velocity that comes and goes with slow_s."""
    slow_s: float
    brake_fades_mps: float
    """Braking is weaker above this speed, 3 m/s further only ..."""
    brake_faded_mps2: float
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
    marks_current_item: bool
    """Tells in a list which item is being flown."""
    flies_to_takeoff_item: bool
    """A take-off item begun above its height is a point to fly to; False: it is done."""
    speed_change_stays: bool
    """DO_CHANGE_SPEED of a mission holds after the mode was left and entered again."""
    paused_state: int
    """MISSION_STATE of a mission that was left in the middle."""
    one_transfer: bool
    """Serves one list at a time, to one partner, item by item in order; False: answers every request."""
    fence_frames: Mapping[int, int]
    """MAV_FRAME of a fence's items as given -> as told; others are refused."""
    fence_altitudes: bool
    """Keeps the altitudes of a fence's items."""
    fence_union: bool
    """Inside one inclusion area is inside; False: outside one of them is outside."""
    adsb_listed: bool
    """Streams a list of the aircraft heard, one per interval; False: passes each report on once."""
    # troubles
    estimator_message: int
    """EKF_STATUS_REPORT or ESTIMATOR_STATUS."""
    tells_fence: bool
    """Knows FENCE_STATUS."""
    fence_enable_param: str | None
    fence_distance_param: str
    fence_height_param: str
    """Both m; 0 is no limit."""
    fence_failsafe: Failsafe
    gcs_failsafe: Failsafe
    gcs_timeout_param: str
    gcs_by_system: bool
    """The ground station is the system of MAV_GCS_SYSID; False: any component of that type."""
    battery_failsafe: Failsafe
    estimator_failsafe: Failsafe
    estimator_grace_s: float
    gnss_grace_s: float
    """How long the estimator lives without GNSS."""
    estimator_recovers: bool
    """Goes back to the mode that was asked for; False: stays where the failsafe led."""
    global_position_stops: bool
    """Sends no GLOBAL_POSITION_INT without a position."""
    sticks_take_over: bool
    """Moved sticks end an automatic mode (COM_RC_OVERRIDE)."""
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


_M = VehicleMode
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
    speaks=True,
    target_always_told=False,
    mode_ack_first=False,
    set_mode_acked=True,
    arms_in_external=True,
    arms_in=frozenset({VehicleMode.MANUAL, VehicleMode.EXTERNAL, VehicleMode.HOLD}),
    failure_result=mavlink.MAV_RESULT_FAILED,
    land_detect_s=1.6,
    landed_disarm_s=2.1,
    disarm_rewinds_mission=True,
    disarm_after_landing_s=None,
    disarm_preflight_s=None,
    takeoff_in_external=True,
    takeoff_altitude_is_amsl=False,
    takeoff_param=None,
    spin_up_s=3.5,
    takeoff_speed_mps=2.5,
    slow_takeoff_m=math.inf,
    setpoint_frames=frozenset({1, 7, 8, 9}),
    body_frames=frozenset({8, 9}),
    bad_frame_stops=True,
    external_needs_stream=False,
    loss_noticed_s=0.1,
    loss_mode=None,
    altitude_with_horizontal_velocity=False,
    nose_follows_velocity=True,
    max_horizontal_speed_mps=10.0,
    # GUIDED velocities are not capped by the mission's climb rates: 3 m/s was flown up and down.
    max_climb_mps=5.0,
    max_descent_mps=5.0,
    max_vertical_acceleration_mps2=1.0,
    height_acceleration_mps2=0.7,
    acceleration_mps2=2.5,
    auto_acceleration_mps2=1.6,
    auto_brake_mps2=2.7,
    auto_jerk_mps3=0.45,
    velocity_lag_s=0.3,
    vertical_lag_s=0.3,
    velocity_gain=1.0,
    slow_share=0.0,
    slow_s=1.0,
    brake_fades_mps=5.0,
    brake_faded_mps2=1.4,
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
    marks_current_item=False,
    flies_to_takeoff_item=False,
    # Read in the source: entering AUTO forgets the speed of the mission.
    speed_change_stays=False,
    paused_state=mavlink.MISSION_STATE_NOT_STARTED,
    one_transfer=False,
    fence_frames=MappingProxyType(dict.fromkeys((0, 3, 5, 6, 10, 11), 0)),
    fence_altitudes=False,
    fence_union=False,
    adsb_listed=True,
    estimator_message=mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
    tells_fence=True,
    fence_enable_param="FENCE_ENABLE",
    fence_distance_param="FENCE_RADIUS",
    fence_height_param="FENCE_ALT_MAX",
    # SmartRTL (3, 5) is flown as its second choice.
    fence_failsafe=Failsafe(
        "FENCE_ACTION",
        MappingProxyType({1: _M.RTL, 2: _M.LAND, 3: _M.RTL, 4: _M.BRAKE, 5: _M.LAND}),
        None,
        deferred=False,
    ),
    gcs_failsafe=Failsafe(
        "FS_GCS_ENABLE",
        MappingProxyType({1: _M.RTL, 2: _M.RTL, 3: _M.RTL, 4: _M.LAND, 5: _M.LAND, 6: _M.RTL, 7: _M.BRAKE}),
        "GCS Failsafe",
        deferred=False,
    ),
    gcs_timeout_param="FS_GCS_TIMEOUT",
    gcs_by_system=True,
    battery_failsafe=Failsafe(
        "BATT_FS_LOW_ACT",
        MappingProxyType({1: _M.LAND, 2: _M.RTL, 3: _M.RTL, 4: _M.LAND, 6: _M.RTL, 7: _M.BRAKE}),
        "Battery Failsafe",
        deferred=False,
    ),
    estimator_failsafe=Failsafe(
        "FS_EKF_ACTION",
        MappingProxyType({1: _M.LAND, 3: _M.LAND}),
        "EKF Failsafe: changed to LAND Mode",
        deferred=False,
    ),
    estimator_grace_s=1.0,
    gnss_grace_s=7.0,
    estimator_recovers=False,
    global_position_stops=False,
    sticks_take_over=False,
    param_bytewise=False,
    params=ardupilot_params(),
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
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 2.0,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 0.1,
            mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1.0,
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
    speaks=False,
    target_always_told=True,
    mode_ack_first=True,
    set_mode_acked=False,
    arms_in_external=False,
    arms_in=frozenset({VehicleMode.MANUAL, VehicleMode.HOLD, VehicleMode.MISSION, VehicleMode.TAKEOFF}),
    failure_result=mavlink.MAV_RESULT_TEMPORARILY_REJECTED,
    land_detect_s=2.0,
    landed_disarm_s=4.0,
    disarm_rewinds_mission=False,
    disarm_after_landing_s=4.0,
    disarm_preflight_s=10.0,
    takeoff_in_external=False,
    takeoff_altitude_is_amsl=True,
    takeoff_param="MIS_TAKEOFF_ALT",
    spin_up_s=4.5,
    takeoff_speed_mps=1.65,
    slow_takeoff_m=10.0,
    setpoint_frames=frozenset({1, 8}),
    body_frames=frozenset({8}),
    bad_frame_stops=False,
    external_needs_stream=True,
    # A stream exactly as slow as the timeout counts as lost: that is the honest edge for 1 Hz.
    loss_noticed_s=0.0,
    loss_mode=VehicleMode.RTL,
    altitude_with_horizontal_velocity=True,
    nose_follows_velocity=False,
    max_horizontal_speed_mps=12.0,
    max_climb_mps=3.0,
    max_descent_mps=1.5,
    max_vertical_acceleration_mps2=12.0,
    height_acceleration_mps2=4.0,
    acceleration_mps2=20.0,
    auto_acceleration_mps2=3.0,
    auto_brake_mps2=3.0,
    auto_jerk_mps3=4.0,
    velocity_lag_s=0.62,
    vertical_lag_s=0.25,
    velocity_gain=0.87,
    slow_share=0.185,
    slow_s=5.7,
    brake_fades_mps=math.inf,
    brake_faded_mps2=0.0,
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
    marks_current_item=True,
    flies_to_takeoff_item=True,
    speed_change_stays=True,
    paused_state=mavlink.MISSION_STATE_PAUSED,
    one_transfer=True,
    fence_frames=MappingProxyType({0: 5, 3: 6, 5: 5, 6: 6}),
    fence_altitudes=True,
    fence_union=True,
    adsb_listed=False,
    estimator_message=mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS,
    tells_fence=False,
    fence_enable_param=None,
    fence_distance_param="GF_MAX_HOR_DIST",
    fence_height_param="GF_MAX_VER_DIST",
    fence_failsafe=Failsafe(
        "GF_ACTION", MappingProxyType({2: _M.HOLD, 3: _M.RTL, 5: _M.LAND}), None, deferred=False
    ),
    gcs_failsafe=Failsafe(
        "NAV_DLL_ACT", MappingProxyType({1: _M.HOLD, 2: _M.RTL, 3: _M.LAND}), None, deferred=True
    ),
    gcs_timeout_param="COM_DL_LOSS_T",
    gcs_by_system=False,
    battery_failsafe=Failsafe(
        "COM_LOW_BAT_ACT", MappingProxyType({1: _M.RTL, 2: _M.LAND, 3: _M.RTL}), None, deferred=True
    ),
    # AUTO.LAND is also how its descent without a position shows.
    estimator_failsafe=Failsafe(None, MappingProxyType({0: _M.LAND}), None, deferred=False),
    estimator_grace_s=0.2,
    gnss_grace_s=5.0,
    estimator_recovers=True,
    global_position_stops=True,
    sticks_take_over=True,
    param_bytewise=True,
    params=px4_params(),
    timeout_param="COM_OF_LOSS_T",
    cruise_param="MPC_XY_CRUISE",
    cruise_param_scale=1.0,
)

MANNERS: Mapping[Firmware, Manners] = MappingProxyType({Firmware.ARDUPILOT: ARDUPILOT, Firmware.PX4: PX4})


def with_quirks(manners: Manners, quirks: Mapping[str, object]) -> Manners:
    """A firmware's manners with some of them changed, by the name of the field.

    Raises:
        ConfigError: an unknown name, or a value that is not of the field's kind; tables cannot be given.
    """
    kinds = get_type_hints(Manners)
    given: dict[str, Any] = {}
    for name, value in quirks.items():
        kind = kinds.get(name)
        if kind is None:
            raise ConfigError(
                f"quirk {name}: there is none of that name; allowed: {', '.join(sorted(kinds))}"
            )
        if kind in (VehicleMode, VehicleMode | None) and isinstance(value, str):
            names = {mode.value: mode for mode in manners.custom_modes}
            if value not in names:
                raise ConfigError(f"quirk {name}: {value!r} is no mode; allowed: {', '.join(names)}")
            value = names[value]
        number = kind in (float, float | None) and isinstance(value, int) and not isinstance(value, bool)
        plain = kind in (bool, int, float, str, float | None, str | None, VehicleMode, VehicleMode | None)
        fits = plain and (number or isinstance(value, kind)) and not (kind is int and isinstance(value, bool))
        if not fits:
            raise ConfigError(
                f"quirk {name}: {value!r} is not of its kind ({getattr(kind, '__name__', kind)})"
            )
        given[name] = value
    return replace(manners, **given)
