"""The gate refuses nothing in honest flights, also not with faults of the vehicle and actions of the
pilot."""

from __future__ import annotations

from itertools import product

import pytest

from companion.events import Firmware
from sitl_mocks.examinations.faults import Fault
from sitl_mocks.examinations.flights import Flights

SECONDS = 200.0
TROUBLES = (
    Fault("mission", 60.0, numbers=(2.0,)),
    Fault("mode", 90.0, modes=("rtl",)),
    Fault("mode", 100.0, modes=("mission",)),
    Fault("sticks", 130.0, 5.0, (0.6, 0.0, 0.0)),
    Fault("gnss", 160.0, 4.0),
)


@pytest.mark.parametrize(("firmware", "use"), list(product(Firmware, ("guard", "fly"))))
def test_nothing_is_refused_in_an_honest_flight(firmware, use):
    flights = Flights(firmware, use, 2)
    for trouble in TROUBLES:
        flights.plan(trouble)
    while flights.now_s < SECONDS:
        flights.step()
    assert flights.onboard.gate.counts == {}
    assert flights.told.taken > 0
