"""What the own aircraft says about itself, and when (the paper's "observe": psi messages per GNSS cycle).

Location goes out `rate` times per GNSS cycle of 1 s. On Wi-Fi and BLE 5 every broadcast is a pack with
Basic ID and System; BLE 4 carries one message a frame, so those two follow once per cycle.
"""

from __future__ import annotations

import math
import zlib

from companion.config import IdentityConfig, RemoteIdConfig
from companion.events import Broadcast, Landed
from companion.ownship import Ownship
from companion.remote_id.messages import (
    BasicId,
    HeightType,
    Location,
    Message,
    OperatorLocationType,
    Status,
    System,
)

GNSS_CYCLE_S = 1.0
"""T_GNSS of the paper."""
_ALTITUDES = (-999.5, 31767.5)
_UTC = (1_546_300_801.0, 1_546_300_800.0 + 2**32 - 1)
"""What a System timestamp can hold: from 2019 on."""
_STALE_S = 1.0
"""A position older than this is not put on the air as the present one (F3411-22a: at most 1 s)."""


class Schedule:
    """Decides when to broadcast; keeps its phase for the whole flight."""

    def __init__(self, identity: IdentityConfig, config: RemoteIdConfig) -> None:
        self._identity = identity
        self._config = config
        self._period_s = GNSS_CYCLE_S / config.rate
        # Aircraft switched on together must not all send at once.
        self._phase_s = GNSS_CYCLE_S * zlib.crc32(identity.uas_id.encode()) / 2**32
        self._slot: int | None = None

    def due(self, own: Ownship, now_s: float) -> list[Broadcast]:
        """The broadcasts for this moment. Nothing goes out before the vehicle has been heard."""
        if own.heartbeat is None:
            return []
        slot = math.floor((now_s - self._phase_s) / self._period_s)
        if slot == self._slot:
            return []
        first_of_cycle = self._slot is None or slot // self._config.rate != self._slot // self._config.rate
        self._slot = slot
        location = location_of(own, now_s)
        whole: tuple[Message, ...] = (self._basic_id(), location, system_of(own, now_s))
        return [
            Broadcast(
                transport=transport,
                messages=whole if transport != "ble4" or first_of_cycle else (location,),
            )
            for transport in self._config.transports
        ]

    def _basic_id(self) -> BasicId:
        i = self._identity
        return BasicId(id_type=i.id_type, ua_type=i.ua_type, uas_id=i.uas_id)


def location_of(own: Ownship, now_s: float) -> Location:
    """Own state as a Location message.

    The position is carried on along the own velocity to the tenth of a second that the timestamp can hold, so
    that the timestamp's step adds no error. A position too old to be called present is left out and the
    status says that the system has failed: silence would look like an empty sky.
    """
    position, gnss = own.position, own.gnss
    if position is None or own.age_s(now_s) > _STALE_S or (gnss is not None and gnss.fix_type < 2):
        return Location(status=Status.REMOTE_ID_SYSTEM_FAILURE)
    landed = own.landed(now_s)
    lat, lon, alt_msl = position.lat_deg, position.lon_deg, position.alt_msl_m
    height = position.height_above_home_m
    north, east, down = own.velocity_ned_mps
    timestamp = None
    if own.utc_offset_s is not None:
        tenth = math.floor((now_s + own.utc_offset_s) * 10.0) / 10.0
        ahead = tenth - own.utc_offset_s - own.sample_s()
        lat += math.degrees(north * ahead / 6_378_137.0)
        lon += math.degrees(east * ahead / (6_378_137.0 * max(math.cos(math.radians(lat)), 1e-6)))
        lat, lon = min(max(lat, -90.0), 90.0), (lon + 180.0) % 360.0 - 180.0
        alt_msl -= down * ahead
        height -= down * ahead
        timestamp = round(tenth % 3600.0, 1)
    speed = math.hypot(north, east)
    in_air = landed in (Landed.IN_AIR, Landed.TAKEOFF, Landed.LANDING)
    status = Status.AIRBORNE if in_air else Status.GROUND if landed is Landed.ON_GROUND else Status.UNDECLARED
    return Location(
        status=status,
        lat_deg=lat,
        lon_deg=lon,
        alt_geodetic_m=None if own.separation_m is None else _within(alt_msl + own.separation_m, *_ALTITUDES),
        height_type=HeightType.ABOVE_TAKEOFF,
        height_m=_within(height, *_ALTITUDES),
        direction_deg=math.degrees(math.atan2(east, north)) % 360.0,
        speed_mps=_within(speed, 0.0, 254.25),
        vertical_speed_mps=_within(-down, -62.0, 62.0),
        horizontal_accuracy_m=None if gnss is None else gnss.horizontal_accuracy_m,
        vertical_accuracy_m=None if gnss is None else gnss.vertical_accuracy_m,
        speed_accuracy_mps=None if gnss is None else gnss.speed_accuracy_mps,
        timestamp_s=timestamp,
    )


def _within(value: float, low: float, high: float) -> float | None:
    """A value that the message cannot hold is unknown to those who hear it."""
    return value if low <= value <= high else None


def system_of(own: Ownship, now_s: float) -> System:
    """Operator position: the take-off point, unknown when the take-off was not seen."""
    if own.takeoff is None:
        return System(operator_location_type=OperatorLocationType.TAKEOFF)
    altitude, utc = None, None
    if own.separation_m is not None:
        altitude = _within(own.takeoff.alt_msl_m + own.separation_m, *_ALTITUDES)
    if own.utc_offset_s is not None:
        utc = _within(float(math.floor(now_s + own.utc_offset_s)), *_UTC)
    return System(
        operator_location_type=OperatorLocationType.TAKEOFF,
        operator_lat_deg=own.takeoff.lat_deg,
        operator_lon_deg=own.takeoff.lon_deg,
        operator_alt_geodetic_m=altitude,
        timestamp_utc_s=utc,
    )
