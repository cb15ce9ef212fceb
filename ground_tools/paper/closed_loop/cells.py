"""What the closed loop found, by cell: a file for each condition and method, a line for each encounter; so a
method can be added later, and a run that was cut short goes on.
"""

from __future__ import annotations

import hashlib
from operator import attrgetter
from pathlib import Path
from typing import Any

import msgspec

from ground_tools.common.kept_lines import Kept
from ground_tools.paper.closed_loop.flights import FILE, METHODS, Flight, Row


def cell(folder: Path, flight: Flight, crowd: int) -> Kept[Row]:
    """One file, its rows by encounter.

    Args:
        folder: is there.
        flight: any of the cell's; what it says beside its seeds must be the same for all.
        crowd: encounters side by side in one air.

    Raises:
        ConfigError: the file was made with other settings, or cannot be read.
    """
    path = folder / f"{flight.condition}-{flight.method}.jsonl"
    return Kept(path, _made_with(flight, crowd), Row, attrgetter("encounter"))


def _made_with(flight: Flight, crowd: int) -> dict[str, Any]:
    """What a cell's numbers hang on, beside the software."""
    method = METHODS[flight.method]
    return {
        "condition": flight.condition,
        "method": flight.method,
        "region": "none" if method.policy is None else flight.region.name,
        "channel": _digest(msgspec.json.encode(flight.channel)),
        "crowd": crowd,
        "policy": _digest(flight.policy) if method.policy == FILE and flight.policy is not None else None,
    }


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]
