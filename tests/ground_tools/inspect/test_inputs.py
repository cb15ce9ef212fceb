"""Damaged and mixed inputs: everything readable is shown, and each problem is reported in one line."""

import gzip
import json
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.tlog import TlogWriter
from companion.autopilot.wire import MavlinkWriter
from companion.errors import ConfigError
from companion.event_record import MAGIC, Step
from companion.events import GlobalPosition, Landed, LandedState
from ground_tools.inspect.export import incident
from ground_tools.inspect.read.flown import flown, separations
from ground_tools.inspect.read.read_run import read_run
from ground_tools.inspect.read.timeline import time_line, together
from ground_tools.inspect.report.summary import describe
from tests.ground_tools.inspect.flights import inspect

OTHER_VERSION = MAGIC[:-1] + b"3" + bytes(100)


def write_tlog(path: Path, made: SimpleNamespace, motion: object, late_s: float = 0.0) -> Path:
    """Write a minute of one vehicle at 10 Hz, as its companion would log it."""
    one = MavlinkWriter(1, 1)
    with path.open("wb") as stream:
        writer = TlogWriter(stream)
        for tick in range(601):
            t = tick / 10
            lat, lon, alt = made.home.to_geodetic(*motion(t))  # type: ignore[operator]
            place = mavlink.MAVLink_global_position_int_message(
                round(t * 1e3), round(lat * 1e7), round(lon * 1e7), round(alt * 1e3), 0, 0, 0, 0, 0
            )
            data = one.pack(place)
            if tick % 10 == 0:
                data = one.pack(mavlink.MAVLink_heartbeat_message(2, 3, 1 | 128, 4, 4, 3)) + data
                utc = round((made.utc_s + t) * 1e6)
                data += one.pack(mavlink.MAVLink_system_time_message(utc, round(t * 1e3)))
            writer.received(made.utc_s + t + late_s, data)
    return path


@pytest.mark.parametrize("content", [OTHER_VERSION, b"", MAGIC + b"\x09\x00", None])
def test_an_aircraft_without_a_readable_event_record_is_shown_by_its_tlog(
    run_folder: Path, made: SimpleNamespace, content: bytes | None
) -> None:
    events = run_folder / "DMUCA002.events"
    events.unlink()
    if content is not None:
        events.write_bytes(content)
    write_tlog(run_folder / "DMUCA002.tlog", made, made.eastbound(20.0))
    run = read_run(run_folder)
    assert [(one.name, one.log) for one in run.aircraft] == [("DMUCA001", ""), ("DMUCA002", "telemetry")]
    assert any("the telemetry log is shown instead" in problem for problem in run.problems)
    closest = separations(flown(run).paths)[0]
    assert closest.minimum_m == pytest.approx(20.0 / 2**0.5, abs=0.03)


@pytest.mark.parametrize("content", [OTHER_VERSION, b"\x89PNG"])
def test_a_bad_record_does_not_hide_a_good_one(run_folder: Path, content: bytes) -> None:
    (run_folder / "DMUCA002.events").write_bytes(content)
    run = read_run(run_folder)
    assert [one.name for one in run.aircraft] == ["DMUCA001"]
    (problem,) = run.problems
    assert problem.startswith("DMUCA002.events: ")
    assert len(separations(flown(run).paths)) == 0


def test_a_record_of_another_version_names_the_version(tmp_path: Path) -> None:
    (tmp_path / "a.events").write_bytes(OTHER_VERSION)
    with pytest.raises(ConfigError, match="format b'3'; this version reads b'4'"):
        read_run(tmp_path)


def test_an_event_record_opens_alone(run_folder: Path) -> None:
    run = read_run(run_folder / "DMUCA001.events")
    assert (run.name, [one.facts.steps for one in run.aircraft]) == ("DMUCA001", [601])
    assert run.recording == run_folder / "DMUCA001.rrd"


def test_the_link_of_a_companion_is_that_of_the_tlog_beside_it(
    run_folder: Path, made: SimpleNamespace
) -> None:
    write_tlog(run_folder / "DMUCA001.tlog", made, made.northbound)
    one, other = read_run(run_folder).aircraft
    assert (one.log, other.link) == ("", None)
    assert one.link is not None
    (component,) = one.link.components
    assert component.frames == 601 + 2 * 61
    # Times are those of the record, which begins at 0.
    assert component.seconds[:, 0].tolist() == pytest.approx(range(61), abs=1.0)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda data: b"", ["not a telemetry log: it is empty"]),
        (lambda data: b"no log" * 50, ["not a telemetry log"]),
        (lambda data: data[:5000] + bytes(300) + data[5300:-7], ["1 damaged spans", "the file is cut off"]),
        (lambda data: data, []),
    ],
)
def test_damage_of_the_tlog_beside_a_record_is_told(
    run_folder: Path, made: SimpleNamespace, spoil: Callable[[bytes], bytes], words: list[str]
) -> None:
    path = write_tlog(run_folder / "DMUCA001.tlog", made, made.northbound)
    path.write_bytes(spoil(path.read_bytes()))
    told = [line for line in describe(read_run(run_folder))["problems"] if line.startswith(path.name)]
    assert len(told) == len(words)
    assert all(word in line for word, line in zip(words, told, strict=True))


