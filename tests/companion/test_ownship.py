"""Own state: clocks, freshness, what it refuses to be flown on."""

from __future__ import annotations

import msgspec
import pytest

from companion.events import (
    AirPressure,
    ClockRead,
    CurrentMode,
    Firmware,
    FlightMode,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    Landed,
    LandedState,
    LocalPosition,
    VehicleTime,
)
from companion.ownship import Ownship, pressure_altitude_m


def position(time_boot_s, lat_deg=47.0, velocity=(1.0, 0.0, 0.0)):
    return GlobalPosition(
        time_boot_s=time_boot_s,
        lat_deg=lat_deg,
        lon_deg=8.0,
        alt_msl_m=450.0,
        height_above_home_m=50.0,
        velocity_ned_mps=velocity,
    )


def armed():
    own = Ownship()
    own.observe(
        Heartbeat(
            system_id=1,
            firmware=Firmware.PX4,
            vehicle_type=2,
            custom_mode=0,
            mode=FlightMode.EXTERNAL,
            armed=True,
        ),
        0.0,
    )
    return own


def test_utc_is_unknown_until_the_vehicle_knows_it():
    own = Ownship()
    own.observe(VehicleTime(time_boot_s=5.0, utc_s=None), 1.0)
    assert own.utc_offset_s is None
    own.observe(VehicleTime(time_boot_s=6.0, utc_s=1000.0), 2.0)
    assert own.utc_offset_s == pytest.approx(998.0, abs=0.01)


def test_utc_is_the_vehicles_whatever_the_links_delay():
    own = armed()
    own.observe(VehicleTime(time_boot_s=0.0, utc_s=1000.0), 10.0)
    own.observe(VehicleTime(time_boot_s=1.0, utc_s=1001.0), 14.8)
    assert own.utc_offset_s == pytest.approx(990.0, abs=0.01)
    own.observe(VehicleTime(time_boot_s=5.0, utc_s=987.0), 15.0)
    assert own.utc_offset_s == pytest.approx(972.0, abs=0.01)


def test_a_position_is_dated_by_the_autopilots_clock_not_by_its_arrival():
    own = armed()
    own.observe(VehicleTime(time_boot_s=0.0, utc_s=1000.0), 10.0)
    own.observe(position(0.5), 10.9)
    assert own.sample_s() == pytest.approx(10.5, abs=0.01)
    assert own.age_s(11.0) == pytest.approx(0.5, abs=0.01)
    assert own.position_ned_m(11.0)[0] == pytest.approx(0.5, abs=0.01)


def test_a_link_that_grows_slow_shows_as_age():
    own = armed()
    for k in range(100):
        own.observe(position(0.1 * k), 0.1 * k + min(0.08 * k, 6.0))
    assert own.age_s(9.9 + 6.0) == pytest.approx(6.0, abs=0.05)


def test_a_reboot_begins_a_new_clock_and_is_not_trusted_at_once():
    own = Ownship()
    own.observe(VehicleTime(time_boot_s=500.0, utc_s=1000.0), 10.0)
    own.observe(
        LocalPosition(time_boot_s=500.0, position_ned_m=(0, 0, 0), velocity_ned_mps=(9.0, 0, 0)), 10.0
    )
    own.observe(position(500.0), 10.0)
    own.observe(position(1.0), 20.0)
    assert own.velocity_ned_mps == (1.0, 0.0, 0.0)
    assert own.age_s(20.1) == pytest.approx(0.1)
    assert own.utc_offset_s is None


def test_an_old_message_after_newer_ones_is_no_restart_and_no_position_of_now():
    own = armed()
    own.observe(VehicleTime(time_boot_s=500.0, utc_s=1000.0), 10.0)
    own.observe(position(501.5, lat_deg=47.0002), 11.5)
    own.observe(position(500.1, lat_deg=47.0), 11.6)
    assert own.sample_s() == pytest.approx(11.5)
    assert own.position.lat_deg == 47.0002
    assert own.utc_offset_s == pytest.approx(990.0)
    own.observe(GnssFix(fix_type=3, lat_deg=47.0, lon_deg=8.0, alt_msl_m=400.0), 11.6)
    own.observe(own.heartbeat, 11.6)
    assert own.unfit(11.6, 1.0) == "old messages of the autopilot arrive after newer ones"


