"""Velocity setpoints: what each firmware flies, ignores and stops at, and what follows their loss."""

from __future__ import annotations

import math

import pytest

from companion.events import Firmware
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode

AP, PX4 = Firmware.ARDUPILOT, Firmware.PX4
BOTH = pytest.mark.parametrize("firmware", [AP, PX4])


@BOTH
def test_velocity_is_flown(airborne, firmware):
    b = airborne(firmware).in_external()
    b.run(6.0, 3.0, -4.0, 0.0)
    assert b.vehicle.velocity_ned_mps == pytest.approx((3.0, -4.0, 0.0), abs=0.05)


def test_ardupilot_reaches_5_mps_in_3_s_and_reverses_over_7_m(airborne):
    b = airborne(AP).in_external()
    b.run(3.0, 5.0, 0.0, 0.0)
    assert 4.5 < b.speed <= 5.0
    b.run(5.0, 5.0, 0.0, 0.0)
    before = b.vehicle.position_ned_m[0]
    furthest = before
    for _ in range(50):
        b.run(0.1, -5.0, 0.0, 0.0)
        furthest = max(furthest, b.vehicle.position_ned_m[0])
    assert 6.5 < furthest - before < 8.5
    assert b.vehicle.velocity_ned_mps[0] < -4.5


@BOTH
def test_acceleration_stays_within_the_limit(airborne, firmware):
    b = airborne(firmware).in_external()
    before = b.vehicle.velocity_ned_mps
    for velocity in ((9.0, 0.0), (-9.0, 4.0), (0.0, -9.0)):
        for _ in range(40):
            b.run(0.1, *velocity, 0.0)
            now = b.vehicle.velocity_ned_mps
            assert math.hypot(now[0] - before[0], now[1] - before[1]) <= 0.25 + 1e-9
            before = now


@pytest.mark.parametrize(("firmware", "cap"), [(AP, 10.0), (PX4, 12.0)])
def test_speed_is_capped(airborne, firmware, cap):
    b = airborne(firmware).in_external()
    b.run(12.0, 20.0, 0.0, 0.0)
    assert b.speed == pytest.approx(cap, abs=0.05)


def test_px4_caps_climb_at_3_and_descent_at_1_5(airborne):
    b = airborne(PX4).in_external()
    b.run(4.0, 0.0, 0.0, -10.0)
    assert b.vehicle.velocity_ned_mps[2] == pytest.approx(-3.0, abs=0.05)
    b.run(4.0, 0.0, 0.0, 10.0)
    assert b.vehicle.velocity_ned_mps[2] == pytest.approx(1.5, abs=0.05)


@BOTH
@pytest.mark.parametrize("mask", [0xDC7 | 8, 0xDC7 | 16, 0xDC7 | 32])
def test_any_single_ignored_axis_stops(airborne, firmware, mask):
    b = airborne(firmware).in_external()
    b.run(4.0, 0.0, 3.0, 0.0)
    b.run(5.0, 0.0, 3.0, 0.0, mask=mask)
    assert b.vehicle.mode is VehicleMode.EXTERNAL
    assert b.speed < 0.05


@BOTH
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_not_a_number_stops_and_stays(airborne, firmware, bad):
    b = airborne(firmware).in_external()
    b.run(4.0, 4.0, 0.0, 0.0)
    b.run(5.0, bad, 0.0, 0.0)
    assert b.vehicle.mode is VehicleMode.EXTERNAL
    assert b.speed < 0.05
    assert all(map(math.isfinite, b.vehicle.position_ned_m))


@pytest.mark.parametrize("frame", [1, 7])
def test_ardupilot_local_frames(airborne, frame):
    b = airborne(AP, start_yaw_rad=math.pi / 2).in_external()
    b.run(4.0, 3.0, 0.0, 0.0, frame=frame)
    assert b.vehicle.velocity_ned_mps[0] == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize(("firmware", "frame"), [(AP, 8), (AP, 9), (PX4, 8)])
