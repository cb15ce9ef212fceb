"""Several radios as one."""

from __future__ import annotations

import contextlib

import pytest

from companion.config import Config, IdentityConfig
from companion.errors import ConfigError
from companion.events import RadioState, RemoteIdHeard
from companion.radio.ether.section import EtherRadio
from companion.radio.null.section import NullRadio
from companion.radio.radio import Health
from companion.remote_id.messages import SelfId
from companion.runtime import radios
from companion.runtime.radios import Radios

MESSAGES = (SelfId(description_type=0, text="x"),)
HEARD = RemoteIdHeard(transport="ble4", address="c2:00:00:00:00:09", messages=MESSAGES)


class Fake:
    """A radio made of attributes."""

    def __init__(self, capabilities=(), hears=(), address=None, channel=None, confirmed=None):
        self.capabilities, self.hears = frozenset(capabilities), frozenset(hears)
        self.can_send, self.confirmed = self.capabilities, confirmed
        self.own_addresses = frozenset((address,) if address else ())
        self.wifi_channel = channel
        self.ok, self.closed = True, False
        self.sent, self.configured, self.inbox = [], [], []
        self.refusal = None
        self.refuses = ()

    def configure(self, rates, *, probe=False):
        if self.refusal is not None:
            raise ConfigError(self.refusal)
        if not probe:
            self.configured.append(dict(rates))
        return (f"{'would set' if probe else 'set'} {sorted(rates)}",)

    def broadcast(self, transport, messages, now_s):
        if transport in self.refuses:
            raise ValueError("cannot be encoded")
        self.sent.append((transport, messages))

    def heard(self, now_s):
        inbox, self.inbox = self.inbox, []
        return inbox

    def health(self, now_s):
        return Health(
            ok=self.ok,
            text="fine" if self.ok else "broken",
            frames_sent=len(self.sent),
            frames_heard=0,
            bad_frames=0,
            can_send=self.can_send,
            confirmed=self.confirmed,
        )

    def close(self):
        self.closed = True


@pytest.fixture
def opened(monkeypatch):
    """Opens these radios in turn."""

    def open_them(*fakes, **options):
        left = list(fakes)

        def open_radio(entry, *_):
            fake = left.pop(0)
            if isinstance(fake, Exception):
                raise fake
            return fake

        monkeypatch.setattr(radios, "open_radio", open_radio)
        entries = tuple(NullRadio() for _ in fakes)
        return Radios(Config(identity=IdentityConfig(uas_id="OWN"), radio=entries), **options)

    return open_them


def test_each_transport_is_sent_by_the_first_radio_that_can_now(opened):
    first, second = Fake(("ble4", "ble5")), Fake(("ble4", "wifi"))
    both = opened(first, second)
    assert both.capabilities == {"ble4", "ble5", "wifi"}
    both.broadcast("ble4", MESSAGES, 0.0)
    both.broadcast("wifi", MESSAGES, 0.0)
    first.can_send = frozenset()
    both.broadcast("ble4", MESSAGES, 1.0)
    assert [t for t, _ in first.sent] == ["ble4"]
    assert [t for t, _ in second.sent] == ["wifi", "ble4"]
    with pytest.raises(ValueError, match="nan"):
        both.broadcast("nan", MESSAGES, 0.0)


def told(both, transport, period_s, until_s, begin_s=0.0):
    """Broadcast as the core does: only on what can send. Times at which the state changed, and what it is."""
    changes, can_send, now_s, due_s = [], (), begin_s, begin_s
    while now_s < until_s:
        for event in both.events(now_s):
            can_send = event.can_send
            changes.append((round(now_s - begin_s, 2), can_send, event.text))
        if now_s >= due_s and transport in can_send:
            due_s = now_s + period_s
            with contextlib.suppress(ValueError):
                both.broadcast(transport, MESSAGES, now_s)
        now_s += 0.05
    return changes


