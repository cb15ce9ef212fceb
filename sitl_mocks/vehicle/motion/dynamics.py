"""Motion of the mock vehicle: a point mass whose velocity follows a command, and the ground under it.

The commanded velocity is first limited in speed (over ground and through the air), then in acceleration (a
ramp). The vehicle follows the ramp with a first-order lag. The acceleration therefore never exceeds the
limit, and a reversal overshoots as on real vehicles. Further effects of each firmware were fitted to its
recorded flight. PX4 reaches only a share of the commanded velocity, and part of that slowly. ArduPilot brakes
gently from high speed and accelerates gently in its missions. The code uses plain floats because it runs 50
times per simulated second.
"""

from __future__ import annotations

import math

from companion.geometry import Vec3
from sitl_mocks.vehicle.firmware.response import FADED_OVER_MPS, Response

STEP_S = 0.02
_GRAVITY = 9.81
_FALL_SPEED_MPS = 20.0


class Body:
    """Position and velocity in the home NED frame (m, m/s), and yaw (rad)."""

    __slots__ = (
        "_lag", "_lag_v", "_pace", "_ramp_v", "_response", "_slow", "_slow_e", "_slow_n", "airspeed", "auto",
        "climb", "descent", "down", "east", "horizontal",
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
        response: Response,
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
        self.auto = False
        """The firmware flies one of its own modes, with the `auto_*` limits of the response."""
        self._response = response
        self._pace = 0.0
        self._ramp_v = response.vertical_acceleration_mps2 * STEP_S
        self._lag = 1.0 - math.exp(-STEP_S / response.lag_s)
        self._lag_v = 1.0 - math.exp(-STEP_S / response.vertical_lag_s)
        self._slow = 1.0 - math.exp(-STEP_S / response.slow_s)
        self.ramp_n /= response.gain
        self.ramp_e /= response.gain
        self.ramp_d /= response.gain
        self._slow_n, self._slow_e = self.ramp_n, self.ramp_e

    def step(self, command_n: float, command_e: float, command_d: float) -> bool:
        """Fly one step towards a velocity (NED, m/s, finite).

        Return True on the step that touches the ground.
        """
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
        gathers = change_n * self.ramp_n + change_e * self.ramp_e >= 0.0
        limit = self._limit(math.hypot(command_n, command_e), gathers=gathers)
        if change > limit:
            scale = limit / change
            change_n *= scale
            change_e *= scale
        self._pace = min(change, limit)
        self.ramp_n += change_n
        self.ramp_e += change_e
        command_d = min(max(command_d, -self.climb), self.descent)
        self.ramp_d += min(max(command_d - self.ramp_d, -self._ramp_v), self._ramp_v)
        lag, gain, share = self._lag, self._response.gain, self._response.slow_share
        self._slow_n += (self.ramp_n - self._slow_n) * self._slow
        self._slow_e += (self.ramp_e - self._slow_e) * self._slow
        self.vn += (gain * (self.ramp_n - share * (self.ramp_n - self._slow_n)) - self.vn) * lag
        self.ve += (gain * (self.ramp_e - share * (self.ramp_e - self._slow_e)) - self.ve) * lag
        self.vd += (gain * self.ramp_d - self.vd) * self._lag_v
        return self._move()

    def _limit(self, command_mps: float, *, gathers: bool) -> float:
        """Largest change of the ramp in this step (m/s)."""
        response = self._response
        if self.auto:
            if not gathers:
                return response.auto_brake_mps2 * STEP_S
            more = self._pace + response.auto_jerk_mps3 * STEP_S * STEP_S
            return min(response.auto_acceleration_mps2 * STEP_S, more)
        limit = response.acceleration_mps2
        speed = math.hypot(self.ramp_n, self.ramp_e)
        if speed > response.brake_fades_mps and command_mps < speed:
            fade = min((speed - response.brake_fades_mps) / FADED_OVER_MPS, 1.0)
            limit += (response.brake_faded_mps2 - limit) * fade
        return limit * STEP_S

    def fall(self) -> bool:
        """Fall for one step with the motors off. Return True on the step that touches the ground."""
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
        """Come to rest on the ground."""
        self.down = 0.0
        self.vn = self.ve = self.vd = 0.0
        self.ramp_n = self.ramp_e = self.ramp_d = 0.0
        self._slow_n = self._slow_e = 0.0

    @property
    def lean_mps2(self) -> tuple[float, float]:
        """Horizontal acceleration (north, east) that the vehicle's lean produces."""
        lag = self._response.lag_s
        gain = self._response.gain
        return (gain * self.ramp_n - self.vn) / lag, (gain * self.ramp_e - self.ve) / lag

    def turn_towards(self, yaw_rad: float, rate_radps: float) -> None:
        """Turn the nose towards a yaw by the shorter way, at most at `rate_radps`."""
        error = math.remainder(yaw_rad - self.yaw, math.tau)
        limit = rate_radps * STEP_S
        self.yaw = math.remainder(self.yaw + min(max(error, -limit), limit), math.tau)

    def speed_towards(self, distance_m: float, cruise_mps: float, acceleration_mps2: float) -> float:
        """Speed (m/s, at most the cruise speed) from which the vehicle can still stop within a distance."""
        return min(cruise_mps, math.sqrt(1.4 * acceleration_mps2 * distance_m), 0.8 * distance_m)
