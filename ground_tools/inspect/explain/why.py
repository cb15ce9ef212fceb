"""Why a velocity was chosen: the half-spaces of one logged decision, and what else could have been flown.

A `Decision` contains what the avoidance law saw, wanted and chose. Its half-spaces are recomputed from that
with the law's own `kernels.decide`, never with a second implementation. The result is not bit for bit what
was computed in flight, because a `Decision` does not contain all inputs. The missing ones are assumed as
follows:

- Our share of the avoidance is 1 for crewed traffic and one half for all others. (In flight it is also 1 for
  traffic that cannot manoeuvre.)
- Accuracies are such that the radius is the logged one.
- Crewed traffic has no half-space: the law weighs risks (`companion.avoidance.kernels.crewed`). The law's
  turn away from crewed traffic is left out.
- The second half-space of a track that fell silent (for the place where it would stand) is left out.
- If no floor is configured, it is 15 m above home, or the height flown if that is less.

If all assumptions hold, the half-spaces equal those of the flight to within rounding, given the own
velocities from the record (`Explainer.note`). A test compares them with those of the companion's core.

Which of the half-spaces bound the velocity is taken from the log (`TrackView.active`, `Decision.limits`), not
from this computation. For the exact planes, replay the record through the core (`companion.replay`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.authority.course import LEAST_HEIGHT_M, LEAST_LAYER_M
from companion.avoidance import kernels as k
from companion.avoidance.kernels.neighbours import GROWTH_AHEAD_S
from companion.avoidance.law import (
    LEAST_MARGIN_M,
    LIMITS,
    LOOK_S,
    QUANTUM_MPS,
    SIGMAS,
    horizon_s,
    separation_m,
    settings_of,
)
from companion.avoidance.limits import effective
from companion.avoidance.trajectory import Trajectory
from companion.avoidance.walls import walls_of
from companion.config import AvoidanceConfig, Config
from companion.events import Decision, FenceArea, TrackView, VehicleParameters
from companion.geometry import LocalFrame, Vec3
from companion.traffic.adsb import SIGMA_DOWN_M
from companion.traffic.right_of_way import CREWED, FREE, share_of

KEPT_MPS = k.SLACK_MPS
"""A half-space violated by no more than this counts as kept."""
TURNS_DEG = (15, 30, 45, 60, 75, 90)
"""Turns that are tried as alternatives, to the right and to the left."""
_USUAL_TURN_DEG = 45
_AHEAD_S = 60.0
_LEAST_SPEED_MPS = 0.3
"""Least horizontal speed of a velocity for which turns are tried."""


@dataclass(frozen=True, slots=True)
class HalfSpace:
    """A constraint: velocities v (NED, m/s) with normal . v >= least_mps are allowed."""

    cause: str
    """Track id, or one of `law.LIMITS`."""
    track: bool
    """True if the cause is a track."""
    normal_ned: Vec3
    """Unit normal that points to the allowed side."""
    least_mps: float
    active: bool
    """True if the half-space bounded the velocity that was found, according to the log."""

    @property
    def point_ned_mps(self) -> Vec3:
        """The point of the plane nearest to zero velocity."""
        n, e, d = self.normal_ned
        return (n * self.least_mps, e * self.least_mps, d * self.least_mps)

    def short_mps(self, velocity: Vec3) -> float:
        """Return by how much a velocity violates the half-space; 0 or less if the velocity is allowed."""
        return self.least_mps - sum(a * b for a, b in zip(self.normal_ned, velocity, strict=True))


@dataclass(frozen=True, slots=True)
class Alternative:
    """A velocity that could have been flown, and its outcome if every track keeps its velocity."""

    name: str
    velocity_ned_mps: Vec3
    closest_track: str | None
    """The track that it would have come nearest to within the law's look-ahead time; None without tracks."""
    closest_m: float | None
    """Slant distance to that track at the closest approach."""
    closest_in_s: float | None
    """Time until the closest approach."""
    enters: tuple[str, ...]
    """Tracks whose volume (separation plus margin) it would have entered."""
    excluded_by: tuple[tuple[str, float], ...]
    """Constraints that it violates, and by how much (m/s), the largest violation first."""
    from_wanted_mps: float
    """Distance from the wanted velocity. The law takes the nearest allowed velocity."""


@dataclass(frozen=True, slots=True)
class Look:
    """Explanation of one decision."""

    half_spaces: tuple[HalfSpace, ...]
    alternatives: tuple[Alternative, ...]
    """The first one is the velocity that the law found. The command follows it as fast as the acceleration
    limit allows."""


