"""`ground-tools fly` against served mock vehicles: processes over UDP on loopback, in real time."""

from __future__ import annotations

import json
import math
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ground_tools import cli
from ground_tools.fly import command
from tests.integration.conftest import PATIENCE_S
from tests.support.place import HOME

pytest.importorskip("mavsdk", reason="mavsdk is not installed")
PLAN = {
    "fileType": "Plan",
    "mission": {
        "items": [
            {
                "type": "SimpleItem",
                "command": 22,
                "frame": 3,
                "params": [0, 0, 0, None, HOME.lat_deg, HOME.lon_deg, 4],
            },
            {"type": "SimpleItem", "command": 178, "frame": 2, "params": [1, 2, -1, 0, 0, 0, 0]},
            {
                "type": "SimpleItem",
                "command": 16,
                "frame": 3,
                "params": [0, 0, 0, None, HOME.lat_deg + 0.002, HOME.lon_deg, 6],
            },
        ]
    },
}


class Vehicle:
    """A served mock vehicle, with its true positions."""

    def __init__(self, start: Callable[..., Any], truth: Path, *arguments: str) -> None:
        link = ("--link", "udpin:127.0.0.1:0", "--truth", truth)
        self._child = start("sitl_mocks.cli", "serve", *link, *arguments)
        self._child.wait_for("ready")
        self.address = "udpout://127.0.0.1:" + self._child.wait_for(r"link udpin:.*:(\d+)")[1]
        self._truth = truth

    def left(self) -> dict[str, Any]:
        """End it; how it was left."""
        assert self._child.end() == 0
        left: dict[str, Any] = json.loads(self._child.output.splitlines()[-1])
        return left

    def path(self) -> list[list[float]]:
        """Rows of UTC (s), north, east, down (m)."""
        return [[float(v) for v in line.split(",")] for line in self._truth.read_text().splitlines()[1:]]


@pytest.fixture
def plan(tmp_path: Path) -> str:
    """A mission of a take-off, a speed and a waypoint 220 m to the north."""
    path = tmp_path / "m.plan"
    path.write_text(json.dumps(PLAN))
    return str(path)


def test_two_vehicles_meet_as_a_scenario_says_and_land(tmp_path, start):
    """ArduPilot and PX4 manners: take-off, gathering, start together, both flown and landed."""
    scenario = tmp_path / "s.toml"
    scenario.write_text(
        "[[path]]\npoints = [[0, -6, 0, -3], [4, 6, 0, -3]]\n"
        "[[path]]\npoints = [[0, 26, 8, -3], [4, 38, 8, -3]]\n"
    )
    a = Vehicle(start, tmp_path / "a.csv", "--firmware", "ardupilot")
    b = Vehicle(start, tmp_path / "b.csv", "--firmware", "px4", "--system-id", "2", "--start", "0", "8")
    fly = start("ground_tools.cli", "fly", a.address, b.address, "--scenario", scenario, "--takeoff", "3",
                "--start", "--land", "--json")  # fmt: skip
    fly.wait_for("all vehicles have reached their start points and continue")
    assert fly.process.wait(PATIENCE_S) == 0, fly.output
    report = json.loads(fly.output.splitlines()[-1])
    assert report["ok"] is True
    assert [v["firmware"] for v in report["vehicles"]] == ["ardupilot", "px4"]
    passing = []
    for vehicle, begins, ends, east in ((a, -6.0, 6.0, 0.0), (b, 26.0, 38.0, 8.0)):
        left = vehicle.left()
        assert left["armed"] is False
        assert left["setpoints_received"] == 0
        # PX4's manner keeps some of its speed for seconds after a stop.
        assert left["position_ned_m"] == pytest.approx([ends, east, 0.0], abs=2.5)
        near = [
            [math.dist(row[1:], (north, east, -3.0)) for row in vehicle.path()] for north in (begins, ends)
        ]
        assert min(near[0]) < 1.5
        passing.append(next(row[0] for row, gap in zip(vehicle.path(), near[1], strict=True) if gap < 3.0))
    # One has 6 m to its start, the other 26 m, and still they are at their ends together.
    assert passing[0] == pytest.approx(passing[1], abs=2.5)


