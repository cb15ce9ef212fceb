"""The analytic channel model on PyTorch, for many fleets at once, with difference costs for training.

It implements the same equations as `sitl_mocks.channel.equations.analytic`; a test checks that both agree.
Training needs two differences. First, every environment is dense: all aircraft against all. Second, one
forward and one backward pass give the *difference cost*: what the fleet's total cost would become for each
action of each aircraft. The aircraft's own delay in it is exact; the delay of the others is a first-order
approximation.

Transmissions of other aircraft act on a link through a few sums over these aircraft (`Loads`). Each sum is
linear in what one aircraft adds, so the backward pass uses the transposed sums.

Mean delays are tabulated as log delay over log survival and, if Wi-Fi stations use carrier sense, also over
the load around the sender. This function is smooth, and it is linear where the survival is low.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from companion.arrays import Floats
from companion.atmc.actions import Action
from sitl_mocks.channel.equations import carrier_sense
from sitl_mocks.channel.equations.collision import background_survival, shares_of
from sitl_mocks.channel.equations.delay import link_delay_s
from sitl_mocks.channel.equations.half_duplex import deaf_shares_of
from sitl_mocks.channel.link_budget import thresholds_db
from sitl_mocks.channel.parameters import (
    MODES,
    OVERLAPPED_CHANNELS,
    SECONDARY_CHANNELS,
    WIFI_CHANNELS,
    ChannelParameters,
)

_BLE4, _BLE5, _WIFI = range(len(MODES))
_LOWEST = -8.0
"""Lowest log survival in the tables; below it, log delay is extrapolated linearly."""
_NODES = {_BLE4: 401, _BLE5: 121, _WIFI: 401}
_HIGHEST_LOAD, _LOAD_NODES = 2.5, 101
"""Highest load in the Wi-Fi tables, and number of load nodes. Higher loads are clamped to the highest one."""

Loads = dict[str, Tensor]
"""Sums over the packets of the other aircraft, by name, each of shape (environments, receiver, sender). All
are log survivals except "common" and "sensed", which are shares of time."""


@dataclass(frozen=True, slots=True)
class Reach:
    """Which aircraft can receive which, for `environments` fleets of `aircraft` aircraft each.

    Matrices have shape (environments, receiver, sender) and hold 1.0 or 0.0, with zeros on the diagonal.
    """

    modes: tuple[Tensor, Tensor, Tensor]
    same_channel: Tensor
    """1 where both aircraft send their beacons on the same Wi-Fi channel; the diagonal is 1."""
    on_channel: Tensor
    """(environments, aircraft, Wi-Fi channels), 1 for the aircraft's own channel."""
    quiet: dict[str, Tensor]
    """Log survival against foreign transmissions in the band, by packet, (environments, receiver, 1)."""


@dataclass(frozen=True, slots=True)
class Packets:
    """Log survival of each packet on each link, (environments, receiver, sender).

    `sensed` is the Wi-Fi load (share of time) around each sender, (environments, 1, sender).
    """

    ble4: Tensor
    pointer: Tensor
    auxiliary: Tensor
    wifi: Tensor
    sensed: Tensor

    def of(self, senders: Tensor) -> Packets:
        """The packets of the senders with these indices."""
        parts = (self.ble4, self.pointer, self.auxiliary, self.wifi, self.sensed)
        return Packets(*(part[:, :, senders] for part in parts))


@dataclass(frozen=True, slots=True)
class _Part:
    """The contribution of senders on one mode to one of the `Loads`."""

    load: str
    mode: int
    factors: Tensor
    """Contribution of one sender, indexed by rate level."""
    spread: str
    """Which aircraft are summed over. "own": the receiver itself. "all": all that reach the receiver. "0",
    "1" or "2": those of them on this Wi-Fi channel (by index). "shared": those of them on the link sender's
    Wi-Fi channel. "hidden": those of "shared" that the link's sender does not sense. "common": those of
    "shared" that it does sense. "sensed": all that the link's sender senses."""


