"""The web viewer's server: what it serves, and what a browser may do."""

from __future__ import annotations

import contextlib
import http.client
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from companion.errors import ConfigError
from ground_tools.inspect.viewer import web
from ground_tools.inspect.viewer.web import MAP_TILES, WebViewer

pytest.importorskip("rerun_cli")
CONTENT = bytes(range(256)) * 500


@pytest.fixture(scope="module")
def viewer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebViewer]:
    path = tmp_path_factory.mktemp("web") / "x.rrd"
    path.write_bytes(CONTENT)
    with WebViewer(path) as shown:
        yield shown


def got(viewer: WebViewer, path: str) -> tuple[Any, bytes]:
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    with opener.open(viewer.url.partition("/?")[0] + path, timeout=60.0) as answer:
        return answer.headers, answer.read()


def test_the_page_may_contact_this_machine_only(viewer: WebViewer) -> None:
    headers, page = got(viewer, "/?url=x")
    assert b"<canvas" in page
    # Preconnections, which a Content-Security-Policy does not prevent.
    assert b"<link" in page
    assert b"fonts.googleapis.com" not in page
    rules = dict(rule.split(" ", 1) for rule in headers["Content-Security-Policy"].split("; "))
    others = [w for rule in rules.values() for w in rule.split() if "//" in w and "//127." not in w]
    assert rules["default-src"] == "'self' data: blob:"
    assert others == [MAP_TILES]
    assert MAP_TILES in rules["connect-src"]


@pytest.mark.parametrize("host", ["evil.example", "evil.example:{port}", "127.0.0.1", "[::1]:{port}", ""])
@pytest.mark.parametrize("path", ["/recording.rrd", "/", "/re_viewer_bg.wasm"])
def test_requests_for_another_host_are_refused(viewer: WebViewer, host: str, path: str) -> None:
    """A page whose name points at this machine (DNS rebinding) sends its own name as Host."""
    port = urllib.parse.urlsplit(viewer.url).port
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60.0)
    with contextlib.closing(connection):
        connection.request("GET", path, headers={"Host": host.format(port=port)})
        answer = connection.getresponse()
        assert answer.status == 421
        assert CONTENT[:64] not in answer.read()


def test_localhost_is_this_machine(viewer: WebViewer) -> None:
    port = urllib.parse.urlsplit(viewer.url).port
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60.0)
    with contextlib.closing(connection):
        connection.request("GET", "/recording.rrd", headers={"Host": f"localhost:{port}"})
        assert connection.getresponse().read() == CONTENT


def test_reruns_own_server_listens_where_no_other_page_knows(viewer: WebViewer) -> None:
    """Rerun's server answers any Host, but a rebinding page would have to guess one of 16 million
    addresses."""
    address = urllib.parse.urlsplit(viewer.data_url.removeprefix("rerun+"))
    assert address.hostname is not None
    assert address.hostname.startswith("127.")
    assert address.hostname != "127.0.0.1"
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", address.port or 0), timeout=5.0).close()
    with WebViewer(viewer._front.recording if viewer._front else None) as another:
        assert urllib.parse.urlsplit(another.data_url.removeprefix("rerun+")).hostname != address.hostname


def test_the_recording_and_the_program_are_served_whole(viewer: WebViewer) -> None:
    assert got(viewer, "/recording.rrd")[1] == CONTENT
    headers, program = got(viewer, "/re_viewer_bg.wasm")
    assert headers["Content-Type"] == "application/wasm"
    assert program[:4] == b"\0asm"
    assert int(headers["Content-Length"]) == len(program)


def test_nothing_else_of_the_folder_is_served(viewer: WebViewer) -> None:
    for path in ("/x.rrd", "/../x.rrd", "/recording.rrd/"):
        with pytest.raises(urllib.error.HTTPError, match="404"):
            got(viewer, path)


def test_a_viewer_that_ends_is_reported_and_sends_no_statistics(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "rerun"
    program.write_text(f'#!/bin/sh\nprintf "$CI" > {tmp_path}/told\nexit 3\n')
    program.chmod(0o755)
    monkeypatch.delenv("CI", raising=False)
    monkeypatch.setattr(web, "_program", lambda: program)
    with pytest.raises(ConfigError, match="ended with exit code 3"):
        WebViewer()
    assert (tmp_path / "told").read_text() == "1"


def children(pid: int) -> list[int]:
    """Running processes that a process has started."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, parent = stat.read_text().rpartition(")")[2].split()[:2]
            found += [int(stat.parent.name)] if int(parent) == pid and state != "Z" else []
    return found


def runs(pid: int) -> bool:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


@pytest.mark.usefixtures("hangup_ends")
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="prctl(2), /proc")
@pytest.mark.parametrize(
    ("sent", "code"),
    [(signal.SIGTERM, 0), (signal.SIGHUP, 0), (signal.SIGKILL, -signal.SIGKILL)],
    ids=lambda value: getattr(value, "name", None),
)
def test_no_viewer_process_is_left_after_any_signal(tmp_path: Path, sent: signal.Signals, code: int) -> None:
    """SIGHUP means that the terminal was closed."""
    path = tmp_path / "x.rrd"
    path.write_bytes(CONTENT)
    lines = (
        "import pathlib, sys",
        "from ground_tools.inspect.viewer.web import serve",
        "serve(pathlib.Path(sys.argv[1]))",
    )
    words = "\n".join(lines)
    with subprocess.Popen([sys.executable, "-c", words, path], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert "127.0.0.1" in process.stdout.readline()
        (viewer,) = children(process.pid)
        process.send_signal(sent)
        assert process.wait(60.0) == code
    give_up_s = time.monotonic() + 60.0
    while runs(viewer) and time.monotonic() < give_up_s:
        time.sleep(0.05)
    left = runs(viewer)
    if left:
        os.kill(viewer, signal.SIGKILL)
    assert not left


def test_a_viewer_that_hangs_is_killed(tmp_path: Path) -> None:
    path = tmp_path / "x.rrd"
    path.write_bytes(CONTENT)
    with WebViewer(path) as shown:
        os.kill(shown.pid, signal.SIGSTOP)
    assert not runs(shown.pid)