def test_ctrl_c_in_flight_leaves_it_holding(tmp_path, start, plan):
    """From the ground by the mission's own take-off; on ArduPilot to BRAKE, armed, in the air."""
    vehicle = Vehicle(start, tmp_path / "a.csv", "--firmware", "ardupilot")
    fly = start("ground_tools.cli", "fly", vehicle.address, "--mission", plan, "--start", "--wait")
    fly.wait_for(r"mission uploaded \(3 items\) and verified by reading it back")
    fly.wait_for("mission: item 3, AUTO")
    assert fly.end() == 130
    assert fly.output.endswith("in BRAKE and is armed; land it\n")
    left = vehicle.left()
    assert (left["mode"], left["armed"]) == ("brake", True)
    assert left["position_ned_m"][2] < -3.0


def test_what_the_vehicle_says_when_it_refuses(tmp_path, start):
    """Arming is tried again; Ctrl-C ends it."""
    vehicle = Vehicle(start, tmp_path / "a.csv", "--firmware", "ardupilot", "--did", "require")
    fly = start("ground_tools.cli", "fly", vehicle.address, "--takeoff", "5")
    fly.wait_for(
        r"vehicle 1: COMPONENT_ARM_DISARM was refused \(FAILED\): Arm: OpenDroneID: .*; trying again"
    )
    assert fly.end() == 130
    assert fly.output.endswith("vehicle 1 was not commanded to move\n")
    assert vehicle.left()["armed"] is False


def test_nobody_there(monkeypatch, capsys):
    monkeypatch.setattr(command, "_CONNECT_S", 0.5)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        address = f"udpout://127.0.0.1:{silent.getsockname()[1]}"
        assert cli.main(["fly", address, "--land", "--json"]) == 1
    out, err = capsys.readouterr()
    assert json.loads(out)["error"] == (
        f"vehicle 1: {address}: no autopilot was heard within 0.5 s; check its power, the address, and "
        "whether another program listens there"
    )
    assert "no autopilot was heard" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "nothing to do"),
        (["--takeoff", "0.5"], "--takeoff: 0.5 is out of range; allowed: 1 to 500"),
        (["--land", "--wait"], "--wait is allowed only with --start"),
        (["--mission", "PLAN", "--mission", "PLAN"], "--mission: 2 files for 1 vehicles"),
        (["--scenario", "config/scenarios/s2.toml"], "5 aircraft for 1 vehicles"),
        (["--land", "--seed", "-1"], "--seed: -1"),
    ],
)
def test_options_that_do_not_go_together(arguments, words, plan, capsys):
    given = [plan if word == "PLAN" else word for word in arguments]
    assert cli.main(["fly", "udpout://127.0.0.1:9", *given]) == 2
    assert words in capsys.readouterr().err


def test_one_address_for_two(capsys):
    assert cli.main(["fly", "udpout://127.0.0.1:9", "udpout://127.0.0.1:9", "--land"]) == 2
    assert "ADDRESS: an address is given twice" in capsys.readouterr().err


def test_no_address(capsys):
    assert cli.main(["fly", "127.0.0.1:9", "--land"]) == 2
    assert "this is not an address; allowed: for example udpout://" in capsys.readouterr().err


def test_a_port_that_another_program_has(capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        assert cli.main(["fly", f"udpin://127.0.0.1:{other.getsockname()[1]}", "--land"]) == 2
    assert "another program uses the port" in capsys.readouterr().err


def test_a_scenario_that_is_not_there(capsys):
    assert cli.main(["fly", "udpout://127.0.0.1:9", "--scenario", "face_to_face"]) == 2
    assert (
        "--scenario: face_to_face: no such file; see config/scenarios for examples" in capsys.readouterr().err
    )


def test_without_mavsdk(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "mavsdk", None)
    assert cli.main(["fly", "udpout://127.0.0.1:9", "--land"]) == 2
    assert (
        "mavsdk 4 is not installed; to install it, run in the checkout: pip install -e '.[fly]'"
        in capsys.readouterr().err
    )
