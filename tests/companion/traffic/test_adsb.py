"""Aircraft heard by ADS-B: altitudes, repeats, velocities, bounds."""

from __future__ import annotations

import math

import pytest

from companion.events import Say
from companion.traffic.adsb import (
    BAROMETRIC_M,
    EXPIRE_S,
    MOST,
    PRESSURE_SIGMA_M,
    SIGMA_DOWN_M,
    SIGMA_MPS,
)
from tests.companion.traffic.sky import ICAO, OWN_DOWN_M, SEPARATION_M, STAMP_S, Sky, report
from tests.support.place import HOME


def test_range_is_measured_from_us_and_not_from_where_the_flight_began():
    sky = Sky()
    sky.own_ned_m = (60_000.0, -60_000.0, OWN_DOWN_M)
    sky.take(10.0, report(61_000.0, -61_000.0), report(9_000.0, -60_000.0, icao=0xA00001))
    sky.take(10.0, report(60_000.0, -9_000.0, icao=0xA00002))
    assert sky.only(10.0).position_ned_m[0] == pytest.approx(61_000.0, abs=1.0)


# ------------------------------------------------------------ altitudes


def test_a_geometric_altitude_is_taken_from_the_ellipsoid_and_separates():
    sky = Sky()
    sky.take(10.0, report(down_m=-60.0))
    seen = sky.only(10.0)
    assert seen.position_ned_m == pytest.approx((1000.0, 0.0, -60.0), abs=0.01)
    assert seen.vertical_known


def test_without_the_geoids_height_a_geometric_altitude_is_not_known():
    sky = Sky(separation_m=None)
    sky.take(10.0, report(down_m=-600.0))
    seen = sky.only(10.0)
    assert not seen.vertical_known
    assert seen.position_ned_m[:2] == pytest.approx((1000.0, 0.0), abs=0.2)


@pytest.mark.parametrize(("away_m", "known"), [(0.0, False), (299.0, False), (301.0, True), (-301.0, True)])
@pytest.mark.parametrize("separation_m", [SEPARATION_M, None])
def test_a_barometric_altitude_separates_only_beyond_the_weather(away_m, known, separation_m):
    """It counts from the sea level: the ellipsoid is nothing to it."""
    assert BAROMETRIC_M == 300.0
    sky = Sky(separation_m=separation_m)
    sky.take(10.0, report(down_m=OWN_DOWN_M + away_m, geometric=False))
    seen = sky.only(10.0)
    assert seen.vertical_known is known
    assert seen.position_ned_m[2] == pytest.approx(OWN_DOWN_M + away_m, abs=0.01)


def test_whether_a_barometric_altitude_separates_is_judged_from_our_height_now():
    sky = Sky()
    sky.take(10.0, report(down_m=-450.0, geometric=False))
    assert sky.only(10.0, own_down_m=-50.0).vertical_known
    assert not sky.only(10.0, own_down_m=-200.0).vertical_known


def test_pressure_altitudes_are_compared_with_our_own_pressure_altitude():
    """The day's weather is in both: here they read 120 m more than the altitude above the sea is."""
    sky = Sky()
    own_msl_m = HOME.to_geodetic(0.0, 0.0, OWN_DOWN_M)[2]
    sky.own_pressure_alt_m = own_msl_m + 120.0
    sky.take(10.0, report(alt_m=own_msl_m + 120.0 + 40.0, geometric=False))
    seen = sky.only(10.0)
    assert seen.vertical_known
    assert seen.position_ned_m[2] == pytest.approx(OWN_DOWN_M - 40.0)
    assert seen.sigma_down_m == PRESSURE_SIGMA_M
    sky.own_pressure_alt_m = None
    sky.take(11.0)
    assert not sky.only(11.0).vertical_known


def test_a_geometric_altitude_is_compared_with_the_geometric_one():
    sky = Sky()
    sky.own_pressure_alt_m = 5000.0
    sky.take(10.0, report(down_m=-60.0))
    seen = sky.only(10.0)
    assert (seen.position_ned_m[2], seen.sigma_down_m) == pytest.approx((-60.0, SIGMA_DOWN_M), abs=0.01)


