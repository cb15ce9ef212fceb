"""Crewed traffic: chooses the velocity that stays well clear of it at the lowest price.

Crewed aircraft are fast, turn unpredictably, and need more room than a small aircraft can make in the last
seconds. A plane of the linear program leaves a volume by the shortest way, which is too late for them, so
they have no planes. Instead, a set of candidate velocities is simulated over the next `HORIZON_S`: along the
path, standing still, and in `HEADINGS` directions, each returning to the height of the path, descending,
level and climbing. Each candidate has a risk (the probability of losing well clear, and of a near mid-air
collision) and a price (how far it leaves the path: sideways, up, or down, which is cheapest). The law flies
the one with the lowest sum, and chooses again at each decision. It therefore descends below crewed traffic
first, and moves sideways only as far as descending is not enough.

The predicted position of another aircraft is a mixture: it has continued as it flies now (straight, or in a
turn that fades), or it has begun another manoeuvre, and its position is then much less certain. Nothing here
allocates.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.arrays import Floats
from companion.avoidance.kernels.compiled import compiled
from companion.avoidance.kernels.fence_planes import FENCE_MARGIN_M
from companion.avoidance.kernels.neighbours import Other, other_at
from companion.avoidance.kernels.settings import STEPS, Own, Settings
from companion.avoidance.kernels.timelines import Path, point_at
from companion.avoidance.kernels.vectors import Point, Triple, Vector, clipped, length, minus
from companion.avoidance.kernels.walls import IN_CIRCLE, wall_at

STEP_S = 4.0
"""Time step of the simulation. Motion within a step is assumed to be straight."""
HORIZON_S = STEP_S * (STEPS - 1)
MOST = 32
"""Largest number of crewed aircraft that are considered: those that could lose well clear soonest. A decision
about 200 would take too long."""
CLIMB_MOST_MPS = 15.0
"""Greatest assumed vertical closing speed, in addition to a crewed aircraft's present vertical speed."""
HEADINGS = 12
"""Directions, one of which is north; in each, the greatest speed and half of it are tried."""
NEAR_RADIUS_M, NEAR_HEIGHT_M = 152.4, 30.48
"""Volume of a near mid-air collision (ASTM F3442): 500 ft and 100 ft."""
NEAR_WORTH = 10.0
"""Risk that a near mid-air collision adds, in losses of well clear."""
DEPTH_WORTH = 20.0
"""Risk that the centre of the volume of a near mid-air collision adds to the risk at its edge, in losses of
well clear. It makes distance count where the volume can no longer be avoided."""
STAY_WORTH = 0.3
"""Risk of being inside a volume for the whole horizon, as a share of the risk of entering it. It makes an
aircraft that is inside leave."""
LEAST_RISK = 0.02
"""Risks below this are not avoided."""
CONFLICT_RISK = 0.2
"""From this risk on there is a conflict even if no other velocity is better. The containment may exclude all
better ones, and it widens in a conflict."""
SIDE_PRICE, DOWN_PRICE, UP_PRICE = 0.007, 0.001, 0.003
"""Price of a velocity that differs by 1 m/s from that along the path, in losses of well clear."""
CHANGE_PRICE = 0.003
"""Price of a velocity that differs by 1 m/s from the last command."""
SIGMA_M = 30.0
"""Initial horizontal error of a predicted position, one standard deviation."""
STEADY_S = 30.0
"""Mean time until a crewed aircraft begins another manoeuvre."""
STEADY_SHARE, CHANGED_SHARE = 0.05, 0.35
"""Growth of that error, as a share of the distance that the aircraft flies: while it flies on as it does now,
and after it has begun another manoeuvre."""
LEAST_SIGMA_DOWN_M = 1.0
"""Least error of a height."""
DOWN_MPS = 0.4
"""Growth of the error in height."""
TURN_FADES_S, CLIMB_FADES_S = 40.0, 20.0
"""Time constants with which a turn, and a climb or descent, end."""
TURN_MEMORY_S = 2.0
"""Time constant with which turn rates are averaged."""
TURN_MOST_RPS = 0.35
"""Greatest turn rate that is believed: 20 degrees a second."""
TURN_NOISE_RPS = 0.01
"""Noise that is subtracted from the magnitude of a turn rate, because the course in messages has steps of
about a degree. Extrapolated for `TURN_FADES_S`, this noise would move the predicted position from one side of
our own aircraft to the other with each message."""
TURNING_MPS = 2.0
"""An aircraft that is slower does not turn, because the direction of its velocity is noise."""
_ANSWER_S = 0.5
"""Time until the vehicle answers a command."""


