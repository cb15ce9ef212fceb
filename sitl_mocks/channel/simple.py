"""The simplest radio channel: delay, loss and range are fixed parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from companion.errors import ConfigError
from sitl_mocks.channel.air import Decisions, Outcome, Transmission

MAX_DELAY_S = 60.0


@dataclass(slots=True)
class SimpleChannel:
    """Uniform delay, independent loss and a hard range limit. This `Channel` decides at once.

    Two numbers are drawn for every message and receiver, also for messages that are lost. Two runs with one
    seed therefore draw the same numbers message by message, however differently their aircraft fly.

    Raises:
        ConfigError: a parameter is out of its range.
    """

    delay_s: tuple[float, float] = (0.0, 0.0)
    """Lower and upper bound of the delay. Equal bounds make it constant."""
    loss: float = 0.0
    """Probability that a message is lost."""
    range_m: float | None = None
    """Greatest distance at which a message is received. A message over an unknown distance is in range."""
    _decisions: Decisions = field(default_factory=Decisions, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        low, high = self.delay_s
        # The negated comparison also refuses NaN.
        if not 0.0 <= low <= high <= MAX_DELAY_S:
            raise ConfigError(
                f"channel.delay_s: {low:g}, {high:g} is out of range; "
                f"allowed: 0 <= low <= high <= {MAX_DELAY_S:g}"
            )
        if not 0.0 <= self.loss <= 1.0:
            raise ConfigError(f"channel.loss: {self.loss:g} is out of range; allowed: 0 to 1")
        if self.range_m is not None and not 0.0 < self.range_m < math.inf:
            raise ConfigError(
                f"channel.range_m: {self.range_m:g} is out of range; allowed: finite values above 0"
            )

    def transmit(self, transmission: Transmission, rng: np.random.Generator) -> None:
        """See `Channel.transmit`."""
        for receiver, distance_m in transmission.distance_m.items():
            delay_s = self._delay_s(distance_m, rng)
            arrival_s = None if delay_s is None else transmission.sent_s + delay_s
            self._decisions.add(transmission, receiver, arrival_s)

    def settle(self, now_s: float, rng: np.random.Generator) -> list[Outcome]:
        """See `Channel.settle`. Returns the outcomes of all frames sent, in the order of sending."""
        return self._decisions.pop_outcomes()

    def next_s(self) -> float | None:
        """See `Channel.next_s`."""
        return self._decisions.next_s()

    def _delay_s(self, distance_m: float | None, rng: np.random.Generator) -> float | None:
        luck, share = rng.random(2)
        if luck < self.loss:
            return None
        if self.range_m is not None and distance_m is not None and distance_m > self.range_m:
            return None
        low, high = self.delay_s
        return float(low + (high - low) * share)
