"""Telemetry logs: recordings compared with pymavlink's reader, and synthetic logs for other cases."""

import functools
import gzip
import struct
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import CURRENT_MODE, MavlinkWriter
from companion.errors import ConfigError
from companion.events import (
    AdsbVehicle,
    GlobalPosition,
    Heartbeat,
    RemoteIdHeard,
    VehicleText,
    VelocitySetpoint,
)
from companion.remote_id.mavlink import encode_odid
from companion.remote_id.messages import Location
from ground_tools.inspect.read import read_tlog
from ground_tools.inspect.read.flown import flown
from ground_tools.inspect.read.modes import mode_name
from ground_tools.inspect.read.read_run import AircraftRecord, Run, read_run
from ground_tools.inspect.report import headline
from ground_tools.inspect.report.summary import describe, text

THINNED = Path(__file__).parents[3] / "data"
FULL = Path(__file__).parents[5] / "shared" / "data" / "mavlink"
RECORDED = ("ardupilot_sitl_guided", "ardupilot_sitl_odid_adsb", "px4_sih_offboard")
REAL = ("ardusub_multi_component", "dronekit_flight_replay", "uavlogviewer_vtol")
UTC_S = 1_767_225_600.0


@pytest.fixture(scope="session")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tlogs")
    for name in RECORDED:
        (folder / f"{name}.tlog").write_bytes(gzip.decompress((THINNED / f"{name}.tlog.gz").read_bytes()))
    return folder


def recording(unpacked: Path, name: str) -> Path:
    if name in RECORDED:
        return unpacked / f"{name}.tlog"
    if not (path := FULL / f"{name}.tlog").exists():
        pytest.skip(f"{path} is not here")
    return path


@functools.cache
def opened(path: Path) -> Run:
    """The logs, read once for all tests, because runs are immutable."""
    return read_run(path)


def told(one: AircraftRecord, kind: type) -> list[object]:
    return [item for step in one.steps() for item in (*step.events, *step.commands) if isinstance(item, kind)]


@pytest.mark.parametrize("name", [*RECORDED, *REAL])
def test_positions_and_counts_are_those_that_pymavlink_reads(unpacked: Path, name: str) -> None:
    path = recording(unpacked, name)
    frames: Counter[tuple[int, int]] = Counter()
    skipped: Counter[tuple[int, int]] = Counter()
    last: dict[tuple[int, int], int] = {}
    places, nameless = [], 0
    reader = mavutil.mavlink_connection(str(path), dialect="ardupilotmega")
    while (message := reader.recv_msg()) is not None:
        nameless += message.get_type() == f"UNKNOWN_{CURRENT_MODE}"
        if message.get_type() == "BAD_DATA" or message.get_type().startswith("UNKNOWN"):
            continue
        sender = message.get_srcSystem(), message.get_srcComponent()
        frames[sender] += 1
        skip = (message.get_seq() - last.get(sender, message.get_seq() - 1) - 1) % 256
        skipped[sender] += skip if skip != 255 else 0
        last[sender] = message.get_seq()
        if message.get_type() == "GLOBAL_POSITION_INT" and (message.lat or message.lon):
            places.append((message.lat / 1e7, message.lon / 1e7, message.alt / 1e3))
    (one,) = opened(path).aircraft
    found = [p for p in told(one, GlobalPosition) if isinstance(p, GlobalPosition)]
    assert [(p.lat_deg, p.lon_deg, p.alt_msl_m) for p in found] == places
    assert one.link is not None
    health = {(c.system_id, c.component_id): c for c in one.link.components}
    # Only our reader knows CURRENT_MODE.
    unknown = one.link.unknown + nameless
    assert sum(c.frames for c in health.values()) == sum(frames.values()) + unknown
    for sender, count in frames.items():
        # pymavlink does not give the sender of a message that it does not know.
        assert 0 <= health[sender].frames - count <= unknown
        if unknown == 0:
            assert health[sender].missing == skipped[sender]
            assert health[sender].seconds[:, 1:].sum(axis=0).tolist() == [count, skipped[sender]]


