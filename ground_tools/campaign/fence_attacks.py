"""Attacks on fences: random areas, paths close to their borders, and neighbours that push an aircraft out."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Literal, get_args

import msgspec
import numpy as np

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.avoidance import walls
from companion.avoidance.law import Neighbour
from companion.avoidance.trajectory import Trajectory
from companion.config import LimitsConfig
from companion.events import FenceArea
from companion.geometry import LocalFrame, Vec3
from ground_tools.campaign.outcome import beyond
from ground_tools.campaign.world import World

Others = Literal["none", "honest", "turning", "ghosts"]
OTHERS: tuple[Others, ...] = get_args(Others)
LEAST_CORNER_RAD = math.radians(15.0)
FRAME = LocalFrame(47.0, 8.0, 400.0)
_DOWN_M = -50.0
WORLD = World()
_MESSAGE_S = 1.0
_TRIES = 400
_OUT_M = 8.0
"""Largest distance beyond a border for flights that begin outside."""


class Encounter(msgspec.Struct, frozen=True, kw_only=True):
    """One drawn attack."""

    areas: tuple[FenceArea, ...]
    path: Trajectory
    start_s: float
    limits: LimitsConfig
    acceleration_mps2: float
    """Acceleration that the vehicle is capable of; at least that of the limits."""
    others: Others
    sigma_m: float
    """Standard deviation of the navigation error, both declared and true; 0: no error."""
    floor_down_m: float | None
    ceiling_down_m: float | None
    out_m: float
    """Distance beyond the nearest border at which the flight begins, at rest; 0: it begins on the path, at
    the path's speed."""


# ---------------------------------------------------------------- drawing


def draw(rng: np.random.Generator, *, noisy: bool, outside: bool) -> Encounter:
    """Draw an attack. A draw that cannot be flown is repeated."""
    anyhow = rng.random() < 0.1
    while True:
        speed = rng.uniform(3.0, 20.0)
        acceleration = math.exp(rng.uniform(math.log(0.5), math.log(5.0)))
        climb, descent = rng.uniform(1.0, 5.0, 2).tolist()
        limits = LimitsConfig(
            max_speed_mps=speed,
            max_climb_mps=climb,
            max_descent_mps=descent,
            max_acceleration_mps2=acceleration,
        )
        sigma = WORLD.sigma_m if noisy else 0.0
        margin = k.FENCE_MARGIN_M + 2.0 * sigma
        size = (6.0 * margin + speed + speed * speed / acceleration) * math.exp(rng.uniform(-1.2, 0.3))
        areas = _areas(rng, size)
        path = _path(rng, areas, size, 0.999 * speed, margin)
        if path is None:
            continue
        start = _start(rng, areas, path, acceleration, anyhow)
        if start is None:
            continue
        layered = rng.random() < 0.25
        return Encounter(
            areas=areas,
            path=path,
            start_s=start,
            limits=limits,
            acceleration_mps2=acceleration * rng.uniform(1.0, 2.0),
            others="ghosts" if outside else OTHERS[int(rng.choice(4, p=[0.1, 0.25, 0.25, 0.4]))],
            sigma_m=sigma,
            floor_down_m=_DOWN_M + rng.uniform(2.0, 15.0) if layered else None,
            ceiling_down_m=_DOWN_M - rng.uniform(2.0, 15.0) if layered else None,
            out_m=rng.uniform(0.5, _OUT_M) if outside else 0.0,
        )


def _areas(rng: np.random.Generator, size: float) -> tuple[FenceArea, ...]:
    """One inclusion area, or exclusion areas, or both. The origin lies roughly in the middle."""
    kind = rng.integers(0, 4)
    found = []
    if kind != 1:
        found.append(_area(rng, True, (0.0, 0.0), size))
    if kind in (1, 2):
        for _ in range(int(rng.integers(1, 4))):
            far, bearing = rng.uniform(0.2, 1.0) * size, rng.uniform(0.0, 2.0 * math.pi)
            middle = far * math.cos(bearing), far * math.sin(bearing)
            found.append(_area(rng, False, middle, size * rng.uniform(0.15, 0.6)))
    return tuple(found)


