"""Every layout of ours against pymavlink's own encoding of the same message."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot import encoders
from companion.autopilot.wire import MavlinkWriter
from companion.events import Threat, TrafficReport


def threat(**over: Any) -> Threat:
    values = {"track_id": "4b1234", "adsb": True, "level": 2, "acting": True}
    values |= {"time_to_closest_s": 12.5, "horizontal_m": 30.0, "vertical_m": 8.0}
    return Threat(**(values | over))


def report(**over: Any) -> TrafficReport:
    values = {"icao": 0xB12345, "callsign": "RIDMUCA2", "lat_deg": 47.4, "lon_deg": 8.5, "alt_msl_m": 450.5}
    values |= {"velocity_ned_mps": (-3.0, 4.0, -1.5), "hovers": False, "age_s": 2.9}
    return TrafficReport(**(values | over))


REMOTE_ID_NUMBER = 0x08DF8A4C
"""`printf 1596B0000DMUCA01 | sha256sum`, the first eight digits."""

CASES: list[tuple[encoders.Outgoing, Any]] = [
    (
        encoders.adsb_vehicle(report()),
        mavlink.MAVLink_adsb_vehicle_message(
            0xB12345, 474000000, 85000000, 1, 450500, 12687, 500, 150, b"RIDMUCA2", 14, 2, 0x9F, 0
        ),
    ),
    (
        encoders.adsb_vehicle(report(alt_msl_m=None, hovers=True, velocity_ned_mps=(0, 900, 900), age_s=999)),
        mavlink.MAVLink_adsb_vehicle_message(
            0xB12345, 474000000, 85000000, 1, 0, 0, 65535, -32768, b"RIDMUCA2", 14, 255, 0x99, 0
        ),
    ),
    (encoders.heartbeat(), mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)),
    (
        encoders.velocity_setpoint((1.5, -2.0, 0.25), None, 123456, 7),
        mavlink.MAVLink_set_position_target_local_ned_message(
            123456, 7, 1, 1, 0x5C7, 0, 0, 0, 1.5, -2.0, 0.25, 0, 0, 0, 0, 0
        ),
    ),
    (
        encoders.velocity_setpoint((1.5, -2.0, 0.25), -3.0, 123456, 7),
        mavlink.MAVLink_set_position_target_local_ned_message(
            123456, 7, 1, 1, 0x9C7, 0, 0, 0, 1.5, -2.0, 0.25, 0, 0, 0, -3.0, 0
        ),
    ),
    (
        encoders.command_long(176, (1.0, 4.0), 7, confirmation=3),
        mavlink.MAVLink_command_long_message(7, 1, 176, 3, 1, 4, 0, 0, 0, 0, 0),
    ),
    (
        encoders.param_request_read("WPNAV_SPEED", 7),
        mavlink.MAVLink_param_request_read_message(7, 1, b"WPNAV_SPEED", -1),
    ),
    (
        encoders.param_request_read("SIXTEEN_LETTERS_", 7),
        mavlink.MAVLink_param_request_read_message(7, 1, b"SIXTEEN_LETTERS_", -1),
    ),
    (encoders.mission_request_list(7, 1), mavlink.MAVLink_mission_request_list_message(7, 1, 1)),
    (
        encoders.mission_request(300, 7, 1, as_int=True),
        mavlink.MAVLink_mission_request_int_message(7, 1, 300, 1),
    ),
    (
        encoders.mission_request(300, 7, 0, as_int=False),
        mavlink.MAVLink_mission_request_message(7, 1, 300, 0),
    ),
    (encoders.mission_ack(7, 1), mavlink.MAVLink_mission_ack_message(7, 1, 0, 1)),
    (encoders.mission_ack(7, 0, cancelled=True), mavlink.MAVLink_mission_ack_message(7, 1, 15, 0)),
    (encoders.collision(threat()), mavlink.MAVLink_collision_message(0, 0x4B1234, 4, 2, 12.5, 8.0, 30.0)),
    (
        encoders.collision(threat(track_id="1596B0000DMUCA01", adsb=False, level=1, acting=False)),
        mavlink.MAVLink_collision_message(1, REMOTE_ID_NUMBER, 1, 1, 12.5, 8.0, 30.0),
    ),
    (encoders.statustext(4, "avoiding", 9)[0], mavlink.MAVLink_statustext_message(4, b"avoiding", 0, 0)),
    (encoders.statustext(4, "x" * 60, 9)[1], mavlink.MAVLink_statustext_message(4, b"x" * 10, 9, 1)),
]


@pytest.mark.parametrize(("ours", "theirs"), CASES, ids=[m.get_type() for _, m in CASES])
def test_layout_is_pymavlinks(ours: encoders.Outgoing, theirs: Any) -> None:
    assert MavlinkWriter(1, 191).pack_payload(*ours) == MavlinkWriter(1, 191).pack(theirs)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 101.0, 1e39])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_setpoints_that_must_never_leave(bad: float, axis: int) -> None:
    velocity = [0.0, 0.0, 0.0]
    velocity[axis] = bad
    with pytest.raises(ValueError, match="not finite or above"):
        encoders.velocity_setpoint((velocity[0], velocity[1], velocity[2]), None, 0, 1)


@pytest.mark.parametrize("length", [0, 1, 49, 50, 51, 99, 100, 101, 150, 499, 500, 2000])
def test_long_texts_come_in_chunks_that_end_with_a_zero(length: int) -> None:
    chunks = [MavlinkWriter(1, 191).pack_payload(*c) for c in encoders.statustext(6, "y" * length, 5)]
    texts = [mavlink.MAVLink(None).decode(bytearray(c)) for c in chunks]
    assert "".join(t.text for t in texts) == "y" * min(length, 499)
    assert [t.chunk_seq for t in texts] == list(range(len(texts)))
    if length > 50:
        assert {t.id for t in texts} == {5}
        assert len(texts[-1].text) < 50
    else:
        assert [t.id for t in texts] == [0]


def test_other_alphabets_become_question_marks() -> None:
    (_, payload), *_ = encoders.statustext(6, "höhe\0 5 m", 1)
    assert payload[1:11] == b"h?he? 5 m\0"


def test_boot_time_wraps_instead_of_failing() -> None:
    assert encoders.velocity_setpoint((0.0, 0.0, 0.0), None, 2**32 + 5, 1)[1][:4] == (5).to_bytes(4, "little")


def test_a_strangers_name_in_a_text_is_printable_ascii():
    ((_, payload),) = encoders.statustext(4, "conflict with \x1b[2J\x00\u202eé\n", 1)
    assert payload[1:51].rstrip(b"\0") == b"conflict with ?[2J????"


@pytest.mark.parametrize(
    ("value", "told"), [(math.inf, 1e6), (1e300, 1e6), (-math.inf, 0.0), (-1.0, 0.0), (math.nan, math.nan)]
)
def test_no_number_makes_a_report_fail(value: float, told: float) -> None:
    outgoing = encoders.collision(threat(time_to_closest_s=value, horizontal_m=value, vertical_m=value))
    message = mavlink.MAVLink(None).decode(bytearray(MavlinkWriter(1, 191).pack_payload(*outgoing)))
    numbers = (
        message.time_to_minimum_delta,
        message.altitude_minimum_delta,
        message.horizontal_minimum_delta,
    )
    assert numbers == pytest.approx((told, told, told), nan_ok=True)


@pytest.mark.parametrize("over", [{"level": 3}, {"level": -1}, {"track_id": "GHI"}, {"track_id": "1000000"}])
def test_threats_that_are_bugs_of_ours(over: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"not defined|invalid literal|ICAO"):
        encoders.collision(threat(**over))


def test_remote_id_tracks_have_their_own_numbers() -> None:
    numbers = {encoders.collision(threat(track_id=f"T{n}", adsb=False))[1][:4] for n in range(1000)}
    assert len(numbers) == 1000


@pytest.mark.parametrize("over", [{"icao": 1 << 24}, {"icao": -1}, {"callsign": "NINECHARS"}])
def test_a_traffic_report_that_does_not_fit_is_a_bug(over: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="does not fit into ADSB_VEHICLE"):
        encoders.adsb_vehicle(report(**over))


def test_a_second_place_of_an_address_is_told_with_that_address() -> None:
    first, second = (encoders.collision(threat(track_id=name)) for name in ("4B1234", "4B1234/2"))
    assert first == second
