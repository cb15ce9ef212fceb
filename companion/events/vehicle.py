"""What our vehicle does: modes, own state, sticks, and the commands that fly it.

Times called `time_boot_s` are read from the autopilot's own clock.
"""

from __future__ import annotations

import enum

from companion.events.base import Command, Event
from companion.geometry import Vec3

SIGMA_UNKNOWN_M = 5.0
"""Own horizontal standard deviation (per axis) that is assumed if the receiver reports none."""


class Firmware(enum.Enum):
    """Autopilot firmware of the vehicle."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"


class FlightMode(enum.Enum):
    """The autopilot modes that the companion distinguishes; all others are OTHER."""

    EXTERNAL = "external"
    """Flies velocity setpoints: ArduPilot GUIDED, PX4 OFFBOARD."""
    MISSION = "mission"
    """Flies its stored mission: ArduPilot AUTO, PX4 AUTO.MISSION."""
    HOLD = "hold"
    """Holds position: ArduPilot BRAKE, PX4 AUTO.LOITER."""
    STICKS = "sticks"
    """Holds position, flown with the sticks: ArduPilot LOITER, PX4 POSCTL."""
    OTHER = "other"


class Landed(enum.Enum):
    """EXTENDED_SYS_STATE.landed_state."""

    UNDEFINED = "undefined"
    ON_GROUND = "on_ground"
    IN_AIR = "in_air"
    TAKEOFF = "takeoff"
    LANDING = "landing"


class Heartbeat(Event, frozen=True):
    """HEARTBEAT of the autopilot (component 1) of our vehicle."""

    system_id: int
    firmware: Firmware
    vehicle_type: int
    """MAV_TYPE."""
    custom_mode: int
    mode: FlightMode
    armed: bool
    overtaken: bool = False
    """A newer message of the vehicle arrived before this one, so its mode may have changed since."""
    failsafe: bool = False
    """A failsafe acts, or it is not known yet whether one does (MAV_STATE critical or emergency)."""


class CurrentMode(Event, frozen=True):
    """CURRENT_MODE: the vehicle's mode, reported between two heartbeats (PX4)."""

    custom_mode: int
    """Mode number, as in the heartbeat."""
    overtaken: bool = False
    """As in `Heartbeat`."""


class TwoAutopilots(Event, frozen=True):
    """A second autopilot was heard and no vehicle is configured, so it is not known which vehicle is ours."""

    reason: str


class SecondCompanion(Event, frozen=True):
    """Another companion with our own system and component id is on the link, or is no longer."""

    reason: str | None = None
    """What it is and what to do, in words; None if it is gone."""


class GlobalPosition(Event, frozen=True):
    """GLOBAL_POSITION_INT: the fused own position and velocity."""

    time_boot_s: float
    lat_deg: float
    lon_deg: float
    alt_msl_m: float
    height_above_home_m: float
    velocity_ned_mps: Vec3


class LocalPosition(Event, frozen=True):
    """LOCAL_POSITION_NED: own position from the local origin, and own velocity at full resolution."""

    time_boot_s: float
    position_ned_m: Vec3
    velocity_ned_mps: Vec3


class GnssFix(Event, frozen=True):
    """GPS_RAW_INT: quality of the GNSS solution."""

    fix_type: int
    """GPS_FIX_TYPE; 3 and above is a 3D fix."""
    lat_deg: float
    lon_deg: float
    alt_msl_m: float
    alt_ellipsoid_m: float | None = None
    """Altitude above the WGS84 ellipsoid; None if the autopilot does not fill this extension field."""
    horizontal_accuracy_m: float | None = None
    vertical_accuracy_m: float | None = None
    speed_accuracy_mps: float | None = None
    satellites: int | None = None


class AirPressure(Event, frozen=True):
    """SCALED_PRESSURE: the absolute pressure that the autopilot's barometer measures."""

    pressure_hpa: float


class VehicleTime(Event, frozen=True):
    """SYSTEM_TIME: the autopilot's UTC, if it knows UTC."""

    time_boot_s: float
    utc_s: float | None = None


class ClockRead(Event, frozen=True):
    """TIMESYNC: the autopilot read its clock after `asked_s` and before `heard_s` (our monotonic time)."""

    time_boot_s: float
    asked_s: float
    heard_s: float


class LandedState(Event, frozen=True):
    """EXTENDED_SYS_STATE."""

    landed: Landed


class EstimatorState(Event, frozen=True):
    """EKF_STATUS_REPORT (ArduPilot), ESTIMATOR_STATUS (PX4)."""

    usable: bool
    """The estimator has a measured horizontal velocity and a measured absolute position."""


class RcChannels(Event, frozen=True):
    """RC_CHANNELS: positions of the pilot's sticks."""

    sticks_us: tuple[int, int, int] | None = None
    """Roll, pitch, yaw on channels 1, 2, 4 (us); None without a remote control."""


class ModeRefused(Event, frozen=True):
    """A mode that we commanded was refused, or never confirmed by a heartbeat after all retries."""

    mode: FlightMode
    reason: str


class VelocitySetpoint(Command, frozen=True):
    """Fly this velocity (local NED). The link adds the yaw (`flight.yaw`)."""

    velocity_ned_mps: Vec3


class SetMode(Command, frozen=True):
    """Ask for a flight mode. The link retries until the heartbeat confirms it, or reports ModeRefused."""

    mode: FlightMode
    speed_mps: float | None = None
    """Ground speed for that mode, sent together with the request (DO_CHANGE_SPEED); None to leave it."""


class SetSpeed(Command, frozen=True):
    """Set the ground speed of the mission (DO_CHANGE_SPEED)."""

    speed_mps: float
