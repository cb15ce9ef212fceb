"""Tells our own messages, heard again, from those of another aircraft that has our identity."""

from __future__ import annotations

import math
from collections import deque

from companion.geometry import Vec3
from companion.traffic.fix import Fix

_ECHO_M = 5.0
_ECHO_S = 0.5
_ECHO_HIGH_M = 10.0
_ECHO_MPS = 3.0
"""Tolerances within which a message with our identity counts as our own, compared with our own flight.
`_ECHO_M` allows for two receivers on one aircraft, `_ECHO_S` (times the own speed) for two clocks; the others
are for height and velocity. Beyond them the message is from another aircraft, which is avoided."""
_ECHO_DELAY_S = 3.0
"""Greatest delay of an own frame without a timestamp: some radios repeat the last frame."""
_OWN_SPACING_S = 0.25
_OWN_SAMPLES = 100


class OwnFlight:
    """Our own recent flight, in the local NED frame."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, Vec3, Vec3]] = deque(maxlen=_OWN_SAMPLES)
        """Time (our monotonic time), position and velocity."""

    def __len__(self) -> int:
        return len(self._samples)

    def note(self, now_s: float, position: Vec3, velocity: Vec3) -> None:
        """Store the own state."""
        if not self._samples or now_s - self._samples[-1][0] >= _OWN_SPACING_S:
            self._samples.append((now_s, position, velocity))

    def clear(self) -> None:
        """Forget the flight, because the local frame of its positions is no longer valid."""
        self._samples.clear()

    @property
    def position(self) -> Vec3:
        """The latest position; the frame's origin before the first."""
        return self._samples[-1][1] if self._samples else (0.0, 0.0, 0.0)

    def distance_m(self, fix: Fix, now_s: float) -> float:
        """Horizontal distance (m) of a fix from our own position then; infinite if it does not match our
        flight.

        A fix that matches is an echo of our own broadcast or from a second own transmitter. An aircraft with
        our identity that flies next to us, above us or towards us is another aircraft and must be tracked.
        """
        least = math.inf
        stamp_s = fix.stamp_s
        samples = [own for own in self._samples if now_s - own[0] <= _ECHO_DELAY_S]
        if stamp_s is not None and self._samples:
            samples = [min(self._samples, key=lambda own: abs(own[0] - stamp_s))]
        for at_s, place, velocity in samples:
            along = 0.0 if stamp_s is None else stamp_s - at_s
            north = place[0] + along * velocity[0] - fix.position[0]
            east = place[1] + along * velocity[1] - fix.position[1]
            away = math.hypot(north, east)
            if away > _ECHO_M + _ECHO_S * math.hypot(*velocity):
                continue
            if fix.vertical_known and abs(place[2] - fix.position[2]) > _ECHO_HIGH_M:
                continue
            if fix.velocity is not None and math.dist(velocity, fix.velocity) > _ECHO_MPS:
                continue
            least = min(least, away)
        return least
