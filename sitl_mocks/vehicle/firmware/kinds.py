"""Types that describe a firmware's behaviour. `sitl_mocks.vehicle.firmware.behaviour` has the values."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, get_type_hints

from companion.errors import ConfigError
from companion.events import Firmware
from sitl_mocks.vehicle.firmware.param_tables import ParamTable


class VehicleMode(enum.Enum):
    """Flight modes of the mock vehicle. Each firmware has its own numbers for them."""

    MANUAL = "manual"
    """The pilot's mode: ArduPilot STABILIZE, PX4 POSCTL. The mock's pilot keeps the sticks centred."""
    EXTERNAL = "external"
    """Mode that flies setpoints: ArduPilot GUIDED, PX4 OFFBOARD."""
    MISSION = "mission"
    HOLD = "hold"
    """ArduPilot LOITER, PX4 AUTO.LOITER."""
    BRAKE = "brake"
    """ArduPilot only."""
    TAKEOFF = "takeoff"
    """PX4 only; ArduPilot takes off in GUIDED."""
    RTL = "rtl"
    LAND = "land"


@dataclass(frozen=True, slots=True, eq=False)
class Failsafe:
    """Reaction of a firmware to one trouble."""

    param: str | None
    """Parameter that selects the action. None: the action cannot be chosen and is always 0."""
    modes: Mapping[int, VehicleMode]
    """Mode by action.

    Actions that are missing here do nothing, or need a mode that the mock does not have.
    """
    text: str | None
    deferred: bool
    """PX4 first holds for COM_FAIL_ACT_T, so that a pilot can select another mode."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Manners:
    """Behaviour of one firmware. Speeds are in m/s, accelerations in m/s^2, times in s."""

    firmware: Firmware
    autopilot_id: int
    """MAV_AUTOPILOT."""
    custom_modes: Mapping[VehicleMode, int]
    base_modes: Mapping[VehicleMode, int]
    """base_mode of the heartbeat, without the armed bit."""
    vtol_state: int
    gps_fix_type: int
    boot_mode: VehicleMode
    # telemetry
    fresh_streams: Mapping[int, float]
    """Message id -> interval of the streams on a new link, before any request."""
    data_streams: bool
    """Whether the vehicle obeys REQUEST_DATA_STREAM."""
    forwards: bool
    """Whether the vehicle forwards frames from one link to the others."""
    has_did_params: bool
    """Whether the vehicle can relay Remote ID data (ArduPilot's DID_* parameters)."""
    heartbeat_on_mode_change: bool
    tells_current_mode: bool
    """Whether the vehicle sends CURRENT_MODE."""
    standard_modes: Mapping[VehicleMode, int]
    """MAV_STANDARD_MODE by mode; 0 for modes that are missing here."""
    refuses_interval_param3: bool
    unsupported_interval_result: int
    unsupported_request_result: int
    no_such_message_text: bool
    speaks: bool
    """Whether the vehicle sends STATUSTEXT. PX4 uses events instead."""
    target_always_told: bool
    """True sends POSITION_TARGET_LOCAL_NED in every mode, False only in the mode that flies setpoints."""
    # modes and arming
    mode_ack_first: bool
    """Whether a mode command is first acknowledged with result 0, and then with the actual result."""
    set_mode_acked: bool
    """Whether the old SET_MODE message is answered with COMMAND_ACK."""
    arms_in: frozenset[VehicleMode]
    failure_result: int
    """Result in the ACK of a refused arming, take-off or mode change."""
    land_detect_s: float
    """Time from touch-down until the vehicle reports that it has landed."""
    landed_disarm_s: float
    """Time from touch-down until the vehicle disarms, in a mode that lands."""
    disarm_rewinds_mission: bool
    disarm_after_landing_s: float | None
    """Time until the vehicle disarms after a touch-down in a mode that does not land.

    None: it stays armed.
    """
    disarm_preflight_s: float | None
    # take-off
    takeoff_in_external: bool
    takeoff_altitude_is_amsl: bool
    takeoff_param: str | None
    """Parameter with the height (m) of a take-off whose command gives none.

    None: such a command is refused.
    """
    spin_up_s: float
    takeoff_speed_mps: float
    slow_takeoff_m: float
    """Height over home (m) up to which climbs use takeoff_speed_mps. Above it they use max_climb_mps."""
    # setpoints
    setpoint_frames: frozenset[int]
    body_frames: frozenset[int]
    bad_frame_stops: bool
    """True: a setpoint in an unknown frame stops the vehicle. False: it is ignored."""
    external_needs_stream: bool
    loss_noticed_s: float
    """Extra delay of the reaction to setpoint loss, beyond the timeout parameter."""
    loss_mode: VehicleMode | None
    """Mode after setpoint loss when `loss_actions` gives none, for example without a pilot's radio. None: the
    vehicle brakes and stays in its mode."""
    loss_actions: Mapping[int, VehicleMode]
    """Mode after setpoint loss by the value of COM_OBL_RC_ACT. MANUAL needs the pilot's radio. Values that
    are missing here lead to `loss_mode`."""
    stream_takes_back: bool
    """Whether setpoints that resume after their loss are flown again without a mode command."""
    cancels_takeoff: bool
    """Whether a setpoint after lift-off ends a take-off that is flown in the setpoint mode."""
    needs_whole_velocity: bool
    """True: one ignored axis invalidates the whole velocity, and the vehicle stops. False: that axis counts
    as zero."""
    altitude_with_horizontal_velocity: bool
    nose_follows_velocity: bool
    # flight
    max_horizontal_speed_mps: float
    max_climb_mps: float
    max_descent_mps: float
    max_vertical_acceleration_mps2: float
    height_acceleration_mps2: float
    """Vertical deceleration with which the vehicle stops at a height."""
    acceleration_mps2: float
    """Horizontal acceleration limit when flying setpoints."""
    auto_acceleration_mps2: float
    auto_brake_mps2: float
    auto_jerk_mps3: float
    velocity_lag_s: float
    vertical_lag_s: float
    velocity_gain: float
    """Velocity reached divided by velocity commanded."""
    slow_share: float
    """Share of the horizontal velocity that builds up and decays with time constant slow_s."""
    slow_s: float
    brake_fades_mps: float
    """Speed above which braking becomes weaker. From 3 m/s above it only brake_faded_mps2 is left."""
    brake_faded_mps2: float
    mission_speed_mps: float
    acceptance_radius_m: float
    rtl_height_m: float
    land_speed_mps: float
    # mission
    mission_request_int: bool
    home_is_item_zero: bool
    mission_end_mode: VehicleMode | None
    upload_timeout_s: float
    upload_retry_s: float
    mission_texts: bool
    marks_current_item: bool
    """Whether a downloaded mission marks the item being flown as current."""
    flies_to_takeoff_item: bool
    """True: a take-off item begun above its height is a point to fly to. False: it counts as done."""
    speed_change_stays: bool
    """Whether the speed of a mission's DO_CHANGE_SPEED still holds when the mission mode is entered again."""
    paused_state: int
    """MISSION_STATE of a mission that was interrupted."""
    one_transfer: bool
    """True: sends one list at a time to one partner, items in order. False: answers every request."""
    fence_frames: Mapping[int, int]
    """MAV_FRAME of an uploaded fence item -> frame in which it is sent back. Other frames are refused."""
    fence_altitudes: bool
    """Whether the altitudes of fence items are stored."""
    fence_union: bool
    """True: the vehicle must be inside at least one inclusion area. False: it must be inside all of them."""
    adsb_listed: bool
    """True: streams a list of the aircraft heard, one per interval.

    False: forwards each ADS-B report once.
    """
    # troubles
    estimator_message: int
    """Id of the estimator's message: EKF_STATUS_REPORT or ESTIMATOR_STATUS."""
    tells_fence: bool
    """Whether the vehicle sends FENCE_STATUS."""
    fence_enable_param: str | None
    fence_distance_param: str
    fence_height_param: str
    """Parameter with the largest height; fence_distance_param has the largest distance (m; 0: no limit)."""
    fence_failsafe: Failsafe
    gcs_failsafe: Failsafe
    gcs_timeout_param: str
    gcs_by_system: bool
    """True: the ground station is the system with the id MAV_GCS_SYSID.

    False: it is any component of type GCS.
    """
    battery_failsafe: Failsafe
    estimator_failsafe: Failsafe
    estimator_grace_s: float
    gnss_grace_s: float
    """Time for which the estimator keeps a position without GNSS."""
    estimator_recovers: bool
    """Whether the vehicle returns to the requested mode when the position is back. False: it stays in the
    failsafe's mode."""
    global_position_stops: bool
    """Whether GLOBAL_POSITION_INT stops without a position."""
    sticks_take_over: bool
    """Whether moved sticks end an automatic mode (COM_RC_OVERRIDE)."""
    # parameters
    param_bytewise: bool
    params: ParamTable
    legacy_names: Mapping[str, str] = field(default_factory=dict)
    """Current parameter name -> the name before the last renaming."""
    timeout_param: str
    cruise_param: str
    cruise_param_scale: float
    """SI value = parameter value times this."""

    @property
    def waits_in(self) -> VehicleMode:
        """Mode in which a vehicle in the air waits for a companion that is to fly it: the one that flies
        setpoints, or HOLD if that one needs a stream of them."""
        return VehicleMode.HOLD if self.external_needs_stream else VehicleMode.EXTERNAL

    def mode_of(self, custom_mode: int) -> VehicleMode | None:
        """Return the mode with this firmware number; None if the mock does not have it."""
        return next((mode for mode, number in self.custom_modes.items() if number == custom_mode), None)


