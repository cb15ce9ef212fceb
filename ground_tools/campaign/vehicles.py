"""The vehicles of a flight, in compiled code: their kinds, their motion and their messages.

A vehicle follows a velocity command with a first-order lag and a limited acceleration. Every aircraft sends
its state once a period, at its own phase. Each other aircraft receives the message after its own delay, or
not at all. Positions carry a time-correlated GNSS error, which is the same in the messages and in the
aircraft's own navigation. Sent velocities carry white noise. Messages are quantised as in Remote ID
(ASTM F3411-22a).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from companion.arrays import Floats, Integers
from companion.avoidance import kernels as k
from ground_tools.campaign.compiled import compiled
from ground_tools.campaign.world import Conditions

# Kinds of aircraft. AVOIDS flies the avoidance law; no other kind avoids. BLIND sends and flies its path;
# TURNING also turns and climbs at random; FROZEN turns likewise, but always sends its first velocity. SILENT
# is received only at short range. LIAR sends a wrong position. CREWED is crewed traffic that is received by
# ADS-B with a geometric altitude; BAROMETRIC is the same with a pressure altitude, which separates
# aircraft only if it differs by 300 m or more. TWIN flies its path and sends with the identity of the second
# aircraft, CLONE also from its radio address; OWN_TWIN and OWN_CLONE do so with those of the aircraft that
# receives the message. These last four are flown by `twins.fly`.
(
    AVOIDS, BLIND, TURNING, SILENT, LIAR, FROZEN, CREWED, BAROMETRIC, TWIN, CLONE, OWN_TWIN, OWN_CLONE,
) = range(12)  # fmt: skip
INTRUDERS = {
    "blind": BLIND, "turning": TURNING, "silent": SILENT, "liar": LIAR, "frozen": FROZEN, "crewed": CREWED,
    "barometric": BAROMETRIC,
}  # fmt: skip
TWINS = {"twin": TWIN, "clone": CLONE, "own-twin": OWN_TWIN, "own-clone": OWN_CLONE}
# Columns of a message: its time (s), position, velocity.
M_TIME, M_POSITION, M_VELOCITY, MESSAGE_COLUMNS = 0, 1, 4, 7
_BLACKOUT_BEFORE_S, _BLACKOUT_AFTER_S = 15.0, 5.0
"""A blackout begins at a random time from the first before to the second after the middle of the flight."""

_compiled = compiled()
_inlined = compiled(forceinline=True)
"""Decorator for functions that every step calls with a whole fleet."""


class Fleet(NamedTuple):
    """State of a fleet of A aircraft in flight. NED, m and s; the first axis is the aircraft unless stated
    otherwise."""

    position: Floats
    """(A, 3)."""
    before: Floats
    """(A, 3): position one step ago."""
    velocity: Floats
    """(A, 3)."""
    command: Floats
    """(A, 3)."""
    error: Floats
    """(A, 3): error of the GNSS position."""
    own_error: Floats
    """(A, 3): error of the own velocity."""
    gust: Floats
    """(A, 3), m/s^2."""
    clock: Floats
    """(A,): how far the aircraft's clock is ahead of the true time."""
    phase: Integers
    """(A,): offset of the message schedule: steps between a message and the flight's first step."""
    frozen: Floats
    """(A, 3): velocity at the start of the flight."""
    lie: Floats
    """(A, 2): north and east offset added to a sent position."""
    sent: Floats
    """(A, slots, MESSAGE_COLUMNS): the latest messages."""
    arrival: Floats
    """(receiver, sender, slots): arrival time of each message; infinite if it is lost or already received."""


def on_the_ground(fleet: int, world: Conditions) -> Fleet:
    """A fleet whose arrays are still zero and that has no message in transit."""
    slots = int(world.delay_high_s / (world.message * world.step_s)) + 2
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
    )


@compiled(_nrt=True)  # as random integers need it
def begin(
    rng: np.random.Generator,
    world: Conditions,
    path_times: Floats,
    path_points: Floats,
    kinds: Floats,
    craft: Fleet,
) -> None:
    """Place every aircraft on its path and draw its errors. The arguments are those of `flight.fly`."""
    step, message_every = world.step_s, int(world.message)
    position, velocity = craft.position, craft.velocity
    for i in range(len(kinds)):
        n, e, d = k.path_position(path_times[i], path_points[i], world.start_s)
        position[i, 0], position[i, 1], position[i, 2] = n, e, d
        bn, be, bd = k.path_position(path_times[i], path_points[i], world.start_s + step)
        velocity[i, 0], velocity[i, 1], velocity[i, 2] = (bn - n) / step, (be - e) / step, (bd - d) / step
        for c in range(3):
            craft.command[i, c] = velocity[i, c]
            craft.error[i, c] = rng.normal(0.0, world.sigma_m)
            craft.frozen[i, c] = velocity[i, c]
            craft.own_error[i, c] = rng.normal(0.0, world.own_sigma_mps)
        craft.phase[i] = rng.integers(0, message_every)
        craft.clock[i] = rng.uniform(-world.clock_s, world.clock_s)
        bearing = rng.uniform(0.0, 2.0 * math.pi)
        if kinds[i] == LIAR:
            craft.lie[i, 0] = world.lie_m * math.cos(bearing)
            craft.lie[i, 1] = world.lie_m * math.sin(bearing)


