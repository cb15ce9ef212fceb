"""The flight loop goes on through whatever happens beside it."""

from __future__ import annotations

import errno
import math
import os
import signal
import socket
import threading
import time

import msgspec
import pytest

from companion.autopilot.wire import MavlinkReader
from companion.errors import ConfigError
from companion.events import RadioState, RemoteIdHeard
from companion.remote_id.messages import Location
from companion.runtime import clock
from companion.runtime.flight import Flight
from companion.runtime.links.byte_link import Received
from companion.runtime.waited_frames import WaitedFrames
from tests.companion.runtime.flying import (
    Autopilot,
    configured,
    fly,
    heard_of,
    summary,
)


def test_a_lost_link_comes_back_and_remote_id_goes_on_meanwhile(flight, autopilot, said, until):
    again = []

    def broadcasts_without_link():
        sent = flight.radio.broadcasts
        until(lambda: flight.radio.broadcasts >= sent + 2)
        assert not flight.link.up

    fly(
        flight,
        lambda: until(heard_of(said, "recording to")),
        autopilot.end,
        lambda: until(lambda: not flight.link.up),
        broadcasts_without_link,
        lambda: until(heard_of(said, "link down")),
        lambda: again.append(Autopilot(autopilot.port)),
        lambda: until(lambda: flight.link.up and again[0].commands),
    )
    again[0].end()
    found = summary(flight)
    # A stall of the test's computer makes the flight reopen the link, too.
    assert found["link_losses"] == 1 or heard_of(said, "the program was stopped")()
    assert sum("lost:" in line for line in said) == found["link_losses"]
    assert sum(line.endswith(": restored") for line in said) == found["link_losses"]
    assert found["link_sends_dropped"] > 0
    assert found["recorder_error"] is None


def test_a_refused_broadcast_is_counted_and_said_once(flight, said, until):
    flight.radio.refusals = ["too high", "too fast"]
    fly(flight, lambda: until(lambda: flight.radio.broadcasts >= 4 and heard_of(said, "recording to")()))
    found = summary(flight)
    assert found["broadcasts_refused"] >= 4
    assert found["broadcast_errors"] == ["too fast", "too high"]
    assert sum("too high" in line for line in said) == 1
    assert sum("too fast" in line for line in said) == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_end_a_flight_in_order(flight, said, until, number):
    signal.signal(number, lambda *_: None)
    released = threading.Event()

    def ended():
        os.kill(os.getpid(), number)
        until(lambda: flight._stop)
        released.set()

    fly(flight, lambda: until(heard_of(said, "recording to")), ended)
    assert released.is_set()
    assert summary(flight)["ticks"] > 0


def test_under_nohup_a_closed_terminal_ends_nothing(flight, said, until):
    signal.signal(signal.SIGHUP, signal.SIG_IGN)

    def hang_up():
        os.kill(os.getpid(), signal.SIGHUP)
        ticks = flight._ticks
        until(lambda: flight._ticks > ticks + 3)
        assert not flight._stop

    fly(flight, lambda: until(heard_of(said, "recording to")), hang_up)


@pytest.mark.parametrize(("held_up_s", "leaves"), [(0.2, True), (0.3, False)])
def test_what_a_tick_decided_leaves_in_time_or_not_at_all(flight, monkeypatch, held_up_s, leaves):
    """The gate is asked as the bytes leave, not as they were decided."""
    now, asked = [1000.0], []
    monkeypatch.setattr(clock, "now_s", lambda: now[0])
    monkeypatch.setattr(flight.link, "receive", lambda _: Received())

    def held_up(now_s, **_):
        flight.onboard.gate.decided(now_s)
        now[0] += held_up_s
        return []

    monkeypatch.setattr(flight.onboard, "tick", held_up)
    monkeypatch.setattr(flight.onboard, "drain", lambda now_s: asked.append(now_s) or b"")
    flight._tick()
    assert asked == [1000.0 + held_up_s]
    assert flight.onboard.gate.in_time(asked[0]) is leaves
    flight._close()


def test_a_broken_pipe_does_not_end_a_flight(autopilot, make_config, tmp_path, kept_signals, watchdog, until):
    def broken(_line):
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    made = Flight(configured(make_config, tmp_path, autopilot.port), broken, dry_run=False)

    def flown():
        ticks = made._ticks
        until(lambda: made.folder is not None and made._ticks > ticks + 5)

    fly(made, flown)
    assert summary(made)["lines_dropped"] >= 3


