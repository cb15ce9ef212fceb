"""The signing key's file, and the timestamp of signing kept on disk from one run to the next."""

from __future__ import annotations

import contextlib
import os
import stat
import threading
import time
from hashlib import sha256
from pathlib import Path

from companion.autopilot.signing import KEY_BYTES, TICKS_PER_S, Signing, timestamp_at
from companion.config import Config
from companion.errors import ConfigError

TIMESTAMP_FILE = "signing-timestamp"
"""In record.folder: the last timestamp used, in decimal digits."""
PERIOD_S = 5.0
"""Between two writes of it. A process that is killed loses no more: the next one begins this much later."""
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

    Raises:
        ConfigError: as `read_key`, or record.folder cannot be written.
    """

    def __init__(self, config: Config) -> None:
        self.signing: Signing | None = None
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._path = Path(config.record.folder) / TIMESTAMP_FILE
        if config.vehicle.signing_key is None:
            return
        key = read_key(Path(config.vehicle.signing_key))
        # The clock may be wrong (a small computer has no battery for it): what was used before counts, too.
        start = max(timestamp_at(time.time()), self._stored())
        self.signing = Signing(key, start, time.monotonic())
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._write(self.signing)
        except OSError as error:
            raise ConfigError(f"record.folder: {self._path}: cannot be written: {error.strerror}") from error

    def start(self) -> None:
        """Keep the timestamp on disk from now on, in a thread: a card can take its time."""
        if self.signing is not None:
            self._thread = threading.Thread(
                target=self._keep, args=(self.signing,), name="signing", daemon=True
            )
            self._thread.start()

    def close(self) -> None:
        """Write it once more."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(PERIOD_S)
        elif self.signing is not None:
            self._try_write(self.signing)

    def _keep(self, signing: Signing) -> None:
        while not self._stop.wait(PERIOD_S):
            self._try_write(signing)
        self._try_write(signing)

    def _try_write(self, signing: Signing) -> None:
        # A full disk is told by the recorder; flying on needs no file.
        with contextlib.suppress(OSError):
            self._write(signing)

    def _write(self, signing: Signing) -> None:
        new = self._path.with_suffix(".new")
        with new.open("w") as file:
            file.write(f"{signing.timestamp}\n")
            file.flush()
            os.fsync(file.fileno())
        new.replace(self._path)

    def _stored(self) -> int:
        """The first timestamp that was not used before."""
        try:
            text = self._path.read_text("ascii")
        except (OSError, UnicodeDecodeError):
            return 0
        return int(text) + int(PERIOD_S * TICKS_PER_S) if text.strip().isdigit() and len(text) < 20 else 0
