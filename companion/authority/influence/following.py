"""Finds aircraft that move with us, whatever we do, among those that fly their own way.

An attacker that pushes this aircraft away must follow it. An honest aircraft does not follow: one without
avoidance flies straight on or turns independently of us, and one with avoidance turns the other way. So a
track follows if it has kept its place beside us while we were pushed off our way, although it would be
elsewhere

- if it had flown straight on since the conflict began (it turns as we do); or
- by the velocities that it reports (it reports that it comes nearer, but does not).

A track that follows us when we give way also keeps its distance when we come back. A track that follows is
avoided only as far as all others allow (`Neighbour.yields`), so it cannot push us into them.
"""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass, replace

from companion.avoidance.law import Neighbour
from companion.geometry import Vec3

PUSHED_M = 10.0
"""A track follows only if we were pushed this far, and it either moved along with us by half of that or is
this far from where its reported velocities lead. A track that continues another one's conflict must appear
within this distance of the other's place beside us."""
_HEIR_S = 15.0
"""A conflict is remembered for this long after its track was last in conflict with us, so that a track with
another name can continue it."""
_LASTS_S = 1.0
"""Time for which a track must have followed; one message is no evidence."""
_MOST = 32
"""Most conflicts that are examined at a time."""
_FRESH_S = 2.0
"""Greatest age of a message that shows where a track is beside us."""
_HEIR_WITHIN_S = 5.0
"""A track may continue another one's conflict only within this time after its own first conflict began."""
_PAUSE_S = 3.5
"""Longest time between the last message of a track and the first conflict of the track that continues it."""
_BEGINS_S = 5.0
"""After this long without a conflict, the next one is a new one. For a track that followed, it is
`_HEIR_S`."""


@dataclass(slots=True)
class _Conflict:
    """A conflict with a track: how it began, and what the track has done since. NED, m and m/s."""

    began_s: float
    own: Vec3
    own_mps: Vec3
    place: Vec3
    mps: Vec3
    began_beside: Vec3
    """Place of the track relative to us when the conflict began."""
    reported: Vec3
    """Where the track would be by the velocities that it has reported since."""
    beside: Vec3
    """Place of the track relative to us when it was last heard. A track with another name that appears there
    continues this conflict. The place is fixed once the track follows, so that a follower cannot pass its
    record to an aircraft by moving to it."""
    at_s: float
    """Time at which the track was last in conflict with us."""
    since_s: float
    """Time since which it has followed."""
    named_s: float
    """Time at which the first conflict under this name began; -infinity if it continues another track's."""
    seen_s: float
    """Time at which the track last existed."""
    heard_s: float
    """Time of its last message."""
    unheard: bool = False
    """Whether the track was not received for so long that its aircraft may have stopped
    (`Neighbour.unheard`)."""
    follows: bool = False

    def look(self, now_s: float, own: Vec3, place: Vec3, mps: Vec3) -> None:
        """Take in the present state during the conflict, and judge whether the track follows."""
        if now_s - self.at_s > _LASTS_S:
            self.since_s = now_s
        self.go_on(now_s, mps)
        passed_s = now_s - self.began_s
        pushed = _minus(own, _after(self.own, passed_s, self.own_mps))
        pushed_m = math.hypot(*pushed)
        bent = _minus(place, _after(self.place, passed_s, self.mps))
        with_us = sum(a * b for a, b in zip(bent, pushed, strict=True)) > 0.5 * pushed_m * pushed_m
        if (
            pushed_m < PUSHED_M
            or math.dist(self.beside, self.began_beside) > 0.5 * pushed_m
            or not (with_us or math.dist(place, self.reported) > max(PUSHED_M, 0.5 * pushed_m))
        ):
            self.since_s = now_s
        elif now_s - self.since_s >= _LASTS_S:
            self.follows = True

    def go_on(self, now_s: float, mps: Vec3) -> None:
        """Take in the velocity (m/s) that has been reported since the last conflict."""
        self.reported, self.at_s = _after(self.reported, now_s - self.at_s, mps), now_s

    def over(self, now_s: float) -> bool:
        """Whether the conflict has ended, so that the next one with the track is a new one."""
        return now_s - self.at_s > (_HEIR_S if self.follows else _BEGINS_S)