def with_quirks(manners: Manners, quirks: Mapping[str, object]) -> Manners:
    """Return a firmware's behaviour with some fields of `Manners` changed.

    Raises:
        ConfigError: a name is unknown, or a value is not of the field's type. Tables cannot be changed.
    """
    if not quirks:
        return manners
    kinds = get_type_hints(Manners)
    given: dict[str, Any] = {}
    for name, value in quirks.items():
        kind = kinds.get(name)
        if kind is None:
            raise ConfigError(f"quirk {name}: unknown name; allowed: {', '.join(sorted(kinds))}")
        if kind in (VehicleMode, VehicleMode | None) and isinstance(value, str):
            names = {mode.value: mode for mode in manners.custom_modes}
            if value not in names:
                raise ConfigError(
                    f"quirk {name}: {value!r} is not a mode of this firmware; allowed: {', '.join(names)}"
                )
            value = names[value]
        number = kind in (float, float | None) and isinstance(value, int) and not isinstance(value, bool)
        plain = kind in (bool, int, float, str, float | None, str | None, VehicleMode, VehicleMode | None)
        fits = plain and (number or isinstance(value, kind)) and not (kind is int and isinstance(value, bool))
        if not fits:
            raise ConfigError(
                f"quirk {name}: {value!r} has the wrong type; expected {getattr(kind, '__name__', kind)}"
            )
        given[name] = value
    return replace(manners, **given)
