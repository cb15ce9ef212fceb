"""95 % intervals: of a share by Wilson, of anything else by the bootstrap."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

Z: Final = 1.959963984540054
"""Of the normal distribution, for 95 %."""
DRAWS: Final = 2000


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Interval of a share, after E. B. Wilson (1927); (0, 1) for nothing counted."""
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
    """Percentile interval of a statistic.

    Args:
        groups: values that belong together (one air) and are drawn together, each of shape (values,).
        statistic: of all values of a draw, over the last axis.

    Returns:
        None for less than two groups: nothing can be said then.
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