class _Way(NamedTuple):
    """A candidate velocity, and how it is flown from now on; NED, m and m/s."""

    velocity: Vector
    answer_s: float
    """Time for which the present velocity lasts before the aircraft flies the candidate."""
    free_m: float
    """Distance until it stops before a wall (`_free`); infinite along the path and standing still."""
    follows: float
    """1: its horizontal part follows the path."""
    returns: float
    """1: its height returns to that of the path."""


class _Follow(NamedTuple):
    """How the own aircraft returns to its path and follows it."""

    gap: Vector
    """Own position minus the point of the path."""
    back_mps: float
    """Speed at which it closes the gap."""
    path_s: float


class _View(NamedTuple):
    """Data by which candidate velocities are judged."""

    rows: int
    """Number of neighbours."""
    ahead: Floats
    """Predictions. The last entry of an aircraft's second row says whether the aircraft is considered."""
    own: Own
    path: Path
    follow: _Follow
    radius_m: float
    """Well clear: horizontal and vertical distance (m)."""
    height_m: float


@compiled
def turn_rate(rate: float, before: Triple, now: Triple, passed_s: float) -> float:
    """Turn rate of an aircraft (rad/s, positive to the right) after another message.

    Args:
        rate: the turn rate before; 0 at the first message.
        before, now: velocities of the last and of this message, NED, m/s.
        passed_s: time between both.
    """
    if passed_s <= 0.0:
        return rate
    news = 0.0
    if min(math.hypot(before[0], before[1]), math.hypot(now[0], now[1])) >= TURNING_MPS:
        right = before[0] * now[1] - before[1] * now[0]
        news = math.atan2(right, before[0] * now[0] + before[1] * now[1]) / passed_s
        news = min(max(news, -TURN_MOST_RPS), TURN_MOST_RPS)
    return rate + (1.0 - math.exp(-passed_s / TURN_MEMORY_S)) * (news - rate)


@compiled
def _predict(other: Other, own_d: float, ahead: Floats) -> None:
    """Write a prediction of an aircraft for each moment: north, east and down; the probability that it flies
    on as it does now; the horizontal error if it does and if it does not; and the error in height."""
    speed = math.sqrt(other.vn * other.vn + other.ve * other.ve)
    heading = math.atan2(other.ve, other.vn)
    turn_rps = math.copysign(max(abs(other.turn_rps) - TURN_NOISE_RPS, 0.0), other.turn_rps)
    n, e, t = other.n, other.e, 0.0
    for row in range(STEPS):
        until = other.age_s + row * STEP_S
        parts = max(1, math.ceil(until - t))
        step = (until - t) / parts
        for _ in range(parts):
            fade = 1.0 - math.exp(-(t + 0.5 * step) / TURN_FADES_S)
            course = heading + turn_rps * TURN_FADES_S * fade
            n += speed * math.cos(course) * step
            e += speed * math.sin(course) * step
            t += step
        way, known = speed * until, other.vertical_known != 0.0
        climbed = CLIMB_FADES_S * (1.0 - math.exp(-until / CLIMB_FADES_S))
        ahead[row, 0], ahead[row, 1] = n, e
        ahead[row, 2] = other.d + other.vd * climbed if known else own_d
        ahead[row, 3] = math.exp(-until / STEADY_S)
        ahead[row, 4] = math.sqrt(SIGMA_M**2 + (STEADY_SHARE * way) ** 2)
        ahead[row, 5] = math.sqrt(SIGMA_M**2 + (CHANGED_SHARE * way) ** 2)
        sigma_down = max(other.sigma_down_m, LEAST_SIGMA_DOWN_M)
        ahead[row, 6] = math.sqrt(sigma_down**2 + (DOWN_MPS * until) ** 2) if known else math.inf


