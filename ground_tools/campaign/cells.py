"""The cells of a campaign: which encounters are flown, and the outcome of each flight."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from companion.arrays import Floats
from companion.avoidance import kernels, law
from companion.avoidance.law import settings_of
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from companion.errors import ConfigError
from ground_tools.campaign import flight, outcome, powers, vehicles
from ground_tools.campaign import twins as twin_flight
from ground_tools.campaign.generators import draw
from ground_tools.campaign.peers import flown, omniscient
from ground_tools.campaign.peers.flown import Flown
from ground_tools.campaign.scenarios import files, layouts, missions
from ground_tools.campaign.scenarios.surroundings import CREWED_MPS, crewed_ways, fence_beside
from ground_tools.campaign.world import World
from ground_tools.common import sources
from ground_tools.common.kept_lines import Kept
from ground_tools.common.plugin_state import state_of

Law = Literal["dmuca", "paper", "none"]
"""The companion's laws. A `Cell` may also be flown by one of `peers.laws.PEERS`."""
LAWS: dict[Law, AvoidanceConfig] = {
    "dmuca": AvoidanceConfig(),
    # The paper gives no parameters. Of the parameters that were tried, these kept pairs apart most often.
    "paper": AvoidanceConfig(
        law="paper", horizon_s=30.0, period_s=0.2, n_noncollide=75, recovery_time_s=10.0
    ),
    "none": AvoidanceConfig(law="none"),
}
WORLDS = {
    "calm": World(),
    # Gusts of 2 m/s, a quarter of a wind of 8 m/s, with a drag of 0.3 m/s^2 for each m/s of airspeed.
    "wind": World(gust_mps2=0.6),
    "clocks": World(clock_s=0.5),
    "velocity": World(own_sigma_mps=0.3),
    "layer": World(floor_m=70.0, ceiling_m=130.0),
    "blackout": World(blackout_s=10.0),
    "mute": World(blackout_s=10.0, mute=True),
    # One fence beside the paths; only for encounters whose paths all run along one line.
    "fence": World(),
    "all": World(gust_mps2=0.6, clock_s=0.5, own_sigma_mps=0.3, floor_m=70.0, ceiling_m=130.0),
}
KINDS = vehicles.INTRUDERS | vehicles.TWINS | dict.fromkeys(missions.MISSIONS, vehicles.BLIND)
"""Kind of an aircraft (`vehicles`), by the name of the kind of intruder."""
FLIGHT = "ground_tools.campaign.flight"
"""Module that flies an encounter."""
TWINS = "ground_tools.campaign.twins"
"""Module that flies an encounter in which two aircraft send one identity."""
PEERS = "ground_tools.campaign.peers.laws"
"""Module that lists the laws of other projects."""
PLANNED = "ground_tools.campaign.peers.omniscient"
"""Module of the law that plans everything before the flight."""
ENCOUNTERS = ("ground_tools.campaign.generators", "companion.avoidance.trajectory")
"""Modules that draw an encounter."""
SCENARIOS = ("ground_tools.campaign.scenarios.layouts", "ground_tools.campaign.scenarios.missions")
"""Modules that draw scenarios and the paths of intruders on missions."""
FILES = "ground_tools.campaign.scenarios.files"
"""Module that makes flights from files of other projects."""
MISSION_MPS2 = 5.0
"""Limit of the change of command (m/s^2) of an intruder on a mission. It exceeds the vehicle's own limit, so
that the intruder turns as sharply as it can and stays close to its path."""
_RESERVE = 0.6
"""Ratio of planned to greatest speed in encounters in which each aircraft has its own limits."""
SEPARATION_M = 2.0 * AvoidanceConfig().conflict_radius_m


