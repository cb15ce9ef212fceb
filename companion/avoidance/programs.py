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

import numpy as np
from numpy.typing import NDArray

from companion.avoidance.compiled import compiled

Array = NDArray[np.float64]

EPSILON = 1e-9
"""Violations and gaps (m/s) up to this count as rounding errors."""
PARALLEL = 1e-14
"""Two planes count as parallel if the square of the sine of their angle is at most this."""
ALIGNED = 2e-7
"""Gap between parallel planes, as a fraction of the greatest speed, that their remaining tilt can cause."""
HEAD_ON = 1e-6
"""Below this angle (rad) between p and v, the direction of avoidance is by convention: to the right."""


@compiled
def half_space(
    px: float,
    py: float,
    pz: float,
    vx: float,
    vy: float,
    vz: float,
    radius: float,
    tau: float,
    overlap: float,
) -> tuple[float, float, float, float]:
    """Outward normal n and signed length s of u = s n for one neighbour (s > 0: v is inside the obstacle).

    Args:
        px, py, pz: p_other - p_self, m.
        vx, vy, vz: v_self - v_other, m/s.
        radius: combined radius R, m, above 0.
        tau: horizon, s.
        overlap: time in which to separate if |p| <= R already, s.

    Returns:
        n (unit) and s (m/s). The neighbour, for which p and v are (-p, -v), gets exactly -n and the same s.
    """
    p2 = px * px + py * py + pz * pz
    r2 = radius * radius
    if p2 <= r2:
        return _sphere(px, py, pz, vx, vy, vz, radius, 1.0 / overlap)
    rate = 1.0 / tau
    wx, wy, wz = vx - px * rate, vy - py * rate, vz - pz * rate
    wp = wx * px + wy * py + wz * pz
    if wp < 0.0 and wp * wp > r2 * (wx * wx + wy * wy + wz * wz):
        return _sphere(px, py, pz, vx, vy, vz, radius, rate)
    cx, cy, cz = py * vz - pz * vy, pz * vx - px * vz, px * vy - py * vx
    cross2 = cx * cx + cy * cy + cz * cz
    tangent2 = p2 - r2  # cos(theta)^2 |p|^2
    if cross2 > HEAD_ON * HEAD_ON * p2 * (vx * vx + vy * vy + vz * vz):
        k = math.sqrt(tangent2 / cross2)
        s = k * cross2
        ex, ey, ez = k * (cy * pz - cz * py), k * (cz * px - cx * pz), k * (cx * py - cy * px)
    else:
        k = math.sqrt(tangent2 * p2)
        s = math.sqrt(tangent2 * cross2)
        ex, ey, ez = _right_of(px, py, pz)
        ex, ey, ez = k * ex, k * ey, k * ez
    # All terms of n and of u . n are divided by |p|^2: one division for all.
    k = 1.0 / p2
    s = radius * (px * vx + py * vy + pz * vz) - s
    return k * (ex - radius * px), k * (ey - radius * py), k * (ez - radius * pz), k * s


@compiled
def _sphere(
    px: float, py: float, pz: float, vx: float, vy: float, vz: float, radius: float, rate: float
) -> tuple[float, float, float, float]:
    """n = w / |w| and s = R / window - |w| for the sphere of radius R / window at p / window (rate: 1 /
    window)."""
    wx, wy, wz = vx - px * rate, vy - py * rate, vz - pz * rate
    length = math.sqrt(wx * wx + wy * wy + wz * wz)
    if length > 1e-9:
        k = 1.0 / length
        return k * wx, k * wy, k * wz, radius * rate - length
    # At the centre all directions are equally short: straight away from the other.
    length = math.sqrt(px * px + py * py + pz * pz)
    if length > 1e-9:
        return -px / length, -py / length, -pz / length, radius * rate
    # Same position and same velocity: nothing in the data distinguishes the two.
    return 1.0, 0.0, 0.0, radius * rate


@compiled
def _right_of(px: float, py: float, pz: float) -> tuple[float, float, float]:
    """Unit vector perpendicular to p, to the right seen from above (NED: from north towards east).

    It is an odd function of p, so that the two aircraft move apart. If p is vertical, there is no right: the
    upper aircraft goes north, the lower one south.
    """
    level = math.sqrt(px * px + py * py)
    if level > 1e-9 * abs(pz):
        return -py / level, px / level, 0.0
    if pz > 0.0:
        return 1.0, 0.0, 0.0
    return -1.0, 0.0, 0.0


