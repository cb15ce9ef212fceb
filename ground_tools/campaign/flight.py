"""One flight of a fleet, entirely in compiled code: `vehicles` in a `world`, with the companion's own law.

The decision function is `companion.avoidance.kernels.decide`, the same that the companion uses in flight. The
laws of `peers` fly in the same loop with decision functions of their own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from companion.arrays import Floats, Integers
from companion.avoidance import kernels as k
from companion.traffic import adsb
from companion.traffic.right_of_way import CREWED as CREWED_RANK
from companion.traffic.right_of_way import FREE, share_of
from ground_tools.campaign.compiled import compiled
from ground_tools.campaign.outcome import (
    P_ALERT,
    Log,
    Tally,
    count_decision,
    land,
    measure,
    nothing_yet,
    write_down,
)
from ground_tools.campaign.powers import (
    S_BESIDE,
    S_EAST,
    S_NORTH,
    Powers,
    measure_powers,
    unmeasured,
)
from ground_tools.campaign.vehicles import (
    AVOIDS,
    BAROMETRIC,
    CREWED,
    FROZEN,
    M_POSITION,
    M_TIME,
    M_VELOCITY,
    MESSAGE_COLUMNS,
    TURNING,
    Fleet,
    begin,
    blackout,
    move,
    on_the_ground,
    send,
)
from ground_tools.campaign.world import Conditions

CREWED_SHARE = share_of(FREE, CREWED_RANK)
_TURN_S = 4.0
"""Time between two random changes of course of a turning aircraft."""
_TURN_RAD = math.radians(60.0)
"""Largest angle by which a turning aircraft turns away from its course to the path."""
_FIT_AGAIN_S = 4.0
"""Time from the return of GNSS to the next command: the companion waits for a steady state and then takes
control of the vehicle again."""


class Mind(NamedTuple):
    """Memory of the companions of A aircraft, and working tables for one decision."""

    heard: Floats
    """(receiver, sender, MESSAGE_COLUMNS): the latest message."""
    got: Floats
    """(receiver, sender): when the latest message was received; -inf after one without a position."""
    turn_rps: Floats
    """(receiver, sender): turn rate as received."""
    pasts: Floats
    """(receiver, sender, columns of `kernels.Past`)."""
    command: Floats
    """(A, 3): last command of the law; this and the following are the fields of `kernels.State`."""
    decided_s: Floats
    """(A,)."""
    quiet: Floats
    """(A,)."""
    late_s: Floats
    """(A,)."""
    samples: Integers
    """(A,)."""
    times_s: Floats
    """(A, HISTORY_SAMPLES)."""
    velocities: Floats
    """(A, HISTORY_SAMPLES, 3)."""
    neighbours: Floats
    """(2 A, columns of `kernels.Other`)."""
    senders: Integers
    """(2 A,): index of the aircraft in each row of `neighbours`."""
    turn: Floats
    """(A,): present turn of a turning aircraft away from its course, rad."""
    climb: Floats
    """(A,): present climb of a turning aircraft, m/s."""
    notes: Floats
    """(A, A + OWN_NOTES): memory of a law of `peers`: one entry about each aircraft, then entries about
    itself."""


Decide = Callable[..., k.Decision]
"""A compiled decision function. Its arguments are `mind`, the index of the aircraft, the number of rows in
`mind.neighbours`, the aircraft's `k.Own`, `k.Path` and fence, the table of settings of all aircraft, the
aircraft's `k.Settings`, and the workspace."""
Loop = Callable[..., None]
"""A compiled function with the arguments of `loop_of` except the first one, which is its law."""
OWN_NOTES = 6


def _new_mind(fleet: int, settings: Floats) -> Mind:
    pasts = np.tile(np.array(k.NO_PAST), (fleet, fleet, 1))
    heard = np.zeros((fleet, fleet, MESSAGE_COLUMNS))
    heard[:, :, M_TIME] = -math.inf
    fields = len(k.Settings._fields)
    first = [k.first_state(k.Settings(*row), 0) for row in settings[:, :fields].tolist()]
    return Mind(
        heard=heard,
        got=np.zeros((fleet, fleet)),
        turn_rps=np.zeros((fleet, fleet)),
        pasts=pasts,
        command=np.array([state.command for state in first]),
        decided_s=np.array([state.time_s for state in first]),
        quiet=np.array([state.quiet for state in first]),
        late_s=np.array([state.delay_s for state in first]),
        samples=np.zeros(fleet, np.int64),
        times_s=np.zeros((fleet, k.HISTORY_SAMPLES)),
        velocities=np.zeros((fleet, k.HISTORY_SAMPLES, 3)),
        neighbours=np.zeros((2 * fleet, k.OTHER_COLUMNS)),
        senders=np.zeros(2 * fleet, np.int64),
        turn=np.zeros(fleet),
        climb=np.zeros(fleet),
        notes=np.zeros((fleet, fleet + OWN_NOTES)),
    )


