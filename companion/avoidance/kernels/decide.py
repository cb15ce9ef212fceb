"""One decision: from the own state, the path and the neighbours to the command.

`decide` is a complete law: it builds the planes of neighbours and fences, finds the velocity with `programs`
and the command with `hard_planes`. A compiled loop over many aircraft can call it in the same way as the
aircraft does.
"""

from __future__ import annotations

import math

import numpy as np

from companion.arrays import Floats
from companion.avoidance.kernels.compiled import compiled
from companion.avoidance.kernels.crewed import LEAST_RISK, crewed_wish, turn_rate
from companion.avoidance.kernels.fence_planes import (
    BRAKES,
    DOWN_SPEEDS,
    FENCE_MARGIN_M,
    LAG_S,
    Site,
    closing,
    wall_planes,
)
from companion.avoidance.kernels.hard_planes import Bounds, keep, limit
from companion.avoidance.kernels.neighbours import (
    KEPT_S,
    NO_PAST,
    all_within,
    kept_for,
    neighbour_planes,
    note_track,
    other_at,
    silent_after,
)
from companion.avoidance.kernels.powers import HYPOTHESES, note_power, suspicion
from companion.avoidance.kernels.priority import Asked, put_last, solve_in_order
from companion.avoidance.kernels.programs import EPSILON
from companion.avoidance.kernels.settings import (
    DMUCA,
    NONE,
    OTHER_COLUMNS,
    PAPER,
    Decision,
    Own,
    Settings,
    State,
    Workspace,
    workspace,
)
from companion.avoidance.kernels.timelines import (
    History,
    Path,
    note_velocity,
    path_nearest,
    path_position,
    point_at,
)
from companion.avoidance.kernels.vectors import (
    Plane,
    Point,
    Triple,
    Vector,
    along,
    clipped,
    dot,
    length,
    minus,
    plane_at,
    put_plane,
    times,
)
from companion.avoidance.kernels.walls import NO_WALLS, inside

ON_PLANE_MPS = 1e-6
"""A plane bounds a velocity that satisfies it by at most this."""
BOUNDARY_LAG_S = 1.0
"""Time from a decision to the vehicle's response, for floor and ceiling: autopilot lag, period and
latency."""
BOUNDARY_MPS2 = 1.0
"""Greatest deceleration that is assumed for stopping before floor and ceiling, even if the command's limit is
higher. ArduPilot reached 1.1 m/s^2 vertically and 2.8 horizontally (docs/simulation-results.md)."""
TURN_MPS = 2.0
"""Greatest sideways speed that the turn to the right adds: that of 0.2 rad at 10 m/s. At 20 m/s the whole
angle takes more room than the planes need, and aircraft weave because they turn and return by what others did
seconds ago. With 1 m/s, 3 of 7,000 such flights lost separation (seeds 2,001 to 2,500), with 2 m/s none."""
RESTART_S = 1.0
"""After a pause longer than this and than five periods, the command starts again from the own velocity."""

PlainDecision = tuple[
    Triple, Triple, Triple, tuple[bool, ...], tuple[int, int], tuple[Triple, float, float, float, int]
]


@compiled
def on_plane(plane: Plane, v: Vector) -> bool:
    """Whether a plane bounds a velocity: the velocity lies on it, or violates it. False if its normal is
    0."""
    n = plane.normal
    if n.n == 0.0 and n.e == 0.0 and n.d == 0.0:
        return False
    return dot(n, v) <= plane.least + ON_PLANE_MPS


@compiled
def down_speeds(own: Own, settings: Settings) -> tuple[float, float]:
    """Least and greatest down speed: within the climb and descent limits, and able to stop before floor and
    ceiling."""
    down, acceleration = own.position.d, min(settings.acceleration_mps2, BOUNDARY_MPS2)
    least, most = -settings.climb_mps, settings.descent_mps
    most = min(max(closing(own.floor_d - down, acceleration, BOUNDARY_LAG_S), least), most)
    least = min(
        max(-closing(down - own.ceiling_d, acceleration, BOUNDARY_LAG_S), least), settings.descent_mps
    )
    # If floor and ceiling are close together, the way back from one may be faster than the other allows.
    return min(least, most), most


