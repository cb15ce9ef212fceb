"""What one scan or the points of one step show, and what a scan sees past, by hand."""

from __future__ import annotations

import pytest

from companion.config import SensedConfig
from companion.events import ObstaclePoint, ObstacleScan
from companion.events.sensed import NOTHING
from companion.traffic.sensed.seen import View, sight_of_points, sight_of_scan
from tests.companion.traffic.sensed.made import pose

CONFIG = SensedConfig(use=True, max_range_m=40.0)


def scan(*metres: float) -> ObstacleScan:
    """Sectors of 5 degrees from the nose to the right; nothing is seen in the others."""
    found = [round(100.0 * m) for m in metres]
    distances = (*found, *[NOTHING] * (72 - len(found)))
    return ObstacleScan(
        component=196, axes="nose", first_deg=0.0, step_deg=5.0, max_cm=4000, distances_cm=distances
    )


@pytest.mark.parametrize(
    ("metres", "surfaces"),
    [((20.0, 22.0, 24.9), 0), ((20.0, 22.0, 25.1), 3), ((25.1, 22.0, 20.0), 3), ((20.0,) * 4, 0)],
)
def test_what_is_deeper_than_an_object_is_a_surface(metres: tuple[float, ...], surfaces: int) -> None:
    sight = sight_of_scan(scan(*metres), pose(), CONFIG)
    assert (len(sight.surfaces), len(sight.objects)) == (surfaces, 0 if surfaces else 1)


def test_points_of_one_thing_lie_within_half_its_width() -> None:
    points = [ObstaclePoint(component=196, axes="offset", position_m=(20.0, e, 0.0)) for e in (-1, 0, 1, 2)]
    (found,) = sight_of_points(points, pose(), CONFIG).objects
    assert found.position == pytest.approx((20.0, 0.5, 0.0))
    assert found.across_m == pytest.approx(1.5)


@pytest.mark.parametrize(("north_m", "passed"), [(0.9, False), (1.1, True), (37.9, True), (38.1, False)])
def test_a_scan_says_nothing_of_its_own_vehicle_nor_of_the_end_of_its_range(
    north_m: float, passed: bool
) -> None:
    assert View(scan(), pose(), CONFIG).passes((north_m, 0.0, 0.0), flat=False) is passed


@pytest.mark.parametrize(("down_m", "passed"), [(1.9, True), (2.1, False), (-2.1, False)])
def test_a_level_scan_sees_past_what_is_near_its_plane(down_m: float, passed: bool) -> None:
    """A metre, and a twentieth of 20 m."""
    assert View(scan(), pose(), CONFIG).passes((20.0, 0.0, down_m), flat=False) is passed
