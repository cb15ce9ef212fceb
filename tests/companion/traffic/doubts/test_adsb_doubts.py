"""ADS-B reports that contradict each other: velocities that positions do not follow, heights that jump."""

from __future__ import annotations

import math

import pytest

from companion.avoidance.kernels.crewed import HORIZON_S
from companion.traffic.adsb import DOUBTED_S
from tests.companion.traffic.sky import OWN_DOWN_M, STAMP_S, Sky, report
from tests.support.place import HOME


def by_name(sky, now_s):
    return {neighbour.track_id: neighbour for neighbour in sky.at(now_s)}


# ------------------------------------------------------------ velocities


def test_a_helicopter_that_says_it_stands_flies_as_its_positions_show():
    """ArduPilot repeats its reports meanwhile, which is no standing still."""
    sky = Sky()
    for second in range(60):
        true = report(3000.0 - 40.0 * (second - second % 2), velocity_ned_mps=(0.0, 0.0, 0.0))
        sky.take(10.0 + second, true)
        if second >= 16:
            found = sky.only(10.0 + second)
            assert found.velocity_ned_mps == pytest.approx((-40.0, 0.0, 0.0), abs=6.0)
            assert found.age_s == pytest.approx(STAMP_S + second % 2)


@pytest.mark.parametrize(
    "told", [(40.0, 0.0, 0.0), (-40.0, 40.0, 0.0), (-40.0, 0.0, -15.0), (250.0, 0.0, 0.0)]
)
def test_a_velocity_that_positions_contradict_is_corrected(told):
    sky = Sky()
    for second in range(30):
        sky.take(10.0 + second, report(3000.0 - 40.0 * second, velocity_ned_mps=told))
    assert sky.only(39.0).velocity_ned_mps == pytest.approx((-40.0, 0.0, 0.0), abs=0.1)


def test_a_wrong_vertical_speed_leaves_the_turn_as_it_is():
    """It circles and descends, and reports no vertical speed."""
    sky, turn_rps = Sky(), 0.1
    for second in range(40):
        course = turn_rps * second
        place = 2000.0 + 400.0 * math.sin(course), -400.0 * math.cos(course), -1000.0 + 18.0 * second
        told = 40.0 * math.cos(course), 40.0 * math.sin(course), 0.0
        sky.take(10.0 + second, report(*place, velocity_ned_mps=told))
    found = sky.only(49.0)
    assert found.velocity_ned_mps == pytest.approx((*told[:2], 18.0), abs=0.1)
    assert found.turn_rps == pytest.approx(turn_rps, abs=0.001)


def test_a_velocity_that_is_right_again_is_taken_within_seconds():
    sky = Sky()
    for second in range(40):
        told = (0.0, 0.0, 0.0) if second < 20 else (-40.0, 0.0, 0.0)
        sky.take(10.0 + second, report(3000.0 - 40.0 * second, velocity_ned_mps=told))
        if second >= 28:
            assert sky.only(10.0 + second).velocity_ned_mps == (-40.0, 0.0, 0.0)


@pytest.mark.parametrize("every", [2, 5])
def test_a_report_without_a_velocity_does_not_interrupt_the_correction(every):
    sky = Sky()
    for second in range(60):
        told = None if second % every == 0 else (0.0, 0.0, 0.0)
        sky.take(10.0 + second, report(3000.0 - 40.0 * second, velocity_ned_mps=told))
        if second > 20:
            assert sky.only(10.0 + second).velocity_ned_mps == pytest.approx((-40.0, 0.0, 0.0), abs=0.1)


def test_a_helicopter_that_lands_with_such_a_velocity_stands():
    """From then on its reports are all the same, as if they were repeated."""
    sky = Sky()
    for second in range(60):
        sky.take(10.0 + second, report(3000.0 - 40.0 * min(second, 30), velocity_ned_mps=(0.0, 0.0, 0.0)))
    assert sky.only(69.0).velocity_ned_mps == (0.0, 0.0, 0.0)
    assert sky.only(69.0).age_s == STAMP_S


def test_two_forged_places_do_not_make_a_helicopter_fly_that_stands():
    sky, still = Sky(), (0.0, 0.0, 0.0)
    for second in range(40):
        sky.take(10.0 + second, report(400.0, velocity_ned_mps=still))
        if second in (3, 6):
            sky.take(10.0 + 1.02 * second, report(400.0 + 31.7 * second, velocity_ned_mps=still))
        if second > 14:
            assert by_name(sky, 10.0 + second)["4B1234"].velocity_ned_mps == still


