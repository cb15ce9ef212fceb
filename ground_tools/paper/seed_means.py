"""Interquartile means over the seeds of training runs, and their bootstrap."""

from __future__ import annotations

from typing import Final

import numpy as np

from companion.arrays import Floats

_DRAWS: Final = 2000


def interquartile_mean(values: Floats) -> Floats:
    """Interquartile mean over the second-last axis of values of shape (..., seeds, points). At either end, a
    quarter of the seeds, rounded down, is left out."""
    seeds = values.shape[-2]
    cut = seeds // 4
    ordered: Floats = np.sort(values, axis=-2)[..., cut : seeds - cut, :]
    found: Floats = ordered.mean(-2)
    return found


def resampled(values: Floats) -> Floats:
    """Interquartile means of seeds drawn with replacement: from shape (seeds, points) to (draws, points)."""
    rng = np.random.default_rng(1)
    found: Floats = interquartile_mean(values[rng.integers(0, len(values), (_DRAWS, len(values)))])
    return found
