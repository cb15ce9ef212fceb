"""The avoidance law: own state, timed path and neighbours in, one velocity out (paper section II, "Decide").

Three laws share one interface, the same limits and the same kernel:

- "dmuca" is the default. The preferred velocity always leads back to the timed path and always passes through
  ORCA. Planes are built from the own velocity at the time of each neighbour's sample, so that both aircraft
  of an encounter split the same geometry. Radii grow with declared inaccuracy and age.
- "paper" is exactly the published law, for comparison: ORCA around the current velocity, then a recovery that
  ignores other aircraft. Where the paper leaves something open, the flight begins on the path (as after a
  recovery), overlapping volumes must separate within one period, and the command obeys the same limits as in
  the other laws.
- "none" is the baseline: it follows the path and ignores other aircraft, but reports the tracks.

Nothing here reads a clock, a socket or a file, or draws a random number.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter

import msgspec
import numpy as np

from companion.avoidance import kernels as k
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from companion.events import TrackView
from companion.geometry import Vec3

OLDEST_S = 15.0
"""Neighbours whose message is older than this are ignored."""
LEAST_MARGIN_M = 2.0
SIGMAS = 3.8
"""Margin for accuracy in standard deviations of the relative horizontal error; the margin is at least
LEAST_MARGIN_M. The error of two axes exceeds it with probability exp(-3.8^2 / 2) = 0.07 %."""
QUANTUM_MPS = 0.2
"""Error of a velocity due to Remote ID's resolution: 0.25 m/s, 1 degree, and 0.5 m/s vertically (scaled by
0.85)."""
CATCH_UP_S = 30.0
"""The timed path waits for an aircraft that could not catch up with its point within this time."""
CREWED_HORIZON_S = 90.0
VERTICAL_SCALE = 0.85
"""Factor on vertical distances. Volumes are 1 / 0.85 times as tall as wide, because of downwash and the
vertical error of GNSS."""
_BELIEVABLE = 1e7
"""Largest magnitude (m, m/s) of a number that is used: an own state beyond it is refused, and a neighbour
with a number beyond it is ignored."""
OVERLAP_S = 2.0
LOOK_S = 30.0
KEEP_RIGHT_RAD = 0.2

LIMITS = ("climb or ceiling", "descent or floor", "fence", "outside the fence", "speed")
"""Names of the limits, other than other aircraft, that can bound a decision's velocity."""

_LEAST_TURN_S = 0.01
_ON_PLANE_MPS = 1e-6

_by_id = attrgetter("track_id")


class Neighbour(msgspec.Struct, frozen=True, gc=False):
    """One other aircraft as it was last received; NED."""

    track_id: str
    position_ned_m: Vec3
    """Position at the message's own time, not predicted."""
    velocity_ned_mps: Vec3
    age_s: float
    """Now minus the message's own time; a negative age counts as 0."""
    sigma_m: float
    """Declared horizontal error, one standard deviation per axis."""
    sigma_mps: float = 0.3
    """Error of the velocity, one standard deviation for each axis."""
    growth_mps: float = 0.0
    """How fast it deviates from its predictions (`kernels.note_track`)."""
    silent: bool = False
    """True: not received for so long that it may have stopped (`kernels.silent_after`)."""
    share: float = 0.5
    """Our share of the velocity change that avoids it, 0.5 to 1 (`right_of_way`)."""
    vertical_known: bool = True
    """False: assumed to fly at our height, so that it is not passed above or below."""
    crewed: bool = False
    """True: the separations from crewed traffic apply."""
    adsb: bool = False
    """True: received by ADS-B; then `track_id` is its ICAO address."""


@dataclass(frozen=True, slots=True)
class Situation:
    """Input of a decision; NED."""

    now_s: float
    """Monotonic time."""
    path_time_s: float
    """The same instant on the trajectory's clock."""
    position_ned_m: Vec3
    velocity_ned_mps: Vec3
    sigma_m: float
    """Own horizontal error, one standard deviation per axis."""
    neighbours: Sequence[Neighbour] = ()
    floor_down_m: float | None = None
    """NED down of the floor, which is the greater of both numbers; None: no floor."""
    ceiling_down_m: float | None = None
    """NED down of the ceiling; None: no ceiling."""


