"""What our vehicle has stored: mission, geofence and parameters, and the commands that download them."""

from __future__ import annotations

import msgspec

from companion.events.base import Command, Event
from companion.events.vehicle import Firmware


class MissionItem(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One MISSION_ITEM_INT as downloaded."""

    seq: int
    command: int
    """MAV_CMD."""
    frame: int
    """MAV_FRAME."""
    params: tuple[float | None, float | None, float | None, float | None] = (0.0, 0.0, 0.0, 0.0)
    """Params 1 to 4; None stands for NaN."""
    lat_deg: float | None = 0.0
    lon_deg: float | None = 0.0
    alt_m: float | None = 0.0
    """Position, or params 5 to 7 of a command without one; None if not given (NaN, INT32_MAX)."""


class MissionDownloaded(Event, frozen=True):
    """The whole mission that the vehicle holds (without ArduPilot's home item 0)."""

    items: tuple[MissionItem, ...]


class MissionRefused(Event, frozen=True):
    """A mission download failed: it was refused, or not finished after all retries."""

    reason: str


class MissionCurrent(Event, frozen=True):
    """MISSION_CURRENT."""

    seq: int
    complete: bool = False
    """The last item is done. Older firmware does not report this."""
    total: int = 0
    """Number of items as the vehicle counts them; 0 if there are none or the number is not reported."""
    mission_id: int = 0
    """Identifier that differs between missions; 0 if it is not reported (ArduPilot)."""


class FenceArea(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One area of a geofence, seen from above: a polygon, or a circle around its only point."""

    inclusion: bool
    """True: the vehicle must stay inside. False: it must stay outside."""
    points: tuple[tuple[float, float], ...]
    """lat_deg, lon_deg of the corners in order. The first corner is not repeated at the end."""
    radius_m: float | None = None
    """Radius of a circle; None for a polygon."""


class FenceDownloaded(Event, frozen=True):
    """The whole geofence that the vehicle holds; no areas if it has none."""

    areas: tuple[FenceArea, ...]


class FenceRefused(Event, frozen=True):
    """A fence download failed: it was refused, not finished after all retries, or not understood."""

    reason: str


class Parameter(msgspec.Struct, frozen=True, kw_only=True):
    """One parameter of the vehicle."""

    name: str
    """Name that this vehicle's firmware uses."""
    value: float
    """Value in SI units."""


class VehicleParameters(Event, frozen=True):
    """The vehicle's own limits and failsafes, as far as it has reported them; None if not known."""

    firmware: Firmware
    speed_mps: Parameter | None = None
    """Horizontal speed limit."""
    cruise_mps: Parameter | None = None
    """PX4: speed of a mission that sets no other. ArduPilot uses `speed_mps` for that."""
    climb_mps: Parameter | None = None
    descent_mps: Parameter | None = None
    acceleration_mps2: Parameter | None = None
    """Horizontal acceleration limit."""
    setpoint_timeout_s: Parameter | None = None
    """How long the vehicle flies the last setpoint when no new ones arrive."""
    loss_action: Parameter | None = None
    """PX4: action after that timeout."""
    fence_action: Parameter | None = None
    """Action at the vehicle's own fence. ArduPilot: whether it has a fence."""
    mission_restart: Parameter | None = None
    """ArduPilot: 1 if AUTO always restarts the mission."""
    adsb_type: Parameter | None = None
    """ArduPilot: type of the ADS-B receiver; 0: none."""
    adsb_radius_m: Parameter | None = None
    """ArduPilot: aircraft farther away than this are not reported; 0: all are reported."""
    traffic_action: Parameter | None = None
    """PX4: what the vehicle does about traffic by itself; 0: nothing, 1: it warns."""


class DownloadMission(Command, frozen=True):
    """Fetch the vehicle's mission; answered by MissionDownloaded or MissionRefused."""


class DownloadFence(Command, frozen=True):
    """Fetch the vehicle's geofence; answered by FenceDownloaded or FenceRefused."""
