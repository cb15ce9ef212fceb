"""Faults around the vehicle, and how each firmware reacts."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkWriter
from companion.errors import ConfigError
from companion.events import FenceArea, Firmware, MissionItem
from sitl_mocks.vehicle.firmware.behaviour import MANNERS, VehicleMode, with_quirks
from sitl_mocks.vehicle.mock_vehicle import VehicleOptions
from sitl_mocks.vehicle.real_time.server import options_of
from tests.support.place import HOME

AP, PX4 = Firmware.ARDUPILOT, Firmware.PX4
BOTH = pytest.mark.parametrize("firmware", [AP, PX4])


def area(*corners, inclusion=True, radius_m=None):
    points = tuple(HOME.to_geodetic(north, east, 0.0)[:2] for north, east in corners)
    return FenceArea(inclusion=inclusion, points=points, radius_m=radius_m)


SQUARE = area((-50.0, -50.0), (50.0, -50.0), (50.0, 50.0), (-50.0, 50.0))


def item(command, north=0.0, east=0.0, height=50.0, p1=0.0, p2=0.0):
    lat, lon, _ = HOME.to_geodetic(north, east, 0.0)
    return MissionItem(
        seq=0, command=command, frame=6, params=(p1, p2, 0.0, None), lat_deg=lat, lon_deg=lon, alt_m=height
    )


def kinds(messages, name):
    return [m for m in messages if m.get_type() == name]


# ---------------------------------------------------------------- fence


@pytest.mark.parametrize(
    ("firmware", "params", "mode"),
    [
        (AP, {"FENCE_ENABLE": 1.0}, VehicleMode.RTL),
        (AP, {"FENCE_ENABLE": 1.0, "FENCE_ACTION": 0.0}, VehicleMode.EXTERNAL),
        (AP, {"FENCE_ENABLE": 1.0, "FENCE_ACTION": 2.0}, VehicleMode.LAND),
        (AP, {"FENCE_ENABLE": 1.0, "FENCE_ACTION": 4.0}, VehicleMode.BRAKE),
        (AP, {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 3.0}, VehicleMode.EXTERNAL),
        (AP, {"FENCE_ENABLE": 0.0}, VehicleMode.EXTERNAL),
        (PX4, {}, VehicleMode.HOLD),
        (PX4, {"GF_ACTION": 1.0}, VehicleMode.EXTERNAL),
        (PX4, {"GF_ACTION": 3.0}, VehicleMode.RTL),
        (PX4, {"GF_ACTION": 5.0}, VehicleMode.LAND),
    ],
)
def test_the_fence_is_obeyed_as_its_parameters_say(airborne, firmware, params, mode):
    b = airborne(firmware, fence=(SQUARE,), parameters=params).in_external()
    b.run(7.0, 5.0, 0.0, 0.0)
    assert b.vehicle.mode is VehicleMode.EXTERNAL
    while b.vehicle.position_ned_m[0] <= 50.0:
        b.run(0.1, 5.0, 0.0, 0.0)
    b.run(0.2, 5.0, 0.0, 0.0)
    assert b.vehicle.mode is mode


@pytest.mark.parametrize(
    ("firmware", "params"),
    [
        (AP, {"FENCE_ENABLE": 1.0, "FENCE_RADIUS": 40.0}),
        (AP, {"FENCE_ENABLE": 1.0, "FENCE_ALT_MAX": 45.0}),
        (PX4, {"GF_MAX_HOR_DIST": 40.0}),
        (PX4, {"GF_MAX_VER_DIST": 45.0}),
    ],
)
def test_distance_from_home_and_height(bench, firmware, params):
    start = (41.0, 0.0, -46.0)
    b = bench(firmware, airborne=True, start_position_ned_m=start, parameters=params, start_mode=None)
    b.run(0.5)
    assert b.vehicle.failsafe
    b = bench(firmware, airborne=True, start_position_ned_m=(39.0, 0.0, -44.0), parameters=params)
    b.run(0.5)
    assert not b.vehicle.failsafe


def test_fence_status_and_texts_of_ardupilot(airborne):
    b = airborne(AP, fence=(SQUARE,), parameters={"FENCE_ENABLE": 1.0, "FENCE_ACTION": 0.0}).in_external()
    b.interval(mavlink.MAVLINK_MSG_ID_FENCE_STATUS, 5.0)
    before = kinds(b.run(1.0, 5.0, 0.0, 0.0), "FENCE_STATUS")[-1]
    assert (before.breach_status, before.breach_count, before.breach_type) == (0, 0, 0)
    b.run(12.0, 5.0, 0.0, 0.0)
    out = kinds(b.run(1.0, -5.0, 0.0, 0.0), "FENCE_STATUS")[-1]
    assert (out.breach_status, out.breach_count) == (1, 1)
    assert out.breach_type == mavlink.FENCE_BREACH_BOUNDARY
    assert "Polygon fence breached" in b.texts()
    b.run(10.0, -5.0, 0.0, 0.0)
    assert "Fence breach cleared" in b.texts()


def test_no_fence_status_without_a_fence_or_from_px4(airborne):
    assert airborne(AP).command(512, 162.0) == [mavlink.MAV_RESULT_FAILED]
    assert airborne(PX4).command(512, 162.0) == [mavlink.MAV_RESULT_DENIED]


def test_ardupilot_stays_in_every_inclusion_px4_in_one(airborne):
    other = area((0.0, 0.0), (90.0, 0.0), (90.0, 90.0), (0.0, 90.0))
    for firmware, out in ((AP, True), (PX4, False)):
        b = airborne(
            firmware,
            fence=(SQUARE, other),
            start_position_ned_m=(-20.0, -20.0, -50.0),
            parameters={"FENCE_ENABLE": 1.0} if firmware is AP else {},
        )
        b.run(0.3)
        assert b.vehicle.failsafe is out


@BOTH
def test_exclusion_circle(airborne, firmware):
    zone = area((0.0, 0.0), inclusion=False, radius_m=20.0)
    b = airborne(firmware, fence=(zone,), parameters={"FENCE_ENABLE": 1.0} if firmware is AP else {})
    b.run(0.3)
    assert b.vehicle.failsafe


def test_px4_gives_the_vehicle_back_outside_the_fence_when_asked(airborne):
    b = airborne(PX4, fence=(SQUARE,), start_position_ned_m=(60.0, 0.0, -50.0))
    b.run(1.0, -3.0, 0.0, 0.0)
    assert b.vehicle.failsafe
    b.set_mode(VehicleMode.EXTERNAL)
    b.run(6.0, -3.0, 0.0, 0.0)
    assert b.vehicle.mode is VehicleMode.EXTERNAL
    assert b.vehicle.position_ned_m[0] < 48.0


# ---------------------------------------------------------------- ground station


@pytest.mark.parametrize(
    ("firmware", "params", "mode", "after_s"),
    [
        (AP, {}, VehicleMode.EXTERNAL, 30.0),
        (AP, {"FS_GCS_ENABLE": 1.0}, VehicleMode.RTL, 5.0),
        (AP, {"FS_GCS_ENABLE": 5.0, "FS_GCS_TIMEOUT": 3.0}, VehicleMode.LAND, 3.0),
        (PX4, {}, VehicleMode.EXTERNAL, 30.0),
        (PX4, {"NAV_DLL_ACT": 1.0}, VehicleMode.HOLD, 10.0),
        (PX4, {"NAV_DLL_ACT": 2.0}, VehicleMode.RTL, 15.0),
    ],
)
def test_silence_of_the_ground_station(airborne, firmware, params, mode, after_s):
    b = airborne(firmware, parameters=params).in_external()
    station = MavlinkWriter(255, 190)
    beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 0, 3)
    b.vehicle.receive(station.pack(beat), b.now_s)
    heard_s = b.now_s
    while b.now_s - heard_s < after_s - 0.3:
        b.run(0.1, 1.0, 0.0, 0.0)
        expected = {VehicleMode.EXTERNAL}
        if firmware is PX4 and mode is VehicleMode.RTL and b.now_s - heard_s > 9.9:
            # It holds for COM_FAIL_ACT_T first.
            expected |= {VehicleMode.HOLD}
        assert b.vehicle.mode in expected
    b.run(0.6, 1.0, 0.0, 0.0)
    assert b.vehicle.mode is mode


@BOTH
def test_a_ground_station_never_heard_is_not_missed(airborne, firmware):
    params = {"FS_GCS_ENABLE": 1.0} if firmware is AP else {"NAV_DLL_ACT": 2.0}
    b = airborne(firmware, parameters=params).in_external()
    b.send(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_ONBOARD_CONTROLLER, 8, 0, 0, 0, 3))
    b.run(20.0, 1.0, 0.0, 0.0)
    assert b.vehicle.mode is VehicleMode.EXTERNAL


# ---------------------------------------------------------------- battery, estimator, GNSS


@BOTH
def test_battery_is_told_and_acts_where_it_was_told_to(airborne, firmware):
    low = {"BATT_LOW_MAH": 660.0, "BATT_FS_LOW_ACT": 1.0} if firmware is AP else {"COM_LOW_BAT_ACT": 2.0}
    for params, mode in (({}, VehicleMode.EXTERNAL), (low, VehicleMode.LAND)):
        b = airborne(firmware, parameters=params).in_external()
        b.interval(mavlink.MAVLINK_MSG_ID_SYS_STATUS, 5.0)
        b.interval(mavlink.MAVLINK_MSG_ID_BATTERY_STATUS, 5.0)
        assert kinds(b.run(0.5, 0.0, 0.0, 0.0), "SYS_STATUS")[-1].battery_remaining == 100
        b.vehicle.troubles.battery_remaining = 0.05
        seen = b.run(6.0, 0.0, 0.0, 0.0)
        assert kinds(seen, "SYS_STATUS")[-1].battery_remaining == 5
        assert kinds(seen, "BATTERY_STATUS")[-1].battery_remaining == 5
        assert b.vehicle.mode is mode


def test_px4_at_rest_on_the_ground_says_constant_position(bench, airborne):
    for make, flag in ((bench, mavlink.ESTIMATOR_CONST_POS_MODE), (airborne, 0)):
        b = make(PX4)
        b.interval(mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS, 5.0)
        told = kinds(b.run(0.5), "ESTIMATOR_STATUS")[-1]
        assert told.flags & mavlink.ESTIMATOR_CONST_POS_MODE == flag
        assert told.flags & mavlink.ESTIMATOR_POS_HORIZ_ABS


@pytest.mark.parametrize(("firmware", "name"), [(AP, "EKF_STATUS_REPORT"), (PX4, "ESTIMATOR_STATUS")])
def test_bad_estimator_ends_the_flight_by_position(airborne, firmware, name):
    b = airborne(firmware).in_external()
    number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
    assert b.interval(number, 5.0) == [0]
    good = kinds(b.run(0.5, 0.0, 0.0, 0.0), name)[-1]
    assert good.flags & mavlink.ESTIMATOR_POS_HORIZ_ABS
    b.vehicle.troubles.estimator_bad = True
    b.run(1.3, 0.0, 0.0, 0.0)
    assert b.vehicle.mode is VehicleMode.LAND
    bad = kinds(b.run(0.5, 0.0, 0.0, 0.0), name)[-1]
    assert not bad.flags & mavlink.ESTIMATOR_POS_HORIZ_ABS
    acks = b.set_mode(VehicleMode.EXTERNAL) + [m.result for m in kinds(b.run(0.1), "COMMAND_ACK")]
    assert acks == ([4] if firmware is AP else [0, 1])
    assert b.vehicle.mode is VehicleMode.LAND
    b.vehicle.troubles.estimator_bad = False
    b.run(0.5, 0.0, 0.0, 0.0)
    assert b.vehicle.mode is (VehicleMode.LAND if firmware is AP else VehicleMode.EXTERNAL)


def test_px4_returns_after_a_failsafe_to_the_take_off_and_not_to_the_mode_before_it(airborne):
    b = airborne(PX4)
    b.set_mode(VehicleMode.RTL)
    b.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, math.nan, math.nan, math.nan, 480.0)
    assert b.vehicle.mode is VehicleMode.TAKEOFF
    b.vehicle.troubles.estimator_bad = True
    b.run(1.8)
    assert b.vehicle.mode is VehicleMode.LAND
    b.vehicle.troubles.estimator_bad = False
    b.run(0.5)
    assert b.vehicle.mode is VehicleMode.TAKEOFF


@pytest.mark.parametrize(("firmware", "grace_s"), [(AP, 7.0), (PX4, 5.0)])
def test_gnss_loss_is_told_at_once_and_lands_later(airborne, firmware, grace_s):
    b = airborne(firmware).in_external()
    b.interval(mavlink.MAVLINK_MSG_ID_GPS_RAW_INT, 5.0)
    b.interval(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 5.0)
    b.vehicle.troubles.gnss_lost = True
    seen = b.run(grace_s - 0.3, 0.0, 0.0, 0.0)
    fix = kinds(seen, "GPS_RAW_INT")[-1]
    assert (fix.fix_type, fix.satellites_visible, fix.eph) == (1, 0, 0xFFFF)
    assert b.vehicle.mode is VehicleMode.EXTERNAL
    b.run(0.5, 0.0, 0.0, 0.0)
    assert b.vehicle.mode is VehicleMode.LAND
    after = kinds(b.run(1.0), "GLOBAL_POSITION_INT")
    assert bool(after) is (firmware is AP)


# ---------------------------------------------------------------- sticks, links, reboot


def test_sticks_are_told(airborne):
    b = airborne(AP)
    b.interval(mavlink.MAVLINK_MSG_ID_RC_CHANNELS, 5.0)
    b.vehicle.troubles.sticks = (0.5, -1.0, 0.0, 1.0)
    m = kinds(b.run(0.5), "RC_CHANNELS")[-1]
    assert (m.chan1_raw, m.chan2_raw, m.chan3_raw, m.chan4_raw) == (1750, 1000, 1500, 2000)
    b.vehicle.troubles.rc_connected = False
    assert not kinds(b.run(1.0), "RC_CHANNELS")


@pytest.mark.parametrize(
    ("firmware", "params", "mode"),
    [
        (AP, {}, VehicleMode.MISSION),
        (PX4, {}, VehicleMode.MISSION),
        (PX4, {"COM_RC_IN_MODE": 0.0}, VehicleMode.MANUAL),
        (PX4, {"COM_RC_IN_MODE": 0.0, "COM_RC_OVERRIDE": 0.0}, VehicleMode.MISSION),
    ],
)
def test_moved_sticks_end_px4s_mission(airborne, firmware, params, mode):
    b = airborne(firmware, mission=(item(16, 200.0),), parameters=params)
    b.set_mode(VehicleMode.MISSION)
    b.vehicle.troubles.sticks = (0.2, 0.0, 0.0, 0.0)
    b.run(1.0)
    assert b.vehicle.mode is VehicleMode.MISSION
    b.vehicle.troubles.sticks = (0.4, 0.0, 0.0, 0.0)
    b.run(1.0)
    assert b.vehicle.mode is mode


@BOTH
def test_a_cut_link_carries_nothing_either_way(airborne, firmware):
    b = airborne(firmware)
    b.vehicle.cut_link()
    assert b.set_mode(VehicleMode.RTL) == []
    assert b.run(3.0) == []
    assert b.vehicle.mode is VehicleMode.HOLD
    b.vehicle.mend_link()
    assert kinds(b.run(1.5), "HEARTBEAT")


@BOTH
def test_reboot_in_the_air_falls_or_flies_on(airborne, firmware):
    for flies_on in (False, True):
        b = airborne(firmware, start_position_ned_m=(0.0, 0.0, -150.0)).in_external()
        b.run(3.0, 4.0, 0.0, 0.0)
        b.vehicle.reboot(flies_on=flies_on)
        assert b.run(2.3) == []
        b.run(0.3)
        assert b.vehicle.armed is flies_on
        down = b.vehicle.position_ned_m[2]
        assert (down == pytest.approx(-150.0, abs=0.5)) if flies_on else (-130.0 < down < -100.0)
        assert b.vehicle.mode is MANNERS[firmware].boot_mode
        b.interval(mavlink.MAVLINK_MSG_ID_SYSTEM_TIME, 5.0)
        assert kinds(b.run(0.5), "SYSTEM_TIME")[-1].time_boot_ms < 1000
        b.run(6.0)
        assert (b.vehicle.position_ned_m[2] == 0.0) is not flies_on


# ---------------------------------------------------------------- quirks, missions


@BOTH
def test_a_quirk_changes_one_manner(airborne, firmware):
    b = airborne(firmware, quirks={"loss_mode": "hold", "nose_follows_velocity": True}).in_external()
    b.run(3.0, 0.0, 3.0, 0.0)
    assert b.vehicle.yaw_rad == pytest.approx(math.pi / 2, abs=0.05)
    b.run(4.0)
    assert b.vehicle.mode is VehicleMode.HOLD


@pytest.mark.parametrize(
    ("quirks", "words"),
    [
        ({"kindness": True}, "unknown name"),
        ({"nose_follows_velocity": 1.0}, "has the wrong type"),
        ({"loss_noticed_s": True}, "has the wrong type"),
        ({"custom_modes": {}}, "has the wrong type"),
        ({"loss_mode": "sleep"}, "not a mode of this firmware"),
    ],
)
def test_bad_quirks_are_named(quirks, words):
    with pytest.raises(ConfigError, match=words):
        with_quirks(MANNERS[AP], quirks)


def test_unknown_parameter_is_named():
    with pytest.raises(ConfigError, match="NO_SUCH"):
        VehicleOptions(parameters={"NO_SUCH": 1.0})


@pytest.mark.parametrize(("firmware", "speed"), [(AP, 10.0), (PX4, 3.0)])
def test_speed_of_the_mission_after_a_break(airborne, firmware, speed):
    """ArduPilot forgets DO_CHANGE_SPEED when it leaves AUTO; PX4 applies it again."""
    b = airborne(firmware, mission=(item(178, p1=1.0, p2=3.0), item(16, 400.0)))
    b.set_mode(VehicleMode.MISSION)
    b.run(6.0)
    seq = b.vehicle.mission_seq
    assert b.speed == pytest.approx(3.0, abs=0.1)
    b.in_external()
    b.run(3.0, 0.0, 3.0, 0.0)
    b.set_mode(VehicleMode.MISSION)
    b.run(8.0)
    assert b.vehicle.mission_seq == seq
    assert b.speed == pytest.approx(speed, abs=0.2)


def test_served_vehicle_takes_parameters_and_quirks():
    import argparse

    from sitl_mocks.vehicle.real_time import server as vehicle_server

    parser = argparse.ArgumentParser()
    vehicle_server.add_arguments(parser)
    options = options_of(
        parser.parse_args(
            [
                "--param",
                "FENCE_ENABLE=1",
                "--quirk",
                "nose_follows_velocity=false",
                "--quirk",
                "loss_mode=hold",
            ]
        )
    )
    assert options.parameters == {"FENCE_ENABLE": 1.0}
    assert not options.manners.nose_follows_velocity
    assert options.manners.loss_mode is VehicleMode.HOLD
    with pytest.raises(ConfigError, match="--param"):
        options_of(parser.parse_args(["--param", "FENCE_ENABLE"]))


@pytest.mark.parametrize(
    ("params", "options", "mode"),
    [
        ({}, {}, VehicleMode.RTL),
        ({"COM_RC_IN_MODE": 0.0}, {}, VehicleMode.MANUAL),
        ({"COM_RC_IN_MODE": 0.0}, {"rc_connected": False}, VehicleMode.RTL),
        ({"COM_OBL_RC_ACT": 4.0}, {}, VehicleMode.LAND),
        ({"COM_OBL_RC_ACT": 5.0}, {}, VehicleMode.HOLD),
    ],
)
def test_px4_without_setpoints_goes_where_its_parameters_and_the_radio_say(airborne, params, options, mode):
    b = airborne(PX4, parameters=params, **options).in_external()
    b.run(1.2)
    assert b.vehicle.mode is mode


def test_the_bold_quirks_can_be_switched_off(airborne, bench):
    b = airborne(AP, quirks={"needs_whole_velocity": False}).in_external()
    b.run(4.0, 0.0, 3.0, 0.0, mask=0xDC7 | 8)
    assert b.vehicle.velocity_ned_mps[1] == pytest.approx(3.0, abs=0.1)
    b = airborne(PX4, quirks={"stream_takes_back": False}).in_external()
    b.run(1.5)
    b.run(0.5, 1.0, 0.0, 0.0)
    assert b.vehicle.mode is VehicleMode.RTL
    for quirks, height_m in (({}, 15.0), ({"cancels_takeoff": False}, 30.0)):
        b = bench(AP, quirks=quirks)
        b.set_mode(VehicleMode.EXTERNAL)
        b.command(400, 1.0)
        b.command(22, 0, 0, 0, 0, 0, 0, 30.0)
        b.run(8.0)
        b.run(14.0, 0.0, 0.0, 0.0)
        assert (-b.vehicle.position_ned_m[2] > height_m - 0.5) is (height_m == 30.0)
