"""The core: who flies, when setpoints leave, what goes on the air."""

from __future__ import annotations

import math

import msgspec
import pytest

from companion.authority.table import HOLDING, State
from companion.autopilot.dialect import DIALECTS
from companion.core import Companion
from companion.decider import Decider
from companion.events import (
    AuthorityChanged,
    Broadcast,
    CurrentMode,
    Firmware,
    FlightMode,
    Heartbeat,
    Landed,
    ModeRefused,
    Say,
    SetMode,
    Severity,
    VelocitySetpoint,
)
from companion.remote_id import codec
from tests.companion.core.conftest import UTC_AT_ZERO_S, intruder


def changes(commands):
    return [c for c in commands if isinstance(c, AuthorityChanged)]


def test_takes_a_ready_vehicle_streams_before_asking_and_flies_the_path(make_bench):
    bench = make_bench()
    bench.until(lambda: any(isinstance(c, SetMode) for _, c in bench.log))
    first_mode = next(t for t, c in bench.log if isinstance(c, SetMode))
    first_setpoint = next(t for t, c in bench.log if isinstance(c, VelocitySetpoint))
    # PX4 enters OFFBOARD only while setpoints already stream.
    assert first_mode - first_setpoint >= 0.4
    bench.step(100)
    north, east, down = bench.setpoints()[-1].velocity_ned_mps
    assert north > 2.5
    assert abs(east) < 0.1
    assert abs(down) < 0.1


@pytest.mark.parametrize(
    ("change", "value"),
    [
        ("armed", False),
        ("landed", Landed.ON_GROUND),
        ("landed", Landed.TAKEOFF),
        ("mode", FlightMode.OTHER),
        ("fix_type", 2),
        ("stuck_position", True),
    ],
)
def test_a_vehicle_that_is_not_ready_is_not_taken(make_bench, change, value):
    bench = make_bench()
    setattr(bench, change, value)
    commands = bench.step(100)
    assert bench.core.state is State.STANDBY
    assert not bench.setpoints(commands)
    assert not any(isinstance(c, SetMode) for c in commands)


def test_watch_never_commands(make_bench):
    bench = make_bench(use="watch")
    commands = bench.step(200)
    assert not bench.setpoints(commands)
    assert not any(isinstance(c, SetMode) for c in commands)
    assert any(isinstance(c, Broadcast) for c in commands)


def test_the_pilot_wins_at_once_and_for_good(flying):
    flying.mode = FlightMode.OTHER
    assert not flying.setpoints(flying.step())
    assert flying.core.state is State.YIELDED
    flying.mode = FlightMode.EXTERNAL
    assert not flying.setpoints(flying.step(200))
    assert flying.core.state is State.YIELDED


def test_the_pilot_who_lands_and_disarms_gives_authority_back(flying):
    flying.mode = FlightMode.OTHER
    flying.step(5)
    flying.landed, flying.armed = Landed.ON_GROUND, False
    flying.step(5)
    assert flying.core.state is State.STANDBY
    flying.landed, flying.armed, flying.mode = Landed.IN_AIR, True, FlightMode.HOLD
    flying.until(lambda: flying.core.state is State.GUARDING)


def test_rearm_by_mode_needs_the_pilot_to_select_the_external_mode(make_bench):
    bench = make_bench(rearm="mode")
    bench.until(lambda: bench.mode is FlightMode.EXTERNAL)
    bench.step(5)
    bench.mode = FlightMode.HOLD
    bench.step(100)
    assert bench.core.state is State.YIELDED
    bench.mode = FlightMode.EXTERNAL
    bench.step(2)
    assert bench.core.state in HOLDING


@pytest.mark.parametrize("steps", [20, 21, 22, 23])
def test_what_was_decided_before_the_pilot_flew_is_not_flown_after(make_bench, steps):
    bench = make_bench(rearm="mode")
    bench.until(lambda: bench.core.in_control)
    bench.step(steps)
    assert bench.setpoints()[0].velocity_ned_mps[1] == pytest.approx(0.0, abs=1e-3)
    bench.mode = FlightMode.OTHER
    bench.step(20)
    bench.mode, bench.east_m = FlightMode.EXTERNAL, 5.0
    bench.until(lambda: bench.core.state in HOLDING)
    assert bench.setpoints()[0].velocity_ned_mps[1] < -0.01


def test_rearm_never_survives_a_landing(make_bench):
    bench = make_bench(rearm="never")
    bench.until(lambda: bench.mode is FlightMode.EXTERNAL)
    bench.step(5)
    bench.mode = FlightMode.HOLD
    bench.step(5)
    bench.armed = False
    bench.step(5)
    bench.armed = True
    bench.step(100)
    assert bench.core.state is State.YIELDED


