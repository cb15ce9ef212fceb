"""NASA's DAIDALUS as a law of the campaign, with its library and without."""

from __future__ import annotations

import re

import pytest
from msgspec.structs import replace

from ground_tools import cli
from ground_tools.campaign import cells as campaign
from ground_tools.campaign import tables
from ground_tools.campaign.cells import Cell
from ground_tools.campaign.peer_comparison import pareto
from ground_tools.campaign.peer_comparison import table as comparison
from ground_tools.campaign.peers import daidalus, flown
from ground_tools.common import table_file
from ground_tools.common.provenance import CannotSampleError
from ground_tools.results import samples

built = pytest.mark.skipif(
    flown.missing("daidalus") is not None, reason="DAIDALUS is not built (docs/peers.md#daidalus)"
)


@pytest.fixture
def no_daidalus(monkeypatch, tmp_path):
    """A machine without NASA's library."""
    monkeypatch.setenv(daidalus.LIBRARY, str(tmp_path / "none.so"))
    daidalus.load.cache_clear()
    yield
    daidalus.load.cache_clear()


def test_a_law_whose_library_is_missing_is_refused_with_the_reason(no_daidalus, capsys):
    assert cli.main(["campaign", "run", "--generator", "S2", "--law", "daidalus", "--seeds", "1-2"]) == 2
    assert re.search(r"--law: DAIDALUS: .*none.so: .*build.sh", capsys.readouterr().err)


def test_a_table_says_which_law_was_not_flown_and_why(no_daidalus, capsys, monkeypatch):
    small = replace(comparison.TABLES["encounters"].encounters[1], aircraft=2)
    table = comparison.Table("two", ("none", "daidalus"), (small,), comparison.separation, "numbers")
    monkeypatch.setitem(comparison.TABLES, "encounters", table)
    assert cli.main(["campaign", "peers", "table", "encounters", "--seeds", "1-1", "--processes", "1"]) == 0
    said = capsys.readouterr()
    assert said.out.startswith("| encounter | none |\n")
    assert re.search(r"daidalus: not flown: DAIDALUS: .*none.so", said.err)


def test_a_sample_without_the_library_says_so(no_daidalus, tmp_path):
    cells = [Cell(generator="S1", aircraft=2, law=law) for law in ("none", "daidalus")]
    (row,) = campaign.fly(cells[0], [1])
    lines = tuple(tables.Line(cell=cell, found={"runs": 1}, first=row) for cell in cells)
    table_file.write(tmp_path / "t.json", tables.Kept(software="", seeds=(1, 1), lines=lines))
    with pytest.raises(
        CannotSampleError, match=r"1 of 2 lines, of which DAIDALUS: .*; the others are the same"
    ):
        samples.campaign_table(tmp_path / "t.json")


def test_the_picture_without_a_law_that_was_not_flown(tmp_path):
    pytest.importorskip("matplotlib")
    found = {"runs": 10, "losses_of_separation": 1, "min_separation_m": 9.0, "median_max_deviation_m": 20.0}
    cells = [cell for cell in pareto.cells() if not cell.law.startswith("daidalus")]
    lines = [tables.Line(cell=cell, found=found) for cell in cells]
    pareto.draw(tmp_path / "p.png", lines)
    assert "daidalus" not in pareto.markdown(lines)


@built
def test_aircraft_pass_each_other_and_are_back_on_their_paths():
    """With DAIDALUS's own distance of a collision, 152 m, they stopped in front of each other for ever."""
    cell = Cell(generator="head-on", aircraft=5, law="daidalus", delay_s=(2.0, 3.0))
    for row in campaign.fly(cell, [90001, 90002]):
        assert row.separation_m >= 10.0
        assert row.back_m < 6.0


@built
def test_the_kept_results_depend_on_the_library():
    cell = Cell(generator="S2", aircraft=2, law="daidalus")
    assert campaign.software_of([cell]) == f"{campaign.software(peers=True)}-{daidalus.load()}"
