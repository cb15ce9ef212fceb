"""What a fleet's choice costs: the paper's objective, and awareness, for which the policy that flies is
trained.

Each gives three things of a fleet's present actions: the total, every aircraft's own cost for every action
that it could take instead, and the difference cost, which adds what that action does to the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from ground_tools.atmc.env.channel import Packets, Reach, TorchChannel
from sitl_mocks.channel.parameters import MODES

MISS_S = 3.0
"""An aircraft out of reach counts like one of this age."""


@dataclass(frozen=True, slots=True)
class Air:
    """A batch of fleets as the objectives see them."""

    reach: Reach
    weight: Tensor
    """(environments, receiver, sender): how much the receiver must know of the sender; see
    `companion.atmc.observation.conflict_weight`. The paper's objective does not use it."""


class Objective(Protocol):
    """A cost (s) of what all aircraft send."""

    channel: TorchChannel

    def each(self, air: Air, action: Tensor, packets: Packets) -> Tensor:
        """Cost of each aircraft's own messages, (environments, aircraft), differentiable in `packets`."""
        ...

    def own(self, air: Air, packets: Packets, senders: Tensor) -> Tensor:
        """The same of some aircraft, for each of its actions while all others keep theirs, (environments,
        aircraft, actions)."""
        ...


def costs(objective: Objective, air: Air, action: Tensor) -> Tensor:
    """Cost of each aircraft's messages (s), (environments, aircraft)."""
    c = objective.channel
    with torch.no_grad():
        return objective.each(air, action, c.packets(air.reach, c.loads(air.reach, action)))


def difference_costs(
    objective: Objective, air: Air, action: Tensor, senders: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """The present cost of each aircraft's messages (s), (environments, aircraft), and what the fleet's total
    would be for each of its actions, up to a number for each aircraft, (environments, senders, actions).

    Args:
        senders: indices of those to tell it of; None: all.
    """
    c = objective.channel
    with torch.no_grad():
        loads = c.loads(air.reach, action)
    leaves = {name: load.requires_grad_() for name, load in loads.items()}
    with torch.enable_grad():
        packets = c.packets(air.reach, leaves)
        each = objective.each(air, action, packets)
        found = torch.autograd.grad(each.sum(), list(leaves.values()), allow_unused=True)
    gradients = {
        name: torch.zeros_like(leaf) if gradient is None else gradient
        for (name, leaf), gradient in zip(leaves.items(), found, strict=True)
    }
    with torch.no_grad():
        if senders is None:
            senders = torch.arange(action.shape[1], device=action.device)
        harm = c.harm(air.reach, gradients)[:, senders]
        return each.detach(), objective.own(air, packets, senders) + harm


class PaperObjective:
    """P0: the sum over aircraft of the mean delay (s) to those whom each one reaches; 0 for one that reaches
    nobody. Every action is one protocol."""

    def __init__(self, channel: TorchChannel) -> None:
        if ((channel.level_of > 0).sum(1) != 1).any():
            raise ValueError("P0 takes exactly one protocol for each action")
        self.channel = channel
        self._mode = (channel.level_of > 0).long().argmax(1)

    def each(self, air: Air, action: Tensor, packets: Packets) -> Tensor:
        """See `Objective.each`."""
        c, level, mode = self.channel, self.channel.level_of[action], self._mode[action]
        total = torch.zeros(action.shape, device=action.device)
        for index in range(len(MODES)):
            chosen = (mode == index).to(total.dtype)
            carried = air.reach.modes[index] * chosen[:, None, :]
            delay = torch.exp(c.log_delay_at(index, level[:, None, :, index], packets))
            total = total + (delay * carried).sum(1) / carried.sum(1).clamp(min=1.0)
        return total

    def own(self, air: Air, packets: Packets, senders: Tensor) -> Tensor:
        """See `Objective.own`."""
        packets = packets.of(senders)
        c = self.channel
        parts = []
        for index in range(len(MODES)):
            carried = air.reach.modes[index][:, :, senders]
            delay = torch.exp(c.log_delay(index, packets))
            mean = (delay * carried[..., None]).sum(1) / carried.sum(1).clamp(min=1.0)[..., None]
            parts.append(torch.cat([torch.zeros_like(mean[..., :1]), mean], -1))
        return torch.cat(
            [parts[self._mode[a]][..., c.level_of[a, self._mode[a]], None] for a in range(len(c.actions))], -1
        )


class AwarenessObjective:
    """The age of what everybody knows of everybody whom it could soon be in conflict with.

    A message crosses a link on any of the sender's transports; times between receptions are taken for
    exponential, so that rates of reception add up: h = sum of 1 / mean delay over the transports in reach.
    Ages above MISS_S count as MISS_S: the expected age is (1 - exp(-h MISS_S)) / h, and MISS_S where nothing
    gets through. A cost is the sum over receivers of weight times age (s).
    """

    def __init__(self, channel: TorchChannel) -> None:
        self.channel = channel

    def each(self, air: Air, action: Tensor, packets: Packets) -> Tensor:
        """See `Objective.each`."""
        level = self.channel.level_of[action]
        heard: Tensor | float = 0.0
        for index in range(len(MODES)):
            there = level[:, None, :, index]
            delay = self.channel.log_delay_at(index, there, packets)
            heard = heard + torch.exp(-delay) * (air.reach.modes[index] * (there > 0))
        assert isinstance(heard, Tensor)
        return (age_s(heard) * air.weight).sum(1)

    def own(self, air: Air, packets: Packets, senders: Tensor) -> Tensor:
        """See `Objective.own`."""
        packets = packets.of(senders)
        c = self.channel
        rates = []
        for index in range(len(MODES)):
            carried = air.reach.modes[index][:, :, senders]
            heard = torch.exp(-c.log_delay(index, packets)) * carried[..., None]
            rates.append(torch.cat([torch.zeros_like(heard[..., :1]), heard], -1))
        costs = [
            (
                age_s(sum(rates[mode][..., c.level_of[a, mode]] for mode in range(3)))  # type: ignore[arg-type]
                * air.weight[:, :, senders]
            ).sum(1)
            for a in range(len(c.actions))
        ]
        return torch.stack(costs, -1)


def age_s(rate: Tensor) -> Tensor:
    """Expected age (s), ages above MISS_S counted as that, for receptions at `rate` (1/s)."""
    at = rate.clamp(min=1e-4)
    return -torch.expm1(-at * MISS_S) / at
