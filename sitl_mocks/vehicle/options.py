"""Options of a mock vehicle: firmware, home, start, limits, navigation errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from companion.errors import ConfigError
from companion.events import FenceArea, Firmware, MissionItem
from companion.geofence import check_areas
from companion.geometry import LocalFrame, Vec3
from sitl_mocks.vehicle.firmware.behaviour import MANNERS, Manners, VehicleMode, with_quirks
from sitl_mocks.vehicle.firmware.response import Response
from sitl_mocks.vehicle.sensing import Obstacle, SensorOptions
from sitl_mocks.vehicle.traffic import CrewedFlight

HOME: Final = LocalFrame(47.397, 8.545, 400.0)
"""Home of every simulated vehicle that is not given another one."""

_PLAIN_ACCELERATION_MPS2 = 2.5
_PLAIN_VERTICAL_MPS2 = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleOptions:
    """Everything that is set before the vehicle exists.

    NED is relative to home. A limit of None takes the firmware's value.

    Raises ConfigError for values outside their range.
    """

    firmware: Firmware = Firmware.ARDUPILOT
    system_id: int = 1

    home_lat_deg: float = HOME.lat_deg
    home_lon_deg: float = HOME.lon_deg
    home_alt_msl_m: float = HOME.alt_m
    geoid_separation_m: float = 47.0
    """Height of mean sea level above the ellipsoid: alt_ellipsoid = alt_msl + geoid_separation_m."""

    signing_key: bytes | None = None
    """MAVLink signing key. The vehicle signs every frame and rejects wrongly signed or unsigned frames on
    every link (the real ArduPilot trusts its USB port)."""

    airborne: bool = False
    """True starts armed in the air. False starts disarmed on the ground, at the north and east of
    `start_position_ned_m`."""
    start_position_ned_m: Vec3 = (0.0, 0.0, 0.0)
    start_velocity_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    start_yaw_rad: float = 0.0
    start_mode: VehicleMode | None = None
    """None starts in HOLD in the air and in the firmware's boot mode on the ground. In an airborne start in
    EXTERNAL, the start velocity counts as the first setpoint."""
    mission: tuple[MissionItem, ...] = ()
    """Mission stored from the start, without ArduPilot's home item."""
    fence: tuple[FenceArea, ...] = ()
    """Fence stored from the start. ArduPilot obeys it if FENCE_ENABLE is set, PX4 according to GF_ACTION."""
    traffic: tuple[CrewedFlight, ...] = ()
    """Crewed aircraft that the vehicle's ADS-B receiver hears."""

    sensor: SensorOptions | None = None
    """A sensor aboard that sees obstacles and other aircraft; None: there is none."""
    obstacles: tuple[Obstacle, ...] = ()
    """Obstacles and aircraft that transmit nothing, for `sensor`. Vehicles fly through them, because
    collisions are not simulated.
    """

    boot_time_offset_s: float = 120.0
    """Reading of the vehicle's own clock at now_s = 0."""
    utc_at_zero_s: float | None = None
    """Unix time at now_s = 0. None: the vehicle does not know the time."""
    arming_ready_s: float = 0.0
    """Time after boot during which arming is refused, because the estimator waits for GNSS (30-45 s on a cold
    ArduPilot)."""
    rc_connected: bool = True
    """Whether there is a pilot's radio, with centred sticks. Without one, ArduPilot's LOITER descends
    (throttle low)."""
    legacy_parameter_names: bool = False
    parameters: Mapping[str, float] = field(default_factory=dict)
    """Parameter values that replace the firmware's defaults, by current parameter name."""
    quirks: Mapping[str, object] = field(default_factory=dict)
    """Changes to the firmware behaviour, by field name of `sitl_mocks.vehicle.firmware.kinds.Manners`."""
    did_enable: bool = False
    """ArduPilot's DID_ENABLE. On all links, the vehicle sends its own Remote ID location and forwards the
    Remote ID data that it received (the real ArduPilot: on the port of DID_MAVPORT)."""
    did_require: bool = False
    """DID_OPTIONS = 1: arming, also forced arming, is refused without a transmitter, an identity and an
    operator location."""

    max_horizontal_speed_mps: float | None = None
    max_climb_mps: float | None = None
    max_descent_mps: float | None = None
    max_acceleration_mps2: float | None = None
    """Horizontal acceleration."""
    max_vertical_acceleration_mps2: float | None = None
    velocity_lag_s: float | None = None
    """Lag of a plain response that replaces the firmware's own. The vehicle follows its setpoints with a ramp
    (2.5 m/s^2 unless `max_acceleration_mps2` is given; vertically at most 4 m/s^2) and this lag."""
    mission_speed_mps: float | None = None
    wind_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    max_airspeed_mps: float = 18.0
    """Airspeed up to which the controller holds the ground velocity against the wind."""

    gnss_horizontal_sigma_m: float = 0.0
    """Standard deviation per axis."""
    gnss_vertical_sigma_m: float = 0.0
    gnss_velocity_sigma_mps: float = 0.0
    """Standard deviation per axis."""
    gnss_correlation_s: float = 30.0
    gnss_velocity_correlation_s: float = 1.0

    def __post_init__(self) -> None:
        """Check all values."""
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
                raise ConfigError(f"parameter {name}: the simulated vehicle has no such parameter")
            if not math.isfinite(value):
                raise ConfigError(f"parameter {name} is {value}; allowed: finite numbers")
        if self.did_enable and not MANNERS[self.firmware].has_did_params:
            raise ConfigError(f"did_enable is allowed only for ardupilot, not for {self.firmware.value}")
        wired = self.sensor is not None and self.sensor.message == "proximity"
        if wired and self.firmware is not Firmware.ARDUPILOT:
            raise ConfigError(
                f"sensor.message: proximity is allowed only for ardupilot, not for {self.firmware.value}"
            )
        if self.did_require and not self.did_enable:
            raise ConfigError("did_require is allowed only with did_enable")
        modes = MANNERS[self.firmware].custom_modes
        if self.start_mode is not None and self.start_mode not in modes:
            allowed = ", ".join(sorted(mode.value for mode in modes))
            raise ConfigError(
                f"start_mode {self.start_mode.value} does not exist on {self.firmware.value}; "
                f"allowed: {allowed}"
            )
        if self.airborne and self.start_position_ned_m[2] >= 0.0:
            raise ConfigError(
                "start_position_ned_m of an airborne start must lie above the ground (down < 0)"
            )

    @property
    def manners(self) -> Manners:
        """Behaviour of the firmware, with the quirks applied."""
        return with_quirks(MANNERS[self.firmware], self.quirks)

    @property
    def response(self) -> Response:
        """Parameters of how the vehicle follows a commanded velocity."""
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
