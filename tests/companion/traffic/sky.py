"""A receiver of ADS-B at one place, and what it is sent."""

from __future__ import annotations

from companion.events import AdsbVehicle
from companion.traffic.adsb import AdsbTraffic
from tests.support.place import HOME

SEPARATION_M = 47.0
OWN_DOWN_M = -50.0
ICAO = 0x4B1234
STAMP_S = 0.5
"""Half of the whole second that an age is cut to."""


def report(north_m=1000.0, east_m=0.0, down_m=-50.0, *, geometric=True, **over):
    lat, lon, alt_msl_m = HOME.to_geodetic(north_m, east_m, down_m)
    return AdsbVehicle(
        **{
            "icao": ICAO,
            "lat_deg": lat,
            "lon_deg": lon,
            "alt_m": alt_msl_m + (SEPARATION_M if geometric else 0.0),
            "alt_geometric": geometric,
            "velocity_ned_mps": (0.0, 50.0, 0.0),
            **over,
        }
    )


class Sky:
    """An AdsbTraffic with the arguments that do not change."""

    def __init__(self, own_icao=None, separation_m=SEPARATION_M):
        self.traffic = AdsbTraffic(own_icao)
        self.separation_m = separation_m
        self.own_ned_m = (0.0, 0.0, OWN_DOWN_M)
        self.own_velocity_ned_mps = (0.0, 0.0, 0.0)
        self.own_pressure_alt_m = None

    def take(self, now_s, *reports):
        self.traffic.note_own(now_s, self.own_ned_m, self.own_velocity_ned_mps, self.own_pressure_alt_m)
        for one in reports:
            self.traffic.hear(one, now_s, HOME, self.separation_m)

    def at(self, now_s, own_down_m=OWN_DOWN_M):
        return self.traffic.neighbours(now_s, own_down_m)

    def only(self, now_s, own_down_m=OWN_DOWN_M):
        (neighbour,) = self.at(now_s, own_down_m)
        return neighbour
