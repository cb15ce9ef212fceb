"""The analytic channel on PyTorch, for many environments at once, and what one aircraft's choice does to all.

The same equations as `sitl_mocks.channel.analytic` (a test holds both together), with two differences that
training needs. Every environment is dense, all aircraft against all. And it gives the *difference cost*: what
each aircraft's total would become for each of its actions, its own delay exactly, the delay of the others to
first order, from one forward and one backward pass.

Mean delays are polynomials in the survival of one packet. They are tabulated as log delay over log survival,
which is smooth, and linear where little survives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from companion.atmc.actions import Action
from sitl_mocks.channel.collision import background_survival, shares_of
from sitl_mocks.channel.delay import mean_delay_s, terms_of
from sitl_mocks.channel.link_budget import thresholds_db
from sitl_mocks.channel.parameters import MODES, ChannelParameters

_BLE4, _BLE5, _WIFI = range(len(MODES))
PRODUCTS = ("ble4", "pointer", "auxiliary", "wifi")
_LOWEST = -8.0
"""Log survival at which the tables end; log delay goes on linearly from there."""
_NODES = {_BLE4: 401, _BLE5: 121, _WIFI: 401}


@dataclass(frozen=True, slots=True)
class Reach:
    """Who hears whom, of `environments` fleets of `aircraft` each.

    Every tensor is of shape (environments, receiver, sender), floating, 1 or 0, with zeros on the diagonal.
    """

    modes: tuple[Tensor, Tensor, Tensor]
    same_channel: Tensor
    """1 where both send their beacons on one Wi-Fi channel."""
    quiet: tuple[Tensor, ...]
    """By product, (environments, receiver): log survival of a packet among what others send in the band."""


class TorchChannel:
    """The equations for one table of actions.

    Args:
        parameters: of the channel.
        actions: what an aircraft may send.
        device: where all tensors live.
    """

    def __init__(
        self, parameters: ChannelParameters, actions: Sequence[Action], device: torch.device | str = "cpu"
    ) -> None:
        self.parameters = parameters
        self.device = torch.device(device)
        self.actions = tuple(actions)
        self.rates = torch.tensor(actions, dtype=torch.float32, device=self.device)
        """Shape (actions, 3)."""
        levels = [sorted({a[mode] for a in actions} | {0}) for mode in range(3)]
        self.level_of = torch.tensor(
            [[levels[mode].index(a[mode]) for mode in range(3)] for a in actions], device=self.device
        )
        """Shape (actions, 3): index into the rates of each mode, of which the first is 0."""
        self._tables = [self._table(mode, levels[mode][1:]) for mode in range(3)]
        self.thresholds_db = torch.tensor(
            thresholds_db(parameters), dtype=torch.float32, device=self.device
        )
        s = shares_of(parameters)
        self._carrier_sense = False
        pairs = {
            ("ble4", _BLE4): s.ble4_by_ble4,
            ("ble4", _BLE5): s.ble4_by_ble5,
            ("pointer", _BLE5): s.pointer_by_ble5,
            ("pointer", _BLE4): s.pointer_by_ble4,
            ("auxiliary", _BLE5): s.auxiliary_by_ble5,
            ("auxiliary", _WIFI): s.auxiliary_by_wifi,
            ("wifi", _WIFI): s.wifi_by_wifi,
            ("wifi", _BLE5): s.wifi_by_ble5,
        }
        self._shares = pairs
        # What each level of each mode takes from the log survival of each product.
        self._factors = {
            (product, mode): torch.tensor(
                np.log1p(-share * np.array(levels[mode], float)), dtype=torch.float32, device=self.device
            )
            for (product, mode), share in pairs.items()
        }

    # ------------------------------------------------------------ tables

    def _table(self, mode: int, rates: Sequence[int]) -> Tensor:
        """Log mean delay (s) of each rate over the grid of log survival: (nodes, rates), or for BLE 5, of
        pointer and auxiliary packet, (nodes * nodes, rates)."""
        nodes = np.linspace(_LOWEST, 0.0, _NODES[mode])
        first, second = np.exp(nodes), np.ones(len(nodes))
        if mode == _BLE5:
            first, second = (grid.ravel() for grid in np.meshgrid(np.exp(nodes), np.exp(nodes), indexing="ij"))
        columns = [
            np.log(mean_delay_s(terms_of(MODES[mode], rate, self.parameters), first, second)) for rate in rates
        ]
        table = np.stack(columns, 1) if columns else np.zeros((len(first), 0))
        return torch.tensor(table, dtype=torch.float32, device=self.device)

    def _place(self, mode: int, log_survival: Tensor) -> tuple[Tensor, Tensor]:
        """Node below and the share of the way to the next one, which is negative below the grid."""
        nodes = _NODES[mode]
        at = (log_survival - _LOWEST) * ((nodes - 1) / -_LOWEST)
        node = at.detach().floor().clamp(0, nodes - 2).long()
        return node, at - node

    def log_delay(self, mode: int, first: Tensor, second: Tensor | None = None) -> Tensor:
        """Log mean delay (s) of every rate of a mode, (..., rates).

        Args:
            first: log survival of one packet (BLE 5: a pointer), any shape.
            second: of the auxiliary packet; same shape.
        """
        table = self._tables[mode]
        node, part = self._place(mode, first)
        part = part[..., None]
        if mode != _BLE5:
            return torch.lerp(table[node], table[node + 1], part)
        assert second is not None
        nodes = _NODES[mode]
        other, share = self._place(mode, second)
        low, high, share = node * nodes + other, (node + 1) * nodes + other, share[..., None]
        return torch.lerp(
            torch.lerp(table[low], table[low + 1], share), torch.lerp(table[high], table[high + 1], share), part
        )

    def log_delay_at(self, mode: int, level: Tensor, first: Tensor, second: Tensor | None = None) -> Tensor:
        """Log mean delay (s) at one rate for each link, for levels from 1; anything where the level is 0."""
        table = self._tables[mode]
        rates = table.shape[1]
        flat, column = table.reshape(-1), (level - 1).clamp(min=0)
        node, part = self._place(mode, first)
        if mode != _BLE5:
            low = node * rates + column
            return torch.lerp(flat[low], flat[low + rates], part)
        assert second is not None
        nodes = _NODES[mode]
        other, share = self._place(mode, second)
        low = (node * nodes + other) * rates + column
        high = low + nodes * rates
        return torch.lerp(
            torch.lerp(flat[low], flat[low + rates], share),
            torch.lerp(flat[high], flat[high + rates], share),
            part,
        )

    # ------------------------------------------------------------ the air

    def reach(self, path_loss_db: Tensor, wifi_channel: Tensor, busy: Tensor | None = None) -> Reach:
        """Who hears whom.

        Args:
            path_loss_db: (environments, aircraft, aircraft), symmetric.
            wifi_channel: (environments, aircraft), any numbers that tell channels apart.
            busy: (environments, aircraft, 3), share of time that others fill each mode's channel; None: none.
        """
        environments, aircraft, _ = path_loss_db.shape
        others = 1.0 - torch.eye(aircraft, device=self.device)
        modes = tuple((path_loss_db <= self.thresholds_db[mode]) * others for mode in range(3))
        same = (wifi_channel[:, :, None] == wifi_channel[:, None, :]).to(torch.float32)
        if busy is None:
            quiet = (torch.zeros(environments, aircraft, device=self.device),) * len(PRODUCTS)
        else:
            alive = background_survival(self.parameters, busy.reshape(-1, 3).cpu().double().numpy())
            quiet = tuple(
                torch.tensor(np.log(getattr(alive, product)), dtype=torch.float32, device=self.device).reshape(
                    environments, aircraft
                )
                for product in PRODUCTS
            )
        return Reach((modes[0], modes[1], modes[2]), same, quiet)

    def log_survivals(self, reach: Reach, action: Tensor) -> tuple[Tensor, ...]:
        """By product, (environments, receiver, sender): log survival of a packet of the sender among the packets
        of all others, whatever the sender itself sends.

        Args:
            action: (environments, aircraft), indices into the actions.
        """
        level = self.level_of[action]
        total: dict[str, Tensor] = {}
        for (product, mode), factors in self._factors.items():
            load = factors[level[..., mode]][:, None, :] * reach.modes[mode]
            if (product, mode) == ("wifi", _WIFI):
                # (receiver, sender): the sum over those on the sender's channel, itself included.
                found = load @ reach.same_channel - load
            else:
                found = load.sum(2, keepdim=True) - load
            total[product] = total[product] + found if product in total else found
        return tuple(
            total[product] + quiet[:, :, None]
            for product, quiet in zip(PRODUCTS, reach.quiet, strict=True)
        )

    def harm(self, reach: Reach, gradients: Sequence[Tensor]) -> Tensor:
        """What each aircraft's action adds to the cost of the others, to first order.

        Args:
            gradients: of the total cost with respect to what `log_survivals` gave.

        Returns:
            (environments, aircraft, actions), up to a number for each aircraft.
        """
        by_product = dict(zip(PRODUCTS, gradients, strict=True))
        harm: Tensor | None = None
        for (product, mode), factors in self._factors.items():
            gradient, carried = by_product[product], reach.modes[mode]
            if (product, mode) == ("wifi", _WIFI):
                felt = ((gradient @ reach.same_channel - gradient) * carried).sum(1)
            else:
                felt = ((gradient.sum(2, keepdim=True) - gradient) * carried).sum(1)
            part = felt[..., None] * factors[self.level_of[:, mode]]
            harm = part if harm is None else harm + part
        assert harm is not None
        return harm
