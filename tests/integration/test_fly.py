"""`ground-tools fly` against served mock vehicles: processes over UDP on loopback, in real time."""

from __future__ import annotations

import json
import math
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from ground_tools import cli
from ground_tools.fly import command

pytest.importorskip("mavsdk", reason="mavsdk is not installed")
PATIENCE_S = 60.0
PLAN = {
    "fileType": "Plan",
    "mission": {
        "items": [
            {"type": "SimpleItem", "command": 22, "frame": 3, "params": [0, 0, 0, None, 47.397, 8.545, 4]},
            {"type": "SimpleItem", "command": 178, "frame": 2, "params": [1, 2, -1, 0, 0, 0, 0]},
            {"type": "SimpleItem", "command": 16, "frame": 3, "params": [0, 0, 0, None, 47.399, 8.545, 6]},
        ]
    },
}


class Process:
    """One of our commands; its lines are read as they come."""

    def __init__(self, module: str, *arguments: str) -> None:
        self.child = subprocess.Popen(
            [sys.executable, "-u", "-m", module, *arguments],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        self.lines: list[str] = []
        self._coming: queue.Queue[str | None] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.child.stdout is not None
        for line in self.child.stdout:
            self._coming.put(line.rstrip())
        self._coming.put(None)

    def expect(self, words: str) -> str:
        """Read on until a line holds some words."""
        end_s = time.monotonic() + PATIENCE_S
        while (line := self._coming.get(timeout=max(end_s - time.monotonic(), 0.1))) is not None:
            self.lines.append(line)
            if words in line:
                return line
        raise AssertionError(f"{words!r} never came: {self.lines}")

    def end(self, *, interrupt: bool = False) -> int:
        """Its exit code; the lines that were left are read."""
        if interrupt:
            self.child.send_signal(signal.SIGINT)
        code = self.child.wait(PATIENCE_S)
        while (line := self._coming.get(timeout=PATIENCE_S)) is not None:
            self.lines.append(line)
        return code


class Vehicle(Process):
    """A served mock vehicle, with its true positions."""

    def __init__(self, truth: Path, *arguments: str) -> None:
        super().__init__(
            "sitl_mocks.cli", "serve", "--link", "udpin:127.0.0.1:0", "--truth", str(truth), *arguments
        )
        self.address = "udpout://127.0.0.1:" + self.expect("link udpin").rpartition(":")[2]
        self.expect("ready")
        self._truth = truth

    def left(self) -> dict[str, object]:
        """End it; how it was left."""
        assert self.end(interrupt=True) == 0
        left: dict[str, object] = json.loads(self.lines[-1])
        return left

    def path(self) -> list[list[float]]:
        """Rows of UTC (s), north, east, down (m)."""
        return [[float(v) for v in line.split(",")] for line in self._truth.read_text().splitlines()[1:]]


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., Vehicle]]:
    """Starts vehicles; none is left behind."""
    vehicles: list[Vehicle] = []

    def start(*arguments: str) -> Vehicle:
        vehicles.append(Vehicle(tmp_path / f"{len(vehicles)}.csv", *arguments))
        return vehicles[-1]

    yield start
    for vehicle in vehicles:
        vehicle.child.kill()
        vehicle.child.wait(PATIENCE_S)


@pytest.fixture
def plan(tmp_path: Path) -> str:
    """A mission of a take-off, a speed and a waypoint 220 m to the north."""
    path = tmp_path / "m.plan"
    path.write_text(json.dumps(PLAN))
    return str(path)


