"""Geofences: validation of their areas, and reading them from a file.

Areas are horizontal polygons and circles, either inclusion or exclusion areas. They come from a file of
`[[area]]` tables or from the vehicle (`companion.autopilot.lists.fence`). The same checks apply to both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from companion.arrays import Integers
from companion.errors import ConfigError
from companion.events import FenceArea
from companion.geometry import LocalFrame, between
from companion.toml_reader import decode_toml

MIN_POINTS = 3
MAX_SPAN_DEG = 5.0
"""Largest distance of a corner from the first one, in latitude and in longitude. Within it the largest
products below fit 64 bits. A larger fence is most likely a typing error."""
MAX_RADIUS_M = 500_000.0
LONGEST_EDGE_M = 5_000.0
"""Longer edges of a polygon are divided."""
_MOST_PIECES = 1000
"""Most corners that are added to a polygon, so that its walls take no more time than a step has."""
_E7 = 1e7
"""Corners are compared exactly, as integers in units of 1e-7 deg (about 1 cm), as MAVLink carries them."""


class _Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all tables."""


class _Area(_Section, frozen=True):
    """One area of a fence file: either `points`, or `center` and `radius_m`."""

    inclusion: bool
    points: tuple[tuple[float, ...], ...] = ()
    center: tuple[float, ...] = ()
    radius_m: float | None = None

    def __post_init__(self) -> None:
        if not self.points and not self.center:
            raise ValueError("points: missing; give either points, or center and radius_m")
        if self.points and (self.center or self.radius_m is not None):
            raise ValueError("points: give either points, or center and radius_m, not both")
        if self.center and self.radius_m is None:
            raise ValueError("radius_m: missing; a circle needs center and radius_m")
        names = [f"points[{number}]" for number in range(len(self.points))]
        for name, place in zip(names or ["center"], self.points or [self.center], strict=True):
            if len(place) != 2:
                raise ValueError(f"{name}: {list(place)}: expected [latitude, longitude]")


class FenceFile(_Section, frozen=True):
    """A fence file: areas that the aircraft stays inside or outside of."""

    area: Annotated[tuple[_Area, ...], Meta(min_length=1)]


def load_fence(path: Path) -> tuple[FenceArea, ...]:
    """Read and check a fence file.

    Raises:
        ConfigError: names the file, the key and what is allowed.
    """
    areas = tuple(map(_area, decode_toml(path, FenceFile).area))
    try:
        check_areas(areas)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    return tuple(map(divided, areas))


def _area(table: _Area) -> FenceArea:
    points = tuple((lat_deg, lon_deg) for lat_deg, lon_deg in table.points or (table.center,))
    return FenceArea(inclusion=table.inclusion, points=points, radius_m=table.radius_m)


def divided(area: FenceArea) -> FenceArea:
    """The area with corners added on long edges, which autopilots draw straight in latitude and longitude."""
    if area.radius_m is not None:
        return area
    places = [(lat_deg, lon_deg, 0.0) for lat_deg, lon_deg in area.points]
    edges = list(zip(places, (*places[1:], places[0]), strict=True))
    around_m = sum(math.hypot(*LocalFrame(*a).to_ned(*b)[:2]) for a, b in edges)
    longest_m = max(LONGEST_EDGE_M, around_m / _MOST_PIECES)
    points: list[tuple[float, float]] = []
    for corner, following in edges:
        points.append(corner[:2])
        points += [place[:2] for place in between(corner, following, longest_m)]
    return FenceArea(inclusion=area.inclusion, points=tuple(points))


def check_areas(areas: Sequence[FenceArea]) -> None:
    """Refuse areas for which inside and outside are not defined.

    Raises:
        ConfigError: names the area (counted from 0), what is wrong in it and what is allowed.
    """
    for number, area in enumerate(areas):
        fault = fault_of(area)
        if fault is not None:
            raise ConfigError(f"area[{number}].{fault}")


