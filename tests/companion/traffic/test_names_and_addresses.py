"""Which track a message belongs to: names, radio addresses, copies of both, and our own."""

from __future__ import annotations

import math
import random

import pytest

from companion.remote_id.messages import IdType
from companion.traffic.plausibility import Flag
from tests.companion.traffic.listening import Listener, basic, location


def test_identity_follows_the_address_and_renames_the_nameless_track():
    listener = Listener()
    listener.hear(10.0, location(timestamp_s=10.0), transport="ble4")
    assert list(listener.tracks) == ["ble4/a"]
    listener.hear(10.1, basic("X"), transport="ble4")
    assert list(listener.tracks) == ["X"]
    listener.hear(11.0, location(timestamp_s=11.0), transport="ble4")
    assert list(listener.tracks) == ["X"]


def test_one_aircraft_on_two_transports_is_one_track():
    listener = Listener()
    listener.hear(10.0, basic("X"), location(timestamp_s=10.0), transport="wifi", address="w")
    listener.hear(11.0, basic("X"), location(east_m=5.0, timestamp_s=11.0), transport="ble5", address="b")
    assert list(listener.tracks) == ["X"]


def test_what_was_nameless_on_one_transport_joins_the_track_that_has_the_name():
    listener = Listener()
    listener.hear(10.1, basic("X"), location(timestamp_s=10.0), address="w", transport="wifi")
    listener.hear(10.6, location(timestamp_s=10.5), address="b", transport="ble4")
    assert len(listener.tracks) == 2
    listener.hear(10.7, basic("X"), address="b", transport="ble4")
    (track,) = listener.tracks.values()
    assert (track.track_id, track.identity) == ("X", "X")
    assert set(track.sources) == {"wifi/w", "ble4/b"}
    # The newer of both positions stands; what comes later on either transport updates the one track.
    assert track.sample_s == pytest.approx(10.5)
    listener.hear(11.1, location(timestamp_s=11.0), address="b", transport="ble4")
    listener.hear(11.6, location(timestamp_s=11.5), address="w", transport="wifi")
    (track,) = listener.tracks.values()
    assert track.sample_s == pytest.approx(11.5)
    assert listener.traffic.counts.split == 0


def test_a_sender_without_a_clock_joins_its_named_track_too():
    """Its timestamps raise a flag, but no doubt about whose messages these are."""
    listener = Listener()
    for k in range(20):
        north, now = -300.0 + 4.0 * k, 10.0 + 0.5 * k
        told = {"timestamp_s": None, "speed_mps": 8.0, "direction_deg": 0.0}
        listener.hear(now, basic("X"), location(north, **told), address="w", transport="wifi")
        listener.hear(now + 0.2, location(north + 1.6, **told), address="b", transport="ble4")
    assert Flag.NO_TIMESTAMP in listener.tracks["ble4/b"].doubts.flags
    listener.hear(now + 0.3, basic("X"), address="b", transport="ble4")
    assert list(listener.tracks) == ["X"]


def test_a_nameless_track_elsewhere_stays_one_of_its_own():
    listener = Listener()
    listener.hear(10.1, basic("X"), location(timestamp_s=10.0), address="w", transport="wifi")
    listener.hear(10.6, location(900.0, timestamp_s=10.5), address="b", transport="ble4")
    listener.hear(10.7, basic("X"), address="b", transport="ble4")
    assert len(listener.tracks) == 2
    assert {t.identity for t in listener.tracks.values()} == {"X"}


@pytest.mark.parametrize(("away_m", "silent_s"), [(40.0, 0.5), (200.0, 7.0)])
def test_a_copied_name_takes_no_aircraft_off_the_table(away_m, silent_s):
    """Who was not heard for some seconds could be anywhere; that is no reason to drop where it was heard."""
    listener = Listener()
    listener.hear(10.1, location(timestamp_s=10.0, speed_mps=0.0), address="b", transport="ble4")
    for number in range(round(2.0 * silent_s)):
        at_s = 10.5 + 0.5 * number
        copied = location(100.0 + away_m, timestamp_s=at_s)
        listener.hear(at_s + 0.1, basic("X"), copied, address="w", transport="wifi")
    listener.hear(10.2 + silent_s, basic("X"), address="b", transport="ble4")
    places = sorted(t.position_ned_m[0] for t in listener.traffic.tracks.values())
    assert places == pytest.approx([100.0, 100.0 + away_m], abs=1.0)


def test_a_copied_identity_hides_nobody():
    listener = Listener()
    listener.hear(10.0, basic("X"), location(north_m=100.0, timestamp_s=10.0), address="a")
    listener.hear(10.5, basic("X"), location(north_m=-900.0, timestamp_s=10.5), address="b")
    assert len(listener.tracks) == 2
    assert {round(t.position_ned_m[0]) for t in listener.tracks.values()} == {100, -900}


def test_a_second_identity_of_one_address_does_not_rename_it():
    listener = Listener()
    listener.hear(10.0, basic("X"), basic("REG", IdType.CAA_REGISTRATION), location(timestamp_s=10.0))
    listener.hear(11.0, basic("REG", IdType.CAA_REGISTRATION), location(timestamp_s=11.0))
    assert list(listener.tracks) == ["X"]


