"""The network of a policy, evaluated for many aircraft at once.

The matrix products are NumPy's. What lies between them is compiled, with NumPy's order of sums, so that the
values are the same to the bit as by its functions, in a fraction of the time.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from companion.arrays import Bools, Float32s, Integers
from companion.atmc.networks import Tensors
from ground_tools.city.compiled import compiled

ROWS_AT_ONCE: Final = 2000
"""Rows that are evaluated at once: few enough that a layer's values stay in the processor's cache."""
_TERMS: Final = 8
"""NumPy sums up to `_MOST_TERMS` numbers in this many partial sums, and more of them recursively."""
_MOST_TERMS: Final = 128
_ZERO: Final = np.float32(0.0)
_compiled = compiled()


class SetValues:
    """`companion.atmc.networks.SetNetwork` for many aircraft at once, and its working space.

    Args:
        tensors: the network's tensors.
    """

    def __init__(self, tensors: Tensors) -> None:
        self._tensors = tensors
        self._sizes = [tensors[f"phi{layer}.bias"].shape[0] for layer in (0, 1)]
        self._layers = [np.zeros((0, size), np.float32) for size in self._sizes]
        self._parts = np.zeros((_TERMS, self._sizes[1]), np.float32)

    def of(self, own: Float32s, rows: Float32s, count: Integers) -> Float32s:
        """The values, (B, actions).

        Args:
            own: shape (B, own columns).
            rows: shape (R, neighbour columns), one aircraft after the other.
            count: shape (B,): number of rows of each.
        """
        hidden = self._sizes[1]
        pooled = np.zeros((len(own), 2 * hidden + own.shape[1]), np.float32)
        end = np.cumsum(count)
        first = 0
        while first < len(own):
            base = int(end[first] - count[first])
            after = max(first + 1, int(np.searchsorted(end, base + ROWS_AT_ONCE, side="right")))
            some = np.arange(first, after)[count[first:after] > 0]
            if len(some):
                h = self._evaluated(rows[base : int(end[after - 1])])
                self._pool(h, end[some] - count[some] - base, some, pooled)
            first = after
        np.log1p(pooled[:, :hidden], out=pooled[:, :hidden])
        pooled[:, 2 * hidden :] = own
        z, tensors = pooled, self._tensors
        for layer in ("rho0", "rho1"):
            z = np.maximum(z @ tensors[f"{layer}.weight"].T + tensors[f"{layer}.bias"], 0.0)
        return np.asarray(z @ tensors["out.weight"].T + tensors["out.bias"], np.float32)

    def _evaluated(self, rows: Float32s) -> Float32s:
        """The last layer's outputs for each row."""
        h = rows
        for number, layer in enumerate(("phi0", "phi1")):
            if len(self._layers[number]) < len(rows):
                self._layers[number] = np.zeros((len(rows), self._sizes[number]), np.float32)
            h = np.matmul(h, self._tensors[f"{layer}.weight"].T, out=self._layers[number][: len(rows)])
            rectify(h, self._tensors[f"{layer}.bias"])
        return h

    def _pool(self, h: Float32s, starts: Integers, some: Integers, pooled: Float32s) -> None:
        if np.diff(starts, append=len(h)).max() <= _MOST_TERMS:
            pool(h, starts, some, self._parts, pooled)
            return
        hidden = h.shape[1]
        pooled[some, :hidden] = np.add.reduceat(h, starts, axis=0)
        pooled[some, hidden : 2 * hidden] = np.maximum.reduceat(h, starts, axis=0)


@_compiled
def rectify(h: Float32s, bias: Float32s) -> None:
    """`np.maximum(h + bias, 0)`, in place."""
    for r in range(len(h)):
        for c in range(h.shape[1]):
            value = h[r, c] + bias[c]
            h[r, c] = _ZERO if value <= _ZERO else value


@_compiled
def pool(h: Float32s, starts: Integers, some: Integers, parts: Float32s, pooled: Float32s) -> None:
    """`np.add.reduceat` and `np.maximum.reduceat` along the rows of h, of which none is negative.

    Args:
        starts: first row of each aircraft, which has at most `_MOST_TERMS` rows.
        some: row of `pooled` of each aircraft: its first columns receive the sums, the next ones the largest
            values.
        parts: shape (_TERMS, columns of h): working space.
    """
    hidden = h.shape[1]
    for s in range(len(starts)):
        first, end = starts[s], starts[s + 1] if s + 1 < len(starts) else len(h)
        sums, most = pooled[some[s], :hidden], pooled[some[s], hidden : 2 * hidden]
        for c in range(hidden):
            most[c] = h[first, c]
        for r in range(first + 1, end):
            for c in range(hidden):
                value = h[r, c]
                most[c] = value if value > most[c] or value != value else most[c]
        _sum_rows(h, first + 1, end, parts, sums)
        for c in range(hidden):
            sums[c] = h[first, c] + sums[c]


@_compiled
def _sum_rows(h: Float32s, first: int, end: int, parts: Float32s, sums: Float32s) -> None:
    """Write the sums of rows, in the order in which NumPy sums up numbers that are not contiguous."""
    rest = first
    for c in range(len(sums)):
        sums[c] = _ZERO
    if end - first >= _TERMS:
        rest = end - (end - first) % _TERMS
        for p in range(_TERMS):
            for c in range(len(sums)):
                parts[p, c] = h[first + p, c]
        for r in range(first + _TERMS, rest, _TERMS):
            for p in range(_TERMS):
                for c in range(len(sums)):
                    parts[p, c] += h[r + p, c]
        for c in range(len(sums)):
            low = (parts[0, c] + parts[1, c]) + (parts[2, c] + parts[3, c])
            sums[c] = low + ((parts[4, c] + parts[5, c]) + (parts[6, c] + parts[7, c]))
    for r in range(rest, end):
        for c in range(len(sums)):
            sums[c] += h[r, c]


@_compiled
def admit(
    rows: Float32s, count: Integers, low: Float32s, high: Float32s, distance: int, most: int, refused: Bools,
    kept: Float32s,
) -> int:  # fmt: skip
    """Leave out neighbours that are too far away, and observations that the policy refuses.

    Args:
        rows: all neighbours, one aircraft after the other.
        count: number of neighbours of each; receives the numbers of those that are kept.
        low, high: bounds of the columns.
        distance: index of the column for which a neighbour above the bound is left out.
        most: greatest number of neighbours that is not refused.
        refused: read and written.
        kept: as large as `rows`; receives the neighbours that are kept.

    Returns:
        The number of rows written.
    """
    used = at = 0
    for b in range(len(count)):
        first, good = used, not refused[b]
        for r in range(at, at + count[b]):
            if rows[r, distance] > high[distance]:
                continue
            within = True
            for c in range(rows.shape[1]):
                kept[used, c] = rows[r, c]
                within &= (rows[r, c] >= low[c]) & (rows[r, c] <= high[c])
            good &= within
            used += 1
        at += count[b]
        good &= used - first <= most
        refused[b] = not good
        used = used if good else first
        count[b] = used - first
    return used