def test_a_position_that_a_newer_one_has_overtaken_does_not_replace_it():
    own = armed()
    own.observe(position(1.0), 1.0)
    own.observe(position(0.4, lat_deg=47.1), 1.1)
    assert (own.position.time_boot_s, own.unfit(1.1, 1.0)) == (1.0, "no GNSS report for 3 s")


@pytest.mark.parametrize("boot_s", [495.0, 1.0])
def test_a_clock_that_went_back_and_shows_no_newer_time_has_restarted(boot_s):
    """The newer time may have been wrong."""
    own = armed()
    own.observe(position(500.0), 10.0)
    for k in range(12):
        own.observe(position(boot_s + 0.1 * k), 10.1 + 0.1 * k)
    assert own.sample_s() == pytest.approx(11.2)
    assert own.position.time_boot_s == pytest.approx(boot_s + 1.1)


def test_landed_is_forgotten_when_it_is_not_repeated():
    own = Ownship()
    own.observe(LandedState(landed=Landed.IN_AIR), 10.0)
    assert own.landed(12.0) is Landed.IN_AIR
    assert own.landed(14.0) is Landed.UNDEFINED


def test_a_landing_of_an_armed_vehicle_takes_more_than_one_message():
    own = armed()
    own.observe(position(0.0, velocity=(0.0, 0.0, 0.0)), 10.0)
    for k, landed in enumerate((Landed.IN_AIR, *[Landed.ON_GROUND] * 3, Landed.IN_AIR)):
        own.observe(LandedState(landed=landed), 11.0 + k)
        assert own.landed(11.0 + k) is Landed.IN_AIR, "3 s, but 50 m above home"
    for k in range(10):
        own.observe(LandedState(landed=Landed.ON_GROUND), 16.0 + k)
    assert own.landed(25.0) is Landed.IN_AIR
    own.observe(LandedState(landed=Landed.ON_GROUND), 26.0)
    assert own.landed(26.0) is Landed.ON_GROUND


def test_a_landing_that_was_not_seen_is_not_taken_for_flight():
    own = armed()
    own.observe(LandedState(landed=Landed.IN_AIR), 10.0)
    own.observe(LandedState(landed=Landed.ON_GROUND), 40.0)
    assert own.landed(40.0) is Landed.UNDEFINED
    own.observe(LandedState(landed=Landed.ON_GROUND), 41.0)
    own.observe(LandedState(landed=Landed.ON_GROUND), 42.0)
    assert own.landed(42.0) is Landed.ON_GROUND


def test_the_newer_velocity_counts():
    own = Ownship()
    own.observe(position(1.0), 1.0)
    own.observe(LocalPosition(time_boot_s=1.1, position_ned_m=(0, 0, 0), velocity_ned_mps=(2.0, 0, 0)), 1.1)
    assert own.velocity_ned_mps == (2.0, 0.0, 0.0)
    own.observe(LocalPosition(time_boot_s=0.9, position_ned_m=(0, 0, 0), velocity_ned_mps=(3.0, 0, 0)), 1.2)
    assert own.velocity_ned_mps == (2.0, 0.0, 0.0)


def test_geoid_separation_only_where_the_receiver_gives_both_altitudes():
    own = Ownship()
    fix = {"fix_type": 3, "lat_deg": 47.0, "lon_deg": 8.0, "alt_msl_m": 400.0}
    own.observe(GnssFix(**fix), 1.0)
    assert own.separation_m is None
    own.observe(GnssFix(**fix, alt_ellipsoid_m=447.5), 2.0)
    assert own.separation_m == 47.5