def test_body_frames_turn_with_the_nose(airborne, firmware, frame):
    b = airborne(firmware, start_yaw_rad=math.pi / 2).in_external()
    b.run(4.0, 3.0, 0.0, 0.0, frame=frame)
    assert b.vehicle.velocity_ned_mps[1] == pytest.approx(3.0, abs=0.1)


def test_ardupilot_stops_at_an_unknown_frame(airborne):
    b = airborne(AP).in_external()
    b.run(4.0, 3.0, 0.0, 0.0)
    b.run(4.0, 3.0, 0.0, 0.0, frame=12)
    assert b.vehicle.mode is VehicleMode.EXTERNAL
    assert b.speed < 0.05


@pytest.mark.parametrize("frame", [7, 9, 12])
def test_px4_ignores_other_frames_and_the_loss_follows(airborne, frame):
    b = airborne(PX4).in_external()
    b.run(0.9, 3.0, 0.0, 0.0, frame=frame)
    assert b.vehicle.mode is VehicleMode.EXTERNAL
    b.run(0.3, 3.0, 0.0, 0.0, frame=frame)
    assert b.vehicle.mode is VehicleMode.RTL
    assert b.vehicle.failsafe


@BOTH
def test_foreign_target_is_ignored(airborne, firmware):
    b = airborne(firmware).in_external()
    b.run(0.8, 0.0, 4.0, 0.0, target=(77, 1))
    assert b.speed < 0.05
    assert b.vehicle.setpoints_received == 20  # Those of in_external.


@BOTH
def test_target_zero_is_everybody(airborne, firmware):
    b = airborne(firmware).in_external()
    b.run(4.0, 0.0, 4.0, 0.0, target=(0, 0))
    assert b.vehicle.velocity_ned_mps[1] == pytest.approx(4.0, abs=0.1)


@BOTH
def test_outside_external_setpoints_change_nothing(airborne, firmware):
    b = airborne(firmware)
    b.run(3.0, 4.0, 0.0, 0.0)
    assert b.speed == 0.0
    assert b.vehicle.mode is VehicleMode.HOLD


def test_entering_guided_zeroes_the_target(airborne):
    b = airborne(AP).in_external()
    b.run(4.0, 4.0, 0.0, 0.0)
    b.set_mode(VehicleMode.HOLD)
    b.run(0.1, 4.0, 0.0, 0.0)
    b.set_mode(VehicleMode.EXTERNAL)
    b.run(4.0)
    assert b.speed < 0.05


def test_ardupilot_flies_on_3_s_after_the_last_setpoint_then_brakes_and_stays_guided(airborne):
    b = airborne(AP).in_external()
    b.run(8.0, 5.0, 0.0, 0.0)
    said = len(b.texts())
    at = b.vehicle.position_ned_m[0]
    b.run(2.9)
    assert b.speed > 4.9
    b.run(3.1)
    assert b.speed < 0.3
    assert 18.0 < b.vehicle.position_ned_m[0] - at < 24.0
    assert b.vehicle.mode is VehicleMode.EXTERNAL
    assert len(b.texts()) == said


def test_ardupilot_is_content_with_1_hz(airborne):
    b = airborne(AP).in_external()
    b.run(10.0, 5.0, 0.0, 0.0, rate_hz=1.0)
    assert b.speed == pytest.approx(5.0, abs=0.05)


def test_px4_goes_home_1_s_after_the_last_setpoint_and_comes_back_with_them(airborne):
    b = airborne(PX4, start_position_ned_m=(200.0, 0.0, -50.0)).in_external()
    b.run(3.0, 5.0, 0.0, 0.0)
    b.run(0.9)
    assert b.vehicle.mode is VehicleMode.EXTERNAL
    b.run(0.2)
    assert b.vehicle.mode is VehicleMode.RTL
    b.run(4.0)
    assert b.vehicle.velocity_ned_mps[0] < -3.0
    b.run(0.1, 5.0, 0.0, 0.0)
    assert b.vehicle.mode is VehicleMode.EXTERNAL
    assert not b.vehicle.failsafe


