"""One flight of a fleet, all in compiled code: vehicles, GNSS errors, messages, the companion's own law.

Vehicles answer a velocity command with a first-order lag and a limited acceleration. Every aircraft sends
its state once a period, at its own phase; each of the others gets it after a delay of its own, or not at all.
Positions carry a time-correlated GNSS error, the same in what is sent and what the aircraft flies by; sent
velocities carry white noise, and messages are quantised as Remote ID does (ASTM F3411-22a). The decision is
`companion.avoidance.kernels.decide`, as it flies.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from companion.avoidance import kernels as k
from companion.avoidance.law import OLDEST_S
from companion.traffic import adsb
from companion.traffic.right_of_way import CREWED as CREWED_RANK
from companion.traffic.right_of_way import FREE, share_of
from ground_tools.campaign.compiled import compiled

Array = NDArray[np.float64]

COLLISION_M = 2.0
CREWED_SHARE = share_of(FREE, CREWED_RANK)
AWAY_M = 15.0
"""Farther than this from the timed point counts as away from the path."""

# Entries of `world`.
(
    W_START,  # s, on the paths' clock
    W_END,  # s
    W_STEP,  # s
    W_PERIOD,  # steps from one decision to the next
    W_MESSAGE,  # steps from one message to the next
    W_DELAY_LOW,  # s
    W_DELAY_HIGH,  # s
    W_LOSS,  # share of messages that a receiver does not get
    W_SIGMA,  # m for each axis
    W_SIGMA_MEMORY,  # s
    W_SIGMA_VELOCITY,  # m/s for each axis
    W_DECLARED,  # m, what everybody says of the own position's error
    W_QUANTISED,  # 0 or 1
    W_LAG,  # s
    W_ACCELERATION,  # m/s^2
    W_GUST,  # m/s^2 for each axis
    W_GUST_MEMORY,  # s
    W_OWN_VELOCITY,  # m/s for each axis, of the error of the own velocity, as slow as that of the position
    W_CLOCK,  # s, most that a clock is off
    W_FLOOR,  # NED down, m
    W_CEILING,  # NED down, m
    W_SILENT,  # m, within which a silent one is heard
    W_LIE,  # m, by which a liar's position is off
    W_BLACKOUT,  # s for which one aircraft has no GNSS
    WORLD_ENTRIES,
) = range(25)
# What an aircraft is: one that avoids; one that sends and flies its path (blind), or besides turns and climbs
# at random (turning), and always sends its first velocity (frozen), is not heard from afar (silent), sends
# a wrong position (liar); crewed traffic, heard by ADS-B, with a geometric altitude (crewed) or with one that
# says nothing within 300 m (barometric); one that flies its path and sends with the identity of the second
# aircraft (twin), and from its radio address, too (clone), or with that of whoever hears it (own twin, own
# clone): those are flown by `twins.fly`.
(
    AVOIDS, BLIND, TURNING, SILENT, LIAR, FROZEN, CREWED, BAROMETRIC, TWIN, CLONE, OWN_TWIN, OWN_CLONE,
) = range(12)  # fmt: skip
INTRUDERS = {
    "blind": BLIND, "turning": TURNING, "silent": SILENT, "liar": LIAR, "frozen": FROZEN, "crewed": CREWED,
    "barometric": BAROMETRIC,
}  # fmt: skip
TWINS = {"twin": TWIN, "clone": CLONE, "own-twin": OWN_TWIN, "own-clone": OWN_CLONE}
_TURN_S = 4.0
"""Between two changes of mind of one that turns."""
_TURN_RAD = math.radians(60.0)
"""Most that it turns off its way to the path."""
_BLACKOUT_BEFORE_S, _BLACKOUT_AFTER_S = 15.0, 5.0
"""A loss of GNSS begins between these times before and after the middle of the flight."""
_FIT_AGAIN_S = 4.0
"""From GNSS regained to the next command: the heart waits for a steady state, then takes the vehicle anew."""
# Columns of a message: its time (s), position, velocity.
M_TIME, M_POSITION, M_VELOCITY, MESSAGE_COLUMNS = 0, 1, 4, 7
# Columns of what a decision saw of another: when the message was sent (s), then its rows of `neighbours` and
# of `view`. In the own place stand time, position and velocity of the own last message.
SEEN_MESSAGE, SEEN_NEIGHBOUR = 0, 1
SEEN_VIEW = SEEN_NEIGHBOUR + k.NEIGHBOUR_COLUMNS
SEEN_COLUMNS = SEEN_VIEW + k.VIEW_COLUMNS
DECIDED_COLUMNS = k.OWN_ENTRIES + k.OUT_ENTRIES
# What comes of a flight.
(
    F_SEPARATION,  # least distance of any pair, m
    F_TIME,  # when, s
    F_FIRST,  # of which pair
    F_SECOND,
    F_DEVIATION,  # largest distance of any aircraft that avoids from its timed point, m
    F_AWAY,  # longest time that any of them was away from it, s
    F_BACK,  # largest distance at the end, m
    F_LOST,  # largest delay of a path, s
    F_PATH_RATIO,  # way flown by all over way planned for all
    F_MANOEUVRES,  # times that a conflict began, of all
    F_INFEASIBLE,  # share of decisions that could not keep every plane
    F_RECOVERY,  # longest time from the last decision in conflict until back, s; infinite: not back
    F_CREWED,  # least of the larger of horizontal and vertical distance from crewed traffic, in separations
    F_FENCE,  # farthest beyond a fence, m
    FLIGHT_ENTRIES,
) = range(15)
# What comes of a pair: least distance (m); 1 where one that avoids was in conflict with the other.
P_SEPARATION, P_ALERT, PAIR_ENTRIES = range(3)


class World(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a fleet flies in."""

    start_s: float = 0.0
    end_s: float = 500.0
    step_s: Annotated[float, Meta(gt=0)] = 0.1
    delay_s: tuple[float, float] = (0.0, 1.0)
    """Of every message to every receiver, drawn uniformly."""
    loss: Annotated[float, Meta(ge=0, le=1)] = 0.0
    sigma_m: Annotated[float, Meta(ge=0)] = 1.5
    """GNSS error, one standard deviation for each axis."""
    sigma_memory_s: Annotated[float, Meta(gt=0)] = 30.0
    sigma_mps: Annotated[float, Meta(ge=0)] = 0.3
    declared_m: Annotated[float, Meta(ge=0)] = 1.5
    quantised: bool = True
    message_s: Annotated[float, Meta(gt=0)] = 1.0
    lag_s: Annotated[float, Meta(gt=0)] = 0.5
    acceleration_mps2: Annotated[float, Meta(gt=0)] = 2.5
    gust_mps2: Annotated[float, Meta(ge=0)] = 0.0
    """What gusts do to a vehicle that holds its velocity; a steady wind is compensated."""
    gust_memory_s: Annotated[float, Meta(gt=0)] = 3.0
    own_sigma_mps: Annotated[float, Meta(ge=0)] = 0.0
    clock_s: Annotated[float, Meta(ge=0)] = 0.0
    """Every clock is off by up to this, drawn once."""
    floor_m: float = -math.inf
    """Height, as of the generators'."""
    ceiling_m: float = math.inf
    silent_m: Annotated[float, Meta(ge=0)] = 100.0
    lie_m: Annotated[float, Meta(ge=0)] = 50.0
    blackout_s: Annotated[float, Meta(ge=0)] = 0.0
    """One that avoids has no GNSS for so long around the middle of the flight: it sends nothing, decides
    nothing and stands still."""

    def row(self, period_s: float) -> Array:
        """As the kernel takes it, shape (WORLD_ENTRIES,)."""
        row = np.zeros(WORLD_ENTRIES)
        row[W_START], row[W_END], row[W_STEP] = self.start_s, self.end_s, self.step_s
        row[W_PERIOD] = max(1, round(period_s / self.step_s))
        row[W_MESSAGE] = max(1, round(self.message_s / self.step_s))
        row[W_DELAY_LOW], row[W_DELAY_HIGH] = self.delay_s
        row[W_LOSS], row[W_QUANTISED] = self.loss, self.quantised
        row[W_SIGMA], row[W_SIGMA_MEMORY] = self.sigma_m, self.sigma_memory_s
        row[W_SIGMA_VELOCITY], row[W_DECLARED] = self.sigma_mps, self.declared_m
        row[W_LAG], row[W_ACCELERATION] = self.lag_s, self.acceleration_mps2
        row[W_GUST], row[W_GUST_MEMORY] = self.gust_mps2, self.gust_memory_s
        row[W_OWN_VELOCITY], row[W_CLOCK] = self.own_sigma_mps, self.clock_s
        row[W_FLOOR], row[W_CEILING] = -self.floor_m, -self.ceiling_m
        row[W_SILENT], row[W_LIE] = self.silent_m, self.lie_m
        row[W_BLACKOUT] = self.blackout_s
        return row


