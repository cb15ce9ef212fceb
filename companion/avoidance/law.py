"""Decide: from the own state, the timed path and what was heard, one velocity to fly (paper section II).

Three laws share one interface, the same limits and the same kernels:

- `DmucaLaw` flies. The preferred velocity always leads back to the timed path and always passes through ORCA;
  planes are built from the own velocity at the time of each neighbour's sample, so that both sides of an
  encounter split the same geometry; radii grow with declared inaccuracy and age.
- `PaperLaw` is the published law to the letter, for comparison.
- `NoAvoidance` follows the path and looks at nobody: the baseline.

Nothing here reads a clock, a socket or a file, or draws a random number.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Protocol

import msgspec
import numpy as np

from companion.avoidance import kernels as k
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from companion.events import TrackView, Vec3

OLDEST_S = 15.0
"""A message older than this says nothing any more."""
LEAST_MARGIN_M = 2.0
SIGMAS = 3.8
"""Margin for accuracy: standard deviations of the relative horizontal error, at least LEAST_MARGIN_M."""
AGE_MARGIN_MPS = 0.5
VERTICAL_SCALE = 0.85
"""Volumes are 1 / 0.85 times as tall as wide: downwash, and the vertical error of GNSS."""
OVERLAP_S = 2.0
LOOK_S = 30.0
KEEP_RIGHT_RAD = 0.2
BOUNDARY_LAG_S = 1.0
"""From a decision to the vehicle's answer, at floor and ceiling: autopilot lag, period and latency."""

_RESTART_S = 1.0
"""After a pause longer than this (and five periods) the command starts again from the velocity flown."""
_HISTORY_SPACING_S = 0.04
_HISTORY_SAMPLES = 1024
"""Half of them stay when they are full: at this spacing 20 s, more than the oldest message's age."""
_BELIEVABLE = 1e7
"""m, m/s: beyond it a neighbour's number is as good as none."""

_by_id = attrgetter("track_id")


class Neighbour(msgspec.Struct, frozen=True, gc=False):
    """One other aircraft as it was heard; NED."""

    track_id: str
    position_ned_m: Vec3
    """At the message's own time, not predicted."""
    velocity_ned_mps: Vec3
    age_s: float
    """Now less the message's own time; a negative one counts as 0."""
    sigma_m: float
    """Declared horizontal error, one standard deviation per axis."""
    vertical_known: bool = True
    """False: taken as flying at our height, not to be passed above or below."""


@dataclass(frozen=True, slots=True)
class Situation:
    """What a decision is made from; NED."""

    now_s: float
    """Monotonic."""
    path_time_s: float
    """The same instant on the trajectory's clock."""
    position_ned_m: Vec3
    velocity_ned_mps: Vec3
    sigma_m: float
    """Own horizontal error, one standard deviation per axis."""
    neighbours: Sequence[Neighbour] = ()
    floor_down_m: float | None = None
    """NED down of the floor (the greater number)."""
    ceiling_down_m: float | None = None


@dataclass(frozen=True, slots=True)
class LawResult:
    """One decision; NED."""

    wanted_ned_mps: Vec3
    """What it would fly if it were alone."""
    chosen_ned_mps: Vec3
    """The command: within every limit, whatever came in."""
    feasible: bool
    """False: no velocity kept every neighbour's half-space; the least violation was taken."""
    conflict: bool
    """Flying the wanted velocity would break a neighbour's volume."""
    recovering: bool
    """Off the timed path and on the way back to it."""
    tracks: tuple[TrackView, ...]


class Law(Protocol):
    """One aircraft's law; keeps the own velocity's history and the last command."""

    @property
    def trajectory(self) -> Trajectory:
        """The path as it is flown now (a law may delay it)."""
        ...

    def note_velocity(self, now_s: float, velocity_ned_mps: Vec3) -> None:
        """Own velocity between decisions; what is not newer or not finite is passed over."""
        ...

    def decide(self, situation: Situation) -> LawResult:
        """One decision.

        Raises:
            ValueError: the own state is not finite, or the ceiling lies below the floor.
        """
        ...


def make_law(avoidance: AvoidanceConfig, limits: LimitsConfig, trajectory: Trajectory) -> Law:
    """The law that the configuration names."""
    kinds: dict[str, type[DmucaLaw | PaperLaw | NoAvoidance]]
    kinds = {"dmuca": DmucaLaw, "paper": PaperLaw, "none": NoAvoidance}
    return kinds[avoidance.law](avoidance, limits, trajectory)


