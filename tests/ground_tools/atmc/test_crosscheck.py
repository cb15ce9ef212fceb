"""`ground-tools atmc crosscheck`: the table, the kept runs, wrong input; training if the library is there."""

from __future__ import annotations

import importlib.util
import json
import re
from importlib import metadata
from types import SimpleNamespace

import pytest
import torch

from companion.errors import ConfigError
from ground_tools import cli
from ground_tools.atmc.commands import crosscheck, results
from ground_tools.atmc.commands.crosscheck import Row
from ground_tools.common.kept_lines import read_lines
from ground_tools.common.provenance import CannotSampleError


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


def test_a_file_that_cannot_be_written_is_refused_before_anything_is_trained(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(crosscheck, "_missing_package", lambda: None)
    monkeypatch.setattr(crosscheck, "train", None)
    out = tmp_path / "none" / "runs.jsonl"
    assert cli.main(["atmc", "crosscheck", "--processes", "1", "--out", str(out)]) == 2
    assert f"--out: {out}: cannot be written" in capsys.readouterr().err


def test_lines_that_are_no_runs_are_ignored(tmp_path, best_1500_ms):
    path = kept(tmp_path / "runs.jsonl", [row()])
    other = json.dumps(crosscheck_row(row()) | {"algorithm": "qmix"})
    empty = json.dumps(crosscheck_row(row(seed=2)) | {"curve": []})
    path.write_text(path.read_text() + f"{other}\n{empty}\n")
    _, rows = read_lines(path, Row)
    assert rows == [row()]


def test_the_best_fixed_mode_is_the_one_with_the_least_delay(monkeypatch):
    def validate(self, choose):
        action = int(choose(torch.zeros(1, 2, 3))[0, 0])
        return {"score": 2000.0 + (action - 7) ** 2}

    monkeypatch.setattr("ground_tools.atmc.env.paper_task.PaperTask.validate", validate)
    assert crosscheck.best_fixed_ms() == 2000.0


def test_the_last_policy_is_measured_as_those_of_this_project(monkeypatch):
    asked = []

    class Outside:
        @staticmethod
        def train(*of):
            return SimpleNamespace(curve=((2000, 1.5),), choose=("the policy of", of))

    def measured(choose, uavs, configurations):
        asked.append((choose, uavs, configurations))
        return SimpleNamespace(delays_ms={"delay_ms": 1234.567})

    monkeypatch.setattr(crosscheck, "_outside", lambda: Outside)
    monkeypatch.setattr(crosscheck.collect, "measured", measured)
    monkeypatch.setattr(metadata, "version", lambda name: "1")
    found = crosscheck.train(("ippo", 3, 4000))
    assert asked == [(("the policy of", ("ippo", 3, 4000)), 10, 10_000)]
    assert (found.algorithm, found.seed, found.last) == ("ippo", 3, {"delay_ms": 1234.6})
    assert found.library.startswith("benchmarl 1, ")


def test_without_the_library_no_sample_is_claimed(tmp_path, monkeypatch):
    monkeypatch.setattr(crosscheck, "_missing_package", lambda: "benchmarl")
    with pytest.raises(CannotSampleError, match="benchmarl is not installed"):
        crosscheck.sample(kept(tmp_path / "runs.jsonl", [row()]))
    assert crosscheck.sample(kept(tmp_path / "none.jsonl", [])) == ["the file holds no run"]


def test_a_sample_trains_the_beginning_of_the_first_run_of_each_learner(tmp_path, monkeypatch):
    trained = []

    class Outside:
        @staticmethod
        def train(algorithm, seed, steps, until):
            trained.append((algorithm, seed, steps, until))
            return SimpleNamespace(curve=((2000, 1500.0 if algorithm == "iql" else 1.0),))

    monkeypatch.setattr(crosscheck, "_missing_package", lambda: None)
    monkeypatch.setattr(crosscheck, "_outside", lambda: Outside)
    path = kept(tmp_path / "runs.jsonl", [row(seed=4), row(seed=5), row("masac", 6)])
    assert crosscheck.sample(path) == ["masac, seed 6: (2000, 1500.0), now (2000, 1.0)"]
    assert trained == [("iql", 4, 4000, 2000), ("masac", 6, 4000, 2000)]


def test_the_table_says_never_and_gives_mean_and_range(best_1500_ms, capsys, tmp_path):
    rows = [row(last_ms=1000.0), row(seed=2, curve=((2000, 1200.0), (4000, 1200.0)), last_ms=1100.0)]
    path = kept(tmp_path / "runs.jsonl", rows)
    assert (
        cli.main(
            [
                "atmc",
                "crosscheck",
                "--algorithms",
                "iql",
                "--seeds",
                "1-2",
                "--steps",
                "4000",
                "--out",
                str(path),
            ]
        )
        == 0
    )
    said = " ".join(capsys.readouterr().out.split())
    assert "the best fixed mode has 1,500 ms" in said
    assert re.search(r"IQL 2 4,000, never 1,100 \(1,000 to 1,050 \(1,000 to", said)


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
