from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.link import MAX_QUEUED_BYTES, AutopilotLink
from companion.autopilot.streams import FIRMWARE_OF, STREAM_RATES_HZ
from companion.config import VehicleConfig
from companion.events import (
    AdsbVehicle,
    Broadcast,
    Firmware,
    FlightMode,
    GlobalPosition,
    Heartbeat,
    ModeRefused,
    Say,
    SetMode,
    SetSpeed,
    Severity,
    Threat,
    TwoAutopilots,
    VehicleText,
    VelocitySetpoint,
)

from .conftest import Scripted

GUIDED, LOITER, BRAKE, RTL = 4, 5, 17, 6
OFFBOARD = 0x00060000
EXTERNAL = SetMode(mode=FlightMode.EXTERNAL)
NORTH = VelocitySetpoint(velocity_ned_mps=(3.0, 0.0, 0.0))

ARDUPILOT_RATES_HZ = {
    number: rate for number, rate in STREAM_RATES_HZ.items() if FIRMWARE_OF.get(number) is not Firmware.PX4
}
"""What the other firmware alone sends is not asked for."""


def ack(
    result: int, command: int = 176, system: int = 0, component: int = 0
) -> mavlink.MAVLink_command_ack_message:
    return mavlink.MAVLink_command_ack_message(command, result, 0, 0, system, component)


# ---------------------------------------------------------------- who is listened to


def test_speaks_first_as_a_companion_and_never_as_the_ground_station() -> None:
    scripted = Scripted()
    scripted.after(0.0)
    (beat,) = scripted.told()
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (1, 191)
    assert (beat.type, beat.autopilot) == (18, 8)


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


def test_bad_values_are_counted_and_do_not_stop_the_rest(ardupilot: Scripted) -> None:
    nan = mavlink.MAVLink_local_position_ned_message(1, math.nan, 0, 0, 0, 0, 0)
    events = ardupilot.says(nan, ardupilot.position(1000, lat=2**31 - 1), ardupilot.position(1000))
    assert [type(e) for e in events] == [GlobalPosition]
    assert ardupilot.link.counts.bad_values == 2
    assert "is not on Earth" in str(ardupilot.link.last_bad)


def test_messages_that_nobody_needs_are_counted(ardupilot: Scripted) -> None:
    assert ardupilot.says(mavlink.MAVLink_attitude_message(1, 0, 0, 0, 0, 0, 0)) == []
    assert ardupilot.link.counts.unneeded == 1


def test_position_before_the_vehicle_knows_it_is_no_event(ardupilot: Scripted) -> None:
    assert ardupilot.says(ardupilot.position(1000, lat=0, lon=0)) == []
    assert ardupilot.link.counts.no_position == 1


@pytest.mark.parametrize("vehicle_type", [1, 10, 12, 22])
def test_unsupported_vehicles_are_read_but_never_commanded(vehicle_type: int) -> None:
    scripted = Scripted()
    (beat,) = scripted.heartbeat(GUIDED, vehicle_type=vehicle_type)
    assert isinstance(beat, Heartbeat)
    assert beat.mode is FlightMode.OTHER
    assert scripted.says(scripted.position(1))
    scripted.link.send(NORTH, scripted.now_s)
    scripted.link.send(EXTERNAL, scripted.now_s)
    (refused,) = scripted.after(0.0)
    assert isinstance(refused, ModeRefused)
    assert "not supported" in refused.reason
    assert scripted.told("SET_POSITION_TARGET_LOCAL_NED") == []
    assert scripted.link.counts.setpoints_dropped == 1


# ---------------------------------------------------------------- streams


def test_own_heartbeat_once_a_second(ardupilot: Scripted) -> None:
    for _ in range(200):
        ardupilot.after(0.05)
    assert len(ardupilot.told("HEARTBEAT")) == 10


def asked(scripted: Scripted) -> list[int]:
    return [int(m.param1) for m in scripted.told("COMMAND_LONG") if m.command == 511]


