"""Fence items into areas."""

from __future__ import annotations

from typing import Any

import pytest

from companion.autopilot.lists.fence import areas_from_items
from companion.errors import PeerDataError
from companion.events import FenceArea, MissionItem

RETURN, POLYGON_IN, POLYGON_OUT, CIRCLE_IN, CIRCLE_OUT = 5000, 5001, 5002, 5003, 5004
SQUARE = ((47.0, 8.0), (47.01, 8.0), (47.01, 8.01), (47.0, 8.01))


def item(
    command: int, param1: float | None, place: tuple[float | None, float | None] = (47.0, 8.0), frame: int = 0
) -> dict[str, Any]:
    return {
        "command": command,
        "params": (param1, 0.0, 0.0, 0.0),
        "frame": frame,
        "lat_deg": place[0],
        "lon_deg": place[1],
    }


def polygon(
    command: int, *places: tuple[float, float], count: float | None = None, frame: int = 0
) -> list[Any]:
    return [item(command, len(places) if count is None else count, place, frame) for place in places]


def areas(*items: dict[str, Any]) -> tuple[FenceArea, ...]:
    return areas_from_items([MissionItem(seq=seq, **values) for seq, values in enumerate(items)])


@pytest.mark.parametrize("frame", [0, 3, 5, 6, 10, 11])
def test_areas_in_order_without_the_return_point(frame: int) -> None:
    got = areas(
        item(RETURN, 0.0, frame=frame),
        *polygon(POLYGON_IN, *SQUARE, frame=frame),
        item(CIRCLE_OUT, 25.5, (47.005, 8.005), frame),
        *polygon(POLYGON_OUT, *SQUARE[:3], frame=frame),
        *polygon(POLYGON_OUT, *SQUARE[1:], frame=frame),
        item(CIRCLE_IN, 5000.0, frame=frame),
    )
    assert got == (
        FenceArea(inclusion=True, points=SQUARE),
        FenceArea(inclusion=False, points=((47.005, 8.005),), radius_m=25.5),
        FenceArea(inclusion=False, points=SQUARE[:3]),
        FenceArea(inclusion=False, points=SQUARE[1:]),
        FenceArea(inclusion=True, points=((47.0, 8.0),), radius_m=5000.0),
    )


def test_long_edges_are_divided() -> None:
    (area,) = areas(*polygon(POLYGON_IN, (47.4, 179.9), (47.4, -179.8), (47.39, 179.9)))
    assert area.points[:3] == ((47.4, 179.9), (47.4, pytest.approx(179.96)), (47.4, pytest.approx(-179.98)))


def test_no_items_no_areas() -> None:
    assert areas() == ()
    assert areas(item(RETURN, 0.0)) == ()


@pytest.mark.parametrize(
    ("items", "reason"),
    [
        ([item(16, 0.0)], "fence item 0 (WAYPOINT): not a fence item"),
        ([item(5005, 0.0)], "fence item 0 (MAV_CMD 5005): not"),
        (
            polygon(POLYGON_IN, *SQUARE, count=2.0),
            "item 0 (FENCE_POLYGON_VERTEX_INCLUSION): vertex count 2.0",
        ),
        (
            polygon(POLYGON_IN, *SQUARE, count=3.5),
            "item 0 (FENCE_POLYGON_VERTEX_INCLUSION): vertex count 3.5",
        ),
        (polygon(POLYGON_IN, *SQUARE, count=0.0), "vertex count 0.0"),
        (polygon(POLYGON_IN, *SQUARE, count=-4.0), "vertex count -4.0"),
        ([item(POLYGON_OUT, None)], "item 0 (FENCE_POLYGON_VERTEX_EXCLUSION): vertex count None"),
        (polygon(POLYGON_IN, *SQUARE, count=5.0), "item 0 (FENCE_POLYGON_VERTEX_INCLUSION): 4 of 5 vertices"),
        (polygon(POLYGON_IN, *SQUARE, count=3e38), "4 of 3e+38 vertices"),
        # A vertex too many begins a polygon of its own, which is not whole.
        (polygon(POLYGON_IN, *SQUARE, count=3.0), "item 3 (FENCE_POLYGON_VERTEX_INCLUSION): 1 of 3 vertices"),
        (
            [*polygon(POLYGON_IN, *SQUARE[:2], count=4.0), *polygon(POLYGON_OUT, *SQUARE[2:], count=4.0)],
            "item 2 (FENCE_POLYGON_VERTEX_EXCLUSION): vertex 2 of item 0's polygon has a different",
        ),
        (
            [*polygon(POLYGON_IN, *SQUARE[:2], count=4.0), *polygon(POLYGON_IN, *SQUARE[2:], count=3.0)],
            "item 2 (FENCE_POLYGON_VERTEX_INCLUSION): vertex 2 of item 0's polygon has a different",
        ),
        (
            [*polygon(POLYGON_IN, *SQUARE[:2], count=3.0), item(CIRCLE_IN, 3.0)],
            "item 2 (FENCE_CIRCLE_INCLUSION): vertex 2 of item 0's polygon has a different",
        ),
        ([item(CIRCLE_IN, 0.0)], "item 0 (FENCE_CIRCLE_INCLUSION): radius_m: 0.0"),
        ([item(RETURN, 0.0), item(CIRCLE_OUT, -3.0)], "item 1 (FENCE_CIRCLE_EXCLUSION): radius_m: -3.0"),
        ([item(CIRCLE_IN, None)], "item 0 (FENCE_CIRCLE_INCLUSION): radius is not a number"),
        ([item(CIRCLE_IN, 5.0, frame=1)], "item 0 (FENCE_CIRCLE_INCLUSION): MAV_FRAME 1 is not a global"),
        (polygon(POLYGON_IN, *SQUARE, frame=2), "item 0 (FENCE_POLYGON_VERTEX_INCLUSION): MAV_FRAME 2"),
        ([item(CIRCLE_IN, 5.0, (None, 8.0))], "latitude or longitude is missing"),
        ([item(CIRCLE_IN, 5.0, (47.0, None))], "latitude or longitude is missing"),
        (
            [item(CIRCLE_IN, 5.0), *polygon(POLYGON_IN, SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3])],
            "item 1 (FENCE_POLYGON_VERTEX_INCLUSION): points: the edge",
        ),
        (polygon(POLYGON_IN, *SQUARE, SQUARE[0]), "points[4]: the same place as points[0]"),
    ],
)
def test_refusals_name_the_item(items: list[dict[str, Any]], reason: str) -> None:
    with pytest.raises(PeerDataError) as refused:
        areas(*items)
    assert reason in str(refused.value)
    assert str(refused.value).startswith("fence item ")
