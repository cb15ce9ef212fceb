"""`companion run` as a process against the served mock vehicle."""

from __future__ import annotations

import io
import json
import os
import re
import signal
import socket
import time
from pathlib import Path

import pytest

from companion import event_record
from companion.autopilot.tlog import read_tlog
from companion.autopilot.wire import MavlinkReader, MavlinkWriter, mavlink, message_id_of
from companion.commands import cli
from companion.events import AuthorityChanged, Heartbeat, VelocitySetpoint
from tests.integration.conftest import PATIENCE_S, again_after_a_stall
from tests.support.place import NORTHWARD
from tests.support.waiting import until

NAME = f"TEST{os.getpid()}"
"""No aircraft of another worker of the tests: each is flown by one companion on a computer."""
SETPOINT = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED


def write_config(folder: Path, link: str, **flight: str) -> Path:
    (folder / "t.toml").write_text(NORTHWARD)
    keys = {"use": '"fly"', "trajectory": '"t.toml"', "take_in_flight": "true", **flight}
    lines = "\n".join(f"{key} = {value}" for key, value in keys.items())
    path = folder / "c.toml"
    path.write_text(
        f'[identity]\nuas_id = "{NAME}"\n[vehicle]\nlink = "{link}"\nwait_s = 20.0\n[flight]\n{lines}\n'
        f'[avoidance]\nlaw = "none"\n'
        f'[record]\nfolder = "{folder / "runs"}"\nname = "test"\nsync_period_s = 0.2\n'
    )
    return path


class Station:
    """A ground station on the vehicle's second link."""

    def __init__(self, vehicle, companion):
        self.companion = companion
        port = re.findall(r"link udpin:127\.0\.0\.1:(\d+)", vehicle.output)[1]
        self.writer = MavlinkWriter(255, 190)
        self.reader = MavlinkReader()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", int(port)))
        self.socket.settimeout(0.2)
        self.send(self.writer.encoder.heartbeat_encode(6, 8, 0, 0, 4))
        self.send(self.writer.encoder.command_long_encode(1, 1, 511, 0, 33, 200_000, 0, 0, 0, 0, 0))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def send(self, message):
        self.socket.send(self.writer.pack(message))

    def wait_for(self, kind, good):
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            self.companion.check_stall()
            try:
                data = self.socket.recv(65536)
            except TimeoutError:
                continue
            if any(m.get_type() == kind and good(m) for m in self.reader.feed(data)):
                return
        raise AssertionError(f"no such {kind} came")


def fly(start, tmp_path, firmware):
    """A vehicle in the air and a companion that holds it, and must not stall."""
    mode = "external" if firmware == "ardupilot" else "hold"
    vehicle = start(
        "sitl_mocks.cli", "serve", "--firmware", firmware, "--airborne", "50", "--mode", mode,
        "--link", "udpin:127.0.0.1:0", "--link", "udpin:127.0.0.1:0",
    )  # fmt: skip
    vehicle.wait_for("ready")
    port = vehicle.wait_for(r"link udpin:127\.0\.0\.1:(\d+)").group(1)
    path = write_config(tmp_path, f"udpout:127.0.0.1:{port}")
    companion = start("companion.commands.cli", "run", "--config", path)
    companion.must_not_stall = True
    companion.wait_for("standby -> guarding")
    return vehicle, companion


def the_record(tmp_path):
    (file,) = (tmp_path / "runs").glob(f"*-test/{NAME}.events")
    return file, list(event_record.read(io.BytesIO(file.read_bytes()), file.name))


def count_setpoints(items):
    return sum(
        isinstance(c, VelocitySetpoint)
        for item in items
        if isinstance(item, event_record.Step)
        for c in item.commands
    )


