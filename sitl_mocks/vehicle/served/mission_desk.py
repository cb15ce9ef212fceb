"""Distributes the messages of the mission protocol to the mock vehicle's lists: its mission and its fence.

PX4 has one transfer at a time for all lists. A download ends when the partner acknowledges the list or is
silent for the timeout. Until then PX4 ignores requests for other lists and changes. An item requested out of
order ends the download. ArduPilot answers every request. Both were read in the firmwares' sources.
"""

from __future__ import annotations

from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkMessage
from sitl_mocks.vehicle.firmware.behaviour import Manners
from sitl_mocks.vehicle.served.mission import MissionBook

_MISSION = int(mavlink.MAV_MISSION_TYPE_MISSION)
_ALL = int(mavlink.MAV_MISSION_TYPE_ALL)


@dataclass(slots=True)
class _Sending:
    """State of PX4 while it sends a list."""

    kind: int
    partner: tuple[int, int]
    seq: int
    """Sequence number of the item that may be requested next."""
    last_heard_s: float


class MissionDesk:
    """Gives each message of the mission protocol to the list that it concerns."""

    def __init__(self, manners: Manners, books: tuple[MissionBook, ...]) -> None:
        self.books = books
        self._manners = manners
        self._by_kind = {book.kind: book for book in books}
        self._sending: _Sending | None = None

    def handle(self, message: MavlinkMessage, now_s: float, link: int) -> list[MavlinkMessage]:
        """Handle one mission message addressed to this vehicle. Return the answers for the same link."""
        name, kind = message.get_type(), getattr(message, "mission_type", _MISSION)
        partner = (message.get_srcSystem(), message.get_srcComponent())
        if self._manners.one_transfer:
            answers = self._px4_transfer(message, kind, partner, now_s)
            if answers is not None:
                return answers
        book = self._by_kind.get(kind)
        if book is not None:
            return book.handle(message, now_s, link)
        if name == "MISSION_REQUEST_LIST":
            return [mavlink.MAVLink_mission_count_message(*partner, 0, kind)]
        if name == "MISSION_CLEAR_ALL":
            if kind == _ALL:
                for each in self.books:
                    each.handle(message, now_s, link)
            return [mavlink.MAVLink_mission_ack_message(*partner, mavlink.MAV_MISSION_ACCEPTED, kind)]
        if name in ("MISSION_COUNT", "MISSION_REQUEST", "MISSION_REQUEST_INT"):
            return [mavlink.MAVLink_mission_ack_message(*partner, mavlink.MAV_MISSION_UNSUPPORTED, kind)]
        return []

    def tick(self, now_s: float) -> list[tuple[int, MavlinkMessage]]:
        """Return repeated requests and timeouts of uploads, each as a link and its message."""
        return [retry for book in self.books if (retry := book.tick(now_s)) is not None]

    def reboot(self) -> None:
        """Forget every transfer."""
        self._sending = None
        for book in self.books:
            book.drop_upload()

    def _px4_transfer(
        self, message: MavlinkMessage, kind: int, partner: tuple[int, int], now_s: float
    ) -> list[MavlinkMessage] | None:
        """Update PX4's single transfer. Return the answers, or None if the list itself must answer."""
        name, sending = message.get_type(), self._sending
        if sending is not None:
            done = sending.seq == len(self._by_kind[sending.kind].items)
            silent = now_s - sending.last_heard_s > self._manners.upload_timeout_s
            if silent or (done and name == "MISSION_REQUEST_LIST"):
                sending = self._sending = None
        ours = sending is not None and (sending.kind, sending.partner) == (kind, partner)
        if name == "MISSION_REQUEST_LIST":
            if (sending is not None and not ours) or any(book.receiving for book in self.books):
                return []
            if kind in self._by_kind:
                self._sending = _Sending(kind, partner, 0, now_s)
        elif name in ("MISSION_COUNT", "MISSION_CLEAR_ALL"):
            return None if sending is None else []
        elif name in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
            if sending is None or not ours:
                return []
            if message.seq not in (sending.seq, sending.seq - 1):
                self._sending = None
                return [mavlink.MAVLink_mission_ack_message(*partner, mavlink.MAV_MISSION_ERROR, kind)]
            sending.seq, sending.last_heard_s = message.seq + 1, now_s
        elif name == "MISSION_ACK" and ours:
            self._sending = None
        return None
