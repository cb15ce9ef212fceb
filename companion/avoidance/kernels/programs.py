"""Half-spaces and linear programs: the plane of one neighbour, and the velocity that satisfies many planes.

The half-space of a neighbour is that of ORCA (paper section II, the equations of VO, u and the ORCA set; van
den Berg et al., "Reciprocal n-body collision avoidance", in three dimensions). With p = p_other - p_self, v =
v_self - v_other and the combined radius R, the velocity obstacle is a cone around p, cut off by a sphere of
radius R / tau at p / tau. The cone's outward normal is n = cos(theta) e - sin(theta) p / |p|, where
sin(theta) = R / |p| and e is the unit vector of the component of v perpendicular to p. So u . n = sin(theta)
v.p / |p| - cos(theta) |p x v| / |p|. This is the textbook form with sqrt(b^2 - a c) = |p x v| R / sqrt(|p|^2
- R^2) substituted, which avoids cancellation near head-on encounters.

Planes are rows (n, d) that require n . v >= d. The programs find a velocity in a ball: program 1 on a line,
program 2 on a plane, program 3 in the whole ball. If there is none, program 4 minimises the largest
violation. Hard planes come first, and program 4 satisfies them fully. `solve` and program 4 add the most
violated plane next instead of the next row, because a few planes then satisfy all others, even if there are
many.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.arrays import Floats
from companion.avoidance.kernels.compiled import compiled
from companion.avoidance.kernels.vectors import (
    PLANE_COLUMNS,
    Vector,
    along,
    copy_plane,
    cross,
    dot,
    length,
    minus,
    plane_at,
    put_plane,
    times,
)

EPSILON = 1e-9
"""Violations and gaps (m/s) up to this count as rounding errors."""
PARALLEL = 1e-14
"""Two planes count as parallel if the square of the sine of their angle is at most this."""
ALIGNED = 2e-7
"""Gap between parallel planes, as a fraction of the greatest speed, that their remaining tilt can cause."""
HEAD_ON = 1e-6
"""Below this angle (rad) between p and v, the direction of avoidance is by convention: to the right."""


class Aim(NamedTuple):
    """What a program looks for in the ball of allowed velocities."""

    wish: Vector
    """m/s."""
    speed: float
    """Radius of the ball, m/s."""
    towards: bool
    """False: the velocity nearest to the wish. True: the one farthest in the wish's direction."""


@compiled
def half_space(
    p: Vector, v: Vector, radius: float, horizon_s: float, overlap_s: float
) -> tuple[Vector, float]:
    """Outward normal n and signed length s of u = s n for one neighbour (s > 0: v is inside the obstacle).

    Args:
        p: p_other - p_self, m.
        v: v_self - v_other, m/s.
        radius: combined radius R, m, above 0.
        horizon_s: horizon tau.
        overlap_s: time in which to separate if |p| <= R already.

    Returns:
        n (unit) and s (m/s). The neighbour, for which p and v are (-p, -v), gets exactly -n and the same s.
    """
    p2 = dot(p, p)
    r2 = radius * radius
    if p2 <= r2:
        return _sphere(p, v, radius, 1.0 / overlap_s)
    rate = 1.0 / horizon_s
    w = along(v, -rate, p)
    wp = dot(w, p)
    if wp < 0.0 and wp * wp > r2 * dot(w, w):
        return _sphere(p, v, radius, rate)
    c = cross(p, v)
    cross2 = dot(c, c)
    tangent2 = p2 - r2  # cos(theta)^2 |p|^2
    if cross2 > HEAD_ON * HEAD_ON * p2 * dot(v, v):
        k = math.sqrt(tangent2 / cross2)
        s = k * cross2
        aside = times(k, cross(c, p))
    else:
        k = math.sqrt(tangent2 * p2)
        s = math.sqrt(tangent2 * cross2)
        aside = times(k, _right_of(p))
    # All terms of n and of u . n are divided by |p|^2: one division for all.
    k = 1.0 / p2
    s = radius * dot(p, v) - s
    return times(k, along(aside, -radius, p)), k * s


