"""A guard on what a policy may choose: an aircraft stays audible for neighbours that it does not hear.

A policy judges by what is heard. Where little is, it may send little, or only on transports of short range:
two aircraft then do not learn of each other before they are near. While few aircraft are heard, the channel
has room, and every choice has to contain the best fixed set.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from companion.arrays import Bools
from companion.atmc.actions import Action
from companion.atmc.rule import FIXED_SETS

CROWD: Final = 20
"""From this number of heard aircraft on, a policy may send less: the channel fills up."""


def audible(actions: Sequence[Action], allowed: Bools) -> Bools:
    """Which of the allowed actions contain the best fixed set that is allowed, at its rates or higher.

    Args:
        actions: all actions of a policy. If they do not include the best fixed set, as those of the paper,
            which have one transport each, nothing is left out.
        allowed: shape (actions,), what is legal and can be sent.

    Returns:
        Shape (actions,). There is always one if any action is allowed.
    """
    can = {action for action, fits in zip(actions, allowed, strict=True) if fits}
    least = next((action for action in FIXED_SETS if action in can), None)
    if least is None or FIXED_SETS[0] not in actions:
        return allowed
    return allowed & (np.array(actions) >= np.array(least)).all(1)
