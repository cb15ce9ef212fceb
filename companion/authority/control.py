"""Takes the vehicle, keeps it, lets it go: what moves the authority table, and what each move does."""

from __future__ import annotations

import math

from companion.authority.guard import GuardPlan
from companion.authority.handback import HandBack
from companion.authority.plan import Plan
from companion.authority.readiness import Readiness, mode_name
from companion.authority.sticks import Sticks
from companion.authority.table import HOLDING, State, Trigger, next_state
from companion.avoidance.law import LawResult
from companion.config import Config
from companion.events import (
    AuthorityChanged,
    Command,
    Firmware,
    FlightMode,
    Landed,
    ModeRefused,
    RcChannels,
    Say,
    SetMode,
    Severity,
)
from companion.ownship import Ownship
from companion.settings import SWITCHED_OFF

_NOT_GUARDED = frozenset({Landed.TAKEOFF, Landed.LANDING})
"""Parts of a guarded mission that the vehicle is not taken out of."""
_HUNG_S = 1.0
_HEALTHY_AFTER_S = 3.0
"""A fault lasts longer than the slowest heartbeat that shows which failsafe it caused: to PX4, setpoints that
come again are a wish to go on."""
_REFUSED_PAUSE_S = 8.0
"""After a refused mode change, before the vehicle is asked again."""
_STREAM_FIRST_S = 0.5
"""PX4 enters OFFBOARD only while setpoints already stream."""
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
_BRAKING_S = 3.0
"""Who switches off wants the vehicle to stop, not to meet what an autopilot does when setpoints end: for so
long at most it is commanded to stand, until it holds by itself."""
_STICKS_S = 10.0
"""The same for a mode that takes sticks: longer than it is asked for, so that where the vehicle refuses it a
hold can be asked for instead."""


