"""`ground-tools atmc evaluate`: compare a frozen policy with the baselines and the search.

All methods are measured at the same positions. A policy that was trained to decide at random phases does so
here: at each set of positions, random parts of the fleet decide one after the other. They start from the
actions at the previous positions, and only the last rounds count. The paper's policies decide once, all
aircraft at the same time, after new positions were drawn.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from companion.arrays import Floats
from companion.atmc import policy_file
from companion.atmc.actions import PAPER_ACTIONS, SET_ACTIONS, Action, legal
from companion.atmc.audible import CROWD, audible
from companion.atmc.choice import Mind
from companion.atmc.observation import NEIGHBOUR_COLUMNS, OWN_COLUMNS
from companion.atmc.plugin_policy import PluginPolicy
from companion.atmc.policy import Metadata, Policy, load
from companion.atmc.rule import BLE4_RANGE_M, FLYING_FAR, FLYING_NEAR, PAPER_FAR, PAPER_NEAR
from companion.errors import ConfigError
from ground_tools.atmc.commands.places import Places, Square
from ground_tools.atmc.env.channel import TorchChannel
from ground_tools.atmc.env.deciders import Decider, Fixed, Rule, settle
from ground_tools.atmc.env.environment import Env, EnvSettings, Observation
from ground_tools.atmc.env.flat_observation import flat
from ground_tools.atmc.env.objective import Objective, PaperObjective, awareness_objective, costs
from ground_tools.atmc.env.plugged import Plugged
from ground_tools.atmc.env.search import search
from ground_tools.atmc.env.tasks import REGIONS, ObjectiveName, RegionName
from ground_tools.atmc.env.world import SIDES_M, WorldSettings
from ground_tools.atmc.learners.set_network import SetNet
from ground_tools.atmc.learners.stack import thawed
from sitl_mocks.channel.parameters import ChannelParameters

ROUNDS, COUNTED, PARTS = 6, 2, 4
"""For policies that decide at random phases: rounds at each set of positions, final rounds that count, and
parts of the fleet per round."""
_CELLS = 200_000
"""Pairs of aircraft computed at a time."""
_SEARCH_ROUNDS = 60
_TIMED = 2_000
_FLIGHT_STEPS, _FLIGHT_STEP_S, _MINUTE_S = 120, 1.0, 60.0


@dataclass(frozen=True, slots=True)
class Question:
    """Parameters of a measurement."""

    objective: ObjectiveName
    region: RegionName = "none"
    uavs: int = 10
    load: float = 0.0
    samples: int = 1000
    """Sets of positions in each of the paper's six squares."""
    seed: int = 1
    sigma_db: float = 0.0
    wifi_channels: Literal["shared", "random"] = "shared"
    guarded: bool = False
    """Whether the policy decides with the guard that is used aboard (`companion.atmc.audible`)."""


class Frozen:
    """A policy file that decides for whole fleets. A `Decider`.

    Args:
        data: Contents of the policy file.
        name: Name of the file, for error messages.
        allowed: (actions,), which actions may be chosen; None for all.
        guarded: As in `Question`.
    """

    def __init__(
        self, data: bytes, name: str, allowed: Tensor | None = None, *, guarded: bool = False
    ) -> None:
        self.policy: Policy = load(data, name)
        self.metadata: Metadata = self.policy.metadata
        self._columns = [NEIGHBOUR_COLUMNS.index(c) for c in self.metadata.neighbour_columns]
        self._own = [OWN_COLUMNS.index(c) for c in self.metadata.own_columns]
        count = len(self.metadata.actions)
        allowed = torch.ones(count, dtype=torch.bool) if allowed is None else allowed
        self._refused = torch.where(allowed, 0.0, -torch.inf)
        loud = torch.from_numpy(audible(self.metadata.actions, allowed.numpy())) if guarded else allowed
        self._refused_of_few = torch.where(loud, 0.0, -torch.inf)
        if self.metadata.kind == "flat":
            self._stack = thawed(data, name)
            return
        _, tensors = policy_file.read(data, name)
        self._net = SetNet(len(self._columns), len(self._own), count)
        self._net.load_state_dict({key: torch.from_numpy(value) for key, value in tensors.items()})

    def decide(self, seen: Observation, action: Tensor) -> Tensor:
        """See `Decider.decide`."""
        with torch.no_grad():
            if self.metadata.kind == "flat":
                values = self._stack.of_all(flat(seen))
            else:
                values = self._net(seen.own[..., self._own], seen.rows[..., self._columns], seen.heard)
        few = ((seen.heard > 0).sum(-1) < CROWD)[..., None]
        values = values + torch.where(few, self._refused_of_few, self._refused)
        stay = torch.nn.functional.one_hot(action, values.shape[-1]) * self.metadata.switch_price
        return (values + stay).argmax(-1)


