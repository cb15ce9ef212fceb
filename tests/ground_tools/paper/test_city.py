"""The figure over density: grid, intervals, verdicts on made-up rows, picture and command."""

from __future__ import annotations

import csv
import json
import math
import sys
from pathlib import Path

import msgspec
import pytest

from companion.errors import ConfigError
from ground_tools import cli
from ground_tools.city.cells import City
from ground_tools.common import provenance
from ground_tools.common.figure import styled
from ground_tools.paper.city import capacity, picture, runs, table
from ground_tools.paper.city.grid import METHODS, Cell, Grid, cost_s, inside
from ground_tools.paper.city.numbers import LOSSES, MEASURES, estimate
from ground_tools.paper.city.verdict import sentences, verdicts
from tests.ground_tools.paper.made_city import SILENT, row, three

ROOT = Path(__file__).parents[3]
KEPT = ROOT / "results" / "city-paper" / runs.FILE
BY_KEY = {measure.key: measure for measure in MEASURES}


def cells(*by_density, load=0.0):
    """Cells of made-up rows: for each density the losses per run of perfect information, nobody and
    policy."""
    found = {}
    for density, perfect, nobody, policy in by_density:
        found[Cell(load, density, "policy")] = three(policy)
        found[Cell(load, density, "perfect")] = three(perfect, **SILENT)
        found[Cell(load, density, "none")] = three(nobody, **SILENT)
    return found


# ---------------------------------------------------------------- the grid


def test_the_area_follows_from_the_number_of_aircraft():
    grid = Grid()
    assert [grid.side_m(d) for d in grid.densities] == [20_000, 11_550, 6320, 3650, 2000]
    for density in grid.densities:
        assert grid.city(Cell(0.0, density, "rule")).demand.aircraft == pytest.approx(400, rel=0.01)
    assert Grid(aircraft=20).side_m(100.0) == 2000.0
    assert Grid(aircraft=20_000).side_m(1.0) == 20_000.0


def test_methods_without_radio_fly_once_for_all_loads():
    grid = Grid(densities=(10.0,), seeds=range(1, 3))
    assert len(list(grid.cells())) == 26
    works = runs.missing(grid, {})
    assert len(works) == 2 * (2 * 10 + 3)
    assert len({(work.city.name, work.seed) for work in works}) == len(works)
    assert [work.cost_s for work in works] == sorted((work.cost_s for work in works), reverse=True)
    assert grid.city(Cell(0.0, 10.0, "none")) == grid.city(Cell(0.6, 10.0, "none"))
    loaded = grid.city(Cell(0.6, 10.0, "fixed"))
    assert (loaded.load, loaded.region, loaded.transports) == (0.6, "us", "fixed")


def test_the_estimate_is_of_the_whole_grid():
    works = runs.missing(Grid(), {})
    assert len(works) == 5 * 3 * (2 * 10 + 3)
    hours = sum(work.cost_s for work in works) / 3600.0
    assert 0.5 < hours < 3.0
    assert f"{len(works)} runs" in runs.estimate(works, 2)
    city = City()
    assert cost_s(city, "policy") == pytest.approx(1e-6 * METHODS["policy"].cost_us[1] * 1000 * 600)


def test_the_share_of_a_range_inside_the_area():
    """For a disc that fits into the square, the mean overlap is 1 - 8 r / (3 pi s) + r² / (2 pi s²)."""
    for share in (0.05, 0.3, 0.9):
        exact = 1.0 - 8.0 * share / (3.0 * math.pi) + share**2 / (2.0 * math.pi)
        assert inside(share * 1000.0, 1000.0) == pytest.approx(exact, abs=2e-3)
    # A disc larger than the square contains all of it, wherever its centre is.
    assert inside(2000.0, 1000.0) == pytest.approx(1.0 / (4.0 * math.pi), rel=0.01)


def test_the_options_of_a_grid():
    assert Grid().options == ""
    grid = Grid(densities=(10.0,), methods=("policy",), seeds=range(1, 3), duration_s=60.0)
    assert grid.options == " --densities 10 --methods policy --seeds 1-2 --minutes 1"


# ---------------------------------------------------------------- intervals and verdicts


def test_numbers_of_a_cell():
    losses = estimate(three(10), LOSSES)
    # 30 losses in 75 hours; Garwood's interval of 30 is 20.24 to 42.83.
    assert (losses.value, losses.low, losses.high) == pytest.approx((0.4, 0.2699, 0.5710), abs=1e-4)
    uneven = estimate([row(1, 0), row(2, 20), row(3, 10)], LOSSES)
    assert uneven.value == losses.value
    assert uneven.high - uneven.low > 2.0 * (losses.high - losses.low)
    unheard = estimate([row(1, unheard=0.9), row(2, unheard=0.1)], BY_KEY["unheard"])
    assert (unheard.low, unheard.high) == (0.0, 1.0)
    assert estimate([row(1), row(2, age_s=None)], BY_KEY["age_s"]) is None


