"""The messages that the mock vehicle sends by itself, each built from the present state.

The vehicle does not know message ids that are not in `Telemetry.known`. Those of `LISTS` come from
`sitl_mocks.vehicle.traffic` and `sitl_mocks.vehicle.sensing`, several at a time or none.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import CURRENT_MODE, MavlinkMessage
from companion.events import Landed
from companion.geometry import Vec3
from sitl_mocks.vehicle.firmware.behaviour import Manners, VehicleMode
from sitl_mocks.vehicle.links import Payload, packed
from sitl_mocks.vehicle.motion.flight import Flight
from sitl_mocks.vehicle.motion.navigation import Globe, NavigationError
from sitl_mocks.vehicle.options import VehicleOptions
from sitl_mocks.vehicle.served.mission import MissionBook
from sitl_mocks.vehicle.served.remote_id import home_system, location
from sitl_mocks.vehicle.troubles import Troubles

Builder = Callable[[float], MavlinkMessage | Payload | None]
"""Builds a message for a now_s; None if the vehicle has nothing to report."""

# Layouts of the messages that are sent many times a second, with the fields in wire order.
_GLOBAL_POSITION = struct.Struct("<IiiiihhhH")
_SIX_FLOATS = struct.Struct("<I6f")
_POSITION_TARGET = struct.Struct("<I11fHB")
_GPS_RAW = struct.Struct("<QiiiHHHHBBiIIII")
_CURRENT_MODE = struct.Struct("<IIB")

_LANDED = {
    Landed.ON_GROUND: mavlink.MAV_LANDED_STATE_ON_GROUND,
    Landed.IN_AIR: mavlink.MAV_LANDED_STATE_IN_AIR,
    Landed.TAKEOFF: mavlink.MAV_LANDED_STATE_TAKEOFF,
    Landed.LANDING: mavlink.MAV_LANDED_STATE_LANDING,
}
_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
    | mavlink.MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION
    | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | mavlink.MAV_SYS_STATUS_AHRS
)
LISTS = (mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE, mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR)
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
)
_ESTIMATOR_LOST = (
    mavlink.ESTIMATOR_ATTITUDE | mavlink.ESTIMATOR_VELOCITY_VERT | mavlink.ESTIMATOR_POS_VERT_ABS
)
_ESTIMATOR_GOOD = (
    _ESTIMATOR_LOST
    | mavlink.ESTIMATOR_VELOCITY_HORIZ
    | mavlink.ESTIMATOR_POS_HORIZ_REL
    | mavlink.ESTIMATOR_POS_HORIZ_ABS
    | mavlink.ESTIMATOR_PRED_POS_HORIZ_REL
    | mavlink.ESTIMATOR_PRED_POS_HORIZ_ABS
)
_FIRST_FIX_S = 8.0
"""Time from boot to the first GNSS position; the estimator may take longer."""
_MIN_ACCURACY_M = 0.3
_MIN_SPEED_ACCURACY_MPS = 0.1
_GRAVITY = 9.81


class Telemetry:
    """Builds messages for a time: the caller's `now_s`, to which the flight state belongs."""

    def __init__(
        self,
        options: VehicleOptions,
        manners: Manners,
        flight: Flight,
        book: MissionBook,
        errors: NavigationError,
        troubles: Troubles,
        boot_s: float,
    ) -> None:
        self.boot_s = boot_s
        """The now_s at which the vehicle's own clock read 0."""
        self._options = options
        self._manners = manners
        self._flight = flight
        self._book = book
        self._errors = errors
        self._troubles = troubles
        self._globe = Globe(options.home_lat_deg, options.home_lon_deg, options.home_alt_msl_m)
        builders: dict[int, Builder] = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self.heartbeat,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: self._system_time,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_raw,
            mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: self._scaled_pressure,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position,
            mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: self._mission_current,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._origin,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: self._vfr_hud,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._timesync,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self.autopilot_version,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: self.home_position,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._extended_sys_state,
            mavlink.MAVLINK_MSG_ID_RC_CHANNELS: self._rc_channels,
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: self._battery_status,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: self._position_target,
            manners.estimator_message: self._estimator_status,
        }
        if manners.tells_fence:
            builders[mavlink.MAVLINK_MSG_ID_FENCE_STATUS] = self._fence_status
        if mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION in manners.fresh_streams:
            builders[mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION] = self.remote_id_location
            builders[mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_SYSTEM] = self._remote_id_system
        if manners.tells_current_mode:
            builders[CURRENT_MODE] = self.current_mode
        self.builders: Mapping[int, Builder] = builders
        self.known = frozenset((*builders, *LISTS))

    def boot_ns(self, now_s: float) -> int:
        """Time of the vehicle's own clock (ns)."""
        return round((now_s - self.boot_s) * 1e9)

    def position_ned_m(self) -> Vec3:
        """Estimated position: true position plus navigation error (NED, m)."""
        body, error = self._flight.body, self._errors.errors
        return body.north + error[0], body.east + error[1], body.down + error[2]

    def velocity_ned_mps(self) -> Vec3:
        """Estimated velocity: true velocity plus navigation error (NED, m/s)."""
        body, error = self._flight.body, self._errors.errors
        return body.vn + error[3], body.ve + error[4], body.vd + error[5]

    def heartbeat(self, now_s: float) -> Payload:
        """Build HEARTBEAT."""
        flight, manners = self._flight, self._manners
        base = manners.base_modes[flight.mode] | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if flight.armed else 0)
        if flight.failsafe:
            status = mavlink.MAV_STATE_CRITICAL
        elif flight.on_ground and flight.landing_detected:
            status = mavlink.MAV_STATE_STANDBY
        else:
            status = mavlink.MAV_STATE_ACTIVE
        mode = manners.custom_modes[flight.mode]
        return packed(
            mavlink.MAVLink_heartbeat_message,
            mode,
            mavlink.MAV_TYPE_QUADROTOR,
            manners.autopilot_id,
            base,
            status,
            3,
        )

    def current_mode(self, now_s: float) -> Payload:
        """Build CURRENT_MODE with the present mode."""
        return self.mode_told(self._flight.mode, self._flight.intended)

    def mode_told(self, mode: VehicleMode, intended: VehicleMode) -> Payload:
        """Build CURRENT_MODE with any mode."""
        manners = self._manners
        numbers = manners.custom_modes[mode], manners.custom_modes[intended]
        return Payload(CURRENT_MODE, _CURRENT_MODE.pack(*numbers, manners.standard_modes.get(mode, 0)))

    def home_position(self, now_s: float) -> MavlinkMessage:
        """Build HOME_POSITION: the origin of the local frame."""
        lat, lon, alt = self._home()
        nan = math.nan
        usec = round((now_s - self.boot_s) * 1e6)
        return mavlink.MAVLink_home_position_message(
            lat, lon, alt, 0.0, 0.0, 0.0, [nan, nan, nan, nan], 0.0, 0.0, 0.0, usec
        )

    def _home(self) -> tuple[int, int, int]:
        options = self._options
        lat, lon = round(options.home_lat_deg * 1e7), round(options.home_lon_deg * 1e7)
        return lat, lon, round(options.home_alt_msl_m * 1e3)

    def _boot_ms(self, now_s: float) -> int:
        return round((now_s - self.boot_s) * 1e3) & 0xFFFFFFFF

    def _global_position(self, now_s: float) -> Payload | None:
        known = self._flight.knows_place(now_s)
        if not known and self._manners.global_position_stops:
            return None
        lat, lon, alt = self._globe.to_geodetic(*self.position_ned_m())
        if not known and now_s - self.boot_s < _FIRST_FIX_S:
            lat, lon = 0.0, 0.0
        vn, ve, vd = self.velocity_ned_mps()
        heading = round(math.degrees(self._flight.body.yaw) % 360.0 * 100.0) % 36000
        body = _GLOBAL_POSITION.pack(
            self._boot_ms(now_s),
            round(lat * 1e7),
            round(lon * 1e7),
            round(alt * 1e3),
            round((alt - self._options.home_alt_msl_m) * 1e3),
            round(vn * 1e2),
            round(ve * 1e2),
            round(vd * 1e2),
            heading,
        )
        return Payload(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, body)

    def _local_position(self, now_s: float) -> Payload | None:
        if not self._flight.knows_place(now_s):
            return None
        body = _SIX_FLOATS.pack(self._boot_ms(now_s), *self.position_ned_m(), *self.velocity_ned_mps())
        return Payload(mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, body)

    def _position_target(self, now_s: float) -> Payload | None:
        """The velocity that the firmware flies from the setpoints; zero if it flies none."""
        flight = self._flight
        external = flight.mode is VehicleMode.EXTERNAL
        if not (external or self._manners.target_always_told) or not flight.armed:
            return None
        velocity = (0.0, 0.0, 0.0)
        if external and flight.setpoint is not None and not flight.setpoint.stop:
            velocity = flight.setpoint.velocity_ned_mps
        numbers = (0.0, 0.0, 0.0, *velocity, 0.0, 0.0, 0.0, 0.0, 0.0)
        body = _POSITION_TARGET.pack(self._boot_ms(now_s), *numbers, 0xDC7, mavlink.MAV_FRAME_LOCAL_NED)
        return Payload(mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED, body)

    def _gps_raw(self, now_s: float) -> Payload:
        options, lost = self._options, self._troubles.gnss_lost
        lat, lon, alt = self._globe.to_geodetic(*self.position_ned_m())
        vn, ve, _ = self.velocity_ned_mps()
        speed = math.hypot(vn, ve)
        course = round(math.degrees(math.atan2(ve, vn)) % 360.0 * 100.0) % 36000 if speed > 0.05 else 0
        body = _GPS_RAW.pack(
            round((now_s - self.boot_s) * 1e6),
            round(lat * 1e7),
            round(lon * 1e7),
            round(alt * 1e3),
            0xFFFF if lost else 121,
            0xFFFF if lost else 200,
            round(speed * 1e2),
            course,
            mavlink.GPS_FIX_TYPE_NO_FIX if lost else self._manners.gps_fix_type,
            0 if lost else 10,
            round((alt + options.geoid_separation_m) * 1e3),
            round(max(options.gnss_horizontal_sigma_m, _MIN_ACCURACY_M) * 1e3),
            round(max(options.gnss_vertical_sigma_m, _MIN_ACCURACY_M) * 1e3),
            round(max(options.gnss_velocity_sigma_mps, _MIN_SPEED_ACCURACY_MPS) * 1e3),
            0,
        )
        return Payload(mavlink.MAVLINK_MSG_ID_GPS_RAW_INT, body)

    def _scaled_pressure(self, now_s: float) -> Payload:
        """The pressure of the standard atmosphere, without weather, at the true height."""
        altitude = self._options.home_alt_msl_m - self._flight.body.down
        pressure_hpa = 1013.25 * (1.0 - altitude / 44_330.77) ** (1.0 / 0.190263)
        kind = mavlink.MAVLink_scaled_pressure_message
        return packed(kind, self._boot_ms(now_s), pressure_hpa, 0.0, 1500)

    def attitude_rad(self) -> Vec3:
        """Roll, pitch and yaw of a multicopter with this acceleration."""
        body = self._flight.body
        north, east = body.lean_mps2
        cos, sin = math.cos(body.yaw), math.sin(body.yaw)
        forward, right = cos * north + sin * east, cos * east - sin * north
        return math.atan2(right, _GRAVITY), -math.atan2(forward, _GRAVITY), body.yaw

    def pose(self) -> tuple[Vec3, Vec3]:
        """Estimated position (NED, m), and roll, pitch and yaw (rad)."""
        return self.position_ned_m(), self.attitude_rad()

    def _attitude(self, now_s: float) -> Payload:
        """ATTITUDE. Angular rates are not modelled."""
        packed = _SIX_FLOATS.pack(self._boot_ms(now_s), *self.attitude_rad(), 0.0, 0.0, 0.0)
        return Payload(mavlink.MAVLINK_MSG_ID_ATTITUDE, packed)

    def _vfr_hud(self, now_s: float) -> Payload:
        body = self._flight.body
        vn, ve, vd = self.velocity_ned_mps()
        speed = math.hypot(vn, ve)
        heading = round(math.degrees(body.yaw)) % 360
        throttle = 0 if self._flight.on_ground else 50
        altitude = self._options.home_alt_msl_m - self.position_ned_m()[2]
        return packed(mavlink.MAVLink_vfr_hud_message, speed, speed, altitude, -vd, heading, throttle)

    def _sys_status(self, now_s: float) -> Payload:
        sensor = self._options.sensor
        wired = sensor is not None and sensor.message == "proximity"
        there = _SENSORS | (mavlink.MAV_SYS_STATUS_SENSOR_PROXIMITY if wired else 0)
        healthy = _SENSORS if self._troubles.proximity_lost else there
        numbers = there, there, healthy, 100, self._millivolts, 0, 0, 0, 0, 0, 0, 0, self._percent
        return packed(mavlink.MAVLink_sys_status_message, *numbers)

    @property
    def _percent(self) -> int:
        return round(self._troubles.battery_remaining * 100.0)

    @property
    def _millivolts(self) -> int:
        """Voltage of three cells in series that falls linearly from full to empty."""
        return round(9900.0 + 2700.0 * self._troubles.battery_remaining)

    def _battery_status(self, now_s: float) -> MavlinkMessage:
        cells = [self._millivolts, *[0xFFFF] * 9]
        return mavlink.MAVLink_battery_status_message(0, 0, 0, 0x7FFF, cells, 0, 0, -1, self._percent)

    def _rc_channels(self, now_s: float) -> Payload | None:
        """Channels 1 to 4: roll, pitch, throttle, yaw."""
        troubles = self._troubles
        if not troubles.rc_connected:
            return None
        sticks = [round(1500.0 + 500.0 * stick) for stick in troubles.sticks]
        channels = [*sticks, *[1500] * 4, *[0xFFFF] * 10]
        return packed(mavlink.MAVLink_rc_channels_message, self._boot_ms(now_s), *channels, 8, 200)

    def _estimator_status(self, now_s: float) -> Payload:
        """EKF_STATUS_REPORT or ESTIMATOR_STATUS. Both have the same flag bits, but the constant-position flag
        means "no position" on ArduPilot and "at rest on the ground" on PX4."""
        troubles = self._troubles
        ratio = 1.5 if troubles.estimator_bad else 0.1
        flags = _ESTIMATOR_LOST if troubles.position_lost else _ESTIMATOR_GOOD
        ardupilot = self._manners.estimator_message == mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT
        if troubles.position_lost if ardupilot else self._flight.landed is Landed.ON_GROUND:
            flags |= mavlink.ESTIMATOR_CONST_POS_MODE
        if ardupilot:
            return packed(mavlink.MAVLink_ekf_status_report_message, ratio, ratio, 0.1, 0.1, 0.0, flags)
        accuracy = self._options.gnss_horizontal_sigma_m or _MIN_ACCURACY_M
        usec = round((now_s - self.boot_s) * 1e6)
        ratios = ratio, ratio, 0.1, 0.1, 0.0, 0.0
        return packed(mavlink.MAVLink_estimator_status_message, usec, *ratios, accuracy, accuracy, flags)

    def _fence_status(self, now_s: float) -> MavlinkMessage | None:
        troubles = self._troubles
        if not troubles.fence_enabled:
            return None
        breaches = troubles.breaches
        kind = mavlink.FENCE_BREACH_NONE
        if breaches:
            kind = mavlink.FENCE_BREACH_BOUNDARY if breaches & ~1 else mavlink.FENCE_BREACH_MAXALT
        at_ms = round((troubles.breached_s - self.boot_s) * 1e3) & 0xFFFFFFFF if troubles.breach_count else 0
        return mavlink.MAVLink_fence_status_message(
            1 if breaches else 0, troubles.breach_count, kind, at_ms, mavlink.FENCE_MITIGATE_NONE
        )

    def _utc_s(self, now_s: float) -> float | None:
        utc = self._options.utc_at_zero_s
        return None if utc is None else utc + now_s

    def remote_id_location(self, now_s: float) -> MavlinkMessage:
        """Build OPEN_DRONE_ID_LOCATION."""
        place = self._globe.to_geodetic(*self.position_ned_m())
        velocity = self.velocity_ned_mps()
        on_ground = self._flight.on_ground
        return location(self._options, place, velocity, self._utc_s(now_s), on_ground=on_ground)

    def _remote_id_system(self, now_s: float) -> MavlinkMessage:
        return home_system(self._options, self._utc_s(now_s))

    def _system_time(self, now_s: float) -> Payload:
        utc_s = self._utc_s(now_s)
        usec = 0 if utc_s is None else round(utc_s * 1e6)
        return packed(mavlink.MAVLink_system_time_message, usec, self._boot_ms(now_s))

    def _extended_sys_state(self, now_s: float) -> Payload:
        kind, landed = mavlink.MAVLink_extended_sys_state_message, _LANDED[self._flight.landed]
        return packed(kind, self._manners.vtol_state, landed)

    def _mission_current(self, now_s: float) -> Payload:
        flight, total = self._flight, self._book.flown_count
        if not total:
            state = mavlink.MISSION_STATE_NO_MISSION
            total = 0 if self._manners.home_is_item_zero else 65535
        elif flight.runner.complete:
            state = mavlink.MISSION_STATE_COMPLETE
        elif flight.mode is VehicleMode.MISSION:
            state = mavlink.MISSION_STATE_ACTIVE
        elif flight.runner.seq > self._book.first_seq:
            state = self._manners.paused_state
        else:
            state = mavlink.MISSION_STATE_NOT_STARTED
        return packed(mavlink.MAVLink_mission_current_message, flight.runner.seq, total, state, 0)

    def _timesync(self, now_s: float) -> Payload:
        return packed(mavlink.MAVLink_timesync_message, 0, self.boot_ns(now_s))

    def _origin(self, now_s: float) -> MavlinkMessage:
        return mavlink.MAVLink_gps_global_origin_message(*self._home(), round((now_s - self.boot_s) * 1e6))

    def autopilot_version(self, now_s: float) -> MavlinkMessage:
        """Build AUTOPILOT_VERSION."""
        encode = (
            mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
            if self._manners.param_bytewise
            else mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
        )
        none = [0] * 8
        return mavlink.MAVLink_autopilot_version_message(
            _CAPABILITIES | encode, 0, 0, 0, 0, none, none, none, 0, 0, self._options.system_id
        )
