from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot import readers
from companion.errors import PeerDataError
from companion.events import GlobalPosition, GnssFix, Landed, VehicleTime

ORDER = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: "custom_mode type autopilot base_mode system_status mavlink_version",
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: "time_boot_ms lat lon alt relative_alt vx vy vz hdg",
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: "time_boot_ms x y z vx vy vz",
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: "time_usec lat lon alt eph epv vel cog fix_type satellites_visible "
    "alt_ellipsoid h_acc v_acc vel_acc hdg_acc yaw",
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: "time_unix_usec time_boot_ms",
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: "vtol_state landed_state",
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: "seq total mission_state mission_mode",
    mavlink.MAVLINK_MSG_ID_STATUSTEXT: "severity text id chunk_seq",
    mavlink.MAVLINK_MSG_ID_COMMAND_ACK: "command result progress result_param2 target_system "
    "target_component",
    mavlink.MAVLINK_MSG_ID_MISSION_COUNT: "count target_system target_component mission_type",
    mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT: "param1 param2 param3 param4 x y z seq command target_system "
    "target_component frame current autocontinue mission_type",
    mavlink.MAVLINK_MSG_ID_MISSION_ITEM: "param1 param2 param3 param4 x y z seq command target_system "
    "target_component frame current autocontinue mission_type",
    mavlink.MAVLINK_MSG_ID_MISSION_ACK: "target_system target_component type mission_type",
}


def read(message: Any) -> Any:
    encoder = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    message.pack(encoder)
    fields = readers.unpack(message.get_msgId(), bytes(message.get_payload()))
    return readers.READERS[message.get_msgId()](fields)


def position(**over: int) -> Any:
    values = {
        "lat": 473970000,
        "lon": -85450000,
        "alt": 430120,
        "relative_alt": -1500,
        "vx": 123,
        "vy": -7,
        "vz": 1,
    }
    return mavlink.MAVLink_global_position_int_message(1500, **(values | over), hdg=65535)


def gps(**over: int) -> Any:
    values = {"fix_type": 3, "lat": 473970000, "lon": 85450000, "alt": 430000, "eph": 65535, "epv": 65535}
    values |= {"vel": 65535, "cog": 65535, "satellites_visible": 10}
    return mavlink.MAVLink_gps_raw_int_message(1, **(values | over))


@pytest.mark.parametrize("message_id", ORDER)
def test_wire_order_is_what_the_readers_take_it_for(message_id: int) -> None:
    assert mavlink.mavlink_map[message_id].ordered_fieldnames == ORDER[message_id].split()


def test_global_position_in_si() -> None:
    assert read(position()) == GlobalPosition(
        time_boot_s=1.5,
        lat_deg=47.397,
        lon_deg=-8.545,
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
    assert read(mavlink.MAVLink_mission_current_message(7)).seq == 7
