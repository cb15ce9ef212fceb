"""95 % confidence intervals: the Wilson interval for a share, the bootstrap for any other statistic."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from companion.arrays import Floats

Z: Final = 1.959963984540054
"""Two-sided 95 % quantile of the standard normal distribution."""
DRAWS: Final = 2000
"""Bootstrap resamples."""


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Interval of the share `hits / count`, after E. B. Wilson (1927); (0, 1) if `count` is 0."""
    if count == 0:
        return 0.0, 1.0
    share, z2 = hits / count, Z * Z / count
    middle = (share + z2 / 2.0) / (1.0 + z2)
    half = Z / (1.0 + z2) * math.sqrt(share * (1.0 - share) / count + z2 / (4.0 * count))
    low = 0.0 if hits == 0 else middle - half
    return low, 1.0 if hits == count else middle + half


def bootstrap(
    groups: Sequence[Floats], statistic: Callable[[Floats], Floats], seed: int = 1
) -> tuple[float, float] | None:
    """Percentile bootstrap interval of a statistic.

    Args:
        groups: Groups of values that depend on each other (one simulated airspace) and are therefore
            resampled together, each of shape (values,).
        statistic: Maps the values of a resample to the statistic, over the last axis.
        seed: Seed of the resampling.

    Returns:
        The interval, or None for fewer than two groups, from which none can be computed.
    """
    if len(groups) < 2:
        return None
    drawn = np.random.default_rng(seed).integers(0, len(groups), (DRAWS, len(groups)))
    if len({len(group) for group in groups}) == 1:
        found = statistic(np.stack(groups)[drawn].reshape(DRAWS, -1))
    else:
        found = np.array([statistic(np.concatenate([groups[i] for i in some])) for some in drawn])
    low, high = np.percentile(found, (2.5, 97.5))
    return float(low), float(high)