def blackout(rng: np.random.Generator, world: Conditions, kinds: Floats) -> tuple[int, float]:
    """Index of the aircraft that loses its position (-1: none), and the time (s) at which it does."""
    dark, dark_from = -1, math.inf
    if world.blackout_s > 0.0:
        dark = int(rng.integers(0, len(kinds)))
        middle = 0.5 * (world.start_s + world.end_s)
        dark_from = middle + rng.uniform(-_BLACKOUT_BEFORE_S, _BLACKOUT_AFTER_S)
        if kinds[dark] != AVOIDS:
            dark = -1
    return dark, dark_from


@_compiled
def _quantise(message: Floats) -> None:
    """Quantise a message in place: speed to 0.25 m/s, direction to whole degrees, vertical speed to 0.5 m/s,
    horizontal position to 1e-7 degrees, height to 0.5 m."""
    position, velocity = message[M_POSITION:M_VELOCITY], message[M_VELOCITY:MESSAGE_COLUMNS]
    speed = round(math.hypot(velocity[0], velocity[1]) / 0.25) * 0.25
    course = round(math.atan2(velocity[1], velocity[0]) * 180.0 / math.pi) * math.pi / 180.0
    position[0], position[1] = round(position[0] / 0.0111) * 0.0111, round(position[1] / 0.0111) * 0.0111
    position[2] = round(position[2] / 0.5) * 0.5
    velocity[0], velocity[1] = speed * math.cos(course), speed * math.sin(course)
    velocity[2] = round(velocity[2] / 0.5) * 0.5


@_compiled
def _distance(position: Floats, i: int, j: int) -> float:
    return math.sqrt(
        (position[i, 0] - position[j, 0]) ** 2
        + (position[i, 1] - position[j, 1]) ** 2
        + (position[i, 2] - position[j, 2]) ** 2
    )


@_inlined
def send(rng: np.random.Generator, world: Conditions, tick: int, i: int, kinds: Floats, craft: Fleet) -> int:
    """Send the message of aircraft i that is due at this step. Writes `sent` and `arrival`.

    Returns:
        The slot of the message.
    """
    position, velocity, error, clock = craft.position, craft.velocity, craft.error, craft.clock
    phase, frozen, lie, sent, arrival = craft.phase, craft.frozen, craft.lie, craft.sent, craft.arrival
    now = world.start_s + tick * world.step_s
    slot = int(((tick + phase[i]) // int(world.message)) % sent.shape[1])
    message = sent[i, slot]
    message[M_TIME] = now + clock[i]
    for c in range(3):
        sent_velocity = frozen[i, c] if kinds[i] == FROZEN else velocity[i, c]
        message[M_POSITION + c] = position[i, c] + error[i, c]
        message[M_VELOCITY + c] = sent_velocity + rng.normal(0.0, world.sigma_mps)
    message[M_POSITION] += lie[i, 0]
    message[M_POSITION + 1] += lie[i, 1]
    if world.quantised != 0.0:
        _quantise(message)
    for j in range(len(kinds)):
        if j != i:
            delay = rng.uniform(world.delay_low_s, world.delay_high_s)
            lost = world.loss > 0.0 and rng.random() < world.loss
            if kinds[i] == SILENT and _distance(position, i, j) > world.silent_m:
                lost = True
            arrival[j, i, slot] = math.inf if lost else now + delay
    return slot


@_inlined
def move(rng: np.random.Generator, world: Conditions, craft: Fleet) -> None:
    """Move all vehicles by one step according to their commands."""
    step, lag, most = world.step_s, world.lag_s, world.acceleration_mps2
    keep = math.exp(-step / world.sigma_memory_s)
    fresh = math.sqrt(1.0 - keep * keep) * world.sigma_m
    gust_keep = math.exp(-step / world.gust_memory_s)
    gust_fresh = math.sqrt(1.0 - gust_keep * gust_keep) * world.gust_mps2
    own_fresh = math.sqrt(1.0 - keep * keep) * world.own_sigma_mps
    position, before, velocity, command = craft.position, craft.before, craft.velocity, craft.command
    error, own_error, gust = craft.error, craft.own_error, craft.gust
    for i in range(len(position)):
        an, ae, ad = (
            (command[i, 0] - velocity[i, 0]) / lag,
            (command[i, 1] - velocity[i, 1]) / lag,
            (command[i, 2] - velocity[i, 2]) / lag,
        )
        size = math.sqrt(an * an + ae * ae + ad * ad)
        if size > most:
            an, ae, ad = an * most / size, ae * most / size, ad * most / size
        if world.gust_mps2 > 0.0:
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