@pytest.mark.parametrize(
    ("change", "value", "within_s"),
    [("stuck_position", True, 1.2), ("silent", True, 1.2), ("fix_type", 1, 0.1)],
)
def test_a_stale_own_state_ends_the_setpoints(flying, change, value, within_s):
    setattr(flying, change, value)
    flying.step(round(within_s / 0.05))
    assert flying.core.state is State.FAULT
    assert not flying.setpoints(flying.step(100))


def test_a_fault_that_has_gone_leads_through_standby(flying):
    flying.stuck_position = True
    flying.step(40)
    flying.stuck_position = False
    flying.until(lambda: flying.core.state in HOLDING)
    states = [c.state for c in changes([c for _, c in flying.log])]
    assert states[states.index("fault") :][:3] == ["fault", "standby", "guarding"]


def test_a_late_loop_commands_nothing_in_that_step(flying):
    assert not flying.setpoints(flying.step(gap_s=0.6))
    assert flying.setpoints(flying.step())
    assert not flying.setpoints(flying.step(gap_s=1.2))
    assert flying.core.state is State.FAULT


def test_a_start_in_flight_takes_nothing_until_the_vehicle_has_been_down(make_bench):
    bench = make_bench(take_in_flight=False)
    said = [c.text for c in bench.step(100) if isinstance(c, Say) and c.severity is Severity.WARNING]
    assert said == [
        "DMUCA: cannot take control: vehicle was flying when the companion started and must land "
        "first (flight.take_in_flight)"
    ]
    assert bench.core.state is State.STANDBY
    bench.landed, bench.armed = Landed.ON_GROUND, False
    bench.step(10)
    bench.landed, bench.armed = Landed.IN_AIR, True
    bench.until(lambda: bench.core.state is State.GUARDING)


@pytest.mark.parametrize("mode", [FlightMode.HOLD, FlightMode.MISSION, FlightMode.EXTERNAL])
def test_a_hold_that_a_failsafe_caused_is_not_ended(make_bench, mode):
    """PX4 holds for a lost radio or ground station, and before it returns."""
    bench = make_bench()
    bench.mode, bench.failsafe = mode, True
    bench.step(100)
    assert (bench.core.state in HOLDING) is (mode is not FlightMode.HOLD)
    if mode is FlightMode.HOLD:
        assert "a failsafe may have selected" in bench.core.waits_for(bench.now_s)
        bench.failsafe = False  # The pilot has selected the hold himself since.
        bench.until(lambda: bench.core.state is State.GUARDING)


def test_a_hold_between_two_heartbeats_is_taken_only_once_the_next_one_shows_no_failsafe(make_bench):
    """CURRENT_MODE comes at once, and does not say why the mode has changed."""
    bench = make_bench()
    bench.mode = FlightMode.OTHER
    bench.step(40)
    heartbeat, events = DIALECTS[Firmware.PX4].commands[FlightMode.HOLD], bench.events
    bench.events = lambda: [e for e in events() if not isinstance(e, Heartbeat)]
    bench.extra = [CurrentMode(custom_mode=heartbeat.custom_mode)]
    bench.step(20)
    assert bench.core.own.mode is FlightMode.HOLD
    assert bench.core.state is State.STANDBY
    bench.events, bench.mode = events, FlightMode.HOLD
    bench.until(lambda: bench.core.state is State.GUARDING)


@pytest.mark.parametrize(
    ("mode", "taken"),
    [
        (FlightMode.HOLD, False),
        (FlightMode.OTHER, False),
        (FlightMode.EXTERNAL, True),
        (FlightMode.MISSION, True),
    ],
)
def test_ardupilot_is_never_taken_from_loiter_or_brake(make_bench, mode, taken):
    bench = make_bench()
    bench.firmware, bench.mode = Firmware.ARDUPILOT, mode
    bench.step(100)
    assert (bench.core.state in HOLDING) is taken


def test_another_hold_mode_while_asking_is_the_pilot(make_bench):
    """LOITER and BRAKE are both HOLD; going from one to the other is the pilot's act."""
    bench = make_bench()
    bench.obeys = False
    bench.until(lambda: bench.core.state is State.GUARDING)
    bench.custom_mode = 17
    bench.step()
    assert bench.core.state is State.YIELDED
    bench.extra = [ModeRefused(mode=FlightMode.EXTERNAL, reason="went to another mode")]
    assert not bench.setpoints(bench.step(400))
    assert bench.core.state is State.YIELDED


def test_too_far_from_the_path_is_not_taken_and_said_once(make_bench):
    bench = make_bench(start_within_m=50.0)
    bench.east_m = 80.0
    said = [c.text for c in bench.step(400) if isinstance(c, Say)]
    assert bench.core.state is State.STANDBY
    assert said == ["DMUCA: path refused: vehicle is more than 50 m from its place on the path"]
    bench.east_m = 20.0
    bench.until(lambda: bench.core.state in HOLDING)
    bench.step(10)
    assert bench.core.state is State.RECOVERING


