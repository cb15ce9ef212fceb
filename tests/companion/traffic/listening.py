"""A receiver of Remote ID at one place, and what it is sent."""

from __future__ import annotations

from companion.config import TrafficConfig
from companion.events import RemoteIdHeard
from companion.remote_id.messages import BasicId, IdType, Location, UaType
from companion.traffic.tracks import Traffic
from tests.support.place import HOME

SEPARATION_M = 47.0
UTC_OFFSET_S = 1_767_225_600.0
"""A full hour: a timestamp equals the time since then."""


class Listener:
    """A Traffic with the arguments that do not change."""

    def __init__(self, utc_offset_s=UTC_OFFSET_S, separation_m=SEPARATION_M, **config):
        self.traffic = Traffic(TrafficConfig(**config), "OWN")
        self.utc_offset_s = utc_offset_s
        self.separation_m = separation_m

    def hear(self, now_s, *messages, address="a", transport="wifi"):
        heard = RemoteIdHeard(transport=transport, address=address, messages=messages)
        self.traffic.hear(heard, now_s, self.utc_offset_s, HOME, self.separation_m)

    @property
    def tracks(self):
        return self.traffic.tracks


def basic(uas_id, id_type=IdType.SERIAL_NUMBER):
    return BasicId(id_type=id_type, ua_type=UaType.AEROPLANE, uas_id=uas_id)


def location(north_m=100.0, east_m=0.0, timestamp_s=10.0, speed_mps=5.0, direction_deg=90.0, **more):
    lat, lon, _ = HOME.to_geodetic(north_m, east_m, 0.0)
    values = {"alt_geodetic_m": 447.0, "vertical_speed_mps": 1.0, "horizontal_accuracy_m": 3.0}
    return Location(
        lat_deg=lat,
        lon_deg=lon,
        timestamp_s=timestamp_s,
        speed_mps=speed_mps,
        direction_deg=direction_deg,
        **{**values, **more},
    )
