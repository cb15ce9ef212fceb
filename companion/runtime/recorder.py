"""The run folder: configuration, manifest, tlog and event record, written beside the flight.

Writing happens in a thread of its own, because a memory card can stall a writer for seconds and a setpoint
cannot wait. What the thread cannot take is dropped and counted, and the count stands in the summary. The same
thread looks after the room on the disk.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import platform
import queue
import threading
import time
from importlib import metadata
from pathlib import Path
from typing import BinaryIO

import msgspec

from companion import __version__, record
from companion.config import RecordConfig
from companion.errors import ConfigError
from companion.runtime.disk import MANIFEST, DiskFloor, lock

_QUEUE = 20_000
_LOOK_S = 5.0
"""How often the free space is looked at: a flight writes some 0.2 MB in this time."""
_CLOSE_S = 5.0
"""How long the end of a flight waits for a slow disk."""
_VERSIONED = ("numpy", "numba", "pymavlink", "msgspec", "pymap3d")


def create_run_folder(root: Path, name: str, utc_s: float, key: str = "record.folder") -> Path:
    """Make `<root>/<utc>-<name>/`; a number is added when it is there already.

    Args:
        key: what named the root, for messages.

    Raises:
        ConfigError: the folder cannot be made.
    """
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime(utc_s))
    for number in range(1, 1000):
        folder = root / (f"{stamp}-{name}" if number == 1 else f"{stamp}-{name}-{number}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            raise ConfigError(f"{key}: {root}: cannot be written: {error.strerror}") from error
        return folder
    raise ConfigError(f"{key}: {root}: a thousand runs of the name {stamp}-{name} are there already")


def write_manifest(folder: Path, what: str, **facts: object) -> None:
    """Write `manifest.json`: what ran, on what, with which versions."""
    manifest = {
        "what": what,
        "dmuca": __version__,
        "git_commit": _git_commit(),
        "python": platform.python_version(),
        "machine": platform.machine(),
        "versions": {name: metadata.version(name) for name in _VERSIONED},
        **facts,
    }
    (folder / MANIFEST).write_text(json.dumps(manifest, indent=2) + "\n")


def _git_commit() -> str | None:
    """Commit of the checkout that the package lies in; None when it is installed."""
    git = Path(__file__).resolve().parents[2] / ".git"
    try:
        head = (git / "HEAD").read_text().strip()
        if not head.startswith("ref: "):
            return head
        ref = git / head[5:]
        if ref.exists():
            return ref.read_text().strip()
        packed = (git / "packed-refs").read_text().splitlines()
    except OSError:
        return None
    return next((line.split()[0] for line in packed if line.endswith(head[5:])), None)


class EventFile:
    """`<aircraft>.events`, written in the calling thread; for simulation."""

    def __init__(self, path: Path, header: record.Header) -> None:
        self._file = path.open("wb")
        self._file.write(record.MAGIC + record.encode(header))

    def step(self, step: record.Step) -> None:
        """Append one step."""
        self._file.write(record.encode(step))

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


class FlightRecorder:
    """Tlog and event record of one aircraft, written by a thread and synced every `config.sync_period_s`.

    Raises:
        OSError: the files cannot be written from the start.
    """

    def __init__(self, folder: Path, header: record.Header, config: RecordConfig) -> None:
        self._sync_period_s = config.sync_period_s
        self.floor = DiskFloor(config, folder)
        self._events = (folder / f"{header.aircraft}.events").open("wb")
        with contextlib.suppress(OSError):
            lock(self._events)
        self._tlog = (folder / f"{header.aircraft}.tlog").open("wb")
        self._events.write(record.MAGIC + record.encode(header))
        self._events.flush()
        self._queue: queue.Queue[tuple[BinaryIO, bytes] | None] = queue.Queue(_QUEUE)
        self._error: str | None = None
        self._overflowed = 0
        self._unwritten = 0
        self._thread = threading.Thread(target=self._write, name="recorder", daemon=True)
        self._thread.start()

    def step(self, step: record.Step) -> None:
        """Append one step of the heart."""
        self._put(self._events, record.encode(step))

    def write(self, data: bytes) -> int:
        """Append bytes to the tlog: the recorder is the stream of a `TlogWriter`."""
        self._put(self._tlog, data)
        return len(data)

    @property
    def dropped(self) -> int:
        """Records that are not in the files."""
        return self._overflowed + self._unwritten

    @property
    def error(self) -> str | None:
        """Why writing stopped; None while it goes on."""
        return self._error

    def close(self, timeout_s: float = _CLOSE_S) -> bool:
        """Write out what waits, sync, close. What fails is kept in `error`.

        Returns:
            Whether the disk answered; after `timeout_s` it is left alone.
        """
        give_up_s = time.monotonic() + timeout_s
        try:
            self._queue.put(None, timeout=timeout_s)
            self._thread.join(max(0.0, give_up_s - time.monotonic()))
        except queue.Full:
            pass
        if self._thread.is_alive():
            # The thread is inside a write and owns the files: closing them would wait for it.
            self._keep(f"the disk took nothing for {timeout_s:g} s at the end")
            self._overflowed += self._queue.qsize()
            return False
        for file in (self._events, self._tlog):
            try:
                file.close()
            except OSError as error:
                self._keep(str(error))
        return True

    def _put(self, file: BinaryIO, data: bytes) -> None:
        try:
            self._queue.put_nowait((file, data))
        except queue.Full:
            self._overflowed += 1

    def _keep(self, error: str) -> None:
        """The first error explains those after it."""
        if self._error is None:
            self._error = error

    def _write(self) -> None:
        synced = time.monotonic()
        looked = -math.inf
        running = True
        while running:
            if self._error is None and time.monotonic() - looked >= _LOOK_S:
                looked = time.monotonic()
                self._look()
            try:
                item = self._queue.get(timeout=self._sync_period_s)
            except queue.Empty:
                pass
            else:
                running = item is not None
                if item is not None:
                    self._write_item(*item)
            if self._error is None and (not running or time.monotonic() - synced >= self._sync_period_s):
                synced = time.monotonic()
                self._sync()

    def _write_item(self, file: BinaryIO, data: bytes) -> None:
        # A full disk must not end the flight: writing stops, status and summary tell.
        if self._error is None:
            try:
                file.write(data)
            except OSError as error:
                self._keep(str(error))
        if self._error is not None:
            self._unwritten += 1

    def _look(self) -> None:
        """Stop at the floor: a disk that is full to the last byte stops more than this record."""
        try:
            trouble = self.floor.trouble()
        except OSError as error:
            trouble = str(error)
        if trouble is not None:
            self._keep(trouble)

    def _sync(self) -> None:
        try:
            for file in (self._events, self._tlog):
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            self._keep(str(error))


def write_json(path: Path, value: object) -> None:
    """Write a small JSON file."""
    path.write_bytes(msgspec.json.format(msgspec.json.encode(value), indent=2) + b"\n")
