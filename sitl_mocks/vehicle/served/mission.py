"""The stored mission and fence, and the MAVLink mission protocol for upload and download.

A new list replaces the old one only when its last item has arrived. Missing items of an upload are requested
again; after a timeout the upload is dropped. ArduPilot keeps home as item 0 of its mission and requests items
with MISSION_REQUEST. PX4 has no home item and uses MISSION_REQUEST_INT. An ArduPilot that is receiving a list
refuses to send it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.lists.list_download import GLOBAL_FRAMES
from companion.autopilot.wire import MavlinkMessage
from companion.errors import ConfigError
from companion.events import FenceArea, MissionItem
from companion.geometry import LocalFrame
from sitl_mocks.vehicle.firmware.behaviour import Manners

MAX_ITEMS = 700
NO_PLACE = 0x7FFFFFFF
"""x or y of an item without a position of its own; NaN where positions are floats."""
_MISSION = int(mavlink.MAV_MISSION_TYPE_MISSION)
_FENCE = int(mavlink.MAV_MISSION_TYPE_FENCE)
NAV_COMMANDS = frozenset(
    {
        mavlink.MAV_CMD_NAV_WAYPOINT,
        mavlink.MAV_CMD_NAV_LOITER_UNLIM,
        mavlink.MAV_CMD_NAV_LOITER_TIME,
        mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH,
        mavlink.MAV_CMD_NAV_LAND,
        mavlink.MAV_CMD_NAV_TAKEOFF,
        mavlink.MAV_CMD_NAV_DELAY,
    }
)
_PLACED_COMMANDS = NAV_COMMANDS - {
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH,
    mavlink.MAV_CMD_NAV_LAND,
    mavlink.MAV_CMD_NAV_DELAY,
}
VERTICES = {
    True: mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    False: mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
}
CIRCLES = {
    True: mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION,
    False: mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION,
}
_FENCE_COMMANDS = {mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT, *VERTICES.values(), *CIRCLES.values()}
_FRAMES = GLOBAL_FRAMES | {int(mavlink.MAV_FRAME_MISSION)}


@dataclass(frozen=True, slots=True)
class StoredItem:
    """One item in the form of MISSION_ITEM_INT: params 1-4, x and y in 1e-7 deg, z in m."""

    command: int
    frame: int
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float
    autocontinue: int = 1

    @property
    def placed(self) -> bool:
        """Whether the item has a latitude and longitude. 0, 0 and NO_PLACE mean the present position."""
        return (self.x, self.y) != (0, 0) and NO_PLACE not in (self.x, self.y)


@dataclass(slots=True)
class _Upload:
    link: int
    partner: tuple[int, int]
    count: int
    items: list[StoredItem] = field(default_factory=list)
    last_heard_s: float = 0.0
    last_asked_s: float = 0.0


def stored(item: MissionItem) -> StoredItem:
    """Convert a companion's mission item to its stored form."""
    p1, p2, p3, p4 = (math.nan if value is None else value for value in item.params)
    x, y = (NO_PLACE if v is None else round(v * 1e7) for v in (item.lat_deg, item.lon_deg))
    z = math.nan if item.alt_m is None else item.alt_m
    return StoredItem(item.command, item.frame, (p1, p2, p3, p4), x, y, z)


def home_item(home: LocalFrame) -> StoredItem:
    """Home as ArduPilot reports it: mission item 0."""
    return StoredItem(
        mavlink.MAV_CMD_NAV_WAYPOINT,
        mavlink.MAV_FRAME_GLOBAL,
        (0.0, 0.0, 0.0, 0.0),
        round(home.lat_deg * 1e7),
        round(home.lon_deg * 1e7),
        home.alt_m,
    )


