"""State of one flight: the avoidance law with its path, the path's clock, and the height limits."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence

from companion.avoidance.law import Law
from companion.config import LimitsConfig
from companion.geometry import Vec3
from companion.ownship import Ownship

LEAST_HEIGHT_M = 15.0
"""Default floor, above home: if no floor is configured, avoidance goes no lower than the lower of this and
the path's lowest point."""
LEAST_LAYER_M = 5.0
"""Least height between floor and ceiling. The check of the configuration requires the same."""
HOME_MOVED_M = 1.0
"""The vehicle's home has moved if its altitude differs by more than this. Less is noise."""
LEG_S = 30.0
"""The present leg is the path from this long before the path's time to this long after it."""


class Course:
    """Path, path clock and home altitude of one flight at a time."""

    def __init__(self) -> None:
        self.law: Law | None = None
        """Law with the path that it flies; None if there is no path."""
        self.lowest_height_m = 0.0
        """Height of the path's lowest point above home."""
        self.start_s: float | None = None
        """Monotonic time of the path's time 0; None if the path's clock has not started."""
        self.home_alt_msl_m = 0.0
        self.home_up_m = 0.0
        """Height of the vehicle's present home above that home, if home was set in flight; otherwise 0."""
        self._height_now_m = 0.0
        """Height of the vehicle above `home_alt_msl_m`, if home was set in flight."""
        self.places: tuple[Vec3, ...] = ()
        """Places of the whole mission or path (local NED, m); empty if they are not known."""
        self.heights_m: tuple[float, ...] = ()
        """Heights of those places above home."""
        self._profile: tuple[Sequence[float], Sequence[float]] = (), ()
        """Points of the flown path: time on the path's clock (s) and height above home (m) of each."""

    def begin(self, law: Law, home_alt_msl_m: float, start_s: float | None) -> None:
        """Begin a flight. The home altitude stays fixed, even if the autopilot corrects it later, unless the
        plan takes it over (`follow_home`).

        Args:
            start_s: monotonic time of the path's time 0; None to start the clock with `engage`.
        """
        self.law, self.home_alt_msl_m, self.start_s = law, home_alt_msl_m, start_s
        self.home_up_m = 0.0
        self.places, self.heights_m, self._profile = (), (), ((), ())

    def lead(
        self, places: Sequence[Vec3], heights_m: Sequence[float], profile: Sequence[tuple[float, float]]
    ) -> None:
        """Set the places and heights of the flight.

        Args:
            places, heights_m: values of the attributes of the same names.
            profile: points of the flown path: increasing time on the path's clock (s) and height above home
                (m) of each.
        """
        self.places, self.heights_m = tuple(places), tuple(heights_m)
        self._profile = [time_s for time_s, _ in profile], [height_m for _, height_m in profile]

    def note_home(self, own: Ownship) -> None:
        """Note whether home was set in flight. The gate counts floor and ceiling from the present home."""
        if own.position is not None and own.home_alt_msl_m is not None:
            up_m = own.home_alt_msl_m - self.home_alt_msl_m
            self.home_up_m = up_m if abs(up_m) > HOME_MOVED_M else 0.0
            self._height_now_m = own.position.alt_msl_m - self.home_alt_msl_m

    def end(self) -> None:
        """End the flight."""
        self.law = self.start_s = None

    def engage(self, now_s: float) -> None:
        """Start the path's clock, unless it runs already: the vehicle now flies our setpoints."""
        if self.start_s is None:
            self.start_s = now_s

    def follow_home(self, own: Ownship) -> float:
        """Take over the vehicle's home if it has moved: a pilot may set it in flight, and PX4 corrects its
        altitude after take-off. The heights of the path stay where they are, so they are counted from the new
        one. Returns how far the flight's home has risen (m)."""
        home = own.home_alt_msl_m
        if home is None or abs(home - self.home_alt_msl_m) <= HOME_MOVED_M:
            return 0.0
        risen_m, self.home_alt_msl_m = home - self.home_alt_msl_m, home
        self.lowest_height_m -= risen_m
        self.heights_m = tuple(height_m - risen_m for height_m in self.heights_m)
        times, heights = self._profile
        self._profile = times, [height_m - risen_m for height_m in heights]
        return risen_m

    def own_height_m(self, own: Ownship) -> float:
        """Height of the last position above the flight's home, also if the vehicle's home has moved since.
        Needs a position."""
        position, home = own.position, own.home_alt_msl_m
        assert position is not None
        assert home is not None
        moved = abs(home - self.home_alt_msl_m) > HOME_MOVED_M
        return position.alt_msl_m - self.home_alt_msl_m if moved else position.height_above_home_m

    def path_time_s(self, now_s: float) -> float:
        """Time on the path's clock; 0 before it starts."""
        return 0.0 if self.start_s is None else now_s - self.start_s

    @property
    def late_s(self) -> float:
        """How long the path has waited for the aircraft, in seconds. Needs a law."""
        assert self.law is not None
        return self.law.late_s

    def point(self, now_s: float) -> Vec3:
        """Point of the timed path at `now_s` (local NED, m). Needs a law."""
        assert self.law is not None
        return self.law.trajectory.position(self.path_time_s(now_s))

    def distance_m(self, own: Ownship, now_s: float) -> float:
        """Distance of the aircraft from the path's point at `now_s`. Needs a law."""
        return math.dist(self.point(now_s), own.position_ned_m(now_s))

    def leg_heights_m(self, now_s: float) -> tuple[float, float] | None:
        """Least and greatest height (m) above home of the present leg; None if not known. Needs a law."""
        times, heights = self._profile
        if not times:
            return None
        now = self.path_time_s(now_s) - self.late_s
        within = heights[bisect_right(times, now - LEG_S) : bisect_left(times, now + LEG_S)]
        leg = [self._height_m(now - LEG_S), self._height_m(now + LEG_S), *within]
        return min(leg), max(leg)

    def _height_m(self, path_time_s: float) -> float:
        """Height of the path at a time (m above home): that of its first point before it starts, and of its
        last point after it ends."""
        times, heights = self._profile
        after = bisect_right(times, path_time_s)
        if after == 0 or after == len(times):
            return heights[after and -1]
        before = after - 1
        slope = (heights[after] - heights[before]) / (times[after] - times[before])
        return slope * (path_time_s - times[before]) + heights[before]

    def floor_height_m(self, limits: LimitsConfig) -> float:
        """Height of the floor above home: the configured one, else the default.

        If home was set in flight, the configured one counts from both homes and the higher one applies. The
        one above the present home leads no vehicle up: someone else's choice of home moves no vehicle.

        Args:
            limits: configured limits.
        """
        floor_m = limits.floor_height_m
        if floor_m is not None:
            present_m = min(floor_m + self.home_up_m, self._height_now_m)
            return max(floor_m, present_m) if self.home_up_m else floor_m
        ceiling = math.inf if limits.ceiling_height_m is None else limits.ceiling_height_m
        return min(LEAST_HEIGHT_M, self.lowest_height_m, ceiling - LEAST_LAYER_M)

    def ceiling_height_m(self, limits: LimitsConfig) -> float | None:
        """Height of the ceiling above home; None if there is none. As for the floor, both homes count.

        Args:
            limits: configured limits.
        """
        ceiling_m = limits.ceiling_height_m
        if ceiling_m is None or not self.home_up_m:
            return ceiling_m
        least_m = max(self._height_now_m, self.floor_height_m(limits))
        return min(ceiling_m, max(ceiling_m + self.home_up_m, least_m))

    def boundary_down_m(self, height_m: float | None, own: Ownship, now_s: float) -> float | None:
        """Convert a height above home to a NED down coordinate at the aircraft's position.

        Far from the origin, the frame's tangent plane is not level with the ground below the aircraft. The
        aircraft's own altitude is therefore the reference.
        """
        if height_m is None or own.position is None:
            return None
        down_of_sample = own.position_ned_m(own.sample_s())[2]
        return down_of_sample + own.position.alt_msl_m - self.home_alt_msl_m - height_m
