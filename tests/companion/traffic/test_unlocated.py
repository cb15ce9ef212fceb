"""Transmitters that report that they have no position."""

from __future__ import annotations

import pytest

from companion.remote_id.messages import Location
from tests.companion.traffic.listening import UTC_OFFSET_S, Listener, basic, location

LOST = Location(timestamp_s=20.0)


def at(second, **more):
    return location(east_m=5.0 * second, timestamp_s=10.0 + second, **more)


def silent(listener, now_s):
    return {n.track_id: n.silent for n in listener.traffic.neighbours(now_s)}


def test_an_aircraft_that_reports_no_position_may_have_stopped_at_once():
    listener = Listener()
    for second in range(3):
        listener.hear(10.2 + second, basic("X"), at(second))
    assert silent(listener, 12.5) == {"X": False}
    listener.hear(13.2, LOST)
    assert silent(listener, 13.3) == {"X": True}
    listener.hear(14.2, at(4))
    assert silent(listener, 14.3) == {"X": False}


def fly_with_two(listener, seconds, *, lost_s, both_lost_s=99):
    """Two transmitters, each with a GNSS of its own; the second one loses it at `lost_s`. Yields after each
    message."""
    for second in range(seconds):
        for address, transport, after_s, until in (
            ("a", "wifi", 0.0, both_lost_s),
            ("b", "ble5", 0.4, lost_s),
        ):
            told = at(second + after_s) if second < until else LOST
            now_s = 10.2 + second + after_s
            listener.hear(now_s, basic("X"), told, address=address, transport=transport)
            yield second, silent(listener, now_s + 0.1)


def test_of_two_transmitters_the_one_that_lost_its_position_changes_nothing():
    """The other one says where the aircraft is, from its next message on."""
    told = [found for second, found in fly_with_two(Listener(), 20, lost_s=5) if second > 5]
    assert told == [{"X": False}] * len(told)


def test_if_both_have_lost_their_position_the_aircraft_may_have_stopped():
    told = [found for second, found in fly_with_two(Listener(), 14, lost_s=5, both_lost_s=10) if second >= 10]
    assert told == [{"X": True}] * len(told)


@pytest.mark.parametrize("lead_s", [0.0, 1.0, None])
def test_every_transport_of_one_transmitter_tells_that_its_position_is_lost(lead_s):
    """Its frames on Wi-Fi are lost; those on Bluetooth had the same positions. Its clock may lead, or be of
    no use because our own UTC is unknown."""
    listener = Listener(None if lead_s is None else UTC_OFFSET_S)
    for second in range(5):
        told = location(east_m=5.0 * second, timestamp_s=10.0 + second + (lead_s or 0.0))
        for transport in ("wifi", "ble5"):
            listener.hear(10.2 + second, basic("X"), told, transport=transport)
    listener.hear(15.2, basic("X"), LOST, transport="ble5")
    assert silent(listener, 15.3) == {"X": True}
