"""Modes and speeds that the vehicle is asked for."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.events import (
    FlightMode,
    Heartbeat,
    ModeRefused,
    SetMode,
    SetSpeed,
)
from tests.companion.autopilot.conftest import Scripted

GUIDED, LOITER, BRAKE, RTL = 4, 5, 17, 6
OFFBOARD = 0x00060000
EXTERNAL = SetMode(mode=FlightMode.EXTERNAL)


def ack(
    result: int, command: int = 176, system: int = 0, component: int = 0
) -> mavlink.MAVLink_command_ack_message:
    return mavlink.MAVLink_command_ack_message(command, result, 0, 0, system, component)


def mode_requests(scripted: Scripted) -> list[mavlink.MAVLink_command_long_message]:
    return [m for m in scripted.told("COMMAND_LONG") if m.command == 176]


def test_mode_parameters_of_both_firmwares(ardupilot: Scripted, px4: Scripted) -> None:
    for scripted, params in ((ardupilot, (1, 4, 0)), (px4, (1, 6, 0))):
        scripted.link.send(EXTERNAL, scripted.now_s)
        scripted.heartbeat(0x03040000 if scripted is px4 else 0)
        scripted.after(0.05)
        (request,) = mode_requests(scripted)
        assert (request.param1, request.param2, request.param3) == params
        assert (request.target_system, request.target_component, request.confirmation) == (1, 1, 0)


def test_hold_on_ardupilot_is_brake(ardupilot: Scripted) -> None:
    ardupilot.link.send(SetMode(mode=FlightMode.HOLD), ardupilot.now_s)
    ardupilot.heartbeat()
    ardupilot.after(0.05)
    assert mode_requests(ardupilot)[0].param2 == BRAKE


def test_a_heartbeat_confirms_and_ends_the_retries(ardupilot: Scripted) -> None:
    ardupilot.link.send(EXTERNAL, ardupilot.now_s)
    ardupilot.heartbeat()
    ardupilot.after(1.0)
    assert [m.confirmation for m in mode_requests(ardupilot)] == [0, 1]
    assert [type(e) for e in ardupilot.heartbeat(GUIDED)] == [Heartbeat]
    assert ardupilot.after(10.0) == []
    assert mode_requests(ardupilot) == []


def test_an_accepted_command_without_the_mode_is_refused(px4: Scripted) -> None:
    px4.link.send(EXTERNAL, px4.now_s)
    px4.says(ack(0))
    events = []
    tries = []
    for _ in range(60):
        px4.heartbeat(0x03040000)
        events += px4.after(0.1)
        tries += [m.confirmation for m in mode_requests(px4)]
    (refused,) = events
    assert isinstance(refused, ModeRefused)
    assert refused.mode is FlightMode.EXTERNAL
    assert "accepted" in refused.reason
    assert "AUTO.LOITER" in refused.reason
    assert tries == [0, 1, 2, 3, 4]


def test_a_refusal_gives_the_answer_and_the_vehicles_words(ardupilot: Scripted) -> None:
    ardupilot.link.send(EXTERNAL, ardupilot.now_s)
    text = mavlink.MAVLink_statustext_message(4, b"Mode change to GUIDED failed: requires position", 0, 0)
    ardupilot.says(ack(4), text)
    refused = [e for _ in range(6) for e in ardupilot.after(1.0)]
    assert len(refused) == 1
    assert isinstance(refused[0], ModeRefused)
    assert "failed" in refused[0].reason
    assert "requires position" in refused[0].reason


def test_silence_is_refused_as_no_answer(ardupilot: Scripted) -> None:
    ardupilot.link.send(EXTERNAL, ardupilot.now_s)
    (refused,) = [e for _ in range(6) for e in ardupilot.after(1.0)]
    assert isinstance(refused, ModeRefused)
    assert "no answer" in refused.reason


@pytest.mark.parametrize(
    ("vehicle", "old_s", "at_once"),
    [("ardupilot", 1.4, True), ("ardupilot", 1.6, False), ("px4", 0.05, True), ("px4", 0.15, False)],
)
def test_the_first_try_goes_out_at_once_where_the_mode_is_known(
    request: pytest.FixtureRequest, vehicle: str, old_s: float, at_once: bool
) -> None:
    """ArduPilot says a new mode at once, PX4 within a second: there only what it has just said is known."""
    scripted: Scripted = request.getfixturevalue(vehicle)
    scripted.after(old_s)
    scripted.told()
    scripted.link.send(EXTERNAL, scripted.now_s)
    assert len(mode_requests(scripted)) == at_once
    scripted.heartbeat(0x03040000 if vehicle == "px4" else 0)
    scripted.after(1.0)
    # After the heartbeat that shows that nobody has chosen: the second, or the first.
    assert [m.confirmation for m in mode_requests(scripted)] == [int(at_once)]


@pytest.mark.parametrize("vehicle", ["ardupilot", "px4"])
def test_no_try_without_a_heartbeat_that_shows_nobody_else_has_chosen(
    request: pytest.FixtureRequest, vehicle: str
) -> None:
    """A pilot's choice that has not been heard yet is never overwritten: not by the first try either."""
    scripted: Scripted = request.getfixturevalue(vehicle)
    scripted.after(2.0)
    scripted.told()
    scripted.link.send(EXTERNAL, scripted.now_s)
    for _ in range(29):
        assert scripted.after(0.1) == []
    assert mode_requests(scripted) == []
    (refused,) = scripted.after(0.2)
    assert isinstance(refused, ModeRefused)
    assert "no heartbeat" in refused.reason


