"""docs/troubles.md, row by row: who flies after each trouble, on both firmwares' manners.

Each trouble comes while the companion flies around somebody, having taken the vehicle from its mission.
"""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.authority.table import HOLDING, State
from companion.autopilot.dialect import DIALECTS
from companion.autopilot.wire import MavlinkReader, MavlinkWriter
from companion.events import AuthorityChanged, Firmware, FlightMode, SetMode
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode
from tests.sitl_mocks.with_companion.guarding import TICK_S, Guarded, head_on, head_on_at, taken

ARDUPILOT, PX4 = Firmware.ARDUPILOT, Firmware.PX4
BOTH = pytest.mark.parametrize("firmware", Firmware)


def held(firmware, **options):
    """The companion flies the first aircraft for two seconds."""
    return taken(head_on(firmware, **options)).run(1.0) if options else head_on_at(firmware, "held")


def sent(aircraft, since):
    """Setpoints that were sent, counted from a tick on."""
    messages = MavlinkReader().feed(b"".join(aircraft.to_vehicle[since:]))
    return sum(m.get_type() == "SET_POSITION_TARGET_LOCAL_NED" for m in messages)


def sent_at(aircraft, tick):
    """Whether setpoints left in one tick."""
    messages = MavlinkReader().feed(aircraft.to_vehicle[tick])
    return any(m.get_type() == "SET_POSITION_TARGET_LOCAL_NED" for m in messages)


def silent_from_now(sky, aircraft, seconds=20.0):
    """Check that the companion sends no more commands."""
    since = len(aircraft.to_vehicle)
    sky.run(seconds)
    return sent(aircraft, since) == 0


def station(sky, aircraft, pack):
    """Send a message from a ground station on its own link."""
    writer = MavlinkWriter(255, 190)
    aircraft.vehicle.receive(writer.pack(pack(writer.encoder)), sky.now_s, 1)


# ------------------------------------------------------------ the pilot


@BOTH
def test_a_mode_that_a_ground_station_commands(firmware):
    sky = held(firmware)
    one = sky.aircraft[0]
    mode, sub = (6.0, 0.0) if firmware is ARDUPILOT else (4.0, 5.0)  # RTL
    station(sky, one, lambda e: e.command_long_encode(1, 1, 176, 0, 1.0, mode, sub, 0, 0, 0, 0))
    sky.until(lambda: one.state is State.YIELDED, 3.0)
    assert silent_from_now(sky, one)
    assert one.vehicle.mode is VehicleMode.RTL
    name = "RTL" if firmware is ARDUPILOT else "AUTO.RTL"
    assert f"DMUCA yielded: mode changed to {name}, not by the companion" in one.texts()


@BOTH
@pytest.mark.parametrize(("mode", "restored"), [(VehicleMode.HOLD, True), (VehicleMode.RTL, False)])
def test_a_request_that_is_obeyed_after_the_pilots_choice(firmware, mode, restored):
    """It is 0.2 s on its way. His mode is requested again through link and gate if it can be requested."""
    sky = head_on(firmware)
    one, late = sky.aircraft[0], []
    receive, external = one.vehicle.receive, DIALECTS[firmware].command(FlightMode.EXTERNAL)

    def slow(data, now_s, *link):
        asked = [m for m in MavlinkReader().feed(data) if m.get_type() == "COMMAND_LONG"]
        if not late and any(m.command == 176 and m.param2 == external.param2 for m in asked):
            late.append((now_s + 0.2, data))
            one.vehicle.pilot_selects(mode)
            return
        if late and late[0] is not None and now_s > late[0][0]:
            receive(late[0][1], now_s)
            late[0] = None
        receive(data, now_s, *link)

    one.vehicle.receive = slow
    sky.until(lambda: late == [None])
    ours = "GUIDED" if firmware is ARDUPILOT else "OFFBOARD"
    sky.run(3.0)
    assert one.state is State.YIELDED
    said = one.texts()[-1]
    assert said.startswith(f"DMUCA: {ours} entered after ")
    assert said.endswith("is requested again" if restored else "must be selected again")
    assert not restored or one.vehicle.mode is mode
    assert not one.onboard.gate.counts


@pytest.mark.parametrize(
    ("firmware", "tells", "least_s", "most_s"),
    [(ARDUPILOT, False, 0.0, 0.1), (PX4, True, 0.0, 0.15), (PX4, False, 0.8, 1.1)],
)
def test_how_soon_the_setpoints_end_after_the_pilots_choice(firmware, tells, least_s, most_s):
    """Chosen just after a heartbeat, which ArduPilot sends at once again, and PX4 a second later."""
    sky = held(firmware, quirks={"tells_current_mode": tells})
    one = sky.aircraft[0]
    sky.until(lambda: one.core.own.heartbeat_s >= sky.now_s - TICK_S - 1e-6)
    one.vehicle.pilot_selects(VehicleMode.RTL)
    chosen_s, since = sky.now_s, len(one.to_vehicle)
    sky.run(2.0)
    last = max((tick for tick in range(since, len(one.to_vehicle)) if sent_at(one, tick)), default=since - 1)
    assert least_s <= (last + 1 - since) * TICK_S <= most_s, chosen_s
    assert one.state is State.YIELDED


