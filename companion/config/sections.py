"""The sections of a configuration file and of the trajectory file that it names.

Each key's name ends with its unit. Unknown keys are refused. The sections of radios are in
`companion.radio.registry` and the folders that it names.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from companion.events import FenceArea
from companion.radio.null.section import NullRadio
from companion.radio.registry import RadioConfig
from companion.remote_id.messages import IdType, UaType
from companion.remote_id.region import Region, TransportName
from companion.toml_reader import SECRET

EXAMPLE_ID = "1596B0000DMUCA01"
"""Serial number in the example configurations; no aircraft may fly with it."""
CHOOSER_WORDS = ("rule", "fixed")
"""Values of `atmc.policy` other than a path: "rule" is the one-line rule, "fixed" the best fixed legal
set."""
_PLUGIN = "plugin:"
"""Prefix of a value of `atmc.policy` that names a plug-in."""


def policy_plugin(policy: str | None) -> str | None:
    """Name of the plug-in in a value of `atmc.policy` such as "plugin:mine"; None if the value names none."""
    return policy.removeprefix(_PLUGIN) if policy is not None and policy.startswith(_PLUGIN) else None


def names_file(policy: str | None) -> bool:
    """Whether a value of `atmc.policy` means a file."""
    return policy is not None and policy not in CHOOSER_WORDS and policy_plugin(policy) is None


class _Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all sections."""


class VehicleConfig(_Section, frozen=True):
    """The link to the autopilot."""

    link: str = "udpin:127.0.0.1:14540"
    """udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD."""
    system_id: Annotated[int, Meta(ge=0, le=255)] = 0
    """MAVLink system ID of our vehicle. 0: the only autopilot on the link; if there are two, none is used."""
    component_id: Annotated[int, Meta(ge=2, le=255)] = 191
    """MAVLink component ID of the companion. 1 is the autopilot's own."""
    dialect: Annotated[str, Meta(min_length=1)] | None = None
    """Name of a plug-in whose dialect replaces that of the firmware that it resembles. None: use the built-in
    dialects of ArduPilot and PX4."""
    wait_s: Annotated[float, Meta(gt=0, le=600)] = 10.0
    """How long to wait for the vehicle's first heartbeat."""
    stale_after_s: Annotated[float, Meta(ge=0.2, le=5)] = 1.0
    """An own position older than this ends authority (fault)."""
    signing_key: Annotated[str, Meta(min_length=1, extra=SECRET)] | None = None
    """Path of the key file of MAVLink 2 signing (relative to this file; absolute once loaded). A
    configuration never contains the key itself."""


class IdentityConfig(_Section, frozen=True):
    """Identity of the own aircraft in Remote ID."""

    uas_id: Annotated[str, Meta(min_length=1, max_length=40)]
    """UAS ID. A UUID or session ID is written as hexadecimal digits in a file; here it is in the raw form of
    `BasicId.uas_id`."""
    id_type: IdType = IdType.SERIAL_NUMBER
    ua_type: UaType = UaType.HELICOPTER_OR_MULTIROTOR
    icao: Annotated[str, Meta(pattern="^[0-9A-Fa-f]{6}$")] | None = None
    """ICAO address of the aircraft's own ADS-B transponder, six hexadecimal digits. Reports with it are
    ignored."""
    registration_id: Annotated[str, Meta(min_length=1, max_length=20)] | None = None
    """Registration that the state gave the aircraft; sent as a second Basic ID (Japan requires both)."""

    @property
    def name(self) -> str:
        """`uas_id` in printable form: hexadecimal if it is raw bytes."""
        return self.uas_id if self.uas_id.isprintable() else self.uas_id.encode("latin-1").hex()

    @property
    def file_name(self) -> str:
        """`name` with every character that is unsuitable for a file name replaced by "_"."""
        return "".join(c if c.isalnum() or c in "-_" else "_" for c in self.name)


