"""Onboard logs compared with other projects' readers: pymavlink's DFReader and pyulog.

Real logs are not part of the project. DMUCA_LOGS names a folder that is searched for them.
"""

import math
import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from pymavlink import DFReader
from pyulog import ULog

from companion.errors import ConfigError
from companion.events import VehicleText
from companion.flight_logs.logged import plain
from ground_tools.inspect.read.flown import flown
from ground_tools.inspect.read.nearness import ADSB_STAMP_S
from ground_tools.inspect.read.read_run import AircraftRecord, Run, read_run
from ground_tools.inspect.read.timeline import together
from ground_tools.inspect.report.summary import describe, text
from tests.support import onboard_logs as logs
from tests.support.dataflash_writer import DataFlashWriter

REAL = "DMUCA_LOGS"
MADE = {
    "copter.bin": logs.copter,
    "plane.bin": logs.old_plane,
    "damaged.bin": logs.damaged_copter,
    "px4.ulg": logs.px4,
    "old_px4.ulg": lambda path: logs.old_px4(path, damaged=False),
}


@dataclass
class Other:
    """What another reader finds in a log."""

    places: list[tuple[float, float, float]]
    """Latitude, longitude (deg), altitude above mean sea level (m) of every valid position."""
    modes: list[str]
    """Names of the modes, one for each change."""
    texts: list[str]
    utc_offset_s: float | None


def changes(values: list[str]) -> list[str]:
    return [value for n, value in enumerate(values) if n == 0 or value != values[n - 1]]


def by_pymavlink(path: Path, source: str) -> Other:
    reader = DFReader.DFReader_binary(str(path))
    found = Other([], [], [], None)
    offsets = []
    while (message := reader.recv_match(type=["POS", "GPS", "MODE", "MSG"])) is not None:
        kind = message.get_type()
        has_fix = kind == "GPS" and message.Status >= 3 and bool(getattr(message, "U", 1))
        if kind == source and (kind == "POS" or has_fix) and (message.Lat, message.Lng) != (0.0, 0.0):
            found.places.append((message.Lat, message.Lng, message.Alt))
        if has_fix and message.GWk > 0:
            offsets.append(
                DFReader.DFReaderClock()._gpsTimeToTime(message.GWk, message.GMS) - message.TimeUS / 1e6
            )
        if kind == "MODE":
            found.modes.append(reader.flightmode)
        if kind == "MSG":
            found.texts.append(message.Message.strip())
    found.modes = changes(found.modes)
    found.utc_offset_s = float(np.median(offsets)) if offsets else None
    return found


NAV_STATES = {0: "MANUAL", 1: "ALTCTL", 2: "POSCTL", 3: "AUTO.MISSION", 4: "AUTO.LOITER", 5: "AUTO.RTL",
              14: "OFFBOARD", 17: "AUTO.TAKEOFF", 18: "AUTO.LAND", 6: "mode 6"}  # fmt: skip


def by_pyulog(path: Path, source: str) -> Other:
    log = ULog(str(path), None, disable_str_exceptions=True)
    topics = {one.name: one.data for one in log.data_list if one.multi_id == 0}
    found = Other([], [], [message.message for message in log.logged_messages], None)
    data = topics.get(source)
    if source == "vehicle_global_position":
        valid = data.get("lat_lon_valid", np.ones(len(data["lat"]))) > 0
        valid &= data.get("alt_valid", np.ones(len(data["lat"]))) > 0
        found.places = list(zip(data["lat"][valid], data["lon"][valid], data["alt"][valid], strict=True))
    elif source == "vehicle_local_position":
        valid = (data["xy_global"] > 0) & (data["z_global"] > 0)
        found.places = [(math.nan, math.nan, float(alt)) for alt in (data["ref_alt"] - data["z"])[valid]]
    elif source == "vehicle_gps_position":
        valid = data["fix_type"] >= 3
        found.places = list(
            zip(data["lat"][valid] / 1e7, data["lon"][valid] / 1e7, data["alt"][valid] / 1e3, strict=True)
        )
    if "vehicle_status" in topics:
        found.modes = changes([NAV_STATES[int(state)] for state in topics["vehicle_status"]["nav_state"]])
    gps = topics.get("vehicle_gps_position")
    if gps is not None and (known := gps["time_utc_usec"] > 946_684_800e6).any():
        shift = gps["timestamp_time_relative"].astype(float)
        offsets = gps["time_utc_usec"].astype(float) - shift - gps["timestamp"].astype(float)
        found.utc_offset_s = float(np.median(offsets[known])) / 1e6
    return found


