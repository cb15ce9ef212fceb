"""Writes the run folder (configuration, manifest, tlog and event record) while the flight runs.

A separate thread does all of it, from making the folder to closing the files, because a memory card can stall
a writer for seconds and a setpoint cannot wait. Records that the thread cannot accept are dropped and
counted; the summary holds the count. The same thread watches the free space on the disk. An error ends the
thread, and with it the record of this flight.
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
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path

import msgspec

from companion import __version__, event_record
from companion.config import RecordConfig
from companion.errors import ConfigError
from companion.runtime import clock, plain_json
from companion.runtime.record.disk import MANIFEST, DiskFloor, lock, replace_file, write_all

_QUEUE = 20_000
_LOOK_S = 5.0
"""Period of the check for free space. A flight writes about 0.2 MB in this time."""
CLOSE_S = 5.0
"""How long the end of a flight waits for a slow disk."""
_HANGS_S = 5.0
"""A disk that has not answered for this long is reported."""
_BUFFER = 64 * 1024
"""Bytes of a file that may be buffered between two syncs before they are written."""
_EVENTS, _TLOG = 0, 1
"""Indices of the two files."""
_VERSIONED = ("numpy", "numba", "pymavlink", "msgspec", "pymap3d")


def create_run_folder(root: Path, name: str, utc_s: float, key: str = "record.folder") -> Path:
    """Make the folder `<root>/<utc>-<name>/`; if it exists already, a number is appended to its name.

    Args:
        key: configuration key or option that named the root, for messages.

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
    raise ConfigError(f"{key}: {root}: there are already a thousand runs named {stamp}-{name}")


def write_manifest(folder: Path, what: str, **facts: object) -> None:
    """Write `manifest.json`: which program ran, on which machine, with which versions."""
    manifest = {
        "what": what,
        "dmuca": __version__,
        "git_commit": _git_commit(),
        "python": platform.python_version(),
        "machine": platform.machine(),
        "versions": {name: metadata.version(name) for name in _VERSIONED},
        **facts,
    }
    replace_file(folder / MANIFEST, (json.dumps(manifest, indent=2) + "\n").encode())


def _git_commit() -> str | None:
    """Git commit of the checkout that contains this package; None if it is not a checkout."""
    git = Path(__file__).resolve().parents[3] / ".git"
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


class _StoppedError(Exception):
    """Nothing more may be written; the text says why."""


