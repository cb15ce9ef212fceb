"""Compares the signal strength of a sender with the positions that it reports.

`kernels.powers` describes the hypotheses and weighs them. The likelihood ratio of the alternatives against
the truth exceeds 100 for an honest sender with a probability of at most 1 %, however long it is received
(Ville's inequality), if the model holds. The model fails if the shadowing of a link changes a lot while the
aircraft move.

A sender that knows where we are can vary its power so that it fits a false position. Signal strength exposes
faulty senders and simple attackers, but not such a sender.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from companion.arrays import Floats
from companion.avoidance import kernels
from companion.geometry import Vec3

EVERY_S: Final = 0.09
"""Least time between two messages of an address that are used. It bounds the cost of a flood."""
FARTHEST_M: Final = 500.0
"""Messages from farther away are not used: offsets of 100 m hardly change their power."""
_ADDRESSES: Final = 4
MISMATCH: Final = math.log(100.0)
"""Log likelihood ratio at which the signal strength contradicts the reported positions."""
MATCH: Final = math.log(10.0)
"""Below this it contradicts them no longer."""


class Suspicion(NamedTuple):
    """What the signal strength says of a sender's positions (`kernels.suspicion`)."""

    log_ratio: float = 0.0
    """Log likelihood ratio of all alternatives against the truth."""
    beside: float = 0.0
    """Log likelihood ratio of those alternatives in which the sender is beside its reported position."""
    north_m: float = 0.0
    """Place of the sender in those alternatives, north and east of its reported position."""
    east_m: float = 0.0


NOT_SUSPECTED: Final = Suspicion()


@dataclass(slots=True)
class _Shift:
    """Estimate of the shift of one radio address; the arguments of `kernels.note_power`."""

    means: Floats
    covariance: Floats
    at_s: float


class SignalWitness:
    """Evidence of the signal strength of one track. Times are monotonic."""

    def __init__(self) -> None:
        self._shifts: OrderedDict[str, _Shift] = OrderedDict()
        self._log = np.zeros(kernels.HYPOTHESES)
        """Log likelihood of each hypothesis, relative to that of the truth."""
        self.suspicion = NOT_SUSPECTED
        """What all messages so far say together."""

    def add(self, key: str, rssi_dbm: float, relative_ned_m: Vec3, now_s: float) -> bool:
        """Take in the power of one message. False if it is not used.

        Args:
            key: radio address on a transport; each has a shift of its own. The oldest of more than four is
                forgotten.
            rssi_dbm: received power; a number that is not finite is ignored.
            relative_ned_m: reported position at the time of reception, relative to ours.
        """
        north, east, down = relative_ned_m
        distance = math.sqrt(north * north + east * east + down * down)
        if not math.isfinite(rssi_dbm) or not distance <= FARTHEST_M:
            return False
        shift = self._shifts.get(key)
        if shift is None:
            if len(self._shifts) >= _ADDRESSES:
                self._shifts.popitem(last=False)
            shift = self._shifts[key] = _Shift(
                np.zeros((2, kernels.HYPOTHESES)), np.array([math.inf, 0.0, 0.0]), now_s
            )
        elif now_s - shift.at_s < EVERY_S:
            return False
        kernels.note_power(
            self._log, shift.means, shift.covariance, now_s - shift.at_s, rssi_dbm, north, east, down
        )
        shift.at_s = now_s
        self.suspicion = Suspicion._make(kernels.suspicion(self._log))
        return True
