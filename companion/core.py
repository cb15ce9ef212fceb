"""The heart: observe -> orient -> decide (the paper's Section 2), pure.

`step(now, events) -> commands`: no clock, socket, file or random source inside. The same object runs on the
aircraft, in lock-step simulation and in replay; the same events at the same times give the same commands,
bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from companion.atmc.chooser import chooser_of
from companion.authority.control import Control
from companion.authority.guard import GuardPlan
from companion.authority.plan import Plan, plan_of
from companion.authority.readiness import Readiness
from companion.authority.table import HOLDING, State
from companion.avoidance.alerts import Alerts
from companion.avoidance.law import LawResult, Neighbour, Situation
from companion.config import Config
from companion.events import (
    AdsbVehicle,
    Command,
    Decision,
    Event,
    FenceDownloaded,
    FenceRefused,
    Landed,
    MissionDownloaded,
    MissionRefused,
    ModeRefused,
    OperatorData,
    RadioState,
    RcChannels,
    RemoteIdHeard,
    RemoteIdModule,
    Say,
    Settings,
    Severity,
    TwoAutopilots,
    Vec3,
    VehicleParameters,
    VelocitySetpoint,
)
from companion.geometry import LocalFrame
from companion.ownship import Ownship
from companion.remote_id.broadcaster import Broadcaster
from companion.settings import applied, differences
from companion.traffic.adsb import AdsbTraffic
from companion.traffic.tracks import Traffic

_LATE_S = 0.25
"""A step that comes this much after the last (or 2.5 periods) commands nothing: the loop was late."""
_LATE_STEP_S = 30.0
"""The pilot is told each time that the path has waited for this long again."""
_QUIET_LOG_S = 1.0
"""Decisions are logged at least this often; while avoiding or recovering each one is."""


class Companion:
    """One aircraft's mind. Build it, then call `step` with rising times.

    Args:
        policy: content of the file that `config.atmc.policy` names; None where it could not be read.
    """

    def __init__(self, config: Config, policy: bytes | None = None) -> None:
        self.config = config
        """What counts: as configured, with the settings over it."""
        self._configured = self._wanted = config
        self._settings = Settings()
        self.own = Ownship()
        self.traffic = Traffic(config.traffic, config.identity.uas_id, config.identity.ua_type)
        self.adsb = AdsbTraffic(None if config.identity.icao is None else int(config.identity.icao, 16))
        self.alerts = Alerts(config.avoidance)
        plan = plan_of(config)
        self._guard = plan if isinstance(plan, GuardPlan) else None
        self.plan: Plan = plan
        self.broadcaster = Broadcaster(config)
        self._readiness = Readiness(config, self.own, self.broadcaster)
        self._control = Control(config, self.own, self.plan, self._readiness)
        self.chooser = chooser_of(config, policy)
        self._late_s = max(_LATE_S, 2.5 / config.flight.setpoint_rate_hz)
        self._last_step_s: float | None = None
        self._frame: LocalFrame | None = None
        self._decided_s = self._logged_s = -math.inf
        self._result: LawResult | None = None
        """The law's last, while the vehicle is held."""
        self._told_late_s: float | None = None
        """By how much the path was late when that was last told, or when the vehicle was taken."""

    @property
    def state(self) -> State:
        """Who flies."""
        return self._control.state

    @property
    def in_control(self) -> bool:
        """The vehicle flies what we command."""
        return self._control.in_control

    def waits_for(self, now_s: float) -> str | None:
        """Why the vehicle cannot be taken now, in words; None when it can."""
        return self._readiness.waits_for(now_s, self._control.ours)

    def step(self, now_s: float, events: Sequence[Event]) -> list[Command]:
        """Take in what happened since the last step; return what to do now.

        Args:
            now_s: monotonic time (s), not before the last step's.
            events: in order of arrival.

        Raises:
            ValueError: time runs backwards.
        """
        gap_s = 0.0 if self._last_step_s is None else now_s - self._last_step_s
        if gap_s < 0.0:
            raise ValueError(f"step at {now_s} s after one at {self._last_step_s} s")
        self._last_step_s = now_s
        commands: list[Command] = []
        self._observe(now_s, events, commands)
        self._orient(now_s, commands)
        self._decide(now_s, gap_s, commands)
        return commands

    # ------------------------------------------------------------ observe

    def _observe(self, now_s: float, events: Sequence[Event], commands: list[Command]) -> None:
        """Own state and heard messages come in; others are told about ourselves."""
        own = self.own
        heard: list[RemoteIdHeard] = []
        seen: list[AdsbVehicle] = []
        for event in events:
            match event:
                case RemoteIdHeard():
                    heard.append(event)
                    self.broadcaster.take(event, now_s)
                case AdsbVehicle():
                    seen.append(event)
                case RadioState() | OperatorData() | RemoteIdModule():
                    self.broadcaster.take(event, now_s)
                    if isinstance(event, RadioState):
                        self.traffic.own_addresses = event.own_addresses
                case MissionDownloaded():
                    self.plan.take_mission(event, now_s)
                case MissionRefused():
                    commands += self.plan.downloads.refused(event.reason)
                case FenceDownloaded():
                    self.plan.downloads.take_fence(event, now_s)
                case FenceRefused():
                    commands += self.plan.downloads.refused(f"the vehicle's fence: {event.reason}")
                case VehicleParameters():
                    commands += self.plan.terms.take_parameters(event)
                case ModeRefused():
                    commands += self._control.mode_refused(event)
                case TwoAutopilots():
                    commands += self._readiness.take(event)
                case RcChannels():
                    self._control.take_sticks(event)
                case Settings():
                    commands += self._take_settings(event)
                case _:
                    own.take(event, now_s)
        if own.frame is not self._frame:
            self._frame = own.frame
            self.traffic.clear()
            self.adsb.clear()
            self.plan.drop()
        self._hear(now_s, heard, seen)
        self._choose_transports(now_s, commands)
        commands += self.broadcaster.step(own, now_s)

    def _hear(self, now_s: float, heard: Sequence[RemoteIdHeard], seen: Sequence[AdsbVehicle]) -> None:
        """Others are placed relative to ourselves."""
        own = self.own
        if own.frame is None or own.position is None:
            return
        here = own.position_ned_m(now_s)
        self.traffic.note_own(now_s, here, own.velocity_ned_mps)
        for frame in heard:
            self.traffic.hear(frame, now_s, own.utc_offset_s, own.frame, own.separation_m)
        for report in seen:
            self.adsb.take(report, now_s, own.frame, own.separation_m, here)

    def _take_settings(self, event: Settings) -> list[Command]:
        """Off counts at once; numbers as soon as no law flies by the old ones."""
        later = (
            ""
            if self.plan.course.law is None or event.enable != self._settings.enable
            else "; from the next path on"
        )
        told = differences(self._configured, self._settings, event)
        self._settings, self._wanted = event, applied(self._configured, event)
        self._readiness.enabled = event.enable
        return [Say(severity=Severity.NOTICE, text=f"DMUCA: {text}{later}") for text in told]

    def _choose_transports(self, now_s: float, commands: list[Command]) -> None:
        """The paper's ATMC. It only asks: the law's floor and make before break are the broadcaster's."""
        broadcaster = self.broadcaster
        if self.chooser is None or broadcaster.gives_way:
            return
        rates, told = self.chooser.step(now_s, self.own, self.traffic, broadcaster.radio, broadcaster.rates)
        if rates is not None:
            broadcaster.ask(rates)
        commands += told

    # ------------------------------------------------------------ orient

    def _orient(self, now_s: float, commands: list[Command]) -> None:
        """Tracks that still live; a plan, once the vehicle could be taken."""
        self.traffic.expire(now_s)
        commands += self.traffic.flagged(now_s)
        own, readiness = self.own, self._readiness
        readiness.look(now_s)
        if readiness.down(now_s):
            commands += self.plan.check(own, now_s)
            self.plan.drop()
        standby = self.state is State.STANDBY
        if self._guard is not None and standby and not readiness.mode_is_ours_to_end(self._control.ours):
            # What the pilot selects next may be another mission.
            self.plan.drop()
        if self.plan.course.law is None and self._wanted is not self.config:
            self.config = self._wanted
            self.plan.terms.config = self.config
            self.alerts.configure(self.config.avoidance)
        if standby and self.waits_for(now_s) is None:
            commands += self.plan.prepare(own, now_s)
            if self.plan.ready and not self.plan.near(own, now_s) and not self.plan.remake(own):
                limit = self.config.flight.start_within_m
                commands += self.plan.terms.refuse(f"vehicle is not within {limit:g} m of the path's point")
        if self.plan.course.law is not None:
            self.plan.course.law.note_velocity(now_s, own.velocity_ned_mps)

    # ------------------------------------------------------------ decide

    def _decide(self, now_s: float, gap_s: float, commands: list[Command]) -> None:
        """Who flies, and with what velocity."""
        control = self._control
        unfit = control.unfit(now_s, gap_s)
        commands += control.judge(now_s, unfit)
        if control.state not in HOLDING:
            self._result = self._told_late_s = None
        due = now_s - self._decided_s >= self.config.avoidance.period_s - 1e-6
        in_time = gap_s <= self._late_s
        if control.state in HOLDING and in_time:
            self._fly(now_s, due, commands)
        elif control.state is State.WATCHING and due and in_time:
            self._watch(now_s, commands)
        else:
            if due and unfit is None and self.own.landed(now_s) is Landed.IN_AIR:
                self._decided_s = now_s
                self._alert(now_s, self._neighbours(now_s), None, commands)
            if control.stands(now_s) and unfit is None:
                commands.append(self._setpoint((0.0, 0.0, 0.0)))

    def _fly(self, now_s: float, due: bool, commands: list[Command]) -> None:
        """The vehicle is held: it is commanded what the law decides, and has decided last."""
        if self._told_late_s is None:
            self._told_late_s = self.plan.course.late_s
        commands += self._control.give_back(now_s)
        if self._control.state not in HOLDING:
            return
        if self._result is None or due:
            self._result = self._steer(now_s, commands)
        commands += self._control.keep(now_s)
        commands.append(self._setpoint(self._result.chosen_ned_mps))

    def _steer(self, now_s: float, commands: list[Command]) -> LawResult:
        """The law decides."""
        law = self.plan.course.law
        assert law is not None
        self._decided_s = now_s
        if self._guard is not None:
            commands += self._guard.lead(self.own, now_s)
        situation = self._situation(now_s)
        result = law.decide(situation)
        commands += self._control.decided(now_s, result)
        self._alert(now_s, situation.neighbours, result, commands)
        self._tell_late(result, commands)
        self._log(now_s, result, commands)
        return result

    def _watch(self, now_s: float, commands: list[Command]) -> None:
        """The autopilot flies its mission: the law looks on."""
        guard, law = self._guard, self.plan.course.law
        assert guard is not None
        assert law is not None
        self._decided_s = now_s
        commands += guard.watch(self.own, now_s)
        situation = self._situation(now_s)
        self._result = law.decide(situation)
        self._alert(now_s, situation.neighbours, None, commands)
        self._log(now_s, self._result, commands)
        commands += self._control.watched(now_s, self._result)

    def _setpoint(self, velocity: Vec3) -> VelocitySetpoint:
        """The last gate: nothing outside the limits leaves, whatever the law says.

        Raises:
            RuntimeError: our bug; the process must not go on commanding.
        """
        limits, (north, east, down) = self.config.limits, velocity
        slack = 1e-6
        if not (
            math.hypot(north, east, down) <= limits.max_speed_mps + slack
            and -limits.max_climb_mps - slack <= down <= limits.max_descent_mps + slack
        ):
            raise RuntimeError(f"velocity {velocity} m/s is outside the limits {limits}")
        return VelocitySetpoint(velocity_ned_mps=velocity)

    def _situation(self, now_s: float) -> Situation:
        own, limits, course = self.own, self.config.limits, self.plan.course
        return Situation(
            now_s=now_s,
            path_time_s=course.path_time_s(now_s),
            position_ned_m=own.position_ned_m(now_s),
            velocity_ned_mps=own.velocity_ned_mps,
            sigma_m=own.sigma_m,
            neighbours=self._neighbours(now_s),
            floor_down_m=course.boundary_down_m(course.floor_height_m(limits), own, now_s),
            ceiling_down_m=course.boundary_down_m(limits.ceiling_height_m, own, now_s),
        )

    def _neighbours(self, now_s: float) -> list[Neighbour]:
        down_m = self.own.position_ned_m(now_s)[2]
        return self.traffic.neighbours(now_s) + self.adsb.neighbours(now_s, down_m)

    def _alert(
        self,
        now_s: float,
        neighbours: Sequence[Neighbour],
        result: LawResult | None,
        commands: list[Command],
    ) -> None:
        position, velocity = self.own.position_ned_m(now_s), self.own.velocity_ned_mps
        commands += self.alerts.look(now_s, position, velocity, neighbours, result)

    def _tell_late(self, result: LawResult, commands: list[Command]) -> None:
        """An aircraft that stands before a fence, or is kept off its path for long, is no longer where it is
        expected."""
        late_s = self.plan.course.late_s
        assert self._told_late_s is not None
        if late_s - self._told_late_s < _LATE_STEP_S:
            return
        self._told_late_s = late_s
        bounds = f"; bounded by {', '.join(result.limits)}" if result.limits else ""
        commands.append(Say(severity=Severity.NOTICE, text=f"DMUCA: path {late_s:.0f} s late{bounds}"))

    def _log(self, now_s: float, result: LawResult, commands: list[Command]) -> None:
        quiet = self.state in (State.GUARDING, State.WATCHING)
        if quiet and now_s - self._logged_s < _QUIET_LOG_S - 1e-6:
            return
        self._logged_s = now_s
        frame = self.own.frame
        assert frame is not None
        commands.append(
            Decision(
                origin=(frame.lat_deg, frame.lon_deg, frame.alt_m),
                position_ned_m=self.own.position_ned_m(now_s),
                velocity_ned_mps=self.own.velocity_ned_mps,
                wanted_ned_mps=result.wanted_ned_mps,
                chosen_ned_mps=result.chosen_ned_mps,
                feasible=result.feasible,
                path_ned_m=self.plan.course.point(now_s),
                late_s=self.plan.course.late_s,
                limits=result.limits,
                tracks=result.tracks,
            )
        )
