"""The flight controller of the mock vehicle: arming, modes, take-off, setpoints and their loss, landing.

`Flight.step` flies one motion step. The other methods are requests. They are granted, or refused with the
text that a real autopilot would send.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.events import Landed
from companion.geometry import LocalFrame, Vec3
from sitl_mocks.vehicle.firmware.behaviour import Manners, VehicleMode
from sitl_mocks.vehicle.motion.dynamics import STEP_S, Body
from sitl_mocks.vehicle.motion.guidance import HOVER, Homecoming, MissionRunner, Steering
from sitl_mocks.vehicle.motion.setpoints import Setpoint
from sitl_mocks.vehicle.options import VehicleOptions
from sitl_mocks.vehicle.served.mission import MissionBook
from sitl_mocks.vehicle.served.params import ParamBook

FORCE = 21196.0
"""param2 of an arm or disarm command that overrides the checks."""
_MISSION_CHECK_S = 0.5
_LOITER_SINK_MPS = 2.5
_NOSE_RATE_RADPS = 1.0
_MIN_CRUISE_MPS = 0.2
MANUAL_CONTROL_OFF = 4
"""Value of COM_RC_IN_MODE that disables manual control."""
_OWN_FLIGHT = frozenset({VehicleMode.MISSION, VehicleMode.RTL, VehicleMode.TAKEOFF})
_NEEDS_POSITION = frozenset(VehicleMode) - {VehicleMode.MANUAL, VehicleMode.LAND}
_INFO = int(mavlink.MAV_SEVERITY_INFO)
_CRITICAL = int(mavlink.MAV_SEVERITY_CRITICAL)


def make_body(options: VehicleOptions, manners: Manners) -> Body:
    """Make the point mass with the options' limits, or the firmware's limits where the options are None."""
    north, east, down = options.start_position_ned_m
    return Body(
        position_ned_m=(north, east, down if options.airborne else 0.0),
        velocity_ned_mps=options.start_velocity_ned_mps if options.airborne else HOVER,
        yaw_rad=options.start_yaw_rad,
        max_horizontal_mps=options.max_horizontal_speed_mps or manners.max_horizontal_speed_mps,
        max_climb_mps=options.max_climb_mps or manners.max_climb_mps,
        max_descent_mps=options.max_descent_mps or manners.max_descent_mps,
        response=options.response,
        wind_ned_mps=options.wind_ned_mps,
        max_airspeed_mps=options.max_airspeed_mps,
    )


class Flight:
    """Flight state of one aircraft. Times are the caller's `now_s`."""

    def __init__(
        self, options: VehicleOptions, manners: Manners, params: ParamBook, book: MissionBook, start_s: float
    ) -> None:
        self.body = make_body(options, manners)
        self.armed = options.airborne
        self.on_ground = not options.airborne
        self.mode = options.start_mode or (VehicleMode.HOLD if options.airborne else manners.boot_mode)
        self.failsafe = False
        self.position_lost = False
        """The estimator has no position."""
        self.setpoint: Setpoint | None = None
        self.texts: list[tuple[int, str]] = []
        self._options = options
        self._manners = manners
        self._params = params
        self._book = book
        self._steering = Steering(
            self.body,
            manners,
            acceleration_mps2=options.response.auto_acceleration_mps2,
            vertical_mps2=manners.height_acceleration_mps2,
        )
        frame = LocalFrame(options.home_lat_deg, options.home_lon_deg, options.home_alt_msl_m)
        self.runner = MissionRunner(book, frame, self.body, self._steering, manners)
        self._home = Homecoming(self.body, self._steering, manners)
        self._ready_s = start_s + options.arming_ready_s
        self._armed_s = start_s
        self._touched_s: float | None = None
        self.landing_detected = self.on_ground
        """Whether the firmware has detected that it stands on the ground."""
        self._lift_s: float | None = None
        self._takeoff_down: float | None = None
        self._setpoint_s = -math.inf
        self._intended = self.mode
        self._steer: dict[VehicleMode, Callable[[float], Vec3]] = {
            VehicleMode.EXTERNAL: self._fly_external,
            VehicleMode.MISSION: self._fly_mission,
            VehicleMode.TAKEOFF: self._fly_takeoff,
            VehicleMode.RTL: self._fly_home,
            VehicleMode.LAND: self._fly_landing,
            VehicleMode.HOLD: self._fly_hold,
            VehicleMode.BRAKE: self._stay,
            VehicleMode.MANUAL: self._stay,
        }
        self._steer_now = self._steer[self.mode]
        if options.airborne and self.mode is VehicleMode.EXTERNAL:
            self.setpoint = Setpoint(options.start_velocity_ned_mps)
            self._setpoint_s = start_s
        self._enter(self.mode)

    @property
    def cruise_mps(self) -> float:
        """Speed of missions and of the return to launch (m/s)."""
        own = self._options.mission_speed_mps
        set_speed = self._params.get(self._manners.cruise_param) * self._manners.cruise_param_scale
        return own or max(set_speed, _MIN_CRUISE_MPS)

    @property
    def landed(self) -> Landed:
        """Landed state as EXTENDED_SYS_STATE reports it."""
        if self.on_ground and self.landing_detected:
            return Landed.ON_GROUND
        in_mission = self.mode is VehicleMode.MISSION
        if self._takeoff_down is not None or (in_mission and self.runner.climbing):
            return Landed.TAKEOFF
        if self.mode is VehicleMode.LAND or (self.mode is VehicleMode.RTL and self._home.over_home):
            return Landed.LANDING
        return Landed.IN_AIR

    def knows_place(self, now_s: float) -> bool:
        """Whether the estimator has a position."""
        return now_s >= self._ready_s and not self.position_lost

    @property
    def taking_off(self) -> bool:
        """Whether an accepted take-off is still in progress."""
        return self._takeoff_down is not None

    # ------------------------------------------------------------ requests

    def arm(self, now_s: float, *, force: bool = False) -> str | None:
        """Arm. Return None, or the reason of the refusal."""
        if self.armed:
            return None
        refusal = self.arm_refusal(now_s, force=force)
        if refusal is not None:
            return refusal
        self.armed = True
        self._armed_s = now_s
        self._touched_s = None
        self.texts.append((_INFO, "Arming motors"))
        return None

    def arm_refusal(self, now_s: float, *, force: bool = False) -> str | None:
        """Return why the vehicle would refuse to arm; None if it would arm."""
        if now_s < self._ready_s or self.position_lost:
            return "Need Position Estimate"
        if self.mode not in self._manners.arms_in and not force:
            return f"Mode {self.mode.value} not armable"
        return None

    def disarm(self, *, force: bool = False) -> str | None:
        """Disarm. Return None, or the reason of the refusal. If forced in the air, the vehicle falls."""
        if not self.armed:
            return None
        if not self.on_ground and not force:
            return "Disarming denied: not landed"
        self.armed = False
        self._takeoff_down = None
        self._lift_s = None
        self.landing_detected = self.landing_detected or self.on_ground
        if self._manners.disarm_rewinds_mission:
            self.runner.rewind()
        self.texts.append((_INFO, "Disarming motors"))
        return None

    def take_off(self, height_m: float) -> str | None:
        """Climb to a height over home. Return None, or the reason of the refusal.

        Args:
            height_m: in m; NaN climbs by the height in the firmware's take-off parameter, if it has one.
        """
        if math.isnan(height_m):
            height_m = self._default_takeoff_m()
        if not math.isfinite(height_m):
            return "Takeoff altitude is not a number"
        if self._manners.takeoff_in_external:
            if self.mode is not VehicleMode.EXTERNAL:
                return "Takeoff: not in GUIDED"
            if not self.armed or not self.on_ground or height_m <= 0.0:
                return "Takeoff: refused"
        else:
            self._request(VehicleMode.TAKEOFF)
        self._takeoff_down = -height_m
        return None

    def set_mode(self, mode: VehicleMode, now_s: float) -> str | None:
        """Change the mode. Return None, or why the vehicle stays in its mode."""
        if mode not in self._manners.custom_modes:
            return "No such mode"
        if mode is self.mode and not self.failsafe:
            return None
        if self.position_lost and mode in _NEEDS_POSITION:
            return f"Mode change to {mode.value.upper()} failed: requires position"
        if mode is VehicleMode.MISSION:
            if not self._book.flown_count:
                return "Mode change to AUTO failed: init failed"
            if self._manners.external_needs_stream and now_s - self._book.loaded_s < _MISSION_CHECK_S:
                return "Mission is being checked"
        if (
            mode is VehicleMode.EXTERNAL
            and self._manners.external_needs_stream
            and not self._streaming(now_s)
        ):
            return "Offboard needs a setpoint stream"
        self._request(mode)
        return None

    def fail_over(self, mode: VehicleMode) -> None:
        """Enter a mode because of a failsafe. The requested mode stays `intended`."""
        self._enter(mode)
        self.failsafe = True

    def recover(self, now_s: float) -> None:
        """Return to the requested mode after the cause of a failsafe is over."""
        self._enter(VehicleMode.HOLD)
        self.set_mode(self._intended, now_s)

    @property
    def intended(self) -> VehicleMode:
        """The requested mode. During a failsafe it can differ from `mode`."""
        return self._intended if self.failsafe else self.mode

    def take_over(self) -> None:
        """Give control to the pilot: enter MANUAL."""
        self._request(VehicleMode.MANUAL)

    def set_setpoint(self, setpoint: Setpoint, now_s: float) -> None:
        """Take a setpoint that the firmware understood. ArduPilot ignores it outside GUIDED."""
        external = self.mode is VehicleMode.EXTERNAL
        if not self._manners.external_needs_stream:
            if not external:
                return
            if self._takeoff_down is not None:
                if self.on_ground or not self._manners.cancels_takeoff:
                    return
                self._takeoff_down = None
        self.setpoint = setpoint
        self._setpoint_s = now_s
        if self._stream_lost and self._manners.stream_takes_back:
            # The requested mode is still EXTERNAL, so the vehicle returns to it by itself.
            self._enter(VehicleMode.EXTERNAL)

    def change_speed(self, speed_mps: float) -> None:
        """Carry out DO_CHANGE_SPEED that came as a command, not as a mission item."""
        self.runner.speed_mps = speed_mps

    # ------------------------------------------------------------ one step

    def step(self, now_s: float) -> None:
        """Fly one motion step of STEP_S that begins at `now_s`."""
        body = self.body
        if not self.armed:
            if not self.on_ground and body.fall():
                self._touch(now_s)
            return
        self._watch_stream(now_s + STEP_S)
        if self.on_ground:
            self._stand(now_s)
            return
        north, east, down = self._steer_now(now_s)
        if body.step(north, east, down):
            self._touch(now_s)
            return
        self._turn_nose()

    def _watch_stream(self, now_s: float) -> None:
        """React to the loss of the setpoint stream."""
        if self.mode is not VehicleMode.EXTERNAL or self.setpoint is None or not self.setpoint.expires:
            return
        if self._streaming(now_s):
            return
        if self._manners.loss_mode is None:
            self.setpoint = None
            return
        self.fail_over(self._chosen_for_loss() or self._manners.loss_mode)
        self._stream_lost = True
        self.texts.append((_CRITICAL, "Failsafe activated: offboard signal lost"))

    def _chosen_for_loss(self) -> VehicleMode | None:
        """Mode that the parameters select for setpoint loss; None if the firmware's `loss_mode` applies."""
        if not self._manners.loss_actions:
            return None
        chosen = self._manners.loss_actions.get(int(self._params.get("COM_OBL_RC_ACT")))
        by_hand = self._options.rc_connected and self._params.get("COM_RC_IN_MODE") != MANUAL_CONTROL_OFF
        return None if chosen is VehicleMode.MANUAL and not by_hand else chosen

    def _streaming(self, now_s: float) -> bool:
        timeout_s = self._params.get(self._manners.timeout_param) + self._manners.loss_noticed_s
        return now_s - self._setpoint_s < timeout_s - 1e-9

    def _stand(self, now_s: float) -> None:
        """Handle one step while armed on the ground: lift off, wait, or disarm."""
        if self._wants_up():
            if self._lift_s is None:
                self._lift_s = max(self._armed_s + self._manners.spin_up_s, now_s)
            if now_s >= self._lift_s:
                self.on_ground = self.landing_detected = False
                self._lift_s = None
                self._touched_s = None
            return
        self._lift_s = None
        manners = self._manners
        lands = self.mode in (VehicleMode.LAND, VehicleMode.RTL)
        lands = lands or (self.mode is VehicleMode.MISSION and self.runner.landing)
        since_touch = math.inf if self._touched_s is None else now_s - self._touched_s
        self.landing_detected = self.landing_detected or since_touch >= manners.land_detect_s
        if lands:
            due = since_touch >= manners.landed_disarm_s
        elif self._touched_s is not None:
            due = manners.disarm_after_landing_s is not None and since_touch >= manners.disarm_after_landing_s
        else:
            waited = now_s - self._armed_s
            due = manners.disarm_preflight_s is not None and waited >= manners.disarm_preflight_s
        if due:
            if self.mode is VehicleMode.MISSION:
                self.runner.complete = True
            self.disarm()

    def _wants_up(self) -> bool:
        if self._takeoff_down is not None:
            return True
        if self.mode is VehicleMode.MISSION:
            self.runner.sync()
            return self.runner.taking_off
        setpoint = self.setpoint
        if (
            self.mode is not VehicleMode.EXTERNAL
            or setpoint is None
            or not self._manners.external_needs_stream
        ):
            # ArduPilot in GUIDED leaves the ground only with a take-off command.
            return False
        return setpoint.velocity_ned_mps[2] < -0.3 or (setpoint.down_m is not None and setpoint.down_m < -1.0)

    def _touch(self, now_s: float) -> None:
        self.on_ground = True
        self.landing_detected = not self.armed
        self._touched_s = now_s
        self._takeoff_down = None
        if self.body.touchdown_mps > 1.0:
            self.texts.append((_INFO, f"SIM Hit ground at {self.body.touchdown_mps:f} m/s"))

    def _request(self, mode: VehicleMode) -> None:
        """Enter a mode that is no failsafe's, and to which the vehicle returns after one."""
        self._enter(mode)
        self._intended = mode

    def _enter(self, mode: VehicleMode) -> None:
        self.failsafe = self._stream_lost = False
        self._takeoff_down = None
        if mode is VehicleMode.EXTERNAL and self.mode is not mode and not self._manners.external_needs_stream:
            self.setpoint = None
        self.mode = mode
        self.body.auto = mode in _OWN_FLIGHT
        self._steer_now = self._steer[mode]
        if mode is VehicleMode.RTL:
            self._home.begin()
        elif mode is VehicleMode.MISSION:
            if not self._manners.speed_change_stays:
                self.runner.speed_mps = None
            self.runner.resume()
        elif mode is VehicleMode.TAKEOFF:
            self._takeoff_down = -self._default_takeoff_m()

    def _default_takeoff_m(self) -> float:
        name = self._manners.takeoff_param
        return math.nan if name is None else self._params.get(name) - self.body.down

    # ------------------------------------------------------------ modes

    def _fly_external(self, now_s: float) -> Vec3:
        if self._takeoff_down is not None:
            return self._climb()
        setpoint = self.setpoint
        if setpoint is None or setpoint.stop:
            return HOVER
        north, east, down = setpoint.velocity_ned_mps
        if setpoint.horizontal_ned_m is None and setpoint.down_m is None:
            return north, east, down
        body = self.body
        place = setpoint.horizontal_ned_m or (body.north, body.east)
        height = body.down if setpoint.down_m is None else setpoint.down_m
        to_n, to_e, to_d = self._steering.towards((place[0], place[1], height), self.cruise_mps)
        return north + to_n, east + to_e, down + to_d

    def _fly_takeoff(self, now_s: float) -> Vec3:
        velocity = self._climb()
        if self._takeoff_down is None:
            self._request(VehicleMode.HOLD)
        return velocity

    def _climb(self) -> Vec3:
        down = self._takeoff_down
        if down is None or abs(self.body.down - down) < 0.3:
            self._takeoff_down = None
            return HOVER
        return self._steering.to_height(down)

    def _fly_mission(self, now_s: float) -> Vec3:
        velocity = self.runner.step(now_s, self.cruise_mps)
        if self.runner.complete and self._manners.mission_end_mode is not None:
            self._request(self._manners.mission_end_mode)
        return velocity

    def _fly_hold(self, now_s: float) -> Vec3:
        if self._options.rc_connected or not self._manners.takeoff_in_external:
            return HOVER
        return (0.0, 0.0, _LOITER_SINK_MPS)

    def _fly_home(self, now_s: float) -> Vec3:
        return self._home.step(self.cruise_mps)

    def _fly_landing(self, now_s: float) -> Vec3:
        return self._steering.landing()

    def _stay(self, now_s: float) -> Vec3:
        return HOVER

    def _turn_nose(self) -> None:
        body = self.body
        rate = _NOSE_RATE_RADPS
        if self.mode is VehicleMode.EXTERNAL:
            setpoint = self.setpoint
            if setpoint is not None and setpoint.yaw_rad is not None:
                body.turn_towards(setpoint.yaw_rad, rate)
                return
            if setpoint is not None and setpoint.yaw_rate_radps is not None:
                turn = setpoint.yaw_rate_radps
                body.turn_towards(body.yaw + math.copysign(1.0, turn), abs(turn))
                return
            if not self._manners.nose_follows_velocity:
                return
        elif self.mode not in (VehicleMode.MISSION, VehicleMode.RTL):
            return
        if body.vn * body.vn + body.ve * body.ve > 1.0:
            body.turn_towards(math.atan2(body.ve, body.vn), rate)
