"""Data of some steps of one aircraft, in the columns that a recording draws.

Times are on the common time line.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from companion.arrays import Floats
from companion.events import TrackView
from ground_tools.inspect.explain.why import HalfSpace


@dataclass(frozen=True, slots=True)
class Note:
    """A line of text about an event."""

    time_s: float
    level: str
    """Level of rerun's text log: INFO, WARN, ERROR, CRITICAL."""
    text: str
    marked: bool = False
    """True if a marker is drawn where the aircraft was at that time."""


@dataclass(frozen=True, slots=True)
class Places:
    """Received positions of one other aircraft."""

    label: str
    time_s: Floats
    """(n,)"""
    position_ned_m: Floats
    """(n, 3) in the scene's frame."""
    rssi_dbm: Floats
    """(n,) signal strength; NaN if the radio does not report it."""


@dataclass(frozen=True, slots=True)
class Bound:
    """The active half-spaces of tracks at one decision."""

    time_s: float
    position_ned_m: Floats
    """(3,) own position in the scene's frame."""
    velocity_ned_mps: Floats
    """(3,) chosen velocity."""
    half_spaces: tuple[HalfSpace, ...]


@dataclass(slots=True)
class Piece:
    """Data of some steps of one aircraft, in columns. Positions are in the scene's frame (NED, m)."""

    own_s: Floats
    """(n,) times of own positions."""
    own_geodetic: Floats
    """(n, 3) lat_deg, lon_deg, alt_msl_m."""
    own_ned_m: Floats
    """(n, 3)"""
    speed_mps: Floats
    """(n,) flown speed."""
    decided_s: Floats
    """(m,) times of decisions."""
    decided_ned_m: Floats
    """(m, 3) own positions used in the decisions."""
    wanted_ned_mps: Floats
    """(m, 3)"""
    chosen_ned_mps: Floats
    """(m, 3)"""
    path_s: Floats
    """(p,) times of decisions on a timed path."""
    path_ned_m: Floats
    """(p, 3) the path's point at those times."""
    seen: tuple[tuple[TrackView, ...], ...]
    """Tracks of each of the m decisions."""
    seen_ned_m: Floats
    """(sum of tracks, 3) positions of these tracks as the law predicted them."""
    setpoint_s: Floats
    """(k,) times of velocity setpoints."""
    setpoint_mps: Floats
    """(k,) commanded speed."""
    bounds: tuple[Bound, ...]
    heard: dict[str, Places]
    """Received positions, by radio address, or by "adsb" and the ICAO address."""
    notes: list[Note] = field(default_factory=list)
    states: dict[str, list[tuple[float, str]]] = field(default_factory=dict)
    """(time, state) of each change, by lane: authority, alert, mode, protocol, choice."""
