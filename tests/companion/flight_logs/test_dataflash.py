"""ArduPilot's logs: what each message becomes, damaged and torn files, and formats of several versions."""

import io
import math
from pathlib import Path

import pytest

from companion.errors import PeerDataError
from companion.events import (
    AdsbVehicle,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    Landed,
    LandedState,
    VehicleText,
    VehicleTime,
    VelocitySetpoint,
)
from companion.flight_logs import About, ardupilot
from companion.flight_logs.dataflash import DataFlashReader
from companion.flight_logs.logged import LogCounts
from tests.support import onboard_logs as logs
from tests.support.dataflash_writer import DataFlashWriter


def read(content: bytes) -> tuple[list[tuple[float, object]], About]:
    about = About()
    steps = ardupilot.read_steps(io.BytesIO(content), "x.bin", about)
    return [(step.now_s, item) for step in steps for item in (*step.events, *step.commands)], about


def of(kind: type, found: list[tuple[float, object]]) -> list[object]:
    return [item for _, item in found if isinstance(item, kind)]


@pytest.fixture
def copter(tmp_path: Path) -> bytes:
    return logs.copter(tmp_path / "copter.bin").read_bytes()


def test_positions_have_the_velocity_of_the_core_in_use(copter: bytes):
    found, about = read(copter)
    places = of(GlobalPosition, found)
    assert len(places) == 10 * logs.SECONDS
    for tick, place in enumerate(places):
        assert place.lat_deg == pytest.approx(logs.latitude(tick / 10), abs=1e-7)
        assert place.velocity_ned_mps == (logs.SPEED_MPS, 0.0, -0.5)
        assert place.height_above_home_m == pytest.approx(20.0)
    assert about.position_from == "POS"
    assert about.firmware == "ArduCopter V4.6.1 (abcdef12)"
    assert about.system_id == 7


def test_modes_arming_and_landing(copter: bytes):
    found, about = read(copter)
    beats = [(now_s, beat) for now_s, beat in found if isinstance(beat, Heartbeat)]
    spans = [(round(now_s), beat.custom_mode, beat.armed) for now_s, beat in beats]
    assert spans[0] == (0, 0, False)
    assert (2, 4, True) in spans
    assert (18, 6, True) in spans
    assert spans[-1] == (19, 6, False)
    assert {beat.vehicle_type for _, beat in beats} == {13}  # a hexarotor
    assert [state.landed for state in of(LandedState, found)] == [Landed.IN_AIR, Landed.ON_GROUND]
    assert list(about.modes) == [0, 4, 6]


def test_warnings_are_told_from_the_rest(copter: bytes):
    found, _ = read(copter)
    texts = {text.text: text.severity for text in of(VehicleText, found)}
    assert texts == {
        "ArduCopter V4.6.1 (abcdef12)": 6,
        "Frame: HEXA/X": 6,
        "PreArm: Need Position Estimate": 4,
        "error: radio failsafe, code 1": 3,
        "error: radio failsafe resolved": 6,
    }


@pytest.mark.parametrize(
    ("text", "severity"),
    [("Disarming motors", 6), ("Crash: Disarming", 4), ("BlackBox: disarming at 3.0 m/s", 4)],
)
def test_an_ordinary_disarming_is_no_warning(tmp_path: Path, text: str, severity: int):
    """Copters, rovers and submarines send the first one at the end of every flight, as information."""
    log = DataFlashWriter()
    log.define("MSG", "QZ", "TimeUS,Message", "F-")
    log.write("MSG", 1_000, text)
    found, _ = read(log.save(tmp_path / "x.bin").read_bytes())
    assert [(one.text, one.severity) for one in of(VehicleText, found)] == [(text, severity)]