def test_two_aircraft_with_one_identity_and_address_are_two_tracks():
    """A copied configuration: neither may hide the other, however they take turns."""
    listener = Listener()
    for k in range(20):
        listener.hear(10.0 + k, basic("X"), location(north_m=100.0, east_m=5.0 * k, timestamp_s=10.0 + k))
        away = location(north_m=-700.0, east_m=5.0 * k, timestamp_s=10.5 + k)
        listener.hear(10.5 + k, basic("X"), away)
        listener.traffic.expire(10.5 + k)
        assert {round(t.position_ned_m[0]) for t in listener.tracks.values()} == {100, -700}
    assert listener.traffic.counts.split == 1


def test_tracks_under_one_identity_are_bounded_and_the_true_one_stays():
    listener = Listener()
    for k in range(40):
        listener.hear(10.0 + k, basic("X"), location(north_m=100.0, east_m=5.0 * k, timestamp_s=10.0 + k))
        listener.hear(10.1 + k, location(north_m=300.0 * (k + 2), timestamp_s=10.1 + k))
        assert len(listener.tracks) <= 16
        assert any(abs(t.position_ned_m[0] - 100.0) < 1.0 for t in listener.tracks.values())


@pytest.mark.parametrize(
    ("begins_s", "nearest_m", "farthest_m"), [(0, 500, 5000), (5, 500, 5000), (5, 40, 90)]
)
def test_a_copied_name_that_leaps_about_does_not_drive_out_its_owner(begins_s, nearest_m, farthest_m):
    """Ten copies a second, each elsewhere and from another address; the owner speaks once a second."""
    listener, draw = Listener(), random.Random(1)
    for tenth in range(250):
        now_s = 10.0 + 0.1 * tenth
        stamp = {"timestamp_s": round(now_s, 1)}
        if tenth % 10 == 0:
            east_m = 0.5 * tenth
            listener.hear(now_s, basic("X"), location(100.0, east_m, **stamp), address="owner")
        if tenth >= 10 * begins_s:
            away_m, angle = draw.uniform(nearest_m, farthest_m), draw.uniform(0.0, math.tau)
            copy = location(away_m * math.cos(angle), away_m * math.sin(angle), **stamp)
            listener.hear(now_s, basic("X"), copy, address=f"copy {tenth}")
        places = [t.position_ned_m[:2] for t in listener.tracks.values()]
        assert any(math.dist(place, (100.0, east_m)) < 15.0 for place in places)


def test_the_names_arrival_keeps_the_newer_track():
    listener = Listener()
    listener.hear(10.0, basic("X"), location(timestamp_s=10.0), address="old")
    listener.hear(15.0, location(north_m=120.0, timestamp_s=15.0), address="new")
    listener.hear(15.1, basic("X"), address="new")
    assert max(t.sample_s for t in listener.tracks.values()) == 15.0


def test_a_vague_height_does_not_separate():
    listener = Listener()
    listener.hear(10.0, basic("X"), location(vertical_accuracy_m=150.0))
    assert not listener.tracks["X"].vertical_known


def test_own_identity_counts_as_echo_only_where_we_are():
    listener = Listener()
    for k in range(40):
        listener.traffic.note_own(8.0 + 0.25 * k, (100.0, 5.0 * (0.25 * k - 2.0), 0.0), (0.0, 5.0, 0.0))
    listener.hear(12.0, basic("OWN"), location(north_m=101.0, east_m=0.0, timestamp_s=10.0), address="own")
    assert not listener.tracks
    listener.hear(12.0, basic("OWN"), location(north_m=160.0, timestamp_s=12.0), address="clone")
    assert len(listener.tracks) == 1


def fly_own(listener, to_s=14.0):
    """Ourselves at 5 m/s to the east, at (100, 0) at 10 s."""
    for k in range(round((to_s - 8.0) / 0.25) + 1):
        at_s = 8.0 + 0.25 * k
        listener.traffic.note_own(at_s, (100.0, 5.0 * (at_s - 10.0), 0.0), (0.0, 5.0, 0.0))


@pytest.mark.parametrize(
    "change",
    [
        {"north_m": 108.0},
        {"east_m": -8.0},
        {"direction_deg": 270.0},
        {"speed_mps": 1.5},
        {"alt_geodetic_m": 459.0},
        {"vertical_speed_mps": 4.0},
    ],
    ids=["beside", "behind", "towards us", "slower", "above", "climbing"],
)
def test_a_twin_of_ours_is_seen_unless_it_flies_as_we_do_where_we_do(change):
    listener = Listener()
    fly_own(listener)
    listener.hear(11.0, basic("OWN"), location(timestamp_s=10.0, **change), address="twin")
    assert len(listener.tracks) == 1
    listener = Listener()
    fly_own(listener)
    noisy = {
        "north_m": 103.0,
        "east_m": 2.0,
        "speed_mps": 6.0,
        "direction_deg": 80.0,
        "alt_geodetic_m": 450.0,
    }
    listener.hear(11.0, basic("OWN"), location(timestamp_s=10.0, **noisy), address="own")
    assert not listener.tracks


