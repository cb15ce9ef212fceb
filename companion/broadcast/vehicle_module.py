"""Tells whether the vehicle has a Remote ID module of its own that broadcasts, so that we do not.

One aircraft must have one identity. But reports on an unsigned link can be forged, and a forged report that
silences our broadcast makes us invisible to everybody. So a module is believed only after it has reported for
a while on the ground, and only as long as it continues to report.
"""

from __future__ import annotations

from companion.events import RemoteIdModule

PROVEN_AFTER_S = 3.0
"""A component that reports for this long, before take-off, is the vehicle's module."""
_GAP_S = 2.5
"""Longest pause between two reports of a module. Ground stations declare a module dead after this time."""
SILENT_S = 5.0
"""A module that does not report for this long no longer broadcasts, as far as we know."""


class VehicleModule:
    """Evidence for a Remote ID module on the vehicle's link. Times are monotonic."""

    def __init__(self) -> None:
        self.report: RemoteIdModule | None = None
        """Latest report of the module; None if there is no module."""
        self._candidate: RemoteIdModule | None = None
        self._armed = False
        self._since_s = self._last_s = 0.0

    def note_armed(self, armed: bool) -> None:
        """Take in at each step whether the vehicle is armed.

        In flight no component becomes the module: our own broadcast is on the air by then, and two identities
        of one aircraft are better than none. Forged heartbeats between the true ones do not change that.
        """
        self._armed = armed
        if armed:
            self._candidate = None

    def observe(self, event: RemoteIdModule, now_s: float) -> None:
        """Take in OPEN_DRONE_ID_ARM_STATUS of another component of our vehicle."""
        if self.report is not None:
            if event.component_id == self.report.component_id:
                self.report, self._last_s = event, now_s
            return
        before = self._candidate
        if self._armed:
            return
        goes_on = before is not None and before.component_id == event.component_id
        if not goes_on or now_s - self._last_s > _GAP_S:
            self._since_s = now_s
        self._candidate, self._last_s = event, now_s
        if now_s - self._since_s >= PROVEN_AFTER_S:
            self.report = event

    def fell_silent(self, now_s: float) -> bool:
        """Whether the module has just fallen silent; from then on there is no module."""
        if self.report is None or now_s - self._last_s <= SILENT_S:
            return False
        self.report = self._candidate = None
        return True
