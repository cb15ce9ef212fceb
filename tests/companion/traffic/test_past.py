"""What a track did before: how fast it leaves its predictions, and how long it may be silent."""

from __future__ import annotations

import copy
import math

import pytest

from companion.avoidance.kernels import GROWTH_MOST_MPS
from companion.avoidance.law import ASIDE
from companion.traffic.fix import Fix
from tests.companion.traffic.flights import Listener, circle, fly, location, seconds, straight


def neighbour(listener, now_s=60.0):
    (one,) = [n for n in listener.traffic.neighbours(now_s) if ASIDE not in n.track_id]
    return one


def off_line(aside_m, at_s=13.0):
    """Straight on, but `aside_m` to the side from `at_s` on: the declared velocity tells nothing of it."""
    line = straight()
    return lambda t: (line(t)[0] + (aside_m if t >= at_s else 0.0), *line(t)[1:])


@pytest.mark.parametrize(
    ("aside_m", "growth_mps"),
    [
        # Declared 3 m and three seconds: 0.6 * 3 m + 0.9 * 3 m = 4.5 m are usual; of the rest, divided by the
        # time, 2.5 times is the growth.
        (5.7, 1.0),
        (4.4, 0.0),
        # More than 31 m would be another aircraft.
        (25.0, GROWTH_MOST_MPS),
    ],
)
def test_an_unusual_deviation_from_a_prediction_is_growth(aside_m, growth_mps):
    listener = Listener()
    fly(listener, off_line(aside_m), seconds(4))
    assert neighbour(listener, 14.0).growth_mps == pytest.approx(growth_mps, abs=0.05)


def test_growth_fades():
    listener = Listener()
    fly(listener, off_line(5.7), seconds(44))
    assert neighbour(listener).growth_mps == pytest.approx(1.0 * math.exp(-39.0 / 60.0), abs=0.05)


def test_a_turning_sender_is_known_to_turn_and_a_straight_one_not():
    turning, straight_on = Listener(), Listener()
    fly(turning, circle(10.0, 5.0), seconds(20))
    fly(straight_on, straight(), seconds(20))
    # Its turns lead 16 m aside in three seconds.
    assert neighbour(turning).growth_mps == GROWTH_MOST_MPS
    assert neighbour(straight_on).growth_mps == 0.0


def test_the_same_moment_on_two_transports_is_one():
    listener = Listener()
    for at_s in seconds(20):
        for transport in ("wifi", "ble5"):
            fly(listener, straight(), [at_s], transport=transport, address=transport)
    assert neighbour(listener).growth_mps == 0.0
    assert len(listener.traffic.tracks) == 1


