"""The numeric part of the law: one decision, compiled by numba in double precision.

`decide` is a complete law, from the own state, the path and the neighbours to the command: it builds the
planes of neighbours and fences, finds the velocity with `programs` and the command with `hard_planes`. Every
function works on arrays that the caller owns, so that a compiled loop over many aircraft can call it in the
same way as the aircraft does. The functions also run uncompiled.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.avoidance.compiled import compiled as _compiled
from companion.avoidance.fence_planes import BRAKES, LAG_S, closing, wall_planes
from companion.avoidance.fence_planes import DOWN_SPEEDS as DOWN_SPEEDS
from companion.avoidance.fence_planes import FENCE_MARGIN_M as FENCE_MARGIN_M
from companion.avoidance.fence_planes import IN_CIRCLE as IN_CIRCLE
from companion.avoidance.fence_planes import IN_POLYGON as IN_POLYGON
from companion.avoidance.fence_planes import OUT_OF_CIRCLE as OUT_OF_CIRCLE
from companion.avoidance.fence_planes import OUT_OF_POLYGON as OUT_OF_POLYGON
from companion.avoidance.fence_planes import W_AREA as W_AREA
from companion.avoidance.fence_planes import W_FROM as W_FROM
from companion.avoidance.fence_planes import W_KIND as W_KIND
from companion.avoidance.fence_planes import W_TO as W_TO
from companion.avoidance.fence_planes import WALL_COLUMNS as WALL_COLUMNS
from companion.avoidance.fence_planes import inside as inside
from companion.avoidance.fence_planes import nearest_of_wall as nearest_of_wall
from companion.avoidance.fence_planes import plane_rows as plane_rows
from companion.avoidance.hard_planes import keep, limit
from companion.avoidance.programs import EPSILON
from companion.avoidance.programs import half_space as half_space
from companion.avoidance.programs import solve as solve

Array = NDArray[np.float64]

SLACK_MPS = 0.02
"""Slack for `programs.solve` in a decision that cannot satisfy every plane."""

# Columns of a row of `neighbours`.
N_POSITION, N_VELOCITY, N_AGE = 0, 3, 6  # at the message's own time; s
(
    N_SIGMA,  # m for each horizontal axis
    N_SIGMA_VELOCITY,  # m/s for each axis
    N_GROWTH,  # m/s, growth of the track by `note_track`
    N_SILENT,  # 1: not received for so long that it may have stopped
    N_SHARE,  # our share of the velocity change that avoids it, 0.5 to 1
    N_VERTICAL,  # 1: its height is known
    N_CREWED,  # 1: crewed traffic, with its own separations
    NEIGHBOUR_COLUMNS,
) = range(7, 15)
# Entries of `own`; floor and ceiling are NED down, plus and minus infinity if there is none.
O_POSITION, O_VELOCITY, O_SIGMA, O_NOW, O_PATH_TIME, O_FLOOR, O_CEILING = 0, 3, 6, 7, 8, 9, 10
OWN_ENTRIES = 11
# Entries of `settings`.
(
    S_LAW,  # DMUCA, PAPER or NONE
    S_RADIUS,  # sum of both conflict radii, m
    S_LEAST_MARGIN,  # least margin, m
    S_SIGMAS,  # margin in standard deviations of the relative error
    S_QUANTUM,  # m/s, error due to the resolution of a sent velocity
    S_GROWTH,  # 1: growth and silence of tracks are used, 0: they are not
    S_CREWED,  # separation from crewed traffic, m
    S_CREWED_VERTICAL,  # S_VERTICAL for crewed traffic
    S_CREWED_HORIZON,  # S_HORIZON for crewed traffic, s
    S_VERTICAL,  # factor on vertical distances: below 1 the volume is taller than wide
    S_HORIZON,  # tau, s
    S_OVERLAP,  # time in which to leave an overlapping volume, s
    S_LOOK,  # s, window of the conflict test
    S_RIGHT,  # rad, turn to the right when in conflict
    S_SPEED,  # greatest speed, m/s
    S_CLIMB,  # greatest climb, m/s
    S_DESCENT,  # greatest descent, m/s
    S_ACCELERATION,  # greatest change of the command, m/s^2
    S_PERIOD,  # time between two decisions, s
    S_RECOVERY,  # T: time to close the gap to the path's point, s
    S_TURN,  # time before and after a corner of the path in which it is rounded, s, above 0
    S_QUIET,  # cycles without conflict before the published law recovers
    S_REGAINED,  # distance to the path's point that counts as back on the path, m
    S_CATCH_UP,  # a gap along the path that takes longer than this to close (s) delays the path; 0: never
    SETTINGS_ENTRIES,
) = range(25)
DMUCA, PAPER, NONE = 0.0, 1.0, 2.0
# Entries of `state`, the memory of a law: the last command and its time (NaN before the first one), cycles
# without conflict, delay of the path (s), number of samples in the history of own velocities.
L_COMMAND, L_TIME, L_QUIET, L_DELAY, L_HISTORY, STATE_ENTRIES = 0, 3, 4, 5, 6, 7
# Columns of a row of `view`: predicted position, radius, conflict (0 or 1), time and distance at the closest
# approach, plane, and plane for the place where a silent track may have stopped (0 if there is none).
V_POSITION, V_RADIUS, V_CONFLICT, V_TIME, V_DISTANCE = 0, 3, 4, 5, 6
V_PLANE, V_STANDING, VIEW_COLUMNS = 7, 11, 15
# Memory of `note_track` for a track: time, position and velocity of a message; growth; longest gap lately.
T_TIME, T_POSITION, T_VELOCITY, T_GROWTH, T_GAP, TRACK_ENTRIES = 0, 1, 4, 7, 8, 9
# Entries of `out`: the command; the wanted velocity, without neighbours; 0 or 1: every plane is satisfied,
# the wanted velocity would enter a volume, the aircraft is on the way back to the path; first row of `planes`
# that belongs to a neighbour; number of hard planes; velocity that the law would command without a limit on
# its change; delay of the path, s.
R_CHOSEN, R_WANTED, R_FEASIBLE, R_CONFLICT, R_RECOVERING = 0, 3, 6, 7, 8
R_NEIGHBOURS, R_HARD, R_SOLVED, R_LATE, OUT_ENTRIES = 9, 10, 11, 14, 15

BOUNDARY_LAG_S = 1.0
"""Time from a decision to the vehicle's response, for floor and ceiling: autopilot lag, period and
latency."""
RESTART_S = 1.0
"""After a pause longer than this and than five periods, the command starts again from the own velocity."""
DEMAND = 2.0
"""Most that one neighbour's plane may require, as a multiple of the greatest speed."""
NEWS_S = 0.9
"""Least time between two messages that are compared to judge a track's past."""
GROWTH_MEMORY_S = 40.0
"""Time constant with which the growth of a track fades."""
GROWTH_MOST_MPS = 3.0
GROWTH_AHEAD_S = 4.0
"""The growth of a track applies to the time from its message to this long after now."""
SILENT_S, SILENT_GAPS = 2.0, 1.5
"""A track may have stopped if nothing was received for SILENT_S plus SILENT_GAPS times its longest recent gap
(at least 1 s). With one message a second, delays that differ by a second already make gaps of 2 s."""
GAP_MEMORY_S = 60.0
"""Time constant with which the longest gap of a track fades."""
STOPS_S = 1.0
"""A silent track is assumed to stand where it would have been this long after its last message."""
HISTORY_SPACING_S = 0.04
"""Least time between two samples in the history of own velocities."""
HISTORY_SAMPLES = 1024
"""Size of that history. When it is full, the newer half is kept: 20 s, which exceeds the age of the oldest
message."""


