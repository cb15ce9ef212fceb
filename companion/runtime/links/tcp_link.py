"""TCP as a link.

While we do not read, the receive buffer grows up to `net.ipv4.tcp_rmem` (6 MB and more). After that the
peer's kernel holds further data, and nothing is dropped.

Our kernel keeps retransmitting data that the peer's kernel has not acknowledged. Only aborting the connection
stops that. Acknowledged data cannot be recalled: a Linux reader that was stopped still reads it after our
reset, and only then gets the error.
"""

from __future__ import annotations

import select
import socket
import struct
import sys

from companion.runtime.links.byte_link import LATE_S, LinkTrouble
from companion.runtime.links.stream_link import StreamLink
from companion.runtime.links.unsent import unsent_bytes

_CONNECT_S = 3.0
_SEND_BUFFER = 8 * 1024
_AT_ONCE = struct.pack("ii", 1, 0)
"""Value of SO_LINGER with which `close` resets the connection and frees what is queued."""
_MIN_RTT_AT = 148
"""Byte offset of `tcpi_min_rtt` (microseconds) in Linux's struct tcp_info."""


class TcpLink(StreamLink):
    """A TCP client.

    Raises:
        OSError: the connection was not made within three seconds.
    """

    def __init__(self, address: tuple[str, int], trouble: LinkTrouble) -> None:
        super().__init__(trouble, keeps=True)
        self._socket = socket.create_connection(address, timeout=_CONNECT_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        self._socket.setblocking(False)
        if sys.platform == "linux":
            # Makes the socket not writable while the kernel holds any unsent data.
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, 1)
            # Makes the kernel end the connection if this process is stopped and cannot do it.
            limit_ms = int(1e3 * self._late_after_s())
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, limit_ms)

    def fileno(self) -> int:
        """File descriptor for `select`."""
        return self._socket.fileno()

    def discard(self) -> None:
        """Do nothing if all data was acknowledged; TCP cannot discard unacknowledged data.

        Raises:
            ConnectionAbortedError: some data was not acknowledged; the link has to be aborted.
        """
        if self._here():
            raise ConnectionAbortedError("sent data was not acknowledged in time")

    def abort(self) -> None:
        """Reset the connection."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)
        self._socket.close()

    def _release(self) -> None:
        if self._here():
            self.abort()
        else:
            self._socket.close()

    def _read(self, count: int) -> bytes:
        data = self._socket.recv(count)
        if not data:
            raise ConnectionError("the autopilot's side closed the TCP connection")
        return data

    def _write(self, data: bytes) -> int:
        return self._socket.send(data)

    def _queued(self) -> int:
        return unsent_bytes(self._socket)

    def _takes_more(self, now_s: float) -> bool:
        # Data that was sent but not acknowledged yet does not hold up the next send: the acknowledgement of
        # the next send lets the kernel notice a lost segment before the limit.
        return bool(select.select([], [self._socket], [], 0.0)[1])

    def _late_after_s(self) -> float:
        return LATE_S + self._round_trip_s()

    def _round_trip_s(self) -> float:
        """Shortest round trip so far: the least time that an acknowledgement takes on this path. Only Linux
        reports it; elsewhere 0."""
        if sys.platform != "linux":
            return 0.0
        info = self._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _MIN_RTT_AT + 4)
        if len(info) < _MIN_RTT_AT + 4:
            return 0.0
        (shortest_us,) = struct.unpack_from("I", info, _MIN_RTT_AT)
        return float(shortest_us) * 1e-6