@compiled
def _line(
    planes: Array,
    count: int,
    qx: float,
    qy: float,
    qz: float,
    lx: float,
    ly: float,
    lz: float,
    radius: float,
    ox: float,
    oy: float,
    oz: float,
    towards: bool,
) -> tuple[bool, float, float, float]:
    """Program 1: best velocity on the line q + t l (q nearest to 0, l unit), in the ball and the first
    `count` planes. The first value is False if there is none."""
    room = radius * radius - (qx * qx + qy * qy + qz * qz)
    if room < -EPSILON:
        return False, 0.0, 0.0, 0.0
    most = math.sqrt(max(room, 0.0))
    least = -most
    for j in range(count):
        slope = planes[j, 0] * lx + planes[j, 1] * ly + planes[j, 2] * lz
        need = planes[j, 3] - (planes[j, 0] * qx + planes[j, 1] * qy + planes[j, 2] * qz)
        if slope * slope <= PARALLEL:
            if need > ALIGNED * radius:
                return False, 0.0, 0.0, 0.0
            continue
        t = need / slope
        if slope > 0.0:
            least = max(least, t)
        else:
            most = min(most, t)
        if least > most + EPSILON:
            return False, 0.0, 0.0, 0.0
    wish = ox * lx + oy * ly + oz * lz
    if towards:
        t = most if wish > 0.0 else least
    else:
        t = min(max(wish, least), most)
    return True, qx + t * lx, qy + t * ly, qz + t * lz


@compiled
def _plane(
    planes: Array, i: int, radius: float, ox: float, oy: float, oz: float, towards: bool
) -> tuple[bool, float, float, float]:
    """Program 2: best velocity on plane i, in the ball and all planes before it. The first value is False if
    there is none."""
    nx, ny, nz, d = planes[i, 0], planes[i, 1], planes[i, 2], planes[i, 3]
    if abs(d) > radius:
        return False, 0.0, 0.0, 0.0
    # The point of the plane nearest to the wish, or farthest in the wish's direction along the plane.
    away = ox * nx + oy * ny + oz * nz
    gx, gy, gz = ox - away * nx, oy - away * ny, oz - away * nz
    length2 = gx * gx + gy * gy + gz * gz
    disc2 = max(radius * radius - d * d, 0.0)
    if towards:
        k = math.sqrt(disc2 / length2) if length2 > 1e-18 else 0.0
    else:
        k = math.sqrt(disc2 / length2) if length2 > disc2 else 1.0
    x, y, z = d * nx + k * gx, d * ny + k * gy, d * nz + k * gz
    for j in range(i):
        mx, my, mz, f = planes[j, 0], planes[j, 1], planes[j, 2], planes[j, 3]
        if mx * x + my * y + mz * z >= f - EPSILON:
            continue
        lx, ly, lz = ny * mz - nz * my, nz * mx - nx * mz, nx * my - ny * mx
        sine2 = lx * lx + ly * ly + lz * lz
        if sine2 <= PARALLEL:
            if f - (mx * x + my * y + mz * z) <= ALIGNED * radius:
                continue
            return False, 0.0, 0.0, 0.0
        # Measured along plane i from its own point: exactly on plane i, however small the angle.
        k = (f - d * (nx * mx + ny * my + nz * mz)) / sine2
        gx, gy, gz = ly * nz - lz * ny, lz * nx - lx * nz, lx * ny - ly * nx
        qx, qy, qz = d * nx + k * gx, d * ny + k * gy, d * nz + k * gz
        k = 1.0 / math.sqrt(sine2)
        ok, x, y, z = _line(planes, j, qx, qy, qz, lx * k, ly * k, lz * k, radius, ox, oy, oz, towards)
        if not ok:
            return False, 0.0, 0.0, 0.0
    return True, x, y, z


@compiled
def ball(
    planes: Array, count: int, radius: float, ox: float, oy: float, oz: float, towards: bool
) -> tuple[int, float, float, float]:
    """Program 3: velocity in the ball and all planes, nearest to o or (`towards`) farthest in its direction.

    Returns:
        How many planes are satisfied (`count`: all), and the velocity.
    """
    length2 = ox * ox + oy * oy + oz * oz
    k = 1.0
    if towards or length2 > radius * radius:
        k = radius / math.sqrt(length2)
    x, y, z = ox * k, oy * k, oz * k
    for i in range(count):
        if planes[i, 0] * x + planes[i, 1] * y + planes[i, 2] * z < planes[i, 3] - EPSILON:
            ok, tx, ty, tz = _plane(planes, i, radius, ox, oy, oz, towards)
            if not ok:
                return i, x, y, z
            x, y, z = tx, ty, tz
    return count, x, y, z


@compiled
def _worst_to(planes: Array, i: int, count: int, x: float, y: float, z: float, allowed: float) -> bool:
    """Swap the most violated plane of the rows from i on into row i; False if none is violated by more than
    `allowed` (m/s)."""
    worst = -1
    for j in range(i, count):
        violation = planes[j, 3] - (planes[j, 0] * x + planes[j, 1] * y + planes[j, 2] * z)
        if violation > allowed:
            worst, allowed = j, violation
    if worst < 0:
        return False
    for c in range(4):
        planes[i, c], planes[worst, c] = planes[worst, c], planes[i, c]
    return True


