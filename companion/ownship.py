"""Own state as the autopilot reports it: position, velocity, clock, quality, and whether it may be used.

The vehicle is the only source of UTC (a small computer has no clock of its own). UTC is tied to two other
clocks: the autopilot's time since boot, which dates a position exactly, and our monotonic time.
"""

from __future__ import annotations

from dataclasses import dataclass

from companion.events import (
    Event,
    FlightMode,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    Landed,
    LandedState,
    LocalPosition,
    Vec3,
    VehicleTime,
)
from companion.geometry import LocalFrame

SIGMA_UNKNOWN_M = 5.0
"""Own horizontal standard deviation when the receiver declares none."""
_HEARTBEAT_LOST_S = 3.0
_GNSS_LOST_S = 3.0
_CLOCK_DRIFT = 1e-3
_CLOCK_JUMP_S = 5.0
"""SYSTEM_TIME that reads late by more than this was not delayed: the vehicle's clock was set back."""


@dataclass(slots=True)
class Ownship:
    """Everything known of the own aircraft."""

    heartbeat: Heartbeat | None = None
    heartbeat_s: float = float("-inf")
    position: GlobalPosition | None = None
    received_s: float = float("-inf")
    """When the position arrived."""
    velocity_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    velocity_boot_s: float = float("-inf")
    gnss: GnssFix | None = None
    gnss_s: float = float("-inf")
    landed: Landed = Landed.UNDEFINED
    takeoff: GlobalPosition | None = None
    """Where the aircraft was last seen on the ground."""
    separation_m: float | None = None
    """Geoid above the ellipsoid (m), from the GNSS receiver's two altitudes."""
    _sample_ned_m: Vec3 = (0.0, 0.0, 0.0)
    frame: LocalFrame | None = None
    """Local NED: origin at the first position, altitude datum mean sea level; fixed for the flight."""
    utc_offset_s: float | None = None
    """UTC minus our monotonic time; from the least delayed SYSTEM_TIME."""
    utc_offset_at_s: float = 0.0
    boot_to_utc_s: float | None = None
    """UTC minus the autopilot's time since boot."""

    def take(self, event: Event, now_s: float) -> None:
        """Take in one event that concerns the own aircraft; others are left alone."""
        match event:
            case Heartbeat():
                self.heartbeat, self.heartbeat_s = event, now_s
            case GlobalPosition():
                self._take_position(event, now_s)
            case LocalPosition() if event.time_boot_s >= self.velocity_boot_s:
                self.velocity_ned_mps, self.velocity_boot_s = event.velocity_ned_mps, event.time_boot_s
            case GnssFix():
                self.gnss, self.gnss_s = event, now_s
                if event.alt_ellipsoid_m is not None:
                    self.separation_m = event.alt_ellipsoid_m - event.alt_msl_m
            case LandedState():
                self.landed = event.landed
            case VehicleTime():
                self._take_time(event, now_s)
            case _:
                pass

    def _take_position(self, event: GlobalPosition, now_s: float) -> None:
        if self.position is not None and event.time_boot_s < self.position.time_boot_s - 1.0:
            # The autopilot rebooted: its clock began anew.
            self.velocity_boot_s, self.boot_to_utc_s = float("-inf"), None
        self.position, self.received_s = event, now_s
        if event.time_boot_s >= self.velocity_boot_s:
            self.velocity_ned_mps, self.velocity_boot_s = event.velocity_ned_mps, event.time_boot_s
        if self.landed is Landed.ON_GROUND:
            self.takeoff = event
        if self.frame is None:
            self.frame = LocalFrame(event.lat_deg, event.lon_deg, event.alt_msl_m)
        self._sample_ned_m = self.frame.to_ned(event.lat_deg, event.lon_deg, event.alt_msl_m)

    def _take_time(self, event: VehicleTime, now_s: float) -> None:
        if event.utc_s is None:
            return
        self.boot_to_utc_s = event.utc_s - event.time_boot_s
        offset = event.utc_s - now_s
        if self.utc_offset_s is not None and offset > self.utc_offset_s - _CLOCK_JUMP_S:
            # Link delay only ever makes the offset read too small: keep the largest, less the clocks' drift.
            drift = _CLOCK_DRIFT * (now_s - self.utc_offset_at_s)
            offset = max(offset, self.utc_offset_s - drift)
        self.utc_offset_s, self.utc_offset_at_s = offset, now_s

    @property
    def mode(self) -> FlightMode | None:
        """Mode in the last heartbeat."""
        return None if self.heartbeat is None else self.heartbeat.mode

    @property
    def armed(self) -> bool:
        """Armed in the last heartbeat."""
        return self.heartbeat is not None and self.heartbeat.armed

    def sample_s(self) -> float:
        """Our monotonic time of the position held (never after it arrived). Needs a position."""
        assert self.position is not None
        if self.utc_offset_s is None or self.boot_to_utc_s is None:
            return self.received_s
        return min(self.received_s, self.position.time_boot_s + self.boot_to_utc_s - self.utc_offset_s)

    def sample_utc_s(self) -> float | None:
        """UTC of the position held; None while UTC is unknown."""
        if self.position is None or self.boot_to_utc_s is None:
            return None
        return self.position.time_boot_s + self.boot_to_utc_s

    def age_s(self, now_s: float) -> float:
        """Age of the position held; infinite while there is none."""
        return float("inf") if self.position is None else now_s - self.sample_s()

    def position_ned_m(self, now_s: float) -> Vec3:
        """Position at `now_s` in the local frame (m), carried on with the own velocity. Needs a position."""
        p, v = self._sample_ned_m, self.velocity_ned_mps
        age = now_s - self.sample_s()
        return p[0] + age * v[0], p[1] + age * v[1], p[2] + age * v[2]

    @property
    def sigma_m(self) -> float:
        """Own horizontal standard deviation per axis (m), as the receiver estimates it."""
        if self.gnss is None or self.gnss.horizontal_accuracy_m is None:
            return SIGMA_UNKNOWN_M
        return self.gnss.horizontal_accuracy_m

    @property
    def home_alt_msl_m(self) -> float | None:
        """Altitude of the vehicle's home."""
        return None if self.position is None else self.position.alt_msl_m - self.position.height_above_home_m

    def unfit(self, now_s: float, stale_after_s: float) -> str | None:
        """Why the own state cannot be flown on, in words; None when it can."""
        if self.heartbeat is None or now_s - self.heartbeat_s > _HEARTBEAT_LOST_S:
            return f"no heartbeat from the autopilot for {_HEARTBEAT_LOST_S:g} s"
        if self.age_s(now_s) > stale_after_s:
            return f"own position older than {stale_after_s:g} s"
        if self.gnss is None or now_s - self.gnss_s > _GNSS_LOST_S:
            return f"no GNSS report for {_GNSS_LOST_S:g} s"
        if self.gnss.fix_type < 3:
            return f"GNSS without a 3D fix (fix type {self.gnss.fix_type})"
        return None