@dataclass(frozen=True, slots=True)
class LawResult:
    """Result of one decision; NED."""

    wanted_ned_mps: Vec3
    """Velocity that the aircraft would fly without neighbours."""
    chosen_ned_mps: Vec3
    """Velocity to command. It is within the limits for any input."""
    feasible: bool
    """False: no velocity kept every plane; the one with the least largest violation was used."""
    conflict: bool
    """True: flying the wanted velocity would enter a neighbour's volume."""
    recovering: bool
    """True: the aircraft is off the timed path and on the way back to it."""
    limits: tuple[str, ...]
    """Names from `LIMITS` of the limits that bound the velocity now."""
    tracks: tuple[TrackView, ...]


class Law:
    """The law of one aircraft, with the history of own velocities, the last command and the path's delay.

    It checks the input, fills the tables of `kernels.decide`, which makes the decision, and reads its result.
    """

    def __init__(
        self,
        avoidance: AvoidanceConfig,
        limits: LimitsConfig,
        trajectory: Trajectory,
        fence: k.Array | None = None,
    ) -> None:
        """A law at the start of a flight.

        Args:
            fence: walls from `walls.walls_of`; None: no fence.
        """
        self._fence = np.zeros((0, k.WALL_COLUMNS)) if fence is None else fence
        self._configured = avoidance, limits
        self._planned = self._trajectory = trajectory
        self._path = trajectory.arrays
        self._settings = settings_of(avoidance, limits, trajectory)
        self._state = np.zeros(k.STATE_ENTRIES)
        k.begin(self._state, self._settings)
        self._times, self._velocities = np.zeros(k.HISTORY_SAMPLES), np.zeros((k.HISTORY_SAMPLES, 3))
        self._own, self._out = np.zeros(k.OWN_ENTRIES), np.zeros(k.OUT_ENTRIES)
        self._room(32)

    @property
    def late_s(self) -> float:
        """Delay of the path so far, s."""
        return float(self._state[k.L_DELAY])

    @property
    def trajectory(self) -> Trajectory:
        """The path as it is flown now, with the delay by the law."""
        delay_s = self.late_s
        if self._trajectory.start_s != self._planned.start_s + delay_s:
            self._trajectory = self._planned.delayed(delay_s)
        return self._trajectory

    def restrict(self, limits: LimitsConfig) -> None:
        """Use other limits from the next decision on."""
        self._configured = self._configured[0], limits
        self._settings = settings_of(*self._configured, self._planned)

    def follow(self, trajectory: Trajectory) -> None:
        """Follow another path from now on, without delay.

        The history of own velocities is kept. The next command starts from the own velocity, as the first one
        of a flight does.
        """
        self._planned = self._trajectory = trajectory
        self._path = trajectory.arrays
        self._settings = settings_of(*self._configured, trajectory)
        history = self._state[k.L_HISTORY]
        k.begin(self._state, self._settings)
        self._state[k.L_HISTORY] = history

    def note_velocity(self, now_s: float, velocity_ned_mps: Vec3) -> None:
        """Add an own velocity between decisions; ignored if it is not newer than the last, or not finite."""
        n, e, d = map(float, velocity_ned_mps)
        k.note_velocity(self._state, self._times, self._velocities, float(now_s), n, e, d)

    def decide(self, situation: Situation) -> LawResult:
        """Make one decision.

        Raises:
            ValueError: the own state is not finite, or the ceiling lies below the floor.
        """
        self._own[:] = _own_row(situation)
        usable = self._take(situation.neighbours)
        k.decide(
            self._neighbours,
            len(usable),
            self._own,
            *self._path,
            self._fence,
            self._settings,
            self._state,
            self._times,
            self._velocities,
            self._planes,
            self._scratch,
            self._view,
            self._out,
        )
        view, out = self._view[: len(usable)].tolist(), self._out.tolist()
        hard, outside = int(out[k.R_HARD]), out[k.R_NEIGHBOURS] > out[k.R_HARD]
        active = [
            moving or standing
            for moving, standing in zip(
                self._binding(self._view[: len(usable), k.V_PLANE : k.V_STANDING]),
                self._binding(self._view[: len(usable), k.V_STANDING :]),
                strict=True,
            )
        ]
        return LawResult(
            wanted_ned_mps=(out[3], out[4], out[5]),
            chosen_ned_mps=(out[0], out[1], out[2]),
            feasible=out[k.R_FEASIBLE] != 0.0,
            conflict=out[k.R_CONFLICT] != 0.0,
            recovering=out[k.R_RECOVERING] != 0.0,
            limits=self._limits(hard, outside),
            tracks=tuple(map(_track, usable, view, active)),
        )

    def _limits(self, hard: int, outside: bool) -> tuple[str, ...]:
        """Names from `LIMITS` of the limits that the velocity found by the law reaches.

        Args:
            hard: number of hard planes.
            outside: whether the aircraft is outside an inclusion area or inside an exclusion area.
        """
        least_down, most_down, *fence = self._binding(self._planes[:hard])
        speed = math.hypot(*self._out[k.R_SOLVED : k.R_SOLVED + 3])
        fast = speed >= self._settings[k.S_SPEED] - _ON_PLANE_MPS
        reached = (least_down, most_down, any(fence), outside, fast)
        return tuple(name for name, on in zip(LIMITS, reached, strict=True) if on)

    def _binding(self, planes: k.Array) -> list[bool]:
        found = self._out[k.R_SOLVED : k.R_SOLVED + 3].tolist()
        return [on_plane(plane, found) for plane in planes.tolist()]

    def _room(self, count: int) -> None:
        self._neighbours = np.zeros((count, k.NEIGHBOUR_COLUMNS))
        self._view = np.zeros((count, k.VIEW_COLUMNS))
        rows = k.plane_rows(len(self._fence), count)
        self._planes, self._scratch = np.zeros((rows, 4)), np.zeros((rows, 4))

    def _take(self, neighbours: Sequence[Neighbour]) -> list[Neighbour]:
        """Fill the table with the usable neighbours, sorted by track id, so that the input's order is
        irrelevant."""
        usable = [n for n in sorted(neighbours, key=_by_id) if -OLDEST_S <= n.age_s <= OLDEST_S]
        if not usable:
            return usable
        rows = np.array(
            [
                (
                    *n.position_ned_m,
                    *n.velocity_ned_mps,
                    max(n.age_s, 0.0),
                    n.sigma_m,
                    n.sigma_mps,
                    n.growth_mps,
                    n.silent,
                    n.share,
                    n.vertical_known,
                    n.crewed,
                )
                for n in usable
            ],
            dtype=np.float64,
        )
        good = np.abs(rows) <= _BELIEVABLE  # False for NaN too
        if not good.all():
            kept = good.all(axis=1)
            rows = rows[kept]
            usable = [usable[i] for i in np.flatnonzero(kept)]
        if len(usable) > len(self._neighbours):
            self._room(2 * len(usable))
        self._neighbours[: len(usable)] = rows
        return usable


