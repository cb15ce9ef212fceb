"""Ctrl-C and SIGTERM in the middle of many flights."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import pytest


def workers(pid: int) -> list[int]:
    """Child processes of a process."""
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def running(pids: list[int]) -> list[int]:
    return [pid for pid in pids if Path(f"/proc/{pid}/exe").exists()]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_all_flights(start, number):
    demo = start("sitl_mocks", "demo", "--seeds", "1-20")
    end = time.monotonic() + 60.0
    while len(workers(demo.process.pid)) < 2 and time.monotonic() < end:
        time.sleep(0.1)
    # Let them begin to fly.
    time.sleep(3.0)
    flying = workers(demo.process.pid)
    assert demo.end(number) == 130
    end = time.monotonic() + 60.0
    while running(flying) and time.monotonic() < end:
        time.sleep(0.1)
    assert not running(flying)
    assert "Interrupted" in demo.output
    assert "Traceback" not in demo.output
