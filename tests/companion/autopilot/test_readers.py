from __future__ import annotations

import math
import struct
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot import readers
from companion.errors import PeerDataError
from companion.events import AdsbVehicle, GlobalPosition, GnssFix, Landed, MissionCurrent, VehicleTime
from tests.support.place import HOME, LAT_E7, LON_E7

ORDER = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: "custom_mode type autopilot base_mode system_status mavlink_version",
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: "time_boot_ms lat lon alt relative_alt vx vy vz hdg",
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: "time_boot_ms x y z vx vy vz",
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: "time_usec lat lon alt eph epv vel cog fix_type satellites_visible "
    "alt_ellipsoid h_acc v_acc vel_acc hdg_acc yaw",
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: "time_boot_ms press_abs press_diff temperature "
    "temperature_press_diff",
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: "time_unix_usec time_boot_ms",
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: "vtol_state landed_state",
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: "seq total mission_state mission_mode",
    mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE: "ICAO_address lat lon altitude heading hor_velocity ver_velocity "
    "flags squawk altitude_type callsign emitter_type tslc",
    mavlink.MAVLINK_MSG_ID_STATUSTEXT: "severity text id chunk_seq",
    mavlink.MAVLINK_MSG_ID_COMMAND_ACK: "command result progress result_param2 target_system "
    "target_component",
    mavlink.MAVLINK_MSG_ID_MISSION_COUNT: "count target_system target_component mission_type",
    mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT: "param1 param2 param3 param4 x y z seq command target_system "
    "target_component frame current autocontinue mission_type",
    mavlink.MAVLINK_MSG_ID_MISSION_ITEM: "param1 param2 param3 param4 x y z seq command target_system "
    "target_component frame current autocontinue mission_type",
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: "velocity_variance pos_horiz_variance pos_vert_variance "
    "compass_variance terrain_alt_variance flags airspeed_variance",
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: "time_usec vel_ratio pos_horiz_ratio pos_vert_ratio mag_ratio "
    "hagl_ratio tas_ratio pos_horiz_accuracy pos_vert_accuracy flags",
    mavlink.MAVLINK_MSG_ID_MISSION_ACK: "target_system target_component type mission_type",
}


def read(message: Any) -> Any:
    encoder = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    message.pack(encoder)
    fields = readers.unpack(message.get_msgId(), bytes(message.get_payload()))
    return readers.READERS[message.get_msgId()](fields)


def position(**over: int) -> Any:
    values = {
        "lat": LAT_E7,
        "lon": -LON_E7,
        "alt": 430120,
        "relative_alt": -1500,
        "vx": 123,
        "vy": -7,
        "vz": 1,
    }
    return mavlink.MAVLink_global_position_int_message(1500, **(values | over), hdg=65535)


def gps(**over: int) -> Any:
    values = {"fix_type": 3, "lat": LAT_E7, "lon": LON_E7, "alt": 430000, "eph": 65535, "epv": 65535}
    values |= {"vel": 65535, "cog": 65535, "satellites_visible": 10}
    return mavlink.MAVLink_gps_raw_int_message(1, **(values | over))


@pytest.mark.parametrize("message_id", ORDER)
def test_wire_order_is_what_the_readers_take_it_for(message_id: int) -> None:
    assert mavlink.mavlink_map[message_id].ordered_fieldnames == ORDER[message_id].split()


def test_global_position_in_si() -> None:
    assert read(position()) == GlobalPosition(
        time_boot_s=1.5,
        lat_deg=HOME.lat_deg,
        lon_deg=-HOME.lon_deg,
        alt_msl_m=430.12,
        height_above_home_m=-1.5,
        velocity_ned_mps=(1.23, -0.07, 0.01),
    )


def test_no_position_yet_is_no_event() -> None:
    assert read(position(lat=0, lon=0)) is None