def on_plane(plane: Sequence[float], velocity: Sequence[float]) -> bool:
    """Whether a plane (n, d) bounds a velocity: the velocity lies on it, or violates it. False if n = 0."""
    n, e, d, most = plane
    if n == e == d == 0.0:
        return False
    return n * velocity[0] + e * velocity[1] + d * velocity[2] <= most + _ON_PLANE_MPS


def separation_m(avoidance: AvoidanceConfig, crewed: bool) -> tuple[float, float]:
    """Volume to keep clear of around another aircraft: its horizontal radius (m), and the factor on vertical
    distances that makes the volume a ball.

    For crewed traffic it is the ellipsoid around the cylinder of both separations, sqrt(2) wider and taller.
    """
    if crewed:
        scale = avoidance.crewed_horizontal_m / avoidance.crewed_vertical_m
        return math.sqrt(2.0) * avoidance.crewed_horizontal_m, scale
    return 2.0 * avoidance.conflict_radius_m, VERTICAL_SCALE


def horizon_s(avoidance: AvoidanceConfig, crewed: bool) -> float:
    """Time ahead (s) for which conflicts with another aircraft are avoided."""
    return max(CREWED_HORIZON_S, avoidance.horizon_s) if crewed else avoidance.horizon_s


def settings_of(avoidance: AvoidanceConfig, limits: LimitsConfig, trajectory: Trajectory) -> k.Array:
    """Settings of `kernels.decide` for one aircraft and its path, shape (SETTINGS_ENTRIES,)."""
    settings = np.zeros(k.SETTINGS_ENTRIES)
    settings[k.S_LAW] = {"dmuca": k.DMUCA, "paper": k.PAPER, "none": k.NONE}[avoidance.law]
    settings[k.S_RADIUS], settings[k.S_VERTICAL] = separation_m(avoidance, False)
    settings[k.S_CREWED], settings[k.S_CREWED_VERTICAL] = separation_m(avoidance, True)
    settings[k.S_HORIZON], settings[k.S_CREWED_HORIZON] = (
        horizon_s(avoidance, False),
        horizon_s(avoidance, True),
    )
    if avoidance.law == "paper":  # no margin, no turn to the right
        settings[k.S_VERTICAL] = 1.0
        settings[k.S_LOOK] = avoidance.horizon_s
        settings[k.S_OVERLAP] = avoidance.period_s
    else:
        settings[k.S_LEAST_MARGIN] = LEAST_MARGIN_M
        settings[k.S_SIGMAS] = SIGMAS
        settings[k.S_QUANTUM] = QUANTUM_MPS
        settings[k.S_GROWTH] = 1.0
        settings[k.S_OVERLAP] = OVERLAP_S
        settings[k.S_LOOK] = LOOK_S
        settings[k.S_RIGHT] = KEEP_RIGHT_RAD
        settings[k.S_CATCH_UP] = CATCH_UP_S if avoidance.law == "dmuca" else 0.0
    settings[k.S_SPEED] = limits.max_speed_mps
    settings[k.S_CLIMB] = min(limits.max_climb_mps, limits.max_speed_mps)
    settings[k.S_DESCENT] = min(limits.max_descent_mps, limits.max_speed_mps)
    settings[k.S_ACCELERATION] = limits.max_acceleration_mps2
    settings[k.S_PERIOD] = avoidance.period_s
    settings[k.S_RECOVERY] = avoidance.recovery_time_s
    settings[k.S_TURN] = max(
        0.5 * trajectory.largest_turn_mps() / limits.max_acceleration_mps2, _LEAST_TURN_S
    )
    settings[k.S_QUIET] = avoidance.n_noncollide
    settings[k.S_REGAINED] = avoidance.regained_m
    return settings