class _History:
    """Own velocities of the last seconds, oldest first."""

    def __init__(self) -> None:
        self.times = np.zeros(_HISTORY_SAMPLES)
        self.velocities = np.zeros((_HISTORY_SAMPLES, 3))
        self.count = 0

    def note(self, now_s: float, velocity: Vec3) -> None:
        if not all(map(math.isfinite, (now_s, *velocity))):
            return
        n = self.count
        if n and now_s <= self.times[n - 1]:
            return
        if n > 1 and self.times[n - 1] - self.times[n - 2] < _HISTORY_SPACING_S:
            n -= 1  # a fast caller: the newest sample moves along
        elif n == _HISTORY_SAMPLES:
            n //= 2
            self.times[:n] = self.times[-n:]
            self.velocities[:n] = self.velocities[-n:]
        self.times[n] = now_s
        self.velocities[n] = velocity
        self.count = n + 1


class _Common:
    """What all laws share: the neighbours' table, the limits, the last command."""

    def __init__(self, avoidance: AvoidanceConfig, limits: LimitsConfig, trajectory: Trajectory) -> None:
        self._avoidance = avoidance
        self._trajectory = trajectory
        self._turn_s = 0.5 * trajectory.largest_turn_mps() / limits.max_acceleration_mps2
        # Plain floats: a whole number in the limits would compile a kernel anew, in flight.
        self._speed = float(limits.max_speed_mps)
        self._climb = min(float(limits.max_climb_mps), self._speed)
        self._descent = min(float(limits.max_descent_mps), self._speed)
        self._acceleration = float(limits.max_acceleration_mps2)
        self._settings = self._make_settings()
        self._history = _History()
        self._own = np.zeros(k.OWN_ENTRIES)
        self._out = np.zeros(3)
        self._previous = np.zeros(3)
        self._commanded_s: float | None = None
        self._room(32)

    @property
    def trajectory(self) -> Trajectory:
        return self._trajectory

    def note_velocity(self, now_s: float, velocity_ned_mps: Vec3) -> None:
        self._history.note(now_s, velocity_ned_mps)

    def _make_settings(self) -> k.Array:
        settings = np.zeros(k.SETTINGS_ENTRIES)
        settings[k.S_RADIUS] = 2.0 * self._avoidance.conflict_radius_m
        settings[k.S_LEAST_MARGIN] = LEAST_MARGIN_M
        settings[k.S_SIGMAS] = SIGMAS
        settings[k.S_AGE_MARGIN] = AGE_MARGIN_MPS
        settings[k.S_VERTICAL] = VERTICAL_SCALE
        settings[k.S_HORIZON] = self._avoidance.horizon_s
        settings[k.S_OVERLAP] = OVERLAP_S
        settings[k.S_LOOK] = LOOK_S
        settings[k.S_RIGHT] = KEEP_RIGHT_RAD
        settings[k.S_SPEED] = self._speed
        return settings

    def _room(self, count: int) -> None:
        self._neighbours = np.zeros((count, k.NEIGHBOUR_COLUMNS))
        self._view = np.zeros((count, k.VIEW_COLUMNS))
        self._planes = np.zeros((k.HARD + count, 4))
        self._scratch = np.zeros((k.HARD + count, 4))

    def _take(self, neighbours: Sequence[Neighbour]) -> list[Neighbour]:
        """Fill the table with the usable neighbours, ordered by name in whatever order they came."""
        usable = [n for n in sorted(neighbours, key=_by_id) if -OLDEST_S <= n.age_s <= OLDEST_S]
        if not usable:
            return usable
        rows = np.array(
            [
                (*n.position_ned_m, *n.velocity_ned_mps, max(n.age_s, 0.0), n.sigma_m, n.vertical_known)
                for n in usable
            ],
            dtype=np.float64,
        )
        good = np.abs(rows) < _BELIEVABLE  # False for NaN too
        if not good.all():
            kept = good.all(axis=1)
            rows = rows[kept]
            usable = [usable[i] for i in np.flatnonzero(kept)]
        if len(usable) > len(self._neighbours):
            self._room(2 * len(usable))
        self._neighbours[: len(usable)] = rows
        return usable

    def _begin(self, s: Situation) -> tuple[float, float]:
        """Check the own state, note it; the least and the greatest down speed."""
        state = (*s.position_ned_m, *s.velocity_ned_mps, s.sigma_m)
        if not (math.isfinite(s.now_s) and math.isfinite(s.path_time_s)):
            raise ValueError(f"time is not finite: now {s.now_s} s, path {s.path_time_s} s")
        if not all(-_BELIEVABLE < x < _BELIEVABLE for x in state):  # NaN fails too
            raise ValueError(f"own state is not a finite place and velocity: {state}")
        self._history.note(s.now_s, s.velocity_ned_mps)
        return self._down_speeds(s)

    def _down_speeds(self, s: Situation) -> tuple[float, float]:
        """Climb, descent, and what still stops before floor and ceiling."""
        least, most = -self._climb, self._descent
        floor, ceiling, down = s.floor_down_m, s.ceiling_down_m, s.position_ned_m[2]
        if floor is not None:
            if not math.isfinite(floor) or (ceiling is not None and ceiling >= floor):
                raise ValueError(f"floor (down {floor} m) must be finite and below the ceiling ({ceiling} m)")
            most = min(max(_closing(floor - down, self._acceleration), least), most)
        if ceiling is not None:
            if not math.isfinite(ceiling):
                raise ValueError(f"ceiling (down {ceiling} m) is not finite")
            least = min(max(-_closing(down - ceiling, self._acceleration), -self._climb), self._descent)
        return least, most

    def _avoid(
        self, s: Situation, wish: Vec3, least: float, most: float
    ) -> tuple[bool, bool, tuple[TrackView, ...]]:
        """Run the kernel: whether feasible, whether in conflict, the tracks; its velocity is in `_out`."""
        usable = self._take(s.neighbours)
        self._own[:] = (*s.position_ned_m, *wish, least, most, s.sigma_m, s.now_s)
        history = self._history
        feasible, conflict = k.decide(
            self._neighbours,
            len(usable),
            self._own,
            self._settings,
            history.times,
            history.velocities,
            history.count,
            self._planes,
            self._scratch,
            self._view,
            self._out,
        )
        view = self._view[: len(usable)].tolist()
        return feasible, conflict, tuple(map(_track, usable, view))

    def _limited(self, s: Situation, least: float, most: float) -> Vec3:
        """The velocity in `_out` within every limit, seen from the last command; becomes the last command."""
        period = float(self._avoidance.period_s)
        dt = period if self._commanded_s is None else s.now_s - self._commanded_s
        if self._commanded_s is None or dt > max(_RESTART_S, 5.0 * period):
            n, e, d = s.velocity_ned_mps
            self._previous[:] = _clipped((n, e, min(max(d, -self._climb), self._descent)), self._speed)
            dt = period
        change = self._acceleration * max(float(dt), 0.0)
        chosen: Vec3 = k.limit(self._out, self._previous, change, least, most, self._speed)
        self._previous[:] = chosen
        self._commanded_s = s.now_s
        return chosen

    def _preferred(self, s: Situation, least: float, most: float) -> Vec3:
        """Along the path, and back to its point within T.

        The velocity along the path turns ahead of a corner, over the time that the acceleration limit needs:
        without that the aircraft overshoots and is led back by the gap alone. No feed-forward after the end.
        """
        path = self._trajectory
        target = path.position(s.path_time_s)
        velocity = path.mean_velocity(s.path_time_s, self._turn_s)
        gain = 1.0 / self._avoidance.recovery_time_s
        n, e, d = (v + gain * (p - q) for v, p, q in zip(velocity, target, s.position_ned_m, strict=True))
        return _clipped((n, e, min(max(d, least), most)), self._speed)

    def _off_path(self, s: Situation) -> bool:
        target = self._trajectory.position(s.path_time_s)
        return math.dist(target, s.position_ned_m) > self._avoidance.regained_m