class Cell(msgspec.Struct, frozen=True, kw_only=True):
    """Encounters of one kind, flown by one law in one world. They differ only in their seeds."""

    generator: str
    """One of `generators.NAMES`, a key of `layouts.SCENARIOS`, or an episode of a file (`files.name_of`)."""
    aircraft: int
    law: str = "dmuca"
    """A key of `LAWS`, or a peer as `peers.laws.of` reads it."""
    speed_mps: float = 5.0
    """Greatest speed of each aircraft."""
    delay_s: tuple[float, float] = (0.0, 1.0)
    loss: Annotated[float, Meta(ge=0, le=1)] = 0.0
    intruders: Annotated[float, Meta(ge=0, le=1)] = 0.0
    """Share of the aircraft that do not avoid. They have the lowest indices."""
    intruder: str = "blind"
    """Kind of those aircraft, a key of `KINDS`."""
    world: str = "calm"
    """A key of `WORLDS`."""
    reserve: bool = True
    """False: no aircraft can fly faster than planned."""
    rate: Annotated[int, Meta(ge=1, le=20)] = 1
    """Messages of each aircraft in a second."""
    signal: bool = False
    """Whether the aircraft weigh the signal strength of messages."""

    @property
    def twins(self) -> bool:
        """Whether two aircraft send the same identity."""
        return self.intruder in vehicles.TWINS and self.intruders > 0.0

    @property
    def on_missions(self) -> bool:
        """Whether the intruders fly missions."""
        return self.intruder in missions.MISSIONS and self.intruders > 0.0

    @property
    def name(self) -> str:
        """Name of the cell's file. Two cells with the same name are equal."""
        digest = hashlib.sha256(msgspec.json.encode(self)).hexdigest()[:8]
        return f"{self.generator}-{self.aircraft}-{self.law.partition(':')[0]}-{digest}"


class Row(msgspec.Struct, frozen=True, array_like=True):
    """Outcome of one flight."""

    seed: int
    separation_m: float
    """Least distance of any pair."""
    time_s: float
    first: int
    second: int
    deviation_m: float
    """Largest distance of any avoiding aircraft from its timed point."""
    away_s: float
    """Longest time for which any avoiding aircraft was more than `outcome.AWAY_M` from its timed point."""
    back_m: float
    """Largest distance of any avoiding aircraft from its timed point at the end."""
    lost_s: float
    """Largest delay of a path."""
    path_ratio: float
    manoeuvres: float
    infeasible: float
    """Share of decisions that could not keep every half-space."""
    recovery_s: float | None
    """Longest time of any avoiding aircraft from its last conflict until it is within `regained_m` of its
    timed point. 0 if there was no conflict; None if one of the aircraft was not back at the end."""
    crewed: float | None
    """Least of the larger of horizontal and vertical distance from crewed traffic, in separations; None
    without crewed traffic."""
    fence_m: float
    """Largest distance beyond a fence."""
    lost: tuple[int, ...]
    """Numbers of the pairs that came nearer than `SEPARATION_M`, in the order (0, 1), (0, 2), (1, 2), (0, 3)
    and so on."""
    alerts: tuple[int, ...]
    """Pairs in which an avoiding aircraft was in conflict with the other one, by pair number."""
    flagged: tuple[tuple[int, int], ...] = ()
    """Receiver and sender, where the signal strength contradicted the positions."""

    @property
    def severity(self) -> float:
        """Severity of the loss of separation: the lost share of the required distance, from 0 (none) to 1.

        With a single required distance, this equals the severity of the loss of well clear (SLoWC) of RTCA
        SC-228 and the intrusion severity of the BlueSky simulator.
        """
        return max(0.0, 1.0 - self.separation_m / SEPARATION_M)


@dataclass(frozen=True, slots=True)
class Look:
    """Complete record of one flight."""

    row: Row
    world: World
    avoidance: AvoidanceConfig
    limits: tuple[LimitsConfig, ...]
    """Limits of each aircraft."""
    fence: Floats
    """The argument `fence` of `kernels.decide`."""
    times: Floats
    """(A, K): times of the paths, s."""
    points: Floats
    """(A, K, 3): waypoints of the paths, NED, m."""
    kinds: Floats
    """(A,): `vehicles.AVOIDS`, or another kind of aircraft."""
    trace: Floats
    """(steps, A, 3): true positions at the end of each step."""
    log: outcome.Log
    """Every decision of every aircraft."""


