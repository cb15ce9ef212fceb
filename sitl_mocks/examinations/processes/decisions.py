"""When a companion decided what it sends, inferred from the bytes on its link."""

from __future__ import annotations

from collections import deque
from typing import Final

from companion.autopilot.wire import Frame

AUTOPILOT: Final = 1
"""Component id of an autopilot."""
_SYSTEM_TIME, _LOCAL, _GLOBAL, _SETPOINT = 2, 32, 33, 84
CLOCKS: Final = {_SYSTEM_TIME: 8, _LOCAL: 0, _GLOBAL: 0}
"""Messages that give the companion the vehicle's clock, and the clock's offset in them (uint32, ms)."""
_KEPT_S = 30.0
"""How long clock times are kept: longer than any stall of a companion."""


class Decisions:
    """Latest possible decision times of setpoints, inferred from the bytes on the link.

    A setpoint carries the vehicle's clock as the companion knew it. If a message with a later time had been
    readable, the companion decided before it read that message. If the message was readable when the
    companion resumed after a stop, the companion decided before the stop.
    """

    def __init__(self) -> None:
        self._readable: deque[tuple[float, int]] = deque(maxlen=1000)
        """Times at which a message could be read, and the vehicle's clock in it (ms). Both increase."""
        self._newest_ms = -1

    def readable(self, now_s: float, told: list[tuple[float, bytes]]) -> None:
        """Record that the companion can read these frames from now on."""
        for _, raw in told:
            message_id = raw[7] | raw[8] << 8 | raw[9] << 16
            at = CLOCKS.get(message_id) if raw[0] == 0xFD and raw[6] == AUTOPILOT else None
            if at is None:
                continue
            clock_ms = int.from_bytes(raw[10 : 10 + raw[1]].ljust(12, b"\0")[at : at + 4], "little")
            if clock_ms < self._newest_ms:
                # Out of order: the companion's copy of the clock goes back, so nothing can be inferred until
                # the clock has passed its newest value.
                self._readable.clear()
            elif clock_ms > self._newest_ms:
                self._newest_ms = clock_ms
                self._readable.append((now_s, clock_ms))

    def decided_s(self, now_s: float, frames: list[Frame]) -> float:
        """Latest possible decision time of frames that leave now."""
        decided_s = now_s
        for frame in frames:
            if frame.message_id == _SETPOINT:
                clock_ms = int.from_bytes(frame.payload[:4], "little")
                # A message may have been read after the step had begun.
                later = next((at_s for at_s, told_ms in self._readable if told_ms > clock_ms), now_s)
                decided_s = min(decided_s, later)
        while len(self._readable) > 1 and now_s - self._readable[0][0] > _KEPT_S:
            self._readable.popleft()
        return decided_s
