"""A disk that is full, slow or gone is told of, and ends nothing."""

from __future__ import annotations

import errno
import io
import json
import os
import shutil
import threading

import pytest

from companion import event_record
from companion.config import RecordConfig
from companion.errors import ConfigError
from companion.event_record import Header, Step
from companion.runtime import clock
from companion.runtime.record import disk
from companion.runtime.record.recorder import FlightRecorder, create_run_folder, write_json

SLOW = RecordConfig(sync_period_s=60.0, keep_free_mb=0.0)
QUICK = RecordConfig(sync_period_s=0.01, keep_free_mb=0.0)


class Disk:
    """Stands before the real one; can be told to fail or to hang."""

    def __init__(self):
        self.full = False
        self.may_write = threading.Event()
        self.may_write.set()
        self.asked = threading.Event()

    def write_all(self, file, data):
        if not data:
            return
        self.asked.set()
        self.may_write.wait()
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        disk.write_all(file, data)


@pytest.fixture
def header(make_config):
    return Header(aircraft="A", software="0", config=make_config())


@pytest.fixture
def a_disk(monkeypatch):
    made = Disk()
    monkeypatch.setattr("companion.runtime.record.recorder.write_all", made.write_all)
    yield made
    made.may_write.set()


@pytest.fixture
def started(tmp_path, header, until):
    """A recorder that takes what comes."""

    def start(config=SLOW, **early):
        recorder = FlightRecorder(lambda: tmp_path, header, config, **early)
        until(lambda: recorder.recording)
        return recorder

    return start


def step(now_s):
    return Step(now_s=now_s, events=(), commands=())


def recorded(folder):
    return list(event_record.read(io.BytesIO((folder / "A.events").read_bytes()), "A"))


def test_all_is_there_after_close(tmp_path, header, started):
    recorder = started(steps=[step(-2.0), step(-1.0)], tape=b"early")
    for number in range(100):
        recorder.step(step(float(number)))
    recorder.write(b"tlog")
    assert recorder.close()
    assert recorder.error is None
    assert recorder.dropped == 0
    assert recorder.folder == tmp_path
    assert recorded(tmp_path) == [header, *(step(float(number)) for number in range(-2, 100))]
    assert (tmp_path / "A.tlog").read_bytes() == b"earlytlog"


def test_more_than_the_buffer_and_the_queue_hold_from_before_the_start_is_written(
    tmp_path, header, monkeypatch
):
    """A long wait on a busy link crowds nothing out."""
    monkeypatch.setattr("companion.runtime.record.recorder._QUEUE", 10)
    early = [step(float(number)) for number in range(5000)]
    recorder = FlightRecorder(lambda: tmp_path, header, SLOW, early, 200_000 * b"x")
    assert recorder.close()
    assert recorder.dropped == 0
    assert recorded(tmp_path) == [header, *early]
    assert (tmp_path / "A.tlog").stat().st_size == 200_000


def test_a_full_disk_is_an_error_that_close_does_not_raise(a_disk, until, started):
    recorder = started(QUICK)
    a_disk.full = True
    for number in range(10):
        recorder.step(step(float(number)))
    until(lambda: recorder.error is not None)
    assert recorder.close()
    assert recorder.error == "No space left on device"
    assert recorder.dropped == 10


def test_a_disk_that_fails_only_at_the_end_is_an_error_kept(a_disk, started):
    recorder = started()
    a_disk.full = True
    recorder.step(step(0.0))
    assert recorder.close()
    assert recorder.error == "No space left on device"
    assert recorder.dropped == 1


def test_close_gives_up_on_a_disk_that_hangs_with_a_full_queue(a_disk, until, started, monkeypatch):
    monkeypatch.setattr("companion.runtime.record.recorder._QUEUE", 10)
    recorder = started(QUICK)
    a_disk.may_write.clear()
    a_disk.asked.clear()
    before_s = clock.now_s()
    recorder.step(step(0.0))
    a_disk.asked.wait()
    for number in range(1, 50):
        recorder.step(step(float(number)))
    assert recorder.slow(before_s) == "the disk was too slow: records are missing"
    assert recorder.slow(clock.now_s() + 6.0) == "the disk has not answered for 5 s"
    assert recorder.close(timeout_s=0.1) is False
    assert "accepted no data" in (recorder.error or "")
    assert recorder.dropped >= 49
    a_disk.may_write.set()
    until(lambda: not recorder._thread.is_alive())


def test_a_disk_that_hung_for_a_while_loses_nothing(a_disk, until, started, tmp_path, header):
    recorder = started(QUICK)
    a_disk.may_write.clear()
    a_disk.asked.clear()
    recorder.step(step(0.0))
    a_disk.asked.wait()
    for number in range(1, 50):
        recorder.step(step(float(number)))
    assert recorder.slow(clock.now_s() + 6.0) is not None
    a_disk.may_write.set()
    until(lambda: recorder.slow(clock.now_s() + 6.0) is None)
    assert recorder.close()
    assert recorder.error is None
    assert recorded(tmp_path) == [header, *(step(float(number)) for number in range(50))]


@pytest.mark.parametrize("name", ["A.events", "A.tlog"])
def test_a_file_that_blocks_when_it_is_opened_holds_up_nobody(tmp_path, header, name, until):
    """A pipe without a reader: the real call of the system blocks."""
    os.mkfifo(tmp_path / name)
    recorder = FlightRecorder(lambda: tmp_path, header, SLOW)
    recorder.step(step(0.0))
    recorder.write(b"tlog")
    until(lambda: recorder.slow(clock.now_s() + 6.0) == "the disk has not answered for 5 s")
    assert recorder.close(timeout_s=0.05) is False
    os.close(os.open(tmp_path / name, os.O_RDONLY | os.O_NONBLOCK))  # lets the thread go on


