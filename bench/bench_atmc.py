"""ATMC: decisions a second in training and what they go to; one decision aboard."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from companion.atmc.observation import NEIGHBOUR_COLUMNS
from companion.atmc.policy import load

_POLICY = Path(__file__).parents[1] / "config/policies/atmc.safetensors"
_PAPER_DECISION_US = 3840.0
_TURNS = 5


def main() -> None:
    """Print both tables."""
    _training()
    _aboard()


def _training() -> None:
    try:
        import torch

        from ground_tools.atmc.flying import FlyingLearner, FlyingSettings
    except ModuleNotFoundError as error:
        print(f"{error.name} is not installed: no figures of training")
        return
    torch.set_num_threads(1)
    learner = FlyingLearner(FlyingSettings(episodes=2, updates=6), 1)
    learner.train()
    table = Table(title="training the set network, one core: each group of fleets")
    for head in ("aircraft", "fleets", "ms an update", "labels a second", "observing", "costs", "network"):
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
    table = Table(title="one decision aboard, NumPy")
    for head in ("neighbours", "us", "of the paper's 3.84 ms"):
        table.add_column(head, justify="right")
    for neighbours in (0, 9, 50, 99):
        some = np.resize(rows, (neighbours, len(NEIGHBOUR_COLUMNS)))
        took = _median(lambda some=some: policy.choose(own, some, allowed, 0), 400)
        table.add_row(str(neighbours), f"{1e6 * took:.0f}", f"{1e6 * took / _PAPER_DECISION_US:.3f}")
    Console().print(table)


def _median(call: Callable[[], object], turns: int = _TURNS) -> float:
    times = []
    for _ in range(turns):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return float(np.median(times))
