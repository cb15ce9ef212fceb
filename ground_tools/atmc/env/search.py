"""The floor that every policy is measured against: a search over everybody's actions that knows everything.

Best response from several starts: where all difference costs are known, a random part of the aircraft that
would gain goes to its best action; what does not lower the fleet's total is taken back, and a smaller part
tried. It is no bound, only the best that is known.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ground_tools.atmc.env.objective import Air, Objective, costs, difference_costs

ROUNDS = 40
_GAIN_S = 1e-7


def search(
    objective: Objective,
    air: Air,
    starts: Sequence[Tensor],
    allowed: Tensor,
    generator: torch.Generator,
    rounds: int = ROUNDS,
) -> Tensor:
    """The best actions that were found, (environments, aircraft).

    Args:
        starts: actions to begin with, each (environments, aircraft).
        allowed: (actions,), which of them may be taken.
        rounds: difference costs computed for each start.
    """
    best, least = starts[0], costs(objective, air, starts[0]).sum(1)
    for start in starts:
        found, cost = _improve(objective, air, start, allowed, generator, rounds)
        better = cost < least
        best, least = torch.where(better[:, None], found, best), torch.where(better, cost, least)
    return best


def _improve(
    objective: Objective,
    air: Air,
    action: Tensor,
    allowed: Tensor,
    generator: torch.Generator,
    rounds: int,
) -> tuple[Tensor, Tensor]:
    """Actions and total cost after so many rounds from one start."""
    cost = costs(objective, air, action).sum(1)
    share = torch.full_like(cost, 0.5)
    for _ in range(rounds):
        _, difference = difference_costs(objective, air, action)
        difference = difference.masked_fill(~allowed, torch.inf)
        least, choice = difference.min(-1)
        gain = difference.gather(-1, action[..., None])[..., 0] - least
        luck = torch.rand(gain.shape, generator=generator, device=gain.device)
        # Whatever the share, the one with the most to gain, or now and then another one, tries.
        first = torch.nn.functional.one_hot((gain * luck).argmax(1), gain.shape[1]).bool()
        moves = (gain > _GAIN_S) & ((luck < share[:, None]) | first)
        trial = torch.where(moves, choice, action)
        new = costs(objective, air, trial).sum(1)
        better = new < cost
        action = torch.where(better[:, None], trial, action)
        cost = torch.where(better, new, cost)
        share = torch.where(better, (share * 1.5).clamp(max=0.7), share * 0.5)
        if not moves.any():
            break
    return action, cost
