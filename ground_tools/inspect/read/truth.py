"""Reader of true positions: `<aircraft>.truth.csv`, which simulated vehicles write next to the event records.

Each row holds UTC (s) and north, east, down (m) from the simulation's home position. There are ten rows a
second. A real flight has no such file.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from companion.arrays import Floats
from companion.errors import PeerDataError
from companion.geometry import Vec3
from sitl_mocks.vehicle.options import HOME

ORIGIN: Vec3 = (HOME.lat_deg, HOME.lon_deg, HOME.alt_m)
"""Origin of the NED positions: latitude, longitude (degrees) and height above mean sea level (m)."""
HEADER = "utc_s,north_m,east_m,down_m"


def read_truth(path: Path) -> Floats | None:
    """Read true positions as an array (n, 4) of utc_s, north_m, east_m, down_m with rising time.

    A last line without a line end is skipped, because a killed vehicle process may leave one.

    Returns:
        The array, or None if the file does not exist or has no rows.

    Raises:
        PeerDataError: The file cannot be read, or is not a valid file of this kind.
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
        raise PeerDataError(f"{path.name}: line 1 must be {HEADER}")
    if len(lines) < 2:
        return None
    try:
        rows = np.array([[float(value) for value in line.split(",")] for line in lines[1:]])
    except ValueError as error:
        raise PeerDataError(f"{path.name}: {error}") from error
    if rows.ndim != 2 or rows.shape[1] != 4 or not np.isfinite(rows).all():
        raise PeerDataError(f"{path.name}: a row is not four finite numbers")
    if (np.diff(rows[:, 0]) <= 0.0).any():
        raise PeerDataError(f"{path.name}: the times must rise from row to row")
    return rows
