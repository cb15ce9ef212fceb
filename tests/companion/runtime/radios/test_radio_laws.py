"""Whether a flight begins with radios that cannot do what the law asks."""

from __future__ import annotations

import msgspec
import pytest

from companion.errors import ConfigError
from companion.remote_id.region import Region
from companion.runtime.flight import Flight
from tests.companion.runtime.flying import Radio, configured, fly, heard_of, summary

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
def begin(monkeypatch, make_config, said, tmp_path, autopilot, kept_signals, watchdog):
    """Make a flight whose radios can send on these transports. `lost` is why another one cannot be opened."""

    def build(use, *capabilities, lost=None):
        radio = Sender(*capabilities)

        def opened(*_, failed, **__):
            if lost is not None:
                failed(lost)
            return radio

        monkeypatch.setattr("companion.runtime.prepare.Radios", opened)
        monkeypatch.setattr("companion.runtime.flight._ARMED_S", 0.5)
        config = configured(make_config, tmp_path, autopilot.port)
        config = msgspec.structs.replace(
            config, region=US, flight=msgspec.structs.replace(config.flight, use=use)
        )
        return Flight(config, said.append, dry_run=False), radio

    return build


@pytest.fixture
def arm(begin):
    """Make such a flight, and end it."""

    def build(use, *capabilities):
        flight, radio = begin(use, *capabilities)
        flight._close()
        return radio

    return build


def test_a_radio_that_cannot_be_legal_does_not_fly(begin):
    flight, radio = begin("guard", "ble4")
    with pytest.raises(ConfigError, match=r"remote_id: region us asks for .*; the radio can send on ble4"):
        flight.run()
    assert radio.configured is None
    assert flight.folder is None


def test_a_radio_that_cannot_be_opened_does_not_fly(begin):
    flight, _ = begin("watch", "wifi", lost="radio[1]: no such device")
    with pytest.raises(ConfigError, match=r"^radio\[1\]: no such device$"):
        flight.run()
    assert flight.folder is None


def test_an_armed_vehicle_is_not_left_without_its_companion_because_a_radio_is_missing(
    begin, autopilot, said, until
):
    """As after a restart in the air, when the program ended because the radio did."""
    autopilot.armed = True
    flight, radio = begin("watch", "wifi", lost="radio[1]: no such device")
    fly(flight, lambda: until(heard_of(said, "recording to")))
    assert radio.configured == {"wifi": 2}
    assert "radio[1]: no such device; the vehicle is armed; the flight continues" in said
    assert summary(flight)["ticks"] > 0


def test_an_armed_vehicle_sends_what_its_radios_can_although_it_is_not_legal(begin, autopilot, said, until):
    autopilot.armed = True
    flight, radio = begin("guard", "ble4")
    fly(flight, lambda: until(heard_of(said, "recording to")))
    assert radio.configured == {"ble4": 2}
    assert any("the radio can send on ble4; the vehicle is armed" in line for line in said)


def test_an_armed_vehicle_flies_without_any_radio_that_can_be_prepared(begin, autopilot, said, until):
    autopilot.armed = True
    flight, radio = begin("watch", lost="radio[0]: no such device")
    fly(flight, lambda: until(heard_of(said, "recording to")))
    assert radio.configured is None
    assert any("nothing is broadcast" in line for line in said)


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
