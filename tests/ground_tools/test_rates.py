"""Intervals from few runs, against published tables and by simulation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ground_tools.common.rates import Estimate, dispersion, mean, rate, ratio, student


def test_the_poisson_interval_against_published_values():
    """Garwood (1936), as in the tables of Johnson, Kotz and Kemp: 0, 1, 2, 10, 20 and 100 events."""
    for count, low, high in (
        (0, 0.0, 3.689),
        (1, 0.0253, 5.572),
        (2, 0.2422, 7.225),
        (10, 4.795, 18.390),
        (20, 12.217, 30.888),
        (100, 81.364, 121.627),
    ):
        found = rate([count], [1.0])
        assert (found.low, found.high) == pytest.approx((low, high), abs=6e-4)
    pooled = rate([3, 7], [2.0, 2.0])
    assert (pooled.value, pooled.low, pooled.high) == pytest.approx((2.5, 4.795 / 4, 18.390 / 4), abs=2e-4)
    assert rate([0], [0.0]) is None


def test_counts_that_differ_more_than_chance_widen_the_interval():
    assert dispersion([5, 5, 5], [1.0, 1.0, 1.0]) == 1.0
    assert dispersion([5], [1.0]) == dispersion([0, 0], [1.0, 1.0]) == 1.0
    # Mean 10; squares 100 + 100 + 0, divided by 10 and by two degrees of freedom.
    assert dispersion([0, 20, 10], [1.0, 1.0, 1.0]) == pytest.approx(10.0)
    # Counts in proportion to the hours have no extra dispersion.
    assert dispersion([2, 20], [1.0, 10.0]) == 1.0
    plain, wide = rate([0, 20, 10], [1.0] * 3), rate([0, 20, 10], [1.0] * 3, 10.0)
    assert plain.value == wide.value == 10.0
    # As with three events that count ten each: Garwood's interval is 0.619 to 8.767.
    assert (wide.low, wide.high) == pytest.approx((10 * 0.619 / 3, 10 * 8.767 / 3), abs=5e-3)


def test_the_ratio_of_two_rates():
    one, other = rate([40], [10.0]), rate([10], [10.0])
    found = ratio(one, other)
    assert found.value == pytest.approx(4.0)
    # The exact conditional interval of 40 against 10 is 1.97 to 8.96.
    assert (found.low, found.high) == pytest.approx((1.97, 8.96), rel=0.06)
    backwards = ratio(other, one)
    assert (backwards.low, backwards.high) == pytest.approx((1 / found.high, 1 / found.low))
    none = rate([0], [10.0])
    assert ratio(none, none) is None
    against_none = ratio(one, none)
    assert against_none.value == against_none.high == math.inf
    assert 1.0 < against_none.low < math.inf
    assert ratio(none, one).low == 0.0
    assert 0.0 < ratio(none, one).high < 0.2


def test_the_ratio_covers_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(5)
    hit = 0
    for _ in range(600):
        found = ratio(rate([int(rng.poisson(20))], [1.0]), rate([int(rng.poisson(10))], [1.0]))
        hit += found is not None and found.low <= 2.0 <= found.high
    assert hit / 600 > 0.93


def test_students_interval():
    found = mean([1.0, 2.0, 3.0])
    assert (found.value, found.low, found.high) == pytest.approx((2.0, -0.4841, 4.4841), abs=1e-3)
    assert mean([4.0]) == Estimate(4.0, -math.inf, math.inf)
    assert mean([]) is None
    for freedom, quantile in ((1, 12.706), (2, 4.303), (30, 2.042), (40, 2.021), (120, 1.980)):
        assert student(freedom) == pytest.approx(quantile, abs=1e-3)
