"""The core with a chooser: when it decides, what goes on the air, and what happens when it cannot."""

from __future__ import annotations

import io
import itertools

import msgspec
import numpy as np
import pytest

from companion import event_record, replay
from companion.atmc import chooser as chooser_module
from companion.atmc.actions import SET_ACTIONS
from companion.atmc.audible import CROWD
from companion.atmc.choice import Refused, Why
from companion.atmc.policy import Bounds, Policy
from companion.atmc.rule import FIXED_SETS
from companion.config import AtmcConfig, IdentityConfig
from companion.core import Companion
from companion.events import (
    Broadcast,
    BroadcastChanged,
    RadioState,
    RemoteIdHeard,
    RemoteIdModule,
    Say,
    Severity,
    TransportsChosen,
)
from companion.remote_id.messages import Location
from companion.remote_id.region import Region
from sitl_mocks.encounters import lockstep
from sitl_mocks.encounters import scenario_file as sitl_settings
from tests.companion.atmc.policies import FN, FO, metadata, policy_file

ALL = RadioState(can_send=("ble4", "ble5", "nan", "wifi"))
US = Region(name="us", transport_sets=(("wifi",), ("ble4", "ble5")), location_period_s=1.0)
POLICY = policy_file()


@pytest.fixture
def bench(make_bench):
    """Builds an aircraft that watches, with a chooser."""

    def build(policy=None, word=None, region=US, radio=ALL, uas_id="OWN", transports=("wifi",), **atmc):
        made = make_bench(use="watch")
        config = msgspec.structs.replace(
            made.core.config,
            identity=IdentityConfig(uas_id=uas_id),
            region=region,
            remote_id=msgspec.structs.replace(made.core.config.remote_id, transports=transports),
            atmc=AtmcConfig(policy=word, **atmc),
        )
        bench = type(made)(Companion(config, policy))
        bench.extra = [radio]
        return bench

    return build


def chosen(bench):
    return [c for _, c in bench.log if isinstance(c, TransportsChosen)]


def said(bench):
    return [c for _, c in bench.log if isinstance(c, Say) and "transports" in c.text]


def on_air(bench, seconds=3.0):
    """Locations a second that go out on each transport."""
    sent = [c for c in bench.step(round(seconds / 0.05)) if isinstance(c, Broadcast)]
    sent = [c.transport for c in sent if any(isinstance(m, Location) for m in c.messages)]
    return {t: sent.count(t) / seconds for t in sorted(set(sent))}


def hear(bench, name, north_m):
    place = Location(lat_deg=bench.lat_deg + north_m / 111_194.9, lon_deg=bench.lon_deg, speed_mps=0.0)
    bench.extra.append(RemoteIdHeard(transport="wifi", address=name, messages=(place,), counter=0))


def test_without_a_policy_nothing_changes(make_bench, bench):
    plain, same = make_bench(use="watch"), bench(region=Region())
    plain.extra = [ALL]
    for made in (plain, same):
        made.step(100)
    assert same.core.chooser is None
    assert plain.log == same.log
    assert not chosen(same)


def test_a_policy_goes_on_the_air(bench):
    made = bench(POLICY)
    made.step(100)
    (first, *_) = chosen(made)
    assert first.by == "policy"
    assert first.reason == "0 aircraft heard"
    rates = dict(first.rates)
    assert tuple(rates.get(t, 0) for t in ("ble4", "ble5", "wifi")) in SET_ACTIONS
    air = on_air(made)
    assert air.keys() == dict(chosen(made)[-1].rates).keys()
    for transport, rate in chosen(made)[-1].rates:
        assert air[transport] == pytest.approx(rate, rel=0.25)
    assert not said(made)
    changes = [c for _, c in made.log if isinstance(c, BroadcastChanged)]
    assert all(c.legal for c in changes)


