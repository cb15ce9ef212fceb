"""Notifications to the service manager in the protocol of sd_notify(3), without its library.

Each notification is a datagram of KEY=value lines to the socket that NOTIFY_SOCKET names. Nothing here blocks
or raises: a flight does not depend on the program that started it.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Mapping

_PING_S = 1.0


def notify_address(environ: Mapping[str, str]) -> str | None:
    """Address of the service manager's socket; None if there is none.

    In NOTIFY_SOCKET, "@" stands for the zero byte at the start of an abstract socket's address.
    """
    name = environ.get("NOTIFY_SOCKET", "")
    if name.startswith("/"):
        return name
    return f"\0{name[1:]}" if name.startswith("@") and len(name) > 1 else None


def ping_period_s(environ: Mapping[str, str], pid: int) -> float | None:
    """Period of the pings to systemd's watchdog, in seconds; None if the watchdog is off or is meant for
    another process.

    The period is half the watchdog's limit (sd_watchdog_enabled(3)), but at most one second. A stall may then
    last nearly the whole limit before it counts as a hang, at whatever point between two pings it begins.
    """
    limit_us, whose = environ.get("WATCHDOG_USEC", ""), environ.get("WATCHDOG_PID", str(pid))
    if not (limit_us.isascii() and limit_us.isdigit() and int(limit_us) > 0) or whose != str(pid):
        return None
    return min(int(limit_us) / 2e6, _PING_S)


class Notifier:
    """Notifies the service manager. Only the flight loop may call it: a thread would keep pinging although
    the loop hangs."""

    def __init__(self, environ: Mapping[str, str]) -> None:
        self._address = notify_address(environ)
        self._period_s = ping_period_s(environ, os.getpid())
        self._pinged_s: float | None = None
        self._socket = None
        if self._address is not None:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)

    def ready(self) -> None:
        """Report that start-up is complete; from now on systemd's watchdog is active."""
        self._tell("READY=1")

    def status(self, line: str) -> None:
        """Report the line that `systemctl status` shows."""
        self._tell("STATUS=" + "".join(c if c.isprintable() else "?" for c in line))

    def ping(self, now_s: float) -> None:
        """Report that the loop is running. To be called in every tick; sent only once per ping period."""
        if self._period_s is None or (self._pinged_s is not None and now_s - self._pinged_s < self._period_s):
            return
        self._pinged_s = now_s
        self._tell("WATCHDOG=1")

    def stopping(self) -> None:
        """Report an orderly stop; systemd's watchdog is no longer active."""
        self._tell("STOPPING=1")

    def close(self) -> None:
        """Release the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _tell(self, text: str) -> None:
        if self._socket is not None and self._address is not None:
            # A service manager that is gone or whose queue is full must not delay a setpoint; the next ping
            # may arrive.
            with contextlib.suppress(OSError):
                self._socket.sendto(text.encode(), self._address)
