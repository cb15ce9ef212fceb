"""Room on the disk for the record: a floor that is never written below, and old runs that may go.

Nothing is deleted unless the configuration says so, and then only what is surely ours: a folder in the
record's folder that has a run's name and holds a manifest of `companion run` and plain files alone, an event
record among them that nobody writes. A run that ended with a crash or a cut battery is finished too: who
still writes holds a lock.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
from pathlib import Path

from companion.config import RecordConfig

MANIFEST = "manifest.json"
RUN = "companion run"
"""What the manifest says of a run that may be deleted."""
_RUN_NAME = re.compile(r"\d{8}T\d{6}Z-.+")
_MB = 1_000_000


def free_mb(folder: Path) -> float:
    """Free space for us where a folder is, or will be (10^6 bytes).

    Raises:
        OSError: the disk does not tell.
    """
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return shutil.disk_usage(folder).free / _MB


def lock(file: int) -> None:
    """Mark an open file (its descriptor) as being written, until it is closed or its process ends, however.

    Raises:
        OSError: the file system has no locks.
    """
    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def write_all(file: int, data: bytes | bytearray) -> None:
    """Write all of `data` to an open file (its descriptor).

    Python's own file objects are not used for what a hung disk may hold up: one that a thread is inside of
    makes the end of the process a crash.

    Raises:
        OSError: the disk does not take it; some of it may have been written.
    """
    left = memoryview(data)
    while left:
        left = left[os.write(file, left) :]


def replace_file(path: Path, data: bytes) -> None:
    """Write a small file that is there whole or as it was before.

    Raises:
        OSError: the disk does not take it.
    """
    new = path.with_suffix(".new")
    file = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o666)
    try:
        write_all(file, data)
        os.fsync(file)
    finally:
        os.close(file)
    new.replace(path)
    # The new name is on disk only when the folder is.
    folder = os.open(path.parent, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def finished_runs(root: Path) -> list[Path]:
    """Run folders that may be deleted, the oldest first by the time in their names."""
    try:
        names = sorted(name for name in os.listdir(root) if _RUN_NAME.fullmatch(name))
    except OSError:
        return []
    return [root / name for name in names if _is_finished_run(root / name)]


def _is_finished_run(folder: Path) -> bool:
    try:
        if folder.is_symlink() or not folder.is_dir():
            return False
        with os.scandir(folder) as entries:
            if not all(entry.is_file(follow_symlinks=False) for entry in entries):
                return False
        if json.loads((folder / MANIFEST).read_bytes())["what"] != RUN:
            return False
        records = list(folder.glob("*.events"))
        for path in records:
            with path.open("rb") as file:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return False
    return bool(records)


class DiskFloor:
    """Keeps `record.keep_free_mb` free.

    Args:
        own: the run folder that is being written.
    """

    def __init__(self, config: RecordConfig, own: Path) -> None:
        self._config = config
        self._own = own
        self.deleted: list[str] = []
        """Names of the run folders that were deleted."""

    def trouble(self) -> str | None:
        """Why nothing more may be written, after making room where that is allowed; None when it may.

        Raises:
            OSError: the disk does not tell how full it is.
        """
        floor = self._config.keep_free_mb
        if free_mb(self._own) >= floor:
            return None
        if self._config.delete_oldest:
            for folder in finished_runs(self._own.parent):
                if folder.name == self._own.name:
                    continue
                # Does not follow links, and stops at what cannot be removed.
                shutil.rmtree(folder, ignore_errors=True)
                if not folder.exists():
                    self.deleted.append(folder.name)
                if free_mb(self._own) >= floor:
                    return None
        return f"less than {floor:g} MB are free on the disk (record.keep_free_mb)"
