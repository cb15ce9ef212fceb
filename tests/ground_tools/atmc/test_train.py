"""`ground-tools atmc train`: run folders, resuming, stopping, and wrong input."""

from __future__ import annotations

import csv
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
import torch

from companion.atmc import policy
from companion.errors import ConfigError
from ground_tools import cli
from ground_tools.atmc.commands.results import Results, read, write
from ground_tools.atmc.learners import training
from ground_tools.atmc.learners.algorithms import ALGORITHMS

TINY = """
episodes = 4
batch = 16
buffer_steps = 15
hidden = [16, 8]
[task]
uavs = 4
steps = 10
validation_environments = 2
validation_steps = 2
"""


@pytest.fixture(autouse=True)
def _validate_often(monkeypatch):
    often = replace(ALGORITHMS["madqn"], validate_every=2, checkpoint_every=3)
    monkeypatch.setitem(ALGORITHMS, "madqn", often)


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    return path


def train(config: Path, root: Path, *more: str) -> tuple[int, list[Path]]:
    code = cli.main(
        ["atmc", "train", "--algorithm", "madqn", "--config", str(config), "--out", str(root), *more]
    )
    return code, sorted(root.iterdir())


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "metrics.csv").open() as file:
        found = list(csv.DictReader(file))
    for row in found:
        assert float(row.pop("seconds")) > 0.0
    return found


def test_run_folder(config, tmp_path, capsys):
    code, (folder,) = train(config, tmp_path / "runs", "--seed", "7")
    assert code == 0
    assert capsys.readouterr().out.strip() == str(folder)
    names = {path.name.split(".")[0] for path in folder.iterdir()}
    assert names == {"config", "manifest", "metrics", "events", "checkpoint", "policy"}
    manifest = json.loads((folder / "manifest.json").read_text())
    assert (manifest["algorithm"], manifest["seed"], manifest["device"]) == ("madqn", 7, "cpu")
    assert {"git_commit", "torch", "versions"} <= manifest.keys()
    found = rows(folder)
    assert [row["episode"] for row in found] == ["1", "2", "3", "4"]
    assert [bool(row["validation_score"]) for row in found] == [False, True, False, True]
    assert {"reward", "delay_ms", "loss", "exploration", "reward_uav3", "delay_ms_uav3"} <= found[0].keys()
    best = policy.load((folder / "policy.safetensors").read_bytes(), "best")
    scores = [float(row["validation_score"]) for row in found if row["validation_score"]]
    assert best.metadata.results["score"] == pytest.approx(min(scores))
    again = training.resumed_job(folder, None, None).settings
    assert (again.episodes, again.task.uavs, again.discount) == (4, 4, 0.95)


def test_a_longer_run_is_the_same_as_one_that_was_resumed(config, tmp_path):
    _, (whole,) = train(config, tmp_path / "whole", "--episodes", "5")
    _, (part,) = train(config, tmp_path / "part", "--episodes", "3")
    assert cli.main(["atmc", "train", "--resume", str(part), "--episodes", "5"]) == 0
    shorter = [row for row in rows(part) if row["episode"] != "3"]  # the very last round is validated too
    assert shorter == [row for row in rows(whole) if row["episode"] != "3"]
    states = [torch.load(folder / "checkpoint.pt", weights_only=True)["learner"] for folder in (whole, part)]
    assert torch.equal(states[0]["network"]["weights.0"], states[1]["network"]["weights.0"])
    assert torch.equal(states[0]["generator"], states[1]["generator"])
    assert (part / "config.toml").read_bytes() == (whole / "config.toml").read_bytes()


def test_rows_after_the_checkpoint_are_replaced(config, tmp_path):
    _, (folder,) = train(config, tmp_path / "runs", "--episodes", "3")
    with (folder / "metrics.csv").open("a") as file:
        file.write("4,torn")
    assert cli.main(["atmc", "train", "--resume", str(folder), "--episodes", "4"]) == 0
    assert [row["episode"] for row in rows(folder)] == ["1", "2", "3", "4"]


def test_seeds_side_by_side(config, tmp_path, monkeypatch):
    """The workers are forks of this process, which has loaded PyTorch; the tests below start new
    processes."""
    forked = multiprocessing.get_context("fork")
    monkeypatch.setattr(multiprocessing, "get_context", lambda _method: forked)
    code, folders = train(config, tmp_path / "many", "--seeds", "1-2", "--episodes", "2")
    assert code == 0
    _, (alone,) = train(config, tmp_path / "alone", "--seed", "2", "--episodes", "2")
    assert [json.loads((f / "manifest.json").read_text())["seed"] for f in folders] == [1, 2]
    assert [row["reward"] for row in rows(folders[1])] == [row["reward"] for row in rows(alone)]


