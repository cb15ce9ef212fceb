"""A dry run computes everything and transmits nothing."""

from __future__ import annotations

import json
import time

import msgspec
import pytest

from companion.config import RecordConfig
from companion.events import Firmware, RemoteIdHeard
from companion.radio.null.null_radio import NullTransport
from companion.radio.null.section import NullRadio
from companion.radio.radio import Health
from companion.remote_id.messages import Location, Status
from companion.runtime import clock, radios
from companion.runtime.flight import Flight
from companion.runtime.links.byte_link import LinkTrouble
from companion.runtime.record.code import code_sha256
from tests.companion.runtime.flying import (
    Joined,
    fly,
    heard_of,
)
from tests.support.place import HOME


class Air(NullTransport):
    """A radio that could send, and hears another aircraft where ours is."""

    capabilities = frozenset({"wifi"})

    def __init__(self, link):
        self._link = link
        self.sent, self.changed = 0, 0

    def configure(self, rates, *, probe=False):
        self.changed += not probe
        return ()

    def broadcast(self, transport, messages, now_s):
        self.sent += 1

    def heard(self, now_s):
        north, east, _down = self._link.vehicle.position_ned_m
        message = Location(
            status=Status.AIRBORNE,
            lat_deg=HOME.lat_deg + (north + 20.0) / 111_194.9,
            lon_deg=HOME.lon_deg + east / 75_370.0,
            alt_geodetic_m=None,
            direction_deg=180.0,
            speed_mps=3.0,
            vertical_speed_mps=0.0,
            horizontal_accuracy_m=3.0,
            timestamp_s=round(time.time() % 3600.0, 1),
        )
        return [RemoteIdHeard(transport="wifi", address="02:00:00:00:00:01", messages=(message,))]

    def health(self, now_s):
        return Health(
            ok=True, text="", frames_sent=0, frames_heard=0, bad_frames=0, can_send=self.capabilities
        )


ASKS = {"HEARTBEAT", "MISSION_REQUEST_LIST", "MISSION_REQUEST_INT", "MISSION_ACK"}
ASKS |= {"PARAM_REQUEST_READ", "TIMESYNC"}
"""What a dry run may send beside COMMAND_LONG with SET_MESSAGE_INTERVAL: to be told things, and no more."""


@pytest.mark.parametrize("firmware", Firmware)
@pytest.mark.parametrize("dry_run", [True, False])
def test_a_dry_run_computes_and_transmits_nothing(
    make_config, tmp_path, monkeypatch, said, until, kept_signals, watchdog, firmware, dry_run
):
    """Beside the same flight that is none: it sends what the dry run must not."""
    link = Joined(firmware)
    air = Air(link)
    monkeypatch.setattr("companion.runtime.flight.KeptLink", lambda *_: link)
    monkeypatch.setattr(link, "trouble", LinkTrouble(), raising=False)
    monkeypatch.setattr(radios, "open_radio", lambda *_: air)
    base = make_config(use="fly")
    config = msgspec.structs.replace(
        base,
        remote_id=msgspec.structs.replace(base.remote_id, component=True),
        radio=(NullRadio(),),
        record=RecordConfig(folder=str(tmp_path)),
    )
    made = Flight(config, said.append, dry_run=dry_run)
    mode = link.vehicle.custom_mode
    fly(made, lambda: until(heard_of(said, "guarding -> avoiding")), lambda: time.sleep(1.0))
    kinds = {message.get_type() for message in link.left}
    commands = {m.command for m in link.left if m.get_type() == "COMMAND_LONG"}
    if dry_run:
        assert kinds <= ASKS | {"COMMAND_LONG"}
        assert commands == {511, 512}
        assert link.vehicle.custom_mode == mode
        assert (air.sent, air.changed) == (0, 0)
        assert not made.live(clock.now_s()).rates
    else:
        assert kinds >= {"SET_POSITION_TARGET_LOCAL_NED", "STATUSTEXT", "COLLISION"}
        assert air.sent > 0
        assert air.changed > 0
    assert heard_of(said, "dry run: nothing is broadcast")() is dry_run
    assert made.onboard.core.state.value == "avoiding"
    assert made.folder is not None
    assert any(path.stat().st_size > 1000 for path in made.folder.glob("*.events"))
    manifest = json.loads((made.folder / "manifest.json").read_text())
    assert (manifest["dry_run"], manifest["code_sha256"]) == (dry_run, code_sha256())
