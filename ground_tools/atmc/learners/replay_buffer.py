"""The replay buffer: what all aircraft of a fleet saw, did, got and saw next. The oldest step goes first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True)
class Batch:
    """Experiences, for each network its own."""

    seen: Tensor
    """(networks, batch, inputs)."""
    action: Tensor
    """(networks, batch)."""
    reward: Tensor
    """(networks, batch)."""
    then: Tensor
    """(networks, batch, inputs)."""


class Replay:
    """Holds `steps` steps of `aircraft` aircraft."""

    def __init__(self, steps: int, aircraft: int, inputs: int, device: torch.device) -> None:
        self._steps, self._aircraft = steps, aircraft
        self.seen = torch.zeros(steps, aircraft, inputs, device=device)
        self.then = torch.zeros(steps, aircraft, inputs, device=device)
        self.action = torch.zeros(steps, aircraft, dtype=torch.long, device=device)
        self.reward = torch.zeros(steps, aircraft, device=device)
        self.added = 0
        """Steps, also those replaced since."""

    @property
    def full(self) -> bool:
        """Whether it holds as many steps as it can."""
        return self.added >= self._steps

    def add(self, seen: Tensor, action: Tensor, reward: Tensor, then: Tensor) -> None:
        """One step of all aircraft: (N, inputs), (N,), (N,), (N, inputs)."""
        at = self.added % self._steps
        self.seen[at], self.action[at], self.reward[at], self.then[at] = seen, action, reward, then
        self.added += 1

    def sample(self, batch: int, networks: int, generator: torch.Generator) -> Batch:
        """Draw from what is held, with replacement. One network for each aircraft draws from that aircraft's
        experiences; a single one from those of all."""
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
        """Draw whole steps, of all aircraft at the same moments: (aircraft, batch, ...)."""
        step = torch.randint(
            min(self.added, self._steps), (1, batch), generator=generator, device=generator.device
        )
        who = torch.arange(self._aircraft, device=generator.device)[:, None]
        return Batch(
            self.seen[step, who], self.action[step, who], self.reward[step, who], self.then[step, who]
        )

    def state(self) -> dict[str, Any]:
        """Everything, for a checkpoint."""
        held = min(self.added, self._steps)
        names = ("seen", "then", "action", "reward")
        return {"added": self.added, **{name: getattr(self, name)[:held].clone() for name in names}}

    def load(self, state: dict[str, Any]) -> None:
        """Go on from a `state`."""
        self.added = state["added"]
        for name in ("seen", "then", "action", "reward"):
            getattr(self, name)[: len(state[name])] = state[name]
