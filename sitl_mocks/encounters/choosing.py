"""Choice of transports for simulated aircraft: command options, policy file, random chooser and statistics.

Only `read_policy` and `keep` access files. The simulation receives the policy's bytes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from companion.arrays import AnyFloats, Bools
from companion.atmc import policy_file
from companion.atmc.actions import SET_ACTIONS, Action, legal
from companion.atmc.choice import Choice, Refused, Why
from companion.atmc.plugin_policy import plugin_policy, try_out
from companion.atmc.policy import load
from companion.config import Config, IdentityConfig, names_file
from companion.errors import ConfigError
from companion.event_record import Record, Step
from companion.events import BroadcastChanged, TransportsChosen
from companion.runtime.policy import RUN_FILE
from companion.runtime.policy import read_policy as read_file
from companion.shipped import given
from sitl_mocks.encounters import scenario_file
from sitl_mocks.encounters.scenario_file import POLICY_WORDS, Scenario

SILENT: Final = "nothing"
"""Name for the empty set of transports."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that select the policy and the region."""
    parser.add_argument(
        "--policy",
        metavar=f"FILE|{'|'.join(POLICY_WORDS)}|plugin:NAME",
        help="what chooses each aircraft's transports in flight (default: they stay fixed)",
    )
    parser.add_argument(
        "--region", type=given, metavar="FILE", help="region profile (default: no legal rules)"
    )


def with_options(scenario: Scenario, arguments: argparse.Namespace) -> Scenario:
    """Apply the options to a scenario.

    Raises:
        ConfigError: the region's profile cannot be read or is wrong.
    """
    policy, region = arguments.policy, arguments.region
    if policy is not None:
        file = names_file(policy) and policy not in POLICY_WORDS
        where = str(given(policy).absolute()) if file else policy
        atmc = msgspec.structs.replace(scenario.atmc, policy=where)
        scenario = msgspec.structs.replace(scenario, atmc=atmc)
    if region is not None:
        try:
            scenario = msgspec.structs.replace(scenario, region=scenario_file.load_region(region))
        except ConfigError as error:
            raise ConfigError(f"--region: {error}") from error
    return scenario


def read_policy(scenario: Scenario) -> bytes | None:
    """Read and check the scenario's policy file. Returns None if no file is named.

    Raises:
        ConfigError: the file cannot be read or is no usable policy, or none of its actions is legal in the
            scenario's region.
    """
    where = scenario.atmc.policy
    plugged = plugin_policy(where)
    if plugged is not None:
        try_out(plugged, scenario.region)
    if where is None or where in POLICY_WORDS or plugged is not None:
        return None
    data = read_file(Config(identity=IdentityConfig(uas_id="any"), atmc=scenario.atmc))
    assert data is not None
    policy = load(data, where)
    agents, aircraft = policy.metadata.agents, len(scenario.path) or scenario.aircraft
    if 1 < agents < aircraft:
        raise ConfigError(
            f"atmc.policy: {where}: holds {agents} networks, one for each aircraft; "
            f"the scenario has {aircraft} aircraft"
        )
    if not legal(policy.actions, scenario.region).any():
        raise ConfigError(
            f"atmc.policy: {where}: none of its actions is legal in region {scenario.region.name}"
        )
    return data


def with_agent(config: Config, policy: bytes | None, number: int) -> Config:
    """The configuration with `atmc.agent` set, if the policy holds one network for each aircraft.

    More aircraft than networks use the networks again, in order.
    """
    agents = 1 if policy is None else policy_file.read(policy, "policy")[0].agents
    if agents == 1:
        return config
    return msgspec.structs.replace(config, atmc=msgspec.structs.replace(config.atmc, agent=number % agents))


def keep(folder: Path, scenario: Scenario, policy: bytes | None) -> Scenario:
    """Copy the policy's file to the run folder, and return the scenario that refers to the copy."""
    if policy is None:
        return scenario
    (folder / RUN_FILE).write_bytes(policy)
    atmc = msgspec.structs.replace(scenario.atmc, policy=RUN_FILE)
    return msgspec.structs.replace(scenario, atmc=atmc)


@dataclass(slots=True)
class RandomMind:
    """A `Mind` for comparison that chooses any allowed action with equal probability. It never flies."""

    rng: np.random.Generator

    @property
    def actions(self) -> tuple[Action, ...]:
        """Actions that it can choose."""
        return SET_ACTIONS

    def choose(
        self,
        own_row: AnyFloats,
        neighbour_rows: AnyFloats,
        allowed: Bools,
        current: int | None,
        agent: int = 0,
    ) -> Choice | Refused:
        """See `Mind`. Only `allowed` is used."""
        can = np.flatnonzero(allowed)
        if not len(can):
            return Refused(Why.NOTHING_ALLOWED, "no set of transports is both legal and available")
        index = int(self.rng.choice(can))
        return Choice(index, SET_ACTIONS[index])


