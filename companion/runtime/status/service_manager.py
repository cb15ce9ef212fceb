"""What the service manager is told: sd_notify(3), whole.

A datagram of KEY=value lines to the socket that NOTIFY_SOCKET names. Nothing here waits and nothing fails: a
flight does not depend on who started it.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Mapping

_PING_S = 1.0


def notify_address(environ: Mapping[str, str]) -> str | None:
    """Address of the service manager's socket, "@" standing for the zero byte of an abstract one; None where
    nobody is to be told."""
    name = environ.get("NOTIFY_SOCKET", "")
    if name.startswith("/"):
        return name
    return f"\0{name[1:]}" if name.startswith("@") and len(name) > 1 else None


def ping_period_s(environ: Mapping[str, str], pid: int) -> float | None:
    """How often the watchdog is to hear of us; None where there is none, or it is meant for another process.

    At least twice within its limit (sd_watchdog_enabled(3)), and once a second: a stall then has nearly the
    whole limit before it is taken for a hang, wherever between two pings it begins.
    """
    limit_us, whose = environ.get("WATCHDOG_USEC", ""), environ.get("WATCHDOG_PID", str(pid))
    if not (limit_us.isascii() and limit_us.isdigit() and int(limit_us) > 0) or whose != str(pid):
        return None
    return min(int(limit_us) / 2e6, _PING_S)


class Notifier:
    """The service manager, as this process sees it. To be called by the loop alone: a thread would go on
    pinging for a loop that hangs."""

    def __init__(self, environ: Mapping[str, str]) -> None:
        self._address = notify_address(environ)
        self._period_s = ping_period_s(environ, os.getpid())
        self._pinged_s: float | None = None
        self._socket = None
        if self._address is not None:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)

    def ready(self) -> None:
        """Started up; from now on the watchdog counts."""
        self._tell("READY=1")

    def status(self, line: str) -> None:
        """What `systemctl status` shows."""
        self._tell("STATUS=" + "".join(c if c.isprintable() else "?" for c in line))

    def ping(self, now_s: float) -> None:
        """The loop goes round; passed on as often as the watchdog wants it."""
        if self._period_s is None or (self._pinged_s is not None and now_s - self._pinged_s < self._period_s):
            return
        self._pinged_s = now_s
        self._tell("WATCHDOG=1")

    def stopping(self) -> None:
        """Ending in order; the watchdog does not count any more."""
        self._tell("STOPPING=1")

    def close(self) -> None:
        """Release the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _tell(self, text: str) -> None:
        if self._socket is not None and self._address is not None:
            # A manager that is gone or full must not hold up a setpoint; the next ping may arrive.
            with contextlib.suppress(OSError):
                self._socket.sendto(text.encode(), self._address)
