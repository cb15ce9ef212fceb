"""Which changes of authority the pilot is told of, how loudly, and in which words."""

from __future__ import annotations

from companion.authority.table import State
from companion.events import FlightMode, Say, Severity, TwoAutopilots
from tests.companion.core.conftest import intruder
from tests.companion.core.guarded.guarding import taken


def said(bench, state):
    """Severities and texts about a state."""
    head = f"DMUCA {state.value}: "
    told = [c for _, c in bench.log if isinstance(c, Say) and c.text.startswith(head)]
    return [(c.severity, c.text.removeprefix(head)) for c in told]


def test_a_vehicle_that_is_taken_and_a_pilot_who_takes_over(flying):
    ((severity, text),) = said(flying, State.GUARDING)
    assert severity is Severity.INFO
    assert text.startswith("taking control in mode ")
    flying.mode = FlightMode.OTHER
    flying.step()
    ((severity, text),) = said(flying, State.YIELDED)
    assert severity is Severity.WARNING
    assert text.endswith(", not by the companion")


def test_a_conflict_is_not_said_while_we_fly_as_alerts_tell_of_it(flying):
    for k in range(3):
        flying.extra.append(intruder(flying, 60.0 - 3.0 * k, 3.0))
        flying.step(20)
    assert flying.core.state is State.AVOIDING
    assert said(flying, State.AVOIDING) == []


def test_a_mission_that_is_guarded_taken_or_left(guarded):
    bench = guarded()
    assert said(bench, State.WATCHING) == [(Severity.INFO, "guarding the vehicle's mission")]
    assert said(taken(bench), State.AVOIDING) == [(Severity.INFO, "conflict with OTHER")]
    left = guarded()
    left.mode = FlightMode.OTHER
    left.step()
    ((severity, text),) = said(left, State.STANDBY)
    assert severity is Severity.INFO
    assert text.startswith("the vehicle left its mission for mode ")


def test_a_mission_whose_vehicle_may_be_anothers(guarded):
    bench = guarded()
    bench.extra.append(TwoAutopilots(reason="two autopilots"))
    bench.step()
    assert said(bench, State.STANDBY) == [
        (Severity.INFO, "two autopilots on the link, so it is unclear which one is ours")
    ]
