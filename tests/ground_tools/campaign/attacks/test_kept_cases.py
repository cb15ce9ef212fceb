"""The kept attacks fly again, and keep what their files promise."""

from __future__ import annotations

from pathlib import Path

import pytest

from ground_tools.campaign.attacks import kept

CASES = sorted((Path(__file__).parents[3] / "data" / "attacks").glob("*.json"))


def test_there_are_some():
    assert CASES


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_a_kept_attack_breaks_no_promise(path):
    case = kept.read(path)
    row = kept.fly(case)
    assert row.seed == case.seed
    assert not kept.broken(case, row)
