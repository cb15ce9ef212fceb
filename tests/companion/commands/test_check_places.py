"""Fences and paths that are valid, but not where the vehicle is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from companion.commands.check_places import judge_heights, judge_places
from companion.commands.preflight import Preflight
from companion.config import Config, LimitsConfig, TrajectoryFile, Waypoint
from companion.events import FenceArea

HOME = 47.0, 8.0
CORNERS = ((46.99, 7.99), (46.99, 8.01), (47.01, 8.01), (47.01, 7.99))
SWAPPED = tuple((lon, lat) for lat, lon in CORNERS)
FIELD = tuple((lat + 0.05, lon) for lat, lon in CORNERS)
"""Beside the vehicle, 5 km away."""


def lines(judge: Callable[[Preflight], None]) -> list[tuple[str, str]]:
    found = Preflight()
    judge(found)
    assert all(bool(f.do) for f in found.findings)
    return [(f.light.value, f"{f.what}: {f.text}") for f in found.findings]


@pytest.mark.parametrize(
    ("area", "told"),
    [
        (FenceArea(inclusion=True, points=CORNERS), None),
        (FenceArea(inclusion=True, points=SWAPPED), "the vehicle is outside of it"),
        (FenceArea(inclusion=True, points=FIELD), "the vehicle is outside of it"),
        (FenceArea(inclusion=True, points=(HOME,), radius_m=200.0), None),
        (FenceArea(inclusion=True, points=((47.01, 8.0),), radius_m=200.0), "the vehicle is outside of it"),
        # Larger than what counts as far.
        (FenceArea(inclusion=True, points=((47.3, 8.0),), radius_m=50_000.0), None),
        (FenceArea(inclusion=True, points=((46.0, 7.0), (46.0, 9.0), (49.0, 8.0))), None),
        (FenceArea(inclusion=False, points=CORNERS), "the vehicle is in it"),
        (FenceArea(inclusion=False, points=FIELD), None),
        (FenceArea(inclusion=False, points=SWAPPED), "km from the vehicle, so it bounds nothing"),
        (FenceArea(inclusion=False, points=((0.82, 0.14),), radius_m=500.0), "km from the vehicle"),
        # 0.225 degrees of latitude are 25 km, of which the radius is the vehicle's.
        (FenceArea(inclusion=False, points=((47.225, 8.0),), radius_m=1_000.0), ": 24 km from the vehicle"),
        (FenceArea(inclusion=False, points=((47.225, 8.0),), radius_m=6_000.0), None),
    ],
)
def test_a_fence_that_is_elsewhere(
    make_config: Callable[..., Config], area: FenceArea, told: str | None
) -> None:
    config = msgspec.structs.replace(make_config(use="watch"), fence=(area,), path=None)
    found = lines(lambda preflight: judge_places(config, *HOME, preflight))
    assert len(found) == (told is not None)
    if told is not None:
        light, text = found[0]
        assert (light, told in text) == ("yellow", True), text


def path(altitude: str, *heights_m: float, at: tuple[float, float] = HOME) -> TrajectoryFile:
    points = tuple(
        Waypoint(t_s=60.0 * n, lat_deg=at[0], lon_deg=at[1], alt_m=h) for n, h in enumerate(heights_m)
    )
    return msgspec.convert({"altitude": altitude, "waypoint": msgspec.to_builtins(points)}, TrajectoryFile)


def test_a_path_that_is_elsewhere(make_config: Callable[..., Config]) -> None:
    config = msgspec.structs.replace(make_config(use="watch"), path=path("home", 30.0, 30.0))
    assert lines(lambda found: judge_places(config, *HOME, found)) == []
    config = msgspec.structs.replace(config, path=path("home", 30.0, 30.0, at=HOME[::-1]))
    ((light, text),) = lines(lambda found: judge_places(config, *HOME, found))
    assert light == "yellow"
    assert "km from the vehicle" in text


@pytest.mark.parametrize(
    ("north_deg", "told"), [(0.17, None), (0.225, "path: waypoint[0] is 25 km from the")]
)
def test_a_path_that_begins_far_away(
    make_config: Callable[..., Config], north_deg: float, told: str | None
) -> None:
    """Its other waypoints are with the vehicle."""
    near = path("home", 30.0, 30.0)
    first = msgspec.structs.replace(near.waypoint[0], lat_deg=HOME[0] + north_deg)
    flown = msgspec.structs.replace(near, waypoint=(first, near.waypoint[1]))
    config = msgspec.structs.replace(make_config(use="watch"), path=flown)
    found = lines(lambda preflight: judge_places(config, *HOME, preflight))
    assert [text.startswith(told or "-") for _, text in found] == [True] * (told is not None)


@pytest.mark.parametrize(
    ("flown", "limits", "told"),
    [
        (path("home", 30.0, 40.0), {}, None),
        (path("home", 0.0, 40.0), {}, None),
        (path("home", -20.0, 40.0), {}, "is 20 m below home, and so is the floor"),
        (path("home", -20.0, 40.0), {"floor_height_m": -30.0}, None),
        (path("home", 30.0, 40.0), {"floor_height_m": 35.0}, "limits.floor_height_m is 35 m"),
        (path("home", 30.0, 40.0), {"ceiling_height_m": 35.0}, "limits.ceiling_height_m is 35 m"),
        # Heights above home, written down as heights above the sea.
        (path("msl", 30.0, 40.0), {}, "is 458 m below home"),
        (path("msl", 518.0, 528.0), {"floor_height_m": 20.0, "ceiling_height_m": 60.0}, None),
        (path("geodetic", 30.0, 40.0), {}, None),
    ],
)
def test_a_path_at_the_wrong_height(
    make_config: Callable[..., Config], flown: TrajectoryFile, limits: dict[str, Any], told: str | None
) -> None:
    config = msgspec.structs.replace(make_config(use="watch"), path=flown, limits=LimitsConfig(**limits))
    found = lines(lambda preflight: judge_heights(config, 488.0, preflight))
    assert len(found) == (told is not None), found
    if told is not None:
        light, text = found[0]
        assert (light, told in text) == ("red", True), text


def test_heights_above_the_sea_are_not_judged_before_home_is_known(
    make_config: Callable[..., Config],
) -> None:
    config = msgspec.structs.replace(make_config(use="watch"), path=path("msl", 30.0, 40.0))
    assert lines(lambda found: judge_heights(config, None, found)) == []
