"""Real-time router between one `companion run` process and one served vehicle.

It sends each frame as a separate datagram (UDP) or writes it (TCP, a pseudo-terminal), adds foreign frames,
applies the impairments of a modelled link (`modelled_link`), and reports to a judge what passes and when.
Datagrams are judged at the kernel's receive times, not at the times at which the router reads them. A
companion that is stopped reads nothing. Data that waits for it becomes readable when it resumes.
"""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import struct
import time
import tty
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from companion.autopilot.wire import CURRENT_MODE, Frame, FrameScanner
from sitl_mocks.examinations.faults import Interposer, others_frames
from sitl_mocks.examinations.modelled_link import Kind, ModelledLink
from sitl_mocks.examinations.rule_judge import Judge

_READ_BYTES = 65536
_ANCILLARY_BYTES = 64
_STAMPED: Final = 35
"""SO_TIMESTAMPNS: the kernel's time of each datagram."""
_STAMP = struct.Struct("@ll")
_HEARTBEAT, _SYSTEM_TIME, _LOCAL, _GLOBAL, _SETPOINT = 0, 2, 32, 33, 84
_CLOCKS: Final = {_SYSTEM_TIME: 8, _LOCAL: 0, _GLOBAL: 0}
"""Messages that give the companion the vehicle's clock, and the clock's offset in them (uint32, ms)."""
_WATCHED: Final = frozenset({_HEARTBEAT, CURRENT_MODE, *_CLOCKS})
"""Messages of the autopilot for which the router must know whether they were delivered."""
_AUTOPILOT = 1
_FEW = 8
_UNDER_WAY_S = 0.002
_UNSURE_S = 0.2
"""Messages sent to a running companion within this time before a stop may not have been read."""
_RUNS_EVERY_S = 0.1


