"""TIMESYNC reads the vehicle's clock between two moments of our own (MAVLink guide, "Time Synchronization").

We send our clock in `ts1` and zero in `tc1`. The vehicle sends `ts1` back with its own time since boot in
`tc1`, both in nanoseconds. It read its clock after we asked and before we received the answer. The difference
of the two clocks is therefore known to within the round trip, and it does not matter which direction was
slower. `companion.ownship` uses this.

The returned `ts1` shows whose question was answered. The target fields do not: ArduPilot has none of them,
and PX4 1.17 answers without setting them.
"""

from __future__ import annotations

import math
import struct

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.encoders import Outgoing
from companion.events import ClockRead

PERIOD_S = 1.0
LONGEST_ROUND_TRIP_S = 0.5
"""An answer that took longer says too little about the vehicle's clock."""
_FORGOTTEN_S = 30.0
"""An answer that took up to this long still shows that the vehicle answers at all."""
_EPSILON_S = 1e-6
_FIELDS = struct.Struct("<qqBB")


def timesync(tc1: int, ts1: int, system_id: int, component_id: int) -> Outgoing:
    """TIMESYNC (ns) to one component, with the target fields, which pymavlink's layout lacks."""
    return mavlink.MAVLINK_MSG_ID_TIMESYNC, _FIELDS.pack(tc1, ts1, system_id, component_id)


def read_timesync(payload: bytes) -> tuple[int, int, int, int]:
    """tc1, ts1 (ns), target system and component (0: everybody, or not given)."""
    tc1, ts1, system_id, component_id = _FIELDS.unpack(payload.ljust(_FIELDS.size, b"\0")[: _FIELDS.size])
    return tc1, ts1, system_id, component_id


def nanoseconds(now_s: float) -> int:
    """Our clock in the unit of TIMESYNC."""
    return round(now_s * 1e9)


class TimeSync:
    """Asks once a second, and additionally when it must be known that the vehicle reads what it is sent."""

    def __init__(self) -> None:
        self._open: dict[int, float] = {}
        """Questions that may still be answered: ts1 (ns) -> when the question was asked."""
        self._asked_s = self._told_s = -math.inf
        self.answered_s: float | None = None
        """When the latest question that was answered had been asked."""
        self.round_trip_s: float | None = None
        """Round trip of the last answer."""

    def restart(self) -> None:
        """The vehicle is new or has restarted: earlier questions are void, and the next one is due at
        once."""
        self._asked_s = self._told_s = -math.inf
        self._open.clear()

    def due(self, now_s: float) -> int | None:
        """The `ts1` to ask with, if a question is due."""
        return self.ask(now_s) if now_s - self._asked_s >= PERIOD_S - _EPSILON_S else None

    def ask(self, now_s: float) -> int | None:
        """The `ts1` to ask with now; None: a question with this time is open already."""
        ts1 = nanoseconds(now_s)
        if ts1 in self._open:
            return None
        while self._open and now_s - self._open[oldest := next(iter(self._open))] > _FORGOTTEN_S:
            del self._open[oldest]
        self._open[ts1] = self._asked_s = now_s
        return ts1

    def answered(self, tc1: int, ts1: int, now_s: float) -> ClockRead | None:
        """Reading of the vehicle's clock from an answer, about once in a period. None when the answer belongs
        to no open question, or came too late."""
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
