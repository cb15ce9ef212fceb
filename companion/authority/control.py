"""Takes the vehicle, keeps it, lets it go: what moves the authority table, and what each move does."""

from __future__ import annotations

import math
from collections.abc import Sequence

from companion.adjustable_parameters import SWITCHED_OFF
from companion.authority.guard import GuardPlan
from companion.authority.handback import HandBack
from companion.authority.modes import OurModes
from companion.authority.plan import Plan
from companion.authority.readiness import Readiness, mode_name, was_disarmed
from companion.authority.standstill import Standstill
from companion.authority.step import Cycle, Step
from companion.authority.sticks import Sticks
from companion.authority.table import HOLDING, Found, State, Trigger, next_state
from companion.avoidance.law import LawResult
from companion.config import Config
from companion.events import (
    AuthorityChanged,
    Command,
    Firmware,
    FlightMode,
    GateRefused,
    Heartbeat,
    Landed,
    ModeRefused,
    RcChannels,
    Say,
    SetMode,
    Severity,
)
from companion.geometry import Vec3
from companion.ownship import Ownship

_NOT_GUARDED = frozenset({Landed.TAKEOFF, Landed.LANDING})
"""Parts of a guarded mission that the vehicle is not taken out of."""
_HUNG_S = 1.0
_HEALTHY_AFTER_S = 3.0
"""A fault lasts longer than the slowest heartbeat that shows which failsafe it caused: to PX4, setpoints that
come again are a wish to go on."""
_REFUSED_PAUSE_S = 8.0
"""After a refused mode change, before the vehicle is asked again."""
_SURE = 3
"""Decisions in a row that must see a conflict before a guarded vehicle is taken."""
_KEPT_OFF_S = 60.0
"""Kept off its way for so long with no conflict, by a floor, a ceiling, a fence or the wind, a guarded
vehicle is given back where it is."""
_TOLD_LOUDLY = frozenset({Trigger.PILOT, Trigger.UNFIT, Trigger.CHANGED})
_TOLD = _TOLD_LOUDLY | {Trigger.READY, Trigger.RELEASE, Trigger.WATCH, Trigger.RESUMED, Trigger.ENDED}
"""Moves that the pilot is told of, besides each that ends watching."""
_REASONS = {
    Trigger.RELEASE: "vehicle disarmed or on the ground",
    Trigger.REARM: "authority given anew",
    Trigger.HEALTHY: "own state fit again",
    Trigger.WATCH: "guarding the mission that the vehicle flies",
    Trigger.LEFT: "which vehicle is ours is not known",
    Trigger.CLEAR: "no conflict",
    Trigger.AWAY: "off the timed path",
    Trigger.REGAINED: "back on the timed path",
}
"""Of the moves that have but one."""
_LATE_S = 0.25
"""A step that comes this much after the last (or 2.5 periods) commands nothing: the loop was late."""


