"""95 % intervals from few runs: of the rate of rare events, of the ratio of two such rates, and of a mean.

A bootstrap over three runs has only ten different resamples. Its interval is too narrow, and has no width at
all if no run saw an event. The width of the intervals here comes from the number of events (Poisson) or from
Student's distribution.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Final

import numpy as np

from companion.errors import ConfigError
from companion.shipped import how_to_install

_TAIL: Final = 0.025


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float
    """Upper end of the interval; infinite if there is no bound."""


def rate(counts: Sequence[int], hours: Sequence[float], dispersion: float = 1.0) -> Estimate | None:
    """Events per hour, pooled over runs, with F. Garwood's exact Poisson interval (1936).

    Args:
        counts: events of each run.
        hours: exposure of each run.
        dispersion: variance over mean of a count, at least 1. Events that come in groups carry less
            information. The interval is that of count / dispersion.

    Returns:
        None if there is no exposure.
    """
    exposure = sum(hours)
    if exposure <= 0.0:
        return None
    count = sum(counts) / dispersion
    low, high = (dispersion * bound / exposure for bound in _garwood(count))
    return Estimate(sum(counts) / exposure, low, high)


def dispersion(counts: Sequence[int], hours: Sequence[float]) -> float:
    """Variance over mean of the counts of runs (Pearson's chi-squared over its degrees of freedom), at least
    1. With a single run, or without any event, it cannot be estimated and is 1."""
    total, exposure = sum(counts), sum(hours)
    if len(counts) < 2 or total == 0 or exposure <= 0.0:
        return 1.0
    expected = [total * hour / exposure for hour in hours]
    found = sum((n - mean) ** 2 / mean for n, mean in zip(counts, expected, strict=True) if mean > 0.0)
    return max(1.0, found / (len(counts) - 1))


def ratio(first: Estimate, second: Estimate) -> Estimate | None:
    """First rate over the second, with the interval of A. Donner and G. Zou (2012) from those of both.

    Returns:
        None if both are 0, because their ratio is then unknown.
    """
    a, b = first, second
    if a.value == b.value == 0.0:
        return None
    whole = a.value * b.value
    lower, upper = a.low * (2.0 * a.value - a.low), a.high * (2.0 * a.value - a.high)
    under, over = b.low * (2.0 * b.value - b.low), b.high * (2.0 * b.value - b.high)
    low = 0.0
    if lower > 0.0:
        low = lower / (whole + math.sqrt(max(whole * whole - lower * over, 0.0)))
    high = math.inf
    if under > 0.0:
        high = (whole + math.sqrt(max(whole * whole - upper * under, 0.0))) / under
    return Estimate(a.value / b.value if b.value > 0.0 else math.inf, low, high)


def mean(values: Sequence[float]) -> Estimate | None:
    """Mean of independent runs with Student's interval, which is infinite for a single run; None for none.

    The interval requires normal values. Each run is a mean over hundreds of aircraft and thus nearly normal.
    """
    if not values:
        return None
    middle = float(np.mean(values))
    if len(values) == 1:
        return Estimate(middle, -math.inf, math.inf)
    half = student(len(values) - 1) * float(np.std(values, ddof=1)) / math.sqrt(len(values))
    return Estimate(middle, middle - half, middle + half)


def student(freedom: int) -> float:
    """Two-sided 95 % quantile of Student's distribution.

    Raises:
        ConfigError: scipy is not installed.
    """
    return float(_special().stdtrit(freedom, 1.0 - _TAIL))


def _garwood(count: float) -> tuple[float, float]:
    """Interval of the mean of a Poisson distribution from one count, which need not be a whole number."""
    inverse = _special().gammaincinv
    low = 0.0 if count == 0.0 else float(inverse(count, _TAIL))
    return low, float(inverse(count + 1.0, 1.0 - _TAIL))


def _special() -> ModuleType:
    try:
        from scipy import special
    except ImportError as error:
        raise ConfigError(how_to_install("scipy", "inspect")) from error
    return special  # type: ignore[no-any-return]
