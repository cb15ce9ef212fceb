"""Tracks that turn out to be one aircraft, and which track gives way in a full table."""

from __future__ import annotations

import math

import pytest

from companion.remote_id.messages import IdType
from companion.traffic.table import TRACKS_PER_IDENTITY
from tests.companion.traffic.flights import Listener, basic, fly, location, seconds, straight


@pytest.mark.parametrize(
    ("beside_m", "joined"),
    [(0.0, True), (14.0, True), (16.0, False)],
)
@pytest.mark.parametrize("named_first", [True, False])
def test_a_nameless_track_joins_where_the_named_one_has_flown_to(beside_m, joined, named_first):
    """Two seconds later, 40 m farther at 20 m/s."""
    listener = Listener()
    motion, beside = straight(20.0, north_m=0.0), straight(20.0, north_m=beside_m)
    named_s, nameless_s = (10.0, 12.0) if named_first else (12.0, 10.0)
    heard = [
        (named_s, lambda: listener.hear(named_s + 0.1, basic("X"), location(motion, named_s), address="w")),
        (
            nameless_s,
            lambda: listener.hear(
                nameless_s + 0.1, location(beside, nameless_s), address="b", transport="ble4"
            ),
        ),
    ]
    for _, hear in sorted(heard, key=lambda entry: entry[0]):
        hear()
    listener.hear(12.5, basic("X"), address="b", transport="ble4")
    assert len(listener.traffic.tracks) == (1 if joined else 2)


@pytest.mark.parametrize(
    ("changed", "joined"),
    [
        ({"alt_geodetic_m": 507.0}, True),
        ({"alt_geodetic_m": 557.0}, False),
        ({"alt_geodetic_m": 437.0}, False),
        ({"alt_geodetic_m": None}, True),
        ({"direction_deg": 80.0}, True),
        ({"direction_deg": 20.0}, False),
    ],
)
def test_a_nameless_track_at_another_height_or_on_another_course_does_not_join(changed, joined):
    """The named one is at 497 m and flies east at 20 m/s; heights are known to 3 m."""
    listener = Listener()
    listener.hear(10.1, basic("X"), location(straight(20.0), 10.0), address="w")
    listener.hear(11.1, location(straight(20.0), 11.0, **changed), address="b", transport="ble4")
    listener.hear(11.5, basic("X"), address="b", transport="ble4")
    assert len(listener.traffic.tracks) == (1 if joined else 2)


@pytest.mark.parametrize("name", [basic("X", IdType.NONE), basic("")])
def test_an_identity_of_no_kind_or_without_text_is_none(name):
    listener = Listener()
    for address in "ab":
        listener.hear(10.2, name, location(straight(), 10.0), address=address)
    assert set(listener.traffic.tracks) == {"wifi/a", "wifi/b"}


def test_an_established_track_that_flew_away_gives_way_before_one_that_is_nearer():
    """We are at the origin; who left was the nearest when it was established. The new one flies at us."""
    listener = Listener(max_tracks=2)
    leaving = straight(60.0, north_m=0.0, east_m=20.0)
    fly(listener, leaving, seconds(24), identity="LEAVING", address="l")
    fly(listener, straight(0.0, 300.0, 0.0), seconds(4, 30.0), identity="STAYING", address="s")
    listener.traffic.note_own(36.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def approaching(t):
        """At our height, unlike the others."""
        return 5.0, 15.0 * (t - 44.0), 0.0, 15.0, 0.0

    fly(listener, approaching, [36.0], identity="NEW", address="n")
    assert set(listener.traffic.tracks) == {"STAYING", "NEW"}


def test_in_a_full_table_a_newcomer_that_ranks_last_is_left_out():
    """It is in nobody's way, and those that are held have been heard for longer."""
    listener = Listener(max_tracks=2)
    for name, north_m in (("A", 300.0), ("B", -300.0)):
        fly(listener, straight(0.0, north_m, 0.0), seconds(8), identity=name, address=name)
    fly(listener, straight(0.0, 0.0, 300.0), seconds(3, 20.0), identity="NEW", address="n")
    assert set(listener.traffic.tracks) == {"A", "B"}
    assert listener.traffic.counts.refused_full == 3
    assert len(listener.traffic._table.ranking) == 2


def test_a_copy_that_is_no_threat_does_not_take_the_place_of_those_that_are():
    """We are at the origin. All that are held fly at us, from different directions; one seems to jump."""
    listener = Listener()
    listener.traffic.note_own(10.0, (0.0, 0.0, -50.0), (0.0, 0.0, 0.0))

    def coming(number):
        angle = math.tau * number / TRACKS_PER_IDENTITY
        n, e = math.cos(angle), math.sin(angle)
        return lambda t: (150.0 * n, 150.0 * e, -15.0 * n, -15.0 * e, 50.0)

    for number in range(TRACKS_PER_IDENTITY):
        fly(listener, coming(number), [10.0], address=f"{number}")
    held = set(listener.traffic.tracks)
    assert len(held) == TRACKS_PER_IDENTITY
    fly(listener, straight(0.0, 900.0, 900.0), [10.1], address="0")
    assert set(listener.traffic.tracks) == held
    assert listener.traffic.counts.refused_full == 1


def test_an_unknown_height_is_no_manoeuvre():
    """Heard every five seconds, flying straight on."""
    listener = Listener()
    fly(listener, straight(), seconds(10, rate_hz=0.2), alt_geodetic_m=None)
    (track,) = listener.traffic.tracks.values()
    assert track.past.growth_mps == pytest.approx(0.0, abs=0.01)
