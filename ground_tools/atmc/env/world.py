"""Where the aircraft of many environments are, how they move, and what the radio makes of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import msgspec
import torch
from msgspec import Meta
from torch import Tensor

from sitl_mocks.channel.parameters import WIFI_CHANNELS

SIDES_M = (100.0, 500.0, 1000.0, 3000.0, 5000.0, 10000.0)
"""Of the paper's squares."""
MIN_ALTITUDE_M, MAX_ALTITUDE_M = 30.0, 120.0
MAX_SPEED_MPS = 20.0
_MAX_CLIMB_MPS = 2.0
_MIN_DISTANCE_M = 1.0


Sigma = Annotated[float, Meta(ge=0)]
Load = Annotated[float, Meta(ge=0, lt=1)]
Share = Annotated[float, Meta(ge=0, le=1)]


class WorldSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is drawn for each environment."""

    sides: Literal["paper", "any"] | Annotated[float, Meta(gt=0)] = "paper"
    """Side of the square: one of the paper's six; log-uniform between the least and the greatest of them; or
    this many metres."""
    shadowing_sigma_db: tuple[Sigma, Sigma] = (0.0, 0.0)
    """Drawn uniformly between these for each environment."""
    wifi_channels: Literal["shared", "random", "either"] = "shared"
    """"either": in three of four environments all share one, in the fourth each has a random one."""
    load: tuple[Load, Load] = (0.0, 0.0)
    """Share of time that others fill the Wi-Fi channel; drawn uniformly, but in half of the environments the
    lower bound."""
    bluetooth_load: tuple[Share, Share] = (0.35, 0.35)
    """The Bluetooth channels' share, as a fraction of Wi-Fi's."""


@dataclass(frozen=True, slots=True)
class World:
    """A batch of environments; E of them with N aircraft each."""

    position_m: Tensor
    """(E, N, 3)."""
    velocity_mps: Tensor
    """(E, N, 3)."""
    side_m: Tensor
    """(E,)."""
    shadowing_db: Tensor
    """(E, N, N), symmetric."""
    wifi_channel: Tensor
    """(E, N)."""
    busy: Tensor
    """(E, N, 3): share of time that others fill each mode's channel."""

    def distance_m(self) -> Tensor:
        """(E, N, N)."""
        apart = self.position_m[:, :, None] - self.position_m[:, None]
        return apart.square().sum(-1).sqrt().clamp(min=_MIN_DISTANCE_M)

    def closing_mps(self, distance_m: Tensor) -> Tensor:
        """(E, N, N): speed at which each distance shrinks."""
        apart = self.position_m[:, :, None] - self.position_m[:, None]
        relative = self.velocity_mps[:, :, None] - self.velocity_mps[:, None]
        return -(apart * relative).sum(-1) / distance_m


def draw(settings: WorldSettings, environments: int, aircraft: int, generator: torch.Generator) -> World:
    """New environments, on the generator's device."""
    device = generator.device

    def uniform(*shape: int, low: float = 0.0, high: float = 1.0) -> Tensor:
        return low + (high - low) * torch.rand(shape, generator=generator, device=device)

    if settings.sides == "paper":
        sides = torch.tensor(SIDES_M, device=device)
        side = sides[torch.randint(len(SIDES_M), (environments,), generator=generator, device=device)]
    elif settings.sides == "any":
        side = torch.exp(uniform(environments, low=math.log(SIDES_M[0]), high=math.log(SIDES_M[-1])))
    else:
        side = torch.full((environments,), settings.sides, device=device)
    unit = uniform(environments, aircraft, 3)
    level = unit[..., :2] * side[:, None, None]
    height = MIN_ALTITUDE_M + (MAX_ALTITUDE_M - MIN_ALTITUDE_M) * unit[..., 2:]
    heading, speed = uniform(environments, aircraft, high=2.0 * math.pi), uniform(environments, aircraft)
    speed = speed * MAX_SPEED_MPS
    climb = uniform(environments, aircraft, low=-_MAX_CLIMB_MPS, high=_MAX_CLIMB_MPS)
    velocity = torch.stack([speed * heading.cos(), speed * heading.sin(), climb], -1)
    low, high = settings.shadowing_sigma_db
    shadowing = torch.zeros(environments, aircraft, aircraft, device=device)
    if high > 0.0:
        normal = torch.randn(shadowing.shape, generator=generator, device=device)
        upper = torch.triu(normal, 1)
        shadowing = (upper + upper.transpose(1, 2)) * uniform(environments, 1, 1, low=low, high=high)
    channel = torch.ones(environments, aircraft, dtype=torch.long, device=device)
    if settings.wifi_channels != "shared":
        drawn = torch.randint(
            len(WIFI_CHANNELS), (environments, aircraft), generator=generator, device=device
        )
        share = 1.0 if settings.wifi_channels == "random" else 0.25
        channel = torch.where(uniform(environments, 1) < share, drawn, channel)
    low, high = settings.load
    load = torch.where(uniform(environments) < 0.5, low, uniform(environments, low=low, high=high))
    low, high = settings.bluetooth_load
    bluetooth = load * uniform(environments, low=low, high=high)
    busy = torch.stack([bluetooth, bluetooth, load], -1)[:, None].expand(environments, aircraft, 3)
    return World(torch.cat([level, height], -1), velocity, side, shadowing, channel, busy)


def redraw(world: World, generator: torch.Generator) -> World:
    """The same environments with all aircraft at new places (the paper's step)."""
    unit = torch.rand(world.position_m.shape, generator=generator, device=generator.device)
    level = unit[..., :2] * world.side_m[:, None, None]
    height = MIN_ALTITUDE_M + (MAX_ALTITUDE_M - MIN_ALTITUDE_M) * unit[..., 2:]
    return replace(world, position_m=torch.cat([level, height], -1))


def move(world: World, seconds: float) -> World:
    """All aircraft fly on, and turn back at the edges."""
    side = world.side_m[:, None, None]
    low = torch.tensor([0.0, 0.0, MIN_ALTITUDE_M], device=side.device)
    extent = torch.cat([side.expand(-1, 1, 2), torch.full_like(side, MAX_ALTITUDE_M - MIN_ALTITUDE_M)], -1)
    # Reflected as in two mirrors: an aircraft may cross a small square several times in one step.
    along = (world.position_m - low + world.velocity_mps * seconds) % (2.0 * extent)
    back = along > extent
    return replace(
        world,
        position_m=low + torch.where(back, 2.0 * extent - along, along),
        velocity_mps=torch.where(back, -world.velocity_mps, world.velocity_mps),
    )