@_compiled
def closest(
    px: float, py: float, pz: float, vx: float, vy: float, vz: float, window: float
) -> tuple[float, float]:
    """Time (s, in [0, window]) and square (m^2) of the least distance, for the relative position p - v t."""
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
    """Add an own velocity to the history, oldest first. One that is not newer, or not finite, is ignored."""
    n = int(state[L_HISTORY])
    if not math.isfinite(now + vn + ve + vd) or (n > 0 and now <= times[n - 1]):
        return
    if n > 1 and times[n - 1] - times[n - 2] < HISTORY_SPACING_S:
        n -= 1  # the caller is fast: replace the newest sample
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
    """Learn from a new message how fast a track deviates from its own predictions.

    A neighbour that manoeuvres is not where its last message predicts. The distance between a message and the
    prediction from the one before, minus what noise explains, divided by the time between them, is a speed.
    The growth is twice the largest such speed lately, halved every 28 s.

    Args:
        track: TRACK_ENTRIES values; before the first message all 0, except T_TIME, which is -inf. Written.
        t: the message's own time, s; a message less than NEWS_S after the one remembered is ignored.
        pn, pe, pd, vn, ve, vd: position and velocity of the message, NED, m and m/s.
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
    """Time (s) since the last reception from which a track counts as silent, by its memory from
    `note_track`."""
    return float(SILENT_S + SILENT_GAPS * max(track[T_GAP], 1.0))


@_compiled
def _between(times: Array, rows: Array, count: int, t: float) -> tuple[float, float, float]:
    """The row at time t, interpolated linearly between the first `count` rows at rising times; the first or
    last row outside of their times."""
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
    """Own velocity at a time, interpolated in the history; its first or last sample outside of it."""
    return _between(times, velocities, count, t)


@_compiled
def path_position(times: Array, points: Array, t: float) -> tuple[float, float, float]:
    """Point of a timed path at a time; its first or last point before its start or after its end.

    Args:
        times: shape (K,), strictly rising, s.
        points: shape (K, 3), NED, m.
    """
    return _between(times, points, len(times), t)


@_compiled
def path_nearest(
    times: Array, points: Array, x: float, y: float, z: float
) -> tuple[float, float, float, float]:
    """Time and place of a path's point nearest to a position; the earliest if several are equally near."""
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
    """The velocity, shortened to `speed` if it is faster."""
    length = math.sqrt(n * n + e * e + d * d)
    if length <= speed:
        return n, e, d
    k = speed / length
    return n * k, e * k, d * k


