"""What a track's past says of it: how fast it leaves its predictions, how long its silences are."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from companion.avoidance import kernels as k


class Track:
    """The past of one track."""

    def __init__(self) -> None:
        self.past = k.NO_PAST


def note(track: Track, t: float, p: Any, v: Any, sigma: float = 1.0) -> float:
    """The growth after one more message."""
    noted = k.note_track(
        tuple(track.past), float(t), tuple(map(float, p)), tuple(map(float, v)), float(sigma)
    )
    track.past = k.Past(*noted)
    return track.past.growth_mps


def after_turn() -> Track:
    """A message 3 s after the first one, 6.3 m aside of its prediction and 4.5 m above."""
    track = Track()
    note(track, 10.0, (0, 0, 0), (4, 0, 0))
    note(track, 13.0, (12.0, 6.3, -4.5), (3, 2, 0))
    return track


def test_the_first_message_says_nothing() -> None:
    track = Track()
    assert note(track, 10.0, (3, -4, 5), (9, 8, 7)) == 0.0
    message = [10.0, 3, -4, 5, 9, 8, 7]
    np.testing.assert_array_equal(track.past, [*message, 0.0, 0.0, 0.0, *message])


def test_growth_by_hand() -> None:
    """2.5 (6.3 m - 0.6 * 1 m - 0.9 * 3 s) / 3 s sideways, and of 4.5 m in height."""
    track = after_turn()
    assert track.past.growth_mps == pytest.approx(2.5, rel=1e-12)
    assert track.past.growth_down_mps == pytest.approx(1.0, rel=1e-12)
    note(track, 16.0, (21.0, 12.3, -4.5), (3, 2, 0))  # on its prediction
    assert track.past.growth_mps == pytest.approx(2.5 * math.exp(-3.0 / 60.0), rel=1e-12)
    assert track.past.growth_down_mps == pytest.approx(math.exp(-3.0 / 60.0), rel=1e-12)


def test_what_is_usual_grows_with_the_declared_error_and_up_to_four_seconds() -> None:
    """0.6 * 2 m + 0.9 * 4 s = 4.8 m after 6 s."""
    track = Track()
    note(track, 0.0, (0, 0, 0), (5, 0, 0), sigma=2.0)
    assert note(track, 6.0, (30.0, 7.2, 0), (5, 0, 0), sigma=2.0) == pytest.approx(1.0, rel=1e-12)


def test_an_aircraft_that_gives_way_is_not_taken_for_one_that_manoeuvres() -> None:
    """With 1 m/s^2 for three seconds, declared 3 m."""
    track = Track()
    for t in range(20):
        turn = max(t - 10.0, 0.0)
        aside = 0.5 * min(turn, 3.0) ** 2 + 3.0 * max(turn - 3.0, 0.0)
        note(track, t, (4.0 * t, aside, 0.0), (4.0, min(turn, 3.0), 0.0), sigma=3.0)
    assert track.past.growth_mps == 0.0


def test_a_turn_without_a_climb_leaves_the_height_predictable() -> None:
    track = Track()
    note(track, 0.0, (0, 0, 0), (5, 0, 0))
    note(track, 3.0, (5.0, 12.0, 0.0), (0, 5, 0))
    assert track.past.growth_mps == k.GROWTH_MOST_MPS
    assert track.past.growth_down_mps == 0.0


def test_a_declared_error_under_a_metre_counts_as_one() -> None:
    for sigma in (0.0, 0.3, 1.0):
        track = Track()
        note(track, 10.0, (0, 0, 0), (4, 0, 0), sigma)
        assert note(track, 13.0, (12.0, 6.3, 0.0), (3, 2, 0), sigma) == pytest.approx(2.5, rel=1e-12)


def test_growth_is_bounded() -> None:
    track = Track()
    note(track, 0.0, (0, 0, 0), (0, 0, 0))
    assert note(track, 3.0, (1e6, 0, 0), (0, 0, 0)) == k.GROWTH_MOST_MPS == 3.0


def test_growth_decays_by_half_in_28_s() -> None:
    track = after_turn()
    for second in range(3, 31):
        note(track, 13.0 + second, (12.0 + 3 * second, 6.3 + 2 * second, -4.5), (3, 2, 0))
    assert track.past.growth_mps == pytest.approx(2.5 * math.exp(-30.0 / 60.0), rel=1e-9)


def test_between_the_messages_that_are_compared_only_the_newest_is_kept() -> None:
    """Those of a second ago lead to the gap and to a velocity from positions, but to no growth."""
    track = Track()
    note(track, 10.0, (0, 0, 0), (4, 0, 0))
    for t in (10.9, 12.8):
        assert note(track, t, (40.0, 60.0 + t, -50.0), (1, 2, 3)) == 0.0
        assert track.past.growth_down_mps == 0.0
        np.testing.assert_array_equal(track.past[:7], [t, 40.0, 60.0 + t, -50.0, 1, 2, 3])
        np.testing.assert_array_equal(track.past[10:], [10.0, 0, 0, 0, 4, 0, 0])
    assert track.past.gap_s == pytest.approx(1.9)
    assert note(track, 14.0, (40.0, 60.0, -50.0), (1, 2, 3)) == k.GROWTH_MOST_MPS
    np.testing.assert_array_equal(track.past[10:], [14.0, 40.0, 60.0, -50.0, 1, 2, 3])


@pytest.mark.parametrize("t", [13.5, 13.89, 13.0, 12.5, -100.0, math.nan])
def test_near_and_older_messages_are_passed_over(t: float) -> None:
    """Ten messages a second say no more than one; the same one again and an older one say nothing."""
    track = after_turn()
    before = track.past
    note(track, t, (500.0, 0, 0), (0, 0, 0))
    np.testing.assert_array_equal(track.past, before)


def test_messages_of_a_fast_sender_are_judged_a_second_apart() -> None:
    """At 10 a second, a turn shows as it does at one a second."""
    slow, fast = Track(), Track()
    for tick in range(101):
        t, turn = 0.1 * tick, 0.05 * tick
        p = (50.0 * math.sin(turn), 50.0 * (1.0 - math.cos(turn)), 0.0)  # 25 m/s round 50 m
        v = (25.0 * math.cos(turn), 25.0 * math.sin(turn), 0.0)
        note(fast, t, p, v)
        if tick % 9 == 0:
            note(slow, t, p, v)
    assert slow.past.growth_mps > 1.0
    assert fast.past.growth_mps == pytest.approx(slow.past.growth_mps, rel=0.15)


def test_the_longest_gap_lately() -> None:
    track = Track()
    gaps = []
    for t in (0.0, 1.0, 4.0, 5.0, 7.0):
        note(track, t, (2 * t, 0, 0), (2, 0, 0))
        gaps.append(track.past.gap_s)
    three = 3.0 * math.exp(-1.0 / 60.0)
    assert gaps == pytest.approx([0.0, 1.0, 3.0, three, three * math.exp(-2.0 / 60.0)], rel=1e-12)


@pytest.mark.parametrize(("gap_s", "silent_s"), [(0.95, 2.2), (1.0, 2.2), (2.0, 4.4), (4.0, 8.8)])
def test_silence_is_told_by_the_link(gap_s: float, silent_s: float) -> None:
    """2.2 times the longest gap: 2.2 s once a second, 8.8 s where every 4th is heard."""
    track = Track()
    for number in range(10):
        note(track, gap_s * number, (0, 0, 0), (0, 0, 0))
    assert k.silent_after(track.past.gap_s) == pytest.approx(silent_s, rel=1e-12)


def test_a_bad_spell_of_the_link_is_forgotten() -> None:
    track = Track()
    for t in (0.0, 1.0, 7.0):
        note(track, t, (0, 0, 0), (0, 0, 0))
    assert k.silent_after(track.past.gap_s) == pytest.approx(2.2 * 6.0)
    for t in range(8, 248):
        note(track, t, (0, 0, 0), (0, 0, 0))
    assert k.silent_after(track.past.gap_s) == pytest.approx(2.2)


@pytest.mark.parametrize(
    ("sigma_mps", "median_mps", "rarely_mps"), [(0.0, 0.4, 0.9), (0.15, 0.5, 1.1), (0.3, 0.9, 1.6)]
)
def test_noise_alone_is_no_manoeuvre(sigma_mps: float, median_mps: float, rarely_mps: float) -> None:
    """An aircraft that flies straight, with the GNSS error that it declares and an error of its velocity.

    Measured (median, 95 %, m/s): 0.36, 0.87 without the latter; 0.48, 1.04; 0.82, 1.50 at 0.3 m/s.
    """
    growths = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        track, noise, keep = Track(), rng.normal(0.0, 1.5, 3), math.exp(-1.0 / 30.0)
        for t in range(60):
            p = np.array([3.0 * t, 0.0, 0.0]) + noise
            v = np.array([3.0, 0.0, 0.0]) + rng.normal(0.0, sigma_mps, 3)
            growths.append(note(track, t, p, v, 1.5))
            noise = keep * noise + math.sqrt(1.0 - keep * keep) * rng.normal(0.0, 1.5, 3)
    median, rarely = np.percentile(growths, [50, 95])
    assert median < median_mps
    assert rarely < rarely_mps
