"""Demand: who flies where and when over a city, drawn from a seed.

Every flight begins and ends `PAD_M` above the ground, where the law takes over and hands back control. It
climbs straight up to its height, flies straight, and descends straight down. Flights that begin before the
run are cut at its beginning, so that the density is constant from the start.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Final, Literal

import msgspec
import numpy as np
from msgspec import Meta

from companion.arrays import AnyFloats, Floats
from ground_tools.city.flights import Wish

PATTERNS: Final = ("doorsteps", "hubs", "corridors", "inspections", "event", "mixed")
PURPOSES: Final = ("doorsteps", "hubs", "corridors", "inspections", "event", "file")
PAD_M: Final = 30.0
LOWEST_M, HIGHEST_M = 60.0, 120.0
"""Lowest and highest height of flight above the ground."""
LAYERS: Final = 4
"""Number of layers, 20 m apart. Each layer serves the directions of a quarter of the compass."""
CRUISE: Final = (0.6, 0.75)
"""Planned speed as a share of the greatest speed."""
CLIMB_MPS: Final = 1.5
_TRIP_M: Final = (500.0, 5000.0)
"""Shortest and longest trip."""
_KM2_A_HUB: Final = 4.0
_CORRIDOR_M: Final = 2000.0
"""Distance between parallel corridors."""
_LANE_M: Final = 30.0
"""An aircraft in a corridor flies this far to the right of the corridor's middle."""
_HOVER_S: Final = (20.0, 60.0)
_EVENT_RADIUS_M: Final = 300.0
_EVENT_SHARE: Final = 0.5
"""Share of the flights that go to the event."""
_TRIALS: Final = 400
"""Number of drawn flights from which the mean time in the air is estimated."""