@dataclass(slots=True)
class Chosen:
    """Transports of one aircraft over time."""

    seconds: dict[str, float] = field(default_factory=dict)
    """Time in use (s) by set, in words."""
    switches: int = 0
    fallback_s: float = 0.0
    """Time on the fallback (s), because the configured chooser could not choose."""
    _by_fallback: bool = False
    _present: str | None = None
    _since_s: float = 0.0

    def add_step(self, step: Step) -> None:
        """Update from a step of the companion core."""
        for command in step.commands:
            if type(command) is BroadcastChanged:
                self.note(step.now_s, {name: int(rate) for name, rate in command.rates})
            elif type(command) is TransportsChosen:
                self.end(step.now_s)
                self._by_fallback = command.by == "fallback"

    def note(self, now_s: float, rates: Mapping[str, int]) -> None:
        """Record the transports in use from now on (Locations per second). An unchanged set has no effect."""
        name = words_of(rates)
        if name == self._present:
            return
        self.end(now_s)
        self.switches += self._present not in (None, SILENT)
        self._present, self._since_s = name, now_s

    def end(self, now_s: float) -> None:
        """Count the time up to now."""
        if self._present is not None and self._present != SILENT:
            self.seconds[self._present] = self.seconds.get(self._present, 0.0) + now_s - self._since_s
            if self._by_fallback:
                self.fallback_s += now_s - self._since_s
        self._since_s = now_s

    @property
    def switches_per_minute(self) -> float:
        """Switches per minute of the time in which anything was sent."""
        total_s = sum(self.seconds.values())
        return 60.0 * self.switches / total_s if total_s > 0.0 else 0.0

    def to_dict(self) -> dict[str, object]:
        """Values for a JSON line."""
        return {
            "seconds": {name: round(s, 3) for name, s in self.seconds.items()},
            "switches_per_minute": round(self.switches_per_minute, 3),
            "fallback_s": round(self.fallback_s, 3),
        }


def chosen_of(records: Iterable[Record]) -> Chosen:
    """Transports of an aircraft according to its event record."""
    chosen, now_s = Chosen(), 0.0
    for item in records:
        if isinstance(item, Step):
            now_s = item.now_s
            chosen.add_step(item)
    chosen.end(now_s)
    return chosen


def words_of(rates: Mapping[str, int]) -> str:
    """A set of transports in words, for example "ble4 10 + wifi 10"."""
    return " + ".join(f"{name} {rate:g}" for name, rate in sorted(rates.items())) or SILENT


def shares_of(chosen: Sequence[Chosen]) -> dict[str, float]:
    """Share of all aircraft's time for each set, the largest first."""
    total: dict[str, float] = {}
    for one in chosen:
        for name, seconds in one.seconds.items():
            total[name] = total.get(name, 0.0) + seconds
    whole_s = sum(total.values()) or 1.0
    return {name: s / whole_s for name, s in sorted(total.items(), key=lambda item: (-item[1], item[0]))}


def choices_in_words(chosen: Sequence[Chosen], most: int = 5) -> str:
    """Text with the sets by share of time and the number of switches per aircraft."""
    shares = list(shares_of(chosen).items())
    if not shares:
        return "transports: no Locations were sent"
    words = [f"{100.0 * share:.0f} % {name}" for name, share in shares[:most]]
    if len(shares) > most:
        words.append(f"{100.0 * sum(s for _, s in shares[most:]):.0f} % in {len(shares) - most} other sets")
    words.append(f"{mean_switches(chosen):.1f} switches per minute and aircraft")
    if fallback_share(chosen) > 0.0:
        words.append(f"{100.0 * fallback_share(chosen):.1f} % of the time on the fallback")
    return f"transports (Locations per second): {', '.join(words)}"


def fallback_share(chosen: Sequence[Chosen]) -> float:
    """Share of all aircraft's time on the fallback."""
    whole_s = sum(sum(one.seconds.values()) for one in chosen)
    return sum(one.fallback_s for one in chosen) / whole_s if whole_s > 0.0 else 0.0


def mean_switches(chosen: Sequence[Chosen]) -> float:
    """Switches per minute, averaged over aircraft."""
    return sum(one.switches_per_minute for one in chosen) / len(chosen)
