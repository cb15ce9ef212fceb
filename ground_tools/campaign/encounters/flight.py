"""Flies our own aircraft through one encounter, in compiled code, with the companion's own law.

The decision is `companion.avoidance.kernels.decide`, the same that the companion makes in flight; motion and
messages are those of the campaign (`vehicles`). The crewed aircraft follows its track exactly and never
reacts. It is received once a second, by ADS-B unless `Received.crewed` is 0.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.traffic import adsb
from ground_tools.campaign.compiled import compiled
from ground_tools.campaign.flight import CREWED_SHARE
from ground_tools.campaign.vehicles import (
    AVOIDS,
    CREWED,
    M_POSITION,
    M_TIME,
    M_VELOCITY,
    MESSAGE_COLUMNS,
    Fleet,
    begin,
    move,
    on_the_ground,
    send,
)
from ground_tools.campaign.world import Conditions

UNHEARD, GEOMETRIC, BAROMETRIC, PRESSURE = range(4)
"""How the crewed aircraft is received. UNHEARD: not at all. GEOMETRIC: with its geometric altitude.
BAROMETRIC: with its pressure altitude, and we do not know our own. PRESSURE: with its pressure altitude, and
we know our own."""


class Received(NamedTuple):
    """How the crewed aircraft is received."""

    kind: int
    range_m: float
    """Distance within which its messages are received."""
    height_error_m: float
    """For PRESSURE: error of the difference of both pressure altitudes; positive if the crewed aircraft seems
    too high."""
    crewed: float = 1.0
    """1: the law takes it for crewed. 0: for a small aircraft, as all traffic that only Remote ID or a sensor
    aboard tells of."""


# Entries of `result`.
(
    F_DEVIATION,  # largest distance of our own aircraft from its timed point, m
    F_ALERT,  # time of the first decision in conflict with the crewed aircraft, s; infinite: none
    F_BACK,  # distance from the timed point at the end, m
    ENTRIES,
) = range(4)
_OWN, _OTHER = 0, 1
_KINDS: Final = np.array([float(AVOIDS), float(CREWED)])


def fly(
    rng: np.random.Generator,
    world: Conditions,
    own: tuple[Floats, Floats],
    track: tuple[Floats, Floats],
    settings: k.Settings,
    received: Received,
    walls: Floats = k.NO_WALLS,
) -> tuple[Floats, Floats]:
    """Fly one encounter.

    Args:
        rng: source of all random draws of the flight.
        world: from `World.conditions`; begins at 0 s.
        own: times (2,) and points (2, 3) of our own straight path; NED, s and m.
        track: positions and velocities of the crewed aircraft, both (N + 1, 3), for each step of the world.
        settings: those of our own law.
        received: how the crewed aircraft is received.
        walls: walls that our own aircraft keeps, as `k.Wall`.

    Returns:
        Positions of our own aircraft, (N + 1, 3), and the ENTRIES of the result.
    """
    times, points = own
    trace, result = np.zeros_like(track[0]), np.zeros(ENTRIES)
    neighbours, heard = np.zeros((1, k.OTHER_COLUMNS)), np.zeros(MESSAGE_COLUMNS + 1)
    craft = on_the_ground(2, world)
    begin(rng, world, np.stack([times, times]), np.stack([points, points]), _KINDS, craft)
    history = k.History(np.zeros(k.HISTORY_SAMPLES), np.zeros((k.HISTORY_SAMPLES, 3)))
    _fly(
        rng, world, k.Path(times, points), track[0], track[1], settings, k.first_state(settings, 0), history,
        k.workspace(len(walls), 1), walls, craft, _KINDS, neighbours, heard, received, trace, result,
    )  # fmt: skip
    return trace, result


@compiled()
def _fly(
    rng: np.random.Generator,
    world: Conditions,
    path: k.Path,
    position: Floats,
    velocity: Floats,
    settings: k.Settings,
    state: k.State,
    history: k.History,
    work: k.Workspace,
    fence: Floats,
    craft: Fleet,
    kinds: Floats,
    neighbours: Floats,
    heard: Floats,
    received: Received,
    trace: Floats,
    result: Floats,
) -> None:
    """The loop of `fly`. `heard` is the latest message and the turn rate, `neighbours` the table of the
    law."""
    every, message_every = int(world.period), int(world.message)
    heard[M_TIME], result[F_ALERT] = -math.inf, math.inf
    _place(craft, position, velocity, 0)
    for tick in range(len(position) - 1):
        now = world.start_s + tick * world.step_s
        for c in range(3):
            trace[tick, c] = craft.position[_OWN, c]
        if (tick + craft.phase[_OTHER]) % message_every == 0:
            slot = send(rng, world, tick, _OTHER, kinds, craft)
            if received.kind == UNHEARD or _apart(craft) > received.range_m:
                craft.arrival[_OWN, _OTHER, slot] = math.inf
        _receive(now, craft, heard)
        if tick % every == 0:
            own = _own(world, now, craft)
            # Not literals: numba would compile the whole law once more for each literal value.
            count = int(np.int64(_look(now, world, received, own.position.d, heard, neighbours)))
            decision = k.decide(neighbours, count, own, path, fence, settings, state, history, work)
            state = decision.state
            for c, wanted in enumerate(decision.chosen):
                craft.command[_OWN, c] = wanted
            if decision.conflict:
                result[F_ALERT] = min(result[F_ALERT], now)
        move(rng, world, craft)
        _place(craft, position, velocity, tick + 1)
        point = k.point_at(path, now + world.step_s - state.delay_s)
        n, e, d = craft.position[_OWN, 0], craft.position[_OWN, 1], craft.position[_OWN, 2]
        result[F_BACK] = math.sqrt((point.n - n) ** 2 + (point.e - e) ** 2 + (point.d - d) ** 2)
        result[F_DEVIATION] = max(result[F_DEVIATION], result[F_BACK])
    for c in range(3):
        trace[len(position) - 1, c] = craft.position[_OWN, c]


@compiled(inline="always")
def _place(craft: Fleet, position: Floats, velocity: Floats, row: int) -> None:
    """Place the crewed aircraft on its track."""
    for c in range(3):
        craft.position[_OTHER, c], craft.velocity[_OTHER, c] = position[row, c], velocity[row, c]
        craft.command[_OTHER, c] = velocity[row, c]


@compiled(inline="always")
def _apart(craft: Fleet) -> float:
    p = craft.position
    n, e, d = p[0, 0] - p[1, 0], p[0, 1] - p[1, 1], p[0, 2] - p[1, 2]
    return math.sqrt(n * n + e * e + d * d)


@compiled(inline="always")
def _own(world: Conditions, now: float, craft: Fleet) -> k.Own:
    """The state of our own aircraft as it knows it."""
    p, e, v, f = craft.position, craft.error, craft.velocity, craft.own_error
    return k.Own(
        k.Vector(p[_OWN, 0] + e[_OWN, 0], p[_OWN, 1] + e[_OWN, 1], p[_OWN, 2] + e[_OWN, 2]),
        k.Vector(v[_OWN, 0] + f[_OWN, 0], v[_OWN, 1] + f[_OWN, 1], v[_OWN, 2] + f[_OWN, 2]),
        world.declared_m, now, now, world.floor_down_m, world.ceiling_down_m,
    )  # fmt: skip


@compiled(inline="always")
def _receive(now: float, craft: Fleet, heard: Floats) -> None:
    """Process the messages that have arrived; the latest one counts."""
    for slot in range(craft.arrival.shape[2]):
        if craft.arrival[_OWN, _OTHER, slot] <= now:
            craft.arrival[_OWN, _OTHER, slot] = math.inf
            sent = craft.sent[_OTHER, slot]
            if sent[M_TIME] > heard[M_TIME]:
                heard[-1] = k.turn_rate(
                    heard[-1], (heard[4], heard[5], heard[6]), (sent[4], sent[5], sent[6]),
                    sent[M_TIME] - heard[M_TIME],
                )  # fmt: skip
                for c in range(MESSAGE_COLUMNS):
                    heard[c] = sent[c]


@compiled(inline="always")
def _look(
    now: float, world: Conditions, received: Received, own_down_m: float, heard: Floats, neighbours: Floats
) -> int:
    """Write the crewed aircraft to the law's table, as `companion.traffic` passes it on. Returns the number
    of rows."""
    age = now - heard[M_TIME]
    if age > adsb.EXPIRE_S:
        return 0
    p, v = heard[M_POSITION:M_VELOCITY], heard[M_VELOCITY:MESSAGE_COLUMNS]
    sigma_down = adsb.SIGMA_DOWN_M if received.kind == GEOMETRIC else adsb.PRESSURE_SIGMA_M
    down = p[2] - received.height_error_m if received.kind == PRESSURE else p[2]
    known = received.kind != BAROMETRIC or abs(down - own_down_m) > adsb.BAROMETRIC_M
    if received.crewed:
        sigma, sigma_mps = adsb.SIGMA_M, adsb.SIGMA_MPS
    else:
        sigma, sigma_mps, sigma_down = world.declared_m, world.sigma_mps, 0.0
    k.put_other(
        neighbours, 0,
        k.Other(
            p[0], p[1], down, v[0], v[1], v[2], max(age, 0.0), sigma, sigma_mps, 0.0, 0.0,
            CREWED_SHARE, 1.0 if known else 0.0, received.crewed, 0.0, heard[-1], sigma_down, 0.0, 0.0,
        ),
    )  # fmt: skip
    return 1
