"""One TOML file configures one companion; every key is checked before flight.

Each section is a struct; the unit stands in the key's name; unknown keys are refused. `load` resolves what
the file points to (the trajectory), so that a resolved configuration stands alone in a run folder.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from companion.remote_id.messages import IdType, UaType

Ratio = Annotated[float, Meta(ge=0, le=1)]


class _Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Common to all sections."""


class VehicleConfig(_Section, frozen=True):
    """The link to the autopilot."""

    link: str = "udpin:127.0.0.1:14540"
    """udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD."""
    system_id: Annotated[int, Meta(ge=0, le=255)] = 0
    """Vehicle to fly with; 0 takes the first autopilot heard."""
    component_id: Annotated[int, Meta(ge=1, le=255)] = 191
    wait_s: Annotated[float, Meta(gt=0, le=600)] = 10.0
    """How long to wait for the vehicle's first heartbeat."""
    stale_after_s: Annotated[float, Meta(ge=0.2, le=5)] = 1.0
    """Own position older than this ends authority (fault)."""


class IdentityConfig(_Section, frozen=True):
    """Who we are on the air."""

    uas_id: Annotated[str, Meta(min_length=1, max_length=20)]
    id_type: IdType = IdType.SERIAL_NUMBER
    ua_type: UaType = UaType.HELICOPTER_OR_MULTIROTOR


class FlightConfig(_Section, frozen=True):
    """What to fly and who may fly it."""

    use: Literal["watch", "fly"] = "watch"
    """watch: broadcast, listen and log, never command. fly: command the timed trajectory."""
    trajectory: str | None = None
    """Path of a trajectory file (relative to this file), or "mission" for the vehicle's own mission."""
    mission_speed_mps: Annotated[float, Meta(gt=0, le=100)] | None = None
    """Speed on the vehicle's mission; needed with trajectory = "mission"."""
    start: Literal["engage", "utc"] = "engage"
    """engage: the path's clock starts when the companion takes the vehicle. utc: at start_utc_s."""
    start_utc_s: float | None = None
    rearm: Literal["mode", "disarm", "never"] = "disarm"
    """How authority returns after the pilot took it: when the pilot selects GUIDED/OFFBOARD, when the vehicle
    has been disarmed, or only by a restart."""
    setpoint_rate_hz: Annotated[float, Meta(ge=5, le=50)] = 20.0


class LimitsConfig(_Section, frozen=True):
    """What no command ever exceeds."""

    max_speed_mps: Annotated[float, Meta(gt=0, le=50)] = 5.0
    """Total speed."""
    max_climb_mps: Annotated[float, Meta(gt=0, le=20)] = 2.0
    max_descent_mps: Annotated[float, Meta(gt=0, le=20)] = 2.0
    max_acceleration_mps2: Annotated[float, Meta(gt=0, le=20)] = 1.0
    """How fast the commanded velocity may change."""
    floor_height_m: float | None = None
    """Height above home."""
    ceiling_height_m: float | None = None


class AvoidanceConfig(_Section, frozen=True):
    """The law. Defaults: the reference flight tests; "paper": the published law to the letter."""

    law: Literal["dmuca", "paper", "none"] = "dmuca"
    conflict_radius_m: Annotated[float, Meta(gt=0, le=1000)] = 5.0
    """Each aircraft's; two of them are the separation that must hold."""
    horizon_s: Annotated[float, Meta(gt=0, le=120)] = 20.0
    period_s: Annotated[float, Meta(ge=0.02, le=5)] = 0.2
    recovery_time_s: Annotated[float, Meta(gt=0, le=120)] = 10.0
    """T: time to close the gap to the path's point."""
    n_noncollide: Annotated[int, Meta(ge=1, le=1000)] = 15
    """Paper's law only: cycles without a conflict before recovery."""
    regained_m: Annotated[float, Meta(gt=0, le=1000)] = 5.0
    """Closer to the timed point than this counts as back on the path."""


class TrafficConfig(_Section, frozen=True):
    """Tracks of other aircraft."""

    max_tracks: Annotated[int, Meta(ge=1, le=10000)] = 200
    expire_after_s: Annotated[float, Meta(gt=0, le=120)] = 15.0
    max_clock_offset_s: Annotated[float, Meta(ge=0, le=60)] = 5.0
    max_speed_mps: Annotated[float, Meta(gt=0, le=400)] = 120.0
    """A message that claims or implies more is not believed."""


class RemoteIdConfig(_Section, frozen=True):
    """What goes on the air."""

    transport: Literal["ble4", "ble5", "wifi"] = "wifi"
    rate: Annotated[int, Meta(ge=1, le=10)] = 1
    """psi: messages per GNSS cycle of 1 s."""


class RadioConfig(_Section, frozen=True):
    """The radio."""

    backend: Literal["null", "ether"] = "null"
    address: str | None = None
    """ether: HOST:PORT of the simulated air."""


class RecordConfig(_Section, frozen=True):
    """The run folder."""

    folder: str = "runs"
    name: str = "companion"
    sync_period_s: Annotated[float, Meta(gt=0, le=60)] = 1.0


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
    """Everything. `path` holds the resolved trajectory; it is filled by `load`, not typed by a user."""

    identity: IdentityConfig
    vehicle: VehicleConfig = VehicleConfig()
    flight: FlightConfig = FlightConfig()
    limits: LimitsConfig = LimitsConfig()
    avoidance: AvoidanceConfig = AvoidanceConfig()
    traffic: TrafficConfig = TrafficConfig()
    remote_id: RemoteIdConfig = RemoteIdConfig()
    radio: RadioConfig = RadioConfig()
    record: RecordConfig = RecordConfig()
    path: TrajectoryFile | None = None
