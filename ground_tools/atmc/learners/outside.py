"""Trains learners of BenchMARL, a library of others, on the paper's task through its PettingZoo environment.

The learners have the library's default settings and networks, with the exceptions in `SETTINGS`. They receive
the paper's reward, and are measured on the same validation set as the learners of this project.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import torch
from benchmarl.algorithms import IppoConfig, IqlConfig, MasacConfig
from benchmarl.environments.pettingzoo.common import PettingZooClass
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models import MlpConfig
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import PettingZooWrapper
from torchrl.envs.utils import ExplorationType, set_exploration_type

from ground_tools.atmc.env.paper_task import Choose, PaperTask, TaskSettings
from ground_tools.atmc.env.parallel_env import AtmcParallelEnv
from ground_tools.atmc.env.torch_setup import set_up_torch

STEPS_BETWEEN_MEASUREMENTS: Final = 2000
"""Steps of the fleet that are collected before the next updates, and between two measurements."""
SETTINGS: Final[dict[str, object]] = {
    "gamma": 0.95,
    "on_policy_collected_frames_per_batch": STEPS_BETWEEN_MEASUREMENTS,
    "off_policy_collected_frames_per_batch": STEPS_BETWEEN_MEASUREMENTS,
    "off_policy_n_optimizer_steps": 333,
    "on_policy_n_envs_per_worker": 1,
    "off_policy_n_envs_per_worker": 1,
    "evaluation": False,
    "render": False,
    "loggers": [],
    "create_json": False,
}
"""What differs from the library's defaults: the paper's discount, and measurements in shorter intervals with
as many updates for each step as by default (1,000 for 6,000 steps). The library itself records nothing."""
_ALGORITHMS: Final[dict[str, Any]] = {"iql": IqlConfig, "ippo": IppoConfig, "masac": MasacConfig}
_GROUP: Final = "uav"


@dataclass(frozen=True, slots=True)
class Learned:
    """The outcome of a training run."""

    curve: tuple[tuple[int, float], ...]
    """Steps of the fleet so far, and system delay (ms) on the validation set."""
    choose: Choose
    """The last policy's greedy choices."""


def train(algorithm: str, seed: int, steps: int, until: int | None = None) -> Learned:
    """Train one learner in one thread.

    Args:
        algorithm: "iql", "ippo" or "masac".
        seed: seed of all random draws.
        steps: steps of the fleet to learn from, a multiple of `STEPS_BETWEEN_MEASUREMENTS`.
        until: steps after which this run is stopped, likewise a multiple; None: at its end.
    """
    set_up_torch()
    measurements = _Measurements()
    config = ExperimentConfig.get_from_yaml()
    for name, value in SETTINGS.items():
        setattr(config, name, value)
    config.max_n_frames = steps if until is None else until
    config.off_policy_memory_size = steps  # The default would hold all steps, too.
    config.exploration_anneal_frames = steps // 3  # This is the default of a run that is not stopped.
    with tempfile.TemporaryDirectory() as folder:
        config.save_folder = folder
        Experiment(
            task=_Task("atmc", {}),
            algorithm_config=_ALGORITHMS[algorithm].get_from_yaml(),
            model_config=MlpConfig.get_from_yaml(),
            seed=seed,
            config=config,
            callbacks=[measurements],
        ).run()
    return Learned(tuple(measurements.curve), measurements.choose)


class _Task(PettingZooClass):  # type: ignore[misc]
    """The paper's task for BenchMARL."""

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], Any]:
        def make() -> Any:
            env = AtmcParallelEnv()
            env.reset(seed)
            return PettingZooWrapper(env, categorical_actions=True, use_mask=False, device=device)

        return make

    def supports_continuous_actions(self) -> bool:
        return False

    def supports_discrete_actions(self) -> bool:
        return True

    def has_state(self) -> bool:
        return False

    def has_render(self, env: Any) -> bool:
        return False

    def max_steps(self, env: Any) -> int:
        return TaskSettings().steps


class _Measurements(Callback):  # type: ignore[misc]
    """Measures the policy after each round of updates."""

    def __init__(self) -> None:
        super().__init__()
        self._task = PaperTask(TaskSettings(), torch.Generator().manual_seed(1))
        self.curve: list[tuple[int, float]] = []

    def on_train_end(self, training_td: Any, group: str) -> None:
        score = self._task.validate(self.choose)["score"]
        self.curve.append((int(self.experiment.total_frames), round(score, 1)))

    def choose(self, rows: Tensor) -> Tensor:
        """The policy's greedy actions (E, N) for the observations (E, N, inputs)."""
        seen = TensorDict({"observation": rows}, batch_size=rows.shape[:-1])
        both = TensorDict({_GROUP: seen}, batch_size=rows.shape[:-2])
        with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
            found: Tensor = self.experiment.group_policies[_GROUP](both)[_GROUP, "action"]
        return found
