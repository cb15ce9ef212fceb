from __future__ import annotations

import itertools
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.avoidance import kernels as k
from companion.avoidance.walls import walls_of
from companion.errors import ConfigError
from companion.events import FenceArea
from companion.geofence import check_areas, divided, fault_of, load_fence
from companion.geometry import LocalFrame

SQUARE = ((47.0, 8.0), (47.01, 8.0), (47.01, 8.01), (47.0, 8.01))
EXAMPLE = Path(__file__).parents[3] / "config" / "fence.toml"


def polygon(*points: tuple[float, float]) -> FenceArea:
    return FenceArea(inclusion=True, points=points)


def circle(radius_m: float, *points: tuple[float, float]) -> FenceArea:
    return FenceArea(inclusion=False, points=points or ((47.0, 8.0),), radius_m=radius_m)


# ---------------------------------------------------------------- areas

GOOD = [
    polygon(*SQUARE),
    polygon(*reversed(SQUARE)),
    polygon(*SQUARE[:3]),
    # A dent, whose edges are not those of the hull.
    polygon(*SQUARE[:3], (47.005, 8.002), (47.0, 8.01)),
    # A corner in the middle of a straight side.
    polygon((47.0, 8.0), (47.005, 8.0), *SQUARE[1:]),
    # Across the antimeridian.
    polygon((10.0, 179.99), (10.01, 179.99), (10.01, -179.99), (10.0, -179.99)),
    # Down to the resolution of MAVLink.
    polygon((47.0, 8.0), (47.0000001, 8.0), (47.0, 8.0000001)),
    circle(0.5),
    circle(500_000.0),
]


@pytest.mark.parametrize("area", GOOD)
def test_sound_areas(area: FenceArea) -> None:
    assert fault_of(area) is None


BAD = [
    (polygon(), "points: 0 points"),
    (polygon(*SQUARE[:2]), "points: 2 points; a polygon has at least 3"),
    (polygon((91.0, 8.0), *SQUARE), "points[0]: latitude 91.0: allowed: -90 to 90"),
    (polygon(*SQUARE, (47.0, 180.1)), "points[4]: longitude 180.1"),
    (polygon(*SQUARE, (math.nan, 8.0)), "points[4]: latitude nan"),
    (polygon(*SQUARE, (47.0, math.inf)), "points[4]: longitude inf"),
    (polygon(*SQUARE, SQUARE[0]), "points[4]: the same place as points[0]; do not repeat the first corner"),
    (polygon(*SQUARE[:3], SQUARE[1], SQUARE[3]), "points[3]: the same place as points[1]"),
    (polygon(*SQUARE[:2], (47.01, 13.1)), "points[2]: more than 5 deg from points[0]"),
    (polygon(*SQUARE[:2], (52.1, 8.0)), "points[2]: more than 5 deg"),
    # A bow tie.
    (
        polygon(SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]),
        "points: the edge from points[0] to points[1] meets the one from points[2] to points[3]",
    ),
    # The last edge crosses.
    (
        polygon((47.0, 8.0), (47.0, 8.02), (47.01, 8.02), (47.01, 8.01), (46.99, 8.01)),
        "points: the edge from points[0] to points[1] meets the one from points[3] to points[4]",
    ),
    # A corner on another edge.
    (polygon(*SQUARE[:3], (47.005, 8.0), SQUARE[3]), "points: the edge from points[0] to points[1] meets"),
    (
        polygon((47.0, 8.005), (46.99, 8.01), (47.0, 8.02), (47.0, 8.0), (47.01, 8.005)),
        "points: the edge from points[0] to points[1] meets the one from points[2] to points[3]",
    ),
    # There and back again: no area at all.
    (
        polygon((47.0, 8.0), (47.01, 8.0), (47.005, 8.0)),
        "points: the edge from points[0] to points[1] meets the one from points[1] to points[2]",
    ),
    # A spike, and one at the first corner.
    (
        polygon(*SQUARE[:2], (47.02, 8.0), (47.015, 8.0), *SQUARE[2:]),
        "points: the edge from points[1] to points[2] meets the one from points[2] to points[3]",
    ),
    (
        polygon((47.0, 8.0), (47.01, 8.0), (47.01, 8.01), (47.005, 8.01), (47.005, 8.0)),
        "points: the edge from points[0] to points[1] meets the one from points[3] to points[4]",
    ),
    (circle(0.0), "radius_m: 0.0: allowed: more than 0"),
    (circle(-1.0), "radius_m: -1.0"),
    (circle(math.nan), "radius_m: nan"),
    (circle(math.inf), "radius_m: inf"),
    (circle(5.0, (91.0, 0.0)), "center: latitude 91.0"),
    (circle(5.0, *SQUARE), "center: 4 points; a circle has one"),
]


