"""The replay buffer: observations, actions, rewards and next observations of all aircraft of a fleet.

When the buffer is full, a new step replaces the oldest one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True)
class Batch:
    """A batch of experiences for each network."""

    seen: Tensor
    """Observations, (networks, batch, inputs)."""
    action: Tensor
    """Actions taken, (networks, batch)."""
    reward: Tensor
    """Rewards received, (networks, batch)."""
    then: Tensor
    """Next observations, (networks, batch, inputs)."""


class Replay:
    """A ring buffer of `steps` steps of `aircraft` aircraft."""

    def __init__(self, steps: int, aircraft: int, inputs: int, device: torch.device) -> None:
        self._steps, self._aircraft = steps, aircraft
        self.seen = torch.zeros(steps, aircraft, inputs, device=device)
        self.then = torch.zeros(steps, aircraft, inputs, device=device)
        self.action = torch.zeros(steps, aircraft, dtype=torch.long, device=device)
        self.reward = torch.zeros(steps, aircraft, device=device)
        self.added = 0
        """Number of steps added so far, including those that were replaced."""

    @property
    def full(self) -> bool:
        """Whether the buffer holds as many steps as it can."""
        return self.added >= self._steps

    def add(self, seen: Tensor, action: Tensor, reward: Tensor, then: Tensor) -> None:
        """Add one step of all aircraft: (N, inputs), (N,), (N,), (N, inputs)."""
        at = self.added % self._steps
        self.seen[at], self.action[at], self.reward[at], self.then[at] = seen, action, reward, then
        self.added += 1

    def sample(self, batch: int, networks: int, generator: torch.Generator) -> Batch:
        """Draw experiences with replacement.

        With one network per aircraft, each network gets experiences of its aircraft. A single network gets
        experiences of all aircraft.
        """
        device = generator.device
        step = torch.randint(
            min(self.added, self._steps), (networks, batch), generator=generator, device=device
        )
        if networks == 1:
            who = torch.randint(self._aircraft, (1, batch), generator=generator, device=device)
        else:
            who = torch.arange(networks, device=device)[:, None]
        return Batch(
            self.seen[step, who], self.action[step, who], self.reward[step, who], self.then[step, who]
        )

    def sample_steps(self, batch: int, generator: torch.Generator) -> Batch:
        """Draw whole steps with replacement, the same ones for all aircraft: (aircraft, batch, ...)."""
        step = torch.randint(
            min(self.added, self._steps), (1, batch), generator=generator, device=generator.device
        )
        who = torch.arange(self._aircraft, device=generator.device)[:, None]
        return Batch(
            self.seen[step, who], self.action[step, who], self.reward[step, who], self.then[step, who]
        )

    def state(self) -> dict[str, Any]:
        """The complete state, for a checkpoint."""
        held = min(self.added, self._steps)
        names = ("seen", "then", "action", "reward")
        return {"added": self.added, **{name: getattr(self, name)[:held].clone() for name in names}}

    def load(self, state: dict[str, Any]) -> None:
        """Restore a state that `state` returned."""
        self.added = state["added"]
        for name in ("seen", "then", "action", "reward"):
            getattr(self, name)[: len(state[name])] = state[name]
