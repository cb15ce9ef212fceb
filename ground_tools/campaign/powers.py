"""The received power of each message, and the receiver's check of it, in compiled code.

The power follows the channel model's log-distance law with shadowing of the link and of the message. It is
measured at the time of reception, because the delay of a message arises before it is sent. Receivers weigh it
with the companion's own function (`companion.avoidance.kernels.powers`).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.traffic.signal_strength import EVERY_S, FARTHEST_M, MISMATCH
from ground_tools.campaign.compiled import compiled
from ground_tools.campaign.vehicles import (
    AVOIDS,
    BAROMETRIC,
    CREWED,
    M_POSITION,
    M_TIME,
    M_VELOCITY,
    Fleet,
)
from ground_tools.campaign.world import Conditions
from sitl_mocks.channel.parameters import ChannelParameters

_CHANNEL: Final = ChannelParameters()
_AT_1M_DBM: Final = _CHANNEL.wifi.transmit_power_dbm - _CHANNEL.propagation.loss_at_1m_db
_SLOPE_DB: Final = 10.0 * _CHANNEL.propagation.exponent
_NEAREST_M: Final = 0.1
# The result of `kernels.suspicion` for a sender, and whether its ratio was ever high enough to flag it.
S_RATIO, S_BESIDE, S_NORTH, S_EAST, S_FLAGGED, SUSPICION_COLUMNS = range(6)

_compiled = compiled()
_inlined = compiled(inline="always")


class Powers(NamedTuple):
    """Powers that A aircraft measure. The first two axes are receiver and sender; both are empty without
    measurements."""

    link_db: Floats
    """(A, A): power of a sender and shadowing of the link, relative to their means."""
    log: Floats
    """(A, A, HYPOTHESES): see `kernels.note_power`, also for `means` and `covariance`."""
    means: Floats
    """(A, A, 2, HYPOTHESES)."""
    covariance: Floats
    """(A, A, 3)."""
    noted_s: Floats
    """(A, A): time of the latest power that was used."""
    suspicion: Floats
    """(A, A, SUSPICION_COLUMNS)."""


def unmeasured(rng: np.random.Generator, world: Conditions, fleet: int) -> Powers:
    """State before the first message. Draws the powers of senders and the shadowing of links."""
    size = fleet if world.signal != 0.0 else 0
    sender_db = world.sender_db * rng.standard_normal(size)
    link_db = world.link_db * rng.standard_normal((size, size))
    return Powers(
        link_db=sender_db[None, :] + link_db,
        log=np.zeros((size, size, k.HYPOTHESES)),
        means=np.zeros((size, size, 2, k.HYPOTHESES)),
        covariance=np.tile([math.inf, 0.0, 0.0], (size, size, 1)),
        noted_s=np.full((size, size), -math.inf),
        suspicion=np.zeros((size, size, SUSPICION_COLUMNS)),
    )


@_inlined
def _measure_power(
    rng: np.random.Generator, world: Conditions, now: float, i: int, j: int, craft: Fleet, message: Floats,
    powers: Powers,
) -> None:  # fmt: skip
    """Measure and weigh the power of a message that aircraft i receives from aircraft j.

    Args:
        message: latest message that i knows of j.
    """
    p, q, error = craft.position, message[M_POSITION:M_VELOCITY], craft.error
    distance = math.sqrt((p[i, 0] - p[j, 0]) ** 2 + (p[i, 1] - p[j, 1]) ** 2 + (p[i, 2] - p[j, 2]) ** 2)
    shadow = powers.link_db[i, j] + world.message_db * rng.normal(0.0, 1.0)
    rssi = round(_AT_1M_DBM + shadow - _SLOPE_DB * math.log10(max(distance, _NEAREST_M)))
    age = max(now + craft.clock[i] - message[M_TIME], 0.0)
    north = q[0] + age * message[M_VELOCITY] - p[i, 0] - error[i, 0]
    east = q[1] + age * message[M_VELOCITY + 1] - p[i, 1] - error[i, 1]
    down = q[2] + age * message[M_VELOCITY + 2] - p[i, 2] - error[i, 2]
    reported = math.sqrt(north * north + east * east + down * down)
    passed = now - powers.noted_s[i, j]
    if reported <= FARTHEST_M and passed >= EVERY_S:
        k.note_power(
            powers.log[i, j], powers.means[i, j], powers.covariance[i, j], min(passed, 1e9), float(rssi),
            north, east, down,
        )  # fmt: skip
        powers.noted_s[i, j] = now
        found = powers.suspicion[i, j]
        ratio, beside, there_n, there_e = k.suspicion(powers.log[i, j])
        found[S_RATIO], found[S_BESIDE] = ratio, beside
        found[S_NORTH], found[S_EAST] = there_n, there_e
        if ratio > MISMATCH:
            found[S_FLAGGED] = 1.0


@_compiled
def measure_powers(
    rng: np.random.Generator, world: Conditions, tick: int, kinds: Floats, craft: Fleet, heard: Floats,
    powers: Powers,
) -> None:  # fmt: skip
    """Measure and weigh the powers of all messages that arrive in this step at aircraft that avoid.

    Args:
        rng: source of the shadowing of messages.
        heard: shape (receiver, sender, MESSAGE_COLUMNS): latest message that each receiver knows. Before the
            first message nothing is weighed.
    """
    now, before = world.start_s + tick * world.step_s, world.start_s + (tick - 1) * world.step_s
    arrival = craft.arrival
    for i in range(len(kinds)):
        for j in range(len(kinds)):
            if kinds[i] != AVOIDS or kinds[j] == CREWED or kinds[j] == BAROMETRIC:
                continue
            for slot in range(arrival.shape[2]):
                if not before < arrival[i, j, slot] <= now:
                    continue
                if heard[i, j, M_TIME] > -math.inf and not math.isnan(craft.sent[j, slot, M_POSITION]):
                    _measure_power(rng, world, now, i, j, craft, heard[i, j], powers)
