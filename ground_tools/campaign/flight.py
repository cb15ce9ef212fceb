"""One flight of a fleet, entirely in compiled code: `vehicles` in a `world`, with the companion's own law.

The decision function is `companion.avoidance.kernels.decide`, the same that the companion uses in flight.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.avoidance import kernels as k
from companion.avoidance.law import OLDEST_S
from companion.traffic import adsb
from companion.traffic.right_of_way import CREWED as CREWED_RANK
from companion.traffic.right_of_way import FREE, share_of
from ground_tools.campaign.compiled import compiled
from ground_tools.campaign.outcome import P_ALERT, count_decision, land, measure, nothing_yet
from ground_tools.campaign.vehicles import (
    AVOIDS,
    BAROMETRIC,
    CREWED,
    FROZEN,
    M_POSITION,
    M_TIME,
    MESSAGE_COLUMNS,
    TURNING,
    begin,
    move,
    on_the_ground,
    send,
)
from ground_tools.campaign.world import (
    W_BLACKOUT,
    W_CEILING,
    W_DECLARED,
    W_END,
    W_FLOOR,
    W_MESSAGE,
    W_PERIOD,
    W_SIGMA_VELOCITY,
    W_START,
    W_STEP,
)

Array = NDArray[np.float64]

CREWED_SHARE = share_of(FREE, CREWED_RANK)
_TURN_S = 4.0
"""Time between two random changes of course of a turning aircraft."""
_TURN_RAD = math.radians(60.0)
"""Largest angle by which a turning aircraft turns away from its course to the path."""
_BLACKOUT_BEFORE_S, _BLACKOUT_AFTER_S = 15.0, 5.0
"""A loss of GNSS begins between these times before and after the middle of the flight."""
_FIT_AGAIN_S = 4.0
"""Time from the return of GNSS to the next command: the companion waits for a steady state and then takes
control of the vehicle again."""
# Columns of what a decision saw of another aircraft: the time at which its message was sent (s), then its row
# of `neighbours` and its row of `view`. The aircraft's own place holds time, position and velocity of its own
# latest message.
SEEN_MESSAGE, SEEN_NEIGHBOUR = 0, 1
SEEN_VIEW = SEEN_NEIGHBOUR + k.NEIGHBOUR_COLUMNS
SEEN_COLUMNS = SEEN_VIEW + k.VIEW_COLUMNS
DECIDED_COLUMNS = k.OWN_ENTRIES + k.OUT_ENTRIES


_compiled = compiled()
_inlined = compiled(inline="always")


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
        rng: source of all random draws of the flight.
        world: WORLD_ENTRIES values.
        path_times, path_points: shapes (A, K) and (A, K, 3): each aircraft's timed path, NED.
        fence: as in `kernels.decide`, the same for all aircraft.
        settings: shape (A, SETTINGS_ENTRIES): settings of each aircraft's law.
        kinds: shape (A,): AVOIDS, or another kind of aircraft.
        trace: shape (steps, A, 3): true positions. Written for as many steps as it has; may be empty.
        decided: shape (decisions, A, DECIDED_COLUMNS): own state and result of each decision, with the
            velocity flown in place of its command. Written for as many decisions as it has; may be empty.
        seen: shape (decisions, A, A, SEEN_COLUMNS), as long as `decided`: what each decision saw of each
            other aircraft. Rows of aircraft from which no message was received are not written.
        pairs: shape (A, A, PAIR_ENTRIES), of each aircraft and each one with a lower index; written.
        result: FLIGHT_ENTRIES values; written.
    """
    fleet, step = len(kinds), world[W_STEP]
    craft, tally = on_the_ground(fleet, world), nothing_yet(fleet, pairs, result)
    every, message_every, mind_every = int(world[W_PERIOD]), int(world[W_MESSAGE]), round(_TURN_S / step)
    position, velocity, command, error = craft.position, craft.velocity, craft.command, craft.error
    own_error, clock, phase, sent, arrival = (
        craft.own_error, craft.clock, craft.phase, craft.sent, craft.arrival,
    )  # fmt: skip
    # By receiver and sender: the latest message, when it was received, and the state of the sender's track.
    heard, got = np.zeros((fleet, fleet, MESSAGE_COLUMNS)), np.zeros((fleet, fleet))
    tracks = np.zeros((fleet, fleet, k.TRACK_ENTRIES))
    heard[:, :, M_TIME] = -math.inf
    tracks[:, :, k.T_TIME] = -math.inf
    # The state that each law keeps, and the inputs and outputs of one decision.
    state, late = _first_state(settings)
    times, velocities = np.zeros((fleet, k.HISTORY_SAMPLES)), np.zeros((fleet, k.HISTORY_SAMPLES, 3))
    own, neighbours = np.zeros(k.OWN_ENTRIES), np.zeros((fleet, k.NEIGHBOUR_COLUMNS))
    senders = np.zeros(fleet, np.int64)
    rows = k.plane_rows(len(fence), fleet)
    planes, scratch = np.zeros((rows, 4)), np.zeros((rows, 4))
    view, out = np.zeros((fleet, k.VIEW_COLUMNS)), np.zeros(k.OUT_ENTRIES)
    turn, climb = np.zeros(fleet), np.zeros(fleet)
    steps = round((world[W_END] - world[W_START]) / step)
    dark, dark_from = _blackout(rng, world, kinds)
    begin(rng, world, path_times, path_points, kinds, craft)

    for tick in range(steps):
        now = world[W_START] + tick * step
        blacked = now >= dark_from and now < dark_from + world[W_BLACKOUT]
        unfit = now >= dark_from and now < dark_from + world[W_BLACKOUT] + _FIT_AGAIN_S
        for i in range(fleet):
            if (tick + phase[i]) % message_every == 0 and not (i == dark and blacked):
                heard[i, i] = sent[i, send(rng, world, tick, i, kinds, craft)]
        if tick % every == 0:
            for i in range(fleet):
                if i == dark and unfit:
                    command[i] = 0.0
                    continue
                _receive(now, world[W_DECLARED], arrival[i], sent, heard[i], got[i], tracks[i])
                count = _look(
                    world, now, clock[i], i, kinds, heard[i], got[i], tracks[i], neighbours, senders
                )
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
                if kinds[i] == AVOIDS:
                    count_decision(tally, now, i, out[k.R_FEASIBLE], out[k.R_CONFLICT])
                    if out[k.R_CONFLICT] != 0.0:
                        for n in range(count):
                            if view[n, k.V_CONFLICT] != 0.0:
                                pairs[max(i, senders[n]), min(i, senders[n]), P_ALERT] = 1.0
        move(rng, world, craft)
        measure(world, tick, path_times, path_points, late, fence, settings, kinds, craft, tally, result)
        if tick < len(trace):
            trace[tick] = position

    land(kinds, late, tally, pairs, result)


