"""The router's socket, connection or pseudo-terminal at the companion's end of its link.

An end is where the companion's bytes leave its computer. A faulty TCP stream is a real one here: its segments
are lost (half-open) or it is read slowly, so that the companion's own kernel sees the fault.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import math
import os
import selectors
import socket
import struct
import termios
import time
import tty
from pathlib import Path
from typing import Final, NamedTuple, Protocol

from companion.runtime.links.byte_link import Waiting
from sitl_mocks.examinations.modelled_link import Kind, Weather

_READ_BYTES = 65536
_ANCILLARY_BYTES = 64
_STAMPED: Final = 35
"""SO_TIMESTAMPNS: the kernel's time of each datagram."""
_STAMP = struct.Struct("@ll")
_RECEIVE_BUFFER = 4096
"""Receive buffer of a TCP end. It is small, so that a companion notices soon that its stream is slow."""
_SLOW_CREDIT_BYTES = 256.0
_BITS_PER_BYTE = 10
_ATTACH_FILTER: Final = 26
_DETACH_FILTER: Final = 27
"""SO_ATTACH_FILTER and SO_DETACH_FILTER of Linux."""
_DROP_ALL = ctypes.create_string_buffer(struct.pack("HBBI", 6, 0, 0, 0))
"""The socket filter program `ret 0`, which drops every segment before TCP sees or acknowledges it."""


class Left(NamedTuple):
    """Bytes that left the companion."""

    at_s: float
    """Time at which the kernel of this end had them (monotonic clock)."""
    waited_s: float
    """How long they then waited to be read."""
    data: bytes


class End(Protocol):
    """What the router needs of any kind of link. No method blocks."""

    name: str
    """Link name for the companion's configuration."""

    @property
    def connected(self) -> bool:
        """Whether there is a companion to write to."""

    @property
    def polled(self) -> bool:
        """Whether `read` must be called every few milliseconds, because the selector does not report data."""

    @property
    def confirms(self) -> bool:
        """Whether frames that the kernel has accepted also reach the companion's kernel."""

    def read(self, now_s: float, weather: Weather) -> list[Left]:
        """Everything that has left the companion and that the impairments let through."""

    def write(self, frame: bytes) -> bool:
        """Whether the whole frame was accepted. A full stream drops the newest frame."""

    def flush(self) -> None:
        """Write the rest of a partly written frame."""

    def kernel_drops(self) -> int:
        """Number of datagrams for the companion that the kernel has dropped so far."""

    def close(self) -> None:
        """Release the sockets and file descriptors."""


def open_end(kind: Kind, selector: selectors.BaseSelector) -> End:
    """Open an end of this kind, which registers what it reads from with the selector."""
    if kind == "udp":
        return UdpEnd(selector)
    return TcpEnd(selector) if kind == "tcp" else PtyEnd(selector)


def stamped_socket() -> socket.socket:
    """A UDP socket for `datagrams`."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    sock.setsockopt(socket.SOL_SOCKET, _STAMPED, 1)
    return sock


def datagrams(sock: socket.socket) -> list[tuple[Left, tuple[str, int]]]:
    """All waiting datagrams with the kernel's receive times, and their senders."""
    found: list[tuple[Left, tuple[str, int]]] = []
    with contextlib.suppress(BlockingIOError):
        while True:
            try:
                data, ancillary, _, address = sock.recvmsg(_READ_BYTES, _ANCILLARY_BYTES)
            except ConnectionError:
                continue  # Error from a socket that was closed.
            now_s, utc_s = time.monotonic(), time.time()
            seconds, nanoseconds = _STAMP.unpack_from(ancillary[0][2])
            late_s = max(0.0, utc_s - seconds - 1e-9 * nanoseconds)
            found.append((Left(now_s - late_s, late_s, data), address))
    return found


