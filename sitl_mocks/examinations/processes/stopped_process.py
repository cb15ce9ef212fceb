"""A companion's process that can be stopped and resumed, and how long it has waited for a processor."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections import deque
from pathlib import Path
from typing import Final

_WAITED_EVERY_S = 0.25
_AROUND_S: Final = (1.5, 0.25)


class StoppedProcess:
    """The leader of a process group. There is no process as long as `child` is None."""

    def __init__(self) -> None:
        self.child: subprocess.Popen[str] | None = None
        self._waited: deque[tuple[float, float]] = deque()
        """Times, and how long the process's threads had waited for a processor until then."""

    def stop(self) -> bool:
        """Stop the process group. Returns whether there is one."""
        return self._send(signal.SIGSTOP)

    def resume(self) -> None:
        """Resume the process group."""
        self._send(signal.SIGCONT)

    @property
    def still_runs(self) -> bool:
        """Whether the process has neither ended nor stopped yet."""
        return self.child is not None and self.child.poll() is None and state_of(self.child.pid) not in "Tt"

    def _send(self, number: signal.Signals) -> bool:
        if self.child is None or self.child.poll() is not None:
            return False
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.child.pid, number)
        return True

    def note_waiting(self, now_s: float) -> None:
        """Record how long the threads have waited for a processor so far."""
        if self.child is None or (self._waited and now_s - self._waited[-1][0] < _WAITED_EVERY_S):
            return
        waited_ns = 0
        with contextlib.suppress(OSError):
            for task in Path(f"/proc/{self.child.pid}/task").iterdir():
                with contextlib.suppress(OSError, ValueError, IndexError):
                    waited_ns += int((task / "schedstat").read_text().split()[1])
        self._waited.append((now_s, 1e-9 * waited_ns))

    def waited_s(self, at_s: float) -> float:
        """Time that the threads waited for a processor around a moment. If it is long, the load of the
        machine caused what happened then.
        """
        before, after = _AROUND_S
        around = [waited for t, waited in self._waited if at_s - before <= t <= at_s + after]
        return round(max(around) - min(around), 3) if around else 0.0


def state_of(pid: int) -> str:
    """State of a process as the kernel reports it; "T" is stopped."""
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
