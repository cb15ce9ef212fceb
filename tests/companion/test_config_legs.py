"""Long legs and fences of files follow the Earth as autopilots fly and draw them."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import pytest

from companion import config as configuration
from companion.avoidance.path import check_path, local_path
from companion.avoidance.trajectory import check_speeds
from companion.config import LimitsConfig, TrajectoryFile, Waypoint, level
from companion.geometry import LocalFrame

EAST = """altitude = "msl"
waypoint = [
  { t_s = 0.0, lat_deg = 47.0, lon_deg = 179.9, alt_m = 100.0 },
  { t_s = 10000.0, lat_deg = 47.0, lon_deg = -179.5, alt_m = 100.0 },
]
"""
"""45.6 km along a parallel, across the antimeridian, at 4.6 m/s."""
NORTH_OF_IT = """[[area]]
inclusion = true
points = [[47.000135, 179.8], [47.000135, -179.4], [46.9, -179.4], [46.9, 179.8]]
"""
"""The area's northern border is 15 m north of the path."""
KEYS = '[identity]\nuas_id = "A1"\n[flight]\ntrajectory = "t.toml"\n[limits]\nfence = "f.toml"\n'


@pytest.fixture
def file(tmp_path: Path) -> Path:
    for name, text in (("t.toml", EAST), ("f.toml", NORTH_OF_IT), ("c.toml", KEYS)):
        (tmp_path / name).write_text(text)
    return tmp_path / "c.toml"


def test_a_long_leg_keeps_its_height_and_its_parallel(file: Path) -> None:
    path = configuration.load(file).path
    assert path is not None
    first, last = path.waypoint[0], path.waypoint[-1]
    assert (first.lon_deg, last.lon_deg, last.t_s) == (179.9, -179.5, 10000.0)
    frame = LocalFrame(47.0, 179.9, 0.0)
    flown = local_path(path, frame, 0.0)
    for t_s in range(0, 10000, 100):
        lat_deg, _, alt_m = frame.to_geodetic(*flown.position(float(t_s)))
        assert alt_m == pytest.approx(100.0, abs=0.6)
        assert (lat_deg - 47.0) * 111_200.0 == pytest.approx(0.0, abs=0.6)


@pytest.mark.parametrize(("lat_deg", "to"), [(47.0, 0.3), (47.0, -0.3), (-68.0, 0.3), (68.0, 0.6)])
def test_a_long_leg_at_a_limit_keeps_it_on_all_pieces(lat_deg: float, to: float) -> None:
    """A degree of longitude is up to 1.3 % shorter at the far end of these diagonal legs."""
    start, end = (lat_deg, 8.0, 100.0), (lat_deg + to, 8.7, 900.0)
    north, east, _ = LocalFrame(*start).to_ned(*end)
    seconds = math.hypot(north, east, 800.0) / 20.0
    path = TrajectoryFile(
        altitude="msl",
        waypoint=tuple(
            Waypoint(t_s=t_s, lat_deg=lat, lon_deg=lon, alt_m=alt)
            for t_s, (lat, lon, alt) in ((0.0, start), (seconds, end))
        ),
    )
    flown = local_path(level(path), LocalFrame(*start), 0.0)
    check_speeds(flown, LimitsConfig(max_speed_mps=20.0))
    climbs = [(b.alt_m - a.alt_m) / (b.t_s - a.t_s) for a, b in itertools.pairwise(level(path).waypoint)]
    assert climbs == pytest.approx([800.0 / seconds] * len(climbs), rel=1e-6)


def test_a_long_leg_within_a_fence_is_checked_where_it_is_flown(file: Path) -> None:
    """Straight in the local frame it would run 44 m nearer to the pole halfway, beyond the border."""
    check_path(configuration.load(file), "c.toml")


def test_a_resolved_configuration_is_not_divided_again(file: Path) -> None:
    loaded = configuration.load(file)
    resolved = file.with_name("resolved.toml")
    resolved.write_bytes(configuration.dump(loaded))
    assert configuration.load(resolved) == loaded


def test_pieces_of_a_very_long_leg_are_not_divided_again(file: Path) -> None:
    """Of these 220 km, the pieces at the southern end are 2 % longer than the mean."""
    far = EAST.replace("47.0, lon_deg = 179.9", "68.55, lon_deg = 10.0")
    (file.parent / "t.toml").write_text(far.replace("47.0, lon_deg = -179.5", "67.2, lon_deg = 13.8"))
    file.write_text(KEYS.partition("[limits]")[0])
    path = configuration.load(file).path
    assert path is not None
    assert level(path) == path
    assert len(path.waypoint) > 40
