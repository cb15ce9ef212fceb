"""Modes, arming, take-off and landing, with each firmware's answers."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.errors import ConfigError
from companion.events import Firmware, Landed
from sitl_mocks.vehicle.firmware.behaviour import MANNERS, VehicleMode
from sitl_mocks.vehicle.mock_vehicle import VehicleOptions

AP, PX4 = Firmware.ARDUPILOT, Firmware.PX4
BOTH = pytest.mark.parametrize("firmware", [AP, PX4])
ARM, TAKEOFF, LAND, RTL, MODE = 400, 22, 21, 20, 176


@pytest.mark.parametrize(
    ("firmware", "mode", "number"),
    [
        (AP, VehicleMode.MANUAL, 0),
        (AP, VehicleMode.MISSION, 3),
        (AP, VehicleMode.EXTERNAL, 4),
        (AP, VehicleMode.HOLD, 5),
        (AP, VehicleMode.RTL, 6),
        (AP, VehicleMode.LAND, 9),
        (AP, VehicleMode.BRAKE, 17),
        (PX4, VehicleMode.EXTERNAL, 0x00060000),
        (PX4, VehicleMode.HOLD, 0x03040000),
        (PX4, VehicleMode.MISSION, 0x04040000),
        (PX4, VehicleMode.RTL, 0x05040000),
        (PX4, VehicleMode.TAKEOFF, 0x02040000),
    ],
)
def test_mode_numbers(firmware, mode, number):
    assert MANNERS[firmware].custom_modes[mode] == number
    assert MANNERS[firmware].mode_of(number) is mode


@BOTH
def test_heartbeat_shows_mode_and_arming(airborne, firmware):
    b = airborne(firmware).in_external()
    beats = [m for m in b.run(1.5, 0.0, 0.0, 0.0) if m.get_type() == "HEARTBEAT"]
    assert beats[-1].custom_mode == b.vehicle.custom_mode
    assert beats[-1].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert beats[-1].autopilot == (3 if firmware is AP else 12)


def test_ardupilot_refuses_a_bad_mode_with_ack_4_and_text(airborne):
    b = airborne(AP)
    assert b.command(MODE, 1.0, 99.0) == [4]
    assert any("No such mode" in text for text in b.texts())


def test_px4_acks_offboard_without_a_stream_and_does_not_enter(airborne):
    b = airborne(PX4)
    assert b.set_mode(VehicleMode.EXTERNAL)[0] == 0
    b.run(1.0)
    assert b.vehicle.mode is VehicleMode.HOLD


def test_px4_acks_an_unknown_mode_and_does_not_enter(airborne):
    b = airborne(PX4)
    assert b.command(MODE, 1.0, 99.0, 0.0)[0] == 0
    assert b.vehicle.mode is VehicleMode.HOLD


def test_px4_offboard_needs_the_stream_first(airborne):
    b = airborne(PX4)
    b.run(0.5, 0.0, 0.0, 0.0)
    assert b.set_mode(VehicleMode.EXTERNAL) == [0, 0]
    assert b.vehicle.mode is VehicleMode.EXTERNAL


@pytest.mark.parametrize(("firmware", "acks"), [(AP, [0]), (PX4, [])])
def test_old_set_mode_message(airborne, firmware, acks):
    b = airborne(firmware)
    number = MANNERS[firmware].custom_modes[VehicleMode.RTL]
    answers = b.send(mavlink.MAVLink_set_mode_message(1, 1, number))
    assert b.vehicle.mode is VehicleMode.RTL
    assert [m.result for m in answers if m.get_type() == "COMMAND_ACK" and m.command == 11] == acks


@BOTH
def test_mode_without_the_custom_flag_is_denied(airborne, firmware):
    b = airborne(firmware)
    assert b.command(MODE, 0.0, 4.0, 4.0)[-1] == mavlink.MAV_RESULT_DENIED
    assert b.command(MODE, math.nan, 4.0)[-1] == mavlink.MAV_RESULT_DENIED
    assert b.vehicle.mode is VehicleMode.HOLD


@BOTH
def test_foreign_command_is_not_answered(airborne, firmware):
    b = airborne(firmware)
    assert b.command(RTL, target=(7, 1)) == []
    assert b.command(RTL, target=(1, 154)) == []
    assert b.vehicle.mode is VehicleMode.HOLD
    assert b.command(RTL, target=(0, 0)) == [0]


@BOTH
def test_unsupported_command(airborne, firmware):
    assert airborne(firmware).command(31010) == [mavlink.MAV_RESULT_UNSUPPORTED]


def test_ardupilot_arming_is_refused_until_ready_and_the_reason_is_only_text(bench):
    b = bench(AP, arming_ready_s=30.0)
    b.run(1.0)
    assert b.command(ARM, 1.0) == [4]
    assert "Arm: Need Position Estimate" in b.texts()
    b.run(30.0)
    assert b.command(ARM, 1.0) == [0]
    assert b.vehicle.armed


def test_px4_arming_is_denied_in_offboard_and_granted_in_hold(bench):
    b = bench(PX4)
    b.run(0.5, 0.0, 0.0, 0.0)
    b.set_mode(VehicleMode.EXTERNAL)
    assert b.command(ARM, 1.0) != [0]
    b.set_mode(VehicleMode.HOLD)
    assert b.command(ARM, 1.0) == [0]


@BOTH
def test_disarming_in_the_air_needs_force_and_then_it_falls(airborne, firmware):
    b = airborne(firmware)
    assert b.command(ARM, 0.0) != [0]
    assert b.vehicle.armed
    assert b.command(ARM, 0.0, 21196.0) == [0]
    b.run(6.0)
    assert b.vehicle.position_ned_m[2] == 0.0
    assert b.vehicle.landed is Landed.ON_GROUND


def _up(b, height_m=30.0):
    if b.firmware is AP:
        b.set_mode(VehicleMode.EXTERNAL)
        assert b.command(ARM, 1.0) == [0]
        return b.command(TAKEOFF, 0, 0, 0, 0, 0, 0, height_m)
    assert b.command(ARM, 1.0) == [0]
    return b.command(TAKEOFF, 0, 0, 0, math.nan, math.nan, math.nan, 400.0 + height_m)


@pytest.mark.parametrize(("firmware", "low_s", "high_s"), [(AP, 14.0, 22.0), (PX4, 16.0, 23.0)])
def test_take_off_to_30_m(bench, firmware, low_s, high_s):
    b = bench(firmware)
    assert _up(b) == [0]
    b.run(low_s)
    assert b.vehicle.landed is Landed.TAKEOFF
    b.run(high_s - low_s)
    assert b.vehicle.landed is Landed.IN_AIR
    assert b.vehicle.position_ned_m[2] == pytest.approx(-30.0, abs=0.5)
    assert b.vehicle.mode is (VehicleMode.EXTERNAL if firmware is AP else VehicleMode.HOLD)


@BOTH
def test_spin_up_keeps_it_on_the_ground(bench, firmware):
    b = bench(firmware)
    _up(b)
    b.run(3.4)
    assert b.vehicle.landed is Landed.ON_GROUND
    b.run(3.5)
    assert b.vehicle.landed is Landed.TAKEOFF


def test_px4_take_off_without_an_altitude_takes_the_parameters(bench):
    b = bench(PX4)
    b.send(mavlink.MAVLink_param_set_message(1, 1, b"MIS_TAKEOFF_ALT", 6.0, 9))
    _up(b, math.nan)
    b.run(15.0)
    assert b.vehicle.position_ned_m[2] == pytest.approx(-6.0, abs=0.5)


def test_ardupilot_take_off_without_an_altitude_is_refused(bench):
    assert _up(bench(AP), math.nan) == [4]


def test_ardupilot_velocity_setpoint_after_lift_off_cancels_the_take_off(bench):
    b = bench(AP)
    _up(b)
    b.run(3.0, 0.0, 0.0, 0.0)
    b.run(7.0)
    assert b.vehicle.landed is Landed.TAKEOFF
    b.run(20.0, 1.0, 0.0, 0.0)
    assert b.vehicle.landed is Landed.IN_AIR
    assert b.vehicle.position_ned_m[2] > -20.0
    assert b.vehicle.velocity_ned_mps[0] == pytest.approx(1.0, abs=0.05)


def test_ardupilot_second_take_off_in_the_air_is_refused(bench):
    b = bench(AP)
    _up(b)
    b.run(22.0)
    assert b.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 40.0) == [4]


def test_ardupilot_take_off_needs_guided_and_arming(bench):
    b = bench(AP)
    assert b.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 30.0) == [4]
    b.set_mode(VehicleMode.EXTERNAL)
    assert b.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 30.0) == [4]


def test_ardupilot_setpoint_on_the_ground_does_not_lift(bench):
    b = bench(AP)
    b.set_mode(VehicleMode.EXTERNAL)
    b.command(ARM, 1.0)
    b.run(8.0, 0.0, 0.0, -2.0)
    assert b.vehicle.landed is Landed.ON_GROUND


@BOTH
def test_land_command_lands_and_disarms(airborne, firmware):
    b = airborne(firmware, start_position_ned_m=(3.0, 4.0, -12.0))
    assert b.command(LAND) == [0]
    b.run(30.0)
    assert b.vehicle.landed is Landed.ON_GROUND
    assert not b.vehicle.armed
    assert b.vehicle.position_ned_m == pytest.approx((3.0, 4.0, 0.0), abs=0.1)


@BOTH
def test_rtl_flies_home_and_lands(airborne, firmware):
    b = airborne(firmware, start_position_ned_m=(60.0, -20.0, -10.0))
    assert b.command(RTL) == [0]
    highest = 0.0
    for _ in range(100):
        b.run(1.0)
        highest = min(highest, b.vehicle.position_ned_m[2])
    assert -highest == pytest.approx(15.0 if firmware is AP else 30.0, abs=1.0)
    assert b.vehicle.position_ned_m == pytest.approx((0.0, 0.0, 0.0), abs=1.5)
    assert not b.vehicle.armed


def test_ardupilot_flown_into_the_ground_stays_armed_and_land_disarms(airborne):
    b = airborne(AP, start_position_ned_m=(0.0, 0.0, -6.0)).in_external()
    b.run(15.0, 0.0, 0.0, 3.0)
    assert b.vehicle.landed is Landed.ON_GROUND
    assert any("Hit ground" in text for text in b.texts())
    assert b.vehicle.armed
    assert b.vehicle.mode is VehicleMode.EXTERNAL
    b.command(LAND)
    b.run(1.0)
    assert not b.vehicle.armed


def test_px4_disarms_itself_in_offboard_4_s_after_touch_down_2_s_after_it_has_noticed(airborne):
    b = airborne(PX4, start_position_ned_m=(0.0, 0.0, -1.0)).in_external()
    while b.vehicle.landed is not Landed.ON_GROUND:
        b.run(0.1, 0.0, 0.0, 1.0)
    b.run(1.8, 0.0, 0.0, 1.0)
    assert b.vehicle.armed
    b.run(0.5, 0.0, 0.0, 1.0)
    assert not b.vehicle.armed


def test_ardupilot_loiter_without_rc_descends_and_brake_is_safe(airborne):
    b = airborne(AP, rc_connected=False)
    b.run(4.0)
    assert b.vehicle.velocity_ned_mps[2] > 2.0
    b.set_mode(VehicleMode.BRAKE)
    b.run(5.0)
    assert b.vehicle.velocity_ned_mps[2] == pytest.approx(0.0, abs=0.01)
    held = airborne(AP)
    held.run(4.0)
    assert held.vehicle.position_ned_m == (0.0, 0.0, -50.0)


@BOTH
def test_pilot_takes_the_vehicle_away(airborne, firmware):
    b = airborne(firmware).in_external()
    assert b.vehicle.pilot_selects(VehicleMode.MANUAL)
    b.run(5.0, 5.0, 0.0, 0.0)
    assert b.vehicle.mode is VehicleMode.MANUAL
    assert b.speed < 0.05


def test_ardupilot_shows_a_mode_change_at_once(airborne):
    b = airborne(AP)
    b.run(1.3)
    b.seen.clear()
    b.set_mode(VehicleMode.EXTERNAL)
    assert [m.custom_mode for _, m in b.seen if m.get_type() == "HEARTBEAT"] == [4]


@BOTH
def test_hold_at_the_start_brakes(airborne, firmware):
    b = airborne(firmware, start_velocity_ned_mps=(5.0, 0.0, 0.0))
    b.run(5.0)
    assert b.vehicle.mode is VehicleMode.HOLD
    assert b.speed < 0.05


@BOTH
def test_same_inputs_same_flight(airborne, firmware):
    def fly():
        b = airborne(firmware, gnss_horizontal_sigma_m=1.0).in_external()
        b.run(3.0, 3.0, 1.0, 0.0)
        return b.vehicle.position_ned_m, [m.get_msgbuf() for _, m in b.seen]

    assert fly() == fly()


@pytest.mark.parametrize(
    "wrong",
    [
        {"system_id": 0},
        {"gnss_horizontal_sigma_m": -1.0},
        {"velocity_lag_s": 0.0},
        {"airborne": True},
        {"start_mode": VehicleMode.TAKEOFF},
        {"wind_ned_mps": (math.nan, 0.0, 0.0)},
        {"home_lat_deg": math.nan},
    ],
)
def test_options_out_of_range_are_refused(wrong):
    with pytest.raises(ConfigError):
        VehicleOptions(**wrong)
