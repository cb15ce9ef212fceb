"""The sections of a configuration file and of the trajectory file that it names.

The unit stands in the key's name; unknown keys are refused.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from companion.events import FenceArea
from companion.remote_id.messages import IdType, UaType
from companion.remote_id.region import Region, TransportName
from companion.toml_reader import SECRET

Ratio = Annotated[float, Meta(ge=0, le=1)]
Interface = Annotated[str, Meta(min_length=1, max_length=15)]
"""Linux gives a network interface no longer name."""

CHOOSER_WORDS = ("rule", "fixed")
"""What `atmc.policy` may say instead of a path: the one-line rule; the best fixed legal set."""


class _Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Common to all sections."""


class VehicleConfig(_Section, frozen=True):
    """The link to the autopilot."""

    link: str = "udpin:127.0.0.1:14540"
    """udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD."""
    system_id: Annotated[int, Meta(ge=0, le=255)] = 0
    """Vehicle to fly with; 0 takes the only autopilot on the link, of two none."""
    component_id: Annotated[int, Meta(ge=1, le=255)] = 191
    wait_s: Annotated[float, Meta(gt=0, le=600)] = 10.0
    """How long to wait for the vehicle's first heartbeat."""
    stale_after_s: Annotated[float, Meta(ge=0.2, le=5)] = 1.0
    """Own position older than this ends authority (fault)."""
    signing_key: Annotated[str, Meta(min_length=1, extra=SECRET)] | None = None
    """Path of the key file of MAVLink 2 signing (relative to this file; absolute once loaded). The key itself
    never stands in a configuration."""


class IdentityConfig(_Section, frozen=True):
    """Who we are on the air."""

    uas_id: Annotated[str, Meta(min_length=1, max_length=40)]
    """UUID and session id: in a file hexadecimal digits, here the raw form of `BasicId.uas_id`."""
    id_type: IdType = IdType.SERIAL_NUMBER
    ua_type: UaType = UaType.HELICOPTER_OR_MULTIROTOR
    icao: Annotated[str, Meta(pattern="^[0-9A-Fa-f]{6}$")] | None = None
    """Address of the aircraft's own ADS-B transponder, six hexadecimal digits: not to be avoided."""
    registration_id: Annotated[str, Meta(min_length=1, max_length=20)] | None = None
    """Number that the state gave the aircraft; sent as a second Basic ID (Japan asks for both)."""

    @property
    def name(self) -> str:
        """`uas_id` as people and files can take it: hexadecimal where it is raw bytes."""
        return self.uas_id if self.uas_id.isprintable() else self.uas_id.encode("latin-1").hex()

    @property
    def file_name(self) -> str:
        """`name` as a file can take it."""
        return "".join(c if c.isalnum() or c in "-_" else "_" for c in self.name)


class FlightConfig(_Section, frozen=True):
    """What to fly and who may fly it."""

    use: Literal["watch", "guard", "fly"] = "watch"
    """watch: broadcast, listen and log, never command. guard: the autopilot flies its mission and is taken
    for a conflict alone. fly: command the timed trajectory."""
    trajectory: str | None = None
    """Path of a trajectory file (relative to this file), or "mission" for the vehicle's own mission."""
    mission_speed_mps: Annotated[float, Meta(gt=0, le=100)] | None = None
    """Speed on the vehicle's mission; needed with trajectory = "mission"."""
    start: Literal["engage", "utc"] = "engage"
    """engage: the path's clock starts when the companion takes the vehicle. utc: at start_utc_s."""
    start_utc_s: float | None = None
    rearm: Literal["mode", "disarm", "never"] = "disarm"
    """How authority returns after the pilot took it: when the pilot selects GUIDED/OFFBOARD (guard:
    AUTO/MISSION), when the vehicle has been disarmed, or only by a restart."""
    take_in_flight: bool = False
    """May take a vehicle that was flying already when the companion started. Without it a companion that
    restarts in flight waits for the next landing."""
    start_within_m: Annotated[float, Meta(gt=0, le=10000)] = 100.0
    """The vehicle is taken only this near to the path's point for the moment."""
    setpoint_rate_hz: Annotated[float, Meta(ge=5, le=50)] = 20.0
    yaw: Literal["face", "hold"] = "face"
    """face: the nose turns to where the aircraft flies. hold: it stays where it is."""


