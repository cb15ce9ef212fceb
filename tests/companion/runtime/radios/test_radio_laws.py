"""Whether a flight begins with radios that cannot do what the law asks."""

from __future__ import annotations

import msgspec
import pytest

from companion.errors import ConfigError
from companion.remote_id.region import Region
from companion.runtime.flight import Flight
from tests.companion.runtime.flying import (
    Radio,
    configured,
)

US = Region(name="us", transport_sets=(("wifi",), ("ble4", "ble5")), location_period_s=1.0)


class Sender(Radio):
    """A radio that sends on some transports."""

    wifi_channel = 6

    def __init__(self, *capabilities):
        super().__init__()
        self.able, self.configured = frozenset(capabilities), None

    @property
    def capabilities(self):
        return self.able

    def configure(self, rates):
        self.configured = rates
        return ["radio: set"]


@pytest.fixture
def arm(monkeypatch, make_config, said, tmp_path, autopilot):
    """Make a flight whose radios can send on these transports, and end it."""

    def build(use, *capabilities):
        radio = Sender(*capabilities)
        monkeypatch.setattr("companion.runtime.flight.Radios", lambda *_, **__: radio)
        config = configured(make_config, tmp_path, autopilot.port)
        config = msgspec.structs.replace(
            config, region=US, flight=msgspec.structs.replace(config.flight, use=use)
        )
        flight = Flight(config, said.append, dry_run=False)
        flight._close()
        return radio

    return build


def test_a_radio_that_cannot_be_legal_does_not_fly(arm):
    with pytest.raises(ConfigError, match=r"remote_id: region us asks for .*; the radio can send on ble4"):
        arm("fly", "ble4")
    arm("fly", "wifi")


def test_one_that_only_watches_goes_on_without_broadcasting(arm, said):
    radio = arm("watch", "ble4")
    assert radio.configured is None
    assert any("nothing is broadcast" in line for line in said)


def test_radios_that_only_listen_leave_the_broadcast_to_the_vehicle(arm, said):
    radio = arm("fly")
    assert radio.configured is None
    assert any("Remote ID module of its own" in line for line in said)


def test_what_the_law_adds_is_configured_and_said(arm, said):
    radio = arm("fly", "ble4", "ble5")
    assert radio.configured == {"ble4": 2, "ble5": 2}
    assert (
        "remote ID: ble4 1.25/s, ble5 1.25/s (radio cannot send on wifi; region us asks for ble4, ble5; "
        "region us asks for ble4 every 1 s, sent with a margin; "
        "region us asks for ble5 every 1 s, sent with a margin)" in said
    )
    assert "radio: set" in said
