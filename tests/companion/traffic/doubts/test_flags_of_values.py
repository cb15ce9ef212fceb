"""Doubts about times, velocities, places and altitudes."""

from __future__ import annotations

import math
import random

import pytest

from companion.remote_id.messages import Location
from companion.traffic.fix import Fix
from companion.traffic.plausibility import Flag, MotionWindow, climbs_impossibly
from tests.companion.traffic.flights import (
    Listener,
    fly,
    seconds,
    stop_and_go,
    straight,
)

# ---------------------------------------------------------------- timestamps


@pytest.mark.parametrize("clock_s", [-3.0, -4.5, -20.0, -900.0])
def test_stale_timestamps(clock_s):
    listener = Listener()
    fly(listener, straight(), seconds(15), clock_s=clock_s)
    assert listener.flags() == {Flag.STALE_TIMESTAMP}


def test_a_late_second_reception_now_and_then_is_not_stale():
    listener = Listener()
    for k, t in enumerate(seconds(60)):
        fly(listener, straight(), [t], delay_s=2.5 if k % 3 == 0 else 0.8)
    assert Flag.STALE_TIMESTAMP not in listener.ever


@pytest.mark.parametrize("clock_s", [1.0, 4.0, 18.0, 900.0])
def test_future_timestamps(clock_s):
    listener = Listener()
    fly(listener, straight(), seconds(15), clock_s=clock_s)
    assert listener.flags() == {Flag.FUTURE_TIMESTAMP}


def test_a_lead_within_the_declared_accuracy_is_no_doubt():
    listener = Listener()
    fly(listener, straight(), seconds(15), clock_s=1.5, timestamp_accuracy_s=1.5)
    assert listener.ever == set()


def test_one_wrong_timestamp_is_no_doubt():
    listener = Listener()
    for k, t in enumerate(seconds(30)):
        fly(listener, straight(), [t], clock_s=4.0 if k == 7 else 0.0)
    assert listener.ever == set()


@pytest.mark.parametrize("clock_s", [-900.0, 900.0])
def test_without_our_own_utc_no_clock_is_doubted(clock_s):
    listener = Listener(utc_offset_s=None)
    fly(listener, straight(), seconds(15), clock_s=clock_s)
    assert listener.ever == set()


def test_no_timestamp_and_its_end():
    listener = Listener()
    fly(listener, straight(), seconds(10), timestamp_s=None)
    assert listener.flags() == {Flag.NO_TIMESTAMP}
    fly(listener, straight(), seconds(10, 20.0))
    assert listener.flags() == frozenset()


def test_timestamps_across_the_full_hour_are_sound():
    listener = Listener()
    fly(listener, straight(), seconds(60, 3570.0))
    assert listener.ever == set()


# ---------------------------------------------------------------- velocity and values


@pytest.mark.parametrize(
    "change",
    [
        {"speed_mps": 0.0},
        {"direction_deg": 270.0},
        {"direction_deg": 0.0, "speed_mps": 30.0},
    ],
)
@pytest.mark.parametrize("rate_hz", [1.0, 4.0])
def test_velocity_that_the_positions_do_not_follow(change, rate_hz):
    listener = Listener()
    motion = straight(20.0)
    fly(listener, motion, seconds(int(20 * rate_hz), rate_hz=rate_hz), **change)
    assert listener.flags() == {Flag.VELOCITY_MISMATCH}
    fly(listener, motion, seconds(int(25 * rate_hz), 30.0, rate_hz))
    assert listener.flags() == frozenset()


def strays(first_mps, rest_mps, gap_s, off_m, stamped=True, **content):
    """Whether a window's last position, `off_m` farther east than velocities lead, speaks against them."""
    made, last = [], math.ceil(5.0 / gap_s)
    for k in range(last + 1):
        v_mps = rest_mps if k else first_mps
        # The first interval is travelled at the mean of both velocities.
        east_m = gap_s * (0.5 * (first_mps + rest_mps) + rest_mps * (k - 1)) if k else 0.0
        made.append(
            Fix(
                position=(0.0, east_m + (off_m if k == last else 0.0), 0.0),
                velocity=(0.0, v_mps, 0.0),
                sigma_m=3.0,
                sigma_mps=0.5,
                vertical_known=True,
                stamp_s=10.0 + gap_s * k if stamped else None,
                lead_s=0.0,
                content=Location(**content),
            )
        )
    window = MotionWindow(made[0], 10.2)
    answers = [window.check(fix, 10.2 + gap_s * k) for k, fix in enumerate(made[1:], start=1)]
    assert answers[:-1] == [None] * (last - 1)
    return answers[-1]


