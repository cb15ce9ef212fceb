"""What enters the heart (events) and what leaves it (commands): one frozen value each.

They are `msgspec` structs (frozen, slotted, compared by value) so that the recorder writes them and the
replay reads them without a second description of the same thing. Units are SI; vectors are local NED;
"unknown" is `None`. Times called `time_boot_s` are the autopilot's own clock.
"""

from __future__ import annotations

import enum
from typing import Literal

import msgspec

from companion.geometry import Vec3
from companion.remote_id.messages import Message

SIGMA_UNKNOWN_M = 5.0
"""Own horizontal standard deviation that is assumed when the receiver declares none."""


class Event(msgspec.Struct, frozen=True, tag=True, kw_only=True, omit_defaults=True):
    """Something that entered the heart."""


class Command(msgspec.Struct, frozen=True, tag=True, kw_only=True, omit_defaults=True):
    """Something that left the heart."""


class Firmware(enum.Enum):
    """Whose manners the vehicle has."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"


class FlightMode(enum.Enum):
    """What the companion has to tell apart among an autopilot's modes; everything else is OTHER."""

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
    """MAV_SEVERITY, the part that the companion uses."""

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
    """CURRENT_MODE: the vehicle's mode, told between two heartbeats (PX4)."""

    custom_mode: int
    """As in the heartbeat."""


class TwoAutopilots(Event, frozen=True):
    """A second autopilot was heard on a link whose vehicle was not configured: which is ours is not known."""

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
    """Above WGS84; None where the autopilot does not fill the extension."""
    horizontal_accuracy_m: float | None = None
    vertical_accuracy_m: float | None = None
    speed_accuracy_mps: float | None = None
    satellites: int | None = None


class VehicleTime(Event, frozen=True):
    """SYSTEM_TIME: the autopilot's UTC, when it knows it."""

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
    """It has a horizontal velocity and an absolute position, and measures them."""


class RcChannels(Event, frozen=True):
    """RC_CHANNELS: where the pilot's sticks are."""

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
    """Params 1-4; None stands for NaN."""
    lat_deg: float | None = 0.0
    lon_deg: float | None = 0.0
    alt_m: float | None = 0.0
    """Position, or params 5-7 of a command without one; None where left open (NaN, INT32_MAX)."""


class MissionDownloaded(Event, frozen=True):
    """The whole mission as the vehicle holds it (ArduPilot's home item 0 left out)."""

    items: tuple[MissionItem, ...]


class MissionRefused(Event, frozen=True):
    """A mission download that failed: refused, or not finished after all retries."""

    reason: str


class MissionCurrent(Event, frozen=True):
    """MISSION_CURRENT."""

    seq: int
    complete: bool = False
    """Its last item is done; not told by older vehicles."""
    total: int = 0
    """How many items the mission has, as the vehicle counts; 0: none, or not told."""
    mission_id: int = 0
    """Another one for another mission; 0: not told (ArduPilot)."""