@compiled
def _slower(gap: Vector, velocity: Vector, settings: Settings) -> float:
    """Delay per second of a path whose point is farther ahead than the speed in reserve can make up for
    within `catch_up_s`. The paper instead updates the expected arrival when the way back is clipped."""
    speed = length(velocity)
    lead = dot(gap, velocity) / speed
    most_speed = settings.speed_mps
    if velocity.d < -EPSILON:
        most_speed = min(most_speed, speed * settings.climb_mps / -velocity.d)
    elif velocity.d > EPSILON:
        most_speed = min(most_speed, speed * settings.descent_mps / velocity.d)
    reserve = max(most_speed - speed, 0.0)
    gain = 1.0 / settings.recovery_s
    return min(max(gain * (lead - reserve * settings.catch_up_s) / speed, 0.0), 1.0)


@compiled
def _preferred(
    own: Own, path: Path, settings: Settings, delay_s: float, least: float, most: float
) -> tuple[Vector, float]:
    """The preferred velocity, along the path and back to its point within T, and the path's delay per second.

    The velocity along the path turns ahead of a corner, over the time that the acceleration limit needs.
    Otherwise the aircraft would overshoot, and only the gap would lead it back. After the path's end there is
    no feed-forward.
    """
    t, half = own.path_time_s - delay_s, settings.turn_s
    gap = minus(point_at(path, t), own.position)
    velocity = times(0.5 / half, minus(point_at(path, t + half), point_at(path, t - half)))
    slower = 0.0
    if settings.catch_up_s > 0.0 and length(velocity) > EPSILON and path.times_s[0] < t < path.times_s[-1]:
        slower = _slower(gap, velocity, settings)
    wanted = along(velocity, 1.0 / settings.recovery_s, gap)
    wanted = Vector(wanted.n, wanted.e, min(max(wanted.d, least), most))
    return clipped(wanted, settings.speed_mps), slower


@compiled
def _published_recovery(own: Own, path: Path, settings: Settings, delay_s: float) -> tuple[Vector, float]:
    """The paper's velocity back to the path, in both cases, and the delay of the path. If the velocity
    exceeds v_max, the path is delayed accordingly."""
    t, p = own.path_time_s - delay_s, own.position
    nearest_s, (n, e, d) = path_nearest(path.times_s, path.points, p.n, p.e, p.d)
    point, within = Vector(n, e, d), nearest_s - t
    if within <= 0.0:
        point, within = point_at(path, t), settings.recovery_s
    gap = minus(point, p)
    longer = length(gap) / settings.speed_mps
    if longer > within:
        delay_s += longer - within
        within = longer
    return Vector(gap.n / within, gap.e / within, gap.d / within), delay_s


@compiled
def _started(own: Own, state: State, settings: Settings) -> tuple[Vector, float]:
    """The last command, or the own velocity after a pause, and how much the command may change from it."""
    passed, command = own.now_s - state.time_s, state.command
    period = settings.period_s
    if not passed <= max(RESTART_S, 5.0 * period):  # also at the first decision, where it is NaN
        passed, v = period, own.velocity
        down = min(max(v.d, -settings.climb_mps), settings.descent_mps)
        command = clipped(Vector(v.n, v.e, down), settings.speed_mps)
    return command, settings.acceleration_mps2 * max(passed, 0.0)


@compiled
def _turned(wanted: Vector, right_rad: float) -> Vector:
    """The velocity, turned to the right by an angle that leads aside with at most TURN_MPS."""
    if right_rad == 0.0:
        return wanted
    aside = math.sin(right_rad) * math.sqrt(wanted.n * wanted.n + wanted.e * wanted.e)
    if aside > TURN_MPS:
        right_rad = math.asin(math.sin(right_rad) * TURN_MPS / aside)
    c, s = math.cos(right_rad), math.sin(right_rad)
    return Vector(c * wanted.n - s * wanted.e, s * wanted.n + c * wanted.e, wanted.d)


