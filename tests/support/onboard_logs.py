"""Five small onboard logs: two of ArduPilot's copters, one of an old plane, and two of PX4.

Each flight has ten positions per second and goes north at 5 m/s from `PLACE`, at `ALT_M`.
"""

from __future__ import annotations

import math
import struct
from pathlib import Path

from bench.commands import big_log
from tests.support.dataflash_writer import HEAD, DataFlashWriter
from tests.support.ulog_writer import UlogWriter

PLACE = (47.0, 8.5)
ALT_M, HOME_M = 450.0, 430.0
SPEED_MPS = 5.0
NORTH_DEG_S = SPEED_MPS / 111_178.0
"""Degrees of latitude per second of flight."""
UTC_S = 1_767_225_600.0
"""UTC (Unix seconds) when the vehicle started: 2026-01-01."""
GPS_EPOCH_S, LEAP_S = 315_964_800, 18
SECONDS = 20
SAMPLES_BYTES = 750_000
"""Size of the samples of sensors, of which most of a real log consists and which are not read."""
ICAO = 0x4B1234


def latitude(t: float) -> float:
    """Latitude at the time `t` (s)."""
    return PLACE[0] + NORTH_DEG_S * t


def gps_time(t: float) -> tuple[int, int]:
    """GPS week and millisecond of the week at the time `t` (s)."""
    since_ms = round((UTC_S + t - GPS_EPOCH_S + LEAP_S) * 1e3)
    week, ms = divmod(since_ms, 604_800_000)
    return ms, week


