"""An autopilot that restarts in flight reports that it is disarmed. That is no landing."""

from __future__ import annotations

import pytest

from companion.authority.table import State
from companion.events import FlightMode, Landed
from tests.companion.conftest import UTC_AT_ZERO_S


def restart(bench, disarmed_s):
    """The autopilot is silent for two seconds, and then disarmed for a while, without a position."""
    bench.silent = True
    bench.step(40)
    bench.silent, bench.boot_offset_s = False, 1.0 - bench.now_s
    bench.armed, bench.landed, bench.mode = False, Landed.ON_GROUND, FlightMode.OTHER
    bench.stuck_position = True
    bench.step(round(disarmed_s / 0.05))


def flies_on(bench, mode):
    bench.armed, bench.landed, bench.mode = True, Landed.IN_AIR, mode
    bench.stuck_position = False
    bench.step(100)


def pilot_takes_over(bench):
    bench.until(lambda: bench.core.in_control)
    bench.step(5)
    bench.mode = FlightMode.STICKS
    bench.step(20)


@pytest.mark.parametrize("rearm", ["disarm", "mode"])
def test_a_restart_in_flight_gives_no_authority_back(make_bench, rearm):
    bench = make_bench(rearm=rearm)
    pilot_takes_over(bench)
    restart(bench, 5.0)
    flies_on(bench, FlightMode.MISSION)
    assert bench.core.state is State.YIELDED


def test_a_vehicle_that_stays_disarmed_after_a_restart_has_landed(make_bench):
    bench = make_bench()
    pilot_takes_over(bench)
    restart(bench, 11.0)
    flies_on(bench, FlightMode.MISSION)
    assert bench.core.in_control


def test_one_disarmed_heartbeat_before_a_long_silence_is_no_landing(make_bench):
    bench = make_bench()
    pilot_takes_over(bench)
    restart(bench, 0.05)
    bench.silent = True
    bench.step(400)
    bench.silent = False
    flies_on(bench, FlightMode.MISSION)
    assert bench.core.state is State.YIELDED


def test_a_restart_in_flight_is_no_landing_of_a_vehicle_that_was_flying_at_the_start(make_bench):
    bench = make_bench(take_in_flight=False)
    bench.step(20)
    restart(bench, 5.0)
    flies_on(bench, FlightMode.MISSION)
    assert bench.core.state is State.STANDBY


def test_a_gap_in_the_link_before_the_landing_takes_nothing_from_it(make_bench):
    bench = make_bench()
    pilot_takes_over(bench)
    bench.silent = True
    bench.step(40)
    bench.silent = False
    bench.step(20)
    bench.armed, bench.landed = False, Landed.ON_GROUND
    bench.step(2)
    assert bench.core.state is State.STANDBY


def test_a_clock_that_wraps_after_49_days_is_taken_for_a_restart_and_flight_goes_on(make_bench):
    """MAVLink counts milliseconds since boot in 32 bits."""
    wrap_s, after_s = 2**32 / 1000.0, 10.0
    bench = make_bench()
    bench.boot_offset_s = wrap_s - after_s
    bench.until(lambda: bench.core.state is State.GUARDING)
    bench.until(lambda: bench.now_s >= after_s)
    bench.boot_offset_s -= wrap_s
    bench.step(2)
    assert bench.core.state is State.FAULT
    bench.step(100)
    assert bench.core.in_control
    assert bench.core.own.age_s(bench.now_s) < 0.1
    assert bench.core.own.utc_offset_s == pytest.approx(UTC_AT_ZERO_S)
