"""True positions: `<aircraft>.truth.csv`, which the simulated vehicles write beside the event records.

Rows are UTC (s) and north, east, down (m) from the simulation's home, ten a second. A real flight has none.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.errors import PeerDataError
from companion.geometry import Vec3
from sitl_mocks.encounters.lockstep import HOME

ORIGIN: Vec3 = (HOME.lat_deg, HOME.lon_deg, HOME.alt_m)
"""Latitude, longitude (degrees) and height above mean sea level (m) of the rows' origin."""
HEADER = "utc_s,north_m,east_m,down_m"


def read_truth(path: Path) -> NDArray[np.float64] | None:
    """(n, 4) of utc_s, north_m, east_m, down_m, time rising; None where there is no file, or none with rows.

    A last line without its end is what a killed vehicle leaves, and is left out.

    Raises:
        PeerDataError: not such a file.
    """
    try:
        whole, _, _ = path.read_text(encoding="ascii").rpartition("\n")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise PeerDataError(f"{path.name}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise PeerDataError(f"{path.name}: {error}") from error
    lines = whole.splitlines()
    if lines and lines[0] != HEADER:
        raise PeerDataError(f"{path.name}: does not begin with {HEADER}")
    if len(lines) < 2:
        return None
    try:
        rows = np.array([[float(value) for value in line.split(",")] for line in lines[1:]])
    except ValueError as error:
        raise PeerDataError(f"{path.name}: {error}") from error
    if rows.ndim != 2 or rows.shape[1] != 4 or not np.isfinite(rows).all():
        raise PeerDataError(f"{path.name}: rows are not four finite numbers")
    if (np.diff(rows[:, 0]) <= 0.0).any():
        raise PeerDataError(f"{path.name}: time does not rise")
    return rows
