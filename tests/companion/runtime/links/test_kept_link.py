"""A link that is lost comes back, and nobody waits for it."""

from __future__ import annotations

import os
import socket
import threading
import time
import tty

import pytest

from companion.errors import ConfigError
from companion.runtime.links.byte_link import Received
from companion.runtime.links.kept_link import KeptLink
from companion.runtime.links.open_link import open_link


class Pipe:
    """A link whose device can be pulled."""

    def __init__(self):
        self.ends = socket.socketpair()
        self.gone = False
        self.closed = False
        self.full = False
        self.discards = 0

    def fileno(self):
        return self.ends[0].fileno()

    def receive(self, now_s):
        if self.gone:
            raise OSError(5, "Input/output error")
        return Received(b"data")

    def send(self, data):
        self.receive(0.0)

    def discard(self):
        self.discards += 1
        if self.full:
            raise ConnectionAbortedError("full")

    def close(self):
        self.closed = True
        for end in self.ends:
            end.close()

    abort = close


class Opener:
    """Opens pipes, as long as it may."""

    def __init__(self):
        self.made = []
        self.attempts = 0
        self.absent: Exception | None = None
        self.may_open = threading.Event()
        self.may_open.set()

    def __call__(self, name, trouble):
        self.attempts += 1
        self.may_open.wait()
        if self.absent is not None:
            raise self.absent
        self.made.append(Pipe())
        return self.made[-1]


@pytest.fixture
def opener():
    return Opener()


@pytest.fixture
def said():
    return []


@pytest.fixture
def kept(opener, said, monkeypatch):
    for pause in ("_FIRST_PAUSE_S", "_PAUSE_S"):
        monkeypatch.setattr(f"companion.runtime.links.kept_link.{pause}", 0.01)
    link = KeptLink("tcp:there", said.append, opener)
    yield link
    opener.may_open.set()
    link.close()


@pytest.mark.parametrize(
    ("found_by", "absent"),
    [("receive", ConfigError("x")), ("send", ConfigError("x")), ("receive", RuntimeError("unforeseen"))],
)
def test_lost_and_found_again_each_said_once(kept, opener, said, until, found_by, absent):
    assert kept.receive(0.0).data == b"data"
    opener.absent = absent
    opener.made[0].gone = True
    if found_by == "receive":
        assert kept.receive(0.0).data == b""
    else:
        kept.send(b"x")
    assert opener.made[0].closed
    until(lambda: opener.attempts > 3)
    assert not kept.up
    assert kept.receive(0.0).data == b""
    assert said == ["link tcp:there: lost: Input/output error; reopening it"]
    opener.absent = None
    until(lambda: kept.receive(0.0).data == b"data")
    assert said[1:] == ["link tcp:there: restored"]
    assert kept.up
    assert kept.trouble.losses == 1


def test_nothing_waits_for_a_link_that_takes_long_to_open(kept, opener, until):
    opener.may_open.clear()
    opener.made[0].gone = True
    kept.receive(0.0)
    until(lambda: opener.attempts == 2)
    # The attempt hangs until it is let go below; if any of these waited for it, the test would hang.
    for _ in range(3):
        kept.wait(0.001)
        assert kept.receive(0.0).data == b""
        kept.send(b"x")
    assert kept.trouble.dropped == 3
    assert not kept.up


def test_a_link_that_cannot_be_opened_at_first_is_bad_configuration(said):
    with pytest.raises(ConfigError):
        KeptLink("tcp:127.0.0.1:0", said.append)


def test_a_closed_link_is_not_opened_again(kept, opener):
    opener.made[0].gone = True
    kept.receive(0.0)
    kept.close()
    assert all(pipe.closed for pipe in opener.made)
    assert not kept.up


