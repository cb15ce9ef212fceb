"""UDP as a link.

While we do not read, the kernel keeps the oldest datagrams and drops the newest once its receive buffer is
full. It grants the requested buffer size up to `net.core.rmem_max`, and counts 832 bytes for a small
datagram: 425 kB, which many systems grant, hold 512 of them; 2 MB hold 2,520.

Datagrams to a neighbour whose link-layer address is not known yet wait in the kernel for up to three seconds
and cannot be recalled. Two of them leave late when the neighbour answers; datagrams sent after these two are
dropped until then.
"""

from __future__ import annotations

import socket
from typing import Any

from companion.autopilot.heard_vehicle import shows_autopilot
from companion.runtime import clock
from companion.runtime.links.byte_link import HELD_S, READ_BYTES, LinkTrouble, Received
from companion.runtime.links.unsent import unsent_bytes

_DATAGRAM = 65536
_MAX_DATAGRAMS = 256
"""Largest number of datagrams read in one call, including those of other senders. Reading them takes about a
millisecond, or five on a small computer."""
_RECEIVE_BUFFER = 1024 * 1024
_SEND_BUFFER = 4096
"""Send buffer in bytes, which the kernel doubles. It holds about ten datagrams while the neighbour is unknown
or the interface accepts none."""
_PEER_SILENT_S = 3.0
"""A peer silent for this long may be replaced by another, because a restarted vehicle has a new port. An
autopilot is replaced only by an autopilot: a ground station or a tracker that happens to send here while the
vehicle pauses would otherwise keep the vehicle out for as long as it sends."""
_MAGICS = (0xFD, 0xFE)
"""First byte of a MAVLink 2 frame and of a MAVLink 1 frame."""


class UdpLink:
    """Datagrams to and from one peer: the first that sends MAVLink (udpin), or a given one (udpout).

    Args:
        listen: True for udpin, False for udpout.

    Raises:
        OSError: the host is unknown, or the address cannot be bound.
    """

    def __init__(self, address: tuple[str, int], trouble: LinkTrouble, *, listen: bool) -> None:
        info = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(info[0], socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        self._trouble = trouble
        self._listen = listen
        self._peer: Any = None
        self._heard_s = float("-inf")
        self._is_autopilot = False
        """The peer has sent an autopilot's heartbeat."""
        self._waits_since_s: float | None = None
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
        """File descriptor for `select`."""
        return self._socket.fileno()

    def receive(self, now_s: float) -> Received:
        """Return the waiting datagrams of the peer, joined."""
        parts: list[bytes] = []
        read = 0
        for _ in range(_MAX_DATAGRAMS):
            try:
                data, sender = self._socket.recvfrom(_DATAGRAM)
            except BlockingIOError:
                return Received(b"".join(parts), emptied=True)
            except OSError:
                # The network reports an error for a datagram of ours (port closed, no route); the next may
                # arrive.
                self._trouble.errors += 1
                continue
            read += len(data)
            if self._is_peer(sender, data, now_s):
                self._heard_s = now_s
                parts.append(data)
            if read >= READ_BYTES:
                break
        return Received(b"".join(parts), emptied=False)

    def _is_peer(self, sender: Any, data: bytes, now_s: float) -> bool:
        if sender == self._peer:
            self._is_autopilot = self._is_autopilot or shows_autopilot(data)
            return True
        silent = now_s - self._heard_s > _PEER_SILENT_S
        mavlink = self._listen and silent and data and data[0] in _MAGICS
        shows = mavlink and shows_autopilot(data)
        if not mavlink or (self._is_autopilot and not shows):
            self._trouble.left_out += 1
            return False
        self._peer, self._is_autopilot = sender, bool(shows)
        return True

    def send(self, data: bytes) -> None:
        """Send one datagram. Nothing is sent while the peer is unknown, or while older datagrams have waited
        for more than `HELD_S`."""
        if self._peer is None or not data:
            return
        now = clock.now_s()
        if not self._queued():
            self._waits_since_s = None
        elif self._waits_since_s is not None and now - self._waits_since_s > HELD_S:
            self._trouble.dropped += 1
            return
        if clock.now_s() - now > HELD_S:  # this process was held up in the call above
            self._trouble.dropped += 1
            return
        try:
            self._socket.sendto(data, self._peer)
        except BlockingIOError:
            self._trouble.dropped += 1
        except OSError:
            # No program listens there yet, no route, or a firewall: this datagram is lost, the link is not.
            self._trouble.errors += 1
        if self._waits_since_s is None:
            self._waits_since_s = now

    def _queued(self) -> int:
        """Number of bytes that no interface has accepted yet."""
        return unsent_bytes(self._socket)

    def discard(self) -> None:
        """Do nothing: a datagram that was sent cannot be recalled."""

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    abort = close
