"""What counts as a pilot who moves the sticks."""

from __future__ import annotations

import pytest

from companion.authority.sticks import Sticks
from companion.events import RcChannels


def shown(sticks, *positions):
    """Whether they count as moved after each message; None: no remote control."""
    found = []
    for position in positions:
        sticks.note_channels(RcChannels(sticks_us=position))
        found.append(sticks.moved)
    return found


REST = (1500, 1480, 1510)


def resting():
    sticks = Sticks()
    sticks.note_channels(RcChannels(sticks_us=REST))
    sticks.begin()
    return sticks


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("by_us", "moved"), [(100, False), (101, True), (-100, False), (-101, True)])
def test_more_than_a_fifth_of_the_travel_on_any_axis_in_two_messages(axis, by_us, moved):
    there = tuple(us + (by_us if number == axis else 0) for number, us in enumerate(REST))
    assert shown(resting(), there, there, there) == [False, moved, moved]


def test_a_single_message_is_a_glitch():
    away = (1900, *REST[1:])
    assert shown(resting(), away, REST, away, REST) == [False] * 4
    assert shown(resting(), away, None, away) == [False] * 3


def test_sticks_that_return_are_at_rest():
    away = (1900, *REST[1:])
    assert shown(resting(), away, away, REST) == [False, True, False]


def test_they_rest_where_they_were_when_the_vehicle_was_taken():
    held = (1700, 1480, 1510)
    sticks = resting()
    assert shown(sticks, held, held) == [False, True]
    sticks.begin()
    assert not sticks.moved
    assert shown(sticks, held, held) == [False, False]
    assert shown(sticks, REST, REST) == [False, True]


def test_without_a_position_before_the_first_one_is_where_they_rest():
    sticks = Sticks()
    sticks.begin()
    assert shown(sticks, None, REST, REST, (1900, 1480, 1510), (1900, 1480, 1510)) == [False] * 4 + [True]
