"""What moves towards us so fast that no velocity within reach keeps its volume clear: out of its way.

The plane of ORCA asks for the smallest change of velocity that keeps the volume. Near a fast aircraft that is
ahead, this change mostly points backwards, and the command spends its limited acceleration on braking, which
hardly delays the meeting. Moving aside, across the relative motion, is what leads farthest from it. This is
asked for where the position was measured from ours: what a sensor sees first at 40 m leaves three seconds,
while others are heard in time, and what is heard seconds late does not tell on which side it will pass.
"""

from __future__ import annotations

import math

from companion.avoidance.kernels.compiled import compiled
from companion.avoidance.kernels.settings import DEMAND, Own, Settings
from companion.avoidance.kernels.vectors import Plane, Vector, dot, times

ANSWERS_S = 0.5
"""Time until the vehicle follows a command; this much less is left to move aside."""
SAME_SIDE_M, TURNED_MPS = 2.0, 1.0 / 3.0
"""The side to which the command has turned from the wanted velocity already is preferred by SAME_SIDE_M, and
by less if it has turned by less than TURNED_MPS. On which side another aircraft passes is known to some
metres only at first, and who changes sides with every measurement stays in the middle."""


@compiled
def way_aside(more_mps: float, t: float, acceleration: float) -> float:
    """Way (m) in a time t (s) by accelerating until `more_mps` are reached."""
    until = max(more_mps, 0.0) / acceleration
    if t < until:
        return 0.5 * acceleration * t * t
    return acceleration * until * (t - 0.5 * until)


@compiled
def escape(
    away: Vector, velocity: Vector, own: Own, turned: Vector, radius: float, settings: Settings
) -> tuple[bool, Plane]:
    """The plane that asks to move aside, level and across the relative motion, and whether it is to replace
    that of ORCA.

    The side is the one on which the least distance can become larger, by the speed and the acceleration that
    are left there. If it can reach `radius`, nothing is to be replaced.

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
