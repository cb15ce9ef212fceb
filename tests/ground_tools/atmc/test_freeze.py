"""`ground-tools atmc freeze`: the file's metadata, refused input, and the policy that a resumed run keeps."""

from __future__ import annotations

import hashlib
import re

import numpy as np
import pytest

from companion.atmc.observation import NEIGHBOUR_COLUMNS
from companion.atmc.policy import check_flyable, load
from ground_tools import cli
from ground_tools.atmc.commands import evaluate, freeze_command
from ground_tools.atmc.learners import validation
from ground_tools.atmc.learners.flying_policy import FlyingLearner
from tests.ground_tools.atmc.test_train import TINY

FLYING = """
episodes = 2
updates = 2
fleets = [[5, 4], [3, 4]]
switch_price_s = 0.03
"""
MADQN = TINY.replace("episodes = 4", "episodes = 1")
KEYS = ("dynamic_ms", "best_fixed_dynamic_ms", "rule_dynamic_ms", "search_dynamic_ms")


def train(root, algorithm, text):
    """Train a tiny run. Returns its folder."""
    root.mkdir(exist_ok=True)
    config = root / f"{algorithm}.toml"
    config.write_text(text)
    out = root / algorithm
    assert (
        cli.main(["atmc", "train", "--algorithm", algorithm, "--config", str(config), "--out", str(out)]) == 0
    )
    (folder,) = out.iterdir()
    return folder