class LimitsConfig(_Section, frozen=True):
    """What no command ever exceeds."""

    max_speed_mps: Annotated[float, Meta(gt=0, le=50)] = 5.0
    """Total speed."""
    max_climb_mps: Annotated[float, Meta(gt=0, le=20)] = 2.0
    max_descent_mps: Annotated[float, Meta(gt=0, le=20)] = 2.0
    max_acceleration_mps2: Annotated[float, Meta(gt=0, le=20)] = 1.0
    """How fast the commanded velocity may change."""
    floor_height_m: float | None = None
    """Height above home. None: the lower of 15 m and the path's lowest point."""
    ceiling_height_m: float | None = None
    fence: str | None = None
    """Path of a fence file (relative to this file), or "vehicle" for the vehicle's own geofence."""


class AvoidanceConfig(_Section, frozen=True):
    """The law. Defaults: the reference flight tests; "paper": the published law to the letter."""

    law: Literal["dmuca", "paper", "none"] = "dmuca"
    conflict_radius_m: Annotated[float, Meta(gt=0, le=1000)] = 5.0
    """Each aircraft's; two of them are the separation that must hold."""
    crewed_horizontal_m: Annotated[float, Meta(gt=0, le=5000)] = 150.0
    """Kept from crewed traffic to the side, or `crewed_vertical_m` in height."""
    crewed_vertical_m: Annotated[float, Meta(gt=0, le=1000)] = 50.0
    horizon_s: Annotated[float, Meta(gt=0, le=120)] = 20.0
    period_s: Annotated[float, Meta(ge=0.02, le=1)] = 0.2
    recovery_time_s: Annotated[float, Meta(gt=0, le=120)] = 10.0
    """T: time to close the gap to the path's point."""
    n_noncollide: Annotated[int, Meta(ge=1, le=1000)] = 15
    """Cycles without a conflict before an avoidance is over; in the paper's law, before recovery."""
    regained_m: Annotated[float, Meta(gt=0, le=1000)] = 5.0
    """Closer to the timed point than this counts as back on the path."""


class TrafficConfig(_Section, frozen=True):
    """Tracks of other aircraft."""

    max_tracks: Annotated[int, Meta(ge=1, le=10000)] = 200
    expire_after_s: Annotated[float, Meta(gt=0, le=120)] = 15.0
    max_clock_offset_s: Annotated[float, Meta(ge=0, le=60)] = 5.0
    max_speed_mps: Annotated[float, Meta(gt=0, le=400)] = 120.0
    """A message that claims or implies more is not believed."""
    keys: dict[str, str] = {}
    """Identity -> Ed25519 public key that its signatures are checked with: 64 hex digits, or the path
    (relative to this file) of a PEM file."""


class RemoteIdConfig(_Section, frozen=True):
    """What goes on the air."""

    region: str | None = None
    """Path of a region profile (relative to this file), such as "regions/eu.toml". None: no law is kept."""
    transports: Annotated[tuple[TransportName, ...], Meta(min_length=1, max_length=4)] = ("wifi",)
    """Sent on together. What the region asks beyond them is added."""
    rate: Annotated[int, Meta(ge=1, le=10)] = 1
    """psi: Locations a second on each; never below the region's floor."""
    self_id: Annotated[str, Meta(max_length=23)] | None = None
    """Free text about the flight."""
    operator_id: Annotated[str, Meta(min_length=1, max_length=24, extra=SECRET)] | None = None
    """Registration of the operator. EU: whole, with the three secret characters, which are never sent."""
    category_eu: Annotated[int, Meta(ge=0, le=3)] | None = None
    """1 open, 2 specific, 3 certified."""
    class_eu: Annotated[int, Meta(ge=0, le=7)] | None = None
    """1 to 7 for C0 to C6."""
    monitor_s: Annotated[float, Meta(ge=2, le=60)] = 5.0
    """Own frames not heard back for this long, where something could hear them, are a failure."""
    component: bool = False
    """Be the vehicle's Remote ID component (236) on MAVLink: heartbeat and OPEN_DRONE_ID_ARM_STATUS."""


