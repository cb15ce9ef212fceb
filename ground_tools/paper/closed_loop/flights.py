"""The flights of the closed loop: one encounter or several side by side, under one condition, by one method.

The choice of transports, the radio channel, the delays, the tracks, the avoidance and the vehicles are all
those of the lock-step simulation. None of them is replaced by a simpler model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Final

import msgspec
import numpy as np

from companion.config import AtmcConfig, AvoidanceConfig, LimitsConfig
from companion.remote_id.region import Region, TransportName
from sitl_mocks.air.air_settings import AirSettings
from sitl_mocks.air.ether import Ether
from sitl_mocks.channel.parameters import BackgroundLoad, ChannelParameters
from sitl_mocks.encounters.awareness import AgeLog, awareness_of, weights_of
from sitl_mocks.encounters.choosing import Chosen, fallback_share
from sitl_mocks.encounters.draw import side_by_side
from sitl_mocks.encounters.lockstep import Run, fly, names_of
from sitl_mocks.encounters.scenario_file import PathSettings, Scenario
from sitl_mocks.encounters.verdict import deviations_of, pairs_of

SPARSE, DENSE, LOADED = "sparse", "dense", "loaded"
CONDITIONS: Final = {
    SPARSE: "nobody else on the air",
    DENSE: "many encounters side by side in one air",
    LOADED: "nobody else, but foreign transmissions fill the band",
}
LOAD: Final = BackgroundLoad(wifi=0.6, ble4=0.21, ble5=0.21)
"""Shares of time for which foreign transmissions fill the band. Bluetooth has 35 % of the share of Wi-Fi,
because it hops."""
LIMITS: Final = LimitsConfig(max_speed_mps=10.0, max_acceleration_mps2=2.0)
AVOIDANCE: Final = AvoidanceConfig(recovery_time_s=5.0)
"""With this recovery time, a vehicle that starts at rest is on its path before the crossing."""
SEPARATION_M: Final = 2.0 * AVOIDANCE.conflict_radius_m
RATE: Final = 10
"""Location messages per second of the single modes."""


@dataclass(frozen=True, slots=True)
class Method:
    """How the transports are chosen."""

    words: str
    """Display name."""
    transports: tuple[TransportName, ...] = ("ble4", "wifi")
    """Transports for the whole flight if there is no policy. With a policy they are used until its first
    choice and are the best legal set."""
    policy: str | None = None
    """The policy as in a scenario, or FILE for the policy in a file."""
    kept: str | None = None
    """One of the paper's policies, which come with the software; None: the policy that the command names."""
    avoids: bool = True


FILE: Final = "file"
UNAVOIDED, BEST_SET, ATMC = "unavoided", "best-set", "atmc"
METHODS: Final = {
    UNAVOIDED: Method("nobody avoids", ("wifi",), avoids=False),
    "ble4": Method("BLE 4 at 10", ("ble4",)),
    "ble5": Method("BLE 5 at 10", ("ble5",)),
    "wifi": Method("Wi-Fi at 10", ("wifi",)),
    BEST_SET: Method("best legal set", policy="fixed"),
    "rule": Method("rule", policy="rule"),
    "random": Method("random legal set", policy="random"),
    ATMC: Method("ATMC", policy=FILE),
    **{
        name: Method(words, policy=FILE, kept=f"results/policies/{name}.safetensors")
        for name, words in (
            ("paper-madqn", "paper's MADQN"),
            ("paper-madqn-shared", "paper's MADQN, one network"),
            ("paper-set", "paper's objective, set network"),
        )
    },
}
"""The methods. Those without a policy, and the paper's policies, which choose single modes, ignore regional
law: BLE 4 alone is legal nowhere."""


