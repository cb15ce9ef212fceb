"""Actions of a policy: sets of transports, each with its Locations per second.

The paper's action space (section "Action Space") is one protocol at one rate. The policy that flies chooses
among sets of transports, because in some regions no single Bluetooth mode is legal, and because sets perform
better (docs/atmc.md).
"""

from __future__ import annotations

import itertools
from collections.abc import Collection
from typing import Final

import numpy as np

from companion.arrays import Bools
from companion.remote_id.region import Region
from companion.remote_id.transports import BLE4, BLE5, MAX_RATE, WIFI_BEACON

TRANSPORTS: Final = (BLE4, BLE5, WIFI_BEACON)
"""Transports, in the order that every array of this package uses."""

Action = tuple[int, int, int]
"""Locations per second on each of `TRANSPORTS`; 0 for a transport that is not used."""

PAPER_ACTIONS: Final[tuple[Action, ...]] = tuple(
    tuple(rate if mode == chosen else 0 for mode in range(3))  # type: ignore[misc]
    for chosen in range(3)
    for rate in range(1, MAX_RATE + 1)
)
"""The paper's actions: one protocol at 1 to 10 messages per GNSS period; BLE 4, then BLE 5, then Wi-Fi."""

SET_LEVELS: Final = ((0, 3, 10), (0, 2, 5, 10), (0, 2, 7, 10))
"""Locations per second that sets are made of, by transport; 0 means that the transport is not used. The
lowest rates above 0 keep the period of one second that every law requires, with margin. Wi-Fi at 7 meets the
receivers' scans nearly as well as at 10; 3 to 6 and 8 hardly do better than 2."""
SET_ACTIONS: Final[tuple[Action, ...]] = tuple(
    (ble4, ble5, wifi)
    for wifi, ble5, ble4 in itertools.product(SET_LEVELS[2], SET_LEVELS[1], SET_LEVELS[0])
    if ble4 or ble5 or wifi
)
"""Every set of transports at the rates of `SET_LEVELS`."""


def legal(actions: Collection[Action], region: Region) -> Bools:
    """Which actions include at least one of the region's legal transport sets; shape (actions,)."""
    sets = [frozenset(names) for names in region.transport_sets]
    return np.array(
        [not sets or any(names <= transports_of(action) for names in sets) for action in actions], bool
    )


def able(actions: Collection[Action], can_send: Collection[str]) -> Bools:
    """Which actions use only transports that the radios can send on; shape (actions,)."""
    return np.array([transports_of(action) <= frozenset(can_send) for action in actions], bool)


def transports_of(action: Action) -> frozenset[str]:
    """Names of the transports that an action uses."""
    return frozenset(name for name, rate in zip(TRANSPORTS, action, strict=True) if rate)


def rates_of(action: Action) -> dict[str, int]:
    """The action in the broadcaster's format: used transports with their Locations per second."""
    return {name: rate for name, rate in zip(TRANSPORTS, action, strict=True) if rate}