def test_a_policy_that_would_hardly_send_stays_audible_until_many_are_heard(bench, monkeypatch):
    """A network that always prefers Wi-Fi at 2 a second."""
    favourite = np.array([action == (0, 0, 2) for action in SET_ACTIONS], np.float32)
    flown = bench(POLICY)
    monkeypatch.setattr(Policy, "_values", lambda self, own, rows, agent: favourite.copy())
    flown.step(100)
    assert chosen(flown)[-1].by == "policy"
    assert dict(chosen(flown)[-1].rates) == {"ble4": 10, "wifi": 10}
    for _ in range(40):
        for number in range(CROWD - 1):
            hear(flown, f"N{number}", 100.0 + number)
        flown.step(5)
    assert dict(chosen(flown)[-1].rates) == {"ble4": 10, "wifi": 10}
    for _ in range(40):
        for number in range(CROWD):
            hear(flown, f"N{number}", 100.0 + number)
        flown.step(5)
    assert dict(chosen(flown)[-1].rates) == {"wifi": 2}


def test_the_rule_and_the_fixed_set(bench):
    rule, fixed_set = bench(word="rule"), bench(word="fixed")
    for made in (rule, fixed_set):
        made.step(80)
    assert dict(chosen(rule)[-1].rates) == {"wifi": 10}
    assert dict(chosen(fixed_set)[-1].rates) == {"ble4": 10, "wifi": 10}
    assert (chosen(rule)[-1].by, chosen(fixed_set)[-1].by) == ("rule", "fixed")
    for _ in range(60):
        hear(rule, "c2:00", 100.0)
        rule.step()
    assert dict(chosen(rule)[-1].rates) == {"ble4": 10, "wifi": 10}
    assert chosen(rule)[-1].reason == "1 aircraft heard"
    assert len(chosen(fixed_set)) == 1


def test_decisions_fall_at_random_phases(bench, monkeypatch):
    times = {}
    for uas_id in ("A", "B"):
        made = bench(POLICY, uas_id=uas_id, period_s=1.0)
        look = made.core.chooser._senses.look

        def noted(now_s, *rest, uas_id=uas_id, look=look):
            times.setdefault(uas_id, []).append(now_s)
            return look(now_s, *rest)

        monkeypatch.setattr(made.core.chooser._senses, "look", noted)
        made.step(1200)
    for found in times.values():
        gaps = np.diff(found)
        assert gaps.mean() == pytest.approx(1.0, abs=0.1)
        assert gaps.min() >= 0.45
        assert gaps.max() <= 1.6
        assert gaps.std() > 0.15
    together = {round(t, 3) for t in times["A"]} & {round(t, 3) for t in times["B"]}
    assert len(together) < 0.25 * len(times["A"])


OUTSIDE = Bounds(
    neighbour_low=(0.9,) * FN, neighbour_high=(1.0,) * FN, own_low=(-1.0,) * FO, own_high=(1.0,) * FO
)


@pytest.mark.parametrize(
    ("policy", "word", "words"),
    [
        (None, "/x/y/good.safetensors", "policy good.safetensors could not be read"),
        (b"torn", "/x/y/good.safetensors", "policy good.safetensors: not a safetensors file"),
        (policy_file("flat", agents=2), "/x/y.st", "y.st: holds 2 networks"),
    ],
)
def test_without_its_policy_it_flies_on_the_fixed_set(bench, policy, word, words):
    made = bench(policy, word)
    assert words in made.core.chooser.trouble
    made.step(100)
    (event,) = chosen(made)
    assert event.by == "fallback"
    assert dict(event.rates) == {"ble4": 10, "wifi": 10}
    assert words in event.reason
    (text,) = said(made)
    assert text.severity is Severity.WARNING
    assert words in text.text
    assert "now ble4 10/s + wifi 10/s" in text.text
    assert on_air(made) == pytest.approx({"ble4": 10.0, "wifi": 10.0}, rel=0.1)


