"""A hover among many that stand around it: nothing keeps every plane, and nothing says how to climb."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.avoidance.law import Law, Neighbour
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from tests.companion.avoidance.flown.flying import fly


@pytest.mark.parametrize("count", [3, 60])
@pytest.mark.parametrize("seed", range(4))
def test_a_hover_among_others_of_unknown_height_keeps_its_height(count: int, seed: int) -> None:
    """Level planes leave the down speed free: of all that violate them least, the wish's is flown."""
    rng = np.random.default_rng(seed)
    bearing, away = rng.uniform(0.0, 2.0 * math.pi, count), rng.uniform(4.0, 14.0, count)
    down = rng.uniform(-100.0, 0.0, count)
    others = [
        Neighbour(
            str(i), (r * math.cos(b), r * math.sin(b), d), (0.0, 0.0, 0.0), 0.5, 1.0, vertical_known=False
        )
        for i, (b, r, d) in enumerate(zip(bearing, away, down, strict=True))
    ]
    path = Trajectory([0, 100], [(0, 0, -50), (0.01, 0, -50)])
    law = Law(AvoidanceConfig(), LimitsConfig(), path)
    flight = fly(law, 30.0, hears=lambda now, p, v: others, sigma_m=1.0, seed=seed)
    assert any(not result.feasible for result in flight.results)
    assert abs(flight.position[:, 2] + 50.0).max() < 4.0