def fly(cell: Cell, seeds: Sequence[int]) -> list[Row]:
    """Fly the encounters of a cell for the given seeds.

    Raises:
        ConfigError: the generator cannot draw one of them.
    """
    return [_fly(cell, seed, looked=False).row for seed in seeds]


def look(cell: Cell, seed: int) -> Look:
    """Fly one encounter and record everything. The flight is identical to the one that `fly` flies.

    Raises:
        ConfigError: the generator cannot draw the encounter, or the law is that of a plug-in.
    """
    if flown_by(cell).plugin is not None:
        raise ConfigError(f"law {cell.law}: the flights of a plug-in's law are not recorded in a campaign")
    return _fly(cell, seed, looked=True)


def _fly(cell: Cell, seed: int, *, looked: bool) -> Look:
    law_flown = flown_by(cell)
    avoidance = law_flown.avoidance
    kinds = np.full(cell.aircraft, float(vehicles.AVOIDS))
    kinds[: round(cell.intruders * cell.aircraft)] = KINDS[cell.intruder]
    times, points = _drawn(cell, seed)
    if cell.on_missions:
        times, points = missions.flown(cell.intruder, times, points, kinds != vehicles.AVOIDS, seed)
    crewed = (kinds == vehicles.CREWED) | (kinds == vehicles.BAROMETRIC)
    if crewed.any():
        points[crewed] = crewed_ways(times, points, crewed, seed)
    paths = [Trajectory(t.tolist(), p.tolist()) for t, p in zip(times, points, strict=True)]
    limits = [_limits(cell, path, kind) for path, kind in zip(paths, kinds.tolist(), strict=True)]
    settings = np.array(
        [
            law_flown.settings_row(settings_of(avoidance, own, path), kind == vehicles.AVOIDS)
            for own, path, kind in zip(limits, paths, kinds.tolist(), strict=True)
        ]
    )
    fence = fence_beside(points) if cell.world == "fence" else kernels.NO_WALLS
    start_s, end_s = _from_to_s(cell, times)
    world = msgspec.structs.replace(
        WORLDS[cell.world],
        start_s=start_s,
        end_s=end_s,
        delay_s=cell.delay_s,
        loss=cell.loss,
        message_s=1.0 / cell.rate,
        step_s=min(WORLDS[cell.world].step_s, 1.0 / cell.rate),
        signal=cell.signal,
    )
    n, conditions = cell.aircraft, world.conditions(avoidance.period_s)
    steps = round((world.end_s - world.start_s) / world.step_s) if looked else 0
    decisions = math.ceil(steps / conditions.period)
    trace, log = np.zeros((steps, n, 3)), outcome.new_log(n, decisions)
    pairs, result = np.zeros((n, n, outcome.PAIR_ENTRIES)), np.zeros(outcome.FLIGHT_ENTRIES)
    rng, power_rng = np.random.default_rng([seed, 7]), np.random.default_rng([seed, 9])
    measured = powers.unmeasured(power_rng, conditions, n)
    if cell.twins or law_flown.plugin is not None:
        laws = [
            law.new_law(avoidance if kind == vehicles.AVOIDS else LAWS["none"], own, path, fence)
            for kind, own, path in zip(kinds.tolist(), limits, paths, strict=True)
        ]
        twin_flight.fly(rng, conditions, times, points, fence, settings, kinds, laws, pairs, result)
    elif law_flown.planned:
        futures = look(msgspec.structs.replace(cell, law="none"), seed).trace
        omniscient.fly(
            rng, conditions, times, points, fence, settings, kinds, futures, trace, log, pairs, result
        )
    else:
        flight.fly(
            rng, conditions, times, points, fence, settings, kinds, trace, log, pairs, result, measured,
            power_rng, None if law_flown.peer is None else law_flown.peer[0].loop,
        )  # fmt: skip
    flagged = np.argwhere(measured.suspicion[:, :, powers.S_FLAGGED] != 0.0).tolist()
    found = _row(seed, result, pairs[np.tril_indices(n, -1)], flagged)
    return Look(found, world, avoidance, tuple(limits), fence, times, points, kinds, trace, log)


