"""Choice of transports in simulations: keys, options, the random chooser and the reported choices."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
import tomli_w

from companion.atmc.actions import SET_ACTIONS, legal
from companion.atmc.choice import Refused
from companion.config import AtmcConfig, check
from companion.errors import ConfigError
from companion.event_record import Step
from companion.events import BroadcastChanged, TransportsChosen
from companion.remote_id.region import Region
from companion.toml_reader import without_none
from sitl_mocks import cli
from sitl_mocks.air.air_settings import AirSettings
from sitl_mocks.encounters import choosing, lockstep, scenario_file
from sitl_mocks.encounters.choosing import Chosen, RandomMind, chosen_of, shares_of
from sitl_mocks.encounters.scenario_file import PathSettings, Scenario
from tests.companion.atmc.policies import FO, metadata, policy_file

REGIONS = Path(__file__).parents[3] / "config" / "regions"
US = scenario_file.load_region(REGIONS / "us.toml")
NEAR = Scenario(
    path=(
        PathSettings(points=((0.0, -25.0, 60.0, -60.0), (12.0, 25.0, 60.0, -60.0))),
        PathSettings(points=((0.0, 25.0, 0.0, -60.0), (12.0, -25.0, 0.0, -60.0))),
    ),
    air=AirSettings(model="packets", rate=5),
)
SHORT = """duration_s = 8.0
[[path]]
points = [[0.0, -25.0, 60.0, -60.0], [12.0, 25.0, 60.0, -60.0]]
[[path]]
points = [[0.0, 25.0, 0.0, -60.0], [12.0, -25.0, 0.0, -60.0]]
[air]
model = "packets"
"""


def write(folder, text):
    path = folder / "s.toml"
    path.write_text(text)
    return path


def chosen_by(policy, seed=1, data=None, **changes):
    scenario = msgspec.structs.replace(NEAR, atmc=AtmcConfig(policy=policy), **changes)
    return lockstep.fly(scenario, seed, policy=data).chosen


# ---------------------------------------------------------------- keys and options


def test_a_file_names_sets_region_and_policy(tmp_path):
    path = write(
        tmp_path,
        f'geometry = "S2"\n[air]\ntransports = ["ble4", "ble5"]\nrate = 3\nregion = "{REGIONS / "us.toml"}"\n'
        '[atmc]\npolicy = "p.safetensors"\nperiod_s = 1.0\n',
    )
    scenario = scenario_file.load(path)
    assert (scenario.air.transports, scenario.air.rate) == (("ble4", "ble5"), 3)
    assert (scenario.region, scenario.air.region) == (US, None)
    assert scenario.atmc == AtmcConfig(policy=str(tmp_path / "p.safetensors"), period_s=1.0)
    copy = tmp_path / "folder" / "config.toml"
    copy.parent.mkdir()
    kept = choosing.keep(copy.parent, scenario, policy_file())
    copy.write_text(tomli_w.dumps(without_none(msgspec.to_builtins(kept))))
    again = scenario_file.load(copy)
    assert again.region == US
    assert choosing.read_policy(again) == policy_file()


@pytest.mark.parametrize("word", ["rule", "fixed", "random"])
def test_words_are_not_paths(tmp_path, word):
    scenario = scenario_file.load(write(tmp_path, f'geometry = "S2"\n[atmc]\npolicy = "{word}"\n'))
    assert scenario.atmc.policy == word
    assert choosing.read_policy(scenario) is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[air]\ntransport = "wifi"\n', "air.transport: unknown key"),
        ("[air]\ntransports = []\n", "air.transports"),
        ('[air]\ntransports = ["lora"]\n', "air.transports"),
        ('[air]\nregion = "nowhere.toml"\n', "air.region: "),
        ('[air]\nregion = "r.toml"\n[region]\nname = "x"\n', "region: give either region or air.region"),
        ("[atmc]\npolicy = 3\n", "atmc.policy"),
        ("[atmc]\nperiod_s = 0.1\n", "atmc.period_s"),
    ],
)
def test_wrong_keys_are_named(tmp_path, text, words):
    (tmp_path / "r.toml").write_text('name = "x"\n')
    with pytest.raises(ConfigError) as refused:
        scenario_file.load(write(tmp_path, 'geometry = "S2"\n' + text))
    assert words in str(refused.value)
    assert str(tmp_path) in str(refused.value)


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["--policy", "/nowhere.safetensors"], "atmc.policy: /nowhere.safetensors: cannot be read"),
        (["--region", "/nowhere.toml"], "--region: /nowhere.toml: cannot be read"),
    ],
)
def test_wrong_options_are_one_line(tmp_path, capsys, words, error):
    assert cli.main(["demo", "--runs", str(tmp_path), *words]) == 2
    told = capsys.readouterr().err
    assert error in told
    assert told.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_damaged_policy_and_one_that_no_law_allows(tmp_path):
    path = tmp_path / "p.safetensors"
    path.write_bytes(policy_file()[:-3])
    damaged = Scenario(atmc=AtmcConfig(policy=str(path)))
    with pytest.raises(ConfigError, match=r"p\.safetensors"):
        choosing.read_policy(damaged)
    path.write_bytes(policy_file())
    nan = Region(name="only nan", transport_sets=(("nan",),))
    with pytest.raises(ConfigError, match="none of its actions is legal in region only nan"):
        choosing.read_policy(msgspec.structs.replace(damaged, region=nan))


def test_the_swarm_has_no_random_choice(tmp_path, capsys):
    assert cli.main(["swarm", "--policy", "random", "--runs", str(tmp_path)]) == 2
    assert "--policy: random is allowed only with sitl-mocks demo" in capsys.readouterr().err


@pytest.mark.parametrize("region", ["none", "us", "eu", "jp"])
def test_simulated_identities_are_as_each_law_asks(region):
    """No swarm flies with an identity that `companion check` would refuse."""
    scenario = msgspec.structs.replace(NEAR, region=scenario_file.load_region(REGIONS / f"{region}.toml"))
    (path, _) = lockstep.paths_of(scenario, 1)
    config = lockstep.companion_config(scenario, "DMUCA001", path, "none")
    check(config, "simulated")
    assert config.region.name == region
    assert config.identity.uas_id == ("DMUCA001" if region == "none" else "15968DMUCA001")


# ---------------------------------------------------------------- what is chosen


def test_random_takes_what_is_allowed_and_only_that():
    mind = RandomMind(np.random.default_rng(1))
    allowed = legal(SET_ACTIONS, US)
    drawn = [mind.choose(np.zeros(0), np.zeros((0, 0)), allowed, None).index for _ in range(2000)]
    assert set(drawn) == set(np.flatnonzero(allowed))
    assert isinstance(
        mind.choose(np.zeros(0), np.zeros((0, 0)), np.zeros(len(SET_ACTIONS), bool), None), Refused
    )


def test_the_rule_takes_ble4_beside_wifi_where_someone_is_near():
    chosen = chosen_by("rule", region=US)
    for one in chosen.values():
        assert set(one.seconds) >= {"ble4 10 + wifi 10"}
        assert one.seconds["ble4 10 + wifi 10"] > 8.0
        assert sum(one.seconds.values()) == pytest.approx(15.0, abs=0.1)
        assert one.switches >= 1


def test_who_does_not_choose_keeps_the_set():
    air = AirSettings(model="packets", transports=("ble4", "ble5"), rate=3)
    for one in chosen_by(None, air=air).values():
        assert set(one.seconds) == {"ble4 3 + ble5 3"}
        assert one.switches == 0


def test_the_same_seed_draws_the_same_choices_and_another_others():
    first, again, other = (chosen_by("random", seed) for seed in (1, 1, 2))
    assert first == again
    assert first != other
    assert first["DMUCA001"] != first["DMUCA002"]


def test_a_policy_file_chooses():
    """Random weights: whatever it chooses, it does not stay with what was configured."""
    chosen = chosen_by("p.safetensors", data=policy_file(seed=3))
    assert any(set(one.seconds) != {"wifi 5"} for one in chosen.values())


def test_time_on_each_set_and_switches():
    one = Chosen()
    one.note(0.0, {})
    one.note(2.0, {"wifi": 5})
    one.note(4.0, {"wifi": 5})
    one.note(12.0, {"wifi": 10, "ble4": 3})
    one.note(32.0, {"wifi": 5})
    one.end(62.0)
    assert one.fallback_s == 0.0
    assert one.seconds == {"wifi 5": 40.0, "ble4 3 + wifi 10": 20.0}
    assert one.switches == 2
    assert one.switches_per_minute == 2.0
    other = Chosen({"wifi 5": 20.0})
    assert shares_of([one, other]) == {"wifi 5": 0.75, "ble4 3 + wifi 10": 0.25}
    assert choosing.choices_in_words([one, other]) == (
        "transports (Locations per second): 75 % wifi 5, 25 % ble4 3 + wifi 10, "
        "1.0 switches per minute and aircraft"
    )
    assert choosing.choices_in_words([Chosen()]) == "transports: no Locations were sent"


def test_time_on_the_fall_back():
    """What the policy saw was outside its training: it is told how long that was."""

    def step(now_s, *commands):
        return Step(now_s=now_s, events=(), commands=commands)

    one, rates = Chosen(), (("wifi", 10),)
    one.add_step(step(0.0, BroadcastChanged(rates=rates, legal=True, reason="")))
    one.add_step(step(5.0, TransportsChosen(rates=rates, by="fallback", reason="outside")))
    one.add_step(step(6.0))
    one.add_step(step(8.0, TransportsChosen(rates=rates, by="policy", reason="")))
    one.end(20.0)
    assert (one.seconds, one.fallback_s) == ({"wifi 10": 20.0}, 3.0)
    assert choosing.fallback_share([one]) == 0.15
    assert choosing.choices_in_words([one]).endswith(", 15.0 % of the time on the fallback")
    bounds = msgspec.structs.replace(metadata().bounds, own_high=(-0.9,) * FO)
    narrow = policy_file(bounds=bounds)
    assert all(one.fallback_s > 5.0 for one in chosen_by("p.safetensors", data=narrow).values())


def test_the_record_tells_the_same_as_the_simulation():
    steps = []
    scenario = msgspec.structs.replace(NEAR, atmc=AtmcConfig(policy="rule"))
    run = lockstep.fly(
        scenario, 1, record=lambda name, _: steps.append if name == "DMUCA001" else lambda s: None
    )
    assert any(isinstance(c, BroadcastChanged) for s in steps if isinstance(s, Step) for c in s.commands)
    told, flown = chosen_of(steps), run.chosen["DMUCA001"]
    assert told == flown


@pytest.mark.usefixtures("one_worker")
def test_a_run_folder_with_a_policy_stands_alone_and_replays(tmp_path, capsys):
    policy = tmp_path / "wild.safetensors"
    policy.write_bytes(policy_file(seed=3))
    words = ["--scenario", str(write(tmp_path, SHORT)), "--runs", str(tmp_path / "runs")]
    words += ["--policy", str(policy), "--region", str(REGIONS / "us.toml")]
    assert cli.main(["demo", *words]) in (0, 1)
    out = capsys.readouterr().out
    assert "transports (Locations per second): " in out
    assert "switches per minute" in out
    policy.unlink()
    (folder,) = (tmp_path / "runs").iterdir()
    scenario = scenario_file.load(folder / "config.toml")
    assert scenario.region == US
    assert choosing.read_policy(scenario) == policy_file(seed=3)
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["policy"] == "wild.safetensors"
    assert set(summary["transports"]) == {"DMUCA001", "DMUCA002"}
    assert sum(summary["shares"].values()) == pytest.approx(1.0, abs=0.01)
    from companion.commands import cli as companion_cli

    assert companion_cli.main(["replay", str(folder)]) == 0


@pytest.mark.usefixtures("one_worker")
def test_a_random_choice_leaves_no_record_that_a_replay_would_refute(tmp_path, capsys):
    words = ["--scenario", str(write(tmp_path, SHORT)), "--runs", str(tmp_path / "runs")]
    assert cli.main(["demo", *words, "--policy", "random", "--json"]) in (0, 1)
    told = capsys.readouterr()
    assert "No event records" in told.err
    assert json.loads(told.out)["policy"] == "random"
    (folder,) = (tmp_path / "runs").iterdir()
    assert not list(folder.glob("*.events"))
    assert (folder / "DMUCA001.tlog").exists()
