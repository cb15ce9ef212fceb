"""Says in words why the authority moved from one state to another."""

from __future__ import annotations

import msgspec

from companion.authority.handback import HandBack
from companion.authority.readiness import mode_name
from companion.authority.table import Trigger
from companion.avoidance.law import LawResult
from companion.events import Heartbeat
from companion.ownship import Ownship

_REASONS = {
    Trigger.RELEASE: "vehicle disarmed or on the ground",
    Trigger.REARM: "the pilot gave authority again",
    Trigger.HEALTHY: "own state usable again",
    Trigger.WATCH: "guarding the vehicle's mission",
    Trigger.LEFT: "two autopilots on the link, so it is unclear which one is ours",
    Trigger.CLEAR: "no conflict",
    Trigger.AWAY: "off the timed path",
    Trigger.REGAINED: "back on the timed path",
}
"""Reason texts of the triggers that have only one."""


class Refused(msgspec.Struct):
    """Texts of what was refused since the last step; None where nothing was."""

    mode: str | None = None
    """The vehicle did not enter our mode."""
    fault: str | None = None
    """The gate refused a command, as a fault of ours."""
    lost: str | None = None
    """The gate refused a command because authority was lost."""
    second: str | None = None
    """Another companion may command the vehicle."""
    traffic: str | None = None
    """Traffic has spent its allowance (`authority.influence`), so the vehicle is asked to hold."""


class Reasons:
    """The words for each trigger."""

    def __init__(self, own: Ownship, handback: HandBack | None) -> None:
        self._own = own
        self._handback = handback

    def of(
        self,
        now_s: float,
        trigger: Trigger,
        seen: Heartbeat | None,
        unfit: str | None,
        result: LawResult | None,
        refused: Refused,
    ) -> str:
        """Reason, in words, why a trigger moved the authority.

        Args:
            seen: heartbeat that caused the trigger.
            unfit: why nothing may be commanded.
            result: decision of the law that caused the trigger.
            refused: what was refused since the last step.
        """
        handback = self._handback
        match trigger:
            case Trigger.PILOT:
                return self._what_the_pilot_did(now_s, seen, refused.lost)
            case Trigger.UNFIT:
                return unfit or f"mode request failed: {refused.mode}"
            case Trigger.READY:
                return f"taking control in mode {mode_name(self._own.heartbeat)}"
            case Trigger.LEFT if seen is not None:
                return f"the vehicle left its mission for mode {mode_name(seen)}"
            case Trigger.LEFT if refused.second is not None:
                return refused.second
            case Trigger.RESUMED if handback is not None:
                return handback.how(now_s)
            case Trigger.ENDED:
                return f"the mission ended during handback; the vehicle is in mode {mode_name(seen)}"
            case Trigger.CHANGED if handback is not None:
                return handback.why_not
            case Trigger.SPENT:
                return f"{refused.traffic}: the vehicle is asked to hold"
            case Trigger.CONFLICT if result is not None:
                return "conflict with " + ", ".join(t.track_id for t in result.tracks if t.conflict)
        return _REASONS[trigger]

    def _what_the_pilot_did(self, now_s: float, seen: Heartbeat | None, lost: str | None) -> str:
        if seen is None:
            return lost or "the pilot moved the sticks"
        changed = f"mode changed to {mode_name(seen)}"
        if self._handback is not None and self._handback.ends_in_hold(seen, now_s):
            return f"{changed} during handback: the mission ended, or the pilot changed it"
        return f"{changed}, not by the companion"
