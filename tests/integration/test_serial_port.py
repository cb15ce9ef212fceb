"""The companion on a serial port: pseudo-terminals stand in for the UART, a served mock for the autopilot."""

from __future__ import annotations

import contextlib
import json
import os
import random
import re
import select
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from unittest.mock import ANY

import pytest
import serial

from companion.autopilot.wire import FrameScanner, mavlink
from companion.commands import cli
from tests.integration.conftest import PATIENCE_S, Child, again_after_a_stall
from tests.support.place import NORTHWARD
from tests.support.waiting import until

PROFILE = (Path(__file__).parents[2] / "config" / "ardupilot-serial.toml").read_text()
SETPOINT = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED


class Cable:
    """Carries bytes between a vehicle on UDP and a pseudo-terminal that `device` names, as udev would."""

    def __init__(self, device: Path) -> None:
        self.device = device
        self.spoil: Callable[[bytes], bytes] = bytes
        """What the line makes of the vehicle's bytes."""
        self.setpoints = 0
        """Of the companion, so far."""
        self._scanner = FrameScanner()
        self._ends: tuple[int, int] | None = None
        self._air = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._air.bind(("127.0.0.1", 0))
        self.link = f"udpout:127.0.0.1:{self._air.getsockname()[1]}"
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._pump, daemon=True)
        self._thread.start()

    def plug(self) -> None:
        """A new device, of the same name."""
        ours, theirs = os.openpty()
        tty.setraw(theirs)
        os.set_blocking(ours, False)
        with self._lock:
            self._ends = ours, theirs
        self.device.symlink_to(os.ttyname(theirs))

    def pull(self) -> None:
        """The device is gone, and its name with it."""
        self.device.unlink()
        with self._lock:
            assert self._ends is not None
            for end in self._ends:
                os.close(end)
            self._ends = None

    def _pump(self) -> None:
        peer = None
        while not self._ended.is_set():
            with self._lock:
                ours = None if self._ends is None else self._ends[0]
                ready = select.select([self._air] if ours is None else [self._air, ours], [], [], 0.002)[0]
                if self._air in ready:
                    data, peer = self._air.recvfrom(65536)
                    if ours is not None:
                        with contextlib.suppress(BlockingIOError):  # nobody reads: a line loses it
                            os.write(ours, self.spoil(data))
                if ours in ready and ours is not None:
                    data = os.read(ours, 65536)
                    frames = self._scanner.frames(data)
                    self.setpoints += sum(f.message_id == SETPOINT for f in frames)
                    if peer is not None:
                        self._air.sendto(data, peer)
            time.sleep(0.001)

    def wait_for_setpoints(self, more: int, companion: Child) -> None:
        """Until the companion has sent so many more."""
        wanted = self.setpoints + more
        until(lambda: self.setpoints >= wanted, "setpoints", PATIENCE_S, meanwhile=companion.check_stall)

    def close(self) -> None:
        """Ends the line."""
        self._ended.set()
        self._thread.join(60.0)
        if self._ends is not None:
            self.pull()
        self._air.close()


@pytest.fixture
def cable(tmp_path: Path) -> Iterator[Cable]:
    made = Cable(tmp_path / "autopilot")
    made.plug()
    yield made
    made.close()


def profile(folder: Path, cable: Cable, **more: str) -> Path:
    """The profile that is shipped, on this cable."""
    (folder / "t.toml").write_text(NORTHWARD)
    text = PROFILE
    ours = {
        "/dev/autopilot": str(cable.device),
        "keep_free_mb = 500.0": f'keep_free_mb = 1.0\nfolder = "{folder / "runs"}"\nname = "test"',
    }
    for old, new in {**ours, **more}.items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / "companion.toml"
    path.write_text(text)
    return path


FLY = {
    'use = "watch"': 'use = "fly"\ntrajectory = "t.toml"\ntake_in_flight = true',
    "[record]": '[avoidance]\nlaw = "none"\n[record]',
}


def noisy(seed: int) -> Callable[[bytes], bytes]:
    """Garbage between the vehicle's packets, and a packet in ten with one byte hit."""
    rng = random.Random(seed)

    def spoil(data: bytes) -> bytes:
        if rng.random() < 0.1:
            at = rng.randrange(len(data))
            data = data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]
        return rng.randbytes(rng.randrange(40)) + data

    return spoil


