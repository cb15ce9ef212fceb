"""What is really broadcast is shown beside what was chosen."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from companion.core import Companion
from companion.events import Broadcast, RadioState
from companion.remote_id.messages import Location, SelfId
from companion.remote_id.region import Region
from companion.runtime.flight import Flight
from companion.runtime.status.sent_rates import SentRates, in_words
from companion.toml_reader import decode_toml
from tests.companion.conftest import Bench
from tests.companion.runtime.flying import Radio, configured, fly, heard_of

REGIONS = Path(__file__).parents[4] / "config" / "regions"


@pytest.mark.parametrize(
    ("region", "channel", "rate", "words"),
    [
        ("us", 6, 2, "wifi 2/s"),
        ("us", 6, 1, "wifi 1/s chosen, 1.25/s sent"),
        ("us", 1, 2, "wifi 2/s chosen, 6.67/s sent"),
        ("eu", 11, 7, "wifi 7/s"),
        ("jp", 1, 2, "wifi 2/s chosen, 6.67/s sent"),
    ],
)
def test_where_the_law_asks_for_more_than_was_chosen_both_are_shown(
    make_config, region, channel, rate, words
):
    base = make_config(use="watch")
    config = msgspec.structs.replace(
        base,
        region=decode_toml(REGIONS / f"{region}.toml", Region),
        remote_id=msgspec.structs.replace(base.remote_id, rate=rate),
    )
    bench, sent = Bench(Companion(config)), SentRates()
    bench.extra = [RadioState(can_send=("wifi",), wifi_channel=channel)]
    rates = bench.core.broadcaster
    for _ in range(60):
        sent.take(bench.step(), rates.rates, bench.now_s)
    assert in_words(rates.rates, sent.per_s(bench.now_s)) == f"wifi {rate}/s", "not measured yet"
    for _ in range(140):
        sent.take(bench.step(), rates.rates, bench.now_s)
    assert in_words(rates.rates, sent.per_s(bench.now_s)) == words


def test_a_rate_that_has_just_changed_is_measured_anew():
    sent = SentRates()
    place = Broadcast(transport="ble4", messages=(Location(),))
    name = Broadcast(transport="ble4", messages=(SelfId(description_type=0, text="x"),))
    for k in range(100):
        sent.take([place, name] if k % 10 == 0 else [name], {"ble4": 2}, 0.1 * k)
    assert sent.per_s(9.9) == {"ble4": 1.0}
    sent.take([], {"ble4": 3, "wifi": 1}, 10.0)
    assert sent.per_s(10.0) == {}
    sent.take([], {"ble4": 3, "wifi": 1}, 16.0)
    assert in_words({"ble4": 3, "wifi": 1}, sent.per_s(16.0)) == (
        "ble4 3/s chosen, 0/s sent, wifi 1/s chosen, 0/s sent"
    )
    sent.take([], {}, 17.0)
    assert sent.per_s(30.0) == {}
    assert in_words({}, {}) == ""


def test_status_and_console_show_it(
    autopilot, said, make_config, tmp_path, kept_signals, watchdog, monkeypatch, until
):
    monkeypatch.setattr("companion.runtime.flight._STATUS_S", 0.1)
    monkeypatch.setattr("companion.runtime.status.sent_rates._WINDOW_S", 1.0)
    config = configured(make_config, tmp_path, autopilot.port)
    config = msgspec.structs.replace(config, region=Region(name="here", location_period_s=0.2))
    flight = Flight(config, said.append, dry_run=False)
    flight.radio = Radio()
    states = []
    fly(
        flight,
        lambda: until(heard_of(said, "on the air: wifi 1/s chosen, ")),
        lambda: states.append(flight.live(flight._status_s)),
    )
    assert states[0].rates == {"wifi": 1}
    assert states[0].sent_per_s["wifi"] > 1.5
