"""A flight whose link is signed."""

from __future__ import annotations

import time

import msgspec
import pytest

from companion.autopilot.signing import Signing, timestamp_at
from companion.autopilot.wire import MavlinkWriter
from companion.config import VehicleConfig
from companion.errors import ConfigError
from companion.runtime import clock
from companion.runtime.flight import Flight
from tests.companion.runtime.flying import (
    KEY,
    LONG_S,
    Autopilot,
    Radio,
    configured,
    fly,
    heard_of,
    summary,
)


@pytest.fixture
def signed(make_config, tmp_path, said, kept_signals, watchdog, monkeypatch):
    """A flight with a key, to a port; and the folder of its runs."""
    monkeypatch.setattr("companion.runtime.flight._STATUS_S", 0.1)
    key_file = tmp_path / "signing.key"
    key_file.write_text(KEY.hex())
    key_file.chmod(0o600)

    def make(port):
        config = configured(make_config, tmp_path / "runs", port)
        vehicle = VehicleConfig(link=config.vehicle.link, wait_s=LONG_S, signing_key=str(key_file))
        made = Flight(msgspec.structs.replace(config, vehicle=vehicle), said.append, dry_run=False)
        made.radio = Radio()
        return made

    return make


def test_the_run_folder_and_the_log_hold_no_key(signed, said, until, tmp_path):
    vehicle = Signing(KEY, timestamp_at(time.time()), 0.0)
    forged = MavlinkWriter(1, 1)

    def wrap(frame):
        return vehicle.sign(frame) + forged.pack(forged.encoder.heartbeat_encode(2, 3, 1, 4, 4))

    served = Autopilot(wrap=wrap)
    flight = signed(served.port)
    fly(
        flight,
        lambda: until(heard_of(said, "recording to")),
        lambda: until(heard_of(said, "frames refused: ")),
        lambda: until(lambda: served.commands),
    )
    served.end()
    found = summary(flight)["signing"]
    assert found["valid"] > 0
    assert found["unsigned"] > 0
    assert flight.onboard.core.own.heartbeat.custom_mode == 5
    for path in (tmp_path / "runs").rglob("*"):
        if path.is_file():
            data = path.read_bytes()
            assert KEY not in data, path
            assert KEY.hex().encode() not in data, path
    assert not any(KEY.hex() in line for line in said)
    assert (tmp_path / "runs" / "signing-timestamp").exists()


def test_a_vehicle_that_does_not_sign_is_told_in_plain_words(signed, autopilot, monkeypatch):
    flight = signed(autopilot.port)
    now_s = clock.now_s

    def skips() -> float:
        """The wait for a vehicle is nearly over as soon as something has come."""
        return now_s() + (LONG_S - 0.5 if flight.link.received_bytes else 0.0)

    monkeypatch.setattr(clock, "now_s", skips)
    with pytest.raises(ConfigError, match="every frame of the vehicle is unsigned: signing is not set up"):
        flight.run()