@pytest.mark.parametrize(
    "over",
    [
        {"lat": 900000001},
        {"lat": 2**31 - 1},
        {"lon": -1800000001},
        {"alt": 2**31 - 1},
        {"alt": -(2**31)},
        {"relative_alt": 2**31 - 1},
        {"vx": 32767},
        {"vz": -32768},
    ],
)
def test_impossible_positions_are_bad_data(over: dict[str, int]) -> None:
    with pytest.raises(PeerDataError):
        read(position(**over))


@pytest.mark.parametrize("field", ["x", "y", "z", "vx", "vy", "vz"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e9])
def test_non_finite_local_positions_are_bad_data(field: str, value: float) -> None:
    values = dict.fromkeys(["x", "y", "z", "vx", "vy", "vz"], 1.0) | {field: value}
    with pytest.raises(PeerDataError):
        read(mavlink.MAVLink_local_position_ned_message(1, **values))


def test_local_position() -> None:
    event = read(mavlink.MAVLink_local_position_ned_message(2500, 1.0, -2.0, -30.5, 0.5, 0.25, -0.125))
    assert (event.time_boot_s, event.position_ned_m) == (2.5, (1.0, -2.0, -30.5))
    assert event.velocity_ned_mps == (0.5, 0.25, -0.125)


def test_gnss_without_extensions_leaves_them_unknown() -> None:
    event = read(gps(satellites_visible=255))
    assert isinstance(event, GnssFix)
    assert (event.alt_ellipsoid_m, event.horizontal_accuracy_m, event.satellites) == (None, None, None)
    assert (event.vertical_accuracy_m, event.speed_accuracy_mps) == (None, None)


def test_gnss_extensions_in_si() -> None:
    event = read(gps(alt_ellipsoid=478000, h_acc=1200, v_acc=2**32 - 1, vel_acc=300))
    assert (event.fix_type, event.alt_msl_m, event.alt_ellipsoid_m, event.satellites) == (3, 430.0, 478.0, 10)
    assert (event.horizontal_accuracy_m, event.vertical_accuracy_m) == (1.2, None)
    assert event.speed_accuracy_mps == 0.3


@pytest.mark.parametrize("over", [{"fix_type": 9}, {"fix_type": 255}, {"lat": 2**31 - 1}, {"alt": 2**31 - 1}])
def test_impossible_fixes_are_bad_data(over: dict[str, int]) -> None:
    with pytest.raises(PeerDataError):
        read(gps(**over))


@pytest.mark.parametrize(
    ("usec", "utc_s"),
    [(0, None), (1_000_000, None), (2**64 - 1, None), (1_700_000_000_250_000, 1_700_000_000.25)],
)
def test_utc_only_when_the_vehicle_can_know_it(usec: int, utc_s: float | None) -> None:
    event = read(mavlink.MAVLink_system_time_message(usec, 4000))
    assert event == VehicleTime(time_boot_s=4.0, utc_s=utc_s)


@pytest.mark.parametrize(("number", "landed"), list(enumerate(Landed)))
def test_landed_states(number: int, landed: Landed) -> None:
    assert read(mavlink.MAVLink_extended_sys_state_message(0, number)).landed is landed


def test_undefined_landed_state_is_bad_data() -> None:
    with pytest.raises(PeerDataError):
        read(mavlink.MAVLink_extended_sys_state_message(0, 77))


def test_mission_current() -> None:
    assert read(mavlink.MAVLink_mission_current_message(7)) == MissionCurrent(seq=7)
    complete = mavlink.MAVLink_mission_current_message(7, 8, mavlink.MISSION_STATE_COMPLETE, 0)
    assert read(complete) == MissionCurrent(seq=7, complete=True, total=8)
    # PX4's checksum of the mission, an extension.
    fields = readers.unpack(
        mavlink.MAVLINK_MSG_ID_MISSION_CURRENT, struct.pack("<HHBBI", 7, 8, 3, 1, 0xFEDCBA98)
    )
    assert readers.mission_current(fields) == MissionCurrent(seq=7, total=8, mission_id=0xFEDCBA98)