class FlightConfig(_Section, frozen=True):
    """What to fly, and when the companion may take the vehicle."""

    use: Literal["watch", "guard", "fly"] = "watch"
    """watch: broadcast, listen and log, never command. guard: the autopilot flies its mission, and the
    companion takes the vehicle only for a conflict. fly: command the timed trajectory."""
    trajectory: str | None = None
    """Path of a trajectory file (relative to this file), or "mission" for the vehicle's own mission."""
    mission_speed_mps: Annotated[float, Meta(ge=0.2, le=100)] | None = None
    """Speed on the vehicle's mission; needed with trajectory = "mission"."""
    start: Literal["engage", "utc"] = "engage"
    """engage: the path's clock starts when the companion takes the vehicle. utc: it starts at start_utc_s."""
    start_utc_s: float | None = None
    rearm: Literal["mode", "disarm", "never"] = "disarm"
    """When authority may return after the pilot took it. mode: when the pilot selects GUIDED/OFFBOARD (guard:
    AUTO/MISSION). disarm: when the vehicle has been disarmed. never: only after a restart."""
    take_in_flight: bool = False
    """Whether the companion may take a vehicle that was already flying when the companion started. If not, a
    companion that restarts in flight waits for the next landing."""
    start_within_m: Annotated[float, Meta(ge=1, le=10000)] = 100.0
    """The vehicle is taken only within this distance of the path's present point."""
    setpoint_rate_hz: Annotated[float, Meta(ge=5, le=50)] = 20.0
    yaw: Literal["face", "hold"] = "face"
    """face: the nose points in the direction of flight. hold: the heading stays as it is."""


class LimitsConfig(_Section, frozen=True):
    """Limits that no command ever exceeds."""

    max_speed_mps: Annotated[float, Meta(ge=0.5, le=50)] = 5.0
    """Greatest total speed."""
    max_climb_mps: Annotated[float, Meta(ge=0.1, le=20)] = 2.0
    max_descent_mps: Annotated[float, Meta(ge=0.1, le=20)] = 2.0
    max_acceleration_mps2: Annotated[float, Meta(ge=0.2, le=20)] = 2.0
    """Greatest rate of change of the commanded velocity."""
    floor_height_m: Annotated[float, Meta(ge=-500, le=10_000)] | None = None
    """Height above home. None: the lower of 15 m and the path's lowest point."""
    ceiling_height_m: Annotated[float, Meta(ge=-500, le=10_000)] | None = None
    """Height above home, at least 5 m above the floor."""
    fence: str | None = None
    """Path of a fence file (relative to this file), or "vehicle" for the vehicle's own geofence."""


class AvoidanceConfig(_Section, frozen=True):
    """The avoidance law. The defaults are those of the reference flight tests; "paper" is exactly the
    published law."""

    law: Annotated[str, Meta(min_length=1)] = "dmuca"
    """A key of `companion.laws.LAWS`, the name of a plug-in, or "module:class"."""
    conflict_radius_m: Annotated[float, Meta(ge=0.5, le=1000)] = 5.0
    """Radius of one aircraft. The separation of two aircraft must be at least twice this radius."""
    crewed_horizontal_m: Annotated[float, Meta(ge=10, le=5000)] = 610.0
    """Horizontal separation from crewed traffic; alternatively `crewed_vertical_m` must be kept in height.
    The defaults contain well clear of ASTM F3442: 2,000 ft and 250 ft."""
    crewed_vertical_m: Annotated[float, Meta(ge=5, le=1000)] = 77.0
    horizon_s: Annotated[float, Meta(ge=1, le=120)] = 20.0
    period_s: Annotated[float, Meta(ge=0.02, le=1)] = 0.2
    recovery_time_s: Annotated[float, Meta(ge=1, le=120)] = 15.0
    """T of the paper: time in which to close the gap to the path's present point."""
    n_noncollide: Annotated[int, Meta(ge=1, le=1000)] = 15
    """Decision cycles without a conflict after which an avoidance is over; in the paper's law, recovery
    starts."""
    regained_m: Annotated[float, Meta(ge=0.5, le=1000)] = 5.0
    """Within this distance of its timed point, the aircraft counts as back on the path."""


