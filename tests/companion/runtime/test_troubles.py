"""Troubles of the computer beside the flight: told, to the pilot once, and flown on with."""

from __future__ import annotations

import errno
import shutil
import threading
import time

import msgspec
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.signing import Signing, timestamp_at
from companion.autopilot.wire import MavlinkReader, MavlinkWriter
from companion.commands import status
from companion.config import RecordConfig, VehicleConfig
from companion.events import Firmware
from companion.runtime import clock
from companion.runtime.flight import Flight
from companion.runtime.links.open_link import LinkTrouble
from companion.runtime.record import run_record
from tests.companion.runtime.flying import KEY, Autopilot, Joined, Radio, configured, fly, heard_of, summary

NOT_RECORDED = "DMUCA: this flight is not recorded"


class Listening(Autopilot):
    """Keeps the texts to the pilot."""

    def __init__(self, after=b""):
        self.texts = []
        super().__init__(wrap=lambda heartbeat: heartbeat + after)

    def _speak(self, peer):
        reader = MavlinkReader()

        class Tapped:
            setblocking, sendall = peer.setblocking, peer.sendall

            @staticmethod
            def recv(size):
                data = peer.recv(size)
                for message in reader.feed(data):
                    if message.get_type() == "STATUSTEXT":
                        self.texts.append(message.text)
                return data

        super()._speak(Tapped)


@pytest.fixture
def pilot():
    served = Listening()
    yield served
    served.end()


@pytest.fixture
def flight_to(make_config, tmp_path, said, kept_signals, watchdog, monkeypatch):
    """A flight that watches, with its record below a folder."""
    monkeypatch.setattr("companion.runtime.flight._STATUS_S", 0.1)

    def make(pilot, folder=None, *, dry_run=False, key=None):
        config = configured(make_config, tmp_path, pilot.port)
        record = RecordConfig(folder=str(folder or tmp_path / "runs"), sync_period_s=0.01, keep_free_mb=0.0)
        config = msgspec.structs.replace(config, record=record)
        if key is not None:
            vehicle = VehicleConfig(link=config.vehicle.link, wait_s=60.0, signing_key=str(key))
            config = msgspec.structs.replace(config, vehicle=vehicle)
        made = Flight(config, said.append, dry_run=dry_run)
        made.radio = Radio()
        return made

    return make


def goes_on(flight, until):
    """It ticks, and has not ended."""

    def check():
        ticks = flight._ticks
        until(lambda: flight._ticks > ticks + 5)

    return check


def a_file(path):
    path.write_text("")
    return path, "Not a directory"


def a_file_for_a_parent(path):
    path.write_text("")
    return path / "runs", "Not a directory"


@pytest.mark.parametrize("make", [a_file, a_file_for_a_parent])
@pytest.mark.parametrize("dry_run", [False, True])
def test_a_record_folder_that_cannot_be_made_ends_no_flight(
    flight_to, pilot, said, until, tmp_path, make, dry_run
):
    folder, why = make(tmp_path / "x")
    flight = flight_to(pilot, folder, dry_run=dry_run)
    states = []
    told = f"not recording: record.folder: {folder}: cannot be written: {why}"
    fly(
        flight,
        lambda: until(heard_of(said, told)),
        goes_on(flight, until),
        lambda: until(lambda: NOT_RECORDED in pilot.texts or dry_run),
        lambda: states.append(status.ask(flight._server.path)),
        lambda: until(lambda: flight.radio.broadcasts > 1),
    )
    assert said.count(f"{told}; the flight continues") == 1
    assert said.count(f"there is no record: {told.removeprefix('not recording: ')}") == 1
    assert pilot.texts.count(NOT_RECORDED) == (0 if dry_run else 1)
    assert states[0].recorder_error == told.removeprefix("not recording: ")
    assert told in states[0].troubles
    assert states[0].folder is None
    assert any(told in line for line in said if line.startswith("standby")), "the status line"
    assert flight.folder is None


