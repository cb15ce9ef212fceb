"""The numeric law: half-spaces, linear programs and one decision, compiled by numba in double precision.

One neighbour's half-space is ORCA's (paper section II, the equations of VO, u and the ORCA set; van den Berg
et al., "Reciprocal n-body collision avoidance", in three dimensions). With p = p_other - p_self,
v = v_self - v_other and R the combined radius, the velocity obstacle is a cone around p cut off by a sphere
of radius R / tau at p / tau. The cone's outward normal is n = cos(theta) e - sin(theta) p / |p|, where
sin(theta) = R / |p| and e is the unit vector of v across p; so u . n = sin(theta) v.p / |p| -
cos(theta) |p x v| / |p|. This is the textbook form with sqrt(b^2 - a c) = |p x v| R / sqrt(|p|^2 - R^2) put
in: nothing cancels near a head-on encounter.

Planes are rows (n, d) that ask for n . v >= d. The programs look for a velocity in a ball: program 1 on a
line, 2 on a plane, 3 in the ball, 4 the least of the largest violations when there is none; hard planes come
first and program 4 keeps them whole. Programs 3 and 4 take up the most violated plane next, not the next in
the row: a few planes then settle all the others, however many there are.

`decide` is all of a law, from the own state, the path and what was heard to the command. Every function works
on arrays that the caller owns, so that a compiled loop over many aircraft calls it as the aircraft does; it
runs uncompiled too. All of them stand in this one file because numba's
cache looks only at the file of the function that is called: a change elsewhere would go unnoticed.
"""

from __future__ import annotations

import math
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Function = TypeVar("Function")
# Without numba's runtime what allocates does not compile, and references to arrays are not counted.
_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "_nrt": False}


def _compiled(function: Function) -> Function:
    try:
        return cast(Function, njit(**_OPTIONS)(function))
    except RuntimeError:
        # No folder takes the cache (NUMBA_CACHE_DIR names one): compiled anew at every start.
        return cast(Function, njit(**{**_OPTIONS, "cache": False})(function))


EPSILON = 1e-9
"""Violations and gaps (m/s) up to this are rounding."""
PARALLEL = 1e-14
"""Square of the sine under which two planes count as parallel."""
SLACK_MPS = 0.02
"""Of a decision that cannot keep every plane."""
ALIGNED = 2e-7
"""Gap, in parts of the greatest speed, that the tilt of parallel planes explains."""
HEAD_ON = 1e-6
"""Angle (rad) between p and v under which the way out is a convention: to the right."""

# Columns of a row of `neighbours`.
N_POSITION, N_VELOCITY, N_AGE = 0, 3, 6  # at the message's own time; s
(
    N_SIGMA,  # m for each horizontal axis
    N_SIGMA_VELOCITY,  # m/s for each axis
    N_GROWTH,  # m/s, what `note_track` says of its past
    N_SILENT,  # 1: not heard for so long that it may have stopped
    N_SHARE,  # of what is needed that is ours, 0.5 to 1
    N_VERTICAL,  # 1: its height is known
    N_CREWED,  # 1: crewed traffic, with separations of its own
    NEIGHBOUR_COLUMNS,
) = range(7, 15)
# Entries of `own`; floor and ceiling are NED down, infinite (plus, minus) where there is none.
O_POSITION, O_VELOCITY, O_SIGMA, O_NOW, O_PATH_TIME, O_FLOOR, O_CEILING = 0, 3, 6, 7, 8, 9, 10
OWN_ENTRIES = 11
# Entries of `settings`.
(
    S_LAW,  # DMUCA, PAPER or NONE
    S_RADIUS,  # both conflict radii, m
    S_LEAST_MARGIN,  # m
    S_SIGMAS,  # margin in standard deviations of the relative error
    S_QUANTUM,  # m/s, error of a sent velocity's steps
    S_GROWTH,  # 0: what tracks did before does not count, 1: it does
    S_CREWED,  # separation from crewed traffic, m
    S_CREWED_VERTICAL,  # as S_VERTICAL
    S_CREWED_HORIZON,  # as S_HORIZON, s
    S_VERTICAL,  # factor on vertical distances: under 1 the volume is taller than wide
    S_HORIZON,  # tau, s
    S_OVERLAP,  # time in which to leave a volume, s
    S_LOOK,  # s, window of the conflict test
    S_RIGHT,  # rad, turn to the right when in conflict
    S_SPEED,  # greatest speed, m/s
    S_CLIMB,  # greatest climb, m/s
    S_DESCENT,  # greatest descent, m/s
    S_ACCELERATION,  # greatest change of the command, m/s^2
    S_PERIOD,  # between two decisions, s
    S_RECOVERY,  # T: time to close the gap to the path's point, s
    S_TURN,  # s before and after over which the path's corners are rounded, above 0
    S_QUIET,  # cycles without conflict before the published law recovers
    S_REGAINED,  # m from the path's point that count as back on it
    S_CATCH_UP,  # s: a gap along the path that takes longer to close delays the path; 0: never
    SETTINGS_ENTRIES,
) = range(25)
DMUCA, PAPER, NONE = 0.0, 1.0, 2.0
# Entries of `state`, what a law remembers: the last command and its time (NaN before the first one), quiet
# cycles, by how much the path is delayed, samples in the history of own velocities.
L_COMMAND, L_TIME, L_QUIET, L_DELAY, L_HISTORY, STATE_ENTRIES = 0, 3, 4, 5, 6, 7
# Columns of a row of `view`: predicted position, radius, conflict (0 or 1), time and distance at the closest,
# plane, and that of where it would stand (0 where there is none).
V_POSITION, V_RADIUS, V_CONFLICT, V_TIME, V_DISTANCE = 0, 3, 4, 5, 6
V_PLANE, V_STANDING, VIEW_COLUMNS = 7, 11, 15
# Columns of a row of `fence`, an edge or a circle: number of its area, rising from row to row; what the area
# is; corners north, east, or a circle's middle and radius, m; share of the acceleration with which it stops
# before the wall, the rest is left to turn.
W_AREA, W_KIND, W_FROM, W_TO, W_BRAKES, WALL_COLUMNS = 0, 1, 2, 4, 6, 7
IN_POLYGON, OUT_OF_POLYGON, IN_CIRCLE, OUT_OF_CIRCLE = 0.0, 1.0, 2.0, 3.0
# What is remembered of a track by `note_track`: a message's time, position, velocity; growth; silence.
T_TIME, T_POSITION, T_VELOCITY, T_GROWTH, T_GAP, TRACK_ENTRIES = 0, 1, 4, 7, 8, 9
# Entries of `out`: the command, what would be flown alone; 0 or 1: every plane kept, a volume would be
# broken by flying alone, on the way back to the path; first row of `planes` that is a neighbour's, hard
# planes; what the law would command if it could change the velocity at once; s, by
# which the path waits.
R_CHOSEN, R_WANTED, R_FEASIBLE, R_CONFLICT, R_RECOVERING = 0, 3, 6, 7, 8
R_NEIGHBOURS, R_HARD, R_SOLVED, R_LATE, OUT_ENTRIES = 9, 10, 11, 14, 15

