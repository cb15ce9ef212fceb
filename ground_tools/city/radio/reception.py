"""Reception probabilities by the channel equations, for everybody in reach; `draws` draws from them.

The equations are those of `sitl_mocks.channel.equations`, with sums over all aircraft that reach a receiver.
Two things are tabulated or sampled: the mean delay over the survival of packets, and, for a sender that
senses more than `SAMPLE` Wi-Fi stations, the share of them that also reach the receiver.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Final, NamedTuple

import numpy as np

from companion.arrays import Floats, Integers
from companion.errors import ConfigError
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from ground_tools.city.compiled import compiled
from ground_tools.city.draws import Frames
from ground_tools.city.loop import State
from ground_tools.city.radio.choosing import Chooser
from ground_tools.city.simulation import PARTS
from ground_tools.city.tables import NOBODY, Air, Links
from sitl_mocks.channel.equations import carrier_sense
from sitl_mocks.channel.equations.collision import background_survival, shares_of
from sitl_mocks.channel.equations.delay import link_delay_s
from sitl_mocks.channel.equations.half_duplex import log_hearing
from sitl_mocks.channel.equations.reception import meeting_chances
from sitl_mocks.channel.parameters import (
    MODES,
    OVERLAPPED_CHANNELS,
    SECONDARY_CHANNELS,
    ChannelParameters,
    max_rates,
)

SAMPLE: Final = 64
"""Most Wi-Fi stations around a sender that are looked at one by one for each receiver."""
_LOWEST: Final = -8.0
"""Lowest log survival in the tables; below it, the tabulated value is extrapolated linearly."""
_NODES: Final = (401, 121, 401)
_HIGHEST_LOAD, _LOAD_NODES = 4.0, 161
"""Highest Wi-Fi load in the tables, and number of load nodes. Higher loads are clamped to the highest one."""
_WIDE: Final = OVERLAPPED_CHANNELS / SECONDARY_CHANNELS
# What an aircraft adds to the loads of those it reaches: log survivals, except the last one, a share of time.
(
    BLE4_BY_BLE4, POINTER_BY_BLE4, BLE4_BY_BLE5, POINTER_BY_BLE5, AUXILIARY_BY_BLE5, WIFI_BY_BLE5,
    WIFI_BY_WIFI, AUXILIARY_BY_WIFI, LOAD, PARTS_OF_LOAD,
) = range(10)  # fmt: skip
_BY_BLE4, _BY_BLE5, _BY_WIFI = BLE4_BY_BLE4, BLE4_BY_BLE5, WIFI_BY_WIFI
_compiled = compiled()


class Around(NamedTuple):
    """Radio traffic around each of M aircraft."""

    adds: Floats
    """(M, PARTS_OF_LOAD): what each aircraft adds."""
    total: Floats
    """(M, PARTS_OF_LOAD): sums of `adds` over all aircraft that reach it."""
    crowding: Floats
    """(M,): `carrier_sense.crowding` of the Wi-Fi load that it senses."""
    hearing: Floats
    """(M, 3): log probability that a BLE 4 PDU, a pointer and an auxiliary packet survive the receiver's own
    transmissions and the foreign transmissions."""
    wifi_quiet: float
    """Log probability that a beacon survives the foreign transmissions."""
    listens: float
    """1: stations sense the carrier."""
    reach2: float
    """Square of the reach of Wi-Fi, m^2."""


class Chances(NamedTuple):
    """Tables of log(-log(1 - p)) over log survival, one for each rate; p is the probability that one frame is
    received."""

    ble4: Floats
    """(rates, nodes)."""
    ble5: Floats
    """(rates, nodes, nodes): over the survival of pointer and auxiliary packet."""
    wifi: Floats
    """(rates, nodes, loads): over the survival of the beacon and the load around the sender."""


class AnalyticRadio:
    """Reception by the channel equations.

    Args:
        parameters: one Wi-Fi channel for all, and no shadowing.
        rates: Location messages per second that may be used on any transport.
        chooser: chooses the transports.
        slots: number of slots.
        message_s: time between two messages, which must be the GNSS period.
        rng: source of the draws of samples.

    Raises:
        ConfigError: the parameters ask for something that is not modelled here.
    """

    def __init__(
        self,
        parameters: ChannelParameters,
        rates: Collection[int],
        chooser: Chooser,
        slots: int,
        message_s: float,
        rng: np.random.Generator,
    ) -> None:
        _check(parameters, message_s)
        self._parameters, self.chooser, self._rng = parameters, chooser, rng
        self.chances = chances_of(parameters, rates)
        self.frames = Frames(message_s, offsets_s(parameters), np.zeros(slots))
        load = parameters.background
        quiet = background_survival(parameters, np.array([[load.ble4, load.ble5, load.wifi]]))
        self._quiet = np.log([quiet.ble4[0], quiet.pointer[0], quiet.auxiliary[0]])
        p, wifi = parameters.propagation, parameters.wifi
        budget = wifi.transmit_power_dbm - wifi.sensitivity_dbm - p.loss_at_1m_db
        self.around = Around(
            np.zeros((slots, PARTS_OF_LOAD)), np.zeros((slots, PARTS_OF_LOAD)), np.zeros(slots),
            np.zeros((slots, 3)), float(np.log(quiet.wifi[0])),
            1.0 if parameters.wifi.access == "carrier_sense" else 0.0,
            float(10.0 ** (2.0 * budget / (10.0 * p.exponent))),
        )  # fmt: skip
        self._places, self._near = np.zeros((SAMPLE, 3)), np.zeros((SAMPLE, 2))
        self._who = np.zeros(SAMPLE, np.int64)

    @property
    def sensed_load(self) -> Floats:
        """(M,): Wi-Fi load around each aircraft, as a share of time."""
        return np.asarray(self.around.total[:, LOAD])

    def choose(self, part: int, now: float, state: State) -> None:
        """See `simulation.Radio`."""
        air = state.air
        turn = np.flatnonzero(air.flight != NOBODY)
        turn = turn[turn % PARTS == part % PARTS]
        self.chooser.choose(now, turn, state, self._rng)
        self.compute(turn, state)

    def compute(self, turn: Integers, state: State) -> None:
        """Compute the loads around all aircraft, and the reception probabilities of the senders whose turn it
        is."""
        air, around, parameters = state.air, self.around, self._parameters
        rates = np.where(air.flight[:, None] != NOBODY, air.rates, 0)
        around.adds[:] = adds_of(rates, parameters)
        _sum(state.links, air.flight, rates, around)
        for c, log in enumerate(log_hearing(parameters, rates)):
            around.hearing[:, c] = self._quiet[c]
            if parameters.bluetooth_half_duplex:
                around.hearing[:, c] += log
        if around.listens:
            around.crowding[:] = carrier_sense.crowding(around.total[:, LOAD])
            each_ms = parameters.wifi.beacon_ms + carrier_sense.GAP_MS
            self.frames.wait_s[:] = carrier_sense.WAIT * each_ms * around.crowding / 1000.0
        starts = self._rng.random(len(turn))
        _survive(
            turn, starts, rates, state.craft.position, air, state.links, around, self.chances, self._places,
            self._near, self._who,
        )  # fmt: skip


def _check(parameters: ChannelParameters, message_s: float) -> None:
    if parameters.propagation.shadowing_sigma_db > 0.0 or parameters.wifi_channels != "shared":
        raise ConfigError(
            "the city's channel has no shadowing and one Wi-Fi channel: propagation.shadowing_sigma_db must "
            'be 0, and wifi_channels "shared"'
        )
    if abs(parameters.gnss_period_ms / 1000.0 - message_s) > 1e-9:
        raise ConfigError(f"gnss_period_ms must be {1000.0 * message_s:g}, the time between two messages")


def offsets_s(parameters: ChannelParameters) -> Floats:
    """Time from the beginning of a frame until its message is complete, by transport."""
    ble = [meeting_chances(mode, parameters)[1] for mode in (BLE4, BLE5)]
    return np.array([*ble, parameters.wifi.beacon_ms]) / 1000.0


def adds_of(rates: Integers, parameters: ChannelParameters) -> Floats:
    """What aircraft with these rates add to the loads of those they reach, (M, PARTS_OF_LOAD)."""
    s, period_ms = shares_of(parameters), parameters.gnss_period_ms
    ble4, ble5, wifi = (rates[:, m].astype(float) for m in range(len(MODES)))
    adds = np.zeros((len(rates), PARTS_OF_LOAD))
    for column, share, psi in (
        (BLE4_BY_BLE4, s.ble4_by_ble4, ble4),
        (POINTER_BY_BLE4, s.pointer_by_ble4, ble4),
        (BLE4_BY_BLE5, s.ble4_by_ble5, ble5),
        (POINTER_BY_BLE5, s.pointer_by_ble5, ble5),
        (AUXILIARY_BY_BLE5, s.auxiliary_by_ble5, ble5),
        (WIFI_BY_BLE5, s.wifi_by_ble5, ble5),
        (WIFI_BY_WIFI, s.wifi_by_wifi, wifi),
        (AUXILIARY_BY_WIFI, s.auxiliary_by_wifi, wifi),
    ):
        adds[:, column] = np.log1p(-share * psi)
    if parameters.wifi.access == "carrier_sense":
        together = (parameters.ble5.auxiliary_ms + parameters.wifi.beacon_ms) / period_ms
        adds[:, AUXILIARY_BY_WIFI] = np.log(np.maximum(1.0 - together * wifi, 1e-12))
        adds[:, LOAD] = carrier_sense.load_of(wifi, parameters)
    return adds


def chances_of(parameters: ChannelParameters, rates: Collection[int]) -> Chances:
    """Reception tables for these rates."""
    loads = np.linspace(0.0, _HIGHEST_LOAD, _LOAD_NODES)
    grids = [np.exp(np.linspace(_LOWEST, 0.0, nodes)) for nodes in _NODES]
    wifi_loads = loads if parameters.wifi.access == "carrier_sense" else loads[:2]
    shapes = ((_NODES[0],), (_NODES[1], _NODES[1]), (_NODES[2], len(wifi_loads)))
    tables = [np.zeros((max(max_rates(parameters)) + 1, *shape)) for shape in shapes]
    offset_s = offsets_s(parameters)
    for m, mode in enumerate(MODES):
        for rate in sorted(set(rates)):
            if not 1 <= rate <= max_rates(parameters)[m]:
                continue
            wait_s: Floats = np.zeros(1)
            if mode == BLE4:
                delay_s = link_delay_s(mode, rate, parameters, grids[0], np.ones(_NODES[0]))
            elif mode == BLE5:
                first, second = np.meshgrid(grids[1], grids[1], indexing="ij")
                delay_s = link_delay_s(mode, rate, parameters, first, second)
            else:
                alive, load = np.meshgrid(grids[2], wifi_loads, indexing="ij")
                delay_s = _wifi_delay_s(rate, alive, load, parameters)
                wait_s = _wait_s(load, parameters)
            tables[m][rate] = np.log(_hazard(delay_s - offset_s[m] - wait_s, rate, parameters))
    return Chances(*tables)


def _wifi_delay_s(rate: int, alive: Floats, load: Floats, parameters: ChannelParameters) -> Floats:
    if parameters.wifi.access == "carrier_sense":
        return carrier_sense.delay_s(rate, alive, load, parameters)
    return link_delay_s(WIFI_BEACON, rate, parameters, alive, np.ones_like(alive))


def _wait_s(load: Floats, parameters: ChannelParameters) -> Floats:
    if parameters.wifi.access != "carrier_sense":
        return np.zeros_like(load)
    each_ms = parameters.wifi.beacon_ms + carrier_sense.GAP_MS
    return np.asarray(carrier_sense.WAIT * each_ms * carrier_sense.crowding(load) / 1000.0)


def _hazard(delay_s: Floats, rate: int, parameters: ChannelParameters) -> Floats:
    """-log(1 - p) for the probability p of one frame that gives frames at this rate the given mean delay.

    The first frame begins at a random time within one interval, so that the mean is interval (1 / p - 1/2).
    """
    interval_s = parameters.gnss_period_ms / 1000.0 / rate
    p = 1.0 / np.maximum(delay_s / interval_s + 0.5, 1.0 + 1e-9)
    return np.asarray(-np.log1p(-p))


@_compiled
def _sum(links: Links, flight: Integers, rates: Integers, around: Around) -> None:
    """Sum up the contributions of all senders that reach each aircraft."""
    around.total[:] = 0.0
    for i in range(len(flight)):
        total = around.total[i]
        for e in range(links.start[i], links.start[i + 1]):
            j, modes = links.other[e], links.modes[e]
            add = around.adds[j]
            if modes & 1 and rates[j, 0] > 0:
                for c in range(_BY_BLE4, _BY_BLE5):
                    total[c] += add[c]
            if modes & 2 and rates[j, 1] > 0:
                for c in range(_BY_BLE5, _BY_WIFI):
                    total[c] += add[c]
            if modes & 4 and rates[j, 2] > 0:
                for c in range(_BY_WIFI, PARTS_OF_LOAD):
                    total[c] += add[c]


@_compiled
def _sensed(
    j: int, start: float, rates: Integers, position: Floats, links: Links, around: Around, places: Floats,
    near: Floats, who: Integers,
) -> int:  # fmt: skip
    """Write a sample of the Wi-Fi stations that aircraft j senses, with the weight of each. Returns its
    size."""
    stations = 0
    for e in range(links.start[j], links.start[j + 1]):
        if links.modes[e] & 4 and rates[links.other[e], 2] > 0:
            stations += 1
    size = min(stations, SAMPLE)
    stride = stations / size if size > 0 else 1.0
    number, found = 0, 0
    for e in range(links.start[j], links.start[j + 1]):
        k = links.other[e]
        if not (links.modes[e] & 4 and rates[k, 2] > 0):
            continue
        if found < size and number >= math.floor((found + start) * stride):
            who[found] = k
            for c in range(3):
                places[found, c] = position[k, c]
            near[found, 0] = stride * around.adds[k, WIFI_BY_WIFI]
            near[found, 1] = stride * around.adds[k, LOAD]
            found += 1
        number += 1
    return found


@_compiled
def _common(
    i: int, size: int, position: Floats, reach2: float, places: Floats, near: Floats, who: Integers
) -> tuple[float, float]:
    """Weighted sums over the stations of a sample that also reach aircraft i."""
    blind = load = 0.0
    for s in range(size):
        n, e, d = (
            places[s, 0] - position[i, 0], places[s, 1] - position[i, 1], places[s, 2] - position[i, 2]
        )  # fmt: skip
        if n * n + e * e + d * d <= reach2 and who[s] != i:
            blind += near[s, 0]
            load += near[s, 1]
    return blind, load


@_compiled
def _survive(
    turn: Integers, starts: Floats, rates: Integers, position: Floats, air: Air, links: Links,
    around: Around, chances: Chances, places: Floats, near: Floats, who: Integers,
) -> None:  # fmt: skip
    """Compute the reception probabilities of all links whose senders are in `turn`."""
    for t in range(len(turn)):
        j = turn[t]
        size, sends = 0, 0
        for m in range(rates.shape[1]):
            sends |= (1 << m) if rates[j, m] > 0 else 0
        if sends & 4 and around.listens != 0.0:
            size = _sensed(j, starts[t], rates, position, links, around, places, near, who)
        for e in range(links.start[j], links.start[j + 1]):
            i = links.other[e]
            on = links.modes[e] & sends
            chance = links.chance[e]
            chance[0] = chance[1] = chance[2] = 0.0
            ble4, pointer, auxiliary, wifi = _logs(i, j, on, around)
            if on & 1:
                chance[0] = -math.exp(_on_line(chances.ble4[rates[j, 0]], ble4))
            if on & 2:
                chance[1] = -math.exp(_on_grid(chances.ble5[rates[j, 1]], pointer, auxiliary))
            if on & 4:
                if around.listens != 0.0:
                    blind, load = _common(i, size, position, around.reach2, places, near, who)
                    wifi = min(wifi - blind, 0.0) - load * around.crowding[j]
                wifi += around.total[i, WIFI_BY_BLE5] - (around.adds[j, WIFI_BY_BLE5] if on & 2 else 0.0)
                wifi = min(wifi, 0.0) + around.wifi_quiet
                share = around.total[j, LOAD] / _HIGHEST_LOAD * (chances.wifi.shape[2] - 1)
                chance[2] = -math.exp(_on_loads(chances.wifi[rates[j, 2]], wifi, share))


@_compiled
def _logs(i: int, j: int, on: int, around: Around) -> tuple[float, float, float, float]:
    """Log survival of the BLE 4 PDU, pointer, auxiliary packet and beacon from j at i. For the beacon, only
    collisions with other Wi-Fi, without carrier sense."""
    total, own, hearing = around.total[i], around.adds[j], around.hearing[i]
    on4, on5, on_wifi = float(on & 1), float((on >> 1) & 1), float((on >> 2) & 1)
    ble4 = total[BLE4_BY_BLE4] - on4 * own[BLE4_BY_BLE4] + total[BLE4_BY_BLE5] - on5 * own[BLE4_BY_BLE5]
    pointer = (
        total[POINTER_BY_BLE5] - on5 * own[POINTER_BY_BLE5]
        + total[POINTER_BY_BLE4] - on4 * own[POINTER_BY_BLE4]
    )  # fmt: skip
    auxiliary = total[AUXILIARY_BY_BLE5] - on5 * own[AUXILIARY_BY_BLE5]
    beacons = min(total[AUXILIARY_BY_WIFI] - on_wifi * own[AUXILIARY_BY_WIFI], 0.0)
    if around.listens != 0.0:
        auxiliary += math.log1p(-_WIDE * (1.0 - math.exp(beacons)))
    else:
        auxiliary += beacons
    wifi = total[WIFI_BY_WIFI] - on_wifi * own[WIFI_BY_WIFI]
    return (
        min(ble4, 0.0) + hearing[0], min(pointer, 0.0) + hearing[1], min(auxiliary, 0.0) + hearing[2], wifi
    )  # fmt: skip


@_compiled
def _place(log: float, nodes: int) -> tuple[int, float]:
    """Table node below a log survival, and the fraction of the way to the next node."""
    at = (log - _LOWEST) * ((nodes - 1) / -_LOWEST)
    node = min(max(math.floor(at), 0), nodes - 2)
    return node, at - node


@_compiled
def _on_line(table: Floats, log: float) -> float:
    node, share = _place(log, len(table))
    return float(table[node] + share * (table[node + 1] - table[node]))


@_compiled
def _on_grid(table: Floats, first: float, second: float) -> float:
    node, share = _place(second, table.shape[1])
    low, part = _place(first, table.shape[0])
    below = table[low, node] + share * (table[low, node + 1] - table[low, node])
    above = table[low + 1, node] + share * (table[low + 1, node + 1] - table[low + 1, node])
    return float(below + part * (above - below))


@_compiled
def _on_loads(table: Floats, log: float, at: float) -> float:
    """Interpolate a table at a log survival and a load index; a load beyond the highest node is clamped to
    it."""
    node = min(math.floor(at), table.shape[1] - 2)
    share = min(at - node, 1.0)
    low, part = _place(log, table.shape[0])
    below = table[low, node] + share * (table[low, node + 1] - table[low, node])
    above = table[low + 1, node] + share * (table[low + 1, node + 1] - table[low + 1, node])
    return float(below + part * (above - below))
