"""Neighbours: what their past messages show, where they are now, and the plane that each of them requires."""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.arrays import Floats
from companion.avoidance.kernels.compiled import compiled
from companion.avoidance.kernels.escape import escape
from companion.avoidance.kernels.programs import half_space
from companion.avoidance.kernels.settings import DEMAND, DMUCA, PAPER, Own, Settings
from companion.avoidance.kernels.timelines import History, own_velocity_at
from companion.avoidance.kernels.vectors import (
    PLANE_COLUMNS,
    Plane,
    Triple,
    Vector,
    along,
    closest,
    dot,
    length,
    minus,
    put_plane,
)

NEWS_S = 0.9
"""`note_track` ignores a message that is newer than the last one that counted by less than this."""
MANOEUVRE_S = 2.9
"""Least time between two messages that are compared to find manoeuvres. The deviation by a manoeuvre grows
with the square of this time, that by noise does not."""
USUAL_M, USUAL_MPS, USUAL_S = 0.6, 0.9, 4.0
"""Deviation that does not count as a manoeuvre: USUAL_M for each metre of declared error, plus USUAL_MPS for
each second up to USUAL_S. For a declared error of 3 m and three seconds it is 4.5 m, the distance by which an
aircraft moves that gives way with 1 m/s^2."""
GROWTH_FACTOR = 2.5
"""Growth for each metre per second of further deviation."""
GROWTH_MEMORY_S = 60.0
"""Time constant with which the growth of a track fades."""
GROWTH_MOST_MPS = 3.0
GROWTH_AHEAD_S = 4.0
"""The growth of a track applies to the time from its message to this long after now."""
SILENT_GAPS = 2.2
"""A track may have stopped if nothing was received for this many of its longest recent gaps (at least 1 s).
With one message a second, delays that differ by a second already make gaps of 2 s."""
KEPT_S = 15.0
"""A track is used for at least this long after its message by default, whatever its gaps (`kept_for`)."""
KEPT_GAPS, KEPT_MORE = 3.0, 2.0
"""A track is used for KEPT_GAPS times its longest recent gap, at most KEPT_MORE times that least time. Where
four of five messages are lost, gaps of 15 s are common, and aircraft that forget each other meet."""
GAP_MEMORY_S = 60.0
"""Time constant with which the longest gap of a track fades."""
PASSING_M = 5.0
"""Another aircraft that passes by more than this to the right of us passes on our right."""
NEVER_MPS = 1e6
"""A speed that no aircraft reaches."""
STOPS_S = 1.0
"""A silent track is assumed to stand where it would have been this long after its last message."""


class Past(NamedTuple):
    """Memory of `note_track` for a track: its last message, and what it has shown; NED, m and m/s."""

    time_s: float
    n: float
    e: float
    d: float
    vn: float
    ve: float
    vd: float
    growth_mps: float
    """How fast its horizontal position deviates from its predictions."""
    growth_down_mps: float
    """How fast its height does."""
    gap_s: float
    """Longest time between two messages lately."""
    since_s: float
    """Time of the message from which it is predicted to find deviations; its state follows."""
    since_n: float
    since_e: float
    since_d: float
    since_vn: float
    since_ve: float
    since_vd: float


NO_PAST = Past._make((-math.inf, *[0.0] * 9, -math.inf, *[0.0] * 6))
"""Memory before the first message."""


class Other(NamedTuple):
    """Another aircraft as it was last received; its row in a table of neighbours. NED, m and m/s."""

    n: float
    """Position at the message's own time."""
    e: float
    d: float
    vn: float
    ve: float
    vd: float
    age_s: float
    """Age of the message."""
    sigma_m: float
    """Error of the position for each horizontal axis."""
    sigma_mps: float
    """Error of the velocity for each axis."""
    growth_mps: float
    """`Past.growth_mps`."""
    silent: float
    """1: not received for so long that it may have stopped."""
    share: float
    """Our share of the velocity change that avoids it, 0.5 to 1."""
    vertical_known: float
    """1: its height is known."""
    crewed: float
    """1: crewed traffic, with its own separations."""
    growth_down_mps: float
    """`Past.growth_down_mps`."""
    turn_rps: float
    """Turn rate of crewed traffic, positive to the right."""
    sigma_down_m: float
    """Error of the height of crewed traffic relative to ours."""
    yields: float
    """1: its planes are kept only as far as those of all others allow."""
    relative: float
    """1: its position was measured from ours, so that the error of ours plays no part."""