_compiled = compiled()
_inlined = compiled(forceinline=True)
"""Decorator for functions that every step calls with a whole fleet. LLVM inlines them. With numba's own
`inline="always"`, the loop of each law would take twice as long to compile."""


def fly(
    rng: np.random.Generator,
    world: Conditions,
    path_times: Floats,
    path_points: Floats,
    fence: Floats,
    settings: Floats,
    kinds: Floats,
    trace: Floats,
    log: Log,
    pairs: Floats,
    result: Floats,
    powers: Powers | None = None,
    power_rng: np.random.Generator | None = None,
    loop: Loop | None = None,
) -> None:
    """Fly a fleet along its paths.

    Args:
        rng: source of all random draws of the flight.
        world: from `World.conditions`.
        path_times, path_points: shapes (A, K) and (A, K, 3): each aircraft's timed path, NED.
        fence: as in `kernels.decide`, the same for all aircraft.
        settings: shape (A, at least the fields of `kernels.Settings`): settings of each aircraft's law.
            A law of `peers` has its parameters in the columns after those fields.
        kinds: shape (A,): AVOIDS, or another kind of aircraft.
        trace: shape (steps, A, 3): true positions. Written for as many steps as it has; may be empty.
        log: written for as many decisions as it has.
        pairs: shape (A, A, PAIR_ENTRIES), of each aircraft and each one with a lower index; written.
        result: FLIGHT_ENTRIES values; written.
        powers: from `powers.unmeasured`; written. None: no powers are measured.
        power_rng: source of the shadowing of messages, so that all other draws are the same without it.
        loop: the loop of the law that is flown; None: that of the companion's own law.
    """
    fleet = len(kinds)
    if powers is None or power_rng is None:
        power_rng, world = np.random.default_rng(0), world._replace(signal=0.0)
        powers = unmeasured(power_rng, world, fleet)
    craft, tally = on_the_ground(fleet, world), nothing_yet(fleet, pairs, result)
    mind, work = _new_mind(fleet, settings), k.workspace(len(fence), 2 * fleet)
    dark, dark_from = blackout(rng, world, kinds)
    begin(rng, world, path_times, path_points, kinds, craft)
    (loop or _fly)(
        rng, world, path_times, path_points, fence, settings, kinds, trace, log, pairs, result, craft, tally,
        mind, work, dark, float(dark_from), powers, power_rng,
    )  # fmt: skip
    land(kinds, mind.late_s, tally, pairs, result)


