"""The pluggable radio channel, and its plainest implementation: delay, loss and range by fixed numbers.

A channel answers one question per message and receiver: after how long does it arrive, or not at all. What it
draws comes from the generator that is passed in, so that a seed and an order of calls give one air.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from companion.errors import ConfigError

MAX_DELAY_S = 60.0


class Channel(Protocol):
    """What the ether asks of a radio model."""

    def deliver(
        self, sender: str, receiver: str, transport: str, distance_m: float | None, rng: np.random.Generator
    ) -> float | None:
        """Delay of one message on its way to one receiver (s, finite, >= 0); None when it is lost.

        Args:
            sender: name of the transmitting aircraft.
            receiver: name of the receiving aircraft.
            transport: `companion.radio.transport` name.
            distance_m: between the two (slant), None when it is not known.
            rng: where the channel draws from.
        """
        ...


@dataclass(frozen=True, slots=True)
class SimpleChannel:
    """Uniform delay, independent loss, hard range limit.

    Two numbers are drawn for every message and receiver whatever becomes of it. Two runs with one seed thus
    meet the same luck message by message, however differently their aircraft fly.

    Raises:
        ConfigError: a parameter is out of its range.
    """

    delay_s: tuple[float, float] = (0.0, 0.0)
    """Lower and upper bound of the delay; equal ones make it constant."""
    loss: float = 0.0
    """Probability that a message is lost."""
    range_m: float | None = None
    """Nothing is heard farther than this. A message over an unknown distance is in range."""

    def __post_init__(self) -> None:
        low, high = self.delay_s
        # Negated comparisons refuse NaN too.
        if not 0.0 <= low <= high <= MAX_DELAY_S:
            raise ConfigError(
                f"channel.delay_s: {low:g}, {high:g}: allowed 0 <= low <= high <= {MAX_DELAY_S:g}"
            )
        if not 0.0 <= self.loss <= 1.0:
            raise ConfigError(f"channel.loss: {self.loss:g}: allowed 0 to 1")
        if self.range_m is not None and not 0.0 < self.range_m < math.inf:
            raise ConfigError(f"channel.range_m: {self.range_m:g}: allowed a finite value > 0")

    def deliver(
        self, sender: str, receiver: str, transport: str, distance_m: float | None, rng: np.random.Generator
    ) -> float | None:
        """See `Channel.deliver`."""
        luck, share = rng.random(2)
        if luck < self.loss:
            return None
        if self.range_m is not None and distance_m is not None and distance_m > self.range_m:
            return None
        low, high = self.delay_s
        return float(low + (high - low) * share)