@pytest.mark.parametrize(("area", "fault"), BAD)
def test_faults_name_the_corner(area: FenceArea, fault: str) -> None:
    said = fault_of(area)
    assert said is not None
    assert said.startswith(fault)
    with pytest.raises(ConfigError, match=r"^area\[1\]\."):
        check_areas([GOOD[0], area])


def meet(p: complex, q: complex, r: complex, s: complex) -> bool:
    """Segments pq and rs have a common point: by solving for it, in exact whole numbers."""

    def cross(a: complex, b: complex) -> int:
        return int(a.real) * int(b.imag) - int(a.imag) * int(b.real)

    along, other, between = q - p, s - r, r - p
    below = cross(along, other)
    if below:
        t, u = cross(between, other), cross(between, along)
        return 0 <= t * below <= below * below and 0 <= u * below <= below * below
    if cross(between, along):
        return False

    def dot(a: complex) -> int:
        return int(a.real) * int(along.real) + int(a.imag) * int(along.imag)

    ends = sorted((dot(r - p), dot(s - p)))
    return ends[0] <= dot(along) and ends[1] >= 0


@given(
    st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=3, max_size=8, unique=True),
)
def test_polygons_on_a_small_grid(corners: list[tuple[int, int]]) -> None:
    """Where many corners fall on edges; every pair of edges is solved for."""
    count = len(corners)
    z = [complex(*corner) for corner in corners]
    edges = [(z[k], z[(k + 1) % count]) for k in range(count)]
    simple = True
    for a, b in itertools.combinations(range(count), 2):
        (p, q), (r, s) = edges[a], edges[b]
        if b - a == 1 or (a == 0 and b == count - 1):
            shared, one, two = (q, p, s) if b - a == 1 else (p, q, r)
            u, v = one - shared, two - shared
            turned = int(u.real) * int(v.imag) - int(u.imag) * int(v.real)
            ahead = int(u.real) * int(v.real) + int(u.imag) * int(v.imag)
            simple = simple and not (turned == 0 and ahead > 0)
        else:
            simple = simple and not meet(p, q, r, s)
    fault = fault_of(polygon(*((47.0 + n * 1e-3, 8.0 + e * 1e-3) for n, e in corners)))
    assert (fault is None) == simple


# ---------------------------------------------------------------- long edges


@pytest.mark.parametrize("lon_deg", [8.0, 180.0, -180.0])
@pytest.mark.parametrize("inclusion", [True, False])
def test_a_long_edge_is_straight_in_latitude_and_longitude(inclusion: bool, lon_deg: float) -> None:
    """As autopilots draw it. Straight in the local frame, it was 53 m farther north halfway along."""
    west, east = (math.remainder(lon_deg + side * 0.33, 360.0) for side in (-1.0, 1.0))
    corners = (47.4, west), (47.4, east), (47.2, east), (47.2, west)
    area = divided(FenceArea(inclusion=inclusion, points=corners))
    assert fault_of(area) is None
    frame = LocalFrame(47.39, lon_deg, 500.0)
    walls = walls_of([area], frame, None, 0.0)
    for north_m, inside in ((-1.0, True), (1.0, False)):
        north, east_m, _ = frame.to_ned(47.4 + north_m / 111_200.0, lon_deg, 500.0)
        assert k.inside(walls, 0, len(walls), k.Point(north, east_m)) == inside


@pytest.mark.parametrize("area", [area for area in GOOD if area.radius_m != 500_000.0])
def test_areas_without_long_edges_are_kept_as_they_are(area: FenceArea) -> None:
    assert divided(area) == area


