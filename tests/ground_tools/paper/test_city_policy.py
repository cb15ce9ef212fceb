"""Policies trained for a city, beside fixed sets, on cut-outs of it."""

from __future__ import annotations

import functools
import json

import msgspec
import pytest

from companion.shipped import CHECKOUT
from ground_tools import cli
from ground_tools.common.kept_lines import read_lines
from ground_tools.paper.city import cutouts
from ground_tools.paper.city.cutouts import USUAL, Cut
from ground_tools.paper.city.runs import FILE

KEPT = CHECKOUT / "results" / "city-policy"
SMALL = [
    "--aircraft",
    "12",
    "--minutes",
    "0.5",
    "--settle",
    "10",
    "--densities",
    "8",
    "--loads",
    "0",
    "--jobs",
    "1",
]


def run(*words):
    return cli.main(["paper", "city-policy", *map(str, words)])


def test_runs_are_kept_and_shown_beside_the_fixed_set(tmp_path, capsys):
    options = [*SMALL, "--seeds", "1-2", "--methods", "city-1", "10-0-2", "--out", tmp_path]
    assert run(*options) == 0
    shown = capsys.readouterr().out
    for words in ("| fixed set |", "| city-1 |", "| search over the sets, in hindsight |", "other cut-outs"):
        assert words in shown
    before = (tmp_path / FILE).read_bytes()
    assert run(*options, "--json") == 0
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(line["method"], line["seed"]) for line in found] == [
        (method, seed) for method in (USUAL, "city-1", "10-0-2") for seed in (1, 2)
    ]
    assert (tmp_path / FILE).read_bytes() == before


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--methods", "0-0-10"], "--methods: 0-0-10 is unknown"),
        (["--densities", "0"], "--densities: above 0"),
        (["--settle", "1e9"], "--settle: at least 0, below the run's length"),
        (["--minutes", "0.1", "--settle", "0"], "--minutes: 0.1 is out of range; allowed: 1/6 to 1440"),
        (
            ["--aircraft", "2", "--densities", "30"],
            "--aircraft: 2 at 30 per km² are a square of 258 m; allowed",
        ),
    ],
)
def test_wrong_options_are_reported(options, words, tmp_path, capsys):
    assert run(*SMALL, "--out", tmp_path, *options) == 2
    assert words in capsys.readouterr().err


def _row(losses, deviation_m):
    row = read_lines(KEPT / FILE, Cut)[1][0].row
    return msgspec.structs.replace(row, losses=losses, deviation_m=deviation_m)


def test_the_best_set_has_no_more_losses_than_the_fixed_set():
    methods = {USUAL: {1: _row(0, 9.0)}, "10-0-2": {1: _row(1, 3.0)}, "10-0-7": {1: _row(0, 7.0)}}
    assert cutouts.best(methods, [1]) == "10-0-7"


def test_the_set_for_a_cut_out_is_chosen_in_the_others():
    methods = {
        USUAL: {1: _row(0, 9.0), 2: _row(0, 9.0)},
        "10-0-2": {1: _row(0, 1.0), 2: _row(0, 20.0)},
    }
    shown = dict(cutouts.shown(methods))
    (others,) = (rows for words, rows in shown.items() if "other cut-outs" in words)
    assert [others[seed].deviation_m for seed in (1, 2)] == [9.0, 20.0]
    assert [row.deviation_m for row in shown["search over the sets, in hindsight"].values()] == [1.0, 9.0]


def test_a_kept_run_is_made_again(tmp_path, monkeypatch):
    monkeypatch.setattr(cutouts, "flown", functools.cache(cutouts.flown))
    header, rows = read_lines(KEPT / FILE, Cut)
    few = [cut for cut in rows if cut.method == USUAL][:1]
    path = tmp_path / FILE
    path.write_text(
        "\n".join([json.dumps(header), *(msgspec.json.encode(cut).decode() for cut in few)]) + "\n"
    )
    assert cutouts.sample(path) == []
    changed = msgspec.structs.replace(few[0], row=msgspec.structs.replace(few[0].row, losses=99))
    path.write_text(json.dumps(header) + "\n" + msgspec.json.encode(changed).decode() + "\n")
    assert len(cutouts.sample(path)) == 1


def test_the_table_is_that_of_the_kept_runs():
    rows = read_lines(KEPT / FILE, Cut)[1]
    assert (KEPT / "table.md").read_text().splitlines() == cutouts.table(cutouts.cuts_of(rows))