@pytest.mark.parametrize("unknown", [{"alt_geodetic_m": None}, {"vertical_accuracy_m": 45.0}])
def test_a_height_that_comes_and_goes_is_no_manoeuvre(unknown):
    """50 m above the frame's origin while it is known, in the middle of it while not."""
    listener = Listener()
    for number, at_s in enumerate(seconds(30)):
        fly(listener, straight(), [at_s], **(unknown if number // 5 % 2 else {}))
    assert neighbour(listener).growth_mps == 0.0
    assert neighbour(listener).growth_down_mps == 0.0


@pytest.mark.parametrize("often", range(1, 8))
@pytest.mark.parametrize("sinks_mps", [-5.0, 2.0, 10.0])
def test_a_declared_climb_whose_height_comes_and_goes_is_no_manoeuvre(sinks_mps, often):
    """It becomes known or unknown between the messages that are compared, three seconds apart."""
    listener = Listener()
    for number, at_s in enumerate(seconds(30)):
        height = {"alt_geodetic_m": 597.0 - sinks_mps * (at_s - 10.0), "vertical_speed_mps": -sinks_mps}
        unknown = {"vertical_accuracy_m": 45.0} if number // often % 2 else {}
        fly(listener, straight(), [at_s], **height, **unknown)
        assert neighbour(listener, at_s + 0.2).growth_down_mps == 0.0


def test_a_turn_is_seen_also_without_height():
    listener = Listener()
    fly(listener, circle(10.0, 5.0), seconds(20), alt_geodetic_m=None)
    assert neighbour(listener).growth_mps > 1.5


@pytest.mark.parametrize(
    ("accuracy_m", "grows"), [(3.0, True), (45.0, False)], ids=["known", "too inaccurate to be known"]
)
def test_a_climb_that_is_not_declared_is_growth_where_the_height_is_known(accuracy_m, grows):
    listener = Listener()
    for at_s in seconds(20):
        height = {"alt_geodetic_m": 497.0 + 3.0 * (at_s - 10.0), "vertical_accuracy_m": accuracy_m}
        fly(listener, straight(), [at_s], **height)
    assert (neighbour(listener).growth_down_mps > 1.0) is grows
    assert neighbour(listener).growth_mps == 0.0
    assert neighbour(listener).vertical_known is grows


@pytest.mark.parametrize("unknown", [{"alt_geodetic_m": None}, {"vertical_accuracy_m": 45.0}])
def test_a_turn_is_seen_also_where_the_height_comes_and_goes(unknown):
    listener = Listener()
    for number, at_s in enumerate(seconds(20)):
        fly(listener, circle(10.0, 5.0), [at_s], **(unknown if number % 2 else {}))
    assert neighbour(listener).growth_mps == GROWTH_MOST_MPS


def test_what_is_thought_of_a_senders_clock_is_no_manoeuvre():
    """Its lead is learnt from messages that came late, and corrected by 1.4 s: 42 m of way."""
    listener = Listener()
    for number, at_s in enumerate(seconds(20)):
        fly(listener, straight(30.0), [at_s], delay_s=1.5 if number < 10 else 0.1, clock_s=3.0)
    assert neighbour(listener).growth_mps == 0.0


# ------------------------------------------------------------ velocity


@pytest.mark.parametrize("rate_hz", [1.0, 2.0, 5.0, 10.0])
def test_however_often_positions_come_a_velocity_comes_of_them(rate_hz):
    listener = Listener()
    at_s = seconds(30, rate_hz=rate_hz)
    fly(listener, straight(), at_s, speed_mps=None, direction_deg=None, vertical_speed_mps=None)
    assert neighbour(listener).velocity_ned_mps == pytest.approx((0.0, 15.0, 0.0), abs=0.1)
    assert listener.traffic.tracks["X"].velocity_known


NOTHING_OF_MOTION = {"speed_mps": None, "direction_deg": None, "vertical_speed_mps": None}


@pytest.mark.parametrize(
    ("change", "down_mps"),
    [({}, -3.0), ({"alt_geodetic_m": None}, 0.0), ({"vertical_accuracy_m": 45.0}, 0.0)],
    ids=["known", "no height", "too inaccurate to be known"],
)
def test_a_climb_comes_of_the_heights_if_they_are_known(change, down_mps):
    listener = Listener()
    for at_s in seconds(10, rate_hz=2.0):
        height = {"alt_geodetic_m": 497.0 + 3.0 * (at_s - 10.0)}
        fly(listener, straight(), [at_s], **NOTHING_OF_MOTION, **(height | change))
    assert neighbour(listener).velocity_ned_mps == pytest.approx((0.0, 15.0, down_mps), abs=0.1)


def test_a_height_that_is_heard_for_the_first_time_is_no_climb():
    listener = Listener()
    fly(listener, straight(), seconds(3), **NOTHING_OF_MOTION, alt_geodetic_m=None)
    fly(listener, straight(), [13.0], **NOTHING_OF_MOTION, alt_geodetic_m=597.0)
    assert neighbour(listener).velocity_ned_mps == pytest.approx((0.0, 15.0, 0.0), abs=0.1)


# ------------------------------------------------------------ silence


def assert_silent_after(listener, received_s, silent_s):
    assert not neighbour(listener, received_s + silent_s - 0.01).silent
    assert neighbour(listener, received_s + silent_s + 0.01).silent


@pytest.mark.parametrize("delay_s", [0.2, 1.2])
@pytest.mark.parametrize(("every_s", "silent_s"), [(0.5, 2.2), (1.0, 2.2), (3.0, 6.6)])
def test_silence_means_something_after_the_senders_own_gaps(every_s, silent_s, delay_s):
    """2.2 of its longest gaps, each at least 1 s, from the last reception on: a message that
    came late was no silence."""
    listener = Listener()
    sent_s = seconds(21, rate_hz=1.0 / every_s)
    fly(listener, straight(), sent_s, delay_s=delay_s)
    assert_silent_after(listener, sent_s[-1] + delay_s, silent_s)


def test_one_long_gap_is_remembered_and_fades():
    listener = Listener()
    fly(listener, straight(), [*seconds(5), *seconds(1, start_s=18.0)])
    assert_silent_after(listener, 18.2, 2.2 * 4.0)
    fly(listener, straight(), seconds(60, start_s=19.0))
    assert_silent_after(listener, 78.2, 2.2 * 4.0 * math.exp(-1.0))


def test_a_first_message_says_nothing_of_the_past():
    listener = Listener()
    listener.hear(10.2, location(straight(), 10.0))
    assert neighbour(listener, 10.2).growth_mps == 0.0
    assert_silent_after(listener, 10.2, 2.2)


@pytest.mark.parametrize(("steps_m", "threat"), [(0.0, False), (20.0, True)])
def test_one_whose_height_is_unpredictable_is_a_threat_farther_above(steps_m, threat):
    """It passes 42 m above, and its height leaps every six seconds: the law keeps clear of as much."""
    listener = Listener()
    for number, at_s in enumerate(seconds(32)):
        listener.traffic.note_own(
            at_s, (200.0, -300.0 + 15.0 * (at_s - 10.0) + 60.0, -20.0), (0.0, 12.0, 0.0)
        )
        height = {"alt_geodetic_m": 447.0 + 62.0 + (steps_m if number // 6 % 2 else 0.0)}
        fly(listener, straight(), [at_s], **height)
    (track,) = listener.traffic.tracks.values()
    assert track.past.growth_mps == 0.0
    assert (track.past.growth_down_mps > 2.0) is threat
    assert (track.threat_s > 0.0) is threat


def test_a_new_track_takes_over_the_growth_of_the_nearest():
    """Of two tracks that its address feeds, whichever comes first."""
    listener = Listener()
    fly(listener, straight(), seconds(4))
    (near,) = listener.traffic.tracks.values()
    north, east, down = near.position_ned_m
    far, new = copy.deepcopy(near), copy.deepcopy(near)
    far.position_ned_m = (north + 15.0, east, down)
    near.past, far.past = near.past._replace(growth_mps=1.0), far.past._replace(growth_mps=2.0)
    fix = Fix((north, east, down), near.velocity_ned_mps, 3.0, 0.5, True, near.sample_s, 0.0, near.content)
    for others in ((near, far), (far, near)):
        new.past = new.past._replace(growth_mps=0.0)
        new.inherit(others, fix, near.sample_s)
        assert new.past.growth_mps == 1.0
