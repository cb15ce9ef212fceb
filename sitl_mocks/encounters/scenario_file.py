"""Scenario file: aircraft and their paths, the air, and the errors. Every key is checked.

Options of the command line (`--aircraft`, `--delay`, `--seed`) override the file's keys.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from companion.config import CHOOSER_WORDS, AtmcConfig, AvoidanceConfig, LimitsConfig, names_file
from companion.errors import ConfigError
from companion.laws import plugin_of
from companion.remote_id.region import Region
from companion.shipped import named, names
from companion.toml_reader import decode_toml
from sitl_mocks.air.air_settings import DEFAULT_DELAY_S, AirSettings, check_allowed, load_parameters
from sitl_mocks.channel.parameters import ChannelParameters
from sitl_mocks.vehicle.sensing import Obstacle, SensorOptions

Positive = Annotated[float, Meta(gt=0, le=1e6)]
NotNegative = Annotated[float, Meta(ge=0, le=1e6)]


class _Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base class of all sections."""


class VehicleSettings(_Section, frozen=True):
    """The simulated aircraft and its navigation errors."""

    firmware: Literal["ardupilot", "px4", "mixed"] = "mixed"
    lag_s: Annotated[float, Meta(ge=0.01, le=10)] = 0.5
    max_acceleration_mps2: Positive = 2.5
    wind_ned_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gnss_horizontal_sigma_m: NotNegative = 1.5
    gnss_vertical_sigma_m: NotNegative = 1.5
    gnss_velocity_sigma_mps: NotNegative = 0.3
    gnss_correlation_s: Positive = 30.0


class PathSettings(_Section, frozen=True):
    """One aircraft's timed path: rows of time (s), north, east, down (m)."""

    points: Annotated[tuple[tuple[float, float, float, float], ...], Meta(min_length=2)]


class Scenario(_Section, frozen=True):
    """Everything that determines a run, except the seed."""

    geometry: Literal["S1", "S2", "S3"] | None = None
    """Kind of drawn paths. Without it, `path` gives the paths."""
    aircraft: Annotated[int, Meta(ge=2, le=100)] = 5
    path: tuple[PathSettings, ...] = ()
    duration_s: Positive | None = None
    """Default: the end of the last path."""
    vehicle: VehicleSettings = VehicleSettings()
    air: AirSettings = AirSettings()
    channel: ChannelParameters | None = None
    """Content of the file that `air.parameters` names, so that a resolved scenario in a run folder needs no
    other file.
    """
    region: Region = Region()
    """Content of the file that `air.region` names."""
    atmc: AtmcConfig = AtmcConfig()
    """Choice of transports for all aircraft, as in a companion's file. `policy` may also be "random"."""
    sensor: SensorOptions | None = None
    """A sensor aboard every aircraft, which sees obstacles and the other aircraft; None: there is none."""
    obstacle: tuple[Obstacle, ...] = ()
    """Obstacles and aircraft that transmit nothing. Their times are on the paths' clock."""
    limits: LimitsConfig = LimitsConfig()
    avoidance: AvoidanceConfig = AvoidanceConfig()

    def __post_init__(self) -> None:
        if self.channel is not None and self.air.model == "interval":
            raise ValueError('channel: allowed only with air.model "analytic" or "packets"')


RANDOM = "random"
"""Value of `atmc.policy` that is allowed only here: a legal set is drawn anew at every decision."""
POLICY_WORDS = (*CHOOSER_WORDS, RANDOM)
DEFAULT = Scenario(geometry="S2", air=AirSettings(delay_s=DEFAULT_DELAY_S))
"""Five aircraft that cross in a ball of 8 m radius."""


def load(path: Path) -> Scenario:
    """Read and check a scenario file.

    Raises:
        ConfigError: the message names the file and the key.
    """
    try:
        scenario = decode_toml(path, Scenario)
    except ConfigError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            come = ", ".join(names("scenarios", ".toml"))
            raise ConfigError(f"{error}; the scenarios that come with the software: {come}") from error
        raise
    if (scenario.geometry is None) == (not scenario.path):
        raise ConfigError(f"{path}: give either geometry or path tables, not both and not neither")
    if scenario.path and len(scenario.path) < 2:
        raise ConfigError(f"{path}: path: there is only one path; allowed: 2 or more")
    for number, given in enumerate(scenario.path):
        for a, b in itertools.pairwise(given.points):
            if b[0] <= a[0]:
                raise ConfigError(f"{path}: path[{number}].points: time {b[0]:g} s is not after {a[0]:g} s")
            if not all(math.isfinite(v) for v in b):
                raise ConfigError(f"{path}: path[{number}].points: {b} contains a value that is not finite")
    try:
        plugin_of(scenario.avoidance.law)
    except ConfigError as error:
        raise ConfigError(f"{path}: avoidance.law: {error}") from error
    return _with_policy(_with_region(_with_parameters(scenario, path), path), path)


def load_region(path: Path) -> Region:
    """Read a region profile.

    Raises:
        ConfigError: the message names the file and the key.
    """
    return decode_toml(path, Region)


def _with_region(scenario: Scenario, path: Path) -> Scenario:
    """Return the scenario with the profile of its region loaded."""
    name = scenario.air.region
    if name is None:
        return scenario
    if scenario.region != Region():
        raise ConfigError(f"{path}: region: give either region or air.region, not both")
    try:
        region = load_region(named(name, "regions", ".toml", path.parent))
    except ConfigError as error:
        raise ConfigError(f"{path}: air.region: {error}") from error
    air = msgspec.structs.replace(scenario.air, region=None)
    return msgspec.structs.replace(scenario, air=air, region=region)


def _with_policy(scenario: Scenario, path: Path) -> Scenario:
    """Return the scenario with the absolute path of its policy."""
    name = scenario.atmc.policy
    if not names_file(name) or name is None or name == RANDOM:
        return scenario
    atmc = msgspec.structs.replace(
        scenario.atmc, policy=str(named(name, "policies", ".safetensors", path.parent).absolute())
    )
    return msgspec.structs.replace(scenario, atmc=atmc)


def _with_parameters(scenario: Scenario, path: Path) -> Scenario:
    """Return the scenario with its channel's parameter file loaded."""
    name = scenario.air.parameters
    if name is None:
        if scenario.channel is not None:
            try:
                check_allowed(scenario.air, scenario.channel)
            except ConfigError as error:
                raise ConfigError(f"{path}: channel: {error}") from error
        return scenario
    if scenario.channel is not None:
        raise ConfigError(f"{path}: channel: give either channel or air.parameters, not both")
    try:
        channel = load_parameters(named(name, "channel", ".toml", path.parent), scenario.air)
    except ConfigError as error:
        raise ConfigError(f"{path}: air.parameters: {error}") from error
    air = msgspec.structs.replace(scenario.air, parameters=None)
    return msgspec.structs.replace(scenario, air=air, channel=channel)
