"""The avoidance law: own state, timed path and neighbours in, one velocity out (paper section II, "Decide").

Three laws share one interface, the same limits and the same kernel (`companion.laws` lists them, and those
that have a file of their own; `plugin_law` flies those of plug-ins):

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
import pkgutil
import struct
from collections.abc import Sequence
from itertools import compress
from operator import attrgetter

import msgspec
import numpy as np

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from companion.events import TrackView
from companion.geometry import Vec3
from companion.laws import kind_of

OLDEST_S = k.KEPT_MORE * k.KEPT_S
"""Neighbours whose message is older than this are ignored."""
LEAST_MARGIN_M = 2.0
SIGMAS = 4.0
"""Margin for accuracy in standard deviations of the relative horizontal error; the margin is at least
LEAST_MARGIN_M. The error of two axes exceeds it with probability exp(-4^2 / 2) = 0.03 %."""
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
OVERLAP_S = 1.0
LOOK_S = 30.0
KEEP_RIGHT_RAD = 0.2

LIMITS = ("climb or ceiling", "descent or floor", "fence", "outside the fence", "speed")
"""Names of the limits, other than other aircraft, that can bound a decision's velocity."""

_LEAST_TURN_S = 0.01

_by_id = attrgetter("track_id")


ASIDE = "\N{PRIME}"
"""Separator in a `Neighbour.track_id` before the number (or `traffic.places.SIGNAL_PLACE`) of an alternative
place of the track. No track's own id contains it, because ids from Remote ID are Latin-1."""


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
    """How fast its horizontal position deviates from its predictions (`kernels.Past`)."""
    silent: bool = False
    """True: it may have stopped, because it is `unheard` or reports that it has no position."""
    share: float = 0.5
    """Our share of the velocity change that avoids it, 0.5 to 1 (`right_of_way`)."""
    vertical_known: bool = True
    """False: assumed to fly at our height, so that it is not passed above or below."""
    crewed: bool = False
    """True: the separations from crewed traffic apply."""
    adsb: bool = False
    """True: received by ADS-B; then `track_id` is its ICAO address."""
    proven: bool = False
    """True: a signature has verified its identity. What it says may still be false."""
    group: str = ""
    """Group with which it shares an allowance: tracks that appeared together or resemble each other; "":
    none."""
    growth_down_mps: float = 0.0
    """How fast its height deviates from its predictions."""
    turn_rps: float = 0.0
    """Turn rate, positive to the right; for crewed traffic."""
    sigma_down_m: float = 0.0
    """Error of the difference of its height and ours, one standard deviation; for crewed traffic."""
    together: bool = False
    """True: it appeared in a burst of new tracks."""
    split: bool = False
    """True: another track had its name first. Either of them may be a copy."""
    known_s: float = 0.0
    """Time since it was first received."""
    yields: bool = False
    """True: it is avoided only as far as all others allow, because it may be forged to press on us."""
    presses: bool = False
    """True: it yields, and has been inside its volume or follows us. The law of a plug-in is not given such a
    neighbour while another one is near."""
    relative: bool = False
    """True: its position was measured from ours. Then the error of our position plays no part, and `sigma_m`
    is that of the measurement."""
    unheard: bool = False
    """True: not received for some time (`kernels.silent_after`)."""


class Situation(msgspec.Struct, frozen=True):
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