@dataclass(frozen=True, slots=True)
class Flight:
    """One run, whose encounters share one radio environment."""

    condition: str
    method: str
    seeds: tuple[int, ...]
    """Seeds of its encounters. The first one is also the seed of the run."""
    region: Region
    channel: ChannelParameters
    policy: bytes | None
    """Content of the policy file, for the method that uses one."""
    plugin: str | None = None
    """The policy of a plug-in that this method uses instead, as "plugin:NAME"."""


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """Result of one encounter."""

    encounter: int
    """Seed of the encounter."""
    run: int
    """Seed of the run that it was part of."""
    aircraft: int
    least_separation_m: float
    pairs_lost: int
    """Pairs that came nearer than `SEPARATION_M`."""
    deviation_m: float
    """Largest distance from the point of the timed path, averaged over the aircraft."""
    age_mean_s: float | None
    """Weighted mean age of information over the ordered pairs; None without avoidance."""
    age_p95_s: float | None
    age_max_s: float | None
    unheard: int
    """Ordered pairs in which nothing was received."""
    switches_per_minute: float
    seconds: dict[str, float]
    """Time of all its aircraft on each transport set."""
    fallback_share: float = 0.0
    """Share of that time on the fall-back set, because the policy could not choose."""


def region_of(flight: Flight) -> Region:
    """The region whose law the aircraft of a flight obey; `Region()` if none."""
    method = METHODS[flight.method]
    return flight.region if method.policy is not None and method.kept is None else Region()


def scenario_of(flight: Flight) -> tuple[Scenario, list[range]]:
    """The scenario of a run, and the indices of the aircraft of each encounter."""
    method = METHODS[flight.method]
    encounters = side_by_side(flight.seeds)
    paths = [PathSettings(points=tuple(map(tuple, rows.tolist()))) for e in encounters for rows in e]
    ends = np.cumsum([len(e) for e in encounters])
    groups = [range(int(end) - len(e), int(end)) for e, end in zip(encounters, ends, strict=True)]
    channel = flight.channel
    if flight.condition == LOADED:
        channel = msgspec.structs.replace(channel, background=LOAD)
    air = AirSettings(model="packets", transports=method.transports, rate=RATE)
    atmc = AtmcConfig(policy=flight.plugin if method.policy == FILE and flight.plugin else method.policy)
    return Scenario(
        path=tuple(paths),
        air=air if method.avoids else AirSettings(),
        channel=channel if method.avoids else None,
        region=region_of(flight),
        atmc=atmc,
        limits=LIMITS,
        avoidance=AVOIDANCE,
    ), groups


def rows_of(flight: Flight) -> list[Row]:
    """Fly a run. Returns a row for each of its encounters."""
    method = METHODS[flight.method]
    scenario, groups = scenario_of(flight)
    names = names_of(scenario, 0)
    logs = [AgeLog(list(permutations([names[i] for i in group], 2))) for group in groups]
    policy = flight.policy if method.policy == FILE else None
    law = None if method.avoids else "none"

    def watch(ether: Ether) -> None:
        for log in logs:
            log(ether)

    run = fly(scenario, flight.seeds[0], law=law, policy=policy, watch=watch)
    return [
        _row(flight, scenario, run, seed, group, log)
        for seed, group, log in zip(flight.seeds, groups, logs, strict=True)
    ]


def _row(flight: Flight, scenario: Scenario, run: Run, seed: int, group: range, log: AgeLog) -> Row:
    own = Run([run.aircraft[i] for i in group], {}, run.time_s, {})
    paths = [np.asarray(scenario.path[i].points, float) for i in group]
    separations = [pair.min_separation_m for pair in pairs_of(own)]
    chosen = [run.chosen[aircraft.name] for aircraft in own.aircraft]
    ages = awareness_of(log.ages_s(), weights_of(run, log.pairs)) if METHODS[flight.method].avoids else None
    return Row(
        encounter=seed,
        run=flight.seeds[0],
        aircraft=len(group),
        least_separation_m=round(min(separations), 3),
        pairs_lost=sum(s < SEPARATION_M for s in separations),
        deviation_m=round(float(np.mean([d.largest_m for d in deviations_of(own, paths, 0.0)])), 3),
        age_mean_s=None if ages is None else round(ages.mean_s, 4),
        age_p95_s=None if ages is None else round(ages.p95_s, 4),
        age_max_s=None if ages is None else round(ages.largest_s, 4),
        unheard=log.unheard() if ages is not None else 0,
        switches_per_minute=round(sum(c.switches_per_minute for c in chosen) / len(chosen), 3),
        seconds=_seconds(chosen),
        fallback_share=round(fallback_share(chosen), 4),
    )


def _seconds(chosen: Sequence[Chosen]) -> dict[str, float]:
    total: dict[str, float] = {}
    for one in chosen:
        for name, seconds in one.seconds.items():
            total[name] = round(total.get(name, 0.0) + seconds, 2)
    return total
