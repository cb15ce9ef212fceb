"""Draws the encounter in which an attack is flown: own aircraft, honest aircraft, and what they report.

The paths cross at the origin of the home frame at `Scene.meeting_s`. If both fly as planned, the own aircraft
and the intruder lose separation there.
"""

from __future__ import annotations

import math
from typing import Final, Literal

import msgspec
import numpy as np

from companion.events import Firmware
from companion.geometry import LocalFrame, Vec3
from ground_tools.inspect.read.truth import ORIGIN

Use = Literal["guard", "fly"]
Manner = Literal["blind", "turning", "avoiding"]
USES: Final = ("guard", "fly", "mixed")
MANNERS: Final = ("blind", "turning", "avoiding", "mixed")

HOME: Final = LocalFrame(*ORIGIN)
BEGIN_S: Final = 5.0
"""Time at which the paths begin. Until then the companion reads the vehicle's mission."""
_MEETING_S: Final = 40.0
_AFTER_S: Final = 25.0
LONG_S: Final = 300.0
"""Duration of a flight that measures for how long and how far an attacker can lead an aircraft away."""
_FENCE_M: Final = 60.0
_LANE_M: Final = 60.0
"""Distance of the parallel aircraft towards which a ghost pushes the own aircraft."""
LEADING: Final = ("herd", "adsb")
"""Kinds of attack that lead an aircraft away."""
HERDS: Final = ("up", "down", "aside", "fence", "aircraft")
"""Direction in which a herding ghost pushes, by the seed modulo the length."""
_MOST_TURN_RADPS: Final = math.radians(3.0)
_SLOW_MPS, _FAST_MPS = 6.0, 20.0
_SECOND_AFTER_S: Final = 10.0
"""Delay of the second aircraft on collision course behind the first."""
_SENDS_FROM_S: Final = 20.0
_RESERVE: Final = 1.4
"""Greatest speed divided by planned speed."""


class Honest(msgspec.Struct, frozen=True, kw_only=True):
    """An honest aircraft. It flies a straight line or an arc, at constant speed and height."""

    manner: Manner
    speed_mps: float
    heading_rad: float
    """Course at the meeting time, clockwise from north."""
    turn_radps: float = 0.0
    at_ned_m: Vec3
    """Position at the meeting time."""
    rate: int
    """Location messages per second."""
    sends_from_s: float = 0.0
    """Time of its first message, as after a take-off or from behind a building. An aircraft that avoids sends
    throughout."""

    def state(self, along_s: float) -> tuple[Vec3, Vec3]:
        """Position (m) and velocity (m/s), NED.

        Args:
            along_s: time minus the meeting time.
        """
        north, east, down = self.at_ned_m
        course = self.heading_rad + self.turn_radps * along_s
        v, w = self.speed_mps, self.turn_radps
        if w == 0.0:
            north += v * along_s * math.cos(course)
            east += v * along_s * math.sin(course)
        else:
            north += v / w * (math.sin(course) - math.sin(self.heading_rad))
            east -= v / w * (math.cos(course) - math.cos(self.heading_rad))
        return (north, east, down), (v * math.cos(course), v * math.sin(course), 0.0)


class Cell(msgspec.Struct, frozen=True, kw_only=True):
    """Flights of one kind of attack under the same conditions. They differ only in their seeds."""

    kind: str
    use: str = "mixed"
    """One of `USES`: how the own aircraft uses its companion."""
    intruder: str = "mixed"
    """One of `MANNERS`: how the honest aircraft on collision course flies."""
    signal: bool = True
    """Whether receivers report the signal strength."""
    attacked: bool = True
    """False: the same flights without the attack."""


class Scene(msgspec.Struct, frozen=True, kw_only=True):
    """One encounter with all random values drawn."""

    seed: int
    use: Use
    firmware: Firmware
    speed_mps: float
    heading_rad: float
    height_m: float
    """Height of the own path above home."""
    meeting_s: float
    end_s: float
    honest: tuple[Honest, ...]
    fence_m: float | None
    """Half width of a fence along the own path; None: no fence."""
    signal: bool

    @property
    def max_speed_mps(self) -> float:
        """Limit of the own aircraft's speed."""
        return _RESERVE * self.speed_mps

    def planned(self, now_s: float) -> Vec3:
        """Point of the own path at a time (NED, m)."""
        along = self.speed_mps * (now_s - self.meeting_s)
        return along * math.cos(self.heading_rad), along * math.sin(self.heading_rad), -self.height_m