def test_a_loop_that_is_always_late_is_a_fault_not_a_guard(flying):
    commands = flying.step(8, gap_s=0.3)
    assert not flying.setpoints(commands)
    assert flying.core.state is State.FAULT


def test_the_path_clock_waits_for_the_vehicle_to_obey(make_bench):
    bench = make_bench()
    bench.obeys = False
    bench.step(60)
    assert bench.core.state in HOLDING
    assert bench.core.plan.course.path_time_s(bench.now_s) == 0.0
    bench.mode = FlightMode.EXTERNAL
    bench.step(21)
    assert bench.core.plan.course.path_time_s(bench.now_s) == pytest.approx(1.0, abs=0.1)


def test_given_back_in_flight_the_path_goes_on_from_its_nearest_point(make_bench):
    bench = make_bench(rearm="mode")
    bench.until(lambda: bench.mode is FlightMode.EXTERNAL)
    bench.step(5)
    bench.mode = FlightMode.HOLD
    bench.step(200)
    for k in range(100):
        bench.north_m = 3.0 * k
        bench.step()
    bench.mode = FlightMode.EXTERNAL
    bench.step(3)
    assert bench.core.state in HOLDING
    assert bench.core.plan.course.path_time_s(bench.now_s) == pytest.approx(99.0, abs=1.0)


def test_the_path_clock_starts_anew_with_each_flight(flying):
    flying.step(600)
    flying.landed, flying.armed, flying.mode = Landed.ON_GROUND, False, FlightMode.HOLD
    flying.step(20)
    flying.landed, flying.armed = Landed.IN_AIR, True
    flying.until(lambda: flying.core.state is State.GUARDING)
    assert flying.core.plan.course.path_time_s(flying.now_s) == pytest.approx(0.0, abs=0.1)


def test_a_corrected_utc_moves_neither_age_nor_path_time(make_bench):
    start = UTC_AT_ZERO_S - 10.0
    bench = make_bench(start="utc", start_utc_s=start)
    bench.until(lambda: bench.mode is FlightMode.EXTERNAL)
    before = bench.core.plan.course.path_time_s(bench.now_s)
    assert before == pytest.approx(10.0 + bench.now_s, abs=0.1)
    bench.utc_error_s = -18.0
    bench.step(20)
    assert bench.core.state in HOLDING
    assert bench.core.plan.course.path_time_s(bench.now_s) == pytest.approx(before + 1.0, abs=0.05)


@pytest.mark.parametrize("what", ["jump", "reboot"])
def test_a_jump_or_a_reboot_in_flight_is_a_fault(flying, what):
    if what == "jump":
        flying.north_m += 3000.0
    else:
        flying.boot_offset_s -= 90.0
    assert not flying.setpoints(flying.step())
    assert flying.core.state is State.FAULT


def test_home_that_moves_in_flight_moves_neither_path_nor_ceiling(make_bench):
    bench = make_bench()
    limits = msgspec.structs.replace(bench.core.config.limits, ceiling_height_m=60.0, floor_height_m=20.0)
    bench = type(bench)(Companion(msgspec.structs.replace(bench.core.config, limits=limits)))
    bench.until(lambda: bench.mode is FlightMode.EXTERNAL)
    bench.step(40)
    bench.height_m = 150.0
    for _ in range(100):
        bench.step()
        assert abs(bench.setpoints()[-1].velocity_ned_mps[2]) < 0.05


@pytest.mark.parametrize("height_m", [15.0, 35.0, 80.0, 150.0])
def test_the_bounds_are_within_the_gates_wherever_home_is_set_in_flight(make_bench, monkeypatch, height_m):
    """The gate counts floor and ceiling from the vehicle's present home."""
    bench = make_bench()
    limits = msgspec.structs.replace(bench.core.config.limits, ceiling_height_m=60.0, floor_height_m=20.0)
    bench = type(bench)(Companion(msgspec.structs.replace(bench.core.config, limits=limits)))
    bench.until(lambda: bench.core.in_control)
    situations, made = [], Decider._situation
    monkeypatch.setattr(Decider, "_situation", lambda *args: situations.append(made(*args)) or situations[-1])
    bench.height_m = height_m  # the vehicle stays where it is, 50 m above its first home
    bench.step(40)
    seen = situations[-1]
    room_below_m = seen.floor_down_m - seen.position_ned_m[2]
    room_above_m = seen.position_ned_m[2] - seen.ceiling_down_m
    assert room_below_m == pytest.approx(min(30.0, max(height_m - 20.0, 0.0)))
    assert room_above_m == pytest.approx(min(10.0, max(60.0 - height_m, 0.0)))
    assert abs(bench.setpoints()[-1].velocity_ned_mps[2]) < 0.05


