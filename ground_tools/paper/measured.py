"""Delays of all methods that need no stored training run, on equal positions, with the paper's objective.

The methods are the fixed modes, random choice, the one-line rule, the set network and the search. The system
delay is the sum over the aircraft of each one's mean delay to those that it reaches. Needs PyTorch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import torch
from torch import Tensor

from companion.atmc.actions import PAPER_ACTIONS
from companion.errors import ConfigError
from ground_tools.atmc.commands.evaluate import COUNTED, PARTS, ROUNDS, Frozen, read_policy, rule_of
from ground_tools.atmc.env.deciders import Chance, Decider, settle
from ground_tools.atmc.env.environment import Env, EnvSettings, Observation
from ground_tools.atmc.env.objective import costs
from ground_tools.atmc.env.paper_task import paper_objective
from ground_tools.atmc.env.search import search
from ground_tools.atmc.env.world import SIDES_M, WorldSettings
from ground_tools.channel.options import UAVS
from ground_tools.paper.delays import DENSITIES, SET, Delays
from sitl_mocks.channel.parameters import MODES

_CHUNK: Final = 500
"""Number of fleets that are evaluated at once."""
_BEFORE: Final = 2
"""Rounds of decisions at a previous position, so that the set network's first choices follow earlier choices
of its own."""
_RULE_ROUNDS: Final = 2
"""Rounds of the rule. In the first round some neighbours may not be received, because they are on a transport
that no aircraft uses afterwards."""
_SEARCH_ROUNDS: Final = 15


class Sums:
    """Accumulated costs of one method: system delays by square, and the delays of each aircraft."""

    def __init__(self) -> None:
        self._fleets = dict.fromkeys(SIDES_M, 0)
        self._first = dict.fromkeys(SIDES_M, 0.0)
        self._second = dict.fromkeys(SIDES_M, 0.0)
        self._each = torch.zeros(UAVS, dtype=torch.float64)

    def add(self, side_m: float, cost_s: Tensor) -> None:
        """Add costs (s) in one square, shape (fleets, aircraft)."""
        each_ms = 1000.0 * cost_s.double()
        system = each_ms.sum(1)
        self._fleets[side_m] += len(system)
        self._first[side_m] += float(system.sum())
        self._second[side_m] += float(system.square().sum())
        self._each += each_ms.sum(0)

    def mean_ms(self, sides_m: Sequence[float]) -> tuple[float, float]:
        """Mean system delay over these squares and its standard error; the squares' draws are independent."""
        means, variances = [], []
        for side_m in sides_m:
            n, mean = self._fleets[side_m], self._first[side_m] / self._fleets[side_m]
            means.append(mean)
            variances.append(max(0.0, self._second[side_m] / n - mean**2) / max(1, n - 1))
        return math.fsum(means) / len(means), math.sqrt(math.fsum(variances)) / len(means)

    def delays(self, key: str, name: str, rate: int | str) -> Delays:
        """The accumulated delays. All squares must have the same number of fleets."""
        system = {density: self.mean_ms(sides_m) for density, sides_m in DENSITIES.items()}
        uav_ms = self._each / sum(self._fleets.values())
        return Delays(key, name, rate, system, tuple(uav_ms.tolist()))


def measure(samples: int, seed: int, policy: Path | None) -> tuple[Delays, ...]:
    """Measure every method on the same positions.

    Args:
        samples: number of fleets in each of the six squares.
        seed: seed of the draw.
        policy: file of a set network that was trained for the paper's objective; None leaves this method out.

    Raises:
        ConfigError: the policy is not one for this task.
    """
    frozen = None if policy is None else _frozen(policy)
    sums: dict[int | str, Sums] = {}
    for side_m in SIDES_M:
        generator = torch.Generator().manual_seed(seed * 1_000_003 + int(side_m))
        for begin in range(0, samples, _CHUNK):
            fleets = min(_CHUNK, samples - begin)
            for key, cost_s in _in_one_place(side_m, fleets, frozen, generator).items():
                sums.setdefault(key, Sums()).add(side_m, cost_s)
    names = {SET: "set network", "random": "random", "rule": "one-line rule", "search": "search"}
    return (
        *_best_fixed([sums[k] for k in range(len(PAPER_ACTIONS))]),
        *(sums[key].delays(key, name, "-") for key, name in names.items() if key in sums),
    )


