"""The cells of a study of cities: what is flown, what aircraft know of each other, and the outcome."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec
import numpy as np
from msgspec import Meta

from companion.arrays import Floats
from companion.atmc.actions import SET_ACTIONS, Action
from companion.atmc.rule import FIXED_SETS, fixed
from companion.config import AvoidanceConfig, TrafficConfig
from companion.errors import ConfigError
from companion.remote_id.region import Region
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from companion.shipped import shipped
from companion.toml_reader import decode_toml
from ground_tools.campaign.outcome import COLLISION_M
from ground_tools.campaign.world import World
from ground_tools.city import measure
from ground_tools.city.flights import Flights, flights_of
from ground_tools.city.loop import GIVEN, PERFECT, RADIO
from ground_tools.city.radio import awareness
from ground_tools.city.radio.choosing import ByPolicy, ByRule, Chooser, Fixed
from ground_tools.city.radio.reception import AnalyticRadio
from ground_tools.city.simulation import PART_S, Result, Simulation
from ground_tools.city.traffic import demand, intentions
from ground_tools.city.traffic.demand import Demand
from sitl_mocks.channel.link_budget import ranges_m
from sitl_mocks.channel.parameters import BackgroundLoad, ChannelParameters
from sitl_mocks.channel.parameters import load as load_parameters

CHANNEL: Final = "config/channel/standard.toml"
POLICY: Final = "config/policies/atmc.safetensors"
SAME: Final[dict[str, Action]] = {
    BLE4: (10, 0, 0), BLE5: (0, 10, 0), "wifi": (0, 0, 10), "wifi-2": (0, 0, 2), "wifi-1": (0, 0, 1),
    "all-2": (2, 2, 2), "ble4-wifi-2": (10, 0, 2),
}  # fmt: skip
"""All aircraft on the same transports: one of them at the highest rate, Wi-Fi at a lower one, all three with
two Location messages a second on each, or BLE 4 at the highest rate and Wi-Fi at two. BLE 4 and BLE 5 alone
are legal nowhere."""
TRANSPORTS: Final = (*SAME, "fixed", "rule", "policy")
_BLUETOOTH: Final = 0.35
"""Background load of Bluetooth as a share of that of Wi-Fi: Bluetooth hops. As in `paper closed-loop`."""
_PERFECT_M: Final = 2500.0
"""Range within which an aircraft with perfect information knows the others, m."""


class City(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Runs of one kind. They differ only in their seeds."""

    demand: Demand = Demand()
    flights: str | None = None
    """Path of a file with flights (`intentions`) instead of `demand`."""
    from_s: float = 0.0
    """Time in that file at which the run begins."""
    duration_s: Annotated[float, Meta(ge=10, le=86_400)] = 600.0
    settle_s: Annotated[float, Meta(ge=0)] = 60.0
    """Simulated time at which counting begins."""
    law: Literal["dmuca", "none"] = "dmuca"
    separation_m: Annotated[float, Meta(gt=0, le=100)] = measure.SEPARATION_M
    """Separation that the law is asked to keep. Losses are counted below `measure.SEPARATION_M` all the
    same."""
    knows: Literal["radio", "given", "perfect"] = "radio"
    """radio: messages by the channel equations. given: messages with `delay_s` and `loss`. perfect: the true
    state of all aircraft within 2.5 km."""
    transports: str = "policy"
    """One of `TRANSPORTS`: one of `SAME`, the best fixed legal set, the rule, or the policy."""
    region: Literal["none", "us", "eu"] = "none"
    load: Annotated[float, Meta(ge=0, lt=1)] = 0.0
    """Share of time for which foreign transmissions fill the Wi-Fi channel."""
    delay_s: tuple[float, float] = (0.0, 1.0)
    loss: Annotated[float, Meta(ge=0, le=1)] = 0.0
    reach_m: Annotated[float, Meta(gt=0)] = 2000.0
    """Range of messages, with `knows` "given"."""

    @property
    def name(self) -> str:
        """Name of the files of this cell. Two cells with the same name are equal."""
        digest = hashlib.sha256(msgspec.json.encode(self)).hexdigest()[:8]
        what = self.transports if self.knows == "radio" and self.law != "none" else self.knows
        return f"{self.demand.pattern}-{self.demand.per_km2:g}-{self.law}-{what}-{digest}"


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """Outcome of one run. What "counts" happened after its first `settle_s`."""

    seed: int
    flights: int
    """Flights of the demand: the sum of the next four fields."""
    arrived: int
    in_the_air: int
    """Flights in the air at the end of the run."""
    waiting: int
    """Flights that were due, but still waited for their departure at the end."""
    not_due: int
    slots: int
    """Most aircraft that could be in the air at the same time."""
    flight_h: float
    """Flight hours that count."""
    losses: int
    """Losses of separation that count: a pair that comes nearer than `measure.SEPARATION_M`."""
    cruise_losses: int
    """Losses that count and are far from the beginning and the end of both paths."""
    collisions: int
    """Losses that count and in which the pair came nearer than `COLLISION_M`."""
    least_m: float | None
    """Least distance of any pair; None: no two aircraft were ever near each other."""
    deviation_m: float
    """Mean distance of an aircraft from the timed point of its path."""
    largest_deviation_m: float
    """Median, over the flights, of the largest distance from the timed point."""
    extra_energy: float
    """Energy of all flights by `energy.power_w`, above that of the parts of their paths that they have
    completed, as a share of the latter."""
    late_s: float
    """Mean delay of the paths: how much later than planned the timed point is."""
    waited_s: float
    """Mean waiting time before departure."""
    infeasible: float
    """Share of decisions that could not keep every half-space."""
    conflict: float
    """Share of decisions in conflict."""
    asked: float
    """Mean number of neighbours that could matter to a decision."""
    age_s: float | None
    """Mean age of the information of aircraft within `awareness.WITHIN_M`; None without messages."""
    old: float | None
    """Share of the information in `age_s` that is older than `awareness.OLD_S`."""
    unheard: float | None
    """Share of the ordered pairs within `awareness.WITHIN_M` in which the first aircraft has no track of the
    second."""
    wifi_load: float | None
    """Mean Wi-Fi load that aircraft sense, as a share of time. Above 1, the channel is overloaded."""
    ble4: float
    """Mean number of Location messages that an aircraft sends per second on BLE 4; `ble5` and `wifi`
    likewise."""
    ble5: float
    wifi: float
    refused: float
    """Share of transport decisions in which the fall-back was used instead of the policy."""
    given_up: int
    """Tracks that were given up because a table was full."""
    turned_away: int
    """Newcomers for which a full table had no room."""
    not_measured: int
    """Near pairs that were not measured, because an aircraft had too many."""


