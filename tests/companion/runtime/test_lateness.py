"""How late ticks come, in bounded memory."""

from __future__ import annotations

import pytest

from companion.runtime.lateness import Lateness


def test_percentiles_are_right_to_a_tenth_of_a_millisecond():
    lateness = Lateness()
    for number in range(1000):
        lateness.add(number * 1e-5)  # 0 to 10 ms
    assert lateness.percentile_s(50.0) == pytest.approx(0.005, abs=1e-4)
    assert lateness.percentile_s(99.0) == pytest.approx(0.0099, abs=1e-4)
    assert lateness.percentile_s(100.0) == lateness.worst_s == pytest.approx(0.00999)


def test_what_is_later_than_any_bin_is_the_worst():
    lateness = Lateness()
    for late_s in (0.0, 7.0, 9.0):
        lateness.add(late_s)
    assert lateness.worst_s == 9.0
    assert lateness.percentile_s(100.0) == 9.0
    assert lateness.percentile_s(30.0) < 0.001


def test_without_ticks_there_is_nothing_to_tell():
    assert Lateness().percentile_s(99.0) == 0.0
