"""Draws an obstacle for the own aircraft, which would pass it within `PASS_M` on its planned path.

The own aircraft flies straight and level, at 0.5 to 0.75 of its greatest speed, as in the other campaigns.
"""

from __future__ import annotations

import math
from typing import Annotated, Final, Literal

import msgspec
import numpy as np
from msgspec import Meta

from companion.geometry import Vec3
from sitl_mocks.vehicle.sensing import Obstacle

Kind = Literal["pole", "wall", "unheard-5", "unheard-10"]
KINDS: Final[tuple[Kind, ...]] = ("pole", "wall", "unheard-5", "unheard-10")
SPEED_MPS: Final = {"unheard-5": 5.0, "unheard-10": 10.0}
PASS_M: Final = 5.0
BEGIN_S: Final = 5.0
"""Time at which the path begins."""
MEETING_S: Final = 30.0
END_S: Final = 60.0
HEIGHT_M: Final = 50.0
_ORDER: Final = 23
"""Number that separates this stream of random draws from the others of a seed."""


class Cell(msgspec.Struct, frozen=True, kw_only=True):
    """Flights of one kind under the same conditions. They differ only in their seeds."""

    kind: Kind
    range_m: Annotated[float, Meta(ge=5, le=600)] = 40.0
    """Range of the sensor."""
    message: Literal["scan", "points", "tracks", "proximity"] = "scan"
    fov_deg: Annotated[float, Meta(gt=0, le=360)] = 360.0
    rate_hz: Annotated[float, Meta(ge=1, le=20)] = 10.0
    speed_mps: Annotated[float, Meta(ge=1, le=30)] = 5.0
    """Greatest speed of the own aircraft."""
    acceleration_mps2: Annotated[float, Meta(gt=0, le=20)] = 2.0
    """Greatest rate of change of its command; the vehicle itself can accelerate at 2.5 m/s^2."""


class Scene(msgspec.Struct, frozen=True, kw_only=True):
    """One encounter with all random values drawn."""

    heading_rad: float
    speed_mps: float
    obstacle: Obstacle

    def planned(self, now_s: float) -> Vec3:
        """Point of the own path at a time (NED, m)."""
        along = self.speed_mps * (now_s - MEETING_S)
        return along * math.cos(self.heading_rad), along * math.sin(self.heading_rad), -HEIGHT_M


def draw(cell: Cell, seed: int) -> Scene:
    """Draw the encounter of a seed. Cells that differ only in the sensor have the same encounter."""
    rng = np.random.default_rng([seed, _ORDER, KINDS.index(cell.kind)])
    heading = float(rng.uniform(0.0, 2.0 * math.pi))
    speed = cell.speed_mps * float(rng.uniform(0.5, 0.75))
    miss, bearing = float(rng.uniform(0.0, PASS_M)), float(rng.uniform(0.0, 2.0 * math.pi))
    n, e = miss * math.cos(bearing), miss * math.sin(bearing)
    if cell.kind == "pole":
        obstacle = Obstacle(kind="pole", at_ned_m=(n, e, 0.0), radius_m=float(rng.uniform(0.15, 0.5)))
    elif cell.kind == "wall":
        length, along = float(rng.uniform(10.0, 40.0)), float(rng.uniform(0.0, 1.0))
        way = float(rng.uniform(0.0, 2.0 * math.pi))
        cn, ce = length * math.cos(way), length * math.sin(way)
        begin = (n - along * cn, e - along * ce, 0.0)
        obstacle = Obstacle(kind="wall", at_ned_m=begin, to_ned_m=(begin[0] + cn, begin[1] + ce, 0.0))
    else:
        course, fast = float(rng.uniform(0.0, 2.0 * math.pi)), SPEED_MPS[cell.kind]
        vn, ve = fast * math.cos(course), fast * math.sin(course)
        down = float(rng.uniform(-2.0, 2.0)) - HEIGHT_M
        obstacle = Obstacle(
            kind="aircraft",
            at_ned_m=(n - MEETING_S * vn, e - MEETING_S * ve, down),
            velocity_ned_mps=(vn, ve, 0.0),
            radius_m=0.5,
        )
    return Scene(heading_rad=heading, speed_mps=speed, obstacle=obstacle)