class Seen(NamedTuple):
    """Report of a decision on one neighbour; its row in the table of reports."""

    n: float
    """Position predicted for now, NED, m."""
    e: float
    d: float
    radius_m: float
    """Radius of the volume to keep clear of."""
    conflict: float
    """1: flying the wanted velocity would enter the volume."""
    time_s: float
    """Time to the closest approach at the wanted velocity."""
    distance_m: float
    """Distance then."""
    active: float
    """1: one of its planes bounds the velocity that the law found."""
    height_m: float
    """Half height of the volume."""


class Volume(NamedTuple):
    """What to keep clear of around another aircraft: a ball, once vertical distances are scaled."""

    radius: float
    scale: float
    horizon_s: float


class Relative(NamedTuple):
    """Another aircraft relative to the own one; NED, m and m/s."""

    away: Vector
    """Its position minus ours."""
    velocity: Vector
    own: Vector
    """Own velocity that counts towards it."""
    closing_d: float
    """Own down speed minus its own; 0 if its height is unknown."""


@compiled
def _growth(before: float, passed: float, off: float, usual: float) -> float:
    """The growth after a deviation of `off` (m) in `passed` (s). Noise and giving way explain `usual` (m)."""
    news = min(GROWTH_FACTOR * max(off - usual, 0.0) / passed, GROWTH_MOST_MPS)
    return max(before * math.exp(-passed / GROWTH_MEMORY_S), news)


@compiled
def note_track(
    past: tuple[float, ...], t: float, position: Triple, velocity: Triple, sigma_m: float
) -> tuple[float, ...]:
    """Learn from a new message how fast a track deviates from its own predictions.

    A neighbour that manoeuvres is not where its message of some three seconds ago predicts. The distance from
    there, minus what noise and giving way explain, divided by the time between both messages, is a speed. The
    growth is 2.5 times the largest such speed lately, halved every 42 s. It is learnt for the horizontal
    position and for the height separately: an aircraft that turns and keeps its height can be passed above or
    below.

    Args:
        past: the fields of a `Past`, as a plain tuple.
        t: the message's own time, s; a message less than NEWS_S after the one remembered is ignored.
        position, velocity: of the message, NED, m and m/s.
        sigma_m: declared error of the position for each axis.

    Returns:
        The fields of the new `Past`.
    """
    at_s, pn, pe, pd, un, ue, ud, growth, growth_down, gap, since_s, n, e, d, vn, ve, vd = past
    passed = t - at_s
    if not passed >= NEWS_S:
        return at_s, pn, pe, pd, un, ue, ud, growth, growth_down, gap, since_s, n, e, d, vn, ve, vd
    if passed < math.inf:
        gap = max(gap * math.exp(-passed / GAP_MEMORY_S), passed)
    passed = t - since_s
    if passed >= MANOEUVRE_S:
        if passed < math.inf:
            usual = USUAL_M * max(sigma_m, 1.0) + USUAL_MPS * min(passed, USUAL_S)
            off_n, off_e = position[0] - n - passed * vn, position[1] - e - passed * ve
            growth = _growth(growth, passed, math.sqrt(off_n * off_n + off_e * off_e), usual)
            growth_down = _growth(growth_down, passed, abs(position[2] - d - passed * vd), usual)
        since_s, n, e, d = t, position[0], position[1], position[2]
        vn, ve, vd = velocity[0], velocity[1], velocity[2]
    return (
        t, position[0], position[1], position[2], velocity[0], velocity[1], velocity[2], growth, growth_down,
        gap, since_s, n, e, d, vn, ve, vd,
    )  # fmt: skip


@compiled
def silent_after(gap_s: float) -> float:
    """Time (s) since the last reception from which a track counts as silent.

    Args:
        gap_s: `Past.gap_s`.
    """
    return SILENT_GAPS * max(gap_s, 1.0)


@compiled
def kept_for(gap_s: float, least_s: float) -> float:
    """Time (s) since its message for which a track is used.

    Args:
        gap_s: `Past.gap_s`.
        least_s: the time for a track without gaps; KEPT_S by default.
    """
    return min(max(KEPT_GAPS * gap_s, least_s), KEPT_MORE * least_s)


@compiled
def other_at(neighbours: Floats, row: int) -> Other:
    """A row of a table of neighbours."""
    r = neighbours[row]
    return Other(
        r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9], r[10], r[11], r[12], r[13], r[14],
        r[15], r[16], r[17], r[18],
    )  # fmt: skip


@compiled
def put_other(neighbours: Floats, row: int, other: Other) -> None:
    """Write a row of a table of neighbours."""
    r = neighbours[row]
    r[0], r[1], r[2], r[3], r[4], r[5] = other.n, other.e, other.d, other.vn, other.ve, other.vd
    r[6], r[7], r[8], r[9] = other.age_s, other.sigma_m, other.sigma_mps, other.growth_mps
    r[10], r[11], r[12], r[13] = other.silent, other.share, other.vertical_known, other.crewed
    r[14], r[15], r[16], r[17] = other.growth_down_mps, other.turn_rps, other.sigma_down_m, other.yields
    r[18] = other.relative


