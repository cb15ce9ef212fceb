"""Of all that lies in the record's folder only old runs of ours are deleted, and only when asked."""

from __future__ import annotations

import contextlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from companion.config import RecordConfig
from companion.event_record import Header
from companion.runtime.record import disk
from companion.runtime.record.disk import DiskFloor, finished_runs, free_mb, replace_file
from companion.runtime.record.recorder import FlightRecorder

DAYS = ["20260101T000000Z-a", "20260102T000000Z-b", "20260103T000000Z-c"]
OWN = "20260104T000000Z-own"


def run_folder(root, name, what="companion run"):
    folder = root / name
    folder.mkdir()
    (folder / "manifest.json").write_text(json.dumps({"what": what}))
    (folder / "A.events").write_bytes(b"DMUCAEV3")
    (folder / "A.tlog").write_bytes(b"")
    return folder


@pytest.fixture
def runs(tmp_path):
    """Three old runs and the present one, made in no order."""
    for name in (DAYS[1], OWN, DAYS[2], DAYS[0]):
        run_folder(tmp_path, name)
    return tmp_path


@pytest.fixture
def small_disk(runs, monkeypatch):
    """A disk on which every run takes 100 MB and 50 MB are free beside the four."""

    def free(_folder):
        return 450.0 - 100.0 * sum(path.is_dir() for path in runs.glob("2026*"))

    monkeypatch.setattr(disk, "free_mb", free)
    return runs


def floor(root, keep_free_mb, *, delete_oldest=True):
    return DiskFloor(RecordConfig(keep_free_mb=keep_free_mb, delete_oldest=delete_oldest), root / OWN)


def names(root):
    return sorted(path.name for path in root.iterdir())


def test_the_oldest_goes_first_and_no_more_than_needed(small_disk):
    made = floor(small_disk, 200.0)
    assert made.trouble() is None
    assert made.deleted == DAYS[:2]
    assert names(small_disk) == [DAYS[2], OWN]


def test_the_present_run_stays_and_the_floor_is_told(small_disk):
    made = floor(small_disk, 500.0)
    assert made.trouble() == "less than 500 MB are free on the disk (record.keep_free_mb)"
    assert names(small_disk) == [OWN]


def test_nothing_is_deleted_unasked(small_disk):
    made = floor(small_disk, 200.0, delete_oldest=False)
    assert made.trouble() is not None
    assert names(small_disk) == [*DAYS, OWN]
    assert not RecordConfig().delete_oldest


def test_a_manifest_made_to_choke_on_stops_nothing(small_disk):
    (small_disk / DAYS[0] / "manifest.json").write_text(100_000 * "[")
    made = floor(small_disk, 100.0)
    assert made.trouble() is None
    assert made.deleted == DAYS[1:2]


def test_nothing_is_deleted_while_there_is_room(small_disk):
    assert floor(small_disk, 50.0).trouble() is None
    assert names(small_disk) == [*DAYS, OWN]


def a_link(folder):
    target = run_folder(folder.parent, "elsewhere")
    shutil.rmtree(folder)
    folder.symlink_to(target)


def a_link_in_it(folder):
    (folder / "A.tlog").unlink()
    (folder / "A.tlog").symlink_to("/etc/hostname")


def a_folder_in_it(folder):
    (folder / "notes").mkdir()


def of_a_simulation(folder):
    (folder / "manifest.json").write_text(json.dumps({"what": "sitl-mocks demo"}))


def a_strange_manifest(folder):
    (folder / "manifest.json").write_text("[1]")


def without_manifest(folder):
    (folder / "manifest.json").unlink()


def without_record(folder):
    (folder / "A.events").unlink()


def another_name(folder):
    folder.rename(folder.parent / "holiday")


def a_file(folder):
    shutil.rmtree(folder)
    folder.write_text("")


@pytest.mark.parametrize(
    "change",
    [
        a_link, a_link_in_it, a_folder_in_it, of_a_simulation, a_strange_manifest, without_manifest,
        without_record, another_name, a_file,
    ],
)  # fmt: skip
def test_what_is_not_surely_a_finished_run_of_ours_is_left_alone(runs, change):
    assert [path.name for path in finished_runs(runs)] == [*DAYS, OWN]
    change(runs / DAYS[0])
    assert [path.name for path in finished_runs(runs)] == [*DAYS[1:], OWN]


def test_a_run_that_is_being_written_is_not_finished(runs, make_config, until):
    header = Header(aircraft="A", software="0", config=make_config())
    recorder = FlightRecorder(lambda: runs / DAYS[0], header, RecordConfig(keep_free_mb=0.0))
    until(lambda: recorder.recording)
    assert [path.name for path in finished_runs(runs)] == [*DAYS[1:], OWN]
    recorder.close()
    assert [path.name for path in finished_runs(runs)] == [*DAYS, OWN]


@pytest.mark.parametrize("name", ["companion", "drone-7"])
def test_of_runs_that_began_at_one_time_the_first_is_the_oldest(tmp_path, name):
    """As those of a computer without a clock, which begins each time in 1970."""
    began = [f"19700101T000020Z-{name}{number}" for number in ("", *(f"-{n}" for n in range(2, 12)))]
    for name in (*reversed(began), DAYS[0]):
        run_folder(tmp_path, name)
    assert [path.name for path in finished_runs(tmp_path)] == [*began, DAYS[0]]


def test_the_folder_need_not_be_there_yet(tmp_path):
    assert free_mb(tmp_path / "runs" / "to" / "come") == pytest.approx(free_mb(tmp_path), rel=0.1)
    assert finished_runs(Path("/nowhere")) == []


WRITER = """
import sys
from pathlib import Path
from companion.runtime.record.disk import replace_file
for _ in range(100):
    replace_file(Path(sys.argv[1]), sys.argv[2].encode() * 20_000)
"""


def test_two_processes_that_write_one_file_publish_nothing_torn(tmp_path):
    path = tmp_path / "signing-timestamp"
    writers = [subprocess.Popen([sys.executable, "-c", WRITER, path, digit]) for digit in "12"]
    seen = set()
    while any(writer.poll() is None for writer in writers):
        with contextlib.suppress(FileNotFoundError):
            data = path.read_bytes()
            seen.add((len(data), len(set(data))))
    assert [writer.returncode for writer in writers] == [0, 0]
    assert seen <= {(20_000, 1)}
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_the_draft_of_a_file_is_beside_it_and_overwrites_no_other(tmp_path):
    other = tmp_path / "flights.new"
    other.write_text("kept")
    replace_file(tmp_path / "flights.json", b"{}")
    assert other.read_text() == "kept"
