"""One clock, that counts the time for which the computer was suspended and that nobody sets."""

from __future__ import annotations

import re
import time
from pathlib import Path

from companion.runtime import clock

RUNTIME = Path(clock.__file__).parent


def test_the_time_of_a_suspend_counts(monkeypatch):
    asked = []

    def read(number):
        asked.append(number)
        return 1000.0

    monkeypatch.setattr(time, "clock_gettime", read)
    assert clock.now_s() == 1000.0
    assert asked == [time.CLOCK_BOOTTIME]


def test_the_flight_has_no_other_clock():
    """Two clocks that differ by the time of a suspend would wait for ever, or not at all."""
    others = re.compile(r"\bmonotonic(_ns)?\(|\.monotonic\b|import monotonic|clock_gettime")
    using = {path.name for path in RUNTIME.glob("*.py") if others.search(path.read_text())}
    assert using == {"clock.py"}