def test_streams_are_asked_for_once_the_vehicle_is_known() -> None:
    scripted = Scripted()
    scripted.after(0.0)
    assert asked(scripted) == []
    scripted.heartbeat()
    scripted.after(0.1)
    requests = [m for m in scripted.told("COMMAND_LONG") if m.command == 511]
    assert {int(m.param1): 1e6 / m.param2 for m in requests} == pytest.approx(ARDUPILOT_RATES_HZ)
    assert {m.param3 for m in requests} == {0.0}


def test_streams_that_arrive_are_not_asked_for_again(ardupilot: Scripted) -> None:
    for step in range(300):
        if step % 10 == 0:
            ardupilot.heartbeat()
        ardupilot.says(ardupilot.position(1000 + 100 * step))
        ardupilot.after(0.1)
    assert mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT not in asked(ardupilot)


def test_a_refusing_vehicle_is_asked_ever_more_rarely(ardupilot: Scripted) -> None:
    asked_at = []
    for step in range(1200):
        if step % 10 == 0:
            ardupilot.heartbeat()
        ardupilot.after(0.1)
        if mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT in asked(ardupilot):
            asked_at.append(step / 10)
    gaps = [round(b - a) for a, b in itertools.pairwise(asked_at)]
    assert gaps[:3] == [4, 8, 16]
    assert max(gaps) <= 31
    assert len(asked_at) <= 7


def test_a_stream_at_a_fraction_of_its_rate_is_asked_for_again(ardupilot: Scripted) -> None:
    for step in range(30):
        if step % 10 == 0:
            ardupilot.heartbeat()
            ardupilot.says(ardupilot.position(1000 + 100 * step))
        ardupilot.after(0.1)
    assert mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT in asked(ardupilot)


def test_a_reboot_forgets_rates_so_they_are_asked_for_at_once(ardupilot: Scripted) -> None:
    ardupilot.says(ardupilot.position(60_000))
    ardupilot.after(0.5)
    ardupilot.says(ardupilot.position(59_950))
    ardupilot.after(0.1)
    assert asked(ardupilot) == []
    ardupilot.says(ardupilot.position(400))
    ardupilot.after(0.1)
    assert set(asked(ardupilot)) == set(ARDUPILOT_RATES_HZ)
    assert ardupilot.link.counts.reboots == 1


def test_a_dropped_link_is_not_talked_at_and_asked_again_when_it_returns(ardupilot: Scripted) -> None:
    ardupilot.after(3.5)
    ardupilot.told()
    for _ in range(100):
        ardupilot.after(0.5)
    assert asked(ardupilot) == []
    ardupilot.heartbeat()
    ardupilot.after(0.1)
    assert set(asked(ardupilot)) == set(ARDUPILOT_RATES_HZ)
    assert ardupilot.link.counts.drops == 1


ADSB = mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE


def adsb(flags: int = 3, icao: int = 0x4B1234) -> mavlink.MAVLink_adsb_vehicle_message:
    return mavlink.MAVLink_adsb_vehicle_message(
        icao, 473970000, 85450000, 0, 500_000, 0, 0, 0, b"", 1, 0, flags, 0
    )


def asked_for_traffic(scripted: Scripted, *, traffic_at_s: float) -> list[float]:
    """When ADSB_VEHICLE is asked for within a minute, with one report at `traffic_at_s`."""
    asked_at = []
    for step in range(1, 601):
        if step % 10 == 0:
            scripted.heartbeat()
        if step == round(traffic_at_s * 10):
            scripted.says(adsb())
        scripted.after(0.1)
        if ADSB in asked(scripted):
            asked_at.append(step / 10)
    return asked_at


def test_traffic_is_asked_for_three_times_and_then_silence_is_believed(ardupilot: Scripted) -> None:
    # The first time was when the vehicle was first heard.
    assert asked_for_traffic(ardupilot, traffic_at_s=1e9) == pytest.approx([2.0, 6.0], abs=0.3)


