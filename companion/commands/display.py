"""`companion display`: a page of the traffic around a flying aircraft, served by a process of its own.

The process asks the status socket, as `companion status` does, at most twice a second however many browsers
are connected. Browsers cannot affect the flight: one that hangs only holds a thread of this process until a
timeout. The page is one file that loads nothing else, so it works without a network.

Without a token the page is served on loopback only. A page of another host must not read the state: it could
point a name of its own at this computer (DNS rebinding), so only requests for an address of this computer are
answered, and on other interfaces only those with the token.
"""

from __future__ import annotations

import argparse
import contextlib
import ipaddress
import os
import secrets
import socket
import threading
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qs, quote, urlsplit

import msgspec

from companion.commands.status import ask, find_socket
from companion.errors import ConfigError
from companion.runtime.signing_key import private_bytes

PORT: Final = 8753
PERIOD_S: Final = 0.5
"""Least time between two questions to the status socket."""
MOST_AT_ONCE: Final = 16
"""Most requests at a time; further ones are closed at once."""
_PATIENCE_S: Final = 5.0
"""How long a browser may take for a request, from its connection to the last byte of the answer."""
_LEAST_TOKEN: Final = 12
_PAGE: Final = Path(__file__).with_name("display.html")
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `companion display`."""
    parser.add_argument("--socket", type=Path, help="status socket; needed if several companions run")
    parser.add_argument(
        "--host", default="127.0.0.1", help="address to listen on; others than loopback need the token"
    )
    parser.add_argument("--port", type=int, default=PORT, help="port (default: %(default)s; 0: any)")
    parser.add_argument(
        "--token-file",
        type=Path,
        help=f"file (chmod 600) with the token: text of {_LEAST_TOKEN} characters or more without which "
        "nothing is answered (default: no token on loopback, a new one otherwise)",
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Serve until interrupted. Returns 0.

    Raises:
        ConfigError: no companion runs here, or an option is wrong.
    """
    path = find_socket(arguments.socket, os.environ)
    token = None if arguments.token_file is None else read_token(arguments.token_file)
    with Display(path, arguments.host, arguments.port, token) as display:
        print(f"showing {path} at {display.url} until Ctrl-C", flush=True)
        display.serve_forever()
    return 0


def read_token(path: Path) -> str:
    """Read the token from a file that only its owner may access. Every user sees the options of a process.

    Raises:
        ConfigError: the file cannot be read, is accessible to others, or is no text.
    """
    if not path.exists():
        # The text does not repeat the path: a user may have entered the token itself.
        raise ConfigError("--token-file: no such file; it is the path of a file with the token")
    try:
        return private_bytes(path, "--token-file").decode().strip()
    except UnicodeDecodeError as error:
        raise ConfigError(f"--token-file: {path}: not UTF-8 text") from error


class _Source:
    """The state as JSON, asked for at most every `PERIOD_S`."""

    def __init__(self, path: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self._path = path
        self._clock = clock
        self._lock = threading.Lock()
        self._asked_s: float | None = None
        self._answer = b""

    def state(self) -> bytes:
        """The state, or an object with the key "error"."""
        with self._lock:
            if self._asked_s is None or self._clock() - self._asked_s >= PERIOD_S:
                try:
                    self._answer = msgspec.json.encode(ask(self._path))
                except ConfigError as error:
                    self._answer = msgspec.json.encode({"error": str(error)})
                self._asked_s = self._clock()
            return self._answer


class Display(ThreadingHTTPServer):
    """The server of the page.

    Raises:
        ConfigError: it cannot listen there, or the token is too short.
    """

    daemon_threads = True
    block_on_close = False
    request_queue_size = MOST_AT_ONCE

    def __init__(self, path: Path, host: str = "127.0.0.1", port: int = 0, token: str | None = None) -> None:
        try:
            self._address = ipaddress.ip_address(host)
        except ValueError as error:
            raise ConfigError(f"--host: {host!r}: allowed: an IP address of this computer") from error
        if token is not None and len(token) < _LEAST_TOKEN:
            raise ConfigError(f"--token-file: too short; allowed: {_LEAST_TOKEN} characters or more")
        if token is None and not self._address.is_loopback:
            token = secrets.token_urlsafe(16)
        self.token = token
        self.source = _Source(path)
        self._free = threading.BoundedSemaphore(MOST_AT_ONCE)
        self.address_family = socket.AF_INET6 if self._address.version == 6 else socket.AF_INET
        try:
            super().__init__((host, port), _Handler)
        except (OSError, OverflowError) as error:
            raise ConfigError(f"--host {host} --port {port}: cannot listen there: {error}") from error

    @property
    def url(self) -> str:
        """Address to open in a browser on this computer, or with the computer's own address in others."""
        host = socket.gethostname() if self._address.is_unspecified else str(self._address)
        shown = f"[{host}]" if ":" in host else host
        return f"http://{shown}:{self.server_port}/" + (
            "" if self.token is None else f"?token={quote(self.token, safe='')}"
        )

    def is_ours(self, host: str) -> bool:
        """Whether a Host header names this computer in a way that no other host's name can."""
        name = urlsplit(f"//{host}").hostname or ""
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            local = socket.gethostname().lower()
            return name == "localhost" if self._address.is_loopback else name in (local, f"{local}.local")
        return address.is_loopback if self._address.is_loopback else True

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread of its own, or close at once if too many wait."""
        if not self._free.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer one request."""
        # The timeout of the socket counts from each byte anew, so that a client which sends one byte now and
        # then would hold its thread for ever.
        limit = threading.Timer(_PATIENCE_S, _end, [request])
        limit.daemon = True
        limit.start()
        try:
            super().process_request_thread(request, client_address)
        finally:
            limit.cancel()
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a browser that closed its connection."""


def _end(request: socket.socket) -> None:
    """End a connection, so that a thread that waits for it goes on."""
    with contextlib.suppress(OSError):
        request.shutdown(socket.SHUT_RDWR)


class _Handler(BaseHTTPRequestHandler):
    server: Display
    timeout = _PATIENCE_S
    server_version, sys_version = "dmuca", ""

    def do_GET(self) -> None:
        """Send the page or the state."""
        parts = urlsplit(self.path)
        try:
            ours = self.server.is_ours(self.headers.get("Host", ""))
        except ValueError:
            ours = False
        if not ours:
            self._send(403, "text/plain", b"ask for this computer by its address\n")
            return
        given = parse_qs(parts.query).get("token", [""])[0]
        if self.server.token is not None and not secrets.compare_digest(
            given.encode(), self.server.token.encode()
        ):
            self._send(403, "text/plain", b"the token is missing or wrong\n")
        elif parts.path == "/":
            self._send(200, "text/html; charset=utf-8", _PAGE.read_bytes())
        elif parts.path == "/state":
            self._send(200, "application/json", self.server.source.state())
        else:
            self._send(404, "text/plain", b"there is only / and /state\n")

    def _send(self, code: int, kind: str, body: bytes) -> None:
        self.send_response(code)
        for name, value in (_HEADERS | {"Content-Type": kind, "Content-Length": str(len(body))}).items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Write no log: a query may hold the token."""
