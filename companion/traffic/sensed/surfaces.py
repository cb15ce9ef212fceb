"""Surfaces that a sensor sees (walls, trees, masts with wires): a bounded number of places that stand still.

The visible part of a wall moves along with the aircraft, so that its middle would seem to fly. Its places are
therefore not followed with a velocity: each scan gives new ones, which keep the names of those that they
replace. Places that lie out of the sensor's view are remembered for a moment, because an aircraft that turns
away from a wall does not see it any more.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from companion.geometry import Vec3
from companion.traffic.sensed.pose import Pose
from companion.traffic.sensed.seen import Seen, View, spread

MOST: Final = 16
"""Most places of surfaces that are held, the nearest ones."""
APART_M: Final = 6.0
"""Least distance of two of them. It is less than the radius that is kept from each, so that no gap opens."""
EXPIRE_S: Final = 3.0
CONFIRMED: Final = 2


@dataclass(slots=True)
class Patch:
    """One place of a surface."""

    name: str
    at_s: float
    position: Vec3
    across_m: float
    flat: bool
    measured: int = 1


@dataclass(slots=True)
class Surfaces:
    """At most `MOST` places."""

    held: list[Patch] = field(default_factory=list)
    _last: int = 0

    def clear(self) -> None:
        """Forget all of them."""
        self.held.clear()

    def expire(self, now_s: float) -> None:
        """Remove those that were not seen for too long."""
        self.held = [one for one in self.held if 0.0 <= now_s - one.at_s <= EXPIRE_S]

    def see(self, places: Sequence[Seen], pose: Pose, view: View | None) -> None:
        """Take in what one component saw at a time. Arguments are those of `Objects.see`."""
        if not places and not self.held:
            return
        chosen = spread(places, pose.position, APART_M, MOST)
        before = list(self.held)
        renewed: list[Patch] = []
        for place in chosen:
            old = min(before, key=lambda one: _apart(one.position, place.position), default=None)
            if old is not None and _apart(old.position, place.position) < APART_M:
                before.remove(old)
                patch = Patch(
                    old.name, pose.at_s, place.position, place.across_m, place.flat, old.measured + 1
                )
            else:
                self._last += 1
                patch = Patch(str(self._last), pose.at_s, place.position, place.across_m, place.flat)
            renewed.append(patch)
        unseen = [
            one
            for one in before
            if all(_apart(one.position, new.position) >= APART_M for new in renewed)
            and not (view is not None and view.passes(one.position))
        ]
        held = renewed + unseen
        held.sort(key=lambda one: (math.dist(one.position, pose.position), one.name))
        self.held = held[:MOST]


def _apart(a: Vec3, b: Vec3) -> float:
    return math.hypot(a[0] - b[0], a[1] - b[1])