def stored_fence(areas: tuple[FenceArea, ...], manners: Manners) -> tuple[StoredItem, ...]:
    """Convert a fence to its stored form."""
    frame = manners.fence_frames[mavlink.MAV_FRAME_GLOBAL]
    items = []
    for area in areas:
        if area.radius_m is None:
            command, size = VERTICES[area.inclusion], float(len(area.points))
        else:
            command, size = CIRCLES[area.inclusion], area.radius_m
        for lat, lon in area.points:
            params = (size, 0.0, 0.0, 0.0)
            items.append(StoredItem(command, frame, params, round(lat * 1e7), round(lon * 1e7), 0.0))
    return tuple(items)


class MissionBook:
    """The items of one list and the state of its upload. `revision` counts the replacements of the list.

    Args:
        manners: behaviour of the firmware.
        home: home item of a mission, which ArduPilot stores as item 0. None makes the list a fence.
        items: items stored from the start, without the home item.
    """

    def __init__(self, manners: Manners, home: StoredItem | None, items: tuple[StoredItem, ...]) -> None:
        self.home = home
        self.kind = _FENCE if home is None else _MISSION
        self.revision = 0
        self.loaded_s = -math.inf
        self.requested_seq: int | None = None
        """Item requested by MISSION_SET_CURRENT. The vehicle resets it to None when it jumps there."""
        self.current_seq = 0
        """Sequence number of the item being flown, set by the vehicle."""
        self.texts: list[tuple[int, str]] = []
        self._manners = manners
        self._upload: _Upload | None = None
        self.items: tuple[StoredItem, ...] = ()
        self._home_first = home if manners.home_is_item_zero else None
        if items:
            self.items = items if self._home_first is None else (self._home_first, *items)

    @property
    def first_seq(self) -> int:
        """Sequence number of the first item that is flown."""
        return 0 if self._home_first is None else 1

    @property
    def receiving(self) -> bool:
        """Whether an upload is in progress."""
        return self._upload is not None

    @property
    def flown_count(self) -> int:
        """Number of items to fly."""
        return max(len(self.items) - self.first_seq, 0)

    def handle(self, message: MavlinkMessage, now_s: float, link: int) -> list[MavlinkMessage]:
        """Handle one mission message addressed to this vehicle. Return the answers for the same link."""
        handler = {
            "MISSION_REQUEST_LIST": self._list,
            "MISSION_REQUEST": self._request,
            "MISSION_REQUEST_INT": self._request,
            "MISSION_COUNT": self._count,
            "MISSION_ITEM": self._item,
            "MISSION_ITEM_INT": self._item,
            "MISSION_CLEAR_ALL": self._clear,
            "MISSION_SET_CURRENT": self._set_current,
        }.get(message.get_type())
        if handler is None:
            return []
        partner = (message.get_srcSystem(), message.get_srcComponent())
        return handler(message, partner, now_s, link)

    def tick(self, now_s: float) -> tuple[int, MavlinkMessage] | None:
        """Request a missing item again, or drop the upload. Return the link and the message to send on it."""
        upload = self._upload
        if upload is None:
            return None
        if now_s - upload.last_heard_s > self._manners.upload_timeout_s:
            self._upload = None
            name = "Mission" if self.kind == _MISSION else "Fence"
            self.texts.append((int(mavlink.MAV_SEVERITY_WARNING), f"{name} upload timeout"))
            return upload.link, self._ack(upload.partner, mavlink.MAV_MISSION_OPERATION_CANCELLED)
        if now_s - upload.last_asked_s >= self._manners.upload_retry_s:
            return upload.link, self._ask(upload, now_s)
        return None

    def drop_upload(self) -> None:
        """Drop an upload in progress."""
        self._upload = None

    def _list(
        self, message: MavlinkMessage, partner: tuple[int, int], now_s: float, link: int
    ) -> list[MavlinkMessage]:
        if self._upload is not None:
            return [self._ack(partner, mavlink.MAV_MISSION_DENIED)]
        return [mavlink.MAVLink_mission_count_message(*partner, len(self.items), self.kind)]

    def _request(
        self, message: MavlinkMessage, partner: tuple[int, int], now_s: float, link: int
    ) -> list[MavlinkMessage]:
        seq, kind = message.seq, self.kind
        if self._upload is not None:
            return [self._ack(partner, mavlink.MAV_MISSION_DENIED)]
        if seq >= len(self.items):
            return [self._ack(partner, mavlink.MAV_MISSION_INVALID_SEQUENCE)]
        item = self.items[seq] if self._home_first is None or seq else self._home_first
        current = int(self._manners.marks_current_item and self.kind == _MISSION and seq == self.current_seq)
        head = (*partner, seq, item.frame, item.command, current, item.autocontinue, *item.params)
        if message.get_type() == "MISSION_REQUEST_INT":
            return [mavlink.MAVLink_mission_item_int_message(*head, item.x, item.y, item.z, kind)]
        scale = 1e-7 if item.frame in GLOBAL_FRAMES else 1.0
        return [mavlink.MAVLink_mission_item_message(*head, item.x * scale, item.y * scale, item.z, kind)]

    def _count(
        self, message: MavlinkMessage, partner: tuple[int, int], now_s: float, link: int
    ) -> list[MavlinkMessage]:
        if message.count > MAX_ITEMS:
            return [self._ack(partner, mavlink.MAV_MISSION_NO_SPACE)]
        if self._upload is not None and self._upload.partner != partner:
            return [self._ack(partner, mavlink.MAV_MISSION_DENIED)]
        self._upload = _Upload(link, partner, message.count, last_heard_s=now_s)
        if message.count == 0:
            return [self._finish(self._upload, now_s)]
        return [self._ask(self._upload, now_s)]

    def _item(
        self, message: MavlinkMessage, partner: tuple[int, int], now_s: float, link: int
    ) -> list[MavlinkMessage]:
        upload = self._upload
        if upload is None or upload.partner != partner:
            return [self._ack(partner, mavlink.MAV_MISSION_ERROR)]
        upload.last_heard_s = now_s
        if message.seq != len(upload.items):
            repeated = message.seq == len(upload.items) - 1
            if self._manners.mission_request_int or repeated:
                return [self._ask(upload, now_s)]
            return [self._ack(partner, mavlink.MAV_MISSION_INVALID_SEQUENCE)]
        item = _from_wire(message)
        fault = fault_of(item) if self.kind == _MISSION else fence_fault_of(item, self._manners)
        if fault is not None:
            self._upload = None
            return [self._ack(partner, fault)]
        upload.items.append(item if self.kind == _MISSION else _as_fenced(item, self._manners))
        if len(upload.items) < upload.count:
            return [self._ask(upload, now_s)]
        return [self._finish(upload, now_s)]

    def _clear(
        self, message: MavlinkMessage, partner: tuple[int, int], now_s: float, link: int
    ) -> list[MavlinkMessage]:
        self._upload = None
        self._replace((), now_s)
        return [self._ack(partner, mavlink.MAV_MISSION_ACCEPTED)]

    def _set_current(
        self, message: MavlinkMessage, partner: tuple[int, int], now_s: float, link: int
    ) -> list[MavlinkMessage]:
        if message.seq >= len(self.items):
            return [self._ack(partner, mavlink.MAV_MISSION_INVALID_SEQUENCE)]
        self.requested_seq = max(message.seq, self.first_seq)
        return []

    def _ask(self, upload: _Upload, now_s: float) -> MavlinkMessage:
        upload.last_asked_s = now_s
        kind = (
            mavlink.MAVLink_mission_request_int_message
            if self._manners.mission_request_int
            else mavlink.MAVLink_mission_request_message
        )
        return kind(*upload.partner, len(upload.items), self.kind)

    def _finish(self, upload: _Upload, now_s: float) -> MavlinkMessage:
        self._upload = None
        if self.kind == _FENCE and not _whole(upload.items):
            return self._ack(upload.partner, mavlink.MAV_MISSION_ERROR)
        self._replace(tuple(upload.items), now_s)
        if self._manners.mission_texts and self.kind == _MISSION:
            self.texts.append((int(mavlink.MAV_SEVERITY_INFO), "Flight plan received"))
        return self._ack(upload.partner, mavlink.MAV_MISSION_ACCEPTED)

    def _replace(self, items: tuple[StoredItem, ...], now_s: float) -> None:
        self.items = items
        self.loaded_s = now_s
        self.revision += 1

    def _ack(self, partner: tuple[int, int], result: int) -> MavlinkMessage:
        return mavlink.MAVLink_mission_ack_message(*partner, result, self.kind)


