"""What a track says of its aircraft: place, age and accuracy, and how many tracks there are."""

from __future__ import annotations

import math
from collections import deque
from types import SimpleNamespace

import msgspec
import pytest

from companion.avoidance import kernels
from companion.avoidance.law import OLDEST_S
from companion.config import TrafficConfig
from companion.remote_id.messages import Location, Status
from companion.traffic.fix import SIGMA_MOST_M, SIGMA_UNKNOWN_M
from companion.traffic.matching import _follows
from companion.traffic.plausibility import Flag
from companion.traffic.track import Earlier, Track, flown, near, reach
from tests.companion.traffic.listening import SEPARATION_M, UTC_OFFSET_S, Listener, basic, location


def test_position_velocity_accuracy_and_age():
    listener = Listener()
    listener.hear(10.7, basic("X"), location(timestamp_s=10.0))
    (neighbour,) = listener.traffic.neighbours(11.0)
    assert neighbour.track_id == "X"
    assert neighbour.position_ned_m == pytest.approx((100.0, 0.0, 0.0), abs=0.01)
    assert neighbour.velocity_ned_mps == pytest.approx((0.0, 5.0, -1.0), abs=1e-9)
    assert neighbour.age_s == pytest.approx(1.0)
    assert neighbour.sigma_m == 3.0
    assert neighbour.vertical_known


def test_age_across_the_full_hour():
    listener = Listener()
    listener.hear(3600.4, basic("X"), location(timestamp_s=3599.8))
    assert listener.traffic.neighbours(3600.4)[0].age_s == pytest.approx(0.6)


def test_an_older_message_that_comes_later_changes_nothing():
    listener = Listener()
    listener.hear(11.0, basic("X"), location(north_m=100.0, timestamp_s=10.5))
    listener.hear(11.2, location(north_m=90.0, timestamp_s=9.5))
    assert listener.tracks["X"].position_ned_m[0] == pytest.approx(100.0, abs=0.01)
    assert listener.traffic.counts.old == 1


def test_a_clock_that_leads_is_estimated():
    listener = Listener()
    for k in range(6):
        # Sent with a clock 2 s ahead, delay 0.5 s: reads 1.5 s into the future.
        listener.hear(10.0 + k, basic("X"), location(east_m=5.0 * k, timestamp_s=11.5 + k))
    assert listener.traffic.neighbours(15.0)[0].age_s == pytest.approx(0.0, abs=0.1)


def test_one_wrong_timestamp_shifts_nothing():
    """Whoever sends one message from the future must not age the true ones that follow."""
    listener = Listener()
    for k in range(8):
        ahead = 4.9 if k == 3 else -0.4
        listener.hear(10.0 + k, basic("X"), location(east_m=5.0 * k, timestamp_s=round(10.0 + k + ahead, 1)))
        assert listener.traffic.neighbours(10.0 + k)[0].age_s <= 0.5
    assert listener.traffic.counts.old == 0


@pytest.mark.parametrize("error_s", [18.0, -18.0, 1700.0])
def test_a_clock_far_off_never_empties_the_sky(error_s):
    listener = Listener(utc_offset_s=UTC_OFFSET_S + error_s)
    for k in range(5):
        listener.hear(100.0 + k, basic("X"), location(east_m=5.0 * k, timestamp_s=100.0 + k))
        (neighbour,) = listener.traffic.neighbours(100.0 + k)
        assert neighbour.age_s == 0.0
        assert neighbour.sigma_m > 5.0
    assert listener.traffic.counts.clock == 5


def test_repeated_advertisements_say_nothing_about_clocks():
    """1 Hz of content, advertised ten times a second, by a clock 2 s ahead: one update a message."""
    listener = Listener()
    for k in range(200):
        now_s, second = 10.0 + 0.1 * k, k // 10
        listener.hear(
            now_s, basic("X"), location(east_m=15.0 * second, speed_mps=15.0, timestamp_s=12.0 + second)
        )
    assert listener.traffic.counts.updates == 20


