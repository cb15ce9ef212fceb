"""The compiled weighing of received powers, against a plain computation with NumPy and SciPy's Gaussians."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.avoidance import kernels as k

MESSAGE_DB, DRIFT_DB2_PER_S, SLOPE_DB = 5.0, 0.02, 20.0
WANDER_DB, WANDER_S = 2.0, 5.0
PASSED_S = 0.7


def weighed(rssi: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Log likelihoods after all messages of one address."""
    log, means = np.zeros(k.HYPOTHESES), np.zeros((2, k.HYPOTHESES))
    covariance = np.array([math.inf, 0.0, 0.0])
    for power, place in zip(rssi.tolist(), places.tolist(), strict=True):
        k.note_power(log, means, covariance, PASSED_S, power, *place)
    return log


def coming(rng: np.random.Generator, count: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Powers and relative positions of a sender that comes nearer."""
    places = np.column_stack([np.linspace(90.0, 40.0, count), np.full(count, 7.0), np.full(count, -4.0)])
    return rng.normal(-70.0, 6.0, count) - SLOPE_DB * np.log10(np.linalg.norm(places, axis=1)), places


def test_likelihoods_are_those_of_a_wandering_shift_in_gaussian_noise() -> None:
    """The messages of one hypothesis are jointly Gaussian: an unknown shift that drifts, a part that wanders
    and returns, and noise. The first message only defines the shift."""
    from scipy.stats import multivariate_normal  # takes a second, which only the worker of this test needs

    rssi, places = coming(np.random.default_rng(1))
    count = len(rssi)
    at_s = PASSED_S * np.arange(count)
    covariance = DRIFT_DB2_PER_S * np.minimum.outer(at_s, at_s) + MESSAGE_DB**2 * np.eye(count)
    covariance += WANDER_DB**2 * np.exp(-np.abs(np.subtract.outer(at_s, at_s)) / WANDER_S)
    differ = np.hstack([-np.ones((count - 1, 1)), np.eye(count - 1)])
    gaussian = multivariate_normal(np.zeros(count - 1), differ @ covariance @ differ.T)
    expected = []
    for north, east in k.OFFSETS:
        away = np.linalg.norm(places + np.array([north, east, 0.0]), axis=1)
        expected.append(gaussian.logpdf(differ @ (rssi + SLOPE_DB * np.log10(np.maximum(away, 2.0)))))
    expected.append(gaussian.logpdf(differ @ rssi))
    assert weighed(rssi, places) == pytest.approx(np.array(expected) - expected[0], abs=1e-9)


def test_what_is_suspected_is_the_mean_over_the_offsets() -> None:
    log = np.random.default_rng(2).normal(0.0, 3.0, k.HYPOTHESES)
    log[0] = 0.0
    weights = np.exp(log[1:-1])
    mean = weights @ k.OFFSETS[1:] / weights.sum()
    ratio = 0.5 * weights.mean() + 0.5 * math.exp(log[-1])
    expected = math.log(ratio), math.log(weights.mean()), *mean
    assert k.suspicion(log) == pytest.approx(expected, abs=1e-9)


def test_likelihoods_that_no_float_can_hold_are_weighed() -> None:
    """Of opposite extremes, each takes all of the weight or none."""
    for log in (-1e15, 1e15):
        powers = np.full(k.HYPOTHESES, log)
        powers[0] = 0.0
        ratio, beside, north, east = k.suspicion(powers)
        assert ratio == pytest.approx(log) == beside
        assert (north, east) == pytest.approx((0.0, 0.0), abs=1e-9)
        assert (beside > k.BESIDE) == (log > 0.0)


def test_within_two_metres_a_place_counts_as_two_metres_away() -> None:
    def level(north: float) -> float:
        means = np.zeros((2, k.HYPOTHESES))
        k.note_power(np.zeros(k.HYPOTHESES), means, np.array([math.inf, 0.0, 0.0]), 0.0, 0.0, north, 0.0, 0.0)
        return float(means[0, 0])

    assert level(0.1) == level(1.9) == pytest.approx(SLOPE_DB * math.log10(2.0))
    assert level(4.0) == pytest.approx(SLOPE_DB * math.log10(4.0))


def test_offsets_surround_the_reported_place() -> None:
    away = np.linalg.norm(k.OFFSETS, axis=1)
    assert away[0] == 0.0
    assert away.max() == pytest.approx(100.0)
    gaps = np.linalg.norm(k.OFFSETS[:, None] - k.OFFSETS[None], axis=2)
    np.fill_diagonal(gaps, np.inf)
    assert gaps.min(axis=1) == pytest.approx(100.0 / 6.0)
