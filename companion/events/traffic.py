"""Other aircraft: ADS-B reports, doubts about tracks, alerts, and what the law decided.

Aircraft heard by Remote ID arrive as `RemoteIdHeard` (`companion.events.remote_id`).
"""

from __future__ import annotations

import msgspec

from companion.events.base import Command, Event
from companion.geometry import Vec3


class AdsbVehicle(Event, frozen=True):
    """ADSB_VEHICLE: an aircraft heard by the autopilot's ADS-B receiver, mostly crewed traffic."""

    icao: int
    lat_deg: float
    lon_deg: float
    alt_m: float | None = None
    """Altitude; None if not known."""
    alt_geometric: bool = False
    """True: `alt_m` is above the WGS84 ellipsoid. False: it is barometric, from the sea level pressure."""
    velocity_ned_mps: Vec3 | None = None
    """Velocity; None if not known."""
    age_s: float = 0.0
    """Time since the aircraft was last heard, in whole seconds."""
    callsign: str = ""
    emitter: int = 0
    """ADSB_EMITTER_TYPE."""


class Threat(Command, frozen=True):
    """COLLISION: predicted approach of another aircraft, for ground stations and the autopilot."""

    track_id: str
    adsb: bool
    """True if heard by ADS-B; `track_id` is then the ICAO address in hexadecimal digits."""
    level: int
    """MAV_COLLISION_THREAT_LEVEL: 0 none, 1 low, 2 high."""
    acting: bool
    """True if the companion flies around the aircraft, False if it only reports it."""
    time_to_closest_s: float
    horizontal_m: float
    """Least predicted horizontal distance."""
    vertical_m: float
    """Least predicted vertical distance."""


class TrafficReport(Command, frozen=True):
    """ADSB_VEHICLE: an aircraft heard by Remote ID, for the maps of ground stations."""

    icao: int
    """Address from a block that no aircraft uses (`traffic.published`)."""
    callsign: str
    lat_deg: float
    lon_deg: float
    """Place at the time of the aircraft's message."""
    alt_msl_m: float | None
    """Altitude above mean sea level; None while the aircraft reports none."""
    velocity_ned_mps: Vec3
    hovers: bool
    """True if the aircraft hovers; its direction of flight is then meaningless."""
    age_s: float
    """Age of the aircraft's message."""


class TrackFlagged(Command, frozen=True):
    """There is a new reason to doubt a track of received traffic."""

    track_id: str
    flag: str
    text: str


class AlertChanged(Command, frozen=True):
    """The alert level of a track rose or fell."""

    track_id: str
    level: int
    """0 none, 1 advisory, 2 caution, 3 warning."""
    reason: str
    """Text: which aircraft, where and when it comes closest, what is done, what bounds the velocity."""
    time_to_closest_s: float
    horizontal_m: float
    """Least horizontal distance if both aircraft keep their velocities."""
    vertical_m: float
    acting: bool
    """True if the companion flies around the aircraft."""
    limits: tuple[str, ...] = ()
    """Bounds on the velocity other than aircraft, from `avoidance.law.LIMITS`."""


class TrackView(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, gc=False):
    """One track as the law saw it at a decision."""

    track_id: str
    position_ned_m: Vec3
    """Position predicted to the time of the decision."""
    velocity_ned_mps: Vec3
    age_s: float
    radius_m: float
    """Combined horizontal radius that was used."""
    conflict: bool
    """True if the wanted velocity would violate this track's volume."""
    time_to_closest_s: float
    closest_m: float
    active: bool = False
    """True if this track's half-space bounds the chosen velocity."""
    adsb: bool = False
    """True if the track was heard by ADS-B."""
    height_m: float = 0.0
    """Half height of the volume whose radius is `radius_m`; 0 in records that do not have it."""
    yields: bool = False
    """True if it was avoided only as far as all others allowed (`Neighbour.yields`)."""


class Decision(Command, frozen=True):
    """One decision of the law, for the log. Vectors are in the core's local NED frame."""

    origin: Vec3
    """lat_deg, lon_deg, alt_msl_m of the local frame's origin."""
    position_ned_m: Vec3
    velocity_ned_mps: Vec3
    wanted_ned_mps: Vec3
    chosen_ned_mps: Vec3
    feasible: bool
    path_ned_m: Vec3 | None = None
    """Point of the timed path at the time of the decision."""
    late_s: float = 0.0
    """How long the timed path has waited for the aircraft."""
    limits: tuple[str, ...] = ()
    """Bounds on the chosen velocity other than aircraft."""
    tracks: tuple[TrackView, ...] = ()
