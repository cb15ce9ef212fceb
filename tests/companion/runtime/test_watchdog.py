"""The watchdog, on processes of its own: what hangs ends, what was only stopped goes on."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time

import pytest

PROGRAM = """
import sys, time
from companion.runtime.watchdog import Watchdog
watchdog = Watchdog(wake_ups=100, period_s=0.01)
watchdog.start()
def hangs():
    print("hangs", flush=True)
    while True:
        time.sleep(0.01)
def reports():
    print("goes round", flush=True)
    for line in sys.stdin:
        watchdog.report()
    watchdog.stop()
    time.sleep(1.5)
    print("ended in order", flush=True)
"""


@pytest.fixture
def start():
    running = []

    def run(what, **streams):
        program = f"{PROGRAM}\n{what}()\n"
        streams = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **streams}
        running.append(subprocess.Popen([sys.executable, "-c", program], text=True, **streams))
        assert running[-1].stdout.readline()
        return running[-1]

    yield run
    for process in running:
        process.kill()
        process.communicate()


def test_a_loop_that_hangs_ends_the_process_with_a_traceback_of_all_threads(start):
    process = start("hangs")
    _, errors = process.communicate(timeout=60.0)
    assert process.returncode == 1
    assert errors.startswith("watchdog: the loop has hung for 1 s; the process ends\n")
    assert "in hangs" in errors
    assert "in _watch" in errors


def test_a_process_that_was_stopped_for_longer_goes_on(start):
    """And one whose watchdog was told to stop is not ended by it."""
    process = start("reports")
    process.stdin.write("\n")
    process.stdin.flush()
    time.sleep(0.2)  # by now it has reported
    process.send_signal(signal.SIGSTOP)
    time.sleep(1.5)  # longer than a hang may last
    process.send_signal(signal.SIGCONT)
    time.sleep(0.2)  # a watchdog that counted the stop would end it now
    output, errors = process.communicate("\n", timeout=60.0)
    assert (process.returncode, errors) == (0, "")
    assert output == "ended in order\n"


def test_a_terminal_that_takes_no_traceback_does_not_keep_a_hung_process_alive(start):
    end, stopped = os.pipe()
    os.set_blocking(stopped, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(stopped, 65536 * b"x")
    os.set_blocking(stopped, True)
    process = start("hangs", stderr=stopped)
    assert process.wait(60.0) == -signal.SIGALRM
    os.close(end)
    os.close(stopped)