def test_outside_of_its_training_it_falls_back_and_returns(bench):
    made = bench(policy_file(bounds=OUTSIDE))
    made.step(100)
    assert chosen(made)[-1].by == "policy"
    for _ in range(80):
        hear(made, "c2:00", 100.0)
        made.step()
    event = chosen(made)[-1]
    assert event.by == "fallback"
    assert event.reason.startswith("a neighbour's log_distance 0.5")
    assert len(said(made)) == 1
    # Not with the first answer: whoever stands at the edge of the training would switch and switch.
    made.step(200)
    assert chosen(made)[-1].by == "fallback"
    made.step(200)
    assert chosen(made)[-1].by == "policy"
    for _ in range(80):
        hear(made, "c2:00", 100.0)
        made.step()
    # The log has every change, the pilot each kind of trouble once.
    runs = [by for by, _ in itertools.groupby(c.by for c in chosen(made))]
    assert runs == ["policy", "fallback", "policy", "fallback"]
    assert len(said(made)) == 1


def test_too_many_neighbours(bench):
    made = bench(policy_file(neighbours=5))
    for _ in range(80):
        for k in range(6):
            hear(made, f"c2:0{k}", 100.0 + 100.0 * k)
        made.step()
    assert chosen(made)[-1].by == "fallback"
    assert chosen(made)[-1].reason == "6 neighbours, trained with up to 5"


def test_an_answer_that_is_no_number(bench, monkeypatch):
    made = bench(POLICY)
    monkeypatch.setattr(
        made.core.chooser._mind._network, "values", lambda *_: np.full(len(SET_ACTIONS), np.nan)
    )
    made.step(100)
    assert chosen(made)[-1].by == "fallback"
    assert "not a finite number" in chosen(made)[-1].reason


def test_a_transport_that_is_lost_is_left_at_once(bench):
    made = bench(word="fixed")
    made.step(80)
    made.extra = [RadioState(can_send=("ble4", "ble5"))]
    made.step()
    event = chosen(made)[-1]
    assert (event.by, event.reason) == ("fallback", "the radio can no longer send on wifi")
    assert dict(event.rates) == {"ble4": 10, "ble5": 10}
    assert len(said(made)) == 1
    made.step(80)
    # The next decision is the chooser's again, of what is left.
    assert chosen(made)[-1].by == "fixed"
    assert dict(chosen(made)[-1].rates) == {"ble4": 10, "ble5": 10}


def test_no_legal_set_leaves_it_to_the_floor(bench):
    made = bench(word="fixed", radio=RadioState(can_send=("ble4",)))
    made.step(100)
    event = chosen(made)[-1]
    assert (event.by, event.rates) == ("fallback", (("wifi", 1),))
    assert "legal" in event.reason
    assert "now wifi 1/s (configured rates, as far as region and radio allow)" in said(made)[0].text


def test_what_is_configured_goes_on_where_no_set_can_be_sent(bench):
    """A radio that loses Wi-Fi still has NAN, which no set has and the configuration asks for."""
    radio = RadioState(can_send=("nan", "wifi"))
    made = bench(word="rule", region=Region(), radio=radio, transports=("nan", "wifi"))
    made.step(100)
    assert on_air(made)["wifi"] > 5.0
    made.extra.append(RadioState(can_send=("nan",)))
    made.step(40)
    assert on_air(made).keys() == {"nan"}
    assert chosen(made)[-1].rates == (("nan", 1), ("wifi", 1))


def test_an_old_own_position(bench):
    made = bench(POLICY)
    made.step(80)
    made.stuck_position = True
    made.step(180)
    assert chosen(made)[-1].reason == "own position is too old"
    made.stuck_position = False
    made.step(120)
    assert chosen(made)[-1].by == "policy"


def test_nothing_is_chosen_before_there_is_a_radio_or_beside_a_module(bench):
    made = bench(POLICY, radio=RadioState())
    made.step(100)
    assert not chosen(made)
    made = bench(None, "lost.safetensors")
    made.armed = False
    for _ in range(5):
        made.extra.append(RemoteIdModule(component_id=236, ready=True))
        made.step(20)
    made.log.clear()
    made.armed = True
    made.extra.append(RemoteIdModule(component_id=236, ready=True))
    made.step(90)
    assert not chosen(made)


