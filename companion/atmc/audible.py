"""Limits what a policy may choose, so that aircraft that we do not hear can still hear us.

A policy judges by the aircraft that it hears. If it hears few, it may send little, or only on transports of
short range, so that two aircraft do not learn of each other before they are near. While few aircraft are
heard, the channel has room, and every choice must contain the best fixed set.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from companion.arrays import Bools
from companion.atmc.actions import Action
from companion.atmc.rule import FIXED_SETS

CROWD: Final = 20
"""From this number of heard aircraft on, a policy may send less, because the channel fills up."""


def audible(actions: Sequence[Action], allowed: Bools) -> Bools:
    """Which allowed actions contain the best allowed fixed set, at its rates or higher.

    Args:
        actions: all actions of a policy. If they do not include the best fixed set (the paper's have one
            transport each), all allowed actions remain.
        allowed: shape (actions,); True for the actions that are legal and can be sent.

    Returns:
        Shape (actions,). At least one is True if any action is allowed.
    """
    can = {action for action, fits in zip(actions, allowed, strict=True) if fits}
    least = next((action for action in FIXED_SETS if action in can), None)
    if least is None or FIXED_SETS[0] not in actions:
        return allowed
    return allowed & (np.array(actions) >= np.array(least)).all(1)
