"""What `allowance` remembers of each track: the time that it used, and whether it presses the aircraft."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from companion.avoidance.law import Neighbour
from companion.geometry import Vec3

WHOLE = 0.5
"""A spent allowance can be used again once its used time has fallen to this share of it."""
STANDS_M, STANDS_S = 15.0, 30.0
"""A track stands still if it has stayed within this distance of a place for this long."""
_APPEARED_S = 15.0
PRESSES_S = 30.0
"""A track presses if it has been inside its volume for this long. Each second outside takes half a second off
that time."""

Key = tuple[bool, str]
"""Whether a track is from ADS-B, and its id."""


@dataclass(slots=True)
class Used:
    """Time charged to one allowance, which falls while nothing is charged."""

    used_s: float = 0.0
    at_s: float = -math.inf
    spent: bool = False

    def charge(self, now_s: float, seconds: float, most_s: float, refill_s: float) -> bool:
        """Charge some time, perhaps none. Returns whether `spent` has changed."""
        passed_s = now_s - self.at_s
        if seconds <= 0.0 and passed_s < math.inf:
            self.used_s = max(0.0, self.used_s - passed_s * most_s / refill_s)
        self.used_s, self.at_s = min(self.used_s + seconds, most_s), now_s
        before = self.spent
        self.spent = self.used_s >= most_s or (before and self.used_s > WHOLE * most_s)
        return self.spent is not before


@dataclass(slots=True, eq=False)
class Remembered:
    """What is remembered of a track."""

    key: Key
    latest: Neighbour
    """State of the track at the latest decision for which it was heard."""
    first_s: float
    heard_s: float
    anchor: Vec3
    """Place (NED, m) from which the track has not moved farther than `STANDS_M`."""
    anchor_s: float
    used: Used = field(default_factory=Used)
    """Time in conflict."""
    inside: Used = field(default_factory=Used)
    """Time in conflict and inside its volume."""
    pressed_s: float = 0.0
    follows: bool = False
    appeared_s: float = -math.inf
    """Time at which the track was first heard inside its volume, or near us soon after other tracks. While it
    appears (`appears`), the time at which it was last inside."""
    entered: bool = False
    """Whether the track has been inside its volume."""
    reserved: bool = False
    """Whether the track had used little when only the last quarter of the total was left."""
    chases: bool = False
    """Whether the track has moved while it pressed. If such a track stands still, it does so only because our
    aircraft does."""

    @property
    def spent(self) -> bool:
        """Whether the track has spent an allowance of its own."""
        return self.used.spent or self.inside.spent

    @property
    def presses(self) -> bool:
        """Whether the track has been inside its volume for long, or follows the aircraft."""
        return self.pressed_s >= PRESSES_S or self.follows

    def appears(self, now_s: float) -> bool:
        """Whether `appeared_s` is recent: the track has not been outside its volume for long since."""
        return now_s - self.appeared_s <= _APPEARED_S

    def yields(self, now_s: float) -> bool:
        """Whether the track is avoided only as far as all others allow."""
        stale = self.latest.unheard and self.latest.together
        return self.presses or self.appears(now_s) or stale

    def renewed(self, now_s: float, latest: Neighbour, place: Vec3) -> Remembered:
        """The same track after a silence. Another aircraft may have its name now, but used time is kept.

        Args:
            place: present position (NED, m).
        """
        fresh = Remembered(self.key, latest, now_s, now_s, place, now_s, self.used, self.inside)
        fresh.reserved = self.reserved
        return fresh

    def inherit(self, others: Iterable[Remembered]) -> None:
        """Take over the longest times that any of the other tracks has used."""
        for other in others:
            self.used.used_s = max(self.used.used_s, other.used.used_s)
            self.inside.used_s = max(self.inside.used_s, other.inside.used_s)
            self.pressed_s = max(self.pressed_s, other.pressed_s)
            self.chases = self.chases or other.chases

    def see(self, now_s: float, position: Vec3) -> None:
        """Take in the present position (NED, m) of the track."""
        self.heard_s = now_s
        if math.dist(self.anchor, position) > STANDS_M:
            self.anchor, self.anchor_s = position, now_s
            self.chases = self.chases or self.presses

    def stands(self, now_s: float) -> bool:
        """Whether the track stands still, and not only because our aircraft does."""
        return not self.chases and now_s - self.anchor_s >= STANDS_S