def test_a_run_and_a_log_share_one_utc_line(run_folder: Path, tmp_path: Path, made: SimpleNamespace) -> None:
    """The log's own clock is wrong by 30 s, so the vehicle's clock is used."""
    path = write_tlog(tmp_path / "other.tlog", made, made.eastbound(20.0), late_s=30.0)
    (run_folder / "DMUCA002.events").unlink()
    run = together([read_run(run_folder), read_run(path)])
    assert (run.name, run.recording) == ("20260101T000000Z-demo and 1 more", run_folder / "together.rrd")
    assert [one.name for one in run.aircraft] == ["DMUCA001", "other"]
    closest = separations(flown(run).paths)[0]
    assert closest.minimum_m == pytest.approx(20.0 / 2**0.5, abs=0.03)
    assert closest.minimum_time_s == pytest.approx(32.0, abs=0.02)
    assert time_line(run).utc_at_zero_s == pytest.approx(made.utc_s)


def test_shared_names_become_distinct(run_folder: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(run_folder, tmp_path / "second"))
    third = Path(shutil.copytree(run_folder, tmp_path / "other" / "second"))
    names = [one.name for one in together([read_run(f) for f in (run_folder, copy, third)]).aircraft]
    assert names[0] == "DMUCA001 (20260101T000000Z-demo)"
    assert names[2] == "DMUCA001 (second)"
    assert names[4] == "DMUCA001 (second) 2"
    assert len(set(names)) == 6


def test_a_run_that_is_given_twice_is_used_once(
    run_folder: Path, tmp_path: Path, made: SimpleNamespace
) -> None:
    link = tmp_path / "link"
    link.symlink_to(run_folder)
    run = together([read_run(run_folder), read_run(link)])
    assert [one.name for one in run.aircraft] == ["DMUCA001", "DMUCA002"]
    assert run.problems == (f"{link}: the run is given more than once and shown once",)
    other = write_tlog(tmp_path / "other.tlog", made, made.eastbound(20.0))
    run = together([read_run(run_folder), read_run(link), read_run(other)])
    assert len(run.aircraft) == 3
    assert f"{link}: the run is given more than once and shown once" in run.problems


def test_one_aircraft_in_two_files_is_reported(
    run_folder: Path, tmp_path: Path, made: SimpleNamespace
) -> None:
    """The inputs are a companion's record and a ground station's log, whose time stamps are 0.2 s late."""
    path = write_tlog(tmp_path / "station.tlog", made, made.northbound, late_s=0.2)
    ways = flown(together([read_run(run_folder), read_run(path)]))
    assert [problem.split(" were ")[0] for problem in ways.problems] == ["DMUCA001 and station"]


def test_inputs_that_do_not_overlap_in_time_are_reported(
    run_folder: Path, tmp_path: Path, made: SimpleNamespace
) -> None:
    motion = made.northbound
    later = [
        Step(
            now_s=s.now_s,
            commands=s.commands,
            events=tuple(e for e in s.events if isinstance(e, GlobalPosition)),
        )
        for s in made.steps(motion, motion)
    ]
    made.write_events(tmp_path / "nowhere", "a", later)
    made.utc_s += 3600.0
    path = write_tlog(tmp_path / "later.tlog", made, motion)
    made.utc_s -= 3600.0
    run = together([read_run(run_folder), read_run(path), read_run(tmp_path / "nowhere")])
    assert [p for p in run.problems if "does not overlap" in p] == [
        "20260101T000000Z-demo: the run (2025-12-31 23:59:50Z to 2026-01-01 00:00:50Z) does not overlap with "
        "the others",
        "later: the run (2026-01-01 00:59:50Z to 2026-01-01 01:00:50Z) does not overlap with the others",
    ]
    assert "nowhere: the run is left out because none of its aircraft knows UTC" in run.problems
    assert [one.name for one in run.aircraft] == ["DMUCA001", "DMUCA002", "later"]


def test_aircraft_on_the_ground_are_not_too_close(tmp_path: Path, made: SimpleNamespace) -> None:
    """They stand side by side until 40 s; only the flight after that counts."""

    def beside(t: float) -> tuple[float, float, float]:
        return (0.0, 2.0 + max(t - 40.0, 0.0) * 10.0, -50.0)

    def here(t: float) -> tuple[float, float, float]:
        return (0.0, 0.0, -50.0)

    for name, motion in (("a", here), ("b", beside)):
        found = []
        for step in made.steps(motion, motion):
            landed = Landed.ON_GROUND if step.now_s < 45.0 else Landed.IN_AIR
            found.append(
                Step(now_s=step.now_s, events=(LandedState(landed=landed), *step.events), commands=())
            )
        made.write_events(tmp_path, name, found)
    closest = separations(flown(read_run(tmp_path)).paths)[0]
    assert closest.minimum_m == pytest.approx(52.5, abs=0.1)
    assert closest.minimum_time_s == pytest.approx(45.05, abs=0.1)


