"""`ground-tools paper`: the model's own numbers against the published ones, and the command line."""

from __future__ import annotations

import csv
import html
import json
import math
import sys

import pytest

from companion.remote_id.transports import BLE4, WIFI_BEACON
from ground_tools import cli
from ground_tools.channel.fixed_modes import Settings, evaluate
from ground_tools.paper.command import FIGURES
from ground_tools.paper.figures import delay_rate, fixed_modes, packet_loss
from ground_tools.paper.study import SIDES_M, Study, curves_of
from sitl_mocks.channel.parameters import ChannelParameters

DRAWINGS = ["framework", "radio-modes"]
NAMES = [
    "delay-rate",
    "packet-loss",
    "fixed-modes",
    "readings",
    "convergence",
    "system-delay",
    "uav-delay",
    "decision-time",
    "dmuca",
]


@pytest.fixture(scope="module")
def study():
    return Study(samples=300, seed=1)


@pytest.mark.parametrize(
    ("mode", "rate", "samples", "published"), [(BLE4, 9, 60_000, 2), (WIFI_BEACON, 10, 1000, 3)]
)
def test_published_delays_of_the_fixed_modes(mode, rate, samples, published):
    """All five within 5 %, with Wi-Fi on one channel and without shadowing. Few aircraft reach each other by
    BLE 4 in large sizes, so that its means need more environments."""
    settings = Settings(ChannelParameters(), SIDES_M, {mode: (rate,)}, (0.0,), 10, samples, 1)
    rows = [row for side in evaluate(settings) for row in side if row.wifi_channels == "shared"]
    found = [c for c in fixed_modes.comparisons(rows) if c.published_ms is not None]
    assert len(found) == published
    for c in found:
        assert c.error_ms < 0.01 * c.published_ms
        assert abs(c.ours_ms - c.published_ms) <= 0.05 * c.published_ms, c


def test_published_statements_that_do_not_hold_are_the_known_ones(study):
    """Lists the paper's statements that do not hold, so that a change of the model does not go unnoticed."""
    found = delay_rate.statements(study.rows(0.0)) + packet_loss.statements(study.rows(0.0))
    assert {s.published for s in found if not s.holds} == {
        *(f"Wi-Fi {r} jumps at rate {n}" for r in ("shared", "random") for n in (4, 7)),
        *(f"Wi-Fi {r} jumps at no other rate" for r in ("shared", "random")),
        "BLE 5 falls at every rate",
    }
    assert len(found) == 32


def test_best_rates_come_from_the_numbers(study):
    best = {name: curve.best_rate(SIDES_M) for name, curve in curves_of(study.rows(0.0)).items()}
    assert best == {"BLE 4": 9, "BLE 5": 10, "Wi-Fi shared": 10, "Wi-Fi random": 10}


def test_a_study_computes_each_sigma_once():
    calls = []
    study = Study(2, 1, lambda: calls.append(1))
    assert study.rows(0.0) is study.rows(0.0)
    assert len(calls) == study.steps()
    assert {row.sigma_db for row in study.rows(math.sqrt(6.0))} == {math.sqrt(6.0)}


def test_all_figures_as_json(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    out = tmp_path / "new" / "paper"
    assert cli.main(["paper", "all", "--samples", "3", "--json", "--out", str(out)]) == 0
    text = capsys.readouterr().out
    rows = [json.loads(line) for line in text.splitlines()]
    assert list(dict.fromkeys(row["figure"] for row in rows)) == NAMES
    assert [*DRAWINGS, *NAMES] == [f.name for f in FIGURES]
    numbers = [row for row in rows if row["kind"] == "number" and row["figure"] == "fixed-modes"]
    assert len(numbers) == 2 * 4 * 3
    assert {round(row["sigma_db"], 3) for row in numbers} == {0.0, 2.449}
    for name in [*DRAWINGS, *NAMES]:
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    check_page(out, rows)


def check_page(out, rows):
    """Both pages show each picture, statement and command once; the CSV files hold every number."""
    statements = [row for row in rows if row["kind"] == "statement"]
    for text in ((out / "index.md").read_text(), html.unescape((out / "index.html").read_text())):
        for name in [*DRAWINGS, *NAMES]:
            assert text.count(f"{name}.png") == 1
            assert text.count(f"ground-tools paper {name} --samples 3 --seed 1") == 1
        for row in statements:
            assert row["published"].replace("|", "\\|") in text or row["published"] in text
        held = sum(row["holds"] for row in statements)
        assert f"{held} of {len(statements)} statements hold" in text
    assert {path.stem for path in out.glob("*.csv")} == set(NAMES)
    for name in NAMES:
        with (out / f"{name}.csv").open() as file:
            found = list(csv.DictReader(file))
        wanted = [row for row in rows if row["figure"] == name]
        assert [row["kind"] for row in found] == [row["kind"] for row in wanted]
        numbers = [(f["ours_ms"], w["ours_ms"]) for f, w in zip(found, wanted, strict=True) if "ours_ms" in w]
        assert all(float(f or "nan") == w or w is None for f, w in numbers)


def test_statements_that_fail_are_no_error(tmp_path, capsys, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.setenv("COLUMNS", "80")
    assert cli.main(["paper", "delay-rate", "--samples", "3", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    lines = [line for line in out.splitlines() if "jumps at rate 7" in line]
    assert len(lines) == 2
    assert all("does not hold" in line for line in lines)
    assert "delay(r) > delay(r - 1)" in out
    assert [path.name for path in tmp_path.iterdir()] == ["delay-rate.png"]


def test_convergence_computes_no_environments(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    # A hundred thousand environments would take minutes.
    assert cli.main(["paper", "convergence", "--samples", "100000", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "MADQN-ATMC converges within" in out
    assert "1050.46" in out


def test_fixed_modes_for_people(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    assert cli.main(["paper", "fixed-modes", "--samples", "3", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    high = next(line for line in out.splitlines() if "Wi-Fi shared" in line and "high" in line)
    assert high.split() == ["Wi-Fi", "shared", "10", "0", "high", "1865.07", "1900", "±0.0", "1.019"]


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--samples", "1"], "--samples: 1 is out of range; allowed: 2 to 100000"),
        (["--seed", "-2"], "--seed: -2 is out of range; allowed: 0 to 4294967295"),
    ],
)
def test_wrong_options(tmp_path, capsys, words, what):
    assert cli.main(["paper", "all", "--out", str(tmp_path), *words]) == 2
    assert what in capsys.readouterr().err


def test_an_unknown_figure():
    with pytest.raises(SystemExit) as stop:
        cli.main(["paper", "figure-99"])
    assert stop.value.code == 2


def test_no_folder_and_no_matplotlib(tmp_path, capsys, monkeypatch):
    (tmp_path / "file").write_text("")
    assert cli.main(["paper", "all", "--out", str(tmp_path / "file")]) == 2
    assert "--out: " in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    # Refused at once: a hundred thousand environments would take minutes.
    assert cli.main(["paper", "all", "--samples", "100000", "--out", str(tmp_path / "new")]) == 2
    assert ".[inspect]" in capsys.readouterr().err


def test_the_numbers_of_one_figure_need_no_matplotlib(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert cli.main(["paper", "delay-rate", "--samples", "3", "--json", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr()
    assert {json.loads(line)["figure"] for line in printed.out.splitlines()} == {"delay-rate"}
    assert "no picture: matplotlib is not installed" in printed.err
    assert list(tmp_path.iterdir()) == []
    assert cli.main(["paper", "framework", "--out", str(tmp_path)]) == 2
    assert "matplotlib is not installed" in capsys.readouterr().err