@pytest.mark.parametrize(
    ("name", "about", "missing", "problems"),
    [
        ("ardupilot_sitl_guided", "ArduPilot quadrotor; modes GUIDED, LOITER", "ADS-B traffic", 0),
        ("ardupilot_sitl_odid_adsb", "ArduPilot quadrotor", "velocity setpoints, Remote ID of others", 0),
        ("px4_sih_offboard", "PX4 quadrotor; modes OFFBOARD, AUTO.TAKEOFF", "ADS-B traffic", 0),
        ("ardusub_multi_component", "ArduPilot submarine; modes MANUAL", "own Remote ID", 1),
        ("dronekit_flight_replay", "ArduPilot quadrotor; modes STABILIZE", "velocity setpoints", 2),
        ("uavlogviewer_vtol", "ArduPilot fixed wing; modes QLOITER, CIRCLE", "own Remote ID", 0),
    ],
)
def test_the_kind_of_a_log_and_missing_data_are_reported(
    unpacked: Path, name: str, about: str, missing: str, problems: int
) -> None:
    run = opened(recording(unpacked, name))
    assert about in run.notes[0]
    assert missing in run.notes[1]
    assert "a companion's decisions" in run.notes[1]
    assert len(run.problems) == problems
    figures = describe(run)
    stamped = name == "ardusub_multi_component"
    assert any("no vehicle sent UTC" in note for note in run.notes) == stamped
    told = "UTC of the log's own time stamps, because no vehicle sent it"
    assert figures["clock"] == (told if stamped else "UTC that the vehicles sent (SYSTEM_TIME)")
    assert figures["aircraft"][0]["duration_s"] > 60.0
    assert f"note: {run.notes[1]}" in text(figures)


def test_link_quality_is_read_from_a_flight_over_a_radio(unpacked: Path) -> None:
    run = opened(recording(unpacked, "dronekit_flight_replay"))
    link = run.aircraft[0].link
    assert link is not None
    assert link.radio.shape == (1370, 8)
    assert 0 < link.radio[:, 1].mean() < 255
    assert (link.counts.corrupt_spans, link.counts.torn_bytes) == (1314, 19)
    assert len(link.reboots_s) == 1
    autopilot = next(c for c in link.components if (c.system_id, c.component_id) == (1, 1))
    # The vehicle's clock restarted after a silence.
    assert any(start <= link.reboots_s[0] <= start + 30.0 for start, _ in autopilot.gaps_s)
    figures = describe(run)
    (reboot,) = (fault for fault in figures["aircraft"][0]["faults"] if "restarted" in fault["text"])
    assert reboot["time_s"] + figures["utc_at_zero_s"] == pytest.approx(link.reboots_s[0])
    rows = {row["component"]: row for row in figures["aircraft"][0]["link"]}
    assert len(rows) == len(link.components)
    row = rows["1/1"]
    assert (row["frames"], row["missing"]) == (autopilot.frames, autopilot.missing)
    assert row["missing_percent"] == pytest.approx(
        100.0 * autopilot.missing / (autopilot.frames + autopilot.missing)
    )
    assert (row["silences"], row["longest_silence_s"]) == (len(autopilot.gaps_s), max(autopilot.gaps_s[:, 1]))


def test_adsb_and_setpoints_are_read(unpacked: Path) -> None:
    (one,) = opened(recording(unpacked, "ardupilot_sitl_odid_adsb")).aircraft
    assert len({a.icao for a in told(one, AdsbVehicle) if isinstance(a, AdsbVehicle)}) == 19
    (one,) = opened(recording(unpacked, "px4_sih_offboard")).aircraft
    assert (3.0, 0.0, 0.0) in {s.velocity_ned_mps for s in told(one, VelocitySetpoint)}  # type: ignore[attr-defined]


# ---------------------------------------------------------------- made here


def log(path: Path, records: Iterable[tuple[float, bytes]]) -> Path:
    path.write_bytes(b"".join(struct.pack(">Q", round((UTC_S + t) * 1e6)) + raw for t, raw in records))
    return path


