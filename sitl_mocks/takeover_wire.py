"""The way between one `companion run` and one served vehicle, in real time: a router of our own.

It sends each frame as a datagram of its own (UDP) or writes it (TCP, a pseudo-terminal), adds others' frames,
and tells a judge what passes and when. A companion that is stopped reads nothing: what waits for it becomes
readable when it goes on.
"""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import time
import tty
from pathlib import Path

from companion.autopilot.wire import Frame, FrameScanner
from sitl_mocks.judge import Judge
from sitl_mocks.modelled_link import Kind
from sitl_mocks.soak_faults import others_frames

_READ_BYTES = 65536
_PEER_S = 5.0


class Wire:
    """One companion's link. `name` is what the companion is configured with.

    Args:
        kind: of the companion's link.
        vehicle_port: where the vehicle listens (UDP, loopback).
    """

    def __init__(self, kind: Kind, vehicle_port: int, judge: Judge) -> None:
        self.kind = kind
        self.judge = judge
        self.traffic_hz = 0.0
        self.dropped = 0
        """Frames that a full stream did not take."""
        self._traffic = others_frames()
        self._traffic_s = 0.0
        self._traffic_n = 0
        self._scanner = FrameScanner(keep_unknown=True)
        self._up_scanner = FrameScanner()
        self._stopped: list[tuple[float, bytes]] | None = None
        """What was sent to a companion that is stopped."""
        self._drops = 0
        self._vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._vehicle.connect(("127.0.0.1", vehicle_port))
        self._vehicle.setblocking(False)
        self._peer: tuple[str, int] | None = None
        self._client: socket.socket | None = None
        self._unsent = b""
        self._ends: tuple[int, int] | None = None
        self._socket: socket.socket | None = None
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._vehicle, selectors.EVENT_READ)
        self.name = self._open()

    def _open(self) -> str:
        if self.kind == "pty":
            self._ends = os.openpty()
            tty.setraw(self._ends[1])
            os.set_blocking(self._ends[0], False)
            self._selector.register(self._ends[0], selectors.EVENT_READ)
            return f"serial:{os.ttyname(self._ends[1])}:921600"
        if self.kind == "udp":
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.bind(("127.0.0.1", 0))
        else:
            self._socket = socket.create_server(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self._selector.register(self._socket, selectors.EVENT_READ)
        port = self._socket.getsockname()[1]
        return f"udpout:127.0.0.1:{port}" if self.kind == "udp" else f"tcp:127.0.0.1:{port}"

    def close(self) -> None:
        """Release everything."""
        self._selector.close()
        for sock in (self._vehicle, self._socket, self._client):
            if sock is not None:
                sock.close()
        for end in self._ends or ():
            os.close(end)

    # ------------------------------------------------------------ the companion

    def stopped(self) -> None:
        """The companion was stopped: from now on nothing is read."""
        self._drops = self._kernel_drops()
        self._stopped = []

    def continues(self) -> None:
        """The companion is about to go on: what waits for it can be read."""
        assert self._stopped is not None
        told, self._stopped = self._stopped, None
        # A full UDP buffer drops what comes: the first ones are there.
        lost = self._kernel_drops() - self._drops
        self.judge.reads(time.monotonic(), told[: len(told) - lost])

    def _kernel_drops(self) -> int:
        """Datagrams for the companion that the kernel has dropped so far."""
        if self.kind != "udp" or self._peer is None:
            return 0
        end = f":{self._peer[1]:04X}"
        for line in Path("/proc/net/udp").read_text().splitlines()[1:]:
            columns = line.split()
            if columns[1].endswith(end):
                return int(columns[-1])
        return 0

    # ------------------------------------------------------------ passing on

    def pump(self, for_s: float) -> None:
        """Pass on whatever comes for so long."""
        ready = self._selector.select(for_s)
        now_s = time.monotonic()
        for key, _ in ready:
            if key.fileobj is self._vehicle:
                self._down(now_s)
            elif key.fileobj is self._socket and self.kind == "tcp":
                self._accept()
            else:
                self._up(now_s)
        self._add_traffic(now_s)
        self._flush()

    def _accept(self) -> None:
        assert self._socket is not None
        client, _ = self._socket.accept()
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._client is not None:
            self._selector.unregister(self._client)
            self._client.close()
        self._client, self._unsent = client, b""
        self._selector.register(client, selectors.EVENT_READ)

    def _down(self, now_s: float) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            while True:
                data = self._vehicle.recv(_READ_BYTES)
                self._tell(now_s, [frame.raw for frame in self._scanner.frames(data)])

    def _add_traffic(self, now_s: float) -> None:
        if self.traffic_hz <= 0.0:
            self._traffic_s = now_s
            return
        due = int((now_s - self._traffic_s) * self.traffic_hz)
        if due:
            self._traffic_s += due / self.traffic_hz
            numbers = range(self._traffic_n, self._traffic_n + due)
            self._traffic_n += due
            self._tell(now_s, [self._traffic[n % len(self._traffic)] for n in numbers])

    def _tell(self, now_s: float, frames: list[bytes]) -> None:
        told = [(now_s, frame) for frame in frames if self._write(frame)]
        if self._stopped is not None:
            self._stopped += told
        elif told:
            self.judge.reads(now_s, told)

    def _write(self, frame: bytes) -> bool:
        """Whether it was sent, whole; a stream that is full loses the newest."""
        if self.kind == "udp":
            if self._peer is None or self._socket is None:
                return False
            with contextlib.suppress(OSError):
                self._socket.sendto(frame, self._peer)
                return True
            return False
        if (self._client is None and self.kind == "tcp") or self._unsent:
            self.dropped += 1
            return False
        self._unsent = frame
        self._flush()
        if len(self._unsent) == len(frame):
            self._unsent = b""
            self.dropped += 1
            return False
        return True

    def _flush(self) -> None:
        """The rest of a frame that was begun."""
        if not self._unsent:
            return
        with contextlib.suppress(BlockingIOError, ConnectionError):
            if self._ends is not None:
                self._unsent = self._unsent[os.write(self._ends[0], self._unsent) :]
            elif self._client is not None:
                self._unsent = self._unsent[self._client.send(self._unsent) :]

    def _up(self, now_s: float) -> None:
        data = self._receive()
        if not data:
            return
        frames: list[Frame] = self._up_scanner.frames(data)
        whole = b"".join(frame.raw for frame in frames)
        self.judge.leaves(now_s, whole)
        self.judge.reaches(now_s, whole, now_s)
        with contextlib.suppress(OSError):
            self._vehicle.send(data)

    def _receive(self) -> bytes:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            if self._ends is not None:
                return os.read(self._ends[0], _READ_BYTES)
            if self.kind == "udp" and self._socket is not None:
                data, self._peer = self._socket.recvfrom(_READ_BYTES)
                return data
            if self._client is not None:
                data = self._client.recv(_READ_BYTES)
                if not data:
                    self._selector.unregister(self._client)
                    self._client.close()
                    self._client = None
                return data
        return b""
