"""Real processes on loopback, ended whatever happens."""

from __future__ import annotations

import functools
import importlib.util
import platform
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

PATIENCE_S = 180.0
"""On an idle machine a process begins within two seconds, on a busy one it may take more than a minute."""
STALLS_EVERY_S = 20.0
"""Longest time for which a flight that is flown again waits for the end of the next stall."""
AGAIN_S = 300.0
"""Time from its beginning in which a test may begin to fly again. pytest ends it after twice as long."""
STALLED = re.compile(
    r"the program was stopped for(.|\n)* -> (fault|yielded)|-> fault: the control loop is late"
)
"""In a companion's log: the machine stood still for so long that the companion gave the vehicle back."""
MOCK_STALLED = re.compile(r"stopped for (0\.[6-9]|[1-9]\d*\.\d) s; the vehicle flew on without its links")
"""In the log of a mock vehicle: it stood still for so long that its companion may have to give it back, which
happens when no position has come for a second."""
GIVEN_BACK = re.compile("-> (fault|yielded)")


def stalled(companion: str, vehicles: str) -> bool:
    """Whether a stall made a companion give its vehicle back, by its output and that of the mock vehicles."""
    return bool((GIVEN_BACK if MOCK_STALLED.search(vehicles) else STALLED).search(companion))


class StalledError(AssertionError):
    """The flight cannot go on as the test needs it, because the machine stood still."""


def again_after_a_stall(test: Callable[..., None]) -> Callable[..., None]:
    """Let a test fly again, in an empty folder, as often as a stall of the machine prevents its flight.

    Nothing else is tried again. The test says which companions must not stall. After a stall they must end
    without an error.
    """

    @functools.wraps(test)
    def flown(start: Start, tmp_path: Path, **others: Any) -> None:
        give_up_s, number = time.monotonic() + AGAIN_S, 0
        while True:
            folder = tmp_path / str(number)
            folder.mkdir()
            try:
                test(start=start, tmp_path=folder, **others)
            except StalledError:
                start.end_flight()
                start.again = True
                if time.monotonic() > give_up_s:
                    raise
                number += 1
            else:
                return

    return flown


def wait_for_the_end_of_a_stall() -> None:
    """Return right after a stall of the machine, when the next one is farthest away."""
    before_s = begins_s = time.monotonic()
    while before_s - begins_s < STALLS_EVERY_S:
        time.sleep(0.05)
        now_s = time.monotonic()
        if now_s - before_s > 0.5:
            return
        before_s = now_s


class Child:
    """A process of ours with its output in a file."""

    must_not_stall = False
    """Whether a stall that the process reports ends what the test waits for; see `again_after_a_stall`."""

    def __init__(self, module: str, arguments: list[str], log: Path, siblings: list[Child]) -> None:
        self.log = log
        self._siblings = siblings
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

    def check_stall(self) -> None:
        """Raise StalledError if a stall made a companion of the test give its vehicle back that must not.

        The companion reported a stall of its own, or the mock vehicle one of its own. A companion that has
        ended with an error has not stalled.
        """
        everything = "".join(child.output for child in self._siblings)
        for child in self._siblings:
            going = child.process.poll() in (None, 0)
            if child.must_not_stall and going and stalled(child.output, everything):
                raise StalledError(child.output)

    def wait_for(self, pattern: str) -> re.Match[str]:
        """Wait until the output matches."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            found = re.search(pattern, self.output)
            if found:
                return found
            if self.process.poll() is not None and not re.search(pattern, self.output):
                break
            self.check_stall()
            time.sleep(0.05)
        raise AssertionError(f"{pattern!r} never came; printed:\n{self.output}")

    def end(self, number: int = signal.SIGINT) -> int:
        """Send a signal and wait for the exit code."""
        self.process.send_signal(number)
        code = self.process.wait(PATIENCE_S)
        if code == 0:
            self.check_stall()
        return code

    def close(self) -> None:
        """Kill it if it still runs."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self._file.close()


class Start:
    """Starts `python -m MODULE ARGUMENTS`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._children: list[Child] = []
        self.again = False
        """Whether a stall of the machine has prevented an earlier flight of this test."""

    def __call__(self, module: str, *arguments: object) -> Child:
        log = self._folder / f"child{len(self._children)}.log"
        self._children.append(Child(module, list(map(str, arguments)), log, self._children))
        return self._children[-1]

    def end_flight(self) -> None:
        """End the processes that must not stall, and then all others.

        Raises:
            AssertionError: one of those ended with an error.
        """
        flown = [child for child in self._children if child.must_not_stall]
        for child in flown:
            child.must_not_stall = False  # the end of one looks at the others
        for child in flown:
            assert child.end() == 0, child.output
        self.close()

    def close(self) -> None:
        """Kill all that still run."""
        for child in self._children:
            child.close()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Start a process, ended with the test."""
    starts = Start(tmp_path)
    yield starts
    starts.close()


class RootCanal:
    """The process; every connection to `name` is a controller of its own, and all share the air."""

    def __init__(self, log: Path, controller: str | None) -> None:
        if importlib.util.find_spec("rootcanal") is None:
            pytest.skip(f"rootcanal is not installed (there is none for {platform.machine()})")
        from rootcanal.binaries import get_package_binary_resource_path

        ports = [f"-{kind}_port=0" for kind in ("test", "hci", "link", "link_ble")]
        if controller is not None:
            ports.append(f"-configuration=tcp_server {{ tcp_port: 0 configuration {{ {controller} }} }}")
        self._log = log
        self._file = log.open("w")
        try:
            self._process = subprocess.Popen(
                [get_package_binary_resource_path("rootcanal"), *ports],
                stdout=self._file,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
            )
        except OSError as error:
            self._file.close()
            pytest.skip(f"rootcanal cannot be started here: {error}")
        self.name = f"tcp:127.0.0.1:{self._port()}"

    def _port(self) -> int:
        """Its HCI server is the one that it opens after saying so."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            found = re.search(r"Opening an HCI.*?Listening on: (\d+)", self._log.read_text(), re.DOTALL)
            if found:
                return int(found[1])
            if self._process.poll() is not None:
                self.close()
                pytest.skip(f"rootcanal does not run here:\n{self._log.read_text()[-2000:]}")
            time.sleep(0.02)
        self.close()
        raise AssertionError("rootcanal never listened")

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        self._file.close()


@pytest.fixture
def air(tmp_path: Path) -> Iterator[Callable[..., RootCanal]]:
    running: list[RootCanal] = []

    def start(controller: str | None = None) -> RootCanal:
        running.append(RootCanal(tmp_path / f"rootcanal{len(running)}.log", controller))
        return running[-1]

    yield start
    for each in running:
        each.close()
