"""Detects that the pilot moves the sticks while the companion flies."""

from __future__ import annotations

from companion.events import RcChannels

MOVED_US = 100
"""Deflection (us) that counts as a movement: a fifth of the travel to one side. Trims and noise are less."""
_MESSAGES = 2
"""Consecutive messages that must show a movement: a single one may be a glitch of the radio."""


class Sticks:
    """Compares roll, pitch and yaw with their positions when the vehicle was taken.

    Throttle is ignored, because its rest position differs. Without a remote control no movement is detected.
    """

    def __init__(self) -> None:
        self._rest: tuple[int, int, int] | None = None
        self._last: tuple[int, int, int] | None = None
        self._count = 0

    def begin(self) -> None:
        """Take the present positions as the rest positions, because the vehicle is being taken."""
        self._rest, self._count = self._last, 0

    def note_channels(self, event: RcChannels) -> None:
        """Take in one RC_CHANNELS message."""
        self._last = event.sticks_us
        if event.sticks_us is None:
            self._count = 0
            return
        if self._rest is None:
            self._rest = event.sticks_us
        moved = any(abs(a - b) > MOVED_US for a, b in zip(event.sticks_us, self._rest, strict=True))
        self._count = self._count + 1 if moved else 0

    @property
    def moved(self) -> bool:
        """Whether the pilot moves the sticks."""
        return self._count >= _MESSAGES