def test_a_turn_is_told_to_the_law():
    """Three degrees a second to the right."""
    sky, rate = Sky(), math.radians(3.0)
    for t in range(20):
        course, radius_m = rate * t, 50.0 / rate
        velocity = (50.0 * math.cos(course), 50.0 * math.sin(course), 0.0)
        place = (1000.0 + radius_m * math.sin(course), radius_m * (1.0 - math.cos(course)))
        sky.take(10.0 + t, report(*place, velocity_ned_mps=velocity))
        assert t > 0 or sky.only(10.0).turn_rps == 0.0
    assert sky.only(29.0).turn_rps == pytest.approx(math.radians(3.0), rel=1e-3)


def test_velocities_from_noisy_positions_are_no_turns():
    """It flies straight; its positions are 10 m off."""
    sky = Sky()
    for second in range(20):
        noise_m = 10.0 * (-1) ** second
        sky.take(10.0 + second, report(3000.0 - 30.0 * second, noise_m, velocity_ned_mps=None))
    found = sky.only(29.0)
    assert found.turn_rps == 0.0
    assert found.velocity_ned_mps[0] == pytest.approx(-30.0, abs=3.0)


@pytest.mark.parametrize("geometric", [False, True])
def test_an_altitude_that_is_not_told_is_not_known(geometric):
    sky = Sky()
    sky.take(10.0, report(alt_m=None, geometric=geometric))
    assert not sky.only(10.0, own_down_m=-5000.0).vertical_known


# ------------------------------------------------------------ who


def test_our_own_transponder_is_not_traffic():
    sky = Sky(own_icao=ICAO)
    sky.take(10.0, report(), report(icao=ICAO + 1))
    assert [seen.track_id for seen in sky.at(10.0)] == ["4B1235"]


@pytest.mark.parametrize(
    ("icao", "name"), [(0, "000000"), (0xA, "00000A"), (0x4B1234, "4B1234"), (0xFFFFFF, "FFFFFF")]
)
def test_names_are_six_hexadecimal_digits(icao, name):
    sky = Sky()
    sky.take(10.0, report(icao=icao))
    seen = sky.only(10.0)
    assert (seen.track_id, seen.adsb) == (name, True)


@pytest.mark.parametrize("emitter", range(20))
def test_who_is_crewed(emitter):
    """ADSB_EMITTER_TYPE 14 UAV, 17 and 18 surface vehicles, 19 point obstacle; what is not told may be."""
    sky = Sky()
    sky.take(10.0, report(emitter=emitter))
    seen = sky.only(10.0)
    assert seen.crewed is (emitter not in (14, 17, 18, 19))
    assert seen.share == (1.0 if seen.crewed else 0.5)


# ------------------------------------------------------------ time


def test_age_counts_from_the_middle_of_the_second():
    sky = Sky()
    sky.take(10.0, report(age_s=2.0))
    assert sky.only(11.0).age_s == pytest.approx(3.0 + STAMP_S)


def test_the_same_report_sent_again_does_not_refresh():
    """ArduPilot goes on with the last one for seconds, its age unchanged."""
    sky = Sky()
    sky.take(10.0, report(age_s=1.0))
    for tick in range(1, 6):
        sky.take(10.0 + tick, report(age_s=1.0))
    assert sky.only(15.0).age_s == pytest.approx(6.0 + STAMP_S)


def test_one_that_hovers_and_repeats_itself_stays():
    """Standing still looks the same each time; it is no repeat."""
    sky = Sky()
    for tick in range(40):
        sky.take(10.0 + tick, report(velocity_ned_mps=(0.0, 0.0, 0.0)))
        assert sky.only(10.0 + tick).age_s == pytest.approx(STAMP_S)


def test_one_that_stands_and_tells_no_velocity_stays():
    """A repeat may not go on for longer than 5 s; then it is news."""
    sky = Sky()
    for tick in range(40):
        sky.take(10.0 + tick, report(velocity_ned_mps=None))
        assert sky.only(10.0 + tick).age_s <= 5.0 + STAMP_S
    assert sky.only(49.0).velocity_ned_mps == pytest.approx((0.0, 0.0, 0.0))


