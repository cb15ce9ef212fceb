"""A fixed set of fleets on which a policy is compared with the best fixed mode during training."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from companion.atmc.rule import FIXED_SETS, PAPER_FAR, PAPER_NEAR
from ground_tools.atmc.env.deciders import Decider, settle
from ground_tools.atmc.env.environment import Env, EnvSettings
from ground_tools.atmc.env.objective import Objective, costs
from ground_tools.atmc.env.tasks import ObjectiveName
from ground_tools.atmc.env.world import SIDES_M, World, WorldSettings, draw

_SIDES_M = SIDES_M[:4]
"""Sides of the squares. In larger ones few aircraft affect each other, so a few pairs would decide."""
_ROUNDS = 4
_FLEETS = {
    "paper": ((5, 120), (10, 80), (20, 20), (50, 4)),
    "awareness": ((5, 60), (10, 40), (20, 15), (50, 3), (100, 1)),
}
"""For each objective: aircraft per fleet, and environments for each size of square."""
_LOAD = 0.5
_MODES = {"paper": (PAPER_NEAR, PAPER_FAR), "awareness": FIXED_SETS[:2]}


@dataclass(slots=True)
class _Case:
    env: Env
    world: World
    fixed_s: float
    """Cost (s) of the best of `_MODES` in this square."""


class Validation:
    """Fleets of several sizes in squares of several sizes; for awareness also with foreign transmissions.

    Args:
        objective: The cost function.
        name: Name of the objective.
        seed: Seed of the positions and of all other random draws.
    """

    def __init__(self, objective: Objective, name: ObjectiveName, seed: int) -> None:
        self._seed = seed
        self._device = objective.channel.device
        generator = self._generator = torch.Generator(self._device).manual_seed(seed)
        settings = EnvSettings(lossy=name == "awareness")
        self._cases: dict[str, list[_Case]] = {}
        loads = (0.0, _LOAD) if name == "awareness" else (0.0,)
        for aircraft, count in _FLEETS[name]:
            for load in loads:
                cases = self._cases[f"{aircraft}" + ("_loaded" if load else "")] = []
                for side in _SIDES_M:
                    env = Env(settings, objective, count, aircraft, generator)
                    world = draw(WorldSettings(sides=side, load=(load, load)), count, aircraft, generator)
                    env.place(world)
                    fixed = [
                        float(costs(objective, env.air, torch.full_like(env.action, index)).sum())
                        for index in map(objective.channel.actions.index, _MODES[name])
                    ]
                    cases.append(_Case(env, world, min(fixed)))

    def measure(self, decider: Decider) -> dict[str, float]:
        """Measure a policy against the best of two fixed modes in each square.

        All squares have equal weight, and all random draws are the same every time.

        Returns:
            Cost beyond that of the best fixed mode (%) for each fleet size, and "score", their mean.
        """
        generator = self._generator.manual_seed(self._seed)
        found = {}
        for key, cases in self._cases.items():
            ratios = []
            for case in cases:
                env = case.env
                env.action = torch.randint(
                    len(env.channel.actions), env.action.shape, generator=generator, device=self._device
                )
                last = settle(env, decider, _ROUNDS, generator)[-4:]
                cost = float(torch.stack([c.sum() for c in last]).mean())
                ratios.append(cost / max(case.fixed_s, 1e-9))
            found[f"uavs{key}_percent"] = 100.0 * (sum(ratios) / len(ratios) - 1.0)
        return {"score": sum(found.values()) / len(found), **found}