def baseline(cell: Cell) -> Cell:
    """The cell with the same flights without the attack. Kinds that are flown in the same encounters share
    it."""
    kind = cell.kind
    if kind in LEADING:
        kind = LEADING[0]
    elif kind != "liar":
        kind = "crowd"
    return msgspec.structs.replace(cell, kind=kind, attacked=False)


def herd_of(seed: int) -> str:
    """Direction in which the herding ghost of a seed pushes."""
    return HERDS[seed % len(HERDS)]


def draw(cell: Cell, seed: int) -> Scene:
    """Draw the encounter of a seed. Cells that differ only in `attacked` and `signal` have the same
    encounter."""
    rng = np.random.default_rng([seed, 11])
    leads = cell.kind in LEADING
    use: Use = "guard" if leads else ("guard", "fly")[seed % 2]
    if cell.use != "mixed":
        use = "guard" if cell.use == "guard" else "fly"
    speed = float(rng.uniform(_SLOW_MPS, 10.0 if leads else _FAST_MPS))
    heading, height = float(rng.uniform(0.0, 2.0 * math.pi)), float(rng.uniform(50.0, 90.0))
    firmware = Firmware.PX4 if rng.random() < 0.5 else Firmware.ARDUPILOT
    honest = _beside(rng, speed, heading, height, seed) if leads else _meeting(rng, cell, heading, height)
    return Scene(
        seed=seed,
        use=use,
        firmware=firmware,
        speed_mps=speed,
        heading_rad=heading,
        height_m=height,
        meeting_s=LONG_S / 2.0 if leads else _MEETING_S,
        end_s=LONG_S if leads else _MEETING_S + _AFTER_S,
        honest=honest,
        fence_m=_FENCE_M if leads and herd_of(seed) == "fence" else None,
        signal=cell.signal,
    )


def _meeting(rng: np.random.Generator, cell: Cell, heading: float, height: float) -> tuple[Honest, ...]:
    """One or two aircraft on collision course (two in a fifth of the flights), and up to three bystanders."""
    found = []
    for number in range(1 + (rng.random() < 0.2)):
        manner = str(rng.choice(["blind", "turning", "avoiding"], p=[0.5, 0.2, 0.3]))
        turn = float(rng.uniform(-_MOST_TURN_RADPS, _MOST_TURN_RADPS))
        course = heading + float(rng.uniform(math.radians(45.0), math.radians(315.0)))
        miss = rng.uniform(-3.0, 3.0, 3)
        speed = float(rng.uniform(4.0, 15.0))
        late = _SECOND_AFTER_S * speed * number
        if cell.intruder != "mixed":
            manner = cell.intruder
        if cell.kind == "liar":
            manner = "blind"
        found.append(
            Honest(
                manner=manner,  # type: ignore[arg-type]
                speed_mps=speed,
                heading_rad=course,
                turn_radps=turn if manner == "turning" else 0.0,
                at_ned_m=(
                    float(miss[0] - late * math.cos(course)),
                    float(miss[1] - late * math.sin(course)),
                    float(miss[2]) - height,
                ),
                rate=int(rng.integers(1, 6)),
                sends_from_s=float(rng.uniform(0.0, _SENDS_FROM_S)),
            )
        )
    return (*found, *_bystanders(rng, height))


def _bystanders(rng: np.random.Generator, height: float) -> tuple[Honest, ...]:
    """Aircraft that fly 40 m higher and pass the meeting point at 150 to 400 m."""
    found = []
    for _ in range(int(rng.integers(0, 4))):
        course, side = float(rng.uniform(0.0, 2.0 * math.pi)), float(rng.choice([-1.0, 1.0]))
        aside = side * float(rng.uniform(150.0, 400.0))
        found.append(
            Honest(
                manner="blind",
                speed_mps=float(rng.uniform(3.0, 12.0)),
                heading_rad=course,
                at_ned_m=(-aside * math.sin(course), aside * math.cos(course), -height - 40.0),
                rate=1,
            )
        )
    return tuple(found)


def _beside(
    rng: np.random.Generator, speed: float, heading: float, height: float, seed: int
) -> tuple[Honest, ...]:
    """The honest aircraft for a ghost that pushes towards it: it flies parallel to the own path."""
    if herd_of(seed) != "aircraft":
        return ()
    side = float(rng.choice([-1.0, 1.0])) * _LANE_M
    return (
        Honest(
            manner="blind",
            speed_mps=speed,
            heading_rad=heading,
            at_ned_m=(-side * math.sin(heading), side * math.cos(heading), -height),
            rate=2,
        ),
    )