@compiled(cache=False, inline="always")  # numba cannot cache it: it takes a function
def loop_of(
    decide: Decide,
    rng: np.random.Generator,
    world: Conditions,
    path_times: Floats,
    path_points: Floats,
    fence: Floats,
    settings: Floats,
    kinds: Floats,
    trace: Floats,
    log: Log,
    pairs: Floats,
    result: Floats,
    craft: Fleet,
    tally: Tally,
    mind: Mind,
    work: k.Workspace,
    dark: int,
    dark_from: float,
    powers: Powers,
    power_rng: np.random.Generator,
) -> None:
    """The loop of `fly`, in which every aircraft flies the law `decide`."""
    step = world.step_s
    every, message_every = int(world.period), int(world.message)
    steps = round((world.end_s - world.start_s) / step)
    for tick in range(steps):
        now = world.start_s + tick * step
        blacked = now >= dark_from and now < dark_from + world.blackout_s
        unfit = now >= dark_from and now < dark_from + world.blackout_s + _FIT_AGAIN_S
        for i in range(len(kinds)):
            unlocated = i == dark and blacked
            if (tick + craft.phase[i]) % message_every == 0 and not (unlocated and world.mute != 0.0):
                slot = send(rng, world, tick, i, kinds, craft)
                if unlocated:
                    craft.sent[i, slot, M_POSITION] = math.nan
                    continue
                for c in range(MESSAGE_COLUMNS):
                    mind.heard[i, i, c] = craft.sent[i, slot, c]
        if world.signal != 0.0:
            measure_powers(power_rng, world, tick, kinds, craft, mind.heard, powers)
        if tick % every == 0:
            for i in range(len(kinds)):
                if i == dark and unfit:
                    craft.command[i, 0] = craft.command[i, 1] = craft.command[i, 2] = 0.0
                    continue
                _receive(now, world.declared_m, i, craft, mind)
                count = _look(world, now, i, kinds, craft, mind, powers)
                own, law = _own(world, now, i, craft), k.settings_at(settings, i)
                path = k.Path(path_times[i], path_points[i])
                decision = decide(mind, i, count, own, path, fence, settings, law, work)
                _remember(mind, i, decision.state)
                _command(rng, round(_TURN_S / step), tick, i, kinds, law, decision.chosen, craft, mind)
                if tick // every < len(log.time_s):
                    write_down(
                        log, tick // every, i, own, decision, count, craft, mind.heard, mind.neighbours,
                        mind.senders, work.seen,
                    )  # fmt: skip
                if kinds[i] == AVOIDS:
                    count_decision(tally, now, i, decision.feasible, decision.conflict)
                    if decision.conflict:
                        for n in range(count):
                            if k.seen_at(work.seen, n).conflict != 0.0:
                                j = mind.senders[n]
                                pairs[max(i, j), min(i, j), P_ALERT] = 1.0
        move(rng, world, craft)
        measure(
            world, tick, path_times, path_points, mind.late_s, fence, settings, kinds, craft, tally, result
        )
        if tick < len(trace):
            for i in range(len(kinds)):
                for c in range(3):
                    trace[tick, i, c] = craft.position[i, c]


@_compiled
def flying_law(
    mind: Mind,
    i: int,
    count: int,
    own: k.Own,
    path: k.Path,
    fence: Floats,
    settings: Floats,
    law: k.Settings,
    work: k.Workspace,
) -> k.Decision:
    """The decision function of the companion's own law; see `Decide`."""
    history = k.History(mind.times_s[i], mind.velocities[i])
    return k.decide(mind.neighbours, count, own, path, fence, law, state_of(mind, i), history, work)


@_compiled
def _fly(
    rng: np.random.Generator,
    world: Conditions,
    path_times: Floats,
    path_points: Floats,
    fence: Floats,
    settings: Floats,
    kinds: Floats,
    trace: Floats,
    log: Log,
    pairs: Floats,
    result: Floats,
    craft: Fleet,
    tally: Tally,
    mind: Mind,
    work: k.Workspace,
    dark: int,
    dark_from: float,
    powers: Powers,
    power_rng: np.random.Generator,
) -> None:
    """The loop of the companion's own law."""
    loop_of(
        flying_law, rng, world, path_times, path_points, fence, settings, kinds, trace, log, pairs, result,
        craft, tally, mind, work, dark, dark_from, powers, power_rng,
    )  # fmt: skip


@_inlined
def _own(world: Conditions, now: float, i: int, craft: Fleet) -> k.Own:
    """The state of aircraft i as it knows it."""
    p, e, v, f = craft.position, craft.error, craft.velocity, craft.own_error
    return k.Own(
        k.Vector(p[i, 0] + e[i, 0], p[i, 1] + e[i, 1], p[i, 2] + e[i, 2]),
        k.Vector(v[i, 0] + f[i, 0], v[i, 1] + f[i, 1], v[i, 2] + f[i, 2]),
        world.declared_m, now, now, world.floor_down_m, world.ceiling_down_m,
    )  # fmt: skip


@_inlined
def state_of(mind: Mind, i: int) -> k.State:
    """The state of aircraft i's law."""
    command = k.Vector(mind.command[i, 0], mind.command[i, 1], mind.command[i, 2])
    return k.State(command, mind.decided_s[i], mind.quiet[i], mind.late_s[i], mind.samples[i])


@_inlined
def _remember(mind: Mind, i: int, state: k.State) -> None:
    mind.command[i, 0], mind.command[i, 1], mind.command[i, 2] = state.command
    mind.decided_s[i], mind.quiet[i] = state.time_s, state.quiet
    mind.late_s[i], mind.samples[i] = state.delay_s, state.samples


