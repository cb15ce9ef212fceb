"""A serial port as a link; a pseudo-terminal may take its place.

While we do not read, the kernel keeps 4 kB and a buffer of up to 64 kB: about ten seconds of a full line at
57600 baud, less than one second at 921600 baud. After that, new data is lost.

A pseudo-terminal always reports that nothing waits in it. Its reader's side holds 4 kB that cannot be
recalled; data queued behind that can be flushed.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sys
import termios
import threading

import serial

from companion.errors import ConfigError
from companion.runtime import clock
from companion.runtime.links.byte_link import HELD_S, LinkTrouble
from companion.runtime.links.stream_link import StreamLink

_BITS_PER_BYTE = 10
_OVERDUE_S = 0.1
"""Bytes that still wait this long after they should have left at the baud rate are thrown away."""
_SETTLED_S = 0.02
"""A pseudo-terminal has handed over what was written this long ago, unless its reader does not read."""
_PTY_MAJORS = range(136, 144)
"""Major device numbers of /dev/pts on Linux."""
_NOT_OPENED = {
    errno.ENOENT: "there is no such device; check the cable, or the udev rule that names it",
    errno.EACCES: "this user may not open it; add the user to the device's group (dialout)",
    errno.EAGAIN: "another program has it open; only one program can use a serial port",
    errno.ENOTTY: "this is not a serial port",
}


class SerialLink(StreamLink):
    """A serial port. pyserial sets it up; reads and writes are direct, non-blocking system calls.

    Raises:
        ConfigError: the port cannot be opened.
    """

    def __init__(self, device: str, baud: int, trouble: LinkTrouble, key: str = "vehicle.link") -> None:
        try:
            self._port = serial.Serial(device, baud, timeout=0, exclusive=True)
            self._fd = int(self._port.fileno())
            _answer_emptiness(self._fd)
        except (OSError, termios.error, ValueError) as error:
            # pyserial passes some errors of the kernel through unchanged, for example for a device that is
            # being unplugged. Its own exceptions carry no errno; the kernel's error is then their context.
            numbers = [getattr(error, "errno", None), *getattr(error.__context__, "args", ())]
            words = next((_NOT_OPENED[n] for n in numbers if n in _NOT_OPENED), str(error))
            raise ConfigError(f"{key}: serial:{device}:{baud}: {words}") from error
        self._is_pty = sys.platform == "linux" and os.major(os.fstat(self._fd).st_rdev) in _PTY_MAJORS
        super().__init__(trouble, keeps=self._is_pty)
        self._bytes_per_s = baud / _BITS_PER_BYTE
        self._due_s = float("-inf")
        self._wrote_s = float("-inf")
        os.set_blocking(self._fd, False)

    def fileno(self) -> int:
        """File descriptor for `select`."""
        return self._fd

    def discard(self) -> None:
        """Flush the driver's queue.

        Raises:
            OSError: the device is gone, or its driver neither sends nor flushes (some for USB adapters).
        """
        self._unsent = b""
        self._flush()
        self._due_s = float("-inf")
        oldest = self._oldest_s()
        # A running transfer to a USB adapter is normal, but one that does not end is a fault.
        if oldest is not None and clock.now_s() - oldest > 2.0 * _OVERDUE_S:
            raise OSError("the serial driver neither sends its queued data nor discards it")

    def abort(self) -> None:
        """Throw away what waits, and close the port in a thread: the driver may take half a minute."""
        self._flush()
        threading.Thread(target=self._close_port, name="close serial", daemon=True).start()

    def _release(self) -> None:
        self._flush()
        self._close_port()

    def _close_port(self) -> None:
        # Closing a device that is gone may fail; then there is nothing left to release.
        with contextlib.suppress(OSError):
            self._port.close()

    def _flush(self) -> None:
        # Flushing a device that is gone fails; the next read detects that.
        with contextlib.suppress(OSError, termios.error):
            termios.tcflush(self._fd, termios.TCOFLUSH)

    def _read(self, count: int) -> bytes:
        data = os.read(self._fd, count)
        if not data:
            raise ConnectionError("the serial device is gone")
        return data

    def _write(self, data: bytes) -> int:
        return os.write(self._fd, data)

    def _queued(self) -> int:
        return int(self._port.out_waiting)

    def _takes_more(self, now_s: float) -> bool:
        if self._is_pty:
            # Flush what was not read since the last send. Flushing sooner after it would also take data from
            # a reader that works normally.
            if now_s - self._wrote_s > _SETTLED_S:
                self._flush()
            self._wrote_s = now_s
            return True
        return self._queued() <= self._bytes_per_s * HELD_S

    def _counts_from(self, count: int, now_s: float) -> float:
        """Time by which the line should have carried the bytes at its baud rate; their age counts from it."""
        self._due_s = max(self._due_s, now_s) + count / self._bytes_per_s
        return self._due_s

    def _late_after_s(self) -> float:
        return _OVERDUE_S


def _answer_emptiness(fd: int) -> None:
    """Let a read that finds no data fail with EAGAIN, so that an empty read means that the device is gone."""
    attributes = termios.tcgetattr(fd)
    attributes[6][termios.VMIN], attributes[6][termios.VTIME] = 1, 0
    termios.tcsetattr(fd, termios.TCSANOW, attributes)
