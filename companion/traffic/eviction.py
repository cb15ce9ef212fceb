"""Finds the track to remove when the table is full, without a search through all tracks."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, field

_STEPS = 100
"""Number of distance steps, each 12 % farther than the one before. The last one holds everything beyond about
2000 km."""
_STEPS_PER_OCTAVE = 6.0
_NEAREST_M = 25.0


@dataclass(slots=True)
class Ranking:
    """Tracks sorted into bands. Fresh tracks are removed before established ones, the farthest first."""

    _bands: list[OrderedDict[str, None]] = field(
        default_factory=lambda: [OrderedDict() for _ in range(2 * _STEPS)]
    )
    """OrderedDict, because finding the first entry of a plain dict is slow after many deletions before it."""
    _held: dict[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of tracks held."""
        return len(self._held)

    def place(self, track_id: str, fresh: bool, distance_m: float) -> None:
        """Add a track, or move it to its present band."""
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
        """Remove a track."""
        del self._bands[self._held.pop(track_id)][track_id]

    def clear(self) -> None:
        """Remove all tracks."""
        for band in self._bands:
            band.clear()
        self._held.clear()

    def first(self) -> str:
        """The track to remove: in its band, the one that has been there longest. There must be a track."""
        return next(next(iter(band)) for band in reversed(self._bands) if band)