def signalled_while_it_trains(number: signal.Signals, root: Path, runs: int) -> None:
    """Send the signal to this process when every run has written its first rows."""
    give_up = time.monotonic() + 300.0
    while len(list(root.glob("*/metrics.csv"))) < runs and time.monotonic() < give_up:
        time.sleep(0.05)
    os.kill(os.getpid(), number)


def train_until(number: signal.Signals, config: Path, root: Path, *more: str, runs: int = 1) -> int:
    """Train in this process, because a new one would take seconds of CPU time to load PyTorch."""
    before = signal.signal(number, not_handled)
    try:
        threading.Thread(target=signalled_while_it_trains, args=(number, root, runs)).start()
        return train(config, root, "--episodes", "100000", *more)[0]
    finally:
        signal.signal(number, before)


def goes_on_from_complete_files(root: Path) -> None:
    (folder,) = root.iterdir()
    done = torch.load(folder / "checkpoint.pt", weights_only=True)["learner"]["done"]
    assert done == len(rows(folder)) > 0
    assert not list(folder.glob("*.new"))
    assert cli.main(["atmc", "train", "--resume", str(folder), "--episodes", str(done + 1)]) == 0


def not_handled(number: int, _: object) -> None:
    raise AssertionError(f"signal {number} does not reach the training")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_complete_files(number, config, tmp_path, capsys):
    root = tmp_path / "runs"
    assert train_until(number, config, root) == 130
    assert "--resume" in capsys.readouterr().err
    goes_on_from_complete_files(root)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("batches = 3", "batches: unknown key; did you mean batch? allowed here: task, "),
        ("discount = 1.5", "discount: 1.5: expected a number, 0 to 1"),
        ("[task]\nuavs = 1", "task.uavs: 1: expected a whole number, 2 to 100"),
        ("[task.environment.world]\nsides = 'big'", "task.environment.world.sides: 'big'"),
        ("hidden = 3", "hidden: 3: expected a list"),
        ("[task.environment.world]\nsides = -5.0", "task.environment.world.sides: -5.0"),
        ("[task.environment.world]\nload = [0.0, 1.0]", "task.environment.world.load"),
    ],
)
def test_wrong_keys_are_named(text, words, config, tmp_path, capsys):
    config.write_text(text)
    assert cli.main(["atmc", "train", "--algorithm", "madqn", "--config", str(config)]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert str(config) in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--algorithm", "madqn", "--config", "nowhere.toml"], "nowhere.toml: cannot be read"),
        (["--algorithm", "madqn", "--seeds", "5-1"], "--seeds: 5-1 is not allowed; allowed: a rising range"),
        (["--algorithm", "madqn", "--seed", "-1"], "--seed: -1 is out of range; allowed"),
        (
            ["--algorithm", "madqn", "--seed", "99999999999"],
            "--seed: 99999999999 is out of range; allowed: 0 to 4294967295",
        ),
        (["--algorithm", "madqn", "--episodes", "0"], "--episodes: 0 is out of range; allowed"),
        (["--algorithm", "madqn", "--seeds", "1-2", "--jobs", "0"], "--jobs: 0 is out of range; allowed"),
        (["--resume", "nowhere"], "--resume: nowhere: this is not the folder of a training run"),
        (["--resume", "nowhere", "--seed", "1"], "--seed cannot be combined with --resume"),
        (["--algorithm", "madqn", "--out", "/proc/x"], "--out: /proc/x: cannot be written"),
    ],
)
def test_wrong_options_are_named(options, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["atmc", "train", *options]) == 2
    assert words in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("fleets = []", "fleets"),
        ("fleets = [[1, 4]]", "fleets[0][0]"),
        ("fleets = [[3, 0]]", "fleets[0][1]"),
        ("learning_rate = [-1.0, 0.0]", "learning_rate[0]"),
        ("switch_price_s = -1.0", "switch_price_s"),
        ("masked = 1.5", "masked"),
    ],
)
def test_wrong_keys_of_the_set_network_are_named(text, key, tmp_path, capsys):
    path = tmp_path / "flying.toml"
    path.write_text(text)
    assert cli.main(["atmc", "train", "--algorithm", "flying", "--config", str(path)]) == 2
    assert f"{path}: {key}" in capsys.readouterr().err