def _area(rng: np.random.Generator, inclusion: bool, middle: tuple[float, float], size: float) -> FenceArea:
    shape = rng.choice(3, p=[0.45, 0.35, 0.2])
    if shape == 2:
        points, radius = [middle], size
    else:
        points, radius = _wedge(rng, size) if shape == 0 else _star(rng, size, inclusion), None
        points = [(n + middle[0], e + middle[1]) for n, e in points]
    corners = (FRAME.to_geodetic(n, e, 0.0) for n, e in points)
    return FenceArea(inclusion=inclusion, points=tuple(c[:2] for c in corners), radius_m=radius)


def _wedge(rng: np.random.Generator, size: float) -> list[tuple[float, float]]:
    """A triangle with one corner of 15 to 120 degrees, in a random orientation."""
    half = 0.5 * rng.uniform(LEAST_CORNER_RAD, math.radians(120.0))
    turn, long = rng.uniform(0.0, 2.0 * math.pi), 2.0 * size
    tip = complex(1.2 * size, 0.0)
    ends = [tip - long * complex(1.0, side * min(math.tan(half), 1.5)) for side in (1.0, -1.0)]
    return [((z * np.exp(1j * turn)).real, (z * np.exp(1j * turn)).imag) for z in (tip, *ends)]


def _star(rng: np.random.Generator, size: float, inclusion: bool) -> list[tuple[float, float]]:
    """A polygon around the origin whose corners on the aircraft's side exceed `LEAST_CORNER_RAD`."""
    for _ in range(_TRIES):
        count = int(rng.integers(3, 11))
        bearing = np.sort(rng.uniform(0.0, 2.0 * math.pi, count))
        if np.diff(np.append(bearing, bearing[0] + 2.0 * math.pi)).max() > 0.9 * math.pi:
            continue
        z = size * rng.uniform(0.25, 1.2, count) * np.exp(1j * bearing)
        before, after = z - np.roll(z, 1), np.roll(z, -1) - z
        inner = math.pi - np.angle(after / before)
        open_angle = inner if inclusion else 2.0 * math.pi - inner
        if open_angle.min() > LEAST_CORNER_RAD and abs(after).min() > 0.05 * size:
            return [(float(p.real), float(p.imag)) for p in z]
    return [(-size, -size), (-size, size), (size, size), (size, -size)]


def _path(
    rng: np.random.Generator, areas: Sequence[FenceArea], size: float, speed: float, margin: float
) -> Trajectory | None:
    """A path whose legs keep the margin to all borders; half of the legs are as long as the margin permits.
    None if none was found."""
    rows = [(area, np.array(walls._walls(0, area, FRAME))) for area in areas]

    def kept(a: Floats, b: Floats) -> bool:
        return all(walls._trouble(area, w, np.array([a, b]), margin + 0.05) is None for area, w in rows)

    points: list[Floats] = []
    for _ in range(_TRIES):
        if not points:
            here = rng.uniform(-1.3, 1.3, 2) * size
            if kept(here, here + 1e-3):
                points.append(here)
            continue
        bearing = rng.uniform(0.0, 2.0 * math.pi)
        way = 2.0 * size * np.array([math.cos(bearing), math.sin(bearing)])
        low, high = 0.0, 1.0
        for _ in range(9):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if kept(points[-1], points[-1] + middle * way) else (low, middle)
        share = low if rng.random() < 0.5 else low * rng.uniform(0.2, 1.0)
        if share * 2.0 * size > 3.0:
            points.append(points[-1] + share * way)
        if len(points) == 6:
            break
    if len(points) < 3:
        return None
    times = [0.0]
    for a, b in itertools.pairwise(points):
        times.append(times[-1] + float(np.linalg.norm(b - a)) / (speed * rng.uniform(0.5, 1.0)))
    return Trajectory(times, [(float(n), float(e), _DOWN_M) for n, e in points])


def _start(
    rng: np.random.Generator,
    areas: Sequence[FenceArea],
    path: Trajectory,
    acceleration: float,
    anyhow: bool,
) -> float | None:
    """Time on the path at which the aircraft is taken over: where it could still stop straight ahead after
    one more second, or anywhere if `anyhow`. None if no such time was found."""
    rows = [(area, np.array(walls._walls(0, area, FRAME))) for area in areas]
    for _ in range(20):
        start = float(rng.uniform(0.0, 0.6 * path.times_s[-1]))
        here, way = np.array(path.position(start))[:2], np.array(path.velocity(start))[:2]
        stop = here + way * (1.0 + 0.5 * float(np.linalg.norm(way)) / acceleration)
        if anyhow or all(walls._trouble(area, w, np.array([here, stop]), 1e-3) is None for area, w in rows):
            return start
    return None