@BOTH
def test_a_gimbal_that_is_turned_all_the_time_keeps_nobody_from_flying(firmware):
    """To PX4 each of its commands is a reason to tell the mode anew, which it may be about to change."""
    sky = head_on(firmware)
    one = sky.aircraft[0]
    turning = mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW

    def turn():
        station(sky, one, lambda e: e.command_long_encode(1, 1, turning, 0, 5.0, 5.0, 0, 0, 0, 0, 0))
        sky.run(TICK_S)

    while one.state not in HOLDING:
        turn()
    taken_s = sky.now_s
    while not one.core.in_control:
        turn()
        assert sky.now_s - taken_s < 1.0
    one.vehicle.troubles.sticks = (0.0, 0.5, 0.0, 0.0)
    moved_s = sky.now_s
    while one.core.own.mode is not FlightMode.STICKS:
        turn()
        assert sky.now_s - moved_s < 1.0


@BOTH
def test_sticks_that_move_give_the_pilot_a_mode_that_takes_them(firmware):
    sky = held(firmware)
    one = sky.aircraft[0]
    one.vehicle.troubles.sticks = (0.0, 0.5, 0.0, 0.0)
    since = len(one.steps)
    sky.until(lambda: one.state is State.YIELDED, 1.0)
    # Commanded to stand until it takes the sticks: without setpoints PX4 goes home after a second.
    sky.until(lambda: one.core.own.mode is FlightMode.STICKS, 3.0)
    assert silent_from_now(sky, one, 5.0)
    assert one.core.own.mode is FlightMode.STICKS
    assert [c.mode for c in one.of(SetMode)][-1] is FlightMode.STICKS
    assert VehicleMode.RTL not in one.modes[since:]
    assert one.setpoints(since)[-1].velocity_ned_mps == (0.0, 0.0, 0.0)


@BOTH
def test_sticks_that_move_before_our_mode_shows(firmware):
    """The vehicle is in our mode and has not said so: it comes to the pilot's all the same, and not home."""
    sky = head_on(firmware)
    one = sky.aircraft[0]
    sky.until(lambda: one.vehicle.mode is VehicleMode.EXTERNAL)
    since = len(one.steps)
    one.vehicle.troubles.sticks = (0.0, 0.5, 0.0, 0.0)
    sky.until(lambda: one.core.own.mode is FlightMode.STICKS, 4.0)
    assert one.state is State.YIELDED
    assert VehicleMode.RTL not in one.modes[since:]
    assert silent_from_now(sky, one, 5.0)


# ------------------------------------------------------------ what the autopilot does by itself


@pytest.mark.parametrize(
    ("firmware", "parameters", "trouble"),
    [
        (ARDUPILOT, {"FS_GCS_ENABLE": 1.0}, "station"),
        (PX4, {"NAV_DLL_ACT": 2.0}, "station"),
        (ARDUPILOT, {"BATT_FS_LOW_ACT": 2.0, "BATT_LOW_MAH": 1500.0}, "battery"),
        (PX4, {"COM_LOW_BAT_ACT": 3.0}, "battery"),
        (ARDUPILOT, {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 1.0, "FENCE_ALT_MAX": 20.0}, "fence"),
        (PX4, {"GF_MAX_VER_DIST": 20.0}, "fence"),
    ],
    ids=lambda v: v if isinstance(v, str) else getattr(v, "value", ""),
)
def test_a_failsafe_of_the_autopilot_is_obeyed_like_the_pilot(firmware, parameters, trouble):
    """Ground station lost, battery low or fence breached: the companion accepts the resulting mode."""
    sky = held(firmware, **({} if trouble == "fence" else {"parameters": parameters}))
    one = sky.aircraft[0]
    if trouble == "station":
        station(sky, one, lambda e: e.heartbeat_encode(6, 8, 0, 0, 4))
    elif trouble == "battery":
        one.vehicle.troubles.battery_remaining = 0.02
    else:
        for name, value in parameters.items():
            station(sky, one, lambda e, n=name, v=value: e.param_set_encode(1, 1, n.encode(), v, 9))
    sky.until(lambda: one.state is State.YIELDED, 40.0)
    assert silent_from_now(sky, one, 10.0)
    assert one.vehicle.mode not in (VehicleMode.EXTERNAL, VehicleMode.MISSION)


# ------------------------------------------------------------ a neighbour's vehicle on the link

TWO = "DMUCA: two autopilots on this link (systems 1 and 2): set vehicle.system_id"


def routed(sky, done, limit_s=120.0):
    """Until `done`, with a router that joins the first aircraft's companion and the second one's vehicle."""
    one, two = sky.aircraft
    end = sky.now_s + limit_s
    while not done():
        assert sky.now_s < end, (one.state, one.texts())
        sky.step()
        two.vehicle.receive(one.to_vehicle[-1], sky.now_s, 1)
        one.onboard.receive(two.vehicle.drain(1), sky.now_s)