class EventFile:
    """Event record `<aircraft>.events`, written in the calling thread. Used by the simulation."""

    def __init__(self, path: Path, header: event_record.Header) -> None:
        self._file = path.open("wb")
        self._file.write(event_record.MAGIC + event_record.encode(header))

    def step(self, step: event_record.Step) -> None:
        """Append one step."""
        self._file.write(event_record.encode(step))

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class FlightRecorder:
    """Tlog and event record of one aircraft, written by a thread and synced every `config.sync_period_s`.

    No method raises, and only `close` waits for the disk.

    Args:
        make_folder: makes the run folder. It is called in the thread; an exception that it raises is kept in
            `error`.
        header: first entry of the event record.
        steps: steps that follow the header.
        tape: bytes with which the tlog begins.
    """

    def __init__(
        self,
        make_folder: Callable[[], Path],
        header: event_record.Header,
        config: RecordConfig,
        steps: Sequence[event_record.Step] = (),
        tape: bytes = b"",
    ) -> None:
        self.folder: Path | None = None
        """The run folder; None until it is made."""
        self.recording = False
        """Whether the files have been opened and free space was found."""
        self.deleted: list[str] = []
        """Names of older runs that were deleted in flight to make room."""
        self._config = config
        self._queue: queue.Queue[tuple[int, bytes] | None] = queue.Queue(_QUEUE)
        self._files: tuple[tuple[Path, int], ...] = ()
        self._buffers = (bytearray(), bytearray())
        self._buffered = [len(steps), int(bool(tape))]
        """Number of records in each buffer."""
        self._written = [0, 0]
        """Number of records that were written to each file."""
        self._error: str | None = None
        self._busy_s: float | None = None
        self._overflowed = 0
        self._unwritten = 0
        self._thread = threading.Thread(
            target=self._run, args=(make_folder, header, steps, tape), name="recorder", daemon=True
        )
        self._thread.start()

    def step(self, step: event_record.Step) -> None:
        """Append one step of the core."""
        self._put(_EVENTS, event_record.encode(step))

    def write(self, data: bytes) -> int:
        """Append bytes to the tlog. With this method the recorder can be the stream of a `TlogWriter`."""
        self._put(_TLOG, data)
        return len(data)

    @property
    def dropped(self) -> int:
        """Number of records that are missing in the files."""
        # After an error the queue is no longer read.
        return self._overflowed + self._unwritten + (self._queue.qsize() if self._error is not None else 0)

    @property
    def error(self) -> str | None:
        """Why writing stopped; None while it continues."""
        return self._error

    def slow(self, now_s: float) -> str | None:
        """What is wrong with a disk that is slow but has not failed; None if it is fast enough.

        Args:
            now_s: current time of `clock.now_s`.
        """
        busy_s = self._busy_s
        if busy_s is not None and now_s - busy_s > _HANGS_S:
            return f"the disk has not answered for {_HANGS_S:g} s"
        return "the disk was too slow: records are missing" if self._overflowed else None

    def close(self, timeout_s: float = CLOSE_S) -> bool:
        """Write what is queued, sync and close the files. A failure is kept in `error`.

        Returns:
            Whether the disk answered within `timeout_s`. If not, the thread is left behind.
        """
        give_up_s = clock.now_s() + timeout_s
        if self._error is None:
            with contextlib.suppress(queue.Full):
                self._queue.put(None, timeout=timeout_s)
        self._thread.join(max(0.0, give_up_s - clock.now_s()))
        if self._thread.is_alive():
            self._keep(f"the disk accepted no data for {timeout_s:g} s at the end")
            return False
        return True

    def _put(self, file: int, data: bytes) -> None:
        try:
            if self._error is None:
                self._queue.put_nowait((file, data))
                return
        except queue.Full:
            pass
        self._overflowed += 1

    def _keep(self, error: str) -> None:
        """Keep the first error only, because it explains the later ones."""
        if self._error is None:
            self._error = error

    # ------------------------------------------------------------ the thread

    def _run(
        self,
        make_folder: Callable[[], Path],
        header: event_record.Header,
        steps: Sequence[event_record.Step],
        tape: bytes,
    ) -> None:
        self._busy_s = clock.now_s()
        try:
            self.folder = make_folder()
            self._open(self.folder, header)
            self._buffers[_EVENTS].extend(b"".join(map(event_record.encode, steps)))
            self._buffers[_TLOG].extend(tape)
            self._write(DiskFloor(self._config, self.folder))
        except OSError as error:
            where = "" if error.filename is None else f"{error.filename}: "
            self._keep(f"{where}{error.strerror or error}")
        except (_StoppedError, ConfigError) as error:
            self._keep(str(error))
        except Exception as error:
            # This is a bug, but not in the flight itself. Keep it in `error`, so that it does not pass
            # unseen.
            self._keep(f"{type(error).__name__}: {error}")
        self._unwritten += sum(self._buffered)
        for (path, file), written in zip(self._files, self._written, strict=False):
            try:
                if os.fstat(file).st_nlink == 0:
                    # A deleted file ceases to exist when it is closed, with everything in it.
                    self._unwritten += written
                    self._keep(f"{path}: was deleted")
                os.close(file)
            except OSError as error:
                self._keep(str(error))
        self._busy_s = None

    def _open(self, folder: Path, header: event_record.Header) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC
        for name in (f"{header.aircraft}.events", f"{header.aircraft}.tlog"):
            path = folder / name
            self._files = (*self._files, (path, os.open(path, flags, 0o666)))
        events = self._files[_EVENTS][1]
        with contextlib.suppress(OSError):
            lock(events)
        write_all(events, event_record.MAGIC + event_record.encode(header))

    def _write(self, floor: DiskFloor) -> None:
        """Write records until the end of the queue, or until `close` has given up. Raises OSError or
        _StoppedError if the disk takes no more."""
        self.deleted = floor.deleted
        looked, synced = -math.inf, clock.now_s()
        running = True
        while running and self._error is None:
            now_s = self._busy_s = clock.now_s()
            if now_s - looked >= _LOOK_S:
                looked = now_s
                self._look(floor)
                self.recording = True
            if now_s - synced >= self._config.sync_period_s:
                synced = now_s
                self._sync()
            self._busy_s = None
            try:
                item = self._queue.get(timeout=self._config.sync_period_s)
            except queue.Empty:
                continue
            self._busy_s = clock.now_s()
            running = item is not None
            if item is not None:
                self._take(*item)
        self._sync()

    def _take(self, file: int, data: bytes) -> None:
        self._buffers[file].extend(data)
        self._buffered[file] += 1
        if len(self._buffers[file]) >= _BUFFER:
            self._flush()

    def _flush(self) -> None:
        for number, ((_, file), buffer) in enumerate(zip(self._files, self._buffers, strict=True)):
            write_all(file, buffer)
            buffer.clear()
            self._written[number] += self._buffered[number]
            self._buffered[number] = 0

    def _look(self, floor: DiskFloor) -> None:
        """Raise _StoppedError if too little space is free, because a completely full disk stops more than
        this record; or if the files were replaced, because data written to them would be lost."""
        trouble = floor.trouble()
        if trouble is not None:
            raise _StoppedError(trouble)
        for path, file in self._files:
            there, ours = path.stat(), os.fstat(file)
            if (there.st_dev, there.st_ino) != (ours.st_dev, ours.st_ino):
                raise _StoppedError(f"{path}: was replaced by another file")

    def _sync(self) -> None:
        self._flush()
        for _, file in self._files:
            os.fsync(file)


def write_json(path: Path, value: object) -> None:
    """Write a small JSON file."""
    replace_file(path, msgspec.json.format(plain_json.encode(value), indent=2) + b"\n")