def region_of(city: City) -> Region:
    """The region whose Remote ID rules apply."""
    if city.region == "none":
        return Region()
    return decode_toml(shipped(f"config/regions/{city.region}.toml"), Region)


def channel_of(city: City) -> ChannelParameters:
    """The channel parameters, with the background load."""
    found = load_parameters(shipped(CHANNEL))
    if city.load == 0.0:
        return found
    bluetooth = _BLUETOOTH * city.load
    return msgspec.structs.replace(
        found, background=BackgroundLoad(wifi=city.load, ble4=bluetooth, ble5=bluetooth)
    )


def chooser_of(city: City, slots: int) -> Chooser:
    """The chooser of the transports.

    Raises:
        ConfigError: `City.transports` is unknown, or no set is legal in the region.
    """
    region, most = region_of(city), TrafficConfig().max_tracks
    if city.transports in SAME:
        return Fixed(SAME[city.transports])
    if city.transports == "fixed":
        action = fixed(region, (BLE4, BLE5, WIFI_BEACON))
        if action is None:
            raise ConfigError(f"region {city.region}: no fixed set is legal")
        return Fixed(action)
    if city.transports == "rule":
        return ByRule(region, most)
    if city.transports == "policy":
        path = shipped(POLICY)
        return ByPolicy(path.read_bytes(), path.name, region, slots, most)
    raise ConfigError(f"--transports: {city.transports} is unknown; allowed: {', '.join(TRANSPORTS)}")


def rates_of(city: City) -> set[int]:
    """Rates that may be used, in Location messages per second."""
    return {rate for action in (*SET_ACTIONS, *FIXED_SETS, *SAME.values()) for rate in action if rate}


def flights_for(city: City, avoidance: AvoidanceConfig, seed: int) -> Flights:
    """The flights of one run.

    Raises:
        ConfigError: the file cannot be read.
    """
    if city.flights is not None:
        wishes = intentions.read(Path(city.flights), city.from_s, city.duration_s, seed)
    else:
        wishes = demand.draw(city.demand, city.duration_s, seed)
    return flights_of(wishes, avoidance)


def simulation_of(
    city: City, seed: int, choosing: Callable[[int], Chooser] | None = None
) -> tuple[Simulation, list[AnalyticRadio]]:
    """A run that has not begun, and its radio, if there is one.

    Args:
        choosing: makes another chooser than that of `City.transports`, for a number of slots.

    Raises:
        ConfigError: a setting or a file cannot be used.
    """
    avoidance = AvoidanceConfig(law=city.law, conflict_radius_m=city.separation_m / 2.0)
    flights = flights_for(city, avoidance, seed)
    rng, radio_rng, other_rng = (np.random.default_rng([seed, number]) for number in (31, 32, 33))
    knows = {"radio": RADIO, "given": GIVEN, "perfect": PERFECT}[city.knows]
    delay_s = city.delay_s if city.knows == "given" else (0.0, 0.0)
    world = World(end_s=city.duration_s, delay_s=delay_s, loss=city.loss)
    reach_m = np.array([city.reach_m if city.knows == "given" else _PERFECT_M, 0.0, 0.0])
    radios: list[AnalyticRadio] = []
    if city.knows == "radio":
        reach_m = ranges_m(channel_of(city))

    def radio(slots: int, message_s: float) -> AnalyticRadio:
        chooser = chooser_of(city, slots) if choosing is None else choosing(slots)
        radios.append(AnalyticRadio(channel_of(city), rates_of(city), chooser, slots, message_s, other_rng))
        return radios[0]

    run = Simulation(
        flights, avoidance, world, knows, reach_m, rng, radio_rng,
        radio=radio if city.knows == "radio" else None,
    )  # fmt: skip
    return run, radios