class DmucaLaw(_Common):
    """The law that flies: preferred velocity with feed-forward, keep right, time-consistent planes."""

    def decide(self, situation: Situation) -> LawResult:
        """One decision. Raises ValueError as `Law.decide` says."""
        least, most = self._begin(situation)
        wanted = self._preferred(situation, least, most)
        feasible, conflict, tracks = self._avoid(situation, wanted, least, most)
        chosen = self._limited(situation, least, most)
        recovering = not conflict and self._off_path(situation)
        return LawResult(wanted, chosen, feasible, conflict, recovering, tracks)


class NoAvoidance(_Common):
    """Follow the path; the tracks are reported, not avoided."""

    def decide(self, situation: Situation) -> LawResult:
        """One decision. Raises ValueError as `Law.decide` says."""
        least, most = self._begin(situation)
        wanted = self._preferred(situation, least, most)
        _, conflict, tracks = self._avoid(situation, wanted, least, most)
        self._out[:] = wanted
        chosen = self._limited(situation, least, most)
        return LawResult(wanted, chosen, True, conflict, self._off_path(situation), tracks)


class PaperLaw(_Common):
    """The published law: ORCA around the current velocity, then a recovery that looks at nobody.

    Where the paper is silent: the flight begins on the path (as after a recovery); overlapping volumes are to
    part within one period; the command obeys the same limits as every other law's.
    """

    def __init__(self, avoidance: AvoidanceConfig, limits: LimitsConfig, trajectory: Trajectory) -> None:
        super().__init__(avoidance, limits, trajectory)
        self._quiet_cycles = avoidance.n_noncollide

    def _make_settings(self) -> k.Array:
        settings = np.zeros(k.SETTINGS_ENTRIES)  # no margin, no turn to the right
        settings[k.S_RADIUS] = 2.0 * self._avoidance.conflict_radius_m
        settings[k.S_VERTICAL] = 1.0
        settings[k.S_HORIZON] = settings[k.S_LOOK] = self._avoidance.horizon_s
        settings[k.S_OVERLAP] = self._avoidance.period_s
        settings[k.S_SPEED] = self._speed
        return settings

    def decide(self, situation: Situation) -> LawResult:
        """One decision. Raises ValueError as `Law.decide` says."""
        least, most = self._begin(situation)
        # The current velocity is both what is tested for conflict and what is to be kept.
        wanted = situation.velocity_ned_mps
        self._history.count = 0
        self._history.note(situation.now_s, wanted)
        feasible, conflict, tracks = self._avoid(situation, wanted, least, most)
        self._quiet_cycles = 0 if conflict else self._quiet_cycles + 1
        recovering = self._quiet_cycles >= self._avoidance.n_noncollide
        if recovering:
            wanted = self._recovery(situation)
            self._out[:] = wanted
        chosen = self._limited(situation, least, most)
        return LawResult(wanted, chosen, feasible, conflict, recovering, tracks)

    def _recovery(self, s: Situation) -> Vec3:
        """Velocity back to the path; above v_max, the path is delayed by the time that clipping costs."""
        t = s.path_time_s
        t_nearest, nearest = self._trajectory.nearest(s.position_ned_m)
        if t_nearest > t:
            target, within = nearest, t_nearest - t
        else:
            target, within = self._trajectory.position(t), self._avoidance.recovery_time_s
        gap = math.dist(target, s.position_ned_m)
        speed = self._speed
        if gap > speed * within:
            self._trajectory = self._trajectory.delayed(gap / speed - within)
            within = gap / speed
        n, e, d = ((a - b) / within for a, b in zip(target, s.position_ned_m, strict=True))
        return (n, e, d)


def _track(neighbour: Neighbour, view: list[float]) -> TrackView:
    return TrackView(
        track_id=neighbour.track_id,
        position_ned_m=(view[0], view[1], view[2]),
        velocity_ned_mps=neighbour.velocity_ned_mps,
        age_s=neighbour.age_s,
        radius_m=view[k.V_RADIUS],
        conflict=view[k.V_CONFLICT] != 0.0,
        time_to_closest_s=view[k.V_TIME],
        closest_m=view[k.V_DISTANCE],
    )


def _clipped(v: Vec3, speed: float) -> Vec3:
    length = math.hypot(*v)
    if length <= speed:
        return v
    return (v[0] * speed / length, v[1] * speed / length, v[2] * speed / length)


def _closing(room_m: float, acceleration: float) -> float:
    """Speed at which it still stops at a boundary: v lag + v^2 / (2 a) = room; beyond it, the way back."""
    if room_m <= 0.0:
        return room_m / BOUNDARY_LAG_S
    a_lag = acceleration * BOUNDARY_LAG_S
    return math.sqrt(a_lag * a_lag + 2.0 * acceleration * room_m) - a_lag
