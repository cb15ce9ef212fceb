"""What describes a firmware's behaviour; `sitl_mocks.vehicle.firmware.behaviour` describes both firmwares."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, get_type_hints

from companion.errors import ConfigError
from companion.events import Firmware
from sitl_mocks.vehicle.firmware.param_tables import ParamTable


class VehicleMode(enum.Enum):
    """What the mock can fly; each firmware has its own number for it."""

    MANUAL = "manual"
    """A pilot's mode: ArduPilot STABILIZE, PX4 POSCTL. The mock's pilot keeps the sticks centred."""
    EXTERNAL = "external"
    """ArduPilot GUIDED, PX4 OFFBOARD."""
    MISSION = "mission"
    HOLD = "hold"
    """ArduPilot LOITER, PX4 AUTO.LOITER."""
    BRAKE = "brake"
    """ArduPilot only."""
    TAKEOFF = "takeoff"
    """PX4 only: ArduPilot takes off inside GUIDED."""
    RTL = "rtl"
    LAND = "land"


@dataclass(frozen=True, slots=True, eq=False)
class Failsafe:
    """What one trouble leads to."""

    param: str | None
    """Holds the action; None: it cannot be chosen, and is action 0."""
    modes: Mapping[int, VehicleMode]
    """By action. One that is not here does nothing, or is flown by no mode of the mock."""
    text: str | None
    deferred: bool
    """PX4 holds for COM_FAIL_ACT_T first, so that a pilot may choose otherwise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Manners:
    """One firmware's ways. Speeds in m/s, accelerations in m/s^2, times in s."""

    firmware: Firmware
    autopilot_id: int
    """MAV_AUTOPILOT."""
    custom_modes: Mapping[VehicleMode, int]
    base_modes: Mapping[VehicleMode, int]
    """base_mode without the armed bit."""
    vtol_state: int
    gps_fix_type: int
    boot_mode: VehicleMode
    # telemetry
    fresh_streams: Mapping[int, float]
    """Message id -> interval of a link nobody has asked anything of."""
    data_streams: bool
    """Answers REQUEST_DATA_STREAM."""
    forwards: bool
    """Passes frames on from one link to the others."""
    has_did_params: bool
    """Can be told to relay Remote ID data (ArduPilot's DID_*)."""
    heartbeat_on_mode_change: bool
    tells_current_mode: bool
    """Knows CURRENT_MODE."""
    standard_modes: Mapping[VehicleMode, int]
    """MAV_STANDARD_MODE; 0 where it is not here."""
    refuses_interval_param3: bool
    unsupported_interval_result: int
    unsupported_request_result: int
    no_such_message_text: bool
    speaks: bool
    """Sends STATUSTEXT; PX4 has events in their place."""
    target_always_told: bool
    """POSITION_TARGET_LOCAL_NED in every mode; False: only where it flies setpoints."""
    # modes and arming
    mode_ack_first: bool
    """A mode command is answered by ACK 0 at once, and by the truth a moment later."""
    set_mode_acked: bool
    """The old SET_MODE message gets a COMMAND_ACK."""
    arms_in_external: bool
    arms_in: frozenset[VehicleMode]
    failure_result: int
    """ACK of a refused arming or take-off."""
    land_detect_s: float
    """From touch-down until it says that it has landed."""
    landed_disarm_s: float
    """From touch-down until it disarms, in a mode that lands."""
    disarm_rewinds_mission: bool
    disarm_after_landing_s: float | None
    """Disarms by itself after a touch-down in a mode that does not land; None: stays armed."""
    disarm_preflight_s: float | None
    # take-off
    takeoff_in_external: bool
    takeoff_altitude_is_amsl: bool
    takeoff_param: str | None
    """Holds the height (m) of a take-off whose command names none; None: such a command is refused."""
    spin_up_s: float
    takeoff_speed_mps: float
    slow_takeoff_m: float
    """Up to this height over home; above it climbs with max_climb_mps."""
    # setpoints
    setpoint_frames: frozenset[int]
    body_frames: frozenset[int]
    bad_frame_stops: bool
    """A setpoint in an unknown frame stops the vehicle; False: it is as if it had never come."""
    external_needs_stream: bool
    loss_noticed_s: float
    """How much later than its parameter says it acts on the loss of the stream."""
    loss_mode: VehicleMode | None
    """Where the loss of the stream leads without a pilot's radio; None: it brakes and stays."""
    loss_actions: Mapping[int, VehicleMode]
    """By COM_OBL_RC_ACT; MANUAL needs the radio, and another action than these is loss_mode."""
    stream_takes_back: bool
    """Setpoints that come again after their loss are flown again, unasked."""
    cancels_takeoff: bool
    """A setpoint after lift-off ends a take-off that it flies in the same mode."""
    needs_whole_velocity: bool
    """One ignored axis drops the whole vector, and the vehicle stops; False: it counts as zero."""
    altitude_with_horizontal_velocity: bool
    nose_follows_velocity: bool
    # flight
    max_horizontal_speed_mps: float
    max_climb_mps: float
    max_descent_mps: float
    max_vertical_acceleration_mps2: float
    height_acceleration_mps2: float
    """With which it stops at a height."""
    acceleration_mps2: float
    """Of setpoints."""
    auto_acceleration_mps2: float
    auto_brake_mps2: float
    auto_jerk_mps3: float
    velocity_lag_s: float
    vertical_lag_s: float
    velocity_gain: float
    """Velocity reached / asked."""
    slow_share: float
    """Part of a velocity that comes and goes with slow_s."""
    slow_s: float
    brake_fades_mps: float
    """Braking is weaker above this speed, 3 m/s further only ..."""
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
    """Tells in a list which item is being flown."""
    flies_to_takeoff_item: bool
    """A take-off item begun above its height is a point to fly to; False: it is done."""
    speed_change_stays: bool
    """DO_CHANGE_SPEED of a mission holds after the mode was left and entered again."""
    paused_state: int
    """MISSION_STATE of a mission that was left in the middle."""
    one_transfer: bool
    """Serves one list at a time, to one partner, item by item in order; False: answers every request."""
    fence_frames: Mapping[int, int]
    """MAV_FRAME of a fence's items as given -> as told; others are refused."""
    fence_altitudes: bool
    """Keeps the altitudes of a fence's items."""
    fence_union: bool
    """Inside one inclusion area is inside; False: outside one of them is outside."""
    adsb_listed: bool
    """Streams a list of the aircraft heard, one per interval; False: passes each report on once."""
    # troubles
    estimator_message: int
    """EKF_STATUS_REPORT or ESTIMATOR_STATUS."""
    tells_fence: bool
    """Knows FENCE_STATUS."""
    fence_enable_param: str | None
    fence_distance_param: str
    fence_height_param: str
    """Both m; 0 is no limit."""
    fence_failsafe: Failsafe
    gcs_failsafe: Failsafe
    gcs_timeout_param: str
    gcs_by_system: bool
    """The ground station is the system of MAV_GCS_SYSID; False: any component of that type."""
    battery_failsafe: Failsafe
    estimator_failsafe: Failsafe
    estimator_grace_s: float
    gnss_grace_s: float
    """How long the estimator lives without GNSS."""
    estimator_recovers: bool
    """Goes back to the mode that was asked for; False: stays where the failsafe led."""
    global_position_stops: bool
    """Sends no GLOBAL_POSITION_INT without a position."""
    sticks_take_over: bool
    """Moved sticks end an automatic mode (COM_RC_OVERRIDE)."""
    # parameters
    param_bytewise: bool
    params: ParamTable
    legacy_names: Mapping[str, str] = field(default_factory=dict)
    """Today's name -> the name before the last renaming."""
    timeout_param: str
    cruise_param: str
    cruise_param_scale: float
    """SI value = parameter value times this."""

    def mode_of(self, custom_mode: int) -> VehicleMode | None:
        """The mode of this number, None where the mock does not fly it."""
        return next((mode for mode, number in self.custom_modes.items() if number == custom_mode), None)