def evaluate(data: bytes, name: str, question: Question) -> dict[str, float | int | str]:
    """Measure a policy. Returns everything that `ground-tools atmc evaluate` prints.

    Raises:
        ConfigError: The policy does not fit the question.
    """
    fleet = Frozen(data, name)
    _check(fleet.metadata, question, name)
    objective, actions = objective_of(question.objective)
    if fleet.metadata.actions != tuple(actions):
        raise ConfigError(
            f"{name}: the policy's actions are not those of the objective {question.objective!r}"
        )
    allowed = torch.from_numpy(legal(actions, REGIONS[question.region]))
    if not allowed.any():
        raise ConfigError(
            f"--region: {question.region}: none of the policy's actions is legal in this region"
        )
    fleet = Frozen(data, name, allowed, guarded=question.guarded)
    found = _measured(question, fleet, fleet.metadata.decisions, fleet.metadata.name, allowed)
    return found | {
        "decision_us_median": decision_us(fleet.policy, question.uavs - 1, _rows_of(fleet.policy)),
        "switches_per_min": switches_per_minute(question, objective, fleet),
    }


def evaluate_plugin(policy: PluginPolicy, question: Question) -> dict[str, float | int | str]:
    """Measure the policy of a plug-in, as `evaluate` does that of a file. It decides at random phases.

    Raises:
        ConfigError: The policy does not fit the question, or fails.
    """
    objective, actions = objective_of(question.objective)
    if policy.actions != tuple(actions):
        raise ConfigError(
            f"policy {policy.plugin}: its actions are not those of the objective {question.objective!r}"
        )
    allowed = legal(actions, REGIONS[question.region])
    if not allowed.any():
        raise ConfigError(f"--region: {question.region}: none of the policy's actions is legal there")
    fleet = Plugged(policy, allowed, guarded=question.guarded)
    found = _measured(question, fleet, "phases", policy.plugin.name, torch.from_numpy(allowed))
    rows = np.zeros((0, len(NEIGHBOUR_COLUMNS)))
    return found | {
        "decision_us_median": decision_us(policy, question.uavs - 1, (np.zeros(len(OWN_COLUMNS)), rows)),
        "switches_per_min": switches_per_minute(question, objective, fleet),
    }


def objective_of_plugin(policy: PluginPolicy) -> ObjectiveName:
    """The objective that has the actions of a policy.

    Raises:
        ConfigError: Neither has.
    """
    known: dict[tuple[Action, ...], ObjectiveName] = {PAPER_ACTIONS: "paper", SET_ACTIONS: "awareness"}
    if policy.actions not in known:
        raise ConfigError(
            f"policy {policy.plugin}: it cannot be evaluated: its actions are neither "
            "companion.atmc.actions.PAPER_ACTIONS nor SET_ACTIONS"
        )
    return known[policy.actions]


