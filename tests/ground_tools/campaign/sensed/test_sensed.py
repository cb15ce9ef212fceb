"""Flights towards things that transmit nothing, on collision course, flown by the companion's own core."""

from __future__ import annotations

import json
import math

import pytest
from msgspec.structs import replace

from ground_tools.campaign.sensed import cells, flight, scene
from ground_tools.campaign.sensed.flight import Row
from ground_tools.campaign.sensed.scene import KINDS, MEETING_S, PASS_M, Cell
from ground_tools.cli import main
from ground_tools.common import table_file
from ground_tools.common.sources import ROOT


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(1, 30))
def test_drawn_obstacles_lie_on_the_path(kind, seed):
    drawn = scene.draw(Cell(kind=kind), seed)
    assert drawn.obstacle.distance_m(drawn.planned(MEETING_S), MEETING_S) <= math.hypot(PASS_M, 2.0)
    assert 2.5 <= drawn.speed_mps <= 3.75
    assert scene.draw(Cell(kind=kind, range_m=80.0, message="points"), seed) == drawn


@pytest.mark.parametrize("kind", KINDS)
def test_a_flight_keeps_away_and_is_the_same_each_time(kind):
    row = flight.fly(Cell(kind=kind), 3)
    assert row == flight.fly(Cell(kind=kind), 3)
    assert row.unavoided_m < 8.0
    assert not row.hit
    assert row.separation_m > row.unavoided_m
    assert row.seen_s is not None
    assert row.seen_s > 0.0


@pytest.mark.parametrize("kind", ["pole", "wall", "unheard-5"])
def test_obstacles_from_an_ardupilots_own_sensor_are_avoided(kind):
    cell = Cell(kind=kind, message="proximity")
    row = flight.fly(cell, 4)
    assert row == flight.fly(cell, 4)
    assert row.unavoided_m < 8.0
    assert row.separation_m > 10.0
    assert row.seen_s is not None
    assert row.separation_m != flight.fly(Cell(kind=kind), 4).separation_m


def test_a_sensor_with_too_short_a_range_does_not_help():
    row = flight.fly(Cell(kind="unheard-10", range_m=5.0), 3)
    assert row.separation_m == pytest.approx(row.unavoided_m, abs=6.0)


def test_a_summary_counts():
    rows = [
        Row(1, 1.0, 0.5, 9.0, 1.0, 2.0),
        Row(2, 8.0, 3.0, 10.0, 2.0, None),
        Row(3, 14.0, 11.0, 20.0, 3.0, 6.0),
    ]
    found = cells.summary(rows)
    assert (found["flights"], found["lost"], found["hit"]) == (3, 2, 1)
    assert (found["lost_unavoided"], found["hit_unavoided"], found["not_seen"]) == (2, 1, 1)
    assert (found["least_m"], found["deviation_median_m"], found["seen_median_s"]) == (1.0, 10.0, 4.0)
    assert "| pole | 40 | 3 | 2 / 1 | 2 | 1 | 1.00 |" in cells.markdown({Cell(kind="pole"): found})


def test_the_command_keeps_what_it_flew(tmp_path, capsys):
    words = [
        "campaign",
        "sensed",
        "--kind",
        "pole",
        "--seeds",
        "1-2",
        "--processes",
        "1",
        "--out",
        str(tmp_path),
    ]
    assert main([*words, "--json"]) == 0
    first = json.loads(capsys.readouterr().out)
    (cell,) = first["cells"]
    assert (cell["kind"], cell["range_m"], cell["flights"], cell["hit"]) == ("pole", 40.0, 2, 0)
    (file,) = tmp_path.glob("*.jsonl")
    before = file.read_bytes()
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == first
    assert file.read_bytes() == before


def test_names_of_groups_and_wrong_numbers(capsys):
    assert main(["campaign", "sensed", "--range", "2", "--kind", "unheard"]) == 2
    assert "range_m" in capsys.readouterr().err


def test_the_page_shows_the_kept_flights():
    kept = table_file.read(ROOT / "results" / "campaign" / "sensed.json", cells.Table)
    assert kept.seeds == (1, 1000)
    page = (ROOT / "docs" / "sensed-results.md").read_text()
    for line in cells.markdown({x.cell: x.found for x in kept.lines}).splitlines()[2:6]:
        assert line in page


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A table with all lines of the kept one, and its file."""
    file = tmp_path_factory.mktemp("kept") / "sensed.json"
    assert main(["campaign", "sensed", "--seeds", "1-2", "--processes", "1", "--file", str(file)]) == 0
    return file, table_file.read(file, cells.Table)


def test_a_sample_of_a_kept_table_names_what_differs(whole):
    file, table = whole
    table_file.write(file, table)
    assert cells.sample(file) == []
    line, *others = table.lines
    other = replace(line, first=replace(line.first, separation_m=9.0))
    table_file.write(file, replace(table, lines=(other, *others)))
    assert cells.sample(file) == [
        f"pole at 40 m, seed 1: least separation 9 m, now {line.first.separation_m:g} m"
    ]
    table_file.write(file, replace(table, seeds=(1, 3)))
    assert cells.sample(file) == ["pole at 40 m: 2 flights; seeds (1, 3) are 3"]


def test_a_kept_table_that_lacks_lines_is_not_the_whole(whole):
    file, table = whole
    pole, wall, five, ten = table.lines
    for lines, number, there, expected in (
        ((), 1, "missing", pole.cell),
        ((pole, wall, five), 4, "missing", ten.cell),
        ((pole, five, ten), 2, five.cell, wall.cell),
        ((pole, wall, five, ten, ten), 5, ten.cell, "the end of the table"),
    ):
        table_file.write(file, replace(table, lines=lines))
        assert cells.sample(file) == [f"{file}: line {number} of the table is {there}; expected: {expected}"]
