"""Which paths a geofence lets be flown, and the walls that come of it."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from companion.avoidance import kernels as k
from companion.avoidance.trajectory import Trajectory
from companion.avoidance.walls import walls_of
from companion.errors import ConfigError
from companion.events import FenceArea
from companion.geometry import LocalFrame

FRAME = LocalFrame(47.0, 8.0, 400.0)
SQUARE = ((-100.0, -100.0), (-100.0, 100.0), (100.0, 100.0), (100.0, -100.0))
L_SHAPE = ((0.0, 0.0), (100.0, 0.0), (100.0, 40.0), (40.0, 40.0), (40.0, 100.0), (0.0, 100.0))


def area(inclusion: bool, *points: tuple[float, float], radius_m: float | None = None) -> FenceArea:
    """From metres north and east of the frame's origin."""
    corners = (FRAME.to_geodetic(n, e, 0.0) for n, e in points)
    return FenceArea(inclusion=inclusion, points=tuple(c[:2] for c in corners), radius_m=radius_m)


def path(*points: tuple[float, float]) -> Trajectory:
    return Trajectory([20.0 * i for i in range(len(points))], [(n, e, -50.0) for n, e in points])


def trouble(areas: Any, trajectory: Trajectory) -> str:
    with pytest.raises(ConfigError) as refused:
        walls_of(areas, FRAME, trajectory, 0.0)
    return str(refused.value)


def test_walls_of_polygons_and_circles() -> None:
    areas = [area(True, *SQUARE), area(False, (30.0, 40.0), radius_m=7.0)]
    walls = walls_of(areas, FRAME, path((0, 0), (50, 0)), 0.0)
    expected = [
        (0, k.IN_POLYGON, -100, -100, -100, 100, 0),
        (0, k.IN_POLYGON, -100, 100, 100, 100, 0),
        (0, k.IN_POLYGON, 100, 100, 100, -100, 0),
        (0, k.IN_POLYGON, 100, -100, -100, -100, 0),
        (1, k.OUT_OF_CIRCLE, 30, 40, 30, 40, 7),
    ]
    np.testing.assert_allclose(walls, expected, atol=1e-2)


def test_kinds() -> None:
    for inclusion, polygon, circle in (
        (True, k.IN_POLYGON, k.IN_CIRCLE),
        (False, k.OUT_OF_POLYGON, k.OUT_OF_CIRCLE),
    ):
        at = 0.0 if inclusion else 500.0
        areas = [area(inclusion, *SQUARE), area(inclusion, (0.0, 0.0), radius_m=90.0)]
        walls = walls_of(areas, FRAME, path((at, 0), (at, 10)), 0.0)
        assert k.Wall(*walls.T).kind.tolist() == [polygon] * 4 + [circle]


def test_no_fence() -> None:
    assert walls_of([], FRAME, path((0, 0), (1, 0)), 1.5).shape == k.NO_WALLS.shape


CROSSES = "crosses its border between waypoint[{}] and waypoint[{}]; at least 2.0 m are kept"


@pytest.mark.parametrize(
    ("kept", "points", "said"),
    [
        # To be stayed in.
        (area(True, *SQUARE), [(0, 0), (50, 0), (150, 0), (160, 0)], CROSSES.format(1, 2)),
        (area(True, *SQUARE), [(150, 0), (0, 0)], "begins outside of it"),
        (area(True, *SQUARE), [(0, 0), (98.5, 0)], "comes within 1.5 m of its border"),
        (area(True, *SQUARE), [(0, -99), (0, 0)], "comes within 1.0 m of its border between waypoint[0]"),
        (area(True, *L_SHAPE), [(80, 20), (20, 80)], CROSSES.format(0, 1)),
        (area(True, *L_SHAPE), [(20, 20), (39, 39), (20, 60)], "comes within 1.4 m"),
        (area(True, (0, 0), radius_m=50.0), [(0, 0), (40, 0), (60, 0)], CROSSES.format(1, 2)),
        (area(True, (0, 0), radius_m=50.0), [(60, 0), (0, 0)], "begins outside of it"),
        (area(True, (0, 0), radius_m=50.0), [(0, 0), (0, 49)], "comes within 1.0 m"),
        # To be stayed out of.
        (area(False, *SQUARE), [(-300, 0), (-200, 0), (0, 0)], CROSSES.format(1, 2)),
        (area(False, *SQUARE), [(0, 0), (-300, 0)], "begins in it"),
        (area(False, *SQUARE), [(-300, 101), (300, 101)], "comes within 1.0 m"),
        (area(False, *SQUARE), [(-101, 300), (-101, 99), (-300, 99)], "comes within 1.0 m"),
        (area(False, (0, 0), radius_m=50.0), [(-90, 0), (0, 0), (90, 0)], CROSSES.format(0, 1)),
        (area(False, (0, 0), radius_m=50.0), [(10, 0), (90, 0)], "begins in it"),
        (area(False, (0, 0), radius_m=50.0), [(-90, 51.5), (90, 51.5)], "comes within 1.5 m"),
        (area(False, *SQUARE), [(50, 151.4), (151.4, 50)], "comes within 1.0 m"),
        # Through what no waypoint lies in: thin, a corner cut, a round one beside the leg's middle.
        (area(False, (0, -90), (1, -90), (1, 90), (0, 90)), [(-80, 3), (80, -3)], CROSSES.format(0, 1)),
        (area(False, *SQUARE), [(-120, 60), (-60, 120)], CROSSES.format(0, 1)),
        (area(False, (0, 3), radius_m=4.0), [(-200, 0), (200, 0)], CROSSES.format(0, 1)),
        (area(True, *L_SHAPE), [(90, 10), (90, 30), (10, 90)], CROSSES.format(1, 2)),
    ],
)
def test_a_path_that_breaks_an_area_is_refused(kept: FenceArea, points: Any, said: str) -> None:
    far = area(False, (5000.0, 5000.0), radius_m=10.0)
    text = trouble([far, kept], path(*points))
    kind = "inclusion" if kept.inclusion else "exclusion"
    assert text.startswith(f"fence: area[1] ({kind}): the path ")
    assert said in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("kept", "points"),
    [
        (area(True, *SQUARE), [(0, 0), (97.9, 0), (97.9, 97.9), (-97.9, -97.9)]),
        (area(True, *L_SHAPE), [(90, 20), (20, 20), (20, 90)]),
        (area(True, (0, 0), radius_m=50.0), [(47.9, 0), (-47.9, 0), (0, 47.9)]),
        (area(False, *SQUARE), [(-300, 102.1), (300, 102.1)]),
        (area(False, *L_SHAPE), [(43, 300), (43, 43), (300, 43)]),
        (area(False, (0, 0), radius_m=50.0), [(-90, 52.1), (90, 52.1)]),
        # The line of the leg goes on through it, the leg does not.
        (area(False, (0, 0), radius_m=50.0), [(-200, 0), (-60, 0)]),
        (area(False, *SQUARE), [(-200, 0), (-103, 0)]),
    ],
)
def test_a_path_that_keeps_its_margin_is_let(kept: FenceArea, points: Any) -> None:
    walls = walls_of([kept], FRAME, path(*points), 0.0)
    assert len(walls) == len(kept.points)


