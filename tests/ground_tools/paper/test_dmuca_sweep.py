"""The sweep over readings of the paper: counts, the criterion for growth, and stored results."""

import numpy as np
import pytest

from ground_tools.cli import main
from ground_tools.common.figure import drawn
from ground_tools.paper.figures import dmuca_sweep
from ground_tools.paper.figures.dmuca_flights import DELAYS_S, IN, flown, least_distances
from ground_tools.paper.figures.dmuca_sweep import READINGS, Row, report, row_of

NARROW = next(
    number
    for number, r in enumerate(READINGS)
    if (r.geometry, r.period_s, r.horizon_s, r.cycles, r.recovery_s) == ("S2", 0.5, 20.0, 10, 1.0)
)


def row(*below, number=0):
    return Row(number, below, (9.0,) * len(below))


def test_the_least_distances_of_the_flight_are_those_of_its_trace():
    for geometry in ("S1", "S3"):
        trace, least = flown(READINGS[NARROW].avoidance, IN["exact"], (1.0, 2.0), 5, geometry)
        assert np.array_equal(least, least_distances(trace))


def test_a_row_counts_the_pairs_of_every_flight():
    found = row_of(NARROW, 3, 7)
    reading = READINGS[NARROW]
    for place, delay_s in enumerate(DELAYS_S):
        least = [
            flown(reading.avoidance, IN["exact"], delay_s, seed, reading.geometry)[1] for seed in (7, 8, 9)
        ]
        assert found.below[place] == tuple(int((pairs < 10.0).sum()) for pairs in least)
        assert found.least_m[place] == min(pairs.min() for pairs in least)


@pytest.mark.parametrize(
    ("below", "trend"),
    [
        ((((0, 0, 1) * 20), ((2, 2, 3) * 20), ((6, 5, 6) * 20)), "grows"),
        ((((0, 4) * 3), ((1, 4) * 3), ((2, 4) * 3)), "mean"),
        ((((0, 4) * 3), ((1, 4) * 3), ((1, 4) * 3)), "not"),
        ((((2, 2, 3) * 20), ((0, 0, 1) * 20), ((6, 5, 6) * 20)), "not"),
    ],
)
def test_growth(below, trend):
    assert row(*below).trend == trend


def test_an_encounter_is_as_published_if_all_three_of_its_flights_are():
    found = row((0, 0, 1, 0), (2, 2, 2, 1), (6, 5, 6, 6))
    assert (found.as_published, found.six) == (1, 3)


def test_report_and_map_show_every_reading(tmp_path):
    rows = [row((0, 0), (2, 2), (6, 6), number=number) for number in range(len(READINGS))]
    found = report(rows, 1)
    assert len(found.numbers[0].rows) == len(READINGS)
    assert all(statement.holds for statement in found.statements)
    with drawn(tmp_path / "map.png", (13.0, 11.0)) as figure:
        dmuca_sweep._draw(figure, rows)
        panels = figure.get_axes()
    assert len(panels) == 12
    assert sum(len(axes.texts) for axes in panels) == len(READINGS)


def test_finished_readings_are_kept_and_never_mixed(tmp_path, monkeypatch, capsys):
    flown_now = []
    monkeypatch.setattr(dmuca_sweep, "_draw", lambda figure, rows: None)  # drawn by the test above
    monkeypatch.setattr(
        dmuca_sweep, "row_of", lambda n, *_: flown_now.append(n) or row((0, 1), (2, 2), (6, 5), number=n)
    )
    arguments = ["paper", "dmuca", "--sweep", "--samples", "2", "--processes", "1", "--out", str(tmp_path)]
    assert main(arguments) == 0
    assert sorted(flown_now) == list(range(len(READINGS)))
    lines = (tmp_path / "dmuca-sweep.jsonl").read_text().splitlines()
    (tmp_path / "dmuca-sweep.jsonl").write_text("\n".join(lines[:-2]) + "\n" + lines[-1][:9])
    flown_now.clear()
    assert main(arguments) == 0
    assert len(flown_now) == 2
    assert main([*arguments[:-4], "--samples", "3", *arguments[-4:]]) == 2
    assert "flights: 2, now 3" in capsys.readouterr().err
    monkeypatch.setattr(dmuca_sweep.sources, "digest", lambda _: "another")
    (tmp_path / "dmuca-sweep.jsonl").write_text("\n".join(lines[:-2]) + "\n")
    assert main(arguments) == 2
    assert "other software" in capsys.readouterr().err


def test_only_dmuca_is_swept(capsys):
    assert main(["paper", "delay-rate", "--sweep"]) == 2
    assert "--sweep" in capsys.readouterr().err
