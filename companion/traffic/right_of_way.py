"""Who gives way to whom.

Crewed traffic first; then what cannot manoeuvre or is in distress; then what has no engine or little power;
then everything else, drones among themselves (the order of ICAO Annex 2, 3.2.2, with crewed traffic above
it). To whom it must give way an aircraft leaves nothing of the work; from equals, and from those who must
give way to it, it expects half: a reciprocal law that did less than half would fly into one that does not
know the rule.
"""

from __future__ import annotations

from companion.remote_id.messages import Status, UaType

CREWED, HELPLESS, LIMITED, FREE = range(4)
"""Ranks: a lower one goes first."""

RANKS = {
    UaType.KITE: HELPLESS,
    UaType.FREE_BALLOON: HELPLESS,
    UaType.CAPTIVE_BALLOON: HELPLESS,
    UaType.FREE_FALL_PARACHUTE: HELPLESS,
    UaType.ROCKET: HELPLESS,
    UaType.TETHERED_POWERED_AIRCRAFT: HELPLESS,
    UaType.GROUND_OBSTACLE: HELPLESS,
    UaType.GLIDER: LIMITED,
    UaType.AIRSHIP: LIMITED,
}
"""Others are FREE."""
IN_DISTRESS = frozenset({Status.EMERGENCY})


def rank_of(ua_type: UaType | None, status: Status | None) -> int:
    """Rank of an aircraft heard by Remote ID, from what it says it is."""
    if status in IN_DISTRESS:
        return HELPLESS
    return FREE if ua_type is None else RANKS.get(ua_type, FREE)


def share_of(own: int, other: int) -> float:
    """Our share of what is needed to keep apart from another, by ranks."""
    return 1.0 if other < own else 0.5
