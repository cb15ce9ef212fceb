"""The set network: two shared layers for every neighbour, pooling over neighbours, and two more layers.

It takes any number of neighbours in any order. `companion.atmc.policy` computes the same aboard in NumPy.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

NEIGHBOUR_WIDTH = 64
WIDTH = 128


class SetNet(nn.Module):
    """Gives the Q value (s) of every action.

    Args:
        neighbour_columns: Columns of each neighbour's row.
        own_columns: Columns of the own row.
        actions: Number of actions.
    """

    def __init__(self, neighbour_columns: int, own_columns: int, actions: int) -> None:
        super().__init__()
        self.phi0 = nn.Linear(neighbour_columns, NEIGHBOUR_WIDTH)
        self.phi1 = nn.Linear(NEIGHBOUR_WIDTH, NEIGHBOUR_WIDTH)
        self.rho0 = nn.Linear(2 * NEIGHBOUR_WIDTH + own_columns, WIDTH)
        self.rho1 = nn.Linear(WIDTH, WIDTH)
        self.out = nn.Linear(WIDTH, actions)

    def forward(self, own: Tensor, rows: Tensor, heard: Tensor) -> Tensor:
        """Compute the Q values.

        Args:
            own: Own rows, (..., own columns).
            rows: Neighbour rows, (..., neighbours, neighbour columns).
            heard: Which neighbour rows are valid, (..., neighbours).

        Returns:
            Q values (s), (..., actions).
        """
        each = torch.relu(self.phi1(torch.relu(self.phi0(rows)))) * heard[..., None]
        pooled = torch.cat([torch.log1p(each.sum(-2)), each.amax(-2), own], -1)
        result: Tensor = self.out(torch.relu(self.rho1(torch.relu(self.rho0(pooled)))))
        return result