@pytest.mark.parametrize("centimetres", [True, False])
def test_guided_velocities_are_in_the_unit_that_the_log_says(tmp_path: Path, centimetres: bool):
    found, about = read(logs.copter(tmp_path / "x.bin", centimetres=centimetres).read_bytes())
    velocities = {setpoint.velocity_ned_mps for setpoint in of(VelocitySetpoint, found)}
    assert len(of(VelocitySetpoint, found)) == 29
    (velocity,) = velocities
    assert velocity == pytest.approx((3.0, -1.0, -0.5))
    assert about.other_setpoints == 1


def test_a_rovers_guided_velocity_is_in_no_frame_of_ours(copter: bytes):
    found, about = read(copter.replace(b"ArduCopter", b"ArduRover\0"))
    assert of(VelocitySetpoint, found) == []
    assert about.other_setpoints == 30


def test_traffic_gnss_wind_and_time(copter: bytes):
    found, about = read(copter)
    traffic = of(AdsbVehicle, found)
    assert len(traffic) == logs.SECONDS
    assert traffic[0].icao == logs.ICAO
    assert traffic[0].alt_m == pytest.approx(logs.ALT_M + 100.0)
    assert traffic[0].velocity_ned_mps == pytest.approx((0.0, -40.0, 0.0), abs=1e-9)
    fixes = of(GnssFix, found)
    assert len(fixes) == 5 * logs.SECONDS  # those of the receiver in use
    assert {fix.satellites for fix in fixes} == {9, 14}
    assert fixes[-1].horizontal_accuracy_m == pytest.approx(0.4)
    assert fixes[-1].alt_ellipsoid_m == pytest.approx(logs.ALT_M + 48.0)
    offsets = [item.utc_s - now_s for now_s, item in found if isinstance(item, VehicleTime)]
    assert offsets == pytest.approx([logs.UTC_S - 0.1] * len(offsets), abs=2e-3)
    rows = [about.wind[n : n + 3] for n in range(0, len(about.wind), 3)]
    assert all(row[1:].tolist() == [-3.0, 4.0] for row in rows)
    assert 0.9 * logs.SECONDS <= len(rows) <= logs.SECONDS


@pytest.mark.parametrize("utc_s", [logs.UTC_S - 1024 * 604_800, logs.GPS_EPOCH_S, 3.8e10])
def test_a_receiver_that_counts_weeks_from_a_rollover_does_not_know_utc(tmp_path: Path, monkeypatch, utc_s):
    """With a date in the year 3175, exports failed; with one 1024 weeks early, the flight was misplaced."""
    monkeypatch.setattr(logs, "UTC_S", utc_s)
    found, _ = read(logs.copter(tmp_path / "copter.bin").read_bytes())
    assert of(VehicleTime, found) == []
    assert len(of(GnssFix, found)) == 5 * logs.SECONDS


@pytest.mark.parametrize(
    ("start_s", "leap_s"), [(1_483_228_801.0, 18), (1_470_000_000.0, 17), (1_400_000_000.0, 16)]
)
def test_utc_of_an_old_log_has_the_leap_seconds_of_its_day(tmp_path: Path, monkeypatch, start_s, leap_s):
    """One second moves an aircraft by its speed on a time line with others."""
    monkeypatch.setattr(logs, "UTC_S", start_s)
    monkeypatch.setattr(logs, "LEAP_S", leap_s)
    found, _ = read(logs.copter(tmp_path / "copter.bin").read_bytes())
    offsets = [item.utc_s - now_s for now_s, item in found if isinstance(item, VehicleTime)]
    assert offsets == pytest.approx([start_s - 0.1] * (5 * logs.SECONDS), abs=2e-3)


def test_without_an_estimator_the_receivers_positions_count(tmp_path: Path):
    found, about = read(logs.old_plane(tmp_path / "plane.bin").read_bytes())
    places = of(GlobalPosition, found)
    assert about.position_from == "GPS"
    assert len(places) == 95  # those with a fix
    assert places[0].velocity_ned_mps == pytest.approx((0.0, logs.SPEED_MPS, 0.0), abs=1e-9)
    assert [beat.custom_mode for beat in of(Heartbeat, found)] == [11, 10]
    assert {beat.vehicle_type for beat in of(Heartbeat, found)} == {1}
    assert "home" in about.missing()[0]