@pytest.mark.parametrize(
    ("number", "at"),
    [
        (errno.EROFS, "create_run_folder"),
        (errno.ENOSPC, "_write_configuration"),
        (errno.EIO, "write_manifest"),
    ],
)
def test_whatever_fails_at_the_start_ends_no_flight(flight_to, pilot, said, until, monkeypatch, number, at):
    def fails(*_, **__):
        raise OSError(number, "the disk's words")

    monkeypatch.setattr(run_record, at, fails)
    flight = flight_to(pilot)
    fly(flight, lambda: until(lambda: NOT_RECORDED in pilot.texts), goes_on(flight, until))
    assert heard_of(said, "not recording: the disk's words; the flight continues")()


def test_a_record_that_vanishes_in_flight_ends_no_flight(flight_to, pilot, said, until, monkeypatch):
    monkeypatch.setattr("companion.runtime.record.recorder._LOOK_S", 0.0)
    flight = flight_to(pilot)
    fly(
        flight,
        lambda: until(heard_of(said, "recording to")),
        lambda: shutil.rmtree(flight.folder),
        lambda: until(lambda: NOT_RECORDED in pilot.texts),
        goes_on(flight, until),
    )
    assert pilot.texts.count(NOT_RECORDED) == 1
    assert heard_of(said, "OWN.events: No such file or directory; the flight continues")()
    assert not flight.folder.exists()


def test_a_disk_that_fills_up_in_flight_ends_no_flight(flight_to, pilot, said, until, monkeypatch):
    flight = flight_to(pilot)

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    fly(
        flight,
        lambda: until(heard_of(said, "recording to")),
        lambda: monkeypatch.setattr("companion.runtime.record.recorder.write_all", full),
        lambda: monkeypatch.setattr("companion.runtime.record.disk.write_all", full),
        lambda: until(lambda: NOT_RECORDED in pilot.texts),
        goes_on(flight, until),
    )
    assert pilot.texts.count(NOT_RECORDED) == 1
    assert heard_of(said, "not recording: No space left on device; the flight continues")()
    assert heard_of(said, "summary.json: cannot be written: No space left on device")()


def test_a_disk_that_hangs_at_the_start_holds_up_no_tick_and_no_end(
    flight_to, pilot, said, until, monkeypatch
):
    monkeypatch.setattr("companion.runtime.record.recorder._HANGS_S", 0.1)
    monkeypatch.setattr("companion.runtime.record.run_record.CLOSE_S", 0.1)
    comes_back = threading.Event()
    monkeypatch.setattr(run_record, "create_run_folder", lambda *_: comes_back.wait())
    flight = flight_to(pilot)
    fly(
        flight,
        lambda: until(lambda: "DMUCA: the disk is too slow for the record" in pilot.texts),
        goes_on(flight, until),
    )
    assert heard_of(said, "recording: the disk has not answered for 0.1 s; the flight continues")()
    assert heard_of(said, "there is no record: the disk accepted no data for 0.1 s at the end")()
    comes_back.set()


def test_a_disk_that_hung_for_a_while_is_told_and_has_lost_nothing(
    flight_to, pilot, said, until, monkeypatch
):
    monkeypatch.setattr("companion.runtime.record.recorder._HANGS_S", 0.1)
    comes_back, write_manifest = threading.Event(), run_record.write_manifest

    def hangs(*arguments, **facts):
        comes_back.wait()
        write_manifest(*arguments, **facts)

    monkeypatch.setattr(run_record, "write_manifest", hangs)
    flight = flight_to(pilot)
    fly(
        flight,
        lambda: until(heard_of(said, "has not answered")),
        goes_on(flight, until),
        comes_back.set,
        lambda: until(heard_of(said, "recording to")),
        lambda: until(lambda: not flight._troubles.texts),
    )
    found = summary(flight)
    assert (found["recorder_error"], found["records_dropped"]) == (None, 0)


