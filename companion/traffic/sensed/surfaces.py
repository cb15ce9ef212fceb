"""Surfaces that a sensor sees (walls, trees, masts with wires): a bounded number of places that stand still.

The visible part of a wall moves along with the aircraft, so that its middle would seem to fly. Its places are
therefore not tracked with a velocity: each is the nearest measurement in a cell of a grid over the ground and
is named after the cell, so that it stays the same place while the wall stands there. Places out of the
sensor's view are remembered for a moment, because an aircraft that turns away from a wall no longer sees it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from companion.traffic.sensed.pose import Pose
from companion.traffic.sensed.seen import Seen, View

MOST: Final = 16
"""Most places of surfaces that are held, the nearest ones."""
CELL_M: Final = 6.0
"""Width of a cell. It is less than the radius that is kept from each place, so that no gap opens."""
EXPIRE_S: Final = 3.0
CONFIRMED: Final = 2

Cell = tuple[int, int]


@dataclass(slots=True)
class Patch:
    """One place of a surface: the latest measurement in its cell."""

    cell: Cell
    at_s: float
    place: Seen
    distance_m: float
    """Distance from us when it was measured."""
    component: int
    """Component that measured it. Only a scan of that component shows that it is gone, because another sensor
    may look over it or through it."""
    measured: int = 1

    @property
    def name(self) -> str:
        """North and east of the cell in steps of CELL_M."""
        return f"{self.cell[0]}/{self.cell[1]}"


@dataclass(slots=True)
class Surfaces:
    """At most `MOST` places."""

    held: dict[Cell, Patch] = field(default_factory=dict)

    def clear(self) -> None:
        """Forget all of them."""
        self.held.clear()

    def expire(self, now_s: float) -> None:
        """Remove those that were not seen for too long."""
        self.held = {cell: one for cell, one in self.held.items() if 0.0 <= now_s - one.at_s <= EXPIRE_S}

    def see(self, component: int, places: Sequence[Seen], pose: Pose, view: View | None) -> None:
        """Take in what one component saw at a time. Arguments are those of `Objects.see`."""
        if not places and not self.held:
            return
        nearest: dict[Cell, Seen] = {}
        for place in sorted(places, key=lambda seen: math.dist(seen.position, pose.position)):
            nearest.setdefault(_cell(place), place)
        for cell, place in nearest.items():
            before = self.held.get(cell)
            away = math.dist(place.position, pose.position)
            self.held[cell] = Patch(
                cell, pose.at_s, place, away, component, 1 if before is None else before.measured + 1
            )
        held = [
            one
            for cell, one in self.held.items()
            if cell in nearest
            or view is None
            or one.component != component
            or not view.passes(one.place.position, flat=one.place.flat)
        ]
        held.sort(key=lambda one: (math.dist(one.place.position, pose.position), one.cell))
        self.held = {one.cell: one for one in held[:MOST]}


def _cell(place: Seen) -> Cell:
    north, east, _ = place.position
    return math.floor(north / CELL_M), math.floor(east / CELL_M)
