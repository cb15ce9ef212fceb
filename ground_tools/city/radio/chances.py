"""Tables of the probability that a frame is received, over the survival of its packets, and their
interpolation."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Final, NamedTuple

import numpy as np

from companion.arrays import Floats
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from ground_tools.city.compiled import compiled
from sitl_mocks.channel.equations import carrier_sense
from sitl_mocks.channel.equations.delay import link_delay_s
from sitl_mocks.channel.equations.reception import meeting_chances
from sitl_mocks.channel.parameters import MODES, ChannelParameters, max_rates

_LOWEST: Final = -8.0
"""Lowest log survival in the tables; below it, the tabulated value is extrapolated linearly."""
_NODES: Final = (401, 121, 401)
HIGHEST_LOAD, _LOAD_NODES = 4.0, 161
"""Highest Wi-Fi load in the tables, and number of load nodes. Higher loads are clamped to the highest one."""
_compiled = compiled()


class Chances(NamedTuple):
    """Tables of log(-log(1 - p)) over log survival, one for each rate; p is the probability that one frame is
    received."""

    ble4: Floats
    """(rates, nodes)."""
    ble5: Floats
    """(rates, nodes, nodes): over the survival of pointer and auxiliary packet."""
    wifi: Floats
    """(rates, loads, nodes): over the load around the sender and the survival of the beacon. The receivers of
    one sender share its load."""


def offsets_s(parameters: ChannelParameters) -> Floats:
    """Time from the beginning of a frame until its message is complete, by transport."""
    ble = [meeting_chances(mode, parameters)[1] for mode in (BLE4, BLE5)]
    return np.array([*ble, parameters.wifi.beacon_ms]) / 1000.0


def chances_of(parameters: ChannelParameters, rates: Collection[int]) -> Chances:
    """Reception tables for these rates."""
    loads = np.linspace(0.0, HIGHEST_LOAD, _LOAD_NODES)
    grids = [np.exp(np.linspace(_LOWEST, 0.0, nodes)) for nodes in _NODES]
    wifi_loads = loads if parameters.wifi.access == "carrier_sense" else loads[:2]
    shapes = ((_NODES[0],), (_NODES[1], _NODES[1]), (len(wifi_loads), _NODES[2]))
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
            table = np.log(_hazard(delay_s - offset_s[m] - wait_s, rate, parameters))
            tables[m][rate] = table.T if mode == WIFI_BEACON else table
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
def _place(log: float, nodes: int) -> tuple[int, float]:
    """Table node below a log survival, and the fraction of the way to the next node."""
    at = (log - _LOWEST) * ((nodes - 1) / -_LOWEST)
    node = min(max(math.floor(at), 0), nodes - 2)
    return node, at - node


@_compiled
def on_line(table: Floats, log: float) -> float:
    """Interpolate a table at a log survival."""
    node, share = _place(log, len(table))
    return float(table[node] + share * (table[node + 1] - table[node]))


@_compiled
def on_grid(table: Floats, first: float, second: float) -> float:
    """Interpolate a table at two log survivals."""
    node, share = _place(second, table.shape[1])
    low, part = _place(first, table.shape[0])
    below = table[low, node] + share * (table[low, node + 1] - table[low, node])
    above = table[low + 1, node] + share * (table[low + 1, node + 1] - table[low + 1, node])
    return float(below + part * (above - below))


@_compiled
def on_loads(table: Floats, log: float, at: float) -> float:
    """Interpolate a table at a log survival and a load index; a load beyond the highest node is clamped to
    it."""
    node = min(math.floor(at), table.shape[0] - 2)
    share = min(at - node, 1.0)
    low, part = _place(log, table.shape[1])
    below = table[node, low] + share * (table[node + 1, low] - table[node, low])
    above = table[node, low + 1] + share * (table[node + 1, low + 1] - table[node, low + 1])
    return float(below + part * (above - below))
