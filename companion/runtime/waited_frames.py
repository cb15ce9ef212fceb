"""Which Remote ID frames are discarded because they waited while the program or its computer was stopped."""

from __future__ import annotations

import math

_PAUSED_S, _DISCARD_S = 1.0, 0.25
"""After a pause of `_PAUSED_S` in reading the radios, frames are discarded for `_DISCARD_S`: they waited for
an unknown time, some of them in the kernel or in a radio's thread. They would be dated as received now."""


class WaitedFrames:
    """Notices pauses in reading the radios."""

    def __init__(self) -> None:
        self._read_s = self._discard_until_s = -math.inf

    def discards(self, now_s: float) -> bool:
        """Whether the frames that are read now are to be discarded. Call it once for each reading."""
        if now_s - self._read_s > _PAUSED_S:
            self._discard_until_s = now_s + _DISCARD_S
        self._read_s = now_s
        return now_s < self._discard_until_s
