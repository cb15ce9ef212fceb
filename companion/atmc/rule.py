"""Choosers without a network: the one-line rule, the best fixed legal set, and the fall-back.

They are the baselines for every learned policy. All their numbers are defined here.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

from companion.arrays import AnyFloats, Bools
from companion.atmc.actions import PAPER_ACTIONS, SET_ACTIONS, Action, able, legal
from companion.atmc.choice import Choice, Refused, Why
from companion.atmc.observation import NEIGHBOUR_COLUMNS
from companion.remote_id.region import Region

BLE4_RANGE_M: Final = 253.0
"""Range of BLE 4 by the paper's link budget."""
FIXED_SETS: Final[tuple[Action, ...]] = (
    (10, 0, 10),  # Wi-Fi has a long range; BLE 4 gets through where Wi-Fi is crowded
    (0, 0, 10),
    (10, 10, 0),
    (0, 10, 0),
    (10, 0, 0),
)
"""Fixed sets, best first (awareness objective). They include one for every legal set of every region."""
PAPER_NEAR: Final[Action] = (0, 0, 10)
PAPER_FAR: Final[Action] = (9, 0, 0)
FLYING_NEAR: Final[Action] = (10, 0, 10)
FLYING_FAR: Final[Action] = (0, 0, 10)

_DISTANCE: Final = NEIGHBOUR_COLUMNS.index("log_distance")


@dataclass(frozen=True, slots=True)
class Rule:
    """Chooses `near` if any aircraft is heard within `within_m`, else `far`. Implements `Mind`.

    If that action is not allowed, it takes the first allowed one of `FIXED_SETS`, else the first allowed
    action.
    """

    actions: tuple[Action, ...]
    near: Action
    far: Action
    within_m: float = BLE4_RANGE_M

    def choose(
        self,
        own_row: AnyFloats,
        neighbour_rows: AnyFloats,
        allowed: Bools,
        current: int | None,
        agent: int = 0,
    ) -> Choice | Refused:
        """See `Mind`. Uses only the distances of the neighbours."""
        limit = math.log10(self.within_m) / 4.0
        is_near = bool((neighbour_rows[:, _DISTANCE] <= limit).any())
        can = {action: i for i, action in enumerate(self.actions) if allowed[i]}
        if not can:
            return Refused(Why.NOTHING_ALLOWED, "no set of transports is legal and can be sent")
        wanted = (self.near if is_near else self.far, *FIXED_SETS, *can)
        action = next(action for action in wanted if action in can)
        return Choice(can[action], action)


PAPER_RULE: Final = Rule(PAPER_ACTIONS, near=PAPER_NEAR, far=PAPER_FAR)
"""Rule for the paper's objective: Wi-Fi at 10 if any aircraft is within BLE 4's range, else BLE 4 at 9."""
FLYING_RULE: Final = Rule(SET_ACTIONS, near=FLYING_NEAR, far=FLYING_FAR)
"""Rule for flight: always Wi-Fi at 10, and also BLE 4 at 10 if any aircraft is heard within its range."""
FIXED: Final = Rule(SET_ACTIONS, near=FIXED_SETS[0], far=FIXED_SETS[0])
"""Always the best fixed set."""


def fixed(region: Region, can_send: Collection[str]) -> Action | None:
    """The fall-back: the first of `FIXED_SETS` that is legal and can be sent; None if there is none.

    It is used if no policy can be followed. The broadcaster still enforces the region's legal minimum.
    """
    allowed = legal(FIXED_SETS, region) & able(FIXED_SETS, can_send)
    return next((action for action, fits in zip(FIXED_SETS, allowed, strict=True) if fits), None)