def test_a_verdict_is_that_of_the_interval_and_not_of_the_value():
    made = cells((1, 0, 1, 0), (10, 40, 900, 44), (30, 40, 900, 72), (100, 40, 900, 200))
    found = {(v.target, v.method): v for v in verdicts(made)}
    policy = found["perfect", "policy"]
    # Density 1: no loss in either. 10: ratio 1.1. 30: ratio 1.8, with 2 in the interval. 100: ratio 5.
    assert (policy.at("kept"), policy.at("open"), policy.at("missed")) == ([10], [1, 30], [100])
    assert policy.stops == 100
    assert "keeps the target at 10; misses it from 100 (5 times" in policy.words
    assert "too few losses to tell at 1 (no loss in either), 30 (1.8 times" in policy.words
    assert found["prevented", "perfect"].at("kept") == [10, 30, 100]
    assert found["prevented", "policy"].at("missed") == [100]
    assert found["perfect", "none"].stops == 10
    assert ("perfect", "perfect") not in found
    assert ("prevented", "none") not in found


def test_few_losses_decide_nothing():
    found = {(v.target, v.method): v for v in verdicts(cells((10, 0, 1, 0)))}
    for verdict in found.values():
        assert (verdict.stops, verdict.at("kept"), verdict.at("open")) == (None, [], [10])
    assert "too few losses to tell at 10" in found["perfect", "policy"].words


def test_many_losses_against_a_reference_without_any_decide():
    found = {(v.target, v.method): v for v in verdicts(cells((10, 0, 900, 10)))}
    assert found["perfect", "policy"].stops == 10
    # 30 against 0 losses in equal hours: from the ends of their intervals, sqrt(20.24 (60 - 20.24)) / 3.689.
    assert "(at least 7.7 times)" in found["perfect", "policy"].words


def test_a_miss_below_a_kept_density_is_reported():
    found = {(v.target, v.method): v for v in verdicts(cells((10, 40, 900, 200), (30, 40, 900, 40)))}
    assert "order is not settled" in found["perfect", "policy"].words


def test_sentences_state_the_target_and_need_a_reference():
    text = "\n".join(sentences(verdicts(cells((10, 40, 900, 44), load=0.6))))
    assert "at most 2 times the losses of separation per flight hour of: perfect information" in text
    assert "foreign load 0.6" in text
    assert "at most 0.1 times the losses of separation per flight hour of: nobody avoids" in text
    alone = {Cell(0.0, 10.0, "policy"): three(1)}
    assert verdicts(alone) == []
    assert "a method to judge and a reference" in sentences([])[0]


# ---------------------------------------------------------------- tables and picture


def test_tables_hold_values_with_their_intervals():
    made = cells((10, 40, 900, 10))
    text = table.markdown(made)
    assert "| 10 | policy | 3 | 75.0 | 30 | 0.400 (0.270 to 0.571) |" in text
    lines = list(csv.DictReader(table.csv_of(made).splitlines()))
    assert [line["method"] for line in lines] == ["policy", "perfect", "none"]
    assert float(lines[0]["losses_per_h_high"]) == pytest.approx(0.571, abs=1e-3)
    assert lines[1]["age_s"] == ""
    found = list(table.json_rows(made, verdicts(made)))
    json.dumps(found, allow_nan=False)
    assert {line["kind"] for line in found} == {"cell", "verdict"}


def test_the_data_of_the_picture():
    made = cells((1, 0, 3, 0), (10, 40, 900, 44)) | cells((10, 40, 900, 44), load=0.6)
    curves = {curve.method: curve for curve in picture.curves(made, 0.0, LOSSES)}
    assert list(curves) == ["policy", "perfect", "none"]
    assert [(density, value.value) for density, value in curves["policy"].points] == [
        (1, 0.0), (10, pytest.approx(44 / 25)),
    ]  # fmt: skip
    (age,) = picture.curves(made, 0.6, BY_KEY["age_s"])
    assert (age.method, len(age.points)) == ("policy", 1)


def test_every_measure_has_a_panel_for_each_load():
    pytest.importorskip("matplotlib")
    made = cells((1, 0, 3, 0), (10, 40, 900, 44)) | cells((1, 0, 3, 0), (10, 40, 900, 44), load=0.6)
    with styled(picture.size_in(2)) as figure:
        picture.draw(figure, made)
        panels = figure.get_axes()
        assert len(panels) == 2 * len(picture.SHOWN)
        assert all(axes.get_title(loc="left") and axes.get_xlabel() for axes in panels)
        titles = [axes.get_ylabel() for axes in panels if axes.get_ylabel()]
        assert titles == [measure.title for measure in picture.SHOWN]
        first = panels[0]
        shapes = [line.get_marker() for line in first.lines]
        # One of three methods had losses at 1 per km²; the other two are drawn at the ends of their
        # intervals.
        assert shapes.count("v") == 2
        assert len(figure.legends[0].get_texts()) == 3