@compiled
def _soonest_loss(other: Other, own: Own, radius: float, height: float, speed: float) -> float:
    """Soonest time (s) at which well clear of an aircraft could be lost, horizontally and vertically. If it
    may be lost already, a negative number, -1 where the aircraft is at our place: many may be that near, as
    gliders in a thermal are.

    Args:
        radius, height: well clear.
        speed: own greatest speed.
    """
    n = other.n + other.age_s * other.vn - own.position.n
    e = other.e + other.age_s * other.ve - own.position.e
    d = other.d + other.age_s * other.vd - own.position.d
    aside, above = math.sqrt(n * n + e * e), abs(d) if other.vertical_known != 0.0 else 0.0
    height += 2.0 * other.sigma_down_m
    if aside <= radius and above <= height:
        return max(aside / radius, above / height) - 1.0
    most = math.sqrt(other.vn * other.vn + other.ve * other.ve) + speed
    return max(max(aside - radius, 0.0) / most, max(above - height, 0.0) / (abs(other.vd) + CLIMB_MOST_MPS))


@compiled
def _select(neighbours: Floats, count: int, own: Own, view: _View, speed: float) -> bool:
    """Predict the crewed aircraft that are considered. Returns whether there is one.

    Args:
        view: its `ahead` is written, and the volume of well clear read.
        speed: the own greatest speed.
    """
    found, ahead = 0, view.ahead
    for j in range(count):
        other = other_at(neighbours, j)
        ahead[j, 0, 7], ahead[j, 1, 7], ahead[j, 2, 7] = 0.0, 0.0, math.inf
        if other.crewed != 0.0:
            ahead[j, 2, 7] = _soonest_loss(other, own, view.radius_m, view.height_m, speed)
            found += 1 if ahead[j, 2, 7] <= HORIZON_S else 0
    for j in range(count):
        if ahead[j, 2, 7] <= HORIZON_S:
            sooner = 0
            if found > MOST:
                for i in range(count):
                    mine, others = ahead[j, 2, 7], ahead[i, 2, 7]
                    sooner += 1 if others < mine or (others == mine and i < j) else 0
            if sooner < MOST:
                ahead[j, 1, 7] = 1.0
                _predict(other_at(neighbours, j), own.position.d, ahead[j])
    return found > 0


@compiled
def _below(x: float) -> float:
    """Approximate probability that a standard normal variable is below x: a cubic between -2 and 2."""
    y = 0.25 * min(max(x, -2.0), 2.0) + 0.5
    return y * y * (3.0 - 2.0 * y)


@compiled
def _beside(aside: float, radius: float, sigma: float) -> float:
    """Probability of being within a radius of an aircraft that is predicted at a distance."""
    return _below((radius - aside) / sigma) * radius * radius / (radius * radius + 2.0 * sigma * sigma)


@compiled
def _within(aside: float, above: float, radius: float, height: float, at: Floats) -> float:
    """Probability of being inside a cylinder around an aircraft.

    Args:
        aside, above: horizontal and vertical distance (m) from its predicted position.
        at: its row of `ahead`. An aircraft of unknown height is assumed to be at ours.
    """
    level = 1.0
    if at[6] < math.inf:
        level = _below((height - above) / at[6]) - _below((-height - above) / at[6])
    if level <= 0.0:
        return 0.0
    steady: float = at[3]
    chance = steady * _beside(aside, radius, at[4]) + (1.0 - steady) * _beside(aside, radius, at[5])
    return level * chance