@compiled
def least_violation(
    planes: Array,
    hard: int,
    count: int,
    radius: float,
    x: float,
    y: float,
    z: float,
    first: int,
    scratch: Array,
) -> tuple[float, float, float]:
    """Program 4: minimise the largest violation of the planes from `first` on; the `hard` first planes stay
    satisfied."""
    for j in range(hard):
        for c in range(4):
            scratch[j, c] = planes[j, c]
    largest = 0.0
    i = max(first, hard)
    while i < count and _worst_to(planes, i, count, x, y, z, largest + EPSILON):
        nx, ny, nz, d = planes[i, 0], planes[i, 1], planes[i, 2], planes[i, 3]
        # Plane i is violated at least as much as plane j where (n_j - n_i) . v >= d_j - d_i.
        kept = hard
        for j in range(hard, i):
            bx, by, bz = planes[j, 0] - nx, planes[j, 1] - ny, planes[j, 2] - nz
            length2 = bx * bx + by * by + bz * bz
            if length2 > 1e-14:
                k = 1.0 / math.sqrt(length2)
                scratch[kept, 0], scratch[kept, 1], scratch[kept, 2] = bx * k, by * k, bz * k
                scratch[kept, 3] = (planes[j, 3] - d) * k
                kept += 1
        done, tx, ty, tz = ball(scratch, kept, radius, nx, ny, nz, True)
        if done == kept:
            x, y, z = tx, ty, tz
        largest = d - (nx * x + ny * y + nz * z)
        i += 1
    return x, y, z


@compiled
def _nearest_of_least(
    planes: Array,
    hard: int,
    count: int,
    radius: float,
    slack: float,
    ox: float,
    oy: float,
    oz: float,
    x: float,
    y: float,
    z: float,
    scratch: Array,
) -> tuple[float, float, float]:
    """The velocity nearest to o among those that exceed the largest violation of (x, y, z) by at most
    `slack`."""
    largest = slack
    for j in range(hard, count):
        violation = planes[j, 3] - (planes[j, 0] * x + planes[j, 1] * y + planes[j, 2] * z)
        largest = max(largest, violation + slack)
    for j in range(count):
        for c in range(4):
            scratch[j, c] = planes[j, c]
        if j >= hard:
            scratch[j, 3] -= largest
    kept, tx, ty, tz = ball(scratch, hard, radius, ox, oy, oz, False)
    i = hard
    ok = kept == hard
    while ok and i < count and _worst_to(scratch, i, count, tx, ty, tz, EPSILON):
        ok, nx, ny, nz = _plane(scratch, i, radius, ox, oy, oz, False)
        if ok:
            tx, ty, tz = nx, ny, nz
            i += 1
    if ok:
        return tx, ty, tz
    return x, y, z


@compiled
def solve(
    planes: Array, hard: int, count: int, radius: float, slack: float, wish: Array, scratch: Array, out: Array
) -> bool:
    """Find the velocity nearest to `wish` in the ball and all planes, or else that of least largest
    violation.

    Many velocities may have nearly the least largest violation (in a level encounter, no plane determines the
    climb). Then the one nearest to `wish` is used, so that the result does not jump between decisions.

    Args:
        planes: shape (at least count, 4), rows (n, d): n unit, n . v >= d in m/s. The `hard` first ones are
            fully satisfied; if that is not possible for all of them, as many as possible from the first on.
            The rows after them are reordered.
        radius: greatest speed, m/s.
        slack: how far the least largest violation may be exceeded to come nearer to `wish`, m/s.
        wish: shape (3,), m/s.
        scratch: shape (at least count, 4); written.
        out: shape (at least 3,); the velocity is written into its first three entries.

    Returns:
        True if every plane is satisfied.
    """
    ox, oy, oz = wish[0], wish[1], wish[2]
    kept, x, y, z = ball(planes, hard, radius, ox, oy, oz, False)
    feasible = kept == hard
    # The most violated plane is added next: a few of them satisfy the others.
    i = hard
    while feasible and i < count and _worst_to(planes, i, count, x, y, z, EPSILON):
        feasible, tx, ty, tz = _plane(planes, i, radius, ox, oy, oz, False)
        if feasible:
            x, y, z = tx, ty, tz
            i += 1
    if not feasible:
        if kept < hard:  # the remaining hard planes are treated as soft
            hard = i = kept
        x, y, z = least_violation(planes, hard, count, radius, x, y, z, max(i, hard), scratch)
        x, y, z = _nearest_of_least(planes, hard, count, radius, slack, ox, oy, oz, x, y, z, scratch)
    out[0], out[1], out[2] = x, y, z
    return feasible