class ContainmentConfig(_Section, frozen=True):
    """How far and how long traffic whose identity no signature has verified may move the aircraft."""

    side_m: Annotated[float, Meta(ge=30, le=100_000)] = 150.0
    """Greatest horizontal distance from the convex hull of the mission or path."""
    below_m: Annotated[float, Meta(ge=10, le=10_000)] = 30.0
    """Greatest distance below the present leg. The floor applies in any case."""
    above_m: Annotated[float, Meta(ge=10, le=10_000)] = 30.0
    """Greatest distance above the present leg. The ceiling applies in any case."""
    track_s: Annotated[float, Meta(ge=10, le=86_400)] = 300.0
    """How long one track may be in conflict with the aircraft, or bound its velocity, while the companion
    flies it."""
    inside_s: Annotated[float, Meta(ge=10, le=86_400)] = 90.0
    """Part of `track_s` for which the aircraft may be inside the track's volume (separation and margins)."""
    group_s: Annotated[float, Meta(ge=10, le=86_400)] = 450.0
    """As `track_s`, for all tracks of one group together."""
    total_s: Annotated[float, Meta(ge=10, le=86_400)] = 600.0
    """How long the companion may fly the aircraft because of all these tracks together, way back included."""
    refill_s: Annotated[float, Meta(ge=60, le=86_400)] = 3600.0
    """Time in which a spent allowance refills completely."""
    then: Literal["resume", "hold"] = "resume"
    """What happens when `total_s` is spent. resume: fly on without avoiding these tracks, and warn; ask the
    vehicle to hold only where a track that stands still is in the way. hold: ask the vehicle to hold in any
    conflict with them, and leave it to the pilot."""
    crewed_side_m: Annotated[float, Meta(ge=30, le=100_000)] | None = None
    """`side_m` for crewed traffic (ADS-B), which may also press the aircraft down to the floor. None:
    1.25 times avoidance.crewed_horizontal_m, at least `side_m`."""
    crewed_above_m: Annotated[float, Meta(ge=10, le=10_000)] | None = None
    """`above_m` for crewed traffic. None: 1.25 times avoidance.crewed_vertical_m, at least `above_m`."""
    crewed_total_s: Annotated[float, Meta(ge=10, le=86_400)] = 600.0
    """`total_s` for crewed traffic, which has no allowance for each track."""
    crewed_then: Literal["resume", "hold"] = "hold"
    """`then` for crewed traffic."""


class TrafficConfig(_Section, frozen=True):
    """Tracks of other aircraft from Remote ID."""

    max_tracks: Annotated[int, Meta(ge=1, le=10000)] = 200
    expire_after_s: Annotated[float, Meta(ge=3, le=15)] = 15.0
    """Time after its last message at which a track is removed. An aircraft with long gaps between its
    messages is kept for three of its longest recent gaps, at most twice as long as this. The law avoids no
    track that is older than 30 s."""
    max_clock_offset_s: Annotated[float, Meta(ge=0, le=60)] = 5.0
    max_speed_mps: Annotated[float, Meta(ge=10, le=400)] = 120.0
    """Of a message that reports a higher speed only the position is used. It also bounds how far an aircraft
    of unknown velocity can have flown."""
    keys: dict[str, str] = {}
    """Ed25519 public key for each identity, to check its signatures with: 64 hex digits, or the path
    (relative to this file) of a PEM file. An identity that is a DRIP entity tag is written as an IPv6
    address."""
    publish: Literal["off", "if-ignored", "routed"] = "off"
    """Whether heard Remote ID traffic is sent as ADSB_VEHICLE for the maps of ground stations. An autopilot
    that takes such messages may avoid the traffic by itself (ArduPilot AVD_*, PX4 NAV_TRAFF_AVOID).
    "if-ignored": only while the vehicle's parameters show that its autopilot does not act on them. "routed":
    always, because a router keeps message 246 from the autopilot."""
    anchors: dict[str, str] = {}
    """Ed25519 public key for the DRIP entity tag (an IPv6 address) of each registry whose endorsements of
    aircraft are believed, in the form of `keys`."""