class Wire:
    """One companion's link. `name` is the link name for the companion's configuration.

    Args:
        kind: kind of the companion's link.
        vehicle_port: port on which the vehicle listens (UDP, loopback).
        rng: generator for the impairments of the link.
        shown: called with the time and each of the vehicle's frames as it leaves the vehicle.
        passed: called with the time and the frames of all that passes at the vehicle's end, in both
            directions.
    """

    def __init__(
        self,
        kind: Kind,
        vehicle_port: int,
        judge: Judge,
        *,
        system_id: int = 1,
        rng: np.random.Generator | None = None,
        shown: Callable[[float, Frame], None] | None = None,
        passed: Callable[[float, list[bytes]], None] | None = None,
    ) -> None:
        self.kind = kind
        self.judge = judge
        self.way = ModelledLink("udp", np.random.default_rng(0) if rng is None else rng, buffered=False)
        self.interposer = Interposer(system_id)
        self.late_s = 0.0
        """Longest time that a datagram waited for the router."""
        self._decisions = Decisions()
        self._drops = 0
        self._loses = False
        """Whether the companion's buffer was full at the last check."""
        self._shown = shown
        self._passed = passed
        self.traffic_hz = 0.0
        self.dropped = 0
        """Number of frames that a full stream or a full UDP buffer did not accept."""
        self._traffic = others_frames()
        self._traffic_s = 0.0
        self._traffic_n = 0
        self._scanner = FrameScanner(keep_unknown=True)
        self._up_scanner = FrameScanner(keep_unknown=True)
        self._stopped: list[tuple[float, bytes]] | None = None
        """Frames that were sent to a stopped companion; None while it runs."""
        self._stopped_s = 0.0
        self._recent: deque[tuple[float, float, bytes]] = deque()
        """Recent frames to a running companion: time of sending, time of leaving the vehicle, and the
        frame.
        """
        self._ran_s = time.monotonic()
        self._vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._vehicle.connect(("127.0.0.1", vehicle_port))
        self._vehicle.setblocking(False)
        self._vehicle.setsockopt(socket.SOL_SOCKET, _STAMPED, 1)
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
            self._socket.setsockopt(socket.SOL_SOCKET, _STAMPED, 1)
        else:
            self._socket = socket.create_server(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self._selector.register(self._socket, selectors.EVENT_READ)
        port = self._socket.getsockname()[1]
        return f"udpout:127.0.0.1:{port}" if self.kind == "udp" else f"tcp:127.0.0.1:{port}"

    def close(self) -> None:
        """Close all sockets and file descriptors."""
        self._selector.close()
        for sock in (self._vehicle, self._socket, self._client):
            if sock is not None:
                sock.close()
        for end in self._ends or ():
            os.close(end)

    # ------------------------------------------------------------ the companion

    def stopped(self) -> None:
        """The companion was stopped and reads nothing from now on."""
        now_s = time.monotonic()
        self.judge.stops(now_s)
        self._stopped_s = now_s
        self._stopped = [(sent_s, frame) for at_s, sent_s, frame in self._recent if now_s - at_s < _UNSURE_S]

    def continues(self) -> None:
        """The companion is about to resume and can read what waits for it."""
        assert self._stopped is not None
        told, self._stopped = self._stopped, None
        self._ran_s = time.monotonic()
        self.judge.reads(self._ran_s, told)
        # The companion reads until nothing waits, so its later decisions use all of this data.
        self._decisions.readable(self._stopped_s, told)

    def _kernel_drops(self) -> int:
        """Number of datagrams for the companion that the kernel has dropped so far."""
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
        """Forward all data that arrives within this time."""
        ready = self._selector.select(min(for_s, _UNDER_WAY_S) if self.way.under_way else for_s)
        now_s = time.monotonic()
        came: list[tuple[float, bool, bytes]] = []
        for key, _ in ready:
            if key.fileobj is self._vehicle:
                came += [(at_s, False, data) for at_s, data in self._datagrams(self._vehicle)]
            elif key.fileobj is not self._socket:
                came.append((now_s, True, self._receive()))
            elif self.kind == "tcp":
                self._accept()
            else:
                came += [(at_s, True, data) for at_s, data in self._datagrams(self._socket)]
        for at_s, up, data in sorted(came, key=lambda one: one[0]):
            if up:
                self._up(at_s, data)
            else:
                self._down(at_s, data)
        self._add_traffic(now_s)
        self._deliver(now_s)
        self._flush()

    def _datagrams(self, sock: socket.socket) -> list[tuple[float, bytes]]:
        """All waiting datagrams with their receive times."""
        found: list[tuple[float, bytes]] = []
        with contextlib.suppress(BlockingIOError):
            while True:
                try:
                    data, ancillary, _, address = sock.recvmsg(_READ_BYTES, _ANCILLARY_BYTES)
                except ConnectionError:
                    continue  # Error from a socket that was closed.
                now_s, utc_s = time.monotonic(), time.time()
                seconds, nanoseconds = _STAMP.unpack_from(ancillary[0][2])
                late_s = max(0.0, utc_s - seconds - 1e-9 * nanoseconds)
                self.late_s = max(self.late_s, late_s)
                found.append((now_s - late_s, data))
                if sock is not self._vehicle:
                    self._peer = address
        return found

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

    def _down(self, at_s: float, data: bytes) -> None:
        frames = self._scanner.frames(data)
        raw = [frame.raw for frame in frames]
        if self._passed is not None:
            self._passed(at_s, raw)
        if self._shown is not None:
            for frame in frames:
                self._shown(at_s, frame)
        self.way.tell(at_s, self.interposer.down(raw))

    def _add_traffic(self, now_s: float) -> None:
        if self.traffic_hz <= 0.0:
            self._traffic_s = now_s
            return
        due = int((now_s - self._traffic_s) * self.traffic_hz)
        if due:
            self._traffic_s += due / self.traffic_hz
            numbers = range(self._traffic_n, self._traffic_n + due)
            self._traffic_n += due
            self.way.tell(now_s, [self._traffic[n % len(self._traffic)] for n in numbers])

    def _deliver(self, now_s: float) -> None:
        """Write the frames that have arrived to the companion."""
        told = self._write_all(self.way.news(now_s))
        if self._stopped is not None:
            self._stopped += told
            return
        # A delay of the router itself does not mean that the companion stood still.
        now_s = time.monotonic()
        while now_s - self._ran_s > _RUNS_EVERY_S:
            self._ran_s += _RUNS_EVERY_S
            self.judge.reads(self._ran_s, ())
        self._ran_s = now_s
        self.judge.reads(now_s, told)
        self._decisions.readable(now_s, told)
        self._recent.extend((now_s, sent_s, frame) for sent_s, frame in told)
        while self._recent and now_s - self._recent[0][0] >= _UNSURE_S:
            self._recent.popleft()

    def _write_all(self, news: list[tuple[float, bytes]]) -> list[tuple[float, bytes]]:
        """Write frames to the companion. Returns the watched frames that were delivered.

        With a full UDP buffer, delivery is known only as far as the kernel reports it. Reading the kernel's
        count of drops takes time. It is read once for a few frames, and around each watched frame if there
        are many or if some were lost the last time.
        """
        singly = self._loses or len(news) > _FEW
        told = []
        for sent_s, frame in news:
            watched = _is_watched(frame)
            if self.kind == "udp" and watched and singly:
                self._drops = self._kernel_drops()
            if not self._write(frame) or not watched:
                continue
            if not singly or self._count_drops() == 0:
                told.append((sent_s, frame))
        if self.kind == "udp" and told and not singly and (lost := self._count_drops()):
            # A full buffer drops new datagrams, so the first ones were delivered.
            told = told[: max(0, len(told) - lost)]
        return told

    def _count_drops(self) -> int:
        """Number of datagrams dropped since the last call."""
        if self.kind != "udp":
            return 0
        before, self._drops = self._drops, self._kernel_drops()
        lost = max(0, self._drops - before)
        self._loses = lost > 0
        self.dropped += lost
        return lost

    def _write(self, frame: bytes) -> bool:
        """Whether the whole frame was accepted. A full stream drops the newest frame."""
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
        """Write the rest of a partly written frame."""
        if not self._unsent:
            return
        with contextlib.suppress(BlockingIOError, ConnectionError):
            if self._ends is not None:
                self._unsent = self._unsent[os.write(self._ends[0], self._unsent) :]
            elif self._client is not None:
                self._unsent = self._unsent[self._client.send(self._unsent) :]

    def _up(self, at_s: float, data: bytes) -> None:
        frames = self._up_scanner.frames(data)
        if not frames:
            return
        whole = b"".join(frame.raw for frame in frames)
        self.judge.leaves(at_s, whole)
        self.way.send(at_s, whole, self._decisions.decided_s(at_s, frames))
        for decided_s, sent in self.way.arrived(at_s):
            kept = self.interposer.up(sent)
            self.judge.reaches(at_s, kept, decided_s)
            if self._passed is not None:
                self._passed(at_s, [frame.raw for frame in frames if frame.raw in kept])
            with contextlib.suppress(OSError):
                self._vehicle.send(kept)

    def _receive(self) -> bytes:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            if self._ends is not None:
                return os.read(self._ends[0], _READ_BYTES)
            if self._client is not None:
                data = self._client.recv(_READ_BYTES)
                if not data:
                    self._selector.unregister(self._client)
                    self._client.close()
                    self._client = None
                return data
        return b""


class Decisions:
    """Latest possible decision times of setpoints, as far as they can be inferred from outside.

    A setpoint carries the vehicle's clock as the companion knew it. If a message with a later time had been
    readable, the companion decided before it read that message. If the message was readable when the
    companion resumed after a stop, the companion decided before the stop.
    """

    def __init__(self) -> None:
        self._told: deque[tuple[float, int]] = deque(maxlen=1000)
        """Times at which a message could be read, and the vehicle's clock in it (ms). Both increase."""
        self._newest_ms = -1

    def readable(self, now_s: float, told: list[tuple[float, bytes]]) -> None:
        """The companion can read these frames now."""
        for _, raw in told:
            message_id = raw[7] | raw[8] << 8 | raw[9] << 16
            at = _CLOCKS.get(message_id) if raw[0] == 0xFD and raw[6] == _AUTOPILOT else None
            if at is None:
                continue
            clock_ms = int.from_bytes(raw[10 : 10 + raw[1]].ljust(12, b"\0")[at : at + 4], "little")
            if clock_ms < self._newest_ms:
                # Out of order: the companion's clock goes back, and nothing is known until it has advanced
                # again.
                self._told.clear()
            elif clock_ms > self._newest_ms:
                self._newest_ms = clock_ms
                self._told.append((now_s, clock_ms))

    def decided_s(self, now_s: float, frames: list[Frame]) -> float:
        """Latest possible decision time of frames that leave now."""
        decided_s = now_s
        for frame in frames:
            if frame.message_id == _SETPOINT:
                clock_ms = int.from_bytes(frame.payload[:4], "little")
                # A message may have been read after the step had begun.
                later = next((at_s for at_s, told_ms in self._told if told_ms > clock_ms), now_s)
                decided_s = min(decided_s, later)
        while len(self._told) > 1 and now_s - self._told[0][0] > _KNOWN_S:
            self._told.popleft()
        return decided_s


_KNOWN_S = 30.0
"""Longer than any stall of a companion."""


def _is_watched(frame: bytes) -> bool:
    return (
        frame[0] == 0xFD and frame[6] == _AUTOPILOT and frame[7] | frame[8] << 8 | frame[9] << 16 in _WATCHED
    )
