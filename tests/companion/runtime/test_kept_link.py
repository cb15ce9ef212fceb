"""A link that is lost comes back, and nobody waits for it."""

from __future__ import annotations

import socket
import threading

import pytest

from companion.errors import ConfigError
from companion.runtime.kept_link import KeptLink
from companion.runtime.links import open_link


class Pipe:
    """A link whose device can be pulled."""

    def __init__(self):
        self.ends = socket.socketpair()
        self.gone = False
        self.closed = False

    def fileno(self):
        return self.ends[0].fileno()

    def receive(self, now_s):
        if self.gone:
            raise OSError(5, "Input/output error")
        return b"data"

    def send(self, data):
        self.receive(0.0)

    def close(self):
        self.closed = True
        for end in self.ends:
            end.close()


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
    monkeypatch.setattr("companion.runtime.kept_link._PAUSE_S", 0.01)
    link = KeptLink("tcp:there", said.append, opener)
    yield link
    opener.may_open.set()
    link.close()


@pytest.mark.parametrize(
    ("found_by", "absent"),
    [("receive", ConfigError("x")), ("send", ConfigError("x")), ("receive", RuntimeError("unforeseen"))],
)
def test_lost_and_found_again_each_said_once(kept, opener, said, until, found_by, absent):
    assert kept.receive(0.0) == b"data"
    opener.absent = absent
    opener.made[0].gone = True
    if found_by == "receive":
        assert kept.receive(0.0) == b""
    else:
        kept.send(b"x")
    assert opener.made[0].closed
    until(lambda: opener.attempts > 3)
    assert not kept.up
    assert kept.receive(0.0) == b""
    assert said == ["link tcp:there: lost: Input/output error; opening it again"]
    opener.absent = None
    until(lambda: kept.receive(0.0) == b"data")
    assert said[1:] == ["link tcp:there: back"]
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
        assert kept.receive(0.0) == b""
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
    monkeypatch.setattr("companion.runtime.kept_link._PAUSE_S", 0.01)

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
    until(lambda: kept.receive(0.0) == b"" and not kept.up)
    server = serve(port)
    until(lambda: kept.receive(0.0) == b"" and kept.up)
    second = server.accept()[0]
    second.sendall(b"again")
    until(lambda: kept.receive(0.0) == b"again")
    for end in (second, server, kept):
        end.close()
    assert [line.split(": ")[1] for line in said] == ["lost", "back"]
