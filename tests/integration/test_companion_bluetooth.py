"""The whole companion on Bluetooth: mock vehicle, two virtual controllers, the law of the US."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from companion import event_record
from companion.events import BroadcastChanged, RadioState, RemoteIdHeard, Say
from companion.radio.frames_io import radio_address
from companion.radio.hci.hci_radio import HciTransport
from companion.remote_id.messages import BasicId, Location, System
from tests.integration.conftest import PATIENCE_S

ROOT = Path(__file__).parents[2]
SERIAL = "1596B0000DMUCA01"


@pytest.fixture
def config(tmp_path, start, air):
    """Configuration of a companion beside a served vehicle, on a Bluetooth air of its own."""
    vehicle = start("sitl_mocks.cli", "serve", "--firmware", "ardupilot", "--link", "udpin:127.0.0.1:0")
    port = vehicle.wait_for(r"link udpin:127\.0\.0\.1:(\d+)").group(1)
    channel = air().name

    def write(transports: str, *radios: str) -> Path:
        path = tmp_path / "c.toml"
        tables = "".join(f'[[radio]]\nbackend = "hci"\nchannel = "{channel}"\n{keys}\n' for keys in radios)
        path.write_text(
            f'[identity]\nuas_id = "{SERIAL}"\n[vehicle]\nlink = "udpout:127.0.0.1:{port}"\nwait_s = 30\n'
            f'[remote_id]\nregion = "{ROOT / "config/regions/us.toml"}"\ntransports = {transports}\n'
            f'monitor_s = 2.0\n[record]\nfolder = "{tmp_path}"\nname = "bt"\n{tables}'
        )
        return path

    write.channel = channel
    return write


def steps_of(tmp_path):
    (folder,) = tmp_path.glob("*-bt")
    (events,) = folder.glob("*.events")
    with events.open("rb") as stream:
        return folder, [r for r in event_record.read(stream, "") if isinstance(r, event_record.Step)]


def test_bluetooth_in_the_us_is_ble4_and_ble5_and_is_heard_back(config, start, tmp_path):
    path = config('["ble4"]', "listen = false", "send = false")
    checked = start("companion.commands.cli", "check", "--config", path)
    assert checked.process.wait(PATIENCE_S) == 0, checked.output
    assert (
        "remote ID: ble4 1.25/s, ble5 1.25/s (region us asks for ble5; "
        "region us asks for ble4 every 1 s, sent with a margin; "
        "region us asks for ble5 every 1 s, sent with a margin)" in checked.output
    )
    companion = start("companion.commands.cli", "run", "--config", path)
    companion.wait_for("recording to")
    receiver = HciTransport(config.channel, "c2:00:00:00:00:01", send=False, listen=True)
    try:
        heard: list[RemoteIdHeard] = []
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end and not all(
            {type(m) for h in heard if h.transport == t for m in h.messages} >= {BasicId, Location, System}
            for t in ("ble4", "ble5")
        ):
            heard += receiver.heard(time.monotonic())
            time.sleep(0.02)
    finally:
        receiver.close()
    assert {h.transport for h in heard} == {"ble4", "ble5"}
    assert {h.address for h in heard} == {radio_address(SERIAL)}
    assert {m.uas_id for h in heard for m in h.messages if isinstance(m, BasicId)} == {SERIAL}
    assert companion.end() == 0, companion.output
    folder, steps = steps_of(tmp_path)
    events = [e for step in steps for e in step.events]
    commands = [c for step in steps for c in step.commands]
    assert any(isinstance(e, RadioState) and e.monitored == ("ble4", "ble5") for e in events)
    assert any(isinstance(e, RemoteIdHeard) and e.address == radio_address(SERIAL) for e in events)
    changes = [c for c in commands if isinstance(c, BroadcastChanged)]
    assert changes[-1].legal
    assert dict(changes[-1].rates) == {"ble4": 1, "ble5": 1}
    assert not any(isinstance(c, Say) and "not heard" in c.text for c in commands)
    assert json.loads((folder / "summary.json").read_text())["bad_frames"] == 0


def test_a_controller_that_cannot_be_legal_is_refused_with_the_reason(config, start):
    path = config('["ble4"]', "send = false")
    checked = start("companion.commands.cli", "check", "--config", path)
    assert checked.process.wait(PATIENCE_S) == 1
    assert "region us asks for wifi or ble4+ble5; the radio can send on nothing" in checked.output
