"""PX4's logs: what each topic becomes, appended parts, damaged and torn files."""

import io
import math
import struct
from pathlib import Path

import pytest

from companion.errors import PeerDataError
from companion.events import (
    AdsbVehicle,
    EstimatorState,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    Landed,
    LandedState,
    RemoteIdModule,
    VehicleText,
    VehicleTime,
    VelocitySetpoint,
)
from companion.flight_logs import About, px4
from tests.support import onboard_logs as logs
from tests.support.ulog_writer import UlogWriter


def read(content: bytes) -> tuple[list[tuple[float, object]], About]:
    about = About()
    steps = px4.read_steps(io.BytesIO(content), "x.ulg", about)
    return [(step.now_s, item) for step in steps for item in (*step.events, *step.commands)], about


def of(kind: type, found: list[tuple[float, object]]) -> list[object]:
    return [item for _, item in found if isinstance(item, kind)]


@pytest.fixture
def copter(tmp_path: Path) -> bytes:
    return logs.px4(tmp_path / "x.ulg").read_bytes()


def test_positions_are_in_order_and_have_the_local_velocity(copter: bytes):
    found, about = read(copter)
    times = [now_s for now_s, _ in found]
    assert times == sorted(times)
    places = [(now_s, item) for now_s, item in found if isinstance(item, GlobalPosition)]
    assert len(places) == 10 * logs.SECONDS
    for tick, (now_s, place) in enumerate(places):
        assert now_s == pytest.approx(1.996 + tick / 10)
        assert place.lat_deg == pytest.approx(logs.latitude(tick / 10), abs=1e-12)
        assert place.velocity_ned_mps == (logs.SPEED_MPS, 0.0, -0.5)
        assert place.height_above_home_m == pytest.approx(20.0)
    assert about.firmware == "PX4 1.16.0 PX4_FMU_V6X"
    assert about.system_id == 9
    assert about.missing() == ("Remote ID of others", "a companion's decisions")


def test_modes_arming_landing_and_setpoints(copter: bytes):
    found, about = read(copter)
    beats = of(Heartbeat, found)
    assert [beat.custom_mode for beat in beats[::5]] == [
        4 << 16 | 2 << 24,
        6 << 16,
        6 << 16,
        4 << 16 | 5 << 24,
    ]
    assert [beat.armed for beat in beats].count(True) == 17
    assert of(LandedState, found)[5].landed is Landed.IN_AIR
    setpoints = [(now_s, item) for now_s, item in found if isinstance(item, VelocitySetpoint)]
    # Only while the vehicle is offboard; one of them has no velocity.
    assert len(setpoints) == 19
    assert about.other_setpoints == 1
    assert {item.velocity_ned_mps for _, item in setpoints} == {(3.0, -1.0, -0.5)}
    assert all(7.0 <= now_s <= 17.0 for now_s, _ in setpoints)
    assert EstimatorState(usable=False) not in of(EstimatorState, found)


def test_traffic_gnss_wind_texts_and_time(copter: bytes):
    found, about = read(copter)
    traffic = of(AdsbVehicle, found)
    assert len(traffic) == logs.SECONDS
    one = traffic[0]
    assert (one.icao, one.callsign, one.emitter, one.age_s) == (logs.ICAO, "TEST123", 3, 1)
    assert one.alt_geometric
    assert one.velocity_ned_mps == pytest.approx((0.0, -40.0, 0.0), abs=1e-4)
    fixes = of(GnssFix, found)
    assert len(fixes) == 5 * logs.SECONDS
    assert {fix.satellites for fix in fixes} == {10, 12}
    offsets = [item.utc_s - now_s for now_s, item in found if isinstance(item, VehicleTime)]
    assert offsets == pytest.approx([logs.UTC_S] * len(offsets), abs=1e-3)
    assert about.wind[1::3].tolist() == [-3.0] * logs.SECONDS
    texts = [(now_s, text.severity, text.text) for now_s, text in found if isinstance(text, VehicleText)]
    assert texts == [(6.0, 6, "[commander] Ready for takeoff!"), (6.0, 4, "[battery] low battery")]
    (module,) = of(RemoteIdModule, found)
    assert (module.ready, module.text) == (False, "missing basic_id message")
    assert about.damage("x.ulg") == ("x.ulg: the autopilot could not write once, for 0.06 s in all",)


@pytest.mark.parametrize("utc_s", [0.0, 1e9, 2.5e12, 1.8e13])
def test_a_receiver_with_an_impossible_date_does_not_know_utc(tmp_path: Path, monkeypatch, utc_s):
    monkeypatch.setattr(logs, "UTC_S", utc_s)
    found, _ = read(logs.px4(tmp_path / "x.ulg").read_bytes())
    assert of(VehicleTime, found) == []
    assert len(of(GnssFix, found)) == 5 * logs.SECONDS


