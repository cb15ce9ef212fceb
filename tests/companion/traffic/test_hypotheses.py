"""Two senders under one name and one radio address: both are tracked, and neither bends the other's track."""

from __future__ import annotations

import math
import random

import pytest

from companion.traffic.plausibility import Flag
from companion.traffic.track import Wander
from tests.companion.traffic.flights import Listener, basic, circle, fly, location, seconds, straight


def aside(metres, motion=None):
    """The same motion, so far to the north."""
    motion = motion or straight()
    return lambda t: (motion(t)[0] + metres, *motion(t)[1:])


def nearest_m(listener, motion, now_s):
    """Distance of the nearest track, as the law predicts it, from where a sender is."""
    north, east = motion(now_s)[:2]
    return min(
        math.hypot(
            n.position_ned_m[0] + n.age_s * n.velocity_ned_mps[0] - north,
            n.position_ned_m[1] + n.age_s * n.velocity_ned_mps[1] - east,
        )
        for n in listener.traffic.neighbours(now_s)
    )


@pytest.mark.parametrize("away_m", [36.0, 40.0, -55.0, 90.0])
@pytest.mark.parametrize("lead_s", [0.0, 4.8, -4.0])
@pytest.mark.parametrize("honest_first", [True, False])
def test_a_clone_beside_it_is_another_track(away_m, lead_s, honest_first):
    """Two a second against one. Dated back it is old, and may be dropped; the true one may not."""
    listener = Listener()
    for k in range(60):
        now_s = 10.0 + 0.5 * k
        if k % 2 == 0 and (honest_first or k > 3):
            fly(listener, straight(), [now_s])
        if k > 3 or not honest_first:
            # Received after the true one, as that has 0.2 s of delay.
            fly(listener, aside(away_m), [now_s + 0.2], delay_s=0.1, clock_s=lead_s)
        if k > 5:
            # One that lags makes the true one, where it was heard first, seem younger by its delay of 0.2 s.
            assert nearest_m(listener, straight(), now_s + 0.3) < (1.0 if lead_s >= 0.0 else 3.5)
            # A clock that leads dates a message by its reception, 0.1 s late.
            assert lead_s < 0.0 or nearest_m(listener, aside(away_m), now_s + 0.3) < 3.0
    listener.traffic.expire(now_s + 0.3)
    assert lead_s < 0.0 or len(listener.traffic.tracks) == 2
    if lead_s == 0.0:
        assert all(Flag.DUPLICATE_IDENTITY in t.flags for t in listener.traffic.tracks.values())


@pytest.mark.parametrize(
    "bent",
    [
        {"north_m": 300.0},
        {"speed_mps": 0.0},
        {"direction_deg": 270.0},
    ],
    ids=["elsewhere", "standing", "turned"],
)
@pytest.mark.parametrize("lead_s", [0.0, 4.9, -4.9, 9.0])
def test_one_message_moves_ages_and_freezes_nothing(bent, lead_s):
    listener = Listener()
    motion = straight(20.0)
    fly(listener, motion, seconds(10))
    north, east, *_ = motion(19.4)
    told = location(
        lambda t: (bent.get("north_m", north), east, 0.0, 20.0, 50.0),
        19.4,
        timestamp_s=round(19.5 + lead_s, 1),
        **{k: v for k, v in bent.items() if k != "north_m"},
    )
    listener.hear(19.5, basic(), told)
    assert nearest_m(listener, motion, 19.9) < 1.0
    for second in range(18):
        fly(listener, motion, [20.0 + second])
        assert nearest_m(listener, motion, 20.9 + second) < 1.0
        newest = min(n.age_s for n in listener.traffic.neighbours(20.2 + second))
        assert newest <= 0.3
        listener.traffic.expire(20.9 + second)
    assert list(listener.traffic.tracks) == ["X"]