DOWN_SPEEDS = 2
"""First planes of a decision, hard: the least and the greatest down speed."""
BOUNDARY_LAG_S = 1.0
"""From a decision to the vehicle's answer, at floor and ceiling: autopilot lag, period and latency."""
RESTART_S = 1.0
"""After a pause longer than this (and five periods) the command starts again from the velocity flown."""
DEMAND = 2.0
"""Most that one neighbour's plane asks for, in parts of the greatest speed."""
FENCE_MARGIN_M = 2.0
"""Kept from a fence besides two standard deviations of the own position."""
FENCE_BACK = 0.2
"""Speed back out of a fence's margin, in parts of the greatest."""
NEWS_S = 0.9
"""A track's past is judged by messages at least this far apart."""
GROWTH_MEMORY_S = 40.0
GROWTH_MOST_MPS = 3.0
GROWTH_AHEAD_S = 4.0
"""A track's deviations count from its message to this long after now."""
SILENT_S, SILENT_GAPS = 2.0, 1.5
"""A track of which nothing was received for longer than this and this many of its longest gaps lately may
have stopped: delays that differ by a second make gaps of 2 s of one message a second."""
GAP_MEMORY_S = 60.0
STOPS_S = 1.0
"""It then stands where it would have been so long after its last message."""
HISTORY_SPACING_S = 0.04
HISTORY_SAMPLES = 1024
"""Half of them stay when they are full: at this spacing 20 s, more than the oldest message's age."""


@_compiled
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
        overlap: time in which to separate when |p| <= R already, s.

    Returns:
        n (unit) and s (m/s). The neighbour that sees (-p, -v) gets exactly -n, and the same s.
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
    # Both terms of n and of u . n over |p|^2: one division for all.
    k = 1.0 / p2
    s = radius * (px * vx + py * vy + pz * vz) - s
    return k * (ex - radius * px), k * (ey - radius * py), k * (ez - radius * pz), k * s


@_compiled
def _sphere(
    px: float, py: float, pz: float, vx: float, vy: float, vz: float, radius: float, rate: float
) -> tuple[float, float, float, float]:
    """The sphere of radius R / window at p / window, rate = 1 / window: n = w / |w|, s = R / window - |w|."""
    wx, wy, wz = vx - px * rate, vy - py * rate, vz - pz * rate
    length = math.sqrt(wx * wx + wy * wy + wz * wz)
    if length > 1e-9:
        k = 1.0 / length
        return k * wx, k * wy, k * wz, radius * rate - length
    # In the very centre every way out is as long: straight away from the other.
    length = math.sqrt(px * px + py * py + pz * pz)
    if length > 1e-9:
        return -px / length, -py / length, -pz / length, radius * rate
    # Same place and same velocity: nothing in the data tells the two apart.
    return 1.0, 0.0, 0.0, radius * rate


@_compiled
def _right_of(px: float, py: float, pz: float) -> tuple[float, float, float]:
    """Unit vector across p, to the right seen from above (NED: north turns to east).

    Odd in p, so that the two aircraft part. Straight above or below there is no right: the upper one goes
    north, the lower one south.
    """
    level = math.sqrt(px * px + py * py)
    if level > 1e-9 * abs(pz):
        return -py / level, px / level, 0.0
    if pz > 0.0:
        return 1.0, 0.0, 0.0
    return -1.0, 0.0, 0.0


@_compiled
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
    """Program 1: on the line q + t l (q nearest to 0, l unit), in the ball and the first `count` planes."""
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


@_compiled
def _plane(
    planes: Array, i: int, radius: float, ox: float, oy: float, oz: float, towards: bool
) -> tuple[bool, float, float, float]:
    """Program 2: on plane i, inside the ball and the planes before it."""
    nx, ny, nz, d = planes[i, 0], planes[i, 1], planes[i, 2], planes[i, 3]
    if abs(d) > radius:
        return False, 0.0, 0.0, 0.0
    # The point in the plane nearest to the wish (or the wish's direction along the plane).
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
        # From plane i's own point along the plane: exact on plane i however small the angle.
        k = (f - d * (nx * mx + ny * my + nz * mz)) / sine2
        gx, gy, gz = ly * nz - lz * ny, lz * nx - lx * nz, lx * ny - ly * nx
        qx, qy, qz = d * nx + k * gx, d * ny + k * gy, d * nz + k * gz
        k = 1.0 / math.sqrt(sine2)
        ok, x, y, z = _line(planes, j, qx, qy, qz, lx * k, ly * k, lz * k, radius, ox, oy, oz, towards)
        if not ok:
            return False, 0.0, 0.0, 0.0
    return True, x, y, z


