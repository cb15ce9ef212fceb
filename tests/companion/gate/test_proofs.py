"""Theorems on the gate's bounds over the real numbers, and on authority over all histories.

Formulas are transcribed from `Bounds`; what is proved of them holds without rounding.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
import z3

from companion.config import Config
from companion.events import Firmware, FlightMode, Heartbeat
from companion.gate import bounds
from companion.gate.bounds import Bounds
from companion.gate.mandate import Mandate
from companion.gate.rules import Broken, Rule
from tests.companion.gate.flying import CUSTOM, config
from tests.companion.proving import prove, refute

REACTION, SLACK, BRAKES, BRAKING = (
    z3.RealVal(str(number))
    for number in (bounds._REACTION_S, bounds._SLACK_MPS, bounds._BRAKES, bounds._BRAKING)
)
A, V, W, T, ROOM, BEGUN, FLOWN = z3.Reals("a v w t room begun flown")


def limits(a: float) -> Bounds:
    return Bounds(config(limits={"max_acceleration_mps2": a, "max_speed_mps": 30.0}))


# ---------------------------------------------------------------- 12 and 13: what can be stopped

NEEDED = V * (REACTION + V / (2 * A))


def test_the_room_that_a_speed_needs_is_the_transcribed_one():
    rng = np.random.default_rng(1)
    for room, towards, a in rng.uniform((0.0, 0.01, 0.3), (60.0, 20.0, 8.0), (2000, 3)).tolist():
        needed = towards * (0.5 + towards / (2.0 * a))
        if abs(needed - room) > 1e-9:
            assert limits(a)._too_fast(0, room, towards, towards, 0.0) is (needed > room)


def test_what_passes_by_its_room_is_stopped_in_it():
    """A vehicle flies towards a bound at a speed that passes, for the reaction time and no faster, then
    brakes with the configured acceleration. At no moment has it flown farther than there is room."""
    flies = (A > 0, V >= 0, W >= 0, W <= V * REACTION, T >= 0, A * T <= V, ROOM >= 0)
    way = W + V * T - A * T * T / 2
    prove(way <= ROOM, *flies, NEEDED <= ROOM)
    refute(way <= ROOM, *flies, NEEDED <= ROOM + 1)


def test_what_passes_as_slowed_down_has_a_bounded_way():
    """A spell in which a vehicle is too fast and passes as being slowed down: what passes at its time t is
    less than begun - 0.9 a t, so that after begun / (0.9 a) nothing more towards the bound passes, and all
    that is commanded in between makes a way of begun^2 / (1.8 a) at most. Not proved: that the vehicle
    follows.
    """
    slowest = z3.If(FLOWN < BEGUN - BRAKES * A * T, FLOWN, BEGUN - BRAKES * A * T)
    passes = (A > 0, T >= 0, slowest - BRAKING * A >= V)
    prove(V <= BEGUN - BRAKES * A * T, *passes)
    prove(V < 0, *passes, BRAKES * A * T >= BEGUN)
    prove(
        BEGUN * T - BRAKES * A * T * T / 2 <= BEGUN * BEGUN / (2 * BRAKES * A), A > 0, T >= 0, BEGUN >= 0
    )  # the integral of the bound


# ---------------------------------------------------------------- 11: change

BUDGET, PASSED, CHANGED, TOTAL, SINCE, FIRST = z3.Reals("budget passed changed total since first")


def allowed(budget, passed, a):
    """`_allowed_mps`: the saved budget plus what the elapsed time adds, up to one second's worth."""
    saved = budget + a * z3.If(passed > 1, z3.RealVal(1), passed)
    return z3.If(saved > a, a, saved)


def left(budget, passed, changed, a):
    """The budget after a setpoint has left."""
    rest = allowed(budget, passed, a) - changed
    return z3.If(rest < -SLACK, -SLACK, rest)


def value(term: Any, **numbers: float) -> float:
    pairs = [(z3.Real(name), z3.RealVal(repr(float(number)))) for name, number in numbers.items()]
    return float(z3.simplify(z3.substitute(term, *pairs)).as_fraction())


