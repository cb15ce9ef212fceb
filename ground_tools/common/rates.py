"""95 % intervals from few runs: of the rate of rare events, of the ratio of two such rates, and of a mean.

A bootstrap over three runs has ten different resamples, so that its interval is too narrow, and it has no
width at all where no run saw an event. What is here has its width from the number of events (Poisson) or
from Student's distribution, and needs no optional package.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ground_tools.common.intervals import Z

_STUDENT: Final = (
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131,
    2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042,
)  # fmt: skip
"""Two-sided 95 % quantiles of Student's distribution with 1 to 30 degrees of freedom."""
_TAIL: Final = 0.025


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float
    """Infinite if nothing bounds it."""


def rate(counts: Sequence[int], hours: Sequence[float], dispersion: float = 1.0) -> Estimate | None:
    """Events per hour, pooled over runs, with F. Garwood's exact Poisson interval (1936).

    Args:
        counts: events of each run.
        hours: exposure of each run.
        dispersion: variance over mean of a count, at least 1: events that come in groups are worth
            fewer. The interval is that of count / dispersion.

    Returns:
        None without exposure.
    """
    exposure = sum(hours)
    if exposure <= 0.0:
        return None
    count = sum(counts) / dispersion
    low, high = (dispersion * bound / exposure for bound in _garwood(count))
    return Estimate(sum(counts) / exposure, low, high)


def dispersion(counts: Sequence[int], hours: Sequence[float]) -> float:
    """Variance over mean of the counts of runs (Pearson's chi-squared over its degrees of freedom); at least
    1, and 1 where a single run, or none with an event, says nothing about it."""
    total, exposure = sum(counts), sum(hours)
    if len(counts) < 2 or total == 0 or exposure <= 0.0:
        return 1.0
    expected = [total * hour / exposure for hour in hours]
    found = sum((n - mean) ** 2 / mean for n, mean in zip(counts, expected, strict=True) if mean > 0.0)
    return max(1.0, found / (len(counts) - 1))


def ratio(first: Estimate, second: Estimate) -> Estimate | None:
    """First rate over the second, with the interval of A. Donner and G. Zou (2012) from those of both.

    Returns:
        None if both are 0: nothing is known of their ratio.
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

    Runs are means over hundreds of aircraft and thus nearly normal, which the interval asks for.
    """
    if not values:
        return None
    middle = float(np.mean(values))
    if len(values) == 1:
        return Estimate(middle, -math.inf, math.inf)
    half = student(len(values) - 1) * float(np.std(values, ddof=1)) / math.sqrt(len(values))
    return Estimate(middle, middle - half, middle + half)


def student(freedom: int) -> float:
    """Two-sided 95 % quantile of Student's distribution; above 30 degrees of freedom by the expansion of
    Cornish and Fisher, within 0.001."""
    if freedom <= len(_STUDENT):
        return _STUDENT[freedom - 1]
    first, second = (Z**3 + Z) / 4.0, (5.0 * Z**5 + 16.0 * Z**3 + 3.0 * Z) / 96.0
    return Z + first / freedom + second / freedom**2


def _garwood(count: float) -> tuple[float, float]:
    """Interval of the mean of a Poisson distribution from one count, which may be no whole number."""
    low = 0.0 if count == 0.0 else _root(lambda x: _gamma_share(count, x) - _TAIL, count)
    return low, _root(lambda x: _gamma_share(count + 1.0, x) - (1.0 - _TAIL), count + 1.0)


def _root(rising: Callable[[float], float], near: float) -> float:
    low, high = 0.0, near + 1.0
    while rising(high) < 0.0:
        high *= 2.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if rising(middle) < 0.0 else (low, middle)
    return 0.5 * (low + high)


def _gamma_share(a: float, x: float) -> float:
    """Distribution function at x of the gamma distribution with shape a and scale 1: its series below the
    mean, above it the continued fraction of its complement (Press et al., Numerical Recipes, 6.2)."""
    if x <= 0.0:
        return 0.0
    front = math.exp(a * math.log(x) - x - math.lgamma(a))
    if x < a + 1.0:
        term = total = 1.0 / a
        n = a
        while term > 1e-15 * total:
            n += 1.0
            term *= x / n
            total += term
        return front * total
    b = x + 1.0 - a
    c, d = 1e300, 1.0 / b
    fraction, step, i = d, 0.0, 0
    while abs(step - 1.0) > 1e-15 and i < 10_000:
        i += 1
        factor = -i * (i - a)
        b += 2.0
        d = 1.0 / (factor * d + b)
        c = b + factor / c
        step = c * d
        fraction *= step
    return 1.0 - front * fraction
