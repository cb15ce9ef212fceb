"""Messages of the vehicle that arrive late: what was measured, what follows and when it ends.

A vehicle's clock that runs slow looks like messages that are held up more and more. TIMESYNC tells the two
apart: no clock is read before it was asked for, so an answer that is too small for its question proves that
the clock fell behind, however slow the link is.
"""

from __future__ import annotations

from collections import deque

from companion.events import ClockRead, Command, InputBehind, Say, Severity

_TOLD_AFTER_S = 1.5
"""Late input is reported after this time. It is longer than the heartbeat period, because the first heartbeat
after a short delay shows the mode again."""
_PAUSE_S = 10.0
"""Least time between two warnings, because a link may be late again and again."""
_RATE_OVER_S, _RATE_WITHIN_S = 20.0, 60.0
"""Least and greatest time over which the rate of the vehicle's clock is measured."""
_MOST_READINGS = 120
_SLOW = 1e-3
"""A clock that loses less than this (s/s) is not called slow: the gate allows for as much."""
_STEADY = 0.5
"""Greatest difference between the loss rates in the two halves of the measured time, as a fraction of the
loss rate. A larger difference shows a clock that jumped rather than one that runs slow."""

_RECENT = "its messages are recent and show the mode"
_KEPT = "it keeps time and the companion is restarted"


class ClockRate:
    """Rate of the vehicle's clock in relation to ours, from its answers to TIMESYNC."""

    def __init__(self) -> None:
        self._readings: deque[ClockRead] = deque(maxlen=_MOST_READINGS)

    def read(self, event: ClockRead) -> None:
        """Take in one answer to TIMESYNC."""
        readings = self._readings
        if readings and event.time_boot_s <= readings[-1].time_boot_s:
            readings.clear()  # The clock has restarted.
        readings.append(event)
        while event.heard_s - readings[0].heard_s > _RATE_WITHIN_S:
            readings.popleft()

    def slow(self) -> float | None:
        """Seconds of the vehicle's clock in one of ours if it is proven to run slow steadily, otherwise None.

        The rate is known to the sum of two round trips divided by the time between them.
        """
        readings = self._readings
        if not readings or readings[-1].heard_s - readings[0].heard_s < _RATE_OVER_S:
            return None
        first, middle, last = readings[0], readings[len(readings) // 2], readings[-1]
        if _least_loss(first, last) <= _SLOW:
            return None
        loss = _loss(first, last)
        if abs(_loss(first, middle) - _loss(middle, last)) > _STEADY * loss:
            return None
        return 1.0 - loss


def _least_loss(first: ClockRead, last: ClockRead) -> float:
    """Least rate (s/s) at which the clock lost time between two readings, whatever the link's delays."""
    lost_s = (last.asked_s - last.time_boot_s) - (first.heard_s - first.time_boot_s)
    return lost_s / (last.heard_s - first.heard_s)


def _loss(first: ClockRead, last: ClockRead) -> float:
    """Rate (s/s) at which the clock lost time, if each answer was sent in the middle of its round trip."""
    passed_s = (last.asked_s + last.heard_s - first.asked_s - first.heard_s) / 2.0
    return 1.0 - (last.time_boot_s - first.time_boot_s) / passed_s


class LateInput:
    """Tells the pilot and the status while messages of the vehicle may be old and nothing is commanded."""

    def __init__(self) -> None:
        self._rate = ClockRate()
        self.why: str | None = None
        """What was measured; None as for `text`."""
        self.text: str | None = None
        """What was measured, that nothing is commanded, and until when, in one sentence; None while all
        input is current, or for a record that does not hold what was measured."""
        self._since_s: float | None = None
        self._told_s: float | None = None
        """Time of the latest warning in this period of late input; None before it."""
        self._warned_s = float("-inf")
        self._slow_told = False

    def read(self, event: ClockRead) -> None:
        """Take in one answer to TIMESYNC."""
        self._rate.read(event)

    def step(self, now_s: float, behind: InputBehind | None) -> list[Command]:
        """Take in whether the input of this step is late. Returns messages to the pilot, which the core sends
        only if the companion may fly the vehicle."""
        if behind is None or not behind.why:
            told, self._since_s, self._told_s = self._told_s, None, None
            self.why, self.text, self._slow_told = None, None, False
            if told is None:
                return []
            return [Say(severity=Severity.NOTICE, text="DMUCA: the vehicle's messages are recent again")]
        slow = self._rate.slow() if behind.by_clock else None
        clock = "" if slow is None else f"the vehicle's clock runs at {slow:.3f} of ours: "
        self.why = clock + behind.why
        self.text = f"{self.why}; nothing is commanded until {_RECENT if slow is None else _KEPT}"
        self._since_s = now_s if self._since_s is None else self._since_s
        lasted = now_s - self._since_s >= _TOLD_AFTER_S
        first = self._told_s is None and now_s - self._warned_s >= _PAUSE_S
        if not lasted or not (first or (slow is not None and not self._slow_told)):
            return []
        self._told_s = self._warned_s = now_s
        self._slow_told = slow is not None
        return [Say(severity=Severity.WARNING, text=f"DMUCA: {self.text}")]
