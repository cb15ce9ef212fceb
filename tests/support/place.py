"""Place of the test flights: the home of the simulated vehicles."""

from typing import Final

from companion.geometry import LocalFrame, Vec3
from sitl_mocks.vehicle.motion.navigation import Globe
from sitl_mocks.vehicle.options import HOME as VEHICLES_HOME

_GLOBE: Final = Globe(VEHICLES_HOME.lat_deg, VEHICLES_HOME.lon_deg, VEHICLES_HOME.alt_m)


class Home(LocalFrame):
    """A local frame at the vehicles' home that converts to latitude and longitude as the vehicles do.

    It agrees with `LocalFrame` to micrometres and takes a twentieth of the time. Tests with many transmitters
    spent most of their time in the conversion.
    """

    def to_geodetic(self, north_m: float, east_m: float, down_m: float) -> Vec3:
        """Latitude, longitude (deg) and altitude (m) of a point in the frame."""
        return _GLOBE.to_geodetic(north_m, east_m, down_m)


HOME: Final = Home(VEHICLES_HOME.lat_deg, VEHICLES_HOME.lon_deg, VEHICLES_HOME.alt_m)
LAT_E7: Final = round(1e7 * HOME.lat_deg)
"""Latitude of home as MAVLink sends it, in 1e-7 deg."""
LON_E7: Final = round(1e7 * HOME.lon_deg)
"""Longitude of home, in 1e-7 deg."""
NORTHWARD: Final = f"""altitude = "home"
waypoint = [
  {{ t_s = 0.0, lat_deg = {HOME.lat_deg}, lon_deg = {HOME.lon_deg}, alt_m = 50.0 }},
  {{ t_s = 300.0, lat_deg = {HOME.lat_deg + 0.0035:.4f}, lon_deg = {HOME.lon_deg}, alt_m = 50.0 }},
]
"""
"""Path file for `companion run`: from 50 m above home to the north for five minutes, at 1.3 m/s."""
