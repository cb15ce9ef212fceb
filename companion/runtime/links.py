"""The autopilot's link: UDP, TCP or serial, non-blocking, named by one string.

A link loses data rather than deliver it late. A stream (TCP, serial) keeps at most the rest of one send, so
that frames stay whole; until that has left, what comes after it is dropped and counted.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import sys
import termios
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Protocol

import serial

from companion.errors import ConfigError

_FORMS = "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD"
_CHUNK = 65536
_MAX_DATAGRAMS = 64
"""Taken per call: a flood must not hold up the loop."""
_PEER_SILENT_S = 3.0
"""A peer silent for this long may be replaced by another: a vehicle that restarted has a new port."""
_MAGICS = (0xFD, 0xFE)
"""First byte of a MAVLink 2 and of a MAVLink 1 frame."""
_CONNECT_S = 3.0
_UNACKNOWLEDGED_MS = 5_000
"""TCP data that the peer's side has not acknowledged for this long ends the connection."""
_SEND_BUFFER = 8 * 1024
_SERIAL_QUEUE_S = 0.2
"""A serial driver that holds more than it can send in this time gets nothing new."""
_BITS_PER_BYTE = 10
_NOT_OPENED = {
    errno.ENOENT: "there is no such device; see to the cable, or to the udev rule that names it",
    errno.EACCES: "this user may not open it; put the user into the device's group (dialout)",
    errno.EAGAIN: "another program has it open; a serial port has one reader",
    errno.ENOTTY: "this is no serial port",
}
_NOT_REACHED = {
    errno.ECONNREFUSED: "nobody accepts connections there; start the program at the other end first",
    errno.EADDRNOTAVAIL: "this computer has no such address; 0.0.0.0 listens on all that it has",
    errno.EACCES: "this user may not open it; ports from 1024 on are open to all",
}


@dataclass(slots=True)
class LinkTrouble:
    """What went wrong on a link so far, whatever it went through."""

    dropped: int = 0
    """Sends dropped whole, because the link was down or had not taken what came before."""
    errors: int = 0
    """Refusals of the network that were passed over."""
    losses: int = 0
    """Times the link was lost."""
    left_out: int = 0
    """Datagrams of another sender than the peer, or that are no MAVLink."""


class Link(Protocol):
    """A byte link. `receive` and `send` never block."""

    def fileno(self) -> int:
        """For `select`."""
        ...

    def receive(self, now_s: float) -> bytes:
        """What has arrived; empty when nothing has.

        Raises:
            OSError: the link is lost.
        """
        ...

    def send(self, data: bytes) -> None:
        """Send now, or lose it: a late setpoint is worse than none.

        Raises:
            OSError: the link is lost.
        """
        ...

    def close(self) -> None:
        """Release it."""
        ...


def open_link(name: str, trouble: LinkTrouble | None = None, key: str = "vehicle.link") -> Link:
    """Open the link that `name` describes.

    Args:
        name: as in the configuration key vehicle.link.
        trouble: counts what goes wrong.
        key: where the name stands in the configuration, for the words of an error.

    Raises:
        ConfigError: not a link name, the port is in use, the device or peer is not there.
    """
    trouble = LinkTrouble() if trouble is None else trouble
    kind, _, rest = name.partition(":")
    if kind == "serial":
        device, _, baud = rest.rpartition(":")
        if not device or not _is_number(baud) or int(baud) == 0:
            raise ConfigError(f"{key}: {name!r}: allowed are {_FORMS}")
        return SerialLink(device, int(baud), trouble, key)
    host, _, port = rest.rpartition(":")
    if kind not in ("udpin", "udpout", "tcp") or not host or not _is_number(port) or int(port) > 65535:
        raise ConfigError(f"{key}: {name!r}: allowed are {_FORMS}")
    address = (host.strip("[]"), int(port))
    try:
        if kind == "tcp":
            return TcpLink(address, trouble)
        return UdpLink(address, trouble, listen=kind == "udpin")
    except UnicodeError as error:
        raise ConfigError(f"{key}: {name!r}: {host!r} is no host name") from error
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise ConfigError(
                f"{key}: {name}: port {port} is in use by another program; close it or choose another"
            ) from error
        words = _NOT_REACHED.get(error.errno or 0, error.strerror or error)
        raise ConfigError(f"{key}: {name}: {words}") from error


def _is_number(text: str) -> bool:
    """Plain digits, and no more of them than any port or baud rate has."""
    return text.isascii() and text.isdigit() and len(text) <= 9


