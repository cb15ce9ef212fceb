"""Input (events) and output (commands) of the core, each an immutable value.

They are `msgspec` structs (frozen, slotted, compared by value), so that the recorder writes them and the
replay reads them without a second definition. Units are SI, vectors are local NED, and unknown values are
`None`. Times called `time_boot_s` are read from the autopilot's own clock.
"""

from __future__ import annotations

import enum
from typing import Literal

import msgspec

from companion.geometry import Vec3
from companion.remote_id.messages import Message

SIGMA_UNKNOWN_M = 5.0
"""Own horizontal standard deviation (per axis) that is assumed if the receiver reports none."""


class Event(msgspec.Struct, frozen=True, tag=True, kw_only=True, omit_defaults=True):
    """An input of the core."""


class Command(msgspec.Struct, frozen=True, tag=True, kw_only=True, omit_defaults=True):
    """An output of the core."""


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


class Severity(enum.IntEnum):
    """The values of MAV_SEVERITY that the companion uses."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


# ---------------------------------------------------------------- from the autopilot


class Heartbeat(Event, frozen=True):
    """HEARTBEAT of the autopilot (component 1) of our vehicle."""

    system_id: int
    firmware: Firmware
    vehicle_type: int
    """MAV_TYPE."""
    custom_mode: int
    mode: FlightMode
    armed: bool


class CurrentMode(Event, frozen=True):
    """CURRENT_MODE: the vehicle's mode, reported between two heartbeats (PX4)."""

    custom_mode: int
    """Mode number, as in the heartbeat."""


class TwoAutopilots(Event, frozen=True):
    """A second autopilot was heard and no vehicle is configured, so it is not known which vehicle is ours."""

    reason: str


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


class VehicleText(Event, frozen=True):
    """STATUSTEXT of the autopilot."""

    severity: int
    text: str


# ---------------------------------------------------------------- from `system.CompanionSystem` and the gate


class InputBehind(Event, frozen=True):
    """Messages of the autopilot in this step may be as old as `since_s` (our monotonic time).

    The input was not read until it was empty, or messages waited on the way. The vehicle's mode is then not
    known, so nothing may be commanded in this step.
    """

    since_s: float


class GateRefused(Event, frozen=True):
    """The gate (`companion.gate`) refused to send one of our commands."""

    rule: int
    """Number of the broken rule (`gate.rules`)."""
    text: str
    ends: Literal["nothing", "fault", "authority"] = "nothing"
    """Consequence of the refusal. "fault" ends authority as a fault does, and "authority" ends it until it is
    given back, as when the pilot takes over. "nothing": the command only came too early or too late."""


class GateAuthority(Event, frozen=True):
    """The gate has lost authority over the vehicle, or regained it."""

    lost: str | None = None
    """Why the gate blocks all commands until authority is given back, in words; None if it was given back."""


# ---------------------------------------------------------------- from the radio


class RemoteIdHeard(Event, frozen=True):
    """One received frame with Remote ID messages."""

    transport: str
    address: str
    """Radio address of the transmitter."""
    messages: tuple[Message, ...]
    rssi_dbm: float | None = None
    counter: int | None = None
    """Message counter of the frame, 0 to 255; None if the radio does not report it."""


class RadioState(Event, frozen=True):
    """Current capabilities of the radios. Sent once at the start and whenever they change."""

    can_send: tuple[str, ...] = ()
    """Transports on which the radios can send, sorted."""
    monitored: tuple[str, ...] = ()
    """Transports on which one of our receivers would hear our own frames."""
    confirmed: tuple[str, ...] = ()
    """Transports that a radio itself reports as on the air."""
    own_addresses: tuple[str, ...] = ()
    """Radio addresses of our own frames."""
    wifi_channel: int | None = None
    """Channel of our Wi-Fi frames."""
    text: str = ""
    """Description of a problem; empty if there is none."""


# ---------------------------------------------------------------- Remote ID data received over MAVLink


class OperatorData(Event, frozen=True):
    """Operator data from a ground station (OPEN_DRONE_ID_SYSTEM, _SYSTEM_UPDATE, _OPERATOR_ID, _SELF_ID)."""

    messages: tuple[Message, ...]


class RemoteIdModule(Event, frozen=True):
    """OPEN_DRONE_ID_ARM_STATUS of another component of our vehicle, which is a Remote ID transmitter."""

    component_id: int
    ready: bool
    """MAV_ODID_ARM_STATUS_GOOD_TO_ARM."""
    text: str = ""


# ---------------------------------------------------------------- from ground stations


class Settings(Event, frozen=True, forbid_unknown_fields=True):
    """All settings that ground stations have changed; None where the configured value applies."""

    enable: bool = True
    """False: the companion neither takes nor keeps control of the vehicle."""
    conflict_radius_m: float | None = None
    horizon_s: float | None = None
    max_speed_mps: float | None = None


# ---------------------------------------------------------------- to the autopilot


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


class DownloadMission(Command, frozen=True):
    """Fetch the vehicle's mission; answered by MissionDownloaded or MissionRefused."""


class DownloadFence(Command, frozen=True):
    """Fetch the vehicle's geofence; answered by FenceDownloaded or FenceRefused."""


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


class Say(Command, frozen=True):
    """STATUSTEXT to the ground station."""

    severity: Severity
    text: str


class ArmStatus(Command, frozen=True):
    """OPEN_DRONE_ID_ARM_STATUS, sent if we are the vehicle's Remote ID component."""

    ready: bool
    text: str = ""
    """Why Remote ID is not ready. Ground stations recognise "missing basic_id message"."""


# ---------------------------------------------------------------- to the radio


class Broadcast(Command, frozen=True):
    """Send these messages once, now."""

    transport: str
    messages: tuple[Message, ...]


# ---------------------------------------------------------------- to the log


class AuthorityChanged(Command, frozen=True):
    """The authority state machine changed its state."""

    previous: str
    state: str
    trigger: str
    reason: str


class BroadcastChanged(Command, frozen=True):
    """The broadcast on the radio changed."""

    rates: tuple[tuple[str, float], ...]
    """Transports with their messages per second."""
    legal: bool
    """Whether the broadcast meets the legal minimum of the region."""
    reason: str


class TransportsChosen(Command, frozen=True):
    """The transports for our own Remote ID were chosen again.

    What is actually sent also meets the legal minimum of the region (`BroadcastChanged`).
    """

    rates: tuple[tuple[str, int], ...]
    """Transports with their Location messages per second."""
    by: Literal["policy", "rule", "fixed", "fallback"]
    reason: str


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


AnyEvent = (
    Heartbeat
    | CurrentMode
    | TwoAutopilots
    | GlobalPosition
    | LocalPosition
    | GnssFix
    | VehicleTime
    | ClockRead
    | LandedState
    | EstimatorState
    | RcChannels
    | ModeRefused
    | MissionDownloaded
    | MissionRefused
    | MissionCurrent
    | FenceDownloaded
    | FenceRefused
    | VehicleParameters
    | AdsbVehicle
    | VehicleText
    | InputBehind
    | GateRefused
    | GateAuthority
    | RemoteIdHeard
    | RadioState
    | OperatorData
    | RemoteIdModule
    | Settings
)

AnyCommand = (
    VelocitySetpoint
    | SetMode
    | SetSpeed
    | DownloadMission
    | DownloadFence
    | Threat
    | Say
    | ArmStatus
    | Broadcast
    | AuthorityChanged
    | BroadcastChanged
    | TransportsChosen
    | TrackFlagged
    | AlertChanged
    | Decision
)
