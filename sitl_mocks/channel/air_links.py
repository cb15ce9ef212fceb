"""What both channel models of the air know of its aircraft: modes, path losses, Wi-Fi channels.

Names and pairs get what chance gives them when they are first met, and keep it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

import numpy as np

from companion.remote_id.transports import WIFI_BEACON, WIFI_NAN
from sitl_mocks.channel.link_budget import path_loss_db, thresholds_db
from sitl_mocks.channel.parameters import MODES, WIFI_CHANNELS, ChannelParameters

MAX_NAMES = 10_000
"""Names whose draws are kept; the oldest are forgotten, and drawn anew when they come back."""
MAX_PAIRS = 100_000
"""Pairs likewise: those of more aircraft than any air here holds at once."""
UNKNOWN_DISTANCE_M = 1.0
"""What counts where a distance is not known: in range of everything."""
CHANNEL_6 = WIFI_CHANNELS.index(6)

Key = TypeVar("Key")
Value = TypeVar("Value")


class Kept(Generic[Key, Value]):
    """Draws that are made once for each key.

    Args:
        limit: how many are kept.
    """

    def __init__(self, limit: int = MAX_NAMES) -> None:
        self._limit = limit
        self._values: dict[Key, Value] = {}

    def get(self, key: Key, draw: Callable[[], Value]) -> Value:
        """The key's value; drawn when it is met for the first time."""
        if key not in self._values:
            if len(self._values) >= self._limit:
                del self._values[next(iter(self._values))]
            self._values[key] = draw()
        return self._values[key]


def mode_of(transport: str) -> int:
    """Index into `MODES`. Wi-Fi NAN counts as a beacon on channel 6 (see `AirLinks`).

    Raises:
        ValueError: not a transport that the channel models know.
    """
    return MODES.index(WIFI_BEACON if transport == WIFI_NAN else transport)


class AirLinks:
    """Path losses and Wi-Fi channels.

    Args:
        parameters: those of the channel.
    """

    def __init__(self, parameters: ChannelParameters) -> None:
        self._parameters = parameters
        self.thresholds_db: list[float] = thresholds_db(parameters).tolist()
        """Greatest path loss over which each mode is heard, in the order of `MODES`."""
        self._shadowing_db: Kept[tuple[str, str], float] = Kept(MAX_PAIRS)
        self._wifi_channel: Kept[str, int] = Kept()

    def path_loss_db(
        self, sender: str, distance_m: Mapping[str, float | None], rng: np.random.Generator
    ) -> dict[str, float]:
        """Path loss to each receiver (dB); shadowing is frozen for a pair and the same in both directions."""
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
        """Index into `WIFI_CHANNELS`: 6 for all ("shared", and Wi-Fi NAN), or drawn once for each sender."""
        if transport == WIFI_NAN or self._parameters.wifi_channels == "shared":
            return CHANNEL_6
        return self._wifi_channel.get(sender, lambda: int(rng.integers(len(WIFI_CHANNELS))))
