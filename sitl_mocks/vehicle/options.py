"""What a mock vehicle is made of: firmware, home, start, limits, navigation errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from companion.errors import ConfigError
from companion.events import FenceArea, Firmware, MissionItem
from companion.geofence import check_areas
from companion.geometry import Vec3
from sitl_mocks.vehicle.dynamics import Response
from sitl_mocks.vehicle.firmware.behaviour import MANNERS, Manners, VehicleMode, with_quirks
from sitl_mocks.vehicle.traffic import CrewedFlight

_PLAIN_ACCELERATION_MPS2 = 2.5
_PLAIN_VERTICAL_MPS2 = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleOptions:
    """Everything that is set before the vehicle exists. NED is relative to home; None: the firmware's value.

    Raises ConfigError for values outside their range.
    """

    firmware: Firmware = Firmware.ARDUPILOT
    system_id: int = 1

    home_lat_deg: float = 47.397
    home_lon_deg: float = 8.545
    home_alt_msl_m: float = 400.0
    geoid_separation_m: float = 47.0
    """Height of mean sea level over the ellipsoid: alt_ellipsoid = alt_msl + this."""

    signing_key: bytes | None = None
    """Signs all it sends, believes nothing else on any link (the real ArduPilot trusts its USB port)."""

    airborne: bool = False
    """Start in the air, armed; else on the ground at `start_position_ned_m`'s north and east, disarmed."""
    start_position_ned_m: Vec3 = (0.0, 0.0, 0.0)
    start_velocity_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    start_yaw_rad: float = 0.0
    start_mode: VehicleMode | None = None
    """None: HOLD in the air, the firmware's boot mode on the ground. A start in EXTERNAL counts the start
    velocity as the first setpoint."""
    mission: tuple[MissionItem, ...] = ()
    """Held from the start, without ArduPilot's home item."""
    fence: tuple[FenceArea, ...] = ()
    """Held from the start. ArduPilot obeys it with FENCE_ENABLE, PX4 as GF_ACTION says."""
    traffic: tuple[CrewedFlight, ...] = ()
    """What its ADS-B receiver hears."""

    boot_time_offset_s: float = 120.0
    """The vehicle's own clock at now_s = 0."""
    utc_at_zero_s: float | None = None
    """Unix time at now_s = 0; None: the vehicle does not know the time."""
    arming_ready_s: float = 0.0
    """How long after boot arming is refused (the estimator waits for GNSS; 30-45 s on a cold ArduPilot)."""
    rc_connected: bool = True
    """A pilot's radio with centred sticks. Without one, ArduPilot's LOITER descends (throttle low)."""
    legacy_parameter_names: bool = False
    parameters: Mapping[str, float] = field(default_factory=dict)
    """Values that replace the firmware's own, by today's names."""
    quirks: Mapping[str, object] = field(default_factory=dict)
    """Manners that replace the firmware's own, by the names of `vehicle_manners.Manners`."""
    did_enable: bool = False
    """ArduPilot's DID_ENABLE: sends its own Remote ID, and what it was told, on all links (the real one: on
    the port of DID_MAVPORT)."""
    did_require: bool = False
    """DID_OPTIONS = 1: refuses to arm, also by force, without a transmitter, identity and operator."""

    max_horizontal_speed_mps: float | None = None
    max_climb_mps: float | None = None
    max_descent_mps: float | None = None
    max_acceleration_mps2: float | None = None
    """Horizontal."""
    max_vertical_acceleration_mps2: float | None = None
    velocity_lag_s: float | None = None
    """Given, the vehicle follows its setpoints with a plain ramp (2.5 m/s^2 where none is given) and this
    lag, vertically within 4 m/s^2, and nothing else of the firmware's own response."""
    mission_speed_mps: float | None = None
    wind_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    max_airspeed_mps: float = 18.0
    """The controller holds ground velocity against the wind, up to this airspeed."""

    gnss_horizontal_sigma_m: float = 0.0
    """Per axis."""
    gnss_vertical_sigma_m: float = 0.0
    gnss_velocity_sigma_mps: float = 0.0
    """Per axis."""
    gnss_correlation_s: float = 30.0
    gnss_velocity_correlation_s: float = 1.0

    def __post_init__(self) -> None:
        """Refuse what the vehicle could not fly honestly."""
        self._check_range("system_id", self.system_id, 1, 255)
        self._check_range("home_lat_deg", self.home_lat_deg, -89.0, 89.0)
        self._check_range("home_lon_deg", self.home_lon_deg, -180.0, 180.0)
        for name in ("max_airspeed_mps", "gnss_correlation_s", "gnss_velocity_correlation_s"):
            self._check_range(name, getattr(self, name), 1e-3, 1e4)
        for name in ("max_horizontal_speed_mps", "max_climb_mps", "max_descent_mps", "mission_speed_mps",
                     "max_acceleration_mps2", "max_vertical_acceleration_mps2",
                     "velocity_lag_s"):  # fmt: skip
            if getattr(self, name) is not None:
                self._check_range(name, getattr(self, name), 1e-3, 1e3)
        for name in ("gnss_horizontal_sigma_m", "gnss_vertical_sigma_m", "gnss_velocity_sigma_mps"):
            self._check_range(name, getattr(self, name), 0.0, 1e3)
        self._check_range("boot_time_offset_s", self.boot_time_offset_s, 0.0, 4e6)
        for name in ("start_position_ned_m", "start_velocity_ned_mps", "wind_ned_mps"):
            if not all(math.isfinite(value) for value in getattr(self, name)):
                raise ConfigError(f"{name} holds a value that is not a finite number")
        try:
            check_areas(self.fence)
        except ConfigError as error:
            raise ConfigError(f"fence: {error}") from error
        manners = self.manners
        for name, value in self.parameters.items():
            if name not in manners.params:
                raise ConfigError(f"parameter {name}: the mock has none of that name")
            if not math.isfinite(value):
                raise ConfigError(f"parameter {name} is {value}; allowed are finite numbers")
        if self.did_enable and not MANNERS[self.firmware].has_did_params:
            raise ConfigError(f"did_enable is no option of {self.firmware.value}; it is ArduPilot's")
        if self.did_require and not self.did_enable:
            raise ConfigError("did_require needs did_enable")
        modes = MANNERS[self.firmware].custom_modes
        if self.start_mode is not None and self.start_mode not in modes:
            allowed = ", ".join(sorted(mode.value for mode in modes))
            raise ConfigError(
                f"start_mode {self.start_mode.value} is none of {self.firmware.value}'s: {allowed}"
            )
        if self.airborne and self.start_position_ned_m[2] >= 0.0:
            raise ConfigError(
                "start_position_ned_m of an airborne start must lie above the ground (down < 0)"
            )

    @property
    def manners(self) -> Manners:
        """The firmware's ways, with the quirks."""
        return with_quirks(MANNERS[self.firmware], self.quirks)

    @property
    def response(self) -> Response:
        """How the vehicle follows a velocity."""
        manners = self.manners
        vertical = self.max_vertical_acceleration_mps2 or manners.max_vertical_acceleration_mps2
        if self.velocity_lag_s is not None:
            vertical = min(vertical, _PLAIN_VERTICAL_MPS2)
            ramp = self.max_acceleration_mps2 or _PLAIN_ACCELERATION_MPS2
            return Response(
                acceleration_mps2=ramp,
                vertical_acceleration_mps2=vertical,
                lag_s=self.velocity_lag_s,
                vertical_lag_s=self.velocity_lag_s,
                auto_acceleration_mps2=ramp,
                auto_brake_mps2=ramp,
            )
        return Response(
            acceleration_mps2=self.max_acceleration_mps2 or manners.acceleration_mps2,
            vertical_acceleration_mps2=vertical,
            lag_s=manners.velocity_lag_s,
            vertical_lag_s=manners.vertical_lag_s,
            auto_acceleration_mps2=self.max_acceleration_mps2 or manners.auto_acceleration_mps2,
            auto_brake_mps2=self.max_acceleration_mps2 or manners.auto_brake_mps2,
            auto_jerk_mps3=manners.auto_jerk_mps3,
            gain=manners.velocity_gain,
            slow_share=manners.slow_share,
            slow_s=manners.slow_s,
            brake_fades_mps=manners.brake_fades_mps,
            brake_faded_mps2=manners.brake_faded_mps2,
        )

    def _check_range(self, name: str, value: float, low: float, high: float) -> None:
        if not low <= value <= high:
            raise ConfigError(f"{name} is {value}; allowed: {low} to {high}")
