"""Reads the MAVLink signing key, and stores the signing timestamp on disk from one run to the next."""

from __future__ import annotations

import os
import stat
import threading
import time
from hashlib import sha256
from pathlib import Path

from companion.autopilot.signing import KEY_BYTES, TICKS_PER_S, Signing, timestamp_at
from companion.config import Config
from companion.errors import ConfigError
from companion.runtime import clock
from companion.runtime.record.disk import not_mounted, replace_file

TIMESTAMP_FILE = "signing-timestamp"
"""Name of the file in record.folder that holds the last timestamp used, in decimal digits."""
PERIOD_S = 5.0
"""Time between two writes of the timestamp. A process that is killed loses no more than that, so the next
process starts this much later than the stored timestamp."""
PLAUSIBLE_UTC_S = 4_102_444_800.0
"""No clock is later than this, the beginning of the year 2100. The timestamps end in 2104, and once a vehicle
has taken one near the end, no later frame is newer."""
_LATEST = timestamp_at(PLAUSIBLE_UTC_S)
_PATIENCE_S = 2.0
"""How long the flight waits for the first write of the timestamp before it continues without it."""
_HEX = frozenset("0123456789abcdefABCDEF")
_MOST_BYTES = 1024
_FORMS = f"{KEY_BYTES} raw bytes, {2 * KEY_BYTES} hexadecimal digits, or one line with a passphrase"


def read_key(path: Path) -> bytes:
    """Read the signing key from a file.

    The file holds 32 raw bytes, 64 hexadecimal digits, or a passphrase. The key of a passphrase is its
    SHA-256, as in QGroundControl, Mission Planner and MAVProxy.

    Raises:
        ConfigError: the file cannot be read, is accessible to others than its owner, or holds none of these
            forms. No error text repeats the content of the file.
    """
    data = private_bytes(path, "vehicle.signing_key")
    name = f"vehicle.signing_key: {path}"
    text = data.removesuffix(b"\n").removesuffix(b"\r")
    if not text:
        raise ConfigError(f"{name}: empty; allowed: {_FORMS}")
    # 32 random bytes are practically never all printable: a printable file is text, even if it has 32 bytes.
    printable = all(0x20 <= byte < 0x7F for byte in text)
    if not any(data):
        # So a file may look after a power cut; autopilots take this key for none.
        raise ConfigError(f"{name}: holds only zero bytes; write the key again")
    if not printable and len(data) == KEY_BYTES:
        return data
    if not printable:
        raise ConfigError(f"{name}: {len(data)} bytes that are not one line of ASCII text; allowed: {_FORMS}")
    digits = text.strip(b" ")
    if all(chr(byte) in _HEX for byte in digits) and len(digits) >= KEY_BYTES:
        # With a space they would be a passphrase, and so another key.
        if len(digits) != 2 * KEY_BYTES:
            raise ConfigError(f"{name}: {len(digits)} hexadecimal digits; a key has {2 * KEY_BYTES}")
        return bytes.fromhex(digits.decode())
    return sha256(text).digest()


def private_bytes(path: Path, key: str) -> bytes:
    """Read a file that only its owner may access.

    Args:
        key: key of the configuration that names the file, for errors.

    Raises:
        ConfigError: the file cannot be read, or is accessible to others.
    """
    try:
        # O_NONBLOCK: opening a pipe would wait for a writer.
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise ConfigError(f"{key}: {path}: not a regular file")
            if status.st_mode & 0o077:
                raise ConfigError(
                    f"{key}: {path}: mode {stat.S_IMODE(status.st_mode):04o} gives other users "
                    f"access to it; run chmod 600 {path}"
                )
            data = file.read(_MOST_BYTES + 1)
    except FileNotFoundError as error:
        # The text does not repeat the path: a user may have entered the key itself instead of a path.
        raise ConfigError(
            f"{key}: no such file; it is the path of a key file, relative to the configuration"
        ) from error
    except OSError as error:
        raise ConfigError(f"{key}: {path}: cannot be read: {error.strerror}") from error
    if len(data) > _MOST_BYTES:
        raise ConfigError(f"{key}: {path}: more than {_MOST_BYTES} bytes, which no key has")
    return data