def test_range_is_counted_from_where_we_are():
    listener = Listener()
    listener.traffic.note_own(10.0, (66_000.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    listener.hear(10.0, basic("X"), location(north_m=66_050.0))
    assert list(listener.tracks) == ["X"]


def test_a_stale_advertisement_does_not_stay_fresh():
    listener = Listener(utc_offset_s=UTC_OFFSET_S + 100.0)
    for k in range(30):
        listener.hear(100.0 + k, basic("X"), location(timestamp_s=100.0))
        listener.traffic.expire(100.0 + k)
    # Taken once as fresh, forgotten 15 s later, and once more after that: never continuously fresh.
    assert listener.traffic.counts.updates <= 2


def test_without_utc_the_time_of_reception_counts():
    listener = Listener(utc_offset_s=None)
    listener.hear(10.0, basic("X"), location(timestamp_s=7.0))
    assert listener.traffic.neighbours(10.5)[0].age_s == pytest.approx(0.5)


def test_expiry():
    listener = Listener(expire_after_s=15.0)
    listener.hear(10.0, basic("X"), location(timestamp_s=10.0))
    listener.traffic.expire(24.9)
    assert "X" in listener.tracks
    listener.traffic.expire(25.1)
    assert not listener.tracks


@pytest.mark.parametrize(("gap_s", "kept_s"), [(4.9, 15.0), (7.0, 21.0), (12.0, 30.0)])
def test_an_aircraft_with_long_gaps_is_kept_for_three_of_them(gap_s, kept_s):
    listener = Listener(expire_after_s=15.0)
    for k in range(3):
        listener.hear(10.0 + k * gap_s, basic("X"), location(timestamp_s=10.0 + k * gap_s))
    last_s = 10.0 + 2.0 * gap_s
    listener.traffic.expire(last_s + kept_s - 0.1)
    (known,) = listener.traffic.neighbours(last_s + kept_s - 0.1)
    assert known.age_s == pytest.approx(kept_s - 0.1)
    assert known.age_s <= OLDEST_S
    listener.traffic.expire(last_s + kept_s + 0.1)
    assert not listener.tracks


def test_the_campaign_keeps_tracks_as_long_as_the_default_configuration():
    assert TrafficConfig().expire_after_s == kernels.KEPT_S
    with pytest.raises(msgspec.ValidationError):  # a track that is kept longer than the law avoids it
        msgspec.convert({"expire_after_s": OLDEST_S / kernels.KEPT_MORE + 0.1}, TrafficConfig)


def test_a_place_beyond_all_reception_is_not_believed():
    listener = Listener()
    listener.hear(10.0, basic("X"), location(north_m=60_000.0))
    assert not listener.tracks
    assert listener.traffic.counts.implausible == 1


def test_an_impossible_speed_hides_no_aircraft():
    """Its place may be true: some senders write the largest speed for an unknown one."""
    listener = Listener()
    for k in range(3):
        listener.hear(10.0 + k, basic("X"), location(5.0 * k, timestamp_s=10.0 + k, speed_mps=254.25))
    (other,) = listener.traffic.neighbours(12.0)
    assert other.position_ned_m[:2] == pytest.approx((10.0, 0.0), abs=0.1)
    assert other.velocity_ned_mps[0] == pytest.approx(5.0, abs=0.5)  # from its places
    assert listener.traffic.counts.implausible == 3
    assert Flag.IMPOSSIBLE_VALUES in listener.tracks["X"].doubts.flags


@pytest.mark.parametrize("altitude_m", [31767.5, -999.5, 20_000.5])
def test_an_impossible_altitude_hides_no_aircraft(altitude_m):
    """It is avoided at any height instead of at one where nobody flies."""
    listener = Listener()
    listener.hear(10.0, basic("X"), location(alt_geodetic_m=altitude_m))
    (other,) = listener.traffic.neighbours(10.0)
    assert not other.vertical_known


def test_an_aircraft_without_clock_that_climbs_above_one_place_is_followed():
    listener = Listener()
    for k in range(14):
        height = {"alt_geodetic_m": 507.0 - 5.0 * max(0, k - 3), "vertical_speed_mps": 0.0 if k < 4 else -5.0}
        listener.hear(10.0 + k, basic("X"), location(timestamp_s=None, speed_mps=0.0, **height))
    other = listener.traffic.neighbours(23.0)[0]
    assert other.position_ned_m[2] + other.age_s * other.velocity_ned_mps[2] == pytest.approx(-10.0, abs=1.0)


@pytest.mark.parametrize("names", [("OWN",), ("OWN", "REGISTRATION"), ("REGISTRATION", "OWN")])
def test_our_own_transmitter_of_unknown_address_becomes_no_aircraft_on_ble4(names):
    """An ArduRemoteID module reports no address. Our own receiver hears a Location before the name."""
    listener = Listener()
    for k in range(100):
        now = 10.0 + 0.1 * k
        north = 0.8 * math.sin(now / 7)
        listener.traffic.note_own(now, (north, 0.0, 0.0), (0.0, 0.0, 0.0))
        if k % 5 in (0, 3):
            place = location(north, 0.0, round(now, 1), 0.0, vertical_speed_mps=0.0)
            listener.hear(now, place, address="module", transport="ble4")
        if k % 5 == 4:
            listener.hear(now, basic(names[k // 5 % len(names)]), address="module", transport="ble4")
    assert listener.traffic.neighbours(now) == []


def test_near_ghosts_do_not_push_out_an_established_track():
    listener = Listener(max_tracks=10)
    for k in range(4):
        listener.hear(10.0 + k, basic("REAL"), location(north_m=80.0, east_m=5.0 * k, timestamp_s=10.0 + k))
    for k in range(300):
        listener.hear(14.0, basic(f"G{k}"), location(north_m=30.0, timestamp_s=14.0), address=f"g{k}")
    assert "REAL" in listener.tracks
    assert len(listener.tracks) == 10


def test_no_position_no_track():
    listener = Listener()
    listener.hear(10.0, basic("X"), Location(timestamp_s=10.0))
    assert not listener.tracks
    assert listener.traffic.counts.no_position == 1


def test_an_aircraft_that_reports_no_position_any_more_may_have_stopped():
    listener = Listener()
    for k in range(4):
        now = 10.0 + k
        listener.hear(now, basic("X"), location(north_m=80.0 + 3.0 * k, timestamp_s=now))
    listener.hear(13.1, Location(status=Status.REMOTE_ID_SYSTEM_FAILURE), address="elsewhere")
    assert not listener.traffic.neighbours(13.2)[0].silent
    listener.hear(13.2, basic("X"), Location(status=Status.REMOTE_ID_SYSTEM_FAILURE))
    assert listener.traffic.neighbours(13.3)[0].silent
    listener.hear(14.0, basic("X"), location(north_m=92.0, timestamp_s=14.0))
    assert not listener.traffic.neighbours(14.1)[0].silent


@pytest.mark.parametrize(("altitude", "separation"), [(None, SEPARATION_M), (447.0, None)])
def test_height_is_unknown_when_either_side_lacks_it(altitude, separation):
    listener = Listener(separation_m=separation)
    listener.hear(10.0, basic("X"), location(alt_geodetic_m=altitude))
    assert not listener.tracks["X"].vertical_known


def test_undeclared_accuracy_and_velocity():
    listener = Listener()
    listener.hear(10.0, basic("X"), location(speed_mps=None, horizontal_accuracy_m=None))
    track = listener.tracks["X"]
    assert track.sigma_m == SIGMA_UNKNOWN_M
    assert track.velocity_ned_mps == (0.0, 0.0, 0.0)
    listener.hear(12.0, location(east_m=8.0, timestamp_s=12.0, speed_mps=None))
    assert track.velocity_ned_mps[:2] == pytest.approx((0.0, 4.0), abs=0.01)


def test_a_declared_accuracy_of_kilometres_is_bounded():
    listener = Listener()
    listener.hear(10.0, basic("X"), location(horizontal_accuracy_m=18520.0))
    assert listener.tracks["X"].sigma_m == SIGMA_MOST_M


def test_a_flood_of_far_ghosts_does_not_push_out_the_near():
    listener = Listener(max_tracks=10)
    listener.hear(10.0, basic("NEAR"), location(north_m=50.0), address="near")
    for k in range(500):
        listener.hear(10.0, basic(f"G{k}"), location(north_m=5_000.0 + k), address=f"g{k}")
    assert len(listener.tracks) == 10
    assert "NEAR" in listener.tracks
    listener.hear(10.0, basic("CLOSE"), location(north_m=60.0), address="close")
    assert "CLOSE" in listener.tracks
    assert len(listener.traffic._table.sources) <= 40


def test_every_number_of_a_neighbour_is_finite():
    listener = Listener()
    listener.hear(10.0, basic("X"), location(direction_deg=None, speed_mps=3.0))
    (n,) = listener.traffic.neighbours(10.0)
    assert all(map(math.isfinite, (*n.position_ned_m, *n.velocity_ned_mps, n.age_s, n.sigma_m)))


def test_how_far_from_where_it_was_predicted_an_aircraft_may_be():
    """After 2 s, with 3 m of noise: by 10 m/s^2 it flies 20 m aside; two aircraft are told apart by more."""
    assert near(3.0) == 10.0 + 6.0
    assert flown(2.0, 3.0) == near(3.0) + 2.0 * 4.0 + 20.0
    assert reach(2.0, 3.0) == 20.0 + 12.0 + 2.0 * 8.0 + 20.0


@pytest.mark.parametrize(("passed_s", "allowed_m"), [(0.0, 22.0), (0.2, 23.0), (1.5, 39.25)])
def test_a_row_of_quick_messages_moves_a_track_no_farther_than_the_time_allows(passed_s, allowed_m):
    """Of an aircraft that hovers, with 3 m of error in both messages."""
    earlier = Earlier(10.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 3.0, False, 3.0, True)
    track = SimpleNamespace(earlier=earlier, velocity_known=True, declared_s=None, leads_s=deque([0.0]))
    for over_m in (-0.01, 0.01):
        fix = SimpleNamespace(
            position=(0.0, allowed_m + over_m, 0.0), velocity=None, sigma_m=3.0, vertical_known=False
        )
        assert _follows(track, fix, 10.0 + passed_s, others=False) is (over_m < 0.0)


def clock(**state):
    """What a track knows of its sender's clock, which leads ours by half a second."""
    known = {"base_lead_s": 0.5, "clock_s": 10.0, "sample_s": 10.0, "leads_s": deque([0.5])}
    return SimpleNamespace(**known | state)


def test_a_clock_that_leads_more_is_believed_once_the_other_was_not_heard_for_ten_seconds():
    known = clock()
    assert not Track.note_lead(known, 4.5, 19.9)
    assert [Track.note_lead(known, 4.5, now_s) for now_s in (20.1, 21.1)] == [True, True]
    assert known.base_lead_s == 4.5


def test_a_clock_that_leads_less_replaces_what_was_learnt_unless_its_message_is_old():
    delayed, late, other = clock(), clock(), clock()
    assert Track.note_lead(delayed, -2.4, 15.0)  # by up to 3 s of delay
    assert (delayed.base_lead_s, list(delayed.leads_s)) == (0.5, [0.5, -2.4])
    assert Track.note_lead(late, -2.6, 12.5)
    assert (late.base_lead_s, list(late.leads_s)) == (0.5, [0.5, -2.6])
    assert Track.note_lead(other, -2.6, 12.7)
    assert (other.base_lead_s, list(other.leads_s)) == (-2.6, [-2.6])


def test_a_late_message_of_a_clock_that_leads_is_as_old_as_it_is_late():
    listener = Listener()
    for second in range(5):
        listener.hear(10.2 + second, basic("X"), location(timestamp_s=11.0 + second))
    listener.hear(16.2, basic("X"), location(timestamp_s=16.0, north_m=105.0))
    assert listener.traffic.neighbours(16.2)[0].age_s == pytest.approx(1.0)
