"""Takes, keeps and releases control of the vehicle.

`Control` finds the triggers of the authority table at each step and carries out each transition.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from companion.adjustable_parameters import SWITCHED_OFF
from companion.authority.guard import GuardPlan
from companion.authority.handback import HandBack
from companion.authority.late_input import LateInput
from companion.authority.modes import OurModes
from companion.authority.plan import Plan
from companion.authority.readiness import Readiness
from companion.authority.reasons import Reasons, Refused
from companion.authority.standstill import Standstill
from companion.authority.step import Cycle, Step
from companion.authority.sticks import Sticks
from companion.authority.table import HOLDING, Found, State, Trigger, next_state
from companion.autopilot.dialect import DIALECTS
from companion.avoidance.law import LawResult
from companion.config import Config
from companion.events import (
    AuthorityChanged,
    Command,
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
"""Phases of a guarded mission in which the companion does not take the vehicle."""
_HUNG_S = 1.0
_HEALTHY_AFTER_S = 3.0
"""How long the cause of a fault must be gone before the fault ends. This is longer than the slowest heartbeat
period, so that a heartbeat shows which failsafe the fault triggered: PX4 re-enters OFFBOARD by itself when
setpoints resume."""
_REFUSED_PAUSE_S = 8.0
"""Pause after a refused mode change before the vehicle is asked again."""
_SURE = 3
"""Consecutive decisions that must see a conflict before a guarded vehicle is taken."""
_KEPT_OFF_S = 60.0
"""If a floor, a ceiling, a fence or the wind keeps a guarded vehicle off its path for this long without a
conflict, it is handed back where it is."""
_OBEYED_LATE_S = 3.0
"""How long after the pilot took over the vehicle may still obey a request of ours that was on its way."""
_TOLD_LOUDLY = frozenset({Trigger.PILOT, Trigger.UNFIT, Trigger.CHANGED, Trigger.SPENT})
_HOLDS = frozenset({Trigger.CHANGED, Trigger.SPENT})
"""Transitions at which the vehicle is asked to hold."""
_TOLD = _TOLD_LOUDLY | {Trigger.READY, Trigger.RELEASE, Trigger.WATCH, Trigger.RESUMED, Trigger.ENDED}
"""Transitions that are reported to the pilot, in addition to every transition out of `State.WATCHING`."""
_LATE_S = 0.25
"""A step commands nothing if the gap since the last one exceeds this, or 2.5 setpoint periods if those are
longer: the loop was late."""


class Control:
    """Decides who flies one aircraft.

    The caller hands in events as they arrive and calls `step` once per cycle.

    Args:
        config: only settings that no ground station can change are read from it.
    """

    def __init__(
        self, config: Config, own: Ownship, plan: Plan, readiness: Readiness, late_input: LateInput
    ) -> None:
        self.state = State.STANDBY
        self._config = config
        self._own = own
        self._plan = plan
        self._readiness = readiness
        self._late_input = late_input
        self._clear_after_s = config.avoidance.n_noncollide * config.avoidance.period_s
        self._late_s = max(_LATE_S, 2.5 / config.flight.setpoint_rate_hz)
        self._guard = plan if isinstance(plan, GuardPlan) else None
        self._handback = None if self._guard is None else HandBack(self._guard, own, self._clear_after_s)
        """Hands a guarded mission back to the autopilot; None if no mission is guarded."""
        self._modes = OurModes(own, self._handback)
        self._sticks = Sticks()
        self._standstill = Standstill()
        self._result: LawResult | None = None
        """Latest decision of the law while we control the vehicle."""
        self._conflict_s = self._commanded_s = -math.inf
        self._conflicts = 0
        """Consecutive decisions that saw a conflict while the autopilot flew its mission."""
        self._refused = Refused()
        self._reasons = Reasons(own, self._handback)
        self._healthy_s = -math.inf
        """Earliest time at which a fault may end."""
        self._left = False
        """The pilot has left the mode whose selection gives us authority."""
        self._obeyed_until_s = self._seen_s = -math.inf
        """Time until which the vehicle may obey a request of ours, and time of its heartbeat before the
        reports being judged: what changed in a silence may have changed at its beginning."""

    @property
    def in_control(self) -> bool:
        """True while the vehicle flies our setpoints."""
        return self.state in HOLDING and self._modes.confirmed

    @property
    def left_in(self) -> frozenset[FlightMode]:
        """Modes that the vehicle may be in because of our own commands after a fault ended our control."""
        return self._modes.left_in

    @property
    def law_fault(self) -> str | None:
        """Why the decisions of the law must not be flown any longer; None if they may be."""
        law = self._plan.course.law
        return None if law is None else law.fault

    def note_sticks(self, event: RcChannels) -> None:
        """Take in the positions of the pilot's sticks."""
        self._sticks.note_channels(event)

    def mode_refused(self, event: ModeRefused) -> list[Command]:
        """Handle a mode that the vehicle refused to enter.

        A refused EXTERNAL mode is a fault. Any other refusal is reported to the pilot. If the vehicle has no
        mode for stick control (PX4 without a calibrated radio), we ask for a hold before its failsafe acts.
        """
        if event.mode is FlightMode.EXTERNAL:
            self._refused.mode = event.reason
            return []
        told: list[Command] = [Say(severity=Severity.WARNING, text=f"DMUCA: {event.reason}")]
        if event.mode is FlightMode.STICKS and self._own.mode is FlightMode.EXTERNAL:
            told.append(SetMode(mode=FlightMode.HOLD))
        return told

    def note_gate_refusal(self, event: GateRefused) -> None:
        """Handle a command that the gate did not let pass."""
        if event.ends == "fault":
            self._refused.fault = event.text
        elif event.ends == "authority":
            self._refused.lost = event.text

    def step(
        self, now_s: float, gap_s: float, shown: Sequence[Heartbeat], cycle: Cycle, *, mode_known: bool = True
    ) -> Step:
        """Decide who flies now and what is commanded.

        Args:
            gap_s: time since the last step.
            mode_known: False if the reported mode may be old; then nothing is commanded.
            shown: modes and arming states that the vehicle reported since the last step, in the order of
                arrival. If nothing new arrived, the last report. Empty if the vehicle was never heard.
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
        # A law that failed says nothing about the own state, so the pilot is still told of other aircraft.
        fit = unfit is None or unfit == self.law_fault
        return Step(commands, (0.0, 0.0, 0.0) if stands else None, alerts_only=fit)

    # ------------------------------------------------------------ parts of a step

    def _unfit(self, now_s: float, gap_s: float) -> str | None:
        """Reason, in words, why nothing may be commanded; None if there is none."""
        if gap_s > _HUNG_S:
            return f"the control loop is late: no command sent for {_HUNG_S:g} s"
        if self._refused.fault is not None:
            return self._refused.fault
        if self.law_fault is not None:
            return self.law_fault
        unfit = self._own.unfit(now_s, self._config.vehicle.stale_after_s)
        if unfit is None and self.state in HOLDING and now_s - self._commanded_s > _HUNG_S:
            why = self._late_input.why or "the control loop is late, or the vehicle's mode is not known"
            return f"no command sent for {_HUNG_S:g} s: {why}"
        return unfit

    def _judge(
        self, now_s: float, shown: Sequence[Heartbeat], unfit: str | None, in_time: bool
    ) -> list[Command]:
        """Apply what the vehicle's state says about who flies."""
        ended = unfit if self._readiness.enabled else SWITCHED_OFF
        if ended is not None:
            self._healthy_s = now_s + _HEALTHY_AFTER_S
        elif self._refused.mode is not None:
            self._healthy_s = now_s + _REFUSED_PAUSE_S
        for heartbeat in shown:
            self._standstill.see(heartbeat.mode)
        commands = self._move(now_s, self._triggers(now_s, shown, ended, in_time), unfit=ended)
        self._refused = Refused()
        if self.state is State.FAULT and self._modes.entered_late:
            commands += self._let_go(Trigger.UNFIT)
        return commands

    def _watch(self, now_s: float, cycle: Cycle, commands: list[Command]) -> None:
        """While the autopilot flies its mission, check whether the law would fly something else."""
        assert self._guard is not None
        commands += self._guard.watch(self._own, now_s)
        self._result = result = cycle.decide(now_s, self.state)
        commands += cycle.note(now_s, result, self.state)
        if self.law_fault is not None:
            commands += self._move(now_s, {Trigger.UNFIT: None}, unfit=self.law_fault)
            return
        guarded = self._own.landed(now_s) not in _NOT_GUARDED
        self._conflicts = self._conflicts + 1 if result.conflict and guarded else 0
        if self._conflicts >= _SURE:
            commands += self._move(now_s, {Trigger.CONFLICT: None}, result=result)

    def _fly(self, now_s: float, cycle: Cycle, commands: list[Command]) -> Vec3 | None:
        """Command the law's latest decision, and ask for our mode once setpoints stream.

        Returns None if the vehicle was released: its mission cannot be resumed, or traffic has held it for as
        long as it may.
        """
        commands += self._give_back(now_s)
        if self.state not in HOLDING:
            return None
        result = self._result
        if result is None or cycle.due(now_s):
            self._result = result = self._steer(now_s, cycle, commands)
            if self.state not in HOLDING:
                return None
        self._commanded_s = now_s
        commands += self._modes.keep(now_s)
        if self._modes.confirmed:
            self._plan.engage(now_s)
        return result.chosen_ned_mps

    def _give_back(self, now_s: float) -> list[Command]:
        """Hand a guarded vehicle that is back on its path back to its mission."""
        if self._handback is None or self.state is not State.GUARDING or not self._modes.confirmed:
            return []
        clear_s = now_s - self._conflict_s
        if clear_s < self._clear_after_s:
            return []
        commands, over = self._handback.ask(now_s, clear_s)
        return commands + self._move(now_s, {Trigger.CHANGED: None}) if over else commands

    def _steer(self, now_s: float, cycle: Cycle, commands: list[Command]) -> LawResult:
        """Run one decision of the law and apply its triggers."""
        commands += self._plan.lead(self._own, now_s)
        result = cycle.decide(now_s, self.state)
        if self._handback is not None:
            self._handback.note_way(now_s)
        if result.conflict:
            self._conflict_s = now_s
        if self.law_fault is not None:
            commands += self._move(now_s, {Trigger.UNFIT: None}, unfit=self.law_fault)
            return result
        triggers = self._law_triggers(now_s, result)
        if cycle.hold is not None and self._modes.confirmed:
            self._refused.traffic = cycle.hold
            triggers |= {Trigger.SPENT}
        commands += self._move(now_s, dict.fromkeys(triggers), result=result)
        commands += cycle.note(now_s, result, self.state)
        return result

    # ------------------------------------------------------------ triggers

    def _triggers(self, now_s: float, shown: Sequence[Heartbeat], unfit: str | None, in_time: bool) -> Found:
        """Triggers that follow from the vehicle's state."""
        own = self._own
        found: Found = {}
        foreign = self._modes.judge(shown, now_s, self.state in HOLDING)
        if foreign is not None or self._sticks.moved or self._refused.lost is not None:
            found[Trigger.PILOT] = foreign
        if unfit is not None or self._refused.mode is not None:
            found[Trigger.UNFIT] = None
        if self._readiness.down:
            found[Trigger.RELEASE] = None
        if now_s >= self._healthy_s:
            found[Trigger.HEALTHY] = None
        if self._authority_given_again(shown):
            found[Trigger.REARM] = None
        standing_by = self.state is State.STANDBY and self._plan.ready and in_time
        ready = standing_by and self._readiness.waits_for(now_s, self._modes.left_in) is None
        ready = ready and self.law_fault is None
        if ready and self._plan.near(own, now_s):
            watch = self._handback is not None and own.mode is FlightMode.MISSION
            found[Trigger.WATCH if watch else Trigger.READY] = None
        if self._handback is not None:
            found |= self._handback.triggers(shown, now_s)
        self._refused.second = self._readiness.second
        if self.state is State.WATCHING and (self._readiness.unclear or self._readiness.second) is not None:
            found[Trigger.LEFT] = None
        return found

    def _authority_given_again(self, shown: Sequence[Heartbeat]) -> bool:
        """Whether the pilot gives authority again.

        With `rearm = "disarm"` disarming does so. With "mode" the pilot must have left the mode that gives
        authority and selected it again as his latest mode.
        """
        rearm = self._config.flight.rearm
        gives = FlightMode.EXTERNAL if self._handback is None else FlightMode.MISSION
        self._left = self._left or any(heartbeat.mode is not gives for heartbeat in shown)
        if self._own.mode is gives and self._seen_s < self._obeyed_until_s:
            self._left = False
        self._seen_s = self._own.heartbeat_s
        if rearm == "disarm":
            return self._readiness.disarmed
        return rearm == "mode" and self._left and self._own.mode is gives

    @property
    def _asks_sticks(self) -> bool:
        """Whether to ask for a mode that the pilot can fly with the sticks.

        This is so if he moves the sticks without having selected a mode. The vehicle is then in our mode, in
        the hold that we requested after a fault, or still in the mode from which we are taking it.
        """
        heartbeat, mode = self._own.heartbeat, self._own.mode
        if not self._sticks.moved:
            return False
        if mode is FlightMode.EXTERNAL:
            return True
        if self._modes.left_in:
            return mode is FlightMode.HOLD and mode in self._modes.left_in
        return heartbeat is not None and self._modes.being_taken(heartbeat)

    def _law_triggers(self, now_s: float, result: LawResult) -> frozenset[Trigger]:
        """Triggers that follow from the law's decision."""
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

    # ------------------------------------------------------------ transitions

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
        reason = self._reasons.of(now_s, trigger, seen, unfit, result, self._refused)
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
            # The pilot may select another mission next.
            self._plan.drop()
        return commands

    def _begin(self, now_s: float) -> list[Command]:
        """Start to control the vehicle."""
        commands = [] if self._handback is None else self._handback.begin(now_s)
        self._sticks.begin()
        self._modes.left_in = frozenset()
        # A mission is handed back after some time without a conflict. That time starts now, even if the path
        # to the item ends before the conflict that the mission flies into.
        self._conflict_s = -math.inf if self._handback is None else now_s
        self._commanded_s = now_s
        self._modes.seek(now_s)
        return commands

    def _end(self, now_s: float, trigger: Trigger, seen: Heartbeat | None, held: bool) -> list[Command]:
        """Enter a state that does not control the vehicle; release the vehicle if we controlled it.

        Args:
            seen: heartbeat that caused the trigger.
            held: we controlled the vehicle until now.
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
        holds = trigger in _HOLDS or (trigger is Trigger.UNFIT and not self._readiness.enabled)
        if held and (holds or sticks):
            # Command a standstill while we wait for the mode: without setpoints, PX4's failsafe would act
            # before the next heartbeat.
            self._standstill.begin(now_s, self._own.mode, sticks=sticks)
        elif not sticks:
            self._standstill.end()
        if self.state is State.WATCHING:
            self._modes.left_in = frozenset()
        self._left, self._conflicts = False, 0
        asked = self._modes.asked if self._handback is None else self._handback.asked(now_s)
        self._obeyed_until_s = now_s + _OBEYED_LATE_S if held and asked else -math.inf
        return commands

    def _let_go(self, trigger: Trigger) -> list[Command]:
        """Release the vehicle.

        A vehicle that would fly the last setpoint for some seconds is asked to hold.
        """
        heartbeat = self._own.heartbeat
        self._modes.left_in = frozenset()
        if trigger in _HOLDS:
            return [SetMode(mode=FlightMode.HOLD)]
        if trigger is not Trigger.UNFIT:
            return []
        flies_on = heartbeat is not None and DIALECTS[heartbeat.firmware].flies_last_setpoint
        return self._modes.let_go(asks_hold=flies_on or not self._readiness.enabled)