@_compiled
def _ball(
    planes: Array, count: int, radius: float, ox: float, oy: float, oz: float, towards: bool
) -> tuple[int, float, float, float]:
    """Program 3: how many planes are kept (`count`: all); the velocity nearest to or farthest towards o."""
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


@_compiled
def _worst_to(planes: Array, i: int, count: int, x: float, y: float, z: float, allowed: float) -> bool:
    """Bring the most violated plane of row i and after to row i; False: none by more than allowed (m/s)."""
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


@_compiled
def _least_violation(
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
    """Program 4: from plane `first` on, lower the largest violation; the `hard` first planes stay whole."""
    for j in range(hard):
        for c in range(4):
            scratch[j, c] = planes[j, c]
    largest = 0.0
    i = max(first, hard)
    while i < count and _worst_to(planes, i, count, x, y, z, largest + EPSILON):
        nx, ny, nz, d = planes[i, 0], planes[i, 1], planes[i, 2], planes[i, 3]
        # Where plane i is violated at least as much as plane j: (n_j - n_i) . v >= d_j - d_i.
        kept = hard
        for j in range(hard, i):
            bx, by, bz = planes[j, 0] - nx, planes[j, 1] - ny, planes[j, 2] - nz
            length2 = bx * bx + by * by + bz * bz
            if length2 > 1e-14:
                k = 1.0 / math.sqrt(length2)
                scratch[kept, 0], scratch[kept, 1], scratch[kept, 2] = bx * k, by * k, bz * k
                scratch[kept, 3] = (planes[j, 3] - d) * k
                kept += 1
        done, tx, ty, tz = _ball(scratch, kept, radius, nx, ny, nz, True)
        if done == kept:
            x, y, z = tx, ty, tz
        largest = d - (nx * x + ny * y + nz * z)
        i += 1
    return x, y, z


@_compiled
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
    """Of the velocities that violate no plane by more than (x, y, z) does and `slack`, the nearest to o."""
    largest = slack
    for j in range(hard, count):
        violation = planes[j, 3] - (planes[j, 0] * x + planes[j, 1] * y + planes[j, 2] * z)
        largest = max(largest, violation + slack)
    for j in range(count):
        for c in range(4):
            scratch[j, c] = planes[j, c]
        if j >= hard:
            scratch[j, 3] -= largest
    kept, tx, ty, tz = _ball(scratch, hard, radius, ox, oy, oz, False)
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


@_compiled
def solve(
    planes: Array, hard: int, count: int, radius: float, slack: float, wish: Array, scratch: Array, out: Array
) -> bool:
    """Velocity nearest to `wish` in the ball and every plane; if there is none, of least largest violation.

    Many velocities may have the least largest violation, or nearly so (nothing in a level encounter says how
    to climb); then it is the one nearest to `wish`, which keeps the answer from jumping.

    Args:
        planes: shape (at least count, 4), rows (n, d): n unit, n . v >= d in m/s. The `hard` first ones are
            kept whole; if they are not possible together, as many of the first as are. Those after them
            change places.
        radius: greatest speed, m/s.
        slack: how much more than the least largest violation may be taken to come nearer to `wish`, m/s.
        wish: shape (3,), m/s.
        scratch: shape (at least count, 4); written.
        out: shape (at least 3,); the velocity is written into its first three entries.

    Returns:
        True when every plane is kept.
    """
    ox, oy, oz = wish[0], wish[1], wish[2]
    kept, x, y, z = _ball(planes, hard, radius, ox, oy, oz, False)
    feasible = kept == hard
    # The most violated plane is added next: a few of them settle the others.
    i = hard
    while feasible and i < count and _worst_to(planes, i, count, x, y, z, EPSILON):
        feasible, tx, ty, tz = _plane(planes, i, radius, ox, oy, oz, False)
        if feasible:
            x, y, z = tx, ty, tz
            i += 1
    if not feasible:
        if kept < hard:  # the rest of them are soft then
            hard = i = kept
        x, y, z = _least_violation(planes, hard, count, radius, x, y, z, max(i, hard), scratch)
        x, y, z = _nearest_of_least(planes, hard, count, radius, slack, ox, oy, oz, x, y, z, scratch)
    out[0], out[1], out[2] = x, y, z
    return feasible


@_compiled
def closest(
    px: float, py: float, pz: float, vx: float, vy: float, vz: float, window: float
) -> tuple[float, float]:
    """Time (s, in [0, window]) and square of the least distance (m^2) while p - v t closes or opens."""
    t = 0.0
    v2 = vx * vx + vy * vy + vz * vz
    if v2 > 0.0:
        t = min(max((px * vx + py * vy + pz * vz) / v2, 0.0), window)
    dx, dy, dz = px - vx * t, py - vy * t, pz - vz * t
    return t, dx * dx + dy * dy + dz * dz


@_compiled
def note_velocity(
    state: Array, times: Array, velocities: Array, now: float, vn: float, ve: float, vd: float
) -> None:
    """Add an own velocity to the history, oldest first; what is not newer or not finite is passed over."""
    n = int(state[L_HISTORY])
    if not math.isfinite(now + vn + ve + vd) or (n > 0 and now <= times[n - 1]):
        return
    if n > 1 and times[n - 1] - times[n - 2] < HISTORY_SPACING_S:
        n -= 1  # a fast caller: the newest sample moves along
    elif n == len(times):
        half = n // 2
        for i in range(half):
            times[i] = times[n - half + i]
            for c in range(3):
                velocities[i, c] = velocities[n - half + i, c]
        n = half
    times[n] = now
    velocities[n, 0], velocities[n, 1], velocities[n, 2] = vn, ve, vd
    state[L_HISTORY] = n + 1


@_compiled
def note_track(
    track: Array, t: float, pn: float, pe: float, pd: float, vn: float, ve: float, vd: float, sigma: float
) -> None:
    """Learn from a new message how fast a track leaves its own predictions.

    A neighbour that manoeuvres is not where its last message says. What noise cannot explain of the distance
    between a message and the prediction of the one before, over the time between them, is a speed; twice the
    largest one lately, halved every 28 s, is the growth.

    Args:
        track: TRACK_ENTRIES values, all 0 but T_TIME, which is -inf, before the first message; written.
        t: the message's own time, s; an older one is passed over.
        pn, pe, pd, vn, ve, vd: its position and velocity, NED, m and m/s.
        sigma: declared error of the position, m for each axis.
    """
    passed = t - track[T_TIME]
    if not passed >= NEWS_S:
        return
    if passed < math.inf:
        away = math.sqrt(
            (pn - track[T_POSITION] - passed * track[T_VELOCITY]) ** 2
            + (pe - track[T_POSITION + 1] - passed * track[T_VELOCITY + 1]) ** 2
            + (pd - track[T_POSITION + 2] - passed * track[T_VELOCITY + 2]) ** 2
        )
        noise = 0.35 * (max(sigma, 1.0) + passed)
        news = min(2.0 * max(away - noise, 0.0) / passed, GROWTH_MOST_MPS)
        track[T_GROWTH] = max(track[T_GROWTH] * math.exp(-passed / GROWTH_MEMORY_S), news)
        track[T_GAP] = max(track[T_GAP] * math.exp(-passed / GAP_MEMORY_S), passed)
    track[T_TIME] = t
    track[T_POSITION], track[T_POSITION + 1], track[T_POSITION + 2] = pn, pe, pd
    track[T_VELOCITY], track[T_VELOCITY + 1], track[T_VELOCITY + 2] = vn, ve, vd


@_compiled
def silent_after(track: Array) -> float:
    """Time (s) from the last reception after which silence says something, by what `note_track` remembers."""
    return float(SILENT_S + SILENT_GAPS * max(track[T_GAP], 1.0))


@_compiled
def _between(times: Array, rows: Array, count: int, t: float) -> tuple[float, float, float]:
    """Of the `count` first rows, at rising times, the one at t on a straight line between two; the first or
    last one outside of their time."""
    low, high = 0, count - 1
    if t <= times[low]:
        return rows[low, 0], rows[low, 1], rows[low, 2]
    if t >= times[high]:
        return rows[high, 0], rows[high, 1], rows[high, 2]
    while high - low > 1:
        middle = (low + high) // 2
        if times[middle] <= t:
            low = middle
        else:
            high = middle
    k = (t - times[low]) / (times[high] - times[low])
    return (
        rows[low, 0] + k * (rows[high, 0] - rows[low, 0]),
        rows[low, 1] + k * (rows[high, 1] - rows[low, 1]),
        rows[low, 2] + k * (rows[high, 2] - rows[low, 2]),
    )


@_compiled
def own_velocity_at(times: Array, velocities: Array, count: int, t: float) -> tuple[float, float, float]:
    """Own velocity at a time, between the samples of the history; its first or last one outside of it."""
    return _between(times, velocities, count, t)


@_compiled
def path_position(times: Array, points: Array, t: float) -> tuple[float, float, float]:
    """Point of a timed path at a time; its first or last point outside of its own time.

    Args:
        times: shape (K,), strictly rising, s.
        points: shape (K, 3), NED, m.
    """
    return _between(times, points, len(times), t)


@_compiled
def path_nearest(
    times: Array, points: Array, x: float, y: float, z: float
) -> tuple[float, float, float, float]:
    """Time and place of a path's point nearest to a position; the earliest of equally near ones."""
    least = math.inf
    t = n = e = d = 0.0
    for i in range(len(times) - 1):
        ax, ay, az = points[i, 0], points[i, 1], points[i, 2]
        sx, sy, sz = points[i + 1, 0] - ax, points[i + 1, 1] - ay, points[i + 1, 2] - az
        gx, gy, gz = x - ax, y - ay, z - az
        length2 = sx * sx + sy * sy + sz * sz
        share = 0.0
        if length2 > 0.0:
            share = min(max((gx * sx + gy * sy + gz * sz) / length2, 0.0), 1.0)
        gx, gy, gz = gx - share * sx, gy - share * sy, gz - share * sz
        gap2 = gx * gx + gy * gy + gz * gz
        if gap2 < least:
            least = gap2
            t = times[i] + share * (times[i + 1] - times[i])
            n, e, d = ax + share * sx, ay + share * sy, az + share * sz
    return t, n, e, d


@_compiled
def _clipped(n: float, e: float, d: float, speed: float) -> tuple[float, float, float]:
    """The velocity, shortened to a speed where it is faster."""
    length = math.sqrt(n * n + e * e + d * d)
    if length <= speed:
        return n, e, d
    k = speed / length
    return n * k, e * k, d * k


@_compiled
def _closing(room: float, acceleration: float) -> float:
    """Speed at which it still stops at a boundary: v lag + v^2 / (2 a) = room; beyond it, the way back."""
    if room <= 0.0:
        return room / BOUNDARY_LAG_S
    lag = acceleration * BOUNDARY_LAG_S
    return math.sqrt(lag * lag + 2.0 * acceleration * room) - lag


@_compiled
def _down_speeds(own: Array, settings: Array) -> tuple[float, float]:
    """Least and greatest down speed: climb, descent, and what still stops before floor and ceiling."""
    down, acceleration = own[O_POSITION + 2], settings[S_ACCELERATION]
    least, most = -settings[S_CLIMB], settings[S_DESCENT]
    most = min(max(_closing(own[O_FLOOR] - down, acceleration), least), most)
    least = min(max(-_closing(down - own[O_CEILING], acceleration), least), settings[S_DESCENT])
    # In a thin layer the way back from one may be faster than the other allows.
    return min(least, most), most


@_compiled
def nearest_of_wall(wall: Array, n: float, e: float) -> tuple[float, float, float]:
    """Distance (m) to the nearest point of an edge or a circle, and the unit vector from there to (n, e)."""
    if wall[W_KIND] >= IN_CIRCLE:
        dn, de = n - wall[W_FROM], e - wall[W_FROM + 1]
        length = math.sqrt(dn * dn + de * de)
        if length < 1e-9:
            dn, de, length = 1.0, 0.0, 1.0
        room = math.sqrt((n - wall[W_FROM]) ** 2 + (e - wall[W_FROM + 1]) ** 2) - wall[W_TO]
        k = 1.0 / length if room >= 0.0 else -1.0 / length
        return abs(room), k * dn, k * de
    an, ae = wall[W_FROM], wall[W_FROM + 1]
    sn, se = wall[W_TO] - an, wall[W_TO + 1] - ae
    share = min(max(((n - an) * sn + (e - ae) * se) / (sn * sn + se * se), 0.0), 1.0)
    dn, de = n - an - share * sn, e - ae - share * se
    length = math.sqrt(dn * dn + de * de)
    if length < 1e-9:  # on the edge itself: nothing tells the sides apart
        return 0.0, 0.0, 0.0
    return length, dn / length, de / length


@_compiled
def inside(fence: Array, first: int, after: int, n: float, e: float) -> bool:
    """Whether a point is inside the polygon or circle of the rows from `first` to before `after`."""
    if fence[first, W_KIND] >= IN_CIRCLE:
        dn, de = n - fence[first, W_FROM], e - fence[first, W_FROM + 1]
        return bool(dn * dn + de * de < fence[first, W_TO] ** 2)
    inside = False
    for i in range(first, after):
        an, ae = fence[i, W_FROM], fence[i, W_FROM + 1]
        bn, be = fence[i, W_TO], fence[i, W_TO + 1]
        if (ae > e) != (be > e) and n < an + (e - ae) / (be - ae) * (bn - an):
            inside = not inside
    return inside


@_compiled
def _fence(fence: Array, own: Array, settings: Array, planes: Array, at: int) -> tuple[int, int]:
    """Planes of the fence, from row `at` on: hard ones, then a soft one; the rows after each.

    On the right side of an area, each wall within reach asks for a speed towards it at which the aircraft
    still stops before the margin, by the same law as floor and ceiling; standing still is allowed. Within the
    margin of the nearest of them there is a way back, where that breaks no other. On the wrong side of areas,
    the nearest of their walls is to be crossed back: one soft plane.
    """
    n, e, speed = own[O_POSITION], own[O_POSITION + 1], settings[S_SPEED]
    margin = FENCE_MARGIN_M + 2.0 * own[O_SIGMA]
    back, bn, be = math.inf, 0.0, 0.0
    nearest, least_room = -1, margin
    start = at
    first = 0
    while first < len(fence):
        after = first + 1
        while after < len(fence) and fence[after, W_AREA] == fence[first, W_AREA]:
            after += 1
        right = inside(fence, first, after, n, e) == (fence[first, W_KIND] in (IN_POLYGON, IN_CIRCLE))
        for i in range(first, after):
            room, dn, de = nearest_of_wall(fence[i], n, e)
            if dn * dn + de * de == 0.0:  # on the border itself: nothing tells the sides apart
                continue
            if right:
                closing = _closing(max(room - margin, 0.0), fence[i, W_BRAKES] * settings[S_ACCELERATION])
                if closing >= speed:  # too far away to bind
                    continue
                planes[at, 0], planes[at, 1], planes[at, 2], planes[at, 3] = dn, de, 0.0, -closing
                if room < least_room:
                    nearest, least_room = at, room
                at += 1
            elif room < back:
                back, bn, be = room, dn, de
        first = after
    hard = at
    if nearest >= 0:
        dn, de = planes[nearest, 0], planes[nearest, 1]
        outward = min((margin - least_room) / BOUNDARY_LAG_S, FENCE_BACK * speed)
        for j in range(start, hard):
            if j != nearest and outward * (planes[j, 0] * dn + planes[j, 1] * de) < planes[j, 3]:
                outward = 0.0
        planes[nearest, 3] = outward
    if back < math.inf:
        planes[at, 0], planes[at, 1], planes[at, 2] = -bn, -be, 0.0
        planes[at, 3] = min((back + margin) / BOUNDARY_LAG_S, 0.5 * speed)
        at += 1
    return hard, at


@_compiled
def _preferred(
    own: Array, times: Array, points: Array, settings: Array, delay: float, least: float, most: float
) -> tuple[float, float, float, float]:
    """Along the path, and back to its point within T; and by how much the path is delayed each second.

    The velocity along the path turns ahead of a corner, over the time that the acceleration limit needs:
    without that the aircraft overshoots and is led back by the gap alone. No feed-forward after the end.

    A point that runs ahead faster than the speed in reserve can make up for waits: the paper updates the
    expected arrival where the way back is clipped; here the point slows down as far as its lead is more than
    what the reserve makes up for within S_CATCH_UP.
    """
    t, half = own[O_PATH_TIME] - delay, settings[S_TURN]
    n, e, d = path_position(times, points, t)
    an, ae, ad = path_position(times, points, t - half)
    bn, be, bd = path_position(times, points, t + half)
    mean, gain = 0.5 / half, 1.0 / settings[S_RECOVERY]
    vn, ve, vd = mean * (bn - an), mean * (be - ae), mean * (bd - ad)
    gn, ge, gd = n - own[O_POSITION], e - own[O_POSITION + 1], d - own[O_POSITION + 2]
    slower = 0.0
    speed = math.sqrt(vn * vn + ve * ve + vd * vd)
    if settings[S_CATCH_UP] > 0.0 and speed > EPSILON and times[0] < t < times[-1]:
        lead = (gn * vn + ge * ve + gd * vd) / speed
        most_speed = settings[S_SPEED]
        if vd < -EPSILON:
            most_speed = min(most_speed, speed * settings[S_CLIMB] / -vd)
        elif vd > EPSILON:
            most_speed = min(most_speed, speed * settings[S_DESCENT] / vd)
        reserve = max(most_speed - speed, 0.0)
        slower = min(max(gain * (lead - reserve * settings[S_CATCH_UP]) / speed, 0.0), 1.0)
    vn, ve, vd = vn + gain * gn, ve + gain * ge, vd + gain * gd
    vn, ve, vd = _clipped(vn, ve, min(max(vd, least), most), settings[S_SPEED])
    return vn, ve, vd, slower


@_compiled
def _published_recovery(
    own: Array, times: Array, points: Array, settings: Array, state: Array
) -> tuple[float, float, float]:
    """The paper's way back to the path, both cases; above v_max the path is delayed by the time it costs."""
    t = own[O_PATH_TIME] - state[L_DELAY]
    pn, pe, pd = own[O_POSITION], own[O_POSITION + 1], own[O_POSITION + 2]
    nearest, n, e, d = path_nearest(times, points, pn, pe, pd)
    within = nearest - t
    if within <= 0.0:
        n, e, d = path_position(times, points, t)
        within = settings[S_RECOVERY]
    gap = math.sqrt((n - pn) ** 2 + (e - pe) ** 2 + (d - pd) ** 2)
    longer = gap / settings[S_SPEED]
    if longer > within:
        state[L_DELAY] += longer - within
        within = longer
    return (n - pn) / within, (e - pe) / within, (d - pd) / within


@_compiled
def _half_space_row(
    planes: Array,
    row: int,
    pn: float,
    pe: float,
    pd: float,
    an: float,
    ae: float,
    ad: float,
    vn: float,
    ve: float,
    rd: float,
    scale: float,
    radius: float,
    horizon: float,
    overlap: float,
    share: float,
    most: float,
) -> None:
    """One neighbour's plane, built where its volume is a ball, the normal mapped back.

    p: from us to it; a: our velocity; vn, ve: its level velocity; rd: our down speed less its. Nobody may ask
    for more than `most` m/s: from within a large volume the demand would outweigh everybody else's.
    """
    nn, ne, nd, s = half_space(pn, pe, scale * pd, an - vn, ae - ve, scale * rd, radius, horizon, overlap)
    nd *= scale
    length = math.sqrt(nn * nn + ne * ne + nd * nd)
    planes[row, 0], planes[row, 1], planes[row, 2] = nn / length, ne / length, nd / length
    planes[row, 3] = min((nn * an + ne * ae + nd * ad + share * s) / length, most)


@_compiled
def _avoid(
    neighbours: Array,
    count: int,
    own: Array,
    wn: float,
    we: float,
    wd: float,
    least: float,
    most: float,
    fence: Array,
    settings: Array,
    history_times: Array,
    history_velocities: Array,
    history_count: int,
    planes: Array,
    scratch: Array,
    view: Array,
    out: Array,
) -> tuple[bool, bool]:
    """Predict the others, build the half-spaces, keep right, solve; whether feasible, whether in conflict.

    The combined radius is the separation and a margin: S_SIGMAS standard deviations of the relative position
    now (both positions', and the sent velocity's over the age), and what has been lost since the message to
    the steps of sent velocities or, where that is more, to the track's manoeuvres.
    """
    planes[0, 0], planes[0, 1], planes[0, 2], planes[0, 3] = 0.0, 0.0, 1.0, least
    planes[1, 0], planes[1, 1], planes[1, 2], planes[1, 3] = 0.0, 0.0, -1.0, -most
    hard, first = _fence(fence, own, settings, planes, DOWN_SPEEDS)
    conflict = False
    standing = 0
    demand = DEMAND * settings[S_SPEED] if settings[S_LAW] != PAPER else math.inf
    for j in range(count):
        age, level = neighbours[j, N_AGE], neighbours[j, N_VERTICAL] == 0.0
        radius, scale, horizon = settings[S_RADIUS], settings[S_VERTICAL], settings[S_HORIZON]
        if neighbours[j, N_CREWED] != 0.0:
            radius, scale = settings[S_CREWED], settings[S_CREWED_VERTICAL]
            horizon = settings[S_CREWED_HORIZON]
        vn, ve, vd = neighbours[j, N_VELOCITY], neighbours[j, N_VELOCITY + 1], neighbours[j, N_VELOCITY + 2]
        pn = neighbours[j, N_POSITION] + age * vn - own[O_POSITION]
        pe = neighbours[j, N_POSITION + 1] + age * ve - own[O_POSITION + 1]
        pd = neighbours[j, N_POSITION + 2] + age * vd - own[O_POSITION + 2]
        an, ae, ad = own_velocity_at(history_times, history_velocities, history_count, own[O_NOW] - age)
        rd, wish_d = ad - vd, wd - vd
        if level:  # an unknown height is no way out
            pd, rd, wish_d = 0.0, 0.0, 0.0
        drift = neighbours[j, N_SIGMA_VELOCITY] * age
        sigma = math.sqrt(own[O_SIGMA] ** 2 + neighbours[j, N_SIGMA] ** 2 + drift * drift)
        growth = settings[S_GROWTH] * neighbours[j, N_GROWTH]
        radius += max(settings[S_LEAST_MARGIN], settings[S_SIGMAS] * sigma)
        radius += max(settings[S_QUANTUM] * age, growth * (age + GROWTH_AHEAD_S))

        look = max(settings[S_LOOK], horizon)
        _, near2 = closest(pn, pe, scale * pd, wn - vn, we - ve, scale * wish_d, look)
        breaks = near2 < radius * radius
        conflict = conflict or breaks
        t, near2 = closest(pn, pe, pd, wn - vn, we - ve, wish_d, 1e6)
        view[j, 0], view[j, 1] = own[O_POSITION] + pn, own[O_POSITION + 1] + pe
        view[j, 2] = own[O_POSITION + 2] + pd
        view[j, V_RADIUS], view[j, V_CONFLICT] = radius, 1.0 if breaks else 0.0
        view[j, V_TIME], view[j, V_DISTANCE] = t, math.sqrt(near2)

        share = neighbours[j, N_SHARE]
        _half_space_row(
            planes, first + j, pn, pe, pd, an, ae, ad, vn, ve, rd, scale, radius, horizon,
            settings[S_OVERLAP], share, demand,
        )  # fmt: skip
        for column in range(4):
            view[j, V_PLANE + column] = planes[first + j, column]
            view[j, V_STANDING + column] = 0.0
        if settings[S_GROWTH] != 0.0 and neighbours[j, N_SILENT] != 0.0:
            # Who falls silent in flight may have lost its GNSS with its last message, and stopped there.
            back = age - STOPS_S
            pn, pe, pd = pn - back * vn, pe - back * ve, pd - back * vd
            an, ae, ad = own[O_VELOCITY], own[O_VELOCITY + 1], own[O_VELOCITY + 2]
            rd = ad
            if level:
                pd, rd, wish_d = 0.0, 0.0, 0.0
            else:
                wish_d = wd
            _, near2 = closest(pn, pe, scale * pd, wn, we, scale * wish_d, look)
            if near2 < radius * radius:
                conflict, view[j, V_CONFLICT] = True, 1.0
            _half_space_row(
                planes, first + count + standing, pn, pe, pd, an, ae, ad, 0.0, 0.0, rd, scale, radius,
                horizon, settings[S_OVERLAP], share, demand,
            )  # fmt: skip
            for column in range(4):
                view[j, V_STANDING + column] = planes[first + count + standing, column]
            standing += 1
    out[0], out[1], out[2] = wn, we, wd
    if conflict and settings[S_RIGHT] != 0.0:
        c, s = math.cos(settings[S_RIGHT]), math.sin(settings[S_RIGHT])
        out[0], out[1] = c * wn - s * we, s * wn + c * we
    feasible = solve(planes, hard, first + count + standing, settings[S_SPEED], SLACK_MPS, out, scratch, out)
    out[R_NEIGHBOURS], out[R_HARD] = first, hard
    out[R_SOLVED], out[R_SOLVED + 1], out[R_SOLVED + 2] = out[0], out[1], out[2]
    return feasible, conflict


@_compiled
def limit(
    wanted: Array, previous: Array, most_change: float, least_down: float, most_down: float, speed: float
) -> tuple[float, float, float]:
    """The command nearest to `wanted` on the way from `previous`: change, down speed and speed limited.

    The bounds on the down speed may move faster than the change allows (a jump in altitude at the ceiling);
    then they win, and the change is what it has to be.
    """
    dn, de, dd = wanted[0] - previous[0], wanted[1] - previous[1], wanted[2] - previous[2]
    most_change *= 1.0 - 1e-9  # rounding stays under the limit
    change = math.sqrt(dn * dn + de * de + dd * dd)
    k = most_change / change if change > most_change else 1.0
    d = previous[2] + k * dd
    down = min(max(d, least_down), most_down)
    if down != d:  # what the vertical needs is taken from the horizontal
        left = math.sqrt(max(most_change * most_change - (down - previous[2]) ** 2, 0.0))
        level = math.sqrt(dn * dn + de * de)
        k = left / level if level > left else 1.0
    n, e = previous[0] + k * dn, previous[1] + k * de
    most = speed * (1.0 - 1e-12)
    down = min(max(down, -most), most)
    level, room = math.sqrt(n * n + e * e), math.sqrt(max(most * most - down * down, 0.0))
    if level > room:
        n, e = n * room / level, e * room / level
    return n, e, down


@_compiled
def _off_the_fence(planes: Array, hard: int, command: Array, change: float) -> float:
    """Turn the last command away from the fence plane that it breaks most, as far as the change allows.

    On the straight way from one command to the next a fence would get no more than its part of the change.

    Args:
        command: the last one; written.
        change: most that it may change, m/s.

    Returns:
        What is left of the change.
    """
    worst, short = DOWN_SPEEDS, 0.0
    for row in range(DOWN_SPEEDS, hard):
        missing = planes[row, 3] - (planes[row, 0] * command[0] + planes[row, 1] * command[1])
        if missing > short:
            worst, short = row, missing
    if short == 0.0:
        return change
    short = min(short, change)
    command[0] += short * planes[worst, 0]
    command[1] += short * planes[worst, 1]
    return change - short


@_compiled
def decide(
    neighbours: Array,
    count: int,
    own: Array,
    path_times: Array,
    path_points: Array,
    fence: Array,
    settings: Array,
    state: Array,
    history_times: Array,
    history_velocities: Array,
    planes: Array,
    scratch: Array,
    view: Array,
    out: Array,
) -> None:
    """One aircraft's decision by the law of its settings.

    Args:
        neighbours: shape (at least count, NEIGHBOUR_COLUMNS); NED, m and m/s, at each message's own time.
        own: OWN_ENTRIES values.
        path_times, path_points: shapes (K,) and (K, 3): the timed path, before any delay.
        fence: shape (F, WALL_COLUMNS); areas one after the other.
        settings: SETTINGS_ENTRIES values.
        state: STATE_ENTRIES values; written.
        history_times, history_velocities: shapes (H,) and (H, 3); own velocities (NED) at rising times;
            written. A plane takes the own velocity at the time of the neighbour's sample.
        planes, scratch: shape (at least DOWN_SPEEDS + F + 2 count, 4); written.
        view: shape (at least count, VIEW_COLUMNS); written.
        out: OUT_ENTRIES values; written.
    """
    law, now, speed = settings[S_LAW], own[O_NOW], settings[S_SPEED]
    vn, ve, vd = own[O_VELOCITY], own[O_VELOCITY + 1], own[O_VELOCITY + 2]
    least, most = _down_speeds(own, settings)
    if law == PAPER:
        # The current velocity is both what is tested for conflict and what is to be kept.
        state[L_HISTORY] = 0.0
        wn, we, wd = vn, ve, vd
    else:
        wn, we, wd, slower = _preferred(own, path_times, path_points, settings, state[L_DELAY], least, most)
        if now - state[L_TIME] <= RESTART_S:
            state[L_DELAY] += slower * max(now - state[L_TIME], 0.0)
    note_velocity(state, history_times, history_velocities, now, vn, ve, vd)
    feasible, conflict = _avoid(
        neighbours, count, own, wn, we, wd, least, most, fence, settings,
        history_times, history_velocities, int(state[L_HISTORY]), planes, scratch, view, out,
    )  # fmt: skip
    if law == PAPER:
        state[L_QUIET] = 0.0 if conflict else state[L_QUIET] + 1.0
        recovering = state[L_QUIET] >= settings[S_QUIET]
        if recovering:
            wn, we, wd = _published_recovery(own, path_times, path_points, settings, state)
            out[0], out[1], out[2] = wn, we, wd
    else:
        n, e, d = path_position(path_times, path_points, own[O_PATH_TIME] - state[L_DELAY])
        gap2 = (n - own[O_POSITION]) ** 2 + (e - own[O_POSITION + 1]) ** 2 + (d - own[O_POSITION + 2]) ** 2
        recovering = gap2 > settings[S_REGAINED] ** 2 and not (conflict and law == DMUCA)
        if law == NONE:
            feasible = True
            out[0], out[1], out[2] = wn, we, wd
    period = settings[S_PERIOD]
    passed = now - state[L_TIME]
    if not passed <= max(RESTART_S, 5.0 * period):  # the first time NaN
        passed = period
        down = min(max(vd, -settings[S_CLIMB]), settings[S_DESCENT])
        state[0], state[1], state[2] = _clipped(vn, ve, down, speed)
    change = settings[S_ACCELERATION] * max(passed, 0.0)
    if law != NONE:
        change = _off_the_fence(planes, int(out[R_HARD]), state, change)
    n, e, d = limit(out, state, change, least, most, speed)
    state[0], state[1], state[2], state[L_TIME] = n, e, d, now
    out[0], out[1], out[2] = n, e, d
    out[R_WANTED], out[R_WANTED + 1], out[R_WANTED + 2] = wn, we, wd
    out[R_FEASIBLE] = 1.0 if feasible else 0.0
    out[R_LATE] = state[L_DELAY]
    out[R_CONFLICT] = 1.0 if conflict else 0.0
    out[R_RECOVERING] = 1.0 if recovering else 0.0


@_compiled
def begin(state: Array, settings: Array) -> None:
    """What a law remembers before its first decision; the published one begins as after a recovery."""
    state[:] = 0.0
    state[L_TIME] = math.nan
    state[L_QUIET] = settings[S_QUIET]


def warm_up() -> None:
    """Compile, or load from the cache, everything that a decision calls.

    To be called before the vehicle is asked to obey: the first compilation takes many seconds, and a vehicle
    that waits for setpoints meanwhile goes into its failsafe.
    """
    neighbours = np.zeros((2, NEIGHBOUR_COLUMNS))
    neighbours[0, :2] = neighbours[1, :2] = 3.0
    times, velocities = np.zeros(4), np.zeros((4, 3))
    path = np.arange(2.0), np.zeros((2, 3))
    planes, scratch = np.zeros((DOWN_SPEEDS + 4, 4)), np.zeros((DOWN_SPEEDS + 4, 4))
    fence = np.zeros((0, WALL_COLUMNS))
    view, state, settings = np.zeros((2, VIEW_COLUMNS)), np.zeros(STATE_ENTRIES), np.ones(SETTINGS_ENTRIES)
    begin(state, settings)
    note_velocity(state, times, velocities, 0.0, 0.0, 0.0, 0.0)
    decide(
        neighbours, 2, np.zeros(OWN_ENTRIES), *path, fence, settings, state, times, velocities,
        planes, scratch, view, np.zeros(OUT_ENTRIES),
    )  # fmt: skip
    note_track(np.zeros(TRACK_ENTRIES), 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    path_position(*path, 0.0)
    path_nearest(*path, 0.0, 0.0, 0.0)
