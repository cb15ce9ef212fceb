"""The figure of training: numbers from made-up runs and from the kept results."""

from __future__ import annotations

import numpy as np
import pytest

from companion.errors import ConfigError
from ground_tools.atmc.commands.results import CONVERGENCE, Results, Run, read, write
from ground_tools.paper.figures import convergence
from ground_tools.paper.figures.convergence import (
    binned,
    comparisons,
    converged_at,
    failures,
    statements,
)
from ground_tools.paper.seed_means import interquartile_mean


def run(
    algorithm: str, seed: int, *, learned_by: int = 400, failed: int = 0, delay_ms: float = 1000.0
) -> Run:
    """A run whose rewards rise from -10 to -1 and stay there."""
    fleet = np.clip(np.linspace(-10.0, -10.0 + 9.0 * 1000 / learned_by, 1000), -10.0, -1.0)
    uavs = [np.clip(np.linspace(-1.0, 2.0, 100), -1.0, -1.0 if n < failed else -0.1) for n in range(10)]
    found = {"delay_ms": delay_ms, "high_ms": 2.0 * delay_ms, "low_ms": 0.0}
    return Run(
        algorithm=algorithm,
        seed=seed,
        git_commit=None,
        settings={},
        seconds=60.0,
        reward=tuple(fleet.tolist()),
        delay_ms=tuple((-1000.0 * fleet).tolist()),
        reward_uav=tuple(tuple(curve.tolist()) for curve in uavs),
        validation=((10, 2.0 * delay_ms), (1000, delay_ms)),
        best=dict(found),
        last=found,
    )


@pytest.fixture
def results():
    return Results(
        configurations=100,
        runs=(
            *(
                run("madqn", seed, delay_ms=ms)
                for seed, ms in enumerate((1000.0, 1010.0, 1020.0, 1030.0, 2000.0))
            ),
            run("maddpg", 1, learned_by=900, failed=2, delay_ms=1300.0),
            run("iac", 1, delay_ms=1500.0),
        ),
    )


def test_interquartile_mean_leaves_out_a_quarter_at_either_end():
    assert interquartile_mean(np.array([[1.0], [2.0], [3.0], [4.0], [100.0]])) == pytest.approx(3.0)
    assert interquartile_mean(np.array([[1.0], [3.0]])) == pytest.approx(2.0)


def test_numbers_of_a_run():
    assert converged_at(run("madqn", 1)) == pytest.approx(360, abs=20)
    assert [failures(run("madqn", 1, failed=n)) for n in (0, 2, 4)] == [0, 2, 4]
    assert binned(range(25)).tolist() == [4.5, 14.5]


def test_statements_are_checked_for_each_seed(results):
    found = {s.published: s for s in statements(results)}
    assert found["MADQN-ATMC converges within 500 episodes"].holds
    assert len(found["MADQN-ATMC converges within 500 episodes"].checks) == 5
    assert not found["MADDPG converges within 800 episodes"].holds
    assert found["MADDPG: two aircraft fail"].holds
    assert not found["IAC: most aircraft fail"].holds


@pytest.mark.parametrize(("delay_ms", "holds"), [(1090.0, False), (1110.0, True)])
def test_iac_is_compared_with_the_worst_seed_of_madqn(delay_ms, holds):
    words = "IAC does not converge to what MADQN-ATMC reaches"
    runs = [
        run("madqn", 1, delay_ms=900.0),
        run("madqn", 2, delay_ms=1000.0),
        run("iac", 1, delay_ms=delay_ms),
    ]
    (found,) = (s for s in statements(Results(configurations=100, runs=tuple(runs))) if s.published == words)
    assert found.holds == holds
    alone = statements(Results(configurations=100, runs=(runs[2],)))
    assert words not in {s.published for s in alone}


def test_delays_are_listed_with_the_published_ones(results):
    for run in results.runs:
        run.best.update({key: 0.9 * value for key, value in run.last.items()})
    found = {(c.labels["mode"], c.labels["networks"], c.labels["density"]): c for c in comparisons(results)}
    madqn = found["madqn", "last", "dynamic"]
    assert madqn.ours_ms == pytest.approx(1020.0)
    assert madqn.published_ms == 1050.46
    assert madqn.error_ms > 0.0
    best = found["madqn", "best", "dynamic"]
    assert best.ours_ms == pytest.approx(918.0)
    assert best.published_ms is None
    assert found["iac", "last", "low"].published_ms is None


def test_a_written_file_is_read_back_unchanged(results, tmp_path):
    path = tmp_path / "new" / "results.json.gz"
    write(path, results)
    assert read(path) == results
    data = path.read_bytes()
    write(path, results)
    assert path.read_bytes() == data


def test_files_of_another_kind_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        read(tmp_path / "none")
    (tmp_path / "other").write_bytes(b"{}")
    with pytest.raises(ConfigError, match="cannot be read"):
        read(tmp_path / "other")


def test_picture(results, tmp_path):
    pytest.importorskip("matplotlib")
    write(tmp_path / "results", results)
    convergence.draw(tmp_path / "figure.png", tmp_path / "results")
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.skipif(not CONVERGENCE.exists(), reason="the results are not here")
def test_the_document_says_what_the_last_networks_reach():
    found = read()
    assert CONVERGENCE.stat().st_size < 300_000
    text = (CONVERGENCE.parents[2] / "docs" / "atmc-baselines.md").read_text()
    for algorithm in ("madqn", "madqn-shared", "maddpg", "iac"):
        last = [run.last["delay_ms"] for run in found.of(algorithm)]
        assert len(last) == 5
        rows = [line.split("|") for line in text.splitlines() if line.startswith("| ")]
        assert f"{sum(last) / 5.0:.0f}" in {row[-3].strip() for row in rows if row[1].startswith(" mean of")}
    assert convergence.report().comparisons