def test_the_pilots_choice_ends_a_request_at_once(ardupilot: Scripted) -> None:
    ardupilot.link.send(EXTERNAL, ardupilot.now_s)
    mode_requests(ardupilot)
    _, refused = ardupilot.heartbeat(RTL)
    assert isinstance(refused, ModeRefused)
    assert "STABILIZE to RTL" in refused.reason
    assert ardupilot.after(1.5) == []
    assert mode_requests(ardupilot) == []


def test_a_cancelled_request_is_not_sent_any_more(ardupilot: Scripted) -> None:
    ardupilot.link.send(EXTERNAL, ardupilot.now_s)
    ardupilot.told()
    ardupilot.link.cancel_mode()
    for _ in range(5):
        ardupilot.heartbeat()
        assert ardupilot.after(1.0) == []
    assert mode_requests(ardupilot) == []


@pytest.mark.parametrize(("later_s", "asked"), [(0.5, [3.0]), (4.0, [])])
def test_a_cancelled_request_that_is_entered_yet_is_not_the_pilots_choice(
    px4: Scripted, later_s: float, asked: list[float]
) -> None:
    """Sticks that move while the vehicle is being taken: OFFBOARD shows after POSCTL is asked for."""
    px4.link.send(EXTERNAL, px4.now_s)
    px4.told()
    for _ in range(round(later_s / 0.5)):
        px4.link.cancel_mode()
        px4.after(0.5)
    px4.heartbeat(0x03040000)
    px4.after(0.2)
    px4.told()
    px4.link.send(SetMode(mode=FlightMode.STICKS), px4.now_s)
    px4.heartbeat(OFFBOARD)
    px4.after(0.05)
    assert [m.param2 for m in mode_requests(px4)] == asked


def test_a_newer_mode_replaces_an_older(ardupilot: Scripted) -> None:
    ardupilot.link.send(EXTERNAL, ardupilot.now_s)
    ardupilot.link.send(SetMode(mode=FlightMode.HOLD), ardupilot.now_s)
    mode_requests(ardupilot)
    # The older request took effect first: that is nobody else's choice.
    assert len(ardupilot.heartbeat(GUIDED)) == 1
    ardupilot.after(1.0)
    assert [m.param2 for m in mode_requests(ardupilot)] == [BRAKE]
    assert len(ardupilot.heartbeat(BRAKE)) == 1
    assert ardupilot.after(9.0) == []


def test_a_speed_that_comes_with_a_mode_follows_each_request_at_once(ardupilot: Scripted) -> None:
    """ArduPilot forgets it as the mode begins, and a leg begun without it overshoots it."""
    ardupilot.link.send(SetMode(mode=FlightMode.MISSION, speed_mps=4.0), ardupilot.now_s)
    for _ in range(2):
        asked = [m for m in ardupilot.told("COMMAND_LONG") if m.command in (176, 178)]
        assert [m.command for m in asked] == [176, 178]
        assert (asked[1].param1, asked[1].param2, asked[1].param3) == (1.0, 4.0, -1.0)
        ardupilot.after(1.0)
        assert 178 not in {m.command for m in ardupilot.told("COMMAND_LONG")}, "not before the mode"
        ardupilot.heartbeat()
        ardupilot.after(0.05)
    ardupilot.told()
    ardupilot.link.send(SetMode(mode=FlightMode.HOLD), ardupilot.now_s)
    ardupilot.heartbeat()
    ardupilot.after(0.05)
    assert 178 not in {m.command for m in ardupilot.told("COMMAND_LONG")}


def speeds(scripted: Scripted) -> int:
    return sum(m.command == 178 for m in scripted.told("COMMAND_LONG"))


