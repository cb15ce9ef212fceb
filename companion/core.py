"""The core of the companion: observe, orient, decide (the paper's Section 2), as a pure state machine.

`step(now, events)` returns commands and uses no clock, socket, file or random source. The same object runs on
the aircraft, in lock-step simulation and in replay. The same events at the same times give the same commands,
bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Final

from companion.adjustable_parameters import applied, differences
from companion.atmc.chooser import chooser_of
from companion.authority.control import Control
from companion.authority.late_input import LateInput
from companion.authority.modes import LateRequests
from companion.authority.plan import Plan, plan_of
from companion.authority.readiness import Readiness
from companion.authority.table import HOLDING, State
from companion.autopilot.advice import acts_on_traffic
from companion.autopilot.dialect import use
from companion.broadcast.broadcaster import Broadcaster
from companion.config import Config
from companion.decider import Decider
from companion.events import (
    AdsbVehicle,
    AirPressure,
    Attitude,
    ClockRead,
    Command,
    CurrentMode,
    Event,
    FenceDownloaded,
    FenceRefused,
    GateAuthority,
    GateRefused,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    InputBehind,
    Landed,
    LandedState,
    LocalPosition,
    MissionDownloaded,
    MissionRefused,
    ModeRefused,
    ObstaclePoint,
    ObstacleScan,
    OperatorData,
    RadioState,
    RcChannels,
    RemoteIdHeard,
    RemoteIdModule,
    Say,
    SecondCompanion,
    SensedAircraft,
    Settings,
    Severity,
    TwoAutopilots,
    VehicleParameters,
    VehicleTime,
    VelocitySetpoint,
)
from companion.geometry import LocalFrame
from companion.laws import plugin_of
from companion.ownship import Ownship
from companion.traffic.adsb import AdsbTraffic
from companion.traffic.published import Publication, is_published
from companion.traffic.sensed import SensedTraffic
from companion.traffic.tracks import Traffic

_OWN_STATE: Final[dict[type[Event], Callable[[Any], float]]] = {
    GlobalPosition: lambda e: (
        e.time_boot_s + e.lat_deg + e.lon_deg + e.alt_msl_m + e.height_above_home_m + sum(e.velocity_ned_mps)
    ),
    LocalPosition: lambda e: e.time_boot_s + sum(e.position_ned_m) + sum(e.velocity_ned_mps),
    VehicleTime: lambda e: e.time_boot_s + (e.utc_s or 0.0),
    ClockRead: lambda e: e.time_boot_s + e.asked_s + e.heard_s,
}
"""Sum of all numbers of each event that says where we are and when. It is finite unless one of them is not,
and takes less time than looking at each."""


class Companion:
    """The decision core of one aircraft. Call `step` with times that never decrease.

    Args:
        policy: content of the file that `config.atmc.policy` names; None if it could not be read.

    Raises:
        ConfigError: a plug-in that the configuration names cannot be used.
    """

    def __init__(self, config: Config, policy: bytes | None = None) -> None:
        plugin_of(config.avoidance.law)
        use(config.vehicle.dialect)
        self.config = config
        """Configuration in effect: the configured one with the ground station's settings applied."""
        self._configured = self._wanted = config
        self._settings = Settings()
        self.own = Ownship()
        identity = config.identity
        self.traffic = Traffic(config.traffic, identity.uas_id, identity.ua_type, config.avoidance)
        self.adsb = AdsbTraffic(None if identity.icao is None else int(identity.icao, 16), config.avoidance)
        self.sensed: SensedTraffic | None = None
        """Tracks of what sensors aboard measure; None if sensors are not used."""
        if config.sensed.use:
            self.sensed = SensedTraffic(config.sensed, config.vehicle.stale_after_s)
        self._publication = Publication()
        self.plan: Plan = plan_of(config)
        self._decider = Decider(config, self.own, self.plan.course, self.traffic, self.adsb, self.sensed)
        self.alerts = self._decider.alerts
        self.broadcaster = Broadcaster(config)
        self._readiness = Readiness(config, self.own, self.broadcaster)
        self._late_input = LateInput()
        self._control = Control(config, self.own, self.plan, self._readiness, self._late_input)
        self._late_requests = LateRequests(self.own, guards=config.flight.use == "guard")
        self.chooser = chooser_of(config, policy)
        self._last_step_s: float | None = None
        self._frame: LocalFrame | None = None
        self._mode_known = True
        """Whether the reported modes are current, rather than read from a backlog."""

    @property
    def state(self) -> State:
        """State of the authority table: who flies."""
        return self._control.state

    @property
    def in_control(self) -> bool:
        """True while the vehicle flies our setpoints."""
        return self._control.in_control

    @property
    def law_fault(self) -> str | None:
        """Why the decisions of the law must not be flown any longer, in words; None if they may be."""
        return self._control.law_fault

    def waits_for(self, now_s: float) -> str | None:
        """Why the vehicle cannot be taken now, in words; None if it can."""
        return self._not_ready(now_s) or self._late_input.text

    def idle_because(self, now_s: float) -> str | None:
        """Why nothing is commanded now, in words; None if it could be, or if the state itself says it."""
        return self.waits_for(now_s) if self.state is State.STANDBY else self._late_input.text

    def _not_ready(self, now_s: float) -> str | None:
        """Like `waits_for`, but ignores late messages, which only postpone taking control."""
        return self.law_fault or self._readiness.waits_for(now_s, self._control.left_in)

    def step(self, now_s: float, events: Sequence[Event]) -> list[Command]:
        """Take in the events since the last step and return the commands to carry out now.

        Args:
            now_s: monotonic time (s), not before that of the last step.
            events: events in order of arrival.

        Raises:
            ValueError: `now_s` is before that of the last step, or it or a number in `_OWN_STATE` is NaN or
                infinite. Nothing was taken in, so the step can be repeated with what is right.
        """
        _refuse_not_finite(now_s, events)
        gap_s = 0.0 if self._last_step_s is None else now_s - self._last_step_s
        if gap_s < 0.0:
            raise ValueError(f"step at {now_s} s after one at {self._last_step_s} s")
        self._last_step_s = now_s
        commands: list[Command] = []
        shown = self._observe(now_s, events, commands)
        self._orient(now_s, shown, commands)
        self._decide(now_s, gap_s, shown, commands)
        return commands

    # ------------------------------------------------------------ observe

    def _observe(self, now_s: float, events: Sequence[Event], commands: list[Command]) -> Sequence[Heartbeat]:
        """Take in own state and received messages, and broadcast our own Remote ID.

        Returns the modes that the vehicle reported, in the form that `Control.step` takes.
        """
        own = self.own
        behind: InputBehind | None = None
        for event in events:
            if type(event) is InputBehind:
                behind = event
                break
        sent_s = now_s if behind is None else min(behind.since_s, now_s)
        shown: list[Heartbeat] = []
        heard: list[RemoteIdHeard] = []
        seen: list[AdsbVehicle] = []
        sensed: list[Event] = []
        for event in events:
            # A step compares each event with the cases in turn, so the most frequent ones come first.
            match event:
                case GlobalPosition():
                    own.observe(event, now_s, sent_s)
                case LocalPosition():
                    own.observe(event, now_s, sent_s)
                    sensed.append(event)
                case RcChannels():
                    self._control.note_sticks(event)
                case RemoteIdHeard():
                    heard.append(event)
                    self.broadcaster.observe(event, now_s)
                case LandedState() | GnssFix() | AirPressure() | VehicleTime():
                    own.observe(event, now_s, sent_s)
                case AdsbVehicle():
                    if not is_published(event):
                        seen.append(event)
                case Attitude() | ObstacleScan() | ObstaclePoint() | SensedAircraft():
                    sensed.append(event)
                case RadioState() | OperatorData() | RemoteIdModule():
                    self.broadcaster.observe(event, now_s)
                    if isinstance(event, RadioState):
                        self.traffic.own_addresses = event.own_addresses
                case MissionDownloaded():
                    self.plan.mission_downloaded(event, now_s)
                case MissionRefused():
                    commands += self.plan.downloads.refused(event.reason)
                case FenceDownloaded():
                    commands += self.plan.downloads.fence_downloaded(event, now_s)
                case FenceRefused():
                    commands += self.plan.downloads.refused(f"the vehicle's fence: {event.reason}")
                case VehicleParameters():
                    commands += self.plan.terms.set_vehicle_parameters(event)
                    if self.plan.course.law is not None:
                        # Parameters arrive one after the other, and may be lowered in flight.
                        self.plan.course.law.restrict(self.plan.terms.limits)
                case ModeRefused():
                    commands += self._control.mode_refused(event)
                case TwoAutopilots():
                    commands += self._readiness.two_autopilots_heard(event)
                case SecondCompanion():
                    commands += self._readiness.second_companion_heard(event)
                case Settings():
                    commands += self._take_settings(event)
                case GateRefused():
                    self._control.note_gate_refusal(event)
                case GateAuthority():
                    commands += self._readiness.gate_authority_changed(event, self.state)
                case Heartbeat() | CurrentMode():
                    own.observe(event, now_s, sent_s)
                    if own.heartbeat is not None:
                        shown.append(own.heartbeat)
                case ClockRead():
                    own.observe(event, now_s, sent_s)
                    self._late_input.read(event)
                case _:
                    own.observe(event, now_s, sent_s)
        self._mode_known = behind is None
        told = self._late_input.step(now_s, behind)
        if own.heartbeat is not None and self.config.flight.use != "watch":
            commands += told
        if own.frame is not self._frame:
            self._frame = own.frame
            self.traffic.clear()
            self.adsb.clear()
            if self.sensed is not None:
                self.sensed.clear()
            self.plan.drop()
        self._hear(now_s, heard, seen)
        if self.sensed is not None:
            self.sensed.hear(sensed, now_s, own, sent_s=sent_s)
        self._choose_transports(now_s, commands)
        commands += self.broadcaster.step(own, now_s)
        return shown or ([] if own.heartbeat is None else [own.heartbeat])

    def _hear(self, now_s: float, heard: Sequence[RemoteIdHeard], seen: Sequence[AdsbVehicle]) -> None:
        """Pass received traffic to the trackers, which need our own position."""
        own = self.own
        if own.frame is None or own.position is None:
            return
        here = own.position_ned_m(now_s)
        self.traffic.note_own(now_s, here, own.velocity_ned_mps)
        self.adsb.note_own(now_s, here, own.velocity_ned_mps, own.pressure_alt_m(now_s))
        self.traffic.hear_all(heard, now_s, own.utc_offset_s, own.frame, own.separation_m)
        for report in seen:
            self.adsb.hear(report, now_s, own.frame, own.separation_m)

    def _take_settings(self, event: Settings) -> list[Command]:
        """Take in settings. `enable` applies at once, numbers as soon as no law uses the old ones."""
        later = (
            ""
            if self.plan.course.law is None or event.enable != self._settings.enable
            else "; applies from the next path"
        )
        told = differences(self._configured, self._settings, event)
        self._settings, self._wanted = event, applied(self._configured, event)
        self._readiness.enabled = event.enable
        return [Say(severity=Severity.NOTICE, text=f"DMUCA: {text}{later}") for text in told]

    def _choose_transports(self, now_s: float, commands: list[Command]) -> None:
        """Run the paper's ATMC, the choice of transports and rates.

        It only requests them. The broadcaster ensures the legal minimum and switches make-before-break.
        """
        broadcaster = self.broadcaster
        if self.chooser is None or broadcaster.gives_way:
            return
        rates, told = self.chooser.step(now_s, self.own, self.traffic, broadcaster.radio, broadcaster.rates)
        if rates is not None:
            broadcaster.ask(rates)
        commands += told

    # ------------------------------------------------------------ orient

    def _orient(self, now_s: float, shown: Sequence[Heartbeat], commands: list[Command]) -> None:
        """Expire old tracks, and prepare a plan once the vehicle could be taken."""
        self.traffic.expire(now_s)
        commands += self.traffic.flagged(now_s)
        commands += self.adsb.full.due(now_s)
        if self.sensed is not None:
            self.sensed.expire(now_s)
            commands += self.sensed.told(now_s, armed=self.own.armed)
        commands += self._publish(now_s)
        own, readiness = self.own, self._readiness
        commands += readiness.look(now_s, shown)
        if readiness.down:
            commands += self.plan.check(own, now_s)
            self.plan.drop()
        standby = self.state is State.STANDBY
        left_in = self._control.left_in
        guards = self.config.flight.use == "guard"
        if guards and standby and not all(readiness.mode_is_ours_to_end(h, left_in) for h in shown):
            # The pilot may select another mission next.
            self.plan.drop()
        if self.plan.course.law is None and self._wanted is not self.config:
            self.config = self._wanted
            self.plan.terms.config = self.config
            self._decider.configure(self.config)
            for table in (self.traffic, self.adsb):
                table.judgement.configure(self.config.avoidance)
        if standby and self._not_ready(now_s) is None:
            commands += self.plan.prepare(own, now_s)
            if self.plan.ready and not self.plan.near(own, now_s) and not self.plan.remake(own):
                limit = self.config.flight.start_within_m
                commands += self.plan.terms.refuse(
                    f"vehicle is more than {limit:g} m from its place on the path"
                )
        if self.plan.course.law is not None:
            self.plan.course.law.note_velocity(now_s, own.velocity_ned_mps)

    def _publish(self, now_s: float) -> Sequence[Command]:
        """Reports of heard traffic for ground stations, if the configuration wants them."""
        own, vehicle, wanted = self.own, self.plan.terms.vehicle, self.config.traffic.publish
        if wanted == "off" or own.frame is None or own.position is None or not self._publication.ready(now_s):
            return []
        if wanted == "if-ignored" and (vehicle is None or acts_on_traffic(vehicle) is not None):
            return []
        heard = self.traffic.neighbours(now_s)
        return self._publication.due(now_s, own.position_ned_m(now_s), own.frame, heard)

    # ------------------------------------------------------------ decide

    def _decide(
        self, now_s: float, gap_s: float, shown: Sequence[Heartbeat], commands: list[Command]
    ) -> None:
        """Decide who flies, and with what velocity."""
        step = self._control.step(now_s, gap_s, shown, self._decider, mode_known=self._mode_known)
        commands += step.commands
        late = self._late_requests.judge(shown, now_s)
        if self.state not in HOLDING:
            commands += late
            self._decider.let_go()
        self._late_requests.note(commands, now_s)
        if step.alerts_only and self._decider.due(now_s) and self.own.landed(now_s) is Landed.IN_AIR:
            commands += self._decider.look(now_s)
        if step.velocity_ned_mps is not None:
            commands.append(VelocitySetpoint(velocity_ned_mps=step.velocity_ned_mps))


def _refuse_not_finite(now_s: float, events: Sequence[Event]) -> None:
    """Refuse numbers that only a caller of the core can give: no reader of messages passes them on.

    Raises:
        ValueError: names the number that is NaN or infinite.
    """
    if not math.isfinite(now_s):
        raise ValueError(f"now_s is {now_s}, which is no finite number")
    for event in events:
        total = _OWN_STATE.get(type(event))
        if total is None or math.isfinite(total(event)):
            continue
        for name in event.__struct_fields__:
            value = getattr(event, name)
            numbers = value if isinstance(value, tuple) else (value or 0.0,)
            if not all(map(math.isfinite, numbers)):
                raise ValueError(f"{type(event).__name__}.{name} is {value}, which is no finite number")
