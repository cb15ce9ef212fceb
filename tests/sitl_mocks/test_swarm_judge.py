"""The judge of a swarm reports exactly the companions that override the pilot; test doubles on real links."""

from __future__ import annotations

import contextlib
import json
import re
import subprocess
import sys
import threading
import time

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import FrameScanner, MavlinkWriter
from companion.config import LimitsConfig
from companion.events import Firmware
from companion.runtime.links.open_link import open_link
from sitl_mocks.examinations.faults import Fault
from sitl_mocks.examinations.swarm.examination import Examination, ServedVehicle
from sitl_mocks.examinations.swarm.schedule import AircraftSchedule

GUIDED = 4
PATIENCE_S = 60.0


class Double(threading.Thread):
    """Flies the vehicle at once. A disobedient one requests its mode again 0.3 s after it reads another
    mode."""

    def __init__(self, link, *, obeys):
        super().__init__()
        self.stops = threading.Event()
        self.link = open_link(link)
        self.obeys = obeys
        self.writer = MavlinkWriter(1, 191)
        self.scanner = FrameScanner()
        self.clock_ms = 0
        self.authority = True
        self.steps = 0
        self.asks_at = 0

    def run(self):
        while not self.stops.wait(0.05):
            self.hear()
            out = [mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)]
            if self.steps == self.asks_at:
                out += [self.command(511, 33, 1e5), self.command(176, 1, GUIDED)]
            if self.authority and self.clock_ms:
                out.append(
                    mavlink.MAVLink_set_position_target_local_ned_message(
                        self.clock_ms, 1, 1, 1, 0x9C7, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0, 0
                    )
                )
            self.link.send(b"".join(self.writer.pack(message) for message in out))
            self.steps += 1
        self.link.abort()

    def hear(self):
        for frame in self.scanner.frames(self.link.receive(time.monotonic()).data):
            if frame.message_id == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
                self.clock_ms = int.from_bytes(frame.payload[:4], "little")
            heartbeat = frame.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT and frame.system_id == 1
            if not heartbeat or int.from_bytes(frame.payload[:4], "little") == GUIDED:
                continue
            if self.obeys:
                self.authority = False
            elif self.asks_at < self.steps:
                self.asks_at = self.steps + 6

    def command(self, number, *params):
        filled = (*map(float, params), *([0.0] * (7 - len(params))))
        return mavlink.MAVLink_command_long_message(1, 1, number, 0, *filled)


@pytest.fixture
def vehicle(tmp_path):
    """A served vehicle in GUIDED in the air."""
    child = subprocess.Popen(
        [sys.executable, "-u", "-m", "sitl_mocks.cli", "serve", "--airborne", "50", "--mode", "external"]
        + ["--link", "udpin:127.0.0.1:0"] * 2
        + ["--troubles"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        ports = [int(re.search(r":(\d+)$", child.stdout.readline())[1]) for _ in range(2)]
        assert child.stdout.readline() == "ready\n"
        yield ServedVehicle("ONE", Firmware.ARDUPILOT, 1, tuple(ports), child.stdin)
    finally:
        child.kill()
        child.communicate()


def examined(vehicle, folder, link, faults, *, awaited=frozenset()):
    """Report of a test double under these faults once it has broken the expected rules. Without faults it
    obeys."""
    schedule = AircraftSchedule(1, 1, 0, link, 4.5, faults)
    one = Examination(vehicle, LimitsConfig(max_speed_mps=6.0), time.monotonic(), schedule, folder)
    with contextlib.closing(one):
        one.start()
        double = Double(one.link_name, obeys=not awaited)
        double.start()
        try:
            give_up_s = time.monotonic() + PATIENCE_S
            while not (one.over and awaited <= rules(one.report())):
                assert time.monotonic() < give_up_s, one.report()
                time.sleep(0.02)
        finally:
            double.stops.set()
            double.join()
        one.rest()
    return one.report()


def rules(report):
    return {row["rule"] for row in report["breaches"]}


# Late enough that the test double has control by then, also on a busy computer.
RTL = Fault("mode", 2.0, modes=("rtl",))
AT_ONCE = Fault("mode", 2.0, modes=("land", "manual", "rtl"))


@pytest.mark.parametrize(("link", "mode"), [("udp", RTL), ("tcp", RTL), ("tcp", AT_ONCE), ("pty", AT_ONCE)])
def test_a_companion_that_overrides_the_pilot_is_reported(vehicle, tmp_path, link, mode):
    report = examined(vehicle, tmp_path, link, (mode,), awaited={"setpoint", "request", "left"})
    assert report["choices_while_held"] == 1
    assert report["unknown"] is None
    json.dumps(report)
    assert all(row["schedule_s"] > 2.0 for row in report["breaches"])


@pytest.mark.parametrize("link", ["udp", "tcp"])
def test_a_companion_that_yields_is_not(vehicle, tmp_path, link):
    report = examined(vehicle, tmp_path, link, (AT_ONCE,))
    assert report["breaches"] == []
    assert report["setpoints"] > 0
    assert report["choices_while_held"] == 1
    assert report["unknown"] is None


def test_a_vehicle_that_does_not_obey_stays_in_the_mode_of_the_pilot(vehicle, tmp_path):
    faults = (Fault("disobeyed", 0.1, 60.0), RTL)
    report = examined(vehicle, tmp_path, "udp", faults, awaited={"setpoint", "request"})
    assert "left" not in rules(report)