_compiled = compiled()
_inlined = compiled(inline="always")
"""For what every step calls: a call that hands over a fleet costs as much as the step."""


class Fleet(NamedTuple):
    """A fleet in the air, A aircraft. NED, m and s; by aircraft where nothing else is said."""

    position: Array
    """(A, 3)."""
    before: Array
    """(A, 3): a step ago."""
    velocity: Array
    """(A, 3)."""
    command: Array
    """(A, 3)."""
    error: Array
    """(A, 3), of the GNSS position."""
    own_error: Array
    """(A, 3), of the own velocity."""
    gust: Array
    """(A, 3), m/s^2."""
    clock: Array
    """(A,): how far it leads."""
    phase: NDArray[np.int64]
    """(A,): steps from a message to the flight's first step."""
    frozen: Array
    """(A, 3): the first velocity."""
    lie: Array
    """(A, 2): what is added to a sent position."""
    sent: Array
    """(A, slots, MESSAGE_COLUMNS): the last messages."""
    arrival: Array
    """(receiver, sender, slots): when those come; infinite: not, or they came."""
    conflict_at: Array
    """(A,): when it was in conflict last."""
    recovery: Array
    """(A,): how long it took to come back; infinite: not back."""
    away_since: Array
    """(A,): infinite while it is not away."""
    way: Array
    """(2,): flown and planned, of all."""
    least2: Array
    """(A, A): squares of the least distances."""


