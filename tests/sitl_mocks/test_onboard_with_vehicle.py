"""One companion with one mock vehicle in virtual time: missions, modes, reboots, over real bytes."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import pytest

from companion.avoidance.authority import HOLDING, State
from companion.config import AvoidanceConfig, Config, FlightConfig, IdentityConfig, LimitsConfig
from companion.events import AuthorityChanged, DownloadMission, Firmware, MissionItem, Say, VelocitySetpoint
from companion.geometry import LocalFrame
from companion.onboard import Onboard
from sitl_mocks.autopilot import MockVehicle
from sitl_mocks.vehicle_manners import VehicleMode
from sitl_mocks.vehicle_options import VehicleOptions

HOME = LocalFrame(47.397, 8.545, 400.0)
TICK_S = 0.05


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


class Pair:
    """Vehicle and companion, stepped together."""

    def __init__(self, firmware, mission=MISSION, **options):
        options = {"airborne": True, "start_position_ned_m": (0.0, 0.0, -50.0), **options}
        if options["airborne"] and firmware is Firmware.ARDUPILOT:
            # Taken off in GUIDED, as a ground station does it; LOITER is the pilot's.
            options.setdefault("start_mode", VehicleMode.EXTERNAL)
        self.vehicle = MockVehicle(
            VehicleOptions(firmware=firmware, mission=mission, utc_at_zero_s=1_767_225_600.0, **options),
            np.random.default_rng(1),
        )
        config = Config(
            identity=IdentityConfig(uas_id="PAIR"),
            flight=FlightConfig(use="fly", trajectory="mission", mission_speed_mps=3.0, take_in_flight=True),
            limits=LimitsConfig(max_speed_mps=5.0),
            avoidance=AvoidanceConfig(),
        )
        self.steps = []
        self.onboard = Onboard(config, self.steps.append)
        self.tick = 0

    @property
    def state(self):
        return self.onboard.heart.state

    def run(self, seconds):
        for _ in range(round(seconds / TICK_S)):
            now_s = self.tick * TICK_S
            self.tick += 1
            self.vehicle.advance(now_s)
            data = self.vehicle.drain()
            if data:
                self.onboard.receive(data, now_s)
            self.onboard.tick(now_s)
            self.vehicle.receive(self.onboard.drain(now_s), now_s)

    def commands(self, kind, since=0):
        return [c for step in self.steps[since:] for c in step.commands if isinstance(c, kind)]


@pytest.mark.parametrize("firmware", Firmware)
def test_the_vehicles_own_mission_is_flown_as_a_timed_path(firmware):
    pair = Pair(firmware)
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
    pair = Pair(firmware, mission=(MISSION[0], waypoint(2, 0.0, 0.0, 62.0), waypoint(3, 60.0, 0.0, 62.0)))
    pair.run(12.0)
    assert not [c.text for c in pair.commands(Say) if "refused" in c.text]
    assert 1.7 < max(-c.velocity_ned_mps[2] for c in pair.commands(VelocitySetpoint)) < 2.001
    pair.run(24.0)
    assert math.dist(pair.vehicle.position_ned_m, (60.0, 0.0, -62.0)) < 5.0


@pytest.mark.parametrize("firmware", Firmware)
def test_a_mission_that_cannot_be_flown_is_refused_by_item_number(firmware):
    again = waypoint(3, 60.0, 40.0, 60.0, command=22)
    pair = Pair(firmware, mission=(MISSION[0], MISSION[1], again))
    pair.run(20.0)
    assert pair.state is State.STANDBY
    assert not pair.commands(VelocitySetpoint)
    (said,) = [c.text for c in pair.commands(Say) if "refused" in c.text]
    assert f"mission item {2 if firmware is Firmware.PX4 else 3}: NAV_TAKEOFF" in said


@pytest.mark.parametrize("firmware", Firmware)
def test_the_pilots_switch_ends_it_within_one_heartbeat(firmware):
    pair = Pair(firmware)
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
def test_not_taken_on_the_ground(firmware):
    pair = Pair(firmware, airborne=False, start_position_ned_m=(0.0, 0.0, 0.0))
    pair.run(20.0)
    assert pair.state is State.STANDBY
    assert not pair.commands(VelocitySetpoint)
    assert pair.onboard.heart.own.takeoff is not None


@pytest.mark.parametrize("firmware", Firmware)
def test_a_silent_companion_leaves_the_vehicle_to_its_own_failsafe(firmware):
    pair = Pair(firmware)
    pair.run(15.0)
    now_s = pair.tick * TICK_S
    pair.vehicle.advance(now_s + 5.0)
    if firmware is Firmware.PX4:
        assert pair.vehicle.mode is VehicleMode.RTL
    else:
        assert pair.vehicle.mode is VehicleMode.EXTERNAL
        assert math.hypot(*pair.vehicle.velocity_ned_mps) < 1.0
    # Back after the pause the loop is late: fault, then, on PX4, the vehicle's own mode is respected.
    pair.tick += 100
    pair.run(1.5)
    moves = [c.state for c in pair.commands(AuthorityChanged)]
    assert "fault" in moves or "yielded" in moves


def test_link_silence_is_a_fault_and_nothing_is_sent():
    pair = Pair(Firmware.ARDUPILOT)
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
    pair = Pair(
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
    pair = Pair(firmware)
    worst = 0.0
    for _ in range(300):
        pair.run(0.2)
        if pair.state in HOLDING and pair.onboard.heart.in_control:
            worst = max(worst, pair.vehicle.position_ned_m[0] - 60.0)
    # 3 m/s into a right angle at 60 m north, 1 m/s2: fed forward blindly it went more than 6 m too far.
    assert worst < 3.0


@pytest.mark.parametrize("firmware", Firmware)
def test_a_mission_of_many_items_comes_over_a_slow_link(firmware):
    """0.1 s each way, as telemetry radios have, for each of 80 items: asked anew, it would begin again."""
    pair = Pair(firmware, mission=tuple(waypoint(seq, 10.0 * seq, 0.0, 50.0) for seq in range(1, 81)))
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