@pytest.mark.parametrize("sigma_m", [0.0, 0.7, 1.5])
def test_the_margin_grows_with_the_own_error(sigma_m: float) -> None:
    """2 m and two standard deviations, from edges and from circles."""
    margin = 2.0 + 2.0 * sigma_m
    kinds = [(area(True, *SQUARE), 100.0), (area(False, (150.0, 0.0), radius_m=50.0), 100.0)]
    for kept, border in kinds:
        walls_of([kept], FRAME, path((0, 0), (border - margin - 0.05, 0)), sigma_m)
        with pytest.raises(ConfigError, match=f"; at least {margin:.1f} m are kept "):
            walls_of([kept], FRAME, path((0, 0), (border - margin + 0.05, 0)), sigma_m)


def test_heights_do_not_matter() -> None:
    """A fence is seen from above: the legs of a climb are judged by their ground track."""
    steep = Trajectory([0, 100, 200], [(-200, 0, 0), (-150, 0, -5000), (0, 0, -5000)])
    assert re.search(r"crosses .* waypoint\[1\] and waypoint\[2\]", trouble([area(False, *SQUARE)], steep))


def test_every_leg_against_a_dense_sample() -> None:
    """The verdict on random legs is that of 2000 points along each of them."""
    rng = np.random.default_rng(3)
    kinds = [
        area(inclusion, *points, radius_m=radius_m)
        for inclusion in (True, False)
        for points, radius_m in ((L_SHAPE, None), (SQUARE, None), (((20.0, 10.0),), 60.0))
    ]
    refused = 0
    for kept in kinds:
        corners = np.array([FRAME.to_ned(lat, lon, 400.0)[:2] for lat, lon in kept.points]) @ [1, 1j]
        for _ in range(60):
            a, b = rng.uniform(-160, 160, (2, 2)).tolist()
            z = np.linspace(complex(*a), complex(*b), 2000)
            if kept.radius_m is not None:
                inside = abs(z - corners[0]) < kept.radius_m
                rooms = abs(abs(z - corners[0]) - kept.radius_m)
            else:
                ends = np.roll(corners, -1)
                swept = np.angle((ends - z[:, None]) / (corners - z[:, None])).sum(axis=1)
                inside = abs(swept) > np.pi
                along = ((z[:, None] - corners) * (ends - corners).conj()).real / abs(ends - corners) ** 2
                foot = corners + np.clip(along, 0.0, 1.0) * (ends - corners)
                rooms = abs(z[:, None] - foot).min(axis=1)
            kept_whole = (inside == kept.inclusion).all()
            if abs(rooms.min() - k.FENCE_MARGIN_M) < 0.2 and kept_whole:
                continue  # too near for the sample to tell
            expected = kept_whole and rooms.min() > k.FENCE_MARGIN_M
            try:
                walls_of([kept], FRAME, path(tuple(a), tuple(b)), 0.0)
                let = True
            except ConfigError:
                let = False
                refused += 1
            assert let == expected, (kept, a, b)
    assert 100 < refused < 340
