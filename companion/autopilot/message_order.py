"""Recognises mode messages that newer messages have overtaken on the way.

HEARTBEAT and CURRENT_MODE carry no time. Where datagrams are delayed by different times (a radio or a router
with a queue), a mode of a second ago can arrive after a position of just now and would pass for the present
mode. The frames' sequence numbers show the order in which the vehicle sent them.
"""

from __future__ import annotations

import math

_HALF = 128
_REBOOT_STEP_S = 10.0


class MessageOrder:
    """Order of one vehicle's messages.

    A message that more than 127 others have overtaken is not recognised.
    """

    def __init__(self) -> None:
        self._boot_s = -math.inf
        self._sequence: int | None = None
        """Sequence number of the message with the newest time since boot."""

    def stamped(self, sequence: int, time_boot_s: float) -> None:
        """Take a message with the vehicle's time since boot. A clock that goes back far has restarted."""
        if time_boot_s >= self._boot_s or time_boot_s < self._boot_s - _REBOOT_STEP_S:
            self._boot_s, self._sequence = time_boot_s, sequence

    def is_overtaken(self, sequence: int) -> bool:
        """Whether a message was sent before the newest message with a time that has arrived."""
        return self._sequence is not None and (sequence - self._sequence) % 256 >= _HALF
