"""CURRENT_MODE, by which PX4 tells its mode between two heartbeats: asked for, believed, and waited for."""

from __future__ import annotations

from typing import Any

import pytest

from companion.autopilot.wire import CURRENT_MODE
from companion.events import CurrentMode, FlightMode, ModeRefused, SetMode
from tests.companion.autopilot.conftest import Scripted

OFFBOARD, HOLD, MISSION, RETURN = 0x00060000, 0x03040000, 0x04040000, 0x05040000
EXTERNAL = SetMode(mode=FlightMode.EXTERNAL)


def asked(scripted: Scripted) -> list[int]:
    return [int(m.param1) for m in scripted.told("COMMAND_LONG") if m.command == 511]


def mode_requests(scripted: Scripted) -> list[Any]:
    return [m for m in scripted.told("COMMAND_LONG") if m.command == 176]


def asked_for_mode(scripted: Scripted, period_s: float) -> list[float]:
    """When CURRENT_MODE is asked for within half a minute, where it comes once in a period."""
    asked_at = []
    for step in range(1, 301):
        if step % 10 == 0:
            scripted.heartbeat(HOLD)
        if step % round(period_s * 10) == 0:
            scripted.current_mode(HOLD)
        scripted.after(0.1)
        if CURRENT_MODE in asked(scripted):
            asked_at.append(step / 10)
    return asked_at


def test_px4_is_asked_for_its_mode_in_twentieths_of_a_second() -> None:
    scripted = Scripted(autopilot=12)
    scripted.heartbeat(HOLD)
    scripted.after(0.0)
    requests = [m for m in scripted.told("COMMAND_LONG") if m.command == 511 and m.param1 == CURRENT_MODE]
    assert [m.param2 for m in requests] == [50_000.0]


def test_a_mode_that_comes_twice_a_second_is_not_asked_for_again(px4: Scripted) -> None:
    assert asked_for_mode(px4, 0.5) == []


@pytest.mark.parametrize("period_s", [2.0, 1e3])
def test_a_mode_that_comes_as_unasked_or_never_is_asked_for_ever_more_rarely(
    px4: Scripted, period_s: float
) -> None:
    assert asked_for_mode(px4, period_s) == pytest.approx([2.0, 6.0, 14.0], abs=0.4)


def fresh(scripted: Scripted, gap_s: float = 0.5) -> Scripted:
    """CURRENT_MODE has come twice, the last one just now."""
    scripted.after(1.0)
    scripted.current_mode(HOLD)
    scripted.after(gap_s)
    scripted.current_mode(HOLD)
    scripted.told()
    return scripted


@pytest.mark.parametrize(
    ("gap_s", "old_s", "at_once"), [(0.5, 0.5, True), (0.5, 0.7, False), (2.0, 0.5, False)]
)
def test_the_first_try_goes_out_at_once_where_px4_tells_each_change(
    px4: Scripted, gap_s: float, old_s: float, at_once: bool
) -> None:
    """Every 2 s is how it comes unasked: then a change is not told at once."""
    fresh(px4, gap_s).after(old_s)
    px4.link.send(EXTERNAL, px4.now_s)
    assert len(mode_requests(px4)) == at_once


def test_a_try_waits_for_the_mode_that_may_follow_the_one_just_told(px4: Scripted) -> None:
    """PX4 tells the old mode once more as it takes the pilot's command, the new one an interval later."""
    fresh(px4)
    px4.link.send(EXTERNAL, px4.now_s)
    px4.after(0.05)
    assert mode_requests(px4) == []
    _, refused = px4.current_mode(RETURN)
    assert isinstance(refused, ModeRefused)
    assert "AUTO.LOITER to AUTO.RTL" in refused.reason
    px4.after(1.0)
    assert mode_requests(px4) == []
    fresh(px4)
    px4.link.send(EXTERNAL, px4.now_s)
    px4.after(0.11)
    assert len(mode_requests(px4)) == 1


@pytest.mark.parametrize("ahead_s", [0.0, 0.02, 0.05])
def test_current_mode_without_end_holds_no_try_back(px4: Scripted, ahead_s: float) -> None:
    """PX4 tells its mode with every command that it takes, as of a gimbal that is turned all the time."""
    fresh(px4)
    for _ in range(10):
        px4.after(0.05)
        px4.current_mode(HOLD)
    px4.after(ahead_s)
    px4.link.send(EXTERNAL, px4.now_s)
    for _ in range(5):
        px4.after(0.05 - ahead_s)
        px4.current_mode(HOLD)
        px4.after(ahead_s)
    assert len(mode_requests(px4)) == 1


def test_current_mode_without_end_hides_no_choice_of_the_pilot(px4: Scripted) -> None:
    """The old mode is told as his command is taken, the new one an interval later."""
    fresh(px4)
    for _ in range(3):
        px4.after(0.05)
        px4.current_mode(HOLD)
    px4.link.send(EXTERNAL, px4.now_s)
    px4.after(0.09)
    px4.current_mode(HOLD)
    px4.after(0.06)
    assert mode_requests(px4) == []
    assert isinstance(px4.current_mode(RETURN)[1], ModeRefused)
    px4.after(1.0)
    assert mode_requests(px4) == []


def test_a_mode_that_takes_anothers_place_is_asked_for_though_it_shows(px4: Scripted) -> None:
    """The mission was asked for and is not entered yet, as another aircraft comes: OFFBOARD shows, and would
    be left."""
    px4.heartbeat(OFFBOARD)
    px4.link.send(SetMode(mode=FlightMode.MISSION), px4.now_s)
    px4.after(0.03)
    px4.current_mode(OFFBOARD)
    assert [m.param3 for m in mode_requests(px4)] == [4]
    px4.link.send(EXTERNAL, px4.now_s)
    px4.after(0.05)
    px4.current_mode(OFFBOARD)
    px4.current_mode(MISSION)
    px4.after(0.2)
    assert [m.param2 for m in mode_requests(px4)] == [6]


def test_current_mode_confirms_like_a_heartbeat(px4: Scripted) -> None:
    px4.link.send(EXTERNAL, px4.now_s)
    assert len(mode_requests(px4)) == 1
    px4.current_mode(HOLD)
    px4.after(0.05)
    assert px4.current_mode(OFFBOARD) == [CurrentMode(custom_mode=OFFBOARD)]
    assert px4.after(2.0) == []
    assert mode_requests(px4) == []


def test_current_mode_is_the_vehicles_own_or_nothing(px4: Scripted) -> None:
    assert Scripted(autopilot=12).current_mode(RETURN) == []
    assert px4.current_mode(RETURN, system=2) == []
    assert px4.current_mode(RETURN, component=191) == []
    assert px4.current_mode(RETURN, damaged=True) == []
    px4.link.send(EXTERNAL, px4.now_s)
    assert len(mode_requests(px4)) == 1


def test_current_mode_keeps_no_link_alive(px4: Scripted) -> None:
    for _ in range(40):
        px4.after(0.1)
        px4.current_mode(HOLD)
    px4.told()
    for _ in range(100):
        px4.after(0.1)
        px4.current_mode(HOLD)
    assert asked(px4) == []
    px4.heartbeat(HOLD)
    assert px4.link.counts.drops == 1
