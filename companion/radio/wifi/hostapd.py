"""Client of hostapd's control socket: a vendor element in the beacons of a running access point.

The socket takes one command per datagram and answers each in order with one datagram (hostapd's ctrl_iface):
`SET vendor_elements HEX`, then `UPDATE_BEACON`, both answered by OK. `STATUS` returns state, BSSID and
channel. The element replaces the `vendor_elements` of hostapd's own configuration.

hostapd repeats the beacon by itself, so an element stays on the air until it is replaced. We therefore remove
the element when no new one comes for `_STALE_AFTER_S`, and on `close`. A killed process cannot do that. Its
last element is repeated until hostapd restarts, a new companion broadcasts, or a user runs
`hostapd_cli set vendor_elements ""; hostapd_cli update_beacon`.
"""

from __future__ import annotations

import re
import shutil
import socket
import tempfile
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from companion.errors import ConfigError

_SET: Final = "SET vendor_elements "
_UPDATE: Final = "UPDATE_BEACON"
_OPEN_TIMEOUT_S: Final = 2.0
_ANSWER_TIMEOUT_S: Final = 2.0
_CLOSE_TIMEOUT_S: Final = 0.5
_POLL_S: Final = 1.0
_STALE_AFTER_S: Final = 1.5
"""An element in use is renewed once a second at least. Its Location is not to be on the air for longer."""
_MAX_ANSWER: Final = 1 << 14
_BSSID: Final = re.compile("(?!00:00:00:00:00:00)[0-9a-f]{2}(?::[0-9a-f]{2}){5}")
MAX_ELEMENT: Final = 2 + 255
"""Size in bytes of one element including its header (IEEE 802.11 section 9.4.2.1)."""


@dataclass(frozen=True, slots=True)
class ApStatus:
    """State of one access point, as reported by hostapd."""

    state: str
    """ENABLED while it sends beacons."""
    bssid: str | None = None
    """Lower-case hex with colons; None if hostapd does not report it."""
    channel: int | None = None
    beacon_interval_tu: int | None = None
    """Time between beacons in units of 1024 us."""


def parse_status(text: str, interface: str) -> ApStatus:
    """Parse the answer to STATUS, one `key=value` per line. Missing or unreadable values become None."""
    values = dict(line.split("=", 1) for line in text.splitlines() if "=" in line)
    index = next(
        (key[4:-1] for key, name in values.items() if key.startswith("bss[") and name == interface), "0"
    )
    bssid = values.get(f"bssid[{index}]", "").lower()
    return ApStatus(
        state=values.get("state", "unknown"),
        bssid=bssid if _BSSID.fullmatch(bssid) else None,
        channel=_positive(values.get("channel", "")),
        beacon_interval_tu=_positive(values.get("beacon_int", "")),
    )