def test_two_vehicles_meet_as_a_scenario_says_and_land(tmp_path, serve):
    """ArduPilot and PX4 manners: take-off, gathering, start together, both flown and landed."""
    scenario = tmp_path / "s.toml"
    scenario.write_text(
        "[[path]]\npoints = [[0, -6, 0, -4], [4, 6, 0, -4]]\n[[path]]\npoints = [[0, 6, 8, -4], [4, -6, 8, -4]]\n"
    )
    a = serve("--firmware", "ardupilot")
    b = serve("--firmware", "px4", "--system-id", "2", "--start", "0", "8")
    fly = Process("ground_tools.cli", "fly", a.address, b.address, "--scenario", str(scenario), "--takeoff", "4",
                  "--start", "--land", "--json")  # fmt: skip
    fly.expect("all at their starts: go")
    assert fly.end() == 0, fly.lines
    report = json.loads(fly.lines[-1])
    assert report["ok"] is True
    assert [v["firmware"] for v in report["vehicles"]] == ["ardupilot", "px4"]
    for vehicle, (north, east) in ((a, (6.0, 0.0)), (b, (-6.0, 8.0))):
        left = vehicle.left()
        assert left["armed"] is False
        assert left["setpoints_received"] == 0
        assert left["position_ned_m"] == pytest.approx([north, east, 0.0], abs=1.5)
        start = (-north, east, -4.0)
        assert min(math.dist(row[1:], start) for row in vehicle.path()) < 1.5
    # Neither begins before the other is there: they pass the middle at the same time.
    passing = [min(v.path(), key=lambda row: abs(row[1]) + 9.0 * (row[3] > -3.0))[0] for v in (a, b)]
    assert passing[0] == pytest.approx(passing[1], abs=2.5)


def test_ctrl_c_in_flight_leaves_it_holding(serve, plan):
    """From the ground by the mission's own take-off; on ArduPilot to BRAKE, armed, in the air."""
    vehicle = serve("--firmware", "ardupilot")
    fly = Process("ground_tools.cli", "fly", vehicle.address, "--mission", plan, "--start", "--wait")
    fly.expect("holds the mission, 3 items, read back and compared")
    fly.expect("mission: item 3, AUTO")
    assert fly.end(interrupt=True) == 130
    assert "in BRAKE: armed; land it" in fly.lines[-1]
    left = vehicle.left()
    assert (left["mode"], left["armed"]) == ("brake", True)
    assert left["position_ned_m"][2] < -3.0


def test_what_the_vehicle_says_when_it_refuses(serve, plan):
    """Arming is tried again; Ctrl-C ends it. Then: on the ground, a mission that begins in the air."""
    vehicle = serve("--firmware", "ardupilot", "--did", "require")
    fly = Process("ground_tools.cli", "fly", vehicle.address, "--takeoff", "5")
    line = fly.expect("trying again")
    assert "vehicle 1: COMPONENT_ARM_DISARM refused (FAILED): Arm: OpenDroneID:" in line
    assert fly.end(interrupt=True) == 130
    assert fly.lines[-1].endswith("vehicle 1 was not commanded anything")
    Path(plan).write_text(
        json.dumps({"fileType": "Plan", "mission": {"items": PLAN["mission"]["items"][1:]}})
    )
    fly = Process("ground_tools.cli", "fly", vehicle.address, "--mission", plan, "--start")
    fly.expect("vehicle 1: on the ground, and its mission does not begin with a take-off; add --takeoff")
    assert fly.end() == 1
    assert vehicle.left()["armed"] is False


def test_nobody_there(monkeypatch, capsys):
    monkeypatch.setattr(command, "_CONNECT_S", 0.5)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        address = f"udpout://127.0.0.1:{silent.getsockname()[1]}"
        assert cli.main(["fly", address, "--land", "--json"]) == 1
    out, err = capsys.readouterr()
    assert json.loads(out)["error"] == "vehicle 1: no autopilot heard within 0.5 s"
    assert "no autopilot heard" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "nothing to do"),
        (["--takeoff", "0.5"], "--takeoff: 0.5: allowed 1 to 500"),
        (["--land", "--wait"], "--wait: waits for missions that --start starts"),
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
    assert "ADDRESS: one is given twice" in capsys.readouterr().err


def test_no_address(capsys):
    assert cli.main(["fly", "127.0.0.1:9", "--land"]) == 2
    assert "CONNECTION_URL_INVALID; allowed is an address like udpout://" in capsys.readouterr().err


def test_without_mavsdk(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "mavsdk", None)
    assert cli.main(["fly", "udpout://127.0.0.1:9", "--land"]) == 2
    assert "mavsdk 4 is not installed; in the checkout: pip install -e '.[fly]'" in capsys.readouterr().err
