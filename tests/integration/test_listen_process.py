"""`companion remote-id listen` as a real process: terminal, pipe and JSON, on simulated air and Bluetooth."""

from __future__ import annotations

import json
import os
import pty
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from companion.radio.ether.datagrams import Send, encode
from companion.radio.ether.ether_radio import EtherTransport
from companion.radio.frames_io import radio_address
from companion.radio.hci.hci_radio import HciTransport
from companion.remote_id.messages import BasicId, IdType, Location, Status, UaType
from tests.integration.conftest import PATIENCE_S
from tests.support import waiting

ADDRESS = radio_address("INTRUDER")
MESSAGES = (
    BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.GLIDER, uas_id="1596B00000GLIDER"),
    Location(status=Status.AIRBORNE, lat_deg=47.5, lon_deg=8.5, alt_geodetic_m=500.0, speed_mps=20.0),
)


@pytest.fixture
def endpoint(start: Callable[..., Any]) -> str:
    """The simulated air; where it listens."""
    child = start("sitl_mocks.cli", "ether", "--listen", "127.0.0.1:0")
    return child.wait_for(r"ether on (\S+)").group(1)


@pytest.fixture
def intruder(endpoint: str) -> Iterator[Callable[[], None]]:
    """Sends one beacon, one BLE 4 pair and one broken frame at each call."""
    radio = EtherTransport(endpoint, "INTRUDER", ADDRESS)

    def send() -> None:
        now_s = time.monotonic()
        radio.heard(now_s)
        radio.broadcast("wifi", MESSAGES, now_s)
        radio.broadcast("ble4", MESSAGES, now_s)
        radio._socket.send(encode(Send("wifi", ADDRESS, b"\x80\x00broken")))

    yield send
    radio.close()


def until(condition: Callable[[], bool], send: Callable[[], None]) -> None:
    """Send until a condition holds."""
    waiting.until(condition, "what was sent", PATIENCE_S, meanwhile=send, pause_s=0.1)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_plain_lines_into_a_pipe(
    start: Callable[..., Any], endpoint: str, intruder: Callable[[], None], number: signal.Signals
) -> None:
    child = start("companion.commands.cli", "remote-id", "listen", "--radio", f"ether={endpoint}")
    until(lambda: "identity 1596B00000GLIDER" in child.output and "ble4+wifi" in child.output, intruder)
    assert child.end(number) == 0
    assert "type glider" in child.output
    assert f"address {ADDRESS}" in child.output
    assert "position 47.500000 8.500000; alt m 500.0; m/s 20.0" in child.output
    last = child.output.splitlines()[-1]
    assert f"radio: simulated air at {endpoint}: connected; 1 aircraft" in last
    assert not last.endswith(" 0 bad")
    assert "\x1b" not in child.output
    assert "Traceback" not in child.output


def test_json_with_a_configuration(
    start: Callable[..., Any], endpoint: str, intruder: Callable[[], None], tmp_path: Any
) -> None:
    path = tmp_path / "my.toml"
    path.write_text(f'[identity]\nuas_id = "LISTEN"\n[[radio]]\nbackend = "ether"\naddress = "{endpoint}"\n')
    child = start("companion.commands.cli", "remote-id", "listen", "--config", str(path), "--json")

    def frames() -> list[dict[str, Any]]:
        whole = child.output.rpartition("\n")[0].splitlines()
        return [json.loads(line) for line in whole if line.startswith("{")]

    until(lambda: {"wifi", "ble4"} <= {frame["transport"] for frame in frames()}, intruder)
    assert child.end() == 0
    beacon = next(frame for frame in frames() if frame["transport"] == "wifi")
    assert beacon["address"] == ADDRESS
    assert [message["type"] for message in beacon["messages"]] == ["BasicId", "Location"]
    assert beacon["messages"][1]["lat_deg"] == 47.5


def test_it_ends_by_itself_after_its_seconds(start: Callable[..., Any], endpoint: str) -> None:
    child = start(
        "companion.commands.cli", "remote-id", "listen", "--radio", f"ether={endpoint}", "--seconds", "0.3"
    )
    assert child.process.wait(PATIENCE_S) == 0
    assert "0 aircraft, 0 frames heard, 0 bad" in child.output


def test_a_live_table_on_a_terminal(endpoint: str, intruder: Callable[[], None]) -> None:
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "companion.commands.cli",
            "remote-id",
            "listen",
            "--radio",
            f"ether={endpoint}",
        ],
        stdin=subprocess.DEVNULL,
        stdout=theirs,
        stderr=theirs,
        env=os.environ | {"COLUMNS": "240", "LINES": "40", "TERM": "xterm"},
    )
    os.close(theirs)
    screen = bytearray()

    def read() -> bool:
        while select.select([ours], [], [], 0)[0]:
            try:
                data = os.read(ours, 65536)
            except OSError:  # the other end is closed
                return False
            if not data:
                return False
            screen.extend(data)
        return True

    try:

        def shown() -> bool:
            read()
            return b"1596B00000GLIDER" in screen and b"1 aircraft" in screen

        until(shown, intruder)
        process.send_signal(signal.SIGINT)
        # A full pseudo-terminal would hold it up.
        waiting.until(lambda: process.poll() is not None, "its end", PATIENCE_S, meanwhile=read, pause_s=0.01)
        read()
        assert process.poll() == 0, screen.decode(errors="replace")
    finally:
        process.kill()
        process.wait()
        os.close(ours)
    assert b"identity" in screen
    assert b"\x1b[" in screen
    assert b"\x1b[?25h" in screen  # the cursor is shown again
    assert b"Traceback" not in screen


def test_bluetooth_from_a_real_controller(start: Callable[..., Any], air: Callable[..., Any]) -> None:
    channel = air().name
    child = start("companion.commands.cli", "remote-id", "listen", "--radio", f"hci={channel}")
    sender = HciTransport(channel, ADDRESS, send=True, listen=False)

    def send() -> None:
        now_s = time.monotonic()
        sender.heard(now_s)
        for transport in ("ble4", "ble5"):
            sender.broadcast(transport, MESSAGES, now_s)

    try:
        until(lambda: "identity 1596B00000GLIDER" in child.output and "ble4+ble5" in child.output, send)
    finally:
        sender.close()
    assert child.end() == 0
    assert f"address {ADDRESS}" in child.output