def _measured(
    question: Question, fleet: Decider, decisions: str, name: str, allowed: Tensor
) -> dict[str, float | int | str]:
    """The question and the costs of all methods.

    Args:
        decisions: whether the fleet decides "together" or at random "phases".
        name: of the policy.
        allowed: (actions,), which actions may be chosen.
    """
    objective, actions = objective_of(question.objective)
    found = Places()
    for side in SIDES_M:
        found.squares.append(_measure_side(question, objective, fleet, decisions, allowed, side))
    return {
        "policy": name,
        "objective": question.objective,
        "region": question.region,
        "uavs": question.uavs,
        "load": question.load,
        "samples": question.samples,
        "seed": question.seed,
        **found.report(allowed.numpy(), actions),
    }


def objective_of(name: ObjectiveName) -> tuple[Objective, Sequence[Action]]:
    """The objective of this name with its channel, and its actions."""
    if name == "paper":
        return PaperObjective(TorchChannel(ChannelParameters(), PAPER_ACTIONS)), PAPER_ACTIONS
    return awareness_objective(), SET_ACTIONS


def rule_of(name: ObjectiveName, actions: Sequence[Action], allowed: Tensor) -> Rule:
    """The one-line rule. An action that is not allowed is replaced by the last one that is."""
    near, far = (PAPER_NEAR, PAPER_FAR) if name == "paper" else (FLYING_NEAR, FLYING_FAR)
    legal_actions = [action for action, fits in zip(actions, allowed.tolist(), strict=True) if fits]
    near, far = (action if action in legal_actions else legal_actions[-1] for action in (near, far))
    return Rule(actions, near, far, BLE4_RANGE_M)


def _check(metadata: Metadata, question: Question, name: str) -> None:
    if metadata.kind == "flat" and question.uavs != metadata.neighbours + 1:
        raise ConfigError(
            f"--uavs: {question.uavs} is not allowed; "
            f"{name} works for exactly {metadata.neighbours + 1} aircraft"
        )
    if question.uavs > metadata.neighbours + 1:
        raise ConfigError(
            f"--uavs: {question.uavs} is too many; "
            f"{name} was trained with up to {metadata.neighbours + 1} aircraft"
        )
    if metadata.objective != question.objective:
        raise ConfigError(
            f"--objective: {question.objective}: {name} was trained for {metadata.objective!r}; "
            "the two objectives have different actions"
        )