@compiled
def _fence_first(
    site: Site, before: Vector, change: float, least: float, most: float, planes: Floats
) -> tuple[int, int]:
    """Write the planes of the down speeds and of the fence. Returns the row after the hard ones, and after
    all."""
    put_plane(planes, 0, Vector(0.0, 0.0, 1.0), least)
    put_plane(planes, 1, Vector(0.0, 0.0, -1.0), -most)
    if len(site.fence) == 0:
        return DOWN_SPEEDS, DOWN_SPEEDS
    bound = min(math.sqrt(before.n * before.n + before.e * before.e) + change, site.speed)
    return wall_planes(site, before, bound, BRAKES * change, planes, DOWN_SPEEDS)


@compiled
def _bounded(work: Workspace, count: int, hard: int, solved: Vector) -> tuple[bool, bool, bool]:
    """Note for each neighbour whether its planes bound a velocity. Returns whether the first plane (least
    down speed), the second plane (greatest down speed), and any other hard plane do."""
    for j in range(count):
        asked = work.asked[j]
        active = on_plane(plane_at(asked, 0), solved) or on_plane(plane_at(asked, 1), solved)
        work.seen[j, 7] = 1.0 if active else 0.0
    at_fence = False
    for row in range(DOWN_SPEEDS, hard):
        at_fence = at_fence or on_plane(plane_at(work.planes, row), solved)
    return on_plane(plane_at(work.planes, 0), solved), on_plane(plane_at(work.planes, 1), solved), at_fence


@compiled
def _note_crewed(neighbours: Floats, count: int, work: Workspace) -> None:
    """Report the crewed aircraft because of which we do not fly as planned."""
    for j in range(count):
        if other_at(neighbours, j).crewed != 0.0 and work.ahead[j, 0, 7] >= LEAST_RISK:
            work.seen[j, 4], work.seen[j, 7] = 1.0, 1.0


@compiled
def decide(
    neighbours: Floats,
    count: int,
    own: Own,
    path: Path,
    fence: Floats,
    settings: Settings,
    state: State,
    history: History,
    work: Workspace,
) -> Decision:
    """Make one aircraft's decision by the law in its settings.

    Args:
        neighbours, count: table of neighbours (`Other`), and how many of its rows count.
        path: the timed path, before any delay.
        fence: table of walls (`Wall`).
        state: returned by the decision before, or by `first_state`.
        history: written.
        work: tables for at least that many walls and neighbours; written.
    """
    law, delay_s = settings.law, state.delay_s
    least, most = down_speeds(own, settings)
    if law == PAPER:
        # The current velocity is tested for conflict, and the law changes it as little as possible.
        samples, wanted = 0, own.velocity
    else:
        samples = state.samples
        wanted, slower = _preferred(own, path, settings, delay_s, least, most)
        if own.now_s - state.time_s <= RESTART_S:
            delay_s += slower * max(own.now_s - state.time_s, 0.0)
    before, change = _started(own, state, settings)
    samples = note_velocity(history.times_s, history.velocities, samples, own.now_s, own.velocity)
    here = Point(own.position.n, own.position.e)
    ahead = Point(here.n + LAG_S * own.velocity.n, here.e + LAG_S * own.velocity.e)
    margin = FENCE_MARGIN_M + 2.0 * own.sigma_m
    site = Site(fence, here, ahead, margin, settings.speed_mps, settings.acceleration_mps2)
    hard, first = _fence_first(site, before, change, least, most, work.planes)
    wish, gives_way = wanted, False
    if law == DMUCA:
        wish, gives_way = crewed_wish(
            neighbours, count, own, wanted, path, own.path_time_s - delay_s, fence, settings, before,
            work.ahead,
        )  # fmt: skip
    after, conflict, on_right = neighbour_planes(
        neighbours, count, own, wish, settings, history, samples, work.planes, first, work.seen, work.asked,
        before,
    )  # fmt: skip
    last = put_last(neighbours, count, work.planes, first, after, work.asked)
    if conflict and not on_right:
        wish = _turned(wish, settings.right_rad)
    conflict = conflict or gives_way
    asked = Asked(work.planes, hard, last, after, work.scratch)
    feasible, solved = solve_in_order(asked, settings.speed_mps, wish)
    at_least, at_most, at_fence = _bounded(work, count, hard, solved)
    if gives_way:
        _note_crewed(neighbours, count, work)
    flown, quiet = solved, state.quiet
    if law == PAPER:
        quiet = 0.0 if conflict else quiet + 1.0
        recovering = quiet >= settings.quiet
        if recovering:
            wanted, delay_s = _published_recovery(own, path, settings, delay_s)
            flown = wanted
    else:
        gap = minus(point_at(path, own.path_time_s - delay_s), own.position)
        recovering = dot(gap, gap) > settings.regained_m**2 and not (conflict and law == DMUCA)
        if law == NONE:
            feasible, flown = True, wanted
    bounds = Bounds(change, least, most, settings.speed_mps)
    if len(fence) > 0 and law != NONE:
        chosen = keep(site, flown, before, bounds, work.planes, hard, work.scratch)
    else:
        chosen = limit(flown, before, bounds)
    kept = State(chosen, own.now_s, quiet, delay_s, samples)
    return Decision(
        chosen, wanted, solved, feasible, conflict, recovering, hard, first, at_least, at_most, at_fence, kept
    )


