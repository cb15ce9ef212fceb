"""Which aircraft a full table of ADS-B gives up."""

from __future__ import annotations

import pytest

from companion.traffic.adsb import MOST
from tests.companion.traffic.sky import ICAO, Sky, report


def icaos(sky, now_s):
    return {int(seen.track_id, 16) for seen in sky.at(now_s)}


@pytest.mark.parametrize(("heard", "kept"), [(1, False), (2, False), (3, True)])
def test_one_that_was_heard_three_times_is_not_given_up_for_one_that_is_heard_once(heard, kept):
    """It is the farthest of a full table, and the newcomer is near."""
    sky = Sky()
    for tick in range(5):
        sky.take(10.0 + tick, *[report(15_000.0 + 50.0 * tick, icao=0xA00000 + k) for k in range(MOST - 1)])
    for tick in range(heard):
        sky.take(15.0 + tick, report(0.0, 30_000.0 + 50.0 * tick))
    sky.take(18.0, report(1000.0, 500.0, icao=0xC00000))
    assert ({ICAO, 0xC00000} & icaos(sky, 18.0)) == ({ICAO} if kept else {0xC00000})


@pytest.mark.parametrize(("speed_mps", "kept"), [(60.0, True), (10.0, False)])
def test_one_that_was_a_threat_just_now_is_not_given_up_for_a_nearer_one(speed_mps, kept):
    """It has slowed down. Both were heard too seldom to be established."""
    sky = Sky()
    for tick in range(5):
        sky.take(10.0 + tick, *[report(15_000.0 + 50.0 * tick, icao=0xA00000 + k) for k in range(MOST - 1)])
    sky.take(15.0, report(5000.0, velocity_ned_mps=(-speed_mps, 0.0, 0.0)))
    sky.take(18.0, report(4900.0, velocity_ned_mps=(-10.0, 0.0, 0.0)))
    sky.take(18.1, report(1000.0, 500.0, icao=0xC00000))
    assert ({ICAO, 0xC00000} & icaos(sky, 18.1)) == ({ICAO} if kept else {0xC00000})
