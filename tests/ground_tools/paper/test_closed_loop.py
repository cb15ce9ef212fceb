"""The closed loop: statistics by hand, cells that are kept, the command with two encounters."""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.errors import ConfigError
from companion.remote_id.region import Region
from ground_tools import cli
from ground_tools.common.intervals import bootstrap, wilson
from ground_tools.paper.closed_loop import command as closed_loop
from ground_tools.paper.closed_loop.cells import cell as cell_of
from ground_tools.paper.closed_loop.flights import (
    ATMC,
    BEST_SET,
    CONDITIONS,
    METHODS,
    Flight,
    Row,
    rows_of,
    scenario_of,
)
from ground_tools.paper.closed_loop.table import LOST, MEASURES, difference, json_rows, markdown, number
from sitl_mocks.channel.parameters import ChannelParameters
from sitl_mocks.encounters import scenario_file
from tests.companion.atmc.policies import policy_file

ROOT = Path(__file__).parents[3]
US = scenario_file.load_region(ROOT / "config" / "regions" / "us.toml")
BY_KEY = {measure.key: measure for measure in MEASURES}


def flight(condition="sparse", method="wifi", seeds=(1,), policy=None, channel=None):
    return Flight(condition, method, seeds, US, channel or ChannelParameters(), policy)


def row(encounter, separation=20.0, age=0.5, run=None, **changes):
    made = Row(
        encounter=encounter, run=encounter if run is None else run, aircraft=2,
        least_separation_m=separation, pairs_lost=int(separation < 10.0), deviation_m=5.0,
        age_mean_s=age, age_p95_s=1.0, age_max_s=2.0, unheard=0, switches_per_minute=0.0,
        seconds={"wifi 10": 30.0},
    )  # fmt: skip
    return msgspec.structs.replace(made, **changes)


# ---------------------------------------------------------------- statistics


def test_wilson_against_published_values():
    """Newcombe (1998), table I: 81 of 263, 15 of 148, 0 of 20, 1 of 29."""
    for hits, count, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ):
        assert wilson(hits, count) == pytest.approx((low, high), abs=5e-5)
    assert wilson(0, 0) == (0.0, 1.0)
    assert wilson(20, 20) == pytest.approx((1.0 - 0.1611, 1.0), abs=5e-5)


def test_bootstrap_of_a_mean_and_of_what_belongs_together():
    rng = np.random.default_rng(2)
    values = rng.normal(5.0, 1.0, 400)
    mean = lambda v: v.mean(axis=-1)  # noqa: E731
    low, high = bootstrap([np.array([v]) for v in values], mean)
    assert (low, high) == pytest.approx((values.mean() - 0.098, values.mean() + 0.098), abs=0.02)
    # Twenty airs of twenty encounters each that share their luck say as much as twenty values.
    airs = [np.full(20, v) for v in values[:20]]
    low, high = bootstrap(airs, mean)
    assert 0.5 < high - low < 1.3
    assert bootstrap([values], mean) is None
    ragged = bootstrap([*airs[:-1], airs[-1][:7]], mean)
    assert ragged == pytest.approx((low, high), abs=0.15)
    assert bootstrap([np.array([3.0])] * 5, mean) == (3.0, 3.0)


