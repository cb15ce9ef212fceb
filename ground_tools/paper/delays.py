"""Delays of one method: what a measurement yields and the tables and figures show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ground_tools.channel.options import SIDES_M
from ground_tools.paper.study import LARGE_M, SMALL_M

SET: Final = "set"
"""Key of the network that chooses sets of transports."""
DENSITIES: Final = {"high": SMALL_M, "low": LARGE_M, "dynamic": SIDES_M}
"""Sides of the area (m) by the paper's names of densities."""


@dataclass(frozen=True, slots=True)
class Delays:
    """What was measured of one method."""

    key: str
    name: str
    """For people."""
    rate: int | str
    """Messages in a GNSS period; "-" where it changes."""
    system: dict[str, tuple[float, float]]
    """System delay and its standard error (ms), by density."""
    uav_ms: tuple[float, ...]
    """Of each aircraft, dynamic density."""