def test_px4_swings_at_1_hz_and_flies_at_3_hz(airborne):
    b = airborne(PX4).in_external()
    modes = []
    for tick in range(60):
        if tick % 10 == 0:
            b.setpoint(5.0, 0.0, 0.0)
        b.run(0.1)
        modes.append(b.vehicle.mode)
    assert modes.count(VehicleMode.RTL) > 3
    assert modes.count(VehicleMode.EXTERNAL) > 30
    b.setpoint(5.0, 0.0, 0.0)
    for _ in range(30):
        b.run(1 / 3, 5.0, 0.0, 0.0, rate_hz=3.0)
        assert b.vehicle.mode is VehicleMode.EXTERNAL


def test_px4_lets_go_only_when_the_stream_stops_or_a_mode_is_asked(airborne):
    b = airborne(PX4).in_external()
    b.set_mode(VehicleMode.HOLD)
    b.run(3.0, 5.0, 0.0, 0.0)
    assert b.vehicle.mode is VehicleMode.HOLD


def test_height_from_position_with_horizontal_velocity(airborne):
    px4 = airborne(PX4).in_external()
    px4.run(10.0, 0.0, 3.0, 0.0, mask=0xDE3, place=(0.0, 0.0, -55.0))
    assert px4.vehicle.position_ned_m[2] == pytest.approx(-55.0, abs=0.5)
    assert px4.vehicle.velocity_ned_mps[1] == pytest.approx(3.0, abs=0.1)
    ap = airborne(AP).in_external()
    ap.run(5.0, 0.0, 3.0, 0.0, mask=0xDE3, place=(0.0, 0.0, -55.0))
    assert ap.speed < 0.05
    assert ap.vehicle.position_ned_m[2] == pytest.approx(-50.0, abs=0.1)


def test_ardupilot_overspeeds_with_position_and_velocity(airborne):
    b = airborne(AP).in_external()
    b.run(4.0, 2.0, 0.0, 0.0, mask=0xDC0, place=(100.0, 0.0, -50.0))
    assert b.speed > 3.0


@pytest.mark.parametrize(
    ("firmware", "mask", "turns"), [(AP, 0xDC7, True), (AP, 0x5C7, False), (PX4, 0xDC7, False)]
)
def test_nose(airborne, firmware, mask, turns):
    b = airborne(firmware).in_external()
    b.run(5.0, 0.0, 4.0, 0.0, mask=mask)
    assert b.vehicle.yaw_rad == pytest.approx(math.pi / 2 if turns else 0.0, abs=0.05)


@BOTH
def test_start_in_external_flies_the_start_velocity_until_the_timeout(airborne, firmware):
    b = airborne(firmware, start_mode=VehicleMode.EXTERNAL, start_velocity_ned_mps=(5.0, 0.0, 0.0))
    b.run(0.9)
    assert b.vehicle.position_ned_m[0] == pytest.approx(4.5, abs=0.01)
    b.run(4.0, 5.0, 0.0, 0.0)
    assert b.vehicle.mode is VehicleMode.EXTERNAL


@BOTH
def test_setpoint_counters(airborne, firmware):
    b = airborne(firmware)
    b.run(1.0, 0.0, 0.0, 0.0)
    b.run(0.74)
    b.run(0.1, 0.0, 0.0, 0.0)
    assert b.vehicle.setpoints_received == 22
    assert b.vehicle.largest_setpoint_gap_s == pytest.approx(0.78, abs=0.021)


def test_wind_stronger_than_the_airspeed_blows_the_vehicle_away(airborne):
    b = airborne(AP, wind_ned_mps=(0.0, 6.0, 0.0), max_airspeed_mps=5.0).in_external()
    b.run(8.0, 0.0, 0.0, 0.0)
    assert b.vehicle.velocity_ned_mps[1] == pytest.approx(1.0, abs=0.05)
    b = airborne(AP, wind_ned_mps=(0.0, 6.0, 0.0)).in_external()
    b.run(8.0, 5.0, 0.0, 0.0)
    assert b.vehicle.velocity_ned_mps == pytest.approx((5.0, 0.0, 0.0), abs=0.05)
