"""The state of many environments: aircraft positions and motion, shadowing, Wi-Fi channels, and load."""

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
"""Sides of the paper's squares (m)."""
MIN_ALTITUDE_M, MAX_ALTITUDE_M = 30.0, 120.0
MAX_SPEED_MPS = 20.0
_MAX_CLIMB_MPS = 2.0
_MIN_DISTANCE_M = 1.0


Sigma = Annotated[float, Meta(ge=0)]
Load = Annotated[float, Meta(ge=0, lt=1)]
Share = Annotated[float, Meta(ge=0, le=1)]


class WorldSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Distributions from which each environment is drawn."""

    sides: Literal["paper", "any"] | Annotated[float, Meta(gt=0)] = "paper"
    """Side of the square. "paper": one of the paper's six; "any": log-uniform between the smallest and the
    largest of them; a number: this many metres."""
    shadowing_sigma_db: tuple[Sigma, Sigma] = (0.0, 0.0)
    """Range of the shadowing's standard deviation (dB), drawn uniformly for each environment."""
    wifi_channels: Literal["shared", "random", "either"] = "shared"
    """"shared": all aircraft use one channel; "random": each has a random one; "either": an environment is
    "random" with probability 1/4, else "shared"."""
    load: tuple[Load, Load] = (0.0, 0.0)
    """Range of the share of time that foreign transmissions fill the Wi-Fi channel. With probability one half
    the share is the lower bound, otherwise it is drawn uniformly."""
    bluetooth_load: tuple[Share, Share] = (0.35, 0.35)
    """Range of the background load of the Bluetooth channels, as a fraction of the Wi-Fi load."""


@dataclass(frozen=True, slots=True)
class World:
    """A batch of E environments with N aircraft each."""

    position_m: Tensor
    """Positions, (E, N, 3)."""
    velocity_mps: Tensor
    """Velocities, (E, N, 3)."""
    side_m: Tensor
    """Sides of the squares, (E,)."""
    shadowing_db: Tensor
    """Shadowing of each link, (E, N, N), symmetric."""
    wifi_channel: Tensor
    """Index of each aircraft's Wi-Fi channel, (E, N)."""
    busy: Tensor
    """Share of time that foreign transmissions fill each mode's channel, (E, N, 3)."""

    def distance_m(self) -> Tensor:
        """Distances between aircraft, at least 1 m, (E, N, N)."""
        apart = self.position_m[:, :, None] - self.position_m[:, None]
        return apart.square().sum(-1).sqrt().clamp(min=_MIN_DISTANCE_M)

    def closing_mps(self, distance_m: Tensor) -> Tensor:
        """Speed at which each distance decreases, (E, N, N)."""
        apart = self.position_m[:, :, None] - self.position_m[:, None]
        relative = self.velocity_mps[:, :, None] - self.velocity_mps[:, None]
        return -(apart * relative).sum(-1) / distance_m


def draw(settings: WorldSettings, environments: int, aircraft: int, generator: torch.Generator) -> World:
    """Draw new environments on the generator's device."""
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
    """The same environments with all aircraft at new random positions (the paper's step)."""
    unit = torch.rand(world.position_m.shape, generator=generator, device=generator.device)
    level = unit[..., :2] * world.side_m[:, None, None]
    height = MIN_ALTITUDE_M + (MAX_ALTITUDE_M - MIN_ALTITUDE_M) * unit[..., 2:]
    return replace(world, position_m=torch.cat([level, height], -1))


def move(world: World, seconds: float) -> World:
    """Let all aircraft fly for this time; they are reflected at the edges."""
    side = world.side_m[:, None, None]
    low = torch.tensor([0.0, 0.0, MIN_ALTITUDE_M], device=side.device)
    extent = torch.cat([side.expand(-1, 1, 2), torch.full_like(side, MAX_ALTITUDE_M - MIN_ALTITUDE_M)], -1)
    # Fold over twice the extent, because an aircraft may cross a small square several times in one step.
    along = (world.position_m - low + world.velocity_mps * seconds) % (2.0 * extent)
    back = along > extent
    return replace(
        world,
        position_m=low + torch.where(back, 2.0 * extent - along, along),
        velocity_mps=torch.where(back, -world.velocity_mps, world.velocity_mps),
    )