class SensedConfig(_Section, frozen=True):
    """Obstacles and aircraft that transmit nothing, as a sensor aboard reports them over MAVLink."""

    use: bool = False
    """Whether to read such a sensor. Without one on the link nothing changes."""
    components: Annotated[tuple[Annotated[int, Meta(ge=2, le=255)], ...], Meta(max_length=8)] = (196,)
    """MAVLink components of our own vehicle's system whose OBSTACLE_DISTANCE, OBSTACLE_DISTANCE_3D and
    ADSB_VEHICLE are measurements. 196 is MAV_COMP_ID_OBSTACLE_AVOIDANCE. The first two are also taken from
    the autopilot, and DISTANCE_SENSOR from an ArduPilot alone."""
    min_range_m: Annotated[float, Meta(ge=0.2, le=20)] = 1.0
    """Nearer measurements are not used: they show the own vehicle (rotors, landing gear)."""
    max_range_m: Annotated[float, Meta(ge=5, le=5000)] = 300.0
    """Farther measurements are not used."""
    range_sigma_m: Annotated[float, Meta(ge=0.02, le=20)] = 0.3
    """Error of a measured distance, one standard deviation."""
    bearing_sigma_deg: Annotated[float, Meta(ge=0.1, le=20)] = 1.5
    """Error of a measured direction by mounting and heading, one standard deviation. The width of the sector
    adds to it."""
    latency_s: Annotated[float, Meta(ge=0, le=1)] = 0.1
    """Time from a measurement to its arrival here."""
    ground_m: Annotated[float, Meta(ge=-100, le=100)] = 3.0
    """Measurements below this height above home count as ground."""


class SigningConfig(_Section, frozen=True):
    """Signatures over the own Remote ID by DRIP (RFC 9374, RFC 9575)."""

    key: Annotated[str, Meta(min_length=1, extra=SECRET)]
    """Path of the PEM file with the private key (relative to this file; absolute once loaded). A
    configuration never contains the key itself."""
    raa: Annotated[int, Meta(ge=0, le=16383)]
    """Registered Assigning Authority of the aircraft's DRIP entity tag."""
    hda: Annotated[int, Meta(ge=0, le=16383)]
    """HHIT Domain Authority of the aircraft's DRIP entity tag."""
    links: Annotated[tuple[str, ...], Meta(max_length=5)] = ()
    """Endorsements by the registry, to be sent: first the aircraft's own, then those of the registry by its
    parents. Each is 272 hex digits, or the path (relative to this file) of a file that holds them."""
    period_s: Annotated[float, Meta(ge=0.5, le=3)] = 2.0
    """Time between two signatures on each transport. The standard allows 5 s at most, and other pages may
    delay a signature on BLE 4 by 1.5 s."""


class RemoteIdConfig(_Section, frozen=True):
    """Remote ID that the aircraft sends."""

    region: str | None = None
    """Path of a region profile (relative to this file), such as "regions/eu.toml". None: no legal
    requirements."""
    transports: Annotated[tuple[TransportName, ...], Meta(min_length=1, max_length=4)] = ("wifi",)
    """Transports that are used at the same time. Others that the region requires are added."""
    rate: Annotated[int, Meta(ge=1, le=10)] = 1
    """psi of the paper: Locations per second on each transport; never below the region's minimum."""
    self_id: Annotated[str, Meta(max_length=23)] | None = None
    """Free text about the flight."""
    operator_id: Annotated[str, Meta(min_length=1, max_length=24, extra=SECRET)] | None = None
    """Registration of the operator. EU: the full number with its three secret characters, which are never
    sent."""
    category_eu: Annotated[int, Meta(ge=0, le=3)] | None = None
    """EU category: 1 open, 2 specific, 3 certified."""
    class_eu: Annotated[int, Meta(ge=0, le=7)] | None = None
    """EU class: 1 to 7 for C0 to C6."""
    monitor_s: Annotated[float, Meta(ge=2, le=60)] = 5.0
    """If a receiver could hear our own frames, but hears none for this long, that is a failure."""
    yield_to_module: bool = True
    """Whether to leave the broadcast to a Remote ID module of the vehicle. False if the vehicle has none:
    then no forged report of one on an unsigned link silences the companion."""
    component: bool = False
    """Act as the vehicle's Remote ID component (236) on MAVLink: send its heartbeat and
    OPEN_DRONE_ID_ARM_STATUS."""
    signing: SigningConfig | None = None
    """None: nothing is signed."""


