"""Local frame against an independent implementation, and there and back."""

from __future__ import annotations

import itertools

import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.geometry import LocalFrame, between
from tests.support.place import HOME

near = st.floats(-20_000.0, 20_000.0)


@given(
    lat=st.floats(-89.0, 89.0),
    lon=st.floats(-180.0, 180.0),
    alt=st.floats(-400.0, 9000.0),
    north=near,
    east=near,
    down=st.floats(-5000.0, 5000.0),
)
def test_there_and_back(lat, lon, alt, north, east, down):
    frame = LocalFrame(lat, lon, alt)
    point = frame.to_geodetic(north, east, down)
    assert frame.to_ned(*point) == pytest.approx((north, east, down), abs=1e-4)


@given(d_lat=st.floats(-0.2, 0.2), d_lon=st.floats(-0.2, 0.2), alt=st.floats(-100.0, 4000.0))
def test_against_the_library(d_lat, d_lon, alt):
    point = HOME.lat_deg + d_lat, HOME.lon_deg + d_lon, alt
    expected = pymap3d.geodetic2ned(*point, HOME.lat_deg, HOME.lon_deg, HOME.alt_m)
    assert HOME.to_ned(*point) == pytest.approx(tuple(map(float, expected)), abs=1e-6)


@given(north=near, east=near, down=st.floats(-5000.0, 5000.0))
def test_the_place_of_the_tests_is_this_frame(north, east, down):
    frame = LocalFrame(HOME.lat_deg, HOME.lon_deg, HOME.alt_m)
    (lat, lon, alt), expected = HOME.to_geodetic(north, east, down), frame.to_geodetic(north, east, down)
    assert (lat, lon) == pytest.approx(expected[:2], abs=1e-10)
    assert alt == pytest.approx(expected[2], abs=1e-5)


def test_signs():
    frame = LocalFrame(47.0, 8.0, 400.0)
    north, east, down = frame.to_ned(47.001, 8.001, 450.0)
    assert north == pytest.approx(111.2, abs=0.3)
    assert east == pytest.approx(76.0, abs=0.3)
    assert down == pytest.approx(-50.0, abs=0.01)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_long_line_is_divided_across_the_antimeridian(side):
    first, second = between((10.0, 179.9 * side, 100.0), (10.1, -179.9 * side, 400.0), 10_000.0)
    assert first == pytest.approx((10.0 + 0.1 / 3, side * (180.0 - 0.1 / 3), 200.0))
    assert second == pytest.approx((10.0 + 0.2 / 3, -side * (180.0 - 0.1 / 3), 300.0))


def test_a_short_line_is_not_divided():
    here = (47.0, 8.0, 100.0)
    assert between(here, here, 10.0) == between(here, (47.0, 8.0, 900.0), 10.0) == []
    assert between(here, (47.00008, 8.0, 100.0), 10.0) == []


@given(lat=st.floats(-80.0, 80.0), north=st.floats(-0.5, 0.5), east=st.floats(-0.5, 0.5))
def test_pieces_of_a_line_are_not_divided_again(lat, north, east):
    ends = (lat, 8.0, 100.0), (lat + north, 8.0 + east, 400.0)
    line = [ends[0], *between(*ends, 5_000.0), ends[1]]
    assert all(between(a, b, 5_000.0) == [] for a, b in itertools.pairwise(line))
