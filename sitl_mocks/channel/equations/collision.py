"""Packet collisions: section "Packet Collision Model" with its eight products, and foreign transmissions.

STI is interference by the same technology, CTI by another one. Every factor is 1 - x psi, where psi is the
rate of one interfering aircraft and x the share of a GNSS period in which its packet would destroy the
victim. Durations are exact, not whole slots: rounding down would hide up to a fifth of the collisions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.arrays import Bools, Floats, Indices
from sitl_mocks.channel.equations.carrier_sense import log_auxiliary_under_wifi, log_survival
from sitl_mocks.channel.link_budget import Links
from sitl_mocks.channel.parameters import (
    MODES,
    OVERLAPPED_CHANNELS,
    SECONDARY_CHANNELS,
    WIFI_CHANNELS,
    ChannelParameters,
)

_BLE4, _BLE5, _WIFI = range(len(MODES))


@dataclass(frozen=True, slots=True)
class Shares:
    """Share of the GNSS period that one message of an interferer spoils, by victim and interferer."""

    ble4_by_ble4: float
    """P STI of BLE 4: 2 A_P / T_GNSS."""
    ble4_by_ble5: float
    """P CTI of BLE 4 by pointers: (A_P(BLE 4) + A_P(BLE 5)) / T_GNSS."""
    pointer_by_ble5: float
    """P STI of BLE 5 on primary channels."""
    pointer_by_ble4: float
    """P CTI of BLE 5 on primary channels."""
    auxiliary_by_ble5: float
    """P STI of BLE 5 on secondary channels: 2 T_AUX / (37 T_GNSS)."""
    auxiliary_by_wifi: float
    """P CTI of BLE 5 on secondary channels: 9 (T_AUX + B_D) / (37 T_GNSS)."""
    wifi_by_wifi: float
    """P STI of Wi-Fi on one channel."""
    wifi_by_ble5: float
    """P CTI of Wi-Fi by auxiliary packets."""


def shares_of(parameters: ChannelParameters) -> Shares:
    """Compute the shares from the durations."""
    period = parameters.gnss_period_ms
    a4, a5 = parameters.ble4.packet_ms, parameters.ble5.packet_ms
    aux, beacon = parameters.ble5.auxiliary_ms, parameters.wifi.beacon_ms
    wide = OVERLAPPED_CHANNELS * (aux + beacon) / (SECONDARY_CHANNELS * period)
    return Shares(
        ble4_by_ble4=2 * a4 / period,
        ble4_by_ble5=(a4 + a5) / period,
        pointer_by_ble5=2 * a5 / period,
        pointer_by_ble4=(a4 + a5) / period,
        auxiliary_by_ble5=2 * aux / (SECONDARY_CHANNELS * period),
        auxiliary_by_wifi=wide,
        wifi_by_wifi=2 * beacon / period,
        wifi_by_ble5=wide,
    )


@dataclass(frozen=True, slots=True)
class Survival:
    """Probability that one packet survives on its link, each of shape (links,); 1 where it is not carried.

    The packets are BLE 4's PDU, BLE 5's pointer and auxiliary packet, and Wi-Fi's beacon.
    """

    ble4: Floats
    pointer: Floats
    auxiliary: Floats
    wifi: Floats


def background_survival(parameters: ChannelParameters, busy: Floats) -> Survival:
    """Probability that a packet meets none of the foreign transmissions at its receiver.

    Busy and idle periods are exponential. The packet must begin in an idle period and end before that period
    does.

    Args:
        busy: shape (receivers, 3), share of busy time, in the order of `MODES`, below 1.
    """
    burst_ms = parameters.background.burst_ms

    def survives(mode: int, duration_ms: float) -> Floats:
        share = busy[:, mode]
        # The mean idle time is burst_ms (1 - share) / share.
        return np.asarray((1.0 - share) * np.exp(-duration_ms * share / (burst_ms * (1.0 - share))), float)

    return Survival(
        survives(_BLE4, parameters.ble4.packet_ms),
        survives(_BLE5, parameters.ble5.packet_ms),
        survives(_BLE5, parameters.ble5.auxiliary_ms),
        survives(_WIFI, parameters.wifi.beacon_ms),
    )


def survival(
    links: Links,
    carried: Bools,
    rates: Indices,
    wifi_channel: Indices,
    parameters: ChannelParameters,
) -> Survival:
    """The eight products for every link. Wi-Fi against Wi-Fi follows `access` of the parameters.

    A sender's own packets in other modes do not disturb its packet, and a receiver's own packets do not
    disturb what it receives: the sets R contain neither.

    Args:
        carried: shape (links, 3), the sender uses the mode and the link carries it.
        rates: shape (nodes, 3), messages in a GNSS period.
        wifi_channel: shape (nodes,), index into `WIFI_CHANNELS`.
    """
    s = shares_of(parameters)
    on = [np.flatnonzero(carried[:, mode]) for mode in range(len(MODES))]
    sender, receiver = [links.transmitter[at] for at in on], [links.receiver[at] for at in on]

    def log_product(mode: int, by: int, share: float, channels: Indices | None = None) -> Floats:
        """Log product over senders in mode `by` that reach the receiver, for the links that carry `mode`."""
        factor = np.log1p(-share * rates[:, by])
        key, by_key, kinds = receiver[mode], receiver[by], 1
        if channels is not None:
            kinds = len(WIFI_CHANNELS)
            key = key * kinds + channels[sender[mode]]
            by_key = by_key * kinds + channels[sender[by]]
        total = np.bincount(by_key, factor[sender[by]], minlength=links.nodes * kinds)
        own = factor[sender[mode]]
        return np.asarray(total[key] - (own if mode == by else np.where(carried[on[mode], by], own, 0.0)))

    def product(mode: int, *logs: Floats) -> Floats:
        """Product over all interferers, shape (links,)."""
        result = np.ones(len(links.receiver))
        # Rounding must not turn an empty product into a probability of more than 1.
        result[on[mode]] = np.exp(np.minimum(sum(logs), 0.0))
        return result

    def beacons(blind: Floats) -> tuple[Floats, ...]:
        """Log factors of the Wi-Fi stations, given the log product over all of them."""
        if parameters.wifi.access == "independent":
            return (blind,)
        sensed, among_sensed = log_survival(links, carried, rates, wifi_channel, parameters)
        # Rounding must not create hidden stations where there are none.
        return np.minimum(blind - sensed, 0.0), among_sensed

    return Survival(
        ble4=product(
            _BLE4, log_product(_BLE4, _BLE4, s.ble4_by_ble4), log_product(_BLE4, _BLE5, s.ble4_by_ble5)
        ),
        pointer=product(
            _BLE5, log_product(_BLE5, _BLE5, s.pointer_by_ble5), log_product(_BLE5, _BLE4, s.pointer_by_ble4)
        ),
        auxiliary=product(
            _BLE5,
            log_product(_BLE5, _BLE5, s.auxiliary_by_ble5),
            log_auxiliary_under_wifi(links, carried, rates, wifi_channel, parameters)
            if parameters.wifi.access == "carrier_sense"
            else log_product(_BLE5, _WIFI, s.auxiliary_by_wifi),
        ),
        wifi=product(
            _WIFI,
            *beacons(log_product(_WIFI, _WIFI, s.wifi_by_wifi, wifi_channel)),
            log_product(_WIFI, _BLE5, s.wifi_by_ble5),
        ),
    )