class FenceArea(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One area of a geofence, seen from above: a polygon, or a circle around its only point."""

    inclusion: bool
    """True: to be stayed in. False: to be stayed out of."""
    points: tuple[tuple[float, float], ...]
    """lat_deg, lon_deg of the corners in order, without the first one again at the end."""
    radius_m: float | None = None
    """Of a circle."""


class FenceDownloaded(Event, frozen=True):
    """The whole geofence as the vehicle holds it; no areas: it has none."""

    areas: tuple[FenceArea, ...]


class FenceRefused(Event, frozen=True):
    """A fence download that failed: refused, not finished after all retries, or not understood."""

    reason: str


class Parameter(msgspec.Struct, frozen=True, kw_only=True):
    """One parameter of the vehicle."""

    name: str
    """As this vehicle calls it."""
    value: float
    """SI."""


class VehicleParameters(Event, frozen=True):
    """The vehicle's own limits and failsafes, as far as it has told them; None: not known."""

    firmware: Firmware
    speed_mps: Parameter | None = None
    """Horizontal."""
    cruise_mps: Parameter | None = None
    """PX4: of a mission that asks for no other; ArduPilot's is `speed_mps`."""
    climb_mps: Parameter | None = None
    descent_mps: Parameter | None = None
    acceleration_mps2: Parameter | None = None
    """Horizontal."""
    setpoint_timeout_s: Parameter | None = None
    """Without setpoints for so long it no longer flies the last one."""
    loss_action: Parameter | None = None
    """PX4: what it does then."""
    fence_action: Parameter | None = None
    """What it does at its own fence; ArduPilot: whether it has one."""
    mission_restart: Parameter | None = None
    """ArduPilot: 1: AUTO always begins the mission anew."""
    adsb_type: Parameter | None = None
    """ArduPilot: its ADS-B receiver; 0: none."""
    adsb_radius_m: Parameter | None = None
    """ArduPilot: who is farther away is not told of; 0: everybody is."""


class AdsbVehicle(Event, frozen=True):
    """ADSB_VEHICLE: what the autopilot's ADS-B receiver hears, crewed traffic above all."""

    icao: int
    lat_deg: float
    lon_deg: float
    alt_m: float | None = None
    """None: not known."""
    alt_geometric: bool = False
    """True: above the WGS84 ellipsoid. False: barometric, from the sea level pressure."""
    velocity_ned_mps: Vec3 | None = None
    """None: not known."""
    age_s: float = 0.0
    """Time since it was last heard, in whole seconds."""
    callsign: str = ""
    emitter: int = 0
    """ADSB_EMITTER_TYPE."""


class VehicleText(Event, frozen=True):
    """STATUSTEXT of the autopilot."""

    severity: int
    text: str


# ---------------------------------------------------------------- from the shell and the gate


class InputBehind(Event, frozen=True):
    """What the autopilot told may be as old as `since_s` (our monotonic time): its input was not read to its
    end, or it waited on the way. Nothing is to be commanded in such a step: the vehicle's mode is not known.
    """

    since_s: float


class GateRefused(Event, frozen=True):
    """The gate let a command of ours not leave (`companion.gate`)."""

    rule: int
    """Number of the rule (`gate.rules`)."""
    text: str
    ends: Literal["nothing", "fault", "authority"] = "nothing"
    """What it ends: authority, as a fault does, or for good, as the pilot does. Nothing: it came too late."""


class GateAuthority(Event, frozen=True):
    """Whether the gate lets anything leave that commands the vehicle has changed."""

    lost: str | None = None
    """Why nothing is let leave before authority is given back, in words; None: it was given back."""


# ---------------------------------------------------------------- from the radio


class RemoteIdHeard(Event, frozen=True):
    """One frame with Remote ID messages, as received."""

    transport: str
    address: str
    """Transmitter's radio address."""
    messages: tuple[Message, ...]
    rssi_dbm: float | None = None
    counter: int | None = None
    """The frame's message counter, 0-255; None where the radio does not tell it."""


class RadioState(Event, frozen=True):
    """What the radios can do now; sent when it changes, and once at the start."""

    can_send: tuple[str, ...] = ()
    """Transports, sorted."""
    monitored: tuple[str, ...] = ()
    """Transports on which a receiver of ours would hear our own frames."""
    confirmed: tuple[str, ...] = ()
    """Transports that a radio itself reports as on the air."""
    own_addresses: tuple[str, ...] = ()
    """Radio addresses of our own frames."""
    wifi_channel: int | None = None
    """Channel of our Wi-Fi frames."""
    text: str = ""
    """What is wrong, in words; empty when nothing is."""


# ---------------------------------------------------------------- Remote ID told over MAVLink


class OperatorData(Event, frozen=True):
    """What a ground station says about the operator (OPEN_DRONE_ID_SYSTEM, _SYSTEM_UPDATE, _OPERATOR_ID,
    _SELF_ID)."""

    messages: tuple[Message, ...]


class RemoteIdModule(Event, frozen=True):
    """OPEN_DRONE_ID_ARM_STATUS of another component of our vehicle: a Remote ID transmitter of its own."""

    component_id: int
    ready: bool
    """MAV_ODID_ARM_STATUS_GOOD_TO_ARM."""
    text: str = ""


# ---------------------------------------------------------------- from ground stations


class Settings(Event, frozen=True, forbid_unknown_fields=True):
    """All that ground stations have set over the configuration; None: as configured."""

    enable: bool = True
    """False: the vehicle is neither taken nor kept."""
    conflict_radius_m: float | None = None
    horizon_s: float | None = None
    max_speed_mps: float | None = None


# ---------------------------------------------------------------- to the autopilot


class VelocitySetpoint(Command, frozen=True):
    """Fly this velocity (local NED); the link adds where the nose points (`flight.yaw`)."""

    velocity_ned_mps: Vec3


class SetMode(Command, frozen=True):
    """Ask for a flight mode; the link retries until the heartbeat confirms it, or reports ModeRefused."""

    mode: FlightMode
    speed_mps: float | None = None
    """Ground speed to fly there, told in the same breath (DO_CHANGE_SPEED); None leaves it."""


class SetSpeed(Command, frozen=True):
    """Ask for a ground speed of the mission (DO_CHANGE_SPEED)."""

    speed_mps: float


class DownloadMission(Command, frozen=True):
    """Fetch the vehicle's mission; answered by MissionDownloaded."""


class DownloadFence(Command, frozen=True):
    """Fetch the vehicle's geofence; answered by FenceDownloaded or FenceRefused."""


class Threat(Command, frozen=True):
    """COLLISION: how near another aircraft comes, for ground stations and the autopilot."""

    track_id: str
    adsb: bool
    """Heard by ADS-B, then `track_id` is the ICAO address in hexadecimal digits."""
    level: int
    """MAV_COLLISION_THREAT_LEVEL: 0 none, 1 low, 2 high."""
    acting: bool
    """The companion flies around it; False: it only tells."""
    time_to_closest_s: float
    horizontal_m: float
    """Least horizontal distance to come."""
    vertical_m: float
    """Least vertical distance to come."""


class Say(Command, frozen=True):
    """STATUSTEXT to the ground station."""

    severity: Severity
    text: str


class ArmStatus(Command, frozen=True):
    """OPEN_DRONE_ID_ARM_STATUS, where we are the vehicle's Remote ID component."""

    ready: bool
    text: str = ""
    """Why not; ground stations recognise "missing basic_id message"."""


# ---------------------------------------------------------------- to the radio


class Broadcast(Command, frozen=True):
    """Send these messages once, now."""

    transport: str
    messages: tuple[Message, ...]


# ---------------------------------------------------------------- to the log


class AuthorityChanged(Command, frozen=True):
    """The authority state machine moved."""

    previous: str
    state: str
    trigger: str
    reason: str


class BroadcastChanged(Command, frozen=True):
    """What is sent on the radio changed: transports with their messages per second."""

    rates: tuple[tuple[str, float], ...]
    legal: bool
    """Whether it keeps the floor of the region."""
    reason: str


class TransportsChosen(Command, frozen=True):
    """The transports that the own Remote ID is to use were chosen anew: transports with their Locations a
    second. What goes on the air keeps the region's floor besides (`BroadcastChanged`)."""

    rates: tuple[tuple[str, int], ...]
    by: Literal["policy", "rule", "fixed", "fallback"]
    reason: str


class TrackFlagged(Command, frozen=True):
    """A track of heard traffic is doubted for a new reason."""

    track_id: str
    flag: str
    text: str


class AlertChanged(Command, frozen=True):
    """The alert level of a track rose or fell."""

    track_id: str
    level: int
    """0 none, 1 advisory, 2 caution, 3 warning."""
    reason: str
    """Which aircraft, where and when it comes closest, what is done, what bounds it."""
    time_to_closest_s: float
    horizontal_m: float
    """Least horizontal distance, if both keep their velocities."""
    vertical_m: float
    acting: bool
    """The companion flies around it."""
    limits: tuple[str, ...] = ()
    """What besides other aircraft bounds the velocity, of `avoidance.law.LIMITS`."""


class TrackView(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, gc=False):
    """How the law saw one track at a decision."""

    track_id: str
    position_ned_m: Vec3
    """Predicted to now."""
    velocity_ned_mps: Vec3
    age_s: float
    radius_m: float
    """Combined radius used (horizontal)."""
    conflict: bool
    """True when the wanted velocity would break this track's volume."""
    time_to_closest_s: float
    closest_m: float
    active: bool = False
    """True when this track's half-space bounds the velocity that was chosen."""
    adsb: bool = False
    """Heard by ADS-B."""


class Decision(Command, frozen=True):
    """One cycle of the law, for the log: what it saw, wanted and chose. Frame: the heart's local NED."""

    origin: Vec3
    """lat_deg, lon_deg, alt_msl_m of the local frame."""
    position_ned_m: Vec3
    velocity_ned_mps: Vec3
    wanted_ned_mps: Vec3
    chosen_ned_mps: Vec3
    feasible: bool
    path_ned_m: Vec3 | None = None
    """The timed path's point for now."""
    late_s: float = 0.0
    """By how much the timed path has waited."""
    limits: tuple[str, ...] = ()
    """What besides other aircraft bounds the velocity that was chosen."""
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