def test_the_budget_is_the_transcribed_one():
    rng = np.random.default_rng(2)
    one, now_s, last = limits(2.0), 100.0, (0.0, 0.0, 0.0)
    one.left(last, now_s)
    for _ in range(200):
        passed, before = rng.choice([0.0, 0.05, 0.7, 1.4]) * rng.random(), one._budget_mps
        now_s += passed
        n, e = rng.normal(scale=rng.choice([0.02, 0.5]), size=2)
        last = last[0] + n, last[1] + e, 0.0
        one.left(last, now_s)
        expected = value(
            left(BUDGET, PASSED, CHANGED, A), budget=before, passed=passed, changed=math.hypot(n, e), a=2.0
        )
        assert one._budget_mps == pytest.approx(expected, abs=1e-9)


def test_the_change_of_a_chain_of_setpoints_is_bounded_in_every_window():
    """Any number of setpoints, at any times, that each pass by their change from the last one: within t
    seconds their changes add up to at most a (t + 1 s), plus the slack for rounding once.

    Inductive: total + budget <= budget at the window's beginning + a t, for a constant acceleration limit. A
    setpoint that passes by the velocity flown, or a standstill, begins another chain.
    """
    budget = z3.And(-SLACK <= BUDGET, BUDGET <= A)
    after = left(BUDGET, PASSED, CHANGED, A)
    prove(z3.And(after >= -SLACK, after <= A), A > 0, budget, PASSED >= 0, CHANGED >= 0)  # whatever leaves
    step = (A > 0, budget, PASSED >= 0, PASSED <= 1, CHANGED >= 0, SINCE >= 0)
    passes = allowed(BUDGET, PASSED, A) + SLACK >= CHANGED
    invariant = TOTAL + BUDGET <= FIRST + A * SINCE
    kept = TOTAL + CHANGED + after <= FIRST + A * (SINCE + PASSED)
    prove(kept, *step, passes, invariant)
    refute(kept, *step, invariant)
    prove(TOTAL <= A * (SINCE + 1) + SLACK, A > 0, budget, FIRST <= A, invariant)


# ---------------------------------------------------------------- 6: authority

EXTERNAL, MISSION, HOLD, STICKS, OTHER = (
    FlightMode.EXTERNAL,
    FlightMode.MISSION,
    FlightMode.HOLD,
    FlightMode.STICKS,
    FlightMode.OTHER,
)
ASKED = (EXTERNAL, MISSION, HOLD, STICKS)
PAUSE_S, ASKED_S = 11.0, 10.0