class UdpLink:
    """Datagrams to and from one peer: the one that speaks MAVLink (udpin), or a given one (udpout)."""

    def __init__(self, address: tuple[str, int], trouble: LinkTrouble, *, listen: bool) -> None:
        info = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(info[0], socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._trouble = trouble
        self._listen = listen
        self._peer: Any = None
        self._heard_s = float("-inf")
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

    def receive(self, now_s: float) -> bytes:
        """Waiting datagrams of the peer, joined."""
        parts: list[bytes] = []
        for _ in range(_MAX_DATAGRAMS):
            try:
                data, sender = self._socket.recvfrom(_CHUNK)
            except BlockingIOError:
                break
            except OSError:
                # What the network said of a datagram of ours (nobody there, no route): the next may arrive.
                self._trouble.errors += 1
                continue
            if self._is_peer(sender, data, now_s):
                self._heard_s = now_s
                parts.append(data)
        return b"".join(parts)

    def _is_peer(self, sender: Any, data: bytes, now_s: float) -> bool:
        if sender == self._peer:
            return True
        silent = now_s - self._heard_s > _PEER_SILENT_S
        if not (self._listen and silent and data and data[0] in _MAGICS):
            self._trouble.left_out += 1
            return False
        self._peer = sender
        return True

    def send(self, data: bytes) -> None:
        """One datagram; nothing while the peer is unknown."""
        if self._peer is None or not data:
            return
        try:
            self._socket.sendto(data, self._peer)
        except OSError:
            # Nobody there yet, no route, a full buffer, a firewall: this datagram is lost, the link is not.
            self._trouble.errors += 1

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class _Stream(ABC):
    """Sending, as TCP and serial do it: frames leave whole, and never late."""

    def __init__(self, trouble: LinkTrouble) -> None:
        self._trouble = trouble
        self._unsent = b""

    def send(self, data: bytes) -> None:
        """Send the rest of what was sent before, then the new data, if nothing waits in front of it.

        Raises:
            OSError: the link is lost.
        """
        if self._unsent:
            self._unsent = self._unsent[self._try_write(self._unsent) :]
        if not data:
            return
        if self._unsent or not self._takes_more():
            self._trouble.dropped += 1
            return
        taken = self._try_write(data)
        if taken:
            self._unsent = data[taken:]
        else:
            self._trouble.dropped += 1

    def _try_write(self, data: bytes) -> int:
        try:
            return self._write(data)
        except BlockingIOError:
            return 0

    @abstractmethod
    def _write(self, data: bytes) -> int:
        """Hand data to the kernel; how much it took."""

    @abstractmethod
    def _takes_more(self) -> bool:
        """Whether what the kernel took before has left."""


class TcpLink(_Stream):
    """A TCP client."""

    def __init__(self, address: tuple[str, int], trouble: LinkTrouble) -> None:
        super().__init__(trouble)
        self._socket = socket.create_connection(address, timeout=_CONNECT_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        if sys.platform == "linux":
            # Not writable while the kernel holds anything unsent; and a dead path is a loss within seconds.
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, 1)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNACKNOWLEDGED_MS)
        self._socket.setblocking(False)

    def fileno(self) -> int:
        """For `select`."""
        return self._socket.fileno()

    def receive(self, now_s: float) -> bytes:
        """What has arrived.

        Raises:
            OSError: the connection is lost, or the peer closed it.
        """
        try:
            data = self._socket.recv(_CHUNK)
        except BlockingIOError:
            return b""
        if not data:
            raise ConnectionError("the autopilot's side closed the TCP link")
        return data

    def _write(self, data: bytes) -> int:
        return self._socket.send(data)

    def _takes_more(self) -> bool:
        return bool(select.select([], [self._socket], [], 0.0)[1])

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class SerialLink(_Stream):
    """A serial port. pyserial sets it up; reads and writes are the kernel's own, which never wait."""

    def __init__(self, device: str, baud: int, trouble: LinkTrouble, key: str = "vehicle.link") -> None:
        super().__init__(trouble)
        try:
            self._port = serial.Serial(device, baud, timeout=0, exclusive=True)
        except (OSError, termios.error, ValueError) as error:
            # pyserial passes some of the kernel's refusals on as they are: a device that goes just now.
            # What it refuses itself it says without a number: the kernel's refusal lies behind that.
            numbers = [getattr(error, "errno", None), *getattr(error.__context__, "args", ())]
            words = next((_NOT_OPENED[n] for n in numbers if n in _NOT_OPENED), str(error))
            raise ConfigError(f"{key}: serial:{device}:{baud}: {words}") from error
        self._fd = int(self._port.fileno())
        self._queue_bytes = baud / _BITS_PER_BYTE * _SERIAL_QUEUE_S
        os.set_blocking(self._fd, False)

    def fileno(self) -> int:
        """For `select`."""
        return self._fd

    def receive(self, now_s: float) -> bytes:
        """What has arrived.

        Raises:
            OSError: the device is gone.
        """
        # A device that is gone reads as ready and empty; one that has nothing is not ready.
        if not select.select([self._fd], [], [], 0.0)[0]:
            return b""
        try:
            data = os.read(self._fd, _CHUNK)
        except BlockingIOError:
            return b""
        if not data:
            raise ConnectionError("the serial device is gone")
        return data

    def _write(self, data: bytes) -> int:
        return os.write(self._fd, data)

    def _takes_more(self) -> bool:
        return int(self._port.out_waiting) <= self._queue_bytes

    def close(self) -> None:
        """Close the port."""
        # Releasing a device that is gone may fail; there is nothing left to release.
        with contextlib.suppress(OSError):
            self._port.close()
