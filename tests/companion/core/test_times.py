"""How late the loop may be, and how long a fault lasts."""

from __future__ import annotations

import math

import msgspec
import pytest

from companion.authority.table import HOLDING, State
from companion.events import ClockRead, FlightMode, GlobalPosition, LocalPosition, ModeRefused, VehicleTime


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


OWN_STATE = (
    GlobalPosition(
        time_boot_s=100.0,
        lat_deg=47.0,
        lon_deg=8.0,
        alt_msl_m=450.0,
        height_above_home_m=50.0,
        velocity_ned_mps=(0.0, 0.0, 0.0),
    ),
    LocalPosition(time_boot_s=100.0, position_ned_m=(0.0, 0.0, -50.0), velocity_ned_mps=(0.0, 0.0, 0.0)),
    VehicleTime(time_boot_s=100.0, utc_s=1_767_225_600.0),
    ClockRead(time_boot_s=100.0, asked_s=0.9, heard_s=1.0),
)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(("event", "name"), [(e, name) for e in OWN_STATE for name in e.__struct_fields__])
def test_an_own_state_that_is_no_number_is_refused_by_its_name(make_bench, event, name, bad):
    good = getattr(event, name)
    value = (0.0, bad, 0.0) if isinstance(good, tuple) else bad
    core = make_bench().core
    with pytest.raises(
        ValueError, match=rf"^{type(event).__name__}\.{name} is .*, which is no finite number$"
    ):
        core.step(1.0, [ModeRefused(mode=FlightMode.HOLD, reason=""), _with(event, name, value)])
    core.step(0.5, [])  # The refused step is not the last one.


def _with(event, name, value):
    return msgspec.structs.replace(event, **{name: value})


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_time_that_is_no_number_is_refused(flying, bad):
    with pytest.raises(ValueError, match=r"^now_s is -?(nan|inf), which is no finite number$"):
        flying.core.step(bad, [])


def test_a_refused_step_takes_nothing_in(make_bench):
    benches = [make_bench(), make_bench()]
    for bench in benches:
        bench.until(lambda bench=bench: bool(bench.setpoints()))
    refused, twin = benches
    for _ in range(20):
        events = refused.events()
        broken = [_with(e, "lat_deg", math.nan) if isinstance(e, GlobalPosition) else e for e in events]
        with pytest.raises(ValueError, match=r"GlobalPosition\.lat_deg is nan"):
            refused.core.step(refused.now_s, broken)
        assert refused.step() == twin.step()
