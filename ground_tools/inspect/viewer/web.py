"""Rerun's web viewer on loopback, with a page that contacts no other host (except for map tiles).

The viewer comes with rerun: `rerun --serve-web` serves its page and the data that is sent to it. By default
it listens on all interfaces; here it listens on 127.0.0.1 only. Its page would contact the vendor for news,
examples and a font, and report usage statistics. Therefore a browser gets the page through a server of ours,
which adds a Content-Security-Policy (W3C CSP 3) that restricts it to this machine. The same server provides
the recording as a file.

A page of another host must not read the recording. It could point its own name at this machine (DNS
rebinding); our server therefore answers only requests for its own address. Rerun's server answers any, so it
listens on a loopback address that is drawn anew each time and that no other page knows.
"""

from __future__ import annotations

import contextlib
import http.client
import importlib.util
import os
import re
import secrets
import shutil
import socket
import subprocess
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import TracebackType
from typing import Any
from urllib.parse import quote

from companion.errors import ConfigError
from companion.shipped import how_to_install
from sitl_mocks.signals import end_signals

_START_S = 20.0
_STOP_S = 2.0
"""Time that a viewer gets to end when asked to. After that it is killed."""
_POLL_S = 0.05
_BIND = """
import ctypes, os, signal, sys
ctypes.CDLL(None).prctl(1, ctypes.c_ulong(signal.SIGKILL))  # PR_SET_PDEATHSIG
if os.getppid() != int(sys.argv[1]):  # the parent ended before that took effect
    os._exit(1)
os.execv(sys.argv[2], sys.argv[2:])
"""
_LOOK_S = 0.2
_ANSWER_S = 30.0
MAP_TILES = "https://tile.openstreetmap.org"
"""The only other host that the page may contact. It does so once its map is opened."""
_FILE = "/recording.rrd"
_ELSEWHERE = re.compile(rb"<link[^>]*https:[^>]*>")
"""Links to other hosts in the page. A browser connects to them in spite of the policy."""


def serve(recording: Path) -> None:
    """Serve a recording until Ctrl-C or SIGTERM.

    Raises:
        ConfigError: rerun is not installed, or its viewer ended by itself.
    """
    with end_signals() as ended, WebViewer(recording) as viewer:
        print(f"showing {recording} at {viewer.url}, on this machine only, until Ctrl-C", flush=True)
        while not ended:
            viewer.check()
            time.sleep(_LOOK_S)


