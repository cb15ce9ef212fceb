"""The autopilot flies its mission; the companion takes over for a conflict and gives back the same item."""

from __future__ import annotations

import math

import pytest

from companion.authority.table import State
from companion.autopilot.wire import MavlinkReader, MavlinkWriter
from companion.events import AuthorityChanged, Firmware, FlightMode, SetMode, SetSpeed
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode
from tests.sitl_mocks.with_companion.guarding import Guarded, Sky, head_on, head_on_at, item, mission, taken


def setpoints_sent(aircraft, since):
    """SET_POSITION_TARGET_LOCAL_NED messages that were sent, counted from a tick on."""
    messages = MavlinkReader().feed(b"".join(aircraft.to_vehicle[since:]))
    return sum(m.get_type() == "SET_POSITION_TARGET_LOCAL_NED" for m in messages)


@pytest.mark.parametrize("cooperating", [False, True])
@pytest.mark.parametrize("firmware", Firmware)
def test_head_on_is_avoided_and_the_same_item_is_flown_on(firmware, cooperating):
    sky = taken(head_on(firmware, cooperating=True)) if cooperating else head_on_at(firmware, "taken")
    one = sky.aircraft[0]
    seq = one.seq
    assert one.states() == ["watching", "avoiding"]
    sky.until(lambda: one.state is State.WATCHING)
    assert one.seq == seq
    assert one.states() == ["watching", "avoiding", "recovering", "guarding", "watching"]
    assert [c.mode for c in one.of(SetMode)] == [FlightMode.EXTERNAL, FlightMode.MISSION]
    assert sky.least() > 10.0
    # The way back leads to the same leg, and the mission to its end.
    sky.until(lambda: math.dist(one.places[-1], (550.0, 60.0, -50.0)) < 3.0, 200.0)
    assert one.states().count("avoiding") == 1


def test_the_missions_own_speed_comes_with_the_mission():
    """ArduPilot forgets the speed. Sent with the request for AUTO and not after it, it applies to the whole
    leg."""
    slow = item(2, 0.0, 0.0, command=178, params=(1.0, 3.0, -1.0, 0.0))
    items = (item(1, 0.0, 0.0, command=22), slow, item(3, 400.0, 0.0))
    sky = taken(head_on(Firmware.ARDUPILOT, mission=items))
    one = sky.aircraft[0]
    sky.until(lambda: one.vehicle.mode is VehicleMode.MISSION)
    told = MavlinkReader().feed(one.to_vehicle[-1])
    assert [m.command for m in told if m.get_type() == "COMMAND_LONG"][-2:] == [176, 178]
    sky.run(8.0)
    assert math.dist(one.places[-1], one.places[-21]) == pytest.approx(3.0, abs=0.2)


def flown_at(speed_mps, *places):
    """A mission of ArduPilot's: a take-off, a speed, places (north, east)."""
    change = item(2, 0.0, 0.0, command=178, params=(1.0, speed_mps, -1.0, 0.0))
    return (item(1, 0.0, 0.0, command=22), change, *(item(n, *at) for n, at in enumerate(places, 3)))


def told_of_speed(aircraft):
    return [text for text in aircraft.texts() if "limits.max_speed_mps" in text]


def test_a_mission_that_is_faster_than_the_limit_is_told_of_once():
    """The mission is also slowed down to the limit."""
    one = Guarded("ONE", Firmware.ARDUPILOT, [(0.0, 0.0, 50.0)], mission=flown_at(9.6, (900.0, 0.0)))
    south = [(800.0, 1.0, 50.0), (0.0, 1.0, 50.0)]
    sky = Sky(one, Guarded("TWO", Firmware.PX4, south, guarded=False, number=2))
    sky.until(lambda: one.core.in_control)
    said = [
        "DMUCA: mission item 2: 9.6 m/s is above limits.max_speed_mps 8: in a conflict, the companion "
        "slows the vehicle down to that at once"
    ]
    assert told_of_speed(one) == said
    assert math.dist(one.places[-1], one.places[-21]) == pytest.approx(9.6, abs=0.1)
    sky.run(4.0)
    assert math.dist(one.places[-1], one.places[-21]) < 8.1
    sky.until(lambda: one.state is State.WATCHING).run(5.0)
    assert told_of_speed(one) == said