@pytest.mark.parametrize("period_s", [0.1, 0.2, 0.8, 1.0])
def test_a_transport_on_which_everything_is_refused_cannot_send_until_it_works_again(opened, period_s):
    """Otherwise it would count as on the air, with its rate."""
    radio = Fake(("ble4", "wifi"))
    alone = opened(radio)
    radio.refuses = ("wifi",)
    changes = told(alone, "wifi", period_s, 30.0)
    assert changes[0] == (0.0, ("ble4", "wifi"), "")
    after_s, can_send, text = changes[1]
    assert after_s <= 1.1
    assert can_send == ("ble4",)
    assert text == "fine; refuses all broadcasts on wifi"
    able = [at_s for at_s, can_send, _ in changes[1:] if "wifi" in can_send]
    assert 10 < len(able) < 16, "it is tried again, but not all the time"
    radio.refuses = ()
    changes = told(alone, "wifi", period_s, 40.0, begin_s=30.0)
    assert len(changes) <= 1
    assert radio.sent
    assert alone.state(40.0).can_send == ("ble4", "wifi")
    assert alone.health(40.0).ok


def test_one_refused_message_of_many_is_no_refusal_of_all(opened):
    radio = Fake(("wifi",))
    alone = opened(radio)
    for step in range(100):
        radio.refuses = ("wifi",) if step % 2 else ()
        with contextlib.suppress(ValueError):
            alone.broadcast("wifi", MESSAGES, 0.1 * step)
        assert alone.health(0.1 * step).ok
    radio.refuses = ("wifi",)
    for now_s in (100.0, 200.0, 300.0):
        with pytest.raises(ValueError, match="encoded"):
            alone.broadcast("wifi", MESSAGES, now_s)
        assert alone.health(now_s).ok


def test_what_one_radio_refuses_another_sends(opened):
    first, second = Fake(("wifi",)), Fake(("wifi",))
    both = opened(first, second)
    first.refuses = ("wifi",)
    told(both, "wifi", 0.2, 3.0)
    assert both.state(1.5).can_send == ("wifi",)
    assert second.sent


def test_each_radio_is_configured_for_what_it_will_send(opened):
    first, second = Fake(("ble4", "ble5")), Fake(("ble4", "wifi"))
    words = opened(first, second).configure({"ble4": 1, "wifi": 5})
    assert first.configured == [{"ble4": 1}]
    assert second.configured == [{"wifi": 5}]
    assert words == ["radio[0]: set ['ble4']", "radio[1]: set ['wifi']"]


def test_where_one_refuses_none_is_changed(opened):
    """What is set on a module stays there."""
    first, second = Fake(("ble4",)), Fake(("wifi",))
    second.refusal = "locked"
    with pytest.raises(ConfigError, match=r"radio\[1\]: locked"):
        opened(first, second).configure({"ble4": 1, "wifi": 5})
    assert not first.configured


def test_two_radios_are_told_apart_in_every_text(opened):
    first, second = Fake(("ble4",)), Fake(("wifi",))
    both = opened(first, second)
    assert both.health(0.0).text == "radio[0]: fine; radio[1]: fine"
    assert both.lines(0.0) == ["radio[0]: fine", "radio[1]: fine"]
    second.ok = False
    assert both.state(0.0).text == "radio[1]: broken"
    alone = opened(first)
    assert alone.health(0.0).text == "fine"
    assert alone.lines(0.0) == ["radio: fine"]


def test_one_that_cannot_be_opened_is_left_out_and_the_others_keep_their_places(opened):
    failed = []
    both = opened(ConfigError("no such device"), Fake(("wifi",)), sending=False, failed=failed.append)
    assert failed == ["radio[0]: no such device"]
    assert both.lines(0.0) == ["radio[1]: fine"]
    assert both.configure({"wifi": 1}) == ["radio[1]: would set ['wifi']"]


