"""Independent actor-critic (IAC in Christianos et al., 2020).

Each aircraft has an actor and a critic, which both take the observation of that aircraft. Training is
on-policy: every few steps the networks learn from these steps and discard them, so there is no replay buffer
to fill first.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import torch
from msgspec import Meta
from torch import Tensor

from ground_tools.atmc.env.paper_task import Count, PaperTask, Share, Tally, TaskSettings
from ground_tools.atmc.learners.paper_learner import PaperLearner, log_reward
from ground_tools.atmc.learners.stack import Stack, clipped


class IacSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of IAC.

    Values that the paper's table gives for all algorithms are taken from it; the rest was tuned
    (docs/atmc-baselines.md).
    """

    task: TaskSettings = TaskSettings()
    episodes: Count = 1000
    learn_every: Count = 10
    """Number of steps used in each update."""
    discount: Share = 0.95
    learning_rate: Annotated[float, Meta(gt=0)] = 3e-4
    """Learning rate of actors and critics."""
    entropy: Annotated[float, Meta(ge=0)] = 0.01
    """Weight of the entropy of the choices, which is subtracted from the actors' loss."""
    reward: Literal["paper", "log"] = "paper"
    """What the critics learn: the paper's reward in s, or `log_reward`."""
    gradient_clip: Annotated[float, Meta(gt=0)] = 0.5
    """Greatest norm of the gradient of each network."""
    hidden: tuple[Count, ...] = (256, 128)


class Iac(PaperLearner):
    """Trains independent actors and critics. A `Learner`."""

    def __init__(self, settings: IacSettings, seed: int, device: torch.device) -> None:
        s = self.settings = settings
        self.rounds, self.done = s.episodes, 0
        g = self._generator = torch.Generator(device).manual_seed(seed)
        self._task = PaperTask(s.task, g)
        uavs = s.task.uavs
        self.actor = Stack(uavs, (self._task.inputs, *s.hidden, len(self._task.actions)), g)
        self.critic = Stack(uavs, (self._task.inputs, *s.hidden, 1), g)
        self._parameters = [*self.actor.parameters(), *self.critic.parameters()]
        self._adam = torch.optim.Adam(self._parameters, lr=s.learning_rate, fused=True)

    def train(self) -> dict[str, float]:
        """Train for one episode. See `Learner.train`."""
        s = self.settings
        tally = Tally(s.task.uavs, self._task.device)
        seen = self._task.reset()
        path: list[tuple[Tensor, Tensor, Tensor]] = []
        for step in range(s.task.steps):
            action = self._draw(seen)
            then, reward, cost_s = self._task.step(action)
            learned = reward if s.reward == "paper" else log_reward(cost_s)
            path.append((seen, action, learned))
            if len(path) == s.learn_every or step + 1 == s.task.steps:
                tally.learned(self._learn(path, then))
                path = []
            tally.add(reward, cost_s)
            seen = then
        self.done += 1
        return tally.metrics()

    def _draw(self, seen: Tensor) -> Tensor:
        """Draw choices (N,) with the actors' probabilities."""
        with torch.no_grad():
            logits = self.actor.of_all(seen[None])[0]
        # Exponential race: exponential times are divided by the probabilities. Each choice then has the
        # least time with its own probability.
        times = torch.empty_like(logits).exponential_(generator=self._generator)
        return (logits - times.log()).argmax(-1)

    def _learn(self, path: list[tuple[Tensor, Tensor, Tensor]], then: Tensor) -> Tensor:
        """Update from consecutive steps and the observation after them. Returns the critics' mean loss."""
        s = self.settings
        seen, action, reward = (torch.stack(part, 1) for part in zip(*path, strict=True))  # (N, steps, ...)
        with torch.no_grad():
            after = self.critic(then[:, None])[:, 0, 0]
            returns = discounted(reward, after, s.discount)
        value = self.critic(seen)[..., 0]
        logs = torch.log_softmax(self.actor(seen), -1)
        chosen = logs.gather(-1, action[..., None])[..., 0]
        entropy = -(logs.exp() * logs).sum(-1)
        critic_loss = (returns - value).square().mean(1).sum()
        actor_loss = -((returns - value).detach() * chosen + s.entropy * entropy).mean(1).sum()
        gradients = torch.autograd.grad(actor_loss + critic_loss, self._parameters)
        of_actor = len(list(self.actor.parameters()))
        parts = (gradients[:of_actor], gradients[of_actor:])
        for parameter, gradient in zip(
            self._parameters, [g for part in parts for g in clipped(part, s.gradient_clip)], strict=True
        ):
            parameter.grad = gradient
        self._adam.step()
        found: Tensor = critic_loss.detach() / s.task.uavs
        return found

    @property
    def _chooser(self) -> Stack:
        return self.actor

    def _parts(self) -> dict[str, Stack | torch.optim.Optimizer]:
        return {"actor": self.actor, "critic": self.critic, "adam": self._adam}


def discounted(reward: Tensor, after: Tensor, discount: float) -> Tensor:
    """Discounted return from each step on, (N, steps).

    Args:
        reward: Rewards, (N, steps).
        after: Value of the observation after the last step, (N,).
        discount: Discount factor of each step.
    """
    found, total = [], after
    for step in reversed(range(reward.shape[1])):
        total = reward[:, step] + discount * total
        found.append(total)
    return torch.stack(found[::-1], 1)
