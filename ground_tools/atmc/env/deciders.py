"""Everything that chooses for whole fleets at once: the baselines, and frozen policies on PyTorch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import torch
from torch import Tensor

from companion.atmc.actions import Action
from companion.atmc.observation import NEIGHBOUR_COLUMNS
from ground_tools.atmc.env.environment import Env, Observation

_LOG_DISTANCE = NEIGHBOUR_COLUMNS.index("log_distance")


class Decider(Protocol):
    """Chooses for all aircraft."""

    def decide(self, seen: Observation, action: Tensor) -> Tensor:
        """What each would send next; (E, N) indices into the actions.

        Args:
            action: (E, N), what they send now.
        """
        ...


class Fixed:
    """Always the same."""

    def __init__(self, action: int) -> None:
        self.action = action

    def decide(self, seen: Observation, action: Tensor) -> Tensor:
        """See `Decider.decide`."""
        return torch.full_like(action, self.action)


class Chance:
    """Anything that is allowed, drawn anew at every decision."""

    def __init__(self, allowed: Tensor, generator: torch.Generator) -> None:
        self._indices = allowed.nonzero()[:, 0]
        self._generator = generator

    def decide(self, seen: Observation, action: Tensor) -> Tensor:
        """See `Decider.decide`."""
        drawn = torch.randint(
            len(self._indices), action.shape, generator=self._generator, device=action.device
        )
        return self._indices[drawn]


class Rule:
    """One action when anybody is heard within a distance, another one else."""

    def __init__(self, actions: Sequence[Action], near: Action, far: Action, within_m: float) -> None:
        self._near, self._far = actions.index(near), actions.index(far)
        self._within = float(torch.log10(torch.tensor(within_m))) / 4.0

    def decide(self, seen: Observation, action: Tensor) -> Tensor:
        """See `Decider.decide`."""
        near = ((seen.rows[..., _LOG_DISTANCE] <= self._within) & (seen.heard > 0)).any(-1)
        return torch.where(near, self._near, self._far)


def settle(
    env: Env, decider: Decider, rounds: int, generator: torch.Generator, *, parts: int = 4
) -> list[Tensor]:
    """Let everybody decide once a round, in random parts one after the other.

    Returns:
        Costs (s) after each part, each (E, N); `rounds` times `parts` of them.
    """
    found = []
    for _ in range(rounds):
        order = torch.rand(env.action.shape, generator=generator, device=env.action.device).argsort(1)
        found += [
            env.act(decider.decide(env.observe(), env.action), order % parts == part) for part in range(parts)
        ]
    return found
