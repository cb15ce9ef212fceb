"""Risk ratios with intervals: how often an event happens with avoidance, relative to without.

Each encounter counts with its importance weight, with and without avoidance. The interval of a weighted share
is Wilson's, for the effective number of encounters, or for fewer where the event happens in encounters of
great weight. The interval of the ratio follows from both shares' intervals and their correlation, because the
same encounters are flown with and without avoidance: the method of variance estimates recovery (A. Donner,
G. Y. Zou: Closed-form confidence intervals for functions of the normal mean and standard deviation, 2012).
"""

from __future__ import annotations

import math

from companion.arrays import Bools, Floats
from ground_tools.common.intervals import Z


def effective(weights: Floats) -> float:
    """Effective number of encounters with these weights: `sum(w)^2 / sum(w^2)` (Kish)."""
    return float(weights.sum() ** 2 / (weights**2).sum())


def ratio(avoided: Bools, unavoided: Bools, weights: Floats) -> float | None:
    """Weighted share of encounters in which an event happened with avoidance, over that without; None if it
    never happened without."""
    below = float(weights[unavoided].sum())
    return float(weights[avoided].sum()) / below if below > 0.0 else None


def interval(avoided: Bools, unavoided: Bools, weights: Floats) -> tuple[float, float] | None:
    """95 % interval of `ratio`; None where there is no ratio."""
    if not unavoided.any():
        return None
    (p, p_count), (q, q_count) = _share(avoided, weights), _share(unavoided, weights)
    both, _ = _share(avoided & unavoided, weights)
    spread = math.sqrt(max(p * (1.0 - p) * q * (1.0 - q), 0.0))
    r = min(max((both - p * q) / spread, -1.0), 1.0) if spread > 0.0 else 0.0
    (p_low, p_high), (q_low, q_high) = wilson(p, p_count), wilson(q, q_count)
    low = _bound(p, q, r, p_low, q_high, -1.0)
    return low, _bound(p, q, r, p_high, q_low, 1.0)


def _share(happened: Bools, weights: Floats) -> tuple[float, float]:
    """Weighted share of encounters in which an event happened, and the number of equal encounters of which
    this share would have its variance (linearised). That is at most the effective number, because the weights
    of few events may be small by chance.
    """
    total, count = float(weights.sum()), effective(weights)
    # Rounding may make a sum of most of the weights the larger one, or share and 1 equal.
    share = min(float(weights[happened].sum()) / total, 1.0)
    variance = float(((weights * (happened - share)) ** 2).sum()) / total**2
    one = share * (1.0 - share)
    return share, min(count, one / variance) if one > 0.0 and variance > 0.0 else count


def _bound(p: float, q: float, r: float, p_end: float, q_end: float, sign: float) -> float:
    """The lower (sign -1) or upper (sign 1) bound of p / q, from the opposite ends of both intervals."""
    a = q_end * (2.0 * q - q_end)
    b = p * q - r * (p_end - p) * (q - q_end)
    c = p_end * (2.0 * p - p_end)
    root = math.sqrt(max(b * b - a * c, 0.0))
    if sign < 0.0:  # the smaller root, in a form without division by a, which may be 0
        return max(c / (b + root), 0.0) if b + root > 0.0 else 0.0
    return (b + root) / a


def wilson(share: float, count: float) -> tuple[float, float]:
    """Wilson's 95 % interval of a share of an effective number of encounters."""
    z2 = Z * Z / count
    middle = (share + 0.5 * z2) / (1.0 + z2)
    half = Z / (1.0 + z2) * math.sqrt(share * (1.0 - share) / count + 0.25 * z2 / count)
    return max(middle - half, 0.0) if share > 0.0 else 0.0, min(middle + half, 1.0) if share < 1.0 else 1.0
