"""Demand: densities, patterns, and files of other projects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.config import AvoidanceConfig
from companion.errors import ConfigError
from ground_tools.city.flights import Wish, flights_of, largest_number_in_the_air
from ground_tools.city.traffic import intentions
from ground_tools.city.traffic.demand import HIGHEST_M, LOWEST_M, PAD_M, PATTERNS, Demand, draw

INTENTIONS = """00:00:00,D1,MP20,00:10:00,"(16.30, 48.20)","(16.32, 48.20)",1,,,,,,
00:00:00,D2,MP30,00:10:30,"(16.32, 48.20)","(16.30, 48.20)",2,,,,,,
00:00:00,D3,MP30,09:00:00,"(16.32, 48.20)","(16.30, 48.20)",2,,,,,,
"""
SCENARIO = """00:00:00.00>CRE A1,M600,48.20,16.30,90,300,20
00:00:00.00>A1 ADDWPT 48.20,16.31
00:00:05.00>CRE A2,M600,48.20,16.31,270,300,20
00:00:05.00>A2 ADDWPT 48.20,16.30
"""


def in_the_air(wishes: list[Wish], at_s: float) -> int:
    return sum(w.depart_s <= at_s < w.depart_s + w.times[-1] for w in wishes)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_the_density_is_the_requested_one(pattern: str) -> None:
    demand = Demand(pattern=pattern, per_km2=5.0, north_m=6000.0, east_m=4000.0)  # type: ignore[arg-type]
    wishes = draw(demand, 300.0, 1)
    numbers = [in_the_air(wishes, at_s) for at_s in (5.0, 100.0, 200.0, 295.0)]
    assert np.mean(numbers) == pytest.approx(demand.aircraft, rel=0.25)
    speeds = [
        float((np.linalg.norm(np.diff(w.points, axis=0), axis=1) / np.diff(w.times)).max()) for w in wishes
    ]
    assert max(speeds) <= 0.75 * demand.speed_mps + 1e-9
    heights = np.concatenate([-w.points[:, 2] for w in wishes])
    assert heights.min() >= PAD_M - 1e-9
    assert heights.max() <= HIGHEST_M + 1e-9
    assert all(w.points[-1, 2] == pytest.approx(-PAD_M) for w in wishes)


def test_layers_follow_the_direction_of_flight() -> None:
    wishes = draw(Demand(pattern="doorsteps", north_m=3000.0, east_m=3000.0), 60.0, 2)
    for wish in (w for w in wishes if w.depart_s > 0.0):
        way = wish.points[-1] - wish.points[0]
        layer = int(4.0 * (np.arctan2(way[1], way[0]) % (2.0 * np.pi)) / (2.0 * np.pi))
        assert -wish.points[1, 2] == pytest.approx(LOWEST_M + 20.0 * layer)


def test_the_same_seed_draws_the_same_flights() -> None:
    demand = Demand(north_m=2000.0, east_m=2000.0)
    first, second, other = (draw(demand, 60.0, seed) for seed in (3, 3, 4))
    assert all(np.array_equal(a.points, b.points) for a, b in zip(first, second, strict=True))
    assert [w.depart_s for w in first] != [w.depart_s for w in other]


def test_flights_are_sorted_and_counted() -> None:
    path = np.array([0.0, 10.0]), np.array([[0.0, 0.0, -50.0], [50.0, 0.0, -50.0]])
    flights = flights_of([Wish(t, *path, 10.0) for t in (30.0, 0.0, 5.0)], AvoidanceConfig())
    assert flights.depart_s.tolist() == [0.0, 5.0, 30.0]
    assert largest_number_in_the_air(flights) == 2
    assert largest_number_in_the_air(flights_of([], AvoidanceConfig())) == 0
    with pytest.raises(ConfigError, match="do not rise"):
        flights_of([Wish(0.0, path[0][::-1].copy(), path[1], 10.0)], AvoidanceConfig())


def test_flight_intentions_of_metropolis_are_flown(tmp_path: Path) -> None:
    file = tmp_path / "intentions.csv"
    file.write_text(INTENTIONS)
    wishes = intentions.read(file, 600.0, 120.0, 1)
    assert [w.depart_s for w in wishes] == [0.0, 30.0]
    assert all(w.points[0, 2] == w.points[-1, 2] == -PAD_M for w in wishes)
    assert wishes[0].points[1, 2] == wishes[0].points[2, 2] < -LOWEST_M + 1e-9
    with pytest.raises(ConfigError, match="none of its 3 aircraft departs"):
        intentions.read(file, 50_000.0, 60.0, 1)


def test_a_scenario_of_bluesky_is_flown(tmp_path: Path) -> None:
    file = tmp_path / "two.scn"
    file.write_text(SCENARIO)
    first, second = intentions.read(file, 0.0, 60.0, 1)
    assert (first.depart_s, second.depart_s) == (0.0, 5.0)
    assert first.points[0, 2] == pytest.approx(-91.44, abs=0.1)
    assert np.linalg.norm(first.points[-1] - second.points[0]) < 5.0
    assert first.speed_mps > 10.0