@BOTH
def test_a_neighbour_that_is_heard_first_is_never_commanded(firmware):
    sky = head_on(firmware, chosen=False)
    one, two = sky.aircraft
    one.linked = False
    routed(sky, lambda: one.onboard.link.vehicle is not None)
    assert one.onboard.link.vehicle.system_id == 2
    one.linked = True
    routed(sky, lambda: sky.now_s > 30.0)
    assert one.states() == []
    assert one.texts().count(TWO) == 1
    messages = MavlinkReader().feed(b"".join(one.to_vehicle))
    assert not [m for m in messages if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
    assert not [m for m in messages if m.get_type() == "COMMAND_LONG" and m.command != 511]
    assert two.vehicle.mode is VehicleMode.MISSION


@BOTH
def test_a_neighbour_that_is_heard_while_we_avoid_ends_nothing(firmware):
    sky = held(firmware, chosen=False)
    one, _ = sky.aircraft
    routed(sky, lambda: one.state is State.STANDBY)
    # The mission was given back, and is not guarded any more.
    assert one.states()[-2:] == ["watching", "standby"]
    assert not {"yielded", "fault"} & set(one.states())
    assert one.texts().count(TWO) == 1
    assert one.vehicle.mode is VehicleMode.MISSION
    assert sky.least() > 10.0


# ------------------------------------------------------------ navigation


@BOTH
@pytest.mark.parametrize("trouble", ["gnss_lost", "estimator_bad"])
def test_navigation_lost_ends_the_setpoints_and_stops_the_vehicle(firmware, trouble):
    sky = held(firmware)
    one = sky.aircraft[0]
    setattr(one.vehicle.troubles, trouble, True)
    sky.until(lambda: one.state in (State.FAULT, State.YIELDED), 2.5)
    assert silent_from_now(sky, one, 15.0)
    # Whatever is left to it without a position: never on with the last velocity.
    assert one.vehicle.mode is not VehicleMode.EXTERNAL
    assert math.hypot(*one.vehicle.velocity_ned_mps[:2]) < 0.5


# ------------------------------------------------------------ links, reboots, restarts


@BOTH
def test_a_link_lost_for_half_a_minute(firmware):
    sky = held(firmware)
    one = sky.aircraft[0]
    seq, requests = one.seq, one.onboard.link.counts.stream_requests
    one.linked = False
    sky.run(30.0)
    assert one.state is State.FAULT
    assert (
        not one.core.traffic.tracks
        or min(sky.now_s - t.received_s for t in one.core.traffic.tracks.values()) < 15.0
    )
    one.linked = True
    sky.run(12.0)
    assert one.onboard.link.counts.stream_requests >= requests + 7, "all rates are asked for again"
    assert one.onboard.link.counts.drops == 1
    if firmware is PX4:
        # Its own failsafe flies it home: not ours to end.
        assert one.state is State.YIELDED
        assert one.vehicle.mode is VehicleMode.RTL
        assert silent_from_now(sky, one)
        return
    # It hovers in GUIDED where it was left: it is given its mission back.
    sky.until(lambda: one.state is State.WATCHING)
    assert one.vehicle.mode is VehicleMode.MISSION
    assert one.seq == seq


@BOTH
def test_an_autopilot_that_reboots_in_flight(firmware):
    sky = held(firmware)
    one = sky.aircraft[0]
    requests = one.onboard.link.counts.stream_requests
    one.vehicle.reboot(flies_on=True)
    sky.until(lambda: one.state in (State.YIELDED, State.FAULT), 8.0)
    sky.run(10.0)
    assert one.onboard.link.counts.stream_requests >= requests + 7
    assert one.state in (State.YIELDED, State.STANDBY)
    assert silent_from_now(sky, one)


@BOTH
def test_a_companion_that_starts_in_flight_takes_nothing_before_the_next_landing(firmware):
    sky = held(firmware)
    one = sky.aircraft[0]
    anew = Guarded("ONE", firmware, [(0.0, 0.0, 50.0)], take_in_flight=False)
    one.onboard, one.config = anew.onboard, anew.config
    since = len(one.to_vehicle)
    sky.run(40.0)
    assert one.state is State.STANDBY
    assert sent(one, since) == 0
    # Nobody streams: the vehicle's own timeout has ended its flight by setpoints.
    assert math.hypot(*one.vehicle.velocity_ned_mps[:2]) < 0.5 or one.vehicle.mode is VehicleMode.RTL


@BOTH
def test_every_move_that_ends_authority_says_why(firmware):
    sky = held(firmware)
    one = sky.aircraft[0]
    one.vehicle.pilot_selects(VehicleMode.HOLD)
    sky.until(lambda: one.state not in HOLDING, 3.0)
    (change,) = [c for c in one.of(AuthorityChanged) if c.state == "yielded"]
    name = "LOITER" if firmware is ARDUPILOT else "AUTO.LOITER"
    assert change.reason == f"mode changed to {name}, not by the companion"
    assert f"DMUCA yielded: {change.reason}" in one.texts()
