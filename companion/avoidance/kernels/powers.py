"""Whether the received powers of a sender agree with the positions that it reports.

Received power falls with distance, here by 20 dB for each factor of ten, as in free space. The sender's power
and antenna and the shadowing of a link are unknown but nearly constant: they shift all messages of one radio
address alike. Therefore the *change* of the power over an encounter tells whether the reported positions can
be true. Hypotheses are weighed by Bayes' rule:

- the reported positions are true;
- the true position is beside the reported one by a constant horizontal offset (a lattice of up to 100 m);
- the power does not depend on the reported position at all, as for one transmitter that invents aircraft.

For each hypothesis a Kalman filter estimates the shift of each radio address, and a part of it that wanders.
Arrays have an entry for each hypothesis, in this order: the truth, the offsets of `OFFSETS`, no dependence.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from companion.arrays import Floats
from companion.avoidance.kernels.compiled import compiled

_RINGS: Final = 6
_FARTHEST_M: Final = 100.0
_MESSAGE_DB: Final = 5.0
"""Standard deviation of one message's power: fading and quantisation."""
_WANDER_DB, _WANDER_S = 2.0, 5.0
"""Standard deviation and time constant of what changes while the aircraft move: shadowing, antenna patterns
and attitude. Without it many messages a second would prove too much."""
_LINK_DB: Final = math.hypot(4.0, 6.0)
"""Standard deviation of what is constant for a link: the sender's power (4 dB) and shadowing (6 dB)."""
_DRIFT_DB2_PER_S: Final = 0.02
"""Growth of the variance of the link's shift (1.1 dB in a minute): power and shadowing are not quite
constant."""
_SLOPE_DB: Final = 20.0 / math.log(10.0)
_LEAST_M: Final = 2.0
"""Distances below this count as this: antennas are not points."""
BESIDE: Final = math.log(1.5)
"""Log likelihood ratio of the offsets (`suspicion`) above which the place that the powers point to is avoided
as well. Honest senders reach it in less than 1 % of the time if the model holds."""


def _grid() -> Floats:
    """A lattice of equal triangles within a hexagon, its centre first."""
    steps = range(-_RINGS, _RINGS + 1)
    found = [(i + 0.5 * j, math.sqrt(0.75) * j) for i in steps for j in steps if abs(i + j) <= _RINGS]
    return _FARTHEST_M / _RINGS * np.array(sorted(found, key=lambda p: math.hypot(*p)))


OFFSETS: Final = _grid()
"""Horizontal offsets (m) of the true position from the reported one; the first one is none. Shape
(offsets, 2)."""
_PLACES: Final = len(OFFSETS)
HYPOTHESES: Final = _PLACES + 1


@compiled
def note_power(
    log: Floats,
    means: Floats,
    covariance: Floats,
    passed_s: float,
    rssi_dbm: float,
    north: float,
    east: float,
    down: float,
) -> None:
    """Take in the power of one message of one radio address.

    Args:
        log: log likelihood of each hypothesis, relative to that of the truth; written.
        means: shape (2, HYPOTHESES): estimates of the address's shift and of its wandering part (dB) by each
            hypothesis; written.
        covariance: variance of the shift, covariance, variance of the wandering part (dB^2), the same for all
            hypotheses; written. The first one is infinite before the first message.
        passed_s: time since the address's previous message.
        rssi_dbm: received power.
        north, east, down: reported position at the time of reception, relative to ours, m.
    """
    noise, wander = _MESSAGE_DB * _MESSAGE_DB, _WANDER_DB * _WANDER_DB
    passed = max(passed_s, 0.0)
    keep = math.exp(-passed / _WANDER_S)
    first = covariance[0] == math.inf
    shift = min(covariance[0] + _DRIFT_DB2_PER_S * passed, _LINK_DB * _LINK_DB + noise)
    both, wandering = keep * covariance[1], keep * keep * covariance[2] + (1.0 - keep * keep) * wander
    total = shift + 2.0 * both + wandering + noise
    shift_gain, wander_gain, precision = (shift + both) / total, (both + wandering) / total, 0.5 / total
    least, down2 = _LEAST_M * _LEAST_M, down * down
    truth = 0.0
    for i in range(HYPOTHESES):
        level = rssi_dbm
        if i < _PLACES:
            n, e = north + OFFSETS[i, 0], east + OFFSETS[i, 1]
            level += 0.5 * _SLOPE_DB * math.log(max(n * n + e * e + down2, least))
        if first:
            # The absolute power is not judged: nothing is known of the sender's power.
            means[0, i], means[1, i] = level, 0.0
            continue
        wandered = keep * means[1, i]
        residual = level - means[0, i] - wandered
        means[0, i] += shift_gain * residual
        means[1, i] = wandered + wander_gain * residual
        likelihood = log[i] - precision * residual * residual
        if i == 0:
            truth = likelihood
        log[i] = likelihood - truth
    if first:
        covariance[0], covariance[1], covariance[2] = noise + wander, -wander, wander
    else:
        covariance[0] = shift - shift_gain * (shift + both)
        covariance[1] = both - shift_gain * (both + wandering)
        covariance[2] = wandering - wander_gain * (both + wandering)


@compiled
def suspicion(log: Floats) -> tuple[float, float, float, float]:
    """Evaluate all powers so far.

    Args:
        log: log likelihood of each hypothesis, relative to that of the truth.

    Returns:
        Log likelihood ratio of all alternatives against the truth; that of the offsets alone; and the mean of
        the offsets, north and east (m).
    """
    most = log[1]
    for i in range(2, _PLACES):
        most = max(most, log[i])
    total = north = east = 0.0
    for i in range(1, _PLACES):
        weight = math.exp(log[i] - most)
        total += weight
        north += weight * OFFSETS[i, 0]
        east += weight * OFFSETS[i, 1]
    beside = most + math.log(total / (_PLACES - 1))
    high = max(beside, log[_PLACES])
    ratio = high + math.log(0.5 * math.exp(beside - high) + 0.5 * math.exp(log[_PLACES] - high))
    return ratio, beside, north / total, east / total