@_compiled
def _down_speeds(own: Array, settings: Array) -> tuple[float, float]:
    """Least and greatest down speed: within the climb and descent limits, and able to stop before floor and
    ceiling."""
    down, acceleration = own[O_POSITION + 2], settings[S_ACCELERATION]
    least, most = -settings[S_CLIMB], settings[S_DESCENT]
    most = min(max(closing(own[O_FLOOR] - down, acceleration, BOUNDARY_LAG_S), least), most)
    least = min(
        max(-closing(down - own[O_CEILING], acceleration, BOUNDARY_LAG_S), least), settings[S_DESCENT]
    )
    # If floor and ceiling are close together, the way back from one may be faster than the other allows.
    return min(least, most), most


@_compiled
def _preferred(
    own: Array, times: Array, points: Array, settings: Array, delay: float, least: float, most: float
) -> tuple[float, float, float, float]:
    """The preferred velocity, along the path and back to its point within T, and the path's delay per second.

    The velocity along the path turns ahead of a corner, over the time that the acceleration limit needs.
    Otherwise the aircraft would overshoot, and only the gap would lead it back. After the path's end there is
    no feed-forward.

    If the path's point is farther ahead than the speed in reserve can make up for within S_CATCH_UP, the
    point slows down accordingly. The paper instead updates the expected arrival when the way back is clipped.
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
    """The paper's velocity back to the path, in both cases. If it exceeds v_max, the path is delayed
    accordingly."""
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
    """Write the plane of one neighbour, built where its volume is a ball and mapped back.

    p is the position from us to it; a our velocity; vn, ve its horizontal velocity; rd our down speed minus
    its own. A plane requires at most `most` m/s; otherwise a neighbour whose large volume we are in would
    outweigh all others.
    """
    nn, ne, nd, s = half_space(pn, pe, scale * pd, an - vn, ae - ve, scale * rd, radius, horizon, overlap)
    nd *= scale
    length = math.sqrt(nn * nn + ne * ne + nd * nd)
    planes[row, 0], planes[row, 1], planes[row, 2] = nn / length, ne / length, nd / length
    planes[row, 3] = min((nn * an + ne * ae + nd * ad + share * s) / length, most)


@_compiled
def _ahead(own: Array) -> tuple[float, float]:
    """Own position, north and east, when the vehicle responds to a command."""
    return own[O_POSITION] + LAG_S * own[O_VELOCITY], own[O_POSITION + 1] + LAG_S * own[O_VELOCITY + 1]


@_compiled
def _margin(own: Array) -> float:
    """Distance to keep from a fence, m."""
    return float(FENCE_MARGIN_M + 2.0 * own[O_SIGMA])


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
    before: Array,
    change: float,
    settings: Array,
    history_times: Array,
    history_velocities: Array,
    history_count: int,
    planes: Array,
    scratch: Array,
    view: Array,
    out: Array,
) -> tuple[bool, bool]:
    """Predict the neighbours, build the half-spaces, turn right in a conflict, and solve.

    Returns whether all planes are satisfied, and whether there is a conflict.

    The combined radius is the separation plus two margins. The first is S_SIGMAS standard deviations of the
    present relative position (from both positions, and from the sent velocity over the age). The second is
    the error since the message due to the resolution of sent velocities or, if that is more, to the track's
    manoeuvres.
    """
    planes[0, 0], planes[0, 1], planes[0, 2], planes[0, 3] = 0.0, 0.0, 1.0, least
    planes[1, 0], planes[1, 1], planes[1, 2], planes[1, 3] = 0.0, 0.0, -1.0, -most
    hard = first = DOWN_SPEEDS
    if len(fence) > 0:
        bound = min(math.sqrt(before[0] * before[0] + before[1] * before[1]) + change, settings[S_SPEED])
        hard, first = wall_planes(
            fence, own[O_POSITION], own[O_POSITION + 1], *_ahead(own), before[0], before[1], _margin(own),
            settings[S_SPEED], settings[S_ACCELERATION], bound, True, BRAKES * change, planes,
            DOWN_SPEEDS,
        )  # fmt: skip
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
        if level:  # an unknown height must not be passed above or below
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
            # An aircraft that falls silent in flight may have lost its GNSS after its last message, and
            # stopped.
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
    """Make one aircraft's decision by the law in its settings.

    Args:
        neighbours: shape (at least count, NEIGHBOUR_COLUMNS); NED, m and m/s, at each message's own time.
        own: OWN_ENTRIES values.
        path_times, path_points: shapes (K,) and (K, 3): the timed path, before any delay.
        fence: shape (F, WALL_COLUMNS); areas one after the other.
        settings: SETTINGS_ENTRIES values.
        state: STATE_ENTRIES values; written.
        history_times, history_velocities: shapes (H,) and (H, 3); own velocities (NED) at rising times;
            written. A plane uses the own velocity at the time of the neighbour's sample.
        planes, scratch: shape (at least plane_rows(F, count), 4); written.
        view: shape (at least count, VIEW_COLUMNS); written.
        out: OUT_ENTRIES values; written.
    """
    law, now, speed = settings[S_LAW], own[O_NOW], settings[S_SPEED]
    vn, ve, vd = own[O_VELOCITY], own[O_VELOCITY + 1], own[O_VELOCITY + 2]
    least, most = _down_speeds(own, settings)
    if law == PAPER:
        # The current velocity is tested for conflict, and the law changes it as little as possible.
        state[L_HISTORY] = 0.0
        wn, we, wd = vn, ve, vd
    else:
        wn, we, wd, slower = _preferred(own, path_times, path_points, settings, state[L_DELAY], least, most)
        if now - state[L_TIME] <= RESTART_S:
            state[L_DELAY] += slower * max(now - state[L_TIME], 0.0)
    period = settings[S_PERIOD]
    passed = now - state[L_TIME]
    if not passed <= max(RESTART_S, 5.0 * period):  # also at the first decision, where it is NaN
        passed = period
        down = min(max(vd, -settings[S_CLIMB]), settings[S_DESCENT])
        state[0], state[1], state[2] = _clipped(vn, ve, down, speed)
    change = settings[S_ACCELERATION] * max(passed, 0.0)
    note_velocity(state, history_times, history_velocities, now, vn, ve, vd)
    feasible, conflict = _avoid(
        neighbours, count, own, wn, we, wd, least, most, fence, state, change, settings,
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
    if len(fence) > 0 and law != NONE:
        n, e, d = keep(
            fence, own[O_POSITION], own[O_POSITION + 1], *_ahead(own), _margin(own), speed,
            settings[S_ACCELERATION], out, state, change, least, most, planes, int(out[R_HARD]), scratch,
        )  # fmt: skip
    else:
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
    """Initialise the state before the first decision. The published law begins as after a recovery."""
    state[:] = 0.0
    state[L_TIME] = math.nan
    state[L_QUIET] = settings[S_QUIET]


def warm_up() -> None:
    """Compile, or load from the cache, everything that a decision calls.

    Call this before taking control of the vehicle: the first compilation takes many seconds, and a vehicle
    that waits for setpoints meanwhile goes into its failsafe.
    """
    neighbours = np.zeros((2, NEIGHBOUR_COLUMNS))
    neighbours[0, :2] = neighbours[1, :2] = 3.0
    times, velocities = np.zeros(4), np.zeros((4, 3))
    path = np.arange(2.0), np.zeros((2, 3))
    planes, scratch = np.zeros((plane_rows(0, 2), 4)), np.zeros((plane_rows(0, 2), 4))
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
