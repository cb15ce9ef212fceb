"""TIMESYNC: the vehicle's clock read between two moments of our own (MAVLink guide, "Time Synchronization").

We ask with our clock in `ts1` and `tc1` zero; the vehicle sends `ts1` back with its own time since boot in
`tc1`, both in nanoseconds. It read that clock after we had asked and before we heard: what the two clocks
differ by is known to within the round trip, whichever way is the slower one. `companion.ownship` makes use
of it.

The echo says whose answer it is. The target fields do not: ArduPilot has none of them, PX4 1.17 answers
without having set them.
"""

from __future__ import annotations

import math
import struct

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.encoders import Outgoing
from companion.events import ClockRead

PERIOD_S = 1.0
LONGEST_ROUND_TRIP_S = 0.5
"""An answer that took longer tells too little of the vehicle's clock."""
_FORGOTTEN_S = 30.0
"""An answer that took up to this long still shows that the vehicle answers at all."""
_EPSILON_S = 1e-6
_FIELDS = struct.Struct("<qqBB")


def timesync(tc1: int, ts1: int, system_id: int, component_id: int) -> Outgoing:
    """TIMESYNC (ns) to one component; with the target fields, which pymavlink's layout lacks."""
    return mavlink.MAVLINK_MSG_ID_TIMESYNC, _FIELDS.pack(tc1, ts1, system_id, component_id)


def read_timesync(payload: bytes) -> tuple[int, int, int, int]:
    """tc1, ts1 (ns), target system and component (0: everybody, or not told)."""
    tc1, ts1, system_id, component_id = _FIELDS.unpack(payload.ljust(_FIELDS.size, b"\0")[: _FIELDS.size])
    return tc1, ts1, system_id, component_id


def nanoseconds(now_s: float) -> int:
    """Our clock as TIMESYNC has it."""
    return round(now_s * 1e9)


class TimeSync:
    """Asks once a second, and whenever it is to be known that the vehicle reads what it is sent."""

    def __init__(self) -> None:
        self._open: dict[int, float] = {}
        """Questions that may still be answered: ts1 (ns) -> when they were asked."""
        self._asked_s = self._told_s = -math.inf
        self.answered_s: float | None = None
        """When the latest question that was answered had been asked."""
        self.round_trip_s: float | None = None
        """Of the last answer."""

    def restart(self) -> None:
        """The vehicle is new or has restarted: what it was asked before is void; ask at once."""
        self._asked_s = self._told_s = -math.inf
        self._open.clear()

    def due(self, now_s: float) -> int | None:
        """The `ts1` to ask with, when it is time to."""
        return self.ask(now_s) if now_s - self._asked_s >= PERIOD_S - _EPSILON_S else None

    def ask(self, now_s: float) -> int | None:
        """The `ts1` to ask with now; None: this was asked just now."""
        ts1 = nanoseconds(now_s)
        if ts1 in self._open:
            return None
        while self._open and now_s - self._open[oldest := next(iter(self._open))] > _FORGOTTEN_S:
            del self._open[oldest]
        self._open[ts1] = self._asked_s = now_s
        return ts1

    def answered(self, tc1: int, ts1: int, now_s: float) -> ClockRead | None:
        """What an answer tells of the vehicle's clock, once in a period; None when it answers nothing that
        was asked, or came too late."""
        asked_s = self._open.get(ts1)
        if asked_s is None or tc1 < 0:
            return None
        del self._open[ts1]
        self.round_trip_s = now_s - asked_s
        self.answered_s = asked_s if self.answered_s is None else max(asked_s, self.answered_s)
        if not 0.0 <= self.round_trip_s <= LONGEST_ROUND_TRIP_S:
            return None
        if now_s - self._told_s < PERIOD_S - LONGEST_ROUND_TRIP_S:
            return None
        self._told_s = now_s
        return ClockRead(time_boot_s=tc1 / 1e9, asked_s=asked_s, heard_s=now_s)
