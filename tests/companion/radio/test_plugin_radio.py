"""The guard around the radio of a plug-in: whatever it does, the flight goes on and its state says what."""

from __future__ import annotations

import dataclasses
import itertools
from asyncio import CancelledError

import pytest

from companion.errors import ConfigError
from companion.events import RemoteIdHeard
from companion.plugins import Plugin
from companion.radio.null.null_radio import NullTransport
from companion.radio.plugin import plugin_radio
from companion.radio.plugin.plugin_radio import FORGIVEN_S, MOST_HEARD, GuardedRadio, open_radio
from companion.radio.plugin.section import PluginRadio
from companion.radio.radio import Health, RadioContext
from companion.remote_id.messages import Location, SelfId
from tests.support import plugged

PLUGIN = Plugin("mine", "mine:open", "mine 1.0", None)
WORDS = SelfId(description_type=0, text="hello")
HEARD = RemoteIdHeard(
    transport="wifi", address="02:00:00:00:00:01", messages=(WORDS,), rssi_dbm=-70.0, counter=7
)
CONTEXT = RadioContext("OWN", lambda: 0.0, lambda text: None)


class Made(NullTransport):
    """A radio whose answers a test sets."""

    capabilities = hears = frozenset({"wifi"})
    own_addresses = frozenset({"02:00:00:00:00:02"})
    wifi_channel = 6
    hears_now: object = ()
    told = Health(True, "well", 3, 4, 5, can_send=frozenset({"wifi"}))

    def heard(self, now_s):
        return self.hears_now

    def health(self, now_s):
        return self.told

    def broadcast(self, transport, messages, now_s):
        self.sent = transport, messages


def made(**answers):
    radio = Made()
    for name, value in answers.items():
        setattr(radio, name, value)
    return GuardedRadio(radio, PLUGIN)


def raising(error):
    def call(*_, **__):
        raise error

    return call


def test_it_can_send_only_what_it_has():
    told = dataclasses.replace(Made.told, can_send=frozenset({"wifi", "ble4"}))
    assert made(told=told).health(0.0).can_send == {"wifi"}


def test_what_keeps_the_contract_passes():
    radio = made(hears_now=[HEARD])
    assert radio.heard(0.0) == [HEARD]
    assert radio.health(0.0) == Made.told
    assert (radio.capabilities, radio.wifi_channel) == (frozenset({"wifi"}), 6)
    radio.broadcast("wifi", (WORDS,), 0.0)
    assert radio.made.sent == ("wifi", (WORDS,))
    assert radio.trouble is None


@pytest.mark.parametrize(
    "event",
    [
        None,
        "frame",
        RemoteIdHeard(transport="pigeon", address="", messages=(WORDS,)),
        RemoteIdHeard(transport="wifi", address="x" * 1000, messages=(WORDS,)),
        RemoteIdHeard(transport="wifi", address=None, messages=(WORDS,)),
        RemoteIdHeard(transport="wifi", address="", messages=()),
        RemoteIdHeard(transport="wifi", address="", messages=(WORDS,) * 20),
        RemoteIdHeard(transport="wifi", address="", messages=("hello",)),
        RemoteIdHeard(transport="wifi", address="", messages=(Location(lat_deg=float("nan"), lon_deg=1.0),)),
        RemoteIdHeard(transport="wifi", address="", messages=(Location(lat_deg=1e30, lon_deg=1.0),)),
        RemoteIdHeard(transport="wifi", address="", messages=(WORDS,), counter=999),
        RemoteIdHeard(transport="wifi", address="", messages=(WORDS,), counter="7"),
        RemoteIdHeard(transport="wifi", address="", messages=(WORDS,), rssi_dbm="loud"),
    ],
)
def test_a_frame_that_breaks_the_contract_is_counted_and_left_out(event):
    radio = made(hears_now=[event, HEARD])
    assert radio.heard(0.0) == [HEARD]
    assert radio.health(0.0).bad_frames == Made.told.bad_frames + 1


def test_what_is_heard_is_as_coarse_as_on_the_air():
    fine = Location(lat_deg=47.123456789, lon_deg=8.0, speed_mps=5.1)
    (heard,) = made(hears_now=[RemoteIdHeard(transport="wifi", address="", messages=(fine,))]).heard(0.0)
    assert heard.messages[0].speed_mps == 5.0
    assert heard.messages[0].lat_deg == pytest.approx(47.1234568, abs=1e-9)


def test_a_flood_is_cut():
    assert len(made(hears_now=[HEARD] * (2 * MOST_HEARD)).heard(0.0)) == MOST_HEARD


def test_an_endless_answer_is_cut():
    taken = itertools.count()
    radio = made(heard=lambda _now_s: (HEARD for _ in taken))
    assert len(radio.heard(0.0)) == MOST_HEARD
    assert next(taken) <= MOST_HEARD + 1


@pytest.mark.parametrize(
    "error", [RuntimeError("no idea"), OSError(5, "broken"), SystemExit(1), CancelledError()]
)
def test_what_it_raises_is_in_its_state(error):
    radio = made(heard=raising(error))
    assert radio.heard(0.0) == []
    health = radio.health(0.0)
    assert not health.ok
    assert f"the plug-in failed: {type(error).__name__}" in health.text