def test_an_older_report_is_passed_over():
    sky = Sky()
    sky.take(10.0, report(1000.0))
    sky.take(10.5, report(900.0, age_s=3.0))
    seen = sky.only(10.5)
    assert seen.position_ned_m[0] == pytest.approx(1000.0, abs=0.01)
    assert seen.age_s == pytest.approx(0.5 + STAMP_S)
    sky.take(11.0, report(1100.0))
    assert sky.only(11.0).position_ned_m[0] == pytest.approx(1100.0, abs=0.01)


def test_who_is_silent_is_forgotten():
    sky = Sky()
    sky.take(10.0, report())
    assert sky.at(10.0 - STAMP_S + EXPIRE_S)
    assert not sky.at(10.0 - STAMP_S + EXPIRE_S + 0.01)


def test_a_new_frame_begins_with_nobody():
    sky = Sky()
    sky.take(10.0, report())
    sky.traffic.clear()
    assert not sky.at(10.0)


# ------------------------------------------------------------ velocity


def test_a_velocity_that_is_not_told_comes_from_positions():
    sky = Sky()
    sky.take(10.0, report(1000.0, 0.0, -50.0, velocity_ned_mps=None))
    assert sky.only(10.0).velocity_ned_mps == (0.0, 0.0, 0.0)
    sky.take(12.0, report(1000.0, 100.0, -54.0, velocity_ned_mps=None))
    assert sky.only(12.0).velocity_ned_mps == pytest.approx((0.0, 50.0, -2.0), abs=0.01)
    # Too soon after the last one for a difference of positions to mean anything: from the one before.
    sky.take(12.5, report(1040.0, 125.0, -54.0, velocity_ned_mps=None))
    assert sky.only(12.5).velocity_ned_mps == pytest.approx((16.0, 50.0, -1.6), abs=0.01)


@pytest.mark.parametrize("every_s", [0.2, 0.4, 1.0, 3.0])
def test_however_often_positions_come_a_velocity_comes_of_them(every_s):
    """And no jump of a metre is 5 m/s of it."""
    sky = Sky()
    for number in range(30):
        now_s = 10.0 + number * every_s
        north_m = 1000.0 + (number % 2) - 40.0 * number * every_s
        sky.take(now_s, report(north_m, velocity_ned_mps=None))
        if number * every_s >= 1.0:
            assert sky.only(now_s).velocity_ned_mps == pytest.approx((-40.0, 0.0, 0.0), abs=1.01)


@pytest.mark.parametrize("every_s", [0.2, 0.5, 0.9, 1.0, 3.0])
def test_ten_seconds_after_a_turn_the_course_before_it_is_forgotten(every_s):
    """Velocities from positions, after a minute straight ahead."""
    sky = Sky()
    for number in range(int(75.0 / every_s)):
        t = number * every_s
        place = 40.0 * min(t, 60.0), 40.0 * max(0.0, t - 60.0)
        sky.take(10.0 + t, report(*place, velocity_ned_mps=None))
        if t > 71.0:
            assert sky.only(10.0 + t).velocity_ned_mps == pytest.approx((0.0, 40.0, 0.0), abs=0.1)


def test_of_a_long_flight_few_reports_are_kept():
    sky = Sky()
    for tick in range(50):
        sky.take(10.0 + 0.5 * tick, report(1000.0 - tick, velocity_ned_mps=None))
    newest = sky.traffic._seen["4B1234"]
    for kept in (newest.anchor, newest.next_anchor):
        assert kept is not None
        assert (kept.anchor, kept.next_anchor) == (None, None)


def test_a_velocity_that_is_not_told_any_more_is_kept_until_positions_tell_one():
    sky = Sky()
    sky.take(10.0, report(velocity_ned_mps=(0.0, 50.0, 0.0)))
    sky.take(10.5, report(1000.0, 20.0, velocity_ned_mps=None))
    assert sky.only(10.5).velocity_ned_mps == (0.0, 50.0, 0.0)
    sky.take(11.0, report(1000.0, 40.0, velocity_ned_mps=None))
    assert sky.only(11.0).velocity_ned_mps == pytest.approx((0.0, 40.0, 0.0), abs=0.01)