DECLARED = {"horizontal_accuracy_m": 1.0, "speed_accuracy_mps": 1.0}


@pytest.mark.parametrize(
    ("first_mps", "rest_mps", "gap_s", "stamped", "content", "allowed_m"),
    [
        # Per second 2.5 m times the gap, and the velocity's accuracy; thrice both positions' accuracies.
        (0.0, 0.0, 1.0, True, DECLARED, 5.0 * 3.5 + 6.0),
        (0.0, 0.0, 2.0, True, DECLARED, 6.0 * 6.0 + 6.0),
        (0.0, 0.0, 5.0, True, DECLARED, 5.0 * 13.5 + 6.0),
        (0.0, 0.0, 1.0, True, {}, 5.0 * 5.5 + 60.0),
        # Half a second, or two without timestamps, of the greater speed; 2 % of the way.
        (20.0, 20.0, 1.0, True, DECLARED, 23.5 + 10.0 + 2.0),
        (20.0, 20.0, 1.0, False, DECLARED, 23.5 + 40.0 + 2.0),
        (20.0, 0.0, 1.0, True, DECLARED, 23.5 + 10.0 + 0.2),
        (0.0, 20.0, 1.0, True, DECLARED, 23.5 + 10.0 + 1.8),
    ],
)
def test_how_far_positions_may_stray_from_the_velocities(
    first_mps, rest_mps, gap_s, stamped, content, allowed_m
):
    def judged(off_m):
        return strays(first_mps, rest_mps, gap_s, off_m, stamped, **content)

    assert judged(allowed_m - 0.1) is False
    assert judged(allowed_m + 0.1) is True
    assert judged(-allowed_m - 0.1) is True


@pytest.mark.parametrize("gap_s", [5.1, 60.0])
def test_after_a_long_gap_positions_and_velocities_are_not_compared(gap_s):
    assert strays(0.0, 0.0, gap_s, 1e6, **DECLARED) is None


PRECISE = {"horizontal_accuracy_m": 1.0, "speed_accuracy_mps": 0.3}


def test_short_stops_between_messages():
    """Heard every 4.5 s, always at cruise; in between it brakes to a hover and goes on."""
    listener = Listener()
    motion = stop_and_go(8.0, 5.0, cruise_s=0.2, hover_s=1.1)
    fly(listener, motion, [0.1 + 4.5 * k for k in range(4, 24)], **PRECISE)
    assert listener.ever == set()
    assert listener.traffic.tracks["X"].messages == 20


@pytest.mark.parametrize("stamped", [True, False])
def test_fast_and_dated_a_little_wrong(stamped):
    """60 m/s: timestamps 0.3 s off either way, or none and up to 0.9 s of delay."""
    listener = Listener()
    for k, t in enumerate(seconds(60)):
        late = k // 5 % 2
        if stamped:
            fly(listener, straight(60.0), [t], clock_s=0.6 * late - 0.3, **PRECISE)
        else:
            fly(listener, straight(60.0), [t], delay_s=0.9 * late, timestamp_s=None, **PRECISE)
    assert listener.ever == (set() if stamped else {Flag.NO_TIMESTAMP})


def test_noise_of_thirty_metres_where_that_is_declared():
    listener = Listener()
    generator = random.Random(6)
    for t in seconds(120):
        motion = straight(5.0, generator.gauss(200.0, 20.0), generator.gauss(-300.0, 20.0))
        fly(listener, motion, [t], horizontal_accuracy_m=30.0, speed_accuracy_mps=0.3)
    assert listener.ever == set()


def test_long_silences_neither_raise_nor_end_a_mismatch():
    listener = Listener()
    fly(listener, straight(20.0), seconds(20), speed_mps=0.0)
    assert listener.flags() == {Flag.VELOCITY_MISMATCH}
    fly(listener, straight(20.0), [40.0, 49.0, 58.0, 67.0])
    assert listener.flags() == {Flag.VELOCITY_MISMATCH}


def test_a_still_position_with_a_velocity():
    listener = Listener()
    fly(listener, straight(0.0), seconds(20), speed_mps=15.0, direction_deg=45.0)
    assert listener.flags() == {Flag.VELOCITY_MISMATCH}


def test_an_unknown_velocity_is_no_mismatch():
    listener = Listener()
    fly(listener, straight(), seconds(30), speed_mps=None, direction_deg=None)
    assert listener.ever == set()