class Explainer:
    """Explains decisions of one aircraft. Calls of `note` beforehand make the half-spaces more accurate."""

    def __init__(self, config: Config) -> None:
        """
        Args:
            config: Configuration from the record's header.
        """
        self.configure(config, None, config.fence)
        self._samples = 0
        self._history = k.History(np.zeros(k.HISTORY_SAMPLES), np.zeros((k.HISTORY_SAMPLES, 3)))

    def configure(
        self, config: Config, vehicle: VehicleParameters | None, areas: Sequence[FenceArea]
    ) -> None:
        """Set the configuration that applies from now on.

        Args:
            config: Configuration of the companion.
            vehicle: The vehicle's own limits; None if unknown.
            areas: Areas of the fence that applies.
        """
        self._avoidance: AvoidanceConfig = config.avoidance
        self._configured = config.limits
        self._limits = effective(config.limits, vehicle)
        self._areas = tuple(areas)

    def note(self, now_s: float, velocity_ned_mps: Vec3) -> None:
        """Record the own velocity before a decision, as the companion's core does at every step."""
        self._samples = k.note_velocity(*self._history, self._samples, now_s, velocity_ned_mps)

    def look(
        self, now_s: float, decision: Decision, height_m: float | None = None, sigma_m: float = 0.0
    ) -> Look:
        """Return the half-spaces and alternatives of a decision.

        Args:
            now_s: Time of the decision.
            decision: The logged decision.
            height_m: Own height above home; None if unknown, which leaves out floor and ceiling.
            sigma_m: Own horizontal standard deviation, by which a fence's margin grows.
        """
        spaces, solved = self._half_spaces(now_s, decision, height_m, sigma_m)
        speed, climb = self._limits.max_speed_mps, self._limits.max_climb_mps
        found = self._alternative("the law's velocity", solved, decision, spaces)
        wanted = self._alternative("keep the wanted velocity", decision.wanted_ned_mps, decision, spaces)
        others = [self._alternative("stop", (0.0, 0.0, 0.0), decision, spaces)]
        n, e, _ = decision.wanted_ned_mps
        if math.hypot(n, e) >= _LEAST_SPEED_MPS:
            others += [self._turn(side, decision, spaces) for side in (1, -1)]
        for name, down in (
            ("climb", -min(climb, speed)),
            ("descend", min(self._limits.max_descent_mps, speed)),
        ):
            level = math.sqrt(max(speed * speed - down * down, 0.0))
            share = min(level / max(math.hypot(n, e), 1e-9), 1.0)
            others.append(
                self._alternative(
                    f"{name} at {abs(down):.1f} m/s", (share * n, share * e, down), decision, spaces
                )
            )
        return Look(spaces, (found, wanted, *others))

    def _turn(self, side: int, decision: Decision, spaces: tuple[HalfSpace, ...]) -> Alternative:
        """Return the smallest allowed turn of `TURNS_DEG`; if none is allowed, that by `_USUAL_TURN_DEG`."""
        n, e, d = decision.wanted_ned_mps
        found: dict[int, Alternative] = {}
        for degrees in TURNS_DEG:
            c, s = math.cos(math.radians(degrees)), side * math.sin(math.radians(degrees))
            name = f"turn {'right' if side > 0 else 'left'} by {degrees} deg"
            found[degrees] = self._alternative(name, (c * n - s * e, s * n + c * e, d), decision, spaces)
            if not found[degrees].excluded_by:
                return found[degrees]
        return found[_USUAL_TURN_DEG]

    def _half_spaces(
        self, now_s: float, decision: Decision, height_m: float | None, sigma_m: float
    ) -> tuple[tuple[HalfSpace, ...], Vec3]:
        """Return the half-spaces, and the velocity that the law finds in them."""
        here, want = decision.position_ned_m, decision.wanted_ned_mps
        # A straight path through this position at the wanted velocity makes the law prefer that velocity.
        straight = Trajectory(
            [-_AHEAD_S, _AHEAD_S],
            [
                (here[0] + t * want[0], here[1] + t * want[1], here[2] + t * want[2])
                for t in (-_AHEAD_S, _AHEAD_S)
            ],
        )
        settings = settings_of(self._avoidance, self._limits, straight)
        fence = walls_of(self._areas, LocalFrame(*decision.origin), None, 0.0)
        tracks = decision.tracks
        neighbours = np.zeros((len(tracks) + 1, k.OTHER_COLUMNS))
        for row, track in enumerate(tracks):
            neighbours[row] = self._neighbour(track, decision, sigma_m)
        own = k.Own(
            k.Vector(*here), k.Vector(*decision.velocity_ned_mps), sigma_m, now_s, 0.0,
            *self._boundaries(here[2], height_m),
        )  # fmt: skip
        state = k.first_state(settings, self._samples)
        # Work on copies, so that this computation does not change the history.
        history, work = (
            k.History(*(array.copy() for array in self._history)),
            k.workspace(len(fence), len(tracks)),
        )
        made = k.decide(
            neighbours, len(tracks), own, k.Path(*straight.arrays), fence, settings, state, history, work
        )
        found = []
        for number in range(made.hard):
            (n, e, d), least = plane = k.plane_at(work.planes, number)
            cause = LIMITS[min(number, k.DOWN_SPEEDS)]
            bounds = number < k.DOWN_SPEEDS or k.on_plane(plane, made.solved)
            found.append(HalfSpace(cause, False, (n, e, d), least, cause in decision.limits and bounds))
        for track, asked in zip(tracks, work.asked, strict=True):
            (n, e, d), least = k.plane_at(asked, 0)
            if (n, e, d) == (0.0, 0.0, 0.0):  # crewed traffic
                continue
            found.append(HalfSpace(track.track_id, True, (n, e, d), least, track.active))
        return tuple(found), made.solved

    def _neighbour(self, track: TrackView, decision: Decision, own_sigma_m: float) -> k.Other:
        """The track with its position at its message, and with an accuracy and a growth that give the logged
        volume."""
        crewed = self._crewed(track)
        age = max(track.age_s, 0.0)
        separation, scale = separation_m(self._avoidance, crewed)
        height = track.height_m or track.radius_m / scale
        narrow = min(track.radius_m, scale * height)
        n, e, d = (p - age * v for p, v in zip(track.position_ned_m, track.velocity_ned_mps, strict=True))
        sigma = max(narrow - separation - QUANTUM_MPS * age, LEAST_MARGIN_M) / SIGMAS
        # A margin below that of the own error alone shows that the own error is not part of it.
        relative = sigma < own_sigma_m
        wider, taller = track.radius_m - narrow, scale * height - narrow
        ahead = age + GROWTH_AHEAD_S
        return k.Other(
            n,
            e,
            d,
            *track.velocity_ned_mps,
            age_s=age,
            sigma_m=sigma if relative else math.sqrt(max(sigma * sigma - own_sigma_m * own_sigma_m, 0.0)),
            sigma_mps=0.0,
            growth_mps=(wider + QUANTUM_MPS * age) / ahead if wider > 0.0 else 0.0,
            silent=0.0,
            share=share_of(FREE, CREWED if crewed else FREE),
            # The kernel puts a track without a known height at exactly our own height.
            vertical_known=float(track.position_ned_m[2] != decision.position_ned_m[2]),
            crewed=float(crewed),
            growth_down_mps=(taller + QUANTUM_MPS * age) / ahead if taller > 0.0 else 0.0,
            turn_rps=0.0,
            sigma_down_m=SIGMA_DOWN_M if crewed else 0.0,
            yields=float(track.yields),
            relative=float(relative),
        )

    def _crewed(self, track: TrackView) -> bool:
        return track.adsb and track.radius_m >= separation_m(self._avoidance, True)[0]

    def _boundaries(self, down_m: float, height_m: float | None) -> tuple[float, float]:
        """Return the NED down coordinates of floor and ceiling."""
        if height_m is None:
            return math.inf, -math.inf
        floor, ceiling = self._configured.floor_height_m, self._configured.ceiling_height_m
        if floor is None:
            below = math.inf if ceiling is None else ceiling - LEAST_LAYER_M
            floor = min(LEAST_HEIGHT_M, height_m, below)
        highest = -math.inf if ceiling is None else down_m + height_m - ceiling
        return down_m + height_m - floor, highest

    def _alternative(
        self, name: str, velocity: Vec3, decision: Decision, spaces: tuple[HalfSpace, ...]
    ) -> Alternative:
        nearest: tuple[float, float, str] | None = None
        enters = []
        for track in decision.tracks:
            crewed = self._crewed(track)
            away = [a - b for a, b in zip(track.position_ned_m, decision.position_ned_m, strict=True)]
            closing = [a - b for a, b in zip(velocity, track.velocity_ned_mps, strict=True)]
            if away[2] == 0.0:  # the track's height is unknown
                closing[2] = 0.0
            look = max(LOOK_S, horizon_s(self._avoidance, crewed))
            t, near2 = k.closest(k.Vector(*away), k.Vector(*closing), look)
            if nearest is None or near2 < nearest[0]:
                nearest = near2, t, track.track_id
            scale = separation_m(self._avoidance, crewed)[1]
            if track.height_m > 0.0:
                scale = track.radius_m / track.height_m
            elif self._avoidance.law == "paper":
                scale = 1.0
            away[2], closing[2] = scale * away[2], scale * closing[2]
            _, near2 = k.closest(k.Vector(*away), k.Vector(*closing), look)
            if near2 < track.radius_m * track.radius_m:
                enters.append(track.track_id)
        yielding = {track.track_id for track in decision.tracks if track.yields}
        if len(yielding) == len(decision.tracks):
            yielding = set()
        # A track that yields excludes nothing, unless all tracks yield.
        short = [
            (space.cause, space.short_mps(velocity))
            for space in spaces
            if not (space.track and space.cause in yielding)
        ]
        worst: dict[str, float] = {}
        for cause, missing in short:
            if missing > KEPT_MPS:
                worst[cause] = max(worst.get(cause, 0.0), missing)
        return Alternative(
            name=name,
            velocity_ned_mps=velocity,
            closest_track=None if nearest is None else nearest[2],
            closest_m=None if nearest is None else math.sqrt(nearest[0]),
            closest_in_s=None if nearest is None else nearest[1],
            enters=tuple(enters),
            excluded_by=tuple(sorted(worst.items(), key=lambda pair: (-pair[1], pair[0]))),
            from_wanted_mps=math.dist(velocity, decision.wanted_ned_mps),
        )


def alternatives(decision: Decision, config: Config) -> Look:
    """Explain a single decision, without the own velocities before it, and without floor and ceiling.

    An `Explainer` that has followed the whole record is more accurate.
    """
    return Explainer(config).look(0.0, decision)
