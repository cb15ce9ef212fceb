"""What all laws of `peers` share, in compiled code: following the path, prediction, report and limits.

In the table of settings, the law of every aircraft is `kernels.NONE`, whose decision follows the path. The
column AVOIDS states whether the aircraft flies the peer's law, and the columns from FIRST on hold the law's
parameters.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.avoidance.kernels.decide import RESTART_S
from companion.avoidance.kernels.vectors import clipped
from ground_tools.campaign.compiled import compiled
from ground_tools.campaign.flight import Mind, state_of

AVOIDS: Final = len(k.Settings._fields)
FIRST: Final = AVOIDS + 1

_compiled = compiled()


@_compiled
def following(
    mind: Mind, i: int, own: k.Own, path: k.Path, fence: Floats, law: k.Settings, work: k.Workspace
) -> k.Decision:
    """The decision of aircraft i if it follows its path and avoids nobody."""
    history = k.History(mind.times_s[i], mind.velocities[i])
    nobody = int(np.int64(0))  # not a literal 0, for which numba would compile the whole law again
    return k.decide(mind.neighbours, nobody, own, path, fence, law, state_of(mind, i), history, work)


@_compiled
def beside(other: k.Other, own: k.Own, predicted: bool) -> tuple[k.Vector, k.Vector]:
    """Another aircraft's position minus the own one, and its velocity, as a receiver knows them.

    An aircraft of unknown height is assumed to be at the own height, with the own vertical speed.

    Args:
        predicted: extrapolate the position by the age of the message; otherwise use the position in the
            message.
    """
    age = other.age_s if predicted else 0.0
    away = k.Vector(
        other.n + age * other.vn - own.position.n,
        other.e + age * other.ve - own.position.e,
        other.d + age * other.vd - own.position.d,
    )
    if other.vertical_known == 0.0:
        return k.Vector(away.n, away.e, 0.0), k.Vector(other.vn, other.ve, own.velocity.d)
    return away, k.Vector(other.vn, other.ve, other.vd)


@_compiled
def report(
    seen: Floats,
    row: int,
    own: k.Own,
    wanted: k.Vector,
    away: k.Vector,
    velocity: k.Vector,
    radius_m: float,
    conflict: bool,
) -> None:
    """Write the report (`kernels.Seen`) on one neighbour."""
    t, near2 = k.closest(away, k.minus(wanted, velocity), 1e6)
    s = seen[row]
    s[0], s[1], s[2] = own.position.n + away.n, own.position.e + away.e, own.position.d + away.d
    s[3], s[4], s[5], s[6], s[7] = radius_m, 1.0 if conflict else 0.0, t, math.sqrt(near2), 0.0


@_compiled
def commanded(
    plain: k.Decision,
    found: k.Vector,
    feasible: bool,
    conflict: bool,
    own: k.Own,
    law: k.Settings,
    state: k.State,
) -> k.Decision:
    """The decision that commands a peer law's velocity, within the limits of speed, climb and acceleration.

    Args:
        plain: the decision of `following`.
        found: velocity that the peer law found, m/s.
        state: the state before `following`. After a pause, as in `kernels.decide`, the command starts again
            from the own velocity.
    """
    least, most = k.down_speeds(own, law)
    passed, before = own.now_s - state.time_s, state.command
    if not passed <= max(RESTART_S, 5.0 * law.period_s):
        passed, v = law.period_s, own.velocity
        down = min(max(v.d, -law.climb_mps), law.descent_mps)
        before = clipped(k.Vector(v.n, v.e, down), law.speed_mps)
    change = law.acceleration_mps2 * max(passed, 0.0)
    chosen = k.limit(found, before, k.Bounds(change, least, most, law.speed_mps))
    now = plain.state
    return k.Decision(
        chosen, plain.wanted, found, feasible, conflict, plain.recovering and not conflict, plain.hard,
        plain.first, False, False, False, k.State(chosen, now.time_s, now.quiet, now.delay_s, now.samples),
    )  # fmt: skip
