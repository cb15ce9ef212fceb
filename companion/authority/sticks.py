"""Whether the pilot moves the sticks while the companion flies."""

from __future__ import annotations

from companion.events import RcChannels

MOVED_US = 100
"""A fifth of a stick's way to either side; trims and noise are less."""
_MESSAGES = 2
"""In a row: one alone may be a glitch of the radio."""


class Sticks:
    """Compares roll, pitch and yaw with where they were when the vehicle was taken; throttle says nothing, as
    its rest differs. Without a remote control nothing moves."""

    def __init__(self) -> None:
        self._rest: tuple[int, int, int] | None = None
        self._last: tuple[int, int, int] | None = None
        self._count = 0

    def begin(self) -> None:
        """The vehicle is taken: the sticks rest where they are."""
        self._rest, self._count = self._last, 0

    def take(self, event: RcChannels) -> None:
        """One message."""
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
        """The pilot wants to fly."""
        return self._count >= _MESSAGES