def fly(city: City, seed: int, choosing: Callable[[int], Chooser] | None = None) -> tuple[Row, Result]:
    """Fly one run. The same arguments give the same result, bit for bit.

    Args:
        choosing: as in `simulation_of`.

    Raises:
        ConfigError: a setting or a file cannot be used.
    """
    run, radios = simulation_of(city, seed, choosing)
    watch = Watch(run, radios)
    settled = math.ceil(min(city.settle_s, city.duration_s) / PART_S) * PART_S
    run.fly(settled)
    measure.forget(run.state.tally)
    result = run.fly(city.duration_s - settled, after=watch.look)
    refused = radios[0].chooser.refused() if radios else 0.0
    return _row(seed, settled, result, run.slots, watch, refused), result


class Watch:
    """Sums of ages and loads, sampled after each part of a run."""

    def __init__(self, run: Simulation, radios: list[AnalyticRadio]) -> None:
        self._run, self._radios = run, radios
        self.ages = np.zeros(awareness.AGES)
        self.load = self.aircraft = 0.0
        self.rates = np.zeros(3)

    def look(self) -> None:
        """Add the present ages, loads and rates to the sums."""
        state = self._run.state
        flying = state.air.flight >= 0
        self.aircraft += float(flying.sum())
        self.rates += state.air.rates[flying].sum(axis=0)
        if len(state.tracks.who) == len(flying):
            awareness.add_ages(self._run.now_s, awareness.WITHIN_M, state, self.ages)
        for radio in self._radios:
            self.load += float(radio.sensed_load[flying].sum())


def _row(seed: int, settled: float, result: Result, slots: int, watch: Watch, refused: float) -> Row:
    tally, state = result.state.tally, result.state
    rows = tally.flights[tally.flights[:, measure.T_STEPS] > 0.0]
    losses = tally.losses[: min(int(tally.number[0]), len(tally.losses))]
    losses = losses[losses[:, measure.L_TIME] >= settled]
    decisions, steps = max(rows[:, measure.T_DECISIONS].sum(), 1.0), max(rows[:, measure.T_STEPS].sum(), 1.0)
    heard, age, old, unheard = watch.ages.tolist()
    aircraft = max(watch.aircraft, 1.0)
    least = float(rows[:, measure.T_LEAST].min(initial=math.inf))
    messages = heard + unheard > 0.0
    return Row(
        seed=seed,
        flights=len(tally.flights),
        arrived=result.arrived,
        in_the_air=result.in_the_air,
        waiting=result.waiting,
        not_due=result.not_due,
        slots=slots,
        flight_h=round(float(steps) * result.step_s / 3600.0, 4),
        losses=len(losses),
        cruise_losses=int((losses[:, measure.L_TERMINAL] == 0.0).sum()),
        collisions=int((losses[:, measure.L_LEAST] < COLLISION_M).sum()),
        least_m=round(least, 3) if math.isfinite(least) else None,
        deviation_m=_of(rows[:, measure.T_GAP_SUM].sum() / steps),
        largest_deviation_m=_of(np.median(rows[:, measure.T_GAP_MOST])) if len(rows) else 0.0,
        extra_energy=_of(rows[:, measure.T_ENERGY].sum() / max(rows[:, measure.T_PLANNED].sum(), 1.0) - 1.0),
        late_s=_of(rows[:, measure.T_LATE].mean()) if len(rows) else 0.0,
        waited_s=_mean(result.waited_s),
        infeasible=_of(rows[:, measure.T_INFEASIBLE].sum() / decisions),
        conflict=_of(rows[:, measure.T_CONFLICTS].sum() / decisions),
        asked=_of(rows[:, measure.T_ASKED].sum() / decisions),
        age_s=_of(age / heard) if heard > 0.0 else None,
        old=_of(old / heard) if heard > 0.0 else None,
        unheard=_of(unheard / (heard + unheard)) if messages else None,
        wifi_load=_of(watch.load / aircraft) if watch.load > 0.0 else None,
        ble4=_of(watch.rates[0] / aircraft),
        ble5=_of(watch.rates[1] / aircraft),
        wifi=_of(watch.rates[2] / aircraft),
        refused=_of(refused),
        given_up=int(state.tracks.counts[0]),
        turned_away=int(state.tracks.counts[1]),
        not_measured=result.near_overflow,
    )


def _of(value: float) -> float:
    return round(float(value), 5)


def _mean(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return _of(known.mean()) if len(known) else 0.0


ROOTS: Final = ("ground_tools.city.cells",)
"""Modules on which the results depend."""
