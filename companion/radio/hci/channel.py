"""Channels to a Bluetooth controller: Linux user channel, UART, or TCP. Each carries H4 packets.

Opening may take seconds; after that nothing blocks.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import select
import socket
import struct
import sys
import termios
from typing import Final, Protocol

import serial

from companion.errors import ConfigError

_FORMS: Final = "user:NUMBER, uart:DEVICE:BAUD or tcp:HOST:PORT"
_CONNECT_S: Final = 3.0
READ_SIZE: Final = 4096

# From Linux <linux/socket.h> and <net/bluetooth/hci.h>. Many builds of Python lack them in `socket`.
_AF_BLUETOOTH: Final = 31
_BTPROTO_HCI: Final = 1
_HCI_CHANNEL_USER: Final = 1
_NO_DEVICE: Final = 0xFFFF
_SOCKADDR_HCI: Final = struct.Struct("=HHH")
_ERFKILL: Final = 132


class Channel(Protocol):
    """Non-blocking byte channel to one controller."""

    def fileno(self) -> int:
        """Return the file descriptor for `select`."""
        ...

    def receive(self) -> bytes:
        """Return some of the bytes that have arrived; empty if there are none.

        Raises:
            OSError: the channel is lost.
        """
        ...

    def send(self, data: bytes) -> int:
        """Send one packet and return how many bytes were accepted: all, a part (UART, TCP), or none now.

        Raises:
            OSError: the channel is lost.
        """
        ...

    def close(self) -> None:
        """Release the channel."""
        ...


def open_channel(name: str) -> Channel:
    """Open the channel that `name` (config key radio.channel) describes.

    Raises:
        ConfigError: the name has a wrong form, or the channel cannot be opened. The text says what to do.
    """
    kind, _, rest = name.partition(":")
    where, _, number = rest.rpartition(":")
    is_number = number.isascii() and number.isdigit() and len(number) < 10
    if kind == "user" and not where and is_number and int(number) < _NO_DEVICE:
        return UserChannel(int(number))
    if kind == "uart" and where and is_number and int(number) > 0:
        return UartChannel(where, int(number))
    if kind == "tcp" and where and is_number and 0 < int(number) < 1 << 16:
        return TcpChannel(where.strip("[]"), int(number))
    raise ConfigError(f"radio.channel: {name!r}: allowed: {_FORMS}")


class _SocketChannel:
    """Base class of the two socket channels."""

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        self._socket.setblocking(False)

    def fileno(self) -> int:
        """Return the file descriptor for `select`."""
        return self._socket.fileno()

    def receive(self) -> bytes:
        """Return some of the bytes that have arrived. Raises OSError."""
        try:
            data = self._socket.recv(READ_SIZE)
        except BlockingIOError:
            return b""
        if not data:
            raise ConnectionError(errno.EPIPE, "the other side closed the connection")
        return data

    def send(self, data: bytes) -> int:
        """Return how many bytes were accepted. Raises OSError."""
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class UserChannel(_SocketChannel):
    """The Linux kernel's HCI user channel: one packet per read and write, exclusive use of the controller."""

    def __init__(self, number: int) -> None:
        try:
            sock = socket.socket(_AF_BLUETOOTH, socket.SOCK_RAW, _BTPROTO_HCI)
        except OSError as error:
            raise ConfigError(user_channel_error(number, error.errno or 0)) from error
        # `socket.bind` of Python 3.11 does not support HCI channels, so we call bind of the C library.
        address = _SOCKADDR_HCI.pack(_AF_BLUETOOTH, number, _HCI_CHANNEL_USER)
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.bind(sock.fileno(), address, len(address)) != 0:
            code = ctypes.get_errno()
            sock.close()
            raise ConfigError(user_channel_error(number, code))
        super().__init__(sock)


def user_channel_error(number: int, code: int) -> str:
    """Explain why a user channel cannot be opened, and what to do."""
    down = f'"systemctl stop bluetooth" and "hciconfig hci{number} down" release it'
    reasons = {
        errno.EPERM: "not allowed: the program needs the capability CAP_NET_ADMIN (or root)",
        errno.EACCES: "not allowed: the program needs the capability CAP_NET_ADMIN (or root)",
        errno.EBUSY: f"in use: the interface must be down and no other program may hold it; {down}",
        errno.EALREADY: f"in use: the interface must be down and no other program may hold it; {down}",
        errno.EUSERS: f"in use: another program has its user channel; {down}",
        errno.ENODEV: f'there is no hci{number}: "hciconfig -a" lists the controllers',
        errno.EAFNOSUPPORT: "this system has no Bluetooth: the kernel module bluetooth is not loaded",
        errno.EPROTONOSUPPORT: "this system has no Bluetooth: the kernel module bluetooth is not loaded",
        _ERFKILL: 'the radio is switched off: "rfkill unblock bluetooth" switches it on',
    }
    return f"radio.channel: user:{number}: {reasons.get(code) or os.strerror(code)}"


class TcpChannel(_SocketChannel):
    """H4 over TCP, for a virtual controller or one on another machine."""

    def __init__(self, host: str, port: int) -> None:
        name = f"tcp:{host}:{port}"
        try:
            sock = socket.create_connection((host, port), timeout=_CONNECT_S)
        except ValueError as error:  # no valid name: a zero byte, a label of more than 63 bytes
            raise ConfigError(f"radio.channel: {name}: {host!r} is not a host name") from error
        except OSError as error:
            raise ConfigError(f"radio.channel: {name}: {error.strerror or error}") from error
        try:
            if sock.getsockname() == sock.getpeername():  # a TCP socket can connect to itself
                raise ConnectionRefusedError(errno.ECONNREFUSED, os.strerror(errno.ECONNREFUSED))
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:  # also if the other side has already hung up
            sock.close()
            raise ConfigError(f"radio.channel: {name}: {error.strerror}") from error
        super().__init__(sock)

    def receive(self) -> bytes:
        """Return some of the bytes that have arrived. Raises OSError."""
        data = super().receive()
        if sys.platform == "linux":
            # A controller that writes an event in pieces waits up to 40 ms for each acknowledgement.
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        return data


class UartChannel:
    """H4 on a serial port with RTS/CTS, as the standard requires (Core vol. 4 part A section 2)."""

    def __init__(self, device: str, baud: int) -> None:
        try:
            self._port = serial.Serial(device, baud, timeout=0, rtscts=True, exclusive=True)
        except (OSError, termios.error, ValueError, OverflowError) as error:
            raise ConfigError(f"radio.channel: uart:{device}:{baud}: {error}") from error
        self._fd = int(self._port.fileno())
        os.set_blocking(self._fd, False)
        with contextlib.suppress(OSError, termios.error):
            self._port.reset_input_buffer()

    def fileno(self) -> int:
        """Return the file descriptor for `select`."""
        return self._fd

    def receive(self) -> bytes:
        """Return some of the bytes that have arrived. Raises OSError."""
        # A device that is gone reads as ready and empty. One without data is not ready.
        if not select.select([self._fd], [], [], 0.0)[0]:
            return b""
        try:
            data = os.read(self._fd, READ_SIZE)
        except BlockingIOError:
            return b""
        if not data:
            raise ConnectionError(errno.ENODEV, "the serial device is gone")
        return data

    def send(self, data: bytes) -> int:
        """Return how many bytes were accepted. Raises OSError."""
        try:
            return os.write(self._fd, data)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Close the port."""
        with contextlib.suppress(OSError, termios.error):
            termios.tcflush(self._fd, termios.TCOFLUSH)  # else close waits while CTS blocks the line
        with contextlib.suppress(OSError):
            self._port.close()