def wait_for_setpoints(tmp_path, count, companion):
    """Wait until as many are in the record: on a busy machine they come more slowly than at 20 Hz."""
    files = (tmp_path / "runs").glob
    until(
        lambda: any(file.stat().st_size for file in files(f"*-test/{NAME}.events")), "the record", PATIENCE_S
    )
    until(
        lambda: count_setpoints(the_record(tmp_path)[1]) >= count,
        "setpoints",
        PATIENCE_S,
        meanwhile=companion.check_stall,
        pause_s=0.2,
    )


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
@again_after_a_stall
def test_flies_and_ends_cleanly_leaving_the_vehicle_holding(start, tmp_path, firmware):
    vehicle, companion = fly(start, tmp_path, firmware)
    # The first may come right after the take-over; five seconds lie between them.
    companion.wait_for("vehicle mode external(?s:.*)vehicle mode external")
    wait_for_setpoints(tmp_path, 120, companion)
    assert companion.end() == 0
    assert "asking the vehicle to hold" in companion.output
    assert vehicle.end() == 0
    left = json.loads(vehicle.output.splitlines()[-1])
    assert left["mode"] in ("hold", "brake")
    assert left["setpoints_received"] > 50
    file, items = the_record(tmp_path)
    assert isinstance(items[0], event_record.Header)
    summary = json.loads((file.parent / "summary.json").read_text())
    assert summary["records_dropped"] == 0
    assert summary["recorder_error"] is None
    with (file.parent / f"{NAME}.tlog").open("rb") as stream:
        frames = list(read_tlog(stream, "tlog"))
    systems = {(frame[5], frame[6]) for _, frame in frames}
    assert systems == {(1, 1), (1, 191)}
    sent = sum(frame[6] == 191 and message_id_of(frame) == SETPOINT for _, frame in frames)
    assert abs(sent - left["setpoints_received"]) <= 2
    assert sent <= count_setpoints(items), "on a busy machine some wait too long to leave"
    assert next(frame[4] for _, frame in frames if frame[6] == 191) == 0, "the first frame is in the log"
    assert cli.main(["replay", str(file.parent)]) == 0


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
@again_after_a_stall
def test_kill_leaves_a_readable_record_and_the_vehicle_to_its_failsafe(start, tmp_path, firmware):
    vehicle, companion = fly(start, tmp_path, firmware)
    companion.wait_for("vehicle mode external")
    with Station(vehicle, companion) as station:
        station.wait_for("GLOBAL_POSITION_INT", lambda m: m.vx > 50)
        wait_for_setpoints(tmp_path, 30, companion)
        assert companion.end(signal.SIGKILL) == -signal.SIGKILL
        if firmware == "ardupilot":
            # Brakes after GUID_TIMEOUT and stays in GUIDED.
            station.wait_for("GLOBAL_POSITION_INT", lambda m: abs(m.vx) < 10)
            station.wait_for("HEARTBEAT", lambda m: m.custom_mode == 4)
        else:
            station.wait_for("HEARTBEAT", lambda m: m.custom_mode == 0x05040000)
    file, items = the_record(tmp_path)
    assert count_setpoints(items) > 20
    assert not (file.parent / "summary.json").exists()
    assert cli.main(["replay", str(file.parent)]) == 0


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
@again_after_a_stall
def test_a_companion_that_was_stopped_leaves_the_vehicle_to_its_failsafe_and_goes_on(
    start, tmp_path, firmware
):
    """Whatever stopped it for longer than its watchdog lets a loop hang: what is over is over."""
    vehicle, companion = fly(start, tmp_path, firmware)
    companion.wait_for("vehicle mode external")
    with Station(vehicle, companion) as station:
        station.wait_for("GLOBAL_POSITION_INT", lambda m: m.vx > 50)
        companion.must_not_stall = False
        companion.process.send_signal(signal.SIGSTOP)
        if firmware == "ardupilot":
            station.wait_for("GLOBAL_POSITION_INT", lambda m: abs(m.vx) < 10)
        else:
            station.wait_for("HEARTBEAT", lambda m: m.custom_mode == 0x05040000)
        time.sleep(5.0)
        companion.process.send_signal(signal.SIGCONT)
        companion.wait_for("guarding -> (fault|yielded)")
        companion.wait_for("(fault|yielded)(?s:.*)\n(standby|guarding|yielded); vehicle mode")
    assert companion.end() == 0
    assert "watchdog" not in companion.output
    file, _ = the_record(tmp_path)
    assert (file.parent / "summary.json").exists()
    assert cli.main(["replay", str(file.parent)]) == 0
    assert vehicle.end() == 0


def test_a_dry_run_leaves_the_vehicle_alone(start, tmp_path):
    vehicle = start(
        "sitl_mocks.cli", "serve", "--firmware", "px4", "--link", "udpin:127.0.0.1:0", "--airborne", "50"
    )
    port = vehicle.wait_for(r"link udpin:127\.0\.0\.1:(\d+)").group(1)
    path = write_config(tmp_path, f"udpout:127.0.0.1:{port}")
    companion = start("companion.commands.cli", "run", "--config", path, "--dry-run")
    companion.wait_for("standby -> guarding")
    companion.wait_for("tracks; radio")
    wait_for_setpoints(tmp_path, 30, companion)
    assert companion.end() == 0
    assert vehicle.end() == 0
    left = json.loads(vehicle.output.splitlines()[-1])
    assert left["setpoints_received"] == 0
    assert left["mode"] == "hold"
    _, items = the_record(tmp_path)
    assert count_setpoints(items) > 20