class AtmcConfig(_Section, frozen=True):
    """Who chooses the transports and rates in flight. Nobody: they stay as [remote_id] says."""

    policy: Annotated[str, Meta(min_length=1)] | None = None
    """Path of a policy file (relative to this file; absolute once loaded), or one of `CHOOSER_WORDS`."""
    period_s: Annotated[float, Meta(ge=0.5, le=60)] = 2.0
    """Mean time from one decision to the next; they fall at random phases."""


class NullRadio(_Section, frozen=True, tag_field="backend", tag="null"):
    """No radio."""


class EtherRadio(_Section, frozen=True, tag_field="backend", tag="ether"):
    """The simulated air."""

    address: str
    """HOST:PORT."""


class HciRadio(_Section, frozen=True, tag_field="backend", tag="hci"):
    """A Bluetooth controller that no other software uses."""

    channel: str
    """user:NUMBER (Linux hciN), uart:DEVICE:BAUD or tcp:HOST:PORT."""
    send: bool = True
    listen: bool = True


class WifiRadio(_Section, frozen=True, tag_field="backend", tag="wifi"):
    """A Wi-Fi card."""

    hostapd: str | None = None
    """Control socket of a running hostapd, such as /var/run/hostapd/wlan0: sends beacons through it."""
    inject: Interface | None = None
    """Monitor interface to inject beacons and NAN frames on."""
    monitor: Interface | None = None
    """Monitor interface to listen on."""
    channel: Annotated[int, Meta(ge=1, le=177)] = 6
    """What the card is tuned to; where hostapd tells, its word counts."""


class ArduRemoteIdRadio(_Section, frozen=True, tag_field="backend", tag="arduremoteid"):
    """A module with ArduRemoteID firmware on a MAVLink link of its own."""

    link: str
    """As vehicle.link, such as serial:/dev/ttyACM0:57600."""
    system_id: Annotated[int, Meta(ge=1, le=255)] = 1
    """The vehicle's: the module adopts the one it hears first."""


RadioConfig = NullRadio | EtherRadio | HciRadio | WifiRadio | ArduRemoteIdRadio


class RecordConfig(_Section, frozen=True):
    """The run folder."""

    folder: str = "runs"
    name: str = "companion"
    sync_period_s: Annotated[float, Meta(gt=0, le=60)] = 1.0
    keep_free_mb: Annotated[float, Meta(ge=0, le=10_000_000)] = 200.0
    """Below this much free space (10^6 bytes) nothing is recorded; the flight goes on."""
    delete_oldest: bool = False
    """Delete the oldest finished runs in the folder before that."""


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
    """Everything. `path`, `fence` and `region` are the files themselves, taken by `load` from where they are
    named."""

    identity: IdentityConfig
    vehicle: VehicleConfig = VehicleConfig()
    flight: FlightConfig = FlightConfig()
    limits: LimitsConfig = LimitsConfig()
    avoidance: AvoidanceConfig = AvoidanceConfig()
    traffic: TrafficConfig = TrafficConfig()
    remote_id: RemoteIdConfig = RemoteIdConfig()
    atmc: AtmcConfig = AtmcConfig()
    radio: tuple[RadioConfig, ...] = ()
    """Used together: each transport is sent by the first that can."""
    record: RecordConfig = RecordConfig()
    path: TrajectoryFile | None = None
    fence: tuple[FenceArea, ...] = ()
    region: Region = Region()

    @property
    def has_radio(self) -> bool:
        """Whether any radio is configured that can hear or send."""
        return any(not isinstance(radio, NullRadio) for radio in self.radio)
