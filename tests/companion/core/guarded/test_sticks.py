"""The pilot moves the sticks while the core flies a vehicle, event by event."""

from __future__ import annotations

import pytest

from companion.authority.table import State
from companion.events import AuthorityChanged, Firmware, FlightMode, ModeRefused, RcChannels
from tests.companion.core.guarded.guarding import meet, modes, taken


def test_sticks_that_move_take_the_vehicle_and_get_a_mode_that_takes_them(guarded):
    bench = guarded()
    bench.extra.append(RcChannels(sticks_us=(1500, 1510, 1490)))
    taken(bench)
    bench.extra.append(RcChannels(sticks_us=(1500, 1510, 1490)))
    bench.step(5)
    bench.extra.append(RcChannels(sticks_us=(1500, 1650, 1490)))
    assert bench.setpoints(bench.step()), "one message may be a glitch"
    bench.extra.append(RcChannels(sticks_us=(1500, 1650, 1490)))
    bench.obeys = False
    commands = bench.step()
    # Standing, until the pilot's mode shows: PX4 would go home after a second without setpoints.
    assert [s.velocity_ned_mps for s in bench.setpoints(commands)] == [(0.0, 0.0, 0.0)]
    assert modes(commands) == [FlightMode.STICKS]
    assert bench.core.state is State.YIELDED
    bench.step(20)
    assert [s.velocity_ned_mps for s in bench.setpoints()] == [(0.0, 0.0, 0.0)]
    bench.mode = FlightMode.STICKS
    assert not bench.setpoints(bench.step())
    bench.mode = FlightMode.EXTERNAL
    assert not bench.setpoints(bench.step(400)), "authority is not given anew"


def sticks_moved(bench):
    bench.extra += [RcChannels(sticks_us=(1500, 1700, 1500))] * 2
    return bench.step()


def at_rest(bench):
    bench.extra.append(RcChannels(sticks_us=(1500, 1500, 1500)))
    return taken(bench)


def test_sticks_without_a_mode_that_follows_are_waited_for_standing_for_seconds_and_no_longer(guarded):
    bench = at_rest(guarded())
    bench.obeys = False
    told = bench.setpoints(sticks_moved(bench) + bench.step(400))
    assert {s.velocity_ned_mps for s in told} == {(0.0, 0.0, 0.0)}
    assert 9.9 < len(told) * 0.05 < 10.1


def test_a_vehicle_that_refuses_the_mode_for_sticks_is_to_hold(guarded):
    """PX4 with a radio that it does not count as calibrated; without setpoints it would go home."""
    bench = at_rest(guarded())
    bench.obeys = False
    sticks_moved(bench)
    bench.step(120)
    bench.extra.append(ModeRefused(mode=FlightMode.STICKS, reason="POSCTL not entered"))
    commands = bench.step()
    assert modes(commands) == [FlightMode.HOLD]
    assert [s.velocity_ned_mps for s in bench.setpoints(commands)] == [(0.0, 0.0, 0.0)]
    bench.mode = FlightMode.HOLD
    assert not bench.setpoints(bench.step(100))
    assert bench.core.state is State.YIELDED


def test_a_mode_for_sticks_that_is_refused_as_the_pilot_chose_another_leaves_him_that(guarded):
    bench = at_rest(guarded())
    bench.obeys = False
    sticks_moved(bench)
    bench.mode = FlightMode.OTHER
    bench.extra.append(ModeRefused(mode=FlightMode.STICKS, reason="the vehicle went to RTL"))
    assert modes(bench.step()) == []


def test_a_mode_chosen_with_the_sticks_ends_the_standing_for_good(guarded):
    bench = at_rest(guarded())
    bench.obeys = False
    assert bench.setpoints(sticks_moved(bench))
    bench.mode = FlightMode.OTHER
    assert not bench.setpoints(bench.step())
    bench.mode = FlightMode.EXTERNAL
    assert not bench.setpoints(bench.step(100))


def test_nobody_stands_on_an_own_state_that_is_not_fit(guarded):
    bench = at_rest(guarded())
    bench.obeys = False
    assert bench.setpoints(sticks_moved(bench))
    bench.fix_type = 1
    assert not bench.setpoints(bench.step(20))


@pytest.mark.parametrize("firmware", Firmware)
def test_sticks_that_move_in_a_fault_get_a_mode_that_takes_them(guarded, firmware):
    """From ArduPilot's BRAKE, which takes none; from PX4 before its own failsafe shows."""
    bench = guarded()
    bench.firmware = firmware
    at_rest(bench)
    bench.fix_type = 1
    bench.step(2)
    assert bench.core.state is State.FAULT
    assert bench.mode is (FlightMode.HOLD if firmware is Firmware.ARDUPILOT else FlightMode.EXTERNAL)
    commands = sticks_moved(bench)
    assert bench.core.state is State.YIELDED
    assert modes(commands) == [FlightMode.STICKS]
    assert not bench.setpoints(commands)
    (change,) = [c for c in commands if isinstance(c, AuthorityChanged)]
    assert change.reason == "the pilot moved the sticks"


def test_sticks_that_move_in_a_fault_leave_a_mode_that_is_not_ours_alone(guarded):
    """Our mode was never entered: the vehicle flies its mission on, as the pilot chose."""
    bench = guarded()
    bench.obeys = False
    bench.extra.append(RcChannels(sticks_us=(1500, 1500, 1500)))
    meet(bench, seconds=1.5)
    bench.fix_type = 1
    bench.step(2)
    assert bench.core.state is State.FAULT
    commands = sticks_moved(bench)
    assert bench.core.state is State.YIELDED
    assert modes(commands) == []
    (change,) = [c for c in commands if isinstance(c, AuthorityChanged)]
    assert change.reason == "the pilot moved the sticks"


def test_a_glitch_and_sticks_at_rest_are_no_pilot(guarded):
    bench = guarded()
    bench.extra.append(RcChannels(sticks_us=(1400, 1600, 1500)))
    taken(bench)
    for us in (1400, 1700, 1400, 1495):
        bench.extra.append(RcChannels(sticks_us=(us, 1600, 1500)))
        bench.step(4)
    bench.extra.append(RcChannels())
    bench.step(4)
    assert bench.core.in_control


@pytest.mark.parametrize("mode", [FlightMode.MISSION, FlightMode.OTHER])
def test_sticks_that_move_while_the_vehicle_is_being_taken(guarded, mode):
    """Our mode may be entered yet: the one that takes sticks is asked for, unless the pilot chose another."""
    bench = guarded()
    bench.obeys = False
    bench.extra.append(RcChannels(sticks_us=(1500, 1500, 1500)))
    meet(bench, seconds=1.5)
    before = len(bench.log)
    bench.mode = mode
    bench.extra += [RcChannels(sticks_us=(1500, 1700, 1500))] * 2
    bench.step()
    assert bench.core.state is State.YIELDED
    assert modes(c for _, c in bench.log[before:]) == (
        [FlightMode.STICKS] if mode is FlightMode.MISSION else []
    )
