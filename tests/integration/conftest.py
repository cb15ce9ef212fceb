"""Real processes on loopback, ended whatever happens."""

from __future__ import annotations

import importlib.util
import platform
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

PATIENCE_S = 180.0
"""On an idle machine a process begins within two seconds, on a busy one it may take more than a minute."""


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
