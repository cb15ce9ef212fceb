"""Remote ID messages of simulated senders, honest and forged."""

from __future__ import annotations

import math
from typing import Final

import pymap3d

from companion.geometry import Vec3
from companion.remote_id.messages import BasicId, IdType, Location, Message, Status, UaType
from ground_tools.campaign.attacks.scene import HOME
from sitl_mocks.encounters.lockstep import UTC_AT_START_S

_A, _B = 6378137.0, 6356752.31424518
"""Semi-axes of WGS84 (m)."""
_E2, _E2_PRIME = 1.0 - (_B / _A) ** 2, (_A / _B) ** 2 - 1.0
_LAT, _LON = math.radians(HOME.lat_deg), math.radians(HOME.lon_deg)
_SIN_LAT, _COS_LAT, _SIN_LON, _COS_LON = math.sin(_LAT), math.cos(_LAT), math.sin(_LON), math.cos(_LON)
_X0, _Y0, _Z0 = map(float, pymap3d.geodetic2ecef(HOME.lat_deg, HOME.lon_deg, HOME.alt_m))
SEPARATION_M: Final = 47.0
"""Height of the geoid above the ellipsoid."""


def geodetic(place: Vec3) -> Vec3:
    """Latitude, longitude (deg) and height above mean sea level (m) of a NED position.

    The result equals that of `LocalFrame.to_geodetic`, but comes from one step of B. R. Bowring's formula
    (1976), which is exact to micrometres near the ground. It takes a twentieth of the time; the other
    function took half of a flight's computing time.
    """
    north, east, down = place
    outward = -_COS_LAT * down - _SIN_LAT * north
    x = _X0 + _COS_LON * outward - _SIN_LON * east
    y = _Y0 + _SIN_LON * outward + _COS_LON * east
    z = _Z0 - _SIN_LAT * down + _COS_LAT * north
    across = math.hypot(x, y)
    parametric = math.atan2(z * _A, across * _B)
    sine, cosine = math.sin(parametric), math.cos(parametric)
    lat = math.atan2(z + _E2_PRIME * _B * sine**3, across - _E2 * _A * cosine**3)
    prime = _A / math.sqrt(1.0 - _E2 * math.sin(lat) ** 2)
    alt = across * math.cos(lat) + z * math.sin(lat) - _A * _A / prime
    return math.degrees(lat), math.degrees(math.atan2(y, x)), alt


def basic_id(identity: str) -> BasicId:
    """Basic ID of a multirotor with this serial number."""
    return BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id=identity)


def location(now_s: float, place: Vec3, velocity: Vec3, *, lead_s: float = 0.0) -> Location:
    """Location of an aircraft, for the last whole tenth of a second before `now_s`.

    Args:
        place: NED position (m).
        velocity: NED velocity (m/s).
        lead_s: how far the timestamp is ahead of UTC.
    """
    tenth = math.floor((UTC_AT_START_S + now_s) * 10.0 + 1e-4) / 10.0
    along_s = tenth - UTC_AT_START_S - now_s
    north, east, down = (p + along_s * v for p, v in zip(place, velocity, strict=True))
    lat, lon, alt = geodetic((north, east, down))
    return Location(
        status=Status.AIRBORNE,
        lat_deg=lat,
        lon_deg=lon,
        alt_geodetic_m=min(max(alt + SEPARATION_M, -999.0), 30000.0),
        direction_deg=math.degrees(math.atan2(velocity[1], velocity[0])) % 360.0,
        speed_mps=min(math.hypot(velocity[0], velocity[1]), 254.0),
        vertical_speed_mps=min(max(-velocity[2], -60.0), 60.0),
        horizontal_accuracy_m=3.0,
        vertical_accuracy_m=3.0,
        speed_accuracy_mps=0.3,
        timestamp_s=round(tenth + lead_s, 1) % 3600.0,
    )


def report(
    identity: str, now_s: float, place: Vec3, velocity: Vec3, *, lead_s: float = 0.0
) -> tuple[Message, ...]:
    """Basic ID and Location; arguments as in `location`."""
    return basic_id(identity), location(now_s, place, velocity, lead_s=lead_s)
