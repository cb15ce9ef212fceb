"""Survival and delay of Wi-Fi beacons from stations that listen before they send.

The paper's product assumes that stations do not listen first. With `WifiParameters.access` "carrier_sense"
the equations distinguish the stations k that reach the receiver i of a link from j, on j's channel:

- Stations that j does not sense (they do not reach it) are hidden and keep the paper's 1 - 2 B_D psi_k / T.
- Stations that j senses wait for j, and j waits for them. Two of them collide only if they waited for the
  same busy period and their countdowns end together. With u = sum of psi_k (B_D + h) / T over the stations
  that j senses, and u_i the sum over those of them that also reach i,

      survival = exp(-u_i v(u)),    v(u) = 2 c u / (1 - u + sqrt((1 - u)^2 + 4 a c u^2)).

u v(u) is the mean number of others that begin together with j: about c u^2 / (1 - u) for a load u well below
1, and (u - 1) / a well above 1. In the latter case all beacons are still sent, several at a time.

The paper's factors for an auxiliary packet of BLE 5 draw its channel anew for each beacon that it may meet.
In fact the packet has one channel, and no Wi-Fi channel covers 28 of the 37 (`log_auxiliary_under_wifi`).

A beacon waits for W = w (B_D + h) v(u) on average, and beacon intervals do not restart at GNSS samples. A
receiver's scan therefore meets beacons in a regular pattern (`running_terms`), which the waits blur (`blur`).

c, a, h, w and the blur are fitted to the packet-level simulator (docs/channel.md).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np

from companion.arrays import Bools, Floats, Indices, Integers
from companion.remote_id.transports import BLE5, WIFI_BEACON
from sitl_mocks.channel.equations.delay import TRIES, Terms, mean_delay_s
from sitl_mocks.channel.link_budget import Links
from sitl_mocks.channel.parameters import (
    MODES,
    OVERLAPPED_CHANNELS,
    SECONDARY_CHANNELS,
    WIFI_CHANNELS,
    ChannelParameters,
    check_rate,
)

MEETING: Final = 0.029
"""c: how often two stations that waited for the same busy period collide."""
CROWDING: Final = 0.71
"""a: inverse of the number of further stations that begin together, per unit of load beyond the capacity."""
GAP_MS: Final = 0.092
"""h: idle time per beacon: the DIFS and some backoff slots."""
WAIT: Final = 16.5
"""w: wait, in beacon lengths, for each other station that begins with this one; half of CWmin + 2."""
BLUR: Final = 10.7
"""A mean wait of one scan cycle / BLUR halves the regularity with which scans meet beacons (`blur`)."""

_BLE5, _WIFI = MODES.index(BLE5), MODES.index(WIFI_BEACON)
_NOTHING = 1e-300
_PHASES = 2048
_LONGEST_PATTERN = 256
_DENSE_NODES = 1024
"""Largest group of aircraft that reach each other for which a full matrix is built."""
_DENSE_CELLS = 1 << 22
"""Number of cells of such matrices that are processed at once. It limits memory."""


def crowding(load: Floats) -> Floats:
    """v(u), same shape: number of others that begin together with a station, per unit of load around it."""
    free = 1.0 - load
    return 2.0 * MEETING * load / (free + np.sqrt(free * free + 4.0 * CROWDING * MEETING * load * load))


def load_of(rates: Floats, parameters: ChannelParameters) -> Floats:
    """Share of the GNSS period that a station fills with psi messages, psi (B_D + h) / T; same shape."""
    return rates * ((parameters.wifi.beacon_ms + GAP_MS) / parameters.gnss_period_ms)


def sensed_load(
    links: Links, carried: Bools, rates: Indices, wifi_channel: Indices, parameters: ChannelParameters
) -> Floats:
    """u of every aircraft: load of the stations that it senses on its channel, shape (nodes,).

    Args: see `collision.survival`.
    """
    sender, receiver = _heard_on_own_channel(links, carried, wifi_channel)
    load = load_of(rates[:, _WIFI].astype(float), parameters)
    return np.asarray(np.bincount(receiver, load[sender], minlength=links.nodes), float)


def log_survival(
    links: Links, carried: Bools, rates: Indices, wifi_channel: Indices, parameters: ChannelParameters
) -> tuple[Floats, Floats]:
    """Corrections to the paper's product over Wi-Fi, for the links that carry Wi-Fi, each of shape (on,).

    Returns:
        The log of the factors of the stations that the sender senses, to be removed from the paper's product,
        and the log of the survival among these stations, to be added instead.
    """
    on = np.flatnonzero(carried[:, _WIFI])
    psi = rates[:, _WIFI].astype(float)
    load = load_of(psi, parameters)
    blind = np.log1p(-2.0 * parameters.wifi.beacon_ms / parameters.gnss_period_ms * psi)
    sensed = sensed_load(links, carried, rates, wifi_channel, parameters)
    factors, both = _over_common(links, on, wifi_channel, np.stack([blind, load]))
    return factors, -both * crowding(sensed)[links.transmitter[on]]


def log_auxiliary_under_wifi(
    links: Links, carried: Bools, rates: Indices, wifi_channel: Indices, parameters: ChannelParameters
) -> Floats:
    """Log of the probability that an auxiliary packet meets no beacon, for the links that carry BLE 5, (on,).

    On one of the 9 secondary channels under a Wi-Fi channel it can meet all beacons on that channel, else
    none.

    Args: see `collision.survival`.
    """
    on, by = np.flatnonzero(carried[:, _BLE5]), np.flatnonzero(carried[:, _WIFI])
    sender, receiver = links.transmitter[on], links.receiver[on]
    together_ms = parameters.ble5.auxiliary_ms + parameters.wifi.beacon_ms
    # Long packets at a high rate leave no idle time on such a channel.
    idle = np.maximum(1.0 - together_ms / parameters.gnss_period_ms * rates[:, _WIFI], 1e-12)
    factor = np.log(idle)
    hit = np.zeros(len(on))
    for channel in range(len(WIFI_CHANNELS)):
        some = by[wifi_channel[links.transmitter[by]] == channel]
        total = np.bincount(links.receiver[some], factor[links.transmitter[some]], minlength=links.nodes)
        own = carried[on, _WIFI] & (wifi_channel[sender] == channel)
        hit += 1.0 - np.exp(np.minimum(total[receiver] - np.where(own, factor[sender], 0.0), 0.0))
    return np.asarray(np.log1p(-OVERLAPPED_CHANNELS / SECONDARY_CHANNELS * hit), float)


def _heard_on_own_channel(links: Links, carried: Bools, wifi_channel: Indices) -> tuple[Indices, Indices]:
    """Senders and receivers of the links that carry Wi-Fi between stations on the same channel."""
    on = np.flatnonzero(carried[:, _WIFI])
    sender, receiver = links.transmitter[on], links.receiver[on]
    same = wifi_channel[sender] == wifi_channel[receiver]
    return sender[same], receiver[same]


def _over_common(links: Links, on: Indices, wifi_channel: Indices, weights: Floats) -> Floats:
    """Sums over the stations on j's channel that both j and i hear, for the links j -> i.

    Args:
        on: shape (on,): the links that carry Wi-Fi.
        weights: shape (kinds, nodes).

    Returns:
        Shape (kinds, on).
    """
    sender, receiver = links.transmitter[on], links.receiver[on]
    group, place, sizes = _groups(links.nodes, sender, receiver)
    found = np.zeros((len(weights), len(on)))
    of_link = group[sender]
    for size in np.unique(sizes):
        if size < 3:  # no third station
            continue
        if size > _DENSE_NODES:
            for big in np.flatnonzero(sizes == size):
                rows = np.flatnonzero(of_link == big)
                found[:, rows] = _sparse(sender[rows], receiver[rows], wifi_channel, weights)
            continue
        alike = np.flatnonzero(sizes == size)
        row_of = np.full(len(sizes), -1)
        at_once = max(1, _DENSE_CELLS // int(size) ** 2)
        for low in range(0, len(alike), at_once):
            some = alike[low : low + at_once]
            row_of[:] = -1
            row_of[some] = np.arange(len(some))
            rows = np.flatnonzero(row_of[of_link] >= 0)
            block, j, i = row_of[of_link[rows]], place[sender[rows]], place[receiver[rows]]
            hears = np.zeros((len(some), size, size))
            hears[block, j, i] = 1.0
            same = wifi_channel[sender[rows]] == wifi_channel[receiver[rows]]
            for kind, weight in enumerate(weights):
                sensed = np.zeros_like(hears)
                # Transposed: the row is the sensing station, the column the sensed one.
                sensed[block[same], i[same], j[same]] = weight[sender[rows[same]]]
                found[kind, rows] = (sensed @ hears)[block, j, i]
    return found


def _groups(nodes: int, sender: Indices, receiver: Indices) -> tuple[Indices, Indices, Indices]:
    """Ranges of successive aircraft that no link leaves, because environments are stored one after the other.

    Returns:
        Shape (nodes,): the range of each aircraft and its position in it; shape (ranges,): their sizes.
    """
    spanned = np.zeros(nodes + 1, np.intp)
    low, high = np.minimum(sender, receiver), np.maximum(sender, receiver)
    spanned[:nodes] += np.bincount(low + 1, minlength=nodes)[:nodes]
    spanned -= np.bincount(high + 1, minlength=nodes + 1)
    # A range begins at each aircraft that no link spans or reaches from an earlier aircraft.
    begins = np.cumsum(spanned[:nodes]) == 0
    group = np.cumsum(begins) - 1
    first = np.flatnonzero(begins)
    sizes = np.diff(np.append(first, nodes))
    return group, np.arange(nodes) - first[group], sizes


def _sparse(sender: Indices, receiver: Indices, wifi_channel: Indices, weights: Floats) -> Floats:
    """Like `_over_common`, for one large group, shape (kinds, links)."""
    # SciPy is needed only to simulate thousands of aircraft. The extra `inspect` installs it.
    from scipy.sparse import csr_array

    low = int(min(sender.min(), receiver.min()))
    size = int(max(sender.max(), receiver.max())) + 1 - low
    j, i = sender - low, receiver - low
    hears = csr_array((np.ones(len(j)), (j, i)), shape=(size, size))
    same = wifi_channel[sender] == wifi_channel[receiver]
    found = np.zeros((len(weights), len(j)))
    for kind, weight in enumerate(weights):
        sensed = csr_array((weight[sender[same]], (i[same], j[same])), shape=(size, size))
        found[kind] = np.asarray((sensed @ hears)[j, i]).ravel()
    return found


def delay_s(rate: int, survival: Floats, sensed: Floats, parameters: ChannelParameters) -> Floats:
    """Mean delay (s) from a GNSS sample to the first beacon received that carries it or a later one.

    Args:
        rate: psi of the sender.
        survival: probability that one beacon survives; any shape.
        sensed: u of the sender, same shape.

    Returns:
        Same shape; infinite where no beacon can ever arrive.

    Raises:
        ConfigError: the rate is less than 1 or more than the largest.
    """
    wifi = parameters.wifi
    cycle_ms = 3.0 * (wifi.scan_ms + wifi.switch_ms)
    interval_s = parameters.gnss_period_ms / rate / 1000.0
    met = (wifi.scan_ms - wifi.beacon_ms) / cycle_ms
    wait_ms = WAIT * (wifi.beacon_ms + GAP_MS) * crowding(sensed)
    regular = mean_delay_s(running_terms(rate, parameters), survival, np.ones_like(survival))
    blurred = blur(wait_ms, cycle_ms)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        by_chance = interval_s * (1.0 / (met * survival) - 0.5) + wifi.beacon_ms / 1000.0
        mixed = (1.0 - blurred) * regular + blurred * by_chance
    # Where nothing survives both delays are infinite, and a share of 0 would give NaN.
    return np.where(survival > _NOTHING, mixed, np.inf) + wait_ms / 1000.0


def blur(wait_ms: Floats, cycle_ms: float) -> Floats:
    """Share of the regularity between beacons and scans that waits remove, 0 to 1."""
    square = (BLUR * wait_ms / cycle_ms) ** 2
    return square / (1.0 + square)


@lru_cache(maxsize=1024)
def running_terms(rate: int, parameters: ChannelParameters) -> Terms:
    """Terms of beacons whose interval T_GNSS / psi runs on past GNSS samples, in exact time.

    A period has as many beacons as it takes until beacon and scan have the same relative phase again (at most
    `_LONGEST_PATTERN`). Its phase is uniform, and so is the time from the sample to the next beacon.

    Raises:
        ConfigError: the rate is less than 1 or more than the largest.
    """
    check_rate(WIFI_BEACON, rate, parameters)
    wifi = parameters.wifi
    cycle_ms = 3.0 * (wifi.scan_ms + wifi.switch_ms)
    interval_ms = parameters.gnss_period_ms / rate
    beacons = next(
        (
            n
            for n in range(1, _LONGEST_PATTERN)
            if abs(math.remainder(n * interval_ms, cycle_ms)) < 1e-6 * cycle_ms
        ),
        _LONGEST_PATTERN,
    )
    phase_ms = (np.arange(_PHASES) + 0.5) / _PHASES * cycle_ms
    number = np.arange(beacons)
    met = np.mod(phase_ms[:, None] + number * interval_ms, cycle_ms) <= wifi.scan_ms - wifi.beacon_ms
    before: Indices = np.cumsum(met, axis=1) - met
    late_s = np.broadcast_to(((number + 0.5) * interval_ms + wifi.beacon_ms) / 1000.0, met.shape)
    weight = np.bincount(before[met]) / _PHASES
    hits = np.bincount(met.sum(axis=1)) / _PHASES
    return Terms(
        failed=_in_first_column(np.arange(len(weight))),
        kind=np.zeros(len(weight), np.int64),
        weight=weight,
        delay_s=np.bincount(before[met], late_s[met]) / _PHASES,
        missed=_in_first_column(np.flatnonzero(hits)),
        missed_weight=hits[hits > 0.0],
        period_s=beacons * interval_ms / 1000.0,
    )


def _in_first_column(counts: Indices) -> Integers:
    """Numbers of tries of the only kind that Wi-Fi has, shape (counts, TRIES)."""
    table = np.zeros((len(counts), TRIES), np.int64)
    table[:, 0] = counts
    return table
