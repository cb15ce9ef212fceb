"""Draws when messages arrive, from the probabilities that `reception` computed, in compiled code."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from companion.arrays import Floats, Integers
from ground_tools.city.compiled import compiled, fetch
from ground_tools.city.tables import Links

AHEAD = 8
"""Number of links ahead of which memory is asked for."""
_SURELY = 1.0 + 1e-9
"""Factor that is more than the rounding of a logarithm and a quotient."""


class Frames(NamedTuple):
    """Timing of the frames that repeat a message until the next one."""

    period_s: float
    """T_GNSS: time between two messages."""
    offset_s: Floats
    """(3,): time from the beginning of a frame to the end of the packet that delivers it, by transport."""
    wait_s: Floats
    """(M,): how long an aircraft's beacon waits for a free channel."""


@compiled(forceinline=True)
def put_arrival(links: Links, e: int, slot: int, arrival_s: float, by: int) -> None:
    """Write when a message arrives over a link, and on which transports."""
    links.arrival[e, slot], links.by[e, slot] = arrival_s, by
    links.due_s[e] = min(links.due_s[e], arrival_s)


@compiled(forceinline=True)
def draw_arrivals(
    rng: np.random.Generator, now: float, j: int, slot: int, rates: Integers, links: Links, frames: Frames
) -> None:
    """Draw when each aircraft in reach receives a message that aircraft j sends now.

    Until the next message, the frames of a transport with rate psi begin at intervals of T / psi, the first
    at a random time within one interval. Each frame is received with the same probability, so the number
    of frames that fail before the first success has a geometric distribution. The mean over many messages
    is the mean delay of the equations, with which the probability was computed.
    """
    end = links.start[j + 1]
    for e in range(links.start[j], end):
        if e + AHEAD < end:
            fetch(links.arrival, (links.back[e + AHEAD], 0))
            fetch(links.due_s, (links.back[e + AHEAD],))
        at = links.back[e]
        arrival, by = math.inf, 0
        for m in range(links.chance.shape[1]):
            fails, rate = links.chance[e, m], rates[j, m]
            if rate == 0 or fails == 0.0:
                continue
            u = rng.random()
            # -log(1 - u) is more than this polynomial: mostly, no logarithm is needed to see that all fail.
            if u + 0.5 * u * u > _SURELY * (-fails * rate):
                continue
            number = math.floor(math.log(1.0 - u) / fails)
            if number < rate:
                when = now + (number + rng.random()) * frames.period_s / rate + frames.offset_s[m]
                if m == 2:
                    when += frames.wait_s[j]
                arrival = min(arrival, when)
                by |= 1 << m
        put_arrival(links, at, slot, arrival, by)
