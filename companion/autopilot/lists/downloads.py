"""Downloads the vehicle's mission and its fence one after the other, because PX4 serves one list at a
time."""

from __future__ import annotations

from companion.autopilot.dialect import DIALECTS
from companion.autopilot.heard_vehicle import HeardVehicle
from companion.autopilot.lists.fence import areas_from_items
from companion.autopilot.lists.list_download import FENCE, MISSION, MissionDownload
from companion.autopilot.outbox import Outbox
from companion.autopilot.readers import Fields
from companion.autopilot.wire import MAGIC_V1, Frame
from companion.errors import PeerDataError
from companion.events import (
    Event,
    FenceDownloaded,
    FenceRefused,
    MissionCurrent,
    MissionDownloaded,
    MissionRefused,
)


class Downloads:
    """One download in progress, and at most one that waits for its end."""

    def __init__(self, heard: HeardVehicle, outbox: Outbox, events: list[Event]) -> None:
        """`events` receives the result of each download."""
        self._heard = heard
        self._outbox = outbox
        self._events = events
        self._download: MissionDownload | None = None
        self._next: int | None = None
        """Type of the list to download after the current one."""
        self._current: MissionCurrent | None = None
        """Latest report of the mission that the vehicle holds."""

    def fetch(self, mission_type: int, now_s: float) -> None:
        """Download a list. A download of the same list begins again; the other list waits for the end of the
        current one."""
        vehicle = self._heard.vehicle
        if vehicle is None:
            self._refuse(mission_type, "no vehicle has been heard yet")
        elif self._download is not None and self._download.mission_type != mission_type:
            self._next = mission_type
        else:
            skip_home = mission_type == MISSION and DIALECTS[vehicle.firmware].home_is_item_zero
            self._download = MissionDownload(
                vehicle.system_id,
                now_s,
                mission_type=mission_type,
                skip_home=skip_home,
                current=self._current,
            )
            self.advance(now_s)

    def on_current(self, event: MissionCurrent, now_s: float) -> None:
        """Take MISSION_CURRENT of our vehicle."""
        self._current = event
        if self._download is not None and self._download.mission_type == MISSION:
            self._download.on_current(event, now_s)
            self.advance(now_s)

    def on_count(self, frame: Frame, fields: Fields, now_s: float) -> None:
        """Take MISSION_COUNT of our vehicle."""
        download = self._answered(frame, fields[1], fields[2])
        if download is not None:
            download.on_count(fields, now_s)
            self.advance(now_s)

    def on_item(self, frame: Frame, fields: Fields, now_s: float) -> None:
        """Take MISSION_ITEM or MISSION_ITEM_INT of our vehicle.

        Raises:
            PeerDataError: the item is impossible; it ends the download.
        """
        download = self._answered(frame, fields[9], fields[10])
        if download is not None:
            try:
                download.on_item(frame.message_id, fields, now_s)
            finally:
                self.advance(now_s)

    def on_ack(self, frame: Frame, fields: Fields, now_s: float) -> None:
        """Take MISSION_ACK of our vehicle."""
        download = self._answered(frame, fields[0], fields[1])
        if download is not None:
            download.on_ack(fields)
            self.advance(now_s)

    def _answered(self, frame: Frame, target_system: int, target_component: int) -> MissionDownload | None:
        """The current download, if an answer of the mission protocol is for us."""
        if self._download is None or not self._heard.is_for_us(target_system, target_component):
            return None
        if frame.raw[0] == MAGIC_V1:
            self._download.on_mavlink1()
        return self._download

    def advance(self, now_s: float) -> None:
        """Send the request that is due, report the result when there is one, and begin the download that
        waits."""
        download = self._download
        if download is None:
            return
        outgoing = download.due(now_s)
        if outgoing is not None:
            self._outbox.queue(outgoing)
        if download.failed is not None:
            self._refuse(download.mission_type, download.failed)
        elif download.items is None:
            return
        elif download.mission_type == MISSION:
            self._events.append(MissionDownloaded(items=download.items))
        else:
            try:
                self._events.append(FenceDownloaded(areas=areas_from_items(download.items)))
            except PeerDataError as error:
                self._refuse(FENCE, str(error))
        self._download = None
        if self._next is not None:
            mission_type, self._next = self._next, None
            self.fetch(mission_type, now_s)

    def _refuse(self, mission_type: int, reason: str) -> None:
        refused = MissionRefused if mission_type == MISSION else FenceRefused
        self._events.append(refused(reason=reason))