def test_the_legend_of_all_methods_is_within_the_picture():
    pytest.importorskip("matplotlib")
    made = {Cell(load, 10.0, method): three(1) for load in (0.0, 0.6) for method in METHODS}
    with styled(picture.size_in(2)) as figure:
        picture.draw(figure, made)
        figure.canvas.draw()
        (legend,) = figure.legends
        assert len(legend.get_texts()) == len(METHODS)
        left, right = legend.get_window_extent().intervalx
        assert left >= 0.0
        assert right <= figure.bbox.width


# ---------------------------------------------------------------- the command


SMALL = ["--densities", "8", "--aircraft", "12", "--minutes", "0.5", "--settle", "10", "--loads", "0.6"]


def command(*words):
    return cli.main(["paper", "city", *map(str, words)])


def test_a_small_grid_is_flown_kept_and_continued(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    words = [*SMALL, "--methods", "perfect", "fixed", "--jobs", 1, "--out", tmp_path, "--json"]
    assert command(*words, "--seeds", "1-1") == 0
    told = capsys.readouterr()
    assert "2 runs are to be flown: about" in told.err
    first = [json.loads(line) for line in told.out.splitlines()]
    flown = {line["method"]: line for line in first if line["kind"] == "cell"}
    assert set(flown) == {"fixed", "perfect"}
    assert flown["fixed"]["age_s"]["value"] > 0.3
    assert flown["fixed"]["wifi_load"]["value"] > 0.0
    assert flown["perfect"]["age_s"]["value"] is None
    assert flown["perfect"]["flight_h"] > 0.1
    record = provenance.read(tmp_path / runs.FILE)
    assert record.command.startswith("ground-tools paper city --densities 8 --methods fixed perfect")
    assert "ground_tools.city.loop" in record.sources
    assert (tmp_path / "city.png").read_bytes().startswith(b"\x89PNG")
    assert "| 8 | best fixed legal set | 1 |" in (tmp_path / "table.md").read_text()
    lines = (tmp_path / runs.FILE).read_text().splitlines()
    assert len(lines) == 3
    # An incomplete line, as a killed process leaves it, is flown again, and new cells are flown.
    (tmp_path / runs.FILE).write_text("\n".join(lines)[:-30])
    assert command(*words, "--seeds", "1-2") == 0
    told = capsys.readouterr()
    assert "3 runs are to be flown" in told.err
    cells_now = [line for line in map(json.loads, told.out.splitlines()) if line["kind"] == "cell"]
    assert [line["runs"] for line in cells_now] == [2, 2]
    again = runs.kept(tmp_path).rows
    assert {msgspec.json.encode(run).decode() for run in again.values()} >= set(lines[1:])
    assert runs.sample(tmp_path / runs.FILE) == []


def test_complete_results_are_shown_without_flying_and_without_matplotlib(tmp_path, capsys, monkeypatch):
    grid = Grid(densities=(10.0,), methods=("policy", "perfect"), loads=(0.0,))
    file = runs.kept(tmp_path)
    file.add([])
    for cell in grid.cells():
        file.add([runs.Run(grid.city(cell), one) for one in three(40)])
    monkeypatch.setattr(runs, "fly", None)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    words = ["--densities", "10", "--methods", "policy", "perfect", "--loads", "0", "--out", tmp_path]
    assert command(*words) == 0
    told = capsys.readouterr().out
    assert "to be flown" not in told
    assert "policy: keeps the target at 10." in told
    assert "10 per km², 6.32 km: BLE 4 97%" in told
    assert "no picture: matplotlib is not installed" in told
    assert not (tmp_path / "city.png").exists()
    assert provenance.read(file.path) is None


def test_runs_of_other_software_are_shown_and_not_mixed_with_new_ones(tmp_path, capsys, monkeypatch):
    grid = Grid(densities=(10.0,), methods=("perfect",), loads=(0.0,))
    file = runs.kept(tmp_path)
    file.add([runs.Run(grid.city(cell), one) for cell in grid.cells() for one in three(40)])
    text = file.path.read_text().replace('"software": "', '"software": "0', 1)
    file.path.write_text(text)
    monkeypatch.setattr(runs, "fly", None)
    words = ["--densities", "10", "--methods", "perfect", "--loads", "0", "--out", tmp_path]
    assert command(*words) == 0
    assert command(*words, "--seeds", "1-4") == 2
    assert "made by other software, and are not mixed" in capsys.readouterr().err
    assert file.path.read_text() == text


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--densities", "0"], "--densities: 0 is out of range; allowed: above 0, up to 200"),
        (["--densities", "nan"], "--densities: nan is out of range"),
        (["--loads", "1"], "--loads: 1 is out of range; allowed: at least 0, below 1"),
        (["--aircraft", "1"], "--aircraft: 1 is out of range; allowed: 2 to 20,000"),
        (["--minutes", "0.1"], "--minutes: 0.1 is out of range; allowed: 1/6 to 1440"),
        (["--settle", "300"], "--settle: 300 is out of range; allowed: at least 0, below the run's length"),
        (["--seeds", "3-1"], "--seeds: 3-1 is not allowed"),
        (["--jobs", "0"], "--jobs: 0 is out of range"),
    ],
)
def test_wrong_options_are_one_line(tmp_path, capsys, words, what):
    assert command("--out", tmp_path / "new", *words) == 2
    told = capsys.readouterr().err
    assert what in told
    assert told.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_a_file_of_another_study_is_refused(tmp_path):
    (tmp_path / runs.FILE).write_text('{"study": "town"}\n')
    with pytest.raises(ConfigError, match="made with other settings"):
        runs.kept(tmp_path)