@pytest.mark.parametrize(
    ("flags", "px4", "ardupilot"),
    [
        (0x33F, True, True),
        (0x37F, True, True),  # PX4 1.17 in flight, with a range finder
        (0x3FF, True, False),  # the same on the ground, at rest; to ArduPilot, a place that is assumed
        (0x3BF & ~16, False, False),
        (0x33F & ~2, False, False),
        (0x33F & ~32, False, False),  # no height
        (0, False, False),
    ],
)
def test_what_the_estimators_flags_say(flags: int, px4: bool, ardupilot: bool) -> None:
    ratios = (0.1,) * 5
    told = read(mavlink.MAVLink_ekf_status_report_message(flags, *ratios))
    assert told.usable is ardupilot
    told = read(mavlink.MAVLink_estimator_status_message(1, flags, *ratios, 0.0, 1.0, 1.0))
    assert told.usable is px4


# ---------------------------------------------------------------- sticks


def channels(roll: int = 1500, pitch: int = 1500, yaw: int = 1500, count: int = 16) -> Any:
    """RC_CHANNELS with the throttle and the switches out of range."""
    return mavlink.MAVLink_rc_channels_message(1, count, roll, pitch, 0, yaw, *[0] * 14, 255)


def test_sticks_are_roll_pitch_and_yaw_of_channels_1_2_and_4() -> None:
    assert read(channels(1200, 1400, 1900)).sticks_us == (1200, 1400, 1900)


@pytest.mark.parametrize(
    ("told", "known"),
    [
        ({"roll": 800, "pitch": 2200, "yaw": 800}, True),
        ({"roll": 799}, False),
        ({"pitch": 2201}, False),
        ({"yaw": 65535}, False),
        ({"yaw": 0}, False),
        # Without a remote control no channel is received; the values are of no meaning then.
        ({"count": 0}, False),
        ({"count": 1}, True),
    ],
)
def test_without_a_signal_of_all_three_there_are_no_sticks(told: dict[str, int], known: bool) -> None:
    assert (read(channels(**told)).sticks_us is not None) is known


# ---------------------------------------------------------------- ADS-B

COORDS, ALTITUDE, HEADING, VELOCITY, CALLSIGN, SQUAWK, VERTICAL = 1, 2, 4, 8, 16, 32, 128
ALL = COORDS | ALTITUDE | HEADING | VELOCITY | CALLSIGN | SQUAWK | VERTICAL


def adsb(**over: Any) -> Any:
    """500 m up, flying east at 60 m/s and climbing at 2.5 m/s."""
    values = {"ICAO_address": 0x4B1234, "lat": LAT_E7, "lon": -LON_E7, "altitude_type": 0}
    values |= {"altitude": 500_000, "heading": 9000, "hor_velocity": 6000, "ver_velocity": 250}
    values |= {"callsign": b"HBABC", "emitter_type": 1, "tslc": 2, "flags": ALL, "squawk": 7000}
    return mavlink.MAVLink_adsb_vehicle_message(**(values | over))


def test_adsb_in_si_and_ned() -> None:
    event = read(adsb())
    assert isinstance(event, AdsbVehicle)
    assert event.velocity_ned_mps == pytest.approx((0.0, 60.0, -2.5))
    assert (event.icao, event.lat_deg, event.lon_deg, event.alt_m) == (
        0x4B1234,
        HOME.lat_deg,
        -HOME.lon_deg,
        500.0,
    )
    assert (event.alt_geometric, event.age_s, event.callsign, event.emitter) == (False, 2.0, "HBABC", 1)
    assert read(adsb(altitude_type=1)).alt_geometric