@compiled
def _place(way: _Way, t: float, view: _View) -> Vector:
    """Position that a way reaches after a time (s)."""
    own, follow = view.own, view.follow
    before, after = min(t, way.answer_s), max(t - way.answer_s, 0.0)
    point, left = own.position, 0.0
    if way.follows != 0.0 or way.returns != 0.0:
        point, size = point_at(view.path, follow.path_s + t), length(follow.gap)
        left = max(1.0 - follow.back_mps * t / size, 0.0) if size > 0.0 else 0.0
    down = own.position.d + before * own.velocity.d + after * way.velocity.d
    if way.returns != 0.0:
        down = point.d + left * follow.gap.d
    down = max(min(down, own.floor_d), own.ceiling_d)
    if way.follows != 0.0:
        return Vector(point.n + left * follow.gap.n, point.e + left * follow.gap.e, down)
    n, e = way.velocity.n * after, way.velocity.e * after
    far = math.sqrt(n * n + e * e)
    k = way.free_m / far if far > way.free_m else 1.0
    at = own.position
    return Vector(at.n + before * own.velocity.n + k * n, at.e + before * own.velocity.e + k * e, down)


@compiled
def _risk(ahead: Floats, way: _Way, view: _View, enough: float) -> float:
    """Risk of a way with one aircraft, in losses of well clear. No more is added beyond `enough`.

    Args:
        ahead: predictions of the aircraft.
    """
    lost, near, stays = 0.0, 0.0, 0.0
    n, e, d = 0.0, 0.0, 0.0
    for row in range(STEPS):
        at, place = ahead[row], _place(way, row * STEP_S, view)
        then_n, then_e, then_d = n, e, d
        n, e, d = at[0] - place.n, at[1] - place.e, at[2] - place.d
        k = 1.0
        if row > 0:  # the closest point since the moment before
            dn, de = n - then_n, e - then_e
            k = min(max(-(then_n * dn + then_e * de) / max(dn * dn + de * de, 1e-9), 0.0), 1.0)
            aside = math.sqrt((then_n + k * dn) ** 2 + (then_e + k * de) ** 2)
            above = abs(then_d + k * (d - then_d))
        else:
            aside, above = math.sqrt(n * n + e * e), abs(d)
        if aside < view.radius_m + 2.0 * at[5]:
            chance = _within(aside, above, view.radius_m, view.height_m, at)
            close = _within(aside, above, NEAR_RADIUS_M, NEAR_HEIGHT_M, at)
            depth = max(1.0 - aside / NEAR_RADIUS_M, 0.0)
            close *= NEAR_WORTH + DEPTH_WORTH * depth
            lost, near = max(lost, chance), max(near, close)
            stays += chance + close
            if lost + near + STAY_WORTH * stays / STEPS >= enough:
                break
    return lost + near + STAY_WORTH * stays / STEPS


@compiled
def _free(fence: Floats, own: Own, n: float, e: float) -> float:
    """Distance (m) to the first wall in a direction, minus the margin kept from fences and twice the error of
    our position."""
    size = math.sqrt(n * n + e * e)
    if size == 0.0:
        return math.inf
    n, e, here, first = n / size, e / size, own.position, math.inf
    for row in range(len(fence)):
        wall = wall_at(fence, row)
        pn, pe = wall.n - here.n, wall.e - here.e
        if wall.kind >= IN_CIRCLE:
            middle, off = pn * n + pe * e, pn * e - pe * n
            inner = wall.radius_m * wall.radius_m - off * off
            if inner > 0.0:
                root = math.sqrt(inner)
                for way in (middle - root, middle + root):
                    first = min(first, way) if way > 0.0 else first
        else:
            sn, se = wall.end_n - wall.n, wall.end_e - wall.e
            cross = n * se - e * sn
            if cross != 0.0:
                way, share = (pn * se - pe * sn) / cross, (pn * e - pe * n) / cross
                if way > 0.0 and 0.0 <= share <= 1.0:
                    first = min(first, way)
    return max(first - FENCE_MARGIN_M - 2.0 * own.sigma_m, 0.0)


@compiled
def _risks(way: _Way, view: _View, enough: float, keep: bool) -> float:
    """Risk of a way with all crewed aircraft.

    Args:
        keep: whether to store the risk of each aircraft in its table.
    """
    total = 0.0
    for j in range(view.rows):
        if view.ahead[j, 1, 7] != 0.0:
            risk = _risk(view.ahead[j], way, view, enough - total)
            if keep:
                view.ahead[j, 0, 7] = risk
            total += risk
            if total >= enough:
                break
    return total