class HostapdControl:
    """One access point of a running hostapd.

    Args:
        path: Control socket of the access point's interface (config key radio.hostapd).

    Raises:
        ConfigError: hostapd does not answer there. The text says what to do.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self.updates = 0
        """Number of times that hostapd changed its beacon on our command."""
        self.failures = 0
        """Number of commands that it refused or did not answer, or that could not be sent."""
        self._silence: str | None = None
        """Why hostapd does not answer or send beacons; None while it does."""
        self._doubt: str | None = None
        """Why its beacon may not hold the last element; None if hostapd accepted that element."""
        self._pending: deque[tuple[str, float]] = deque()
        self._set_ok = False
        self._element = b""
        self._element_s = 0.0
        self._touched = False
        """True once an element was set."""
        self._polled_s: float | None = None
        self._number = 0
        try:
            self._folder = Path(tempfile.mkdtemp(prefix="companion-hostapd-"))
        except OSError as error:
            raise ConfigError(
                f"radio.hostapd: cannot make a folder for its socket: {error.strerror}"
            ) from error
        try:
            self._socket = self._bind()
            try:
                self.status = self._greet()
            except ConfigError:
                self._socket.close()
                raise
        except ConfigError:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise
        self._judge_state()

    @property
    def trouble(self) -> str | None:
        """Why our element is not on the air, in words; None if no problem is known."""
        return self._silence or self._doubt

    def set_element(self, element: bytes, now_s: float) -> None:
        """Replace the element in the beacon. An empty element removes it.

        Raises:
            ValueError: the element is too long.
        """
        if len(element) > MAX_ELEMENT:
            raise ValueError(f"element of {len(element)} bytes; allowed: up to {MAX_ELEMENT}")
        self._element, self._element_s = element, now_s
        self._touched = self._touched or bool(element)
        if self._command(_SET + element.hex(), now_s):
            self._command(_UPDATE, now_s)

    def poll(self, now_s: float) -> None:
        """Read hostapd's answers, ask for its status once a second, and remove a stale element."""
        self._collect()
        if self._pending and now_s - self._pending[0][1] > _ANSWER_TIMEOUT_S:
            self._lose(f"no answer to {_word(self._pending[0][0])} for {_ANSWER_TIMEOUT_S:g} s")
        if self._element and self._doubt is None and now_s - self._element_s > _STALE_AFTER_S:
            self.set_element(b"", now_s)
        if self._polled_s is not None and now_s - self._polled_s < _POLL_S:
            return
        self._polled_s = now_s
        self._command("STATUS", now_s)
        if self._doubt is not None and self._silence is None:
            # No broadcast comes while we report trouble. Test with an empty element, which is never stale.
            self.set_element(b"", now_s)

    def close(self) -> None:
        """Remove the element from the air and release the socket."""
        self._socket.settimeout(_CLOSE_TIMEOUT_S)
        if self._touched:
            self.set_element(b"", 0.0)
        self._socket.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _greet(self) -> ApStatus:
        """Send PING and STATUS, and wait for the answers."""
        name = f"radio.hostapd: {self.path!r}"
        self._socket.settimeout(_OPEN_TIMEOUT_S)
        try:
            pong = self._exchange("PING")
            if pong.strip() != "PONG":
                raise ConfigError(f"{name}: answers {pong[:40]!r} to PING; check that it is hostapd's socket")
            status = parse_status(self._exchange("STATUS"), Path(self.path).name)
        except TimeoutError as error:
            raise ConfigError(f"{name}: no answer for {_OPEN_TIMEOUT_S:g} s: hostapd hangs") from error
        except (OSError, ValueError) as error:
            raise ConfigError(f"{name}: {_explain(error)}") from error
        self._socket.setblocking(False)
        return status

    def _exchange(self, command: str) -> str:
        self._socket.sendto(command.encode(), self.path)
        return self._socket.recv(_MAX_ANSWER).decode(errors="replace")

    def _command(self, command: str, now_s: float) -> bool:
        """Send a command whose answer is read later. Return False if sending failed."""
        try:
            self._socket.sendto(command.encode(), self.path)
        except OSError as error:
            self._lose(_explain(error))
            return False
        self._pending.append((command, now_s))
        return True

    def _collect(self) -> None:
        while True:
            try:
                answer = self._socket.recv(_MAX_ANSWER).decode(errors="replace").strip()
            except OSError:
                return  # no answer yet; a lost hostapd shows at the next command
            if answer.startswith("<") or not self._pending:
                continue  # an event, or an answer to no pending command
            self._take(self._pending.popleft()[0], answer)

    def _take(self, command: str, answer: str) -> None:
        if command == "STATUS":
            self.status = parse_status(answer, Path(self.path).name)
            self._judge_state()
        elif answer != "OK":
            self.failures += 1
            self._set_ok = False
            self._doubt = f"hostapd answered {answer[:40]!r} to {_word(command)}"
        elif command != _UPDATE:
            self._set_ok = True
        elif self._set_ok:
            self._doubt = None
            self.updates += 1

    def _judge_state(self) -> None:
        state = self.status.state
        self._silence = None if state == "ENABLED" else f"hostapd sends no beacons: its state is {state}"

    def _lose(self, why: str) -> None:
        """Handle a hostapd that is gone or hangs.

        Forgets pending answers and changes to a new socket, so that a late answer is not taken for another
        command's.
        """
        if self._silence is None:
            self.failures += 1
        self._silence = f"hostapd: {why}"
        if self._touched:
            self._doubt = "hostapd is back; its beacon is being cleared"
        self._set_ok = False
        self._pending.clear()
        try:
            fresh = self._bind()
        except ConfigError:
            return
        self._socket.close()
        self._socket = fresh
        self._socket.setblocking(False)

    def _bind(self) -> socket.socket:
        """Bind a socket to a path of its own. hostapd cannot answer a socket without one."""
        self._number += 1
        path = self._folder / str(self._number)
        fresh = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            fresh.bind(str(path))
        except OSError as error:
            fresh.close()
            raise ConfigError(f"radio.hostapd: cannot make a socket at {path}: {_explain(error)}") from error
        (self._folder / str(self._number - 1)).unlink(missing_ok=True)
        return fresh


def _word(command: str) -> str:
    return " ".join(command.split()[:2]) if command.startswith(_SET) else command


def _positive(text: str) -> int | None:
    return int(text) or None if re.fullmatch("[0-9]{1,6}", text) else None


def _explain(error: Exception) -> str:
    """Describe a socket error in words that say what to do."""
    match error:
        case FileNotFoundError():
            return "no such socket; check that hostapd runs with ctrl_interface=FOLDER in its configuration"
        case ConnectionRefusedError():
            return "no program listens there; give the socket of the interface of a running hostapd"
        case PermissionError():
            return "no permission; run as root or in the group that hostapd's ctrl_interface_group names"
        case BlockingIOError():
            return "accepts no commands because it hangs"
        case OSError():
            return error.strerror or str(error)
        case _:
            return str(error)
