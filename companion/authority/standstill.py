"""A vehicle that was let go is commanded to stand until it holds by itself."""

from __future__ import annotations

import math

from companion.events import FlightMode

_HOLD_S = 3.0
"""Who switches off wants the vehicle to stop, not to meet what an autopilot does when setpoints end: for so
long at most it is commanded to stand, until it holds by itself."""
_STICKS_S = 10.0
"""The same for a mode that takes sticks: longer than it is asked for, so that where the vehicle refuses it a
hold can be asked for instead."""


class Standstill:
    """Until the mode that was asked for shows, or any other, and then never again."""

    def __init__(self) -> None:
        self._until_s = -math.inf
        self._seen: FlightMode | None = None
        """Mode that the vehicle was last seen in."""

    def begin(self, now_s: float, mode: FlightMode | None, *, sticks: bool) -> None:
        """The vehicle is let go.

        Args:
            mode: that it is in.
            sticks: a mode that takes sticks was asked for; False: a hold.
        """
        self._until_s = now_s + (_STICKS_S if sticks else _HOLD_S)
        self._seen = mode

    def end(self) -> None:
        """Nothing is commanded any more."""
        self._until_s = -math.inf

    def see(self, mode: FlightMode | None) -> None:
        """The vehicle shows this mode."""
        if mode is FlightMode.EXTERNAL:
            self._seen = mode
        elif mode is not self._seen:
            self.end()

    def lasts(self, now_s: float, mode: FlightMode | None) -> bool:
        """The vehicle is still to be commanded to stand.

        Args:
            mode: that it is in.
        """
        return now_s < self._until_s and mode is FlightMode.EXTERNAL