@_compiled
def _quantise(message: Array) -> None:
    """Speed in 0.25 m/s, direction in degrees, vertical speed in 0.5 m/s, 1e-7 degrees, heights in 0.5 m."""
    speed = round(math.hypot(message[4], message[5]) / 0.25) * 0.25
    course = round(math.atan2(message[5], message[4]) * 180.0 / math.pi) * math.pi / 180.0
    message[1], message[2] = round(message[1] / 0.0111) * 0.0111, round(message[2] / 0.0111) * 0.0111
    message[3] = round(message[3] / 0.5) * 0.5
    message[4], message[5] = speed * math.cos(course), speed * math.sin(course)
    message[6] = round(message[6] / 0.5) * 0.5


@_compiled
def _least_distance2(position: Array, before: Array, i: int, j: int) -> float:
    """Square of the least distance of two aircraft on their straight ways of one step."""
    px, py, pz = before[j, 0] - before[i, 0], before[j, 1] - before[i, 1], before[j, 2] - before[i, 2]
    dx, dy, dz = (
        position[j, 0] - position[i, 0] - px,
        position[j, 1] - position[i, 1] - py,
        position[j, 2] - position[i, 2] - pz,
    )
    d2 = dx * dx + dy * dy + dz * dz
    if d2 > 0.0:
        share = min(max(-(px * dx + py * dy + pz * dz) / d2, 0.0), 1.0)
        px, py, pz = px + share * dx, py + share * dy, pz + share * dz
    return float(px * px + py * py + pz * pz)


@_compiled
def _distance(position: Array, i: int, j: int) -> float:
    return math.sqrt(
        (position[i, 0] - position[j, 0]) ** 2
        + (position[i, 1] - position[j, 1]) ** 2
        + (position[i, 2] - position[j, 2]) ** 2
    )


