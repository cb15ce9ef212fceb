"""The autopilot's link: UDP, TCP or serial, non-blocking, named by one string."""

from __future__ import annotations

import contextlib
import errno
import socket
from typing import Any, Protocol

import serial

from companion.errors import ConfigError

_FORMS = "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD"
_CHUNK = 65536
_MAX_BACKLOG = 64 * 1024
"""Bytes waiting for a slow stream; beyond it the oldest data is worthless, so the new is dropped."""


class Link(Protocol):
    """A byte link. `receive` and `send` never block."""

    def fileno(self) -> int:
        """For `select`."""
        ...

    def receive(self) -> bytes:
        """What has arrived; empty when nothing has."""
        ...

    def send(self, data: bytes) -> None:
        """Send now, or lose it: a late setpoint is worse than none."""
        ...

    def close(self) -> None:
        """Release it."""
        ...


def open_link(name: str) -> Link:
    """Open the link that `name` describes.

    Raises:
        ConfigError: not a link name, the port is in use, the device or peer is not there.
    """
    kind, _, rest = name.partition(":")
    if kind == "serial":
        device, _, baud = rest.rpartition(":")
        if not device or not baud.isdigit():
            raise ConfigError(f"vehicle.link: {name!r}: allowed are {_FORMS}")
        return SerialLink(device, int(baud))
    host, _, port = rest.rpartition(":")
    if kind not in ("udpin", "udpout", "tcp") or not host or not port.isdigit() or int(port) > 65535:
        raise ConfigError(f"vehicle.link: {name!r}: allowed are {_FORMS}")
    address = (host.strip("[]"), int(port))
    try:
        if kind == "tcp":
            return TcpLink(address)
        return UdpLink(address, listen=kind == "udpin")
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise ConfigError(
                f"vehicle.link: {name}: port {port} is in use by another program; close it or choose another"
            ) from error
        raise ConfigError(f"vehicle.link: {name}: {error.strerror or error}") from error


class UdpLink:
    """Datagrams to and from one peer: the first one that speaks (udpin), or a given one (udpout)."""

    def __init__(self, address: tuple[str, int], *, listen: bool) -> None:
        info = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(info[0], socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._peer: Any = None
        if listen:
            try:
                self._socket.bind(info[4])
            except OSError:
                self._socket.close()
                raise
        else:
            self._peer = info[4]

    @property
    def port(self) -> int:
        """Local port."""
        return int(self._socket.getsockname()[1])

    def fileno(self) -> int:
        """For `select`."""
        return self._socket.fileno()

    def receive(self) -> bytes:
        """All waiting datagrams of the peer, joined."""
        parts: list[bytes] = []
        while True:
            try:
                data, peer = self._socket.recvfrom(_CHUNK)
            except (BlockingIOError, ConnectionRefusedError):
                return b"".join(parts)
            if self._peer is None:
                self._peer = peer
            if peer == self._peer:
                parts.append(data)

    def send(self, data: bytes) -> None:
        """One datagram; nothing while the peer is unknown."""
        if self._peer is not None and data:
            # Refused: the peer is not there yet. Full: the kernel's buffer is; either way it is lost.
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                self._socket.sendto(data, self._peer)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class TcpLink:
    """A TCP client."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._socket = socket.create_connection(address, timeout=5.0)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)
        self._backlog = b""

    def fileno(self) -> int:
        """For `select`."""
        return self._socket.fileno()

    def receive(self) -> bytes:
        """What has arrived.

        Raises:
            ConnectionError: the peer closed the connection.
        """
        try:
            data = self._socket.recv(_CHUNK)
        except BlockingIOError:
            return b""
        if not data:
            raise ConnectionError("the autopilot's side closed the TCP link")
        return data

    def send(self, data: bytes) -> None:
        """Send; a rest that the kernel does not take goes first next time, so that frames stay whole."""
        if len(self._backlog) <= _MAX_BACKLOG:
            self._backlog += data
        if self._backlog:
            with contextlib.suppress(BlockingIOError):
                self._backlog = self._backlog[self._socket.send(self._backlog) :]

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class SerialLink:
    """A serial port."""

    def __init__(self, device: str, baud: int) -> None:
        try:
            self._port = serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)
        except (serial.SerialException, ValueError) as error:
            raise ConfigError(f"vehicle.link: serial:{device}:{baud}: {error}") from error
        self._backlog = b""

    def fileno(self) -> int:
        """For `select`."""
        return int(self._port.fileno())

    def receive(self) -> bytes:
        """What has arrived.

        Raises:
            OSError: the device is gone.
        """
        return bytes(self._port.read(_CHUNK))

    def send(self, data: bytes) -> None:
        """Send; a rest that the port does not take goes first next time."""
        if len(self._backlog) <= _MAX_BACKLOG:
            self._backlog += data
        if self._backlog:
            self._backlog = self._backlog[int(self._port.write(self._backlog) or 0) :]

    def close(self) -> None:
        """Close the port."""
        self._port.close()