def test_no_vehicle_is_one_line_and_exit_code_2(start, tmp_path):
    path = write_config(tmp_path, "udpin:127.0.0.1:0")
    path.write_text(path.read_text().replace("wait_s = 20.0", "wait_s = 1.0"))
    companion = start("companion.commands.cli", "run", "--config", path)
    assert companion.process.wait(PATIENCE_S) == 2
    assert "no vehicle within 1 s" in companion.output.splitlines()[-1]


def test_a_port_in_use_is_one_line_and_exit_code_2(start, tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        path = write_config(tmp_path, f"udpin:127.0.0.1:{taken.getsockname()[1]}")
        companion = start("companion.commands.cli", "run", "--config", path)
        assert companion.process.wait(PATIENCE_S) == 2
    assert "is in use by another program" in companion.output.splitlines()[-1]


def test_a_path_that_breaks_the_speed_limit_is_one_line_and_exit_code_2(start, tmp_path):
    path = write_config(tmp_path, "udpin:127.0.0.1:0")
    (tmp_path / "t.toml").write_text(NORTHWARD.replace("300.0", "30.0"))
    companion = start("companion.commands.cli", "run", "--config", path)
    assert companion.process.wait(PATIENCE_S) == 2
    (line,) = companion.output.splitlines()
    assert "flight.trajectory: leg from waypoint[0] to waypoint[1]: horizontal speed 12.97" in line


def test_a_vehicle_that_cannot_be_flown_is_one_line_and_exit_code_2(start, tmp_path):
    """A rover's heartbeats."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    companion = start(
        "companion.commands.cli", "run", "--config", write_config(tmp_path, f"udpin:127.0.0.1:{port}")
    )
    companion.wait_for("waiting for a vehicle")
    writer = MavlinkWriter(1, 1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as rover:
        while companion.process.poll() is None:
            heartbeat = writer.encoder.heartbeat_encode(mavlink.MAV_TYPE_GROUND_ROVER, 3, 1, 0, 4)
            rover.sendto(writer.pack(heartbeat), ("127.0.0.1", port))
            time.sleep(0.1)
    assert companion.process.returncode == 2
    assert "rover" in companion.output.splitlines()[-1]


def test_check_says_what_is_missing(start, tmp_path):
    vehicle = start("sitl_mocks.cli", "serve", "--link", "udpin:127.0.0.1:0")
    port = vehicle.wait_for(r"link udpin:127\.0\.0\.1:(\d+)").group(1)
    path = write_config(tmp_path, f"udpout:127.0.0.1:{port}")
    checked = start("companion.commands.cli", "check", "--config", path)
    assert checked.process.wait(PATIENCE_S) == 1
    assert checked.output.splitlines()[-1] == "check: NOT ready"
    assert "configuration: valid" in checked.output
    assert "vehicle: " in checked.output
    assert "vehicle: without setpoints for 3 s (GUID_TIMEOUT) it brakes and stays in GUIDED" in checked.output
    slow = "vehicle: WPNAV_SPEED_DN 1.5 (set in centimetres: 150) is below limits.max_descent_mps 2"
    assert slow in checked.output
    assert "radio: none configured, and avoidance.law is none" in checked.output


@again_after_a_stall
def test_the_pilot_takes_over(start, tmp_path):
    """Another ground station's mode change ends the setpoints."""
    vehicle, companion = fly(start, tmp_path, "ardupilot")
    companion.wait_for("vehicle mode external")
    wait_for_setpoints(tmp_path, 30, companion)
    with Station(vehicle, companion) as station:
        companion.must_not_stall = False  # it gives the vehicle back now
        station.send(station.writer.encoder.command_long_encode(1, 1, 176, 0, 1, 5, 0, 0, 0, 0, 0))
        companion.wait_for("-> yielded: mode changed to LOITER, not by the companion")
    companion.wait_for("yielded; vehicle mode sticks")
    assert companion.end() == 0
    _, items = the_record(tmp_path)
    steps = [item for item in items if isinstance(item, event_record.Step)]
    seen = next(
        k
        for k, s in enumerate(steps)
        if any(isinstance(c, AuthorityChanged) and c.state == "yielded" for c in s.commands)
    )
    # No setpoint in the step that saw the pilot's mode, and none after it.
    assert any(isinstance(e, Heartbeat) for e in steps[seen].events)
    assert count_setpoints(steps[:seen]) > 20
    assert count_setpoints(steps[seen:]) == 0