def test_own_state_at_the_edges_of_the_messages_never_raises(make_bench):
    bench = make_bench(use="watch")
    for lat, lon in ((89.9999999, 0.0), (47.0, 179.9999999), (-47.0, -180.0)):
        for velocity in ((300.0, 300.0, -90.0), (-20.0, 20.0, 20.0)):
            bench.core.own.position = None
            bench.lat_deg, bench.lon_deg, bench.velocity_ned_mps = lat, lon, velocity
            for broadcast in bench.step(60):
                if isinstance(broadcast, Broadcast):
                    for message in broadcast.messages:
                        codec.encode(message)


def test_utc_before_2019_is_not_put_into_a_system_message(make_bench):
    bench = make_bench(use="watch")
    bench.landed, bench.armed, bench.utc_error_s = Landed.ON_GROUND, False, -3.2e8
    broadcasts = [c for c in bench.step(60) if isinstance(c, Broadcast)]
    assert broadcasts
    for broadcast in broadcasts:
        assert broadcast.messages[2].timestamp_utc_s is None
        codec.encode(broadcast.messages[2])


@pytest.mark.parametrize("home_m", [0.0, 50.0])
def test_a_vehicle_on_the_ground_is_released(flying, home_m):
    """Armed, it is believed after a while, on a hill after a longer one."""
    flying.landed, flying.height_m = Landed.ON_GROUND, home_m
    least_s = 10.0 if home_m else 1.5
    assert len(flying.setpoints(flying.step(round(least_s / 0.05)))) == round(least_s / 0.05)
    assert not flying.setpoints(flying.step())
    assert flying.core.state is State.STANDBY


def test_a_vehicle_that_disarms_is_released_at_once(flying):
    flying.armed = False
    assert not flying.setpoints(flying.step())
    assert flying.core.state is State.STANDBY


@pytest.mark.parametrize(("seconds", "speed_mps"), [(1.0, 0.0), (8.0, 0.0), (60.0, 3.0)])
def test_a_false_landing_in_flight_ends_nothing(flying, seconds, speed_mps):
    flying.height_m = 0.0 if seconds == 1.0 else 50.0
    flying.velocity_ned_mps = (speed_mps, 0.0, 0.0)
    law = flying.core.plan.course.law
    flying.landed = Landed.ON_GROUND
    count = round(seconds / 0.05)
    assert len(flying.setpoints(flying.step(count))) == count
    flying.landed = Landed.IN_AIR
    flying.step(20)
    assert flying.core.state in HOLDING
    assert flying.core.plan.course.law is law
    assert flying.core.own.takeoff is None


def test_a_refused_mode_is_a_fault_and_is_asked_again_later(make_bench):
    bench = make_bench()
    bench.obeys = False
    bench.until(lambda: any(isinstance(c, SetMode) for _, c in bench.log))
    bench.extra = [ModeRefused(mode=FlightMode.EXTERNAL, reason="denied by the vehicle")]
    bench.step()
    assert bench.core.state is State.FAULT
    assert "denied" in changes([c for _, c in bench.log])[-1].reason
    asked = sum(isinstance(c, SetMode) for c in bench.step(100))
    assert asked == 0
    bench.obeys = True
    bench.until(lambda: bench.mode is FlightMode.EXTERNAL)


def test_head_on_traffic_is_avoided_then_the_path_is_regained(flying):
    apart, position = [], 300.0
    for tick in range(1600):
        if tick % 20 == 0:
            flying.extra.append(intruder(flying, position, 3.0))
        flying.step()
        velocity = flying.setpoints()[-1].velocity_ned_mps
        flying.north_m += 0.05 * velocity[0]
        flying.east_m += 0.05 * velocity[1]
        flying.velocity_ned_mps = (velocity[0], velocity[1], 0.0)
        position -= 0.05 * 3.0
        apart.append(math.hypot(position - flying.north_m, flying.east_m))
    states = [c.state for c in changes([c for _, c in flying.log])]
    assert "avoiding" in states
    assert min(apart) > 10.0
    assert abs(flying.east_m) < 5.0
    assert states[-1] == "guarding"


def test_two_benches_with_the_same_events_command_the_same(make_bench):
    a, b = make_bench(), make_bench()
    for tick in range(300):
        if tick % 20 == 0:
            for bench in (a, b):
                bench.extra.append(intruder(bench, 200.0 - 0.15 * tick, 3.0))
        assert a.step() == b.step()


def test_time_running_backwards_is_our_bug(flying):
    with pytest.raises(ValueError, match="after one at"):
        flying.core.step(flying.now_s - 1.0, [])
