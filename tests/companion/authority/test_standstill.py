"""How long a released vehicle is commanded to stand still."""

from __future__ import annotations

import pytest

from companion.authority.standstill import Standstill
from companion.events import FlightMode

EXTERNAL, MISSION, HOLD, OTHER = (
    FlightMode.EXTERNAL,
    FlightMode.MISSION,
    FlightMode.HOLD,
    FlightMode.OTHER,
)


def begun(mode, sticks=False):
    made = Standstill()
    assert not made.lasts(0.0, EXTERNAL)
    made.begin(0.0, mode, sticks=sticks)
    return made


@pytest.mark.parametrize(("sticks", "for_s"), [(False, 3.0), (True, 10.0)])
def test_it_ends_by_itself(sticks, for_s):
    made = begun(EXTERNAL, sticks)
    assert made.lasts(for_s - 0.1, EXTERNAL)
    assert not made.lasts(for_s, EXTERNAL)


@pytest.mark.parametrize(
    ("begun_in", "shown", "lasts"),
    [
        (EXTERNAL, [EXTERNAL, EXTERNAL], True),
        (EXTERNAL, [HOLD, EXTERNAL], False),
        (EXTERNAL, [OTHER, EXTERNAL], False),
        (MISSION, [MISSION, EXTERNAL], True),
        (MISSION, [EXTERNAL, MISSION, EXTERNAL], False),
        (MISSION, [OTHER, MISSION, EXTERNAL], False),
    ],
)
def test_any_mode_that_shows_ends_it_for_good(begun_in, shown, lasts):
    made = begun(begun_in)
    for mode in shown:
        made.see(mode)
    assert made.lasts(0.5, EXTERNAL) is lasts


def test_only_in_our_mode_is_anything_commanded():
    made = begun(MISSION)
    made.see(MISSION)
    assert not made.lasts(0.5, MISSION)
    assert made.lasts(0.5, EXTERNAL)