def test_a_tcp_server_that_restarts(said, until, monkeypatch):
    for pause in ("_FIRST_PAUSE_S", "_PAUSE_S"):
        monkeypatch.setattr(f"companion.runtime.links.kept_link.{pause}", 0.01)

    def serve(port):
        server = socket.socket()
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        server.bind(("127.0.0.1", port))
        server.listen()
        return server

    server = serve(0)
    port = server.getsockname()[1]
    kept = KeptLink(f"tcp:127.0.0.1:{port}", said.append, open_link)
    first = server.accept()[0]
    server.close()
    first.close()
    until(lambda: kept.receive(0.0).data == b"" and not kept.up)
    server = serve(port)
    until(lambda: kept.receive(0.0).data == b"" and kept.up)
    second = server.accept()[0]
    second.sendall(b"again")
    until(lambda: kept.receive(0.0).data == b"again")
    for end in (second, server, kept):
        end.close()
    assert [line.split(": ")[1] for line in said] == ["lost", "restored"]


def test_a_link_that_is_down_says_that_nothing_waits(kept, opener):
    opener.absent = ConfigError("x")
    opener.made[0].gone = True
    assert kept.receive(0.0) == Received(b"", emptied=True)
    assert not kept.up
    assert kept.receive(0.0) == Received(b"", emptied=True)
    kept.discard()


@pytest.mark.parametrize("full", [False, True])
def test_discarding_costs_a_link_only_where_nothing_else_helps(kept, opener, said, until, full):
    opener.made[0].full = full
    kept.discard()
    assert opener.made[0].discards == 1
    assert kept.up is not full
    assert kept.trouble.losses == full
    until(lambda: kept.receive(0.0).data == b"data")
    assert [line.split(": ")[1] for line in said] == ["lost", "restored"] * full


def test_what_is_thrown_away_on_a_link_that_stays_up_is_said_once_in_a_while(kept, said, monkeypatch):
    now = 1000.0
    monkeypatch.setattr("companion.runtime.clock.now_s", lambda: now)
    for _ in range(5):
        kept.trouble.discarded += 1
        kept.receive(0.0)
        kept.send(b"x")
    assert said == [
        "link tcp:there: nothing gets through; data that waited too long to be sent was discarded"
    ]
    now += 11.0
    kept.receive(0.0)
    assert len(said) == 1
    kept.trouble.discarded += 1
    kept.send(b"x")
    assert len(said) == 2


class Far:
    """The far end of a stream: what it reads of numbered frames, with the tick at which it reads them."""

    def __init__(self, kind):
        self.got = []
        self._rest = b""
        if kind == "pty":
            self._master, self._slave = os.openpty()
            tty.setraw(self._slave)
            os.set_blocking(self._master, False)
            self.link = f"serial:{os.ttyname(self._slave)}:57600"
        else:
            self._server = socket.create_server(("127.0.0.1", 0))
            self.link = f"tcp:127.0.0.1:{self._server.getsockname()[1]}"
        self._kind = kind

    def accept(self):
        if self._kind == "tcp":
            self._peer = self._server.accept()[0]
            self._master = self._peer.fileno()
            self._peer.setblocking(False)

    def talk(self):
        os.write(self._master, b".")

    def read(self, tick):
        try:
            self._rest += os.read(self._master, 65536)
        except BlockingIOError:
            return
        *frames, self._rest = self._rest.split(b"\n")
        self.got += [(int(frame), tick) for frame in frames if len(frame) == 64]

    def close(self):
        if self._kind == "pty":
            os.close(self._master)
            os.close(self._slave)
        else:
            self._peer.close()
            self._server.close()


@pytest.mark.parametrize("kind", ["tcp", "pty"])
def test_a_far_end_that_is_stopped_for_a_while_reads_few_old_frames_and_then_new_ones(kind, said):
    far = Far(kind)
    kept = KeptLink(far.link, said.append)
    far.accept()
    for tick in range(120):
        stopped = 20 <= tick < 90
        if not stopped:
            far.read(tick)
            far.talk()
        time.sleep(0.01)
        kept.receive(time.monotonic())
        kept.send(b"%64d\n" % tick)
    kept.close()
    far.close()
    old = [frame for frame, read in far.got if read - frame > 5]
    assert 0 < len(old) <= 15
    assert max(old) < 20 + 15, "the oldest were taken, nothing after them"
    assert {frame for frame, _ in far.got} >= {*range(20), *range(92, 118)}
    assert said == []
