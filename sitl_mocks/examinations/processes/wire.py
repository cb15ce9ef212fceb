"""Real-time router between one `companion run` process and one served vehicle.

It sends each frame as a separate datagram (UDP) or writes it (TCP, a pseudo-terminal), adds foreign frames,
applies the impairments of a modelled link (`modelled_link`), and reports to a judge what passes and when.
Datagrams are judged at the kernel's receive times, not at the times at which the router reads them. A
companion that is stopped reads nothing. Data that waits for it becomes readable when it resumes.
"""

from __future__ import annotations

import contextlib
import selectors
import time
from collections import deque
from collections.abc import Callable
from typing import Final

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import CURRENT_MODE, Frame, FrameScanner
from sitl_mocks.examinations.faults import others_frames
from sitl_mocks.examinations.modelled_link import Kind, ModelledLink
from sitl_mocks.examinations.processes.companion_ends import Left, datagrams, open_end, stamped_socket
from sitl_mocks.examinations.processes.decisions import AUTOPILOT, CLOCKS, Decisions
from sitl_mocks.examinations.rule_judge import Judge

GRACE_S: Final = 0.15
"""A step of the companion that was under way when the pilot's mode arrived may send for this long."""
CAUSE_S: Final = 1.5
"""A mode that the vehicle enters within this time after a request was caused by that request."""
_HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
_WATCHED: Final = frozenset({_HEARTBEAT, CURRENT_MODE, *CLOCKS})
"""Messages of the autopilot for which the router must know whether they were delivered."""
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
        rng: np.random.Generator | None = None,
        shown: Callable[[float, Frame], None] | None = None,
        passed: Callable[[float, list[bytes]], None] | None = None,
    ) -> None:
        self.kind = kind
        self.judge = judge
        self.way = ModelledLink(kind, np.random.default_rng(0) if rng is None else rng, buffered=False)
        self.late_s = 0.0
        """Longest time that a datagram waited for the router."""
        self._decisions = Decisions()
        self._drops = 0
        self._was_full = False
        """Whether the companion's buffer was full at the last check."""
        self._shown = shown
        self._passed = passed
        self.traffic_hz = 0.0
        self.dropped = 0
        """Number of frames that a full stream or a full UDP buffer did not accept."""
        self._traffic, self._traffic_s, self._traffic_n = others_frames(), 0.0, 0
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
        self._vehicle = stamped_socket()
        self._vehicle.connect(("127.0.0.1", vehicle_port))
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._vehicle, selectors.EVENT_READ)
        self._end = open_end(kind, self._selector)
        self.name = self._end.name

    def close(self) -> None:
        """Close all sockets and file descriptors."""
        self._selector.close()
        self._vehicle.close()
        self._end.close()

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

    # ------------------------------------------------------------ passing on

    def pump(self, for_s: float) -> None:
        """Forward all data that arrives within this time."""
        polled = self.way.under_way or self._end.polled
        self._selector.select(min(for_s, _UNDER_WAY_S) if polled else for_s)
        now_s = time.monotonic()
        came = [(left.at_s, False, left) for left, _ in datagrams(self._vehicle)]
        from_companion = self._end.read(now_s, self.way.weather)
        came += [(left.at_s + left.waited_s, True, left) for left in from_companion]
        for at_s, up, left in sorted(came, key=lambda one: one[0]):
            self.late_s = max(self.late_s, now_s - at_s)
            if up:
                self._up(left)
            else:
                self._down(at_s, left.data)
        self._add_traffic(now_s)
        self._deliver(now_s)
        self._end.flush()

    def _down(self, at_s: float, data: bytes) -> None:
        frames = self._scanner.frames(data)
        raw = [frame.raw for frame in frames]
        if self._passed is not None:
            self._passed(at_s, raw)
        if self._shown is not None:
            for frame in frames:
                self._shown(at_s, frame)
        self.way.tell(at_s, raw)

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
        singly = self._was_full or len(news) > _FEW
        told = []
        for sent_s, frame in news:
            watched = _is_watched(frame)
            if watched and singly:
                self._drops = self._end.kernel_drops()
            if not self._write(frame) or not watched or not self._end.confirms:
                continue
            if not singly or self._count_drops() == 0:
                told.append((sent_s, frame))
        if told and not singly and (lost := self._count_drops()):
            # A full buffer drops new datagrams, so the first ones were delivered.
            told = told[: max(0, len(told) - lost)]
        return told

    def _count_drops(self) -> int:
        """Number of datagrams dropped since the last call."""
        before, self._drops = self._drops, self._end.kernel_drops()
        lost = max(0, self._drops - before)
        self._was_full = lost > 0
        self.dropped += lost
        return lost

    def _write(self, frame: bytes) -> bool:
        written = self._end.write(frame)
        self.dropped += self._end.connected and not written
        return written

    def _up(self, left: Left) -> None:
        frames = self._up_scanner.frames(left.data)
        if not frames:
            return
        whole = b"".join(frame.raw for frame in frames)
        self.judge.leaves(left.at_s, whole)
        if self.way.weather.up_stands and self.kind != "tcp":
            return  # A TCP end drops the segments itself (`TcpEnd`).
        # The time that the far end took to read is not the companion's delay.
        decided_s = self._decisions.decided_s(left.at_s, frames) + left.waited_s
        self.judge.reaches(left.at_s + left.waited_s, whole, decided_s)
        if self._passed is not None:
            self._passed(left.at_s + left.waited_s, [frame.raw for frame in frames])
        with contextlib.suppress(OSError):
            self._vehicle.send(whole)


def _is_watched(frame: bytes) -> bool:
    return (
        frame[0] == 0xFD and frame[6] == AUTOPILOT and frame[7] | frame[8] << 8 | frame[9] << 16 in _WATCHED
    )