def test_the_largest_polygon_gets_a_bounded_number_of_corners() -> None:
    """Its edges run to and fro between its centre and its border."""
    count = 2000
    ring = [(2.4 if n % 2 else 0.1, 2.0 * math.pi * n / count) for n in range(count)]
    star = polygon(*((47.0 + r * math.cos(angle), 8.0 + r * math.sin(angle)) for r, angle in ring))
    assert fault_of(star) is None
    assert len(divided(star).points) <= count + 1000 + count


# ---------------------------------------------------------------- files


def test_the_example() -> None:
    kept_in, kept_out = load_fence(EXAMPLE)
    assert (kept_in.inclusion, len(kept_in.points), kept_in.radius_m) == (True, 4, None)
    assert kept_out == FenceArea(inclusion=False, points=((47.3978, 8.5468),), radius_m=25.0)


POINTS = "points = [[47.0, 8.0], [47.01, 8.0], [47.01, 8.01]]"


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "area: missing"),
        ("area = []", "area: one table for each area is needed"),
        ("[area]\ninclusion = true", "area: one table for each area is needed: write [[area]]"),
        ("[[area]]\n" + POINTS, "area[0].inclusion: missing"),
        ("[[area]]\ninclusion = 1\n" + POINTS, "area[0].inclusion: 1: expected true or false"),
        ("[[area]]\ninclusion = true", "area[0].points: missing; give either points, or center and radius_m"),
        ("[[area]]\ninclusion = true\nradius_m = 3.0", "area[0].points: missing"),
        ("[[area]]\ninclusion = true\nradius_m = 3.0\n" + POINTS, "area[0].points: give either points"),
        (
            "[[area]]\ninclusion = true\ncenter = [47.0, 8.0]",
            "area[0].radius_m: missing; a circle needs center and radius_m",
        ),
        ("[[area]]\ninclusion = true\ncentre = [47.0, 8.0]", "area[0].centre: unknown key"),
        (
            "[[area]]\ninclusion = true\npoints = [[47.0, 8.0], [47.0]]",
            "area[0].points[1]: [47.0]: expected [latitude, longitude]",
        ),
        (
            "[[area]]\ninclusion = true\ncenter = [47.0, 8.0, 9.0]\nradius_m = 3.0",
            "area[0].center: [47.0, 8.0, 9.0]: expected [latitude, longitude]",
        ),
        (
            '[[area]]\ninclusion = true\npoints = [[47.0, "8.0"]]',
            "area[0].points[0][1]: '8.0': expected a number",
        ),
        ("[[area]]\ninclusion = true\npoints = []", "area[0].points: missing"),
        ("[[area]]\ninclusion = true\npoints = 5", "area[0].points: 5: expected a list"),
        ("[[area]]\ninclusion = true\npoints = [[47.0, nan]]", "area[0].points[0][1]: nan is not a finite"),
        ("[[area]]\ninclusion = true\npoints = [[47.0, 8.0]]", "area[0].points: 1 points"),
        (
            "[[area]]\ninclusion = true\ncenter = [47.0, 8.0]\nradius_m = inf",
            "area[0].radius_m: inf is not a finite",
        ),
        (
            f"[[area]]\ninclusion = true\n{POINTS}\n"
            "[[area]]\ninclusion = false\ncenter = [97.0, 8.0]\nradius_m = 1.0",
            "area[1].center: latitude 97.0",
        ),
        ("[[area]", "not valid TOML"),
    ],
)
def test_files_are_refused_by_key(tmp_path: Path, text: str, fault: str) -> None:
    path = tmp_path / "fence.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as refused:
        load_fence(path)
    said = str(refused.value)
    assert said.startswith(f"{path}: ")
    assert fault in said
    assert "\n" not in said


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_fence(tmp_path / "none.toml")


def test_long_edges_of_a_file_are_divided(tmp_path: Path) -> None:
    path = tmp_path / "fence.toml"
    path.write_text("[[area]]\ninclusion = true\npoints = [[47.4, 8.0], [47.4, 8.3], [47.39, 8.0]]")
    (area,) = load_fence(path)
    assert area.points[:2] == ((47.4, 8.0), (47.4, pytest.approx(8.06)))