class Control:
    """Who flies one aircraft. The caller knows one entry, `step`, besides what it hands in as it comes.

    Args:
        config: only what no ground station may set is used.
    """

    def __init__(self, config: Config, own: Ownship, plan: Plan, readiness: Readiness) -> None:
        self.state = State.STANDBY
        self._config = config
        self._own = own
        self._plan = plan
        self._readiness = readiness
        self._clear_after_s = config.avoidance.n_noncollide * config.avoidance.period_s
        self._late_s = max(_LATE_S, 2.5 / config.flight.setpoint_rate_hz)
        self._guard = plan if isinstance(plan, GuardPlan) else None
        self._handback = None if self._guard is None else HandBack(self._guard, own, self._clear_after_s)
        """Of a mission that is guarded; None: none is."""
        self._modes = OurModes(own, self._handback)
        self._sticks = Sticks()
        self._standstill = Standstill()
        self._result: LawResult | None = None
        """The law's last, while the vehicle is held."""
        self._conflict_s = self._commanded_s = -math.inf
        self._conflicts = 0
        """Decisions in a row, while a mission is guarded, that saw one."""
        self._refused: str | None = None
        self._gate_fault: str | None = None
        self._gate_lost: str | None = None
        """What the gate refused, as a fault of ours, or because there is no authority."""
        self._healthy_s = -math.inf
        """From when on a fault may end."""
        self._left = False
        """The pilot has left the mode by which he gives authority."""

    @property
    def in_control(self) -> bool:
        """The vehicle flies what we command."""
        return self.state in HOLDING and self._modes.confirmed

    @property
    def left_in(self) -> frozenset[FlightMode]:
        """Modes that the vehicle may be in by our own doing, after a fault ended our flight."""
        return self._modes.left_in

    def take_sticks(self, event: RcChannels) -> None:
        """The pilot's sticks."""
        self._sticks.take(event)

    def mode_refused(self, event: ModeRefused) -> list[Command]:
        """What was asked for in order to fly is a fault; the rest is told. Where the vehicle has no mode for
        the sticks that move (PX4 without a calibrated radio), it is to hold before its failsafe acts."""
        if event.mode is FlightMode.EXTERNAL:
            self._refused = event.reason
            return []
        told: list[Command] = [Say(severity=Severity.WARNING, text=f"DMUCA: {event.reason}")]
        if event.mode is FlightMode.STICKS and self._own.mode is FlightMode.EXTERNAL:
            told.append(SetMode(mode=FlightMode.HOLD))
        return told

    def take_refusal(self, event: GateRefused) -> None:
        """The gate let a command not leave."""
        if event.ends == "fault":
            self._gate_fault = event.text
        elif event.ends == "authority":
            self._gate_lost = event.text

    def step(
        self, now_s: float, gap_s: float, shown: Sequence[Heartbeat], cycle: Cycle, *, mode_known: bool = True
    ) -> Step:
        """Who flies now, and what is commanded.

        Args:
            gap_s: since the last step.
            mode_known: False: what the vehicle told of its mode may be old, and nothing is commanded.
            shown: what the vehicle told of its mode, and whether it is armed, since the last step, in the
                order of arrival; where it told nothing new, what it told last. Empty: it was never heard.
        """
        unfit = self._unfit(now_s, gap_s)
        in_time = gap_s <= self._late_s and mode_known
        commands = self._judge(now_s, shown, unfit, in_time)
        if self.state not in HOLDING:
            self._result = None
        if self.state in HOLDING and in_time:
            velocity = self._fly(now_s, cycle, commands)
            return Step(commands, velocity)
        if self.state is State.WATCHING and in_time and cycle.due(now_s):
            self._watch(now_s, cycle, commands)
            return Step(commands)
        stands = unfit is None and self._standstill.lasts(now_s, self._own.mode)
        return Step(commands, (0.0, 0.0, 0.0) if stands else None, alerts_only=unfit is None)

    # ------------------------------------------------------------ the parts of a step

    def _unfit(self, now_s: float, gap_s: float) -> str | None:
        """Why nothing is to be commanded, in words; None when nothing is against it."""
        if gap_s > _HUNG_S:
            return f"the loop is late: nothing commanded for {_HUNG_S:g} s"
        if self._gate_fault is not None:
            return self._gate_fault
        unfit = self._own.unfit(now_s, self._config.vehicle.stale_after_s)
        if unfit is None and self.state in HOLDING and now_s - self._commanded_s > _HUNG_S:
            why = "the loop is late, or the vehicle's mode is not known"
            return f"nothing commanded for {_HUNG_S:g} s: {why}"
        return unfit

    def _judge(
        self, now_s: float, shown: Sequence[Heartbeat], unfit: str | None, in_time: bool
    ) -> list[Command]:
        """What the vehicle's state says about who flies."""
        ended = unfit if self._readiness.enabled else SWITCHED_OFF
        if ended is not None:
            self._healthy_s = now_s + _HEALTHY_AFTER_S
        elif self._refused is not None:
            self._healthy_s = now_s + _REFUSED_PAUSE_S
        for heartbeat in shown:
            self._standstill.see(heartbeat.mode)
        commands = self._move(now_s, self._triggers(now_s, shown, ended, in_time), unfit=ended)
        self._refused = self._gate_fault = self._gate_lost = None
        return commands

    def _watch(self, now_s: float, cycle: Cycle, commands: list[Command]) -> None:
        """The autopilot flies its mission: would the law fly something else?"""
        assert self._guard is not None
        commands += self._guard.watch(self._own, now_s)
        self._result = result = cycle.decide(now_s, self.state)
        commands += cycle.note(now_s, result, self.state)
        guarded = self._own.landed(now_s) not in _NOT_GUARDED
        self._conflicts = self._conflicts + 1 if result.conflict and guarded else 0
        if self._conflicts >= _SURE:
            commands += self._move(now_s, {Trigger.CONFLICT: None}, result=result)
            # The way to the item may end short of what the mission flies into: it counts all the same.
            self._conflict_s = now_s

    def _fly(self, now_s: float, cycle: Cycle, commands: list[Command]) -> Vec3 | None:
        """The vehicle is held: it is commanded what the law decides, and has decided last; once that streams,
        it is got to take it. None: its mission is not resumed, and it was let go."""
        commands += self._give_back(now_s)
        if self.state not in HOLDING:
            return None
        result = self._result
        if result is None or cycle.due(now_s):
            self._result = result = self._steer(now_s, cycle, commands)
        self._commanded_s = now_s
        commands += self._modes.keep(now_s)
        if self._modes.confirmed:
            self._plan.engage(now_s)
        return result.chosen_ned_mps

    def _give_back(self, now_s: float) -> list[Command]:
        """A guarded vehicle on its way goes back to its mission."""
        if self._handback is None or self.state is not State.GUARDING or not self._modes.confirmed:
            return []
        clear_s = now_s - self._conflict_s
        if clear_s < self._clear_after_s:
            return []
        commands, over = self._handback.ask(now_s, clear_s)
        return commands + self._move(now_s, {Trigger.CHANGED: None}) if over else commands

    def _steer(self, now_s: float, cycle: Cycle, commands: list[Command]) -> LawResult:
        """The law decides anew."""
        if self._guard is not None:
            commands += self._guard.lead(self._own, now_s)
        result = cycle.decide(now_s, self.state)
        if self._handback is not None:
            self._handback.note_way(now_s)
        if result.conflict:
            self._conflict_s = now_s
        commands += self._move(now_s, dict.fromkeys(self._law_triggers(now_s, result)), result=result)
        commands += cycle.note(now_s, result, self.state)
        return result

    # ------------------------------------------------------------ what moves it

    def _triggers(self, now_s: float, shown: Sequence[Heartbeat], unfit: str | None, in_time: bool) -> Found:
        """What the vehicle's state says about authority."""
        own = self._own
        found: Found = {}
        foreign = self._modes.judge(shown, now_s, self.state in HOLDING)
        if foreign is not None or self._sticks.moved or self._gate_lost is not None:
            found[Trigger.PILOT] = foreign
        if unfit is not None or self._refused is not None:
            found[Trigger.UNFIT] = None
        if self._readiness.down(now_s, shown):
            found[Trigger.RELEASE] = None
        if now_s >= self._healthy_s:
            found[Trigger.HEALTHY] = None
        if self._given_anew(shown):
            found[Trigger.REARM] = None
        standing_by = self.state is State.STANDBY and self._plan.ready and in_time
        ready = standing_by and self._readiness.waits_for(now_s, self._modes.left_in) is None
        if ready and self._plan.near(own, now_s):
            watch = self._handback is not None and own.mode is FlightMode.MISSION
            found[Trigger.WATCH if watch else Trigger.READY] = None
        if self._handback is not None:
            found |= self._handback.triggers(shown, now_s)
        if self.state is State.WATCHING and self._readiness.unclear is not None:
            found[Trigger.LEFT] = None
        return found

    def _given_anew(self, shown: Sequence[Heartbeat]) -> bool:
        """The pilot gives authority anew: he disarms, or he has left the mode that gives it and selects it
        again, and it is the last that he selected."""
        rearm = self._config.flight.rearm
        gives = FlightMode.EXTERNAL if self._handback is None else FlightMode.MISSION
        self._left = self._left or any(heartbeat.mode is not gives for heartbeat in shown)
        if rearm == "disarm":
            return was_disarmed(shown)
        return rearm == "mode" and self._left and self._own.mode is gives

    @property
    def _asks_sticks(self) -> bool:
        """The pilot moves the sticks and has chosen no mode: the vehicle is in ours, in the hold that our
        fault asked for, or still in the one that we are taking it from. He gets one that takes the sticks."""
        heartbeat, mode = self._own.heartbeat, self._own.mode
        if not self._sticks.moved:
            return False
        if mode is FlightMode.EXTERNAL:
            return True
        if self._modes.left_in:
            return mode is FlightMode.HOLD and mode in self._modes.left_in
        return heartbeat is not None and self._modes.being_taken(heartbeat)

    def _law_triggers(self, now_s: float, result: LawResult) -> frozenset[Trigger]:
        """What the law says about authority."""
        if result.conflict:
            return frozenset({Trigger.CONFLICT})
        clear_s = now_s - self._conflict_s
        if clear_s < self._clear_after_s:
            return frozenset()
        distance, regained = self._plan.course.distance_m(self._own, now_s), self._config.avoidance.regained_m
        kept_off = self._handback is not None and clear_s >= _KEPT_OFF_S
        if distance <= regained or kept_off:
            return frozenset({Trigger.CLEAR, Trigger.REGAINED})
        return frozenset({Trigger.CLEAR, Trigger.AWAY} if distance > 2.0 * regained else {Trigger.CLEAR})

    # ------------------------------------------------------------ what a move does

    def _move(
        self,
        now_s: float,
        found: Found,
        *,
        unfit: str | None = None,
        result: LawResult | None = None,
    ) -> list[Command]:
        moved = next_state(self.state, found)
        if moved is None:
            return []
        previous, (self.state, trigger) = self.state, moved
        seen = found[trigger]
        reason = self._reason(now_s, trigger, seen, unfit, result)
        commands: list[Command] = [
            AuthorityChanged(
                previous=previous.value, state=self.state.value, trigger=trigger.value, reason=reason
            )
        ]
        handback, held = self._handback, previous in HOLDING
        if handback is not None:
            handback.interrupted()
        if self.state in HOLDING and not held:
            commands += self._begin(now_s)
        elif trigger is Trigger.CONFLICT and handback is not None:
            commands += handback.recall(now_s)
        if trigger in _TOLD or previous is State.WATCHING:
            severity = Severity.WARNING if trigger in _TOLD_LOUDLY else Severity.INFO
            commands.append(Say(severity=severity, text=f"DMUCA {self.state.value}: {reason}"))
        if self.state not in HOLDING:
            commands += self._end(now_s, trigger, seen, held)
        if previous is State.WATCHING and found.get(Trigger.LEFT) is not None:
            # What the pilot selects next may be another mission.
            self._plan.drop()
        return commands

    def _begin(self, now_s: float) -> list[Command]:
        """The vehicle is taken."""
        commands = [] if self._handback is None else self._handback.begin(now_s)
        self._sticks.begin()
        self._modes.left_in = frozenset()
        # A mission is given back after a while without a conflict, which begins now.
        self._conflict_s = -math.inf if self._handback is None else now_s
        self._commanded_s = now_s
        self._modes.seek(now_s)
        return commands

    def _end(self, now_s: float, trigger: Trigger, seen: Heartbeat | None, held: bool) -> list[Command]:
        """Nothing is commanded: not any more, where the vehicle was held.

        Args:
            seen: what the vehicle showed with the trigger.
        """
        commands: list[Command] = []
        if trigger is Trigger.RESUMED and self._handback is not None:
            commands += self._handback.resumed(now_s)
        if trigger is Trigger.REARM and self._own.position is not None:
            self._plan.resume(self._own, now_s)
        sticks = trigger is Trigger.PILOT and seen is None and self._asks_sticks
        if sticks:
            commands.append(SetMode(mode=FlightMode.STICKS))
        if held:
            commands += self._let_go(trigger)
        holds = trigger is Trigger.CHANGED or (trigger is Trigger.UNFIT and not self._readiness.enabled)
        if held and (holds or sticks):
            # Waited for standing: PX4's own failsafe is quicker than the next heartbeat.
            self._standstill.begin(now_s, self._own.mode, sticks=sticks)
        elif not sticks:
            self._standstill.end()
        if self.state is State.WATCHING:
            self._modes.left_in = frozenset()
        self._left, self._conflicts = False, 0
        return commands

    def _let_go(self, trigger: Trigger) -> list[Command]:
        """PX4 notices at once that nothing is commanded any more; ArduPilot would fly on for seconds as it
        was commanded last, so it is asked to stop."""
        heartbeat = self._own.heartbeat
        self._modes.left_in = frozenset()
        if trigger is Trigger.CHANGED:
            return [SetMode(mode=FlightMode.HOLD)]
        if trigger is not Trigger.UNFIT:
            return []
        ardupilot = heartbeat is not None and heartbeat.firmware is Firmware.ARDUPILOT
        return self._modes.let_go(asks_hold=ardupilot or not self._readiness.enabled)

    # ------------------------------------------------------------ in words

    def _reason(
        self,
        now_s: float,
        trigger: Trigger,
        seen: Heartbeat | None,
        unfit: str | None,
        result: LawResult | None,
    ) -> str:
        handback = self._handback
        match trigger:
            case Trigger.PILOT:
                return self._what_the_pilot_did(now_s, seen)
            case Trigger.UNFIT:
                return unfit or f"mode not entered: {self._refused}"
            case Trigger.READY:
                return f"taking the vehicle from mode {mode_name(self._own.heartbeat)}"
            case Trigger.LEFT if seen is not None:
                return f"the mission was left for mode {mode_name(seen)}"
            case Trigger.RESUMED if handback is not None:
                return handback.how(now_s)
            case Trigger.ENDED:
                return f"the mission came to its end as it was given back, in mode {mode_name(seen)}"
            case Trigger.CHANGED if handback is not None:
                return handback.why_not
            case Trigger.CONFLICT if result is not None:
                return "conflict with " + ", ".join(t.track_id for t in result.tracks if t.conflict)
        return _REASONS[trigger]

    def _what_the_pilot_did(self, now_s: float, seen: Heartbeat | None) -> str:
        if seen is None:
            return self._gate_lost or "the pilot moves the sticks"
        changed = f"mode changed to {mode_name(seen)}"
        if self._handback is not None and self._handback.ends_in_hold(seen, now_s):
            return f"{changed} as the mission was given back: by its end, or by the pilot"
        return f"{changed}, not by us"
