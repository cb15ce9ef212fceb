"""Moves aside from an aircraft that approaches too fast for any reachable velocity to keep its volume clear.

The plane of ORCA requires the smallest change of velocity that keeps the volume clear. Near a fast aircraft
ahead of us, this change mostly points backwards. The command then spends its limited acceleration on braking,
which hardly delays the meeting. Moving sideways, across the relative motion, gains the most distance. It is
required only for positions that a sensor measured relative to ours: an aircraft that is first seen at 40 m
leaves three seconds. Transmitting aircraft are heard in time, and messages that are seconds old do not show
on which side an aircraft will pass.
"""

from __future__ import annotations

import math

from companion.avoidance.kernels.compiled import compiled
from companion.avoidance.kernels.settings import DEMAND, Own, Settings
from companion.avoidance.kernels.vectors import Plane, Vector, dot, times

ANSWERS_S = 0.5
"""Time until the vehicle follows a command. It is not available for moving aside."""
SAME_SIDE_M, TURNED_MPS = 2.0, 1.0 / 3.0
"""Preference, in metres of distance, for the side to which the command already differs from the wanted
velocity. It is smaller if the difference is below TURNED_MPS. At first it is known only to some metres on
which side another aircraft will pass, and an aircraft that changes sides with every measurement stays in the
middle."""


@compiled
def way_aside(more_mps: float, t: float, acceleration: float) -> float:
    """Distance (m) gained in a time t (s) by accelerating until the speed has grown by `more_mps`."""
    until = max(more_mps, 0.0) / acceleration
    if t < until:
        return 0.5 * acceleration * t * t
    return acceleration * until * (t - 0.5 * until)


@compiled
def escape(
    away: Vector, velocity: Vector, own: Own, turned: Vector, radius: float, settings: Settings
) -> tuple[bool, Plane]:
    """Whether to replace the plane of ORCA, and the plane that then requires to move aside: level, and across
    the relative motion.

    The side is the one on which the least distance can become larger, given the speed and the acceleration
    that are left on that side. If it can reach `radius`, the plane of ORCA stays.

    Args:
        away: position of the other aircraft minus ours, m.
        velocity: its velocity, m/s.
        turned: the last command minus the wanted velocity, m/s.
        radius: distance to keep, m.
    """
    closing_n, closing_e = own.velocity.n - velocity.n, own.velocity.e - velocity.e
    speed2 = closing_n * closing_n + closing_e * closing_e
    t = (away.n * closing_n + away.e * closing_e) / speed2 if speed2 > 0.0 else 0.0
    if t <= 0.0 or (velocity.n == 0.0 and velocity.e == 0.0):
        return False, Plane(velocity, 0.0)
    k = 1.0 / math.sqrt(speed2)
    right = Vector(-k * closing_e, k * closing_n, 0.0)
    off, drift = dot(away, right), dot(own.velocity, right)
    left_s, most, acceleration = max(t - ANSWERS_S, 0.0), settings.speed_mps, settings.acceleration_mps2
    by_right = way_aside(most - drift, left_s, acceleration) - off
    by_left = way_aside(most + drift, left_s, acceleration) + off
    if max(by_right, by_left) >= radius:
        return False, Plane(velocity, 0.0)
    by_right += SAME_SIDE_M * min(max(dot(turned, right) / TURNED_MPS, -1.0), 1.0)
    side = 1.0 if by_right >= by_left else -1.0
    asked = side * drift + acceleration * max(t, settings.period_s)
    return True, Plane(times(side, right), min(asked, DEMAND * most))
