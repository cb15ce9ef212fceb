"""How the mock vehicle moves: a point mass whose velocity follows a command, and the ground under it.

The commanded velocity is first limited in speed (over ground, and through the air), then in acceleration (a
ramp), and the vehicle follows the ramp with a first-order lag; so the acceleration never exceeds the limit,
and a reversal overshoots the way the real ones do. Plain floats: this runs 50 times a simulated second.
"""

from __future__ import annotations

import math

from companion.events import Vec3

STEP_S = 0.02
_GRAVITY = 9.81
_FALL_SPEED_MPS = 20.0


class Body:
    """Position and velocity in the home NED frame (m, m/s), and yaw (rad)."""

    __slots__ = (
        "_lag", "_ramp_h", "_ramp_v", "airspeed", "climb", "descent", "down", "east", "horizontal",
        "north", "ramp_d", "ramp_e", "ramp_n", "touchdown_mps", "vd", "ve", "vn", "wind", "yaw",
    )  # fmt: skip

    def __init__(
        self,
        *,
        position_ned_m: Vec3,
        velocity_ned_mps: Vec3,
        yaw_rad: float,
        max_horizontal_mps: float,
        max_climb_mps: float,
        max_descent_mps: float,
        max_acceleration_mps2: float,
        max_vertical_acceleration_mps2: float,
        lag_s: float,
        wind_ned_mps: Vec3 = (0.0, 0.0, 0.0),
        max_airspeed_mps: float = 1e3,
    ) -> None:
        self.north, self.east, self.down = position_ned_m
        self.vn, self.ve, self.vd = velocity_ned_mps
        self.ramp_n, self.ramp_e, self.ramp_d = velocity_ned_mps
        self.yaw = yaw_rad
        self.horizontal = max_horizontal_mps
        self.climb = max_climb_mps
        self.descent = max_descent_mps
        self.wind = wind_ned_mps
        self.airspeed = max_airspeed_mps
        self.touchdown_mps = 0.0
        self._ramp_h = max_acceleration_mps2 * STEP_S
        self._ramp_v = max_vertical_acceleration_mps2 * STEP_S
        self._lag = 1.0 - math.exp(-STEP_S / lag_s)

    def step(self, command_n: float, command_e: float, command_d: float) -> bool:
        """Fly one step towards a velocity (NED, m/s, finite); True on the step that touches the ground."""
        speed = math.hypot(command_n, command_e)
        if speed > self.horizontal:
            scale = self.horizontal / speed
            command_n *= scale
            command_e *= scale
        wind_n, wind_e, _ = self.wind
        air_n = command_n - wind_n
        air_e = command_e - wind_e
        through_air = math.hypot(air_n, air_e)
        if through_air > self.airspeed:
            scale = self.airspeed / through_air
            command_n = wind_n + air_n * scale
            command_e = wind_e + air_e * scale
        change_n = command_n - self.ramp_n
        change_e = command_e - self.ramp_e
        change = math.hypot(change_n, change_e)
        if change > self._ramp_h:
            scale = self._ramp_h / change
            change_n *= scale
            change_e *= scale
        self.ramp_n += change_n
        self.ramp_e += change_e
        command_d = min(max(command_d, -self.climb), self.descent)
        self.ramp_d += min(max(command_d - self.ramp_d, -self._ramp_v), self._ramp_v)
        lag = self._lag
        self.vn += (self.ramp_n - self.vn) * lag
        self.ve += (self.ramp_e - self.ve) * lag
        self.vd += (self.ramp_d - self.vd) * lag
        return self._move()

    def fall(self) -> bool:
        """One step with the motors off. Return True on the step that touches the ground."""
        self.vd = min(self.vd + _GRAVITY * STEP_S, _FALL_SPEED_MPS)
        self.ramp_d = self.vd
        return self._move()

    def _move(self) -> bool:
        self.north += self.vn * STEP_S
        self.east += self.ve * STEP_S
        self.down += self.vd * STEP_S
        if self.down < 0.0 or self.vd <= 0.0:
            return False
        self.touchdown_mps = self.vd
        self.rest()
        return True

    def rest(self) -> None:
        """Stand on the ground."""
        self.down = 0.0
        self.vn = self.ve = self.vd = 0.0
        self.ramp_n = self.ramp_e = self.ramp_d = 0.0

    def turn_towards(self, yaw_rad: float, rate_radps: float) -> None:
        """Turn the nose by the shorter way, no faster than `rate_radps`."""
        error = math.remainder(yaw_rad - self.yaw, math.tau)
        limit = rate_radps * STEP_S
        self.yaw = math.remainder(self.yaw + min(max(error, -limit), limit), math.tau)

    def speed_towards(self, distance_m: float, cruise_mps: float, acceleration_mps2: float) -> float:
        """The speed from which the vehicle can still stop within a distance (m/s)."""
        return min(cruise_mps, math.sqrt(1.4 * acceleration_mps2 * distance_m), 0.8 * distance_m)
