"""The configured path is checked before the flight: its speeds and the fence."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from companion.avoidance.path import check_path, local_path
from companion.config import Config, IdentityConfig, TrajectoryFile, Waypoint
from companion.errors import ConfigError
from companion.events import FenceArea, Firmware, Parameter, VehicleParameters
from companion.geometry import LocalFrame
from tests.support.place import HOME


def path(*points: tuple[float, float, float], altitude: Any = "msl") -> TrajectoryFile:
    """Waypoints: seconds, metres north, metres above home."""
    made = []
    for t_s, north_m, up_m in points:
        lat_deg, lon_deg, alt_m = HOME.to_geodetic(north_m, 0.0, -up_m)
        made.append(Waypoint(t_s=t_s, lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m))
    return TrajectoryFile(altitude=altitude, waypoint=tuple(made))


def configured(way: TrajectoryFile | None, *fence: FenceArea) -> Config:
    return msgspec.structs.replace(Config(identity=IdentityConfig(uas_id="OWN")), path=way, fence=fence)


LEVEL = path((0.0, 0.0, 50.0), (100.0, 300.0, 50.0))


def test_a_path_in_the_local_frame() -> None:
    """The file's altitudes are above a datum, which is itself above the sea."""
    frame = LocalFrame(HOME.lat_deg, HOME.lon_deg, HOME.alt_m)
    made = local_path(path((2.0, 0.0, 50.0), (102.0, 300.0, 60.0)), frame, 7.0)
    assert made.times_s == (2.0, 102.0)
    assert made.points_ned_m[0] == pytest.approx((0.0, 0.0, -57.0), abs=0.01)
    assert made.points_ned_m[1] == pytest.approx((300.0, 0.0, -67.0), abs=0.01)


@pytest.mark.parametrize("fence", [(), (FenceArea(inclusion=False, points=((0.0, 0.0),), radius_m=9.0),)])
def test_a_sound_path_and_none_at_all_pass(fence: tuple[FenceArea, ...]) -> None:
    check_path(configured(LEVEL, *fence), "x.toml")
    check_path(configured(None, *fence), "x.toml")


def test_too_fast_a_path_is_refused() -> None:
    fast = path((0.0, 0.0, 50.0), (50.0, 300.0, 50.0))
    with pytest.raises(
        ConfigError, match=r"^x.toml: flight.trajectory: leg .* is above limits.max_speed_mps"
    ):
        check_path(configured(fast), "x.toml")


def test_a_path_too_fast_for_the_vehicle_is_refused() -> None:
    slow = VehicleParameters(firmware=Firmware.ARDUPILOT, speed_mps=Parameter(name="WP_SPD", value=2.0))
    with pytest.raises(ConfigError, match="above the vehicle's WP_SPD 2"):
        check_path(configured(LEVEL), "x.toml", slow)


@pytest.mark.parametrize(("north_m", "forbidden"), [(150.0, True), (321.5, True), (322.5, False)])
def test_a_path_into_or_too_near_to_an_area_is_refused(north_m: float, forbidden: bool) -> None:
    """10 m around a place; 12 m are kept from it, because the receiver may be good to 5 m only."""
    lat_deg, lon_deg, _ = HOME.to_geodetic(north_m, 0.0, 0.0)
    area = FenceArea(inclusion=False, points=((lat_deg, lon_deg),), radius_m=10.0)
    if forbidden:
        with pytest.raises(ConfigError, match=r"^x.toml: flight.trajectory: fence: area\[0\]"):
            check_path(configured(LEVEL, area), "x.toml")
    else:
        check_path(configured(LEVEL, area), "x.toml")
