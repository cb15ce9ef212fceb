"""WGS84 <-> local north-east-down, on a tangent plane at a fixed origin."""

from __future__ import annotations

from dataclasses import dataclass

import pymap3d

from companion.events import Vec3


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """A north-east-down frame whose origin lies at a geodetic point.

    Altitudes in and out share one datum, the origin's; taking mean sea level for the ellipsoid here changes
    horizontal distances by one part in 10^5.
    """

    lat_deg: float
    lon_deg: float
    alt_m: float

    def to_ned(self, lat_deg: float, lon_deg: float, alt_m: float) -> Vec3:
        """Position in the frame (m)."""
        n, e, d = pymap3d.geodetic2ned(lat_deg, lon_deg, alt_m, self.lat_deg, self.lon_deg, self.alt_m)
        return float(n), float(e), float(d)

    def to_geodetic(self, north_m: float, east_m: float, down_m: float) -> Vec3:
        """Latitude (deg), longitude (deg) and altitude (m) of a point of the frame."""
        lat, lon, alt = pymap3d.ned2geodetic(north_m, east_m, down_m, self.lat_deg, self.lon_deg, self.alt_m)
        return float(lat), float(lon), float(alt)
