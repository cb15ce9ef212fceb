"""Training and evaluation of policies for adaptive transmission mode configuration (ATMC).

A policy chooses on which transports an aircraft sends its Remote ID, and at which rates. `env` is the
simulated environment with the analytic channel model and the objectives. `learners` holds the training
algorithms: the paper's (MADQN-ATMC, MADDPG, IAC) and the set network that flies. `commands` holds the
subcommands of `ground-tools atmc`: train, evaluate, freeze and collect. The result is a frozen policy file,
which `companion.atmc` loads on the aircraft without PyTorch. Start reading with `env.environment.Env`, then
`learners.flying_policy`; docs/atmc-results.md reports the results.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ground_tools.atmc.env.deciders import Chance, Decider, Fixed, Rule, settle
    from ground_tools.atmc.env.environment import Env, EnvSettings, Observation
    from ground_tools.atmc.env.objective import (
        AwarenessObjective,
        Objective,
        PaperObjective,
        awareness_objective,
        costs,
    )
    from ground_tools.atmc.env.paper_task import paper_objective
    from ground_tools.atmc.env.parallel_env import AtmcParallelEnv
    from ground_tools.atmc.env.search import search
    from ground_tools.atmc.env.world import World, WorldSettings, draw
    from ground_tools.atmc.learners.algorithms import ALGORITHMS, Algorithm
    from ground_tools.atmc.learners.learner import Learner
    from ground_tools.atmc.learners.stack import freeze_layers
    from ground_tools.atmc.learners.training import train

__all__ = [
    "ALGORITHMS",
    "Algorithm",
    "AtmcParallelEnv",
    "AwarenessObjective",
    "Chance",
    "Decider",
    "Env",
    "EnvSettings",
    "Fixed",
    "Learner",
    "Objective",
    "Observation",
    "PaperObjective",
    "Rule",
    "World",
    "WorldSettings",
    "awareness_objective",
    "costs",
    "draw",
    "freeze_layers",
    "paper_objective",
    "search",
    "settle",
    "train",
]

_MODULES = {
    "env.deciders": ("Chance", "Decider", "Fixed", "Rule", "settle"),
    "env.environment": ("Env", "EnvSettings", "Observation"),
    "env.objective": ("AwarenessObjective", "Objective", "PaperObjective", "awareness_objective", "costs"),
    "env.paper_task": ("paper_objective",),
    "env.parallel_env": ("AtmcParallelEnv",),
    "env.search": ("search",),
    "env.world": ("World", "WorldSettings", "draw"),
    "learners.algorithms": ("ALGORITHMS", "Algorithm"),
    "learners.stack": ("freeze_layers",),
    "learners.learner": ("Learner",),
    "learners.training": ("train",),
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that this package can be imported without PyTorch."""
    for module, names in _MODULES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