@again_after_a_stall
def test_flies_through_noise_and_a_cable_that_is_pulled_and_plugged_again(start, tmp_path, cable):
    cable.spoil = noisy(1)
    vehicle = start("sitl_mocks.cli", "serve", "--airborne", "50", "--mode", "external", "--link", cable.link)
    vehicle.wait_for("ready")
    companion = start("companion.commands.cli", "run", "--config", profile(tmp_path, cable, **FLY))
    companion.must_not_stall = True
    companion.wait_for("standby -> guarding")
    cable.wait_for_setpoints(20, companion)
    companion.must_not_stall = False  # it gives the vehicle back now
    cable.pull()
    companion.wait_for("autopilot:921600: lost: .*; reopening it")
    # Which of them comes first depends on milliseconds, on heartbeats that the noise spoiled, and on stalls.
    companion.wait_for("guarding -> fault: (own position older than|no heartbeat from|.*no command sent for)")
    cable.plug()
    companion.wait_for("autopilot:921600: restored")
    companion.wait_for("fault -> standby: own state usable again")
    # The first setpoints come before our mode, and a stop before it is reported may leave the vehicle in it.
    companion.wait_for("fault -> standby(?s:.*)\nguarding; vehicle mode external")
    cable.wait_for_setpoints(20, companion)
    assert companion.end() == 0
    assert vehicle.end() == 0
    left = json.loads(vehicle.output.splitlines()[-1])
    assert left["mode"] in ("hold", "brake"), companion.output
    assert left["setpoints_received"] > 30
    (file,) = (tmp_path / "runs").glob("*-test/*.events")
    summary = json.loads((file.parent / "summary.json").read_text())
    assert (summary["link_losses"], summary["records_dropped"]) == (1, 0)
    assert cli.main(["replay", str(file.parent)]) == 0


@pytest.fixture
def checked(tmp_path, cable, monkeypatch, capsys) -> Callable[..., dict[str, list[dict[str, str]]]]:
    """What `companion check` finds on the cable, by subject."""
    monkeypatch.setattr("companion.commands.check_radios._RADIO_S", 0.1)
    for name, seconds in (("SETTLE", 1.0), ("MEASURE", 2.5), ("PARAMETERS", 0.1)):
        monkeypatch.setattr(f"companion.commands.check._{name}_S", seconds)

    def run(**more: str) -> dict[str, list[dict[str, str]]]:
        cli.main(["check", "--json", "--config", str(profile(tmp_path, cable, **more))])
        found: dict[str, list[dict[str, str]]] = {}
        for finding in json.loads(capsys.readouterr().out)["findings"]:
            found.setdefault(finding["what"], []).append(finding)
        return found

    return run


def test_check_of_a_serial_port_that_is_well_noisy_of_another_rate_and_in_use(start, cable, checked):
    vehicle = start("sitl_mocks.cli", "serve", "--link", cable.link)
    vehicle.wait_for("ready")
    well = checked()
    assert well["link"] == [{"light": "green", "what": "link", "text": ANY, "do": ""}]
    assert [f["light"] for f in well["rates"]] == ["green"]

    cable.spoil = noisy(2)
    found = checked()
    (link,) = found["link"]
    assert (link["light"], link["text"].endswith(" damaged frames")) == ("yellow", True)
    assert {f["light"] for f in found["vehicle"]} == {"green"}

    rng = random.Random(3)
    cable.spoil = lambda data: rng.randbytes(len(data))
    brief = {"[vehicle]": "[vehicle]\nwait_s = 2.0"}
    (found,) = checked(**brief)["vehicle"]
    assert found["light"] == "red"
    assert re.search(r"no vehicle within 2 s; [1-9]\d+ bytes were received, but no MAVLink", found["text"])
    assert "baud rate" in found["do"]

    cable.spoil = bytes
    (found,) = checked(**{"[vehicle]": "[vehicle]\nwait_s = 2.0\nsystem_id = 7"})["vehicle"]
    assert re.search(r"[1-9]\d* MAVLink frames were received, but no autopilot HEARTBEAT", found["text"])
    assert "vehicle.system_id" in found["do"]

    with serial.Serial(str(cable.device), exclusive=True):
        (found,) = checked(**brief)["link"]
    assert "another program has it open" in found["text"]
    cable.pull()
    (found,) = checked(**brief)["link"]
    assert "there is no such device" in found["text"]
    cable.plug()