class UdpEnd:
    """A UDP socket. What is sent while the up direction is blocked is lost."""

    polled = False
    confirms = True

    def __init__(self, selector: selectors.BaseSelector) -> None:
        self._socket = stamped_socket()
        self._socket.bind(("127.0.0.1", 0))
        selector.register(self._socket, selectors.EVENT_READ)
        self._peer: tuple[str, int] | None = None
        self.name = f"udpout:127.0.0.1:{self._socket.getsockname()[1]}"

    @property
    def connected(self) -> bool:
        """See `End`."""
        return self._peer is not None

    def read(self, now_s: float, weather: Weather) -> list[Left]:
        """See `End`. The router's own delay does not count as waiting."""
        found = datagrams(self._socket)
        if found:
            self._peer = found[-1][1]
        return [left._replace(waited_s=0.0) for left, _ in found]

    def write(self, frame: bytes) -> bool:
        """See `End`."""
        if self._peer is None:
            return False
        with contextlib.suppress(OSError):
            self._socket.sendto(frame, self._peer)
            return True
        return False

    def flush(self) -> None:
        """Do nothing: datagrams are whole."""

    def kernel_drops(self) -> int:
        """See `End`."""
        if self._peer is None:
            return 0
        end = f":{self._peer[1]:04X}"
        for line in Path("/proc/net/udp").read_text().splitlines()[1:]:
            columns = line.split()
            if columns[1].endswith(end):
                return int(columns[-1])
        return 0

    def close(self) -> None:
        """See `End`."""
        self._socket.close()


class _StreamEnd:
    """Writing to a stream."""

    def __init__(self) -> None:
        self._unsent = b""

    def write(self, frame: bytes) -> bool:
        """See `End`."""
        if not self.connected or self._unsent:
            return False
        self._unsent = frame
        self.flush()
        if len(self._unsent) == len(frame):
            self._unsent = b""
            return False
        return True

    def flush(self) -> None:
        """See `End`."""
        if self._unsent:
            with contextlib.suppress(BlockingIOError, ConnectionError):
                self._unsent = self._unsent[self._give(self._unsent) :]

    def kernel_drops(self) -> int:
        """A stream loses nothing."""
        return 0

    @property
    def connected(self) -> bool:
        """See `End`."""
        return True

    def _give(self, data: bytes) -> int:
        """Pass data to the kernel. Returns how many bytes it accepted."""
        raise NotImplementedError


class PtyEnd(_StreamEnd):
    """A pseudo-terminal in place of a serial line, which keeps reading at the far end."""

    polled = False
    confirms = True

    def __init__(self, selector: selectors.BaseSelector) -> None:
        super().__init__()
        self._fd, self._slave_fd = os.openpty()
        tty.setraw(self._slave_fd)
        os.set_blocking(self._fd, False)
        selector.register(self._fd, selectors.EVENT_READ)
        self.name = f"serial:{os.ttyname(self._slave_fd)}:921600"

    def read(self, now_s: float, weather: Weather) -> list[Left]:
        """See `End`."""
        with contextlib.suppress(BlockingIOError):
            return [Left(now_s, 0.0, os.read(self._fd, _READ_BYTES))]
        return []

    def _give(self, data: bytes) -> int:
        return os.write(self._fd, data)

    def close(self) -> None:
        """See `End`."""
        os.close(self._fd)
        os.close(self._slave_fd)