def test_in_a_dry_run_nothing_is_sent_or_configured_but_all_is_heard(opened):
    radio = Fake(("wifi",))
    radio.inbox = [HEARD]
    both = opened(radio, sending=False)
    assert both.configure({"wifi": 1}) == ["radio: would set ['wifi']"]
    both.broadcast("wifi", MESSAGES, 0.0)
    assert not radio.sent
    assert not radio.configured
    assert HEARD in both.events(0.0)


def test_the_state_is_told_once_and_when_it_changes(opened):
    sender = Fake(("ble4", "ble5"), hears=("ble4", "ble5"), address="c2:00:00:00:00:01", channel=11)
    listener = Fake(hears=("ble4", "wifi"))
    both = opened(sender, listener)
    state = RadioState(
        can_send=("ble4", "ble5"), monitored=("ble4",), own_addresses=("c2:00:00:00:00:01",), wifi_channel=11
    )
    assert both.events(0.0) == [state]
    assert both.events(1.0) == []
    sender.can_send, sender.ok = frozenset(("ble4",)), False
    (changed,) = both.events(2.0)
    assert changed.can_send == changed.monitored == ("ble4",)
    assert changed.text == "radio[0]: broken"


def test_a_radio_alone_does_not_hear_itself(opened):
    assert opened(Fake(("wifi",), hears=("wifi",))).state(0.0).monitored == ()


def test_a_radio_that_reports_on_itself_is_monitored(opened):
    module = Fake(("ble4", "ble5"), confirmed=frozenset())
    both = opened(module)
    assert both.state(0.0).monitored == ("ble4", "ble5")
    assert both.state(0.0).confirmed == ()
    module.confirmed = module.can_send
    assert both.state(0.0).confirmed == ("ble4", "ble5")


def test_a_spare_sender_is_not_what_is_heard(opened):
    """The first sends and nobody else listens; the second would be heard by the first, if it sent."""
    first = Fake(("ble4",), hears=("ble4",), address="c2:00:00:00:00:01")
    second = Fake(("ble4",), address="c2:00:00:00:00:01")
    both = opened(first, second)
    assert both.state(0.0).monitored == ()
    first.can_send = frozenset()
    assert both.state(1.0).monitored == ("ble4",)


def test_a_module_that_is_not_fed_says_nothing_of_who_sends_instead(opened):
    module = Fake(("ble4",), confirmed=frozenset())
    assert opened(Fake(("ble4",), address="c2:00:00:00:00:01"), module).state(0.0).monitored == ()


def test_who_sends_from_an_unknown_address_is_not_missed(opened):
    assert opened(Fake(("wifi",)), Fake(hears=("wifi",))).state(0.0).monitored == ()


def test_a_dry_run_misses_nothing_of_what_it_does_not_send(opened):
    sender, listener = Fake(("wifi",), address="c2:00:00:00:00:01"), Fake(hears=("wifi",))
    assert opened(sender, listener, sending=False).state(0.0).monitored == ()


def test_the_channel_is_that_of_the_card_that_sends(opened):
    first, second = Fake(("wifi",), channel=6), Fake(("wifi",), channel=1)
    both = opened(first, second)
    assert both.state(0.0).wifi_channel == 6
    first.can_send = frozenset()
    assert both.state(0.0).wifi_channel == 1


def test_one_that_cannot_be_opened_closes_the_others_and_is_named(opened):
    first = Fake(("wifi",))
    with pytest.raises(ConfigError, match=r"radio\[1\]: no such device"):
        opened(first, ConfigError("no such device"))
    assert first.closed


def test_the_simulated_air_is_opened_with_the_own_address():
    config = Config(identity=IdentityConfig(uas_id="OWN"), radio=(EtherRadio(address="127.0.0.1:9"),))
    opened = Radios(config)
    try:
        (address,) = opened.state(0.0).own_addresses
        assert int(address[:2], 16) & 0b11 == 0b10
    finally:
        opened.close()


def test_no_radio_is_no_radio():
    none = Radios(Config(identity=IdentityConfig(uas_id="OWN")))
    assert none.state(0.0) == RadioState()
    assert not none.health(0.0).ok
    assert none.capabilities == frozenset()
