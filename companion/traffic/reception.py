"""How often a sender speaks on one transport, and how much of it arrives: from the counters of its frames.

A frame's counter steps by one with every new content (F3411), so the step from one heard frame to the next is
what was sent meanwhile, heard or not. A few numbers for each address: nothing here grows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.remote_id.transports import MAX_RATE

HEARD_S = 3.0
"""A transport on which a sender was silent for longer is not counted as used, in training as aboard."""
UNKNOWN_RATE = 5
"""Locations a second taken of a sender that was heard once: the middle of what is sent."""
SHARE_MEMORY_S = 10.0
"""Over which the share that arrives is counted."""
_RATE_MEMORY_S = 3.0
_LONGEST_GAP_S = 10.0
"""After so long a counter may have wrapped: the gap says nothing."""
_FASTEST = 20.0
"""Locations a second. A counter that steps faster was set anew, or is made up."""
_STEP_SLACK = 3.0
_OVERTAKEN = 8
"""Frames that come so many counts late were sent before the last one that was heard."""
_SHORTEST_SPAN_S = 0.5


@dataclass(slots=True)
class Reception:
    """What arrives from one radio address on one transport. All sums fade with time."""

    heard_s: float = -math.inf
    """Our monotonic time of the last frame."""
    _news_s: float = -math.inf
    """Of the last frame with new content."""
    _counter: int | None = None
    _sent: float = 0.0
    _span_s: float = 0.0
    """Messages, and the time in which they were sent: the rate."""
    _arrived: float = 0.0
    _expected: float = 0.0
    """Messages that arrived, of those that were sent: the share."""

    def take(self, counter: int | None, now_s: float) -> None:
        """A frame with a Location was heard.

        Args:
            counter: of the frame, 0-255; None where the radio does not tell it. Then what is lost cannot be
                known: the rate is that of arrivals, and no share is counted.
        """
        self.heard_s = now_s
        before, gap_s = self._counter, now_s - self._news_s
        steps = 1 if counter is None or before is None else (counter - before) & 0xFF
        if steps == 0:
            return
        if steps > 0xFF - _OVERTAKEN:
            self._arrived = min(self._arrived + 1.0, self._expected)
            return
        self._counter, self._news_s = counter, now_s
        if gap_s > _LONGEST_GAP_S or steps > _FASTEST * gap_s + _STEP_SLACK:
            return
        if counter is not None and before is None:
            return
        fade = math.exp(-gap_s / _RATE_MEMORY_S)
        self._sent = fade * self._sent + steps
        self._span_s = fade * self._span_s + gap_s
        if counter is not None:
            fade = math.exp(-gap_s / SHARE_MEMORY_S)
            self._arrived = fade * self._arrived + 1.0
            self._expected = fade * self._expected + steps

    def rate(self, now_s: float) -> int:
        """Locations a second, 1 to `MAX_RATE`; 0 where it is not heard (any more)."""
        if now_s - self.heard_s > HEARD_S:
            return 0
        if self._span_s < _SHORTEST_SPAN_S:
            return UNKNOWN_RATE
        return max(1, min(MAX_RATE, round(self._sent / self._span_s)))

    def arrivals(self, now_s: float) -> tuple[float, float]:
        """Messages that arrived, and that were sent up to the last one of them, over the last 10 s or so.

        What was sent since the last one is left out: a sender that left this transport looks the same.
        """
        silent_s = now_s - self.heard_s
        if silent_s > _LONGEST_GAP_S:
            return 0.0, 0.0
        fade = math.exp(-silent_s / SHARE_MEMORY_S)
        return fade * self._arrived, fade * self._expected