def test_a_transport_whose_broadcast_fails_cannot_be_sent_on_until_one_succeeds():
    radio = made(broadcast=raising(RuntimeError("no idea")))
    radio.broadcast("wifi", (WORDS,), 0.0)
    assert radio.health(0.0).can_send == frozenset()
    radio.made.broadcast = lambda *_: None
    radio.broadcast("wifi", (WORDS,), 0.0)
    assert radio.health(0.0).can_send == {"wifi"}


def test_a_transport_whose_broadcast_failed_is_tried_again():
    """One exception must not silence the aircraft: nothing is broadcast on what cannot be sent on."""
    radio = made(broadcast=raising(OSError(11, "try again")))
    radio.broadcast("wifi", (WORDS,), 10.0)
    assert radio.health(10.0 + FORGIVEN_S - 0.1).can_send == frozenset()
    assert radio.health(10.0 + FORGIVEN_S).can_send == {"wifi"}
    radio.broadcast("wifi", (WORDS,), 10.0 + FORGIVEN_S)
    assert radio.health(10.0 + FORGIVEN_S).can_send == frozenset()


def test_messages_that_cannot_be_sent_are_still_refused():
    radio = made(broadcast=raising(ValueError("too long")))
    with pytest.raises(ValueError, match="too long"):
        radio.broadcast("wifi", (WORDS,), 0.0)


def test_a_radio_that_refuses_everything_has_failed():
    """A closed file raises ValueError, too; the radio must not look well while nothing is on the air."""
    radio = made(broadcast=raising(ValueError("I/O operation on closed file")))
    with pytest.raises(ValueError, match="closed file"):
        radio.broadcast("wifi", (WORDS,), 10.0)
    assert radio.health(10.0).can_send == {"wifi"}
    radio.broadcast("wifi", (WORDS,), 10.0 + FORGIVEN_S)
    health = radio.health(10.0 + FORGIVEN_S)
    assert not health.ok
    assert "closed file" in health.text
    assert health.can_send == frozenset()


def test_a_message_that_passes_between_two_that_are_refused_shows_that_the_radio_works():
    radio = made(broadcast=raising(ValueError("too long")))
    for now_s in (10.0, 20.0):
        with pytest.raises(ValueError, match="too long"):
            radio.broadcast("wifi", (WORDS,), now_s)
        radio.made.broadcast, refuse = (lambda *_: None), radio.made.broadcast
        radio.broadcast("wifi", (WORDS,), now_s + 1.0)
        radio.made.broadcast = refuse
    assert radio.health(21.0).ok


@pytest.mark.parametrize("told", [None, "well", Health(True, None, 0, 0, 0), Health(True, "", "3", 0, 0)])
def test_a_state_that_cannot_be_read_is_not_ok(told):
    health = made(told=told).health(0.0)
    assert not health.ok
    assert health.can_send == frozenset()


def test_unknown_transports_are_none():
    radio = made(capabilities=frozenset({"wifi", "pigeon"}))
    assert radio.capabilities == frozenset()
    assert not radio.health(0.0).ok


def test_configure_fails_in_words():
    with pytest.raises(ConfigError, match="cannot be prepared: KeyError"):
        made(configure=raising(KeyError("wifi"))).configure({"wifi": 1})
    with pytest.raises(ConfigError, match="no rights"):
        made(configure=raising(ConfigError("no rights"))).configure({"wifi": 1})


def test_closing_never_raises():
    made(close=raising(OSError(5, "gone"))).close()


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("def open(options, context): raise OSError('no device')", "cannot be opened: OSError: no device"),
        (
            "from companion.errors import ConfigError\ndef open(o, c): raise ConfigError('to: x')",
            "options: to: x",
        ),
        ("open = 3", "cannot be opened: TypeError"),
        ("import gone", "radio.name: 'mine': the plug-in one:open of one 1.0"),
    ],
)
def test_one_that_does_not_open_is_named(tmp_path, monkeypatch, source, words):
    monkeypatch.syspath_prepend(str(tmp_path))
    plugged.forget("one")
    plugged.install(tmp_path, "one", source, {plugin_radio.plugins.RADIOS: {"mine": "one:open"}})
    with pytest.raises(ConfigError) as refused:
        open_radio(PluginRadio(name="mine"), CONTEXT)
    assert words in str(refused.value)
    plugged.forget("one")


def test_it_cannot_change_the_configuration(tmp_path, monkeypatch):
    """The record of the flight holds what was configured."""
    monkeypatch.syspath_prepend(str(tmp_path))
    plugged.forget("one")
    source = "def open(options, context): return options['led'].clear()"
    plugged.install(tmp_path, "one", source, {plugin_radio.plugins.RADIOS: {"mine": "one:open"}})
    section = PluginRadio(name="mine", options={"led": {"pin": 3}})
    open_radio(section, CONTEXT)
    assert section.options == {"led": {"pin": 3}}
    plugged.forget("one")
