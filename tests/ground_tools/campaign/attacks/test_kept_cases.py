"""The kept attacks are flown again, and the flights meet the requirements in their files."""

from __future__ import annotations

from pathlib import Path

import pytest

from ground_tools.campaign.attacks import kept

CASES = sorted((Path(__file__).parents[3] / "data" / "attacks").glob("*.json"))


def test_kept_attacks_exist():
    assert CASES


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_a_kept_attack_meets_its_requirements(path):
    case = kept.read(path)
    row = kept.fly(case)
    assert row.seed == case.seed
    assert not kept.broken(case, row)