def agrees(path: Path) -> Run:
    """Check one log against another reader of its format."""
    run = read_run(path)
    (one,) = run.aircraft
    assert one.log == "onboard"
    source = next(
        (note.partition("positions from ")[2] for note in run.notes if "positions from" in note), ""
    )
    is_px4 = path.suffix.lower() == ".ulg"
    other = (by_pyulog if is_px4 else by_pymavlink)(path, source)
    fixes = one.facts.fixes
    assert len(fixes) == len(other.places)
    for ours, theirs in zip((fixes[:1], fixes[-1:]), (other.places[:1], other.places[-1:]), strict=True):
        for place in theirs:
            known = ~np.isnan(place[:2])
            assert ours[0, 1:3][known].tolist() == pytest.approx(list(np.array(place[:2])[known]), abs=1e-9)
            assert ours[0, 3] == pytest.approx(place[2], abs=0.05)
    (figures,) = describe(run)["aircraft"]
    assert [row["mode"] for row in figures["flight"]["modes"]] == other.modes
    texts = Counter(what.text for _, what in one.facts.rare if isinstance(what, VehicleText))
    # For a DataFlash log, the texts about events and errors are made by our reader only.
    assert not Counter(map(plain, other.texts)) - texts
    if other.utc_offset_s is None:
        assert one.facts.utc_offset_s is None
    else:
        assert one.facts.utc_offset_s == pytest.approx(other.utc_offset_s, abs=1e-3)
    return run


@pytest.mark.parametrize("name", [name for name in MADE if name != "damaged.bin"])
def test_made_logs_read_as_other_readers_read_them(tmp_path: Path, name: str):
    agrees(MADE[name](tmp_path / name))


def real_logs(*suffixes: str) -> list[Path]:
    folder = os.environ.get(REAL)
    found = sorted(Path(folder).rglob("*")) if folder else []
    heads = {".bin": b"\xa3\x95", ".ulg": b"ULog"}
    return [
        path
        for path in found
        if path.suffix.lower() in suffixes
        and path.is_file()
        and path.open("rb").read(4).startswith(heads[path.suffix.lower()])
    ]


@pytest.mark.parametrize("suffix", [".bin", ".ulg"])
def test_real_logs_read_as_other_readers_read_them(suffix: str):
    paths = real_logs(suffix)
    if not paths:
        pytest.skip(f"{REAL} names no folder with real {suffix} logs")
    for path in paths:
        figures = describe(agrees(path))
        assert figures["aircraft"][0]["duration_s"] > 0.0
        assert text(figures)


# ---------------------------------------------------------------- summaries


def one_of(path: Path) -> tuple[Run, AircraftRecord]:
    run = read_run(path)
    (one,) = run.aircraft
    return run, one


ABOUT = {
    "copter.bin": "ArduPilot DataFlash log of ArduCopter V4.6.1 (abcdef12); modes STABILIZE, GUIDED, RTL; "
    "positions from POS",
    "plane.bin": "ArduPlane V3.5.3 (12345678); modes RTL, AUTO; positions from GPS",
    "px4.ulg": "PX4 log (ULog) of PX4 1.16.0 PX4_FMU_V6X; modes AUTO.TAKEOFF, OFFBOARD, AUTO.RTL; "
    "positions from vehicle_global_position",
    "old_px4.ulg": "modes AUTO.MISSION, mode 6; positions from vehicle_local_position",
}
MISSING = {
    "copter.bin": "Remote ID of others, own Remote ID, a companion's decisions",
    "plane.bin": "home from the beginning",
    "px4.ulg": "Remote ID of others, a companion's decisions",
    "old_px4.ulg": "GNSS fix, wind",
}


@pytest.mark.parametrize("name", ABOUT)
def test_the_kind_of_a_log_and_missing_data_are_reported(tmp_path: Path, name: str):
    run, _ = one_of(MADE[name](tmp_path / name))
    assert ABOUT[name] in run.notes[0]
    assert MISSING[name] in run.notes[1]
    assert f"note: {run.notes[1]}" in text(describe(run))


