"""The paper's channel model for whole fleets: mean delay and loss of every link, and the system delay of P0.

It is vectorised over links. One set of links may hold many environments. Every aircraft may send in several
modes, each at its own rate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.arrays import Bools, Floats, Indices
from companion.errors import ConfigError
from companion.remote_id.transports import WIFI_BEACON
from sitl_mocks.channel.equations import carrier_sense
from sitl_mocks.channel.equations.collision import background_survival, survival
from sitl_mocks.channel.equations.delay import link_delay_s
from sitl_mocks.channel.equations.half_duplex import log_hearing
from sitl_mocks.channel.link_budget import Links, reached
from sitl_mocks.channel.parameters import MODES, WIFI_CHANNELS, ChannelParameters, max_rates


@dataclass(frozen=True, slots=True)
class Fleet:
    """Message rates and Wi-Fi channels of all aircraft."""

    rates: Indices
    """Shape (nodes, 3), in the order of `MODES`: messages in a GNSS period; 0 if the mode is not used."""
    wifi_channel: Indices
    """Index into `WIFI_CHANNELS`, shape (nodes,)."""


def fixed_mode(
    nodes: int, mode: str, rate: int, parameters: ChannelParameters, rng: np.random.Generator | None = None
) -> Fleet:
    """A fleet in which all aircraft send in one mode at one rate.

    Args:
        rng: draws the Wi-Fi channels if the parameters require "random".

    Raises:
        ValueError: random Wi-Fi channels without a generator.
    """
    return Fleet(fixed_rates(nodes, mode, rate), wifi_channels(nodes, parameters, rng))


def fixed_rates(nodes: int, mode: str, rate: int) -> Indices:
    """`Fleet.rates` of a fleet in which all aircraft send in one mode at one rate."""
    rates = np.zeros((nodes, len(MODES)), np.intp)
    rates[:, MODES.index(mode)] = rate
    return rates


def wifi_channels(nodes: int, parameters: ChannelParameters, rng: np.random.Generator | None) -> Indices:
    """`Fleet.wifi_channel` according to the parameters.

    Raises:
        ValueError: random Wi-Fi channels without a generator.
    """
    if parameters.wifi_channels == "shared":
        return np.full(nodes, 1, np.intp)
    if rng is None:
        raise ValueError("random Wi-Fi channels need a random generator")
    return rng.integers(len(WIFI_CHANNELS), size=nodes).astype(np.intp)


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Results of the model for every link and mode."""

    links: Links
    carried: Bools
    """Shape (links, 3): the sender uses the mode and the link carries it."""
    delay_s: Floats
    """Shape (links, 3): mean delay; NaN where not carried, infinite where no message ever arrives."""
    loss: Floats
    """Shape (links, 3): probability that a packet which the receiver's scan would have met is destroyed on
    the air; NaN where not carried. For BLE 5, one pointer and the auxiliary packet must both survive.
    """

    def uav_delay_s(self) -> Floats:
        """Mean delay to the aircraft that each one reaches, shape (nodes,); 0 for one that reaches none (P0).

        Raises:
            ValueError: an aircraft uses more than one mode, which P0 does not cover.
        """
        if (self.carried.sum(axis=1) > 1).any():
            raise ValueError("the method P0 needs exactly one mode per aircraft")
        link, mode = np.nonzero(self.carried)
        sender = self.links.transmitter[link]
        total = np.bincount(sender, self.delay_s[link, mode], minlength=self.links.nodes)
        reached_by = np.bincount(sender, minlength=self.links.nodes)
        return np.asarray(total / np.maximum(reached_by, 1), float)


def system_delay_s(evaluation: Evaluation, environments: int) -> Floats:
    """Sum over the aircraft of each environment, shape (environments,). All environments have one size."""
    each: Floats = evaluation.uav_delay_s().reshape(environments, -1).sum(axis=1)
    return each