@_compiled
def _beyond(fence: Array, n: float, e: float) -> float:
    """How far (m) a point is on the wrong side of the area that it is most wrong about; 0: of none."""
    worst, first = 0.0, 0
    while first < len(fence):
        after, near = first, math.inf
        while after < len(fence) and fence[after, k.W_AREA] == fence[first, k.W_AREA]:
            room, _, _ = k.nearest_of_wall(fence[after], n, e)
            near = min(near, room)
            after += 1
        kind = fence[first, k.W_KIND]
        if k.inside(fence, first, after, n, e) != (kind in (k.IN_POLYGON, k.IN_CIRCLE)):
            worst = max(worst, near)
        first = after
    return worst


@_compiled
def _write_down(
    decided: Array,
    seen: Array,
    i: int,
    own: Array,
    command: Array,
    out: Array,
    senders: NDArray[np.int64],
    count: int,
    heard: Array,
    neighbours: Array,
    view: Array,
) -> None:
    """One decision of aircraft i, as it was flown, into the rows of `fly`."""
    decided[i, : k.OWN_ENTRIES] = own
    decided[i, k.OWN_ENTRIES :] = out
    decided[i, k.OWN_ENTRIES : k.OWN_ENTRIES + 3] = command
    seen[i, i, :MESSAGE_COLUMNS] = heard[i]
    for n in range(count):
        j = senders[n]
        seen[i, j, SEEN_MESSAGE] = heard[j, M_TIME]
        seen[i, j, SEEN_NEIGHBOUR:SEEN_VIEW] = neighbours[n]
        seen[i, j, SEEN_VIEW:] = view[n]


@_inlined
def on_the_ground(fleet: int, world: Array) -> Fleet:
    """A fleet of which nothing is known yet."""
    slots = int(world[W_DELAY_HIGH] / (world[W_MESSAGE] * world[W_STEP])) + 2
    return Fleet(
        position=np.zeros((fleet, 3)),
        before=np.zeros((fleet, 3)),
        velocity=np.zeros((fleet, 3)),
        command=np.zeros((fleet, 3)),
        error=np.zeros((fleet, 3)),
        own_error=np.zeros((fleet, 3)),
        gust=np.zeros((fleet, 3)),
        clock=np.zeros(fleet),
        phase=np.zeros(fleet, np.int64),
        frozen=np.zeros((fleet, 3)),
        lie=np.zeros((fleet, 2)),
        sent=np.zeros((fleet, slots, MESSAGE_COLUMNS)),
        arrival=np.full((fleet, fleet, slots), math.inf),
        conflict_at=np.zeros(fleet),
        recovery=np.zeros(fleet),
        away_since=np.full(fleet, math.inf),
        way=np.zeros(2),
        least2=np.full((fleet, fleet), math.inf),
    )


@_compiled
def begin(
    rng: np.random.Generator, world: Array, path_times: Array, path_points: Array, kinds: Array, craft: Fleet
) -> None:
    """Every aircraft onto its path, with the errors that it has; arguments as of `fly`."""
    step, message_every = world[W_STEP], int(world[W_MESSAGE])
    position, velocity = craft.position, craft.velocity
    for i in range(len(kinds)):
        n, e, d = k.path_position(path_times[i], path_points[i], world[W_START])
        position[i, 0], position[i, 1], position[i, 2] = n, e, d
        bn, be, bd = k.path_position(path_times[i], path_points[i], world[W_START] + step)
        velocity[i, 0], velocity[i, 1], velocity[i, 2] = (bn - n) / step, (be - e) / step, (bd - d) / step
        for c in range(3):
            craft.command[i, c] = velocity[i, c]
            craft.error[i, c] = rng.normal(0.0, world[W_SIGMA])
            craft.frozen[i, c] = velocity[i, c]
            craft.own_error[i, c] = rng.normal(0.0, world[W_OWN_VELOCITY])
        craft.phase[i] = rng.integers(0, message_every)
        craft.clock[i] = rng.uniform(-world[W_CLOCK], world[W_CLOCK])
        bearing = rng.uniform(0.0, 2.0 * math.pi)
        if kinds[i] == LIAR:
            craft.lie[i, 0] = world[W_LIE] * math.cos(bearing)
            craft.lie[i, 1] = world[W_LIE] * math.sin(bearing)


