"""Foreign transmissions at the receivers, as an on/off process for each receiver and mode."""

from __future__ import annotations

import numpy as np

from companion.arrays import Bools, Floats, Indices
from sitl_mocks.channel.parameters import MODES, ChannelParameters

_BLOCK = 256


class _Bursts:
    """An alternating renewal process: exponential busy and idle periods, stationary from its start."""

    def __init__(self, share: float, burst: float, start: float, rng: np.random.Generator) -> None:
        self._rng = rng
        self._burst = burst
        self._idle = burst * (1.0 - share) / share
        # Exponential periods are memoryless: the rest of a period that runs at the start is distributed like
        # a whole one.
        first = rng.exponential(burst) if rng.random() < share else 0.0
        self._begin, self._end = np.array([start]), np.array([start + first])

    def overlaps(self, begin: Floats, end: Floats) -> Bools:
        """Whether each interval meets a burst. No `begin` may lie before the time of the last `forget`."""
        self._extend(float(end.max()))
        latest = self._begin.searchsorted(end) - 1
        # Bursts end in the order in which they begin, so the latest one that begins before `end` decides.
        return np.asarray((latest >= 0) & (self._end[latest] > begin), bool)

    def forget(self, before: float) -> None:
        """Drop bursts that ended before a time. The latest one stays, because the process continues there."""
        over = min(int(self._end.searchsorted(before)), len(self._end) - 1)
        if over >= _BLOCK:
            self._begin, self._end = self._begin[over:], self._end[over:]

    def _extend(self, until: float) -> None:
        if self._end[-1] >= until:
            return
        # Blocks have one size, so that the draws do not depend on how the caller divides time.
        begins, ends = [self._begin], [self._end]
        while ends[-1][-1] < until:
            idle = self._rng.exponential(self._idle, _BLOCK)
            busy = self._rng.exponential(self._burst, _BLOCK)
            end = ends[-1][-1] + np.cumsum(idle + busy)
            begins.append(end - busy)
            ends.append(end)
        self._begin, self._end = np.concatenate(begins), np.concatenate(ends)


class Background:
    """Foreign bursts at every receiver, drawn as far as they are needed. Times in slots."""

    def __init__(
        self, parameters: ChannelParameters, nodes: int, start: float, rng: np.random.Generator
    ) -> None:
        """
        Args:
            parameters: their `background` gives the share of each mode and the mean burst.
            nodes: number of receivers.
            start: time at which the processes begin (slots).
            rng: parent of one generator for each process, so that their draws are independent of each other.
        """
        load = parameters.background
        burst = load.burst_ms / parameters.slot_ms
        generators = iter(rng.spawn(len(MODES) * nodes))
        self._nodes = nodes
        self._bursts: list[list[_Bursts] | None] = []
        for mode in MODES:
            share: float = getattr(load, mode)
            own = [next(generators) for _ in range(nodes)]
            self._bursts.append([_Bursts(share, burst, start, g) for g in own] if share > 0.0 else None)

    def overlaps(self, mode: Indices, begin: Floats, end: Floats) -> Bools | None:
        """Whether each packet meets a burst on its mode at each receiver, shape (packets, nodes).

        The result is None for a band without foreign transmissions. It is not valid for packets that begin
        before the time of the last `forget`.
        """
        if not any(self._bursts):
            return None
        met = np.zeros((len(begin), self._nodes), bool)
        for index, bursts in enumerate(self._bursts):
            rows = np.nonzero(mode == index)[0]
            if bursts is None or not len(rows):
                continue
            since, until = begin[rows], end[rows]
            for node, process in enumerate(bursts):
                met[rows, node] = process.overlaps(since, until)
        return met

    def forget(self, before: float) -> None:
        """Drop bursts that ended before a time. Packets that begin at or after `before` remain valid."""
        for bursts in self._bursts:
            for process in bursts or ():
                process.forget(before)