class Followers:
    """The conflicts with all tracks. A key names a track."""

    def __init__(self) -> None:
        self._conflicts: dict[Hashable, _Conflict] = {}

    def __contains__(self, key: Hashable) -> bool:
        """Whether a conflict with the track is remembered."""
        return key in self._conflicts

    def hear(self, now_s: float, key: Hashable, own: Vec3, own_mps: Vec3, other: Neighbour) -> bool:
        """Take in the state of a track, in conflict or not; True if it follows.

        Args:
            own, own_mps: own place and velocity.
        """
        found = self._conflicts.get(key)
        if found is None:
            return False
        found.seen_s, found.heard_s, found.unheard = now_s, now_s - other.age_s, other.unheard
        if other.age_s <= _FRESH_S and not found.follows:
            found.beside = _beside(own, own_mps, other)
        return found.follows and not found.over(now_s)

    def conflict(self, now_s: float, key: Hashable, own: Vec3, own_mps: Vec3, other: Neighbour) -> None:
        """Take in that a track is in conflict now. Call `hear` before."""
        place, mps = _after(other.position_ned_m, other.age_s, other.velocity_ned_mps), other.velocity_ned_mps
        found = self._conflicts.get(key)
        if found is None or found.over(now_s):
            self._forget(now_s)
            if len(self._conflicts) >= _MOST:
                return
            beside = _beside(own, own_mps, other)
            found = _Conflict(
                now_s, own, own_mps, place, mps, beside, place, beside, now_s, now_s, now_s, now_s, now_s,
            )  # fmt: skip
            self._conflicts[key] = found
        if not found.follows and now_s - found.named_s <= _HEIR_WITHIN_S:
            found = self._conflicts[key] = self._earlier(now_s, found, mps) or found
        found.look(now_s, own, place, mps)

    def forget(self, key: Hashable) -> None:
        """Treat the track as a new one from now on. Another track may still continue its old conflict."""
        if key in self._conflicts:
            self._conflicts[object()] = self._conflicts.pop(key)

    def _earlier(self, now_s: float, heir: _Conflict, mps: Vec3) -> _Conflict | None:
        """The earlier conflict that this one continues under another name. Its track had the same place
        beside us and has fallen silent since; a track that is still received cannot be the same aircraft."""
        for found in self._conflicts.values():
            gone = found.unheard or now_s - found.seen_s > _LASTS_S
            near = math.dist(heir.beside, found.beside) <= PUSHED_M
            if found is not heir and gone and near and 0.0 <= heir.named_s - found.heard_s <= _PAUSE_S:
                found = replace(found, named_s=-math.inf, seen_s=now_s, heard_s=now_s, unheard=False)
                found.go_on(now_s, mps)
                return found
        return None

    def _forget(self, now_s: float) -> None:
        old = [key for key, c in self._conflicts.items() if now_s - c.at_s > _HEIR_S]
        if len(self._conflicts) - len(old) >= _MOST:
            old = [key for key, c in self._conflicts.items() if now_s > c.at_s and not c.follows]
        for key in old:
            del self._conflicts[key]


def _beside(own: Vec3, own_mps: Vec3, other: Neighbour) -> Vec3:
    """Place of another aircraft relative to us at the time of its message."""
    return _minus(other.position_ned_m, _after(own, -other.age_s, own_mps))


def _after(place: Vec3, passed_s: float, mps: Vec3) -> Vec3:
    (n, e, d), (vn, ve, vd) = place, mps
    return n + passed_s * vn, e + passed_s * ve, d + passed_s * vd


def _minus(a: Vec3, b: Vec3) -> Vec3:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]
