"""Delays of all methods and times of decisions: made-up numbers, small measurements, and the command line."""

from __future__ import annotations

import json
import math

import pytest

from companion.atmc.actions import PAPER_ACTIONS
from companion.atmc.choice import Refused
from companion.atmc.policy import Policy, encode
from companion.errors import ConfigError
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from ground_tools import cli
from ground_tools.atmc.commands.results import Results, Run, write
from ground_tools.paper import methods
from ground_tools.paper.delays import DENSITIES, SET, Delays
from ground_tools.paper.figures import decision_time, system_delay, uav_delay
from ground_tools.paper.figures.decision_time import Timing
from tests.companion.atmc.policies import metadata, policy_file, tensors, with_golden


def run(algorithm, seed=1, delay_ms=1000.0, uav_ms=(100.0,) * 10):
    last = {"delay_ms": delay_ms, "high_ms": 1.8 * delay_ms, "low_ms": 0.2 * delay_ms}
    best = {key: 0.9 * value for key, value in last.items()}
    return Run(
        algorithm=algorithm, seed=seed, git_commit=None, settings={}, seconds=1.0, reward=(), delay_ms=(),
        reward_uav=(), validation=((10, delay_ms),), best=best, last=last, best_delay_uav_ms=tuple(uav_ms),
    )  # fmt: skip


def results(*runs):
    return Results(configurations=100, runs=runs)


def delays(key, high, low, dynamic):
    system = dict(zip(DENSITIES, ((high, 1.0), (low, 1.0), (dynamic, 1.0)), strict=True))
    return Delays(key, key.upper(), 10, system, (dynamic / 10.0,) * 10)


FIXED = (
    delays(BLE4, 2800.0, 232.0, 1545.0),
    delays(BLE5, 5700.0, 2200.0, 4000.0),
    delays(WIFI_BEACON, 1865.0, 1488.0, 1672.0),
    delays("random", 12000.0, 6000.0, 9000.0),
)


@pytest.fixture
def paper_set(tmp_path):
    """A set policy for the paper's objective, with random weights."""
    meta = metadata(objective="paper", actions=PAPER_ACTIONS)
    parts = tensors(meta)
    path = tmp_path / "policies" / "paper-set.safetensors"
    path.parent.mkdir()
    path.write_bytes(encode(with_golden(meta, parts), parts))
    return path


@pytest.fixture
def only_made_up(monkeypatch):
    """Replace measurements by made-up numbers."""
    for module in (system_delay, uav_delay):
        monkeypatch.setattr(module, "measured", lambda *_: FIXED)


# ------------------------------------------------------------ learners


def test_one_seed_has_no_interval_and_several_have_one():
    one = methods.learner(results(run("madqn")), "madqn")
    assert (one.system["dynamic"], one.interval) == (1000.0, {})
    assert math.isnan(one.error["dynamic"])
    assert "one seed" in one.words
    some = [run("madqn", seed, 1000.0 + ms) for seed, ms in enumerate((0.0, 10.0, 20.0, 30.0, 900.0))]
    five = methods.learner(results(*some), "madqn")
    assert five.system["dynamic"] == pytest.approx(1020.0)
    low, high = five.interval["dynamic"]
    assert 1000.0 <= low < 1020.0 < high <= 1900.0
    assert five.words.startswith("MADQN-ATMC: 5 seeds")
    assert five.best["dynamic"] == pytest.approx(918.0)
    assert five.words.endswith("918 ms with the best validation")
    assert methods.learner(results(), "madqn") is None


def test_without_torch_nothing_is_measured(monkeypatch):
    monkeypatch.setattr(methods, "has_torch", lambda: False)
    assert methods.measured.__wrapped__(10, 1) == ()
    assert "torch is not installed" in methods.not_measured(())[0]


def test_measuring_takes_one_thread(paper_set):
    """With two threads, each waits for the other if the cores are busy, which takes minutes instead of
    seconds."""
    torch = pytest.importorskip("torch")
    torch.set_num_threads(2)
    assert methods.measured.__wrapped__(2, 1, paper_set)
    assert torch.get_num_threads() == 1


# ------------------------------------------------------------ statements


def of_system(*runs):
    learners = system_delay._learners(results(*runs))
    return {s.published: s for s in system_delay.statements(system_delay.table_of(learners, FIXED))}


def test_system_delays_as_published_hold_but_for_the_lowest_at_low_density():
    """At low density, the paper's own number for BLE 4 is lower."""
    runs = [run("madqn", 1, 1036.0), run("maddpg", 1, 1302.0), run("iac", 1, 1400.0)]
    runs[0].last.update(low_ms=246.8)
    found = of_system(*runs)
    assert len(found) == 10
    assert [s.published for s in found.values() if not s.holds] == [
        "MADQN-ATMC has the lowest delay at low density"
    ]


def test_absent_methods_are_not_judged():
    found = of_system(run("madqn", 1, 1300.0))
    assert not any("MADDPG" in words for words in found)
    assert found["MADQN-ATMC, dynamic: at least 32 % below the best fixed mode"].verdict == "does not hold"
    assert system_delay.statements({}) == []
    assert "MADDPG: no run is stored, so it is not shown" in methods.absent(results(run("madqn")))