class Demand(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is flown over a rectangle."""

    pattern: Literal["doorsteps", "hubs", "corridors", "inspections", "event", "mixed"] = "mixed"
    """doorsteps: from anywhere to anywhere. hubs: from one of a few hubs to a doorstep, or back. corridors:
    between hubs, along a grid of corridors. inspections: to several points nearby, with a hover at each.
    event: half of the flights go to one place and hover there. mixed: half hubs, a fifth doorsteps, a fifth
    corridors, a tenth inspections."""
    per_km2: Annotated[float, Meta(gt=0, le=200)] = 10.0
    """Mean number of aircraft in the air, as planned."""
    north_m: Annotated[float, Meta(ge=1000, le=20_000)] = 10_000.0
    east_m: Annotated[float, Meta(ge=1000, le=20_000)] = 10_000.0
    heights: Literal["layers", "free"] = "layers"
    """layers: by the direction of flight. free: any height."""
    speed_mps: Annotated[float, Meta(ge=5, le=30)] = 15.0
    """Greatest speed of each aircraft."""

    @property
    def aircraft(self) -> float:
        """Mean number of aircraft in the air."""
        return self.per_km2 * self.north_m * self.east_m / 1e6


class _Draw:
    """Draws single flights."""

    def __init__(self, demand: Demand, rng: np.random.Generator) -> None:
        self.demand, self.rng = demand, rng
        self.size = np.array([demand.north_m, demand.east_m])
        hubs = max(2, round(demand.north_m * demand.east_m / 1e6 / _KM2_A_HUB))
        self.hubs = rng.uniform(0.1, 0.9, (hubs, 2)) * self.size
        self.event = rng.uniform(0.3, 0.7, 2) * self.size
        self._of: dict[str, Callable[[], tuple[Floats, Floats]]] = {
            "doorsteps": self._doorsteps,
            "hubs": self._hubs,
            "corridors": self._corridors,
            "inspections": self._inspections,
            "event": self._event,
        }

    def draw(self) -> tuple[Floats, Floats, int]:
        """Draw the times, points and purpose of one flight."""
        pattern: str = self.demand.pattern
        if pattern == "mixed":
            shares = [0.5, 0.2, 0.2, 0.1]
            pattern = str(self.rng.choice(["hubs", "doorsteps", "corridors", "inspections"], p=shares))
        elif pattern == "event" and self.rng.random() >= _EVENT_SHARE:
            pattern = "doorsteps"
        return *self._of[pattern](), PURPOSES.index(pattern)

    def _speed(self) -> float:
        return self.demand.speed_mps * float(self.rng.uniform(*CRUISE))

    def _height(self, start: AnyFloats, goal: AnyFloats) -> float:
        """Height of flight, m."""
        if self.demand.heights == "free":
            return float(self.rng.uniform(LOWEST_M, HIGHEST_M))
        course = math.atan2(goal[1] - start[1], goal[0] - start[0]) % (2.0 * math.pi)
        layer = int(LAYERS * course / (2.0 * math.pi)) % LAYERS
        return LOWEST_M + layer * (HIGHEST_M - LOWEST_M) / (LAYERS - 1)

    def _anywhere_from(self, start: AnyFloats) -> AnyFloats:
        """A doorstep within a trip of a place."""
        longest = min(_TRIP_M[1], 0.9 * float(self.size.max()))
        while True:
            goal: AnyFloats = self.rng.uniform(0.0, 1.0, 2) * self.size
            if _TRIP_M[0] <= math.dist(start, goal) <= longest:
                return goal

    def _straight(self, corners: AnyFloats) -> tuple[Floats, Floats]:
        """A timed path: up, along straight legs between the corners, and down."""
        height = self._height(corners[0], corners[-1])
        return _path([(*c, height, 0.0) for c in corners.tolist()], self._speed())

    def _doorsteps(self) -> tuple[Floats, Floats]:
        start = self.rng.uniform(0.0, 1.0, 2) * self.size
        return self._straight(np.array([start, self._anywhere_from(start)]))

    def _hubs(self) -> tuple[Floats, Floats]:
        hub = self.hubs[self.rng.integers(len(self.hubs))] + self.rng.uniform(-60.0, 60.0, 2)
        ends = [hub, self._anywhere_from(hub)]
        return self._straight(np.array(ends if self.rng.random() < 0.5 else ends[::-1]))

    def _corridors(self) -> tuple[Floats, Floats]:
        first, second = self.rng.choice(len(self.hubs), 2, replace=False)
        start, goal = self.hubs[first] + self.rng.uniform(-60, 60, 2), self.hubs[second]
        goal = goal + self.rng.uniform(-60, 60, 2)
        # North along the corridor nearest to the start, then east along the corridor nearest to the goal.
        way_n, way_e = math.copysign(1.0, goal[0] - start[0]), math.copysign(1.0, goal[1] - start[1])
        lane_e = round(start[1] / _CORRIDOR_M) * _CORRIDOR_M + way_n * _LANE_M
        lane_n = round(goal[0] / _CORRIDOR_M) * _CORRIDOR_M - way_e * _LANE_M
        corners = [start, (start[0], lane_e), (lane_n, lane_e), (lane_n, goal[1]), goal]
        return self._straight(np.array(corners))

    def _inspections(self) -> tuple[Floats, Floats]:
        home = self.rng.uniform(0.1, 0.9, 2) * self.size
        away, bearing = self.rng.uniform(200.0, 1000.0), self.rng.uniform(0.0, 2.0 * math.pi)
        site = np.clip(home + away * np.array([math.cos(bearing), math.sin(bearing)]), 0.0, self.size)
        stops = []
        for _ in range(int(self.rng.integers(3, 7))):
            north, east = (site + self.rng.uniform(-60.0, 60.0, 2)).tolist()
            stops.append((north, east, self.rng.uniform(LOWEST_M, HIGHEST_M), self.rng.uniform(*_HOVER_S)))
        ends = [(*home.tolist(), stops[0][2], 0.0), (*home.tolist(), stops[-1][2], 0.0)]
        return _path([ends[0], *stops, ends[1]], 0.6 * self._speed())

    def _event(self) -> tuple[Floats, Floats]:
        start = self.rng.uniform(0.0, 1.0, 2) * self.size
        away, bearing = self.rng.uniform(0.0, _EVENT_RADIUS_M), self.rng.uniform(0.0, 2.0 * math.pi)
        place = self.event + away * np.array([math.cos(bearing), math.sin(bearing)])
        height = float(self.rng.uniform(LOWEST_M, HIGHEST_M))
        hover = (*place.tolist(), height, float(self.rng.uniform(60.0, 240.0)))
        end = (*start.tolist(), height, 0.0)
        return _path([end, hover, end], self._speed())


def _path(stops: list[tuple[float, float, float, float]], speed_mps: float) -> tuple[Floats, Floats]:
    """A timed path from the pad below the first stop to that below the last.

    Args:
        stops: north, east, height (m) and time of hover (s) of each.
    """
    times, points = [0.0], [(stops[0][0], stops[0][1], -PAD_M)]
    for north, east, up, hover_s in [*stops, (*stops[-1][:2], PAD_M, 0.0)]:
        n, e, d = points[-1]
        level, climb = math.hypot(north - n, east - e), abs(up + d)
        takes = max(math.hypot(level, climb) / speed_mps, climb / CLIMB_MPS)
        if takes > 1e-6:
            times.append(times[-1] + takes)
            points.append((north, east, -up))
        if hover_s > 0.0:
            times.append(times[-1] + hover_s)
            points.append((north, east, -up))
    return np.array(times), np.array(points, float)


def draw(demand: Demand, duration_s: float, seed: int) -> list[Wish]:
    """The flights of a run, including those already in the air at its beginning. The same arguments give the
    same flights."""
    rng = np.random.default_rng([21, seed])
    drawing = _Draw(demand, rng)
    trials = np.array([drawing.draw()[0][-1] for _ in range(_TRIALS)])
    longest = float(trials.max())
    a_second = demand.aircraft / float(trials.mean())
    departs = np.sort(rng.uniform(-longest, duration_s, rng.poisson(a_second * (longest + duration_s))))
    wishes = []
    for depart_s in departs.tolist():
        times, points, purpose = drawing.draw()
        if depart_s < 0.0:
            if depart_s + times[-1] < 10.0:
                continue
            times, points = _from(times, points, -depart_s)
            depart_s = 0.0
        wishes.append(Wish(depart_s, times, points, demand.speed_mps, purpose))
    return wishes


def _from(times: Floats, points: Floats, at_s: float) -> tuple[Floats, Floats]:
    """The part of a path after a time."""
    first = np.array([[np.interp(at_s, times, column) for column in points.T]])
    left = times > at_s + 1e-6
    return np.concatenate([[0.0], times[left] - at_s]), np.concatenate([first, points[left]])
