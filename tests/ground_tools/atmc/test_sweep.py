"""`ground-tools atmc sweep`: equal budgets, kept runs, the judged delay, and wrong input."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import msgspec
import pytest

from companion.errors import ConfigError
from ground_tools import cli
from ground_tools.atmc.commands import kept_runs, sweep
from ground_tools.atmc.commands.sweep import CONFIGURATIONS, Row
from ground_tools.atmc.learners.algorithms import ALGORITHMS


def row(algorithm="iac", configuration=0, validation=((10, 1000.0),)):
    return Row(
        algorithm=algorithm,
        configuration=configuration,
        changes={},
        seed=101,
        validation=validation,
        cpu_s=1.0,
    )


def test_all_algorithms_have_as_many_configurations_and_begin_with_the_default():
    assert {len(found) for found in CONFIGURATIONS.values()} == {6}
    assert all(found[0] == {} for found in CONFIGURATIONS.values())


@pytest.mark.parametrize("algorithm", CONFIGURATIONS)
def test_the_configurations_are_valid_and_differ(algorithm):
    default = ALGORITHMS[algorithm].parts().settings
    found = [msgspec.structs.replace(default, **changes) for changes in CONFIGURATIONS[algorithm]]
    # Converting checks names, types and ranges.
    assert [msgspec.convert(msgspec.to_builtins(one), type(default)) for one in found] == found
    assert len(set(map(repr, found))) == len(found)


def test_a_run_is_judged_by_its_last_five_validations():
    delays_ms = [9000.0, 100.0, 200.0, 300.0, 400.0, 500.0]
    assert row(validation=tuple(enumerate(delays_ms))).delay_ms == 300.0


def test_runs_are_kept_and_not_trained_again(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sweep, "VALIDATE_EVERY", 1)
    monkeypatch.setitem(CONFIGURATIONS, "iac", CONFIGURATIONS["iac"][::5])
    out = tmp_path / "sweep.jsonl"
    command = ["atmc", "sweep", "--algorithms", "iac", "--episodes", "1", "--processes", "1", "--json"]
    assert cli.main([*command, "--out", str(out)]) == 0
    first = capsys.readouterr().out
    lines = out.read_text().splitlines()
    assert len(lines) == 1 + len(CONFIGURATIONS["iac"])
    # A run that a killed process left incomplete is trained again, and comes out the same.
    out.write_text("\n".join([*lines[:-1], lines[-1][:20]]))
    assert cli.main([*command, "--out", str(out)]) == 0
    again = capsys.readouterr().out
    delays_ms = [[one["delay_ms"] for one in json.loads(found)] for found in (first, again)]
    assert delays_ms[0] == delays_ms[1]
    assert len(set(delays_ms[0])) == 2


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--episodes", "5"), "--episodes: 5 is not allowed; allowed: multiples of 10"),
        (("--seeds", "x"), "--seeds: x is not allowed"),
        (("--winners", "x"), "--winners: x is not allowed"),
        (("--winners", "99-101"), "--winners: 99-101 has seeds of --seeds"),
        (("--processes", "0"), "--processes: 0 is out of range"),
    ],
)
def test_a_wrong_option_is_named(tmp_path, capsys, options, said):
    assert cli.main(["atmc", "sweep", "--out", str(tmp_path / "runs.jsonl"), *options]) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_runs_of_another_length_are_refused(tmp_path, capsys):
    out = tmp_path / "sweep.jsonl"
    out.write_text(json.dumps({"task": "paper", "episodes": 400}) + "\n")
    assert cli.main(["atmc", "sweep", "--episodes", "10", "--out", str(out)]) == 2
    assert "episodes: 400, now 10" in capsys.readouterr().err


def test_the_table_is_ordered_by_algorithm_configuration_and_seed():
    rows = [row("iac", 1), row("iac"), row("madqn", 5, ((10, 1234.56),))]
    found = sweep.table(rows)
    assert [one["algorithm"] for one in found] == ["madqn", "iac", "iac"]
    assert found[0]["delay_ms"] == 1234.6
    numbers = {
        sweep._key(algorithm, configuration, seed)
        for algorithm in CONFIGURATIONS
        for configuration in range(6)
        for seed in (0, 101, 999_999_999)
    }
    assert len(numbers) == 3 * 6 * 3
    assert all(isinstance(number, int) for number in numbers)


def test_a_file_without_runs_makes_no_table():
    with pytest.raises(ConfigError, match="holds no run"):
        sweep.table([])


def test_the_table_says_which_settings_are_the_default(tmp_path, capsys):
    out = tmp_path / "sweep.jsonl"
    rows = [row(configuration=n, validation=((10, 1000.0 + n),)) for n in range(6)]
    rows[1] = msgspec.structs.replace(rows[1], changes={"reward": "log", "discount": 0.0})
    lines = [
        json.dumps({"task": "paper", "episodes": 10}),
        *(msgspec.json.encode(one).decode() for one in rows),
    ]
    out.write_text("\n".join(lines) + "\n")
    assert cli.main(["atmc", "sweep", "--algorithms", "iac", "--episodes", "10", "--out", str(out)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "IAC default 101 1,000 0.0" in said
    assert "IAC reward log, discount 0.0 101 1,001 0.0" in said


def test_a_sample_shows_a_changed_run_and_a_missing_algorithm(tmp_path, monkeypatch):
    monkeypatch.setattr(sweep, "train", lambda one: row(one[0], one[1], ((one[3], 1000.0),)))
    path = tmp_path / "sweep.jsonl"

    def kept(*rows):
        lines = [b"{}", *map(msgspec.json.encode, rows)]
        path.write_bytes(b"\n".join(lines) + b"\n")
        return sweep.sample(path)

    same = [row(name, validation=((10, 1000.0), (20, 900.0))) for name in CONFIGURATIONS]
    assert kept(*same) == []
    assert kept(*same[:2]) == ["the file lacks the runs of an algorithm"]
    (found,) = kept(*same[:2], row("iac", validation=((10, 1001.0),)))
    assert found.startswith("iac, seed 101")


def test_the_best_settings_are_trained_with_seeds_that_did_not_choose_them(tmp_path, capsys, monkeypatch):
    trained = []

    def train_one(one):
        trained.append(one)
        algorithm, number, seed, episodes = one
        delay_ms = {0: 1200.0, 1: 1000.0, 2: 1100.0}[number] + (500.0 if seed < 100 and number == 1 else 0.0)
        found = row(algorithm, number, ((episodes, delay_ms),))
        return msgspec.structs.replace(found, seed=seed)

    monkeypatch.setitem(CONFIGURATIONS, "iac", CONFIGURATIONS["iac"][:3])
    monkeypatch.setitem(CONFIGURATIONS, "maddpg", CONFIGURATIONS["maddpg"][:3])
    monkeypatch.setattr(kept_runs, "in_parallel", lambda _, items, *__: [(n, train_one(n)) for n in items])
    out = tmp_path / "sweep.jsonl"
    command = ["atmc", "sweep", "--algorithms", "iac", "maddpg", "--episodes", "10", "--winners", "1-2"]
    for _ in range(2):  # the second time everything is kept, and the choice is the same
        assert cli.main([*command, "--json", "--out", str(out)]) == 0
        assert len(json.loads(capsys.readouterr().out)) == 10
        assert [one[:3] for one in trained[6:]] == [
            ("iac", 1, 1), ("maddpg", 1, 1), ("iac", 1, 2), ("maddpg", 1, 2),
        ]  # fmt: skip


@pytest.mark.parametrize("checkout", [True, False])
def test_an_installed_copy_writes_to_the_working_folder(tmp_path, monkeypatch, checkout):
    monkeypatch.setattr(kept_runs, "CHECKOUT", tmp_path if checkout else None)
    parser = argparse.ArgumentParser()
    kept = tmp_path / "results" / "runs.jsonl"
    kept_runs.add_options(parser, ["iac"], seeds="1-1", kept=kept)
    assert parser.parse_args([]).out == (kept if checkout else Path("runs.jsonl"))
