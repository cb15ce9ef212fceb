"""docs/safety-results.md shows the stored results."""

from __future__ import annotations

from pathlib import Path

import pytest

from ground_tools.campaign import tables
from ground_tools.common import table_file

SEEDS = {"laws": 4_000, "twenty": 300, "twins-lost": 200}
ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("name", tables.TABLES)
def test_the_tables_are_those_that_are_kept(name):
    kept = table_file.read(ROOT / "results" / "campaign" / f"{name}.json", tables.Kept)
    assert kept.seeds == (1, SEEDS.get(name, 1000))
    assert [line.cell for line in kept.lines] == tables.TABLES[name]()
    assert {line.found["runs"] for line in kept.lines} == {kept.seeds[1]}
    assert tables.markdown(kept.lines) in (ROOT / "docs" / "safety-results.md").read_text()
