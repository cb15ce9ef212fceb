"""Builds a geofence from the items that a vehicle holds (MAV_MISSION_TYPE_FENCE).

A polygon is a sequence of NAV_FENCE_POLYGON_VERTEX_* items, each with the polygon's vertex count in param 1.
A circle is one NAV_FENCE_CIRCLE_* item with its radius (m) in param 1. ArduPilot uses MAV_FRAME_GLOBAL and no
altitude, PX4 an _INT frame and the altitude that it was given. The areas of both have no height, so every
global frame is accepted. NAV_FENCE_RETURN_POINT is where ArduPilot flies after a breach; it is not an area
and is left out. Any other fault refuses the whole fence, because a partly understood fence is a different
fence.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.lists.list_download import GLOBAL_FRAMES
from companion.errors import PeerDataError
from companion.events import FenceArea, MissionItem
from companion.geofence import MIN_POINTS, divided, fault_of

_RETURN_POINT = mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT
_POLYGONS = {
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: True,
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: False,
}
_CIRCLES = {
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION: True,
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION: False,
}
"""MAV_CMD -> whether the vehicle must stay inside the area."""


def areas_from_items(items: Sequence[MissionItem]) -> tuple[FenceArea, ...]:
    """Areas of a downloaded fence, in its order.

    Raises:
        PeerDataError: names the faulty item (a polygon by its first one) and what is wrong.
    """
    return tuple(_areas(items))


def _areas(items: Sequence[MissionItem]) -> Iterator[FenceArea]:
    at = 0
    while at < len(items):
        item = items[at]
        if item.command == _RETURN_POINT:
            at += 1
            continue
        if item.command in _POLYGONS:
            members = items[at : at + _vertex_count(item)]
            _check_polygon(item, members)
            area = FenceArea(inclusion=_POLYGONS[item.command], points=tuple(map(_place, members)))
        elif item.command in _CIRCLES:
            members = items[at : at + 1]
            if item.params[0] is None:
                raise _refused(item, "radius is not a number")
            area = FenceArea(
                inclusion=_CIRCLES[item.command], points=(_place(item),), radius_m=item.params[0]
            )
        else:
            raise _refused(item, "not a fence item")
        fault = fault_of(area)
        if fault is not None:
            raise _refused(item, fault)
        yield divided(area)
        at += len(members)


def _vertex_count(item: MissionItem) -> int:
    count = item.params[0]
    if count is None or count < MIN_POINTS or count != int(count):
        raise _refused(item, f"vertex count {count}; a polygon has at least {MIN_POINTS}")
    return int(count)


def _check_polygon(first: MissionItem, members: Sequence[MissionItem]) -> None:
    count = first.params[0]
    for number, item in enumerate(members):
        if (item.command, item.params[0]) != (first.command, count):
            raise _refused(
                item, f"vertex {number} of item {first.seq}'s polygon has a different command or vertex count"
            )
    if len(members) != count:
        raise _refused(first, f"{len(members)} of {count:g} vertices; the fence ends before the polygon does")


def _place(item: MissionItem) -> tuple[float, float]:
    """Latitude and longitude of an item."""
    if item.frame not in GLOBAL_FRAMES:
        raise _refused(item, f"MAV_FRAME {item.frame} is not a global frame")
    if item.lat_deg is None or item.lon_deg is None:
        raise _refused(item, "latitude or longitude is missing")
    return item.lat_deg, item.lon_deg


def _refused(item: MissionItem, why: str) -> PeerDataError:
    entry = mavlink.enums["MAV_CMD"].get(item.command)
    name = f"MAV_CMD {item.command}" if entry is None else entry.name.removeprefix("MAV_CMD_NAV_")
    return PeerDataError(f"fence item {item.seq} ({name}): {why}")
