"""What a service manager is told, on a socket of our own in its place."""

from __future__ import annotations

import os
import socket

import pytest

from companion.runtime.status.service_manager import Notifier, notify_address, ping_period_s


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path):
    """A service manager's socket, with the name that the environment gives it."""
    name = str(tmp_path / "notify") if request.param == "path" else f"@dmuca-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server:
        server.bind(name.replace("@", "\0"))
        server.setblocking(False)
        yield server, name


def told(server):
    lines = []
    while True:
        try:
            lines.append(server.recv(4096).decode())
        except BlockingIOError:
            return lines


def test_the_manager_is_told(manager):
    server, name = manager
    notifier = Notifier({"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "1600000"})
    notifier.status("two\nlines")
    notifier.ready()
    for now_s in (100.0, 100.1, 100.7, 100.8, 101.5):
        notifier.ping(now_s)
    notifier.stopping()
    notifier.close()
    assert told(server) == ["STATUS=two?lines", "READY=1", "WATCHDOG=1", "WATCHDOG=1", "STOPPING=1"]


def test_a_manager_that_is_gone_or_does_not_read_holds_nothing_up(manager, tmp_path):
    server, name = manager
    environ = {"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "2"}
    notifier = Notifier(environ)
    for number in range(5000):  # far more than a socket takes
        notifier.ping(float(number))
    server.close()
    notifier.ping(9999.0)
    notifier.close()
    Notifier({"NOTIFY_SOCKET": str(tmp_path / "nobody")}).ready()


def test_without_a_manager_nothing_is_told():
    assert notify_address({}) is None
    assert notify_address({"NOTIFY_SOCKET": "vsock:2:1"}) is None
    notifier = Notifier({})
    notifier.ready()
    notifier.ping(0.0)
    notifier.close()


@pytest.mark.parametrize(
    ("environ", "period_s"),
    [
        ({"WATCHDOG_USEC": "1000000"}, 0.5),
        ({"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": "17"}, 0.5),
        ({"WATCHDOG_USEC": "30000000"}, 1.0),
        ({"WATCHDOG_USEC": "8000000", "WATCHDOG_PID": "18"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({}, None),
    ],
)
def test_the_watchdog_is_pinged_twice_in_its_time_and_once_a_second(environ, period_s):
    assert ping_period_s(environ, 17) == period_s
