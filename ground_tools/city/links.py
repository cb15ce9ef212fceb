"""Finds, with a grid, which aircraft may receive which: the links between all aircraft within reach.

The search is repeated every `simulation.LINKS_S`. Messages in transit and the links' track rows are kept.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.arrays import Bools, Floats, Integers
from ground_tools.campaign.vehicles import Fleet
from ground_tools.city.compiled import compiled, lowest_bit
from ground_tools.city.tables import NEAR_MOST, NOBODY, Air, Links, Near, Numbers, new_links

Words = NDArray[np.uint64]
_MOST_CELLS = 256
"""Most cells along one axis."""
_compiled = compiled()


class Grid:
    """Working space of the search, and the links that the latest search found.

    Args:
        slots: number of slots.
        reach_m: how far each transport reaches.
        messages: number of messages that may be in transit on a link.
        near_m: distance of a pair below which it is measured at every step.
    """

    def __init__(self, slots: int, reach_m: Floats, messages: int, near_m: float) -> None:
        self._reach2 = np.asarray(reach_m, float) ** 2
        self._near2 = near_m * near_m
        self._messages, self._slots = messages, slots
        self.links = new_links(slots, 1, messages)
        self._spare = new_links(slots, 1, messages)
        self._cell, self._sorted = np.zeros(slots, np.int64), np.zeros(slots, np.int64)
        self._begin = np.zeros(_MOST_CELLS**2 + 2, np.int64)
        self._cursor = np.zeros(slots, np.int64)
        self._words, self._away2 = np.zeros(slots // 64 + 1, np.uint64), np.zeros(slots)
        self._kept = np.zeros((2, NEAR_MOST), np.int32)

    def find(self, position: Floats, air: Air, fresh: Bools) -> Links:
        """Find the links for the present positions.

        Args:
            position: shape (slots, 3).
            fresh: shape (slots,): whether the slot has another aircraft than at the last call.
        """
        work = self._cell, self._sorted, self._begin, self._words, self._away2
        needed = _search(position, air.flight, self._reach2, fresh, *work, self.links, self._spare)
        if needed > len(self._spare.other):
            self._spare = new_links(self._slots, needed + needed // 4, self._messages)
            _search(position, air.flight, self._reach2, fresh, *work, self.links, self._spare)
        _join(self._spare, self._cursor)
        self.links, self._spare = self._spare, self.links
        return self.links

    def pair(self, craft: Fleet, near: Near, fresh: Bools) -> int:
        """Find the pairs to measure at every step. Returns how many did not fit into the tables."""
        return int(_pair(craft.position, self.links, self._near2, fresh, near, self._kept))


@_compiled
def _box(position: Floats, flight: Integers, reach: float) -> tuple[float, float, float, int, int]:
    """Corner of the grid, width of its cells, and number of cells along north and east."""
    low_n = low_e = math.inf
    high_n = high_e = -math.inf
    for i in range(len(flight)):
        if flight[i] != NOBODY:
            low_n, high_n = min(low_n, position[i, 0]), max(high_n, position[i, 0])
            low_e, high_e = min(low_e, position[i, 1]), max(high_e, position[i, 1])
    if low_n > high_n:
        return 0.0, 0.0, reach, 1, 1
    width = max(reach, max(high_n - low_n, high_e - low_e) / (_MOST_CELLS - 1))
    return low_n, low_e, width, int((high_n - low_n) / width) + 1, int((high_e - low_e) / width) + 1


@_compiled
def _sort(
    position: Floats, flight: Integers, reach: float, cell: Integers, order: Integers, begin: Integers
) -> tuple[int, int]:
    """Sort the aircraft by cells: cell c has the entries begin[c] to begin[c + 1] of `order`."""
    low_n, low_e, width, rows, columns = _box(position, flight, reach)
    begin[: rows * columns + 2] = 0
    for i in range(len(flight)):
        if flight[i] != NOBODY:
            row, column = int((position[i, 0] - low_n) / width), int((position[i, 1] - low_e) / width)
            cell[i] = row * columns + column
            begin[cell[i] + 2] += 1
    for c in range(2, rows * columns + 2):
        begin[c] += begin[c - 1]
    for i in range(len(flight)):
        if flight[i] != NOBODY:
            order[begin[cell[i] + 1]] = i
            begin[cell[i] + 1] += 1
    return rows, columns


@_compiled
def _largest(values: Floats) -> float:
    most = 0.0
    for value in values:
        most = max(most, value)
    return most


@_compiled
def _apart2(position: Floats, i: int, j: int) -> float:
    n, e, d = (
        position[i, 0] - position[j, 0], position[i, 1] - position[j, 1], position[i, 2] - position[j, 2]
    )  # fmt: skip
    return float(n * n + e * e + d * d)


@_compiled
def _search(
    position: Floats, flight: Integers, reach2: Floats, fresh: Bools, cell: Integers, order: Integers,
    begin: Integers, words: Words, away2: Floats, old: Links, new: Links,
) -> int:  # fmt: skip
    """Write the links, one receiver after the other, without `back`. Returns their number; those that do not
    fit are only counted.

    Args:
        words: one bit for each slot, all of them 0: working space.
        away2: shape (slots,): working space.
    """
    most = _largest(reach2)
    rows, columns = _sort(position, flight, math.sqrt(most), cell, order, begin)
    used = 0
    for i in range(len(flight)):
        new.start[i] = used
        if flight[i] == NOBODY:
            continue
        row, column = cell[i] // columns, cell[i] % columns
        found = 0
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            low = begin[r * columns + max(column - 1, 0)]
            for at in range(low, begin[r * columns + min(column + 1, columns - 1) + 1]):
                j = order[at]
                away2[j] = _apart2(position, i, j)
                near = (away2[j] <= most) & (j != i)
                words[j >> 6] |= np.uint64(near) << np.uint64(j & 63)
                found += int(near)
        used += found
        _write(i, used - found, used <= len(new.other), reach2, fresh, words, away2, old, new)
    new.start[len(flight)] = used
    return used


@_compiled
def _write(
    i: int, e: int, fits: bool, reach2: Floats, fresh: Bools, words: Words, away2: Floats, old: Links,
    new: Links,
) -> None:  # fmt: skip
    """Write the links of receiver i, from link e on, in rising order of their senders, whose bits in `words`
    become 0. Messages in transit and track rows are carried over."""
    at, end = old.start[i], old.start[i + 1]
    if fresh[i]:
        at = end
    for w in range(len(words)):
        bits = words[w]
        words[w] = 0
        while fits and bits != 0:
            j = 64 * w + lowest_bit(bits)
            bits &= bits - np.uint64(1)
            modes = 0
            for m in range(len(reach2)):
                modes |= int(away2[j] <= reach2[m]) << m
            new.other[e], new.modes[e] = j, modes
            while at < end and old.other[at] < j:
                at += 1
            if at < end and old.other[at] == j and not fresh[j]:
                _carry(at, e, old, new)
            else:
                new.row[e], new.due_s[e] = NOBODY, math.inf
                new.arrival[e, :] = math.inf
                new.chance[e, :] = 0.0
            e += 1


@_compiled
def _carry(at: int, e: int, old: Links, new: Links) -> None:
    """Carry over what is known of a link, and its messages in transit."""
    new.row[e], new.due_s[e] = old.row[at], old.due_s[at]
    for s in range(new.arrival.shape[1]):
        new.arrival[e, s], new.by[e, s] = old.arrival[at, s], old.by[at, s]
    for m in range(new.chance.shape[1]):
        new.chance[e, m] = old.chance[at, m]


@_compiled
def _join(links: Links, cursor: Integers) -> None:
    """Write `Links.back`: the links of sender j are visited in rising order of their receivers, which is the
    order of the links that j receives on."""
    for j in range(len(cursor)):
        cursor[j] = links.start[j]
    for e in range(links.start[len(cursor)]):
        j = links.other[e]
        links.back[e] = cursor[j]
        cursor[j] += 1


@_compiled
def _pair(position: Floats, links: Links, near2: float, fresh: Bools, near: Near, kept_pairs: Numbers) -> int:
    """Write the near pairs. A loss of separation that continues keeps its number."""
    overflow = 0
    others, events = kept_pairs[0], kept_pairs[1]
    for i in range(len(near.number)):
        kept = 0
        for n in range(near.number[i]):
            j = near.other[i, n]
            if near.event[i, n] != NOBODY and not fresh[i] and not fresh[j]:
                others[kept], events[kept] = j, near.event[i, n]
                kept += 1
        count = 0
        for e in range(links.start[i], links.start[i + 1]):
            j = links.other[e]
            if j >= i or _apart2(position, i, j) > near2:
                continue
            if count == NEAR_MOST:
                overflow += 1
                continue
            near.other[i, count], near.event[i, count] = j, NOBODY
            for n in range(kept):
                if others[n] == j:
                    near.event[i, count] = events[n]
            count += 1
        near.number[i] = count
    return overflow