def test_traffic_that_comes_is_not_asked_for_again(ardupilot: Scripted) -> None:
    assert asked_for_traffic(ardupilot, traffic_at_s=1.0) == []
    scripted = Scripted()
    assert asked_for_traffic(scripted, traffic_at_s=5.0) == pytest.approx([1.0, 3.0], abs=0.3)


# ---------------------------------------------------------------- traffic


def test_traffic_is_taken_from_the_autopilot_alone(ardupilot: Scripted) -> None:
    (event,) = ardupilot.says(adsb())
    assert isinstance(event, AdsbVehicle)
    assert event.icao == 0x4B1234
    # A receiver's own frames, as ArduPilot forwards them, and another vehicle's.
    assert ardupilot.says(adsb(), component=156) == []
    assert ardupilot.says(adsb(), system=2) == []
    assert ardupilot.link.counts.foreign == 2
    assert ardupilot.says(adsb(flags=0)) == []
    assert ardupilot.link.counts.no_position == 1
    assert ardupilot.says(adsb(icao=2**24)) == []
    assert ardupilot.link.counts.bad_values == 1


def test_threats_are_told_as_collision(ardupilot: Scripted) -> None:
    threat = Threat(
        track_id="4b1234",
        adsb=True,
        level=1,
        acting=False,
        time_to_closest_s=20.0,
        horizontal_m=50.0,
        vertical_m=10.0,
    )
    ardupilot.link.send(threat, ardupilot.now_s)
    (told,) = ardupilot.told("COLLISION")
    assert (told.src, told.id, told.action, told.threat_level) == (0, 0x4B1234, 1, 1)
    assert (told.get_srcSystem(), told.get_srcComponent()) == (1, 191)


# ---------------------------------------------------------------- modes


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


# ---------------------------------------------------------------- setpoints and texts


def test_setpoint_on_the_vehicles_clock(ardupilot: Scripted) -> None:
    ardupilot.says(ardupilot.position(60_000))
    ardupilot.now_s += 0.25
    ardupilot.link.send(NORTH, ardupilot.now_s)
    (setpoint,) = ardupilot.told()
    assert setpoint.time_boot_ms == 60_250
    assert (setpoint.vx, setpoint.vy, setpoint.vz) == (3.0, 0.0, 0.0)
    assert (setpoint.type_mask, setpoint.coordinate_frame) == (0x9C7, 1)
    assert (setpoint.target_system, setpoint.target_component) == (1, 1)


def test_a_setpoint_leaves_once(ardupilot: Scripted) -> None:
    ardupilot.link.send(NORTH, ardupilot.now_s)
    assert len(ardupilot.told()) == 1
    ardupilot.after(0.1)
    assert ardupilot.told("SET_POSITION_TARGET_LOCAL_NED") == []


def test_only_the_newest_setpoint_leaves(ardupilot: Scripted) -> None:
    ardupilot.link.send(NORTH, ardupilot.now_s)
    ardupilot.link.send(VelocitySetpoint(velocity_ned_mps=(0.0, 1.0, 0.0)), ardupilot.now_s)
    (setpoint,) = ardupilot.told()
    assert setpoint.vy == 1.0
    assert ardupilot.link.counts.setpoints_dropped == 1


@pytest.mark.parametrize("bad", [math.nan, math.inf, 500.0])
def test_a_setpoint_that_is_no_velocity_is_our_bug(ardupilot: Scripted, bad: float) -> None:
    with pytest.raises(ValueError):
        ardupilot.link.send(VelocitySetpoint(velocity_ned_mps=(0.0, bad, 0.0)), ardupilot.now_s)
    assert ardupilot.link.drain() == b""


def test_commands_for_others_are_our_bug(ardupilot: Scripted) -> None:
    with pytest.raises(ValueError, match="Broadcast"):
        ardupilot.link.send(Broadcast(transport="wifi", messages=()), ardupilot.now_s)


