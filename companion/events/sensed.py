"""What sensors aboard measure of obstacles and aircraft that send nothing, and the attitude that this
needs."""

from __future__ import annotations

from typing import Literal

from companion.events.base import Event
from companion.events.traffic import AdsbVehicle
from companion.geometry import Vec3

SENSED_HYPHEN = "\N{NON-BREAKING HYPHEN}"
"""Character in every sensed track's id. No transmitter can send it, because ids from Remote ID are Latin-1
and those from ADS-B are digits, so a received track cannot pass for a measured one."""
SENSED = f"sensed{SENSED_HYPHEN}"
"""Prefix of the ids of sensed tracks."""
SENSED_WALL = f"{SENSED}wall "
"""Prefix of the ids of places on sensed surfaces."""
UNKNOWN, NOTHING = -1, 0
"""Values of `ObstacleScan.distances_cm`: not measured, and measured but nothing is there."""


def is_sensed(track_id: str) -> bool:
    """Whether a track's id is that of a track measured by a sensor aboard."""
    return track_id.startswith(SENSED)


def thing_of(track_id: str) -> str:
    """Name of the object behind a track: one name for all places on sensed surfaces, else the track's own
    id."""
    return SENSED_WALL.rstrip() if track_id.startswith(SENSED_WALL) else track_id


class Attitude(Event, frozen=True):
    """ATTITUDE: how the own vehicle is turned. Roll to the right and pitch up are positive, yaw is from
    north."""

    time_boot_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float


class ObstacleScan(Event, frozen=True):
    """OBSTACLE_DISTANCE, or ArduPilot's burst of DISTANCE_SENSOR: distances around the vehicle, one for each
    sector of a plane. If the sensor works and ArduPilot sends no burst, all are UNKNOWN."""

    component: int
    """Component that measured."""
    axes: Literal["body", "nose", "north"]
    """Reference of the angles. body: the vehicle's own plane, which rolls and pitches with it. nose: the
    level plane, from the nose. north: the level plane, from north."""
    first_deg: float
    """Angle of the middle of the first sector, clockwise seen from above."""
    step_deg: float
    """Angle from one sector to the next, which is their width. Negative: counted anticlockwise."""
    distances_cm: tuple[int, ...]
    """Distance in each sector, or UNKNOWN or NOTHING."""
    max_cm: int
    """Range of the sensor."""


class ObstaclePoint(Event, frozen=True):
    """OBSTACLE_DISTANCE_3D: the place of one obstacle."""

    component: int
    axes: Literal["body", "offset", "local"]
    """body: from the vehicle along its own axes (forward, right, down). offset: from the vehicle, NED.
    local: from the origin of the autopilot's local frame, NED."""
    position_m: Vec3
    number: int | None = None
    """Number under which the sensor tracks this obstacle; None if it tracks no obstacles."""


class SensedAircraft(Event, frozen=True):
    """ADSB_VEHICLE of a radar or camera aboard: an aircraft that it tracks. `icao` is the number that the
    sensor gave to the aircraft."""

    component: int
    report: AdsbVehicle