def test_numbers_of_a_cell_by_hand():
    rows = [row(n, separation=5.0 if n == 0 else 10.0 + n, age=0.1 * n) for n in range(11)]
    assert number(rows, BY_KEY["age_mean_s"]).value == pytest.approx(0.5)
    assert number(rows, BY_KEY["separation_m"]).value == pytest.approx((5.0 + 155.0) / 11)
    assert number(rows, BY_KEY["separation_p5_m"]).value == pytest.approx(8.0)
    lost = number(rows, LOST)
    assert lost.value == pytest.approx(1 / 11)
    assert lost.interval == pytest.approx(wilson(1, 11))
    assert lost.words(1, 100.0) == "9.1 (1.6 to 37.7)"
    assert number([row(1, age=None)], BY_KEY["age_mean_s"]).value is None
    # Twelve encounters share each of two airs. No loss at all leaves open what two runs leave open.
    shared = [row(n, run=n // 12, separation=20.0) for n in range(24)]
    assert number(shared, LOST).interval == pytest.approx(wilson(0, 2))
    assert difference(shared, shared, LOST).interval == pytest.approx((-wilson(0, 2)[1], wilson(0, 2)[1]))
    one_air = [row(n, run=0) for n in range(3)]
    assert number(one_air, BY_KEY["age_mean_s"]).interval is None


def test_differences_are_taken_encounter_by_encounter():
    first = [row(1, age=0.4), row(2, age=1.4), row(3, age=9.0)]
    second = [row(2, age=1.5), row(1, age=0.5), row(4, age=99.0)]
    found = difference(first, second, BY_KEY["age_mean_s"])
    assert found.value == pytest.approx(-0.1)
    assert found.interval == pytest.approx((-0.1, -0.1))
    assert difference(first, [], BY_KEY["age_mean_s"]).value is None


def test_tables_for_documents_and_machines():
    cells = {("sparse", BEST_SET): [row(1), row(2)], ("sparse", ATMC): [row(1, age=0.3), row(2, age=0.4)]}
    text = markdown(cells)
    assert "| sparse | ATMC | 2 | 0.350 (0.300 to 0.400) |" in text
    assert "| sparse | -0.150 (-0.200 to -0.100) |" in text
    assert len({line.count("|") for line in text.splitlines() if line.startswith("| sparse | A")}) == 1
    cell, _, gap = json_rows(cells)
    assert (cell["kind"], cell["encounters"], cell["runs"]) == ("cell", 2, 2)
    assert gap["methods"] == [ATMC, BEST_SET]
    assert gap["age_mean_s"]["value"] == pytest.approx(-0.15)
    json.dumps(json_rows(cells), allow_nan=False)


# ---------------------------------------------------------------- flights


@pytest.mark.parametrize("method", METHODS)
def test_all_methods_fly_the_same_encounters(method):
    ours, groups = scenario_of(flight("dense", method, (5, 6)))
    theirs, others = scenario_of(flight("dense", "wifi", (5, 6)))
    assert ours.path == theirs.path
    assert groups == others
    assert ours.region == (US if METHODS[method].policy and not method.startswith("paper") else Region())
    alone, (group,) = scenario_of(flight("sparse", method, (5,)))
    assert alone.path == ours.path[: len(group)]


@pytest.mark.parametrize("method", ["paper-madqn", "paper-madqn-shared", "paper-set"])
def test_the_papers_policies_choose_among_their_single_modes(method):
    args = argparse.Namespace(
        region=ROOT / "config" / "regions" / "us.toml", seed=1, encounters=1, crowd=12, policy=None
    )
    (ours,) = closed_loop.flights_of(args, "sparse", method)
    (flown,) = rows_of(ours)
    assert flown.fallback_share == 0.0
    first, *later = flown.seconds
    assert first == "ble4 10 + wifi 10"
    assert later
    assert not any("+" in name for name in later)
    assert flown.seconds[first] <= flown.aircraft * 3.0


def test_load_is_a_matter_of_the_condition():
    assert scenario_of(flight("loaded"))[0].channel.background.wifi == 0.6
    assert scenario_of(flight("sparse"))[0].channel.background.wifi == 0.0


def test_one_encounter_is_the_same_twice_and_is_lost_without_avoidance():
    (first,), (again,) = rows_of(flight(seeds=(3,))), rows_of(flight(seeds=(3,)))
    assert first == again
    assert first.least_separation_m > 10.0
    assert 0.1 < first.age_mean_s < first.age_p95_s <= first.age_max_s < 5.0
    assert first.switches_per_minute == 0.0
    (unavoided,) = rows_of(flight(method="unavoided", seeds=(3,)))
    assert unavoided.least_separation_m < 10.0
    assert unavoided.pairs_lost >= 1
    assert unavoided.age_mean_s is None


# ---------------------------------------------------------------- cells


def test_a_cell_is_read_again_and_refuses_other_settings(tmp_path):
    cell = cell_of(tmp_path, flight(), 1)
    cell.add([row(1), row(2)])
    again = cell_of(tmp_path, flight(seeds=(9,)), 1)
    assert again.rows == {1: row(1), 2: row(2)}
    other = ChannelParameters(wifi_channels="random")
    with pytest.raises(ConfigError, match=r"sparse-wifi.jsonl was made with other settings \(channel: "):
        cell_of(tmp_path, flight(channel=other), 1)
    with pytest.raises(ConfigError, match=r"crowd: 1, now 3"):
        cell_of(tmp_path, flight(), 3)


def test_rows_of_other_software_are_read_but_not_mixed_with_new_ones(tmp_path):
    cell = cell_of(tmp_path, flight(), 1)
    cell.add([row(1)])
    text = cell.path.read_text()
    assert '"software": "' in text
    other = text.replace('"software": "', '"software": "0')
    cell.path.write_text(other)
    old = cell_of(tmp_path, flight(), 1)
    assert old.rows == {1: row(1)}
    with pytest.raises(ConfigError, match="made by other software, and are not mixed"):
        old.add([row(2)])
    assert cell.path.read_text() == other


def test_another_policy_is_another_cell(tmp_path):
    cell_of(tmp_path, flight(method=ATMC, policy=b"one"), 1).add([row(1)])
    with pytest.raises(ConfigError, match="policy: "):
        cell_of(tmp_path, flight(method=ATMC, policy=b"two"), 1)


def test_a_torn_line_is_flown_again(tmp_path):
    cell = cell_of(tmp_path, flight(), 1)
    cell.add([row(1), row(2)])
    cell.path.write_text(cell.path.read_text()[:-20])
    torn = cell_of(tmp_path, flight(), 1)
    assert set(torn.rows) == {1}
    torn.add([row(2)])
    assert set(cell_of(tmp_path, flight(), 1).rows) == {1, 2}


def test_seeds_of_runs():
    assert closed_loop.seeds_of(0, 3, 1) == [(0,), (1,), (2,)]
    assert closed_loop.seeds_of(1, 3, 2) == [(100_000, 100_001), (100_002, 100_003)]


# ---------------------------------------------------------------- the command


def command(*words):
    return cli.main(["paper", "closed-loop", *map(str, words)])


def test_two_encounters_from_end_to_end(tmp_path, capsys, monkeypatch):
    pytest.importorskip("matplotlib")
    policy = tmp_path / "p.safetensors"
    policy.write_bytes(policy_file())
    words = ["--encounters", 2, "--conditions", "sparse", "--processes", 1, "--out", tmp_path, "--json"]
    assert command(*words, "--methods", "best-set", "atmc", "--policy", policy) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(r["kind"], r.get("method")) for r in lines] == [
        ("cell", "best-set"), ("cell", "atmc"), ("difference", None),
    ]  # fmt: skip
    assert all(r["encounters"] == 2 for r in lines[:2])
    assert lines[0]["sets"] == "ble4 10 + wifi 10: 100 %"
    assert lines[0]["sets"] != lines[1]["sets"]
    assert (tmp_path / "closed-loop.png").read_bytes().startswith(b"\x89PNG")
    assert "| sparse | ATMC | 2 |" in (tmp_path / "closed-loop" / "table.md").read_text()
    # A second time nothing is flown, and the numbers need no matplotlib.
    monkeypatch.setattr(closed_loop, "_fly", None)
    (tmp_path / "closed-loop.png").unlink()
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert command(*words[:-1], "--methods", "best-set", "atmc", "--policy", policy) == 0
    told = capsys.readouterr().out
    assert "least separation" in told  # a heading that 80 columns would break
    assert "ATMC minus best legal set" in told
    assert "no picture: matplotlib is not installed" in told
    assert not (tmp_path / "closed-loop.png").exists()


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--encounters", "0"], "--encounters: 0 is out of range; allowed: 1 to"),
        (["--crowd", "33"], "--crowd: 33 is out of range; allowed: 1 to 32"),
        (["--processes", "0"], "--processes: 0 is out of range; allowed: 1 to"),
        (["--seed", "-1"], "--seed: -1 is out of range; allowed: 0 to 4294967295"),
        (["--policy", "/nowhere.safetensors"], "--policy: atmc.policy: /nowhere.safetensors: cannot be read"),
        (["--region", "/nowhere.toml"], "/nowhere.toml: cannot be read"),
    ],
)
def test_wrong_options_are_one_line(tmp_path, capsys, words, what):
    assert command("--out", tmp_path, *words) == 2
    told = capsys.readouterr().err
    assert what in told
    assert told.count("\n") == 1