def test_two_that_stop_declaring_a_velocity_stay_two():
    listener = Listener()
    for now_s in seconds(20):
        told = {} if now_s < 20.0 else {"speed_mps": None, "direction_deg": None}
        fly(listener, straight(), [now_s], **told)
        fly(listener, aside(40.0), [now_s + 0.2], delay_s=0.1, **told)
    assert len(listener.traffic.tracks) == 2
    assert nearest_m(listener, straight(), now_s + 0.3) < 1.0
    assert nearest_m(listener, aside(40.0), now_s + 0.3) < 1.0


def test_a_glitch_of_one_position_leaves_a_ghost_until_a_silent_track_is_removed():
    listener = Listener()
    for t in seconds(30):
        fly(listener, aside(45.0) if t == 20.0 else straight(), [t])
        listener.traffic.expire(t + 0.2)
        assert len(listener.traffic.tracks) == (2 if 20.0 <= t < 35.0 else 1)
    assert listener.ever == set()


def test_a_sender_whose_position_is_reset_leaves_its_old_place():
    listener = Listener()
    for t in seconds(40):
        fly(listener, aside(45.0) if t >= 20.0 else straight(), [t])
        listener.traffic.expire(t + 0.2)
        assert nearest_m(listener, aside(45.0) if t >= 20.0 else straight(), t + 0.2) < 1.0
        if t >= 35.0:
            assert len(listener.traffic.tracks) == 1


def test_a_clock_that_leads_is_believed_until_one_that_leads_less_is_heard():
    """The clone was there first, 4.8 s ahead; at the same place, so that both are one track."""
    listener = Listener()
    fly(listener, straight(), seconds(10), clock_s=4.8)
    for t in seconds(20, 20.0, 2.0):
        fly(listener, straight(), [t + 0.25], clock_s=4.8, delay_s=0.01)
        fly(listener, straight(), [t])
        assert nearest_m(listener, straight(), t + 0.3) < 3.0
    assert listener.traffic.counts.old <= 20


def test_two_that_are_too_near_for_two_tracks_make_one_of_a_larger_error():
    """Four messages of a clone 17 m beside it for each of its own."""
    listener = Listener()
    for k in range(100):
        now_s = 10.0 + 0.2 * k
        fly(listener, straight() if k % 5 == 0 else aside(17.0), [now_s], delay_s=0.1)
        if k > 60:
            track, *_ = listener.traffic.neighbours(now_s + 0.1)
            assert 4.0 * track.sigma_m >= 4.0 * 3.0 + 12.0
            assert nearest_m(listener, straight(), now_s + 0.1) < 3.0
    fly(listener, straight(), seconds(80, 40.0))
    (only,) = [n for n in listener.traffic.neighbours(119.0) if n.age_s < 5.0]
    assert only.sigma_m == 3.0


@pytest.mark.parametrize("rate_hz", [1.0, 5.0, 10.0])
@pytest.mark.parametrize("motion", [straight(), straight(60.0), circle(20.0, 5.0)])
def test_noise_and_turns_are_no_larger_error(rate_hz, motion):
    """They make a second place of it for at most a fifth of the time. The noise here is white; that between
    successive messages of a real receiver is far smaller."""
    listener = Listener()
    draw = random.Random(round(rate_hz))
    aside = 0
    for t in seconds(round(120 * rate_hz), rate_hz=rate_hz):
        fly(listener, motion, [t], noise=draw)
        n, *others = listener.traffic.neighbours(t + 0.2)
        assert n.sigma_m == 3.0
        aside += bool(others)
    assert len(listener.traffic.tracks) == 1
    assert aside <= 24 * rate_hz


def test_one_miss_is_no_wander_and_many_fade():
    wander = Wander()
    wander.note(40.0, 0.5, 4.0, 10.0)
    wander.note(40.0, 0.5, 4.0, 10.5)
    assert wander.error_m == 0.0
    wander.note(20.0, 0.5, 4.0, 11.0)
    assert 20.0 < wander.error_m < 40.0
    for second in range(80):
        wander.note(1.0, 1.0, 4.0, 12.0 + second)
    assert wander == Wander(at_s=wander.at_s)
    assert wander.error_m == 0.0
