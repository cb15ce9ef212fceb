"""Places of surfaces: which are held, and for how long."""

from __future__ import annotations

import pytest

from companion.traffic.sensed.sensed import _aside_m
from companion.traffic.sensed.surfaces import CELL_M, MOST, Surfaces
from tests.companion.traffic.sensed.made import AT_S, pose, seen


@pytest.mark.parametrize(("after_s", "held"), [(-0.1, 0), (0.0, 1), (3.0, 1), (3.1, 0)])
def test_a_place_is_remembered_for_three_seconds(after_s: float, held: int) -> None:
    surfaces = Surfaces()
    surfaces.see(196, [seen(20.0, 0.0)], pose(), None)
    surfaces.expire(AT_S + after_s)
    assert len(surfaces.held) == held


def test_of_each_cell_the_nearest_place_is_held_and_of_all_the_nearest_cells() -> None:
    surfaces = Surfaces()
    wall = [seen(24.0 + deep_m, CELL_M * column + 1.0) for deep_m in (3.0, 0.0) for column in range(30)]
    for _ in range(2):
        surfaces.see(196, wall, pose(), None)
    assert [one.place.position[:2] for one in surfaces.held.values()] == [
        (24.0, CELL_M * column + 1.0) for column in range(MOST)
    ]
    assert {one.measured for one in surfaces.held.values()} == {2}


@pytest.mark.parametrize(
    ("across_m", "flat", "margin_m"),
    [(4.4, True, 4.4), (4.6, True, 2.3), (4.6, False, 4.6), (1.0, True, 1.0)],
)
def test_the_margin_of_a_place_is_its_half_width_unless_its_sector_is_wide(
    across_m: float, flat: bool, margin_m: float
) -> None:
    """From 15 % of 30 m on."""
    assert _aside_m(seen(30.0, 0.0, across_m=across_m, flat=flat), 30.0) == pytest.approx(margin_m)