def _frozen(path: Path) -> Frozen:
    frozen = Frozen(read_policy(path), str(path))
    m = frozen.metadata
    if (m.kind, m.objective, m.actions) != ("set", "paper", PAPER_ACTIONS) or m.neighbours < UAVS - 1:
        raise ConfigError(
            f"{path}: this is not a set policy for {UAVS} aircraft and the paper's objective and actions"
        )
    return frozen


def _in_one_place(
    side_m: float, fleets: int, frozen: Frozen | None, generator: torch.Generator
) -> dict[int | str, Tensor]:
    """Costs (s), shape (fleets, aircraft), of every fixed action by its index and of the other methods by
    their keys."""
    objective = paper_objective(torch.device("cpu"))
    settings = EnvSettings(world=WorldSettings(sides=side_m), side_drawn="episode")
    env = Env(settings, objective, fleets, UAVS, generator)
    allowed = torch.ones(len(PAPER_ACTIONS), dtype=torch.bool)
    if frozen is not None:
        _decided(env, frozen, generator, _BEFORE)
        env.go_on()
    found: dict[int | str, Tensor] = {
        k: costs(objective, env.air, torch.full_like(env.action, k)) for k in range(len(PAPER_ACTIONS))
    }
    alike = torch.stack([found[k].sum(1) for k in range(len(PAPER_ACTIONS))])
    starts = [alike.argmin(0)[:, None].expand_as(env.action)]
    if frozen is not None:
        found[SET] = _decided(env, frozen, generator, ROUNDS)
        starts.append(env.action)
    chance: Decider = Chance(allowed, generator)
    found["random"] = env.act(chance.decide(env.observe(), env.action))
    rule = rule_of("paper", PAPER_ACTIONS, allowed)
    found["rule"] = settle(env, rule, _RULE_ROUNDS, generator, parts=PARTS)[-1]
    starts.append(env.action)
    floor = search(objective, env.air, starts, allowed, generator, _SEARCH_ROUNDS)
    found["search"] = costs(objective, env.air, floor)
    return found


def _decided(env: Env, frozen: Frozen, generator: torch.Generator, rounds: int) -> Tensor:
    """Costs (s), shape (fleets, aircraft), after the fleet has decided in the same way as in its training.

    A policy that was trained with random phases decides one part of the fleet after the other, and the last
    rounds are averaged. Unlike `settle`, this computes nothing for the aircraft whose turn it is not.
    """
    if frozen.metadata.decisions == "together":
        return env.act(frozen.decide(env.observe(), env.action))
    counted = []
    for number in range(rounds):
        order = torch.rand(env.action.shape, generator=generator).argsort(1)
        for part in range(PARTS):
            moving = order % PARTS == part
            seen = env.observe()
            action = env.action.clone()
            some = Observation(seen.own[moving], seen.rows[moving], seen.heard[moving])
            action[moving] = frozen.decide(some, action[moving])
            env.action = action
            if number >= rounds - COUNTED:
                counted.append(costs(env.objective, env.air, action))
    return torch.stack(counted).mean(0)


def _best_fixed(fixed: Sequence[Sums]) -> list[Delays]:
    """Each protocol at the rate with the least mean delay over all squares; the lowest such rate on a tie."""
    names = dict(zip(MODES, ("BLE 4", "BLE 5", "Wi-Fi"), strict=True))
    found = []
    for index, mode in enumerate(MODES):
        mine = [k for k, action in enumerate(PAPER_ACTIONS) if action[index]]
        best = min(mine, key=lambda k: (fixed[k].mean_ms(SIDES_M)[0], PAPER_ACTIONS[k][index]))
        found.append(fixed[best].delays(mode, names[mode], PAPER_ACTIONS[best][index]))
    return found
