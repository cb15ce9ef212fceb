"""The room that each method needs: plan, verdicts on made-up rows, text and command."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ground_tools import cli
from ground_tools.common import provenance
from ground_tools.common.figure import styled
from ground_tools.paper.city import runs, separation
from ground_tools.paper.city.grid import Grid
from ground_tools.paper.city.separation import Plan, Point, draw, judged, markdown, needed, sentences
from tests.ground_tools.paper.made_city import SILENT, three

ROOT = Path(__file__).parents[3]
NOBODY = Point("none", 0.0)


def made(**losses_by_separation):
    """Rows of made-up runs: for each method the losses per run, by separation; 3,000 if nobody avoids."""
    points = {NOBODY: three(3000, **SILENT)}
    for method, losses in losses_by_separation.items():
        for separation_m, count in losses.items():
            points[Point(method, separation_m)] = three(count, deviation_m=separation_m / 2.0)
    return points


def test_each_method_flies_with_each_separation_and_nobody_once():
    plan = Plan(
        Grid(densities=(30.0,), methods=("ble4", "perfect"), loads=(0.0,), seeds=range(1, 3)), (5.0, 8.0)
    )
    cities = plan.cities()
    assert [(p.method, p.separation_m) for p in cities] == [
        ("ble4", 5.0), ("ble4", 8.0), ("perfect", 5.0), ("perfect", 8.0), ("none", 0.0),
    ]  # fmt: skip
    assert [city.separation_m for city in cities.values()] == [5.0, 8.0, 5.0, 8.0, 10.0]
    works = plan.missing({})
    assert len(works) == 10
    first = works[0]
    kept = {runs.number_of(first.city, first.seed): runs.Run(first.city, three(1)[0])}
    assert len(plan.missing(kept)) == 9
    assert sum(map(len, plan.points(kept).values())) == 1


def test_the_least_separation_is_the_one_from_which_all_larger_ones_keep_the_target():
    points = made(ble4={4.0: 0, 7.0: 300, 10.0: 2, 14.0: 0}, wifi={4.0: 400, 14.0: 400})
    found = judged(points, 0.01)
    assert found[Point("ble4", 4.0)].standing == "kept"
    assert found[Point("ble4", 7.0)].standing == "missed"
    assert needed(points, found, "ble4") == Point("ble4", 10.0)
    assert needed(points, found, "wifi") is None
    told = sentences(points, found, 0.01)
    assert told[1].startswith("  BLE 4 at 10: 10 m keeps it")
    assert told[1].endswith("at a mean distance from the timed point of 5.0 (5.0 to 5.0) m.")
    assert told[2] == "  Wi-Fi at 10: none of the separations flown is shown to keep it."


def test_too_few_losses_do_not_keep_the_target():
    points = {NOBODY: three(1, **SILENT), Point("ble4", 10.0): three(0)}
    found = judged(points, 0.01)
    assert found[Point("ble4", 10.0)].standing == "open"
    assert needed(points, found, "ble4") is None


def test_the_table_and_the_picture_show_every_point():
    points = made(ble4={4.0: 30, 10.0: 0}, policy={4.0: 3})
    text = markdown(points, judged(points, 0.01))
    assert text.count("\n") == 2 + len(points)
    assert "| BLE 4 at 10 | 4 | 3 | 75.0 | 90 |" in text
    with styled((9.0, 6.5)) as figure:
        draw(figure, points)
        (axes,) = figure.axes
        lines = {line.get_label(): line for line in axes.get_lines() if not line.get_label().startswith("_")}
        assert lines["BLE 4 at 10"].get_xdata().tolist() == [2.0, 5.0]
        rate, bound = lines["BLE 4 at 10"].get_ydata().tolist()
        assert rate == pytest.approx(90 / 75)
        assert bound == pytest.approx(3.6889 / 75, rel=1e-3)
        assert [text.get_text() for text in axes.texts] == ["", "4 m", "10 m, none", "4 m"]


def command(*words):
    return cli.main(["paper", "city-separation", *map(str, words)])


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--separations", "0"], "--separations: 0 is out of range; allowed: above 0, up to 100"),
        (["--density", "300"], "--density: 300 is out of range; allowed: above 0, up to 200"),
        (["--load", "1"], "--load: 1 is out of range; allowed: at least 0, below 1"),
        (["--share", "1"], "--share: 1 is out of range; allowed: between 0 and 1"),
        (["--seeds", "3-1"], "--seeds: 3-1 is not allowed"),
    ],
)
def test_wrong_options_are_one_line(tmp_path, capsys, words, what):
    assert command("--out", tmp_path / "new", *words) == 2
    told = capsys.readouterr().err
    assert what in told
    assert told.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_the_command_flies_what_is_missing_once(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    words = ["--density", 8, "--aircraft", 12, "--minutes", 0.5, "--settle", 10, "--methods", "perfect",
             "--separations", 5, 20, "--seeds", "1-1", "--jobs", 1, "--json", "--out", tmp_path]  # fmt: skip
    assert command(*words) == 0
    captured = capsys.readouterr()
    lines = [json.loads(line) for line in captured.out.splitlines()]
    assert [(line["method"], line["separation_m"]) for line in lines] == [
        ("perfect", 5.0), ("perfect", 20.0), ("none", None),
    ]  # fmt: skip
    assert lines[0]["deviation_m"][0] < lines[1]["deviation_m"][0]
    assert "3 runs are to be flown" in captured.err
    assert (tmp_path / f"{separation.NAME}.png").stat().st_size > 5000
    assert command(*words) == 0
    again = capsys.readouterr()
    assert again.out == captured.out
    assert "are to be flown" not in again.err


def test_the_page_shows_the_kept_runs():
    """These are the kept runs; nothing is flown here."""
    folder = ROOT / "results" / "city-separation"
    grid = Grid(densities=(100.0,), methods=("ble4", "policy", "ideal", "perfect"), loads=(0.0,))
    points = Plan(grid, separation.SEPARATIONS).points(runs.kept(folder).rows)
    assert [len(rows) for rows in points.values()] == [3] * 21
    found = judged(points, separation.SHARE)
    page = (ROOT / "docs" / "city-results.md").read_text()
    assert markdown(points, found) in page
    assert (folder / "table.md").read_text() == markdown(points, found)
    assert needed(points, found, "ble4") == Point("ble4", 7.0)
    assert needed(points, found, "policy") == Point("policy", 10.0)
    assert needed(points, found, "ideal") == Point("ideal", 7.0)
    assert needed(points, found, "perfect") is None


def test_the_record_names_the_options_that_make_the_runs_again(tmp_path):
    words = ["--density", 8, "--aircraft", 12, "--minutes", 0.5, "--settle", 10, "--methods", "perfect",
             "--separations", 5, "--seeds", "1-1", "--jobs", 1, "--out", tmp_path / "new"]  # fmt: skip
    assert command(*words) == 0
    record = provenance.read(tmp_path / "new" / runs.FILE)
    assert record is not None
    options = (
        "--separations 5 --density 8 --methods perfect --seeds 1-1 --aircraft 12 --minutes 0.5 --settle 10"
    )
    assert record.command == f"ground-tools paper city-separation {options} --out {tmp_path}/new"


def test_the_kept_command_is_that_of_its_plan():
    grid = Grid(densities=(100.0,), methods=("ble4", "policy", "ideal", "perfect"), loads=(0.0,))
    options = Plan(grid, separation.SEPARATIONS).options
    made = f"ground-tools paper city-separation{options} --out results/city-separation"
    assert made == runs.SEPARATION_COMMAND