def test_what_a_receiver_does_not_know_is_no_number(copter: bytes):
    """A height of the geoid that is no number made every distance to others one."""
    place = struct.pack("<dddd", logs.latitude(10.0), logs.PLACE[1], logs.ALT_M + 1.0, logs.ALT_M + 49.0)
    unknown = struct.pack("<ddddf", *struct.unpack("<ddd", place[:24]), math.nan, math.inf)
    at = copter.index(place)
    found, _ = read(copter[:at] + unknown + copter[at + len(unknown) :])
    (fix,) = [fix for fix in of(GnssFix, found) if fix.alt_ellipsoid_m is None]
    assert fix.speed_accuracy_mps is None
    assert fix.horizontal_accuracy_m == pytest.approx(0.9)


@pytest.mark.parametrize(
    ("number", "odd", "name"),
    [
        (logs.ALT_M + 148.0, math.nan, "alt_m"),
        (math.radians(270.0), math.inf, "velocity_ned_mps"),
        (40.0, math.nan, "velocity_ned_mps"),
    ],
)
def test_traffic_without_a_number_keeps_its_place(copter: bytes, number: float, odd: float, name: str):
    found, about = read(copter.replace(struct.pack("<f", number), struct.pack("<f", odd)))
    traffic = of(AdsbVehicle, found)
    assert len(traffic) == logs.SECONDS
    assert {getattr(one, name) for one in traffic} == {None}
    assert about.counts.bad_values == 0


def test_positions_relative_to_an_origin_appended_data_and_damage(tmp_path: Path):
    found, about = read(logs.old_px4(tmp_path / "x.ulg").read_bytes())
    places = of(GlobalPosition, found)
    assert about.position_from == "vehicle_local_position"
    assert len(places) == 10 * logs.SECONDS
    assert places[-1].lat_deg == pytest.approx(logs.latitude(19.9), abs=1e-7)
    assert places[0].alt_msl_m == pytest.approx(logs.ALT_M)
    assert [text.text for text in of(VehicleText, found)] == ["hard fault"]
    # State 6 meant something else before 1.14.
    assert [beat.custom_mode for beat in of(Heartbeat, found)] == [4 << 16 | 4 << 24, 6]
    assert about.counts.damaged_spans == 2
    assert about.counts.torn_bytes == 0


def test_a_log_that_is_cut_anywhere_is_read_up_to_there(copter: bytes):
    whole, _ = read(copter)
    start = copter.index(b"S\x2f\x73")
    for end in range(start, len(copter), 997):
        found, about = read(copter[:end])
        assert len(found) <= len(whole)
        assert about.counts.damaged_spans == about.counts.bad_values == 0
        assert 0 <= about.counts.torn_bytes < 100


def test_messages_that_cross_the_borders_of_what_is_read_at_once(copter: bytes, monkeypatch):
    whole, _ = read(copter)
    monkeypatch.setattr("companion.flight_logs.ulog._MOST_BYTES", 700)
    for size in (64, 997, 4096):
        monkeypatch.setattr("companion.flight_logs.ulog._CHUNK", size)
        found, about = read(copter)
        assert found == whole
        assert about.counts.damaged_spans == about.counts.torn_bytes == 0


def test_damage_anywhere_among_the_data_costs_at_most_what_lies_before_the_next_mark(copter: bytes):
    whole, _ = read(copter)
    start = copter.index(b"S\x2f\x73")
    second = len(whole) / logs.SECONDS
    for at in range(start + 100, len(copter) - 5000, 3001):
        found, about = read(copter[:at] + b"\xff" * 40 + copter[at + 40 :])
        assert len(found) >= len(whole) - 2 * second
        assert about.counts.damaged_spans + about.counts.bad_values <= 2


def test_parts_of_a_kind_that_is_not_known_are_refused(copter: bytes):
    flagged = bytearray(copter)
    flagged[16 + 3 + 8] |= 2
    with pytest.raises(PeerDataError, match="parts of a kind that is not known"):
        read(bytes(flagged))


@pytest.mark.parametrize("content", [b"", b"ULog\x01\x12\x35", b"ULog" + bytes(100)])
def test_what_is_no_log_is_refused(content: bytes):
    with pytest.raises(PeerDataError, match="no ULog file"):
        read(content)


def test_formats_that_contain_others_are_measured_and_one_that_contains_itself_is_not():
    log = UlogWriter(0)
    log.message("F", b"inner:uint32_t a;uint8_t b;")
    log.message(
        "F", b"vehicle_status:uint64_t timestamp;inner[2] two;uint8_t nav_state;uint8_t arming_state;"
    )
    log.message("F", b"loop:uint64_t timestamp;loop again;")
    log.message("A", struct.pack("<BH", 0, 0) + b"vehicle_status")
    log.message("A", struct.pack("<BH", 0, 1) + b"loop")
    log.message("A", struct.pack("<BH", 0, 2) + b"never_described")
    log.message("D", struct.pack("<HQ10xBB", 0, 1_000_000, 14, 2))
    found, about = read(log.content)
    assert [(beat.custom_mode, beat.armed) for beat in of(Heartbeat, found)] == [(6 << 16, True)]
    assert about.counts.bad_values == 2
