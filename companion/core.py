"""The heart: observe -> orient -> decide (the paper's Section 2), pure.

`step(now, events) -> commands`: no clock, socket, file or random source inside. The same object runs on the
aircraft, in lock-step simulation and in replay; the same events at the same times give the same commands,
bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from companion.atmc.chooser import chooser_of
from companion.autopilot.dialect import DIALECTS
from companion.avoidance.alerts import Alerts
from companion.avoidance.authority import HOLDING, State, Trigger, next_state
from companion.avoidance.guard import GuardPlan
from companion.avoidance.law import LawResult, Neighbour, Situation
from companion.avoidance.plan import Plan
from companion.avoidance.sticks import Sticks
from companion.config import Config
from companion.events import (
    AdsbVehicle,
    AuthorityChanged,
    Command,
    Decision,
    Event,
    FenceDownloaded,
    FenceRefused,
    Firmware,
    FlightMode,
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
    SetMode,
    SetSpeed,
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
from companion.settings import SWITCHED_OFF, applied, differences
from companion.traffic.adsb import AdsbTraffic
from companion.traffic.tracks import Traffic

_TAKE_FROM = {
    # LOITER is flown with the sticks, BRAKE is a pilot's emergency stop: neither is ours to end.
    Firmware.ARDUPILOT: frozenset({FlightMode.EXTERNAL, FlightMode.MISSION}),
    Firmware.PX4: frozenset({FlightMode.EXTERNAL, FlightMode.MISSION, FlightMode.HOLD}),
}
"""Modes that the companion may take the vehicle from."""
_GUARDED = frozenset({FlightMode.MISSION})
_NOT_GUARDED = frozenset({Landed.TAKEOFF, Landed.LANDING})
"""Parts of a guarded mission that the vehicle is not taken out of."""
_LATE_S = 0.25
"""A step that comes this much after the last (or 2.5 periods) commands nothing: the loop was late."""
_HUNG_S = 1.0
_HEALTHY_AFTER_S = 3.0
"""A fault lasts longer than the slowest heartbeat that shows which failsafe it caused: to PX4, setpoints that
come again are a wish to go on."""
_REFUSED_PAUSE_S = 8.0
"""After a refused mode change, before the vehicle is asked again."""
_LISTEN_S = 3.0
"""Three heartbeats: a vehicle that was not configured is not taken before so long, as another one on the link
would be heard by then."""
_STREAM_FIRST_S = 0.5
"""PX4 enters OFFBOARD only while setpoints already stream."""
_SURE = 3
"""Decisions in a row that must see a conflict before a guarded vehicle is taken."""
_GIVING_BACK_S = 8.0
"""For this long after the mission was asked for, the vehicle may still obey; then it is asked again."""
_UNREAD_S = 90.0
"""A mission that could not be fetched for so long, with the vehicle ready to be given back, is not resumed:
longer than one download may take."""
_KEPT_OFF_S = 60.0
"""Kept off its way for so long with no conflict, by a floor, a ceiling, a fence or the wind, a guarded
vehicle is given back where it is."""
_RETAKEN_S = 60.0
"""A guarded vehicle that is taken again within this time after it was given back, as what its mission flies
next leads into somebody, or as one after another crosses, is given back later: after twice as long without a
conflict each time."""
_LONGEST_PATIENCE_S = 60.0
_LATE_STEP_S = 30.0
"""The pilot is told each time that the path has waited for this long again."""
_TOLD_LOUDLY = frozenset({Trigger.PILOT, Trigger.UNFIT, Trigger.CHANGED})
_TOLD = _TOLD_LOUDLY | {Trigger.READY, Trigger.RELEASE, Trigger.WATCH, Trigger.RESUMED, Trigger.ENDED}
"""Moves that the pilot is told of, besides each that ends watching."""
_BRAKING_S = 3.0
"""Who switches off wants the vehicle to stop, not to meet what an autopilot does when setpoints end: for so
long at most it is commanded to stand, until it holds by itself."""
_STICKS_S = 10.0
"""The same for a mode that takes sticks: longer than it is asked for, so that where the vehicle refuses it a
hold can be asked for instead."""
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
        self._brake_until_s = -math.inf
        self._braked_in: FlightMode | None = None
        """Mode that the vehicle was last seen in while it is commanded to stand."""
        self.own = Ownship()
        self.traffic = Traffic(config.traffic, config.identity.uas_id, config.identity.ua_type)
        self.adsb = AdsbTraffic(None if config.identity.icao is None else int(config.identity.icao, 16))
        self.alerts = Alerts(config.avoidance)
        self._guard = GuardPlan(config) if config.flight.use == "guard" else None
        self.plan: Plan = self._guard or Plan(config)
        self._sticks = Sticks()
        self.state = State.STANDBY
        self.broadcaster = Broadcaster(config)
        self.chooser = chooser_of(config, policy)
        self._late_s = max(_LATE_S, 2.5 / config.flight.setpoint_rate_hz)
        self._clear_after_s = config.avoidance.n_noncollide * config.avoidance.period_s
        self._last_step_s: float | None = None
        self._frame: LocalFrame | None = None
        self._seen_down = config.flight.take_in_flight
        self._result: LawResult | None = None
        self._decided_s = self._logged_s = self._conflict_s = self._commanded_s = -math.inf
        self._mode_confirmed = False
        self._stream_s: float | None = None
        self._custom_before: int | None = None
        self._healthy_s = -math.inf
        """From when on a fault may end."""
        self._refused: str | None = None
        self._unclear: str | None = None
        """Why it is not known which vehicle on the link is ours."""
        self._found_s: float | None = None
        """When the vehicle was first heard."""
        self._left = False
        """The pilot has left the mode by which he gives authority."""
        self._told_late_s = 0.0
        self._ours: frozenset[FlightMode] = frozenset()
        """Modes that the vehicle may be in by our own doing, after a fault ended our flight."""
        self._conflicts = 0
        """Decisions in a row, while a mission is guarded, that saw one."""
        self._gave_back_s = -math.inf
        """When the vehicle was last asked to fly its mission on."""
        self._resumed_s = -math.inf
        """When the vehicle last flew its mission on."""
        self._patience_s = 0.0
        """A vehicle that was taken again is not given back before so long without a conflict."""
        self._unread_s = math.inf
        """Since when the vehicle could be given back, if its mission were known to be the same."""
        self._taken_s = -math.inf
        self._off_m = 0.0
        """Farthest from the way to the mission's item since then."""

    @property
    def in_control(self) -> bool:
        """The vehicle flies what we command."""
        return self.state in HOLDING and self._mode_confirmed

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
        own, traffic = self.own, self.traffic
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
                        traffic.own_addresses = event.own_addresses
                case MissionDownloaded():
                    self.plan.take_mission(event, now_s)
                case MissionRefused():
                    commands += self.plan.download_refused(event.reason)
                case FenceDownloaded():
                    self.plan.take_fence(event, now_s)
                case FenceRefused():
                    commands += self.plan.download_refused(f"the vehicle's fence: {event.reason}")
                case VehicleParameters():
                    commands += self.plan.take_parameters(event)
                case ModeRefused():
                    commands += self._mode_refused(event)
                case TwoAutopilots():
                    self._unclear = event.reason
                    commands.append(Say(severity=Severity.WARNING, text=f"DMUCA: {event.reason}"))
                case Settings():
                    commands += self._take_settings(event)
                case RcChannels():
                    self._sticks.take(event)
                case _:
                    own.take(event, now_s)
        if self._found_s is None and own.heartbeat is not None:
            self._found_s = now_s
        if own.frame is not self._frame:
            self._frame = own.frame
            traffic.clear()
            self.adsb.clear()
            self.plan.drop()
        if own.frame is not None and own.position is not None:
            here = own.position_ned_m(now_s)
            traffic.note_own(now_s, here, own.velocity_ned_mps)
            for frame in heard:
                traffic.hear(frame, now_s, own.utc_offset_s, own.frame, own.separation_m)
            for report in seen:
                self.adsb.take(report, now_s, own.frame, own.separation_m, here)
        self._choose_transports(now_s, commands)
        commands += self.broadcaster.step(own, now_s)

    def _take_settings(self, event: Settings) -> list[Command]:
        """Off counts at once; numbers as soon as no law flies by the old ones."""
        later = (
            ""
            if self.plan.law is None or event.enable != self._settings.enable
            else "; from the next path on"
        )
        told = differences(self._configured, self._settings, event)
        self._settings, self._wanted = event, applied(self._configured, event)
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
        own = self.own
        if own.heartbeat is not None and (not own.armed or own.landed(now_s) is Landed.ON_GROUND):
            self._seen_down = True
            commands += self.plan.check(own, now_s)
            self.plan.drop()
        if self._guard is not None and self.state is State.STANDBY and own.mode not in _GUARDED | self._ours:
            # What the pilot selects next may be another mission.
            self.plan.drop()
        if self.plan.law is None and self._wanted is not self.config:
            self.config = self._wanted
            self.plan.configure(self.config)
            self.alerts.configure(self.config.avoidance)
        if self.state is State.STANDBY and self.waits_for(now_s) is None:
            commands += self.plan.prepare(own, now_s)
            if self.plan.ready and not self.plan.near(own, now_s) and not self.plan.remake(own):
                limit = self.config.flight.start_within_m
                commands += self.plan.refuse(f"vehicle is not within {limit:g} m of the path's point")
        if self.plan.law is not None:
            self.plan.law.note_velocity(now_s, own.velocity_ned_mps)

    def waits_for(self, now_s: float) -> str | None:
        """Why the vehicle cannot be taken now, in words; None when it can: it must be armed, in the air, fit,
        and in a mode that is ours to end."""
        own = self.own
        if self._unclear is not None:
            return self._unclear
        if self.config.flight.use == "watch":
            return 'flight.use is "watch"'
        if not self._settings.enable:
            return SWITCHED_OFF
        if own.heartbeat is None or not own.heartbeat.armed:
            return "vehicle to be armed"
        found_s = self._found_s
        if self.config.vehicle.system_id == 0 and (found_s is None or now_s - found_s < _LISTEN_S):
            return "other autopilots on the link to show (vehicle.system_id is not set)"
        if not self._seen_down:
            return "a landing: the vehicle was flying when this started (flight.take_in_flight)"
        if own.landed(now_s) is not Landed.IN_AIR:
            return f"vehicle to be in the air (landed state: {own.landed(now_s).value})"
        allowed = _TAKE_FROM[own.heartbeat.firmware] if self._guard is None else _GUARDED
        if own.heartbeat.mode not in allowed | self._ours:
            modes = "GUIDED or AUTO" if own.heartbeat.firmware is Firmware.ARDUPILOT else "HOLD or MISSION"
            if self._guard is not None:
                modes = "AUTO" if own.heartbeat.firmware is Firmware.ARDUPILOT else "MISSION"
            return f"mode {modes} (now {self._mode_name})"
        if self.config.region.transport_sets and self.broadcaster.trouble is not None:
            return self.broadcaster.trouble
        return own.unfit(now_s, self.config.vehicle.stale_after_s)

    # ------------------------------------------------------------ decide

    def _decide(self, now_s: float, gap_s: float, commands: list[Command]) -> None:
        """Who flies, and with what velocity."""
        unfit = self.own.unfit(now_s, self.config.vehicle.stale_after_s)
        if gap_s > _HUNG_S or (self.state in HOLDING and now_s - self._commanded_s > _HUNG_S):
            unfit = f"the loop is late: nothing commanded for {_HUNG_S:g} s"
        ended = unfit if self._settings.enable else SWITCHED_OFF
        if ended is not None:
            self._healthy_s = now_s + _HEALTHY_AFTER_S
        elif self._refused is not None:
            self._healthy_s = now_s + _REFUSED_PAUSE_S
        self._move(now_s, self._triggers(now_s, ended), ended, commands)
        self._refused = None
        due = now_s - self._decided_s >= self.config.avoidance.period_s - 1e-6
        if self.state is State.WATCHING and due and gap_s <= self._late_s:
            self._decided_s = now_s
            self._watch(now_s, commands)
            return
        if self.state not in HOLDING or gap_s > self._late_s:
            if due and unfit is None and self.own.landed(now_s) is Landed.IN_AIR:
                self._decided_s = now_s
                self._alert(now_s, self._neighbours(now_s), None, commands)
            if self._brakes(now_s) and unfit is None:
                commands.append(self._setpoint((0.0, 0.0, 0.0)))
            return
        law = self.plan.law
        assert law is not None
        if self.state is State.GUARDING:
            self._give_back(now_s, commands)
            if self.state not in HOLDING:
                return
        if self._result is None or due:
            self._decided_s = now_s
            if self._guard is not None:
                commands += self._guard.lead(self.own, now_s)
            situation = self._situation(now_s)
            self._result = law.decide(situation)
            if self._guard is not None:
                _, nearest = law.trajectory.nearest(situation.position_ned_m)
                self._off_m = max(self._off_m, math.dist(nearest, situation.position_ned_m))
            if self._result.conflict:
                self._conflict_s = now_s
            self._move(now_s, self._law_triggers(now_s), None, commands)
            self._alert(now_s, situation.neighbours, self._result, commands)
            self._tell_late(self._result, commands)
            self._log(now_s, self._result, commands)
        self._ask_mode(now_s, commands)
        self._commanded_s = now_s
        commands.append(self._setpoint(self._result.chosen_ned_mps))

    def _brakes(self, now_s: float) -> bool:
        """The vehicle is still to be commanded to stand: until the mode that was asked for shows, or any
        other, and then never again."""
        mode = self.own.mode
        if mode is FlightMode.EXTERNAL:
            self._braked_in = mode
        elif mode is not self._braked_in:
            self._brake_until_s = -math.inf
        return now_s < self._brake_until_s and mode is FlightMode.EXTERNAL

    def _watch(self, now_s: float, commands: list[Command]) -> None:
        """The autopilot flies its mission: would the law fly something else?"""
        guard, law = self._guard, self.plan.law
        assert guard is not None
        assert law is not None
        commands += guard.watch(self.own, now_s)
        situation = self._situation(now_s)
        self._result = result = law.decide(situation)
        guarded = self.own.landed(now_s) not in _NOT_GUARDED
        self._conflicts = self._conflicts + 1 if result.conflict and guarded else 0
        self._alert(now_s, situation.neighbours, None, commands)
        self._log(now_s, result, commands)
        if self._conflicts >= _SURE:
            self._move(now_s, frozenset({Trigger.CONFLICT}), None, commands)
            # The way to the item may end short of what the mission flies into: it counts all the same.
            self._conflict_s = now_s

    def _give_back(self, now_s: float, commands: list[Command]) -> None:
        """On the path, and no conflict: the mission goes on, if it is still the same."""
        if self._guard is None or not self._mode_confirmed or now_s - self._gave_back_s < _GIVING_BACK_S:
            return
        if now_s - self._conflict_s < self._patience_s:
            return
        same, asked = self._guard.give_back(self.own, now_s)
        commands += asked
        if same:
            self._gave_back_s = now_s
            commands.append(SetMode(mode=FlightMode.MISSION, speed_mps=self._forgotten_speed_mps()))
            self._unread_s = math.inf
            return
        self._unread_s = min(self._unread_s, now_s)
        if same is False or now_s - self._unread_s >= _UNREAD_S:
            self._move(now_s, frozenset({Trigger.CHANGED}), None, commands)

    def _mode_refused(self, event: ModeRefused) -> list[Command]:
        """What was asked for in order to fly is a fault; the rest is told. Where the vehicle has no mode for
        the sticks that move (PX4 without a calibrated radio), it is to hold before its failsafe acts."""
        if event.mode is FlightMode.EXTERNAL:
            self._refused = event.reason
            return []
        told: list[Command] = [Say(severity=Severity.WARNING, text=f"DMUCA: {event.reason}")]
        if event.mode is FlightMode.STICKS and self.own.mode is FlightMode.EXTERNAL:
            told.append(SetMode(mode=FlightMode.HOLD))
        return told

    def _triggers(self, now_s: float, unfit: str | None) -> frozenset[Trigger]:
        """What the vehicle's state says about authority."""
        own, flight = self.own, self.config.flight
        found = set()
        if own.mode not in self._ours:
            self._ours = frozenset()
        if self._pilot_took_over(now_s) or self._sticks.moved:
            found.add(Trigger.PILOT)
        if unfit is not None or self._refused is not None:
            found.add(Trigger.UNFIT)
        if not own.armed or own.landed(now_s) is Landed.ON_GROUND:
            found.add(Trigger.RELEASE)
        if now_s >= self._healthy_s:
            found.add(Trigger.HEALTHY)
        on_mission = own.mode is FlightMode.MISSION
        given = on_mission if self._guard is not None else own.mode is FlightMode.EXTERNAL
        self._left = self._left or not given
        if (flight.rearm == "disarm" and own.heartbeat is not None and not own.armed) or (
            flight.rearm == "mode" and given and self._left
        ):
            found.add(Trigger.REARM)
        standing_by = self.state is State.STANDBY and self.plan.ready
        if standing_by and self.waits_for(now_s) is None and self.plan.near(own, now_s):
            found.add(Trigger.WATCH if self._guard is not None and on_mission else Trigger.READY)
        if self._ends_in_hold(now_s) and own.mission_complete:
            found.add(Trigger.ENDED)
        if self._guard is not None and not on_mission:
            found.add(Trigger.LEFT)
        elif self._guard is not None and now_s - self._gave_back_s < _GIVING_BACK_S:
            # Not before it was asked for: the vehicle may be in our mode already, and not have said so.
            found.add(Trigger.RESUMED)
        if self.state is State.WATCHING and self._unclear is not None:
            found.add(Trigger.LEFT)
        return frozenset(found)

    def _pilot_took_over(self, now_s: float) -> bool:
        """A mode that we did not command: any but the one we asked for and, until that is confirmed, the one
        we took the vehicle from."""
        heartbeat = self.own.heartbeat
        if heartbeat is None or heartbeat.mode in self._ours | {FlightMode.EXTERNAL}:
            return False
        if heartbeat.mode is FlightMode.MISSION and now_s - self._gave_back_s < _GIVING_BACK_S:
            return False
        if self._ends_in_hold(now_s) and self.own.mission_complete:
            return False
        return self._mode_confirmed or heartbeat.custom_mode != self._custom_before

    def _ends_in_hold(self, now_s: float) -> bool:
        """The vehicle holds, as PX4 does after a mission's last item, and its mission was just given back.
        Whether that was done is told by MISSION_CURRENT, which may come later."""
        heartbeat = self.own.heartbeat
        if heartbeat is None or heartbeat.firmware is not Firmware.PX4:
            return False
        return heartbeat.mode is FlightMode.HOLD and now_s - self._gave_back_s < _GIVING_BACK_S

    def _law_triggers(self, now_s: float) -> frozenset[Trigger]:
        """What the law's last result says about authority."""
        assert self._result is not None
        if self._result.conflict:
            return frozenset({Trigger.CONFLICT})
        if now_s - self._conflict_s < self._clear_after_s:
            return frozenset()
        distance, regained = self.plan.distance_m(self.own, now_s), self.config.avoidance.regained_m
        kept_off = self._guard is not None and now_s - self._conflict_s >= _KEPT_OFF_S
        if distance <= regained or kept_off:
            return frozenset({Trigger.CLEAR, Trigger.REGAINED})
        return frozenset({Trigger.CLEAR, Trigger.AWAY} if distance > 2.0 * regained else {Trigger.CLEAR})

    def _move(
        self, now_s: float, triggers: frozenset[Trigger], unfit: str | None, commands: list[Command]
    ) -> None:
        moved = next_state(self.state, triggers)
        if moved is None:
            return
        previous, (self.state, trigger) = self.state, moved
        reason = self._reason(now_s, trigger, unfit)
        sticks = trigger is Trigger.PILOT and self._asks_sticks
        commands.append(
            AuthorityChanged(
                previous=previous.value, state=self.state.value, trigger=trigger.value, reason=reason
            )
        )
        self._unread_s = math.inf
        if trigger is Trigger.READY or (previous is State.WATCHING and trigger is Trigger.CONFLICT):
            self._take_control(now_s)
            if self._patience_s:
                text = f"DMUCA: taken again: given back after {self._patience_s:g} s without a conflict"
                commands.append(Say(severity=Severity.NOTICE, text=text))
        elif trigger is Trigger.CONFLICT and now_s - self._gave_back_s < _GIVING_BACK_S:
            # The mission may still be entered: what was asked for last counts.
            commands.append(SetMode(mode=FlightMode.EXTERNAL))
        if trigger in _TOLD or previous is State.WATCHING:
            severity = Severity.WARNING if trigger in _TOLD_LOUDLY else Severity.INFO
            commands.append(Say(severity=severity, text=f"DMUCA {self.state.value}: {reason}"))
        if trigger is Trigger.RESUMED:
            self._resumed_s = now_s
            commands += self._tell_speed()
        if trigger is Trigger.REARM and self.own.position is not None:
            self.plan.resume(self.own, now_s)
        if sticks:
            commands.append(SetMode(mode=FlightMode.STICKS))
        if previous in HOLDING and self.state not in HOLDING:
            self._let_go(trigger, commands)
        # A hold, and the pilot's mode, are waited for standing: PX4's own failsafe is quicker than the next
        # heartbeat.
        holds = trigger is Trigger.CHANGED or (trigger is Trigger.UNFIT and not self._settings.enable)
        if previous in HOLDING and (holds or sticks):
            self._brake_until_s = now_s + (_STICKS_S if sticks else _BRAKING_S)
            self._braked_in = self.own.mode
        elif not sticks:
            self._brake_until_s = -math.inf
        if self.state is State.WATCHING:
            self._ours = frozenset()
        if self.state not in HOLDING:
            self._result = None
            self._left = False
            self._conflicts = 0

    def _forgotten_speed_mps(self) -> float | None:
        """The mission's own speed, which ArduPilot forgets when the mission's mode is entered. It must come
        right behind the request for that: a leg that was begun at the vehicle's own speed overshoots it by
        metres a second."""
        guard, heartbeat = self._guard, self.own.heartbeat
        if guard is None or heartbeat is None or heartbeat.firmware is not Firmware.ARDUPILOT:
            return None
        return guard.mission_speed_mps(self.own)

    def _tell_speed(self) -> list[Command]:
        """The vehicle flies its mission on: at which speed."""
        guard, heartbeat = self._guard, self.own.heartbeat
        speed_mps = self._forgotten_speed_mps()
        if speed_mps is not None:
            return [SetSpeed(speed_mps=speed_mps)]
        ardupilot = heartbeat is not None and heartbeat.firmware is Firmware.ARDUPILOT
        if guard is None or not ardupilot or not guard.speed_is_open(self.own):
            return []
        text = (
            "DMUCA: the mission jumps, which of its speeds holds is not known: flown on at the vehicle's own"
        )
        return [Say(severity=Severity.WARNING, text=text)]

    def _let_go(self, trigger: Trigger, commands: list[Command]) -> None:
        """Nothing is commanded any more. PX4 notices at once; ArduPilot would fly on for seconds as it was
        commanded last, so it is asked to stop."""
        mode = self.own.mode
        external = mode is FlightMode.EXTERNAL
        self._ours = frozenset()
        if trigger is Trigger.CHANGED:
            commands.append(SetMode(mode=FlightMode.HOLD))
        elif trigger is Trigger.UNFIT and mode is not None and not external and not self._mode_confirmed:
            # Our mode may be entered unseen.
            self._ours = frozenset({mode, FlightMode.EXTERNAL})
        elif trigger is Trigger.UNFIT and external:
            self._ours = frozenset({FlightMode.EXTERNAL})
            ardupilot = self.own.heartbeat is not None and self.own.heartbeat.firmware is Firmware.ARDUPILOT
            if ardupilot or not self._settings.enable:
                self._ours |= {FlightMode.HOLD}
                commands.append(SetMode(mode=FlightMode.HOLD))

    @property
    def _asks_sticks(self) -> bool:
        """The pilot moves the sticks and has chosen no mode: the vehicle is in ours, in the hold that our
        fault asked for, or still in the one that we are taking it from. He gets one that takes the sticks."""
        heartbeat = self.own.heartbeat
        if heartbeat is None or not self._sticks.moved:
            return False
        if heartbeat.mode is FlightMode.EXTERNAL:
            return True
        if self._ours:
            return heartbeat.mode is FlightMode.HOLD and heartbeat.mode in self._ours
        return not self._mode_confirmed and heartbeat.custom_mode == self._custom_before

    def _reason(self, now_s: float, trigger: Trigger, unfit: str | None) -> str:
        mode = self._mode_name
        conflicts = () if self._result is None else (t.track_id for t in self._result.tracks if t.conflict)
        pilot = "the pilot moves the sticks"
        if self._pilot_took_over(now_s):
            pilot = f"mode changed to {mode}, not by us"
            if self._ends_in_hold(now_s):
                pilot = f"mode changed to {mode} as the mission was given back: by its end, or by the pilot"
        return {
            Trigger.PILOT: pilot,
            Trigger.UNFIT: unfit or f"mode not entered: {self._refused}",
            Trigger.RELEASE: "vehicle disarmed or on the ground",
            Trigger.REARM: "authority given anew",
            Trigger.HEALTHY: "own state fit again",
            Trigger.READY: f"taking the vehicle from mode {mode}",
            Trigger.WATCH: "guarding the mission that the vehicle flies",
            Trigger.LEFT: "which vehicle is ours is not known"
            if self._unclear is not None
            else f"the mission was left for mode {mode}",
            Trigger.RESUMED: f"the vehicle flies its mission on at item {self.own.mission_seq}, taken for "
            f"{now_s - self._taken_s:.0f} s, {self._off_m:.0f} m off its way at most",
            Trigger.ENDED: f"the mission came to its end as it was given back, in mode {mode}",
            Trigger.CHANGED: self._not_resumed,
            Trigger.CONFLICT: "conflict with " + ", ".join(conflicts),
            Trigger.CLEAR: "no conflict",
            Trigger.AWAY: "off the timed path",
            Trigger.REGAINED: "back on the timed path",
        }[trigger]

    @property
    def _mode_name(self) -> str:
        """In the autopilot's own words."""
        heartbeat = self.own.heartbeat
        return "unknown" if heartbeat is None else DIALECTS[heartbeat.firmware].name(heartbeat.custom_mode)

    @property
    def _not_resumed(self) -> str:
        """Why the mission is not resumed, and what is left to the pilot."""
        guard, heartbeat = self._guard, self.own.heartbeat
        if guard is None or heartbeat is None:
            return ""
        why = guard.why_not or f"the vehicle's mission could not be read for {_UNREAD_S:g} s"
        dialect = DIALECTS[heartbeat.firmware]
        mode = dialect.name(dialect.command(FlightMode.MISSION).custom_mode)
        return f"{why}: it is not resumed, the vehicle is to hold. To fly it select {mode}"

    def _take_control(self, now_s: float) -> None:
        heartbeat = self.own.heartbeat
        if self._guard is not None:
            self._guard.leave(self.own, now_s)
            self._taken_s, self._off_m = now_s, 0.0
            again = now_s - self._resumed_s < _RETAKEN_S
            longer_s = min(2.0 * max(self._patience_s, self._clear_after_s), _LONGEST_PATIENCE_S)
            self._patience_s = longer_s if again else 0.0
        self._sticks.begin()
        self._mode_confirmed, self._ours = False, frozenset()
        self._gave_back_s = -math.inf
        self._stream_s = now_s
        self._custom_before = None if heartbeat is None else heartbeat.custom_mode
        self._conflict_s = -math.inf
        self._told_late_s = self.plan.late_s
        self._commanded_s = now_s

    def _ask_mode(self, now_s: float, commands: list[Command]) -> None:
        """Get the vehicle to take setpoints, once they stream."""
        if self.own.mode is FlightMode.EXTERNAL:
            if not self._mode_confirmed:
                self.plan.engage(now_s)
            self._mode_confirmed = True
        elif self._mode_confirmed:
            # The mission that was asked for is entered after all, and there is a conflict again.
            self._mode_confirmed = False
            self._custom_before = None if self.own.heartbeat is None else self.own.heartbeat.custom_mode
            self._stream_s = now_s
        elif self._stream_s is not None and now_s - self._stream_s >= _STREAM_FIRST_S:
            self._stream_s = None
            commands.append(SetMode(mode=FlightMode.EXTERNAL))

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
        own, limits, plan = self.own, self.config.limits, self.plan
        return Situation(
            now_s=now_s,
            path_time_s=plan.path_time_s(now_s),
            position_ned_m=own.position_ned_m(now_s),
            velocity_ned_mps=own.velocity_ned_mps,
            sigma_m=own.sigma_m,
            neighbours=self._neighbours(now_s),
            floor_down_m=plan.boundary_down_m(plan.floor_height_m, own, now_s),
            ceiling_down_m=plan.boundary_down_m(limits.ceiling_height_m, own, now_s),
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
        late_s = self.plan.late_s
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
                path_ned_m=self.plan.point(now_s),
                late_s=self.plan.late_s,
                limits=result.limits,
                tracks=result.tracks,
            )
        )
