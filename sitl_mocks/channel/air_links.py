"""Path losses and Wi-Fi channels of the simulated aircraft, shared by both models of the air.

Values are drawn at random when a name or a pair is first used, and stay fixed afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

import numpy as np

from companion.remote_id.transports import WIFI_BEACON, WIFI_NAN
from sitl_mocks.channel.link_budget import path_loss_db, thresholds_db
from sitl_mocks.channel.parameters import MODES, WIFI_CHANNELS, ChannelParameters

MAX_NAMES = 10_000
"""Maximum number of names whose draws are kept. The oldest are dropped and drawn anew if they return."""
MAX_PAIRS = 100_000
"""Maximum number of pairs whose draws are kept. This exceeds the pairs of any air simulated here."""
UNKNOWN_DISTANCE_M = 1.0
"""Distance assumed where it is unknown, so that the receiver is in range of every mode."""
CHANNEL_6 = WIFI_CHANNELS.index(6)

Key = TypeVar("Key")
Value = TypeVar("Value")


class Kept(Generic[Key, Value]):
    """Values that are drawn once for each key.

    Args:
        limit: maximum number of keys that are kept.
    """

    def __init__(self, limit: int = MAX_NAMES) -> None:
        self._limit = limit
        self._values: dict[Key, Value] = {}

    def get(self, key: Key, draw: Callable[[], Value]) -> Value:
        """Return the key's value. It is drawn when the key is used for the first time."""
        if key not in self._values:
            if len(self._values) >= self._limit:
                del self._values[next(iter(self._values))]
            self._values[key] = draw()
        return self._values[key]


def mode_of(transport: str) -> int:
    """Index into `MODES`. Wi-Fi NAN counts as a beacon on channel 6 (see `AirLinks`).

    Raises:
        ValueError: the channel models do not support the transport.
    """
    return MODES.index(WIFI_BEACON if transport == WIFI_NAN else transport)


class AirLinks:
    """Path losses of pairs of aircraft and Wi-Fi channels of senders.

    Args:
        parameters: parameters of the channel.
    """

    def __init__(self, parameters: ChannelParameters) -> None:
        self._parameters = parameters
        self.thresholds_db: list[float] = thresholds_db(parameters).tolist()
        """Greatest path loss at which each mode can be received (dB), in the order of `MODES`."""
        self._shadowing_db: Kept[tuple[str, str], float] = Kept(MAX_PAIRS)
        self._wifi_channel: Kept[str, int] = Kept()

    def path_loss_db(
        self, sender: str, distance_m: Mapping[str, float | None], rng: np.random.Generator
    ) -> dict[str, float]:
        """Path loss to each receiver (dB). Shadowing is drawn once for each pair, equal in both
        directions.
        """
        propagation = self._parameters.propagation
        away = [UNKNOWN_DISTANCE_M if d is None else d for d in distance_m.values()]
        loss_db = dict(zip(distance_m, path_loss_db(np.array(away), propagation).tolist(), strict=True))
        sigma_db = propagation.shadowing_sigma_db
        if sigma_db > 0.0:
            for receiver in loss_db:
                pair = (min(sender, receiver), max(sender, receiver))
                loss_db[receiver] += self._shadowing_db.get(pair, lambda: float(rng.normal(0.0, sigma_db)))
        return loss_db

    def wifi_channel(self, sender: str, transport: str, rng: np.random.Generator) -> int:
        """Index into `WIFI_CHANNELS`: channel 6 for "shared" and Wi-Fi NAN, else drawn once for each
        sender.
        """
        if transport == WIFI_NAN or self._parameters.wifi_channels == "shared":
            return CHANNEL_6
        return self._wifi_channel.get(sender, lambda: int(rng.integers(len(WIFI_CHANNELS))))