class TcpEnd(_StreamEnd):
    """A TCP server for one companion; a new connection replaces the one before.

    While the up direction is blocked, every segment of the companion is lost: data, acknowledgements,
    requests to connect, and resets. When the companion closes its connection, this end does not notice:
    the connection is half-open. A slow stream is read slowly, so the companion's kernel keeps the rest.
    """

    def __init__(self, selector: selectors.BaseSelector) -> None:
        super().__init__()
        self._selector = selector
        self._server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        self._server.bind(("127.0.0.1", 0))
        self._server.listen()
        self._server.setblocking(False)
        selector.register(self._server, selectors.EVENT_READ)
        self.name = f"tcp:127.0.0.1:{self._server.getsockname()[1]}"
        self.connections = 0
        """Number of connections accepted so far."""
        self._client: socket.socket | None = None
        self._deaf = False
        """Whether the segments of the companion are lost."""
        self._slow = False
        self._credit_bytes = 0.0
        self._credit_s = 0.0
        self._known = 0
        """Number of bytes that waited after the last read."""
        self._waiting = Waiting()

    @property
    def connected(self) -> bool:
        """See `End`."""
        return self._client is not None

    @property
    def polled(self) -> bool:
        """See `End`."""
        return self._slow

    @property
    def confirms(self) -> bool:
        """See `End`. Without acknowledgements it is not known whether sent data arrived."""
        return not self._deaf

    def read(self, now_s: float, weather: Weather) -> list[Left]:
        """See `End`."""
        self._accept()
        self._set_deaf(weather.up_stands)
        self._set_slow(weather.rate_bps < math.inf)
        client = self._client
        if client is None:
            return []
        waiting = _count_waiting(client)
        if waiting > self._known:
            self._waiting.add(waiting - self._known, now_s)
        room = self._room(now_s, weather.rate_bps)
        if room < 1:
            self._known = waiting
            return []
        since_s = self._waiting.oldest_s(waiting) or now_s
        try:
            data = client.recv(room)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self._drop()
            return []
        self._credit_bytes = max(0.0, self._credit_bytes - len(data))
        self._known = max(0, waiting - len(data))
        if len(data) > waiting:  # More data has arrived since it was counted.
            self._waiting.add(len(data) - waiting, now_s)
        return [Left(since_s, now_s - since_s, data)]

    def _room(self, now_s: float, rate_bps: float) -> int:
        """Number of bytes that may be read now."""
        if rate_bps == math.inf:
            self._credit_bytes, self._credit_s = 0.0, now_s
            return _READ_BYTES
        earned = (now_s - self._credit_s) * rate_bps / _BITS_PER_BYTE
        self._credit_bytes = min(self._credit_bytes + earned, _SLOW_CREDIT_BYTES)
        self._credit_s = now_s
        return int(self._credit_bytes)

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            while True:
                client, _ = self._server.accept()
                self._drop()
                client.setblocking(False)
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._client = client
                self.connections += 1
                if not self._slow:
                    self._selector.register(client, selectors.EVENT_READ)

    def _drop(self) -> None:
        client, self._client = self._client, None
        if client is None:
            return
        if not self._slow:
            self._selector.unregister(client)
        client.close()
        self._unsent, self._known, self._waiting = b"", 0, Waiting()

    def _set_slow(self, slow: bool) -> None:
        """A slow stream is polled, because its unread data would always wake the selector."""
        if slow == self._slow:
            return
        self._slow = slow
        if self._client is None:
            return
        if slow:
            self._selector.unregister(self._client)
        else:
            self._selector.register(self._client, selectors.EVENT_READ)

    def _set_deaf(self, deaf: bool) -> None:
        if deaf == self._deaf:
            return
        self._deaf = deaf
        for sock in (self._server, self._client):
            if sock is None:
                continue
            if deaf:
                program = struct.pack("HxxxxxxP", 1, ctypes.addressof(_DROP_ALL))
                sock.setsockopt(socket.SOL_SOCKET, _ATTACH_FILTER, program)
            else:
                sock.setsockopt(socket.SOL_SOCKET, _DETACH_FILTER, 0)

    def _give(self, data: bytes) -> int:
        assert self._client is not None
        return self._client.send(data)

    def close(self) -> None:
        """See `End`."""
        for sock in (self._server, self._client):
            if sock is not None:
                sock.close()


def _count_waiting(sock: socket.socket) -> int:
    """Number of bytes that can be read."""
    return int(struct.unpack("i", fcntl.ioctl(sock, termios.FIONREAD, b"\0" * 4))[0])
