"""The set network: the same two layers for every neighbour, pooled, and two layers on top.

Any number of neighbours in any order. `companion.atmc.policy` computes the same aboard in NumPy.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

NEIGHBOUR_WIDTH = 64
WIDTH = 128


class SetNet(nn.Module):
    """Q values (s) of every action.

    Args:
        neighbour_columns: of each neighbour's row.
        own_columns: of the own row.
        actions: number of actions.
    """

    def __init__(self, neighbour_columns: int, own_columns: int, actions: int) -> None:
        super().__init__()
        self.phi0 = nn.Linear(neighbour_columns, NEIGHBOUR_WIDTH)
        self.phi1 = nn.Linear(NEIGHBOUR_WIDTH, NEIGHBOUR_WIDTH)
        self.rho0 = nn.Linear(2 * NEIGHBOUR_WIDTH + own_columns, WIDTH)
        self.rho1 = nn.Linear(WIDTH, WIDTH)
        self.out = nn.Linear(WIDTH, actions)

    def forward(self, own: Tensor, rows: Tensor, heard: Tensor) -> Tensor:
        """Q values.

        Args:
            own: (..., own columns).
            rows: (..., neighbours, neighbour columns).
            heard: (..., neighbours), which rows are there.

        Returns:
            (..., actions).
        """
        each = torch.relu(self.phi1(torch.relu(self.phi0(rows)))) * heard[..., None]
        pooled = torch.cat([torch.log1p(each.sum(-2)), each.amax(-2), own], -1)
        result: Tensor = self.out(torch.relu(self.rho1(torch.relu(self.rho0(pooled)))))
        return result