@compiled
def seen_at(seen: Floats, row: int) -> Seen:
    """A row of a table of reports."""
    r = seen[row]
    return Seen(r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8])


@compiled
def past_at(pasts: Floats, row: int) -> Past:
    """A row of a table of pasts."""
    r = pasts[row]
    return Past(
        r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9], r[10], r[11], r[12], r[13], r[14], r[15],
        r[16],
    )  # fmt: skip


@compiled
def put_past(pasts: Floats, row: int, past: tuple[float, ...]) -> None:
    """Write a row of a table of pasts: the fields of a `Past`."""
    r = pasts[row]
    for c in range(len(past)):
        r[c] = past[c]


@compiled
def all_within(table: Floats, count: int, most: float) -> bool:
    """Whether all entries of the first `count` rows have magnitudes up to `most`; False if one is NaN."""
    for row in range(count):
        for column in range(table.shape[1]):
            if not abs(table[row, column]) <= most:
                return False
    return True


@compiled
def volume_of(other: Other, own: Own, settings: Settings) -> Volume:
    """The volume of a neighbour.

    Its radius is the separation plus two margins. The first is `sigmas` standard deviations of the present
    relative position (from both positions, and from the sent velocity over the age). Where the relative
    position itself was measured, the own error is no part of it. The second is the error since the message
    due to the resolution of sent velocities or, if that is more, to the track's manoeuvres. Manoeuvres
    sideways do not make it taller, and those in height not wider.
    """
    radius, scale, horizon = settings.radius_m, settings.vertical, settings.horizon_s
    if other.crewed != 0.0:
        radius, scale = settings.crewed_m, settings.crewed_vertical
        horizon = settings.crewed_horizon_s
    drift = other.sigma_mps * other.age_s
    own_m = 0.0 if other.relative != 0.0 else own.sigma_m
    sigma = math.sqrt(own_m**2 + other.sigma_m**2 + drift * drift)
    radius += max(settings.least_margin_m, settings.sigmas * sigma)
    resolution = settings.quantum_mps * other.age_s
    ahead = settings.growth * (other.age_s + GROWTH_AHEAD_S)
    height = (radius + max(resolution, ahead * other.growth_down_mps)) / scale
    radius += max(resolution, ahead * other.growth_mps)
    return Volume(radius, radius / height, horizon)


@compiled
def _enters(away: Vector, velocity: Vector, volume: Volume, look_s: float) -> bool:
    """Whether a relative motion (`closest`) enters a volume within a time."""
    scaled = Vector(away.n, away.e, volume.scale * away.d)
    _, near2 = closest(scaled, Vector(velocity.n, velocity.e, volume.scale * velocity.d), look_s)
    return near2 < volume.radius * volume.radius


@compiled
def _plane_of(rel: Relative, volume: Volume, overlap_s: float, share: float, most: float) -> Plane:
    """The plane of one neighbour, built where its volume is a ball and mapped back.

    It requires at most `most` m/s; otherwise a neighbour whose large volume we are in would outweigh all
    others.
    """
    scale, own = volume.scale, rel.own
    normal, s = half_space(
        Vector(rel.away.n, rel.away.e, scale * rel.away.d),
        Vector(own.n - rel.velocity.n, own.e - rel.velocity.e, scale * rel.closing_d),
        volume.radius, volume.horizon_s, overlap_s,
    )  # fmt: skip
    mapped = Vector(normal.n, normal.e, normal.d * scale)
    size = length(mapped)
    least = min((dot(mapped, own) + share * s) / size, most)
    return Plane(Vector(mapped.n / size, mapped.e / size, mapped.d / size), least)


@compiled
def _put_asked(asked: Floats, row: int, which: int, plane: Plane, planes: Floats, at: int) -> None:
    put_plane(planes, at, plane.normal, plane.least)
    put_plane(asked[row], which, plane.normal, plane.least)


@compiled
def _ask_nothing(asked: Floats, row: int, planes: Floats, at: int) -> None:
    """Write a plane that every velocity satisfies."""
    put_plane(planes, at, Vector(0.0, 0.0, 1.0), -NEVER_MPS)
    for which in range(2):
        put_plane(asked[row], which, Vector(0.0, 0.0, 0.0), 0.0)