def _from_wire(message: MavlinkMessage) -> StoredItem:
    scale = 1.0 if message.get_type() == "MISSION_ITEM_INT" else 1e7
    place = message.frame in GLOBAL_FRAMES
    x, y = (
        round(v * (scale if place else 1.0)) if math.isfinite(v) else NO_PLACE for v in (message.x, message.y)
    )
    params = (message.param1, message.param2, message.param3, message.param4)
    return StoredItem(message.command, message.frame, params, x, y, message.z, message.autocontinue)


def fence_fault_of(item: StoredItem, manners: Manners) -> int | None:
    """Return the MAV_MISSION_RESULT of an item that a fence cannot contain, else None."""
    if item.frame not in manners.fence_frames:
        return int(mavlink.MAV_MISSION_UNSUPPORTED_FRAME)
    if item.command not in _FENCE_COMMANDS:
        return int(mavlink.MAV_MISSION_UNSUPPORTED)
    return None


def _as_fenced(item: StoredItem, manners: Manners) -> StoredItem:
    """Convert an uploaded fence item to the form that the firmware stores and sends back."""
    size = 0.0 if item.command == mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT else item.params[0]
    z = item.z if manners.fence_altitudes else 0.0
    frame = manners.fence_frames[item.frame]
    return replace(item, frame=frame, params=(size, 0.0, 0.0, 0.0), z=z)