def test_a_damaged_piece_is_skipped_and_a_torn_end_is_said(tmp_path: Path):
    found, about = read(logs.damaged_copter(tmp_path / "x.bin").read_bytes())
    places = of(GlobalPosition, found)
    assert 190 <= len(places) < 200
    for place in places:  # nothing is made up of the damaged bytes
        tick = (place.lat_deg - logs.PLACE[0]) / logs.NORTH_DEG_S * 10
        assert tick == pytest.approx(round(tick), abs=0.02)
    counts = about.counts
    assert (counts.damaged_spans, counts.torn_bytes) == (1, 20)
    assert 512 <= counts.damaged_bytes <= 700
    words = about.damage("x.bin")
    assert words[0].startswith("x.bin: 1 damaged spans (")
    assert words[1] == "x.bin: the file is cut off; its last 20 bytes are not a whole message"


def test_a_log_that_is_cut_anywhere_is_read_up_to_there(copter: bytes):
    whole, _ = read(copter)
    start = copter.index(b"PreArm")
    for end in range(start, len(copter), 997):
        found, about = read(copter[:end])
        assert len(found) <= len(whole)
        assert about.counts.damaged_spans == 0
        assert 0 <= about.counts.torn_bytes < 90


def test_messages_that_cross_the_borders_of_what_is_read_at_once(copter: bytes, monkeypatch):
    whole, _ = read(copter)
    for size in (64, 997, 4096):
        monkeypatch.setattr("companion.flight_logs.dataflash._CHUNK", size)
        found, about = read(copter)
        assert found == whole
        assert about.counts.damaged_spans == about.counts.torn_bytes == 0


def test_a_message_of_a_kind_that_is_not_known_yet_is_counted_and_the_rest_is_read():
    log = DataFlashWriter(with_units=False)
    log.define("NEW", "QB", "TimeUS,What")
    log.define("MSG", "QZ", "TimeUS,Message")
    log.write("NEW", 1, 5)
    log.write("MSG", 2, "still here")
    content = log.content.replace(b"QB\0\0", b"Q!\0\0")
    counts = LogCounts()
    reader = DataFlashReader(io.BytesIO(content), "x.bin", frozenset({"MSG"}), counts)
    assert [fields["Message"] for _, fields in reader.messages()] == ["still here"]
    assert counts.bad_values == 1


@pytest.mark.parametrize("content", [b"\xa3\x95\x80\x80" + bytes(100), b"\xa3\x95" + b"x" * 100_000])
def test_what_is_no_log_is_refused(content: bytes):
    with pytest.raises(PeerDataError, match="no DataFlash log"):
        read(content)


def test_impossible_values_are_counted_and_left_out():
    log = DataFlashWriter()
    log.define("POS", "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt", "FGG000")
    log.define("ADSB", "QIiiiHHhH", "TimeUS,ICAO_address,Lat,Lng,Alt,Heading,Hor_vel,Ver_vel,Squark")
    log.write("POS", 1_000, 47.0, 8.5, 450.0, 20.0, 20.0)
    log.write("POS", 2_000, 47.0, 8.5, math.nan, 20.0, 20.0)
    log.write("POS", 3_000, 120.0, 8.5, 450.0, 20.0, 20.0)
    log.write("POS", 4_000, 0.0, 0.0, 450.0, 20.0, 20.0)  # not known, which is no damage
    log.write("ADSB", 5_000, 1 << 25, 470_000_000, 85_000_000, 0, 0, 0, 0, 0)
    found, about = read(log.content)
    assert len(of(GlobalPosition, found)) == 1
    assert of(AdsbVehicle, found) == []
    assert about.counts.bad_values == 3