@compiled
def _sphere(p: Vector, v: Vector, radius: float, rate: float) -> tuple[Vector, float]:
    """n = w / |w| and s = R / window - |w| for the sphere of radius R / window at p / window (rate: 1 /
    window)."""
    w = along(v, -rate, p)
    size = length(w)
    if size > 1e-9:
        return times(1.0 / size, w), radius * rate - size
    # At the centre all directions are equally short: straight away from the other.
    size = length(p)
    if size > 1e-9:
        return Vector(-p.n / size, -p.e / size, -p.d / size), radius * rate
    # Same position and same velocity: nothing in the data distinguishes the two.
    return Vector(1.0, 0.0, 0.0), radius * rate


@compiled
def _right_of(p: Vector) -> Vector:
    """Unit vector perpendicular to p, to the right seen from above (NED: from north towards east).

    It is an odd function of p, so that the two aircraft move apart. If p is vertical, there is no right: the
    upper aircraft goes north, the lower one south.
    """
    level = math.sqrt(p.n * p.n + p.e * p.e)
    if level > 1e-9 * abs(p.d):
        return Vector(-p.e / level, p.n / level, 0.0)
    if p.d > 0.0:
        return Vector(1.0, 0.0, 0.0)
    return Vector(-1.0, 0.0, 0.0)


@compiled
def _line(planes: Floats, count: int, q: Vector, way: Vector, aim: Aim) -> tuple[bool, Vector]:
    """Program 1: best velocity on the line q + t way (q nearest to 0, way unit), in the ball and the first
    `count` planes. The first value is False if there is none."""
    room = aim.speed * aim.speed - dot(q, q)
    if room < -EPSILON:
        return False, q
    most = math.sqrt(max(room, 0.0))
    least = -most
    for j in range(count):
        plane = plane_at(planes, j)
        slope = dot(plane.normal, way)
        need = plane.least - dot(plane.normal, q)
        if slope * slope <= PARALLEL:
            if need > ALIGNED * aim.speed:
                return False, q
            continue
        t = need / slope
        if slope > 0.0:
            least = max(least, t)
        else:
            most = min(most, t)
        if least > most + EPSILON:
            return False, q
    wish = dot(aim.wish, way)
    if aim.towards:
        t = most if wish > 0.0 else least
    else:
        t = min(max(wish, least), most)
    return True, along(q, t, way)


@compiled
def _plane(planes: Floats, i: int, aim: Aim) -> tuple[bool, Vector]:
    """Program 2: best velocity on plane i, in the ball and all planes before it. The first value is False if
    there is none."""
    n, d = plane_at(planes, i)
    if abs(d) > aim.speed:
        return False, n
    # The point of the plane nearest to the wish, or farthest in the wish's direction along the plane.
    g = along(aim.wish, -dot(aim.wish, n), n)
    length2 = dot(g, g)
    disc2 = max(aim.speed * aim.speed - d * d, 0.0)
    if aim.towards:
        k = math.sqrt(disc2 / length2) if length2 > 1e-18 else 0.0
    else:
        k = math.sqrt(disc2 / length2) if length2 > disc2 else 1.0
    foot = times(d, n)
    v = along(foot, k, g)
    for j in range(i):
        m, least = plane_at(planes, j)
        if dot(m, v) >= least - EPSILON:
            continue
        way = cross(n, m)
        sine2 = dot(way, way)
        if sine2 <= PARALLEL:
            if least - dot(m, v) <= ALIGNED * aim.speed:
                continue
            return False, v
        # Measured along plane i from its own point: exactly on plane i, however small the angle.
        k = (least - d * dot(n, m)) / sine2
        q = along(foot, k, cross(way, n))
        ok, v = _line(planes, j, q, times(1.0 / math.sqrt(sine2), way), aim)
        if not ok:
            return False, v
    return True, v


@compiled
def ball(planes: Floats, count: int, aim: Aim) -> tuple[int, Vector]:
    """Program 3: the velocity that is aimed at, in the ball and all planes.

    Returns:
        How many planes are satisfied (`count`: all), and the velocity.
    """
    length2 = dot(aim.wish, aim.wish)
    k = 1.0
    if aim.towards or length2 > aim.speed * aim.speed:
        k = aim.speed / math.sqrt(length2)
    v = times(k, aim.wish)
    for i in range(count):
        plane = plane_at(planes, i)
        if dot(plane.normal, v) < plane.least - EPSILON:
            ok, better = _plane(planes, i, aim)
            if not ok:
                return i, v
            v = better
    return count, v