class Control:
    """What a flight asks of the core before it lets go."""

    def __init__(self, core, in_control):
        self._core = core
        self.in_control = in_control

    def __getattr__(self, name):
        return getattr(self._core, name)


@pytest.mark.parametrize("in_control", [True, False])
def test_lets_go_of_what_it_controls_and_of_nothing_else(
    flight, autopilot, said, until, watchdog, monkeypatch, in_control
):
    monkeypatch.setattr("companion.runtime.flight._LET_GO_S", 0.3)
    asked = []
    monkeypatch.setattr(flight.onboard, "let_go", lambda _now_s: asked.append(list(watchdog)))
    flight.onboard.core = Control(flight.onboard.core, in_control)
    fly(flight, lambda: until(heard_of(said, "recording to")), lambda: until(lambda: watchdog))
    assert heard_of(said, "asking the vehicle to hold")() is in_control
    # Letting go may last; the watchdog must not end it.
    assert [calls[-1] for calls in asked] == (["stop"] if in_control else [])
    assert watchdog[0] == "start"
    assert "report" in watchdog


def texts_sent(flight, monkeypatch):
    """Severity and text of each STATUSTEXT that the flight has sent; a list that grows."""
    texts, reader, send = [], MavlinkReader(), flight.link.send

    def kept(data):
        texts.extend((m.severity, m.text) for m in reader.feed(data) if m.get_type() == "STATUSTEXT")
        send(data)

    monkeypatch.setattr(flight.link, "send", kept)
    return texts


@pytest.mark.parametrize("armed", [True, False])
def test_the_pilot_reads_that_the_companion_stops(flight, autopilot, said, until, monkeypatch, armed):
    autopilot.armed = armed
    texts, own = texts_sent(flight, monkeypatch), flight.onboard.core.own
    fly(
        flight,
        lambda: until(heard_of(said, "recording to")),
        lambda: until(lambda: own.heartbeat is not None),
    )
    assert [t for t in texts if "companion stops" in t[1]] == [
        (4 if armed else 6, "DMUCA: the companion stops: from now on it avoids ")
    ]


@pytest.mark.parametrize("kind", [ZeroDivisionError, GeneratorExit])  # a plug-in may raise any of them
def test_a_bug_in_flight_lets_go_of_the_vehicle_before_the_process_ends(
    flight, said, until, watchdog, monkeypatch, kind
):
    monkeypatch.setattr("companion.runtime.flight._LET_GO_S", 0.3)
    flight.onboard.core = Control(flight.onboard.core, in_control=True)
    texts = texts_sent(flight, monkeypatch)

    def broken(_now_s, _events):
        raise kind("a bug")

    def break_down():
        until(heard_of(said, "recording to"))
        flight.onboard.core.step = broken
        until(lambda: "stop" in watchdog)

    with pytest.raises(kind, match="a bug"):
        fly(flight, break_down)
    assert heard_of(said, "asking the vehicle to hold")()
    assert any("companion stops" in text for _, text in texts)


class FullDisk:
    """A recorder as it is when the disk is full."""

    error = "No space left on device"
    dropped = 7
    deleted = ()
    recording = True
    answers = True

    def __init__(self, folder):
        self.folder = folder

    def close(self, timeout_s):
        return self.answers


@pytest.mark.parametrize("answers", [True, False])
def test_a_full_disk_is_said_and_the_radio_and_the_link_are_closed(
    flight, said, until, monkeypatch, tmp_path, answers
):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("companion.runtime.record.run_record.write_json", full)

    def fill():
        flight.onboard.tlog = None
        disk = FullDisk(flight.folder)
        disk.answers = answers
        disk.step = lambda _step: None
        flight._run._recorder = disk

    fly(
        flight,
        lambda: until(heard_of(said, "recording to")),
        fill,
        lambda: until(heard_of(said, "not recording: No space left")),
    )
    assert flight.radio.closed
    assert not flight.link.up
    assert heard_of(said, "summary.json: cannot be written")() is answers


