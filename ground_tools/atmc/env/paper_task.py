"""The task of the paper's section "Performance of MADQN-ATMC", and the measurement of a policy in it.

All three of the paper's algorithms learn this task: 10 aircraft, 30 actions each, and positions that are
redrawn at every step.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import msgspec
import torch
from msgspec import Meta
from torch import Tensor

from companion.atmc.actions import PAPER_ACTIONS
from ground_tools.atmc.env.channel import TorchChannel
from ground_tools.atmc.env.environment import Env, EnvSettings, paper_reward
from ground_tools.atmc.env.flat_observation import flat, inputs
from ground_tools.atmc.env.objective import PaperObjective
from ground_tools.atmc.env.world import SIDES_M, WorldSettings
from sitl_mocks.channel.parameters import ChannelParameters

HIGH_M, LOW_M = SIDES_M[:3], SIDES_M[3:]
"""Square sides of the paper's high and low density."""
_VALIDATION_SEED = 2_000_003
"""Seed of the validation environments. They are the same for every run, and no run trains on them."""
_SETTLING_STEPS = 2
"""Steps that are not counted. A policy observes the previous actions, which are random at the beginning."""

Choose = Callable[[Tensor], Tensor]
"""Maps flat observations (E, N, inputs) to actions (E, N)."""
Weight = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=1)]
Count = Annotated[int, Meta(ge=1)]


class TaskSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the paper's task; the defaults are the paper's values.

    The square is redrawn at every step, like the positions. The paper says that the flight range is 100 to
    10,000 m, but not when it changes.
    """

    uavs: Annotated[int, Meta(ge=2, le=100)] = 10
    steps: Count = 100
    """Steps per episode."""
    local_weight: Weight = 1.0
    """Weight alpha of the local reward."""
    global_weight: Weight = 1.0
    """Weight beta of the global reward."""
    environment: EnvSettings = EnvSettings()
    validation_environments: Count = 32
    """Validation fleets in each of the six squares."""
    validation_steps: Count = 16
    """Decisions of each validation fleet."""


@functools.cache
def paper_objective(device: torch.device) -> PaperObjective:
    """The paper's objective. It is cached, because its delay tables take a second to compute."""
    return PaperObjective(TorchChannel(ChannelParameters(), PAPER_ACTIONS, device))