def test_a_twin_of_ours_that_was_seen_is_followed_up_to_us():
    """Nearer to where it was to be than to us, it is no echo; what we send meanwhile is."""
    listener = Listener()
    fly_own(listener)
    for k in range(5):
        twin = location(north_m=112.0 - 2.0 * k, east_m=5.0 * k, timestamp_s=10.0 + k)
        listener.hear(10.5 + k, basic("OWN"), twin, address="twin")
        listener.hear(10.5 + k, basic("OWN"), location(east_m=5.0 * k, timestamp_s=10.0 + k), address="own")
    (track,) = listener.tracks.values()
    assert track.position_ned_m[:2] == pytest.approx((104.0, 20.0), abs=0.01)
    assert listener.traffic.counts.own_echo == 5


@pytest.mark.parametrize("addresses", ["ab", "aa"], ids=["own address", "copied address"])
def test_after_a_silence_a_twin_does_not_take_the_others_track(addresses):
    """One aircraft could have flown there meanwhile; the other would be unseen from then on."""
    listener = Listener()
    first, second = addresses
    listener.hear(10.0, basic("X"), location(timestamp_s=10.0), address=first)
    listener.hear(10.5, basic("X"), location(north_m=-100.0, timestamp_s=10.5), address=second)
    assert len(listener.tracks) == 2
    # One is not heard for so long that it is forgotten, the other for 6 s.
    listener.hear(20.5, basic("X"), location(north_m=-100.0, east_m=50.0, timestamp_s=20.5), address=second)
    listener.traffic.expire(25.5)
    assert len(listener.tracks) == 1
    listener.hear(26.5, basic("X"), location(north_m=-60.0, east_m=80.0, timestamp_s=26.5), address=first)
    places = sorted(t.position_ned_m[0] for t in listener.tracks.values())
    assert places == pytest.approx([-100.0, -60.0], abs=0.01)


def test_two_of_one_name_that_were_never_heard_apart_are_two():
    listener = Listener()
    listener.hear(10.0, basic("X"), location(timestamp_s=10.0), address="a")
    for k in range(4):
        north_m, address = (140.0, "b") if k % 2 == 0 else (100.0, "a")
        report = location(north_m=north_m, east_m=5.0 * (3.0 + k), timestamp_s=13.0 + k)
        listener.hear(13.2 + k, basic("X"), report, address=address)
    places = sorted(t.position_ned_m[0] for t in listener.tracks.values())
    assert places == pytest.approx([100.0, 140.0], abs=0.01)


@pytest.mark.parametrize("lead_s", [0.0, 4.0])
def test_a_copied_name_cannot_draw_the_track_away_from_its_owner(lead_s):
    """Ten copies a second from another address, 5 m farther aside each second, to 20 m."""
    listener = Listener()
    for tenth in range(200):
        now_s = 10.0 + 0.1 * tenth
        along = {"north_m": 300.0 - 0.5 * tenth, "direction_deg": 180.0}
        if tenth % 10 == 0:
            listener.hear(now_s, basic("X"), location(**along, timestamp_s=round(now_s, 1)), address="owner")
        if tenth > 20:
            aside = {"east_m": min(20.0, 0.5 * tenth - 10.0), "timestamp_s": round(now_s + lead_s, 1)}
            listener.hear(now_s, basic("X"), location(**along, **aside), address="copy")
        now = [
            [p + n.age_s * v for p, v in zip(n.position_ned_m, n.velocity_ned_mps, strict=True)]
            for n in listener.traffic.neighbours(now_s)
        ]
        assert min(math.dist(place[:2], (along["north_m"], 0.0)) for place in now) < 5.0
    assert len(listener.tracks) == 2


def test_an_aircraft_with_two_addresses_on_one_transport_is_no_more_than_two_tracks():
    """Both bands of a Wi-Fi transmitter, in turns."""
    listener = Listener()
    for half in range(60):
        now_s = 10.0 + 0.5 * half
        told = location(east_m=2.5 * half, timestamp_s=round(now_s, 1))
        listener.hear(now_s, basic("X"), told, address="ab"[half % 2])
    assert len(listener.tracks) == 2


def test_an_aircraft_that_changes_its_address_stays_one():
    listener = Listener()
    for k in range(6):
        report = location(north_m=100.0 + 3.0 * (k % 2), east_m=5.0 * k, timestamp_s=10.0 + k)
        listener.hear(10.5 + k, basic("X"), report, address=f"{k}")
    assert len(listener.tracks) == 1
    listener.hear(16.5, basic("X"), location(east_m=30.0, timestamp_s=16.0), address="0", transport="ble5")
    assert len(listener.tracks) == 1


def test_one_that_is_alone_may_have_flown_anywhere_meanwhile():
    listener = Listener()
    listener.hear(10.0, basic("X"), location(timestamp_s=10.0))
    listener.hear(16.5, basic("X"), location(north_m=140.0, east_m=30.0, timestamp_s=16.0))
    assert len(listener.tracks) == 1