def fault_of(area: FenceArea) -> str | None:
    """What is wrong with an area, starting with the file key that is concerned; None if nothing is wrong.

    A polygon has at least three corners, all distinct. Its edges meet only where one ends and the next
    begins.
    """
    circle = area.radius_m is not None
    for number, (lat_deg, lon_deg) in enumerate(area.points):
        name = "center" if circle else f"points[{number}]"
        # NaN fails these comparisons too.
        if not -90.0 <= lat_deg <= 90.0:
            return f"{name}: latitude {lat_deg}: allowed: -90 to 90"
        if not -180.0 <= lon_deg <= 180.0:
            return f"{name}: longitude {lon_deg}: allowed: -180 to 180"
    return _circle_fault(area) if circle else _polygon_fault(area)


def _circle_fault(area: FenceArea) -> str | None:
    if len(area.points) != 1:
        return f"center: {len(area.points)} points; a circle has one"
    if not 0.0 < (area.radius_m or 0.0) <= MAX_RADIUS_M:
        return f"radius_m: {area.radius_m}: allowed: more than 0, up to {MAX_RADIUS_M:g}"
    return None


def _polygon_fault(area: FenceArea) -> str | None:
    if len(area.points) < MIN_POINTS:
        return f"points: {len(area.points)} points; a polygon has at least {MIN_POINTS}"
    lat0, lon0 = area.points[0]
    corners = np.empty((len(area.points), 2), dtype=np.int64)
    seen: dict[tuple[int, int], int] = {}
    for number, (lat_deg, lon_deg) in enumerate(area.points):
        # Take the shorter way around the Earth in longitude.
        span = lat_deg - lat0, math.remainder(lon_deg - lon0, 360.0)
        if max(map(abs, span)) > MAX_SPAN_DEG:
            return f"points[{number}]: more than {MAX_SPAN_DEG:g} deg from points[0]"
        corner = round(span[0] * _E7), round(span[1] * _E7)
        same = seen.setdefault(corner, number)
        if same != number:
            closed = "; do not repeat the first corner at the end" if same == 0 else ""
            return f"points[{number}]: the same place as points[{same}]{closed}"
        corners[number] = corner
    crossing = _crossing(corners)
    if crossing is not None:
        a, b = crossing
        count = len(area.points)
        return (
            f"points: the edge from points[{a}] to points[{(a + 1) % count}] meets the one from "
            f"points[{b}] to points[{(b + 1) % count}]; edges may not cross or touch"
        )
    return None


def _crossing(corners: Integers) -> tuple[int, int] | None:
    """Find two edges of a polygon that meet elsewhere than at a common corner; None if there are none.

    Two segments meet if the ends of each lie on both sides of the other's line, or on it. Segments on one
    line meet if their extents overlap.

    Args:
        corners: corners of the polygon as integers, shape (K, 2).
    """
    count = len(corners)
    starts, ends = corners, np.roll(corners, -1, axis=0)
    low, high = np.minimum(starts, ends).T.copy(), np.maximum(starts, ends).T.copy()
    for a in range(count):
        p, q, after = starts[a], ends[a], (a + 1) % count
        # Adjacent edges share a corner. They meet elsewhere only if one runs back along the other.
        onward = ends[after]
        if _side(p, q, onward) == 0 and (q - p) @ (onward - q) < 0:
            return min(a, after), max(a, after)
        # Check every pair once: all later edges except the next one and, for the first edge, the last one.
        rest = slice(a + 2, count - (a == 0))
        overlap = (low[:, rest] <= high[:, a : a + 1]) & (low[:, a : a + 1] <= high[:, rest])
        near = a + 2 + np.flatnonzero(overlap[0] & overlap[1])
        r, s = starts[near], ends[near]
        meets = (_side(p, q, r) * _side(p, q, s) <= 0) & (_side(r, s, p) * _side(r, s, q) <= 0)
        for b in near[meets]:
            return a, int(b)
    return None


def _side(p: Integers, q: Integers, r: Integers) -> Integers:
    """Side of the line from p to q on which the point r lies: -1, 0 or 1, computed exactly."""
    along, to = q - p, r - p
    side: Integers = np.sign(along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0])
    return side
