"""The mission protocol both ways, and the flight along the mission."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.errors import ConfigError
from companion.events import Firmware, Landed, MissionItem
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode
from tests.support.place import HOME, LAT_E7, LON_E7

AP, PX4 = Firmware.ARDUPILOT, Firmware.PX4
BOTH = pytest.mark.parametrize("firmware", [AP, PX4])


def wire(seq, command, north=0.0, east=0.0, height=30.0, frame=6, p1=0.0, p2=0.0):
    lat, lon, _ = HOME.to_geodetic(north, east, 0.0)
    place = (round(lat * 1e7), round(lon * 1e7)) if (north, east) != (0.0, 0.0) else (0, 0)
    return mavlink.MAVLink_mission_item_int_message(
        1, 1, seq, frame, command, 0, 1, p1, p2, 0.0, math.nan, *place, height
    )


def plan(firmware, *rest):
    """Take-off, two waypoints and the remaining items; for ArduPilot a home item comes first."""
    items = [("takeoff", 22, 0.0, 0.0), ("first", 16, 100.0, 0.0), ("second", 16, 100.0, 60.0)]
    out = [wire(0, 16, 1.0, 1.0, 0.0, frame=0)] if firmware is AP else []
    out += [wire(0, command, north, east) for _, command, north, east in items]
    out += rest
    for seq, item in enumerate(out):
        item.seq = seq
    return out


def upload(b, items):
    """Answer each request; return the names of the requests and the final MISSION_ACK type."""
    answers = b.send(mavlink.MAVLink_mission_count_message(1, 1, len(items)))
    asked = []
    for _ in range(len(items) + 1):
        for m in answers:
            if m.get_type() == "MISSION_ACK":
                return asked, m.type
        request = next(m for m in answers if m.get_type().startswith("MISSION_REQUEST"))
        asked.append((request.get_type(), request.seq))
        answers = b.send(items[request.seq])
    raise AssertionError("no end")


def download(b):
    (count,) = b.send(mavlink.MAVLink_mission_request_list_message(1, 1))
    assert (count.target_system, count.target_component) == (1, 191)
    got = [b.send(mavlink.MAVLink_mission_request_int_message(1, 1, seq))[0] for seq in range(count.count)]
    b.send(mavlink.MAVLink_mission_ack_message(1, 1, mavlink.MAV_MISSION_ACCEPTED))
    return got


@pytest.mark.parametrize(
    ("firmware", "request_name"), [(AP, "MISSION_REQUEST"), (PX4, "MISSION_REQUEST_INT")]
)
def test_upload_is_driven_by_the_firmwares_own_request(bench, firmware, request_name):
    b = bench(firmware)
    items = plan(firmware)
    asked, result = upload(b, items)
    assert asked == [(request_name, seq) for seq in range(len(items))]
    assert result == mavlink.MAV_MISSION_ACCEPTED
    assert ("Flight plan received" in b.texts()) is (firmware is AP)


@BOTH
def test_download_returns_what_was_uploaded(bench, firmware):
    b = bench(firmware)
    items = plan(firmware)
    upload(b, items)
    got = download(b)
    first = 1 if firmware is AP else 0
    assert [(m.seq, m.command, m.frame, m.x, m.y, m.z) for m in got[first:]] == [
        (m.seq, m.command, m.frame, m.x, m.y, m.z) for m in items[first:]
    ]


def test_ardupilot_item_0_comes_back_as_home(bench):
    b = bench(AP)
    upload(b, plan(AP))
    home = download(b)[0]
    assert (home.x, home.y, home.z) == (LAT_E7, LON_E7, HOME.alt_m)


def test_old_float_request_is_answered_with_mission_item(bench):
    b = bench(AP)
    upload(b, plan(AP))
    (item,) = b.send(mavlink.MAVLink_mission_request_message(1, 1, 2))
    assert item.get_type() == "MISSION_ITEM"
    assert HOME.to_ned(item.x, item.y, 400.0)[0] == pytest.approx(100.0, abs=1.0)


@BOTH
def test_half_done_upload_is_asked_for_again_then_dropped_and_the_old_mission_stays(bench, firmware):
    b = bench(firmware)
    items = plan(firmware)
    upload(b, items)
    b.send(mavlink.MAVLink_mission_count_message(1, 1, 3))
    b.send(items[0])
    late = b.run(10.0)
    again = [m.seq for m in late if m.get_type().startswith("MISSION_REQUEST")]
    assert set(again) == {1}
    assert [m.type for m in late if m.get_type() == "MISSION_ACK"] == [
        mavlink.MAV_MISSION_OPERATION_CANCELLED
    ]
    assert len(download(b)) == len(items)
    assert [m.type for m in b.send(items[1])] == [mavlink.MAV_MISSION_ERROR]


@BOTH
def test_lost_request_and_repeated_item(bench, firmware):
    b = bench(firmware)
    items = plan(firmware)
    b.send(mavlink.MAVLink_mission_count_message(1, 1, len(items)))
    b.send(items[0])
    (again,) = b.send(items[0])
    assert again.seq == 1


def test_ardupilot_wrong_sequence(bench):
    b = bench(AP)
    items = plan(AP)
    b.send(mavlink.MAVLink_mission_count_message(1, 1, len(items)))
    assert [m.type for m in b.send(items[3])] == [mavlink.MAV_MISSION_INVALID_SEQUENCE]


@BOTH
@pytest.mark.parametrize(
    ("bad", "result"),
    [
        (wire(0, 16, 1.0, 1.0, math.nan), mavlink.MAV_MISSION_INVALID_PARAM7),
        (wire(0, 16, 1.0, 1.0, frame=1), mavlink.MAV_MISSION_UNSUPPORTED_FRAME),
        (wire(0, 82), mavlink.MAV_MISSION_UNSUPPORTED),
    ],
)
def test_items_that_cannot_be_flown_are_refused(bench, firmware, bad, result):
    b = bench(firmware)
    b.send(mavlink.MAVLink_mission_count_message(1, 1, 1))
    assert [m.type for m in b.send(bad)] == [result]
    assert download(b) == []


@BOTH
def test_other_mission_types(bench, firmware):
    b = bench(firmware)
    (count,) = b.send(mavlink.MAVLink_mission_request_list_message(1, 1, 2))
    assert (count.count, count.mission_type) == (0, 2)
    (ack,) = b.send(mavlink.MAVLink_mission_count_message(1, 1, 2, 2))
    assert (ack.type, ack.mission_type) == (mavlink.MAV_MISSION_UNSUPPORTED, 2)


@BOTH
def test_clear_all(bench, firmware):
    b = bench(firmware)
    upload(b, plan(firmware))
    (ack,) = b.send(mavlink.MAVLink_mission_clear_all_message(1, 1))
    assert ack.type == mavlink.MAV_MISSION_ACCEPTED
    assert download(b) == []
    b.run(1.0)
    acks = b.set_mode(VehicleMode.MISSION) + [m.result for m in b.run(0.1) if m.get_type() == "COMMAND_ACK"]
    assert acks == ([4] if firmware is AP else [0, 1])
    assert b.vehicle.mode is not VehicleMode.MISSION


def test_px4_mission_right_after_the_upload_is_accepted_and_not_entered(airborne):
    b = airborne(PX4)
    upload(b, plan(PX4))
    assert b.set_mode(VehicleMode.MISSION)[0] == 0
    assert b.vehicle.mode is VehicleMode.HOLD
    b.run(0.6)
    b.set_mode(VehicleMode.MISSION)
    assert b.vehicle.mode is VehicleMode.MISSION


def reached(b):
    return [m.seq for _, m in b.seen if m.get_type() == "MISSION_ITEM_REACHED"]


@BOTH
def test_mission_from_the_ground_to_the_ground(bench, firmware):
    b = bench(firmware)
    items = plan(firmware, wire(0, 178, p2=3.0), wire(0, 20, frame=2))
    upload(b, items)
    b.run(1.0)
    if firmware is AP:
        b.set_mode(VehicleMode.EXTERNAL)
        assert b.command(400, 1.0) == [0]
        assert b.command(300) == [0]
    else:
        b.set_mode(VehicleMode.MISSION)
        assert b.command(400, 1.0) == [0]
    b.run(15.0)
    assert b.vehicle.landed is Landed.TAKEOFF
    b.run(150.0)
    first = 1 if firmware is AP else 0
    assert reached(b) == list(range(first, len(items) - 1))
    assert b.vehicle.landed is Landed.ON_GROUND
    assert not b.vehicle.armed
    assert b.vehicle.position_ned_m == pytest.approx((0.0, 0.0, 0.0), abs=1.5)


@BOTH
def test_waypoints_are_passed_within_their_acceptance_radius(airborne, firmware):
    b = airborne(firmware)
    upload(b, plan(firmware))
    b.run(1.0)
    b.set_mode(VehicleMode.MISSION)
    passed = []
    while len(passed) < 3 and b.now_s < 120.0:
        b.run(0.1)
        if len(reached(b)) > len(passed):
            passed.append(b.vehicle.position_ned_m)
    assert math.dist(passed[1][:2], (100.0, 0.0)) < (2.5 if firmware is AP else 10.5)
    assert math.dist(passed[2][:2], (100.0, 60.0)) < (2.5 if firmware is AP else 10.5)
    b.run(2.0)
    assert b.vehicle.mode is (VehicleMode.MISSION if firmware is AP else VehicleMode.HOLD)
    current = b.vehicle._telemetry.builders[42](b.now_s)
    _, _, state, _ = mavlink.MAVLink_mission_current_message.unpacker.unpack(current.body)
    assert state == mavlink.MISSION_STATE_COMPLETE


@BOTH
def test_take_over_and_back_resumes_the_same_item(airborne, firmware):
    b = airborne(firmware)
    upload(b, plan(firmware))
    b.run(1.0)
    b.set_mode(VehicleMode.MISSION)
    b.run(8.0)
    seq = b.vehicle.mission_seq
    assert seq == (2 if firmware is AP else 1)
    b.in_external()
    b.run(3.0, 0.0, -5.0, 0.0)
    b.set_mode(VehicleMode.MISSION)
    assert b.vehicle.mission_seq == seq
    b.run(60.0)
    assert seq in reached(b)


@BOTH
def test_set_current_jumps(airborne, firmware):
    b = airborne(firmware)
    items = plan(firmware)
    upload(b, items)
    b.run(1.0)
    b.send(mavlink.MAVLink_mission_set_current_message(1, 1, len(items) - 1))
    b.set_mode(VehicleMode.MISSION)
    assert b.vehicle.mission_seq == len(items) - 1
    b.run(1.0)
    assert b.vehicle.velocity_ned_mps[1] > 0.5


def test_ardupilot_take_off_item_in_the_air_is_reached_at_once(airborne):
    b = airborne(AP)
    upload(b, plan(AP))
    b.set_mode(VehicleMode.MISSION)
    b.run(0.1)
    assert reached(b) == [1]
    assert [t for t in b.texts() if t.startswith("Mission")] == ["Mission: 1 Takeoff", "Mission: 2 WP"]


@BOTH
def test_speed_change_and_hold_time(airborne, firmware):
    b = airborne(firmware)
    first = 1 if firmware is AP else 0
    items = plan(firmware)[:first]
    items += [
        wire(0, 178, p2=3.0),
        wire(0, 16, 40.0, 0.01, 50.0, p1=5.0, p2=2.0),
        wire(0, 16, 40.0, 30.0, 50.0),
    ]
    for seq, item in enumerate(items):
        item.seq = seq
    upload(b, items)
    b.run(1.0)
    b.set_mode(VehicleMode.MISSION)
    b.run(6.0)
    assert b.speed == pytest.approx(3.0, abs=0.1)
    while b.vehicle.position_ned_m[0] < 38.1:
        b.run(0.1)
    b.run(4.5)
    assert abs(b.vehicle.position_ned_m[1]) < 0.5
    b.run(6.0)
    assert b.vehicle.position_ned_m[1] > 3.0


@BOTH
def test_land_item(airborne, firmware):
    b = airborne(firmware)
    items = plan(firmware)[:1]
    items = [*(items if firmware is AP else []), wire(0, 21, 20.0, 10.0, 0.0)]
    for seq, item in enumerate(items):
        item.seq = seq
    upload(b, items)
    b.run(1.0)
    b.set_mode(VehicleMode.MISSION)
    b.run(80.0)
    assert not b.vehicle.armed
    assert b.vehicle.position_ned_m == pytest.approx((20.0, 10.0, 0.0), abs=1.0)


@BOTH
def test_mission_in_the_options(airborne, firmware):
    lat, lon, _ = HOME.to_geodetic(50.0, 0.0, 0.0)
    item = MissionItem(seq=0, command=16, frame=6, lat_deg=lat, lon_deg=lon, alt_m=50.0)
    b = airborne(firmware, mission=(item,), start_mode=VehicleMode.MISSION)
    b.run(20.0)
    assert b.vehicle.position_ned_m[0] > 35.0
    with pytest.raises(ConfigError):
        airborne(firmware, mission=(MissionItem(seq=0, command=16, frame=1),))


@pytest.mark.parametrize(("firmware", "name"), [(AP, b"WPNAV_SPEED"), (PX4, b"MPC_XY_CRUISE")])
@pytest.mark.parametrize("value", [-500.0, 0.0, 2.0])
def test_a_senseless_cruise_parameter_never_flies_backwards(airborne, firmware, name, value):
    b = airborne(firmware)
    upload(b, plan(firmware))
    b.run(1.0)
    b.send(mavlink.MAVLink_param_set_message(1, 1, name, value, mavlink.MAV_PARAM_TYPE_REAL32))
    b.set_mode(VehicleMode.MISSION)
    b.run(4.0)
    assert b.vehicle.position_ned_m[0] >= 0.0
