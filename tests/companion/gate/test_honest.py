"""Of honest flights, troubles and all, the gate refuses nothing."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from companion.events import Firmware
from sitl_mocks.soak import TICK_S, Soak

SECONDS = 420.0


@pytest.mark.parametrize(("firmware", "use"), list(product(Firmware, ("guard", "fly"))))
def test_nothing_is_refused_in_an_honest_flight(firmware, use):
    run = Soak(firmware, use, np.random.default_rng(2))
    gates = [run.onboard.gate]
    for _ in range(round(SECONDS / TICK_S)):
        run.step()
        if run.onboard.gate is not gates[-1]:
            gates.append(run.onboard.gate)
    assert [dict(gate.counts) for gate in gates] == [{}] * len(gates)
    assert run.told.taken > 0
    assert run.told.setpoints > 1000
    assert sum(run.told.troubles.values()) > 1