class History:
    """Who has authority, written from the words of rule 6 alone: it uses the reported modes and the commands
    that left, and none of the gate's code."""

    def __init__(self, use: str, rearm: str) -> None:
        self.use, self.rearm = use, rearm
        self.gives = EXTERNAL if use == "fly" else MISSION
        """The mode by which a pilot gives authority back, with rearm = "mode"."""
        self.told: FlightMode | None = None
        self.gone = False
        self.chosen: FlightMode | None = None
        """Mode that the pilot selected last, since authority was lost."""
        self.chosen_anew = False
        """True once a mode other than the one that gives authority was reported: the next report of that mode
        is the pilot's choice."""
        self.free()

    def free(self) -> None:
        self.gone, self.held = False, False
        self.waits: set[FlightMode] = set()
        """Modes that were requested and not reported while authority lasted, until a mode was reported 3 s
        later."""
        self.aged: set[FlightMode] = set()
        """Those of them that were requested more than 3 s ago."""
        self.overruled = False
        """The vehicle has obeyed such a request after the pilot selected his mode."""
        self.ours: dict[FlightMode, bool] = {}
        """Modes that do not show a pilot's action, with True for a mode that was requested less than 10 s ago
        and not reported yet. Reported modes stay."""
        self.taken_from: FlightMode | None = None
        self.asked_last: FlightMode | None = None
        self.let_alone = False
        """Nothing has left for longer than a request may take."""

    def tell(self, mode: FlightMode, armed: bool) -> None:
        before, self.told, aged = self.told, mode, self.aged
        self._tell(mode, armed, before)
        self.waits, self.aged = self.waits - aged, self.aged - aged

    def _tell(self, mode: FlightMode, armed: bool, before: FlightMode | None) -> None:
        if not armed and not (self.gone and self.rearm == "never"):
            self.free()
        if not self.gone:
            self.waits = self.waits - {mode}
        if self.held and not self.gone and mode is self.taken_from:
            if self.use == "guard" and mode is MISSION and self.let_alone:
                self.free()  # never entered our mode, and was let alone since
        elif self.held and not self.gone:
            if mode is MISSION and mode in self.ours and self.asked_last is not MISSION:
                self.taken_from = mode  # recalled: it is to be left again
                return
            if mode in self.ours or (self.use == "fly" and mode is EXTERNAL):
                self.ours[mode], self.taken_from = False, None
                if mode is MISSION:
                    self.free()  # handed back
                return
            self.gone, self.chosen = True, mode
            # If a mission is reported right after our own mode, it is unknown who selected it.
            self.chosen_anew = before is not EXTERNAL
        if self.gone:
            late = mode is not self.chosen and mode in self.waits
            self.overruled = late or (self.overruled and mode is before)
            if self.overruled:
                self.chosen_anew = self.chosen_anew and mode is not self.gives
                return
            self.chosen = mode
            if mode is self.gives and self.chosen_anew and self.rearm == "mode":
                self.free()
            self.chosen_anew = self.chosen_anew or mode is not self.gives

    def left(self, asked: FlightMode | None) -> None:
        """A setpoint (None) or a request for a mode has left."""
        if not self.held:
            self.held, self.taken_from = True, self.told
        self.let_alone = False
        if asked is not None:
            self.asked_last = asked
            self.waits, self.aged = self.waits | {asked}, self.aged - {asked}
            if self.ours.get(asked) is not False:
                self.ours[asked] = True

    def restores(self, asked: FlightMode | None) -> bool:
        """Whether a request gives the vehicle back to the mode that the pilot has selected."""
        return self.overruled and asked is self.chosen and asked is not EXTERNAL

    def pause(self) -> None:
        self.let_alone, self.aged = True, self.waits
        self.ours = {mode: False for mode, waits in self.ours.items() if not waits}

    def key(self) -> tuple[object, ...]:
        """Everything that determines the further history. A mode stands for itself by its identity, because
        its own hash is computed in Python each time."""
        return (
            id(self.told), self.gone, self.gone and self.chosen_anew, self.held, id(self.taken_from),
            id(self.asked_last), self.let_alone, id(self.gone and self.chosen), self.overruled,
            frozenset(map(id, self.waits)), frozenset(map(id, self.aged)),
            frozenset((id(mode), waits) for mode, waits in self.ours.items()),
        )  # fmt: skip


Event = tuple[str, FlightMode | None, bool]
EVENTS: list[Event] = [
    *(("told", mode, armed) for mode in FlightMode for armed in (True, False)),
    *(("asks", mode, True) for mode in ASKED),
    ("flies", None, True),
    ("pause", None, True),
]
COMMANDS = ("asks", "flies")


@cache
def beat_of(firmware: Firmware, mode: FlightMode, armed: bool) -> Heartbeat:
    custom = CUSTOM[firmware][mode]
    return Heartbeat(
        system_id=1, firmware=firmware, vehicle_type=2, custom_mode=custom, mode=mode, armed=armed
    )


def leaves(event: Event, mandate: Mandate, history: History, firmware: Firmware, now_s: float) -> bool:
    """Whether the mandate lets a command leave. Where it does not, nothing changes."""
    _, mode, _ = event
    try:
        mandate.check(now_s, None if mode is None else CUSTOM[firmware][mode])
        if mode is None:
            mandate.check_setpoint(standing=False)
        else:
            mandate.check_request(mode, now_s)
    except Broken:
        return False
    assert not history.gone or history.restores(mode), "something has left without authority"
    return True


def happen(event: Event, mandate: Mandate, history: History, firmware: Firmware, now_s: float) -> float:
    """Pass one event to the mandate and the history, a command only if it leaves. Returns the time after
    it."""
    what, mode, armed = event
    if what == "pause":
        history.pause()
        return now_s + PAUSE_S
    if what == "told":
        assert mode is not None
        mandate.hear_mode_message(beat_of(firmware, mode, armed), now_s, overtaken=False)
        history.tell(mode, armed)
        return now_s
    if mode is None:
        mandate.setpoint_left(now_s)
    else:
        mandate.request_left(CUSTOM[firmware][mode], now_s)
    history.left(mode)
    return now_s


