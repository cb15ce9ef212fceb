"""MADQN-ATMC, the paper's Algorithm 1, with its table of training parameters.

Each of ten aircraft has its own Q network and replay buffer. Optionally, one network serves all aircraft and
learns from the experiences of all.

The paper leaves three points open. Here an episode begins with random actions. The last step of an episode
does not end the task, so its target bootstraps like every other one. The initial weights are those of
`flat.Stack`.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import torch
from msgspec import Meta
from torch import Tensor

from ground_tools.atmc.env.paper_task import Count, PaperTask, Share, Tally, TaskSettings
from ground_tools.atmc.learners.paper_learner import PaperLearner, log_reward
from ground_tools.atmc.learners.replay_buffer import Replay
from ground_tools.atmc.learners.stack import Stack, soft_update


class MadqnSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of MADQN-ATMC; the defaults are those of the paper's table."""

    task: TaskSettings = TaskSettings()
    shared_network: bool = False
    episodes: Count = 1000
    batch: Count = 256
    """Experiences per network in each update."""
    buffer_steps: Count = 25_000
    """Capacity of the replay buffer in steps (250 episodes). Learning begins when it is full."""
    discount: Share = 0.95
    learning_rate: Annotated[float, Meta(gt=0)] = 1e-4
    soft_update: Share = 0.999
    """tau: share of the network in the target network after an update, as in the paper."""
    first_exploration: Share = 1.0
    last_exploration: Share = 0.1
    exploration_episodes: Count = 500
    reward: Literal["paper", "log"] = "paper"
    """What the networks learn: the paper's reward in s, or `log_reward`."""
    hidden: tuple[Count, ...] = (256, 128)


class SharedMadqnSettings(MadqnSettings, frozen=True, kw_only=True):
    """Settings of MADQN-ATMC with one network for all aircraft, which takes one batch per update."""

    shared_network: bool = True


class Madqn(PaperLearner):
    """Trains the Q networks. A `Learner`."""

    replay: Replay

    def __init__(self, settings: MadqnSettings, seed: int, device: torch.device) -> None:
        s = self.settings = settings
        self.rounds, self.done = s.episodes, 0
        self._generator = torch.Generator(device).manual_seed(seed)
        self._task = PaperTask(s.task, self._generator)
        networks = 1 if s.shared_network else s.task.uavs
        sizes = (self._task.inputs, *s.hidden, len(self._task.actions))
        self.network = Stack(networks, sizes, self._generator)
        self.target = Stack(networks, sizes, self._generator)
        self.target.load_state_dict(self.network.state_dict())
        # Adam treats each weight separately, so one optimiser for all networks equals one for each.
        self._adam = torch.optim.Adam(self.network.parameters(), lr=s.learning_rate, fused=True)
        self.replay = Replay(s.buffer_steps, s.task.uavs, self._task.inputs, device)

    def train(self) -> dict[str, float]:
        """Train for one episode. See `Learner.train`."""
        s = self.settings
        rate = exploration_rate(s, self.done + 1)
        tally = Tally(s.task.uavs, self._task.device)
        seen = self._task.reset()
        for _ in range(s.task.steps):
            action = self._explore(seen, rate)
            then, reward, cost_s = self._task.step(action)
            learned = reward if s.reward == "paper" else log_reward(cost_s)
            self.replay.add(seen, action, learned, then)
            if self.replay.full:
                tally.learned(self._learn())
            tally.add(reward, cost_s)
            seen = then
        self.done += 1
        return tally.metrics() | {"exploration": rate}

    def _explore(self, seen: Tensor, rate: float) -> Tensor:
        """Actions (N,): a random one with probability `rate`, else the best one by the aircraft's network."""
        uavs, device = self.settings.task.uavs, self._task.device
        drawn = torch.rand(uavs, generator=self._generator, device=device)
        some = torch.randint(len(self._task.actions), (uavs,), generator=self._generator, device=device)
        return torch.where(drawn < rate, some, self._best(seen[None])[0])

    def _learn(self) -> Tensor:
        """Update every network once. Returns the mean of their losses."""
        s = self.settings
        batch = self.replay.sample(s.batch, self.network.networks, self._generator)
        with torch.no_grad():
            wanted = td_target(batch.reward, self.target(batch.then), s.discount)
        value = self.network(batch.seen).gather(-1, batch.action[..., None])[..., 0]
        # Mean over the batch, sum over the networks, so that each network's gradient is that of its own loss.
        loss = (wanted - value).square().mean(1).sum()
        self._adam.zero_grad()
        loss.backward()
        self._adam.step()
        soft_update(self.target, self.network, s.soft_update)
        found: Tensor = loss.detach() / self.network.networks
        return found

    @property
    def _chooser(self) -> Stack:
        return self.network

    def _parts(self) -> dict[str, Stack | torch.optim.Optimizer]:
        return {"network": self.network, "target": self.target, "adam": self._adam}


def exploration_rate(settings: MadqnSettings, episode: int) -> float:
    """Exploration rate e of an episode, counted from 1 (Algorithm 1, lines 5 to 9)."""
    s = settings
    if episode < s.exploration_episodes:
        return (
            s.first_exploration
            - episode * (s.first_exploration - s.last_exploration) / s.exploration_episodes
        )
    return s.last_exploration


def td_target(reward: Tensor, next_values: Tensor, discount: float) -> Tensor:
    """Temporal-difference target y = r + gamma max_a Q'(o', a).

    Args:
        reward: Rewards r, (...).
        next_values: Values Q' of the target network, (..., actions).
        discount: gamma.
    """
    return reward + discount * next_values.amax(-1)
