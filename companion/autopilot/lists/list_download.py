"""Downloads a list of the vehicle, its mission or its fence, item by item.

The sequence is MISSION_REQUEST_LIST -> MISSION_COUNT -> (MISSION_REQUEST_INT -> MISSION_ITEM_INT) per item ->
MISSION_ACK. Each request is repeated when its answer does not come. Later tries for a mission use
MISSION_REQUEST; vehicles that hold fences by this protocol do not need it. Either form of item is accepted.

In the answers of both firmwares, `mission_type` shows which list they belong to. MAVLink 1 has no such field:
ArduPilot refuses to serve a fence on a link set to it, and an older vehicle would send its mission instead. A
fence download is therefore given up at the first answer in MAVLink 1.

A vehicle answers each request with the item that it holds then, so a mission that is replaced meanwhile
would arrive as a mixture. MISSION_CURRENT shows that: its number of items or, on PX4, its id changes. A
mission with an id is complete only when a later MISSION_CURRENT has the same id. ArduPilot gives no id, but
refuses every request (MISSION_ACK, denied) while it receives a mission, which ends the download. So on
ArduPilot only a mission with the same number of items that is received whole between two of our requests is
not noticed. Its acknowledgement and its text go to the link of the upload alone.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.encoders import Outgoing, mission_ack, mission_request, mission_request_list
from companion.autopilot.readers import Fields, finite_or_none
from companion.autopilot.wire import names_of
from companion.errors import PeerDataError
from companion.events import MissionCurrent, MissionItem

RETRY_S = 1.0
MAX_TRIES = 5
INT_TRIES = 3
"""Number of tries with MISSION_REQUEST_INT before the older MISSION_REQUEST is used."""
TOTAL_S = 60.0
CONFIRMED_S = 5.0
"""Longest wait for the MISSION_CURRENT that confirms a downloaded mission. It comes once a second."""
MAX_ITEMS = 2000

GLOBAL_FRAMES = frozenset(
    {
        mavlink.MAV_FRAME_GLOBAL,
        mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
        mavlink.MAV_FRAME_GLOBAL_INT,
        mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
        mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT,
        mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT,
    }
)
"""MAV_FRAMEs whose x and y are latitude and longitude."""
_INT32_MAX = 0x7FFF_FFFF
MISSION = mavlink.MAV_MISSION_TYPE_MISSION
FENCE = mavlink.MAV_MISSION_TYPE_FENCE
_RESULTS = names_of("MAV_MISSION_RESULT", "MAV_MISSION_")


def item_from_int(fields: Fields) -> MissionItem:
    """Item from MISSION_ITEM_INT in wire order."""
    x, y = fields[4:6]
    scale = 1e7 if fields[11] in GLOBAL_FRAMES else 1.0
    return _item(fields, *(None if v == _INT32_MAX else v / scale for v in (x, y)))


def item_from_float(fields: Fields) -> MissionItem:
    """Item from MISSION_ITEM in wire order. Its degrees in single precision are accurate only to some
    metres."""
    return _item(fields, finite_or_none(fields[4]), finite_or_none(fields[5]))


def _item(fields: Fields, x: float | None, y: float | None) -> MissionItem:
    p1, p2, p3, p4, _x, _y, z, seq, command, _system, _component, frame = fields[:12]
    name = f"{'fence' if fields[14] == FENCE else 'mission'} item {seq}"
    if frame in GLOBAL_FRAMES and (abs(x or 0.0) > 90.0 or abs(y or 0.0) > 180.0):
        raise PeerDataError(f"{name}: position {x}, {y} is not on Earth")
    if math.isinf(z):
        raise PeerDataError(f"{name}: altitude is infinite")
    return MissionItem(
        seq=seq,
        command=command,
        frame=frame,
        params=(finite_or_none(p1), finite_or_none(p2), finite_or_none(p3), finite_or_none(p4)),
        lat_deg=x,
        lon_deg=y,
        alt_m=finite_or_none(z),
    )


class MissionDownload:
    """One download. `due` returns what to send; the download ends with `items` or with `failed` (a
    reason)."""

    def __init__(
        self,
        system_id: int,
        now_s: float,
        *,
        mission_type: int = MISSION,
        skip_home: bool = False,
        current: MissionCurrent | None = None,
    ) -> None:
        """Create a download that has not asked for anything.

        Args:
            skip_home: leave out the first item.
            current: the vehicle's latest report of its mission; None if there is none.
        """
        self.mission_type = mission_type
        self.items: tuple[MissionItem, ...] | None = None
        self.failed: str | None = None
        self._system_id = system_id
        self._skip_home = skip_home
        self._started_s = now_s
        self._count: int | None = None
        self._got: list[MissionItem] = []
        self._tries = 0
        self._next_s = now_s
        self._mark = None if current is None else (current.total, current.mission_id)
        """Number of items and id of the vehicle's mission."""
        self._confirmed = False
        """The mark was reported again after the last item had arrived."""

    @property
    def _whole(self) -> bool:
        """Whether all items have arrived."""
        return self._count is not None and len(self._got) == self._count

    @property
    def _has_id(self) -> bool:
        return self.mission_type == MISSION and self._mark is not None and self._mark[1] != 0

    def due(self, now_s: float) -> Outgoing | None:
        """Message to send now. After the last try or the total time, the download has failed."""
        if self.failed is not None:
            return self._cancel()
        if self._whole and self._has_id and not self._confirmed:
            if now_s - self._next_s > CONFIRMED_S:
                self.failed = "MISSION_CURRENT, which confirms the mission, was not received"
            return self._cancel() if self.failed else None
        if self._whole:
            self.items = tuple(self._got[1:] if self._skip_home else self._got)
            return mission_ack(self._system_id, self.mission_type)
        if now_s < self._next_s:
            return None
        what = "MISSION_COUNT" if self._count is None else f"item {len(self._got)} of {self._count}"
        if now_s - self._started_s > TOTAL_S:
            self.failed = f"{what} was not received within {TOTAL_S:g} s"
            return self._cancel()
        if self._tries == MAX_TRIES:
            self.failed = f"{what} was not received after {self._tries} tries"
            return self._cancel()
        self._tries += 1
        self._next_s = now_s + RETRY_S
        if self._count is None:
            return mission_request_list(self._system_id, self.mission_type)
        as_int = self.mission_type == FENCE or self._tries <= INT_TRIES
        return mission_request(len(self._got), self._system_id, self.mission_type, as_int=as_int)

    def _cancel(self) -> Outgoing | None:
        """MISSION_ACK that cancels the download. PX4 serves no other list until it receives this, or 5 s have
        passed. A download that has not begun is not cancelled: PX4 may be serving another client and would
        complain about us."""
        return (
            None if self._count is None else mission_ack(self._system_id, self.mission_type, cancelled=True)
        )

    def on_count(self, fields: Fields, now_s: float) -> None:
        """Take MISSION_COUNT in wire order. Another number than before means another mission, so the download
        begins again."""
        count, mission_type = fields[0], fields[3]
        if mission_type != self.mission_type or count == self._count:
            return
        if count > MAX_ITEMS:
            self.failed = f"{count} items are more than the {MAX_ITEMS} that are allowed"
        self._count = count
        self._got = []
        self._progress(now_s)

    def on_current(self, event: MissionCurrent, now_s: float) -> None:
        """Take MISSION_CURRENT. Another number of items or id means another mission, so the download begins
        again."""
        mark = event.total, event.mission_id
        changed = self._mark not in (None, mark)
        self._mark, self._confirmed = mark, self._whole and not changed
        if changed:
            self._count, self._got = None, []
            self._progress(now_s)

    def on_item(self, message_id: int, fields: Fields, now_s: float) -> None:
        """Take MISSION_ITEM_INT or MISSION_ITEM in wire order. Any item but the awaited one is ignored."""
        if fields[14] != self.mission_type or self._count is None or fields[7] != len(self._got):
            return
        as_int = message_id == mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT
        try:
            item = item_from_int(fields) if as_int else item_from_float(fields)
        except PeerDataError as error:
            self.failed = str(error)
            raise
        self._got.append(item)
        self._progress(now_s)

    def on_ack(self, fields: Fields) -> None:
        """Take MISSION_ACK in wire order. Any result but "accepted" ends the download."""
        result, mission_type = fields[2], fields[3]
        if mission_type == self.mission_type and result != 0:
            words = _RESULTS.get(result, f"result {result}").lower().replace("_", " ")
            self.failed = f"the vehicle answered: {words}"

    def on_mavlink1(self) -> None:
        """An answer came in MAVLink 1; its content does not matter."""
        if self.mission_type != MISSION:
            self.failed = "the vehicle uses MAVLink 1, which carries missions only; set the port to MAVLink 2"

    def _progress(self, now_s: float) -> None:
        self._tries = 0
        self._next_s = now_s
