"""All methods whose delays a figure shows: the learners from stored training runs, the others measured anew.

This module does not need PyTorch. Without PyTorch nothing is measured, and the figures state that.
"""

from __future__ import annotations

import functools
import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from companion.shipped import how_to_install, shipped
from ground_tools.atmc.commands.results import NAMES, Results, Run
from ground_tools.atmc.env.torch_setup import set_up_torch
from ground_tools.paper.delays import SET, Delays
from ground_tools.paper.seed_means import interquartile_mean, resampled

POLICIES: Final = shipped("results/policies")
SET_POLICY: Final = POLICIES / "paper-set.safetensors"
"""File of the set network that was trained for the paper's objective."""
LEARNERS: Final = ("madqn", "maddpg", "iac")
"""The learning algorithms that the paper compares."""
_KEYS: Final = {"high": "high_ms", "low": "low_ms", "dynamic": "delay_ms"}


@dataclass(frozen=True, slots=True)
class Learner:
    """Results of one learning algorithm over its seeds, with the networks at the end of the runs.

    An algorithm gives its last networks. Those of the best of a hundred validations are better, but they are
    chosen afterwards.
    """

    key: str
    seeds: int
    system: dict[str, float]
    """Interquartile mean over the seeds (ms), by density; with one seed, its value."""
    best: dict[str, float]
    """The same with the networks of the best validation of each run."""
    error: dict[str, float]
    """Bootstrap standard error (ms), by density; NaN if there is only one seed."""
    interval: dict[str, tuple[float, float]]
    """95 % bootstrap interval (ms), by density; empty if there is only one seed."""

    @property
    def name(self) -> str:
        """Display name."""
        return NAMES[self.key]

    @property
    def words(self) -> str:
        """Text about the uncertainty of the results."""
        best = f"{self.best['dynamic']:.0f} ms with the best validation"
        if not self.interval:
            mean = f"{self.system['dynamic']:.0f} ms at dynamic density"
            return f"{self.name}: one seed, {mean}, no interval; {best}"
        low, high = self.interval["dynamic"]
        mean = f"interquartile mean {self.system['dynamic']:.0f} ms at dynamic density"
        return f"{self.name}: {self.seeds} seeds, {mean}, 95 % interval {low:.0f} to {high:.0f} ms; {best}"


def learner(results: Results, key: str) -> Learner | None:
    """Results of an algorithm from its stored runs; None if no run is stored."""
    runs = results.of(key)
    if not runs:
        return None
    system, best, error, interval = {}, {}, {}, {}
    for density, name in _KEYS.items():
        best[density] = float(interquartile_mean(np.array([[run.best[name]] for run in runs]))[0])
        values = np.array([[run.last[name]] for run in runs])
        system[density], error[density] = float(interquartile_mean(values)[0]), float("nan")
        if len(runs) > 1:
            drawn = resampled(values)
            low, high = np.percentile(drawn, (2.5, 97.5))
            error[density], interval[density] = float(drawn.std()), (float(low), float(high))
    return Learner(key, len(runs), system, best, error, interval)


def best_run(runs: Sequence[Run]) -> Run:
    """The run with the best validation."""
    return min(runs, key=lambda run: min(ms for _, ms in run.validation))


def absent(results: Results) -> list[str]:
    """A text for each learner without a stored run."""
    return [f"{NAMES[key]}: no run is stored, so it is not shown" for key in LEARNERS if not results.of(key)]


def has_torch() -> bool:
    """Whether PyTorch is installed, without which nothing can be measured."""
    return importlib.util.find_spec("torch") is not None


@functools.lru_cache(maxsize=4)
def measured(samples: int, seed: int, policy: Path = SET_POLICY) -> tuple[Delays, ...]:
    """Measure the fixed modes at their best rates, the set network if its file exists, random choice, the
    one-line rule and the search. The result is cached for all figures; it is empty without PyTorch.

    Args:
        samples: number of fleets in each of the six squares.
        seed: seed of the draw.
        policy: file of the set network.

    Raises:
        ConfigError: the policy is not one for this task.
    """
    if not has_torch():
        return ()
    set_up_torch()
    from ground_tools.paper.measured import measure

    return measure(samples, seed, policy if policy.exists() else None)


def not_measured(found: Sequence[Delays], policy: Path = SET_POLICY) -> list[str]:
    """Texts about the methods that are missing among the measured ones."""
    if not found:
        return [f"{how_to_install('torch', 'train')}; until then only stored runs are shown"]
    if all(method.key != SET for method in found):
        return [f"set network: {policy.name} does not exist, so it is not shown"]
    return []