def copter(path: Path, *, centimetres: bool = True, system_id: int = 7, east_deg: float = 0.0) -> Path:
    """A copter with ArduPilot 4.x that flies velocity setpoints, with traffic, wind and errors."""
    log = DataFlashWriter()
    log.define("PARM", "QNff", "TimeUS,Name,Value,Default", "F---")
    log.define("MSG", "QZ", "TimeUS,Message", "F-")
    log.define("VER", "QBHBBBBIZHB", "TimeUS,BT,BST,Maj,Min,Pat,FWT,GH,FWS,APJ,BU", "F----------")
    log.define("MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn", "F---")
    log.define("ARM", "QBIBB", "TimeUS,ArmState,ArmChecks,Forced,Method", "F----")
    log.define("EV", "QB", "TimeUS,Id", "F-")
    log.define("ERR", "QBB", "TimeUS,Subsys,ECode", "F--")
    log.define("POS", "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt", "FGG000")
    gps = "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U"
    log.define("GPS", "QBBIHBcLLeffffB", gps, "F--C-0BGGB000--")
    log.define("GPA", "QBCCCCfBIHe", "TimeUS,I,VDop,HAcc,VAcc,SAcc,YAcc,VV,SMS,Delta,AEl", "F-BBBB0-CCB")
    log.define("XKF1", "QBccCffff", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD", "F-BBB0000")
    log.define("XKF2", "QBcccff", "TimeUS,C,AX,AY,AZ,VWN,VWE", "F----00")
    log.define("XKF4", "QBHBIHb", "TimeUS,C,SV,TS,SS,GPS,PI", "F------")
    factor = "B" if centimetres else "0"
    guided = "TimeUS,Type,pX,pY,pZ,Terrain,vX,vY,vZ,aX,aY,aZ"
    log.define("GUIP", "QBfffbffffff", guided, f"F-{factor * 3}-{factor * 6}")
    log.define(
        "ADSB", "QIiiiHHhH", "TimeUS,ICAO_address,Lat,Lng,Alt,Heading,Hor_vel,Ver_vel,Squark", "F-GGCBCC-"
    )
    log.write("MSG", 0, "ArduCopter V4.6.1 (abcdef12)")
    log.write("MSG", 0, "Frame: HEXA/X")
    log.write("PARM", 0, "SYSID_THISMAV", system_id, 1.0)
    log.write("MODE", 0, 0, 0, 1)
    log.write("MSG", 1_000, "PreArm: Need Position Estimate")
    scale = 100.0 if centimetres else 1.0
    for tick in range(SECONDS * 10):
        t = tick / 10
        us = tick * 100_000 + 1_000
        for core, speed in ((0, 0.0), (1, SPEED_MPS)):  # the second estimator core is in use
            log.write("XKF1", us, core, 0.0, 0.0, 0.0, speed, 0.0, -0.5, 0.0)
            log.write("XKF2", us, core, 0.0, 0.0, 0.0, -3.0 * core, 4.0 * core)
            log.write("XKF4", us, core, 0, 0, 0x1F, 0, 1)
        log.write("POS", us + 10, latitude(t), PLACE[1] + east_deg, ALT_M, ALT_M - HOME_M, ALT_M - HOME_M)
        if tick % 2 == 0:
            ms, week = gps_time(us / 1e6 - 0.1)
            place = latitude(t - 0.1), PLACE[1] + east_deg, ALT_M + 1.0
            satellites = 9 if tick == 100 else 14
            log.write("GPS", us + 20, 0, 3, ms, week, satellites, 0.8, *place, 5.0, 0.0, -0.5, 0.0, 1)
            log.write("GPS", us + 20, 1, 3, ms, week, 5, 2.0, *place, 5.0, 0.0, -0.5, 0.0, 0)
            log.write("GPA", us + 20, 0, 1.2, 0.4, 0.6, 0.2, 0.0, 1, 0, 200, ALT_M + 48.0)
        if tick == 20:
            log.write("ARM", us, 1, 0, 0, 1)
            log.write("EV", us, 10)
            log.write("EV", us, 28)
            log.write("MODE", us, 4, 4, 2)
        if tick == 50:
            log.write("ERR", us, 5, 1)
            log.write("ERR", us, 5, 0)
            log.write("GUIP", us, 2, 1.0, 2.0, 3.0, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        if tick > 50 and tick % 5 == 0:
            velocity = 3.0 * scale, -1.0 * scale, 0.5 * scale
            log.write("GUIP", us, 4, 0.0, 0.0, 0.0, 0, *velocity, 0.0, 0.0, 0.0)
        if tick % 10 == 0:
            # The traffic is 400 m to the east and 100 m higher, and flies west.
            east = PLACE[1] + 400.0 / (111_320.0 * math.cos(math.radians(PLACE[0])))
            lat, lng = round(latitude(t) * 1e7), round(east * 1e7)
            log.write("ADSB", us, ICAO, lat, lng, round((ALT_M + 100.0) * 1e3), 27_000, 4_000, 0, 1200)
        if tick == 180:
            log.write("MODE", us, 6, 6, 2)
        if tick == 190:
            log.write("EV", us, 18)
            log.write("EV", us, 11)
            log.write("ARM", us, 0, 0, 0, 1)
    return log.save(path)


def old_plane(path: Path) -> Path:
    """A plane with ArduPilot 3.x. Its log has no units, and has positions of the GNSS receiver but not of the
    estimator."""
    log = DataFlashWriter(with_units=False)
    log.define("MSG", "QZ", "TimeUS,Message")
    log.define("MODE", "QMB", "TimeUS,Mode,ModeNum")
    log.define("GPS", "QBIHBcLLeEefB", "TimeUS,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,U")
    log.write("MSG", 0, "ArduPlane V3.5.3 (12345678)")
    log.write("MODE", 500, 11, 11)
    for tick in range(SECONDS * 5):
        t = tick / 5
        ms, week = gps_time(t)
        status = 1 if tick < 5 else 3
        place = (0.0, 0.0, 0.0) if tick < 5 else (latitude(t), PLACE[1], ALT_M)
        log.write("GPS", tick * 200_000 + 1_000, status, ms, week, 8, 1.5, *place, SPEED_MPS, 90.0, 0.0, 1)
    log.write("MODE", SECONDS * 1_000_000, 10, 10)
    return log.save(path)


def damaged_copter(path: Path) -> Path:
    """The copter's log with a damaged part, and cut off at its end."""
    copter(path)
    whole = path.read_bytes()
    middle = len(whole) // 2
    path.write_bytes(whole[:middle] + bytes(range(256)) * 2 + whole[middle + 300 : -11])
    return path


def sampled_copter(path: Path) -> Path:
    """The copter's log with samples of its sensors."""
    columns = b"TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
    layout = "<QB6f"
    about = struct.pack("<BB4s16s64s", 250, 3 + struct.calcsize(layout), b"IMU", b"QBffffff", columns)
    sample = HEAD + bytes([250]) + struct.pack(layout, 1_000, 0, *[0.1] * 6)
    with copter(path).open("ab") as log:
        log.write(HEAD + bytes([128]) + about + sample * (SAMPLES_BYTES // len(sample)))
    return path


GLOBAL = "uint64_t timestamp;uint64_t timestamp_sample;double lat;double lon;float alt;float alt_ellipsoid;"
GLOBAL += "bool lat_lon_valid;bool alt_valid;uint8_t[6] _padding0;"
LOCAL = "uint64_t timestamp;bool xy_valid;bool v_xy_valid;float x;float y;float z;float vx;float vy;float vz;"
LOCAL += "bool xy_global;bool z_global;double ref_lat;double ref_lon;float ref_alt;"


def px4(path: Path) -> Path:
    """A multicopter with PX4 1.16 in offboard mode, with traffic, wind, Remote ID and a dropout."""
    log = UlogWriter(1_000_000)
    log.info("", "sys_name", "PX4")
    log.info("", "ver_hw", "PX4_FMU_V6X")
    log.info("uint32_t", "ver_sw_release", 0x011000FF)
    log.parameter("int32_t", "MAV_SYS_ID", 9)
    log.define("vehicle_global_position", GLOBAL)
    log.define("vehicle_local_position", LOCAL)
    log.define("home_position", "uint64_t timestamp;double lat;double lon;float alt;bool valid_alt;")
    log.define(
        "vehicle_status",
        "uint64_t timestamp;uint8_t arming_state;uint8_t nav_state_user_intention;uint8_t nav_state;"
        "uint8_t system_type;uint8_t system_id;",
    )
    log.define("vehicle_land_detected", "uint64_t timestamp;bool freefall;bool landed;")
    log.define(
        "sensor_gps",
        "uint64_t timestamp;double latitude_deg;double longitude_deg;double altitude_msl_m;"
        "double altitude_ellipsoid_m;float s_variance_m_s;uint8_t fix_type;float eph;float epv;"
        "float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;int32_t timestamp_time_relative;"
        "uint64_t time_utc_usec;uint8_t satellites_used;",
    )
    log.define("trajectory_setpoint", "uint64_t timestamp;float[3] position;float[3] velocity;float yaw;")
    log.define("wind", "uint64_t timestamp;float windspeed_north;float windspeed_east;")
    log.define(
        "transponder_report",
        "uint64_t timestamp;uint32_t icao_address;double lat;double lon;uint8_t altitude_type;float altitude;"
        "float heading;float hor_velocity;float ver_velocity;char[9] callsign;uint8_t emitter_type;"
        "uint8_t tslc;uint16_t flags;",
    )
    log.define("open_drone_id_arm_status", "uint64_t timestamp;uint8_t status;char[50] error;")
    log.define("cpuload", "uint64_t timestamp;float load;")
    log.same("vehicle_gps_position", "sensor_gps")
    topics = (
        "vehicle_status", "home_position", "vehicle_global_position", "vehicle_local_position",
        "vehicle_land_detected", "vehicle_gps_position", "trajectory_setpoint", "wind", "transponder_report",
        "open_drone_id_arm_status", "cpuload",
    )  # fmt: skip
    for topic in topics:
        log.subscribe(topic)
    log.subscribe("vehicle_gps_position", 1)
    log.data("home_position", 400_000, *PLACE, HOME_M, True)  # the vehicle started long before the log
    for tick in range(SECONDS * 10):
        t = tick / 10
        us = 2_000_000 + tick * 100_000
        if tick % 10 == 0:
            armed = 2 if 20 <= tick < 190 else 1
            mode = 17 if tick < 50 else 14 if tick < 150 else 5
            log.data("vehicle_status", us, armed, mode, mode, 2, 9)
            log.data("vehicle_land_detected", us, False, not 30 <= tick < 190)
            log.data("wind", us, -3.0, 4.0)
            log.data("cpuload", us, 0.4)
            log.sync()
        log.data(
            "vehicle_local_position",
            us,
            True,
            True,
            0.0,
            0.0,
            0.0,
            SPEED_MPS,
            0.0,
            -0.5,
            True,
            True,
            *PLACE,
            0.0,
        )
        # Topics are written in blocks, so their times are not strictly in order.
        log.data(
            "vehicle_global_position", us - 4_000, us, latitude(t), PLACE[1], ALT_M, ALT_M + 48.0, True, True
        )
        if tick % 2 == 0:
            place = latitude(t), PLACE[1], ALT_M + 1.0, ALT_M + 49.0
            utc_us = round((UTC_S + us / 1e6 - 0.05) * 1e6)
            rest = 3, 0.9, 1.4, SPEED_MPS, 0.0, -0.5, -50_000, utc_us
            log.data("vehicle_gps_position", us, *place, 0.3, *rest, 10 if tick == 100 else 12)
            log.data("vehicle_gps_position", us, *place, 0.3, *rest, 4, instance=1)
        if tick == 40:
            log.data("open_drone_id_arm_status", us, 1, b"missing basic_id message")
            log.text(us, 6, "[commander] \x1b[32mReady for takeoff!\x1b[0m\t")
            log.tagged(us, 4, "[battery] low battery")
        if tick % 5 == 0:
            velocity = (math.nan,) * 3 if tick == 60 else (3.0, -1.0, -0.5)
            log.data("trajectory_setpoint", us, math.nan, math.nan, math.nan, *velocity, 0.0)
        if tick % 10 == 0:
            east = PLACE[1] + 400.0 / (111_320.0 * math.cos(math.radians(PLACE[0])))
            log.data(
                "transponder_report", us, ICAO, latitude(t), east, 1, ALT_M + 148.0, math.radians(270.0),
                40.0, 0.0, b"TEST123", 3, 1, 1 | 2 | 4 | 8 | 16,
            )  # fmt: skip
    log.dropout(62)
    return log.save(path)


def sampled_px4(path: Path) -> Path:
    """The multicopter's log with samples of its sensors."""
    topic, sample = UlogWriter(0), UlogWriter(0)
    topic.content = sample.content = b""
    topic.message("F", b"sensor_combined:uint64_t timestamp;float[6] rates;")
    topic.message("A", struct.pack("<BH", 0, 200) + b"sensor_combined")
    sample.message("D", struct.pack("<HQ6f", 200, 2_000_000, *[0.1] * 6))
    data = px4(path).read_bytes()
    first, _, _ = big_log.stamps_of_ulog(data)
    samples = sample.content * (SAMPLES_BYTES // len(sample.content))
    path.write_bytes(data[:first] + topic.content + data[first:] + samples)
    return path


def old_px4(path: Path, *, damaged: bool = True) -> Path:
    """A vehicle with PX4 1.11: positions are relative to an origin only, and a crash dump was appended."""
    log = UlogWriter(1_000_000)
    log.define("vehicle_local_position", LOCAL)
    log.define(
        "vehicle_status", "uint64_t timestamp;uint8_t arming_state;uint8_t nav_state;uint8_t system_type;"
    )
    log.subscribe("vehicle_local_position")
    log.subscribe("vehicle_status")
    log.data("vehicle_status", 1_000_000, 2, 3, 2)
    for tick in range(SECONDS * 10):
        t = tick / 10
        us = 1_000_000 + tick * 100_000
        north_m = SPEED_MPS * t
        state = north_m, 0.0, -20.0, SPEED_MPS, 0.0, 0.0
        log.data("vehicle_local_position", us, True, True, *state, True, True, *PLACE, HOME_M)
        if tick % 5 == 0:
            log.sync()
        if tick == 100 and damaged:
            log.content += b"\x05\x00Qtorn"  # an unfinished message, as when power fails
            log.content += b"\xff\xff\xff\xff"
            log.sync()
        if tick == 100:
            log.data("vehicle_status", us, 2, 6, 2)
    if damaged:
        log.content += b"\x40\x00D\x00\x00half"
    log.append_here()
    log.text(1_000_000 + SECONDS * 1_000_000, 2, "hard fault")
    return log.save(path)
