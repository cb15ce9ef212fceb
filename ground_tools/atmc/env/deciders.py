"""The `Decider` protocol, which chooses the actions of whole fleets, and the baselines."""

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
    """Chooses the actions of all aircraft."""

    def decide(self, seen: Observation, action: Tensor) -> Tensor:
        """Choose the next action of each aircraft. Returns indices into the actions, (E, N).

        Args:
            seen: Observations of all aircraft.
            action: Current actions, (E, N).
        """
        ...


class Fixed:
    """Always chooses the same action."""

    def __init__(self, action: int) -> None:
        self.action = action

    def decide(self, seen: Observation, action: Tensor) -> Tensor:
        """See `Decider.decide`."""
        return torch.full_like(action, self.action)


class Chance:
    """Draws a random allowed action at every decision."""

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
    """Chooses `near` if any aircraft is heard within `within_m`, else `far`."""

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
    """Let every aircraft decide once per round. Random parts of the fleet decide one after the other.

    Returns:
        Costs (s) after each part, each (E, N); there are `rounds` times `parts` of them.
    """
    found = []
    for _ in range(rounds):
        order = torch.rand(env.action.shape, generator=generator, device=env.action.device).argsort(1)
        found += [
            env.act(decider.decide(env.observe(), env.action), order % parts == part) for part in range(parts)
        ]
    return found
