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
from ground_tools.city.compiled import compiled
from ground_tools.city.draws import Frames
from ground_tools.city.loop import State
from ground_tools.city.radio.chances import (
    HIGHEST_LOAD,
    Chances,
    chances_of,
    offsets_s,
    on_grid,
    on_line,
    on_loads,
)
from ground_tools.city.radio.choosing import Chooser
from ground_tools.city.simulation import PARTS
from ground_tools.city.tables import NOBODY, Air, Links
from sitl_mocks.channel.equations import carrier_sense
from sitl_mocks.channel.equations.collision import background_survival, shares_of
from sitl_mocks.channel.equations.half_duplex import log_hearing
from sitl_mocks.channel.parameters import (
    MODES,
    OVERLAPPED_CHANNELS,
    SECONDARY_CHANNELS,
    ChannelParameters,
)

SAMPLE: Final = 64
"""Most Wi-Fi stations around a sender that are looked at one by one for each receiver."""
BLOCK: Final = 64
"""Number of receivers that are computed at the same time."""
_WIDE: Final = OVERLAPPED_CHANNELS / SECONDARY_CHANNELS
# What an aircraft adds to the loads of those it reaches: log survivals, except the last one, a share of time.
(
    BLE4_BY_BLE4, POINTER_BY_BLE4, BLE4_BY_BLE5, POINTER_BY_BLE5, AUXILIARY_BY_BLE5, WIFI_BY_BLE5,
    WIFI_BY_WIFI, AUXILIARY_BY_WIFI, LOAD, PARTS_OF_LOAD,
) = range(10)  # fmt: skip
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
        with np.errstate(divide="ignore"):  # with a full channel nothing is received
            self._quiet = np.log([quiet.ble4[0], quiet.pointer[0], quiet.auxiliary[0]])
            quiet_wifi = float(np.log(quiet.wifi[0]))
        p, wifi = parameters.propagation, parameters.wifi
        budget = wifi.transmit_power_dbm - wifi.sensitivity_dbm - p.loss_at_1m_db
        self.around = Around(
            np.zeros((slots, PARTS_OF_LOAD)), np.zeros((slots, PARTS_OF_LOAD)), np.zeros(slots),
            np.zeros((slots, 3)), quiet_wifi,
            1.0 if parameters.wifi.access == "carrier_sense" else 0.0,
            float(10.0 ** (2.0 * budget / (10.0 * p.exponent))),
        )  # fmt: skip
        self._places, self._near = np.zeros((SAMPLE, 3)), np.zeros((SAMPLE, 2))
        self._who = np.zeros(SAMPLE, np.int64)
        self._common, self._names = np.zeros((5, BLOCK)), np.zeros(BLOCK, np.int64)

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
        _sum(state.links, air.flight, around)
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
            self._near, self._who, self._common, self._names,
        )  # fmt: skip


def _check(parameters: ChannelParameters, message_s: float) -> None:
    if parameters.propagation.shadowing_sigma_db > 0.0 or parameters.wifi_channels != "shared":
        raise ConfigError(
            "the city's channel has no shadowing and one Wi-Fi channel: propagation.shadowing_sigma_db must "
            'be 0, and wifi_channels "shared"'
        )
    if abs(parameters.gnss_period_ms / 1000.0 - message_s) > 1e-9:
        raise ConfigError(f"gnss_period_ms must be {1000.0 * message_s:g}, the time between two messages")


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


@_compiled
def _sum(links: Links, flight: Integers, around: Around) -> None:
    """Sum up the contributions of all senders that reach each aircraft."""
    for i in range(len(flight)):
        b0 = b1 = c0 = c1 = c2 = c3 = w0 = w1 = w2 = 0.0
        for e in range(links.start[i], links.start[i + 1]):
            add, modes = around.adds[links.other[e]], links.modes[e]
            # No branches, which the processor could not predict. What is not sent adds 0.
            on4, on5, on_wifi = modes & 1 != 0, modes & 2 != 0, modes & 4 != 0
            a0, a1, a2, a3, a4 = add[0], add[1], add[2], add[3], add[4]
            a5, a6, a7, a8 = add[5], add[6], add[7], add[8]
            b0 += a0 if on4 else 0.0
            b1 += a1 if on4 else 0.0
            c0 += a2 if on5 else 0.0
            c1 += a3 if on5 else 0.0
            c2 += a4 if on5 else 0.0
            c3 += a5 if on5 else 0.0
            w0 += a6 if on_wifi else 0.0
            w1 += a7 if on_wifi else 0.0
            w2 += a8 if on_wifi else 0.0
        total = around.total[i]
        total[BLE4_BY_BLE4], total[POINTER_BY_BLE4] = b0, b1
        total[BLE4_BY_BLE5], total[POINTER_BY_BLE5], total[AUXILIARY_BY_BLE5], total[WIFI_BY_BLE5] = (
            c0,
            c1,
            c2,
            c3,
        )
        total[WIFI_BY_WIFI], total[AUXILIARY_BY_WIFI], total[LOAD] = w0, w1, w2


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
    j: int, first: int, after: int, size: int, position: Floats, links: Links, reach2: float, places: Floats,
    near: Floats, who: Integers, common: Floats, names: Integers,
) -> None:  # fmt: skip
    """Sums over the stations of a sample that also reach each of the receivers of aircraft j's links from
    `first` to `after`.

    Args:
        common: shape (5, BLOCK): receives the sum of `near`'s columns in its first two rows.
        names: shape (BLOCK,): working space.
    """
    number = after - first
    blind, load, north, east, down = common[0], common[1], common[2], common[3], common[4]
    for r in range(number):
        i = links.other[first + r]
        names[r], north[r], east[r], down[r] = i, position[i, 0], position[i, 1], position[i, 2]
        blind[r] = load[r] = 0.0
    # The inner loop has no branches, so that the compiler computes several receivers at once. The sums of
    # each of them are in the order of the stations.
    for s in range(size):
        pn, pe, pd, a, b, name = places[s, 0], places[s, 1], places[s, 2], near[s, 0], near[s, 1], who[s]
        for r in range(number):
            n, e, d = pn - north[r], pe - east[r], pd - down[r]
            reaches = (n * n + e * e + d * d <= reach2) & (name != names[r])
            blind[r] += a if reaches else 0.0
            load[r] += b if reaches else 0.0