class TorchChannel:
    """The channel equations for one table of actions.

    Args:
        parameters: Channel parameters.
        actions: What an aircraft may send.
        device: Device of all tensors.
    """

    def __init__(
        self, parameters: ChannelParameters, actions: Sequence[Action], device: torch.device | str = "cpu"
    ) -> None:
        self.parameters = parameters
        self.device = torch.device(device)
        self.actions = tuple(actions)
        self.rates = torch.tensor(actions, dtype=torch.float32, device=self.device)
        """Messages per second on each transport, (actions, 3)."""
        levels = [sorted({a[mode] for a in actions} | {0}) for mode in range(3)]
        self.level_of = torch.tensor(
            [[levels[mode].index(a[mode]) for mode in range(3)] for a in actions], device=self.device
        )
        """Index into the sorted rates of each mode, (actions, 3). Level 0 is rate 0."""
        self._listens = parameters.wifi.access == "carrier_sense"
        self._tables = [self._table(mode, levels[mode][1:]) for mode in range(3)]
        self.thresholds_db = torch.tensor(thresholds_db(parameters), dtype=torch.float32, device=self.device)
        self._parts = self._make_parts(levels)

    def _make_parts(self, levels: Sequence[Sequence[int]]) -> list[_Part]:
        parameters, period_ms = self.parameters, self.parameters.gnss_period_ms
        s = shares_of(parameters)

        def lost(load: str, mode: int, share: float, spread: str = "all") -> _Part:
            idle = np.maximum(1.0 - share * np.array(levels[mode], float), 1e-12)
            factors = torch.tensor(np.log(idle), dtype=torch.float32, device=self.device)
            return _Part(load, mode, factors, spread)

        parts = [
            lost("ble4", _BLE4, s.ble4_by_ble4),
            lost("ble4", _BLE5, s.ble4_by_ble5),
            lost("pointer", _BLE5, s.pointer_by_ble5),
            lost("pointer", _BLE4, s.pointer_by_ble4),
            lost("auxiliary", _BLE5, s.auxiliary_by_ble5),
            lost("wifi", _BLE5, s.wifi_by_ble5),
        ]
        if parameters.bluetooth_half_duplex:
            deaf = deaf_shares_of(parameters)
            for mode in (_BLE4, _BLE5):
                pointer = lost("pointer", mode, deaf.pointer[mode], "own")
                both = lost("auxiliary", mode, deaf.both[mode], "own")
                parts += [
                    lost("ble4", mode, deaf.ble4[mode], "own"),
                    pointer,
                    _Part("auxiliary", mode, both.factors - pointer.factors, "own"),
                ]
        if not self._listens:
            return [
                *parts,
                lost("auxiliary", _WIFI, s.auxiliary_by_wifi),
                lost("wifi", _WIFI, s.wifi_by_wifi, "shared"),
            ]
        together = (parameters.ble5.auxiliary_ms + parameters.wifi.beacon_ms) / period_ms
        share = carrier_sense.load_of(np.array(levels[_WIFI], float), parameters)
        filled = torch.tensor(share, dtype=torch.float32, device=self.device)
        return [
            *parts,
            *(lost(f"auxiliary_{c}", _WIFI, together, str(c)) for c in range(len(WIFI_CHANNELS))),
            lost("wifi", _WIFI, s.wifi_by_wifi, "hidden"),
            _Part("common", _WIFI, filled, "common"),
            _Part("sensed", _WIFI, filled, "sensed"),
        ]

    # ------------------------------------------------------------ tables

    def _table(self, mode: int, rates: Sequence[int]) -> Tensor:
        """Log mean delay (s) of each rate at the grid nodes of the mode's table, (nodes, rates)."""
        first, second = np.linspace(_LOWEST, 0.0, _NODES[mode]), self._second_axis(mode)
        if second is not None:
            first, second = (grid.ravel() for grid in np.meshgrid(first, second, indexing="ij"))
        columns = []
        for rate in rates:
            alive = np.exp(first)
            if mode == _WIFI and second is not None:
                delay = carrier_sense.delay_s(rate, alive, second, self.parameters)
            else:
                other = np.ones(len(first)) if second is None else np.exp(second)
                delay = link_delay_s(MODES[mode], rate, self.parameters, alive, other)
            columns.append(np.log(delay))
        table = np.stack(columns, 1) if columns else np.zeros((len(first), 0))
        return torch.tensor(table, dtype=torch.float32, device=self.device)

    def _second_axis(self, mode: int) -> Floats | None:
        """Grid of the second table variable; None if delay depends on the first packet's survival only.

        It is the log survival of the auxiliary packet for BLE 5, and the load around the sender for Wi-Fi.
        """
        if mode == _BLE5:
            return np.linspace(_LOWEST, 0.0, _NODES[mode])
        if mode == _WIFI and self._listens:
            return np.linspace(0.0, _HIGHEST_LOAD, _LOAD_NODES)
        return None

    def _places(self, mode: int, packets: Packets) -> tuple[tuple[Tensor, Tensor], ...]:
        """For each axis of a mode's table: the node below, and the fraction of the way to the next node.

        The fraction is negative below the grid.
        """
        log_survival = (packets.ble4, packets.pointer, packets.wifi)[mode]
        axes = [((log_survival - _LOWEST) * ((_NODES[mode] - 1) / -_LOWEST), _NODES[mode])]
        if mode == _BLE5:
            axes.append(((packets.auxiliary - _LOWEST) * ((_NODES[mode] - 1) / -_LOWEST), _NODES[mode]))
        elif mode == _WIFI and self._listens:
            load = packets.sensed.expand_as(log_survival).clamp(max=_HIGHEST_LOAD)
            axes.append((load * ((_LOAD_NODES - 1) / _HIGHEST_LOAD), _LOAD_NODES))
        nodes = [at.detach().floor().clamp(0, count - 2).long() for at, count in axes]
        return tuple((node, at - node) for node, (at, _) in zip(nodes, axes, strict=True))

    def _stride(self, mode: int) -> int:
        """Number of table rows between two adjacent nodes of the first axis."""
        return _NODES[_BLE5] if mode == _BLE5 else _LOAD_NODES if mode == _WIFI and self._listens else 1

    def log_delay(self, mode: int, packets: Packets) -> Tensor:
        """Log mean delay (s) at every rate of a mode, (environments, receiver, sender, rates)."""
        table, stride = self._tables[mode], self._stride(mode)
        (node, part), *more = self._places(mode, packets)
        part = part[..., None]
        if not more:
            return torch.lerp(table[node], table[node + 1], part)
        ((other, share),) = more
        low, share = node * stride + other, share[..., None]
        return torch.lerp(
            torch.lerp(table[low], table[low + 1], share),
            torch.lerp(table[low + stride], table[low + stride + 1], share),
            part,
        )

    def log_delay_at(self, mode: int, level: Tensor, packets: Packets) -> Tensor:
        """Log mean delay (s) at one rate for each link, (environments, receiver, sender).

        Levels start from 1; the result is meaningless where the level is 0.
        """
        table, stride = self._tables[mode], self._stride(mode)
        rates = table.shape[1]
        flat, column = table.reshape(-1), (level - 1).clamp(min=0)
        (node, part), *more = self._places(mode, packets)
        if not more:
            low = node * rates + column
            return torch.lerp(flat[low], flat[low + rates], part)
        ((other, share),) = more
        low = (node * stride + other) * rates + column
        high = low + stride * rates
        return torch.lerp(
            torch.lerp(flat[low], flat[low + rates], share),
            torch.lerp(flat[high], flat[high + rates], share),
            part,
        )

    def undisturbed_s(self) -> Tensor:
        """Mean delay (s) of each action on its fastest transport if no other aircraft sends, (actions,)."""
        found = torch.full_like(self.rates, torch.inf)
        for mode, table in enumerate(self._tables):
            level = self.level_of[:, mode]
            # All packets survive in the last row. With carrier sense, the last block starts with zero load.
            row = -_LOAD_NODES if mode == _WIFI and self._listens else -1
            found[level > 0, mode] = torch.exp(table[row, level[level > 0] - 1])
        return found.amin(1)

    # ------------------------------------------------------------ links and loads

    def reach(self, path_loss_db: Tensor, wifi_channel: Tensor, busy: Tensor | None = None) -> Reach:
        """Compute which aircraft can receive which.

        Args:
            path_loss_db: (environments, aircraft, aircraft), symmetric.
            wifi_channel: (environments, aircraft), index of the Wi-Fi channel.
            busy: (environments, aircraft, 3), share of time that foreign transmissions fill each mode's
                channel. None means no foreign transmissions.
        """
        environments, aircraft, _ = path_loss_db.shape
        others = 1.0 - torch.eye(aircraft, device=self.device)
        modes = tuple((path_loss_db <= self.thresholds_db[mode]) * others for mode in range(3))
        same = (wifi_channel[:, :, None] == wifi_channel[:, None, :]).to(torch.float32)
        on_channel = torch.nn.functional.one_hot(wifi_channel, len(WIFI_CHANNELS)).to(torch.float32)
        share = np.zeros((environments * aircraft, 3))
        if busy is not None:
            share = busy.reshape(-1, 3).cpu().double().numpy()
        alive = background_survival(self.parameters, share)
        quiet = {
            packet: torch.tensor(
                np.log(getattr(alive, packet)), dtype=torch.float32, device=self.device
            ).reshape(environments, aircraft)[:, :, None]
            for packet in ("ble4", "pointer", "auxiliary", "wifi")
        }
        return Reach((modes[0], modes[1], modes[2]), same, on_channel, quiet)

    def loads(self, reach: Reach, action: Tensor) -> Loads:
        """Sums over the packets of all aircraft other than the sender, for each link.

        They do not depend on what the link's sender itself sends.

        Args:
            action: (environments, aircraft), indices into the actions.
        """
        level = self.level_of[action]
        found: Loads = {}
        for part in self._parts:
            sent = part.factors[level[..., part.mode]]
            term = self._spread(part, reach, sent)
            found[part.load] = found[part.load] + term if part.load in found else term
        return found

    def _spread(self, part: _Part, reach: Reach, sent: Tensor) -> Tensor:
        """One part of a load on all links; `sent` is what each aircraft adds, (environments, aircraft)."""
        carried = reach.modes[part.mode]
        if part.spread == "own":
            return sent[:, :, None].expand_as(carried)
        if part.spread == "sensed":
            return (carried * reach.same_channel * sent[:, None, :]).sum(2)[:, None, :]
        arriving = carried * sent[:, None, :]
        if part.spread in ("shared", "hidden", "common"):
            return arriving @ self._mates(part, reach).transpose(1, 2)
        if part.spread != "all":
            arriving = arriving * reach.on_channel[:, None, :, int(part.spread)]
        return arriving.sum(2, keepdim=True) - arriving

    def _mates(self, part: _Part, reach: Reach) -> Tensor:
        """Which other aircraft's beacons count on the links of a sender, (environments, sender, other)."""
        sensed = reach.modes[_WIFI] * reach.same_channel
        if part.spread == "common":
            return sensed
        shared = reach.same_channel - torch.eye(sensed.shape[1], device=self.device)
        return shared if part.spread == "shared" else shared - sensed

    def packets(self, reach: Reach, loads: Loads) -> Packets:
        """Log survival of each packet under these loads."""
        quiet, auxiliary, wifi = reach.quiet, loads["auxiliary"], loads["wifi"]
        sensed = torch.zeros_like(wifi[:, :1])
        if self._listens:
            met = [1.0 - torch.exp(loads[f"auxiliary_{c}"]) for c in range(len(WIFI_CHANNELS))]
            hit = torch.stack(met).sum(0)
            auxiliary = auxiliary + torch.log1p(-OVERLAPPED_CHANNELS / SECONDARY_CHANNELS * hit)
            sensed = loads["sensed"]
            wifi = wifi - loads["common"] * _crowding(sensed)
        return Packets(
            loads["ble4"] + quiet["ble4"],
            loads["pointer"] + quiet["pointer"],
            auxiliary + quiet["auxiliary"],
            wifi + quiet["wifi"],
            sensed,
        )

    def harm(self, reach: Reach, gradients: Loads) -> Tensor:
        """First-order effect of each aircraft's action on the cost of the other aircraft.

        Args:
            gradients: Gradients of the total cost with respect to the loads.

        Returns:
            (environments, aircraft, actions), up to an additive constant per aircraft.
        """
        harm: Tensor | None = None
        for part in self._parts:
            felt = self._gather(part, reach, gradients[part.load])
            found = felt[..., None] * part.factors[self.level_of[:, part.mode]]
            harm = found if harm is None else harm + found
        assert harm is not None
        return harm

    def _gather(self, part: _Part, reach: Reach, gradient: Tensor) -> Tensor:
        """Transpose of `_spread`, (environments, aircraft)."""
        carried = reach.modes[part.mode]
        if part.spread == "own":
            return gradient.sum(2)
        if part.spread == "sensed":
            return (carried * reach.same_channel * gradient.transpose(1, 2)).sum(1)
        if part.spread in ("shared", "hidden", "common"):
            return ((gradient @ self._mates(part, reach)) * carried).sum(1)
        felt = ((gradient.sum(2, keepdim=True) - gradient) * carried).sum(1)
        return felt if part.spread == "all" else felt * reach.on_channel[..., int(part.spread)]


def _crowding(load: Tensor) -> Tensor:
    """`carrier_sense.crowding` on tensors."""
    c, a = carrier_sense.MEETING, carrier_sense.CROWDING
    free = 1.0 - load
    return 2.0 * c * load / (free + torch.sqrt(free * free + 4.0 * a * c * load * load))
