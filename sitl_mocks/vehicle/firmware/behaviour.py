"""Differences between ArduPilot Copter and PX4 as data, so that the mock vehicle's code names no firmware.

The values were observed on Copter 4.7 and PX4 1.17 in their own simulations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import CURRENT_MODE
from companion.events import Firmware
from sitl_mocks.vehicle.firmware.kinds import Failsafe, Manners, VehicleMode, with_quirks
from sitl_mocks.vehicle.firmware.param_tables import ardupilot_params, px4_params

__all__ = ["ARDUPILOT", "MANNERS", "PX4", "Failsafe", "Manners", "VehicleMode", "with_quirks"]


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
    tells_current_mode=False,
    standard_modes=MappingProxyType({}),
    refuses_interval_param3=True,
    unsupported_interval_result=mavlink.MAV_RESULT_DENIED,
    unsupported_request_result=mavlink.MAV_RESULT_FAILED,
    no_such_message_text=True,
    speaks=True,
    target_always_told=False,
    mode_ack_first=False,
    set_mode_acked=True,
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
    loss_actions=MappingProxyType({}),
    stream_takes_back=True,
    cancels_takeoff=True,
    needs_whole_velocity=True,
    altitude_with_horizontal_velocity=False,
    nose_follows_velocity=True,
    max_horizontal_speed_mps=10.0,
    # The mission's climb rates do not limit velocities in GUIDED: 3 m/s was flown up and down.
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
    # According to the source, entering AUTO resets the mission's speed.
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
    # The mock flies the fallbacks of the SmartRTL actions (3, 5).
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
            # The real PX4 sends 99 Hz; the mock sends a message at most once per step.
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
            # The real PX4 sends each report as it arrives; the mock's receiver reports once a second.
            mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE: 1.0,
            mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION: 1.0,
            mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_SYSTEM: 1.0,
            CURRENT_MODE: 2.0,
        }
    ),
    data_streams=False,
    forwards=False,
    has_did_params=False,
    heartbeat_on_mode_change=False,
    tells_current_mode=True,
    standard_modes=MappingProxyType({_M.MANUAL: 1, _M.RTL: 5, _M.MISSION: 6, _M.LAND: 7, _M.TAKEOFF: 8}),
    refuses_interval_param3=False,
    unsupported_interval_result=mavlink.MAV_RESULT_FAILED,
    unsupported_request_result=mavlink.MAV_RESULT_DENIED,
    no_such_message_text=False,
    speaks=False,
    target_always_told=True,
    mode_ack_first=True,
    set_mode_acked=False,
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
    # No tolerance: a stream whose period equals the timeout (1 Hz) counts as lost.
    loss_noticed_s=0.0,
    loss_mode=VehicleMode.RTL,
    loss_actions=MappingProxyType({0: _M.MANUAL, 3: _M.RTL, 4: _M.LAND, 5: _M.HOLD}),
    stream_takes_back=True,
    cancels_takeoff=True,
    needs_whole_velocity=True,
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
    # PX4 reports its descent without a position as AUTO.LAND, too.
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

MANNERS: Mapping[Firmware, Manners] = MappingProxyType(
    {manners.firmware: manners for manners in (ARDUPILOT, PX4)}
)