def _drawn(cell: Cell, seed: int) -> tuple[Floats, Floats]:
    """The paths that the generator, scenario or file of a cell draws.

    Raises:
        ConfigError: it cannot draw them.
    """
    if cell.generator.startswith(files.PREFIX):
        return files.draw(cell.generator, seed)
    drawing = layouts.draw if cell.generator in layouts.SCENARIOS else draw
    try:
        return drawing(cell.generator, cell.aircraft, cell.speed_mps, seed)
    except ValueError as error:
        raise ConfigError(f"seed {seed}: {error}") from error


def _from_to_s(cell: Cell, times: Floats) -> tuple[float, float]:
    """When the flight of a cell begins and ends on its paths."""
    beyond_s = files.BEYOND_S if cell.generator.startswith(files.PREFIX) else 0.0
    return float(times.min()) + beyond_s, float(times.max()) - beyond_s


def flown_by(cell: Cell) -> Flown:
    """The law and its settings that the name in a cell refers to.

    Raises:
        ConfigError: there is no such law, or it cannot fly this cell.
    """
    found = flown.flown_by(cell.law, dict(LAWS.items()))
    if found.plugin is not None:
        dark = WORLDS[cell.world].blackout_s > 0.0
        twin_flight.check(cell.law, cell.intruder if cell.intruders else None, cell.signal, dark)
        return found
    crewed = found.planned and cell.intruders > 0.0 and cell.intruder in ("crewed", "barometric")
    if found.planned and (cell.world != "calm" or crewed):
        what = f"--intruder {cell.intruder}" if crewed else f"--world {cell.world}"
        raise ConfigError(f"--law {cell.law} cannot be combined with {what}")
    if cell.law not in LAWS and (cell.twins or (cell.world == "fence" and found.peer is not None)):
        what = f"--intruder {cell.intruder}" if cell.twins else "--world fence"
        raise ConfigError(f"--law {cell.law} cannot be combined with {what}; allowed: {', '.join(LAWS)}")
    return found


def _row(seed: int, result: Floats, pairs: Floats, flagged: list[list[int]]) -> Row:
    values: list[Any] = [round(value, 4) for value in result.tolist()]
    for entry in (outcome.F_FIRST, outcome.F_SECOND):
        values[entry] = int(result[entry])
    for entry in (outcome.F_RECOVERY, outcome.F_CREWED):
        if math.isinf(result[entry]):
            values[entry] = None
    lost, alerts = pairs[:, outcome.P_SEPARATION] < SEPARATION_M, pairs[:, outcome.P_ALERT] != 0.0
    values += [tuple(np.flatnonzero(which).tolist()) for which in (lost, alerts)]
    values.append(tuple((receiver, sender) for receiver, sender in flagged))
    return Row(seed, *values)


def _limits(cell: Cell, path: Trajectory, kind: float) -> LimitsConfig:
    speed, change = cell.speed_mps, LimitsConfig().max_acceleration_mps2
    if kind in (vehicles.CREWED, vehicles.BAROMETRIC):
        speed = CREWED_MPS
    elif cell.on_missions and kind != vehicles.AVOIDS:
        speed, change = path.max_speed() / _RESERVE, MISSION_MPS2
    elif not cell.reserve:
        speed = path.max_speed()
    elif cell.generator == "mixed":
        speed = path.max_speed() / _RESERVE
    return LimitsConfig(max_speed_mps=speed, max_acceleration_mps2=change)


