"""`ground-tools atmc crosscheck`: the table, the kept runs, wrong input; training if the library is there."""

from __future__ import annotations

import importlib.util
import json
from importlib import metadata

import pytest

from companion.errors import ConfigError
from ground_tools import cli
from ground_tools.atmc.commands import crosscheck, results
from ground_tools.atmc.commands.crosscheck import Row


def row(algorithm="iql", seed=1, curve=((2000, 1500.0), (4000, 1000.0)), last_ms=1010.0):
    return Row(
        algorithm=algorithm, seed=seed, curve=curve, last={"delay_ms": last_ms}, cpu_s=1.0, library="none 1"
    )


@pytest.fixture
def best_1500_ms(monkeypatch):
    monkeypatch.setattr(crosscheck, "best_fixed_ms", lambda: 1500.0)


def kept(path, rows, steps=4000):
    lines = [{"task": "paper", "steps": steps}, *({**crosscheck_row(one)} for one in rows)]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def crosscheck_row(one):
    return {name: getattr(one, name) for name in one.__struct_fields__}


def line(found, name):
    (it,) = (one for one in found["lines"] if one["name"] == name)
    return it


def test_a_learner_counts_from_the_first_measurement_32_percent_below(best_1500_ms):
    rows = [
        row(curve=((2000, 1021.0), (4000, 1020.0), (6000, 1400.0)), last_ms=1.0),
        row(seed=2, curve=((2000, 1400.0), (4000, 1300.0), (6000, 1200.0)), last_ms=2.0),
    ]
    found = line(crosscheck.table(rows), "IQL")
    assert found["first"] == [4000, None]
    assert found["at_budget_ms"] == [1400.0, 1200.0]
    assert found["last_ms"] == [1.0, 2.0]


def test_the_common_budget_is_that_of_the_shortest_run(best_1500_ms):
    found = crosscheck.table([row(), row(seed=2, curve=((2000, 1200.0),))])
    assert found["steps"] == 2000
    assert line(found, "IQL")["at_budget_ms"] == [1500.0, 1200.0]


def test_this_project_s_learners_stand_beside_at_the_same_budget(best_1500_ms):
    found = line(crosscheck.table([row()]), "MADQN-ATMC")
    runs = results.read().of("madqn")
    assert found["seeds"] == [run.seed for run in runs]
    assert found["last_ms"] == [run.last["delay_ms"] for run in runs]
    # An episode has a hundred steps, so that 4,000 steps are forty episodes.
    assert found["at_budget_ms"] == [dict(run.validation)[40] for run in runs]


def test_runs_in_the_file_are_not_trained_again(tmp_path, best_1500_ms, capsys):
    path = kept(tmp_path / "runs.jsonl", [row(), row("ippo"), row("masac")])
    assert (
        cli.main(["atmc", "crosscheck", "--seeds", "1-1", "--steps", "4000", "--out", str(path), "--json"])
        == 0
    )
    found = json.loads(capsys.readouterr().out)
    assert [one["name"] for one in found["lines"]][:3] == ["IQL", "IPPO", "MASAC"]


def test_runs_of_another_length_are_refused(tmp_path, capsys):
    path = kept(tmp_path / "runs.jsonl", [row()])
    assert cli.main(["atmc", "crosscheck", "--seeds", "1-1", "--steps", "2000", "--out", str(path)]) == 2
    assert "steps: 4000, now 2000" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--steps", "3000"), "--steps: 3000 is not allowed; allowed: multiples of 2000"),
        (("--steps", "0"), "--steps: 0 is not allowed"),
        (("--seeds", "3-1"), "--seeds: 3-1 is not allowed"),
        (("--processes", "0"), "--processes: 0 is out of range"),
    ],
)
def test_a_wrong_option_is_named(tmp_path, capsys, options, said):
    assert cli.main(["atmc", "crosscheck", "--out", str(tmp_path / "runs.jsonl"), *options]) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_without_the_library_the_extra_is_named(tmp_path, capsys, monkeypatch):
    def version(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "version", version)
    assert cli.main(["atmc", "crosscheck", "--seeds", "1-1", "--out", str(tmp_path / "runs.jsonl")]) == 2
    said = capsys.readouterr().err
    assert "benchmarl is not installed" in said
    assert "crosscheck" in said


def test_a_file_without_runs_makes_no_table(best_1500_ms):
    with pytest.raises(ConfigError, match="holds no run"):
        crosscheck.table([])


@pytest.mark.skipif(
    importlib.util.find_spec("benchmarl") is None, reason="the extra crosscheck is not installed"
)
@pytest.mark.parametrize("algorithm", ["iql", "ippo", "masac"])
def test_a_run_is_the_same_again(algorithm, monkeypatch):
    from ground_tools.atmc.learners import outside

    for name, value in outside.SETTINGS.items():
        if name.endswith(("frames_per_batch", "optimizer_steps")):
            monkeypatch.setitem(outside.SETTINGS, name, 100 if value == 2000 else 3)
    runs = [outside.train(algorithm, 1, 200) for _ in range(2)]
    assert [steps for steps, _ in runs[0].curve] == [100, 200]
    assert runs[0].curve == runs[1].curve