@pytest.mark.parametrize(
    ("course", "north", "east"),
    [(0, 1, 0), (18000, -1, 0), (27000, 0, -1), (36000, 1, 0), (4500, 0.5**0.5, 0.5**0.5)],
)
def test_the_course_is_clockwise_from_north(course: int, north: float, east: float) -> None:
    velocity = read(adsb(heading=course)).velocity_ned_mps
    assert velocity == pytest.approx((60 * north, 60 * east, -2.5))


def test_flags_say_what_is_known() -> None:
    # Fields whose flag is off may hold anything.
    junk = {"altitude": 2**31 - 1, "altitude_type": 9, "heading": 65535, "hor_velocity": 65535}
    junk |= {"ver_velocity": -32768, "callsign": b"\xff\xfe"}
    assert read(adsb(flags=COORDS, **junk)) == AdsbVehicle(
        icao=0x4B1234, lat_deg=HOME.lat_deg, lon_deg=-HOME.lon_deg, age_s=2.0, emitter=1
    )


@pytest.mark.parametrize("missing", [HEADING, VELOCITY])
def test_velocity_needs_course_and_speed(missing: int) -> None:
    assert read(adsb(flags=ALL & ~missing)).velocity_ned_mps is None


def test_the_vertical_speed_counts_without_its_flag_as_in_the_firmwares() -> None:
    assert read(adsb(flags=ALL & ~VERTICAL)).velocity_ned_mps[2] == -2.5


@pytest.mark.parametrize("over", [{"flags": ALL & ~COORDS}, {"flags": 0}, {"lat": 0, "lon": 0}])
def test_no_position_is_no_traffic(over: dict[str, int]) -> None:
    assert read(adsb(**over)) is None


@pytest.mark.parametrize(
    "over",
    [
        {"ICAO_address": 2**24},
        {"lat": 900000001},
        {"lon": -1800000001},
        {"altitude": 50_000_001},
        {"altitude": -1_000_001},
        {"altitude_type": 2},
    ],
)
def test_impossible_traffic_is_bad_data(over: dict[str, int]) -> None:
    with pytest.raises(PeerDataError):
        read(adsb(**over))


@pytest.mark.parametrize(
    "over",
    [{"heading": 36001}, {"hor_velocity": 65535}, {"ver_velocity": 32767}, {"ver_velocity": -32768}],
)
def test_an_impossible_velocity_hides_no_aircraft(over: dict[str, int]) -> None:
    heard = read(adsb(**over))
    assert isinstance(heard, AdsbVehicle)
    assert heard.velocity_ned_mps is None
    assert heard.lat_deg == pytest.approx(read(adsb()).lat_deg)


@pytest.mark.parametrize(
    ("field", "text"),
    [
        (b"", ""),
        (b"HBABC   ", "HBABC"),
        (b"AB\0CD", "AB"),
        (b"ABCDEFGHI", "ABCDEFGHI"),
        (b"A\x1b[2J\xe9", "A?[2J?"),
        (b" A~\x7f\x1f", "A~??"),
    ],
)
def test_callsigns_are_printable_ascii(field: bytes, text: str) -> None:
    wire = readers.unpack(246, bytes(27) + field.ljust(9, b"\0") + bytes(2))
    fields = (0, 1, 1, 0, 0, 0, 0, COORDS | CALLSIGN, *wire[8:])
    assert readers.adsb_vehicle(fields).callsign == text


@pytest.mark.parametrize("pressure_hpa", [0.0, 299.0, 1101.0, math.nan, math.inf])
def test_a_pressure_of_no_flight_is_refused(pressure_hpa: float) -> None:
    with pytest.raises(PeerDataError, match="absolute pressure"):
        read(mavlink.MAVLink_scaled_pressure_message(1500, pressure_hpa, 0.0, 2000))


def test_the_absolute_pressure() -> None:
    found = read(mavlink.MAVLink_scaled_pressure_message(1500, 954.5, 0.1, 2000))
    assert found.pressure_hpa == pytest.approx(954.5)
