"""Rows of tables, and what is known by time, by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from companion.avoidance import kernels as k

# ---------------------------------------------------------------- tables


def test_rows_are_written_and_read_field_by_field() -> None:
    past = k.Past(*map(float, range(1, 18)))
    other = k.Other(*map(float, range(1, 20)))
    pasts, others = np.full((3, len(past)), -1.0), np.full((3, len(other)), -1.0)
    k.put_past(pasts, 1, tuple(past))
    k.put_other(others, 1, other)
    assert k.past_at(pasts, 1) == past
    assert k.other_at(others, 1) == other
    assert pasts[1].tolist() == list(past)
    assert others[1].tolist() == list(other)
    assert (pasts[[0, 2]] == -1.0).all()
    assert (others[[0, 2]] == -1.0).all()
    assert k.seen_at(np.arange(9.0).reshape(1, 9), 0) == k.Seen(*map(float, range(9)))
    assert k.settings_at(np.arange(24.0).reshape(1, 24), 0) == k.Settings(*map(float, range(24)))


@pytest.mark.parametrize(("wrong", "within"), [(5.0, True), (-5.0, True), (5.1, False), (-5.1, False)])
def test_whether_all_entries_are_within_a_bound(wrong: float, within: bool) -> None:
    table = np.zeros((3, 4))
    for row, column in ((0, 0), (1, 3)):
        table[row, column] = wrong
        assert k.all_within(table, 2, 5.0) is within
        table[row, column] = 0.0
    table[2, 0] = math.nan  # a row that does not count
    assert k.all_within(table, 2, 5.0)
    assert not k.all_within(table, 3, 5.0)


# ---------------------------------------------------------------- paths

TIMES = np.array([10.0, 20.0, 30.0, 34.0])
POINTS = np.array([(0.0, 0.0, -10.0), (40.0, 0.0, -10.0), (40.0, 0.0, -10.0), (40.0, 20.0, -20.0)])
"""North, ten seconds of standing, then east and up."""


@pytest.mark.parametrize(
    ("t", "point"),
    [
        (-1.0, (0.0, 0.0, -10.0)),
        (10.0, (0.0, 0.0, -10.0)),
        (12.5, (10.0, 0.0, -10.0)),
        (20.0, (40.0, 0.0, -10.0)),
        (25.0, (40.0, 0.0, -10.0)),
        (31.0, (40.0, 5.0, -12.5)),
        (34.0, (40.0, 20.0, -20.0)),
        (99.0, (40.0, 20.0, -20.0)),
    ],
)
def test_where_a_path_is(t: float, point: Any) -> None:
    assert k.path_position(TIMES, POINTS, t) == pytest.approx(point)
    assert k.point_at(k.Path(TIMES, POINTS), t) == pytest.approx(point)


@pytest.mark.parametrize(
    ("place", "t", "nearest"),
    [
        ((-5.0, 3.0, -10.0), 10.0, (0.0, 0.0, -10.0)),
        ((30.0, -7.0, -15.0), 17.5, (30.0, 0.0, -10.0)),
        # As near for ten seconds: the earliest.
        ((43.0, -4.0, -10.0), 20.0, (40.0, 0.0, -10.0)),
        ((45.0, 10.0, -15.0), 32.0, (40.0, 10.0, -15.0)),
        ((40.0, 99.0, -20.0), 34.0, (40.0, 20.0, -20.0)),
    ],
)
def test_where_a_path_is_nearest(place: Any, t: float, nearest: Any) -> None:
    found_s, found = k.path_nearest(TIMES, POINTS, *place)
    assert (found_s, found) == (pytest.approx(t), pytest.approx(nearest))


def test_of_a_path_that_begins_by_standing_the_earliest_time() -> None:
    times, points = np.array([3.0, 8.0, 9.0]), np.array([(1.0, 0, 0), (1.0, 0, 0), (9.0, 0, 0)])
    assert k.path_nearest(times, points, 0.0, 0.0, 0.0) == (3.0, (1.0, 0.0, 0.0))


# ---------------------------------------------------------------- own velocities


def noted(samples: Any, size: int = 8) -> tuple[list[float], list[float]]:
    """Times and north velocities that are kept of samples (time, north velocity)."""
    times_s, velocities = np.zeros(size), np.zeros((size, 3))
    count = 0
    for t, north in samples:
        count = k.note_velocity(times_s, velocities, count, t, (north, 2.0 * north, -north))
        assert (np.diff(times_s[:count]) > 0.0).all()
        assert velocities[count - 1, 1:].tolist() == [
            2.0 * velocities[count - 1, 0],
            -velocities[count - 1, 0],
        ]
    return times_s[:count].tolist(), velocities[:count, 0].tolist()


def test_velocities_are_kept_in_order_of_time() -> None:
    assert noted([(1.0, 5.0), (1.1, 6.0), (1.05, 7.0), (1.1, 8.0), (1.2, 9.0)]) == (
        [1.0, 1.1, 1.2],
        [5.0, 6.0, 9.0],
    )


@pytest.mark.parametrize("wrong", [(math.nan, 1.0), (math.inf, 1.0), (2.0, math.nan), (2.0, -math.inf)])
def test_velocities_that_are_not_finite_are_ignored(wrong: tuple[float, float]) -> None:
    times_s, velocities = np.zeros(4), np.zeros((4, 3))
    assert k.note_velocity(times_s, velocities, 0, wrong[0], (wrong[1], 0.0, 0.0)) == 0


@pytest.mark.parametrize(("gap_s", "kept"), [(0.03, [0.0, 2.0, 3.0]), (0.05, [0.0, 1.0, 2.0, 3.0])])
def test_of_samples_closer_than_40_ms_the_newest_is_kept(gap_s: float, kept: list[float]) -> None:
    _, velocities = noted([(100.0 + gap_s * number, float(number)) for number in range(4)])
    assert velocities == kept


def test_of_a_full_history_the_newer_half_is_kept() -> None:
    samples = [(0.1 * number, float(number)) for number in range(9)]
    assert noted(samples[:8])[1] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    times_s, velocities = noted(samples)
    assert velocities == [4.0, 5.0, 6.0, 7.0, 8.0]
    assert times_s == pytest.approx([0.4, 0.5, 0.6, 0.7, 0.8])


def test_the_own_velocity_between_two_samples() -> None:
    times_s, velocities = np.array([1.0, 2.0, 99.0]), np.array([(1.0, 2, 3), (3.0, 4, 5), (9.0, 9, 9)])
    history = k.History(times_s, velocities)
    for t, expected in ((0.0, (1, 2, 3)), (1.5, (2, 3, 4)), (2.0, (3, 4, 5)), (50.0, (3, 4, 5))):
        assert k.own_velocity_at(history, 2, t) == pytest.approx(expected)