def _whole(items: list[StoredItem]) -> bool:
    """Whether every polygon has all its vertices and every circle a radius."""
    at = 0
    while at < len(items):
        item = items[at]
        size = item.params[0]
        if item.command in VERTICES.values():
            # NaN also fails this comparison.
            if not 3.0 <= size <= 255.0:
                return False
            same = [
                i for i in items[at : at + int(size)] if (i.command, i.params) == (item.command, item.params)
            ]
            if len(same) != size:
                return False
            at += len(same)
        elif item.command in CIRCLES.values() and not size > 0.0:
            return False
        else:
            at += 1
    return True


def fault_of(item: StoredItem) -> int | None:
    """Return the MAV_MISSION_RESULT of an item that cannot be flown, else None."""
    if item.frame not in _FRAMES:
        return int(mavlink.MAV_MISSION_UNSUPPORTED_FRAME)
    if item.command < mavlink.MAV_CMD_NAV_LAST and item.command not in NAV_COMMANDS:
        return int(mavlink.MAV_MISSION_UNSUPPORTED)
    if item.command in _PLACED_COMMANDS:
        if item.frame not in GLOBAL_FRAMES:
            return int(mavlink.MAV_MISSION_UNSUPPORTED_FRAME)
        if not math.isfinite(item.z):
            return int(mavlink.MAV_MISSION_INVALID_PARAM7)
    if item.command in NAV_COMMANDS and item.placed:
        if abs(item.x) > 900_000_000:
            return int(mavlink.MAV_MISSION_INVALID_PARAM5_X)
        if abs(item.y) > 1_800_000_000:
            return int(mavlink.MAV_MISSION_INVALID_PARAM6_Y)
    return None


def checked_items(mission: Sequence[MissionItem]) -> tuple[StoredItem, ...]:
    """The items of a mission as they are stored.

    Raises:
        ConfigError: one of them cannot be flown.
    """
    items = tuple(stored(item) for item in mission)
    for seq, item in enumerate(items):
        if (fault := fault_of(item)) is not None:
            raise ConfigError(f"mission item {seq} cannot be flown (MAV_MISSION_RESULT {fault})")
    return items
