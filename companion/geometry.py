"""Conversion between WGS84 and local north-east-down (NED) on a tangent plane at a fixed origin."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import pymap3d

Vec3 = tuple[float, float, float]
"""North, east, down."""

_A, _B = 6378137.0, 6356752.31424518
"""Semi-axes of WGS84 (m)."""


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """A north-east-down frame with its origin at a geodetic point.

    All altitudes share the datum of the origin's altitude. Using mean sea level instead of the ellipsoid here
    changes horizontal distances by one part in 10^5.
    """

    lat_deg: float
    lon_deg: float
    alt_m: float
    _centre: Vec3 = field(init=False, repr=False, compare=False)
    """Origin in Earth-centred, Earth-fixed coordinates (m)."""
    _turn: tuple[float, float, float, float] = field(init=False, repr=False, compare=False)
    """Sine and cosine of the origin's latitude and longitude, computed once."""

    def __post_init__(self) -> None:
        """Compute the values that depend only on the origin."""
        x, y, z = pymap3d.geodetic2ecef(self.lat_deg, self.lon_deg, self.alt_m)
        lat, lon = math.radians(self.lat_deg), math.radians(self.lon_deg)
        object.__setattr__(self, "_centre", (float(x), float(y), float(z)))
        object.__setattr__(self, "_turn", (math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)))

    def to_ned(self, lat_deg: float, lon_deg: float, alt_m: float) -> Vec3:
        """Position in the frame (m)."""
        # Same formula as pymap3d.geodetic2ecef. Its array checks would take a tenth of the time from a
        # received frame to its track.
        lat, lon = math.radians(lat_deg), math.radians(lon_deg)
        sin, cos = math.sin(lat), math.cos(lat)
        prime = _A * _A / math.hypot(_A * cos, _B * sin)
        x0, y0, z0 = self._centre
        u = (prime + alt_m) * cos * math.cos(lon) - x0
        v = (prime + alt_m) * cos * math.sin(lon) - y0
        w = (prime * (_B / _A) ** 2 + alt_m) * sin - z0
        sin_lat, cos_lat, sin_lon, cos_lon = self._turn
        outward = cos_lon * u + sin_lon * v
        return (
            cos_lat * w - sin_lat * outward,
            cos_lon * v - sin_lon * u,
            -(cos_lat * outward + sin_lat * w),
        )

    def to_geodetic(self, north_m: float, east_m: float, down_m: float) -> Vec3:
        """Latitude, longitude (deg) and altitude (m) of a point in the frame."""
        lat, lon, alt = pymap3d.ned2geodetic(north_m, east_m, down_m, self.lat_deg, self.lon_deg, self.alt_m)
        return float(lat), float(lon), float(alt)


def between(start: Vec3, end: Vec3, longest_m: float) -> list[Vec3]:
    """Points that divide a line into equal pieces of at most about `longest_m`; none if it is no longer.

    The line is straight in latitude, longitude and altitude, as autopilots fly and fence. A line that is
    straight in a local frame passes below it, by 8 m in the middle of 20 km, and nearer to the pole, by 9 m
    there at a latitude of 47 deg.

    Args:
        start, end: latitude, longitude (deg) and altitude (m); the shorter way around the Earth is meant.

    Returns:
        The places, without start and end.
    """
    north_m, east_m, _ = LocalFrame(*start).to_ned(end[0], end[1], start[2])
    # With a tolerance, so that the pieces are not divided again.
    pieces = math.ceil(math.hypot(north_m, east_m) / longest_m - 0.01)
    north, east, up = end[0] - start[0], math.remainder(end[1] - start[1], 360.0), end[2] - start[2]
    shares = [piece / pieces for piece in range(1, pieces)]
    return [
        (start[0] + k * north, math.remainder(start[1] + k * east, 360.0), start[2] + k * up) for k in shares
    ]
