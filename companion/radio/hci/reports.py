"""Assembles advertising reports to frames. Long advertisements arrive in several reports.

An advertisement whose end the controller did not receive is used as far as it goes, because the messages
before that are whole.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

from companion.radio.hci.controller_events import DataStatus, Report
from companion.radio.hci.packets import address_text
from companion.remote_id.transports import BLE4, BLE5

_REMOTE_ID_HEAD = b"\x16\xfa\xff\x0d"
"""Service data of ASTM Remote ID. Advertisements without it belong to other devices."""
_MAX_DATA = 1650
"""Greatest length of an advertisement (Core vol. 4 part E section 7.8.57)."""
_HEAD_SIZE = 5
"""Length and `_REMOTE_ID_HEAD`."""
_MAX_PARTIAL = 64
_MAX_AGE_S = 1.0
"""Longest age of a partial advertisement. Its parts follow each other within its airtime."""


@dataclass(frozen=True, slots=True)
class HeardFrame:
    """Advertising data that may hold Remote ID."""

    transport: str
    address: str
    data: bytes
    rssi_dbm: float | None


@dataclass(slots=True)
class _Partial:
    data: bytes
    since_s: float


class Reassembler:
    """Reassembles advertisements by address and SID, with limits on memory and age."""

    def __init__(self) -> None:
        self._partial: OrderedDict[tuple[bytes, int], _Partial] = OrderedDict()

    def add_report(self, report: Report, now_s: float) -> HeardFrame | None:
        """Return the frame that this report ends, if it may hold Remote ID."""
        data = report.data
        if not report.legacy:
            whole = self._join(report, now_s)
            if whole is None:
                return None
            data = whole
        if _REMOTE_ID_HEAD not in data:
            return None
        transport = BLE4 if report.legacy else BLE5
        return HeardFrame(transport, address_text(report.address), data, report.rssi_dbm)

    def _join(self, report: Report, now_s: float) -> bytes | None:
        key = (report.address, report.sid)
        before = self._partial.pop(key, None)
        if before is not None and (now_s - before.since_s > _MAX_AGE_S or _begins_anew(before, report.data)):
            before = None
        data = report.data if before is None else before.data + report.data
        if report.data_status is DataStatus.COMPLETE:
            return data
        if report.data_status is DataStatus.RESERVED or len(data) > _MAX_DATA:
            return None
        if report.data_status is DataStatus.TRUNCATED:
            return data
        if len(self._partial) >= _MAX_PARTIAL:
            self._partial.popitem(last=False)
        self._partial[key] = _Partial(data, now_s if before is None else before.since_s)
        return None


def _begins_anew(before: _Partial, data: bytes) -> bool:
    """Whether a report is the first of the next advertisement, because the end of the one before was lost.

    Put together, the two would hold a message that nobody sent, such as a Location with a false altitude.
    """
    return len(data) >= _HEAD_SIZE and data[:_HEAD_SIZE] == before.data[:_HEAD_SIZE]
