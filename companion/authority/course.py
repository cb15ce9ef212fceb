"""What is flown: the law with its path, the path's clock, and the heights that it is bound to."""

from __future__ import annotations

import math

from companion.avoidance.law import Law
from companion.config import LimitsConfig
from companion.geometry import Vec3
from companion.ownship import Ownship

LEAST_HEIGHT_M = 15.0
"""Above home: where no floor is given, avoidance goes no lower than this or the path's lowest point."""
LEAST_LAYER_M = 5.0
"""Between floor and ceiling, as a configuration must leave."""


class Course:
    """Of one flight at a time."""

    def __init__(self) -> None:
        self.law: Law | None = None
        """None: there is no path."""
        self.lowest_height_m = 0.0
        """The path's lowest point, above home."""
        self.start_s: float | None = None
        """Monotonic time of the path's time 0; None: its clock has not started."""
        self.home_alt_msl_m = 0.0

    def begin(self, law: Law, home_alt_msl_m: float, start_s: float | None) -> None:
        """A flight begins. Home stays where it is now, whatever the autopilot corrects later.

        Args:
            start_s: monotonic time of the path's time 0; None: it starts with `engage`.
        """
        self.law, self.home_alt_msl_m, self.start_s = law, home_alt_msl_m, start_s

    def end(self) -> None:
        """The flight is over."""
        self.law = self.start_s = None

    def engage(self, now_s: float) -> None:
        """The vehicle flies what we command: the path's clock starts, unless it runs already."""
        if self.start_s is None:
            self.start_s = now_s

    def path_time_s(self, now_s: float) -> float:
        """Time on the path's clock; 0 before it starts."""
        return 0.0 if self.start_s is None else now_s - self.start_s

    @property
    def late_s(self) -> float:
        """By how much the path has waited for the aircraft. Needs a law."""
        assert self.law is not None
        return self.law.late_s

    def point(self, now_s: float) -> Vec3:
        """The timed path's point for now (local NED, m). Needs a law."""
        assert self.law is not None
        return self.law.trajectory.position(self.path_time_s(now_s))

    def distance_m(self, own: Ownship, now_s: float) -> float:
        """How far the aircraft is from that point. Needs a law."""
        return math.dist(self.point(now_s), own.position_ned_m(now_s))

    def floor_height_m(self, limits: LimitsConfig) -> float:
        """Above home.

        Args:
            limits: as configured.
        """
        if limits.floor_height_m is not None:
            return limits.floor_height_m
        ceiling = math.inf if limits.ceiling_height_m is None else limits.ceiling_height_m
        return min(LEAST_HEIGHT_M, self.lowest_height_m, ceiling - LEAST_LAYER_M)

    def boundary_down_m(self, height_m: float | None, own: Ownship, now_s: float) -> float | None:
        """NED down of a height above home, at the aircraft's own place: the plane of the frame is not level
        with it far from the origin."""
        if height_m is None or own.position is None:
            return None
        down_of_sample = own.position_ned_m(own.sample_s())[2]
        return down_of_sample + own.position.alt_msl_m - self.home_alt_msl_m - height_m