def kept(folder: Path, cell: Cell) -> Kept[Row]:
    """The stored results of a cell: rows by seed.

    Args:
        folder: an existing folder.

    Raises:
        ConfigError: the results come from another state of the law or the world, or cannot be read.
    """
    header = {
        **msgspec.to_builtins(cell),
        "delay_s": list(cell.delay_s),
        "software": software_of([cell]),
    }
    return Kept(folder / f"{cell.name}.jsonl", header, Row, attrgetter("seed"))


def software(
    *,
    twins: bool = False,
    peers: bool = False,
    planned: bool = False,
    scenarios: bool = False,
    others: bool = False,
) -> str:
    """Digest of the code of law, world and encounters, on which the flights depend.

    Args:
        twins: include the code of the tracks.
        peers: include the laws of `peers`.
        planned: include `peers.omniscient`.
        scenarios: include missions and scenarios.
        others: include flights from files of other projects.
    """
    also = [
        *([FILES] if others else []),
        *([PLANNED] if planned else []),
        *([TWINS] if twins else []),
        *([PEERS] if peers else []),
        *(SCENARIOS if scenarios else []),
    ]
    return sources.digest([FLIGHT, *also, *ENCOUNTERS])


def software_of(cells: Sequence[Cell]) -> str:
    """`software` with exactly the parts on which the flights of these cells depend."""
    plugged = sorted({state_of(p) for cell in cells if (p := flown_by(cell).plugin) is not None})
    brought = sorted({state for cell in cells if (state := flown.brought(cell.law)) is not None})
    state = software(
        twins=bool(plugged) or any(cell.twins for cell in cells),
        peers=any(cell.law not in LAWS and cell.law != omniscient.NAME for cell in cells),
        planned=any(cell.law == omniscient.NAME for cell in cells),
        scenarios=any(cell.on_missions or cell.generator in layouts.SCENARIOS for cell in cells),
        others=any(cell.generator.startswith(files.PREFIX) for cell in cells),
    )
    return "-".join([state, *plugged, *brought])


def baseline(cell: Cell) -> Cell:
    """The same encounters without avoidance.

    Delays, losses and intruders that merely fly their path make no difference without avoidance. They are
    reset, so that equal baselines are flown only once.
    """
    others = ("turning", "frozen", "crewed", "barometric", *missions.MISSIONS)
    turning = cell.intruder in others and cell.intruders > 0.0
    return msgspec.structs.replace(
        cell,
        law="none",
        delay_s=(0.0, 1.0),
        loss=0.0,
        rate=1,
        signal=False,
        intruders=cell.intruders if turning else 0.0,
        intruder=cell.intruder if turning else "blind",
    )


def duration_s(cell: Cell) -> float:
    """Duration of one flight of a cell."""
    times, _ = _drawn(cell, 1)
    start_s, end_s = _from_to_s(cell, times)
    return end_s - start_s


def lost(rows: Sequence[Row]) -> int:
    """Number of flights in which a pair came nearer than `SEPARATION_M`."""
    return sum(row.separation_m < SEPARATION_M for row in rows)


def collided(rows: Sequence[Row]) -> int:
    """Number of flights in which a pair came nearer than `outcome.COLLISION_M`."""
    return sum(row.separation_m < outcome.COLLISION_M for row in rows)


def flagged(cell: Cell, rows: Sequence[Row]) -> dict[str, int]:
    """Number of pairs of receiver and sender in which the signal strength contradicted the positions: for
    senders that are intruders, and for others."""
    intruders = round(cell.intruders * cell.aircraft)
    senders = [sender for row in rows for _, sender in row.flagged]
    of_intruders = sum(sender < intruders for sender in senders)
    return {"flagged_intruders": of_intruders, "flagged_others": len(senders) - of_intruders}


def median(values: Sequence[float]) -> float:
    """The median, NaN if there are no values."""
    return float(np.median(values)) if values else math.nan