def test_a_file_that_blocks_when_it_is_written_holds_up_nobody(tmp_path, header, until):
    """A pipe that nobody empties takes 64 KB."""
    os.mkfifo(tmp_path / "A.tlog")
    reader = os.open(tmp_path / "A.tlog", os.O_RDONLY | os.O_NONBLOCK)
    recorder = FlightRecorder(lambda: tmp_path, header, SLOW)
    for _ in range(200):
        recorder.write(1000 * b"x")
    until(lambda: recorder.slow(clock.now_s() + 6.0) == "the disk has not answered for 5 s")
    assert recorder.close(timeout_s=0.05) is False
    os.close(reader)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(errno.EROFS, "Read-only file system", "runs"), "runs: Read-only file system"),
        (ConfigError("record.folder: runs: cannot be written"), "record.folder: runs: cannot be written"),
        (KeyError("a bug"), "KeyError: 'a bug'"),
    ],
)
def test_a_folder_that_cannot_be_made_is_an_error_kept(header, until, error, words):
    def fails():
        raise error

    recorder = FlightRecorder(fails, header, SLOW, [step(0.0)], b"early")
    until(lambda: recorder.error is not None)
    recorder.step(step(1.0))
    recorder.write(b"tlog")
    assert recorder.close()
    assert recorder.error == words
    assert recorder.folder is None
    assert not recorder.recording
    assert recorder.dropped == 4


def make_a_file(path):
    path.write_text("")
    return path


def make_a_parent_a_file(path):
    path.write_text("")
    return path / "runs"


def make_a_parent_that_is_not_there(path):
    return path / "a" / "b" / "runs"


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (make_a_file, "Not a directory"),
        (make_a_parent_a_file, "Not a directory"),
        (make_a_parent_that_is_not_there, None),
    ],
)
def test_what_stands_in_the_folders_place(tmp_path, header, until, make, words):
    root = make(tmp_path / "x")
    recorder = FlightRecorder(lambda: create_run_folder(root, "n", 0.0), header, SLOW)
    until(lambda: recorder.recording or recorder.error is not None)
    assert recorder.close()
    if words is None:
        assert recorder.error is None
        assert recorded(recorder.folder) == [header]
    else:
        assert recorder.error == f"record.folder: {root}: cannot be written: {words}"


@pytest.mark.parametrize("replaced", [False, True])
def test_a_folder_that_vanishes_is_an_error(tmp_path, header, until, monkeypatch, replaced):
    """Writing to files that were deleted fails nowhere, and is kept nowhere."""
    monkeypatch.setattr("companion.runtime.record.recorder._LOOK_S", 0.0)
    folder = tmp_path / "run"
    folder.mkdir()
    recorder = FlightRecorder(lambda: folder, header, QUICK)
    until(lambda: recorder.recording)
    for number in range(10):
        recorder.step(step(float(number)))
    for _ in range(4):
        recorder.write(b"frame")
    until(lambda: (folder / "A.tlog").stat().st_size == 4 * len(b"frame"))
    if replaced:
        (folder / "A.tlog").unlink()
        (folder / "A.tlog").touch()
    else:
        shutil.rmtree(folder)
    until(lambda: recorder.error is not None)
    expected = "A.tlog: was replaced by another file" if replaced else "A.events: No such file or directory"
    assert recorder.error == f"{folder}/{expected}"
    assert recorder.close()
    assert recorder.dropped == (4 if replaced else 14)


def test_a_folder_that_vanishes_right_before_the_end_is_an_error(tmp_path, header, until):
    folder = tmp_path / "run"
    folder.mkdir()
    recorder = FlightRecorder(lambda: folder, header, SLOW)
    until(lambda: recorder.recording)
    recorder.step(step(0.0))
    shutil.rmtree(folder)
    assert recorder.close()
    assert recorder.error == f"{folder}/A.events: was deleted"
    assert recorder.dropped == 1


def test_below_the_floor_writing_stops_and_what_is_lost_is_counted(
    tmp_path, header, until, monkeypatch, started
):
    free = [1000.0]
    monkeypatch.setattr("companion.runtime.record.disk.free_mb", lambda _folder: free[0])
    monkeypatch.setattr("companion.runtime.record.recorder._LOOK_S", 0.0)
    recorder = started(RecordConfig(sync_period_s=0.01, keep_free_mb=300.0))
    recorder.step(step(0.0))
    until(lambda: b"Step" in (tmp_path / "A.events").read_bytes())
    free[0] = 299.0
    until(lambda: recorder.error is not None)
    recorder.step(step(1.0))
    recorder.step(step(2.0))
    assert recorder.close()
    assert recorder.error == "less than 300 MB are free on the disk (record.keep_free_mb)"
    assert recorder.dropped == 2
    assert recorded(tmp_path) == [header, step(0.0)]


def test_a_summary_with_a_name_that_is_no_text_is_written(tmp_path):
    write_json(tmp_path / "summary.json", {"runs_deleted": [os.fsdecode(b"20260101T000000Z-caf\xe9")]})
    assert json.loads((tmp_path / "summary.json").read_text()) == {"runs_deleted": ["20260101T000000Z-caf?"]}