class WebViewer:
    """A web viewer that runs until it is closed.

    Args:
        recording: File to show; None to show what is sent to `data_url`.

    Raises:
        ConfigError: rerun is not installed, or its viewer does not start to serve.
    """

    def __init__(self, recording: Path | None = None) -> None:
        program = _program()
        host = _secret_loopback()
        page, data = _free_ports(host)
        self.data_url = f"rerun+http://{host}:{data}/proxy"
        words = ["--bind", host, "--serve-web", "--port", str(data), "--web-viewer-port", str(page)]
        self._process = subprocess.Popen(
            [*_ending_with(os.getpid()), program, *words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            # A separate session: Ctrl-C must not end the viewer before the stream that sends to it.
            start_new_session=True,
            # Rerun's process also reports each page view to the vendor, unless this variable is set.
            env={**os.environ, "CI": "1"},
        )
        self._front: _Front | None = None
        try:
            for port in (data, page):
                self._wait_for(host, port)
            self._front = _Front(host, page, data, recording)
        except BaseException:
            self.close()
            raise
        own = f"http://127.0.0.1:{self._front.server_port}"
        shown = self.data_url if recording is None else own + _FILE
        self.url = f"{own}/?url={quote(shown, safe='')}"
        """Address to open in a browser. A browser without WebGPU needs `&renderer=webgl` appended to it."""

    def _wait_for(self, host: str, port: int) -> None:
        give_up_s = time.monotonic() + _START_S
        while time.monotonic() < give_up_s:
            self.check()
            with contextlib.suppress(OSError), socket.create_connection((host, port), timeout=1.0):
                return
            time.sleep(_POLL_S)
        raise ConfigError(f"rerun's web viewer did not start within {_START_S:g} s")

    @property
    def pid(self) -> int:
        """Process id of the viewer."""
        return self._process.pid

    def check(self) -> None:
        """Raise ConfigError if the viewer ended by itself."""
        if self._process.poll() is not None:
            raise ConfigError(f"rerun's web viewer ended with exit code {self._process.returncode}")

    def close(self) -> None:
        """End the viewer and the server in front of it."""
        if self._front is not None:
            self._front.end()
        self._process.terminate()
        try:
            self._process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __enter__(self) -> WebViewer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


class _Front(ThreadingHTTPServer):
    """Serves rerun's page, restricted to this machine, and the recording.

    Args:
        host: Address of rerun's servers.
        page: Port of rerun's page.
        data: Port of its data.
        recording: File that is served in addition to the page.
    """

    daemon_threads = True

    def __init__(self, host: str, page: int, data: int, recording: Path | None) -> None:
        self.rerun, self.recording = (host, page), recording
        self.policy = (
            "default-src 'self' data: blob:; "
            "script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; "
            f"connect-src 'self' data: blob: http://{host}:{data} {MAP_TILES}"
        )
        super().__init__(("127.0.0.1", 0), _Handler)
        self.hosts = {f"{name}:{self.server_port}" for name in ("127.0.0.1", "localhost")}
        self._thread = threading.Thread(target=self.serve_forever, kwargs={"poll_interval": _POLL_S})
        self._thread.start()

    def end(self) -> None:
        """Stop the server."""
        self.shutdown()
        self._thread.join()
        self.server_close()

    def handle_error(self, *_: Any) -> None:
        """Ignore errors: the browser disconnected, or the viewer ended, which `WebViewer.check` reports."""


class _Handler(BaseHTTPRequestHandler):
    server: _Front

    def do_GET(self) -> None:
        """Serve the recording, or rerun's file of that name."""
        if self.headers.get("Host") not in self.server.hosts:
            allowed = " or ".join(sorted(self.server.hosts))
            self.send_error(421, explain=f"This server answers only for Host {allowed}.")
            return
        path = self.path.partition("?")[0]
        if path == _FILE and self.server.recording is not None:
            with self.server.recording.open("rb") as file:
                self._head(200, "application/octet-stream", os.fstat(file.fileno()).st_size)
                shutil.copyfileobj(file, self.wfile)
            return
        rerun = http.client.HTTPConnection(*self.server.rerun, timeout=_ANSWER_S)
        with contextlib.closing(rerun):
            rerun.request("GET", path)
            answer = rerun.getresponse()
            kind, body = answer.getheader("Content-Type", ""), answer.read()
        if kind == "text/html":
            body = _ELSEWHERE.sub(b"", body)
        self._head(answer.status, kind, len(body))
        self.wfile.write(body)

    def _head(self, status: int, kind: str, length: int) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(length))
        self.send_header("Content-Security-Policy", self.server.policy)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Do not log requests."""


def _program() -> Path:
    """Return the viewer's executable. `python -m rerun` starts it as a child that outlives its parent."""
    found = importlib.util.find_spec("rerun_cli")
    if found is None or found.origin is None:
        raise ConfigError(how_to_install("rerun", "inspect"))
    return Path(found.origin).with_name("rerun")


def _ending_with(parent: int) -> list[str]:
    """Words before a command line, with which its process ends with its parent (Linux, prctl(2)).

    A function between fork and exec (`preexec_fn`) would hang if another thread holds a lock at that moment.
    """
    if not sys.platform.startswith("linux"):
        return []
    return [sys.executable, "-I", "-S", "-c", _BIND, str(parent)]


def _secret_loopback() -> str:
    """Return a random address of this machine in 127.0.0.0/8, all of which Linux answers on."""
    return ".".join(["127", *(str(1 + secrets.randbelow(254)) for _ in range(3))])


def _free_ports(host: str) -> tuple[int, int]:
    """Return two ports that are free now."""
    with socket.socket() as first, socket.socket() as second:
        first.bind((host, 0))
        second.bind((host, 0))
        return first.getsockname()[1], second.getsockname()[1]
