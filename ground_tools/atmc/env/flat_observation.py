"""The paper's observation as one flat row of numbers for each aircraft.

The own transport and rates come first, then the neighbours by distance, nearest first: each has its distance,
transport, rates, and a 1. Zeros follow for the aircraft that are not heard.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from companion.arrays import Float32s, Floats
from companion.atmc.observation import NEIGHBOUR_COLUMNS, OWN_COLUMNS
from ground_tools.atmc.env.environment import Observation

FLAT_NEIGHBOUR_COLUMNS = ("log_distance", "ble4", "ble5", "wifi", "ble4_rate", "ble5_rate", "wifi_rate")
"""Columns of each neighbour; one more column follows, which is 1 if the neighbour is heard."""
FLAT_OWN_COLUMNS = ("ble4", "ble5", "wifi", "ble4_rate", "ble5_rate", "wifi_rate")
_NEIGHBOUR_INDICES = [NEIGHBOUR_COLUMNS.index(name) for name in FLAT_NEIGHBOUR_COLUMNS]
_OWN_INDICES = [OWN_COLUMNS.index(name) for name in FLAT_OWN_COLUMNS]


def inputs(aircraft: int) -> int:
    """Length of a row for a fleet of this many aircraft."""
    return len(FLAT_OWN_COLUMNS) + (aircraft - 1) * (len(FLAT_NEIGHBOUR_COLUMNS) + 1)


def flat(observation: Observation) -> Tensor:
    """The observation of each aircraft as one row, (E, N, inputs(N))."""
    rows, heard = observation.rows, observation.heard > 0
    environments, aircraft, _ = heard.shape
    nearest = torch.where(heard, rows[..., 0], math.inf).argsort(-1)[..., : aircraft - 1]
    there = heard.gather(-1, nearest)[..., None].to(rows.dtype)
    wanted = rows[..., _NEIGHBOUR_INDICES]
    chosen = wanted.gather(2, nearest[..., None].expand(*nearest.shape, len(FLAT_NEIGHBOUR_COLUMNS)))
    neighbours = torch.cat([chosen * there, there], -1).reshape(environments, aircraft, -1)
    return torch.cat([observation.own[..., _OWN_INDICES], neighbours], -1)


def whole_rows(row: Float32s) -> tuple[Floats, Floats]:
    """Convert a flat row back to an observation with all columns of the schema.

    Args:
        row: Shape (inputs,).

    Returns:
        Own row, shape (own columns,), and rows of the neighbours that are heard, shape (neighbours, neighbour
        columns). Columns that a flat row lacks are 0.
    """
    own = np.zeros(len(OWN_COLUMNS))
    own[_OWN_INDICES] = row[: len(FLAT_OWN_COLUMNS)]
    table = row[len(FLAT_OWN_COLUMNS) :].reshape(-1, len(FLAT_NEIGHBOUR_COLUMNS) + 1)
    table = table[table[:, -1] > 0]
    rows = np.zeros((len(table), len(NEIGHBOUR_COLUMNS)))
    rows[:, _NEIGHBOUR_INDICES] = table[:, :-1]
    return own, rows
