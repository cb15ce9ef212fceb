from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.link import AutopilotLink
from companion.autopilot.outbox import MAX_QUEUED_BYTES
from companion.config import VehicleConfig
from companion.events import (
    Broadcast,
    FlightMode,
    GlobalPosition,
    Heartbeat,
    ModeRefused,
    Say,
    SetMode,
    Severity,
    Threat,
    VehicleText,
    VelocitySetpoint,
)
from tests.companion.autopilot.conftest import Scripted

GUIDED = 4
EXTERNAL = SetMode(mode=FlightMode.EXTERNAL)
NORTH = VelocitySetpoint(velocity_ned_mps=(3.0, 0.0, 0.0))


# ---------------------------------------------------------------- what is taken and said


def test_speaks_first_as_a_companion_and_never_as_the_ground_station() -> None:
    scripted = Scripted()
    scripted.after(0.0)
    (beat,) = scripted.told()
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (1, 191)
    assert (beat.type, beat.autopilot) == (18, 8)


def test_own_heartbeat_once_a_second(ardupilot: Scripted) -> None:
    for _ in range(200):
        ardupilot.after(0.05)
    assert len(ardupilot.told("HEARTBEAT")) == 10


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
