"""What a policy may choose: sets of transports, each with its Locations a second.

The paper's action space (section "Action Space") is one protocol at one rate. What flies chooses among sets,
because the law of some regions knows no legal single Bluetooth mode, and sets do better (docs/atmc.md).
"""

from __future__ import annotations

import itertools
from collections.abc import Collection
from typing import Final

import numpy as np
from numpy.typing import NDArray

from companion.remote_id.region import Region
from companion.remote_id.transports import BLE4, BLE5, MAX_RATE, WIFI_BEACON

TRANSPORTS: Final = (BLE4, BLE5, WIFI_BEACON)
"""In the order of every array of this package."""

Action = tuple[int, int, int]
"""Locations a second on each of `TRANSPORTS`; 0 where it is not used."""
Bools = NDArray[np.bool_]

PAPER_ACTIONS: Final[tuple[Action, ...]] = tuple(
    tuple(rate if mode == chosen else 0 for mode in range(3))  # type: ignore[misc]
    for chosen in range(3)
    for rate in range(1, MAX_RATE + 1)
)
"""The paper's: one protocol at 1 to 10 messages in a GNSS period; BLE 4 first, then BLE 5, then Wi-Fi."""

SET_LEVELS: Final = ((0, 3, 10), (0, 2, 5, 10), (0, 2, 7, 10))
"""Rates that sets are made of, by transport. The slowest sends within the second that every law asks for,
with margin; Wi-Fi at 7 meets scans nearly as well as at 10, where 3 to 6 and 8 hardly do better than 2."""
SET_ACTIONS: Final[tuple[Action, ...]] = tuple(
    (ble4, ble5, wifi)
    for wifi, ble5, ble4 in itertools.product(SET_LEVELS[2], SET_LEVELS[1], SET_LEVELS[0])
    if ble4 or ble5 or wifi
)
"""Every set of transports at those rates."""


def legal(actions: Collection[Action], region: Region) -> Bools:
    """Which actions hold one of the region's legal transport sets; shape (actions,)."""
    sets = [frozenset(names) for names in region.transport_sets]
    return np.array(
        [not sets or any(names <= transports_of(action) for names in sets) for action in actions], bool
    )


def able(actions: Collection[Action], can_send: Collection[str]) -> Bools:
    """Which actions need no transport beyond those that the radios can send on; shape (actions,)."""
    return np.array([transports_of(action) <= frozenset(can_send) for action in actions], bool)


def transports_of(action: Action) -> frozenset[str]:
    """The transports that an action uses."""
    return frozenset(name for name, rate in zip(TRANSPORTS, action, strict=True) if rate)


def rates_of(action: Action) -> dict[str, int]:
    """An action as the broadcaster takes it: transports with their Locations a second."""
    return {name: rate for name, rate in zip(TRANSPORTS, action, strict=True) if rate}