def with_quirks(manners: Manners, quirks: Mapping[str, object]) -> Manners:
    """A firmware's manners with some of them changed, by the name of the field.

    Raises:
        ConfigError: an unknown name, or a value that is not of the field's kind; tables cannot be given.
    """
    kinds = get_type_hints(Manners)
    given: dict[str, Any] = {}
    for name, value in quirks.items():
        kind = kinds.get(name)
        if kind is None:
            raise ConfigError(
                f"quirk {name}: there is none of that name; allowed: {', '.join(sorted(kinds))}"
            )
        if kind in (VehicleMode, VehicleMode | None) and isinstance(value, str):
            names = {mode.value: mode for mode in manners.custom_modes}
            if value not in names:
                raise ConfigError(f"quirk {name}: {value!r} is no mode; allowed: {', '.join(names)}")
            value = names[value]
        number = kind in (float, float | None) and isinstance(value, int) and not isinstance(value, bool)
        plain = kind in (bool, int, float, str, float | None, str | None, VehicleMode, VehicleMode | None)
        fits = plain and (number or isinstance(value, kind)) and not (kind is int and isinstance(value, bool))
        if not fits:
            raise ConfigError(
                f"quirk {name}: {value!r} is not of its kind ({getattr(kind, '__name__', kind)})"
            )
        given[name] = value
    return replace(manners, **given)
