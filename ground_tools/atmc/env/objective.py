"""Cost functions of a fleet's actions: the paper's objective and the awareness objective.

The policy that flies is trained for awareness. Each objective gives three quantities for the fleet's current
actions: the cost of each aircraft's messages; each aircraft's own cost for every action that it could take
instead; and the difference cost, which adds the effect of that action on the other aircraft.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from companion.atmc.actions import SET_ACTIONS
from ground_tools.atmc.env.channel import Packets, Reach, TorchChannel
from ground_tools.atmc.env.tasks import AWARENESS_CHANNEL
from sitl_mocks.channel.parameters import MODES

MISS_S = 3.0
"""Age (s) that counts for an aircraft out of reach, and the upper limit of all ages."""


@dataclass(frozen=True, slots=True)
class Air:
    """A batch of fleets, as input of the objectives."""

    reach: Reach
    weight: Tensor
    """How important it is that the receiver knows the sender's state, (environments, receiver, sender). See
    `companion.atmc.observation.conflict_weight`. The paper's objective does not use it."""


class Objective(Protocol):
    """A cost (s) of the actions of all aircraft."""

    channel: TorchChannel

    def each(self, air: Air, action: Tensor, packets: Packets) -> Tensor:
        """Cost of each aircraft's own messages, (environments, aircraft), differentiable in `packets`."""
        ...

    def own(self, air: Air, packets: Packets, senders: Tensor) -> Tensor:
        """Cost of the `senders`' own messages for each of their actions, (environments, senders, actions).

        All other aircraft keep their current actions.
        """
        ...


def costs(objective: Objective, air: Air, action: Tensor) -> Tensor:
    """Cost of each aircraft's messages (s), (environments, aircraft)."""
    c = objective.channel
    with torch.no_grad():
        return objective.each(air, action, c.packets(air.reach, c.loads(air.reach, action)))


def difference_costs(
    objective: Objective, air: Air, action: Tensor, senders: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Compute current costs and difference costs.

    Args:
        objective: The cost function.
        air: The fleets.
        action: Current actions, (environments, aircraft).
        senders: Indices of the aircraft whose difference costs are wanted; None for all.

    Returns:
        The current cost of each aircraft's messages (s), (environments, aircraft), and what the fleet's total
        cost would be for each action of each sender (s), up to an additive constant per aircraft,
        (environments, senders, actions).
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
    """The paper's objective P0: the sum over all aircraft of each one's mean delay (s) to those it reaches.

    An aircraft that reaches no other counts 0. Every action must use exactly one protocol.
    """

    def __init__(self, channel: TorchChannel) -> None:
        if ((channel.level_of > 0).sum(1) != 1).any():
            raise ValueError("the paper's objective needs exactly one protocol in each action")
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
    """Age of the information that aircraft hold about those with which they could soon be in conflict.

    A message can cross a link on any of the sender's transports. Times between receptions are assumed to be
    exponential, so reception rates add up: h = sum of 1 / mean delay over the transports in reach. Ages above
    MISS_S count as MISS_S: the expected age is (1 - exp(-h MISS_S)) / h, and MISS_S if no message gets
    through. The cost of an aircraft's messages is the sum over receivers of weight times age (s).
    """

    def __init__(self, channel: TorchChannel) -> None:
        self.channel = channel

    def cost(self, rate: Tensor, weight: Tensor) -> Tensor:
        """Cost of pairs whose information is received at `rate` (1/s) and that have this conflict weight."""
        return age_s(rate) * weight

    def each(self, air: Air, action: Tensor, packets: Packets) -> Tensor:
        """See `Objective.each`."""
        level = self.channel.level_of[action]
        heard: Tensor | float = 0.0
        for index in range(len(MODES)):
            there = level[:, None, :, index]
            delay = self.channel.log_delay_at(index, there, packets)
            heard = heard + torch.exp(-delay) * (air.reach.modes[index] * (there > 0))
        assert isinstance(heard, Tensor)
        return self.cost(heard, air.weight).sum(1)

    def own(self, air: Air, packets: Packets, senders: Tensor) -> Tensor:
        """See `Objective.own`."""
        packets = packets.of(senders)
        c = self.channel
        rates = []
        for index in range(len(MODES)):
            carried = air.reach.modes[index][:, :, senders]
            heard = torch.exp(-c.log_delay(index, packets)) * carried[..., None]
            rates.append(torch.cat([torch.zeros_like(heard[..., :1]), heard], -1))
        weight, costs = air.weight[:, :, senders], []
        for action in range(len(c.actions)):
            ble4, ble5, wifi = (rates[mode][..., c.level_of[action, mode]] for mode in range(3))
            costs.append(self.cost(ble4 + ble5 + wifi, weight).sum(1))
        return torch.stack(costs, -1)


def age_s(rate: Tensor) -> Tensor:
    """Expected age (s) for receptions at `rate` (1/s). Ages above MISS_S count as MISS_S."""
    at = rate.clamp(min=1e-4)
    return -torch.expm1(-at * MISS_S) / at


def awareness_objective(device: torch.device | str = "cpu") -> AwarenessObjective:
    """The objective of the policy that flies: sets of transports, and the airtimes of real packets."""
    return AwarenessObjective(TorchChannel(AWARENESS_CHANNEL, SET_ACTIONS, torch.device(device)))