# ---------------------------------------------------------------- neighbours


class Traffic:
    """The neighbours that the aircraft receives; they are updated every second."""

    def __init__(self, rng: np.random.Generator, one: Encounter, fence: Floats) -> None:
        self._rng, self._one, self._fence = rng, one, fence
        self._count = 0 if one.others == "none" else int(rng.integers(1, 5))
        self._next_s = -math.inf
        self._at_s = 0.0
        self._heard: list[tuple[Vec3, Vec3]] = []
        self._places, self._ways = np.zeros((self._count, 3)), np.zeros((self._count, 3))

    def heard(self, now_s: float, position: Floats, velocity: Floats) -> list[Neighbour]:
        """The neighbours for a decision at a time, placed relative to the aircraft's true state, NED."""
        if now_s >= self._next_s and self._count:
            first = self._next_s == -math.inf
            self._next_s, passed = now_s + _MESSAGE_S, now_s - self._at_s
            self._at_s = now_s
            if self._one.others == "ghosts":
                self._push(position, velocity)
            elif first:
                self._meet(position, velocity)
            else:
                self._places += passed * self._ways
                if self._one.others == "turning":
                    self._turn(position)
            self._heard = [(vec(p), vec(v)) for p, v in zip(self._places, self._ways, strict=True)]
        age, sigma = now_s - self._at_s, max(self._one.sigma_m, 0.5)
        return [Neighbour(f"n{i}", place, way, age, sigma) for i, (place, way) in enumerate(self._heard)]

    def _meet(self, position: Floats, velocity: Floats) -> None:
        """Place neighbours that fly straight and level through the aircraft's predicted position, each with a
        random heading and meeting time."""
        speed = self._one.limits.max_speed_mps
        for i in range(self._count):
            ahead, bearing = self._rng.uniform(2.0, 20.0), self._rng.uniform(0.0, 2.0 * math.pi)
            way = self._rng.uniform(0.3, 1.0) * speed
            self._ways[i] = way * math.cos(bearing), way * math.sin(bearing), 0.0
            self._places[i] = position + ahead * (velocity - self._ways[i])

    def _turn(self, position: Floats) -> None:
        """Turn each neighbour by up to 1 rad, towards the aircraft or in a random direction."""
        for i in range(self._count):
            way, to = self._ways[i], position - self._places[i]
            turn = self._rng.uniform(-1.0, 1.0)
            if self._rng.random() < 0.6:
                wanted = math.atan2(to[1], to[0]) - math.atan2(way[1], way[0])
                turn = min(max(math.remainder(wanted, 2.0 * math.pi), -1.0), 1.0)
            c, s = math.cos(turn), math.sin(turn)
            way[0], way[1] = c * way[0] - s * way[1], s * way[0] + c * way[1]

    def _push(self, position: Floats, velocity: Floats) -> None:
        """Place ghosts between the aircraft and the inside of the area, so that they push it towards the
        nearest border or into the nearest corner."""
        n, e = float(position[0]), float(position[1])
        best, out = math.inf, (1.0, 0.0)
        for row in self._fence.tolist():
            room, d = k.nearest_of_wall(k.Wall(*row), k.Point(n, e))
            if room < best and d.n * d.n + d.e * d.e > 0.0:
                best, out = room, (-d.n, -d.e)
        if beyond(self._fence, n, e) > 0.0:
            out = -out[0], -out[1]
        elif self._rng.random() < 0.5 and len(self._fence) > 1:
            walls = k.Wall(*self._fence.T)
            to = np.stack([walls.n, walls.e], axis=1) - position[:2]
            nearest = to[np.argmin(np.linalg.norm(to, axis=1))]
            out = tuple((nearest / max(np.linalg.norm(nearest), 1e-9)).tolist())
        speed = self._one.limits.max_speed_mps
        for i in range(self._count):
            turn, far = self._rng.normal(0.0, 0.5), self._rng.uniform(0.5, 30.0)
            c, s = math.cos(turn), math.sin(turn)
            away = np.array([c * out[0] - s * out[1], s * out[0] + c * out[1], 0.0])
            self._places[i] = position - far * away + [0.0, 0.0, self._rng.normal(0.0, 2.0)]
            self._ways[i] = self._rng.uniform(0.0, 1.0) * speed * away + 0.5 * velocity * [1, 1, 0]


def vec(v: Floats) -> Vec3:
    """A vector as a tuple of three numbers."""
    n, e, d = v.tolist()
    return n, e, d