@pytest.fixture(scope="module", autouse=True)
def _few():
    """Limit measurements to few places and fleets."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(validation, "_FLEETS", dict.fromkeys(("paper", "awareness"), ((3, 2),)))
        patch.setattr(freeze_command, "SAMPLES", {5: 1, 10: 1})
        patch.setattr(evaluate, "decision_us", lambda *_: 0.0)
        patch.setattr(evaluate, "switches_per_minute", lambda *_: 0.0)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return train(tmp_path_factory.mktemp("runs"), "flying", FLYING)


@pytest.fixture
def asked(monkeypatch):
    """Replace the measurement; the list of policies and questions that would have been measured, in order."""
    found = []

    def measure(data, name, question):
        found.append((load(data, name), question))
        return {key: 100.0 * question.uavs + place for place, key in enumerate(KEYS)}

    monkeypatch.setattr(evaluate, "evaluate", measure)
    monkeypatch.setattr(freeze_command, "SAMPLES", {4: 7, 5: 3, 10: 1})
    return found


def freeze(folder, out, *more):
    return cli.main(["atmc", "freeze", str(folder), "--out", str(out), *more])


def test_a_frozen_run_is_the_policy_that_flies(folder, tmp_path, capsys):
    out = tmp_path / "best.safetensors"
    assert freeze(folder, out, "--name", "Our best") == 0
    made, source = (load(path.read_bytes(), path.name) for path in (out, folder / "policy.safetensors"))
    check_flyable(made, None)
    m = made.metadata
    assert m.name == "Our best"
    assert m.training_config_sha256 == hashlib.sha256((folder / "config.toml").read_bytes()).hexdigest()
    assert m.switch_price == 0.03
    assert len(m.golden) == 2
    assert any(case.rows for case in m.golden)
    for case in m.golden:
        rows = np.array(case.rows).reshape(len(case.rows), len(NEIGHBOUR_COLUMNS))
        for policy in (made, source):
            assert policy.values(np.array(case.own), rows).tolist() == pytest.approx(case.q, abs=1e-5)
    # Only the fleet sizes of the training are measured.
    assert list(m.results) == [f"uavs5_{key}" for key in KEYS]
    assert 0.0 < m.results["uavs5_search_dynamic_ms"] == min(m.results.values())
    printed = capsys.readouterr().out
    assert f"wrote {out}: {out.stat().st_size:,} bytes" in printed
    for key, value in m.results.items():
        assert f"  {key}: {value:g}\n" in printed


def test_results_are_those_of_the_file(folder, tmp_path, asked):
    out = tmp_path / "best.safetensors"
    assert freeze(folder, out, "--switch-price", "0.5") == 0
    made = load(out.read_bytes(), "x").metadata
    assert made.name == "best"
    assert made.results == {
        f"uavs{uavs}_{key}": 100.0 * uavs + place for uavs in (4, 5) for place, key in enumerate(KEYS)
    }
    assert [(q.objective, q.uavs, q.samples) for _, q in asked] == [("awareness", 4, 7), ("awareness", 5, 3)]
    assert {measured.metadata.switch_price for measured, _ in asked} == {0.5}


@pytest.mark.parametrize("price", ["0", "0.5", "10"])
def test_the_file_contains_the_switch_price(price, folder, tmp_path, asked):
    out = tmp_path / "x.safetensors"
    assert freeze(folder, out, "--switch-price", price) == 0
    assert load(out.read_bytes(), "x").metadata.switch_price == float(price)


@pytest.mark.parametrize("price", ["-0.1", "10.1", "nan", "inf"])
def test_a_price_out_of_bounds_is_refused(price, folder, tmp_path, asked, capsys):
    out = tmp_path / "x.safetensors"
    assert freeze(folder, out, f"--switch-price={price}") == 2
    words = f"--switch-price: {float(price):g} is out of range; allowed: 0 to 10\n"
    assert capsys.readouterr().err == f"ground-tools: {words}"
    assert not out.exists()
    assert not asked


def test_a_flat_policy_is_measured_with_its_own_fleet_size(tmp_path, asked):
    run = train(tmp_path, "madqn", MADQN)
    out = tmp_path / "x.safetensors"
    assert freeze(run, out) == 0
    made = load(out.read_bytes(), "x").metadata
    assert (made.kind, made.agents, made.switch_price) == ("flat", 4, 0.0)
    assert [(q.objective, q.uavs, q.samples) for _, q in asked] == [("paper", 4, 7)]
    assert list(made.results) == [f"uavs4_{key}" for key in KEYS]


@pytest.mark.parametrize("missing", ["folder", "policy.safetensors", "config.toml"])
def test_a_folder_that_is_no_run_is_refused(missing, folder, tmp_path, asked, capsys):
    run = tmp_path / "run"
    if missing != "folder":
        run.mkdir()
        for name in {"policy.safetensors", "config.toml"} - {missing}:
            (run / name).write_bytes((folder / name).read_bytes())
    out = tmp_path / "x.safetensors"
    assert freeze(run, out) == 2
    named = "config.toml" if missing == "config.toml" else "policy.safetensors"
    wanted = rf"ground-tools: {re.escape(str(run / named))}: cannot be read: No such file or directory\n"
    assert re.fullmatch(wanted, capsys.readouterr().err)
    assert not out.exists()


def test_a_damaged_policy_and_an_unwritable_path_are_named(folder, tmp_path, asked, capsys):
    assert freeze(folder, tmp_path / "nowhere" / "x.safetensors") == 2
    assert "nowhere/x.safetensors: cannot be written: No such file or directory" in capsys.readouterr().err
    run = tmp_path / "run"
    run.mkdir()
    (run / "config.toml").write_text(FLYING)
    (run / "policy.safetensors").write_bytes(b"torn")
    assert freeze(run, tmp_path / "x.safetensors") == 2
    error = capsys.readouterr().err
    assert "policy.safetensors: not a safetensors file" in error
    assert error.count("\n") == 1


def test_a_resumed_run_keeps_the_best_policy_of_all_sessions(tmp_path, monkeypatch):
    scores = iter([5.0, 6.0, 4.0, 4.5])
    monkeypatch.setattr(FlyingLearner, "validate", lambda self: {"score": next(scores)})
    run = train(tmp_path, "flying", "episodes = 1\nupdates = 1\nfleets = [[3, 4]]")
    kept = []
    for episodes in (1, 2, 3, 4):
        if episodes > 1:
            assert cli.main(["atmc", "train", "--resume", str(run), "--episodes", str(episodes)]) == 0
        kept.append((run / "policy.safetensors").read_bytes())
    assert [load(data, "x").metadata.results["score"] for data in kept] == [5.0, 5.0, 4.0, 4.0]
    assert kept[0] == kept[1] != kept[2] == kept[3]
