"""The policy file before flight: what `companion check` says, and what `companion run` starts with."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from companion import config as configuration
from companion import event_record
from companion.atmc.policy import MAX_BYTES
from companion.commands.check import check
from companion.commands.check_radios import find_radios
from companion.commands.preflight import Preflight
from companion.config import AtmcConfig, VehicleConfig
from companion.errors import ConfigError
from companion.radio.arduremoteid.section import ArduRemoteIdRadio
from companion.radio.ether.section import EtherRadio
from companion.remote_id.region import Region
from companion.runtime.flight import Flight
from companion.runtime.policy import RUN_FILE, judge_policy, read_policy, without_choice
from companion.toml_reader import decode_toml
from tests.companion.atmc.policies import policy_file
from tests.companion.runtime.flying import Radio

REGIONS = Path(__file__).parents[3] / "config" / "regions"
CONFIG = '[identity]\nuas_id = "A"\n[atmc]\npolicy = "{}"\n'


@pytest.fixture
def load(tmp_path):
    """Loads a configuration with this `atmc.policy`, and this content of the file that it names."""

    def loaded(policy, content=None):
        if content is not None:
            (tmp_path / policy).write_bytes(content)
        path = tmp_path / "my.toml"
        path.write_text(CONFIG.format(policy))
        return configuration.load(path)

    return loaded


@pytest.mark.parametrize("word", ["rule", "fixed"])
def test_a_word_is_no_file(load, word):
    config = load(word)
    assert config.atmc.policy == word
    assert read_policy(config) is None
    assert word in judge_policy(config)[0]


def test_nobody_chooses(make_config):
    assert judge_policy(make_config()) == []
    assert read_policy(make_config()) is None


def test_a_file_is_taken_from_the_configurations_folder(load, tmp_path):
    data = policy_file()
    config = load("good.safetensors", data)
    assert config.atmc.policy == str(tmp_path / "good.safetensors")
    assert read_policy(config) == data
    (line,) = judge_policy(config)
    assert 'policy "made for tests" (awareness), up to 60 neighbours' in line
    assert "47 of 47 actions are legal in region none" in line
    # In a run folder the configuration stands beside a copy of the file.
    again = configuration.load(_dumped(tmp_path / "run", config))
    assert read_policy(again) == data


def _dumped(folder, config):
    folder.mkdir()
    (folder / "config.toml").write_bytes(configuration.dump(config))
    return folder / "config.toml"


def test_only_other_radios_follow(make_config):
    config = msgspec.structs.replace(
        make_config(), atmc=AtmcConfig(policy="rule"), radio=(ArduRemoteIdRadio(link="tcp:x:1"),)
    )
    assert "repeats messages at its own rates" in judge_policy(config)[1]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, r"good\.safetensors: cannot be read: No such file"),
        (b"hello", "not a safetensors file"),
        (bytes(MAX_BYTES + 5), f"atmc.policy: .*: too large: a policy has at most {MAX_BYTES} bytes"),
        (policy_file("flat", agents=2), "atmc.agent must say which one flies: 0 to 1"),
    ],
)
def test_check_says_what_is_wrong_and_is_not_ready(load, content, words):
    config = load("good.safetensors", content)
    with pytest.raises(ConfigError, match=words):
        judge_policy(config)
    vehicle = VehicleConfig(link="udpin:127.0.0.1:0", wait_s=0.05)
    said = []
    assert check(msgspec.structs.replace(config, vehicle=vehicle), said.append) == 1
    assert "check: NOT ready" in said
    assert any("good.safetensors" in line for line in said)


def test_a_region_where_none_of_its_actions_is_legal(load):
    config = load("good.safetensors", policy_file(actions=((10, 0, 0), (3, 0, 0))))
    judge_policy(config)
    law = Region(name="eu", transport_sets=(("wifi",), ("ble5",)))
    with pytest.raises(ConfigError, match="none of its actions is legal in region eu"):
        judge_policy(msgspec.structs.replace(config, region=law))


@pytest.mark.parametrize("policy", ["good.safetensors", "rule", "fixed"])
def test_a_policy_that_can_choose_nothing_with_the_radios_is_told(load, policy):
    """The shipped policies know no Wi-Fi NAN, which alone is legal in the EU."""
    region = decode_toml(REGIONS / "eu.toml", Region)
    config = load(policy, policy_file() if "." in policy else None)
    config = msgspec.structs.replace(config, region=region)
    assert judge_policy(config)
    text = without_choice(config, {"nan"})
    assert "actions is legal in region eu and can be sent by the radios (nan)" in text
    assert without_choice(config, {"ble4"}) is not None, "not legal alone"
    for can_send in ({"wifi"}, {"wifi", "nan"}, {"ble4", "ble5"}):
        assert without_choice(config, can_send) is None
    assert without_choice(msgspec.structs.replace(config, atmc=AtmcConfig()), {"nan"}) is None
    damaged = load("bad.safetensors", b"torn")
    assert without_choice(damaged, {"nan"}) is None


def test_check_is_yellow_for_a_policy_that_can_choose_nothing(load, monkeypatch):
    class Nan(Radio):
        capabilities = frozenset(("nan",))

        def configure(self, rates, *, probe=False):
            return ()

    monkeypatch.setattr("companion.runtime.radios.open_radio", lambda *_: Nan())
    monkeypatch.setattr("companion.commands.check_radios._RADIO_S", 0.0)
    config = msgspec.structs.replace(
        load("rule"),
        region=decode_toml(REGIONS / "eu.toml", Region),
        radio=(EtherRadio(address="127.0.0.1:9"),),
    )
    found = Preflight()
    find_radios(config, found)
    (line,) = (f.line() for f in found.findings if f.what == "policy")
    assert line.startswith("yellow")
    assert "by the radios (nan)" in line


@pytest.mark.parametrize("damaged", [False, True])
def test_run_starts_with_or_without_its_policy(load, tmp_path, monkeypatch, damaged):
    monkeypatch.setattr("companion.runtime.flight.warm_up", lambda: 0.0)
    data = b"torn" if damaged else policy_file()
    config = load("good.safetensors", data)
    config = msgspec.structs.replace(
        config,
        vehicle=VehicleConfig(link="udpin:127.0.0.1:0"),
        record=configuration.RecordConfig(folder=str(tmp_path / "runs")),
    )
    said = []
    flight = Flight(config, said.append, dry_run=True)
    try:
        flight._run.open(flight.config, flight._policy, str(flight.onboard.link.vehicle))
    finally:
        flight._close()
    told = "a fixed legal set of transports is used instead"
    assert any(told in line for line in said) is damaged
    assert (flight.folder / RUN_FILE).read_bytes() == data
    assert read_policy(configuration.load(flight.folder / "config.toml")) == data
    (events,) = flight.folder.glob("*.events")
    with events.open("rb") as stream:
        header = next(event_record.read(stream, "x"))
    assert header.policy == data


def test_run_starts_without_the_file(load, monkeypatch):
    monkeypatch.setattr("companion.runtime.flight.warm_up", lambda: 0.0)
    config = msgspec.structs.replace(
        load("good.safetensors"), vehicle=VehicleConfig(link="udpin:127.0.0.1:0")
    )
    said = []
    flight = Flight(config, said.append, dry_run=True)
    flight._close()
    assert any("cannot be read: No such file" in line for line in said)
    assert any("policy good.safetensors could not be read: a fixed legal set" in line for line in said)
