"""Makes a sample of kept training results again: first episodes of runs, and a policy's measured delay."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import msgspec
import torch

from companion.atmc import policy_file
from ground_tools.atmc.commands import evaluate, results
from ground_tools.atmc.commands.freeze_command import SAMPLES
from ground_tools.atmc.env.torch_setup import set_up_torch
from ground_tools.atmc.learners.algorithms import ALGORITHMS

_EPISODES: Final = 3
"""Episodes of each run that are trained again. The paper's learners fill their buffers for longer, so that
this compares the task, its random draws and the untrained networks rather than the learning."""
_DIGITS: Final = 4
"""Significant digits of a kept training result."""


def training(path: Path) -> list[str]:
    """Train the first episodes of every kept run again. Returns the differences, as text."""
    set_up_torch()
    runs = results.read(path).runs
    if not runs:
        return ["the file holds no run"]
    found = []
    for run in runs:
        parts = ALGORITHMS[run.algorithm].parts()
        settings: Any = msgspec.convert(run.settings, type(parts.settings))
        learner = parts.make(settings, run.seed, torch.device("cpu"))
        again = [learner.train() for _ in range(_EPISODES)]
        for key, values in (("reward", run.reward), ("delay_ms", run.delay_ms)):
            kept = list(values[:_EPISODES])
            now = [float(f"{metrics[key]:.{_DIGITS}g}") for metrics in again]
            if kept != now:
                found.append(f"{run.algorithm}, seed {run.seed}: {key} {kept}, now {now}")
    return found


def policy(path: Path) -> list[str]:
    """Measure a policy again in its smallest fleets. Returns the differences, as text."""
    set_up_torch()
    data = path.read_bytes()
    metadata, _ = policy_file.read(data, path.name)
    sizes = sorted(uavs for uavs in SAMPLES if f"uavs{uavs}_dynamic_ms" in metadata.results)
    if not sizes:
        return ["the file holds no measured delay to compare with"]
    question = evaluate.Question(metadata.objective, uavs=sizes[0], samples=SAMPLES[sizes[0]])
    again = evaluate.evaluate(data, path.name, question)
    found = []
    for key in ("dynamic_ms", "best_fixed_dynamic_ms", "rule_dynamic_ms", "search_dynamic_ms"):
        kept, now = metadata.results[f"uavs{sizes[0]}_{key}"], float(again[key])
        if kept != now:
            found.append(f"{sizes[0]} aircraft: {key} {kept:g}, now {now:g}")
    return found