def test_the_noise_of_positions_corrects_no_velocity():
    """Three standard deviations to either side, hovering and in flight, ages wrong by up to a second."""
    for speed_mps in (0.0, 60.0):
        sky, true = Sky(), (0.0, speed_mps, 0.0)
        for second in range(60):
            off_m, late_s = 45.0 * (-1) ** second, 0.3 * (second % 4)
            place = 2000.0 + off_m, speed_mps * (second - late_s) - 2000.0
            sky.take(10.0 + second, report(*place, velocity_ned_mps=true))
            assert sky.only(10.0 + second).velocity_ned_mps == true


@pytest.mark.parametrize(("error_mps", "found"), [(9.0, False), (11.0, True)])
def test_how_small_an_error_of_a_velocity_is_found(error_mps, found):
    """Smaller ones cannot be told from the noise of two positions 15 s apart and from manoeuvres."""
    sky = Sky()
    for second in range(60):
        sky.take(10.0 + second, report(1000.0 + error_mps * second, velocity_ned_mps=(0.0, 0.0, 0.0)))
    assert sky.only(69.0).velocity_ned_mps[0] == pytest.approx(error_mps if found else 0.0, abs=0.5)


@pytest.mark.parametrize("every", [2, 5, 9])
def test_forged_reports_now_and_then_do_not_correct_a_true_velocity(every):
    """They are near enough to be taken for the same aircraft's, and say that it is slower."""
    sky, true = Sky(), (-40.0, 0.0, 0.0)
    for second in range(60):
        now_s = 10.0 + second
        sky.take(now_s, report(3000.0 - 40.0 * second, velocity_ned_mps=true))
        assert sky.only(now_s).velocity_ned_mps == true
        if second % every == 0:
            forged = report(2950.0 - 40.0 * second, 120.0, velocity_ned_mps=(-30.0, 5.0, 0.0))
            sky.take(now_s + 0.1, forged)


@pytest.mark.parametrize(
    "forged", [(-40.0, 0.0, 12.0), (-40.0, 0.0, -7.5), (0.0, 0.0, 0.0), (-40.0, 13.0, 0.0), (-55.0, 0.0, 0.0)]
)
def test_who_forges_another_velocity_takes_nothing_from_the_true_one(forged):
    """Each forged report follows a true one at once. A helicopter was thereby met at 1 m: by what it had said
    last, it was on its way out of our height."""
    sky, true = Sky(), (-40.0, 0.0, 0.0)
    for second in range(60):
        now_s, north_m = 10.0 + second, 3000.0 - 40.0 * second
        sky.take(now_s, report(north_m, velocity_ned_mps=true))
        sky.take(now_s + 0.05, report(north_m, down_m=-30.0, velocity_ned_mps=forged))
        found = by_name(sky, now_s + 0.05)
        assert found["4B1234"].velocity_ned_mps == true
        assert found["4B1234"].position_ned_m == pytest.approx((north_m, 0.0, -50.0), abs=0.01)
        assert "4B1234/2" in found


@pytest.mark.parametrize(("aside_m", "names"), [(330.0, 1), (350.0, 2)])
def test_after_two_seconds_a_place_may_be_off_by_the_most_and_by_a_turn(aside_m, names):
    """300 m, and 40 m for turns at 20 m/s2."""
    sky = Sky()
    sky.take(10.0, report(3000.0, velocity_ned_mps=(-40.0, 0.0, 0.0)))
    sky.take(12.0, report(2920.0, aside_m, velocity_ned_mps=(-40.0, 0.0, 0.0)))
    assert len(sky.at(12.0)) == names


@pytest.mark.parametrize("aside_m", [160.0, 250.0])
def test_who_forges_a_place_nearby_takes_nothing_from_the_true_one(aside_m):
    sky = Sky()
    for second in range(60):
        now_s, north_m = 10.0 + second, 3000.0 - 40.0 * second
        for aside, later_s in ((0.0, 0.0), (aside_m, 0.05)):
            sky.take(now_s + later_s, report(north_m, aside, velocity_ned_mps=(-40.0, 0.0, 0.0)))
        assert by_name(sky, now_s + 0.05)["4B1234"].position_ned_m[1] == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(("away_m", "names"), [(880.0, 1), (920.0, 2)])
def test_without_a_known_velocity_it_may_have_flown_as_fast_as_any(away_m, names):
    """300 m, and 600 m/s for a second."""
    sky = Sky()
    sky.take(10.0, report(3000.0, velocity_ned_mps=None))
    sky.take(11.0, report(3000.0, away_m, velocity_ned_mps=None))
    assert len(sky.at(11.0)) == names


