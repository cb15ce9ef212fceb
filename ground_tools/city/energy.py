"""The propulsion power of a small multirotor, in compiled code.

Source: Y. Zeng, J. Xu and R. Zhang, "Energy Minimization for Wireless Communication With Rotary-Wing UAV",
IEEE Transactions on Wireless Communications 18 (4), 2019: the power of steady level flight, with the values
of its simulations (a vehicle of 20 N with a rotor disc of 0.503 m²). Accelerations cost nothing in it. The
power of a climb is added here.
"""

from __future__ import annotations

import math

from ground_tools.city.compiled import compiled

WEIGHT_N = 20.0
BLADE_PROFILE_W = 79.86
"""Power of the blades' drag in hover, W."""
INDUCED_W = 88.63
"""Power that makes the lift in hover, W."""
TIP_SPEED_MPS = 120.0
HOVER_INFLOW_MPS = 4.03
"""Mean velocity of the air through the rotors in hover, m/s."""
PARASITE_W_PER_MPS3 = 0.5 * 0.6 * 1.225 * 0.05 * 0.503
"""Power of the fuselage's drag at 1 m/s, W; it grows with the cube of the speed."""


@compiled(forceinline=True)
def power_w(horizontal_mps: float, climb_mps: float) -> float:
    """Propulsion power, W.

    Args:
        horizontal_mps: horizontal speed, m/s.
        climb_mps: vertical speed, up positive, m/s. A climb adds the power that lifts the weight. A descent
            saves nothing.
    """
    square = horizontal_mps * horizontal_mps
    inflow = square / (2.0 * HOVER_INFLOW_MPS * HOVER_INFLOW_MPS)
    return (
        BLADE_PROFILE_W * (1.0 + 3.0 * square / (TIP_SPEED_MPS * TIP_SPEED_MPS))
        + INDUCED_W * math.sqrt(math.sqrt(1.0 + inflow * inflow) - inflow)
        + PARASITE_W_PER_MPS3 * square * horizontal_mps
        + WEIGHT_N * max(climb_mps, 0.0)
    )
