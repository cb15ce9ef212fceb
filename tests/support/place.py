"""Where the tests fly: at the home of the simulated vehicles."""

from typing import Final

from companion.geometry import LocalFrame, Vec3
from sitl_mocks.vehicle.motion.navigation import Globe
from sitl_mocks.vehicle.options import HOME as VEHICLES_HOME

_GLOBE: Final = Globe(VEHICLES_HOME.lat_deg, VEHICLES_HOME.lon_deg, VEHICLES_HOME.alt_m)


class Home(LocalFrame):
    """A frame at the vehicles' home that converts to latitude and longitude as the vehicles do.

    This agrees with `LocalFrame` to micrometres and takes a twentieth of the time, which was most of the time
    of tests with many transmitters.
    """

    def to_geodetic(self, north_m: float, east_m: float, down_m: float) -> Vec3:
        """Latitude, longitude (deg) and altitude (m) of a point in the frame."""
        return _GLOBE.to_geodetic(north_m, east_m, down_m)


HOME: Final = Home(VEHICLES_HOME.lat_deg, VEHICLES_HOME.lon_deg, VEHICLES_HOME.alt_m)
LAT_E7: Final = round(1e7 * HOME.lat_deg)
"""Its latitude as MAVLink sends it, 1e-7 deg."""
LON_E7: Final = round(1e7 * HOME.lon_deg)
"""Its longitude, 1e-7 deg."""
NORTHWARD: Final = f"""altitude = "home"
waypoint = [
  {{ t_s = 0.0, lat_deg = {HOME.lat_deg}, lon_deg = {HOME.lon_deg}, alt_m = 50.0 }},
  {{ t_s = 300.0, lat_deg = {HOME.lat_deg + 0.0035:.4f}, lon_deg = {HOME.lon_deg}, alt_m = 50.0 }},
]
"""
"""Path of a `companion run`: from 50 m above home to the north for five minutes, at 1.3 m/s."""
