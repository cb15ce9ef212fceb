"""Compares the signal strength of a sender with the positions that it reports.

Received power falls with distance (here by 20 dB for each factor of ten, as in free space). The sender's
power and antenna and the shadowing of the link are unknown, but they are nearly constant: they shift all
messages of one radio address alike. Therefore the *change* of the power over an encounter tells whether the
reported positions can be true. `SignalWitness` weighs these hypotheses by Bayes' rule:

- the reported positions are true;
- the true position is beside the reported one by a constant offset: a grid of up to 100 m around it;
- the power does not depend on the reported position at all, as for one transmitter that invents aircraft.

For each hypothesis a Kalman filter with one state estimates the shift of each radio address. The likelihood
ratio of the alternatives against the truth exceeds 100 for an honest sender with a probability of at most
1 %, however long it is received (Ville's inequality), if the model holds. It does not where the shadowing of
a link wanders while the aircraft move: with 3 dB that change within 20 m it is 3 %, with 6 dB 25 % (150 and
100 simulated encounters).

A sender that knows where we are can vary its power so that it fits a false position. Signal strength bounds
faulty senders and simple attackers, not that one.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.arrays import Floats
from companion.geometry import Vec3

_RADII_M: Final = (20.0, 35.0, 50.0, 75.0, 100.0)
_DIRECTIONS: Final = 12
_MESSAGE_DB: Final = 6.0
"""Standard deviation of one message's power: fading, antenna patterns and attitude."""
_LINK_DB: Final = math.hypot(4.0, 6.0)
"""Standard deviation of what is constant for a link: the sender's power (4 dB) and shadowing (6 dB)."""
_DRIFT_DB2_PER_S: Final = 0.02
"""Growth of the variance of the link's shift (1.1 dB in a minute): power and shadowing are not quite
constant. Ten times as much would hide most offsets of 50 m until they are near."""
_EVERY_S: Final = 0.09
"""Least time between two messages of an address that are used. It bounds the cost of a flood."""
_SLOPE_DB: Final = 20.0
_DOUBT: Final = 0.02
"""Share of senders that are assumed not to be where they say."""
_QUANTILE: Final = 0.9
_LEAST_M: Final = 2.0
"""Distances below this count as this: antennas are not points."""
FARTHEST_M: Final = 500.0
"""Messages from farther away are not used: offsets of 100 m hardly change their power."""
_ADDRESSES: Final = 4
MISMATCH: Final = math.log(100.0)
"""Log likelihood ratio at which the signal strength contradicts the reported positions."""
MATCH: Final = math.log(10.0)
"""Below this it contradicts them no longer."""


def _grid() -> Floats:
    angles = 2.0 * math.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    return np.concatenate([np.zeros((1, 2)), *(radius * ring for radius in _RADII_M)])


_OFFSETS: Final = _grid()
"""Horizontal offsets (m) of the true position from the reported one; the first one is none. Shape
(offsets, 2)."""
_NORMS: Final = np.hypot(_OFFSETS[:, 0], _OFFSETS[:, 1])
_PRIOR: Final = np.log(
    np.array([1.0 - _DOUBT, *[0.5 * _DOUBT / (len(_OFFSETS) - 1)] * (len(_OFFSETS) - 1), 0.5 * _DOUBT])
)
"""Log prior of each hypothesis: the offsets, then the one that the power does not depend on the position."""
_ALTERNATIVES: Final = _PRIOR[1:] - math.log(_DOUBT)


@dataclass(slots=True)
class _Shift:
    """Estimate of the constant shift of one radio address (dB), for each hypothesis."""

    mean: Floats
    variance: float
    at_s: float


class SignalWitness:
    """Evidence of the signal strength of one track. Times are monotonic."""

    def __init__(self) -> None:
        self._shifts: OrderedDict[str, _Shift] = OrderedDict()
        self._log = np.zeros(len(_PRIOR))
        """Log likelihood of each hypothesis, relative to that of the truth."""

    def add(self, key: str, rssi_dbm: float, relative_ned_m: Vec3, now_s: float) -> None:
        """Take in the power of one message.

        Args:
            key: radio address on a transport; each has a shift of its own. The oldest of more than four is
                forgotten.
            rssi_dbm: received power; a number that is not finite is ignored.
            relative_ned_m: reported position at the time of reception, relative to ours.
        """
        north, east, down = relative_ned_m
        distance = math.sqrt(north * north + east * east + down * down)
        if not math.isfinite(rssi_dbm) or not distance <= FARTHEST_M:
            return
        shift = self._shifts.get(key)
        if shift is not None and now_s - shift.at_s < _EVERY_S:
            return
        beside = np.hypot(_OFFSETS[:, 0] + north, _OFFSETS[:, 1] + east)
        losses = _SLOPE_DB * np.log10(np.maximum(np.hypot(beside, down), _LEAST_M))
        loss_free = np.append(losses + rssi_dbm, rssi_dbm)
        if shift is None:
            # The absolute power is not judged: nothing is known of the sender's power.
            if len(self._shifts) >= _ADDRESSES:
                self._shifts.popitem(last=False)
            self._shifts[key] = _Shift(loss_free, _MESSAGE_DB**2, now_s)
            return
        shift.variance = min(
            shift.variance + _DRIFT_DB2_PER_S * max(0.0, now_s - shift.at_s), _LINK_DB**2 + _MESSAGE_DB**2
        )
        residual = loss_free - shift.mean
        spread = shift.variance + _MESSAGE_DB**2
        self._log -= 0.5 * residual * residual / spread
        self._log -= self._log[0]
        gain = shift.variance / spread
        shift.mean += gain * residual
        shift.variance *= 1.0 - gain
        shift.at_s = now_s

    @property
    def log_ratio(self) -> float:
        """Log likelihood ratio of the alternatives, weighted by their prior, against the truth."""
        return _log_sum(_ALTERNATIVES + self._log[1:])

    @property
    def reach_m(self) -> float:
        """How far from its reported position the sender may be (m): the offset that the true one does not
        exceed with a probability of 90 %. 0 for most senders."""
        posterior = _PRIOR + self._log
        # Where the power says nothing about the position, the reported one is as good as any.
        weights = np.exp(posterior[:-1] - posterior[:-1].max())
        total = np.cumsum(weights)
        return float(_NORMS[int(np.searchsorted(total, _QUANTILE * total[-1]))])


def _log_sum(values: Floats) -> float:
    most = float(values.max())
    return most + math.log(float(np.exp(values - most).sum()))