def test_settings_that_cannot_be_kept_count_all_the_same(flight_to, said, until, tmp_path):
    sets = MavlinkWriter(255, 190).pack(
        mavlink.MAVLink_param_set_message(1, 191, b"DMUCA_ENABLE", 0.0, mavlink.MAV_PARAM_TYPE_REAL32)
    )
    pilot = Listening(after=sets)
    (tmp_path / "runs").write_text("a file")
    flight = flight_to(pilot)
    assert flight.onboard.settings.enable
    words = "DMUCA: settings cannot be saved to disk"
    fly(flight, lambda: until(lambda: words in pilot.texts), goes_on(flight, until))
    pilot.end()
    assert not flight.onboard.settings.enable
    assert pilot.texts.count(words) == 1
    assert heard_of(said, f"settings not saved: {tmp_path}/runs: cannot be written: File exists")()


def test_a_signing_time_that_cannot_be_kept_ends_no_flight(flight_to, said, until, tmp_path):
    key = tmp_path / "key"
    key.write_text(KEY.hex())
    key.chmod(0o600)
    (tmp_path / "runs").write_text("a file")
    vehicle = Signing(KEY, timestamp_at(time.time()), 0.0)
    pilot = Listening()
    pilot._wrap = vehicle.sign
    flight = flight_to(pilot, key=key)
    flight._signing.wrong_clock = "the clock's trouble"
    words = {
        "DMUCA: signing time cannot be saved to disk",
        "DMUCA: the last signing time is unknown",
        "DMUCA: the clock for signing is wrong",
    }
    fly(flight, lambda: until(lambda: words <= set(pilot.texts)), goes_on(flight, until))
    pilot.end()
    assert heard_of(said, f"signing time not saved: {tmp_path}/runs: cannot be written: File exists")()
    assert heard_of(said, "signing-timestamp: cannot be read: Not a directory; the flight continues")()
    assert heard_of(said, "signing: the clock's trouble; the flight continues")()


# ---------------------------------------------------------------- clocks


@pytest.fixture
def guarding(make_config, tmp_path, monkeypatch, said, kept_signals, watchdog):
    """A flight that flies a mock vehicle in this process, and its link."""
    link = Joined(Firmware.ARDUPILOT)
    link.trouble = LinkTrouble()
    monkeypatch.setattr("companion.runtime.flight.KeptLink", lambda *_: link)
    config = make_config(use="fly")
    config = msgspec.structs.replace(config, record=RecordConfig(folder=str(tmp_path)))
    return Flight(config, said.append, dry_run=False), link


def setpoints(link, after):
    return [m for m in link.left[after:] if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]


def test_nothing_in_flight_asks_the_wall_clock(guarding, said, until, monkeypatch):
    """It may jump by years, as when a receiver has found the time: nobody sees it."""
    flight, link = guarding
    asked = []
    at = []

    def jump():
        at.append(len(link.left))
        monkeypatch.setattr(time, "time", lambda: asked.append(1) or 0.0)

    fly(
        flight,
        lambda: until(heard_of(said, "standby -> guarding")),
        lambda: until(heard_of(said, "recording to")),
        jump,
        lambda: until(lambda: len(setpoints(link, at[0])) > 20),
        monkeypatch.undo,
    )
    assert not asked
    assert not heard_of(said, "fault")()


def test_a_computer_that_was_suspended_flies_on_nothing_old(guarding, said, until, monkeypatch):
    flight, link = guarding
    at, asleep_s = [], [0.0]
    read = clock.now_s
    monkeypatch.setattr(clock, "now_s", lambda: read() + asleep_s[0])

    def suspend():
        asleep_s[0] = 60.0
        at.append(len(link.left))

    fly(
        flight,
        lambda: until(heard_of(said, "standby -> guarding")),
        lambda: until(lambda: len(setpoints(link, 0)) > 20),
        suspend,
        lambda: until(heard_of(said, "guarding -> fault")),
        lambda: until(heard_of(said, "fault -> standby")),
    )
    assert heard_of(said, "guarding -> fault: the control loop is late")()
    first = [(m.vx, m.vy, m.vz) for m in setpoints(link, at[0])[:5]]
    assert set(first) <= {(0.0, 0.0, 0.0)}