@pytest.mark.parametrize("alt_ellipsoid_m", [-8.0, 1400.0])
def test_a_geoid_that_is_nowhere_on_earth_is_not_believed(alt_ellipsoid_m):
    """It would tell the heights of all others wrongly by as much."""
    own = Ownship()
    fix = {"fix_type": 3, "lat_deg": 47.0, "lon_deg": 8.0, "alt_msl_m": 400.0}
    own.observe(GnssFix(**fix, alt_ellipsoid_m=447.5), 1.0)
    own.observe(GnssFix(**fix, alt_ellipsoid_m=alt_ellipsoid_m), 2.0)
    assert own.separation_m is None


def test_a_velocity_dated_far_ahead_does_not_shut_out_those_after_it():
    own = Ownship()
    own.observe(position(100.0), 1.0)
    ahead = LocalPosition(time_boot_s=4e6, position_ned_m=(0, 0, 0), velocity_ned_mps=(-9.0, 0, 0))
    own.observe(ahead, 1.05)
    own.observe(position(100.1, velocity=(2.0, 0.0, 0.0)), 1.1)
    assert own.velocity_ned_mps == (2.0, 0.0, 0.0)


@pytest.mark.parametrize(("make", "forgiven"), [(Ownship, True), (armed, False)])
def test_a_clock_that_slipped_is_forgiven_on_the_ground_only(make, forgiven):
    """In flight it cannot be told from a link that grew slow."""
    own = make()
    ages = []
    for k in range(600):
        now_s = 0.1 * k
        slip = min(max(now_s - 20.0, 0.0), 1.6)
        own.observe(position(now_s - slip), now_s)
        ages.append(own.age_s(now_s))
    assert max(ages[:200]) < 0.01
    assert max(ages) > 1.2
    assert (ages[-1] < 0.01) is forgiven


def test_after_a_reboot_the_old_position_is_none():
    own = armed()
    own.observe(VehicleTime(time_boot_s=1000.0, utc_s=5000.0), 9.9)
    own.observe(position(1000.0), 10.0)
    assert own.age_s(10.1) == pytest.approx(0.2, abs=0.01)
    own.observe(VehicleTime(time_boot_s=3.0, utc_s=4003.0), 13.0)
    assert own.age_s(13.1) == float("inf")
    assert own.unfit(13.1, 1.0) is not None


def test_a_vehicle_that_was_driven_away_gets_a_new_frame():
    own = Ownship()
    own.observe(position(1.0), 1.0)
    own.observe(position(600.0, lat_deg=47.6), 600.0)
    assert own.frame.lat_deg == 47.6
    assert own.position_ned_m(600.0)[0] == pytest.approx(0.0, abs=0.01)
    flying = armed()
    flying.observe(position(1.0), 1.0)
    flying.observe(position(600.0, lat_deg=47.6), 600.0)
    assert flying.frame.lat_deg == 47.0


# ---------------------------------------------------------------- TIMESYNC

WAYS = [(0.15, 0.0), (0.15, 0.15), (0.0, 0.15), (0.15, 0.02), (0.0, 0.0)]
BOOT_S = 500.0
"""Our time at the vehicle's boot in the tests below: what is to be estimated."""


def flown(down_s, up_s, *, seconds=10.0, answers=True, own=None, start_s=1000.0, boot_s=BOOT_S):
    """A vehicle whose messages take `down_s` and whose questions take `up_s`; positions 10 times a second."""
    own = armed() if own is None else own
    for tick in range(round(seconds * 10)):
        now_s = start_s + tick / 10
        own.observe(position(now_s - down_s - boot_s), now_s)
        if answers and tick % 10 == 5:
            asked_s = now_s - down_s - up_s
            own.observe(ClockRead(time_boot_s=asked_s + up_s - boot_s, asked_s=asked_s, heard_s=now_s), now_s)
    return own, now_s


def error_s(own):
    return own.sample_s() - own.position.time_boot_s - BOOT_S


@pytest.mark.parametrize(("down_s", "up_s"), WAYS)
def test_a_links_delay_is_known_to_half_its_round_trip(down_s, up_s):
    own, now_s = flown(down_s, up_s)
    assert abs(error_s(own)) <= (down_s + up_s) / 2 + 0.002
    assert own.age_s(now_s) == pytest.approx(down_s, abs=(down_s + up_s) / 2 + 0.002)
    if down_s == up_s:
        assert error_s(own) == pytest.approx(0.0, abs=0.002)