def test_readable_inputs_are_shown_although_others_fail(
    run_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "x.png"
    bad.write_bytes(b"\x89PNG")
    assert inspect(run_folder, bad, tmp_path / "none", "--json") == 2
    out, err = capsys.readouterr()
    assert len(json.loads(out)["aircraft"]) == 2
    assert [line.split(":")[0] for line in err.splitlines()] == ["skipped", "skipped"]
    with pytest.raises(ConfigError, match="none of the RUNs can be read"):
        inspect(bad, tmp_path / "none", "--json")


def unreadable(folder: Path, kind: str) -> tuple[Path, str]:
    """A path from which nothing can be read, and the expected error."""
    path = folder / "x"
    match kind:
        case "fifo":
            os.mkfifo(path)
            return path, "not a regular file"
        case "folder with a fifo":
            path.mkdir()
            os.mkfifo(path / "a.events")
            return path, r"a\.events: this is not a regular file"
        case "link to itself":
            path.symlink_to(path)
            return path, "x: cannot be read: Too many levels"
        case "folder with a link to itself":
            path.mkdir()
            (path / "a.tlog").symlink_to(path / "a.tlog")
            return path, r"a\.tlog: cannot be read: Too many levels"
        case "device":
            return Path("/dev/zero"), "not a regular file"
        case "too long":
            return folder / ("x" * 300), "cannot be read: File name too long"
        case "empty folder":
            path.mkdir()
            return path, "the folder has no event record"
        case "empty file":
            path.write_bytes(b"")
            return path, "it is empty"
        case "gz":
            path.write_bytes(gzip.compress(b"log"))
            return path, "this is a compressed file"
        case "ulg":
            path.write_bytes(b"ULog\x01\x12\x35")
            return path, "no ULog file"
        case _:
            path.write_bytes(b"\xa3\x95\x80\x80")
            return path, "no DataFlash log"


@pytest.mark.parametrize(
    "kind",
    [
        *("fifo", "folder with a fifo", "link to itself", "folder with a link to itself", "device"),
        *("too long", "empty folder", "empty file", "gz", "ulg", "bin"),
    ],
)
def test_unreadable_inputs_are_reported_in_one_line(tmp_path: Path, kind: str) -> None:
    path, words = unreadable(tmp_path, kind)
    with pytest.raises(ConfigError, match=words) as error:
        read_run(path)
    assert "\n" not in str(error.value)
    assert "Errno" not in str(error.value)


def test_a_folder_of_runs_names_the_newest(run_folder: Path, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    for day in range(1, 8):
        shutil.copytree(run_folder, runs / f"2026010{day}T000000Z-demo")
    with pytest.raises(ConfigError) as refused:
        read_run(runs)
    words = str(refused.value)
    assert "but it contains 7 runs; give the path of one; the newest: " in words
    named = words.partition("the newest: ")[2].split(", ")
    assert named[0] == str(runs / "20260107T000000Z-demo")
    assert named == sorted(named, reverse=True)
    assert read_run(Path(named[0])).aircraft


def test_a_folder_without_read_permission_is_reported() -> None:
    """Runs as a user other than root, because root can read everything."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / "run"
        folder.mkdir(mode=0)
        Path(made).chmod(0o755)
        if root := os.geteuid() == 0:
            os.seteuid(65534)
        try:
            for path in (folder, folder / "inside", folder / "a.tlog"):
                with pytest.raises(ConfigError, match=f"{path}: cannot be read: Permission denied"):
                    read_run(path)
        finally:
            if root:
                os.seteuid(0)


def test_odd_files_in_a_folder_do_not_hide_the_rest(run_folder: Path) -> None:
    for name in ("y.events", "z.tlog", "DMUCA001.truth.csv", "config.toml"):
        os.mkfifo(run_folder / name)
    (run_folder / "summary.json").write_text("[" * 100_000)
    (run_folder / "manifest.json").unlink()
    (run_folder / "manifest.json").mkdir()
    (run_folder / "w.events").symlink_to(run_folder / "w.events")
    run = read_run(run_folder)
    assert [(one.name, one.facts.steps) for one in run.aircraft] == [("DMUCA001", 601), ("DMUCA002", 601)]
    assert sorted(problem.split(":")[0] for problem in run.problems) == [
        *("DMUCA001.truth.csv", "manifest.json", "summary.json"),
        *("w.events", "y.events", "z.tlog"),
    ]
    assert "cannot be read: Too many levels" in next(p for p in run.problems if p.startswith("w.events"))
    assert len(incident.flown_again(run, flown(run)).scenario.path) == 2


def test_together_merges_inputs_into_one_run(run_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert inspect(run_folder, run_folder / "unavoided", "--together", "--json") == 0
    figures = json.loads(capsys.readouterr().out)
    assert (len(figures["aircraft"]), len(figures["separations"])) == (4, 6)