AUTO = 3


def flying_its_mission(scripted: Scripted) -> None:
    """In AUTO, its speed asked for once and not answered."""
    scripted.heartbeat(AUTO)
    scripted.told()
    scripted.link.send(SetSpeed(speed_mps=4.0), scripted.now_s)
    scripted.after(0.05)
    assert speeds(scripted) == 1


def test_a_missions_speed_is_asked_for_five_times(ardupilot: Scripted) -> None:
    flying_its_mission(ardupilot)
    for _ in range(10):
        ardupilot.heartbeat(AUTO)
        ardupilot.after(1.0)
    assert speeds(ardupilot) == 4


def test_a_missions_speed_is_not_asked_for_once_it_is_answered(ardupilot: Scripted) -> None:
    flying_its_mission(ardupilot)
    ardupilot.says(ack(0, command=178))
    ardupilot.heartbeat(AUTO)
    ardupilot.after(1.0)
    assert speeds(ardupilot) == 0


@pytest.mark.parametrize("how", ["another mode", "given up", "taken"])
def test_a_missions_speed_is_not_asked_for_once_another_flies(ardupilot: Scripted, how: str) -> None:
    """Such as the pilot, who took over before it was answered, and selects AUTO again himself."""
    flying_its_mission(ardupilot)
    if how == "another mode":
        ardupilot.heartbeat(LOITER)
    elif how == "given up":
        ardupilot.link.cancel_mode()
    else:
        ardupilot.link.send(EXTERNAL, ardupilot.now_s)
    ardupilot.after(0.95)
    ardupilot.heartbeat(AUTO)
    for _ in range(6):
        ardupilot.after(1.0)
        ardupilot.heartbeat(AUTO)
    assert speeds(ardupilot) == 0


def test_acknowledgements_for_others_are_not_ours(ardupilot: Scripted) -> None:
    ardupilot.link.send(EXTERNAL, ardupilot.now_s)
    ardupilot.says(ack(0, system=255, component=190))
    (refused,) = [e for _ in range(6) for e in ardupilot.after(1.0)]
    assert isinstance(refused, ModeRefused)
    assert "no answer" in refused.reason
    assert ardupilot.link.counts.foreign == 1


def test_no_vehicle_no_mode() -> None:
    scripted = Scripted()
    scripted.link.send(EXTERNAL, 0.0)
    (refused,) = scripted.after(0.0)
    assert isinstance(refused, ModeRefused)
    assert "no vehicle" in refused.reason


def test_other_is_no_mode_to_ask_for(ardupilot: Scripted) -> None:
    with pytest.raises(ValueError):
        ardupilot.link.send(SetMode(mode=FlightMode.OTHER), ardupilot.now_s)


@pytest.mark.parametrize(("gap_s", "asked"), [(0.15, 1), (0.25, 2)])
def test_after_a_backlog_the_vehicle_is_asked_for_its_mode_five_times_a_second(
    ardupilot: Scripted, gap_s: float, asked: int
) -> None:
    for _ in range(2):
        ardupilot.link.begin_step(ardupilot.now_s, behind=True)
        ardupilot.now_s += gap_s
    wanted = [m for m in ardupilot.told("COMMAND_LONG") if m.command == 512]
    assert [m.param1 for m in wanted] == [0.0] * asked  # HEARTBEAT


def test_without_a_backlog_or_a_vehicle_no_mode_is_asked_for(ardupilot: Scripted) -> None:
    nobody = Scripted()
    nobody.link.begin_step(nobody.now_s, behind=True)
    ardupilot.link.begin_step(ardupilot.now_s, behind=False)
    assert nobody.told("COMMAND_LONG") == ardupilot.told("COMMAND_LONG") == []


def test_after_a_backlog_no_mode_is_asked_for_before_the_vehicle_shows_its_own(ardupilot: Scripted) -> None:
    """The pilot may have selected another mode meanwhile."""
    ardupilot.link.begin_step(ardupilot.now_s, behind=True)
    ardupilot.link.send(EXTERNAL, ardupilot.now_s)
    ardupilot.after(0.05)
    assert mode_requests(ardupilot) == []
    ardupilot.heartbeat()
    ardupilot.after(0.05)
    assert len(mode_requests(ardupilot)) == 1
    ardupilot.heartbeat()
    ardupilot.link.begin_step(ardupilot.now_s, behind=True)
    ardupilot.after(1.05)
    assert mode_requests(ardupilot) == [], "the heartbeat since the first try may be old too"
    ardupilot.heartbeat()
    ardupilot.after(0.05)
    assert len(mode_requests(ardupilot)) == 1
