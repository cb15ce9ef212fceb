"""The timed path that an aircraft is to fly: straight legs between waypoints in local NED.

Times are in seconds on the path's own clock. Before its start and after its end, the path stays at its first
and last point. The paper calls it p_traj(t) (section II, "Decide").
"""

from __future__ import annotations

import bisect
import copy
import itertools
import math
from collections.abc import Sequence

import numpy as np

from companion.arrays import Floats
from companion.avoidance import kernels
from companion.avoidance.limits import effective, lower_ones
from companion.config import LimitsConfig
from companion.errors import ConfigError
from companion.events import VehicleParameters
from companion.geometry import Vec3

_TOLERANCE = 1e-3
"""Relative tolerance of `check_speeds`, so that a leg planned exactly at a limit passes in spite of rounding
and of different ways to measure distances on the ellipsoid. Commands obey the limit itself."""

_STILL: Vec3 = (0.0, 0.0, 0.0)


class Trajectory:
    """A timed piecewise-linear path. Immutable; `delayed` gives a later copy."""

    __slots__ = ("_legs", "_points", "_points_array", "_times", "_times_array")

    def __init__(self, times_s: Sequence[float], points_ned_m: Sequence[Vec3]) -> None:
        """Check and keep the waypoints.

        Args:
            times_s: at least two, strictly rising, on the path's clock.
            points_ned_m: one NED point (m) for each time.

        Raises:
            ConfigError: names the waypoint (counted from 0) that is wrong.
        """
        times = tuple(float(t) for t in times_s)
        points = tuple((float(n), float(e), float(d)) for n, e, d in points_ned_m)
        if len(times) != len(points) or len(times) < 2:
            raise ConfigError(
                f"path: {len(times)} times and {len(points)} points; it needs two or more of each"
            )
        for number, (t, point) in enumerate(zip(times, points, strict=True)):
            if not all(map(math.isfinite, (t, *point))):
                raise ConfigError(
                    f"path: waypoint[{number}]: {(t, *point)} holds a number that is not finite"
                )
            if number and t <= times[number - 1]:
                raise ConfigError(
                    f"path: waypoint[{number}]: {t:g} s is not after the one before it "
                    f"({times[number - 1]:g} s)"
                )
        self._times = times
        self._points = points
        self._times_array = np.array(times)
        self._points_array = np.array(points)
        self._legs = tuple(
            _leg_velocity(points[k], points[k + 1], times[k + 1] - times[k]) for k in range(len(times) - 1)
        )

    @classmethod
    def from_rows(cls, rows: Floats) -> Trajectory:
        """A path from an array of shape (K, 4): rows of time (s), north, east, down (m)."""
        return cls(rows[:, 0].tolist(), [(r[1], r[2], r[3]) for r in rows.tolist()])

    @property
    def times_s(self) -> tuple[float, ...]:
        """Times of the waypoints, s."""
        return self._times

    @property
    def points_ned_m(self) -> tuple[Vec3, ...]:
        """Waypoints, NED, m."""
        return self._points

    @property
    def legs_ned_mps(self) -> tuple[Vec3, ...]:
        """Velocity on each leg, NED, m/s."""
        return self._legs

    @property
    def start_s(self) -> float:
        """Time of the first waypoint."""
        return self._times[0]

    @property
    def end_s(self) -> float:
        """Time of the last waypoint: the expected arrival."""
        return self._times[-1]

    @property
    def arrays(self) -> tuple[Floats, Floats]:
        """Times, shape (K,), and waypoints, shape (K, 3): the fields of `kernels.Path`."""
        return self._times_array, self._points_array

    def position(self, t_s: float) -> Vec3:
        """Point of the path (NED, m) at a time; the first or last point before the start or after the end."""
        return kernels.path_position(self._times_array, self._points_array, float(t_s))

    def velocity(self, t_s: float) -> Vec3:
        """Velocity of the path (NED, m/s) at a time; zero before the start and from the end on.

        At a waypoint it is the velocity of the leg that begins there.
        """
        if not self._times[0] <= t_s < self._times[-1]:
            return _STILL
        return self._legs[bisect.bisect_right(self._times, t_s) - 1]

    def largest_turn_mps(self) -> float:
        """Largest change of velocity (m/s) at a waypoint; the path begins and ends at rest."""
        legs = (_STILL, *self._legs, _STILL)
        return max(math.dist(a, b) for a, b in itertools.pairwise(legs))

    def nearest(self, position_ned_m: Vec3) -> tuple[float, Vec3]:
        """Time and place of the path's point nearest to a position; the earliest if several are equally
        near."""
        n, e, d = map(float, position_ned_m)
        return kernels.path_nearest(self._times_array, self._points_array, n, e, d)

    def max_speed(self) -> float:
        """Speed of the fastest leg (m/s)."""
        return max(math.hypot(*leg) for leg in self._legs)

    def delayed(self, delay_s: float) -> Trajectory:
        """A copy of the path with every waypoint `delay_s` later.

        Times that differ by less than the rounding of the sum become equal. They are not checked again,
        because this is called in flight.
        """
        later = copy.copy(self)
        later._times = tuple(t + delay_s for t in self._times)
        later._times_array = np.array(later._times)
        return later


def check_speeds(
    trajectory: Trajectory,
    limits: LimitsConfig,
    name: str = "path",
    vehicle: VehicleParameters | None = None,
) -> None:
    """Check that every leg's planned speed is within the configured limits and the vehicle's own.

    Args:
        name: name of the path, for messages.
        vehicle: the vehicle's own limits; None: not known.

    Raises:
        ConfigError: names the leg (between two waypoints counted from 0), its speed and the limit.
    """
    counts, own = effective(limits, vehicle), lower_ones(limits, vehicle)
    for number, (n, e, d) in enumerate(trajectory.legs_ned_mps):
        for what, speed, key, limit in (
            ("horizontal speed", math.hypot(n, e), "max_speed_mps", counts.max_speed_mps),
            ("climb", -d, "max_climb_mps", counts.max_climb_mps),
            ("descent", d, "max_descent_mps", counts.max_descent_mps),
            ("total speed", math.hypot(n, e, d), "max_speed_mps", counts.max_speed_mps),
        ):
            if speed > limit * (1.0 + _TOLERANCE):
                whose = f"limits.{key}" if key not in own else f"the vehicle's {own[key].name}"
                raise ConfigError(
                    f"{name}: leg from waypoint[{number}] to waypoint[{number + 1}]: {what} {speed:.3f} m/s "
                    f"is above {whose} {limit:g}"
                )


def _leg_velocity(a: Vec3, b: Vec3, duration_s: float) -> Vec3:
    return ((b[0] - a[0]) / duration_s, (b[1] - a[1]) / duration_s, (b[2] - a[2]) / duration_s)
