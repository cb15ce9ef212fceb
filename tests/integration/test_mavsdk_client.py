"""MAVSDK, a client that shares no code with us, flies the served mock vehicle over UDP on loopback."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import pytest

from tests.support.place import HOME
from tests.support.waiting import PATIENCE_S, until

mavsdk = pytest.importorskip("mavsdk", reason="mavsdk is not installed")

SERVE = """
import argparse, sys
from sitl_mocks.vehicle.real_time import server
parser = argparse.ArgumentParser()
server.add_arguments(parser)
sys.exit(server.run(parser.parse_args()))
"""
STALL_S = 0.8
"""Longer than a wait of the test from one look to the next, and shorter than PX4 waits for setpoints."""
LAT, LON = HOME.lat_deg, HOME.lon_deg


class Served:
    """A mock vehicle in a process of its own."""

    def __init__(self, *arguments: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", SERVE, *arguments], stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        kind, name = self._process.stdout.readline().split()
        assert kind == "link"
        self.port = int(name.rpartition(":")[2])
        assert self._process.stdout.readline() == "ready\n"

    def end(self) -> dict[str, object]:
        """End it as Ctrl-C does; return what it says at its end."""
        self._process.send_signal(signal.SIGINT)
        said, _ = self._process.communicate(timeout=60)
        assert self._process.returncode == 0
        left: dict[str, object] = json.loads(said.splitlines()[-1])
        return left

    def kill(self) -> None:
        """Make sure that it is gone."""
        self._process.kill()
        self._process.wait(timeout=60)


@pytest.fixture
def served(request: pytest.FixtureRequest) -> Iterator[Served]:
    """The vehicle of the firmware under test, on a port of the system's choice."""
    vehicle = Served("--firmware", request.param, "--link", "udpin:127.0.0.1:0")
    yield vehicle
    vehicle.kill()


@pytest.mark.parametrize("served", ["px4", "ardupilot"], indirect=True)
def test_mavsdk_flies_the_mock(served: Served, request: pytest.FixtureRequest) -> None:
    """Connect, telemetry, mission up and down, arm, take off, offboard velocity, mission, land."""
    from mavsdk.plugins.telemetry import FlightMode, LandedState, Telemetry

    ardupilot = "ardupilot" in request.node.callspec.id
    ground = mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION)
    with mavsdk.Mavsdk(ground) as client:
        assert client.add_any_connection(f"udpout://127.0.0.1:{served.port}").name == "SUCCESS"
        system = client.first_autopilot(PATIENCE_S)
        assert system is not None
        telemetry = Telemetry(system)
        # An ArduPilot link is silent until it is asked.
        telemetry.set_rate_position(10)
        telemetry.set_rate_position_velocity_ned(10)
        telemetry.set_rate_landed_state(5)
        until(lambda: math.isfinite(telemetry.position().latitude_deg))
        assert telemetry.position().latitude_deg == pytest.approx(LAT, abs=1e-6)
        assert telemetry.position().absolute_altitude_m == pytest.approx(400.0, abs=0.1)
        until(lambda: telemetry.landed_state() == LandedState.ON_GROUND)
        assert not telemetry.armed()

        raw = _exchange_mission(system, ardupilot)
        _take_off(system, telemetry)
        _fly_offboard(system, telemetry)
        raw.start_mission()
        until(lambda: telemetry.flight_mode() == FlightMode.MISSION)
        until(lambda: raw.mission_progress().current >= (2 if ardupilot else 1))
    left = served.end()
    assert left["armed"] is True
    assert left["mode"] == "mission"
    assert isinstance(left["setpoints_received"], int)
    assert left["setpoints_received"] > 20


def _exchange_mission(system: object, ardupilot: bool) -> object:
    from mavsdk.plugins.mission_raw import MissionItem, MissionRaw

    raw = MissionRaw(system)
    places = [(22, 0.0, 5.0), (16, 1e-3, 10.0), (16, 2e-3, 12.0)]
    wanted = [(0, 16, 0.0, 0.0)] if ardupilot else []
    wanted += [(6, command, north, height) for command, north, height in places]
    items = [
        MissionItem(seq, frame, command, int(seq == 0), 1, 0.0, 0.0, 0.0, math.nan,
                    round((LAT + north) * 1e7), round(LON * 1e7), height, 0)
        for seq, (frame, command, north, height) in enumerate(wanted)
    ]  # fmt: skip
    raw.upload_mission(items)
    back = raw.download_mission()
    assert len(back) == len(items)
    first = 1 if ardupilot else 0
    assert [(i.command, i.frame, i.x, i.y, i.z) for i in back[first:]] == [
        (i.command, i.frame, i.x, i.y, i.z) for i in items[first:]
    ]
    if ardupilot:
        assert back[0].z == pytest.approx(400.0)
    return raw


def _take_off(system: object, telemetry: object) -> None:
    from mavsdk.plugins.action import Action
    from mavsdk.plugins.telemetry import LandedState

    action = Action(system)
    action.set_takeoff_altitude(5.0)
    action.arm()
    until(lambda: telemetry.armed())
    action.takeoff()
    until(lambda: telemetry.position().relative_altitude_m > 4.5)
    until(lambda: telemetry.landed_state() == LandedState.IN_AIR)


def _fly_offboard(system: object, telemetry: object) -> None:
    from mavsdk.plugins.offboard import Offboard, OffboardError, VelocityNedYaw
    from mavsdk.plugins.telemetry import FlightMode

    offboard = Offboard(system)
    looked_s, stalled = time.monotonic(), False

    def look() -> None:
        nonlocal looked_s, stalled
        now_s = time.monotonic()
        looked_s, stalled = now_s, stalled or now_s - looked_s > STALL_S

    def begin() -> None:
        """Begin, unless a stall of the machine, in which no setpoints came, ends it."""
        offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
        time.sleep(0.3)
        try:
            offboard.start()
        except OffboardError:
            look()
            if not stalled:
                raise
        offboard.set_velocity_ned(VelocityNedYaw(3.0, -1.0, 0.0, 0.0))

    def begin_again_after_a_stall() -> None:
        nonlocal stalled
        look()
        if stalled and telemetry.flight_mode() != FlightMode.OFFBOARD:
            stalled = False
            begin()

    def wait(condition: Callable[[], bool]) -> None:
        until(condition, "offboard flight", meanwhile=begin_again_after_a_stall)

    begin()
    wait(lambda: telemetry.flight_mode() == FlightMode.OFFBOARD)
    # PX4 flies 80 to 87 % of what it is asked.
    wait(lambda: telemetry.position_velocity_ned().velocity.north_m_s > 2.3)
    assert telemetry.position_velocity_ned().velocity.east_m_s == pytest.approx(-0.9, abs=0.3)
    offboard.stop()
    until(lambda: telemetry.flight_mode() != FlightMode.OFFBOARD)