@pytest.mark.parametrize("name", ["copter.bin", "px4.ulg"])
def test_figures_of_a_log(tmp_path: Path, name: str):
    figures = describe(one_of(MADE[name](tmp_path / name))[0])
    (one,) = figures["aircraft"]
    assert figures["clock"] == "UTC of the vehicles' GNSS receivers, as logged on board"
    assert figures["utc_at_zero_s"] == pytest.approx(logs.UTC_S, abs=2.1)
    assert one["flight"]["max_height_m"] == pytest.approx(20.0)
    assert one["flight"]["max_speed_mps"] == pytest.approx(logs.SPEED_MPS)
    assert one["flight"]["distance_m"] == pytest.approx(19.9 * logs.SPEED_MPS, rel=1e-3)
    assert one["flight"]["armed_s"] == pytest.approx(17.0, abs=0.1)
    assert one["gnss"] == {
        "reports": 100,
        "best_fix": 3,
        "without_fix_s": 0.0,
        "least_satellites": 9 if name == "copter.bin" else 10,
        "worst_accuracy_m": pytest.approx(0.4 if name == "copter.bin" else 0.9),
    }
    # The wind blows towards the north-west at 5 m/s, so it comes from the south-east.
    wind = one["wind"]
    assert (wind["mean_mps"], wind["max_mps"]) == (pytest.approx(5.0), pytest.approx(5.0))
    assert wind["from_deg"] == pytest.approx(math.degrees(math.atan2(-4.0, 3.0)) % 360.0)
    (traffic,) = one["traffic"]
    assert (traffic["identity"], traffic["by"], traffic["messages"]) == (f"{logs.ICAO:06X}", "ADS-B", 20)
    # The aircraft came 40 m nearer in each second since it was received.
    age_s = (0.0 if name == "copter.bin" else 1.0) + ADSB_STAMP_S
    assert traffic["nearest"]["aside_m"] == pytest.approx(400.0 - 40.0 * age_s, abs=1.5)
    assert traffic["nearest"]["above_m"] == pytest.approx(100.0, abs=1.5)
    words = text(figures)
    assert "GNSS and wind" in words
    faults = {row["text"] for row in one["faults"]}
    assert ("error: radio failsafe, code 1" if name == "copter.bin" else "[battery] low battery") in faults


def test_two_logs_together_are_on_the_utc_of_their_receivers(tmp_path: Path):
    paths = []
    for number in (1, 2):
        (tmp_path / str(number)).mkdir()
        path = tmp_path / str(number) / "00000001.BIN"
        paths.append(logs.copter(path, system_id=number, east_deg=0.0004 * number))
    run = together([read_run(path) for path in paths])
    assert [one.name for one in run.aircraft] == ["system 1", "system 2"]
    (separation,) = describe(run)["separations"]
    metres = 0.0004 * 111_320.0 * math.cos(math.radians(logs.PLACE[0]))
    assert separation["minimum_m"] == pytest.approx(metres, rel=5e-3)
    # A log that starts 7 s later by UTC has the same path 7 s later.
    late = logs.UTC_S + 7.0
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(logs, "UTC_S", late)
        logs.copter(paths[1], system_id=2)
    ways = flown(together([read_run(path) for path in paths]))
    assert ways.paths[1].time_s[0] - ways.paths[0].time_s[0] == pytest.approx(7.0, abs=1e-6)


def test_a_folder_of_onboard_logs_is_one_run(tmp_path: Path):
    logs.copter(tmp_path / "00000001.BIN", system_id=1)
    logs.px4(tmp_path / "second.ulg")
    logs.old_px4(tmp_path / "third.ulg")
    (tmp_path / "eeprom.bin").write_bytes(bytes(100))
    run = read_run(tmp_path)
    assert [one.name for one in run.aircraft] == ["system 1", "second"]
    (problem,) = (problem for problem in run.problems if "left out, because" in problem)
    assert problem.startswith("third: the log is left out, because it has no UTC")


