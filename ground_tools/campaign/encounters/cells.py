"""Encounters of one kind: each is drawn, flown without and with avoidance, and evaluated."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

import msgspec
import numpy as np
from msgspec import Meta

from companion.arrays import Floats
from companion.authority.influence.containment import area_around, reach_m
from companion.avoidance import kernels as k
from companion.avoidance.law import settings_of
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, ContainmentConfig, LimitsConfig
from companion.errors import ConfigError
from ground_tools.campaign.encounters import flight, pairing
from ground_tools.campaign.encounters.model import Model
from ground_tools.campaign.encounters.volumes import NMAC, WELL_CLEAR, Volume, first_inside
from ground_tools.campaign.world import World
from ground_tools.common import sources
from ground_tools.common.kept_lines import Kept

Own = Literal["hover", "5", "10", "15"]
Altitude = Literal["geometric", "pressure", "barometric", "unheard"]
Taken = Literal["crewed", "small"]
OWN: Final[tuple[Own, ...]] = get_args(Own)
ALTITUDES: Final[tuple[Altitude, ...]] = get_args(Altitude)
TAKEN: Final[tuple[Taken, ...]] = get_args(Taken)
WORLD: Final = World(end_s=float(pairing.DURATION_S), delay_s=(0.2, 1.0), floor_m=20.0, ceiling_m=150.0)
"""The campaign's world, between 20 and 150 m above ground."""
SPEED_MPS: Final[dict[Own, float]] = {"hover": 0.0, "5": 5.0, "10": 10.0, "15": 15.0}
RESERVE_MPS: Final = 5.0
"""Greatest speed of our own aircraft beyond that of its path."""
LEAST_MOST_MPS: Final = 10.0
HEIGHT_ERROR_M: Final = 18.0
"""Error of the difference of two pressure altitudes, one standard deviation, drawn once for an encounter:
15 m of the crewed aircraft's altimeter, encoder and static source, 10 m of our own barometer."""
_RECEIVED: Final[dict[Altitude, int]] = {
    "geometric": flight.GEOMETRIC,
    "pressure": flight.PRESSURE,
    "barometric": flight.BAROMETRIC,
    "unheard": flight.UNHEARD,
}


class Cell(msgspec.Struct, frozen=True, kw_only=True):
    """Encounters of one kind. They differ only in their seeds."""

    model: str
    """Name of the model, and first digits of the SHA-256 of its file."""
    digest: str
    own: Own = "hover"
    """Speed of our own aircraft over ground, m/s."""
    altitude: Altitude = "geometric"
    """Altitude that the crewed aircraft sends. pressure: pressure altitude, and we know our own. barometric:
    pressure altitude, and we do not know our own. unheard: it sends nothing."""
    taken: Taken = "crewed"
    """What the law takes it for. small: a small aircraft, as all traffic that only Remote ID or a sensor
    aboard tells of."""
    horizontal_m: Annotated[float, Meta(gt=0)] = AvoidanceConfig().crewed_horizontal_m
    """Separation from crewed traffic that the law keeps."""
    vertical_m: Annotated[float, Meta(gt=0)] = AvoidanceConfig().crewed_vertical_m
    loss: Annotated[float, Meta(ge=0, le=1)] = 0.0
    """Share of messages that are lost."""
    range_m: Annotated[float, Meta(gt=0)] = 50_000.0
    """Distance within which messages are received."""
    aside_m: Annotated[float, Meta(gt=0)] = WELL_CLEAR.aside_m
    """Half width of the window through which the crewed aircraft passes; `height_m` is its half height."""
    height_m: Annotated[float, Meta(gt=0)] = WELL_CLEAR.height_m

    @property
    def avoidance(self) -> AvoidanceConfig:
        """The law of our own aircraft."""
        return AvoidanceConfig(crewed_horizontal_m=self.horizontal_m, crewed_vertical_m=self.vertical_m)

    @property
    def reach_m(self) -> tuple[float, float]:
        """How far the containment allows crewed traffic to push our own aircraft to the side, and up (m)."""
        return reach_m(ContainmentConfig(), self.avoidance)

    @property
    def limits(self) -> LimitsConfig:
        """Limits of our own aircraft."""
        speed = max(SPEED_MPS[self.own] + RESERVE_MPS, LEAST_MOST_MPS)
        return LimitsConfig(max_speed_mps=speed)


class Row(msgspec.Struct, frozen=True, array_like=True):
    """Outcome of one encounter."""

    seed: int
    weight: float
    """Importance weight."""
    nmac: bool
    """Whether there was a near mid-air collision. Fields that end in `_unavoided` apply without avoidance."""
    nmac_unavoided: bool
    lowc_s: float | None
    """When well clear was first lost; None: never."""
    lowc_unavoided_s: float | None
    alert_s: float | None
    """When the law first saw a conflict with the crewed aircraft; None: never."""
    deviation_m: float
    """Largest distance of our own aircraft from its timed point."""
    back_m: float
    """Distance from the timed point at the end."""
    aside_m: float
    """Largest distance from the line of its path."""