def test_between_heights_of_two_kinds_there_is_no_climb():
    sky = Sky()
    sky.take(10.0, report(1000.0, 0.0, -50.0, velocity_ned_mps=None))
    sky.take(12.0, report(1000.0, 100.0, -190.0, geometric=False, velocity_ned_mps=None))
    assert sky.only(12.0).velocity_ned_mps == pytest.approx((0.0, 50.0, 0.0), abs=0.01)


def test_a_velocity_that_is_told_is_taken():
    sky = Sky()
    sky.take(10.0, report(velocity_ned_mps=(-20.0, 30.0, 2.0)))
    assert sky.only(10.0).velocity_ned_mps == (-20.0, 30.0, 2.0)


# ------------------------------------------------------------ bounds


def icaos(sky, now_s):
    return {int(seen.track_id, 16) for seen in sky.at(now_s)}


def test_far_ones_however_many_do_not_displace_a_near_one():
    sky = Sky()
    sky.take(10.0, report(500.0))
    for icao in range(3 * MOST):
        sky.take(10.1, report(30_000.0, icao=icao))
    heard = icaos(sky, 10.2)
    assert len(heard) == MOST
    assert ICAO in heard


def test_of_too_many_the_farthest_from_us_are_left_out():
    sky = Sky()
    sky.own_ned_m = (20_000.0, 0.0, OWN_DOWN_M)
    for icao in range(MOST):
        sky.take(10.0, report(100.0 * icao, icao=icao))
    sky.take(10.1, report(19_950.0, icao=MOST), report(50.0, icao=MOST + 1), report(-50.0, icao=MOST + 2))
    # The first takes the place of 0; the others are farther away than 1.
    assert icaos(sky, 10.2) == {*range(MOST + 1)} - {0}


def test_one_that_is_known_keeps_its_place_among_too_many():
    sky = Sky()
    for icao in range(MOST):
        sky.take(10.0, report(100.0 * icao, icao=icao))
    sky.take(11.0, report(100.0 * MOST, icao=MOST - 1))
    assert icaos(sky, 11.0) == {*range(MOST)}


def test_near_ones_that_fell_silent_keep_nobody_out():
    """On the ground nobody asks for the neighbours, which is when the silent ones are forgotten."""
    sky = Sky()
    for icao in range(MOST):
        sky.take(10.0, report(100.0, icao=icao))
    sky.take(11.0 + EXPIRE_S, report(5000.0))
    assert icaos(sky, 11.0 + EXPIRE_S) == {ICAO}


@pytest.mark.parametrize(("east_m", "heard"), [(49_900.0, True), (50_100.0, False)])
def test_who_is_too_far_away_is_left_out(east_m, heard):
    sky = Sky()
    sky.take(10.0, report(0.0, east_m))
    assert bool(sky.at(10.0)) is heard


def test_one_that_leaves_the_range_is_forgotten_in_time():
    sky = Sky()
    sky.take(10.0, report(0.0, 49_990.0))
    for tick in range(1, 20):
        sky.take(10.0 + tick, report(0.0, 49_990.0 + 50.0 * tick))
    assert not sky.at(29.0)


def test_who_only_looks_forgets_nobody():
    """Or a flight that somebody watched would go another way when it is replayed."""
    sky = Sky()
    sky.take(10.0, report())
    assert sky.traffic.look(10.0, OWN_DOWN_M) == sky.at(10.0)
    late_s = 10.0 + EXPIRE_S + 1.0
    assert sky.traffic.look(late_s, OWN_DOWN_M) == []
    assert sky.only(10.0)


def ghost(k, position, velocity, **over):
    return report(*position, icao=0xA00000 + k, velocity_ned_mps=velocity, **over)


@pytest.mark.parametrize("established", [False, True])
def test_two_hundred_ghosts_do_not_displace_the_helicopter_that_we_are_about_to_meet(established):
    """They fly along with us, nearer than it, for ever; it is heard once a second."""
    sky = Sky()
    sky.own_velocity_ned_mps = (10.0, 0.0, 0.0)
    for second in range(60):
        now_s = 10.0 + second
        sky.own_ned_m = (10.0 * second, 0.0, OWN_DOWN_M)
        helicopter = report(3_000.0 - 40.0 * second, velocity_ned_mps=(-40.0, 0.0, 0.0))
        if second or established:
            sky.take(now_s, helicopter)
        for k in range(MOST):
            east_m = (-1) ** k * (1_000.0 + k)
            sky.take(now_s, ghost(k, (10.0 * second, east_m), (10.0, 0.0, 0.0)))
        if second:
            assert ICAO in icaos(sky, now_s)
    assert sky.traffic.full.left_out
    assert not sky.traffic.full.threats


