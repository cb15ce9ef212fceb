"""Draws the dynamic variables of a track second by second, in compiled code."""

from __future__ import annotations

import numpy as np

from companion.arrays import Floats, Integers
from ground_tools.campaign.compiled import compiled
from ground_tools.campaign.encounters.model import Tables

_inlined = compiled(inline="always")


@compiled()
def walk(rng: np.random.Generator, tables: Tables, bins: Integers, now: Integers, values: Floats) -> None:
    """Draw all following seconds.

    Args:
        bins: shape (seconds, initial variables): bins in each second, of which the first row is given. The
            others are written.
        now: shape (transition variables,): space for the bins at t and t + 1.
        values: shape (seconds, D): values of the dynamic variables in the order of the tables and in the
            file's units, of which the first row is given. The others are written.
    """
    count = bins.shape[1]
    for second in range(1, len(bins)):
        for i in range(count):
            now[i] = bins[second - 1, i]
            bins[second, i] = now[i]
        for d in range(len(tables.later)):
            now[tables.later[d]] = _drawn(rng, tables, d, now)
        for d in range(len(tables.later)):
            before, bin_ = now[tables.at_t[d]], now[tables.later[d]]
            bins[second, tables.at_t[d]] = bin_
            if bin_ == before and rng.random() >= tables.rates[d]:
                values[second, d] = values[second - 1, d]
            elif bin_ == tables.zero_bin[d]:
                values[second, d] = 0.0
            else:
                low, high = tables.edges[d, bin_], tables.edges[d, bin_ + 1]
                values[second, d] = low + rng.random() * (high - low)


@_inlined
def _drawn(rng: np.random.Generator, tables: Tables, d: int, now: Integers) -> int:
    """The bin of a dynamic variable one second later. Where its parents were never observed together, it
    stays the same."""
    row = 0
    for c in range(tables.parents.shape[1]):
        if tables.parents[d, c] >= 0:
            row += tables.strides[d, c] * now[tables.parents[d, c]]
    width = tables.bins[d]
    start = tables.first[d] + row * width
    total = tables.sums[start + width - 1]
    if total == 0.0:
        return int(now[tables.at_t[d]])
    wanted, found = rng.random() * total, 0
    while found < width - 1 and tables.sums[start + found] <= wanted:
        found += 1
    return found
