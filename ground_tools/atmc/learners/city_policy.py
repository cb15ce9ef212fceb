"""Training of the set network for a city: 50 to 500 aircraft, foreign load, others that do not adapt.

`flying_policy` with two differences. Its fleets are cut-outs of a city, and the cost of messages is not the
age of information alone. Old information costs room, because the law's volumes grow with its age. An aircraft
that is not known costs no room, but a loss of separation if both meet soon. Training begins with the weights
of the policy that is shipped.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import msgspec
import torch
from torch import Tensor

from companion.atmc.actions import SET_ACTIONS
from companion.atmc.policy_file import read
from companion.atmc.rule import FIXED_SETS
from companion.avoidance.kernels.neighbours import KEPT_S
from companion.shipped import shipped
from ground_tools.atmc.env.channel import TorchChannel
from ground_tools.atmc.env.deciders import Decider, settle
from ground_tools.atmc.env.environment import Env, EnvSettings
from ground_tools.atmc.env.objective import AwarenessObjective, costs
from ground_tools.atmc.env.tasks import AWARENESS_CHANNEL
from ground_tools.atmc.env.torch_setup import set_up_torch
from ground_tools.atmc.env.world import MAX_SPEED_MPS, World, WorldSettings
from ground_tools.atmc.learners.flying_policy import FlyingLearner, FlyingSettings

BEGINS_WITH: Final = "config/policies/atmc.safetensors"
UNHEARD_S: Final = 60.0
"""Cost of a pair that is about to meet and of which one does not know the other, as an age."""
_SOON: Final = 4
"""Power of the conflict weight with which an unheard pair counts: it is one half 5 s before a conflict, that
of old information 10 s before it."""
_DENSITIES: Final = (3.0, 100.0)
"""Aircraft per square kilometre, log-uniform."""
_SPEED_MPS: Final = 15.0
_FIXED: Final = SET_ACTIONS.index(FIXED_SETS[0])
CITY_FLEETS: Final = (*(3 * ((50, 16), (100, 5), (200, 1))), (50, 16), (100, 5), (500, 1))
_SETTINGS: Final = EnvSettings(
    world=WorldSettings(sides="any", load=(0.0, 0.8), bluetooth_load=(0.35, 0.35)),
    positions="flown",
    step_s=2.0,
    lossy=True,
)
_CASES: Final = tuple(
    (aircraft, density, load)
    for aircraft, densities in ((100, (10.0, 30.0, 100.0)), (200, (10.0, 30.0)))
    for density in densities
    for load in (0.0, 0.6)
)
_VALIDATED: Final = 2
"""Fleets of each case of the validation."""


def price_s(rate: Tensor, weight: Tensor) -> Tensor:
    """Expected cost (s) of a pair's information, received at `rate` (1/s) and of this conflict weight.

    The age A of the latest message is exponential. A track is used for KEPT_S: until then the law's volume
    grows with the age, and the cost is A times the weight. After it, the aircraft is not known.
    """
    at = rate.clamp(min=1e-4) * KEPT_S
    lost = torch.exp(-at)
    return weight * KEPT_S * (1.0 - lost * (1.0 + at)) / at + weight**_SOON * UNHEARD_S * lost


class CityObjective(AwarenessObjective):
    """The sum over receivers of `price_s`."""

    def cost(self, rate: Tensor, weight: Tensor) -> Tensor:
        """See `AwarenessObjective.cost`."""
        return price_s(rate, weight)


def city_objective(device: torch.device | str = "cpu") -> CityObjective:
    """The objective with the channel and the actions of the policy that flies."""
    return CityObjective(TorchChannel(AWARENESS_CHANNEL, SET_ACTIONS, torch.device(device)))


class CityEnv(Env):
    """Squares of a city at random densities. In half of them a share of the aircraft never adapts."""

    def reset(self) -> None:
        """See `Env.reset`."""
        super().reset()
        shape, g = (self.environments, self.aircraft), self._generator
        low, high = (math.log(density) for density in _DENSITIES)
        log_density = low + (high - low) * torch.rand(shape[0], generator=g, device=g.device)
        self.place(scaled(self.world, torch.exp(log_density)))
        share = 2.0 * torch.rand((shape[0], 1), generator=g, device=g.device) - 1.0
        self.stubborn = torch.rand(shape, generator=g, device=g.device) < share
        """Which aircraft never adapt, (E, N): from none to all but a few of those of an environment."""
        drawn = torch.randint(len(SET_ACTIONS), (shape[0], 1), generator=g, device=g.device)
        usual = torch.rand((shape[0], 1), generator=g, device=g.device) < 0.5
        self._theirs = torch.where(usual, _FIXED, drawn)
        self.hold()

    def hold(self) -> None:
        """Give those who never adapt their action again: the fixed set in half of the environments, else
        another one, the same for all of them."""
        self.action = torch.where(self.stubborn, self._theirs, self.action)

    def state(self) -> dict[str, Any]:
        """See `Env.state`."""
        return {**super().state(), "stubborn": self.stubborn, "theirs": self._theirs}

    def load(self, state: dict[str, Any]) -> None:
        """See `Env.load`."""
        super().load(state)
        self.stubborn, self._theirs = state["stubborn"], state["theirs"]


def scaled(world: World, per_km2: Tensor) -> World:
    """The same fleets at these densities (E,), with a city's speeds."""
    side = 1000.0 * torch.sqrt(world.position_m.shape[1] / per_km2)
    position, velocity = world.position_m.clone(), world.velocity_mps.clone()
    position[..., :2] *= (side / world.side_m)[:, None, None]
    velocity[..., :2] *= _SPEED_MPS / MAX_SPEED_MPS
    return replace(world, position_m=position, velocity_mps=velocity, side_m=side)