def beat(kind: int, autopilot: int, mode: int = 0) -> mavlink.MAVLink_message:
    return mavlink.MAVLink_heartbeat_message(kind, autopilot, 1 | 128, mode, 4, 3)


def place(t: float, lat: float) -> mavlink.MAVLink_message:
    return mavlink.MAVLink_global_position_int_message(
        round(t * 1e3), round(lat * 1e7), 85_000_000, 500_000, 100_000, 0, 0, 0, 0
    )


def setpoint(target: int, frame: int, mask: int, north: float) -> mavlink.MAVLink_message:
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, target, 1, frame, mask, 0, 0, 0, north, 0.0, 0.0, 0, 0, 0, 0, 0
    )


@pytest.fixture
def two(tmp_path: Path) -> Path:
    """A log with a rover, a plane, and a ground station that commands them."""
    rover, plane, station = MavlinkWriter(3, 1), MavlinkWriter(7, 1), MavlinkWriter(255, 190)
    camera = MavlinkWriter(7, 100)
    records = []
    for t in range(20):
        records += [
            (t, rover.pack(beat(10, 3, 4))),
            (t + 0.1, plane.pack(beat(1, 3, 11 if t < 10 else 10))),
            (t + 0.2, rover.pack(place(t, 47.0))),
            (t + 0.2, plane.pack(place(t, 47.001))),
            (t + 0.3, station.pack(beat(6, 8))),
            (t + 0.4, station.pack(setpoint(7, 1, 0xDC7, 12.0))),
            (t + 0.4, station.pack(setpoint(7, 8, 0xDC7, 99.0))),
            (t + 0.4, station.pack(setpoint(7, 1, 0xDFF, 88.0))),
        ]
    heard = encode_odid(Location(lat_deg=47.1, lon_deg=8.5), 0, 0, b"\x01\x02" + bytes(18))
    records.append((20.0, plane.pack_payload(*heard)))
    records.append((20.1, camera.pack(mavlink.MAVLink_statustext_message(4, b"lens cap on"))))
    return log(tmp_path / "field.tlog", records)


def test_every_vehicle_of_a_log_is_an_aircraft_with_its_own_data(two: Path) -> None:
    run = read_run(two)
    rover, plane = run.aircraft
    assert (rover.name, plane.name) == ("field 3", "field 7")
    assert run.notes[0].endswith("ArduPilot ground rover; modes HOLD")
    assert run.notes[2].endswith("ArduPilot fixed wing; modes RTL, AUTO")
    assert told(rover, VelocitySetpoint) == []
    assert told(plane, VelocitySetpoint) == [VelocitySetpoint(velocity_ned_mps=(12.0, 0.0, 0.0))] * 20
    assert len(told(rover, Heartbeat)) == len(rover.facts.fixes) == 20
    assert (len(told(rover, RemoteIdHeard)), len(told(plane, RemoteIdHeard))) == (0, 1)
    assert [t.text for t in told(plane, VehicleText)] == ["component 100: lens cap on"]  # type: ignore[attr-defined]
    # One degree of latitude is 111 km.
    assert describe(run)["separations"][0]["minimum_m"] == pytest.approx(111.2, abs=0.1)


def test_an_unknown_autopilot_is_shown_by_its_positions(tmp_path: Path) -> None:
    other = MavlinkWriter(1, 1)
    records = [(t, other.pack(m)) for t in range(5) for m in (beat(2, 0), place(t, 47.0))]
    run = read_run(log(tmp_path / "inav.tlog", records))
    assert "unknown autopilot quadrotor" in run.notes[0]
    assert "flight modes" in run.notes[1]
    assert len(run.aircraft[0].facts.fixes) == 5


def test_without_positions_the_summary_says_so(tmp_path: Path) -> None:
    indoors = MavlinkWriter(1, 1)
    local = mavlink.MAVLink_local_position_ned_message(1000, 1, 2, -3, 0, 0, 0)
    run = read_run(
        log(tmp_path / "hall.tlog", [(t, indoors.pack(m)) for t in range(5) for m in (beat(2, 3), local)])
    )
    assert "position on Earth (only relative to its own origin), GNSS fix" in run.notes[1]
    figures = describe(run)
    assert figures["separations"] == []
    assert "no aircraft recorded a position" in text(figures)


