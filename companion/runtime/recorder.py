"""The run folder: configuration, manifest, tlog and event record, written beside the flight.

Writing happens in a thread of its own, because a memory card can stall a writer for seconds and a setpoint
cannot wait. What the thread cannot take is dropped and counted, and the count stands in the summary.
"""

from __future__ import annotations

import json
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
from companion.errors import ConfigError

_QUEUE = 20_000
_VERSIONED = ("numpy", "numba", "pymavlink", "msgspec", "pymap3d")


def create_run_folder(root: Path, name: str, utc_s: float) -> Path:
    """Make `<root>/<utc>-<name>/`; a number is added when it is there already.

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
            raise ConfigError(f"record.folder: {root}: cannot be written: {error.strerror}") from error
        return folder
    raise ConfigError(f"record.folder: {root}: a thousand runs of the name {stamp}-{name} are there already")


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
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n")


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
    """Tlog and event record of one aircraft, written by a thread and synced every `sync_period_s`."""

    def __init__(self, folder: Path, header: record.Header, sync_period_s: float) -> None:
        self.dropped = 0
        self._sync_period_s = sync_period_s
        self._events = (folder / f"{header.aircraft}.events").open("wb")
        self._tlog = (folder / f"{header.aircraft}.tlog").open("wb")
        self._events.write(record.MAGIC + record.encode(header))
        self._queue: queue.Queue[tuple[BinaryIO, bytes] | None] = queue.Queue(_QUEUE)
        self._error: OSError | None = None
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
    def error(self) -> str | None:
        """Why writing stopped; None while it goes on."""
        return None if self._error is None else str(self._error)

    def close(self) -> None:
        """Write out what waits, sync, close."""
        self._queue.put(None)
        self._thread.join()
        self._events.close()
        self._tlog.close()

    def _put(self, file: BinaryIO, data: bytes) -> None:
        try:
            self._queue.put_nowait((file, data))
        except queue.Full:
            self.dropped += 1

    def _write(self) -> None:
        synced = time.monotonic()
        running = True
        while running:
            try:
                item = self._queue.get(timeout=self._sync_period_s)
                if item is None:
                    running = False
                elif self._error is None:
                    item[0].write(item[1])
                else:
                    self.dropped += 1
            except queue.Empty:
                pass
            except OSError as error:
                # A full disk must not end the flight: stop writing, say so in health and summary.
                self._error = error
            if self._error is None and (not running or time.monotonic() - synced >= self._sync_period_s):
                synced = time.monotonic()
                try:
                    for file in (self._events, self._tlog):
                        file.flush()
                        os.fsync(file.fileno())
                except OSError as error:
                    self._error = error


def write_json(path: Path, value: object) -> None:
    """Write a small JSON file."""
    path.write_bytes(msgspec.json.format(msgspec.json.encode(value), indent=2) + b"\n")
