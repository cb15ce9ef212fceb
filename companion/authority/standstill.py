"""Commands a released vehicle to stand still until it holds by itself."""

from __future__ import annotations

import math

from companion.events import FlightMode

_HOLD_S = 3.0
"""Longest standstill after a hold was requested. After DMUCA_ENABLE = 0 we command a standstill until the
vehicle holds, so that the autopilot's setpoint-loss failsafe does not trigger."""
_STICKS_S = 10.0
"""Longest standstill after a mode for stick control was requested. It is longer than the request is repeated,
so that a hold can still be requested if the vehicle refuses the mode."""


class Standstill:
    """Lasts until the vehicle reports a new mode, requested or not, and does not resume by itself."""

    def __init__(self) -> None:
        self._until_s = -math.inf
        self._seen: FlightMode | None = None
        """Mode that the vehicle last reported."""

    def begin(self, now_s: float, mode: FlightMode | None, *, sticks: bool) -> None:
        """Start the standstill as the vehicle is released.

        Args:
            mode: current mode of the vehicle.
            sticks: True if a mode for stick control was requested, False if a hold.
        """
        self._until_s = now_s + (_STICKS_S if sticks else _HOLD_S)
        self._seen = mode

    def end(self) -> None:
        """End the standstill."""
        self._until_s = -math.inf

    def see(self, mode: FlightMode | None) -> None:
        """Take in a reported mode."""
        if mode is FlightMode.EXTERNAL:
            self._seen = mode
        elif mode is not self._seen:
            self.end()

    def lasts(self, now_s: float, mode: FlightMode | None) -> bool:
        """Whether the vehicle is still to be commanded to stand still.

        Args:
            mode: current mode of the vehicle.
        """
        return now_s < self._until_s and mode is FlightMode.EXTERNAL
