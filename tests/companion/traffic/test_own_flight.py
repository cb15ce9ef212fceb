"""Which message with our identity is our own, heard again, and which is another aircraft."""

from __future__ import annotations

import math

import pytest

from companion.remote_id.messages import Location
from companion.traffic.fix import Fix
from companion.traffic.own_flight import OwnFlight

SPEED_MPS = 4.0


def east_m(at_s):
    """Our way: east at 4 m/s."""
    return SPEED_MPS * (at_s - 10.0)


def flown(from_s=5.0, to_s=15.0):
    """Ourselves, at the place 0 at 10 s."""
    own, steps = OwnFlight(), round((to_s - from_s) / 0.25)
    for k in range(steps + 1):
        at_s = from_s + 0.25 * k
        own.note(at_s, (0.0, east_m(at_s), 0.0), (0.0, SPEED_MPS, 0.0))
    return own


def fix(north_m=0.0, east_m=0.0, down_m=0.0, velocity=(0.0, SPEED_MPS, 0.0), stamp_s=None, vertical=True):
    return Fix(
        position=(north_m, east_m, down_m),
        velocity=velocity,
        sigma_m=3.0,
        sigma_mps=0.5,
        vertical_known=vertical,
        stamp_s=stamp_s,
        lead_s=None,
        content=Location(),
    )


@pytest.mark.parametrize("stamp_s", [10.0, 10.1, 12.35])
def test_a_timestamp_tells_where_we_were(stamp_s):
    """Between two samples we flew on; one aircraft length aside is not far."""
    own = flown()
    assert own.distance_m(fix(0.0, east_m(stamp_s), stamp_s=stamp_s), 15.0) == pytest.approx(0.0, abs=1e-9)
    assert own.distance_m(fix(3.0, east_m(stamp_s), stamp_s=stamp_s), 15.0) == pytest.approx(3.0)


@pytest.mark.parametrize("beyond_s", [0.5, 1.0])
def test_a_timestamp_after_the_last_sample_continues_the_flight(beyond_s):
    ahead = fix(0.0, east_m(15.0 + beyond_s), stamp_s=15.0 + beyond_s)
    assert flown().distance_m(ahead, 15.0 + beyond_s) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("change", "ours"),
    [
        # Beside: 5 m for two receivers, and half a second of our 4 m/s for two clocks.
        ({"north_m": 6.9}, True),
        ({"north_m": -7.1}, False),
        ({"east_m": 6.9}, True),
        ({"east_m": -7.1}, False),
        ({"down_m": 9.9}, True),
        ({"down_m": -10.1}, False),
        ({"down_m": 10.1, "vertical": False}, True),
        ({"velocity": (2.9, SPEED_MPS, 0.0)}, True),
        ({"velocity": (0.0, SPEED_MPS, -3.1)}, False),
        ({"velocity": None}, True),
    ],
)
@pytest.mark.parametrize("stamp_s", [10.0, None])
def test_how_near_to_our_own_flight_a_message_must_be(change, ours, stamp_s):
    own = OwnFlight()
    own.note(10.0, (0.0, 0.0, 0.0), (0.0, SPEED_MPS, 0.0))
    assert (own.distance_m(fix(stamp_s=stamp_s, **change), 10.0) < math.inf) is ours


@pytest.mark.parametrize(("now_s", "ours"), [(12.9, True), (13.1, False)])
def test_without_a_timestamp_an_own_frame_may_be_three_seconds_old(now_s, ours):
    """Some radios repeat the last frame; later than that, nothing of ours is on the air any more."""
    own = OwnFlight()
    own.note(10.0, (0.0, 0.0, 0.0), (0.0, SPEED_MPS, 0.0))
    assert (own.distance_m(fix(), now_s) < math.inf) is ours
    # With its timestamp it is known to be ours, however late it comes.
    assert own.distance_m(fix(stamp_s=10.0), now_s) == 0.0


def test_without_a_timestamp_the_nearest_of_our_places_counts():
    """We were 1 m from it a second ago; now we are 5 m from it, within the tolerance too."""
    assert flown(to_s=11.0).distance_m(fix(1.0, east_m(10.0)), 11.0) == pytest.approx(1.0)


def test_before_any_own_state_nothing_is_ours():
    own = OwnFlight()
    assert own.position == (0.0, 0.0, 0.0)
    assert own.distance_m(fix(), 10.0) == math.inf
    assert own.distance_m(fix(stamp_s=10.0), 10.0) == math.inf


def test_a_flight_is_stored_four_times_a_second_and_for_25_seconds():
    own = OwnFlight()
    for k in range(1000):
        own.note(0.05 * k, (float(k), 0.0, 0.0), (20.0, 0.0, 0.0))
    assert len(own) == 100
    # 49.95 s are over, every fifth state was kept: the last one is of 49.75 s.
    assert own.position == (995.0, 0.0, 0.0)
    # A message of 25 s ago is still recognised by where we were.
    assert own.distance_m(fix(500.0, 0.0, velocity=None, stamp_s=25.0), 50.0) == pytest.approx(0.0, abs=1e-6)
    own.clear()
    assert len(own) == 0