def test_delays_of_aircraft():
    behind = (100.0,) * 4 + (200.0, 210.0) + (100.0,) * 4
    few = (300.0, 110.0, 300.0, 120.0) + (300.0,) * 6
    runs = (run("madqn"), run("maddpg", uav_ms=behind), run("iac", uav_ms=few))
    found = uav_delay.statements(results(*runs), FIXED)
    assert len(found) == 5
    assert all(s.holds for s in found), found
    swapped = (run("maddpg", uav_ms=(*behind[1:], 100.0)), run("iac", uav_ms=(100.0,) * 10))
    verdicts = {s.published: s.verdict for s in uav_delay.statements(results(*swapped), FIXED)}
    assert verdicts == {
        "MADDPG: UAVs 5 and 6 approximately 200 ms": "holds at 1 of 2",
        "MADDPG: any two UAVs are far behind": "holds",
        "IAC: only UAVs 2 and 4 are below the fixed protocols": "does not hold",
    }


def test_times():
    found = decision_time.statements([Timing("a", 9, 0.1, 4.0, 0.2), Timing("b", 9, 0.1, 1.0, 0.2)])
    assert [s.verdict for s in found] == ["holds", "holds at 1 of 2", "holds"]
    assert decision_time.statements([]) == []


# ------------------------------------------------------------ what is measured


def test_measured_in_the_same_places(paper_set):
    pytest.importorskip("torch")
    found = {m.key: m for m in methods.measured(4, 1, paper_set)}
    assert list(found) == [BLE4, BLE5, WIFI_BEACON, SET, "random", "rule", "search"]
    for method in found.values():
        ms = {density: value for density, (value, _) in method.system.items()}
        assert ms["dynamic"] == pytest.approx((ms["high"] + ms["low"]) / 2.0)
        assert sum(method.uav_ms) == pytest.approx(ms["dynamic"])
        assert found["search"].system["dynamic"][0] <= ms["dynamic"] + 1e-3
    assert found[WIFI_BEACON].system["high"][0] == pytest.approx(1900.0, abs=1.0)
    assert found["rule"].system["dynamic"][0] < found[BLE4].system["dynamic"][0]


def test_a_policy_for_something_else(tmp_path):
    pytest.importorskip("torch")
    path = tmp_path / "other.safetensors"
    path.write_bytes(policy_file("flat"))
    with pytest.raises(ConfigError, match="not a set policy for 10 aircraft"):
        methods.measured(4, 1, path)


def test_decisions_of_all_files_of_a_folder(paper_set):
    (paper_set.parent / "flat.safetensors").write_bytes(policy_file("flat"))
    found = decision_time.timed(5, 1, paper_set.parent)
    assert [t.name for t in found.timings] == [
        "flat, 9 neighbours",
        "paper-set, 9 neighbours",
        "paper-set, 50 neighbours",
    ]
    assert len(found.notes) == 1
    assert "switches" in found.notes[0]


def test_refused_decisions_are_not_timed():
    meta = metadata(neighbours=20)
    parts = tensors(meta, widths=(8, 16))
    policy = Policy(with_golden(meta, parts), parts, "few")
    assert isinstance(decision_time.times_ms(policy, 50, 3), Refused)
    assert len(decision_time.times_ms(policy, 9, 3)) == 3


# ------------------------------------------------------------ command line and pictures


@pytest.mark.parametrize("name", ["system-delay", "uav-delay"])
@pytest.mark.usefixtures("only_made_up")
def test_one_command(tmp_path, capsys, name):
    pytest.importorskip("matplotlib")
    assert cli.main(["paper", name, "--samples", "3", "--json", "--out", str(tmp_path)]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {row["figure"] for row in rows} == {name}
    assert {row["kind"] for row in rows} == {"statement", "number"}
    assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_decision_time_for_people(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    assert cli.main(["paper", "decision-time", "--samples", "3", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "3.84" in out
    assert (tmp_path / "decision-time.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.usefixtures("only_made_up")
def test_pictures_of_few_and_of_several_seeds(tmp_path):
    pytest.importorskip("matplotlib")
    source = tmp_path / "results"
    write(source, results(run("madqn", 1), run("madqn", 2, 1100.0), run("iac", uav_ms=())))
    system_delay.draw(3, 1, tmp_path / "a.png", source)
    uav_delay.draw(3, 1, tmp_path / "b.png", source)
    assert all((tmp_path / f"{name}.png").stat().st_size > 10_000 for name in "ab")
    rows = system_delay.report(3, 1, source).comparisons
    madqn, best = (c for c in rows if c.labels["mode"] == "madqn" and c.labels["density"] == "dynamic")
    assert best.name == "MADQN-ATMC, best"
    assert best.published_ms is None
    assert best.ours_ms == pytest.approx(0.9 * madqn.ours_ms)
    assert madqn.labels["low_ms"] <= madqn.ours_ms <= madqn.labels["high_ms"]
    assert madqn.published_ms == 1050.46
    assert "IAC: no run is stored" in " ".join(uav_delay.report(3, 1, source).notes)


def test_without_a_policy_nothing_is_timed_and_no_picture_is_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    picture = tmp_path / "decision-time.png"
    with pytest.raises(ConfigError, match="there is no policy file"):
        decision_time.draw(5, 1, picture, tmp_path)
    assert not picture.exists()
