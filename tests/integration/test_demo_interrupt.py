"""Ctrl-C in the middle of many flights."""

from __future__ import annotations

import time
from pathlib import Path


def workers(pid: int) -> int:
    """Child processes of a process."""
    return len(Path(f"/proc/{pid}/task/{pid}/children").read_text().split())


def test_ctrl_c_ends_all_flights(start):
    demo = start("sitl_mocks.cli", "demo", "--seeds", "1-20")
    end = time.monotonic() + 60.0
    while workers(demo.process.pid) < 2 and time.monotonic() < end:
        time.sleep(0.1)
    # Let them begin to fly.
    time.sleep(3.0)
    assert demo.end() == 130
    assert "Interrupted" in demo.output
    assert "Traceback" not in demo.output