def test_a_log_without_utc_is_reported_and_shown_alone(tmp_path: Path):
    run, one = one_of(logs.old_px4(tmp_path / "x.ulg"))
    assert one.facts.utc_offset_s is None
    assert "the log has no UTC; times count from the vehicle's start" in run.notes[2]
    assert describe(run)["clock"] == "the vehicle's clock, since it started"


def test_damage_is_reported(tmp_path: Path):
    run, one = one_of(logs.damaged_copter(tmp_path / "x.bin"))
    assert len(one.facts.fixes) > 190
    assert run.problems[0].startswith("x.bin: 1 damaged spans")
    assert "the file is cut off; its last 20 bytes" in run.problems[1]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"FMT, 128, 89, FMT, BBnNZ", "converted to text.*allowed: .*ArduPilot's .bin, PX4's .ulg"),
        (b"Dear diary, " * 50, "not a telemetry log.*allowed: a run folder.*PX4's .ulg"),
        (b"\xa3\x95\x80\x80" + bytes(100), "no DataFlash log.*allowed: a run folder"),
        (b"ULog\x01\x12\x35" + bytes(100), "no message that can be shown"),
        (b"ULog\x02" + bytes(100), "no ULog file"),
    ],
)
def test_a_file_of_another_kind_is_one_clear_line(tmp_path: Path, content: bytes, words: str):
    path = tmp_path / "flight.bin"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=words) as raised:
        read_run(path)
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


def in_the_air(path: Path, north_mps: float) -> Path:
    """The log of a copter that was already armed and flying when it began, towards or away from `PLACE`."""
    log = DataFlashWriter()
    log.define("MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn", "F---")
    log.define("POS", "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt", "FGG000")
    gps = "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U"
    log.define("GPS", "QBBIHBcLLeffffB", gps, "F--C-0BGGB000--")
    log.write("MODE", 1_000, 4, 4, 1)
    for tick in range(200):
        t, us = tick / 10, tick * 100_000 + 2_000
        ms, week = logs.gps_time(us / 1e6)
        lat = logs.PLACE[0] + north_mps * (t - 10.0) / 111_178.0
        course = 0.0 if north_mps > 0.0 else 180.0
        place = lat, logs.PLACE[1], logs.ALT_M
        log.write("GPS", us, 0, 3, ms, week, 14, 0.8, *place, abs(north_mps), course, 0.0, 0.0, 1)
        log.write("POS", us, *place, 50.0, 50.0)
    return log.save(path)


def test_a_log_that_begins_in_the_air_is_a_flight(tmp_path: Path):
    """ArduPilot logs only changes of the arming, so no message of such a log says that it is armed."""
    runs = [read_run(in_the_air(tmp_path / f"{name}.bin", v)) for name, v in (("there", 8.0), ("back", -8.0))]
    figures = describe(together(runs))
    (row,) = figures["separations"]
    assert row["minimum_m"] == pytest.approx(0.0, abs=0.5)
    assert row["minimum_time_s"] == pytest.approx(10.0, abs=0.1)
    assert row["kept"] is False
    for one in figures["aircraft"]:
        assert one["flight"]["armed_s"] is None
        assert any("no arming" in words for words in one["missing"])


def test_a_log_of_an_aircraft_that_stood_is_no_flight(tmp_path: Path):
    runs = [read_run(in_the_air(tmp_path / f"{name}.bin", 0.0)) for name in ("one", "other")]
    figures = describe(together(runs))
    assert figures["separations"][0]["minimum_m"] is None
    assert [one["flight"]["armed_s"] for one in figures["aircraft"]] == [0.0, 0.0]


def test_a_log_of_a_folder_that_is_none_is_told(tmp_path: Path):
    """A file whose name ends in .bin may be anything; one that ends in .ulg was a log."""
    run_of_one = read_run(logs.px4(tmp_path / "a.ulg"))
    (tmp_path / "b.ulg").write_bytes(b"")
    (tmp_path / "c.ulg").write_bytes(b"\0" * 100)
    (tmp_path / "model.bin").write_bytes(b"weights")
    run = read_run(tmp_path)
    assert len(run.aircraft) == 1
    assert run.problems == (
        *run_of_one.problems,
        "b.ulg: no ULog file: it is empty",
        "c.ulg: no ULog file: it begins with 00 00 00 00 00 00 00 00",
    )