def city_settings() -> FlyingSettings:
    """The default settings."""
    return FlyingSettings(
        fleets=CITY_FLEETS,
        episodes=40,
        updates=60,
        average=0.995,
        regret_limit_s=5.0,
        clip=125.0,
    )


class CityLearner(FlyingLearner):
    """Trains the set network for a city. A `Learner`."""

    def __init__(self, settings: FlyingSettings, seed: int, device: torch.device | str = "cpu") -> None:
        if settings.objective != "awareness":
            raise ValueError("a policy for a city chooses among sets of transports: objective awareness")
        super().__init__(settings, seed, device)
        self.take(shipped(BEGINS_WITH))
        self._objective = city_objective(device)
        self._groups = [
            self._group(CityEnv(_SETTINGS, self._objective, fleets, aircraft, self._generator))
            for aircraft, fleets in settings.fleets
        ]
        self._draws = torch.Generator(self._device)
        self._cases_s: list[tuple[Env, float]] = []

    def take(self, path: Path) -> None:
        """Take the weights of a policy file."""
        _, tensors = read(path.read_bytes(), path.name)
        weights = {name: torch.from_numpy(values.copy()) for name, values in tensors.items()}
        for net in (self._net, self._average):
            net.load_state_dict(weights)

    def _act(self, group: Any, acting: Tensor, greedy: Tensor, share: float) -> None:
        super()._act(group, acting, greedy, share)
        group.env.hold()

    def validate(self) -> dict[str, float]:
        """See `Learner.validate`. "score" is the mean cost beyond that of the fixed set (%) over fleets that
        are the same every time."""
        draws = self._draws.manual_seed(1_000_003)
        if not self._cases_s:
            self._cases_s = [self._case(*case, draws) for case in _CASES]
            draws.manual_seed(1_000_003)
        found = [100.0 * (_settled(env, self, draws) / cost_s - 1.0) for env, cost_s in self._cases_s]
        return {"score": sum(found) / len(found)}

    def _case(
        self, aircraft: int, per_km2: float, load: float, generator: torch.Generator
    ) -> tuple[Env, float]:
        world = WorldSettings(sides=1000.0, load=(load, load))
        env = Env(EnvSettings(world=world, lossy=True), self._objective, _VALIDATED, aircraft, generator)
        env.place(scaled(env.world, torch.full((_VALIDATED,), per_km2, device=self._device)))
        fixed = torch.full_like(env.action, _FIXED)
        return env, float(costs(self._objective, env.air, fixed).sum())


def _settled(env: Env, decider: Decider, generator: torch.Generator) -> float:
    """Cost (s) of fleets that begin with the fixed set and decide four times."""
    env.action = torch.full_like(env.action, _FIXED)
    last = settle(env, decider, 4, generator)[-4:]
    return float(torch.stack([cost.sum() for cost in last]).mean())


def sample(path: Path) -> list[str]:
    """Validate a kept policy again. Returns the differences, as text."""
    set_up_torch()
    metadata, _ = read(path.read_bytes(), path.name)
    few = msgspec.structs.replace(city_settings(), fleets=((2, 1),))
    learner = CityLearner(few, 1)
    learner.take(path)
    again = learner.validate()
    return [
        f"{name}: {value:g}, now {again[name]:g}"
        for name, value in metadata.results.items()
        if value != again[name]
    ]
