"""Which track to give up when the table is full, found without looking at every track."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, field

_STEPS = 100
"""Steps of distance, each 12 % more; the last holds everything beyond about 2000 km."""
_STEPS_PER_OCTAVE = 6.0
_NEAREST_M = 25.0


@dataclass(slots=True)
class Ranking:
    """Tracks in bands: a fresh one is given up before an established one, the farthest first."""

    _bands: list[OrderedDict[str, None]] = field(
        default_factory=lambda: [OrderedDict() for _ in range(2 * _STEPS)]
    )
    """Ordered: a plain dict's first entry is slow to find after many deletions before it."""
    _held: dict[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        """Tracks held."""
        return len(self._held)

    def place(self, track_id: str, fresh: bool, distance_m: float) -> None:
        """Enter a track, or move it to where it belongs now."""
        step = min(_STEPS - 1, int(_STEPS_PER_OCTAVE * math.log2(1.0 + distance_m / _NEAREST_M)))
        band = step + _STEPS * fresh
        held = self._held.get(track_id)
        if held == band:
            return
        if held is not None:
            del self._bands[held][track_id]
        self._held[track_id] = band
        self._bands[band][track_id] = None

    def remove(self, track_id: str) -> None:
        """Take a track out."""
        del self._bands[self._held.pop(track_id)][track_id]

    def clear(self) -> None:
        """Take all out."""
        for band in self._bands:
            band.clear()
        self._held.clear()

    def first(self) -> str:
        """The track to give up; of one band, the longest there. There must be one."""
        return next(next(iter(band)) for band in reversed(self._bands) if band)
