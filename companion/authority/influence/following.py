"""Tells an aircraft that moves with us, whatever we do, from one that flies its own way.

Whoever pushes this aircraft about must follow it. An honest aircraft does not: blind ones fly straight on or
turn as they like, and those that avoid turn the other way. So a track follows if it has kept its place beside
us while we were pushed off our way, although that is not where it would be

- if it had flown straight on from where the conflict began (it bends as we do), or
- if it flew as fast and where to as it reports (it seems to come nearer all the time, but does not).

What follows us when we give way keeps its distance also when we come back. That is what makes it safe to
give way to others first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.geometry import Vec3

PUSHED_M = 10.0
"""How far we must have been pushed, and how far it must be from where it would be."""
_HEIR_S = 15.0
"""A silent track is predicted for so long; meanwhile another name may go on where it was."""
_BEGINS_S = 5.0
"""After so long without a conflict, another begins."""


@dataclass(slots=True)
class Following:
    """What one track has done since the conflict with it began. NED, m and m/s."""

    own: Vec3 = (0.0, 0.0, 0.0)
    own_mps: Vec3 = (0.0, 0.0, 0.0)
    place: Vec3 = (0.0, 0.0, 0.0)
    mps: Vec3 = (0.0, 0.0, 0.0)
    reported: Vec3 = (0.0, 0.0, 0.0)
    """Where it would be by the velocities that it has reported since."""
    since_s: float = -math.inf
    at_s: float = -math.inf

    def continues(self, now_s: float, own: Vec3, place: Vec3) -> bool:
        """Whether a track that appears here has the place that this one had beside us."""
        if now_s - self.at_s > _HEIR_S:
            return False
        return math.dist(_minus(place, own), _minus(self.place, self.own)) <= PUSHED_M

    def look(self, now_s: float, own: Vec3, own_mps: Vec3, place: Vec3, mps: Vec3) -> bool:
        """Take in the present state of both during a conflict; True if the track has followed.

        Args:
            own, own_mps: own place and velocity.
            place, mps: predicted place of the track, and the velocity that it reports.
        """
        if now_s - self.at_s > _BEGINS_S:
            self.own, self.own_mps, self.place, self.mps, self.reported = own, own_mps, place, mps, place
            self.since_s = self.at_s = now_s
        self.reported = _after(self.reported, now_s - self.at_s, mps)
        self.at_s = now_s
        passed_s = now_s - self.since_s
        pushed = _minus(own, _after(self.own, passed_s, self.own_mps))
        pushed_m = math.hypot(*pushed)
        moved_m = math.dist(_minus(place, own), _minus(self.place, self.own))
        if pushed_m < PUSHED_M or moved_m > 0.5 * pushed_m:
            return False
        bent = _minus(place, _after(self.place, passed_s, self.mps))
        with_us = sum(a * b for a, b in zip(bent, pushed, strict=True)) > 0.5 * pushed_m * pushed_m
        return with_us or math.dist(place, self.reported) > PUSHED_M


def _after(place: Vec3, passed_s: float, mps: Vec3) -> Vec3:
    (n, e, d), (vn, ve, vd) = place, mps
    return n + passed_s * vn, e + passed_s * ve, d + passed_s * vd


def _minus(a: Vec3, b: Vec3) -> Vec3:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]