@pytest.mark.parametrize("every_s", [0.2, 1.0, 2.0, 5.0])
@pytest.mark.parametrize(("speed_mps", "told"), [(20.0, True), (250.0, True), (20.0, False), (100.0, False)])
def test_turns_and_climbs_are_of_one_aircraft(speed_mps, told, every_s):
    """It turns and climbs with 5 m/s2; its velocity may also be told as zero all the time."""
    sky, rate = Sky(), 5.0 / speed_mps
    for k in range(int(60.0 / every_s)):
        t = every_s * k
        climb, wave = 15.0 * math.sin(t / 3.0), 45.0 * math.cos(t / 3.0)
        place = speed_mps / rate * math.sin(rate * t), -speed_mps / rate * math.cos(rate * t), wave - 1000.0
        true = speed_mps * math.cos(rate * t), speed_mps * math.sin(rate * t), -climb
        sky.take(10.0 + t, report(*place, velocity_ned_mps=true if told else (0.0, 0.0, 0.0)))
        sky.only(10.0 + t)


# ------------------------------------------------------------ heights that change impossibly


def known(*downs_m):
    """For each of some reports, one a second: names of the aircraft, and whether the height of each is
    known."""
    sky, found = Sky(), []
    for second, down_m in enumerate(downs_m):
        sky.take(10.0 + second, report(down_m=down_m or 0.0, **({"alt_m": None} if down_m is None else {})))
        found.append({n.track_id: n.vertical_known for n in sky.at(10.0 + second)})
    return found


def test_after_a_jump_the_height_is_unknown_for_as_long_as_the_law_looks_ahead():
    """It may have been wrong before, or is now. Meanwhile it is at the old height as well, as long as an
    aircraft that fell silent."""
    found = known(-50.0, -50.0, *[-350.0] * 70)
    assert DOUBTED_S == HORIZON_S
    assert found[1:3] == [{"4B1234": True}, {"4B1234": True, "4B1234/2": False}]
    assert found[17:61] == [{"4B1234/2": False}] * 44
    assert found[62:] == [{"4B1234/2": True}] * 10


def test_who_forges_another_height_takes_nothing_from_the_true_one():
    found = known(*[-50.0, -350.0] * 50)
    assert found[1:] == [{"4B1234": True, "4B1234/2": False}] * 60 + [{"4B1234": True, "4B1234/2": True}] * 39


def test_a_jump_is_found_over_a_report_without_a_height():
    assert known(-50.0, None, -350.0)[-1] == {"4B1234": False, "4B1234/2": False}


@pytest.mark.parametrize("climb_mps", [0.0, 30.0, -30.0, 51.0])
def test_climbs_and_steps_of_a_hundred_feet_are_no_jumps(climb_mps):
    downs_m = [round((-2000.0 - climb_mps * second) / 30.48) * 30.48 for second in range(40)]
    assert known(*downs_m) == [{"4B1234": True}] * 40


@pytest.mark.parametrize(("off_m", "names"), [(95.0, 1), (-95.0, 1), (110.0, 2), (-110.0, 2)])
def test_a_change_of_height_that_is_faster_than_any_climb_is_a_jump(off_m, names):
    """Within a second: 50 m, and 51 m/s."""
    assert len(known(-1500.0, -1500.0 + off_m)[-1]) == names


@pytest.mark.parametrize(("off_m", "one"), [(40.0, True), (-40.0, True), (300.0, False), (-300.0, False)])
def test_another_kind_of_altitude_may_be_off_no_more_than_the_same_kind(off_m, one):
    sky = Sky()
    sky.take(10.0, report(down_m=-1500.0))
    sky.take(10.2, report(down_m=-1500.0 + off_m, geometric=False))
    assert (len(sky.at(10.2)) == 1) is one


@pytest.mark.parametrize("pressure_known", [True, False])
def test_a_forged_altitude_of_another_kind_hides_no_aircraft(pressure_known):
    """Just after each true one, as far above it as the weather could explain."""
    sky = Sky()
    sky.own_pressure_alt_m = HOME.alt_m - OWN_DOWN_M if pressure_known else None
    for second in range(80):
        sky.take(10.0 + second, report(3000.0 - 40.0 * second, velocity_ned_mps=(-40.0, 0.0, 0.0)))
        place = 2992.0 - 40.0 * second, 0.0, OWN_DOWN_M - 340.0
        sky.take(10.2 + second, report(*place, geometric=False, velocity_ned_mps=(-40.0, 0.0, 0.0)))
        true = {n.track_id: n for n in sky.at(10.4 + second)}["4B1234"]
        assert (true.position_ned_m[2], true.vertical_known) == (pytest.approx(OWN_DOWN_M), True)
