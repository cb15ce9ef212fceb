"""Ctrl-C and SIGTERM in the middle of many flights."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import pytest

from tests.integration.conftest import PATIENCE_S
from tests.support.waiting import until


def workers(pid: int) -> list[int]:
    """Child processes of a process."""
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def running(pids: list[int]) -> list[int]:
    return [pid for pid in pids if Path(f"/proc/{pid}/exe").exists()]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_all_flights(start, number):
    demo = start("sitl_mocks", "demo", "--seeds", "1-20")
    until(lambda: len(workers(demo.process.pid)) >= 2, "a second worker", PATIENCE_S)
    # Let them begin to fly.
    time.sleep(3.0)
    flying = workers(demo.process.pid)
    assert demo.end(number) == 130
    until(lambda: not running(flying), "the end of the workers", PATIENCE_S)
    assert "Interrupted" in demo.output
    assert "Traceback" not in demo.output


@pytest.mark.parametrize("words", [("demo", "--seeds", "1-200"), ("soak", "--hours", "1000")])
def test_sigterm_ends_workers_that_are_still_starting(start, words):
    """The flights would take an hour."""
    process = start("sitl_mocks", *words)
    until(lambda: workers(process.process.pid), "the first worker", PATIENCE_S)
    begun = workers(process.process.pid)
    assert process.end(signal.SIGTERM) == 130
    until(lambda: not running(begun), "the end of the workers", PATIENCE_S)
    assert process.output.strip() in ("", "Interrupted.")