def judge(mandate: Mandate, history: History, now_s: float) -> None:
    """Authority is refused exactly where it is gone."""
    refused = None
    try:
        mandate.check(now_s)
    except Broken as broken:
        refused = broken.rule
    assert not (history.gone and refused is None)
    assert (mandate.lost is not None) is history.gone
    assert refused in (None, Rule.USE, Rule.CURRENT) or history.gone


def snapshot(mandate: Mandate, now_s: float) -> tuple[object, ...]:
    """Everything that determines the mandate's further behaviour, with times relative to now."""
    beat = mandate.heartbeat
    return (
        beat and (beat.armed, id(beat.mode)), mandate.lost is None, mandate.engaged, id(mandate._mode),
        now_s - mandate._mode_s > 3.0, mandate._base, mandate._left, mandate._held_instead,
        mandate._seen_down, mandate._asked, mandate.lost and mandate._chosen, mandate._obeyed_late,
        frozenset((c, now_s > at_s) for c, at_s in mandate._waits_s.items() if mandate._mode_s - at_s <= 3.0),
        now_s - mandate._commanded_s > ASKED_S,
        frozenset((custom, max(until_s - now_s, -1.0)) for custom, until_s in mandate._ours.items()),
    )  # fmt: skip


def shallow(one: Any) -> Any:
    """Same as `copy.copy`, in a third of the time."""
    other = object.__new__(type(one))
    other.__dict__.update(one.__dict__)
    return other


def copied(mandate: Mandate) -> Mandate:
    other: Mandate = shallow(mandate)
    other._ours, other._waits_s = dict(mandate._ours), dict(mandate._waits_s)
    other._requests = []  # how many requests leave at once is another rule's matter
    return other


def explore(configured: Config, firmware: Firmware, mandate_type: type[Mandate] = Mandate) -> int:
    """Judge every state that any sequence of the events leads to. Returns the number of states."""
    flight = configured.flight
    first = mandate_type(configured), History(flight.use, flight.rearm), 100.0
    seen, front = {(snapshot(first[0], first[2]), first[1].key())}, [first]
    while front:
        mandate, history, now_s = front.pop()
        for event in EVENTS:
            if event[0] in COMMANDS and not leaves(event, mandate, history, firmware, now_s):
                continue
            after, following = copied(mandate), shallow(history)
            following.ours = dict(history.ours)
            then_s = happen(event, after, following, firmware, now_s)
            key = snapshot(after, then_s), following.key()
            if key not in seen:
                seen.add(key)
                judge(after, following, then_s)
                front.append((after, following, then_s))
    return len(seen)


@pytest.mark.parametrize("use", ["fly", "guard"])
@pytest.mark.parametrize(
    ("rearm", "firmware"),
    [
        ("mode", Firmware.ARDUPILOT),
        ("mode", Firmware.PX4),
        ("disarm", Firmware.PX4),
        ("never", Firmware.ARDUPILOT),
    ],
)
def test_authority_is_gone_until_what_rearm_names(firmware, use, rearm):
    """All sequences, of any length, of 16 events: a report of one of five modes, armed or not; a request for
    one of four modes; a setpoint; a pause of 11 s. The other events take no time. Sequences that lead to the
    same state are followed once. Other mode numbers, the landed state and the end of a mission are not among
    the events. The firmwares differ in the numbers of their modes and in the hold that is a choice of the
    pilot; so the rules that do not tell by a mode who has authority again are examined with one of them.
    """
    assert explore(config(use, rearm=rearm, take_in_flight=True), firmware) > 600


class Forgetful(Mandate):
    """Forgets that authority has ended when a requested mode is reported."""

    def hear_mode(self, custom: int, mode: FlightMode, now_s: float) -> None:
        if custom in self._ours:
            self.lost = None
        super().hear_mode(custom, mode, now_s)


def test_a_mandate_that_forgets_is_found():
    with pytest.raises(AssertionError):
        explore(config("fly", take_in_flight=True), Firmware.PX4, Forgetful)
