"""The vehicle's navigation solution (truth plus time-correlated errors) and its geodetic coordinates.

The errors are first-order Gauss-Markov processes that are advanced every 0.1 s. They never change the true
motion. The geodetic conversion is the exact one of `companion.geometry` (ellipsoid and tangent plane). It is
written with plain floats because it runs for every telemetry sample.
"""

from __future__ import annotations

import math

import numpy

from companion.geometry import Vec3
from sitl_mocks.vehicle.options import VehicleOptions

NOISE_STEPS = 5
"""Number of motion steps between two advances of the errors."""

_A = 6378137.0
_F = 1.0 / 298.257223563
_B = _A * (1.0 - _F)
_E2 = _F * (2.0 - _F)
_EP2 = _E2 / (1.0 - _E2)


class Globe:
    """Converts NED relative to home (m) to latitude, longitude (deg) and altitude (m, in home's datum)."""

    def __init__(self, lat_deg: float, lon_deg: float, alt_m: float) -> None:
        lat, lon = math.radians(lat_deg), math.radians(lon_deg)
        sin_lat, cos_lat = math.sin(lat), math.cos(lat)
        sin_lon, cos_lon = math.sin(lon), math.cos(lon)
        radius = _A / math.sqrt(1.0 - _E2 * sin_lat * sin_lat)
        self._origin = (
            (radius + alt_m) * cos_lat * cos_lon,
            (radius + alt_m) * cos_lat * sin_lon,
            (radius * (1.0 - _E2) + alt_m) * sin_lat,
        )
        self._trig = (sin_lat, cos_lat, sin_lon, cos_lon)

    def to_geodetic(self, north_m: float, east_m: float, down_m: float) -> Vec3:
        """Convert by Bowring's formula from Earth-centred coordinates (error below 1 um at these heights)."""
        sin_lat, cos_lat, sin_lon, cos_lon = self._trig
        out = -sin_lat * north_m - cos_lat * down_m
        x = self._origin[0] + cos_lon * out - sin_lon * east_m
        y = self._origin[1] + sin_lon * out + cos_lon * east_m
        z = self._origin[2] + cos_lat * north_m - sin_lat * down_m
        p = math.hypot(x, y)
        theta = math.atan2(z * _A, p * _B)
        sin_t, cos_t = math.sin(theta), math.cos(theta)
        lat = math.atan2(z + _EP2 * _B * sin_t * sin_t * sin_t, p - _E2 * _A * cos_t * cos_t * cos_t)
        sin_new = math.sin(lat)
        radius = _A / math.sqrt(1.0 - _E2 * sin_new * sin_new)
        # Both terms are needed to keep the height exact near the poles.
        height = p * math.cos(lat) + z * sin_new - _A * _A / radius
        return math.degrees(lat), math.degrees(math.atan2(y, x)), height


class NavigationError:
    """Position error (NED, m) and velocity error (NED, m/s) of the vehicle's navigation solution."""

    def __init__(self, options: VehicleOptions, rng: numpy.random.Generator, interval_s: float) -> None:
        self._rng = rng
        horizontal = options.gnss_horizontal_sigma_m
        velocity = options.gnss_velocity_sigma_mps
        self._sigmas = (horizontal, horizontal, options.gnss_vertical_sigma_m, velocity, velocity, velocity)
        self.active = any(sigma > 0.0 for sigma in self._sigmas)
        keeps = [math.exp(-interval_s / options.gnss_correlation_s)] * 3
        keeps += [math.exp(-interval_s / options.gnss_velocity_correlation_s)] * 3
        self._keeps = tuple(keeps)
        self._drives = tuple(
            sigma * math.sqrt(1.0 - keep * keep) for sigma, keep in zip(self._sigmas, keeps, strict=True)
        )
        self.errors: tuple[float, ...] = (0.0,) * 6
        if self.active:
            draws = rng.standard_normal(6).tolist()
            self.errors = tuple(sigma * draw for sigma, draw in zip(self._sigmas, draws, strict=True))

    def advance(self) -> None:
        """Advance the errors by one interval. Draws from the generator only if there is noise."""
        if not self.active:
            return
        draws = self._rng.standard_normal(6).tolist()
        self.errors = tuple(
            [
                keep * error + drive * draw
                for keep, error, drive, draw in zip(
                    self._keeps, self.errors, self._drives, draws, strict=True
                )
            ]
        )