def test_the_help_has_an_example_and_the_methods(capsys):
    with pytest.raises(SystemExit) as stop:
        command("--help")
    assert stop.value.code == 0
    told = capsys.readouterr().out
    assert "example: ground-tools paper city --densities 10 100" in told
    assert all(method.words in told for method in METHODS.values())


# ---------------------------------------------------------------- aircraft at a given distance


def at(density, method, deviation_m, losses):
    return {Cell(0.0, density, method): three(losses, deviation_m=deviation_m)}


def test_the_density_at_a_distance_is_interpolated_while_losses_are_prevented():
    cells = {
        **at(1.0, "none", 2.0, 400), **at(10.0, "none", 2.0, 400), **at(100.0, "none", 2.0, 400),
        **at(1.0, "ble4", 2.0, 0), **at(10.0, "ble4", 4.0, 0), **at(100.0, "ble4", 16.0, 0),
        **at(1.0, "wifi", 5.0, 0), **at(10.0, "wifi", 7.0, 0), **at(100.0, "wifi", 9.0, 400),
        **at(1.0, "ble5", 2.0, 400),
    }  # fmt: skip
    assert capacity.capacity(cells, 0.0, "ble4", 4.0).density == pytest.approx(10.0)
    assert capacity.capacity(cells, 0.0, "ble4", 8.0).density == pytest.approx(10.0 * 10.0**0.5)
    assert capacity.capacity(cells, 0.0, "ble4", 20.0).words == "> 100"
    assert capacity.capacity(cells, 0.0, "wifi", 4.0).words == "< 1"
    assert capacity.capacity(cells, 0.0, "wifi", 8.0).words == "> 10"  # at 100 it prevents nothing
    text = capacity.markdown(cells)
    assert "| BLE 4 at 10 | 10 | 20 | 46 |" in text
    assert "| Wi-Fi at 10 | < 1 | 3.5 | > 10 |" in text
    assert "| BLE 5 at 10 | - | - | - |" in text
    assert "nobody avoids" not in text
    alone = {cell: rows for cell, rows in cells.items() if cell.method != "none"}
    assert capacity.markdown(alone) == ""


# ---------------------------------------------------------------- what ships


def test_the_page_shows_the_kept_runs():
    """These are the kept runs; nothing is flown here."""
    grid = Grid()
    rows = runs.rows_of(grid, runs.kept(KEPT.parent).rows)
    assert {cell: len(found) for cell, found in rows.items()} == dict.fromkeys(grid.cells(), 3)
    page = (ROOT / "docs" / "city-results.md").read_text()
    assert table.brief(rows) in page
    assert f"ground-tools paper city{grid.options} --out results/city-paper" in page
    text = table.markdown(rows) + "\n" + capacity.markdown(rows)
    assert (KEPT.parent / "table.md").read_text() == text
    assert capacity.markdown(rows) in page
    found = {(v.target, v.load, v.method): v for v in verdicts(rows)}
    missed = {
        load: [m for m in METHODS if m != "perfect" and found["perfect", load, m].at("missed")]
        for load in grid.loads
    }
    assert missed == {
        0.0: ["ble5", "wifi", "none"], 0.6: ["ble5", "wifi", "wifi-2", "wifi-1", "none"],
    }  # fmt: skip
    stops = {
        load: {m: v.stops for m in METHODS if m != "none" and (v := found["prevented", load, m]).stops}
        for load in grid.loads
    }
    assert stops == {
        0.0: {"ble5": 30.0, "wifi": 10.0}, 0.6: {"ble5": 10.0, "wifi": 10.0, "wifi-2": 30.0, "wifi-1": 3.0},
    }  # fmt: skip