def test_ghosts_that_are_in_conflict_themselves_displace_each_other_and_not_the_helicopter():
    """Consecutive addresses, and one direction: 300 of them, all nearer in time than it is."""
    sky = Sky()
    for second in range(30):
        now_s = 10.0 + second
        sky.take(now_s, report(2_500.0 - 40.0 * second, velocity_ned_mps=(-40.0, 0.0, 0.0)))
        for k in range(300):
            icao = 0xA00000 + 0x111 * k
            sky.take(now_s, report(-300.0 - k, 0.0, icao=icao, velocity_ned_mps=(60.0, 0.0, 0.0)))
        assert ICAO in icaos(sky, now_s)
    (said,) = {type(c) for c in sky.traffic.full.due(40.0)}
    assert said is Say


def test_the_assumed_velocity_error_is_that_of_its_category():
    """NACv 2: 3 m/s at 95 %, which is 1.96 standard deviations."""
    assert pytest.approx(3.0 / 1.96, rel=0.05) == SIGMA_MPS


def test_who_uses_another_aircrafts_address_elsewhere_hides_nobody():
    """It sends each time just after the true one, which comes nearer."""
    sky = Sky()
    for second in range(30):
        now_s, true_m = 10.0 + second, 3000.0 - 40.0 * second
        sky.take(now_s, report(true_m, velocity_ned_mps=(-40.0, 0.0, 0.0)))
        sky.take(now_s + 0.05, report(-30_000.0, velocity_ned_mps=(0.0, 0.0, 0.0)))
        found = {n.track_id: n.position_ned_m[0] for n in sky.at(now_s + 0.05)}
        assert found == pytest.approx({"4B1234": true_m, "4B1234/2": -30_000.0}, abs=1.0)


def test_places_of_an_address_cost_other_addresses_nothing_and_end_with_its_aircraft():
    """Each report is compared with all places of its address."""
    sky = Sky()
    sky.take(10.0, *[report(1_000.0 * k) for k in range(-15, 15)])
    sky.take(10.1, report(1000.0, icao=0xA00001))
    assert sky.traffic._places == {"4B1234": set(range(1, 31)), "A00001": {1}}
    sky.take(20.0, report(1500.0, icao=0xA00001))
    assert len(sky.at(10.0 + EXPIRE_S)) == 1
    assert sky.traffic._places == {"A00001": {1}}
    sky.traffic.clear()
    assert not sky.traffic._places


def test_one_whose_reports_are_lost_for_a_while_stays_one():
    """It turns meanwhile, at 60 m/s; another has no velocity in its reports, and a third is repeated."""
    for over in ({}, {"velocity_ned_mps": None}):
        sky = Sky()
        for at_s, place in ((10.0, (3000.0, 0.0)), (11.0, (3000.0, 60.0)), (24.0, (2600.0, 700.0))):
            sky.take(at_s, report(*place, **{"velocity_ned_mps": (0.0, 60.0, 0.0), **over}))
        assert [n.track_id for n in sky.at(24.0)] == ["4B1234"]
    sky = Sky()
    for second in range(12):
        sky.take(10.0 + second, report(velocity_ned_mps=(0.0, 200.0, 0.0)))
    assert [n.track_id for n in sky.at(21.0)] in ([], ["4B1234"])


def test_a_fast_one_whose_velocity_is_not_known_yet_is_not_taken_for_two():
    """At 250 m/s; its first two reports are too close in time to compute a velocity."""
    sky = Sky()
    for at_s in (10.0, 10.5, 13.5):
        sky.take(at_s, report(250.0 * at_s, velocity_ned_mps=None))
    assert [n.track_id for n in sky.at(13.5)] == ["4B1234"]
