"""MADDPG (Lowe et al., 2017) for the paper's task.

Each aircraft has an actor, which takes the observation of that aircraft, and a critic, which in training
takes the observations and actions of all aircraft.

Choices are discrete, and an actor gives logits. There are two gradients for the actors (`policy_gradient`):

- "exact": the expected value of the aircraft's choice, which is the sum over all actions of their
  probabilities times their values. The critic gives the value of each action, with the choices of the other
  aircraft as they were taken.
- "gumbel": the straight-through Gumbel-softmax of discrete MADDPG, one sampled choice in the forward pass and
  its softmax in the backward pass. This uses the critic's slope at the corners of the simplex, where the
  critic has only learned values, and an actor that has become certain of a mode receives no gradient.

As in MADQN-ATMC, the buffer holds 250 episodes, learning begins when it is full, and the last step of an
episode does not end the task.

All aircraft learn from the same sampled steps, and a critic's first layer is linear. The fleet's observations
and actions therefore pass through it once; a different action of one aircraft only adds one row of weights
and subtracts another.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
import torch
from msgspec import Meta
from torch import Tensor
from torch.nn import functional

from ground_tools.atmc.env.paper_task import Count, PaperTask, Share, Tally, TaskSettings, Weight
from ground_tools.atmc.learners.paper_learner import PaperLearner, log_reward
from ground_tools.atmc.learners.replay_buffer import Batch, Replay
from ground_tools.atmc.learners.stack import Stack, clipped, soft_update

Rate = Annotated[float, Meta(gt=0)]


class MaddpgSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of MADDPG.

    Values that the paper's table gives for all algorithms are taken from it; the rest was tuned
    (docs/atmc-baselines.md). "Original" below means Lowe et al.
    """

    task: TaskSettings = TaskSettings()
    episodes: Count = 1000
    batch: Count = 256
    actor_batch: Count = 64
    """Steps of each batch from which the actors learn. With "exact" each of them costs as many evaluations of
    the critics as there are actions."""
    buffer_steps: Count = 25_000
    """Capacity of the replay buffer in steps. Learning begins when it is full."""
    learn_every: Count = 20
    """Steps from one update to the next; the original uses 100 steps."""
    discount: Share = 0.0
    """0 because positions are redrawn at every step: later rewards depend on an action only through the
    previous actions that are observed."""
    actor_rate: Rate = 3e-4
    critic_rate: Rate = 1e-3
    soft_update: Share = 0.01
    """Share of the network in the target network after an update, as in the original. The paper's 0.999 does
    not make the target network slow, and an actor that follows a critic needs a slow one."""
    policy_gradient: Literal["exact", "gumbel"] = "exact"
    """Gradient of the actors; see the module's docstring."""
    temperature: Rate = 1.0
    """Temperature of the softmax in the backward pass of "gumbel"."""
    entropy: Rate = 0.05
    """Final weight of the entropy of the choices, which is subtracted from the actors' loss."""
    first_entropy: Rate = 1.0
    """Weight of the entropy when learning begins. The critics learn first which modes are good everywhere. An
    actor that follows them at once becomes certain of one of these, and an actor that is certain hardly
    learns."""
    entropy_episodes: Count = 200
    """Episodes of learning over which the weight changes from the first to the last, by the same factor in
    each."""
    exploration: Share = 0.1
    """Share of uniformly random choices once learning has begun; before that all choices are random."""
    reward: Literal["log", "standardised"] = "log"
    """What the critics learn: `log_reward`, or the paper's reward, standardised by its mean and standard
    deviation over the first full buffer."""
    logit_cost: Weight = 1e-3
    """Weight of the mean square of the logits in the actors' loss, as in the original."""
    gradient_clip: Rate = 0.5
    """Greatest norm of the gradient of each network, as in the original."""
    hidden: tuple[Count, ...] = (256, 128)