def test_without_answers_the_delay_is_not_seen():
    own, now_s = flown(0.15, 0.15, answers=False)
    assert own.age_s(now_s) == pytest.approx(0.0, abs=1e-6)


def test_a_vehicle_that_answers_no_more_keeps_what_is_known():
    own, _ = flown(0.1, 0.1)
    own, now_s = flown(0.1, 0.1, answers=False, own=own, start_s=1010.0, seconds=60.0)
    assert own.age_s(now_s) == pytest.approx(0.1, abs=0.005)


def test_one_quick_answer_among_slow_ones_is_enough():
    own, _ = flown(0.2, 0.2, seconds=5.0)
    own, _ = flown(0.01, 0.01, seconds=1.0, own=own, start_s=1005.0)
    own, now_s = flown(0.2, 0.2, own=own, start_s=1006.0)
    assert own.age_s(now_s) == pytest.approx(0.2, abs=0.02)


def test_a_link_that_grows_slow_shows_as_age_for_all_its_answers():
    own, _ = flown(0.0, 0.0)
    own, now_s = flown(0.4, 0.05, own=own, start_s=1010.5, seconds=30.0)
    assert own.age_s(now_s) == pytest.approx(0.4, abs=0.03)


@pytest.mark.parametrize("slip_s", [0.3, -0.3])
def test_a_clock_that_slipped_is_found_again(slip_s):
    """Without answers a clock that fell behind passes for a slow link until the vehicle is disarmed."""
    own, _ = flown(0.02, 0.02)
    own, now_s = flown(0.02, 0.02, own=own, start_s=1010.0, seconds=3.0, boot_s=BOOT_S + slip_s)
    assert own.age_s(now_s) == pytest.approx(0.02, abs=0.021)


def test_a_clock_that_begins_anew_takes_nothing_along():
    own, _ = flown(0.15, 0.15)
    start_s = 1010.0
    own, now_s = flown(0.15, 0.15, own=own, start_s=start_s, seconds=0.5, boot_s=start_s - 1.0)
    assert own.age_s(now_s) == pytest.approx(0.0, abs=1e-6)
    own, now_s = flown(0.15, 0.15, own=own, start_s=start_s + 0.5, seconds=2.0, boot_s=start_s - 1.0)
    assert own.age_s(now_s) == pytest.approx(0.15, abs=0.003)


def test_an_answer_in_another_clock_is_left_out():
    own, now_s = flown(0.05, 0.05)
    before = own.age_s(now_s)
    for time_boot_s in (1_767_225_600.0, 3.0, now_s - BOOT_S + 5.0):
        own.observe(ClockRead(time_boot_s=time_boot_s, asked_s=now_s - 0.1, heard_s=now_s), now_s)
    assert own.age_s(now_s) == before


def test_an_answer_before_any_position_is_left_out():
    own = armed()
    own.observe(ClockRead(time_boot_s=5.0, asked_s=1.0, heard_s=1.1), 1.1)
    assert own.utc_offset_s is None
    own.observe(position(6.0), 2.0)
    assert own.age_s(2.0) == 0.0


def test_no_answer_makes_a_position_younger_than_it_was_when_heard():
    """Positions end and answers go on, from a clock that falls behind: forged, or of a broken autopilot."""
    own, heard_s = flown(0.0, 0.0)
    for second in range(1, 20):
        now_s = heard_s + second
        behind = ClockRead(time_boot_s=now_s - BOOT_S - 0.9 * second, asked_s=now_s - 0.01, heard_s=now_s)
        own.observe(behind, now_s)
        assert own.age_s(now_s) >= second - 1e-6


