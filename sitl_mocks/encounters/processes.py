"""The processes of a real-time run: our own commands, started, read and ended in order."""

from __future__ import annotations

import ctypes
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from companion.errors import ConfigError
from sitl_mocks.examinations.swarm.examination import Examination

_END_S = 15.0
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None)


@dataclass(slots=True)
class Process:
    """One child process and its output."""

    name: str
    child: subprocess.Popen[str]
    log: Path
    lines: list[str] = field(default_factory=list)

    def expect(self, pattern: str) -> str:
        """Read until a line matches, and return its first group.

        Raises:
            ConfigError: the process ended before a line matched.
        """
        assert self.child.stdout is not None
        for line in self.child.stdout:
            self.lines.append(line.rstrip())
            found = re.search(pattern, line)
            if found:
                return found.group(1) if found.groups() else found.group(0)
        self.child.wait()
        raise ConfigError(f"{self.name} ended with exit code {self.child.returncode}; see {self.log}")

    def last_json(self) -> dict[str, object]:
        """The JSON object on the last line; empty if there is none."""
        assert self.child.stdout is not None
        self.lines += [line.rstrip() for line in self.child.stdout]
        try:
            value = json.loads(self.lines[-1])
        except (IndexError, ValueError):
            return {}
        return value if isinstance(value, dict) else {}


class Swarm:
    """The processes of one run, and the examinations between them. `close` ends those that still run."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.processes: list[Process] = []
        self.examinations: list[Examination] = []
        self._logs: list[IO[str]] = []

    def start(self, name: str, *arguments: str, piped: bool, told: bool = False) -> Process:
        """Start one of our commands. Its errors (and its output, unless piped) go to NAME.log.

        Args:
            piped: whether we read its output.
            told: whether we write to its input.
        """
        path = self.folder / f"{name}.log"
        log = path.open("w")
        self._logs.append(log)
        child = subprocess.Popen(
            [sys.executable, "-m", *arguments],
            stdout=subprocess.PIPE if piped else log,
            stderr=log,
            stdin=subprocess.PIPE if told else subprocess.DEVNULL,
            text=True,
            # Ctrl-C must reach only this process, which then ends the children in order, companions first.
            start_new_session=True,
            preexec_fn=_end_with_parent,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        process = Process(name, child, path)
        self.processes.append(process)
        return process

    def end(self, processes: list[Process]) -> list[str]:
        """Ask processes to end and wait for them. Returns those that ended with an error, with exit codes."""
        for process in processes:
            if process.child.poll() is None:
                process.child.send_signal(signal.SIGINT)
        bad = []
        deadline = time.monotonic() + _END_S
        for process in processes:
            try:
                code = process.child.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.child.kill()
                code = process.child.wait()
            if code != 0:
                bad.append(f"{process.name} (exit code {code})")
        return bad

    def close(self) -> None:
        """End the examinations, kill the remaining processes and close the logs."""
        for examination in self.examinations:
            examination.close()
        for process in self.processes:
            if process.child.poll() is None:
                process.child.kill()
                process.child.wait()
            for pipe in (process.child.stdin, process.child.stdout):
                if pipe is not None:
                    pipe.close()
        for log in self._logs:
            log.close()


def _end_with_parent() -> None:
    """Let the kernel kill this process when its parent ends.

    A run that is killed cannot end its processes, and one that is left keeps a port or a serial line from the
    next run.
    """
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