def test_ctrl_c_leaves_what_is_complete(tmp_path):
    words = ["paper", "closed-loop", "--encounters", "400", "--methods", "unavoided", "--out", str(tmp_path)]
    words += ["--conditions", "sparse", "--processes", "1"]
    process = subprocess.Popen([sys.executable, "-m", "ground_tools.cli", *words], stdout=subprocess.PIPE)
    file = tmp_path / "closed-loop" / "sparse-unavoided.jsonl"
    try:
        while process.poll() is None and (not file.exists() or file.read_text().count("\n") < 3):
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        told, _ = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode not in (0, 2)
    assert b"Interrupted" in told
    cell = cell_of(tmp_path / "closed-loop", _as_flown(), 1)
    assert 2 <= len(cell.rows) < 400


def _as_flown():
    from sitl_mocks.channel import parameters

    path = Path(__file__).parents[3] / "config" / "channel" / "standard.toml"
    return flight(method="unavoided", channel=parameters.load(path))


# ---------------------------------------------------------------- what ships


@pytest.fixture(scope="module")
def kept():
    """The cells in config, at the defaults of the command; fails where they are not of what ships now."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=1)
    closed_loop.add_arguments(parser)
    args = parser.parse_args([])
    cells, missing = closed_loop.plan(args, ROOT / "results" / "atmc" / closed_loop.NAME)
    assert not missing
    return closed_loop._shown(args, cells)


def test_what_ships_was_flown_two_hundred_times_under_each_condition(kept):
    assert {key: len(rows) for key, rows in kept.items()} == {
        (condition, method): 200 for condition in CONDITIONS for method in METHODS
    }


def test_the_document_says_what_was_flown(kept):
    text = (ROOT / "docs" / "atmc-results.md").read_text()
    for method in METHODS:
        cells = [kept[condition, method] for condition in CONDITIONS]
        ages = [number(rows, BY_KEY["age_mean_s"]) for rows in cells]
        lost = " / ".join(str(sum(r.least_separation_m < 10.0 for r in rows)) for rows in cells)
        words = ["" if age.value is None else f" {age.words(3)}" for age in ages]
        assert f"{' |'.join(words)} | {lost} |" in text.replace("**", "")
    for condition in CONDITIONS:
        found = difference(kept[condition, ATMC], kept[condition, BEST_SET], BY_KEY["age_mean_s"])
        assert found.words(0, 1e3) in text
