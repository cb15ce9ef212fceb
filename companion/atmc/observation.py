"""Observation of a policy: one row for each heard neighbour and one for the own aircraft.

The trainer and the aircraft build both with these functions. The paper's observation (section "State Space")
holds the own protocol and rate and, for every heard neighbour, its distance, protocol and rate. The policy
that flies has three additions: how soon a neighbour could be in conflict, the share of packets that survive
on each transport here, and features of the own identity, so that aircraft in the same situation can act
differently.

The functions take arrays of any leading shape, from NumPy or PyTorch (`xp` is the module). The aircraft has
no PyTorch, and the trainer may keep its arrays on a GPU.
"""

from __future__ import annotations

import math
import zlib
from typing import Any, Final

SCHEMA: Final = "dmuca-atmc-1"
"""Version of the observation. Increase it with every change of a column or its scaling; policies for another
schema are refused."""

NEIGHBOUR_COLUMNS: Final = (
    "log_distance",  # log10 of the distance (m) / 4
    "conflict",  # see `conflict_weight`
    "ble4",  # 1 if the neighbour is heard on this transport
    "ble5",
    "wifi",
    "ble4_rate",  # Locations per second / 10
    "ble5_rate",
    "wifi_rate",
)
OWN_COLUMNS: Final = (
    "ble4",
    "ble5",
    "wifi",
    "ble4_rate",
    "ble5_rate",
    "wifi_rate",
    "ble4_success",  # share of packets that survive here; 0 if not measured
    "ble5_success",
    "wifi_success",
    "ble4_measured",  # 1 if the share is measured
    "ble5_measured",
    "wifi_measured",
    "identity_0",  # -1 or 1
    "identity_1",
    "identity_2",
    "identity_3",
)
IDENTITY_BITS: Final = 4

SEPARATION_M: Final = 10.0
"""Separation of two aircraft: the sum of both conflict radii."""
LOOK_AHEAD_S: Final = 10.0
"""A neighbour that could be in conflict after this time has the weight 0.5."""
LEAST_CLOSING_MPS: Final = 10.0
"""Least closing speed assumed of a neighbour, because an aircraft that flies past may turn."""
_MIN_DISTANCE_M: Final = 1.0


def conflict_weight(xp: Any, distance_m: Any, closing_mps: Any) -> Any:
    """Weight of a neighbour, 0 to 1: 2^-(t / LOOK_AHEAD_S)^2, with the time t until it could be in conflict.

    Args:
        distance_m: any shape.
        closing_mps: speed at which the distance shrinks; same shape.
    """
    gap_m = xp.clip(distance_m - SEPARATION_M, 0.0, None)
    ratio = gap_m / (xp.clip(closing_mps, LEAST_CLOSING_MPS, None) * LOOK_AHEAD_S)
    return xp.exp2(-ratio * ratio)


def neighbour_rows(xp: Any, distance_m: Any, conflict: Any, rates: Any) -> Any:
    """Rows of `NEIGHBOUR_COLUMNS`.

    Args:
        distance_m: shape (..., neighbours).
        conflict: `conflict_weight` of each neighbour, same shape.
        rates: shape (..., neighbours, 3), Locations per second by transport, 0 if it is not heard on it.

    Returns:
        Shape (..., neighbours, 8), in the type of `distance_m`.
    """
    rows = xp.zeros_like(xp.broadcast_to(distance_m[..., None], (*distance_m.shape, len(NEIGHBOUR_COLUMNS))))
    rows[..., 0] = xp.log10(xp.clip(distance_m, _MIN_DISTANCE_M, None)) / 4.0
    rows[..., 1] = conflict
    rows[..., 2:5] = rates > 0
    rows[..., 5:8] = rates / 10.0
    return rows


def own_row(xp: Any, rates: Any, success: Any, measured: Any, identity: Any) -> Any:
    """The row of `OWN_COLUMNS`.

    Args:
        rates: shape (..., 3), present own Locations per second by transport.
        success: shape (..., 3), share of packets that survive here, 0 to 1.
        measured: shape (..., 3), 1 if that share is known, 0 if not.
        identity: shape (..., 4), see `identity_of`. Its floating-point type is that of the result.

    Returns:
        Shape (..., 16).
    """
    shape = (*identity.shape[:-1], len(OWN_COLUMNS))
    row = xp.zeros_like(xp.broadcast_to(identity[..., :1], shape))
    row[..., 0:3] = rates > 0
    row[..., 3:6] = rates / 10.0
    row[..., 6:9] = success * measured
    row[..., 9:12] = measured
    row[..., 12:16] = identity
    return row


def identity_of(uas_id: str) -> tuple[float, ...]:
    """Features derived from an identity, each -1 or 1, by which the policy can tell aircraft apart."""
    word = zlib.crc32(uas_id.encode()) * 2_654_435_761 >> 16
    return tuple(1.0 if word >> bit & 1 else -1.0 for bit in range(IDENTITY_BITS))


def random_phase(uas_id: str, count: int) -> float:
    """Phase of a decision: a number in [0, 1) that differs between aircraft and between decisions.

    Aircraft that decide at the same time oscillate: all leave the crowded transport and meet on the next one.
    """
    golden = (math.sqrt(5.0) - 1.0) / 2.0
    return (zlib.crc32(f"{uas_id}/{count}".encode()) / 2**32 + golden * count) % 1.0