def test_long_texts_are_chunked(ardupilot: Scripted) -> None:
    ardupilot.link.send(Say(severity=Severity.WARNING, text="a" * 70), ardupilot.now_s)
    first, second = ardupilot.told("STATUSTEXT")
    assert (first.text + second.text, first.severity) == ("a" * 70, 4)
    assert first.id == second.id != 0


def test_an_undrained_queue_is_bounded(ardupilot: Scripted) -> None:
    for _ in range(3000):
        ardupilot.link.send(Say(severity=Severity.INFO, text="b" * 50), ardupilot.now_s)
    assert len(ardupilot.link.drain()) <= MAX_QUEUED_BYTES + 100
    assert ardupilot.link.counts.overflows > 0


def chunk(text: bytes, text_id: int, seq: int) -> mavlink.MAVLink_statustext_message:
    return mavlink.MAVLink_statustext_message(4, text, text_id, seq)


def test_chunked_vehicle_texts_are_put_together(ardupilot: Scripted) -> None:
    assert ardupilot.says(chunk(b"x" * 50, 3, 0)) == []
    assert ardupilot.says(chunk(b"end\x07", 3, 1)) == [VehicleText(severity=4, text="x" * 50 + "end")]


def test_a_lost_chunk_shows(ardupilot: Scripted) -> None:
    ardupilot.says(chunk(b"x" * 50, 3, 0))
    (text,) = ardupilot.says(chunk(b"end", 3, 2))
    assert isinstance(text, VehicleText)
    assert text.text == "x" * 50 + "[...]end"


def test_a_text_that_never_ends_is_given_out(ardupilot: Scripted) -> None:
    ardupilot.says(chunk(b"x" * 50, 3, 0))
    ardupilot.after(1.0)
    (text,) = ardupilot.after(1.5)
    assert isinstance(text, VehicleText)
    assert text.text.endswith("[...]")


def test_a_new_text_ends_an_unfinished_one(ardupilot: Scripted) -> None:
    ardupilot.says(chunk(b"x" * 50, 3, 0))
    first, second = ardupilot.says(chunk(b"new", 4, 0))
    assert isinstance(first, VehicleText)
    assert isinstance(second, VehicleText)
    assert (first.text, second.text) == ("x" * 50 + "[...]", "new")


def test_endless_chunks_are_bounded(ardupilot: Scripted) -> None:
    texts = [e for seq in range(200) for e in ardupilot.says(chunk(b"x" * 50, 3, seq))]
    assert len(texts) > 15
    assert all(isinstance(t, VehicleText) and len(t.text) <= 560 for t in texts)


# ---------------------------------------------------------------- determinism and robustness


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=60)), max_size=12))
def test_random_payloads_under_right_checksums_never_raise(pieces: list[tuple[int, bytes]]) -> None:
    scripted = Scripted()
    scripted.heartbeat()
    writer = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    for message_id, payload in pieces:
        message_class = mavlink.mavlink_map.get(message_id)
        if message_class is None or not payload:
            continue
        message = mavlink.MAVLink_message(message_id, "random")
        data = message._pack(writer, message_class.crc_extra, payload)
        scripted.link.receive(bytes(data), 1.0)
        scripted.link.advance(1.0)


def test_the_same_input_gives_the_same_output() -> None:
    def run() -> tuple[bytes, list[object]]:
        scripted = Scripted()
        out = b""
        events: list[object] = []
        for step in range(50):
            events += scripted.heartbeat(GUIDED)
            events += scripted.says(scripted.position(step * 100))
            scripted.link.send(NORTH, scripted.now_s)
            events += scripted.after(0.1)
            out += scripted.link.drain()
        return out, events

    assert run() == run()


def test_drained_bytes_are_whole_frames(ardupilot: Scripted) -> None:
    ardupilot.link.send(NORTH, ardupilot.now_s)
    ardupilot.after(1.0)
    listener = AutopilotLink(VehicleConfig())
    listener.receive(ardupilot.link.drain(), 0.0)
    assert (listener.counts.wire.corrupt, listener.counts.wire.skipped_bytes) == (0, 0)