def _own_row(s: Situation) -> tuple[float, ...]:
    """The own state as input of the kernels. Raises ValueError if `Law.decide` has to."""
    state = (*s.position_ned_m, *s.velocity_ned_mps, s.sigma_m)
    floor = math.inf if s.floor_down_m is None else s.floor_down_m
    ceiling = -math.inf if s.ceiling_down_m is None else s.ceiling_down_m
    if not (math.isfinite(s.now_s) and math.isfinite(s.path_time_s)):
        raise ValueError(f"time is not finite: now {s.now_s} s, path {s.path_time_s} s")
    if not all(-_BELIEVABLE < x < _BELIEVABLE for x in state):  # NaN fails too
        raise ValueError(f"own state is not a finite place and velocity: {state}")
    if not ceiling < floor:
        raise ValueError(f"floor (down {floor} m) must be a number below the ceiling (down {ceiling} m)")
    return (*state, s.now_s, s.path_time_s, floor, ceiling)


def _track(neighbour: Neighbour, view: list[float], active: bool) -> TrackView:
    return TrackView(
        track_id=neighbour.track_id,
        position_ned_m=(view[0], view[1], view[2]),
        velocity_ned_mps=neighbour.velocity_ned_mps,
        age_s=neighbour.age_s,
        radius_m=view[k.V_RADIUS],
        conflict=view[k.V_CONFLICT] != 0.0,
        time_to_closest_s=view[k.V_TIME],
        closest_m=view[k.V_DISTANCE],
        active=active,
        adsb=neighbour.adsb,
    )
