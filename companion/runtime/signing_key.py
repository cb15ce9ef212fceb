"""The signing key's file, and the timestamp of signing kept on disk from one run to the next."""

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
from companion.runtime.record.disk import replace_file

TIMESTAMP_FILE = "signing-timestamp"
"""In record.folder: the last timestamp used, in decimal digits."""
PERIOD_S = 5.0
"""Between two writes of it. A process that is killed loses no more: the next one begins this much later."""
_PATIENCE_S = 2.0
"""What the first write of it may take before the flight goes on without it."""
_HEX = frozenset("0123456789abcdefABCDEF")
_MOST_BYTES = 1024
_FORMS = f"{KEY_BYTES} raw bytes, {2 * KEY_BYTES} hexadecimal digits, or one line with a passphrase"


def read_key(path: Path) -> bytes:
    """The key in a file: 32 raw bytes, 64 hexadecimal digits, or a passphrase, whose SHA-256 is the key, as
    it is for QGroundControl, Mission Planner and MAVProxy.

    Raises:
        ConfigError: the file cannot be read, may be read by others than its owner, or holds none of these. No
            text repeats what it holds.
    """
    data = _private_bytes(path)
    name = f"vehicle.signing_key: {path}"
    text = data.removesuffix(b"\n").removesuffix(b"\r")
    if not text:
        raise ConfigError(f"{name}: empty; allowed: {_FORMS}")
    # Random bytes that are all printable do not occur: such a file is text, whatever its length.
    printable = all(0x20 <= byte < 0x7F for byte in text)
    if not printable and len(data) == KEY_BYTES:
        return data
    if not printable:
        raise ConfigError(f"{name}: {len(data)} bytes that are not one line of ASCII; allowed: {_FORMS}")
    if all(chr(byte) in _HEX for byte in text) and len(text) >= KEY_BYTES:
        if len(text) != 2 * KEY_BYTES:
            raise ConfigError(f"{name}: {len(text)} hexadecimal digits; a key has {2 * KEY_BYTES}")
        return bytes.fromhex(text.decode())
    return sha256(text).digest()


def _private_bytes(path: Path) -> bytes:
    try:
        # Without waiting: opening a pipe would.
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise ConfigError(f"vehicle.signing_key: {path}: not a file")
            if status.st_mode & 0o077:
                raise ConfigError(
                    f"vehicle.signing_key: {path}: mode {stat.S_IMODE(status.st_mode):04o} lets others than "
                    f"its owner at the key: chmod 600 {path}"
                )
            return file.read(_MOST_BYTES)
    except FileNotFoundError as error:
        # The name is not repeated: somebody may have put the key itself in its place.
        raise ConfigError(
            "vehicle.signing_key: no such file; it is the path of a key file, relative to the configuration"
        ) from error
    except OSError as error:
        raise ConfigError(f"vehicle.signing_key: {path}: cannot be read: {error.strerror}") from error


class KeptSigning:
    """`signing` for the link to the vehicle, None without a key. Its timestamp outlives the process.

    It is written by a thread, from now to `close`. A disk that does not take it ends nothing: a later process
    then begins at its clock or at what was stored before, whichever is later, and follows the vehicle's
    timestamp, which is not behind any of ours that the vehicle has taken, from its first signed frame on.

    Raises:
        ConfigError: as `read_key`.
    """

    def __init__(self, config: Config) -> None:
        self.signing: Signing | None = None
        self.error: str | None = None
        """Why the latest timestamp is not on disk."""
        self.unread: str | None = None
        """Why the one that was stored before is not known."""
        self._stop = threading.Event()
        self._written = threading.Event()
        self._path = Path(config.record.folder) / TIMESTAMP_FILE
        if config.vehicle.signing_key is None:
            return
        key = read_key(Path(config.vehicle.signing_key))
        # The clock may be wrong (a small computer has no battery for it): what was used before counts, too.
        start = max(timestamp_at(time.time()), self._stored())
        self.signing = Signing(key, start, clock.now_s())
        self._thread = threading.Thread(target=self._keep, args=(self.signing,), name="signing", daemon=True)
        self._thread.start()
        # A process that is killed at once must not leave an older one behind. A disk that hangs is not waited
        # for.
        if not self._written.wait(_PATIENCE_S):
            self.error = f"{self._path}: the disk does not answer"

    def close(self) -> None:
        """Write it once more."""
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
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            replace_file(self._path, f"{signing.timestamp}\n".encode())
            self.error = None
        except OSError as error:
            self.error = f"{error.filename or self._path}: cannot be written: {error.strerror}"

    def _stored(self) -> int:
        """The first timestamp that was not used before; 0 where none is known."""
        try:
            text = self._path.read_text("ascii")
        except FileNotFoundError:
            return 0
        except OSError as error:
            self.unread = f"{self._path}: cannot be read: {error.strerror}"
            return 0
        except UnicodeDecodeError:
            text = ""
        if not text.strip().isdigit() or len(text) >= 20:
            self.unread = f"{self._path}: damaged"
            return 0
        return int(text) + int(PERIOD_S * TICKS_PER_S)