@compiled
def _plain(v: Vector) -> Triple:
    return v.n, v.e, v.d


@compiled
def decide_plain(
    neighbours: Floats,
    count: int,
    own: tuple[Triple, Triple, float, float, float, float, float],
    path: tuple[Floats, Floats],
    fence: Floats,
    settings: tuple[float, ...],
    state: tuple[Triple, float, float, float, int],
    history: tuple[Floats, Floats],
    work: tuple[Floats, Floats, Floats, Floats, Floats],
) -> PlainDecision:
    """`decide` for calls from Python, with plain tuples in place of the named ones.

    numba takes 2 us to take over or to return one named tuple, and a tenth of it for a plain one.

    Returns:
        `chosen`, `wanted`, `solved`; `feasible`, `conflict`, `recovering`, `at_least_down`, `at_most_down`,
        `at_fence`; `hard`, `first`; and the fields of `state`.
    """
    position, velocity, sigma_m, now_s, path_time_s, floor_d, ceiling_d = own
    command, time_s, quiet, delay_s, samples = state
    d = decide(
        neighbours, count,
        Own(Vector(*position), Vector(*velocity), sigma_m, now_s, path_time_s, floor_d, ceiling_d),
        Path(*path), fence, Settings(*settings), State(Vector(*command), time_s, quiet, delay_s, samples),
        History(*history), Workspace(*work),
    )  # fmt: skip
    return (
        _plain(d.chosen), _plain(d.wanted), _plain(d.solved),
        (d.feasible, d.conflict, d.recovering, d.at_least_down, d.at_most_down, d.at_fence),
        (d.hard, d.first),
        (_plain(d.state.command), d.state.time_s, d.state.quiet, d.state.delay_s, d.state.samples),
    )  # fmt: skip


def warm_up() -> None:
    """Compile, or load from the cache, everything that a decision calls.

    Call this before taking control of the vehicle: the first compilation takes many seconds, and a vehicle
    that waits for setpoints meanwhile goes into its failsafe.
    """
    neighbours = np.zeros((2, OTHER_COLUMNS))
    neighbours[:, :2] = 3.0
    path, history = (np.arange(2.0), np.zeros((2, 3))), (np.zeros(4), np.zeros((4, 3)))
    zero = 0.0, 0.0, 0.0
    samples = note_velocity(*history, 0, 0.0, zero)
    decide_plain(
        neighbours, 2, (zero, zero, 0.0, 0.0, 0.0, 0.0, 0.0), path, NO_WALLS, (1.0,) * len(Settings._fields),
        (zero, 0.0, 0.0, 0.0, samples), history, (*workspace(0, 2),),
    )  # fmt: skip
    all_within(neighbours, 2, 1.0)
    silent_after(0.0)
    kept_for(0.0, KEPT_S)
    turn_rate(0.0, zero, zero, 1.0)
    note_track(tuple(NO_PAST), 1.0, zero, zero, 1.0)
    powers = np.zeros(HYPOTHESES)
    note_power(powers, np.zeros((2, HYPOTHESES)), np.zeros(3), 0.0, 0.0, 0.0, 0.0, 0.0)
    suspicion(powers)
    path_position(*path, 0.0)
    path_nearest(*path, 0.0, 0.0, 0.0)
    inside(np.zeros((1, NO_WALLS.shape[1])), 0, 1, Point(0.0, 0.0))
