"""Parameters of the mock vehicle, with the values of a fresh ArduPilot Copter 4.7 and PX4 1.17."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from pymavlink.dialects.v20 import ardupilotmega as mavlink

ParamTable = Mapping[str, tuple[float, int]]
"""Name -> (value, MAV_PARAM_TYPE)."""

INT32 = int(mavlink.MAV_PARAM_TYPE_INT32)
INT16 = int(mavlink.MAV_PARAM_TYPE_INT16)
INT8 = int(mavlink.MAV_PARAM_TYPE_INT8)
REAL32 = int(mavlink.MAV_PARAM_TYPE_REAL32)


def ardupilot_params() -> ParamTable:
    """Parameters of ArduPilot Copter."""
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
            "MIS_RESTART": (0.0, INT8),
            "FENCE_ENABLE": (0.0, INT8),
            "FENCE_TYPE": (7.0, INT8),
            "FENCE_ACTION": (1.0, INT8),
            "FENCE_ALT_MAX": (100.0, REAL32),
            "FENCE_RADIUS": (300.0, REAL32),
            "FS_GCS_ENABLE": (0.0, INT8),
            "FS_GCS_TIMEOUT": (5.0, REAL32),
            "FS_EKF_ACTION": (1.0, INT8),
            "DID_ENABLE": (0.0, INT8),
            "DID_MAVPORT": (-1.0, INT8),
            "DID_OPTIONS": (0.0, INT16),
            "ADSB_TYPE": (0.0, INT8),
            "ADSB_LIST_RADIUS": (2000.0, INT32),
            "SIM_ADSB_COUNT": (-1.0, INT16),
            "SIM_ADSB_RADIUS": (10000.0, REAL32),
            "SIM_ADSB_ALT": (1000.0, REAL32),
            "BATT_CAPACITY": (3300.0, INT32),
            "BATT_LOW_MAH": (0.0, REAL32),
            "BATT_FS_LOW_ACT": (0.0, INT8),
            "SERIAL0_PROTOCOL": (2.0, INT8),
            "STAT_RUNTIME": (152.0, INT32),
        }
    )


def px4_params() -> ParamTable:
    """Parameters of PX4."""
    return MappingProxyType(
        {
            "MAV_SYS_ID": (1.0, INT32),
            "MAV_COMP_ID": (1.0, INT32),
            "COM_OF_LOSS_T": (1.0, REAL32),
            "NAV_TRAFF_AVOID": (1.0, INT32),
            "COM_OBL_RC_ACT": (0.0, INT32),
            "COM_RC_IN_MODE": (4.0, INT32),
            "COM_RC_OVERRIDE": (1.0, INT32),
            "COM_RC_STICK_OV": (30.0, REAL32),
            "COM_FAIL_ACT_T": (5.0, REAL32),
            "COM_DL_LOSS_T": (10.0, INT32),
            "COM_LOW_BAT_ACT": (0.0, INT32),
            "BAT_CRIT_THR": (0.07, REAL32),
            "NAV_DLL_ACT": (0.0, INT32),
            "GF_ACTION": (2.0, INT32),
            "GF_MAX_HOR_DIST": (0.0, REAL32),
            "GF_MAX_VER_DIST": (0.0, REAL32),
            "COM_DISARM_LAND": (2.0, REAL32),
            "MPC_XY_CRUISE": (5.0, REAL32),
            "MPC_XY_VEL_MAX": (12.0, REAL32),
            "MPC_ACC_HOR": (3.0, REAL32),
            "MPC_Z_VEL_MAX_UP": (3.0, REAL32),
            "MPC_Z_VEL_MAX_DN": (1.5, REAL32),
            "MIS_TAKEOFF_ALT": (2.5, REAL32),
            "NAV_ACC_RAD": (10.0, REAL32),
            "RTL_RETURN_ALT": (60.0, REAL32),
            "SYS_AUTOSTART": (10040.0, INT32),
            "CAL_ACC0_ID": (1310988.0, INT32),
        }
    )
