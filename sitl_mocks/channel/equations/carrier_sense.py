"""Wi-Fi beacons of stations that listen before they send: what survives, and how late it comes.

The paper's product takes beacons as sent blindly. With `WifiParameters.access` "carrier_sense" the equations
tell the stations k apart that reach the receiver i of a link from j, on j's channel:

- those that j does not sense (they do not reach it) are hidden and keep the paper's 1 - 2 B_D psi_k / T;
- those that j senses wait for it, as it does for them. Two of them meet only where they waited for the same
  busy time and their countdowns end together. With u = sum of psi_k (B_D + h) / T over the stations that j
  senses, and u_i over those of them that reach i too,

      survival = exp(-u_i v(u)),    v(u) = 2 c u / (1 - u + sqrt((1 - u)^2 + 4 a c u^2)).

u v(u) is the mean number of others that begin together with j: c u^2 / (1 - u) while there is time for all,
(u - 1) / a when there is not. Then all that is asked for is still sent, several at a time.

The paper's factors for an auxiliary packet of BLE 5 draw its channel anew for each beacon that it may meet;
but it lies on one channel, and 28 of 37 are free of any Wi-Fi channel (`log_auxiliary_under_wifi`).

The beacon waits, W = w (B_D + h) v(u), and its interval runs on past a GNSS sample, so that a receiver's scan
meets it after the same number of beacons again and again (`running_terms`), until the waits blur that
(`blur`).

c, a, h, w and the blur are fitted to the packet-by-packet simulator (docs/channel.md).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from companion.remote_id.transports import BLE5, WIFI_BEACON
from sitl_mocks.channel.equations.delay import TRIES, Terms, mean_delay_s
from sitl_mocks.channel.link_budget import Bools, Indices, Links
from sitl_mocks.channel.parameters import (
    MODES,
    OVERLAPPED_CHANNELS,
    SECONDARY_CHANNELS,
    WIFI_CHANNELS,
    ChannelParameters,
    check_rate,
)

Floats = NDArray[np.float64]

MEETING: Final = 0.029
"""c: how often two stations meet that waited for the same busy time."""
CROWDING: Final = 0.71
"""a: inverse of the number of further stations that begin together for each airtime asked for beyond all."""
GAP_MS: Final = 0.092
"""h: idle time that each beacon costs, the DIFS and some backoff slots."""
WAIT: Final = 16.5
"""w: beacon lengths that a station waits for each other one that begins with it; half of CWmin + 2."""
BLUR: Final = 10.7
"""Waits of this part of a scan cycle leave half of the regularity with which scans and beacons meet."""

_BLE5, _WIFI = MODES.index(BLE5), MODES.index(WIFI_BEACON)
_NOTHING = 1e-300
_PHASES = 2048
_LONGEST_PATTERN = 256
_DENSE_NODES = 1024
"""Largest group of aircraft that reach each other for which a full matrix is made."""
_DENSE_CELLS = 1 << 22
"""Cells of such matrices at a time: bounds the memory."""


def crowding(load: Floats) -> Floats:
    """v(u), same shape: others that begin together with a station, for each unit of load around it."""
    free = 1.0 - load
    return 2.0 * MEETING * load / (free + np.sqrt(free * free + 4.0 * CROWDING * MEETING * load * load))


def load_of(rates: Floats, parameters: ChannelParameters) -> Floats:
    """Share of the GNSS period that a station fills at psi messages, psi (B_D + h) / T; same shape."""
    return rates * ((parameters.wifi.beacon_ms + GAP_MS) / parameters.gnss_period_ms)


def sensed_load(
    links: Links, carried: Bools, rates: Indices, wifi_channel: Indices, parameters: ChannelParameters
) -> Floats:
    """u of every aircraft: load of the stations that it senses on its channel, shape (nodes,).

    Args: as for `collision.survival`.
    """
    sender, receiver = _heard_on_own_channel(links, carried, wifi_channel)
    load = load_of(rates[:, _WIFI].astype(float), parameters)
    return np.asarray(np.bincount(receiver, load[sender], minlength=links.nodes), float)


def log_survival(
    links: Links, carried: Bools, rates: Indices, wifi_channel: Indices, parameters: ChannelParameters
) -> tuple[Floats, Floats]:
    """What becomes of the paper's product over Wi-Fi, for the links that carry it, each of shape (on,).

    Returns:
        The log of the factors of the stations that the sender senses, to be taken out of the paper's product,
        and the log of the survival among these, to be put in.
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

    On one of the 9 secondary channels under a Wi-Fi channel it meets all beacons there, else none of them.

    Args: as for `collision.survival`.
    """
    on, by = np.flatnonzero(carried[:, _BLE5]), np.flatnonzero(carried[:, _WIFI])
    sender, receiver = links.transmitter[on], links.receiver[on]
    together_ms = parameters.ble5.auxiliary_ms + parameters.wifi.beacon_ms
    # Long packets at a high rate leave nothing on such a channel.
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
    """Senders and receivers of the links that carry Wi-Fi between stations of one channel."""
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
                # Transposed: row by who senses, column by who is sensed.
                sensed[block[same], i[same], j[same]] = weight[sender[rows[same]]]
                found[kind, rows] = (sensed @ hears)[block, j, i]
    return found


def _groups(nodes: int, sender: Indices, receiver: Indices) -> tuple[Indices, Indices, Indices]:
    """Runs of successive aircraft that no link leaves: environments lie side by side.

    Returns:
        Shape (nodes,): the run of each aircraft and its place there; shape (runs,): their sizes.
    """
    spanned = np.zeros(nodes + 1, np.intp)
    low, high = np.minimum(sender, receiver), np.maximum(sender, receiver)
    spanned[:nodes] += np.bincount(low + 1, minlength=nodes)[:nodes]
    spanned -= np.bincount(high + 1, minlength=nodes + 1)
    # A run begins at each aircraft that no link passes by or comes to from before.
    begins = np.cumsum(spanned[:nodes]) == 0
    group = np.cumsum(begins) - 1
    first = np.flatnonzero(begins)
    sizes = np.diff(np.append(first, nodes))
    return group, np.arange(nodes) - first[group], sizes


def _sparse(sender: Indices, receiver: Indices, wifi_channel: Indices, weights: Floats) -> Floats:
    """As `_over_common`, for one large group, shape (kinds, links)."""
    # Only whoever simulates thousands of aircraft needs SciPy; it comes with the extra `inspect`.
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
    """Mean delay (s) from a GNSS sample to the first beacon heard of it or of a later one.

    Args:
        rate: psi of the sender.
        survival: probability that one beacon survives; any shape.
        sensed: u of the sender, same shape.

    Returns:
        Same shape; infinite where nothing can ever arrive.

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
    # Where nothing survives both are infinite, and one of the shares may be 0.
    return np.where(survival > _NOTHING, mixed, np.inf) + wait_ms / 1000.0


def blur(wait_ms: Floats, cycle_ms: float) -> Floats:
    """Share of the regularity between beacons and scans that waits take away, 0 to 1."""
    square = (BLUR * wait_ms / cycle_ms) ** 2
    return square / (1.0 + square)


@lru_cache(maxsize=1024)
def running_terms(rate: int, parameters: ChannelParameters) -> Terms:
    """The terms of beacons whose interval T_GNSS / psi runs on past GNSS samples, in exact time.

    A period is as many beacons as it takes until beacon and scan stand to each other as before (at most
    `_LONGEST_PATTERN`); its phase is uniform, and so is the time from the sample to the next beacon.

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


def _in_first_column(counts: Indices) -> NDArray[np.int64]:
    """Numbers of tries of the only kind that Wi-Fi has, shape (counts, TRIES)."""
    table = np.zeros((len(counts), TRIES), np.int64)
    table[:, 0] = counts
    return table
