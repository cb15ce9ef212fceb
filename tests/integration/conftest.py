"""Real processes on loopback, ended whatever happens."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

PATIENCE_S = 60.0


class Child:
    """A process of ours with its output in a file."""

    def __init__(self, module: str, arguments: list[str], log: Path) -> None:
        self.log = log
        self._file = log.open("w")
        self.process = subprocess.Popen(
            [sys.executable, "-u", "-m", module, *arguments],
            stdout=self._file,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            text=True,
        )

    @property
    def output(self) -> str:
        """Everything printed so far."""
        return self.log.read_text()

    def wait_for(self, pattern: str) -> re.Match[str]:
        """Wait until the output matches."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            found = re.search(pattern, self.output)
            if found:
                return found
            if self.process.poll() is not None and not re.search(pattern, self.output):
                break
            time.sleep(0.05)
        raise AssertionError(f"{pattern!r} never came; printed:\n{self.output}")

    def end(self, number: int = signal.SIGINT) -> int:
        """Send a signal and wait for the exit code."""
        self.process.send_signal(number)
        return self.process.wait(PATIENCE_S)

    def close(self) -> None:
        """Kill it if it still runs."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self._file.close()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Child]]:
    """Start `python -m MODULE ARGUMENTS`; ended with the test."""
    children: list[Child] = []

    def run(module: str, *arguments: str) -> Child:
        child = Child(module, [str(a) for a in arguments], tmp_path / f"child{len(children)}.log")
        children.append(child)
        return child

    yield run
    for child in children:
        child.close()