@_compiled
def _survive(
    turn: Integers, starts: Floats, rates: Integers, position: Floats, air: Air, links: Links,
    around: Around, chances: Chances, places: Floats, near: Floats, who: Integers, common: Floats,
    names: Integers,
) -> None:  # fmt: skip
    """Compute the reception probabilities of all links whose senders are in `turn`."""
    for t in range(len(turn)):
        j = turn[t]
        size, sends = 0, 0
        for m in range(rates.shape[1]):
            sends |= (1 << m) if rates[j, m] > 0 else 0
        if sends & 4 and around.listens != 0.0:
            size = _sensed(j, starts[t], rates, position, links, around, places, near, who)
        share = around.total[j, LOAD] / HIGHEST_LOAD * (chances.wifi.shape[1] - 1)
        end = links.start[j + 1]
        for first in range(links.start[j], end, BLOCK):
            after = min(first + BLOCK, end)
            if sends & 4 and around.listens != 0.0:
                _common(
                    j, first, after, size, position, links, around.reach2, places, near, who, common, names
                )  # fmt: skip
            for e in range(first, after):
                i, on = links.other[e], links.modes[e] & sends
                total, own, hearing, chance = (
                    around.total[i],
                    around.adds[j],
                    around.hearing[i],
                    links.chance[e],
                )
                chance[0] = chance[1] = chance[2] = 0.0
                if on & 1:
                    log = _of_ble4(total, own, on) + hearing[0]
                    chance[0] = -math.exp(on_line(chances.ble4[rates[j, 0]], log))
                if on & 2:
                    pointer, auxiliary = _of_ble5(total, own, on, around.listens)
                    chance[1] = -math.exp(
                        on_grid(chances.ble5[rates[j, 1]], pointer + hearing[1], auxiliary + hearing[2])
                    )
                if on & 4:
                    wifi = total[WIFI_BY_WIFI] - own[WIFI_BY_WIFI]
                    if around.listens != 0.0:
                        blind, load = common[0, e - first], common[1, e - first]
                        wifi = min(wifi - blind, 0.0) - load * around.crowding[j]
                    wifi += total[WIFI_BY_BLE5] - (own[WIFI_BY_BLE5] if on & 2 else 0.0)
                    wifi = min(wifi, 0.0) + around.wifi_quiet
                    chance[2] = -math.exp(on_loads(chances.wifi[rates[j, 2]], wifi, share))


@_compiled
def _of_ble4(total: Floats, own: Floats, on: int) -> float:
    """Log survival of a BLE 4 PDU under the transmissions of all others than its sender.

    Args:
        total: `Around.total` of the receiver.
        own: `Around.adds` of the sender.
        on: transports on which the sender reaches the receiver, one bit each.
    """
    on5 = float((on >> 1) & 1)
    log = total[BLE4_BY_BLE4] - own[BLE4_BY_BLE4] + total[BLE4_BY_BLE5] - on5 * own[BLE4_BY_BLE5]
    return min(float(log), 0.0)


@_compiled
def _of_ble5(total: Floats, own: Floats, on: int, listens: float) -> tuple[float, float]:
    """Log survival of a pointer and its auxiliary packet; see `_of_ble4`."""
    on4, on_wifi = float(on & 1), float((on >> 2) & 1)
    pointer = (
        total[POINTER_BY_BLE5] - own[POINTER_BY_BLE5] + total[POINTER_BY_BLE4] - on4 * own[POINTER_BY_BLE4]
    )
    auxiliary = total[AUXILIARY_BY_BLE5] - own[AUXILIARY_BY_BLE5]
    beacons = min(total[AUXILIARY_BY_WIFI] - on_wifi * own[AUXILIARY_BY_WIFI], 0.0)
    if listens != 0.0:
        auxiliary += math.log1p(-_WIDE * (1.0 - math.exp(beacons)))
    else:
        auxiliary += beacons
    return min(pointer, 0.0), min(auxiliary, 0.0)