@compiled
def _heading(number: int, wanted: Vector, most_mps: float) -> Point:
    """Horizontal part of a velocity to try: -2 along the path, -1 none, then the headings."""
    if number == -2:
        return Point(wanted.n, wanted.e)
    if number == -1:
        return Point(0.0, 0.0)
    speed, angle = most_mps if number < HEADINGS else 0.5 * most_mps, 2.0 * math.pi * number / HEADINGS
    return Point(speed * math.cos(angle), speed * math.sin(angle))


@compiled
def _price(v: Vector, wanted: Vector, command: Vector) -> float:
    """Price of a velocity."""
    lower = v.d - wanted.d
    aside = math.sqrt((v.n - wanted.n) ** 2 + (v.e - wanted.e) ** 2)
    height = max(DOWN_PRICE * lower, -UP_PRICE * lower)
    return SIDE_PRICE * aside + height + CHANGE_PRICE * length(minus(v, command))


@compiled
def _cheapest(
    view: _View, wanted: Vector, fence: Floats, settings: Settings, command: Vector, least: float
) -> tuple[Vector, bool]:
    """The cheapest velocity, and whether one is cheaper than `least`; otherwise it is `wanted`."""
    wish, found, own = wanted, False, view.own
    for number in range(-2, 2 * HEADINGS):
        level = _heading(number, wanted, settings.speed_mps)
        free = math.inf if number < 0 else _free(fence, own, level.n, level.e)
        for vertical, d in enumerate((wanted.d, settings.descent_mps, 0.0, -settings.climb_mps)):
            v = clipped(Vector(level.n, level.e, d), settings.speed_mps)
            price = _price(v, wanted, command)
            if price < least:
                answer = _ANSWER_S + 0.5 * length(minus(v, own.velocity)) / settings.acceleration_mps2
                way = _Way(v, answer, free, 1.0 if number == -2 else 0.0, 1.0 if vertical == 0 else 0.0)
                price += _risks(way, view, least - price, False)
                if price < least:
                    least, wish, found = price, v, True
    return wish, found


@compiled
def crewed_wish(
    neighbours: Floats, count: int, own: Own, wanted: Vector, path: Path, path_s: float, fence: Floats,
    settings: Settings, command: Vector, ahead: Floats,
) -> tuple[Vector, bool]:  # fmt: skip
    """The velocity to fly because of crewed traffic.

    Args:
        neighbours, count: table of neighbours, and how many of its rows count.
        wanted: the velocity along the path and back to it, m/s.
        path, path_s: the timed path, and the time on it.
        fence: table of walls. Candidates are assumed to stop before them, except along the path.
        command: the last command, m/s.
        ahead: (at least count, STEPS, AHEAD_COLUMNS): predictions; written. The last entry of the first row
            of an aircraft is the risk of flying on.

    Returns:
        The velocity, and whether there is a conflict: the velocity differs from `wanted`, or flying on is
        risky. In a conflict, `ahead` shows at least `LEAST_RISK` for the riskiest aircraft, so that one can
        be reported even if the risk is the sum of many small ones.
    """
    radius = settings.crewed_m / math.sqrt(2.0)
    gap = minus(own.position, point_at(path, path_s))
    follow = _Follow(gap, min(length(gap) / settings.recovery_s, settings.speed_mps), path_s)
    view = _View(count, ahead, own, path, follow, radius, radius / settings.crewed_vertical)
    if not _select(neighbours, count, own, view, settings.speed_mps):
        return wanted, False
    risk = _risks(_Way(wanted, 0.0, math.inf, 1.0, 1.0), view, math.inf, True)
    if risk < LEAST_RISK:
        return wanted, False
    least = risk + CHANGE_PRICE * length(minus(wanted, command))
    wish, found = _cheapest(view, wanted, fence, settings, command, least)
    if not (found or risk >= CONFLICT_RISK):
        return wanted, False
    riskiest = 0
    for j in range(count):
        riskiest = j if ahead[j, 0, 7] > ahead[riskiest, 0, 7] else riskiest
    ahead[riskiest, 0, 7] = max(ahead[riskiest, 0, 7], LEAST_RISK)
    return wish, True
