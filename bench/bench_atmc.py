"""ATMC: decisions per second in training, share of time in updates, time of one decision aboard."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from rich.console import Console
from rich.table import Table

from companion.atmc.observation import NEIGHBOUR_COLUMNS
from companion.atmc.policy import load
from companion.errors import ConfigError
from ground_tools.atmc.env.torch_setup import set_up_torch

_POLICY = Path(__file__).parents[1] / "config/policies/atmc.safetensors"
_PAPER_DECISION_US = 3840.0
_TURNS = 5
_LEARNERS = ("madqn", "madqn-shared", "maddpg", "iac")
_EPISODES, _STEPS, _AIRCRAFT = 3, 100, 10


def main() -> None:
    """Print the tables."""
    try:
        set_up_torch()
    except ConfigError as error:
        print(f"training was not measured: {error}")
    else:
        _learners()
        _training()
    _aboard()


def _learners() -> None:
    """Measure the paper's algorithms. An episode is 100 steps of ten aircraft. Algorithms with a replay
    buffer begin to learn in episode 251."""
    import torch

    from ground_tools.atmc.learners.algorithms import ALGORITHMS

    decisions = _STEPS * _AIRCRAFT
    table = Table(title="Training with the paper's algorithms on one core")
    for head in (
        "algorithm",
        "decisions/s, filling",
        "decisions/s, learning",
        "time in updates",
        "minutes per 1,000 episodes",
    ):
        table.add_column(head, justify="right")
    for name in _LEARNERS:
        parts = ALGORITHMS[name].parts()
        task = msgspec.structs.replace(parts.settings.task, steps=_STEPS)
        learner: Any = parts.make(msgspec.structs.replace(parts.settings, task=task), 1, torch.device("cpu"))
        fills = learner.replay is not None
        filling = _median(learner.train, _EPISODES) if fills else 0.0
        if fills:
            # Pretend that 250 episodes have passed. The content of the buffer does not affect the time.
            learner.replay.added = parts.settings.buffer_steps
        learning = _median(learner.train, _EPISODES)
        minutes = (250 * filling + 750 * learning if fills else 1000 * learning) / 60.0
        table.add_row(
            name,
            f"{decisions / filling:,.0f}" if fills else "",
            f"{decisions / learning:,.0f}",
            f"{1.0 - filling / learning:.0%}" if fills else "",
            f"{minutes:.0f}",
        )
    Console().print(table)


def _training() -> None:
    from ground_tools.atmc.learners.flying_policy import FlyingLearner, FlyingSettings

    learner = FlyingLearner(FlyingSettings(episodes=2, updates=6), 1)
    learner.train()
    table = Table(title="Training the set network on one core, by group of fleets")
    for head in (
        "aircraft",
        "fleets",
        "ms per update",
        "labels/s",
        "observation share",
        "cost share",
        "network share",
    ):
        table.add_column(head, justify="right")
    for group in learner._groups:
        env = group.env
        acting = learner._draw_acting(env.aircraft)
        whole = _median(lambda g=group: learner._update(g, 0.5))
        seeing = _median(env.observe)
        costing = _median(lambda g=group, a=acting: learner._target(g, a))
        decided = env.environments * max(2, round(0.3 * env.aircraft))
        shares = (seeing / whole, costing / whole, max(0.0, 1.0 - (seeing + costing) / whole))
        table.add_row(
            str(env.aircraft),
            str(env.environments),
            f"{1e3 * whole:.0f}",
            f"{decided / whole:,.0f}",
            *(f"{share:.0%}" for share in shares),
        )
    Console().print(table)


def _aboard() -> None:
    policy = load(_POLICY.read_bytes(), _POLICY.name)
    own = np.array(policy.metadata.golden[0].own)
    rows = np.array([row for golden in policy.metadata.golden for row in golden.rows])
    allowed = np.ones(len(policy.actions), bool)
    table = Table(title="One decision on board (NumPy)")
    for head in ("neighbours", "us", "relative to the paper's 3.84 ms"):
        table.add_column(head, justify="right")
    for neighbours in (0, 9, 50, 99):
        some = np.resize(rows, (neighbours, len(NEIGHBOUR_COLUMNS)))
        took = _median(lambda some=some: policy.choose(own, some, allowed, 0), 400)
        table.add_row(str(neighbours), f"{1e6 * took:.0f}", f"{1e6 * took / _PAPER_DECISION_US:.3f}")
    Console().print(table)


def _median(call: Callable[[], object], turns: int = _TURNS) -> float:
    times = []
    for _ in range(turns):
        # Processor time, because it depends less on other processes than elapsed time does.
        began = time.process_time()
        call()
        times.append(time.process_time() - began)
    return float(np.median(times))
