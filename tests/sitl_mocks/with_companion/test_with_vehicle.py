"""One companion with one mock vehicle in virtual time: missions, modes, reboots, over real bytes."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.authority.table import HOLDING, State
from companion.autopilot.dialect import impossible_rearm
from companion.autopilot.wire import MavlinkWriter
from companion.config import (
    AvoidanceConfig,
    Config,
    FlightConfig,
    IdentityConfig,
    LimitsConfig,
    VehicleConfig,
)
from companion.events import (
    AuthorityChanged,
    DownloadMission,
    Firmware,
    GlobalPosition,
    MissionItem,
    Say,
    VehicleParameters,
    VelocitySetpoint,
)
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode
from sitl_mocks.vehicle.mock_vehicle import MockVehicle
from sitl_mocks.vehicle.options import VehicleOptions
from tests.sitl_mocks.with_companion.pair import TICK_S, UTC_AT_ZERO_S, Pair
from tests.support.place import HOME


def waypoint(seq, north_m, east_m, height_m, command=16, hold_s=0.0):
    lat, lon, _ = HOME.to_geodetic(north_m, east_m, 0.0)
    return MissionItem(
        seq=seq,
        command=command,
        frame=6,
        params=(hold_s, 0.0, 0.0, 0.0),
        lat_deg=lat,
        lon_deg=lon,
        alt_m=height_m,
    )


MISSION = (
    waypoint(1, 0.0, 0.0, 50.0, command=22),
    waypoint(2, 60.0, 0.0, 50.0),
    waypoint(3, 60.0, 40.0, 60.0, hold_s=5.0),
    waypoint(4, 0.0, 0.0, 0.0, command=20),
)


class MissionPair(Pair):
    """A companion that flies the mission of its vehicle."""

    def __init__(self, firmware, mission=MISSION, flight=None, system_id=1, **options):
        config = Config(
            identity=IdentityConfig(uas_id="PAIR"),
            vehicle=VehicleConfig(system_id=system_id),
            flight=FlightConfig(
                use="fly",
                trajectory="mission",
                mission_speed_mps=3.0,
                take_in_flight=True,
                **(flight or {}),
            ),
            limits=LimitsConfig(max_speed_mps=5.0),
            avoidance=AvoidanceConfig(),
        )
        super().__init__(firmware, config, mission=mission, **options)

    def set(self, name, number, kind=9):
        """Send PARAM_SET as a ground station does."""
        message = mavlink.MAVLink_param_set_message(self.vehicle.options.system_id, 1, name, number, kind)
        self.vehicle.receive(MavlinkWriter(255, 190).pack(message), self.tick * TICK_S)


@pytest.mark.parametrize("firmware", Firmware)
def test_the_vehicles_own_mission_is_flown_as_a_timed_path(firmware):
    pair = MissionPair(firmware)
    pair.run(12.0)
    assert pair.vehicle.mode is VehicleMode.EXTERNAL
    pair.run(8.0)
    # 3 m/s north since the companion took the vehicle, 60 m to the first corner.
    assert 40.0 < pair.vehicle.position_ned_m[0] <= 61.0
    assert abs(pair.vehicle.position_ned_m[1]) < 1.5
    pair.run(40.0)
    assert math.dist(pair.vehicle.position_ned_m, (60.0, 40.0, -60.0)) < 1.0


@pytest.mark.parametrize("firmware", Firmware)
def test_a_waypoint_straight_overhead_is_climbed_to(firmware):
    """Every vehicle that is taken right after its take-off is a little below its first waypoint."""
    pair = MissionPair(
        firmware, mission=(MISSION[0], waypoint(2, 0.0, 0.0, 62.0), waypoint(3, 60.0, 0.0, 62.0))
    )
    pair.run(12.0)
    assert not [c.text for c in pair.commands(Say) if "refused" in c.text]
    assert 1.7 < max(-c.velocity_ned_mps[2] for c in pair.commands(VelocitySetpoint)) < 2.001
    pair.run(24.0)
    assert math.dist(pair.vehicle.position_ned_m, (60.0, 0.0, -62.0)) < 5.0


@pytest.mark.parametrize("firmware", Firmware)
def test_a_mission_that_cannot_be_flown_is_refused_by_item_number(firmware):
    again = waypoint(3, 60.0, 40.0, 60.0, command=22)
    pair = MissionPair(firmware, mission=(MISSION[0], MISSION[1], again))
    pair.run(20.0)
    assert pair.state is State.STANDBY
    assert not pair.commands(VelocitySetpoint)
    (said,) = [c.text for c in pair.commands(Say) if "refused" in c.text]
    assert f"mission item {2 if firmware is Firmware.PX4 else 3}: NAV_TAKEOFF" in said


@pytest.mark.parametrize("firmware", Firmware)
def test_the_pilots_switch_ends_it_within_one_heartbeat(firmware):
    pair = MissionPair(firmware)
    pair.run(15.0)
    assert pair.state in HOLDING
    pair.vehicle.pilot_selects(VehicleMode.HOLD)
    pair.run(1.1)
    assert pair.state is State.YIELDED
    before = len(pair.steps)
    pair.run(10.0)
    assert not pair.commands(VelocitySetpoint, since=before)
    assert pair.vehicle.mode is VehicleMode.HOLD


@pytest.mark.parametrize("firmware", Firmware)
def test_given_back_by_mode_except_by_px4_which_refuses_offboard_without_a_stream(firmware):
    """As `impossible_rearm` tells before the flight."""
    pair = MissionPair(firmware, flight={"rearm": "mode"})
    pair.run(15.0)
    pair.vehicle.pilot_selects(VehicleMode.HOLD)
    pair.run(5.0)
    assert pair.state is State.YIELDED
    pair.vehicle.pilot_selects(VehicleMode.EXTERNAL)
    pair.run(10.0)
    impossible = impossible_rearm(firmware, pair.onboard.core.config.flight)
    assert (impossible is None) is (firmware is Firmware.ARDUPILOT)
    assert pair.state is (State.GUARDING if impossible is None else State.YIELDED)
    assert pair.vehicle.mode is (VehicleMode.EXTERNAL if impossible is None else VehicleMode.HOLD)


@pytest.mark.parametrize("firmware", Firmware)
def test_not_taken_on_the_ground(firmware):
    pair = MissionPair(firmware, airborne=False, start_position_ned_m=(0.0, 0.0, 0.0))
    pair.run(20.0)
    assert pair.state is State.STANDBY
    assert not pair.commands(VelocitySetpoint)
    assert pair.onboard.core.own.takeoff is not None


@pytest.mark.parametrize("firmware", Firmware)
def test_a_silent_companion_leaves_the_vehicle_to_its_own_failsafe(firmware):
    pair = MissionPair(firmware)
    pair.run(15.0)
    now_s = pair.tick * TICK_S
    pair.vehicle.advance(now_s + 5.0)
    if firmware is Firmware.PX4:
        assert pair.vehicle.mode is VehicleMode.RTL
    else:
        assert pair.vehicle.mode is VehicleMode.EXTERNAL
        assert math.hypot(*pair.vehicle.velocity_ned_mps) < 1.0
    # After the pause the loop is late, which is a fault. On PX4 the vehicle's own mode is then respected.
    pair.tick += 100
    pair.run(1.5)
    moves = [c.state for c in pair.commands(AuthorityChanged)]
    assert "fault" in moves or "yielded" in moves


def test_link_silence_is_a_fault_and_nothing_is_sent():
    pair = MissionPair(Firmware.ARDUPILOT)
    pair.run(15.0)
    before = len(pair.steps)
    for _ in range(100):
        pair.onboard.tick(pair.tick * TICK_S)
        pair.tick += 1
    faulted = next(k for k, s in enumerate(pair.steps) if any(
        isinstance(c, AuthorityChanged) and c.state == "fault" for c in s.commands))  # fmt: skip
    assert (faulted - before) * TICK_S <= 1.2
    assert not pair.commands(VelocitySetpoint, since=faulted)


@pytest.mark.parametrize("firmware", Firmware)
def test_a_mission_under_way_goes_on_where_it_is(firmware):
    pair = MissionPair(
        firmware,
        mission=(MISSION[0], waypoint(2, -30.0, 0.0, 50.0), waypoint(3, 0.0, 60.0, 50.0)),
        start_mode=VehicleMode.MISSION,
    )
    # The vehicle flies its mission by itself until it is on the way to the last waypoint.
    last = 3 if firmware is Firmware.ARDUPILOT else 2
    while pair.vehicle.mission_seq < last and pair.tick < 2000:
        pair.vehicle.advance(pair.tick * TICK_S)
        pair.vehicle.drain()
        pair.tick += 1
    north = pair.vehicle.position_ned_m[0]
    assert north < -15.0
    pair.run(40.0)
    assert pair.state in HOLDING
    assert (
        max(abs(step) for step in (pair.vehicle.position_ned_m[0], pair.vehicle.position_ned_m[1] - 60.0))
        < 1.5
    )


@pytest.mark.parametrize("firmware", Firmware)
def test_corners_are_rounded_not_overshot(firmware):
    pair = MissionPair(firmware)
    worst = 0.0
    for _ in range(300):
        pair.run(0.2)
        if pair.state in HOLDING and pair.onboard.core.in_control:
            worst = max(worst, pair.vehicle.position_ned_m[0] - 60.0)
    # 3 m/s into a right angle at 60 m north, with 1 m/s2: feed-forward alone overshot by more than 6 m.
    assert worst < 3.0


@pytest.mark.parametrize("firmware", Firmware)
def test_a_mission_of_many_items_comes_over_a_slow_link(firmware):
    """0.1 s each way, as with telemetry radios, for each of 80 items. A second request would restart the
    download."""
    pair = MissionPair(firmware, mission=tuple(waypoint(seq, 10.0 * seq, 0.0, 50.0) for seq in range(1, 81)))
    down, up = deque([b""] * 2), deque([b""] * 2)
    for tick in range(round(25.0 / TICK_S)):
        now_s = tick * TICK_S
        pair.vehicle.advance(now_s)
        down.append(pair.vehicle.drain())
        if data := down.popleft():
            pair.onboard.receive(data, now_s)
        pair.onboard.tick(now_s)
        up.append(pair.onboard.drain(now_s))
        pair.vehicle.receive(up.popleft(), now_s)
    assert len(pair.commands(DownloadMission)) == 1
    assert pair.state in HOLDING


@pytest.mark.parametrize("firmware", Firmware)
def test_a_mission_that_cannot_be_flown_is_said_before_take_off(firmware):
    again = waypoint(3, 60.0, 40.0, 60.0, command=22)
    on_ground = {"airborne": False, "start_position_ned_m": (0.0, 0.0, 0.0)}
    pair = MissionPair(firmware, mission=(MISSION[0], MISSION[1], again), **on_ground)
    pair.run(20.0)
    (said,) = [c.text for c in pair.commands(Say) if "refused" in c.text]
    assert f"mission item {2 if firmware is Firmware.PX4 else 3}: NAV_TAKEOFF" in said
    assert len(pair.commands(DownloadMission)) == 1
    pair = MissionPair(firmware, **on_ground)
    pair.run(20.0)
    assert not [c for c in pair.commands(Say) if "refused" in c.text]


LIMIT = {
    Firmware.ARDUPILOT: (b"WPNAV_SPEED", 200.0, "WPNAV_SPEED 2"),
    Firmware.PX4: (b"MPC_XY_VEL_MAX", 2.0, "MPC_XY_VEL_MAX 2"),
}


@pytest.mark.parametrize("firmware", Firmware)
def test_the_vehicles_limits_are_read_before_it_is_taken(firmware):
    pair = MissionPair(firmware)
    pair.run(15.0)
    assert pair.state in HOLDING
    told = [e for step in pair.steps for e in step.events if isinstance(e, VehicleParameters)][-1]
    names = {"WPNAV_SPEED_DN": 1.5, "GUID_TIMEOUT": 3.0, "FENCE_ENABLE": 0.0}
    if firmware is Firmware.PX4:
        names = {"MPC_Z_VEL_MAX_DN": 1.5, "COM_OF_LOSS_T": 1.0, "GF_ACTION": 2.0, "COM_OBL_RC_ACT": 0.0}
    found = (told.descent_mps, told.setpoint_timeout_s, told.fence_action, told.loss_action)
    assert {p.name: p.value for p in found if p is not None} == names
    counts = pair.onboard.link.counts
    assert (counts.bad_values, pair.onboard.link.asking) == (0, False)
    said = [c.text for c in pair.commands(Say) if "vehicle's limit applies" in c.text]
    assert len(said) == 1
    assert "limits.max_descent_mps 2" in said[0]


@pytest.mark.parametrize("firmware", Firmware)
def test_a_mission_faster_than_the_vehicle_is_refused(firmware):
    pair = MissionPair(firmware)
    name, number, words = LIMIT[firmware]
    pair.set(name, number)
    pair.run(15.0)
    assert pair.state is State.STANDBY
    (said,) = [c.text for c in pair.commands(Say) if "path refused" in c.text]
    assert f"m/s is above the vehicle's {words}" in said
    # The operator raises the limit: the companion learns of it and tries the path again.
    pair.set(name, 4.0 * number)
    pair.run(15.0)
    assert pair.state in HOLDING


@pytest.mark.parametrize("firmware", Firmware)
def test_a_reboot_asks_for_rates_and_limits_again(firmware):
    pair = MissionPair(firmware, airborne=False, start_position_ned_m=(0.0, 0.0, 0.0))
    pair.run(5.0)
    counts = pair.onboard.link.counts
    before = counts.parameter_requests
    assert before > 0
    name, number, _ = LIMIT[firmware]
    pair.set(name, number)
    pair.run(1.0)
    reboot = mavlink.MAVLink_command_long_message(1, 1, 246, 0, 1, 0, 0, 0, 0, 0, 0)
    pair.vehicle.receive(MavlinkWriter(255, 190).pack(reboot), pair.tick * TICK_S)
    pair.run(4.0)
    since = len(pair.steps)
    pair.run(3.0)
    assert pair.vehicle.reboots == counts.reboots == 1
    assert counts.parameter_requests > before
    assert pair.onboard.link.parameters.speed_mps.value == pytest.approx(2.0)
    positions = [e for s in pair.steps[since:] for e in s.events if isinstance(e, GlobalPosition)]
    assert len(positions) > 20


@pytest.mark.parametrize("firmware", Firmware)
@pytest.mark.parametrize("word", ["face", "hold"])
def test_the_nose_does_the_same_on_both(firmware, word):
    pair = MissionPair(firmware, flight={"yaw": word}, start_yaw_rad=2.5)
    pair.run(17.0)
    assert pair.onboard.core.in_control
    assert 20.0 < pair.vehicle.position_ned_m[0] < 55.0
    north = pair.vehicle.yaw_rad
    pair.run(16.0)
    east = pair.vehicle.yaw_rad
    wanted = (0.0, math.pi / 2) if word == "face" else (2.5, 2.5)
    for yaw, target in zip((north, east), wanted, strict=True):
        assert abs(math.remainder(yaw - target, math.tau)) < 0.1


@pytest.mark.parametrize("firmware", Firmware)
def test_of_two_vehicles_on_one_link_only_the_named_one_is_flown(firmware):
    pair = MissionPair(firmware, system_id=7)
    other = MockVehicle(
        VehicleOptions(
            firmware=firmware,
            system_id=3,
            airborne=True,
            start_position_ned_m=(30.0, 30.0, -50.0),
            start_mode=VehicleMode.HOLD,
            utc_at_zero_s=UTC_AT_ZERO_S,
        ),
        np.random.default_rng(2),
    )
    pair.vehicle = MockVehicle(
        VehicleOptions(
            firmware=firmware,
            system_id=7,
            mission=MISSION,
            airborne=True,
            start_position_ned_m=(0.0, 0.0, -50.0),
            start_mode=VehicleMode.EXTERNAL if firmware is Firmware.ARDUPILOT else None,
            utc_at_zero_s=UTC_AT_ZERO_S,
        ),
        np.random.default_rng(1),
    )
    for tick in range(round(18.0 / TICK_S)):
        now_s = tick * TICK_S
        for vehicle in (other, pair.vehicle):
            vehicle.advance(now_s)
            if data := vehicle.drain():
                pair.onboard.receive(data, now_s)
        pair.onboard.tick(now_s)
        sent = pair.onboard.drain(now_s)
        for vehicle in (other, pair.vehicle):
            vehicle.receive(sent, now_s)
    assert pair.onboard.link.vehicle.system_id == 7
    assert pair.state in HOLDING
    assert pair.vehicle.mode is VehicleMode.EXTERNAL
    assert pair.vehicle.position_ned_m[0] > 15.0
    assert (other.mode, other.setpoints_received) == (VehicleMode.HOLD, 0)
    assert math.dist(other.position_ned_m, (30.0, 30.0, -50.0)) < 0.1
    assert pair.onboard.link.counts.foreign > 10
