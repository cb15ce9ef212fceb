"""Interface of the radio channel: frames go in, and their outcomes come out when they are certain.

The outcome of a packet is known only when no further packet can collide with it. A channel may therefore
decide later than at the time of sending. All random numbers come from the generator that is passed in: the
same seed and the same order of calls give the same results.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import msgspec
import numpy as np


@dataclass(frozen=True, slots=True)
class Transmission:
    """One frame that an aircraft puts on the air."""

    number: int
    """Unique, and higher than that of any earlier transmission."""
    sent_s: float
    """Time at which the companion hands the frame to its radio."""
    sender: str
    transport: str
    """Transport name as in `companion.radio.radio`."""
    distance_m: Mapping[str, float | None]
    """Slant distance by receiver; None where it is unknown."""


class Outcome(msgspec.Struct, frozen=True):
    """Result of one frame at one receiver."""

    number: int
    """Number of the transmission."""
    receiver: str
    arrival_s: float | None
    """Time of arrival, finite and not before it was sent; None if the frame is lost."""


class Channel(Protocol):
    """A radio model. Times never decrease: no frame is sent before the time of an earlier call."""

    def transmit(self, transmission: Transmission, rng: np.random.Generator) -> None:
        """Put one frame on the air."""
        ...

    def settle(self, now_s: float, rng: np.random.Generator) -> list[Outcome]:
        """Outcomes that are certain at `now_s` and were not returned before, in any order.

        Each transmission gets one outcome for every receiver that it names. The time of this call affects
        only when an outcome is returned, never its content.
        """
        ...

    def next_s(self) -> float | None:
        """Time at which `settle` may have more outcomes. A call at that time returns them or moves this time
        on. None if all outcomes were returned.
        """
        ...


class Decisions:
    """Outcomes of a channel that decides at once. They are kept until `settle`."""

    def __init__(self) -> None:
        self._outcomes: list[Outcome] = []
        self._first_s = 0.0

    def add(self, transmission: Transmission, receiver: str, arrival_s: float | None) -> None:
        """Add one outcome."""
        if not self._outcomes:
            self._first_s = transmission.sent_s
        self._outcomes.append(Outcome(transmission.number, receiver, arrival_s))

    def pop_outcomes(self) -> list[Outcome]:
        """Return the outcomes added since the last call, in their order."""
        taken, self._outcomes = self._outcomes, []
        return taken

    def next_s(self) -> float | None:
        """See `Channel.next_s`."""
        return self._first_s if self._outcomes else None