class Maddpg(PaperLearner):
    """Trains actors with centralised critics. A `Learner`."""

    replay: Replay

    def __init__(self, settings: MaddpgSettings, seed: int, device: torch.device) -> None:
        s = self.settings = settings
        self.rounds, self.done = s.episodes, 0
        g = self._generator = torch.Generator(device).manual_seed(seed)
        self._task = PaperTask(s.task, g)
        self._uavs, self._actions = s.task.uavs, len(self._task.actions)
        sizes = (self._task.inputs, *s.hidden, self._actions)
        whole = (self._uavs * (self._task.inputs + self._actions), *s.hidden, 1)
        self.actor, self.actor_target = Stack(self._uavs, sizes, g), Stack(self._uavs, sizes, g)
        self.critic, self.critic_target = Stack(self._uavs, whole, g), Stack(self._uavs, whole, g)
        self.actor_target.load_state_dict(self.actor.state_dict())
        self.critic_target.load_state_dict(self.critic.state_dict())
        self._actor_adam = torch.optim.Adam(self.actor.parameters(), lr=s.actor_rate, fused=True)
        self._critic_adam = torch.optim.Adam(self.critic.parameters(), lr=s.critic_rate, fused=True)
        self.replay = Replay(s.buffer_steps, self._uavs, self._task.inputs, device)
        # Mean and standard deviation of the rewards, known when the buffer is full.
        self._scale = torch.tensor([0.0, 1.0], device=device)

    def train(self) -> dict[str, float]:
        """Train for one episode. See `Learner.train`."""
        s = self.settings
        tally = Tally(self._uavs, self._task.device)
        seen = self._task.reset()
        for step in range(s.task.steps):
            action = self._explore(seen)
            then, reward, cost_s = self._task.step(action)
            learned = reward if s.reward == "standardised" else log_reward(cost_s)
            self.replay.add(seen, action, learned, then)
            if self.replay.added == s.buffer_steps and s.reward == "standardised":
                self._scale = torch.stack([self.replay.reward.mean(), self.replay.reward.std()])
            if self.replay.full and (step + 1) % s.learn_every == 0:
                tally.learned(self._learn())
            tally.add(reward, cost_s)
            seen = then
        self.done += 1
        return tally.metrics()

    @property
    def _entropy_weight(self) -> float:
        s = self.settings
        learned = self.done - s.buffer_steps / s.task.steps
        share = min(max(learned / s.entropy_episodes, 0.0), 1.0)
        factor: float = (s.entropy / s.first_entropy) ** share
        return s.first_entropy * factor

    def _explore(self, seen: Tensor) -> Tensor:
        """Actions (N,): drawn with the actors' probabilities, or at random with the share `exploration`."""
        device, g = self._task.device, self._generator
        some = torch.randint(self._actions, (self._uavs,), generator=g, device=device)
        if not self.replay.full:
            return some
        with torch.no_grad():
            action = self._draw(self.actor.of_all(seen[None]))[0].argmax(-1)
        random = torch.rand(self._uavs, generator=g, device=device) < self.settings.exploration
        return torch.where(random, some, action)

    def _draw(self, logits: Tensor) -> Tensor:
        """Draw one-hot choices (..., actions) by the Gumbel-softmax; gradients pass through the softmax."""
        noise = torch.empty_like(logits).exponential_(generator=self._generator).log().neg()
        soft = torch.softmax((logits + noise) / self.settings.temperature, -1)
        hard = functional.one_hot(soft.argmax(-1), self._actions).to(soft.dtype)
        return hard + soft - soft.detach()

    def _learn(self) -> Tensor:
        """Update every network once. Returns the mean loss of the critics."""
        s = self.settings
        batch = self.replay.sample_steps(s.batch, self._generator)
        taken = functional.one_hot(batch.action, self._actions).to(batch.seen.dtype)
        with torch.no_grad():
            next_value = self._value(
                self.critic_target, batch.then, self._draw(self.actor_target(batch.then))
            )
            reward = (batch.reward - self._scale[0]) / self._scale[1]
            wanted = reward + s.discount * next_value
        loss = (wanted - self._value(self.critic, batch.seen, taken)).square().mean(1).sum()
        _step(self._critic_adam, self.critic, loss, s.gradient_clip)
        self._improve(batch, taken)
        soft_update(self.actor_target, self.actor, s.soft_update)
        soft_update(self.critic_target, self.critic, s.soft_update)
        found: Tensor = loss.detach() / self._uavs
        return found

    def _value(self, critic: Stack, seen: Tensor, choice: Tensor) -> Tensor:
        """Values (N, batch) of the observations (N, batch, inputs) and choices (N, batch, actions) of all."""
        x = torch.cat([seen, choice], -1).transpose(0, 1).reshape(1, seen.shape[1], -1)
        found: Tensor = critic(x.expand(self._uavs, -1, -1))[..., 0]
        return found

    def _improve(self, batch: Batch, taken: Tensor) -> None:
        """Update the actors once: each actor's new choice replaces its taken one; the others keep theirs."""
        s = self.settings
        seen, taken = batch.seen[:, : s.actor_batch], taken[:, : s.actor_batch]
        logits = self.actor(seen)
        x = torch.cat([seen, taken], -1).transpose(0, 1).reshape(1, seen.shape[1], -1)
        each = torch.arange(self._uavs, device=x.device)
        with torch.no_grad():
            weight, bias = self.critic.weights[0], self.critic.biases[0]
            first = torch.baddbmm(bias, x.expand(self._uavs, -1, -1), weight)
            blocks = weight.reshape(self._uavs, self._uavs, -1, weight.shape[-1])
            own = blocks[each, each, self._task.inputs :]  # (N, actions, hidden)
        if s.policy_gradient == "exact":
            value = self._expected(logits, first - torch.bmm(taken, own), own)
        else:
            change = self._draw(logits) - taken
            value = self.critic.after_first(torch.baddbmm(first, change, own))[..., 0]
        logs = torch.log_softmax(logits, -1)
        entropy = -(logs.exp() * logs).sum(-1)
        loss = -(value + self._entropy_weight * entropy).mean(1).sum()
        loss = loss + s.logit_cost * logits.square().mean((1, 2)).sum()
        _step(self._actor_adam, self.actor, loss, s.gradient_clip)

    def _expected(self, logits: Tensor, others: Tensor, own: Tensor) -> Tensor:
        """Expected values (N, batch) of the actors' choices.

        Args:
            logits: (N, batch, actions).
            others: what the critics' first layer gives without the aircraft's own choice, (N, batch, hidden).
            own: what each own choice adds to it, (N, actions, hidden).
        """
        with torch.no_grad():
            each = (others[:, :, None] + own[:, None]).reshape(self._uavs, -1, own.shape[-1])
            values = self.critic.after_first(each).reshape(logits.shape)
        expected: Tensor = (torch.softmax(logits, -1) * values).sum(-1)
        return expected

    @property
    def _chooser(self) -> Stack:
        return self.actor

    def _parts(self) -> dict[str, Stack | torch.optim.Optimizer]:
        return {
            "actor": self.actor,
            "actor_target": self.actor_target,
            "critic": self.critic,
            "critic_target": self.critic_target,
            "actor_adam": self._actor_adam,
            "critic_adam": self._critic_adam,
        }

    def state(self) -> dict[str, Any]:
        """See `Learner.state`."""
        return {**super().state(), "scale": self._scale}

    def load(self, state: dict[str, Any]) -> None:
        """See `Learner.load`."""
        super().load(state)
        self._scale = state["scale"].to(self._task.device)


def _step(adam: torch.optim.Optimizer, networks: Stack, loss: Tensor, clip: float) -> None:
    """One optimiser step of these networks only, with clipped gradients."""
    parameters = list(networks.parameters())
    gradients = torch.autograd.grad(loss, parameters)
    for parameter, gradient in zip(parameters, clipped(gradients, clip), strict=True):
        parameter.grad = gradient
    adam.step()
