"""Answers to TIMESYNC, which let commands leave: how often they are asked for, and which of them count."""

from __future__ import annotations

from collections import deque

import pytest

from companion.autopilot.polled.timesync import read_timesync, timesync
from companion.autopilot.wire import FrameScanner, MavlinkWriter
from companion.events import VelocitySetpoint
from companion.system import CompanionSystem
from tests.companion.gate.flying import config
from tests.support.place import LAT_E7, LON_E7

_TIMESYNC, _SETPOINT = 111, 84
_TRICKLE_S = 0.002
"""A line of 57600 baud brings some eleven bytes in this time."""
_CHUNK = 11


class SlowLine:
    """A vehicle in GUIDED behind a serial line that brings a few bytes at a time, read as the flight loop
    does; each step commands it to stand."""

    def __init__(self, round_trip_s: float) -> None:
        self.onboard = CompanionSystem(config("fly", take_in_flight=True))
        self.round_trip_s = round_trip_s
        self.questions = self.setpoints = 0
        self._writer = MavlinkWriter(1, 1)
        self._answers: deque[tuple[float, int]] = deque()
        self._down = bytearray()
        self._now_s = self._step_s = self._told_s = 10.0

    def run(self, seconds: float) -> None:
        """So long; what left is counted anew."""
        self.questions = self.setpoints = 0
        for _ in range(round(seconds / _TRICKLE_S)):
            self._now_s += _TRICKLE_S
            self._vehicle()
            chunk = bytes(self._down[:_CHUNK])
            del self._down[:_CHUNK]
            if chunk:
                self.onboard.receive(chunk, self._now_s)
                self._send()
            if self._now_s >= self._step_s:
                self._step_s += 0.05
                self.onboard.receive(b"", self._now_s)
                self.onboard.tick(self._now_s)
                self.onboard.link.send(VelocitySetpoint(velocity_ned_mps=(0.0, 0.0, 0.0)), self._now_s)
                self._send()

    def _vehicle(self) -> None:
        writer, encoder, now_s = self._writer, self._writer.encoder, self._now_s
        if now_s >= self._told_s:
            self._told_s += 0.1
            self._down += writer.pack(encoder.heartbeat_encode(2, 3, 129, 4, 4))
            place = LAT_E7, LON_E7, 450000, 50000
            self._down += writer.pack(
                encoder.global_position_int_encode(round(now_s * 1e3), *place, 0, 0, 0, 0)
            )
        while self._answers and self._answers[0][0] <= now_s:
            _, ts1 = self._answers.popleft()
            self._down += writer.pack_payload(*timesync(round(now_s * 1e9), ts1, 0, 0))

    def _send(self) -> None:
        for frame in FrameScanner().frames(self.onboard.drain(self._now_s)):
            self.setpoints += frame.message_id == _SETPOINT
            if frame.message_id == _TIMESYNC and read_timesync(frame.payload)[0] == 0:
                self.questions += 1
                self._answers.append((self._now_s + self.round_trip_s, read_timesync(frame.payload)[1]))


@pytest.mark.parametrize("round_trip_s", [0.02, 0.15, 0.23])
def test_a_slow_line_is_flown_over(round_trip_s: float) -> None:
    line = SlowLine(round_trip_s)
    line.run(1.0)
    line.run(2.0)
    assert line.setpoints == pytest.approx(40, abs=1)


def test_a_line_that_is_too_slow_is_not_flooded_with_questions() -> None:
    """Questions for each few bytes that come would fill it, and keep it slow."""
    line = SlowLine(0.3)
    line.run(1.0)
    line.run(2.0)
    assert line.questions <= 41
    assert line.setpoints == 0


def test_a_line_that_is_quick_again_is_flown_over_again() -> None:
    line = SlowLine(0.02)
    line.run(1.0)
    line.round_trip_s = 0.4
    line.run(1.5)
    line.round_trip_s = 0.02
    line.run(4.0)
    line.run(1.0)
    assert line.setpoints == pytest.approx(20, abs=1)


@pytest.mark.parametrize("round_trip_s", [0.6, 3.0])
def test_a_vehicle_that_answers_very_late_is_none_that_never_answers(round_trip_s: float) -> None:
    line = SlowLine(round_trip_s)
    line.run(round_trip_s + 2.0)
    line.run(2.0)
    assert line.setpoints == 0
