"""The environment as a PettingZoo `ParallelEnv`: one fleet in which every aircraft is an agent.

It is a thin adapter of `environment.Env` for algorithms of other libraries; the learners of this project use
`Env` directly. An episode ends by time only (truncation), so a learner must bootstrap beyond its last step.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import torch
from gymnasium.spaces import Box, Discrete
from pettingzoo import ParallelEnv

from companion.arrays import Float32s
from companion.atmc.actions import PAPER_ACTIONS, Action
from ground_tools.atmc.env.channel import TorchChannel
from ground_tools.atmc.env.environment import Env, EnvSettings, paper_reward
from ground_tools.atmc.env.flat_observation import flat, inputs
from ground_tools.atmc.env.objective import Objective, PaperObjective
from sitl_mocks.channel.parameters import ChannelParameters

Infos = dict[str, dict[str, float]]


class AtmcParallelEnv(ParallelEnv[str, Float32s, int]):  # type: ignore[misc]
    """The paper's task, or one of another objective, on the CPU.

    Agents are named "uav_0", "uav_1" and so on. An observation is a row of `flat.flat`, and a reward is in s.
    In the paper's task the reward is the paper's, and the info of each agent has its mean delay ("delay_s").
    With another objective all agents share one reward, the fleet's mean cost with its sign changed, and the
    info has the cost of the agent's own messages ("cost_s").

    Args:
        aircraft: Number of aircraft in the fleet.
        steps: Steps per episode.
        settings: Settings of the environment.
        actions: What an aircraft may send; each action uses one protocol.
        parameters: Channel parameters.
        objective: Another objective, such as `awareness_objective()`. It has a channel with actions of its
            own, so that `actions` and `parameters` must be left out.

    Raises:
        ValueError: an objective is given together with `actions` or `parameters`.
    """

    metadata: ClassVar[dict[str, Any]] = {"name": "dmuca_atmc_v0", "render_modes": []}

    def __init__(
        self,
        aircraft: int = 10,
        steps: int = 100,
        settings: EnvSettings | None = None,
        actions: tuple[Action, ...] | None = None,
        parameters: ChannelParameters | None = None,
        objective: Objective | None = None,
    ) -> None:
        if objective is not None and (actions is not None or parameters is not None):
            raise ValueError("objective: its channel has actions and parameters; leave out both arguments")
        self.possible_agents = [f"uav_{number}" for number in range(aircraft)]
        self.agents: list[str] = []
        self.render_mode = None
        self._steps, self._done = steps, 0
        self._generator = torch.Generator()
        self._generator.seed()
        self._cost = "delay_s" if objective is None else "cost_s"
        if objective is None:
            channel = TorchChannel(parameters or ChannelParameters(), actions or PAPER_ACTIONS)
            objective = PaperObjective(channel)
        self._env = Env(settings or EnvSettings(), objective, 1, aircraft, self._generator)
        box = Box(0.0, 2.0, (inputs(aircraft),), np.float32)
        self.observation_spaces = dict.fromkeys(self.possible_agents, box)
        count = len(objective.channel.actions)
        self.action_spaces = {agent: Discrete(count) for agent in self.possible_agents}

    def observation_space(self, agent: str) -> Box:
        """Observation space of an agent; it is the same for all agents."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Discrete[Any]:
        """Action space of an agent: indices into the actions."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Float32s], Infos]:
        """Begin an episode. A seed makes the following random draws reproducible."""
        if seed is not None:
            self._generator.manual_seed(seed)
        self.agents = list(self.possible_agents)
        self._done = 0
        self._env.reset()
        return self._observations(), {agent: {} for agent in self.agents}

    def step(
        self, actions: dict[str, int]
    ) -> tuple[dict[str, Float32s], dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Apply the actions of all agents at the same time, then move all aircraft to new positions."""
        agents = self.agents
        if not agents:
            return {}, {}, {}, {}, {}
        chosen = torch.tensor([[int(actions[agent]) for agent in agents]])
        cost_s = self._env.act(chosen)
        if self._cost == "delay_s":
            reward = paper_reward(cost_s, cost_s > 0.0)[0].tolist()
        else:
            reward = [-float(cost_s.mean())] * len(agents)
        self._env.go_on()
        self._done += 1
        over = self._done >= self._steps
        infos = {agent: {self._cost: s} for agent, s in zip(agents, cost_s[0].tolist(), strict=True)}
        observations = self._observations()
        if over:
            self.agents = []
        return (
            observations,
            dict(zip(agents, reward, strict=True)),
            dict.fromkeys(agents, False),
            dict.fromkeys(agents, over),
            infos,
        )

    def _observations(self) -> dict[str, Float32s]:
        rows: Float32s = flat(self._env.observe())[0].numpy()
        return dict(zip(self.agents, rows, strict=True))
