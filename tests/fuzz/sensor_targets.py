"""What sensors of obstacles report, from the payload to the tracks."""

from __future__ import annotations

import math
import struct

from companion.autopilot.readers import unpack
from companion.autopilot.sensors import SENSOR_READERS
from companion.config import SensedConfig
from companion.errors import PeerDataError
from companion.events import Attitude, Firmware, FlightMode, GlobalPosition, GnssFix, Heartbeat
from companion.ownship import Ownship
from companion.traffic.sensed import SensedTraffic, objects, surfaces
from tests.fuzz.seeds import Target
from tests.support.place import HOME

_SCAN, _POINT, _AIRCRAFT = SENSOR_READERS
_ORDER = (_SCAN, _POINT, _AIRCRAFT)
_SHAPE = struct.Struct("<Q72HHHBBffB")


def _seeds() -> list[bytes]:
    """The first byte says which message, the rest is its payload."""
    found = []
    for step_deg, frame in ((5.0, 12), (-10.0, 20), (30.0, 0)):
        distances = [300 + 40 * i for i in range(60)] + [0xFFFF] * 12
        found.append(b"\0" + _SHAPE.pack(0, *distances, 20, 4000, 0, 5, step_deg, 0.0, frame))
    for number, frame in ((0xFFFF, 12), (7, 7), (8, 1)):
        found.append(b"\1" + struct.pack("<IfffffHBB", 0, 20.0, 3.0, -1.0, 0.2, 60.0, number, 0, frame))
    lat, lon = round(1e7 * HOME.lat_deg) + 2000, round(1e7 * HOME.lon_deg)
    aircraft = 77, lat, lon, round(1e3 * HOME.alt_m), 9000, 1000, 0, 0x3F, 0, 0, b"", 14, 0
    found.append(b"\2" + struct.pack("<IiiiHHhHHB9sBB", *aircraft))
    return found


def sensed() -> Target:
    """Measurements of a vehicle that hovers, some of them with another attitude."""
    own, tracker = Ownship(), SensedTraffic(SensedConfig(use=True, latency_s=0.0), 1.0)
    now_s, turn = 10.0, 0

    def feed(data: bytes) -> bool:
        nonlocal now_s, turn
        now_s, turn = now_s + 0.05, turn + 1
        beat = Heartbeat(
            system_id=1, firmware=Firmware.PX4, vehicle_type=2, custom_mode=0, mode=FlightMode.HOLD,
            armed=True,
        )  # fmt: skip
        fix = GnssFix(fix_type=3, lat_deg=HOME.lat_deg, lon_deg=HOME.lon_deg, alt_msl_m=HOME.alt_m)
        place = GlobalPosition(
            time_boot_s=now_s,
            lat_deg=HOME.lat_deg,
            lon_deg=HOME.lon_deg,
            alt_msl_m=HOME.alt_m,
            height_above_home_m=50.0,
            velocity_ned_mps=(1.0, 0.0, 0.0),
        )
        for event in (beat, fix, place):
            own.observe(event, now_s)
        lean = 0.3 if turn % 7 == 0 else 0.0
        attitude = Attitude(time_boot_s=now_s, roll_rad=lean, pitch_rad=-lean, yaw_rad=0.0)
        message = _ORDER[data[0] % 3] if data else _SCAN
        try:
            event = SENSOR_READERS[message](196, unpack(message, data[1:]))
        except PeerDataError:
            event = None
        tracker.hear([attitude, *(() if event is None else (event,))], now_s, own, sent_s=now_s)
        tracker.expire(now_s)
        seen = tracker.look(now_s, own)
        assert len(seen) <= objects.MOST + surfaces.MOST
        for other in seen:
            numbers = (
                *other.position_ned_m,
                *other.velocity_ned_mps,
                other.sigma_m,
                other.sigma_mps,
                other.age_s,
            )
            assert all(map(math.isfinite, numbers))
        return event is not None

    return Target("sensed", _seeds(), feed)