class KeptSigning:
    """Holds `signing` for the link to the vehicle (None without a key) and keeps its timestamp on disk.

    A thread writes the timestamp, from construction to `close`. A disk that does not accept it does not end
    the flight. A later process then starts at its own clock or at the timestamp stored before, whichever is
    later. From the vehicle's first signed frame on it follows the vehicle's timestamp, which is never behind
    any timestamp of ours that the vehicle has accepted.

    Raises:
        ConfigError: `read_key` failed.
    """

    def __init__(self, config: Config) -> None:
        self.signing: Signing | None = None
        self.error: str | None = None
        """Why the latest timestamp is not on disk; None if it is."""
        self.unread: str | None = None
        """Why the timestamp that an earlier process stored is not known; None without trouble."""
        self.wrong_clock: str | None = None
        """What is wrong with this computer's clock, which is then not used; None without trouble."""
        self._stop = threading.Event()
        self._written = threading.Event()
        self._path = Path(config.record.folder) / TIMESTAMP_FILE
        if config.vehicle.signing_key is None:
            return
        key = read_key(Path(config.vehicle.signing_key))
        # The clock may be wrong (a small computer has no battery for it), so the stored timestamp counts,
        # too.
        utc_s, start = time.time(), self._stored()
        if utc_s < PLAUSIBLE_UTC_S:
            start = max(timestamp_at(utc_s), start)
        else:
            self.wrong_clock = (
                "this computer's clock is later than the year 2100; signing starts at the stored time, or at "
                "the vehicle's"
            )
        self.signing = Signing(key, start, clock.now_s())
        self._thread = threading.Thread(target=self._keep, args=(self.signing,), name="signing", daemon=True)
        self._thread.start()
        # Wait for the first write: a process that is killed at once must not leave an older timestamp behind.
        # The wait is bounded, because a disk may hang.
        if not self._written.wait(_PATIENCE_S):
            self.error = f"{self._path}: the disk does not answer"

    def close(self) -> None:
        """Write the timestamp a last time and end the thread."""
        self._stop.set()
        if self.signing is not None:
            self._thread.join(PERIOD_S)

    def _keep(self, signing: Signing) -> None:
        last = False
        while not last:
            self._write(signing)
            self._written.set()
            last = self._stop.wait(PERIOD_S)
        self._write(signing)

    def _write(self, signing: Signing) -> None:
        timestamp = max(signing.timestamp, self._newest_by_others())
        if timestamp >= _LATEST:
            # Adopted from the vehicle. A later process learns it from there, or finds the vehicle corrected.
            self.error = f"{self._path}: the vehicle's signing time is later than the year 2100"
            return
        try:
            self._path.parent.mkdir(exist_ok=True)
            replace_file(self._path, f"{timestamp}\n".encode())
            self.error = None
        except OSError as error:
            self.error = f"{error.filename or self._path}: cannot be written: {error.strerror}"

    def _stored(self) -> int:
        """First timestamp that was certainly not used before; 0 if no stored timestamp is known."""
        try:
            last = self._read()
        except FileNotFoundError:
            absent = not_mounted(self._path.parent)
            self.unread = absent and f"{self._path}: {absent}"
            return 0
        except OSError as error:
            self.unread = f"{self._path}: cannot be read: {error.strerror}"
            return 0
        if last is None:
            self.unread = f"{self._path}: damaged"
            return 0
        return last + _ticks()

    def _newest_by_others(self) -> int:
        """Timestamp in the file, which another process may have written; 0 if there is none."""
        try:
            return self._read() or 0
        except OSError:
            return 0

    def _read(self) -> int | None:
        """Timestamp in the file; None if it is damaged. Raises OSError if it cannot be read."""
        text = self._path.read_bytes()
        last = int(text) if text.strip().isdigit() and len(text) < 20 else _LATEST
        return last if last + _ticks() < _LATEST else None


def _ticks() -> int:
    """The time between two writes, as a timestamp."""
    return int(PERIOD_S * TICKS_PER_S)
