"""Right of way between aircraft.

Crewed traffic has the highest rank, then aircraft that cannot manoeuvre or are in distress, then those with
no engine or little power, then all others, such as most drones (the order of ICAO Annex 2, 3.2.2, with crewed
traffic above it). The own aircraft does all of the avoidance for a higher-ranking aircraft. For one of equal
or lower rank it does half: with a smaller share, a reciprocal law would fly into an aircraft that does not
know the rule.
"""

from __future__ import annotations

from companion.remote_id.messages import Status, UaType

CREWED, HELPLESS, LIMITED, FREE = range(4)
"""Ranks; a lower number has the right of way."""

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
"""Rank of each UA type; all others are FREE."""
_EMERGENCY = Status.EMERGENCY


def rank_of(ua_type: UaType | None, status: Status | None) -> int:
    """Rank of an aircraft received by Remote ID, from its reported type and status."""
    if status == _EMERGENCY:
        return HELPLESS
    return FREE if ua_type is None else RANKS.get(ua_type, FREE)


def share_of(own: int, other: int) -> float:
    """Our share of the velocity change that avoids another aircraft, from both ranks: 0.5 or 1."""
    return 1.0 if other < own else 0.5