@_inlined
def _command(
    rng: np.random.Generator,
    mind_every: int,
    tick: int,
    i: int,
    kinds: Floats,
    law: k.Settings,
    chosen: k.Vector,
    craft: Fleet,
    mind: Mind,
) -> None:
    """Command the chosen velocity, or the random one of an aircraft that turns at random."""
    command, turn, climb = craft.command, mind.turn, mind.climb
    command[i, 0], command[i, 1], command[i, 2] = chosen
    if kinds[i] == TURNING or kinds[i] == FROZEN:
        if tick % mind_every == 0:
            turn[i] = rng.uniform(-_TURN_RAD, _TURN_RAD)
            climb[i] = rng.uniform(-law.descent_mps, law.climb_mps)
        cosine, sine = math.cos(turn[i]), math.sin(turn[i])
        command[i, 0] = cosine * chosen.n - sine * chosen.e
        command[i, 1] = sine * chosen.n + cosine * chosen.e
        command[i, 2] = 0.5 * chosen.d - climb[i]


@_inlined
def _receive(now: float, declared: float, i: int, craft: Fleet, mind: Mind) -> None:
    """Store the messages that aircraft i has received in its memory."""
    arrival, sent, heard = craft.arrival, craft.sent, mind.heard
    for j in range(arrival.shape[1]):
        for slot in range(arrival.shape[2]):
            if arrival[i, j, slot] <= now:
                arrival[i, j, slot] = math.inf
                if sent[j, slot, M_TIME] > heard[i, j, M_TIME]:
                    if math.isnan(sent[j, slot, M_POSITION]):
                        mind.got[i, j] = -math.inf
                        continue
                    was, now_ = heard[i, j], sent[j, slot]
                    mind.turn_rps[i, j] = k.turn_rate(
                        mind.turn_rps[i, j], (was[4], was[5], was[6]), (now_[4], now_[5], now_[6]),
                        now_[M_TIME] - was[M_TIME],
                    )  # fmt: skip
                    for c in range(MESSAGE_COLUMNS):
                        heard[i, j, c] = sent[j, slot, c]
                    mind.got[i, j] = now
                    m = heard[i, j]
                    p, v = m[M_POSITION:M_VELOCITY], m[M_VELOCITY:MESSAGE_COLUMNS]
                    past = k.note_track(
                        k.past_at(mind.pasts[i], j),
                        m[M_TIME],
                        (p[0], p[1], p[2]),
                        (v[0], v[1], v[2]),
                        declared,
                    )
                    k.put_past(mind.pasts[i], j, past)


@_inlined
def _look(
    world: Conditions, now: float, i: int, kinds: Floats, craft: Fleet, mind: Mind, powers: Powers
) -> int:
    """Write the aircraft that aircraft i knows to `neighbours` and `senders`. Returns the number of rows.

    As in `Traffic.neighbours`, an aircraft whose signal strength contradicts its position has a second row.
    """
    count = 0
    for j in range(len(kinds)):
        m = mind.heard[i, j]
        age = max(now + craft.clock[i] - m[M_TIME], 0.0)
        past = k.past_at(mind.pasts[i], j)
        if j == i or age > k.kept_for(past.gap_s, k.KEPT_S):
            continue
        p, v = m[M_POSITION:M_VELOCITY], m[M_VELOCITY:MESSAGE_COLUMNS]
        crewed = kinds[j] == CREWED or kinds[j] == BAROMETRIC
        silent = not crewed and now - mind.got[i, j] > k.silent_after(past.gap_s)
        known = k.Other(
            p[0], p[1], p[2], v[0], v[1], v[2], age,
            adsb.SIGMA_M if crewed else world.declared_m,
            adsb.SIGMA_MPS if crewed else world.sigma_mps,
            0.0 if crewed else past.growth_mps,
            1.0 if silent else 0.0,
            CREWED_SHARE if crewed else 0.5,
            0.0 if kinds[j] == BAROMETRIC else 1.0,
            1.0 if crewed else 0.0,
            0.0 if crewed else past.growth_down_mps,
            mind.turn_rps[i, j] if crewed else 0.0,
            adsb.SIGMA_DOWN_M if crewed else 0.0,
            0.0,
            0.0,
        )  # fmt: skip
        k.put_other(mind.neighbours, count, known)
        mind.senders[count] = j
        count += 1
        if world.signal != 0.0 and powers.suspicion[i, j, S_BESIDE] > k.BESIDE:
            said = powers.suspicion[i, j]
            k.put_other(mind.neighbours, count, known)
            row = mind.neighbours[count]
            row[0], row[1] = known.n + said[S_NORTH], known.e + said[S_EAST]
            mind.senders[count] = j
            count += 1
    return count
