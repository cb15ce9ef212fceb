"""Findings of `companion check` about where the configured fence and path are, seen from the vehicle.

A fence with latitude and longitude exchanged, or in radians, is a valid fence somewhere else, and an area to
stay out of then bounds nothing. A path in a wrong altitude datum is a valid path under the ground.
"""

from __future__ import annotations

import math

from companion.avoidance import kernels
from companion.avoidance.walls import walls_of
from companion.commands.preflight import Preflight
from companion.config import Config
from companion.events import FenceArea
from companion.geometry import LocalFrame

FAR_M = 20_000.0
"""Beyond this distance from the vehicle, a place is most likely an error."""
_PLANE_M = 500_000.0
"""An area whose nearest corner is farther away cannot contain the vehicle, and its shape is not judged."""
_BELOW_M = 1.0
"""A path that lands may end this much below home."""
_SWAPPED = "check that latitude and longitude are in degrees and not exchanged"


def judge_places(config: Config, lat_deg: float, lon_deg: float, found: Preflight) -> None:
    """Report areas of the fence and a path that are far from the vehicle or do not contain it.

    Args:
        lat_deg, lon_deg: position of the vehicle.
    """
    frame = LocalFrame(lat_deg, lon_deg, 0.0)
    for number, area in enumerate(config.fence):
        kind = "inclusion" if area.inclusion else "exclusion"
        away_m = min(_away_m(frame, *corner) for corner in area.points) - (area.radius_m or 0.0)
        inside = away_m <= _PLANE_M and _contains(area, frame)
        if area.inclusion and not inside:
            text = f"area[{number}] ({kind}): the vehicle is outside of it"
            found.yellow("fence", text, f"{_SWAPPED}, or bring the vehicle to the place of the flight")
        elif not area.inclusion and inside:
            text = f"area[{number}] ({kind}): the vehicle is in it"
            found.yellow("fence", text, "take off elsewhere, or correct the fence")
        elif away_m > FAR_M and not inside:
            text = f"area[{number}] ({kind}): {away_m / 1000.0:.0f} km from the vehicle, so it bounds nothing"
            found.yellow("fence", text, _SWAPPED)
    if config.path is not None:
        first = config.path.waypoint[0]
        away_m = _away_m(frame, first.lat_deg, first.lon_deg)
        if away_m > FAR_M:
            text = f"waypoint[0] is {away_m / 1000.0:.0f} km from the vehicle"
            found.yellow("path", text, f"{_SWAPPED}, or bring the vehicle to the place of the flight")


def judge_heights(config: Config, home_alt_msl_m: float | None, found: Preflight) -> None:
    """Report a path that leaves floor or ceiling, or goes below home.

    Args:
        home_alt_msl_m: None: not known. Then, and for geodetic altitudes, only a path above home is judged.
    """
    path = config.path
    home_m = {"home": 0.0, "msl": home_alt_msl_m}.get(path.altitude) if path is not None else None
    if path is None or home_m is None:
        return
    low_m, high_m = (pick(w.alt_m for w in path.waypoint) - home_m for pick in (min, max))
    floor_m, ceiling_m = config.limits.floor_height_m, config.limits.ceiling_height_m
    if floor_m is not None and low_m < floor_m:
        text = f"its lowest point is {low_m:.0f} m above home; limits.floor_height_m is {floor_m:g} m"
        found.red("path", text, "raise the path, or lower the floor")
    if ceiling_m is not None and high_m > ceiling_m:
        text = f"its highest point is {high_m:.0f} m above home; limits.ceiling_height_m is {ceiling_m:g} m"
        found.red("path", text, "lower the path, or raise the ceiling")
    if low_m < -_BELOW_M and floor_m is None:
        text = f"its lowest point is {-low_m:.0f} m below home, and so is the floor"
        do = (
            f'check its altitude = "{path.altitude}"; where the ground is that low, set limits.floor_height_m'
        )
        found.red("path", text, do)


def _away_m(frame: LocalFrame, lat_deg: float, lon_deg: float) -> float:
    return math.hypot(*frame.to_ned(lat_deg, lon_deg, 0.0))


def _contains(area: FenceArea, frame: LocalFrame) -> bool:
    """Whether the origin of the frame is in an area."""
    walls = walls_of((area,), frame, None, 0.0)
    return bool(kernels.inside(walls, 0, len(walls), kernels.Point(0.0, 0.0)))