class Analytic:
    """The channel equations with their parameters."""

    def __init__(self, parameters: ChannelParameters) -> None:
        self.parameters = parameters

    def evaluate(self, links: Links, fleet: Fleet, busy: Floats | None = None) -> Evaluation:
        """Delay and loss of every link.

        Args:
            busy: shape (nodes, 3), share of time that foreign transmissions fill each mode's channel at each
                receiver. Default: the background load of the parameters.

        Raises:
            ConfigError: a rate is below 0 or above the mode's largest, or a busy share is below 0 or not
                below 1.
            ValueError: an array has a wrong shape, rates are not integers, or a Wi-Fi channel is not an index
                into `WIFI_CHANNELS`.
        """
        self._check(links, fleet, busy)
        # Column-major order, because columns are searched and filled one by one.
        carried = np.asfortranarray(reached(links, self.parameters) & (fleet.rates > 0)[links.transmitter])
        alive = survival(links, carried, fleet.rates, fleet.wifi_channel, self.parameters)
        ble4, pointer, auxiliary, wifi = alive.ble4, alive.pointer, alive.auxiliary, alive.wifi
        others = busy if busy is not None else self._busy(links.nodes)
        if others.any():
            quiet, at = background_survival(self.parameters, others), links.receiver
            ble4, wifi = ble4 * quiet.ble4[at], wifi * quiet.wifi[at]
            pointer, auxiliary = pointer * quiet.pointer[at], auxiliary * quiet.auxiliary[at]
        if self.parameters.bluetooth_half_duplex:
            hears = [np.exp(log)[links.receiver] for log in log_hearing(self.parameters, fleet.rates)]
            ble4, pointer, auxiliary = ble4 * hears[0], pointer * hears[1], auxiliary * hears[2]
        one = np.ones_like(ble4)
        sensed = self._sensed_load(links, carried, fleet)
        delay, loss = (np.full(carried.shape, np.nan, order="F") for _ in range(2))
        for index, (mode, first, second) in enumerate(
            zip(MODES, (ble4, pointer, wifi), (one, auxiliary, one), strict=True)
        ):
            on_mode = np.flatnonzero(carried[:, index])
            loss[on_mode, index] = 1.0 - first[on_mode] * second[on_mode]
            rates = fleet.rates[links.transmitter[on_mode], index].astype(np.int16)  # radix sort
            order = np.argsort(rates, kind="stable")
            numbers = np.bincount(rates)
            for rate, at in enumerate(np.split(on_mode[order], np.cumsum(numbers)[:-1])):
                if len(at) and mode == WIFI_BEACON and sensed is not None:
                    load = sensed[links.transmitter[at]]
                    delay[at, index] = carrier_sense.delay_s(rate, first[at], load, self.parameters)
                elif len(at):
                    delay[at, index] = link_delay_s(mode, rate, self.parameters, first[at], second[at])
        return Evaluation(links, carried, delay, loss)

    def _sensed_load(self, links: Links, carried: Bools, fleet: Fleet) -> Floats | None:
        """Wi-Fi load around each aircraft, shape (nodes,). None if stations send without listening."""
        if self.parameters.wifi.access == "independent":
            return None
        return carrier_sense.sensed_load(links, carried, fleet.rates, fleet.wifi_channel, self.parameters)

    def _busy(self, nodes: int) -> Floats:
        load = self.parameters.background
        return np.tile([load.ble4, load.ble5, load.wifi], (nodes, 1))

    def _check(self, links: Links, fleet: Fleet, busy: Floats | None) -> None:
        if fleet.rates.shape != (links.nodes, len(MODES)):
            raise ValueError(f"rates have shape {fleet.rates.shape}; expected ({links.nodes}, {len(MODES)})")
        if not np.issubdtype(fleet.rates.dtype, np.integer):
            raise ValueError(f"rates are {fleet.rates.dtype}; expected integers")
        channels = fleet.wifi_channel
        if channels.shape != (links.nodes,):
            raise ValueError(f"wifi_channel has shape {channels.shape}; expected ({links.nodes},)")
        # Another number would be taken for a channel of the next receiver.
        if channels.size and not 0 <= channels.min() <= channels.max() < len(WIFI_CHANNELS):
            raise ValueError(
                f"wifi_channel is {channels.min()} to {channels.max()}; expected indices 0 to "
                f"{len(WIFI_CHANNELS) - 1} into {WIFI_CHANNELS}"
            )
        for index, (mode, largest) in enumerate(zip(MODES, max_rates(self.parameters), strict=True)):
            rates = fleet.rates[:, index]
            if rates.size and not 0 <= rates.min() <= rates.max() <= largest:
                raise ConfigError(
                    f"{mode}: rates {rates.min()} to {rates.max()} are out of range; allowed: 0 to {largest}"
                )
        if busy is not None and busy.shape != (links.nodes, len(MODES)):
            raise ValueError(f"busy has shape {busy.shape}; expected ({links.nodes}, {len(MODES)})")
        if busy is not None and not ((busy >= 0.0) & (busy < 1.0)).all():
            raise ConfigError("busy: a share is out of range; allowed: 0 to less than 1")