@_inlined
def send(rng: np.random.Generator, world: Array, tick: int, i: int, kinds: Array, craft: Fleet) -> int:
    """What aircraft i sends at a step of its phase, into `sent` and `arrival`; the slot."""
    position, velocity, error, clock = craft.position, craft.velocity, craft.error, craft.clock
    phase, frozen, lie, sent, arrival = craft.phase, craft.frozen, craft.lie, craft.sent, craft.arrival
    now = world[W_START] + tick * world[W_STEP]
    slot = int(((tick + phase[i]) // int(world[W_MESSAGE])) % sent.shape[1])
    message = sent[i, slot]
    message[M_TIME] = now + clock[i]
    for c in range(3):
        sent_velocity = frozen[i, c] if kinds[i] == FROZEN else velocity[i, c]
        message[M_POSITION + c] = position[i, c] + error[i, c]
        message[M_VELOCITY + c] = sent_velocity + rng.normal(0.0, world[W_SIGMA_VELOCITY])
    message[M_POSITION] += lie[i, 0]
    message[M_POSITION + 1] += lie[i, 1]
    if world[W_QUANTISED] != 0.0:
        _quantise(message)
    for j in range(len(kinds)):
        if j != i:
            delay = rng.uniform(world[W_DELAY_LOW], world[W_DELAY_HIGH])
            lost = world[W_LOSS] > 0.0 and rng.random() < world[W_LOSS]
            if kinds[i] == SILENT and _distance(position, i, j) > world[W_SILENT]:
                lost = True
            arrival[j, i, slot] = math.inf if lost else now + delay
    return slot


@_inlined
def move(
    rng: np.random.Generator,
    world: Array,
    tick: int,
    last: bool,
    path_times: Array,
    path_points: Array,
    fence: Array,
    settings: Array,
    kinds: Array,
    state: Array,
    craft: Fleet,
    trace: Array,
    result: Array,
) -> None:
    """One step of all vehicles, as they are commanded, and what it does to the result; arguments as of `fly`.

    Args:
        last: this is the flight's last step.
        state: shape (A, STATE_ENTRIES); each path's delay is read.
        craft: moved.
    """
    step, lag, most = world[W_STEP], world[W_LAG], world[W_ACCELERATION]
    now = world[W_START] + tick * step
    keep = math.exp(-step / world[W_SIGMA_MEMORY])
    fresh = math.sqrt(1.0 - keep * keep) * world[W_SIGMA]
    gust_keep = math.exp(-step / world[W_GUST_MEMORY])
    gust_fresh = math.sqrt(1.0 - gust_keep * gust_keep) * world[W_GUST]
    own_fresh = math.sqrt(1.0 - keep * keep) * world[W_OWN_VELOCITY]
    position, before, velocity, command = craft.position, craft.before, craft.velocity, craft.command
    error, own_error, gust = craft.error, craft.own_error, craft.gust
    conflict_at, recovery, away_since = craft.conflict_at, craft.recovery, craft.away_since
    least2, way = craft.least2, craft.way
    fleet = len(kinds)
    for i in range(fleet):
        an, ae, ad = (
            (command[i, 0] - velocity[i, 0]) / lag,
            (command[i, 1] - velocity[i, 1]) / lag,
            (command[i, 2] - velocity[i, 2]) / lag,
        )
        size = math.sqrt(an * an + ae * ae + ad * ad)
        if size > most:
            an, ae, ad = an * most / size, ae * most / size, ad * most / size
        if world[W_GUST] > 0.0:
            for c in range(3):
                gust[i, c] = gust_keep * gust[i, c] + gust_fresh * rng.normal(0.0, 1.0)
        for c, answer in enumerate((an, ae, ad)):
            a = answer + gust[i, c]
            before[i, c] = position[i, c]
            position[i, c] += (velocity[i, c] + 0.5 * step * a) * step
            velocity[i, c] += step * a
            error[i, c] = keep * error[i, c] + fresh * rng.normal(0.0, 1.0)
            if own_fresh > 0.0:
                own_error[i, c] = keep * own_error[i, c] + own_fresh * rng.normal(0.0, 1.0)
        if tick < len(trace):
            trace[tick, i] = position[i]
        late = state[i, k.L_DELAY]
        n, e, d = k.path_position(path_times[i], path_points[i], now + step - late)
        pn, pe, pd = k.path_position(path_times[i], path_points[i], now - late)
        way[1] += math.sqrt((n - pn) ** 2 + (e - pe) ** 2 + (d - pd) ** 2)
        way[0] += math.sqrt(
            (position[i, 0] - before[i, 0]) ** 2
            + (position[i, 1] - before[i, 1]) ** 2
            + (position[i, 2] - before[i, 2]) ** 2
        )
        if kinds[i] != AVOIDS:
            continue
        gap = math.sqrt((n - position[i, 0]) ** 2 + (e - position[i, 1]) ** 2 + (d - position[i, 2]) ** 2)
        result[F_DEVIATION] = max(result[F_DEVIATION], gap)
        away_since[i] = min(away_since[i], now) if gap > AWAY_M else math.inf
        result[F_AWAY] = max(result[F_AWAY], now - away_since[i])
        result[F_FENCE] = max(result[F_FENCE], _beyond(fence, position[i, 0], position[i, 1]))
        for j in range(fleet):
            if kinds[j] == CREWED or kinds[j] == BAROMETRIC:
                level = settings[i, k.S_CREWED] / math.sqrt(2.0)
                aside = math.hypot(position[i, 0] - position[j, 0], position[i, 1] - position[j, 1]) / level
                above = abs(position[i, 2] - position[j, 2]) * settings[i, k.S_CREWED_VERTICAL] / level
                result[F_CREWED] = min(result[F_CREWED], max(aside, above))
        if recovery[i] == math.inf and gap <= settings[i, k.S_REGAINED]:
            recovery[i] = now - conflict_at[i]
        if last:
            result[F_BACK] = max(result[F_BACK], gap)
            result[F_LOST] = max(result[F_LOST], state[i, k.L_DELAY])
            result[F_RECOVERY] = max(result[F_RECOVERY], recovery[i])
    for i in range(fleet):
        for j in range(i):
            near2 = _least_distance2(position, before, i, j)
            if near2 < least2[i, j]:
                least2[i, j] = near2
                if near2 < result[F_SEPARATION]:
                    result[F_SEPARATION], result[F_TIME] = near2, now
                    result[F_FIRST], result[F_SECOND] = j, i


@_compiled
def land(craft: Fleet, pairs: Array, result: Array) -> None:
    """What the steps have gathered, into `pairs` and `result` of `fly`."""
    pairs[:, :, P_SEPARATION] = np.sqrt(craft.least2)
    result[F_SEPARATION] = math.sqrt(result[F_SEPARATION])
    result[F_PATH_RATIO] = craft.way[0] / craft.way[1] if craft.way[1] > 0.0 else 1.0


@_compiled
def fly(
    rng: np.random.Generator,
    world: Array,
    path_times: Array,
    path_points: Array,
    fence: Array,
    settings: Array,
    kinds: Array,
    trace: Array,
    decided: Array,
    seen: Array,
    pairs: Array,
    result: Array,
) -> None:
    """Fly a fleet along its paths.

    Args:
        rng: every draw of the flight.
        world: WORLD_ENTRIES values.
        path_times, path_points: shapes (A, K) and (A, K, 3): each aircraft's timed path, NED.
        fence: as of `kernels.decide`, the same for all.
        settings: shape (A, SETTINGS_ENTRIES): each aircraft's law.
        kinds: shape (A,): AVOIDS, or what else an aircraft is.
        trace: shape (steps, A, 3): true positions; written as far as it goes, empty where nobody looks.
        decided: shape (decisions, A, DECIDED_COLUMNS); written and empty likewise: own state and answer of
            each decision, with the velocity that is flown for its command.
        seen: shape (decisions, A, A, SEEN_COLUMNS), as long as `decided`: what each decision saw of each
            other aircraft; the rows of those that it had not heard are left alone.
        pairs: shape (A, A, PAIR_ENTRIES), of each aircraft and one before it; written.
        result: FLIGHT_ENTRIES values; written.
    """
    fleet = path_times.shape[0]
    craft = on_the_ground(fleet, world)
    step = world[W_STEP]
    steps = round((world[W_END] - world[W_START]) / step)
    every, message_every, slots = int(world[W_PERIOD]), int(world[W_MESSAGE]), craft.sent.shape[1]
    mind_every = round(_TURN_S / step)
    position, velocity, command = craft.position, craft.velocity, craft.command
    error, own_error, clock, phase = craft.error, craft.own_error, craft.clock, craft.phase
    sent, arrival = craft.sent, craft.arrival
    turn, climb = np.zeros(fleet), np.zeros(fleet)
    heard = np.zeros((fleet, fleet, MESSAGE_COLUMNS))
    heard[:, :, M_TIME] = -math.inf
    state = np.zeros((fleet, k.STATE_ENTRIES))
    times, velocities = np.zeros((fleet, k.HISTORY_SAMPLES)), np.zeros((fleet, k.HISTORY_SAMPLES, 3))
    own, neighbours = np.zeros(k.OWN_ENTRIES), np.zeros((fleet, k.NEIGHBOUR_COLUMNS))
    got = np.zeros((fleet, fleet))  # when that was
    tracks = np.zeros((fleet, fleet, k.TRACK_ENTRIES))
    tracks[:, :, k.T_TIME] = -math.inf
    walls = k.DOWN_SPEEDS + len(fence)
    planes, scratch = np.zeros((walls + 2 * fleet, 4)), np.zeros((walls + 2 * fleet, 4))
    view, out = np.zeros((fleet, k.VIEW_COLUMNS)), np.zeros(k.OUT_ENTRIES)
    senders = np.zeros(fleet, np.int64)
    conflict_at, recovery, in_conflict = craft.conflict_at, craft.recovery, np.zeros(fleet)
    manoeuvres = infeasible = decisions = 0.0
    result[:] = 0.0
    result[F_SEPARATION] = result[F_CREWED] = math.inf
    dark, dark_from = -1, math.inf
    if world[W_BLACKOUT] > 0.0:
        dark = int(rng.integers(0, fleet))
        middle = 0.5 * (world[W_START] + world[W_END])
        dark_from = middle + rng.uniform(-_BLACKOUT_BEFORE_S, _BLACKOUT_AFTER_S)
        if kinds[dark] != AVOIDS:
            dark = -1
    pairs[:, :, P_ALERT] = 0.0

    begin(rng, world, path_times, path_points, kinds, craft)
    for i in range(fleet):
        k.begin(state[i], settings[i])

    for tick in range(steps):
        now = world[W_START] + tick * step
        blacked = now >= dark_from and now < dark_from + world[W_BLACKOUT]
        unfit = now >= dark_from and now < dark_from + world[W_BLACKOUT] + _FIT_AGAIN_S
        for i in range(fleet):
            if i == dark and blacked:
                continue
            if (tick + phase[i]) % message_every == 0:
                heard[i, i] = sent[i, send(rng, world, tick, i, kinds, craft)]
        if tick % every == 0:
            for i in range(fleet):
                if i == dark and unfit:
                    command[i] = 0.0
                    continue
                count = 0
                for j in range(fleet):
                    if j == i:
                        continue
                    for slot in range(slots):
                        if arrival[i, j, slot] <= now:
                            arrival[i, j, slot] = math.inf
                            if sent[j, slot, M_TIME] > heard[i, j, M_TIME]:
                                heard[i, j], got[i, j] = sent[j, slot], now
                                m = heard[i, j]
                                k.note_track(
                                    tracks[i, j], m[0], m[1], m[2], m[3], m[4], m[5], m[6], world[W_DECLARED]
                                )
                    age = max(now + clock[i] - heard[i, j, M_TIME], 0.0)
                    if age <= OLDEST_S:
                        row = neighbours[count]
                        for c in range(6):
                            row[c] = heard[i, j, M_POSITION + c]
                        row[k.N_AGE], row[k.N_SIGMA], row[k.N_VERTICAL] = age, world[W_DECLARED], 1.0
                        row[k.N_SIGMA_VELOCITY], row[k.N_SHARE] = world[W_SIGMA_VELOCITY], 0.5
                        row[k.N_GROWTH], row[k.N_CREWED] = tracks[i, j, k.T_GROWTH], 0.0
                        row[k.N_SILENT] = 0.0
                        if now - got[i, j] > k.silent_after(tracks[i, j]):
                            row[k.N_SILENT] = 1.0
                        if kinds[j] == CREWED or kinds[j] == BAROMETRIC:
                            row[k.N_VERTICAL] = 1.0 if kinds[j] == CREWED else 0.0
                            row[k.N_SIGMA], row[k.N_SIGMA_VELOCITY] = adsb.SIGMA_M, adsb.SIGMA_MPS
                            row[k.N_GROWTH], row[k.N_SHARE], row[k.N_CREWED] = 0.0, CREWED_SHARE, 1.0
                            row[k.N_SILENT] = 0.0
                        senders[count] = j
                        count += 1
                for c in range(3):
                    own[k.O_POSITION + c] = position[i, c] + error[i, c]
                    own[k.O_VELOCITY + c] = velocity[i, c] + own_error[i, c]
                own[k.O_SIGMA], own[k.O_NOW], own[k.O_PATH_TIME] = world[W_DECLARED], now, now
                own[k.O_FLOOR], own[k.O_CEILING] = world[W_FLOOR], world[W_CEILING]
                k.decide(
                    neighbours, count, own, path_times[i], path_points[i], fence, settings[i], state[i],
                    times[i], velocities[i], planes, scratch, view, out,
                )  # fmt: skip
                command[i, 0], command[i, 1], command[i, 2] = out[0], out[1], out[2]
                if kinds[i] == TURNING or kinds[i] == FROZEN:
                    if tick % mind_every == 0:
                        turn[i] = rng.uniform(-_TURN_RAD, _TURN_RAD)
                        climb[i] = rng.uniform(-settings[i, k.S_DESCENT], settings[i, k.S_CLIMB])
                    cosine, sine = math.cos(turn[i]), math.sin(turn[i])
                    command[i, 0] = cosine * out[0] - sine * out[1]
                    command[i, 1] = sine * out[0] + cosine * out[1]
                    command[i, 2] = 0.5 * out[2] - climb[i]
                if tick // every < len(decided):
                    _write_down(
                        decided[tick // every], seen[tick // every], i, own, command[i], out,
                        senders, count, heard[i], neighbours, view,
                    )  # fmt: skip
                if kinds[i] != AVOIDS:
                    continue
                decisions += 1.0
                infeasible += 1.0 - out[k.R_FEASIBLE]
                if out[k.R_CONFLICT] > in_conflict[i]:
                    manoeuvres += 1.0
                in_conflict[i] = out[k.R_CONFLICT]
                if in_conflict[i] != 0.0:
                    conflict_at[i], recovery[i] = now, math.inf
                    for n in range(count):
                        if view[n, k.V_CONFLICT] != 0.0:
                            pairs[max(i, senders[n]), min(i, senders[n]), P_ALERT] = 1.0

        move(
            rng, world, tick, tick == steps - 1, path_times, path_points, fence, settings, kinds, state,
            craft, trace, result,
        )  # fmt: skip

    land(craft, pairs, result)
    result[F_MANOEUVRES] = manoeuvres
    result[F_INFEASIBLE] = infeasible / max(decisions, 1.0)