@pytest.mark.parametrize("word", ["policy", "rule"])
def test_never_illegal_over_a_flight_of_changing_radios(bench, word):
    made = bench(POLICY) if word == "policy" else bench(word=word)
    rng = np.random.default_rng(4)
    radios = [("wifi",), ("ble4", "ble5"), ("ble4", "wifi"), ("ble4", "ble5", "wifi")]
    for k in range(600):
        if k % 37 == 0:
            made.extra.append(RadioState(can_send=radios[int(rng.integers(len(radios)))]))
        if k % 7 == 0:
            hear(made, f"c2:0{k % 5}", float(rng.uniform(50.0, 500.0)))
        made.step()
    changes = [c for _, c in made.log if isinstance(c, BroadcastChanged)]
    assert len(changes) > 5
    assert all(c.legal for c in changes if c.rates)


def test_each_aircraft_flies_its_own_network_of_a_policy_that_holds_several(bench, monkeypatch):
    policy, asked, choose = policy_file("flat", agents=2), [], Policy.choose
    monkeypatch.setattr(Policy, "choose", lambda self, *a: asked.append(a[4]) or choose(self, *a))
    made = bench(policy, agent=1)
    made.step(90)
    assert set(asked) == {1}
    assert not said(made)
    made = bench(policy)
    made.step(90)
    assert set(asked) == {1}
    assert "atmc.agent must say which one flies: 0 to 1" in said(made)[0].text


def test_the_fall_back_is_the_chooser_of_last_resort():
    assert Refused(Why.OUTSIDE, "x") != Refused(Why.TOO_MANY, "x")
    assert chooser_module.fixed(US, ALL.can_send) == FIXED_SETS[0]


# ---------------------------------------------------------------- replay


@pytest.fixture(scope="module")
def flown():
    """Records of three aircraft that flew with a policy, in lock-step."""
    points = ((0.0, -60.0, 0.0, -60.0), (12.0, 0.0, 0.0, -60.0))
    paths = [tuple((t, n + 40.0 * k, 30.0 * k, d) for t, n, _, d in points) for k in range(3)]
    scenario = sitl_settings.Scenario(path=tuple(sitl_settings.PathSettings(points=p) for p in paths))
    policy = policy_file(seed=5, bounds=metadata().bounds)
    files = {}

    def recorder(name, config):
        header = event_record.Header(aircraft=name, software="test", config=config, policy=policy)
        files[name] = bytearray(event_record.MAGIC + event_record.encode(header))
        return lambda step: files[name].extend(event_record.encode(step))

    lockstep.fly(scenario, 1, record=recorder, policy=policy)
    return files


def test_a_run_with_a_policy_replays_bit_for_bit(flown):
    for name, data in flown.items():
        result = replay.replay_record(event_record.read(io.BytesIO(bytes(data)), name), name, 0.0)
        assert result.steps > 250
        assert result.differences == result.inexact == 0


def test_in_lock_step_the_policy_decides_by_what_is_heard(flown):
    steps = [
        item
        for item in event_record.read(io.BytesIO(bytes(flown["DMUCA001"])), "x")
        if isinstance(item, event_record.Step)
    ]
    found = [c for step in steps for c in step.commands if isinstance(c, TransportsChosen)]
    assert found
    assert {c.by for c in found} == {"policy"}
    heard = [e for step in steps for e in step.events if isinstance(e, RemoteIdHeard)]
    assert heard
    assert all(e.counter is not None for e in heard)


def test_without_the_policy_the_replay_differs(flown):
    items = list(event_record.read(io.BytesIO(bytes(flown["DMUCA001"])), "x"))
    items[0] = msgspec.structs.replace(items[0], policy=None)
    assert replay.replay_record(items, "x", 0.0).differences > 0