def _measure_side(
    question: Question,
    objective: Objective,
    fleet: Decider,
    decisions: str,
    allowed: Tensor,
    side: float,
) -> Square:
    """Measure all methods at the same positions in one square."""
    seed = (question.seed * 1_000_003 + int(side)) * 1_000_003 % 2**63
    generator = torch.Generator().manual_seed(seed)
    chunk = max(1, min(question.samples, _CELLS // question.uavs**2))
    names = ("policy", "rule", "search")
    found: dict[str, list[Tensor]] = {name: [] for name in (*names, "weight")}
    fixed: list[Tensor] = []
    settings = _settings(question, side)
    env: Env | None = None
    done = 0
    while done < question.samples:
        some = min(chunk, question.samples - done)
        if env is None or env.environments != some:
            env = Env(settings, objective, some, question.uavs, generator)
            env.action = allowed.nonzero()[:, 0][env.action % int(allowed.sum())]
            _decide(env, fleet, decisions, generator)
        # Reseed, so that positions are the same for every policy, however many random numbers it has drawn.
        generator.manual_seed((seed + done) % 2**63)
        env.go_on()
        found["policy"].append(_decide(env, fleet, decisions, generator))
        policy = env.action
        rule = rule_of(question.objective, objective.channel.actions, allowed)
        found["rule"].append(_decide(env, rule, "phases", generator))
        ruled = env.action
        each = torch.stack(
            [costs(objective, env.air, torch.full_like(policy, k)).sum(1) for k in range(len(allowed))]
        ).double()
        best = int(each.sum(1).masked_fill(~allowed, torch.inf).argmin())
        starts = [policy, ruled, torch.full_like(policy, best)]
        floor = search(objective, env.air, starts, allowed, generator, _SEARCH_ROUNDS)
        found["search"].append(costs(objective, env.air, floor).sum(1))
        fixed.append(each)
        weighs = question.objective == "awareness"
        found["weight"].append(env.air.weight.sum((1, 2)) if weighs else torch.ones(some))
        env.action = policy
        done += some
    each_place = {name: torch.cat(parts).double().numpy() for name, parts in found.items()}
    weight = each_place.pop("weight")
    return Square(each_place, torch.cat(fixed, 1).numpy(), weight)


def _settings(question: Question, side: float) -> EnvSettings:
    world = WorldSettings(
        sides=side,
        shadowing_sigma_db=(question.sigma_db, question.sigma_db),
        wifi_channels=question.wifi_channels,
        load=(question.load, question.load),
    )
    return EnvSettings(world=world, lossy=question.objective == "awareness")


def _decide(env: Env, decider: Decider, decisions: str, generator: torch.Generator) -> Tensor:
    """Sum of each fleet's costs (s), (E,), after it has decided, averaged over the last rounds."""
    if decisions == "together":
        return env.act(decider.decide(env.observe(), env.action)).sum(1)
    rounds = 1 if isinstance(decider, Fixed | Rule) else ROUNDS
    last = settle(env, decider, rounds, generator, parts=PARTS)[-COUNTED * PARTS :]
    if rounds == 1:
        return last[-1].sum(1)
    return torch.stack([cost.sum(1) for cost in last]).mean(0)


def _rows_of(policy: Policy) -> tuple[Floats, Floats]:
    """An own row and neighbour rows for a policy, from its golden cases."""
    golden = policy.metadata.golden
    return np.array(golden[0].own), np.array([row for case in golden for row in case.rows])


def decision_us(policy: Mind, neighbours: int, seen: tuple[Floats, Floats]) -> float:
    """Median time (us) of one decision with the code that flies: NumPy, one thread, on this machine.

    Args:
        seen: an own row, and neighbour rows that are repeated up to the number of neighbours.
    """
    own, rows = seen
    rows = np.resize(rows, (neighbours, len(NEIGHBOUR_COLUMNS))) if len(rows) else np.zeros((0, 8))
    allowed = np.ones(len(policy.actions), bool)
    times = []
    for _ in range(_TIMED):
        began = time.perf_counter()
        policy.choose(own, rows, allowed, 0)
        times.append(time.perf_counter() - began)
    return round(1e6 * float(np.median(times)), 2)


def switches_per_minute(question: Question, objective: Objective, decider: Decider) -> float:
    """How often an aircraft changes its action per minute, on average.

    Fleets fly through squares of all sizes at up to 20 m/s, and each aircraft decides at random times, every
    two seconds on average.
    """
    generator = torch.Generator().manual_seed(question.seed)
    fleets = max(6, min(60, _CELLS // 8 // question.uavs**2))
    switches = decided = 0.0
    for side in SIDES_M:
        s = _settings(question, side)
        settings = EnvSettings(world=s.world, positions="flown", step_s=_FLIGHT_STEP_S, lossy=s.lossy)
        env = Env(settings, objective, fleets // 6, question.uavs, generator)
        settle(env, decider, 1, generator)
        for _ in range(_FLIGHT_STEPS // 6):
            before = env.action
            moving = torch.rand(before.shape, generator=generator) < 0.5
            env.action = torch.where(moving, decider.decide(env.observe(), before), before)
            switches += float((env.action != before).sum())
            decided += before.numel() * _FLIGHT_STEP_S
            env.go_on()
    return round(_MINUTE_S * switches / decided, 3)


def read_policy(path: Path) -> bytes:
    """The bytes of a policy file.

    Raises:
        ConfigError: The file cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
