"""A disk that is full, slow or gone is told of, and ends nothing."""

from __future__ import annotations

import errno
import io
import threading

import pytest

from companion import record
from companion.config import RecordConfig
from companion.record import Header, Step
from companion.runtime.recorder import FlightRecorder
from companion.runtime.run_record import _Tape

SLOW = RecordConfig(sync_period_s=60.0, keep_free_mb=0.0)


class Disk(io.RawIOBase):
    """A file that can be told to fail or to hang."""

    def __init__(self):
        self.full = False
        self.may_write = threading.Event()
        self.may_write.set()
        self.asked = threading.Event()

    def writable(self):
        return True

    def fileno(self):
        raise OSError(errno.ENOSPC, "No space left on device")

    def write(self, data):
        self.asked.set()
        self.may_write.wait()
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        return len(data)


@pytest.fixture
def header(make_config):
    return Header(aircraft="A", software="0", config=make_config())


def step(now_s):
    return Step(now_s=now_s, events=(), commands=())


def on(disk, recorder):
    """Let a recorder write its events to `disk`."""
    recorder._events.close()
    recorder._events = io.BufferedWriter(disk, 16)
    return recorder


def test_all_is_there_after_close(tmp_path, header):
    recorder = FlightRecorder(tmp_path, header, SLOW)
    for number in range(100):
        recorder.step(step(float(number)))
    recorder.write(b"tlog")
    assert recorder.close()
    assert recorder.error is None
    assert recorder.dropped == 0
    items = list(record.read(io.BytesIO((tmp_path / "A.events").read_bytes()), "A"))
    assert items == [header, *(step(float(number)) for number in range(100))]
    assert (tmp_path / "A.tlog").read_bytes() == b"tlog"


def test_a_long_wait_on_a_busy_link_crowds_nothing_out(tmp_path, header, monkeypatch):
    monkeypatch.setattr("companion.runtime.recorder._QUEUE", 10)
    disk = Disk()
    recorder = on(disk, FlightRecorder(tmp_path, header, SLOW))
    disk.may_write.clear()
    recorder.step(step(0.0))
    disk.asked.wait()
    tape = _Tape()
    for _ in range(50):
        tape.write(b"early")
    tape.play(recorder)
    tape.write(b"late")
    recorder.step(step(1.0))
    assert recorder.dropped == 0
    disk.may_write.set()
    recorder.close()
    assert (tmp_path / "A.tlog").read_bytes() == 50 * b"early" + b"late"


def test_a_full_disk_is_an_error_that_close_does_not_raise(tmp_path, header, until):
    disk = Disk()
    recorder = on(disk, FlightRecorder(tmp_path, header, SLOW))
    disk.full = True
    for number in range(10):
        recorder.step(step(float(number)))
    until(lambda: recorder.error is not None)
    assert recorder.close()
    assert "No space left" in (recorder.error or "")
    assert recorder.dropped > 0


def test_a_disk_that_fails_only_at_close_is_an_error_kept(tmp_path, header):
    disk = Disk()
    recorder = FlightRecorder(tmp_path, header, SLOW)
    recorder._events.close()
    recorder._events = io.BufferedWriter(disk, 1 << 20)
    disk.full = True
    recorder.step(step(0.0))
    assert recorder.close()
    assert "No space left" in (recorder.error or "")


def test_close_gives_up_on_a_disk_that_hangs_with_a_full_queue(tmp_path, header, monkeypatch):
    monkeypatch.setattr("companion.runtime.recorder._QUEUE", 10)
    disk = Disk()
    recorder = on(disk, FlightRecorder(tmp_path, header, SLOW))
    disk.may_write.clear()
    recorder.step(step(0.0))
    disk.asked.wait()
    for number in range(1, 50):
        recorder.step(step(float(number)))
    assert recorder.close(timeout_s=0.1) is False
    assert "took nothing" in (recorder.error or "")
    assert recorder.dropped >= 49
    disk.may_write.set()


def test_files_that_cannot_be_made_are_an_error_at_once(tmp_path, header):
    with pytest.raises(OSError):
        FlightRecorder(tmp_path / "absent", header, SLOW)


def test_below_the_floor_writing_stops_and_what_is_lost_is_counted(tmp_path, header, until, monkeypatch):
    free = [1000.0]
    monkeypatch.setattr("companion.runtime.disk.free_mb", lambda _folder: free[0])
    monkeypatch.setattr("companion.runtime.recorder._LOOK_S", 0.0)
    config = RecordConfig(sync_period_s=0.01, keep_free_mb=300.0)
    recorder = FlightRecorder(tmp_path, header, config)
    recorder.step(step(0.0))
    until(lambda: b"Step" in (tmp_path / "A.events").read_bytes())
    free[0] = 299.0
    until(lambda: recorder.error is not None)
    recorder.step(step(1.0))
    recorder.step(step(2.0))
    assert recorder.close()
    assert recorder.error == "less than 300 MB are free on the disk (record.keep_free_mb)"
    assert recorder.dropped == 2
    items = list(record.read(io.BytesIO((tmp_path / "A.events").read_bytes()), "A"))
    assert items == [header, step(0.0)]