def fly(cell: Cell, model: Model, seeds: Sequence[int]) -> list[Row]:
    """Fly the encounters of a cell for the given seeds.

    Raises:
        ConfigError: the model cannot be drawn from.
    """
    return [_fly(cell, model, seed) for seed in seeds]


def draw(cell: Cell, model: Model, seed: int) -> pairing.Encounter:
    """The encounter of a seed. It depends only on the model, the own speed and the window.

    Raises:
        ConfigError: the model cannot be drawn from.
    """
    window = Volume(cell.aside_m, cell.height_m)
    rng = np.random.default_rng([seed, 11])
    try:
        return pairing.draw(rng, model, SPEED_MPS[cell.own], window, WORLD.step_s)
    except ValueError as error:
        raise ConfigError(f"--model: {error}") from error


def warm_up() -> None:
    """Compile the code of a flight, or load it from the cache."""
    still, received = np.zeros((2, 3)), flight.Received(flight.UNHEARD, 1.0, 0.0, 1.0)
    path = Trajectory([0.0, 1.0], [(0.0, 0.0, -80.0)] * 2)
    law = settings_of(AvoidanceConfig(), LimitsConfig(), path)
    conditions = WORLD.conditions(AvoidanceConfig().period_s)
    flight.fly(np.random.default_rng(1), conditions, path.arrays, (still, still), law, received)


def flown(cell: Cell, encounter: pairing.Encounter, seed: int, *, avoids: bool) -> tuple[Floats, Floats]:
    """Fly an encounter with or without avoidance. Returns what `flight.fly` does."""
    own = encounter.own_times_s, encounter.own_points
    path = Trajectory(encounter.own_times_s.tolist(), encounter.own_points.tolist())
    avoidance, error = cell.avoidance, np.random.default_rng([seed, 13]).normal(0.0, HEIGHT_ERROR_M)
    law = settings_of(avoidance, cell.limits, path)
    side_m, above_m = cell.reach_m
    world = msgspec.structs.replace(
        WORLD, loss=cell.loss, ceiling_m=min(WORLD.ceiling_m, above_m - float(encounter.own_points[0, 2]))
    )
    return flight.fly(
        np.random.default_rng([seed, 7]),  # same draws with and without avoidance
        world.conditions(avoidance.period_s),
        own,
        (encounter.position, encounter.velocity),
        law if avoids else law._replace(law=k.NONE),
        flight.Received(
            _RECEIVED[cell.altitude], float(cell.range_m), float(error), float(cell.taken == "crewed")
        ),
        area_around([(float(n), float(e)) for n, e, _ in encounter.own_points], side_m),
    )


def _fly(cell: Cell, model: Model, seed: int) -> Row:
    encounter = draw(cell, model, seed)
    avoided, result = flown(cell, encounter, seed, avoids=True)
    unavoided, _ = flown(cell, encounter, seed, avoids=False)
    lost, lost_unavoided = (
        first_inside(encounter.position - own, WORLD.step_s, WELL_CLEAR) for own in (avoided, unavoided)
    )
    hit, hit_unavoided = (
        first_inside(encounter.position - own, WORLD.step_s, NMAC) is not None for own in (avoided, unavoided)
    )
    return Row(
        seed=seed,
        weight=round(encounter.weight, 6),
        nmac=hit,
        nmac_unavoided=hit_unavoided,
        lowc_s=None if lost is None else round(lost, 3),
        lowc_unavoided_s=None if lost_unavoided is None else round(lost_unavoided, 3),
        alert_s=round(alert, 3) if (alert := float(result[flight.F_ALERT])) < WORLD.end_s else None,
        deviation_m=round(float(result[flight.F_DEVIATION]), 3),
        back_m=round(float(result[flight.F_BACK]), 3),
        aside_m=round(_aside(avoided, encounter.own_points), 3),
    )


def _aside(trace: Floats, points: Floats) -> float:
    """Largest horizontal distance (m) of positions, (N, 3), from the straight line between two points."""
    along, away = (points[1] - points[0])[:2], trace[:, :2] - points[0, :2]
    size = math.hypot(*along)
    if size == 0.0:
        return float(np.hypot(away[:, 0], away[:, 1]).max())
    return float(np.abs(away[:, 0] * along[1] - away[:, 1] * along[0]).max() / size)


def kept(folder: Path, cell: Cell) -> Kept[Row]:
    """The stored results of a cell, its rows by seed.

    Args:
        folder: an existing folder.

    Raises:
        ConfigError: the results come from another state of law, world or model, or cannot be read.
    """
    made_with: dict[str, Any] = {**msgspec.to_builtins(cell), "software": software()}
    digest = hashlib.sha256(msgspec.json.encode(cell)).hexdigest()[:8]
    name = f"{cell.model}-{cell.own}-{cell.altitude}-{digest}"
    return Kept(folder / f"{name}.jsonl", made_with, Row, attrgetter("seed"))


def software() -> str:
    """Digest of the code on which the outcomes depend."""
    return sources.digest(["ground_tools.campaign.encounters.cells"])