def test_a_velocity_mismatch_that_reception_times_explain():
    """Without timestamps, heard 0 to 1.5 s late: positions and times do not fit well."""
    listener = Listener()
    generator = random.Random(4)
    for t in seconds(60):
        fly(listener, straight(10.0), [t], delay_s=generator.uniform(0.0, 0.9), timestamp_s=None)
    assert listener.ever == {Flag.NO_TIMESTAMP}


def test_a_speed_that_cannot_be():
    """The message is not believed; the track it would have moved says why."""
    listener = Listener()
    fly(listener, straight(), seconds(5))
    fly(listener, straight(), seconds(3, 15.0), speed_mps=200.0)
    assert listener.flags() == {Flag.IMPOSSIBLE_VALUES}


def test_a_place_that_cannot_be():
    listener = Listener()
    fly(listener, straight(), seconds(5))
    fly(listener, straight(north_m=90_000.0), seconds(3, 15.0))
    assert listener.flags() == {Flag.IMPOSSIBLE_VALUES}


@pytest.mark.parametrize(
    ("elapsed_s", "accuracy_m", "possible_m"),
    [
        # Three times both accuracies (25 m if not declared), and 62 m/s for half a second more than elapsed.
        (0.0, 3.0, 18.0 + 31.0),
        (1.0, 3.0, 18.0 + 93.0),
        (-1.0, 3.0, 18.0 + 93.0),
        (4.0, 10.0, 60.0 + 279.0),
        (1.0, None, 150.0 + 93.0),
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_greatest_change_of_altitude(elapsed_s, accuracy_m, possible_m, sign):
    def at(alt_m):
        return Location(alt_geodetic_m=alt_m, vertical_accuracy_m=accuracy_m)

    assert not climbs_impossibly(at(500.0), at(500.0 + sign * (possible_m - 0.1)), elapsed_s)
    assert climbs_impossibly(at(500.0), at(500.0 + sign * (possible_m + 0.1)), elapsed_s)
    assert not climbs_impossibly(at(500.0), at(None), elapsed_s)
    assert not climbs_impossibly(at(None), at(500.0), elapsed_s)


@pytest.mark.parametrize(
    ("sent_s", "heard_s", "possible"),
    [
        ([10.0, 14.5], [10.1, 14.6], True),
        ([10.0, 14.5], [14.6, 14.7], True),
        ([14.0, 14.5], [14.1, 19.0], True),
        ([14.0, 14.5], [14.1, 14.6], False),
    ],
)
def test_altitude_changes_with_the_longer_of_what_passed_for_sender_and_receiver(sent_s, heard_s, possible):
    """450 m are too much for half a second, and possible in 4.4 s. With 45 m of error it is one aircraft."""
    listener = Listener()
    for k, (at_s, now_s) in enumerate(zip(sent_s, heard_s, strict=True)):
        change = {"alt_geodetic_m": 500.0 + 450.0 * k, "vertical_accuracy_m": 45.0}
        fly(listener, straight(), [at_s], delay_s=now_s - at_s, **change)
    (track,) = listener.traffic.tracks.values()
    assert track.messages == 2
    assert (Flag.IMPOSSIBLE_VALUES not in track.doubts.evidence) is possible


def test_altitudes_that_leap():
    """With a declared accuracy they are two aircraft; otherwise the height is not known, and they are one."""
    listener, vague = Listener(), Listener()
    for k, t in enumerate(seconds(10)):
        alt_m = 447.0 + 600.0 * (k % 2)
        fly(listener, straight(), [t], alt_geodetic_m=alt_m)
        fly(vague, straight(), [t], alt_geodetic_m=alt_m, vertical_accuracy_m=45.0)
    assert [t.flags for t in listener.traffic.tracks.values()] == [{Flag.DUPLICATE_IDENTITY}] * 2
    assert vague.flags() == {Flag.IMPOSSIBLE_VALUES}


def test_an_altitude_that_cannot_be():
    listener = Listener()
    fly(listener, straight(), seconds(5), alt_geodetic_m=30_000.0)
    assert listener.flags() == {Flag.IMPOSSIBLE_VALUES}


@pytest.mark.parametrize("climb_mps", [10.0, -40.0, 60.0])
def test_a_climb_or_dive_is_possible(climb_mps):
    listener = Listener()
    for t in seconds(20):
        fly(
            listener,
            straight(),
            [t],
            alt_geodetic_m=2000.0 + climb_mps * (t - 10.0),
            vertical_speed_mps=climb_mps,
        )
    assert listener.ever == set()


def test_the_first_altitude_of_a_receiver_is_forgiven():
    listener = Listener()
    fly(listener, straight(), seconds(5), alt_geodetic_m=0.0)
    fly(listener, straight(), seconds(20, 15.0))
    assert listener.ever == set()