def test_a_mission_that_replaces_a_slower_one_is_told_of_too():
    """The new mission has another number of items, because ArduPilot does not report one with the same
    number."""
    slow, fast = flown_at(4.0, (900.0, 0.0)), flown_at(9.0, (900.0, 0.0), (900.0, 50.0))
    one = Guarded("ONE", Firmware.ARDUPILOT, [(0.0, 0.0, 50.0)], mission=slow)
    sky = Sky(one).run(10.0)
    for uploaded, times in ((slow, 0), (fast, 1), (slow, 1), (fast, 1)):
        one.upload(uploaded, sky.now_s)
        sky.run(10.0)
        assert one.state is State.WATCHING
        assert len(told_of_speed(one)) == times


def test_a_return_is_not_slowed_to_the_missions_own_speed():
    """ArduPilot returns home at its own speed, even if the mission has set another speed before."""
    slow = item(2, 0.0, 0.0, command=178, params=(1.0, 3.0, -1.0, 0.0))
    items = (item(1, 0.0, 0.0, command=22), slow, item(3, 0.0, 0.0, command=20))
    start = [(300.0, 0.0, 50.0)]
    one = Guarded("ONE", Firmware.ARDUPILOT, start, mission=items)
    two = Guarded("TWO", Firmware.PX4, [(0.0, 0.0, 50.0), (500.0, 0.0, 50.0)], guarded=False, number=2)
    sky = taken(Sky(one, two))
    assert one.seq == 3
    sky.until(lambda: one.state is State.WATCHING)
    assert [c.speed_mps for c in one.of(SetMode) if c.mode is FlightMode.MISSION] == [None]
    assert not one.of(SetSpeed)


@pytest.mark.parametrize("firmware", Firmware)
def test_nobody_in_the_way_nothing_is_commanded(firmware):
    sky = head_on(firmware)
    one, two = sky.aircraft
    two.linked = False  # its companion sends nothing
    sky.run(60.0)
    assert one.state is State.WATCHING
    assert not one.setpoints()
    assert not one.of(SetMode)
    assert setpoints_sent(one, 0) == 0


def test_one_that_passes_far_aside_changes_nothing():
    north = [(0.0, 0.0, 50.0), (400.0, 0.0, 50.0)]
    south = [(400.0, 90.0, 50.0), (0.0, 90.0, 50.0)]
    one = Guarded("ONE", Firmware.PX4, north)
    Sky(one, Guarded("TWO", Firmware.PX4, south, guarded=False, number=2)).run(80.0)
    assert one.states()[:1] == ["watching"]
    assert not one.setpoints()


def test_a_vehicle_that_waits_makes_way_and_comes_back():
    """An item without a position: the vehicle keeps the point at which it was taken."""
    wait = item(2, 0.0, 0.0, command=93, params=(300.0, -1.0, -1.0, -1.0), lat_deg=0.0, lon_deg=0.0)
    items = (item(1, 0.0, 0.0, command=22), wait, item(3, 50.0, 0.0))
    one = Guarded("ONE", Firmware.ARDUPILOT, [(0.0, 0.0, 50.0)], mission=items)
    two = Guarded("TWO", Firmware.PX4, [(250.0, 0.0, 50.0), (-250.0, 0.0, 50.0)], guarded=False, number=2)
    sky = taken(Sky(one, two))
    assert one.seq == 2
    sky.until(lambda: one.state is State.WATCHING)
    assert sky.least() > 10.0
    assert one.seq == 2
    assert math.dist(one.places[-1], (0.0, 0.0, -50.0)) < 5.0