class LawResult(msgspec.Struct, frozen=True):
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

    It checks the input, fills the table of neighbours for `kernels.decide`, which makes the decision, and
    reads its result.
    """

    fault: str | None = None
    """Why its decisions must not be flown any longer, in words; None: they may be. Only the law of a plug-in
    can fail."""

    def __init__(
        self,
        avoidance: AvoidanceConfig,
        limits: LimitsConfig,
        trajectory: Trajectory,
        fence: Floats | None = None,
    ) -> None:
        """A law at the start of a flight.

        Args:
            fence: walls from `walls.walls_of`; None: no fence.
        """
        self._configured_fence = self._fence = k.NO_WALLS if fence is None else fence
        self._configured = avoidance, limits
        self._planned = self._trajectory = trajectory
        self._settings = settings_of(avoidance, limits, trajectory)
        self._state = k.first_state(self._settings, 0)
        self._samples = 0
        """Number of samples in the history, also of those since the last decision."""
        self._history = np.zeros(k.HISTORY_SAMPLES), np.zeros((k.HISTORY_SAMPLES, 3))
        self._room(32)

    @property
    def late_s(self) -> float:
        """Delay of the path so far, s."""
        return self._state.delay_s

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
        self._settings = settings_of(*self._configured, trajectory)
        self._state = k.first_state(self._settings, self._samples)

    def enclose(self, walls: Floats) -> None:
        """Keep further walls from the next decision on, besides those of the fence.

        Args:
            walls: a table with the columns of `kernels.Wall`; `kernels.NO_WALLS` to keep the fence alone.
        """
        fence = self._configured_fence
        self._fence = np.concatenate([fence, walls]) if len(walls) else fence
        self._room(len(self._table))

    def note_velocity(self, now_s: float, velocity_ned_mps: Vec3) -> None:
        """Add an own velocity between decisions; ignored if it is not newer than the last, or not finite."""
        n, e, d = map(float, velocity_ned_mps)
        self._samples = k.note_velocity(*self._history, self._samples, float(now_s), (n, e, d))

    def decide(self, situation: Situation) -> LawResult:
        """Make one decision.

        Raises:
            ValueError: the own state is not finite, or the ceiling lies below the floor.
        """
        own = own_of(situation)
        usable = self._take(situation.neighbours)
        chosen, wanted, solved, flags, (hard, first), state = k.decide_plain(
            self._table, len(usable), own, self._planned.arrays, self._fence, (*self._settings,),
            ((*self._state.command,), *self._state[1:-1], self._samples), self._history, (*self._work,),
        )  # fmt: skip
        self._state, self._solved, self._hard = k.State(k.Vector(*state[0]), *state[1:]), solved, hard
        self._samples = self._state.samples
        feasible, conflict, recovering, *bounds = flags
        return LawResult(
            wanted_ned_mps=wanted,
            chosen_ned_mps=chosen,
            feasible=feasible,
            conflict=conflict,
            recovering=recovering,
            limits=self._reached(solved, bounds, outside=first > hard),
            tracks=_views(usable, self._work.seen[: len(usable)]),
        )

    def _reached(self, solved: Vec3, bounds: Sequence[bool], *, outside: bool) -> tuple[str, ...]:
        """Names of the limits that bound a velocity.

        Args:
            bounds: whether the greatest climb, the greatest descent and a fence do.
        """
        fast = math.hypot(*solved) >= self._settings.speed_mps - k.ON_PLANE_MPS
        return tuple(compress(LIMITS, (*bounds, outside, fast)))

    def _room(self, count: int) -> None:
        self._table = np.zeros((count, k.OTHER_COLUMNS))
        self._work = k.workspace(len(self._fence), count)

    def _take(self, neighbours: Sequence[Neighbour]) -> list[Neighbour]:
        """Fill the table with the usable neighbours, sorted by track id, so that the input's order is
        irrelevant."""
        usable = self._fill(sorted(neighbours, key=_by_id))
        if not k.all_within(self._table, len(usable), _BELIEVABLE):
            good = (np.abs(self._table[: len(usable)]) <= _BELIEVABLE).all(axis=1)  # False for NaN too
            usable = self._fill([usable[i] for i in np.flatnonzero(good)])
        return usable

    def _fill(self, neighbours: Sequence[Neighbour]) -> list[Neighbour]:
        """Fill the table with those neighbours that are not too old, and return them. The columns are the
        fields of `kernels.Other`."""
        usable: list[Neighbour] = []
        entries: list[float] = []
        for n in neighbours:
            age_s = n.age_s
            if -OLDEST_S <= age_s <= OLDEST_S:
                usable.append(n)
                entries += n.position_ned_m
                entries += n.velocity_ned_mps
                # A truth value is packed more slowly than a number.
                entries += (
                    age_s if age_s > 0.0 else 0.0, n.sigma_m, n.sigma_mps, n.growth_mps,
                    1.0 if n.silent else 0.0, n.share, 1.0 if n.vertical_known else 0.0,
                    1.0 if n.crewed else 0.0, n.growth_down_mps, n.turn_rps, n.sigma_down_m,
                    1.0 if n.yields else 0.0, 1.0 if n.relative else 0.0,
                )  # fmt: skip
        if len(usable) > len(self._table):
            self._room(2 * len(usable))
        # Twice as fast as an assignment to the array; native numbers ("d" without "=") are the faster ones.
        struct.pack_into(f"{len(entries)}d", self._table.data, 0, *entries)
        return usable


def new_law(
    avoidance: AvoidanceConfig,
    limits: LimitsConfig,
    trajectory: Trajectory,
    fence: Floats | None = None,
) -> Law:
    """The configured law at the start of a flight. Arguments are those of `Law`."""
    law: Law = pkgutil.resolve_name(kind_of(avoidance.law).made_by)(avoidance, limits, trajectory, fence)
    return law


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


def settings_of(avoidance: AvoidanceConfig, limits: LimitsConfig, trajectory: Trajectory) -> k.Settings:
    """Settings of `kernels.decide` for one aircraft and its path."""
    paper = avoidance.law == "paper"  # no margin, no turn to the right
    radius, vertical = separation_m(avoidance, False)
    crewed, crewed_vertical = separation_m(avoidance, True)
    turn = 0.5 * trajectory.largest_turn_mps() / limits.max_acceleration_mps2
    settings = k.Settings(
        # Any other law starts from the decision of a kernel that avoids nobody.
        law={"dmuca": k.DMUCA, "paper": k.PAPER}.get(avoidance.law, k.NONE),
        radius_m=radius,
        least_margin_m=0.0 if paper else LEAST_MARGIN_M,
        sigmas=0.0 if paper else SIGMAS,
        quantum_mps=0.0 if paper else QUANTUM_MPS,
        growth=0.0 if paper else 1.0,
        crewed_m=crewed,
        crewed_vertical=crewed_vertical,
        crewed_horizon_s=horizon_s(avoidance, True),
        vertical=1.0 if paper else vertical,
        horizon_s=horizon_s(avoidance, False),
        overlap_s=avoidance.period_s if paper else OVERLAP_S,
        look_s=avoidance.horizon_s if paper else LOOK_S,
        right_rad=0.0 if paper else KEEP_RIGHT_RAD,
        speed_mps=limits.max_speed_mps,
        climb_mps=min(limits.max_climb_mps, limits.max_speed_mps),
        descent_mps=min(limits.max_descent_mps, limits.max_speed_mps),
        acceleration_mps2=limits.max_acceleration_mps2,
        period_s=avoidance.period_s,
        recovery_s=avoidance.recovery_time_s,
        turn_s=max(turn, _LEAST_TURN_S),
        quiet=avoidance.n_noncollide,
        regained_m=avoidance.regained_m,
        catch_up_s=CATCH_UP_S if kind_of(avoidance.law).avoids and not paper else 0.0,
    )
    return k.Settings._make(map(float, settings))  # with an int, numba would compile anew in flight


def own_of(s: Situation) -> tuple[Vec3, Vec3, float, float, float, float, float]:
    """The own state as plain fields of `kernels.Own`. Raises ValueError if `Law.decide` has to."""
    n, e, d = map(float, s.position_ned_m)
    vn, ve, vd = map(float, s.velocity_ned_mps)
    sigma = float(s.sigma_m)
    state = (n, e, d, vn, ve, vd, sigma)
    floor = math.inf if s.floor_down_m is None else float(s.floor_down_m)
    ceiling = -math.inf if s.ceiling_down_m is None else float(s.ceiling_down_m)
    if not (math.isfinite(s.now_s) and math.isfinite(s.path_time_s)):
        raise ValueError(f"time is not finite: now {s.now_s} s, path {s.path_time_s} s")
    # The order of NaN among numbers is undefined, but their sum is NaN.
    if not (max(map(abs, state)) < _BELIEVABLE and math.isfinite(sum(state))):
        raise ValueError(f"own state is not a finite place and velocity: {state}")
    if not ceiling < floor:
        raise ValueError(f"floor (down {floor} m) must be a number below the ceiling (down {ceiling} m)")
    return (n, e, d), (vn, ve, vd), sigma, float(s.now_s), float(s.path_time_s), floor, ceiling


def _views(neighbours: Sequence[Neighbour], seen: Floats) -> tuple[TrackView, ...]:
    """The reports on neighbours, from their rows in the table of reports."""
    return tuple(
        [
            TrackView(
                track_id=neighbour.track_id,
                position_ned_m=(n, e, d),
                velocity_ned_mps=neighbour.velocity_ned_mps,
                age_s=neighbour.age_s,
                radius_m=radius_m,
                conflict=conflict != 0.0,
                time_to_closest_s=time_s,
                closest_m=distance_m,
                active=active != 0.0,
                adsb=neighbour.adsb,
                height_m=height_m,
                yields=neighbour.yields,
            )
            for neighbour, (n, e, d, radius_m, conflict, time_s, distance_m, active, height_m) in zip(
                neighbours, seen.tolist(), strict=True
            )
        ]
    )