@_compiled
def _first_state(settings: Array) -> tuple[Array, Array]:
    """Initial state of each law, shape (A, STATE_ENTRIES), and the view of its path delays, shape (A,)."""
    state = np.zeros((len(settings), k.STATE_ENTRIES))
    for i in range(len(settings)):
        k.begin(state[i], settings[i])
    return state, state[:, k.L_DELAY]


@_compiled
def _blackout(rng: np.random.Generator, world: Array, kinds: Array) -> tuple[int, float]:
    """Index of the aircraft that loses GNSS (-1: none), and the time at which it does."""
    dark, dark_from = -1, math.inf
    if world[W_BLACKOUT] > 0.0:
        dark = int(rng.integers(0, len(kinds)))
        middle = 0.5 * (world[W_START] + world[W_END])
        dark_from = middle + rng.uniform(-_BLACKOUT_BEFORE_S, _BLACKOUT_AFTER_S)
        if kinds[dark] != AVOIDS:
            dark = -1
    return dark, dark_from


@_inlined
def _receive(
    now: float, declared: float, arrival: Array, sent: Array, heard: Array, got: Array, tracks: Array
) -> None:
    """Write the messages that one aircraft has received to its rows of `heard`, `got` and `tracks`."""
    for j in range(len(got)):
        for slot in range(sent.shape[1]):
            if arrival[j, slot] <= now:
                arrival[j, slot] = math.inf
                if sent[j, slot, M_TIME] > heard[j, M_TIME]:
                    heard[j], got[j] = sent[j, slot], now
                    m = heard[j]
                    k.note_track(tracks[j], m[0], m[1], m[2], m[3], m[4], m[5], m[6], declared)


@_inlined
def _look(
    world: Array,
    now: float,
    clock: float,
    i: int,
    kinds: Array,
    heard: Array,
    got: Array,
    tracks: Array,
    neighbours: Array,
    senders: NDArray[np.int64],
) -> int:
    """Write the aircraft that aircraft i knows to `neighbours` and `senders`. Returns their number.

    `heard`, `got` and `tracks` are the rows of aircraft i.
    """
    count = 0
    for j in range(len(kinds)):
        age = max(now + clock - heard[j, M_TIME], 0.0)
        if j == i or age > OLDEST_S:
            continue
        row = neighbours[count]
        for c in range(6):
            row[c] = heard[j, M_POSITION + c]
        row[k.N_AGE], row[k.N_SIGMA], row[k.N_VERTICAL] = age, world[W_DECLARED], 1.0
        row[k.N_SIGMA_VELOCITY], row[k.N_SHARE] = world[W_SIGMA_VELOCITY], 0.5
        row[k.N_GROWTH], row[k.N_CREWED] = tracks[j, k.T_GROWTH], 0.0
        row[k.N_SILENT] = 0.0
        if now - got[j] > k.silent_after(tracks[j]):
            row[k.N_SILENT] = 1.0
        if kinds[j] == CREWED or kinds[j] == BAROMETRIC:
            row[k.N_VERTICAL] = 1.0 if kinds[j] == CREWED else 0.0
            row[k.N_SIGMA], row[k.N_SIGMA_VELOCITY] = adsb.SIGMA_M, adsb.SIGMA_MPS
            row[k.N_GROWTH], row[k.N_SHARE], row[k.N_CREWED] = 0.0, CREWED_SHARE, 1.0
            row[k.N_SILENT] = 0.0
        senders[count] = j
        count += 1
    return count


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
    """Record one decision of aircraft i, as it was flown, in the rows of `decided` and `seen` of `fly`."""
    decided[i, : k.OWN_ENTRIES] = own
    decided[i, k.OWN_ENTRIES :] = out
    decided[i, k.OWN_ENTRIES : k.OWN_ENTRIES + 3] = command
    seen[i, i, :MESSAGE_COLUMNS] = heard[i]
    for n in range(count):
        j = senders[n]
        seen[i, j, SEEN_MESSAGE] = heard[j, M_TIME]
        seen[i, j, SEEN_NEIGHBOUR:SEEN_VIEW] = neighbours[n]
        seen[i, j, SEEN_VIEW:] = view[n]
