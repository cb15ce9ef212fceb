"""Near mid-air collisions and losses of well clear: whether an aircraft entered the volume of another.

All volumes are cylinders. Inside, the horizontal and the vertical distance are below their limits at once.
ASTM F3442 takes 500 ft and 100 ft for the near mid-air collision (NMAC) and 2,000 ft and 250 ft for well
clear of a small uncrewed and a crewed aircraft. Between two small uncrewed aircraft, whose wingspans are up
to 25 ft, 50 ft and 15 ft take the place of the first one (sNMAC; A. Weinert, L. Alvarez, M. Owen, B. Zintak,
"Near Midair Collision Analog for Drones Based on Unmitigated Collision Risk", Journal of Air Transportation,
2022).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from companion.arrays import Floats
from ground_tools.campaign.encounters.sampling import FOOT_M


class Volume(NamedTuple):
    """A cylinder around an aircraft, m."""

    aside_m: float
    """Radius of the cylinder."""
    height_m: float
    """Half of the cylinder's height."""


NMAC: Final = Volume(500.0 * FOOT_M, 100.0 * FOOT_M)
SNMAC: Final = Volume(50.0 * FOOT_M, 15.0 * FOOT_M)
WELL_CLEAR: Final = Volume(2000.0 * FOOT_M, 250.0 * FOOT_M)


def first_inside(relative: Floats, step_s: float, volume: Volume) -> float | None:
    """When one aircraft is first inside the volume of the other one, s after the first row; None: never.

    The motion between two rows is taken as straight. Entries between two rows are found exactly.

    Args:
        relative: shape (N, 3): position of one minus that of the other, one row for each step, m.
    """
    p, d = relative[:-1], np.diff(relative, axis=0)
    level_in, level_out = _within(
        (d[:, :2] ** 2).sum(axis=1),
        (p[:, :2] * d[:, :2]).sum(axis=1),
        (p[:, :2] ** 2).sum(axis=1) - volume.aside_m**2,
    )
    height_in, height_out = _within(d[:, 2] ** 2, p[:, 2] * d[:, 2], p[:, 2] ** 2 - volume.height_m**2)
    enters = np.maximum(np.maximum(level_in, height_in), 0.0)
    leaves = np.minimum(np.minimum(level_out, height_out), 1.0)
    inside = np.flatnonzero(enters < leaves)
    return float((inside[0] + enters[inside[0]]) * step_s) if len(inside) else None


def _within(a: Floats, b: Floats, c: Floats) -> tuple[Floats, Floats]:
    """The interval of s in which a s^2 + 2 b s + c is negative, for a >= 0. If it never is, the interval is
    empty: from infinity to minus infinity."""
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(b * b - a * c)
        low, high = (-b - root) / a, (-b + root) / a
    still = a == 0.0  # no relative motion: b is 0 too
    low = np.where(still, np.where(c < 0.0, -np.inf, np.inf), low)
    high = np.where(still, np.where(c < 0.0, np.inf, -np.inf), high)
    nowhere = np.isnan(low)
    return np.where(nowhere, np.inf, low), np.where(nowhere, -np.inf, high)