class Control:
    """Who flies one aircraft.

    At every step `judge`, and then, by the state: `watched`; or `give_back`, `decided` where the law decides
    anew, and `keep`; or `stands`.

    Args:
        config: only what no ground station may set is used.
    """

    def __init__(self, config: Config, own: Ownship, plan: Plan, readiness: Readiness) -> None:
        self.state = State.STANDBY
        self.ours: frozenset[FlightMode] = frozenset()
        """Modes that the vehicle may be in by our own doing, after a fault ended our flight."""
        self._config = config
        self._own = own
        self._plan = plan
        self._readiness = readiness
        self._clear_after_s = config.avoidance.n_noncollide * config.avoidance.period_s
        self._handback = HandBack(plan, own, self._clear_after_s) if isinstance(plan, GuardPlan) else None
        """Of a mission that is guarded; None: none is."""
        self._sticks = Sticks()
        self._conflict_s = self._commanded_s = -math.inf
        self._conflicts = 0
        """Decisions in a row, while a mission is guarded, that saw one."""
        self._mode_confirmed = False
        self._stream_s: float | None = None
        self._custom_before: int | None = None
        self._refused: str | None = None
        self._healthy_s = -math.inf
        """From when on a fault may end."""
        self._left = False
        """The pilot has left the mode by which he gives authority."""
        self._stand_until_s = -math.inf
        self._stood_in: FlightMode | None = None
        """Mode that the vehicle was last seen in while it is commanded to stand."""

    @property
    def in_control(self) -> bool:
        """The vehicle flies what we command."""
        return self.state in HOLDING and self._mode_confirmed

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

    def unfit(self, now_s: float, gap_s: float) -> str | None:
        """Why nothing is to be commanded, in words; None when nothing is against it.

        Args:
            gap_s: since the last step.
        """
        if gap_s > _HUNG_S or (self.state in HOLDING and now_s - self._commanded_s > _HUNG_S):
            return f"the loop is late: nothing commanded for {_HUNG_S:g} s"
        return self._own.unfit(now_s, self._config.vehicle.stale_after_s)

    def judge(self, now_s: float, unfit: str | None) -> list[Command]:
        """What the vehicle's state says about who flies.

        Args:
            unfit: as `unfit` says.
        """
        ended = unfit if self._readiness.enabled else SWITCHED_OFF
        if ended is not None:
            self._healthy_s = now_s + _HEALTHY_AFTER_S
        elif self._refused is not None:
            self._healthy_s = now_s + _REFUSED_PAUSE_S
        commands = self._move(now_s, self._triggers(now_s, ended), unfit=ended)
        self._refused = None
        return commands

    def watched(self, now_s: float, result: LawResult) -> list[Command]:
        """The autopilot flies its mission: would the law fly something else?"""
        guarded = self._own.landed(now_s) not in _NOT_GUARDED
        self._conflicts = self._conflicts + 1 if result.conflict and guarded else 0
        if self._conflicts < _SURE:
            return []
        commands = self._move(now_s, frozenset({Trigger.CONFLICT}), result=result)
        # The way to the item may end short of what the mission flies into: it counts all the same.
        self._conflict_s = now_s
        return commands

    def decided(self, now_s: float, result: LawResult) -> list[Command]:
        """What the law flies now. Needs a law."""
        if self._handback is not None:
            self._handback.note_way(now_s)
        if result.conflict:
            self._conflict_s = now_s
        return self._move(now_s, self._law_triggers(now_s, result), result=result)

    def give_back(self, now_s: float) -> list[Command]:
        """A guarded vehicle on its way goes back to its mission."""
        if self._handback is None or self.state is not State.GUARDING or not self._mode_confirmed:
            return []
        commands, over = self._handback.ask(now_s, now_s - self._conflict_s)
        return commands + self._move(now_s, frozenset({Trigger.CHANGED})) if over else commands

    def keep(self, now_s: float) -> list[Command]:
        """The vehicle is commanded now: get it to take setpoints, once they stream."""
        self._commanded_s = now_s
        if self._own.mode is FlightMode.EXTERNAL:
            if not self._mode_confirmed:
                self._plan.engage(now_s)
            self._mode_confirmed = True
        elif self._mode_confirmed:
            # The mission that was asked for is entered after all, and there is a conflict again.
            self._seek_mode(now_s)
        elif self._stream_s is not None and now_s - self._stream_s >= _STREAM_FIRST_S:
            self._stream_s = None
            return [SetMode(mode=FlightMode.EXTERNAL)]
        return []

    def stands(self, now_s: float) -> bool:
        """The vehicle that was let go is still to be commanded to stand: until the mode that was asked for
        shows, or any other, and then never again."""
        mode = self._own.mode
        if mode is FlightMode.EXTERNAL:
            self._stood_in = mode
        elif mode is not self._stood_in:
            self._stand_until_s = -math.inf
        return now_s < self._stand_until_s and mode is FlightMode.EXTERNAL

    # ------------------------------------------------------------ what moves it

    def _triggers(self, now_s: float, unfit: str | None) -> frozenset[Trigger]:
        """What the vehicle's state says about authority."""
        own, handback, rearm = self._own, self._handback, self._config.flight.rearm
        found = set()
        if own.mode not in self.ours:
            self.ours = frozenset()
        if self._pilot_took_over(now_s) or self._sticks.moved:
            found.add(Trigger.PILOT)
        if unfit is not None or self._refused is not None:
            found.add(Trigger.UNFIT)
        if self._readiness.down(now_s):
            found.add(Trigger.RELEASE)
        if now_s >= self._healthy_s:
            found.add(Trigger.HEALTHY)
        on_mission = own.mode is FlightMode.MISSION
        given = own.mode is FlightMode.EXTERNAL if handback is None else on_mission
        self._left = self._left or not given
        disarmed = own.heartbeat is not None and not own.armed
        if (rearm == "disarm" and disarmed) or (rearm == "mode" and given and self._left):
            found.add(Trigger.REARM)
        standing_by = self.state is State.STANDBY and self._plan.ready
        ready = standing_by and self._readiness.waits_for(now_s, self.ours) is None
        if ready and self._plan.near(own, now_s):
            found.add(Trigger.WATCH if handback is not None and on_mission else Trigger.READY)
        if handback is not None and handback.ended(now_s):
            found.add(Trigger.ENDED)
        if handback is not None and not on_mission:
            found.add(Trigger.LEFT)
        elif handback is not None and handback.asked(now_s):
            # Not before it was asked for: the vehicle may be in our mode already, and not have said so.
            found.add(Trigger.RESUMED)
        if self.state is State.WATCHING and self._readiness.unclear is not None:
            found.add(Trigger.LEFT)
        return frozenset(found)

    def _pilot_took_over(self, now_s: float) -> bool:
        """A mode that we did not command: any but the one we asked for and, until that is confirmed, the one
        we took the vehicle from."""
        mode = self._own.mode
        if mode is None or mode in self.ours | {FlightMode.EXTERNAL}:
            return False
        if self._handback is not None and self._handback.obeyed(now_s):
            return False
        return not self._being_taken

    @property
    def _being_taken(self) -> bool:
        """The vehicle is still in the mode that we are taking it from."""
        heartbeat = self._own.heartbeat
        assert heartbeat is not None
        return not self._mode_confirmed and heartbeat.custom_mode == self._custom_before

    @property
    def _asks_sticks(self) -> bool:
        """The pilot moves the sticks and has chosen no mode: the vehicle is in ours, in the hold that our
        fault asked for, or still in the one that we are taking it from. He gets one that takes the sticks."""
        mode = self._own.mode
        if mode is None or not self._sticks.moved:
            return False
        if mode is FlightMode.EXTERNAL:
            return True
        if self.ours:
            return mode is FlightMode.HOLD and mode in self.ours
        return self._being_taken

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
        triggers: frozenset[Trigger],
        *,
        unfit: str | None = None,
        result: LawResult | None = None,
    ) -> list[Command]:
        moved = next_state(self.state, triggers)
        if moved is None:
            return []
        previous, (self.state, trigger) = self.state, moved
        reason = self._reason(now_s, trigger, unfit, result)
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
        elif trigger is Trigger.CONFLICT and handback is not None and handback.asked(now_s):
            # The mission may still be entered: what was asked for last counts.
            commands.append(SetMode(mode=FlightMode.EXTERNAL))
        if trigger in _TOLD or previous is State.WATCHING:
            severity = Severity.WARNING if trigger in _TOLD_LOUDLY else Severity.INFO
            commands.append(Say(severity=severity, text=f"DMUCA {self.state.value}: {reason}"))
        if self.state not in HOLDING:
            commands += self._end(now_s, trigger, held)
        return commands

    def _begin(self, now_s: float) -> list[Command]:
        """The vehicle is taken."""
        commands = [] if self._handback is None else self._handback.begin(now_s)
        self._sticks.begin()
        self.ours = frozenset()
        self._conflict_s = -math.inf
        self._commanded_s = now_s
        self._seek_mode(now_s)
        return commands

    def _seek_mode(self, now_s: float) -> None:
        """Our mode is to be entered, from the one that the vehicle is in."""
        heartbeat = self._own.heartbeat
        self._mode_confirmed, self._stream_s = False, now_s
        self._custom_before = None if heartbeat is None else heartbeat.custom_mode

    def _end(self, now_s: float, trigger: Trigger, held: bool) -> list[Command]:
        """Nothing is commanded: not any more, where the vehicle was held."""
        commands: list[Command] = []
        if trigger is Trigger.RESUMED and self._handback is not None:
            commands += self._handback.resumed(now_s)
        if trigger is Trigger.REARM and self._own.position is not None:
            self._plan.resume(self._own, now_s)
        sticks = trigger is Trigger.PILOT and self._asks_sticks
        if sticks:
            commands.append(SetMode(mode=FlightMode.STICKS))
        if held:
            commands += self._let_go(trigger)
        holds = trigger is Trigger.CHANGED or (trigger is Trigger.UNFIT and not self._readiness.enabled)
        if held and (holds or sticks):
            # Waited for standing: PX4's own failsafe is quicker than the next heartbeat.
            self._stand_until_s = now_s + (_STICKS_S if sticks else _BRAKING_S)
            self._stood_in = self._own.mode
        elif not sticks:
            self._stand_until_s = -math.inf
        if self.state is State.WATCHING:
            self.ours = frozenset()
        self._left, self._conflicts = False, 0
        return commands

    def _let_go(self, trigger: Trigger) -> list[Command]:
        """PX4 notices at once that nothing is commanded any more; ArduPilot would fly on for seconds as it
        was commanded last, so it is asked to stop."""
        heartbeat, mode = self._own.heartbeat, self._own.mode
        external = mode is FlightMode.EXTERNAL
        self.ours = frozenset()
        if trigger is Trigger.CHANGED:
            return [SetMode(mode=FlightMode.HOLD)]
        if trigger is not Trigger.UNFIT:
            return []
        if mode is not None and not external and not self._mode_confirmed:
            # Our mode may be entered unseen.
            self.ours = frozenset({mode, FlightMode.EXTERNAL})
        elif external:
            self.ours = frozenset({FlightMode.EXTERNAL})
            ardupilot = heartbeat is not None and heartbeat.firmware is Firmware.ARDUPILOT
            if ardupilot or not self._readiness.enabled:
                self.ours |= {FlightMode.HOLD}
                return [SetMode(mode=FlightMode.HOLD)]
        return []

    # ------------------------------------------------------------ in words

    def _reason(self, now_s: float, trigger: Trigger, unfit: str | None, result: LawResult | None) -> str:
        handback = self._handback
        match trigger:
            case Trigger.PILOT:
                return self._what_the_pilot_did(now_s)
            case Trigger.UNFIT:
                return unfit or f"mode not entered: {self._refused}"
            case Trigger.READY:
                return f"taking the vehicle from mode {mode_name(self._own)}"
            case Trigger.LEFT if self._readiness.unclear is None:
                return f"the mission was left for mode {mode_name(self._own)}"
            case Trigger.RESUMED if handback is not None:
                return handback.how(now_s)
            case Trigger.ENDED:
                return f"the mission came to its end as it was given back, in mode {mode_name(self._own)}"
            case Trigger.CHANGED if handback is not None:
                return handback.why_not
            case Trigger.CONFLICT if result is not None:
                return "conflict with " + ", ".join(t.track_id for t in result.tracks if t.conflict)
        return _REASONS[trigger]

    def _what_the_pilot_did(self, now_s: float) -> str:
        if not self._pilot_took_over(now_s):
            return "the pilot moves the sticks"
        changed = f"mode changed to {mode_name(self._own)}"
        if self._handback is not None and self._handback.ends_in_hold(now_s):
            return f"{changed} as the mission was given back: by its end, or by the pilot"
        return f"{changed}, not by us"