def test_time_does_not_decrease_when_a_clock_is_set_back(tmp_path: Path) -> None:
    one = MavlinkWriter(1, 1)
    stamps = [0.0, 1.0, 2.0, 1.9, 3.0, -3597.0, -3596.0]
    records = [(t, one.pack(m)) for n, t in enumerate(stamps) for m in (beat(2, 3), place(n, 47.0))]
    run = read_run(log(tmp_path / "ntp.tlog", records))
    times = run.aircraft[0].facts.fixes[:, 0] - UTC_S
    # Of the two positions at 2.0 s the last one counts.
    assert times.tolist() == pytest.approx([0.0, 1.0, 2.0, 3.0, 4.0])
    assert "its clock was set back 1 times" in run.problems[0]


@pytest.mark.parametrize(
    ("index", "bit"),
    # A few seconds after the first record, or before the last, may be a silence.
    [(n, bit) for n in (0, 1, 25, 58, 59) for bit in (22, 36, 50) if bit > 22 or 0 < n < 59],
)
def test_one_wrong_bit_in_a_time_stamp_moves_nothing(tmp_path: Path, index: int, bit: int) -> None:
    """A time stamp has no checksum. The bits stand for 4 s, 19 hours and 36 years."""
    one = MavlinkWriter(1, 1)
    records = [(t, one.pack(m)) for t in range(30) for m in (beat(2, 3), place(t, 47.0))]
    path = log(tmp_path / "flipped.tlog", records)
    whole = read_run(path).aircraft[0].facts
    data = bytearray(path.read_bytes())
    at = sum(8 + len(raw) for _, raw in records[:index])
    data[at + 7 - bit // 8] ^= 1 << bit % 8
    path.write_bytes(data)
    run = read_run(path)
    facts = run.aircraft[0].facts
    assert (facts.start_s, facts.end_s) == pytest.approx((whole.start_s, whole.end_s), abs=1.01)
    assert facts.fixes[:, 0].tolist() == pytest.approx(whole.fixes[:, 0].tolist(), abs=1.01)
    assert run.problems == (
        "flipped.tlog: 1 records have a damaged time stamp; that of a neighbour is used instead",
    )


def test_a_clock_that_is_set_forward_moves_the_rest(tmp_path: Path) -> None:
    one = MavlinkWriter(1, 1)
    stamps = [0.0, 1.0, 2.0, 7202.0, 7203.0]
    records = [(t, one.pack(m)) for n, t in enumerate(stamps) for m in (beat(2, 3), place(n, 47.0))]
    run = read_run(log(tmp_path / "ntp.tlog", records))
    assert (run.aircraft[0].facts.fixes[:, 0] - UTC_S).tolist() == pytest.approx(stamps)
    assert run.problems == ()


def with_utc(path: Path, offsets: dict[int, float], jump_s: float = 0.0) -> Run:
    """Vehicles by their system ids, and by how much their UTC is off; after 40 of 60 s the log's clock is set
    forward by `jump_s`."""
    records = []
    for system, off_s in offsets.items():
        one = MavlinkWriter(system, 1)
        for t in range(60):
            now = mavlink.MAVLink_system_time_message(round((UTC_S + t + off_s) * 1e6), 1000 * t)
            stamp = t + (jump_s if t >= 40 else 0.0)
            records += [(stamp, one.pack(m)) for m in (beat(2, 3), now, place(t, 47.0 + 1e-4 * system))]
    return read_run(log(path, sorted(records, key=lambda record: record[0])))


@pytest.mark.parametrize(("jump_s", "told"), [(0.0, False), (3600.0, True)])
def test_a_clock_that_is_set_forward_in_flight_is_told(tmp_path: Path, jump_s: float, told: bool) -> None:
    figures = describe(with_utc(tmp_path / "pi.tlog", {1: 0.0, 2: 0.0}, jump_s))
    first = headline.verdicts(figures)[0]
    assert first.startswith("Separation")
    assert first.endswith("not certain, because the clock of pi 1 was set by 3600 s") is told
    assert any("was set by about 3600 s" in words for words in figures["problems"]) is told


def test_vehicles_that_disagree_about_utc_are_told(tmp_path: Path) -> None:
    """The median of two is the UTC of neither."""
    run = with_utc(tmp_path / "field.tlog", {1: 0.4, 2: -7e7})
    assert [one.facts.utc_offset_s for one in run.aircraft] == pytest.approx([0.4, 0.4])
    assert "report UTCs 70000000 s apart" in run.problems[0]
    assert with_utc(tmp_path / "fine.tlog", {1: 0.4, 2: 0.6}).problems == ()


def test_numbers_that_are_missing_and_silences_are_counted(tmp_path: Path) -> None:
    one = MavlinkWriter(1, 1)
    frames = [one.pack(beat(2, 3)) for _ in range(300)]
    kept = [*range(10), *range(15, 200), 199, *range(200, 300)]
    station = MavlinkWriter(255, 190)
    records = [(0.1 * n + (5.0 if n >= 100 else 0.0), frames[n]) for n in kept]
    run = read_run(log(tmp_path / "gaps.tlog", [*records, (45.0, station.pack(beat(6, 8)))]))
    link = run.aircraft[0].link
    assert link is not None
    component = link.components[0]
    assert (component.frames, component.missing, component.repeated) == (296, 5, 1)
    assert (component.gaps_s - [UTC_S, 0.0]).tolist() == [
        pytest.approx([9.9, 5.1], abs=1e-3),
        pytest.approx([34.9, 10.1], abs=1e-3),
    ]
    assert component.missing_share == pytest.approx(5 / 301)


def test_the_vehicles_utc_counts_over_the_logs_clock(tmp_path: Path) -> None:
    one = MavlinkWriter(1, 1)
    records = []
    for t in range(5):
        now = mavlink.MAVLink_system_time_message(round((UTC_S + t - 2.5) * 1e6), 1000 * t)
        records += [(t, one.pack(m)) for m in (beat(2, 3), now, place(t, 47.0))]
    run = read_run(log(tmp_path / "late.tlog", records))
    assert run.aircraft[0].facts.utc_offset_s == pytest.approx(-2.5, abs=1e-6)
    assert flown(run).utc_at_zero_s == pytest.approx(UTC_S - 2.5, abs=1e-3)
    assert "clock was 2.50 s ahead of" in run.notes[2]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"\x89PNG\r\n\x1a\n" + bytes(100), "a picture"),
        (b"Dear diary, " * 50, "not a telemetry log"),
        (bytes(range(256)) * 600, "not a telemetry log"),
    ],
)
def test_a_file_of_another_kind_is_one_clear_line(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "flight.tlog"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=words) as raised:
        read_run(path)
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_log_of_ground_stations_has_no_vehicle(tmp_path: Path) -> None:
    station = MavlinkWriter(255, 190)
    path = log(tmp_path / "desk.tlog", [(t, station.pack(beat(6, 8))) for t in range(3)])
    with pytest.raises(ConfigError, match="3 records have no autopilot's HEARTBEAT"):
        read_run(path)


def test_a_torn_log_is_read_up_to_its_end(two: Path) -> None:
    two.write_bytes(two.read_bytes()[:-7])
    run = read_run(two)
    assert len(run.aircraft) == 2
    assert "the file is cut off; its last" in run.problems[0]


def test_mode_names() -> None:
    def name(firmware: str, kind: int, number: int) -> str:
        one = MavlinkWriter(1, 1).pack(beat(kind, 3 if firmware == "ardupilot" else 12, number))
        fields = read_tlog.unpack(0, one[10:19])
        return mode_name(read_tlog.heartbeat(1, fields))

    assert name("ardupilot", 2, 4) == "GUIDED"
    assert name("ardupilot", 1, 4) == "ACRO"
    assert name("ardupilot", 2, 99) == "mode 99"
    assert name("px4", 22, 6 << 16) == "OFFBOARD"