def test_current_mode_counts_until_the_next_heartbeat_and_is_no_sign_of_life():
    own = Ownship()
    own.observe(CurrentMode(custom_mode=0x05040000), 0.0)
    assert own.mode is None
    own = armed()
    own.observe(CurrentMode(custom_mode=0x05040000), 0.4)
    assert (own.mode, own.heartbeat.custom_mode, own.armed) == (FlightMode.OTHER, 0x05040000, True)
    assert "no heartbeat" not in own.unfit(2.4, 1.0)
    own.observe(CurrentMode(custom_mode=0x04040000), 2.5)
    assert own.mode is FlightMode.MISSION
    assert "no heartbeat" in own.unfit(2.6, 1.0)
    own.observe(armed().heartbeat, 2.7)
    assert own.mode is FlightMode.EXTERNAL


def test_current_mode_of_a_vehicle_that_cannot_be_commanded():
    own = armed()
    own.observe(msgspec.structs.replace(own.heartbeat, vehicle_type=1), 0.1)
    own.observe(CurrentMode(custom_mode=0x00060000), 0.2)
    assert own.mode is FlightMode.OTHER


@pytest.mark.parametrize(
    ("pressure_hpa", "altitude_m"), [(1013.25, 0.0), (954.61, 500.0), (898.76, 1000.0), (701.09, 3000.0)]
)
def test_altitudes_of_the_standard_atmosphere(pressure_hpa, altitude_m):
    """The table of ICAO Doc 7488."""
    assert pressure_altitude_m(pressure_hpa) == pytest.approx(altitude_m, abs=0.5)


def test_the_own_pressure_altitude_climbs_with_us_until_it_is_old():
    """450 m above the sea; the first report comes before any position."""
    own = armed()
    own.observe(AirPressure(pressure_hpa=960.0), 0.5)
    assert own.pressure_alt_m(0.5) is None
    own.observe(position(10.0, velocity=(0.0, 0.0, -2.0)), 1.0)
    own.observe(AirPressure(pressure_hpa=960.0), 1.0)
    assert own.pressure_alt_m(1.0) == pytest.approx(pressure_altitude_m(960.0), abs=0.01)
    assert own.pressure_alt_m(3.0) == pytest.approx(pressure_altitude_m(960.0) + 4.0, abs=0.01)
    assert own.pressure_alt_m(6.1) is None


def test_the_own_pressure_altitude_is_that_of_the_vehicle_far_from_the_frames_origin():
    """The tangent plane of the frame is 31 m above the ground there."""
    own = armed()
    for second in range(19):
        own.observe(
            position(10.0 * second, lat_deg=47.0 + 0.01 * second, velocity=(111.0, 0.0, 0.0)), 10.0 * second
        )
    own.observe(AirPressure(pressure_hpa=960.0), 180.0)
    assert own.frame.lat_deg == pytest.approx(47.0)
    assert own.pressure_alt_m(180.0) == pytest.approx(pressure_altitude_m(960.0), abs=0.01)


def test_a_pressure_that_no_weather_explains_is_not_believed():
    own = armed()
    own.observe(position(10.0), 1.0)
    own.observe(AirPressure(pressure_hpa=900.0), 1.0)
    assert own.pressure_alt_m(1.0) is None


def test_a_pressure_that_jumps_in_flight_is_not_believed():
    """Or one message would place all crewed traffic hundreds of metres above or below us."""
    own = armed()
    own.observe(position(10.0), 1.0)
    own.observe(AirPressure(pressure_hpa=960.0), 1.0)
    own.observe(AirPressure(pressure_hpa=950.0), 1.5)  # 88 m
    assert own.pressure_alt_m(1.5) is None
    own.observe(AirPressure(pressure_hpa=959.0), 2.0)
    assert own.pressure_alt_m(2.0) == pytest.approx(pressure_altitude_m(959.0), abs=0.01)


def test_weather_that_changes_slowly_is_followed():
    """By 90 m within half an hour."""
    own = armed()
    for second in range(1800):
        own.observe(position(float(second)), float(second))
        own.observe(AirPressure(pressure_hpa=960.0 - second / 180.0), float(second))
    assert own.pressure_alt_m(1799.0) == pytest.approx(pressure_altitude_m(950.0), abs=1.0)