class PaperTask:
    """One fleet to learn from.

    Args:
        settings: Settings of the task.
        generator: Source of all random numbers; all tensors are on its device.
    """

    def __init__(self, settings: TaskSettings, generator: torch.Generator) -> None:
        self.settings = settings
        self.device = generator.device
        self.actions = PAPER_ACTIONS
        self.inputs = inputs(settings.uavs)
        self.objective = paper_objective(self.device)
        self._env = Env(settings.environment, self.objective, 1, settings.uavs, generator)

    def reset(self) -> Tensor:
        """Begin an episode. Returns the observations of all aircraft, (N, inputs)."""
        self._env.reset()
        return flat(self._env.observe())[0]

    def step(self, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Apply the actions of all aircraft, (N,), then move all aircraft to new positions.

        Returns:
            The next observations (N, inputs), the rewards in s (N,), and each aircraft's mean delay to those
            it reaches in s (N,).
        """
        s = self.settings
        cost_s = self._env.act(action[None])
        reward = paper_reward(cost_s, cost_s > 0.0, s.local_weight, s.global_weight)
        self._env.go_on()
        return flat(self._env.observe())[0], reward[0], cost_s[0]

    def validate(self, choose: Choose) -> dict[str, float]:
        """Measure a policy on the fixed validation set; see `measure`. "score" is the dynamic delay in ms."""
        s = self.settings
        found = measure(
            choose, self.objective, s.uavs, s.validation_environments, s.validation_steps, _VALIDATION_SEED
        )
        return {"score": found.delays_ms["delay_ms"], **found.delays_ms}

    def examples(self, count: int = 8) -> Tensor:
        """Example observations as flat rows, of different aircraft in different squares, (count, inputs)."""
        generator = torch.Generator(self.device).manual_seed(_VALIDATION_SEED)
        env = Env(EnvSettings(), self.objective, count, self.settings.uavs, generator)
        each = torch.arange(count, device=self.device)
        return flat(env.observe())[each, each % self.settings.uavs]


@dataclass(frozen=True, slots=True)
class Measured:
    """Measured delays of a policy."""

    delays_ms: dict[str, float]
    """System delays of the fleet: "delay_ms", the mean over the six squares; "high_ms" and "low_ms", the
    means over the squares of high and low density; and one for each square, such as "side_500_ms"."""
    uav_ms: tuple[float, ...]
    """Mean delay of each aircraft over all six squares."""


def measure(
    choose: Choose, objective: PaperObjective, uavs: int, environments: int, steps: int, seed: int
) -> Measured:
    """Measure the system delay of a policy.

    The system delay is the sum over all aircraft of each one's mean delay to those it reaches. Positions are
    redrawn at every step, and then all aircraft decide once, at the same time.

    Args:
        choose: The policy.
        objective: The paper's objective.
        uavs: Aircraft per fleet.
        environments: Fleets in each of the paper's six squares.
        steps: Counted decisions of each fleet.
        seed: Seed of all random draws.
    """
    device = objective.channel.device
    generator = torch.Generator(device).manual_seed(seed)
    sums, each = [], torch.zeros(uavs, device=device)
    with torch.no_grad():
        for side in SIDES_M:
            settings = EnvSettings(world=WorldSettings(sides=side), side_drawn="episode")
            env = Env(settings, objective, environments, uavs, generator)
            total = torch.zeros((), device=device)
            for step in range(-_SETTLING_STEPS, steps):
                cost_s = env.act(choose(flat(env.observe())))
                if step >= 0:
                    total += cost_s.sum(1).mean()
                    each += cost_s.mean(0)
                env.go_on()
            sums.append(1000.0 * total / steps)
    delay_ms = dict(zip(SIDES_M, torch.stack(sums).tolist(), strict=True))
    dynamic = _mean_of(delay_ms, SIDES_M)
    delays = {
        "delay_ms": dynamic,
        "high_ms": _mean_of(delay_ms, HIGH_M),
        "low_ms": _mean_of(delay_ms, LOW_M),
        **{f"side_{side:.0f}_ms": value for side, value in delay_ms.items()},
    }
    return Measured(delays, tuple((1000.0 * each / (steps * len(SIDES_M))).tolist()))


def _mean_of(values: dict[float, float], keys: tuple[float, ...]) -> float:
    return math.fsum(values[key] for key in keys) / len(keys)


class Tally:
    """Means over an episode. The sums stay on the device until the episode ends."""

    def __init__(self, uavs: int, device: torch.device) -> None:
        self._reward = torch.zeros(uavs, device=device)
        self._cost = torch.zeros(uavs, device=device)
        self._loss = torch.zeros((), device=device)
        self._steps, self._updates = 0, 0

    def add(self, reward: Tensor, cost_s: Tensor) -> None:
        """Add the reward (s) and cost (s) of one step, each (N,)."""
        self._reward += reward
        self._cost += cost_s
        self._steps += 1

    def learned(self, loss: Tensor) -> None:
        """Add the loss of one update."""
        self._loss += loss
        self._updates += 1

    def metrics(self) -> dict[str, float]:
        """Means over the episode.

        These are the fleet's reward (s) and delay (ms) per step, the same for each aircraft, and the loss per
        update (NaN if there was no update).
        """
        reward: list[float] = (self._reward / self._steps).tolist()
        cost_ms: list[float] = (1000.0 * self._cost / self._steps).tolist()
        loss = float(self._loss) / self._updates if self._updates else math.nan
        return {
            "reward": math.fsum(reward),
            "delay_ms": math.fsum(cost_ms),
            "loss": loss,
            **{f"reward_uav{n}": value for n, value in enumerate(reward)},
            **{f"delay_ms_uav{n}": value for n, value in enumerate(cost_ms)},
        }
