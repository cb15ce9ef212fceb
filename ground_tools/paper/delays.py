"""Delays of one method: the result of a measurement and the input of tables and figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ground_tools.channel.options import SIDES_M
from ground_tools.paper.study import LARGE_M, SMALL_M

SET: Final = "set"
"""Key of the set network, which chooses sets of transports."""
DENSITIES: Final = {"high": SMALL_M, "low": LARGE_M, "dynamic": SIDES_M}
"""Sides of the area (m), by the paper's name of the density."""


@dataclass(frozen=True, slots=True)
class Delays:
    """Measured delays of one method."""

    key: str
    name: str
    """Display name."""
    rate: int | str
    """Messages in a GNSS period; "-" if the rate changes."""
    system: dict[str, tuple[float, float]]
    """System delay and its standard error (ms), by density."""
    uav_ms: tuple[float, ...]
    """Delay of each aircraft at dynamic density."""