@pytest.mark.parametrize("firmware", Firmware)
def test_the_item_is_waited_at_and_not_flown_past(firmware):
    """An aircraft hovers behind the waypoint: the companion never continues to the next item by itself."""
    north = [(0.0, 0.0, 50.0), (150.0, 0.0, 50.0), (150.0, 200.0, 50.0)]
    one = Guarded("ONE", firmware, north)
    two = Guarded("TWO", Firmware.PX4, [(158.0, 0.0, 50.0)], guarded=False, number=2)
    sky = taken(Sky(one, two))
    seq = one.seq
    sky.run(60.0)
    assert sky.least() > 10.0
    assert one.seq == seq
    assert one.core.in_control
    assert abs(one.places[-1][1]) < 40.0


@pytest.mark.parametrize("firmware", Firmware)
def test_a_mission_changed_meanwhile_is_not_resumed(firmware):
    sky = head_on_at(firmware, "taken")
    one = sky.aircraft[0]
    new = mission((0.0, 0.0, 50.0), (0.0, 300.0, 50.0), first=1 if firmware is Firmware.ARDUPILOT else 0)
    one.upload(new, sky.now_s)
    sky.until(lambda: one.state is State.YIELDED)
    sky.run(5.0)
    assert one.vehicle.mode in (VehicleMode.HOLD, VehicleMode.BRAKE)
    assert any("mission was changed" in text for text in one.texts())
    (last,) = [c for c in one.of(AuthorityChanged) if c.state == "yielded"]
    assert last.trigger == "changed"


@pytest.mark.parametrize("firmware", Firmware)
def test_a_mission_replaced_while_it_is_watched_is_given_back(firmware):
    """A mission with the same number of items is uploaded on another link. Like ArduPilot, the mock does not
    report it."""
    sky = head_on(firmware)
    one = sky.aircraft[0]
    sky.until(lambda: one.state is State.WATCHING)
    first = 1 if firmware is Firmware.ARDUPILOT else 0
    points = [(0.0, 0.0, 50.0), (700.0, 0.0, 50.0), (700.0, -100.0, 50.0)]
    one.upload(mission(*points, first=first), sky.now_s)
    station = MavlinkWriter(255, 190)
    one.vehicle.receive(station.pack(station.encoder.mission_set_current_encode(1, 1, first)), sky.now_s, 1)
    taken(sky).until(lambda: one.state is State.WATCHING)
    assert one.states() == ["watching", "avoiding", "recovering", "guarding", "watching"]


def test_a_flight_that_is_continued_from_a_moment_is_the_flight_itself():
    """Nothing is lost or shared by the copies that other tests begin with."""
    flown = taken(head_on(Firmware.PX4))
    copies = [head_on_at(Firmware.PX4, "taken") for _ in range(2)]
    copies[0].run(3.0)
    for sky in (flown, copies[1]):
        sky.run(3.0)
    for sky in copies:
        for one, other in zip(flown.aircraft, sky.aircraft, strict=True):
            assert one.places == other.places
            assert one.to_vehicle == other.to_vehicle
            assert one.steps == other.steps


# ------------------------------------------------------------ the pilot, and faults


@pytest.mark.parametrize("moment", ["avoiding", "recovering", "guarding"])
@pytest.mark.parametrize("firmware", Firmware)
def test_the_pilot_wins_in_every_phase(firmware, moment):
    sky = head_on_at(firmware, moment)
    one = sky.aircraft[0]
    assert one.state.value == moment
    one.vehicle.pilot_selects(VehicleMode.HOLD)
    seen = len(one.steps)
    sky.until(lambda: one.core.own.mode is not FlightMode.EXTERNAL, 3.0)
    since = len(one.to_vehicle)
    sky.run(30.0)
    # No setpoint leaves after the step that saw the mode.
    assert setpoints_sent(one, since) == 0
    assert one.states()[-1] == "yielded"
    assert one.vehicle.mode is VehicleMode.HOLD
    assert seen < since


@pytest.mark.parametrize("firmware", Firmware)
def test_a_pilot_who_takes_the_mission_back_himself_is_left_alone(firmware):
    sky = head_on_at(firmware, "taken")
    one = sky.aircraft[0]
    one.vehicle.pilot_selects(VehicleMode.MISSION)
    sky.run(30.0)
    assert one.state is State.YIELDED
    assert one.vehicle.mode is VehicleMode.MISSION
