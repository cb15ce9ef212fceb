"""Reference for every policy: a centralised search over the actions of all aircraft, with full knowledge.

It runs best response from several starting points. With all difference costs known, a random part of the
aircraft that would gain switch to their best action. If this does not lower the fleet's total cost, it is
undone and a smaller part is tried. The result is the best known solution, not a proven lower bound.
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
    """Search for the actions with the least total cost. Returns the best found, (environments, aircraft).

    Args:
        objective: The cost function.
        air: The fleets.
        starts: Actions to start from, each (environments, aircraft).
        allowed: (actions,), which actions may be chosen.
        generator: Source of random numbers.
        rounds: Maximum number of rounds for each start; each computes the difference costs once.
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
    """Improve one start. Returns the actions and the total cost of each fleet."""
    cost = costs(objective, air, action).sum(1)
    share = torch.full_like(cost, 0.5)
    for _ in range(rounds):
        _, difference = difference_costs(objective, air, action)
        difference = difference.masked_fill(~allowed, torch.inf)
        least, choice = difference.min(-1)
        gain = difference.gather(-1, action[..., None])[..., 0] - least
        luck = torch.rand(gain.shape, generator=generator, device=gain.device)
        # However small the share, one aircraft may always move: usually one with a large gain.
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
