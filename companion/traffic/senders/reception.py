"""Estimates a sender's message rate on one transport, and the share that arrives, from its frame counters.

A frame's counter increases by one with every new content (F3411), so its step from one received frame to the
next is the number of messages sent meanwhile, received or not. The state of each address has a fixed size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.remote_id.transports import MAX_RATE

HEARD_S = 3.0
"""A transport on which a sender was silent for longer does not count as used, in training and on the
aircraft."""
UNKNOWN_RATE = 5
"""Locations per second assumed of a sender that was heard once: the middle of the possible rates."""
SHARE_MEMORY_S = 10.0
"""Time constant over which the share that arrives is averaged."""
_RATE_MEMORY_S = 3.0
_LONGEST_GAP_S = 10.0
"""After a longer gap a counter may have wrapped, so the gap is not evaluated."""
_FASTEST = 20.0
"""Locations per second. A counter that increases faster was reset or is forged."""
_STEP_SLACK = 3.0
_OVERTAKEN = 8
"""A frame that is up to this many counts behind was sent before the last received one."""
_SHORTEST_SPAN_S = 0.5
_REPEATED = 0.15
"""A sender of which more frames than this share of its news repeat their content sends each content several
times. Gaps in its counter then hide losses."""
_SAME_FRAME_S = 0.075
"""A repetition within this time is the same frame, received on another channel or by another receiver. Frames
count as received at the next step, and steps are 0.05 s apart."""


@dataclass(slots=True)
class Reception:
    """Reception statistics of one radio address on one transport. All sums fade with time."""

    heard_s: float = -math.inf
    """Our monotonic time of the last frame."""
    _news_s: float = -math.inf
    """Our monotonic time of the last frame with new content."""
    _counter: int | None = None
    _sent: float = 0.0
    _span_s: float = 0.0
    """`_sent` messages in `_span_s` seconds give the rate."""
    _arrived: float = 0.0
    _expected: float = 0.0
    """`_arrived` of `_expected` sent messages give the share that arrives."""
    _repeated: float = 0.0
    """Received frames that repeated the last content."""

    def count_frame(self, counter: int | None, now_s: float) -> None:
        """Count a received frame with a Location.

        Args:
            counter: counter of the frame, 0-255; None if the radio does not report it. Then losses are
                unknown: the rate is that of arrivals, and no share is counted.
        """
        self.heard_s = now_s
        before, gap_s = self._counter, now_s - self._news_s
        steps = 1 if counter is None or before is None else (counter - before) & 0xFF
        if steps == 0:
            self._repeated += gap_s > _SAME_FRAME_S
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
            self._repeated *= fade

    def rate(self, now_s: float) -> int:
        """Locations per second, 1 to `MAX_RATE`; 0 if nothing was heard within `HEARD_S`."""
        if now_s - self.heard_s > HEARD_S:
            return 0
        if self._span_s < _SHORTEST_SPAN_S:
            return UNKNOWN_RATE
        return max(1, min(MAX_RATE, round(self._sent / self._span_s)))

    def arrivals(self, now_s: float) -> tuple[float, float]:
        """Messages that arrived, and messages sent up to the last arrival, over about the last 10 s.

        Losses since the last arrival are left out, because a sender that left this transport looks the same.
        A sender that repeats its content is not counted.
        """
        silent_s = now_s - self.heard_s
        if silent_s > _LONGEST_GAP_S or self._repeated > _REPEATED * self._arrived:
            return 0.0, 0.0
        fade = math.exp(-silent_s / SHARE_MEMORY_S)
        return fade * self._arrived, fade * self._expected