@compiled
def _right_of(course: Vector, point: Vector) -> float:
    """How far a point lies to the right of a course through the origin; 0 without a horizontal course."""
    speed = math.sqrt(course.n * course.n + course.e * course.e)
    return (course.n * point.e - course.e * point.n) / speed if speed > 0.0 else 0.0


@compiled
def _passes_right(wanted: Vector, away: Vector, velocity: Vector) -> bool:
    """Whether what moves by a relative motion (`closest`) passes on our right."""
    t, _ = closest(away, velocity, 1e6)
    return _right_of(wanted, along(away, -t, velocity)) > PASSING_M


@compiled
def neighbour_planes(
    neighbours: Floats, count: int, own: Own, wanted: Vector, settings: Settings, history: History,
    samples: int, planes: Floats, first: int, seen: Floats, asked: Floats, before: Vector,
) -> tuple[int, bool, bool]:  # fmt: skip
    """Predict the neighbours, report on them, and write their planes from row `first` on.

    Args:
        neighbours, count: table of neighbours, and how many of its rows count.
        wanted: the wanted velocity, tested for conflict, m/s.
        history, samples: own velocities. A plane uses the one at the time of the neighbour's sample.
        planes: table of planes; written.
        seen: table of reports (`Seen`), without `active`; written.
        asked: shape (at least count, 2, 4): plane of each neighbour, and plane for the place where a silent
            track may have stopped (0 if there is none); written.
        before: the last command, m/s.

    Returns:
        The row after the planes, whether there is a conflict, and whether one of those in conflict will pass
        on our right, so that a turn to the right would lead to it.
    """
    conflict, on_right, at = False, False, first + count
    most = DEMAND * settings.speed_mps if settings.law != PAPER else math.inf
    for j in range(count):
        other = other_at(neighbours, j)
        level, age = other.vertical_known == 0.0, other.age_s
        volume = volume_of(other, own, settings)
        velocity = Vector(other.vn, other.ve, other.vd)
        away = minus(along(Vector(other.n, other.e, other.d), age, velocity), own.position)
        then = own_velocity_at(history, samples, own.now_s - age)
        closing_d, wish = then.d - velocity.d, minus(wanted, velocity)
        if level:  # an unknown height must not be passed above or below
            away, closing_d, wish = Vector(away.n, away.e, 0.0), 0.0, Vector(wish.n, wish.e, 0.0)
        look_s = max(settings.look_s, volume.horizon_s)
        t, near2 = closest(away, wish, 1e6)
        seen[j, 0], seen[j, 1] = own.position.n + away.n, own.position.e + away.e
        seen[j, 2] = own.position.d + away.d
        seen[j, 3], seen[j, 8] = volume.radius, volume.radius / volume.scale
        seen[j, 5], seen[j, 6] = t, math.sqrt(near2)
        if other.crewed != 0.0 and settings.law == DMUCA:  # `crewed` keeps clear of it, without a plane
            seen[j, 4] = 0.0
            _ask_nothing(asked, j, planes, first + j)
            continue
        breaks = _enters(away, wish, volume, look_s)
        on_right = on_right or (breaks and _passes_right(wanted, away, wish))
        relative = Relative(away, velocity, then, closing_d)
        plane = _plane_of(relative, volume, settings.overlap_s, other.share, most)
        if other.relative != 0.0 and settings.law == DMUCA:
            meeting = Vector(own.velocity.n - velocity.n, own.velocity.e - velocity.e, closing_d)
            if _enters(away, meeting, volume, look_s):
                turned = minus(before, wanted)
                late, aside = escape(away, velocity, own, turned, volume.radius, settings)
                plane = aside if late else plane
        _put_asked(asked, j, 0, plane, planes, first + j)
        for column in range(PLANE_COLUMNS):
            asked[j, 1, column] = 0.0
        if settings.growth != 0.0 and other.silent != 0.0:
            # An aircraft that falls silent in flight may have lost its GNSS after its last message, and
            # stopped.
            stood = along(away, -(age - STOPS_S), velocity)
            wish, closing_d = wanted, own.velocity.d
            if level:
                stood, wish, closing_d = Vector(stood.n, stood.e, 0.0), Vector(wish.n, wish.e, 0.0), 0.0
            stands = _enters(stood, wish, volume, look_s)
            breaks = breaks or stands
            on_right = on_right or (stands and _passes_right(wanted, stood, wish))
            relative = Relative(stood, Vector(0.0, 0.0, 0.0), own.velocity, closing_d)
            plane = _plane_of(relative, volume, settings.overlap_s, other.share, most)
            _put_asked(asked, j, 1, plane, planes, at)
            at += 1
        conflict = conflict or breaks
        seen[j, 4] = 1.0 if breaks else 0.0
    return at, conflict, on_right
