"""Who is listened to."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.config import VehicleConfig
from companion.events import (
    Firmware,
    FlightMode,
    Heartbeat,
    ModeRefused,
    SecondCompanion,
    SetMode,
    TwoAutopilots,
    VelocitySetpoint,
)
from tests.companion.autopilot.conftest import Scripted

GUIDED = 4


def test_takes_the_first_autopilot_and_its_system_id() -> None:
    scripted = Scripted()
    events = scripted.heartbeat(GUIDED, system=42, base_mode=129)
    assert events == [
        Heartbeat(
            system_id=42,
            firmware=Firmware.ARDUPILOT,
            vehicle_type=2,
            custom_mode=GUIDED,
            mode=FlightMode.EXTERNAL,
            armed=True,
        )
    ]
    assert scripted.link.vehicle is not None
    assert scripted.link.vehicle.system_id == 42
    scripted.after(0.0)
    told = scripted.told()
    assert {m.get_srcSystem() for m in told} == {42}
    assert {m.target_system for m in told if m.get_type() == "COMMAND_LONG"} == {42}


def test_a_vehicle_with_the_system_id_of_all_is_not_commanded() -> None:
    """Every vehicle on the link would have obeyed what it was sent."""
    scripted = Scripted()
    scripted.heartbeat(system=0)
    assert scripted.link.vehicle is not None
    assert scripted.link.vehicle.refusal is not None
    assert "system id is 0" in scripted.link.vehicle.refusal
    scripted.link.send(SetMode(mode=FlightMode.HOLD), scripted.now_s)
    scripted.link.send(VelocitySetpoint(velocity_ned_mps=(1.0, 0.0, 0.0)), scripted.now_s)
    (refused,) = scripted.after(0.0)
    assert isinstance(refused, ModeRefused)
    assert scripted.told("SET_POSITION_TARGET_LOCAL_NED") == []


def test_ground_stations_companions_and_foreign_components_are_never_the_vehicle() -> None:
    scripted = Scripted()
    station = mavlink.MAVLink_heartbeat_message(6, 8, 81, 4, 4, 3)
    onboard = mavlink.MAVLink_heartbeat_message(18, 8, 81, 4, 4, 3)
    posing = mavlink.MAVLink_heartbeat_message(6, 3, 81, 4, 4, 3)
    autopilot = mavlink.MAVLink_heartbeat_message(2, 3, 81, 4, 4, 3)
    for message, system, component in [
        (station, 255, 190),
        (station, 255, 1),
        (onboard, 1, 191),
        (posing, 9, 1),
        (autopilot, 1, 100),
    ]:
        assert scripted.says(message, system=system, component=component) == []
    assert scripted.link.vehicle is None
    assert scripted.link.counts.foreign == 5


def test_autopilots_that_we_do_not_know_are_told_and_not_taken() -> None:
    scripted = Scripted(autopilot=0)
    assert scripted.heartbeat() == []
    assert scripted.link.vehicle is None
    assert scripted.link.last_bad is not None
    assert "neither ArduPilot (3) nor PX4 (12)" in scripted.link.last_bad


def test_a_configured_system_id_waits_for_that_vehicle() -> None:
    scripted = Scripted(config=VehicleConfig(system_id=7))
    assert scripted.heartbeat(system=3) == []
    scripted.after(0.0)
    assert scripted.told()[0].get_srcSystem() == 7
    assert len(scripted.heartbeat(system=7)) == 1


def test_a_forwarded_frame_that_comes_first_does_not_settle_whose_vehicle_it_is() -> None:
    """One frame of a neighbour, forwarded by somebody; from then on only our own vehicle speaks."""
    scripted = Scripted()
    scripted.heartbeat(system=2)
    assert scripted.link.unclear is None
    events = []
    for _ in range(100):
        events += scripted.heartbeat(system=1) + scripted.after(1.0)
    text = "two autopilots on this link (systems 1 and 2): set vehicle.system_id"
    assert events == [TwoAutopilots(reason=text)], "told once"
    assert scripted.link.unclear == text


def test_which_of_two_autopilots_spoke_first_makes_no_difference(ardupilot: Scripted) -> None:
    (event,) = ardupilot.heartbeat(system=2)
    assert event == TwoAutopilots(
        reason="two autopilots on this link (systems 1 and 2): set vehicle.system_id"
    )
    # What they tell is kept apart all the same.
    assert ardupilot.says(ardupilot.position(1000), system=2) == []
    assert len(ardupilot.says(ardupilot.position(1000))) == 1


def test_a_configured_vehicle_is_clear_whoever_else_speaks() -> None:
    scripted = Scripted(config=VehicleConfig(system_id=7))
    for _ in range(3):
        assert scripted.heartbeat(system=3) == []
        assert len(scripted.heartbeat(system=7)) == 1
    assert scripted.link.unclear is None


@pytest.mark.parametrize(
    ("vehicle_type", "autopilot", "system", "component"),
    [(6, 8, 255, 190), (6, 8, 255, 1), (6, 3, 9, 1), (18, 8, 2, 191), (2, 3, 2, 100), (2, 3, 1, 2)],
)
def test_only_a_second_autopilot_makes_it_unclear(
    ardupilot: Scripted, vehicle_type: int, autopilot: int, system: int, component: int
) -> None:
    message = mavlink.MAVLink_heartbeat_message(vehicle_type, autopilot, 81, 4, 4, 3)
    assert ardupilot.says(message, system=system, component=component) == []
    assert ardupilot.link.unclear is None


def test_other_vehicles_and_components_are_ignored(ardupilot: Scripted) -> None:
    position = ardupilot.position(1000)
    assert ardupilot.says(position, system=2) == []
    assert ardupilot.says(position, component=220) == []
    assert ardupilot.says(position, system=255, component=190) == []
    assert ardupilot.link.counts.foreign == 3
    assert len(ardupilot.says(position)) == 1


def test_nothing_is_believed_before_the_first_heartbeat() -> None:
    scripted = Scripted()
    assert scripted.says(scripted.position(1000)) == []


@pytest.mark.parametrize("configured", [0, 1])
@pytest.mark.parametrize(
    ("apart_s", "period_s", "unclear"), [(60.0, 1.0, True), (5.0, 1.0, False), (60.0, 6.0, False)]
)
def test_two_clocks_under_one_system_id_make_it_unclear(configured, apart_s, period_s, unclear) -> None:
    """Both firmwares have the id 1 unless it was changed. One clock that jumps now and then is a vehicle that
    restarts, and a small step is a late message."""
    scripted = Scripted(config=VehicleConfig(system_id=configured))
    scripted.heartbeat(GUIDED)
    found = []
    for step in range(8):
        scripted.now_s += period_s
        boot_s = 500.0 + scripted.now_s + apart_s * (step % 2)
        found += scripted.says(mavlink.MAVLink_system_time_message(0, round(1e3 * boot_s)))
    told = [event for event in found if isinstance(event, TwoAutopilots)]
    assert [event.reason for event in told] == [
        "two autopilots with system id 1 on this link: give each its own"
    ] * unclear
    assert (scripted.link.unclear is not None) is unclear


ARMED = 129
PLANE = 1


@pytest.mark.parametrize(("autopilot", "vehicle_type"), [(3, PLANE), (12, 2)])
def test_a_heartbeat_of_another_vehicle_under_our_id_says_nothing_about_ours(autopilot, vehicle_type) -> None:
    """It would end our authority in the middle of a conflict, as if the pilot had taken over."""
    scripted = Scripted()
    scripted.heartbeat(GUIDED, base_mode=ARMED)
    other = mavlink.MAVLink_heartbeat_message(vehicle_type, autopilot, ARMED, 0, 4, 3)
    (told,) = scripted.says(other)
    assert told == TwoAutopilots(reason="two autopilots with system id 1 on this link: give each its own")
    assert scripted.says(other) == []
    assert str(scripted.link.vehicle) == "ardupilot, system 1, MAV_TYPE 2"
    assert scripted.link.counts.foreign == 2
    (own,) = scripted.heartbeat(GUIDED, base_mode=ARMED)
    assert isinstance(own, Heartbeat)
    assert own.mode is FlightMode.EXTERNAL


@pytest.mark.parametrize(
    ("vehicle_type", "base_mode", "away_s"), [(PLANE, 1, 0.1), (0, ARMED, 0.1), (PLANE, ARMED, 3.5)]
)
def test_a_vehicle_may_become_another_one_on_the_ground_or_after_a_pause(
    vehicle_type, base_mode, away_s
) -> None:
    """FRAME_CLASS is set on the ground. ArduPilot is of the generic type while it starts."""
    scripted = Scripted()
    scripted.heartbeat(GUIDED, base_mode=base_mode)
    scripted.after(away_s)
    (event,) = scripted.heartbeat(0, vehicle_type=vehicle_type, base_mode=ARMED)
    assert isinstance(event, Heartbeat)
    assert event.mode is not FlightMode.EXTERNAL
    assert scripted.link.vehicle is not None
    assert scripted.link.vehicle.vehicle_type == vehicle_type
    assert scripted.link.unclear is None


SECOND = SecondCompanion(
    reason="another companion on this link has our system id 1 and component id 191: "
    "stop one, or set its vehicle.component_id"
)


def seconds(scripted: Scripted, number: int, *others: Scripted) -> list[SecondCompanion]:
    """What is told while each link hears what all others send, once a second."""
    events = []
    for _ in range(number):
        for link in others:
            events += scripted.link.receive(link.link.drain(), scripted.now_s)
            link.heartbeat(GUIDED)
            link.after(1.0)
        scripted.heartbeat(GUIDED)
        events += scripted.after(1.0)
    return [event for event in events if isinstance(event, SecondCompanion)]


def test_a_second_companion_under_our_id_is_told_once_and_again_when_it_is_gone(ardupilot: Scripted) -> None:
    """Both would command the vehicle."""
    assert seconds(ardupilot, 2, Scripted()) == []
    other = Scripted()
    seconds(other, 30)
    assert seconds(ardupilot, 30, other) == [SECOND]
    assert seconds(ardupilot, 20) == [SecondCompanion()]
    assert seconds(ardupilot, 30, other) == [SECOND]


@pytest.mark.parametrize("late_s", [0, 1, 4])
def test_our_own_frames_that_a_router_sends_back_are_no_second_companion(
    ardupilot: Scripted, late_s: int
) -> None:
    sent = [b""] * late_s
    for _ in range(60):
        sent.append(ardupilot.link.drain())
        assert ardupilot.link.receive(sent[-1 - late_s], ardupilot.now_s) == []
        ardupilot.heartbeat(GUIDED)
        assert not [e for e in ardupilot.after(1.0) if isinstance(e, SecondCompanion)]


def test_what_is_left_of_our_own_former_process_is_no_second_companion(ardupilot: Scripted) -> None:
    former = Scripted()
    seconds(former, 30)
    assert seconds(ardupilot, 2, former) == []
    assert seconds(ardupilot, 30) == []


def test_late_copies_of_messages_are_no_reboots(ardupilot: Scripted) -> None:
    """After a reboot all streams and parameters are requested again. A second path, 1.5 s slower than the
    first, would fill the link with requests."""
    for k in range(100):
        ardupilot.after(0.1)
        if k % 10 == 0:
            ardupilot.heartbeat()
        ardupilot.says(ardupilot.position(60_000 + 100 * k), ardupilot.position(58_500 + 100 * k))
    assert ardupilot.link.counts.reboots == 0
    assert ardupilot.link.counts.stream_requests < 50
