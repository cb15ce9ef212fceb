"""Compares the detection of entries with a brute-force search on dense tracks, and tests the intervals of
ratios."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from ground_tools.campaign.encounters import ratios
from ground_tools.campaign.encounters.volumes import NMAC, WELL_CLEAR, Volume, first_inside
from ground_tools.common.intervals import wilson

FOOT_M = 0.3048


def on_dense_points(relative, step_s, volume, points):
    """First entry from `points` single positions in each step; None: no position is inside."""
    for i, (a, b) in enumerate(itertools.pairwise(relative)):
        for j in range(points + 1):
            n, e, d = a + (b - a) * j / points
            if math.hypot(n, e) < volume.aside_m and abs(d) < volume.height_m:
                return (i + j / points) * step_s
    return None


def test_the_volumes_are_those_of_the_standard():
    assert tuple(NMAC) == (500 * FOOT_M, 100 * FOOT_M)
    assert tuple(WELL_CLEAR) == (2000 * FOOT_M, 250 * FOOT_M)


@pytest.mark.parametrize("seed", range(6))
def test_the_same_as_on_dense_points(seed):
    rng = np.random.default_rng(seed)
    inside = 0
    for _ in range(60):
        relative = rng.uniform(-2.0, 2.0, (4, 3))
        if rng.random() < 0.2:
            relative[1] = relative[0]  # no relative motion
        if rng.random() < 0.2:
            relative[:, 2] = relative[0, 2]  # level
        if rng.random() < 0.2:
            relative[:, :2] = relative[0, :2]  # straight up or down
        volume = Volume(rng.uniform(0.3, 1.2), rng.uniform(0.2, 1.0))
        exact, dense = first_inside(relative, 2.0, volume), on_dense_points(relative, 2.0, volume, 400)
        if dense is None:
            # The dense points may miss a volume that is entered for less than one of their intervals.
            assert exact is None or on_dense_points(relative, 2.0, volume, 20_000) is not None
            continue
        inside += 1
        assert exact is not None
        assert dense - 2.0 / 400 <= exact <= dense + 1e-9
    assert 10 < inside < 60


@pytest.mark.parametrize(
    ("first", "last", "wanted"),
    [
        ((-300.0, 0.0, 0.0), (300.0, 0.0, 0.0), (300.0 - 152.4) / 600.0),  # straight through
        ((-300.0, 0.0, 31.0), (300.0, 0.0, 31.0), None),  # above it
        ((-300.0, 0.0, 30.0), (300.0, 0.0, 30.0), (300.0 - 152.4) / 600.0),
        ((-300.0, 153.0, 0.0), (300.0, 153.0, 0.0), None),  # beside it
        ((0.0, 0.0, -100.0), (0.0, 0.0, 100.0), (100.0 - 30.48) / 200.0),  # straight down
        ((0.0, 0.0, 5.0), (0.0, 0.0, 5.0), 0.0),  # inside all the time
        ((200.0, 0.0, 5.0), (200.0, 0.0, 5.0), None),  # outside all the time
        # Beside the volume while at its height, and above it while near: never both at once.
        ((-1000.0, 0.0, -200.0), (1000.0, 0.0, 600.0), None),
        ((-1000.0, 0.0, -400.0), (1000.0, 0.0, 400.0), (1000.0 - 76.2) / 2000.0),  # falls into it from above
    ],
)
def test_cases_by_hand(first, last, wanted):
    found = first_inside(np.array([first, last]), 1.0, NMAC)
    assert found == (None if wanted is None else pytest.approx(wanted, abs=1e-9))


def test_a_volume_that_is_crossed_between_two_rows_is_found():
    """At 150 m/s and with a row every 10 s, no row is inside."""
    rows = np.array([[-800.0, 10.0, 0.0], [700.0, 10.0, 0.0], [2200.0, 10.0, 0.0]])
    assert on_dense_points(rows, 10.0, NMAC, 1) is None
    assert first_inside(rows, 10.0, NMAC) == pytest.approx((800.0 - math.sqrt(152.4**2 - 100.0)) / 150.0)


def test_the_first_of_several_entries_counts():
    rows = np.array([[200.0, 0, 0], [100.0, 0, 0], [200.0, 0, 0], [0.0, 0, 0]])
    assert first_inside(rows, 1.0, NMAC) == pytest.approx((200.0 - 152.4) / 100.0)


def flags(*numbers):
    return np.array(numbers, bool)


def test_ratios_by_hand():
    avoided, unavoided = flags(1, 0, 0, 1), flags(1, 1, 0, 0)
    assert ratios.ratio(avoided, unavoided, np.ones(4)) == 1.0
    assert ratios.ratio(avoided, unavoided, np.array([1.0, 3.0, 5.0, 1.0])) == 0.5
    assert ratios.ratio(avoided, flags(0, 0, 0, 0), np.ones(4)) is None
    assert ratios.interval(avoided, flags(0, 0, 0, 0), np.ones(4)) is None
    assert ratios.effective(np.ones(7)) == 7.0
    assert ratios.effective(np.array([1.0, 0.0])) == 1.0
    assert ratios.wilson(0.25, 40.0) == pytest.approx(wilson(10, 40))
    assert ratios.wilson(0.0, 40.0) == pytest.approx(wilson(0, 40))
    assert ratios.wilson(1.0, 40.0) == pytest.approx(wilson(40, 40))


def test_zero_events_with_avoidance_give_an_interval_above_zero():
    unavoided = np.zeros(300, bool)
    unavoided[:50] = True
    low, high = ratios.interval(np.zeros(300, bool), unavoided, np.ones(300))
    assert low == 0.0
    assert 0.05 < high < 0.12  # the rule of three: 3 of 50


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize(("share", "induced"), [(0.2, 0.0), (0.2, 0.02), (0.05, 0.0), (0.9, 0.01)])
def test_intervals_hold_the_true_ratio_as_often_as_they_say(share, induced, weighted):
    """1,000 samples of 300 encounters, 15 % of which are hits without avoidance."""
    rng = np.random.default_rng(11)
    true, held = share + induced * 0.85 / 0.15, 0
    for _ in range(1000):
        weights = rng.uniform(0.5, 1.5, 300) if weighted else np.ones(300)
        unavoided = rng.random(300) < 0.15
        chance = np.where(unavoided, share, induced)
        avoided = rng.random(300) < chance
        low, high = ratios.interval(avoided, unavoided, weights)
        held += low <= true <= high
    assert 925 <= held <= 985


def test_intervals_are_wider_where_the_event_happens_in_encounters_of_great_weight():
    """Fast aircraft count three times, and most that come near are fast."""
    rng = np.random.default_rng(11)
    near = {False: 0.01, True: 0.2}
    true = (3 * 0.3 * near[True] + 0.7 * near[False]) / (3 * 0.3 + 0.7)
    held = 0
    for _ in range(1000):
        fast, unavoided = rng.random(1000) < 0.3, rng.random(1000) < 0.15
        avoided = unavoided & (rng.random(1000) < np.where(fast, near[True], near[False]))
        low, high = ratios.interval(avoided, unavoided, np.where(fast, 3.0, 1.0))
        held += low <= true <= high
    assert 935 <= held <= 965


@pytest.mark.parametrize("least", [0.0, 1e-17, 1e-14])
def test_encounters_of_next_to_no_weight_do_not_matter(least):
    """The share of all others is 1 but for rounding, which may also make it greater than 1."""
    rng = np.random.default_rng(1)
    for _ in range(50):
        weights = rng.lognormal(0.0, 1.0, 200)
        avoided = np.arange(200) != 7
        weights[7] = least
        low, high = ratios.interval(avoided, avoided, weights)
        assert (low, high) == pytest.approx(ratios.interval(*np.ones((2, 199), bool), np.delete(weights, 7)))


def test_a_ratio_does_not_depend_on_the_scale_of_the_weights():
    avoided, unavoided = np.array([True, False, False]), np.array([True, True, False])
    for scale in (0.01, 1.0, 100.0):
        assert ratios.ratio(avoided, unavoided, scale * np.array([1.0, 3.0, 1.0])) == pytest.approx(0.25)
