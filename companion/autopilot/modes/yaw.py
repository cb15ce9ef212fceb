"""Yaw while the companion flies: the nose faces the direction of flight, or the heading is held.

Without a yaw in the setpoint the firmwares differ: PX4 holds the heading, and ArduPilot turns the nose as
WP_YAW_BEHAVIOR says. So every setpoint specifies it. PX4 would turn to a new angle as fast as it can, so the
commanded angle changes slowly.
"""

from __future__ import annotations

import math
from typing import Literal

from companion.geometry import Vec3

LEAST_MPS = 1.0
"""Least horizontal speed at which the nose follows the velocity. At a lower speed the direction means little,
and the nose would spin in hover."""
RATE_RADPS = math.radians(45.0)
PAUSE_S = 1.0
"""After a longer pause in the setpoints, the yaw starts from the heading that the vehicle reports, not from
the last commanded yaw."""
_UNKNOWN_CDEG = 36_000


class Nose:
    """Computes the yaw of each setpoint."""

    def __init__(self, policy: Literal["face", "hold"]) -> None:
        self._policy = policy
        self._heading_rad: float | None = None
        self._yaw_rad: float | None = None
        self._target_rad: float | None = None
        self._at_s = -math.inf

    def heard(self, heading_cdeg: int) -> None:
        """Take GLOBAL_POSITION_INT's heading (centidegrees). A value of 36000 or more means that it is
        unknown."""
        known = heading_cdeg < _UNKNOWN_CDEG
        self._heading_rad = math.radians(heading_cdeg / 100.0) if known else None

    def yaw_rad(self, velocity_ned_mps: Vec3, now_s: float) -> float | None:
        """Yaw (clockwise from north, -pi to pi) for a setpoint that is sent now; None: the heading is
        held."""
        if self._policy == "hold":
            return None
        elapsed_s = now_s - self._at_s
        self._at_s = now_s
        if elapsed_s > PAUSE_S:
            self._yaw_rad, self._target_rad, elapsed_s = None, None, 0.0
        if self._yaw_rad is None:
            self._yaw_rad = self._heading_rad
        north, east, _ = velocity_ned_mps
        if math.hypot(north, east) >= LEAST_MPS:
            self._target_rad = math.atan2(east, north)
        if self._yaw_rad is None or self._target_rad is None:
            return None
        most = RATE_RADPS * elapsed_s
        turn = math.remainder(self._target_rad - self._yaw_rad, math.tau)
        self._yaw_rad = math.remainder(self._yaw_rad + min(max(turn, -most), most), math.tau)
        return self._yaw_rad