@compiled
def _worst_to(planes: Floats, i: int, count: int, v: Vector, allowed: float) -> bool:
    """Swap the most violated plane of the rows from i on into row i; False if none is violated by more than
    `allowed` (m/s)."""
    worst = -1
    for j in range(i, count):
        plane = plane_at(planes, j)
        violation = plane.least - dot(plane.normal, v)
        if violation > allowed:
            worst, allowed = j, violation
    if worst < 0:
        return False
    for c in range(PLANE_COLUMNS):
        planes[i, c], planes[worst, c] = planes[worst, c], planes[i, c]
    return True


@compiled
def least_violation(
    planes: Floats, hard: int, count: int, speed: float, v: Vector, first: int, scratch: Floats
) -> Vector:
    """Program 4: minimise the largest violation of the planes from `first` on; the `hard` first planes stay
    satisfied."""
    for j in range(hard):
        copy_plane(planes, j, scratch, j)
    largest = 0.0
    i = max(first, hard)
    while i < count and _worst_to(planes, i, count, v, largest + EPSILON):
        n, d = plane_at(planes, i)
        # Plane i is violated at least as much as plane j where (n_j - n_i) . v >= d_j - d_i.
        kept = hard
        for j in range(hard, i):
            plane = plane_at(planes, j)
            between = minus(plane.normal, n)
            length2 = dot(between, between)
            if length2 > 1e-14:
                k = 1.0 / math.sqrt(length2)
                put_plane(scratch, kept, times(k, between), (plane.least - d) * k)
                kept += 1
        done, better = ball(scratch, kept, Aim(n, speed, True))
        if done == kept:
            v = better
        largest = d - dot(n, v)
        i += 1
    return v


@compiled
def _nearest_of_least(
    planes: Floats, hard: int, count: int, aim: Aim, slack: float, v: Vector, scratch: Floats
) -> Vector:
    """The velocity nearest to the wish among those that exceed the largest violation of v by at most
    `slack`."""
    largest = slack
    for j in range(hard, count):
        plane = plane_at(planes, j)
        violation = plane.least - dot(plane.normal, v)
        largest = max(largest, violation + slack)
    for j in range(count):
        plane = plane_at(planes, j)
        put_plane(scratch, j, plane.normal, plane.least - largest if j >= hard else plane.least)
    kept, found = ball(scratch, hard, aim)
    i = hard
    ok = kept == hard
    while ok and i < count and _worst_to(scratch, i, count, found, EPSILON):
        ok, better = _plane(scratch, i, aim)
        if ok:
            found = better
            i += 1
    return found if ok else v


@compiled
def solve(
    planes: Floats, hard: int, count: int, speed: float, slack: float, wish: Vector, scratch: Floats
) -> tuple[bool, Vector]:
    """Find the velocity nearest to `wish` in the ball and all planes, or else that of least largest
    violation.

    Many velocities may have nearly the least largest violation (in a level encounter, no plane determines the
    climb). Then the one nearest to `wish` is used, so that the result does not jump between decisions.

    Args:
        planes: table of at least `count` planes. The `hard` first ones are fully satisfied; if that is not
            possible for all of them, as many as possible from the first on. The rows after them are
            reordered.
        speed: greatest speed, m/s.
        slack: how far the least largest violation may be exceeded to come nearer to `wish`, m/s.
        wish: m/s.
        scratch: table of at least `count` planes; written.

    Returns:
        Whether every plane is satisfied, and the velocity.
    """
    aim = Aim(wish, speed, False)
    kept, v = ball(planes, hard, aim)
    feasible = kept == hard
    # The most violated plane is added next: a few of them satisfy the others.
    i = hard
    while feasible and i < count and _worst_to(planes, i, count, v, EPSILON):
        feasible, better = _plane(planes, i, aim)
        if feasible:
            v = better
            i += 1
    if not feasible:
        if kept < hard:  # the remaining hard planes are treated as soft
            hard = i = kept
        v = least_violation(planes, hard, count, speed, v, max(i, hard), scratch)
        v = _nearest_of_least(planes, hard, count, aim, slack, v, scratch)
    return feasible, v
