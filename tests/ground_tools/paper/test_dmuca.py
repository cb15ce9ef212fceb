"""The DMUCA figures: made-up separations that confirm the statements or do not, and a few flights."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from rich.console import Console

from ground_tools import cli
from ground_tools.campaign import cells
from ground_tools.campaign.cells import Cell
from ground_tools.paper.figures import dmuca, dmuca_flights
from ground_tools.paper.figures.dmuca_flights import CASES, DELAYS_S, PAIRS, Case, fly, least_distances
from ground_tools.paper.report import Numbers, Report, json_rows, show

PUBLISHED = (
    (12.0,) * 10,
    (12.0, 9.75, 12.0, 12.0, 9.94, *(12.0,) * 5),
    (*(9.0,) * 5, 2.5, *(12.0,) * 4),
)
"""Separations as in the paper, by delay; values that it does not give are made up."""


def table(rows=PUBLISHED, flights=3):
    found = {}
    for case in CASES:
        row = (1.0,) * 10 if case.law == "none" else rows[DELAYS_S.index(case.delay_s)]
        found[case] = np.array([row] * flights)
    return found


def verdicts(found, law):
    return [(s.verdict, s.ours) for s in dmuca.statements(found, law, 7)]


# ---------------------------------------------------------------- statements and tables


def test_flights_as_published_hold():
    for law in ("paper", "dmuca"):
        found = dmuca.statements(table(), law, 7)
        assert {s.verdict for s in found} == {"holds"}, found
        assert len({s.published for s in found}) == 5
    assert list(found[0].checks) == ["seed 7", "seed 8", "seed 9"]


@pytest.mark.parametrize(("law", "other"), [("paper", "dmuca"), ("dmuca", "paper")])
@pytest.mark.parametrize(
    ("delay", "pair", "distance_m", "number", "expected"),
    [
        (0, 3, 10.0, 0, ("holds at 2 of 3", "least 10.00 m, median 12.00 m")),
        (1, 3, 9.99, 1, ("holds at 2 of 3", "2: 2, 3: 1 (pairs: flights)")),
        (1, 1, 10.0, 1, ("holds at 2 of 3", "1: 1, 2: 2 (pairs: flights)")),
        (2, 9, 9.0, 2, ("holds at 2 of 3", "6: 2, 7: 1 (pairs: flights)")),
        (2, 0, 2.0, 3, ("holds at 2 of 3", "least 2.00 m, median 2.50 m")),
    ],
)
def test_one_flight_that_is_not_as_published(law, other, delay, pair, distance_m, number, expected):
    """Only flights of the given law and conditions count."""
    found = table()
    found[Case(other, DELAYS_S[delay], "exact")][1, pair] = distance_m
    found[Case(law, DELAYS_S[delay], "noisy")][1, pair] = distance_m
    assert {verdict for verdict, _ in verdicts(found, law)} == {"holds"}
    found[Case(law, DELAYS_S[delay], "exact")][1, pair] = distance_m
    assert verdicts(found, law)[number] == expected


def test_more_delay_that_does_not_harm():
    rows = (PUBLISHED[0], PUBLISHED[2], PUBLISHED[1])
    (harm,) = [s for s in dmuca.statements(table(rows), "paper", 1) if "more delay" in s.published]
    assert harm.ours == "0.00, 6.00, 2.00 pairs per flight"
    assert harm.checks == {"from [0, 1] to [1, 2] s": True, "from [1, 2] to [2, 3] s": False}
    (same,) = [s for s in dmuca.statements(table((PUBLISHED[0],) * 3), "paper", 1) if "more" in s.published]
    assert same.verdict == "does not hold"


def test_shares_of_all_flights_and_pairs_of_the_first():
    found = table()
    case = Case("paper", (1.0, 2.0), "noisy")
    found[case] = np.array([[11.0] * 10, [9.0] * 4 + [11.0] * 6, [10.5] + [30.0] * 9, [10.0] * 10])
    shares = {(row["law"], row["air"], row["delay_s"]): row for row in dmuca.shares(found).rows}
    assert len(shares) == len(CASES) == 14
    row = shares["paper", "noisy", (1.0, 2.0)]
    assert (row["flights"], row["above"], row["share_percent"]) == (4, 2, (15, 85))
    assert (row["pairs_below"], row["published_pairs_below"]) == (1.0, 2)
    assert (row["least_m"], row["published_least"], row["median_least_m"]) == (9.0, "9.75", 10.25)
    assert shares["none", "exact", None]["published_pairs_below"] is None
    found[Case("paper", (2.0, 3.0), "exact")][0] = np.arange(10.0)
    found[Case("paper", (2.0, 3.0), "exact")][1:] = 50.0
    pairs = dmuca.pairs(found, 7).rows
    assert [row["paper_2_3_m"] for row in pairs] == list(range(10))
    assert [row["pair"] for row in pairs][1::3] == ["UAV1-UAV3", "UAV2-UAV3", "UAV3-UAV4"]
    assert {row["none_m"] for row in pairs} == {1.0}


def test_a_table_with_columns_of_its_own(capsys):
    rows = ({"a": "x", "b": 2, "c": 0.126, "d": (1.0, 2.5), "e": None, "for_machines": 3},)
    report = Report("t", (), numbers=(Numbers("n", {key: key.upper() for key in "abcde"}, rows),))
    show(report, Console(width=80))
    out = capsys.readouterr().out
    assert out.splitlines()[-2].split() == ["x", "2", "0.13", "1-2.5", "-"]
    assert json_rows("f", report) == [{"figure": "f", "kind": "number", **rows[0]}]


# ---------------------------------------------------------------- flights


def test_least_distances_between_the_positions():
    """Two aircraft pass each other at 3 m between two positions; a third one hovers 40 m away."""
    places = np.array(
        [[(-10.0, 0, 0), (12.0, 3, 0), (0, 0, 40.0)], [(10.0, 0, 0), (-8.0, 3, 0), (0, 0, 40.0)]]
    )
    assert_allclose(least_distances(places), [3.0, 40.0, math.hypot(3.0, 40.0)])
    standing = np.array([[(0.0, 0, 0), (3.0, 4, 0)]] * 3)
    assert_allclose(least_distances(standing), [5.0])


@pytest.mark.parametrize("law", ["paper", "dmuca", "none"])
def test_flights_are_those_of_the_campaign(law):
    """The same law, world, paths and draws give the same least distance, of the same pair, at the same
    time."""
    delay_s = DELAYS_S[law == "paper"]
    (row,) = cells.fly(Cell(generator="S2", aircraft=5, law=law, delay_s=delay_s), [3])
    times, places = fly(Case(law, delay_s, "noisy"), 3)
    least = least_distances(places)
    assert least.min() == pytest.approx(row.separation_m, abs=1e-4)
    assert PAIRS[int(least.argmin())] == (row.first, row.second)
    first, second = places[:, row.first], places[:, row.second]
    nearest = np.linalg.norm(first - second, axis=1).argmin()
    assert times[nearest] == pytest.approx(row.time_s, abs=0.21)


def test_exact_flights_send_true_positions():
    """Without avoidance and errors, all aircraft fly their paths. With errors, they are off by their position
    error."""
    exact = dmuca_flights.IN["exact"]
    assert (exact.sigma_m, exact.sigma_mps, exact.declared_m, exact.quantised) == (0.0, 0.0, 0.0, False)
    for air, most_m in (("exact", 2.0), ("noisy", 8.0)):
        times, places = fly(Case("none", (0.0, 1.0), air), 1)
        planned = np.array(dmuca_flights.encounter("S2", 5, 1))
        at = np.array([[np.interp(times, p[:, 0], p[:, c]) for c in (1, 2, 3)] for p in planned])
        off = np.linalg.norm(places - at.transpose(2, 0, 1), axis=2).max()
        assert (off <= 2.0) == (air == "exact")
        assert off < most_m


def test_the_box_of_the_paper_hardly_conflicts():
    assert dmuca_flights.conflicts_in_the_box(20, 1) <= 2
    assert dmuca_flights.conflicts_in_the_box(200, 1) == sum(
        dmuca_flights.conflicts_in_the_box(1, seed) for seed in range(1, 201)
    )


def test_all_cases_once_and_the_same_seeds_in_each(monkeypatch):
    steps = []
    found = dmuca_flights.table_of(2, 5, lambda: steps.append(1))
    assert len(steps) == len(found) == len(CASES)
    monkeypatch.setattr(dmuca_flights, "MOST_FLIGHTS", 1)
    assert {len(least_m) for least_m in dmuca_flights.table_of(2, 5).values()} == {1}
    monkeypatch.undo()
    assert dmuca_flights.table_of(2, 5)[CASES[0]] is found[CASES[0]]
    for case in (CASES[2], CASES[-1]):
        assert_allclose(found[case], [least_distances(fly(case, seed)[1]) for seed in (5, 6)])


def test_nothing_is_cut_off_at_80_columns(capsys):
    show(dmuca.report(2, 5), Console(width=80))
    out = capsys.readouterr().out
    assert "The flight of seed 5" in out
    assert "…" not in out


def test_command_line(tmp_path, capsys, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(dmuca_flights, "MOST_FLIGHTS", 2)
    words = ["paper", "dmuca", "--samples", "100000", "--seed", "5", "--json", "--out", str(tmp_path)]
    assert cli.main(words) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row["kind"] for row in rows] == ["statement"] * 10 + ["number"] * (14 + 10)
    assert {tuple(row["checks"]) for row in rows[:4]} == {("seed 5", "seed 6")}
    assert "paper_0_1_m" in rows[-1]
    assert {row["flights"] for row in rows[10:24]} == {2}
    assert (tmp_path / "dmuca.png").read_bytes().startswith(b"\x89PNG")
