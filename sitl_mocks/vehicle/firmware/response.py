"""How a vehicle follows the velocity that it is commanded."""

from __future__ import annotations

import math
from dataclasses import dataclass

FADED_OVER_MPS = 3.0
"""Speed range over which braking fades."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """Parameters of how a vehicle follows a commanded velocity (m/s, m/s^2, s)."""

    acceleration_mps2: float
    """Horizontal acceleration limit when flying setpoints."""
    vertical_acceleration_mps2: float
    lag_s: float
    vertical_lag_s: float
    auto_acceleration_mps2: float
    """Horizontal acceleration limit in the firmware's own modes (mission, return, take-off)."""
    auto_brake_mps2: float
    auto_jerk_mps3: float = math.inf
    """Jerk limit while speeding up in the firmware's own modes."""
    gain: float = 1.0
    """Velocity reached divided by velocity commanded."""
    slow_share: float = 0.0
    """Share of the horizontal velocity that builds up and decays slowly, with time constant `slow_s`."""
    slow_s: float = 1.0
    brake_fades_mps: float = math.inf
    """Speed above which braking becomes weaker."""
    brake_faded_mps2: float = 0.0
    """Deceleration that remains at `brake_fades_mps` + FADED_OVER_MPS and above."""