class AtmcConfig(_Section, frozen=True):
    """Choice of transports and rates in flight. Without a policy they stay as configured in [remote_id]."""

    policy: Annotated[str, Meta(min_length=1)] | None = None
    """Path of a policy file (relative to this file; absolute once loaded), name of a policy that comes with
    the software (`atmc`), "plugin:NAME" for that of a plug-in, or one of `CHOOSER_WORDS`."""
    agent: Annotated[int, Meta(ge=0, le=99)] | None = None
    """Which network of the policy flies, if it holds one for each aircraft of its training."""
    period_s: Annotated[float, Meta(ge=0.5, le=60)] = 2.0
    """Mean time between two decisions, which fall at random phases."""


class RecordConfig(_Section, frozen=True):
    """Recording of flights into run folders."""

    folder: str = "runs"
    """Folder of the run folders, the stored settings and the stored signing time, relative to
    $STATE_DIRECTORY, which systemd sets, or else to this file; absolute once loaded."""
    name: str = "companion"
    """End of the names of run folders: up to 100 printable characters without "/"."""
    sync_period_s: Annotated[float, Meta(ge=0.01, le=60)] = 1.0
    keep_free_mb: Annotated[float, Meta(ge=0, le=10_000_000)] = 200.0
    """With less free space than this (10^6 bytes) nothing is recorded; the flight continues."""
    delete_oldest: bool = False
    """Whether to delete the oldest finished runs in the folder before recording stops."""


class Waypoint(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One point of a timed path."""

    t_s: float
    lat_deg: Annotated[float, Meta(ge=-90, le=90)]
    lon_deg: Annotated[float, Meta(ge=-180, le=180)]
    alt_m: float


class TrajectoryFile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A timed path: straight legs between waypoints, times strictly rising."""

    altitude: Literal["home", "msl", "geodetic"]
    """Datum of every `alt_m`."""
    waypoint: Annotated[tuple[Waypoint, ...], Meta(min_length=2)]


class Config(_Section, frozen=True):
    """The whole configuration. `path`, `fence` and `region` hold the contents of the files that
    `flight.trajectory`, `limits.fence` and `remote_id.region` name; `load` reads them."""

    identity: IdentityConfig
    vehicle: VehicleConfig = VehicleConfig()
    flight: FlightConfig = FlightConfig()
    limits: LimitsConfig = LimitsConfig()
    avoidance: AvoidanceConfig = AvoidanceConfig()
    containment: ContainmentConfig = ContainmentConfig()
    traffic: TrafficConfig = TrafficConfig()
    sensed: SensedConfig = SensedConfig()
    remote_id: RemoteIdConfig = RemoteIdConfig()
    atmc: AtmcConfig = AtmcConfig()
    radio: tuple[RadioConfig, ...] = ()
    """Radios that are used together. Each transport is sent by the first radio that can send it."""
    record: RecordConfig = RecordConfig()
    path: TrajectoryFile | None = None
    fence: tuple[FenceArea, ...] = ()
    region: Region = Region()

    @property
    def has_radio(self) -> bool:
        """Whether any radio other than a NullRadio is configured."""
        return any(not isinstance(radio, NullRadio) for radio in self.radio)
