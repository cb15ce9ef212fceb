"""Flies around others to the right: the nearer an aircraft in conflict, the harder it is pushed away."""

import math

PUSH_MPS = 5.0
FROM_RADII = 3.0
ASIDE = 0.3


class Sidestep:
    """The law of one aircraft. Limits, floor, ceiling and fence are kept for it."""

    def __init__(self, avoidance):
        self.avoidance = avoidance

    def choose(self, situation, follow, limits):
        """The velocity to fly now: that of the path, and a push for each aircraft in conflict."""
        n, e, d = follow.wanted_ned_mps
        for track in follow.tracks:
            if track.conflict:
                away = [a - b for a, b in zip(situation.position_ned_m, track.position_ned_m, strict=True)]
                distance_m = math.hypot(*away) or 1.0
                push = PUSH_MPS * max(0.0, FROM_RADII - distance_m / track.radius_m) / distance_m
                n += push * (away[0] - ASIDE * away[1])
                e += push * (away[1] + ASIDE * away[0])
                d += push * away[2]
        return n, e, d
