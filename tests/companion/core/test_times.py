"""How late the loop may be, and how long a fault lasts."""

from __future__ import annotations

import pytest

from companion.authority.table import HOLDING, State
from companion.events import FlightMode, ModeRefused


@pytest.mark.parametrize(
    ("rate_hz", "gap_s", "commands"),
    # A quarter of a second, or two and a half periods of the setpoints.
    [(20.0, 0.24, True), (20.0, 0.26, False), (5.0, 0.49, True), (5.0, 0.51, False)],
)
def test_a_late_step_commands_nothing(make_bench, rate_hz, gap_s, commands):
    bench = make_bench(setpoint_rate_hz=rate_hz)
    bench.until(lambda: bench.core.state is State.GUARDING and bench.mode is FlightMode.EXTERNAL)
    bench.step(20)
    bench.step(gap_s=gap_s)
    assert bool(bench.setpoints()) is commands
    assert bench.core.state in HOLDING
    bench.step(10)
    assert bench.core.state in HOLDING


@pytest.mark.parametrize(("gap_s", "fault"), [(0.98, False), (1.02, True)])
def test_a_loop_that_hung_for_a_second_is_a_fault(flying, gap_s, fault):
    flying.step(gap_s=gap_s)
    assert not flying.setpoints()
    assert (flying.core.state is State.FAULT) is fault


def lasted_s(bench):
    assert bench.core.state is State.FAULT
    began_s = bench.now_s
    bench.until(lambda: bench.core.state is not State.FAULT)
    return bench.now_s - began_s


def test_a_fault_ends_three_seconds_after_its_cause(flying):
    """A heartbeat a second shows by then which failsafe it triggered."""
    flying.fix_type = 1
    flying.step(40)
    flying.fix_type = 3
    assert lasted_s(flying) == pytest.approx(3.0, abs=0.06)


def test_a_refused_mode_is_a_fault_of_eight_seconds(make_bench):
    bench = make_bench()
    bench.obeys = False
    bench.until(lambda: bench.core.state is State.GUARDING)
    bench.step(20)
    bench.extra.append(ModeRefused(mode=FlightMode.EXTERNAL, reason="no answer"))
    bench.step()
    assert lasted_s(bench) == pytest.approx(8.0, abs=0.06)
