"""The radio channel as the simulated air sees it: frames go in, fates come out when certain.

A packet's fate is known only once nothing can collide with it any more, so that a channel may decide later
than it is asked. What it draws comes from the generator that is passed in: a seed and an order of calls give
one air.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True, slots=True)
class Transmission:
    """One frame that an aircraft puts on the air."""

    number: int
    """Unique, and higher than that of any earlier one."""
    sent_s: float
    """When the companion hands it to its radio."""
    sender: str
    transport: str
    """`companion.radio.radio` name."""
    distance_m: Mapping[str, float | None]
    """By receiver: slant distance, None where it is not known."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one frame at one receiver."""

    number: int
    """The transmission's."""
    receiver: str
    arrival_s: float | None
    """Finite, not before it was sent; None when it is lost."""


class Channel(Protocol):
    """A radio model. Times never go back: no frame is sent before the time of an earlier call."""

    def transmit(self, transmission: Transmission, rng: np.random.Generator) -> None:
        """Put one frame on the air."""
        ...

    def settle(self, now_s: float, rng: np.random.Generator) -> list[Outcome]:
        """Every outcome that is certain by `now_s` and was not given before, in an order of the channel's.

        Each transmission gets one outcome for every receiver that it names. The time of this call decides
        when an outcome is told, never what it is.
        """
        ...

    def next_s(self) -> float | None:
        """When `settle` may have more to tell; a call then tells it or moves this on. None: all is told."""
        ...


class Decisions:
    """Outcomes of a channel that decides at once: they wait here for `settle`."""

    def __init__(self) -> None:
        self._outcomes: list[Outcome] = []
        self._first_s = 0.0

    def add(self, transmission: Transmission, receiver: str, arrival_s: float | None) -> None:
        """One more outcome."""
        if not self._outcomes:
            self._first_s = transmission.sent_s
        self._outcomes.append(Outcome(transmission.number, receiver, arrival_s))

    def pop_outcomes(self) -> list[Outcome]:
        """Those that were added since the last call, in their order."""
        taken, self._outcomes = self._outcomes, []
        return taken

    def next_s(self) -> float | None:
        """See `Channel.next_s`."""
        return self._first_s if self._outcomes else None