def test_parallel_runs_end_with_their_parent(config, tmp_path):
    """Only the parent receives SIGTERM: the runs stop as after Ctrl-C, and no process is left."""
    root = tmp_path / "runs"
    assert train_until(signal.SIGTERM, config, root, "--seeds", "1-2", "--jobs", "2", runs=2) == 130
    assert multiprocessing.active_children() == []
    for folder in root.iterdir():
        done = torch.load(folder / "checkpoint.pt", weights_only=True)["learner"]["done"]
        assert done == len(rows(folder)) > 0


def test_a_damaged_metrics_file_is_named(config, tmp_path, capsys):
    _, (folder,) = train(config, tmp_path / "runs", "--episodes", "1")
    (folder / "metrics.csv").write_text("episode\nx\n")
    assert cli.main(["atmc", "train", "--resume", str(folder), "--episodes", "2"]) == 2
    assert "metrics.csv: this is not the metrics file of a run" in capsys.readouterr().err


def test_a_device_that_is_not_there(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ConfigError, match="--device: cuda"):
        training.device_of("cuda")


def test_a_damaged_checkpoint_is_named(config, tmp_path, capsys):
    _, (folder,) = train(config, tmp_path / "runs", "--episodes", "1")
    (folder / "checkpoint.pt").write_bytes(b"torn")
    assert cli.main(["atmc", "train", "--resume", str(folder)]) == 2
    assert "checkpoint.pt: cannot be read" in capsys.readouterr().err


def test_missing_pytorch_is_reported_in_one_line(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "torch", None)
    for name in [name for name in sys.modules if name.startswith("ground_tools.atmc.learners.training")]:
        monkeypatch.delitem(sys.modules, name)
    import ground_tools.atmc

    monkeypatch.delattr(ground_tools.atmc, "training", raising=False)
    assert cli.main(["atmc", "train", "--algorithm", "madqn"]) == 2
    assert "pip install -e '.[train]'" in capsys.readouterr().err


def test_no_command_loads_pytorch_before_it_needs_it():
    modules = ", ".join(module for _, module, _ in cli.COMMANDS)
    code = f"import {modules}, sys; print('torch' in sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert found.stdout.strip() == "False"


def test_collected_runs(config, tmp_path, capsys):
    _, (folder,) = train(config, tmp_path / "runs")
    out = tmp_path / "results.json.gz"
    arguments = ["atmc", "collect", str(folder), "--configurations", "250", "--out", str(out)]
    assert cli.main(arguments) == 0
    (found,) = read(out).runs
    assert (found.algorithm, found.seed, len(found.reward)) == ("madqn", 1, 4)
    assert [episode for episode, _ in found.validation] == [2, 4]
    assert sum(found.best_delay_uav_ms) == pytest.approx(found.best["delay_ms"], rel=1e-2)
    assert found.last["delay_ms"] > 0.0
    assert "madqn" in capsys.readouterr().out
    other = msgspec.structs.replace(found, seed=7)
    replaced = msgspec.structs.replace(found, seconds=1e6)
    write(out, Results(configurations=250, runs=(replaced, other)))
    assert cli.main([*arguments, "--add"]) == 0
    assert read(out).runs == (found, other)
    assert cli.main([*arguments, "--add", "--configurations", "500"]) == 2
    assert "measured with --configurations 250, not 500" in capsys.readouterr().err
    (folder / "metrics.csv").write_text("episode\n1\n")
    assert cli.main(arguments) == 2
    assert "1 of 4 episodes" in capsys.readouterr().err
    (folder / "metrics.csv").write_text("episode,seconds\n" + "1,1\n" * 4)
    assert cli.main(arguments) == 2
    assert "metrics.csv: the column delay_ms is missing" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda f: (f / "policy.safetensors").unlink(), "policy.safetensors: cannot be read: No such file"),
        (lambda f: (f / "policy.safetensors").write_bytes(b"torn"), "policy.safetensors"),
        (lambda f: (f / "checkpoint.pt").write_bytes(b"torn"), "checkpoint.pt: cannot be read"),
        (
            lambda f: (f / "manifest.json").write_text('{"algorithm": "set-paper"}'),
            "a run of set-paper; allowed: runs of madqn",
        ),
    ],
)
def test_runs_that_cannot_be_collected_are_named_before_anything_is_measured(
    spoil, words, config, tmp_path, capsys, monkeypatch
):
    _, (good,) = train(config, tmp_path / "good")
    _, (bad,) = train(config, tmp_path / "bad")
    spoil(bad)
    monkeypatch.setattr("ground_tools.atmc.commands.collect.measured", None)
    assert cli.main(["atmc", "collect", str(good), str(bad), "--configurations", "250"]) == 2
    assert words in capsys.readouterr().err