def test_a_link_that_cannot_be_opened_lets_out_what_was_said(make_config, tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    lines = []

    def slow(line):
        time.sleep(0.05)
        lines.append(line)

    with pytest.raises(ConfigError):
        Flight(configured(make_config, tmp_path, port), slow, dry_run=False)
    assert len(lines) == 2


@pytest.mark.parametrize("delete_oldest", [True, False])
def test_old_runs_make_room_for_a_new_one_where_they_may(
    flight, said, until, tmp_path, monkeypatch, delete_oldest
):
    old = tmp_path / "20260101T000000Z-companion"
    old.mkdir()
    (old / "manifest.json").write_text('{"what": "companion run"}')
    (old / "A.events").write_bytes(b"")
    monkeypatch.setattr(
        "companion.runtime.record.disk.free_mb", lambda _folder: 50.0 if old.exists() else 300.0
    )
    record = msgspec.structs.replace(flight.config.record, delete_oldest=delete_oldest)
    flight.config = msgspec.structs.replace(flight.config, record=record)
    recording = "recording to" if delete_oldest else "not recording: less than 200 MB are free"
    fly(flight, lambda: until(heard_of(said, recording)))
    assert old.exists() is not delete_oldest
    assert heard_of(said, f"deleted the oldest runs: {old.name}")() is delete_oldest
    assert (summary(flight)["recorder_error"] is None) is delete_oldest


@pytest.mark.parametrize(("took_s", "leaves"), [(0.01, True), (0.2, True), (0.3, False), (10.0, False)])
def test_what_was_let_leave_before_a_stall_does_not_leave_after_it(monkeypatch, took_s, leaves):
    """The process stops between the gate's word and the link."""

    class Stub:
        def __init__(self):
            self.now_s, self.sent, self.discarded, self.said = 100.0, [], 0, []

        def drain(self, _now_s):
            self.now_s += took_s
            return b"command"

        def discard(self):
            self.discarded += 1

    stub = Stub()
    monkeypatch.setattr(clock, "now_s", lambda: stub.now_s)
    flight = Flight.__new__(Flight)
    flight.onboard = flight.link = stub
    stub.send = stub.sent.append
    flight._say, flight._stalls, flight._read_s = stub.said.append, 0, 100.0
    flight._send()
    assert stub.sent == ([b"command"] if leaves else [])
    assert (flight._stalls, stub.discarded, len(stub.said)) == ((0, 0, 0) if leaves else (1, 1, 1))


class Loop:
    """All that a tick touches, on a clock of its own. The autopilot's input is always emptied."""

    settings = None

    def __init__(self, monkeypatch):
        self.now_s, self.up, self.waiting, self.heard = 100.0, True, [], []
        monkeypatch.setattr(clock, "now_s", lambda: self.now_s)
        self.flight = Flight.__new__(Flight)
        vars(self.flight).update(
            onboard=self, link=self, radio=self, _kept_settings=self, _server=None, _say=lambda _line: None
        )
        vars(self.flight).update(_ticks=0, _stalls=0, _status_s=math.inf, _read_s=None)
        vars(self.flight).update(_waited=WaitedFrames())

    def tick_after(self, passed_s, *events):
        """The events that are taken from the radio after a pause."""
        self.now_s += passed_s
        self.waiting, self.heard = list(events), []
        self.flight._tick()
        return self.heard

    def receive(self, *_args, **_more):
        return Received(b"", emptied=True)

    def events(self, _now_s):
        return self.waiting

    def hear(self, event):
        self.heard.append(event)

    def tick(self, _now_s, **_more):
        return []

    def drain(self, _now_s):
        return b""

    def send(self, _data):
        pass

    keep = send

    def discard(self):
        pass


FRAME = RemoteIdHeard(transport="wifi", address="a", messages=(Location(),))
STATE = RadioState(can_send=("wifi",))


def test_frames_that_waited_while_the_program_was_stopped_are_discarded(monkeypatch):
    """They would be dated by their reception, as if their aircraft were there now."""
    loop = Loop(monkeypatch)
    loop.tick_after(0.05)
    loop.tick_after(0.3)
    assert loop.tick_after(0.05, FRAME) == [FRAME]
    assert loop.tick_after(5.0, FRAME, STATE) == [STATE]
    # The thread of a Bluetooth radio was stopped, too. It reads what waited a moment later.
    assert loop.tick_after(0.05, FRAME) == []
    assert loop.tick_after(0.3, FRAME) == [FRAME]


def test_a_slow_loop_still_hears(monkeypatch):
    loop = Loop(monkeypatch)
    loop.tick_after(0.05)
    assert [loop.tick_after(0.6, FRAME) for _ in range(4)] == [[FRAME]] * 4


def test_aircraft_are_heard_while_the_link_is_down(monkeypatch):
    loop = Loop(monkeypatch)
    loop.tick_after(0.05)
    loop.tick_after(0.3)
    loop.up = False
    assert [loop.tick_after(0.05, FRAME) for _ in range(20)] == [[FRAME]] * 20
