"""Disk space for the record: a minimum of free space that is always kept, and deletion of old runs.

Nothing is deleted unless the configuration allows it, and then only folders that certainly are ours: a folder
in record.folder that has a run's name, holds a manifest of `companion run` and only plain files, and holds an
event record that no process is writing. A process that still writes holds a lock, so a run that ended with a
crash or a power cut counts as finished, too.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import re
import shutil
from collections.abc import Set
from pathlib import Path

from companion.config import RecordConfig

MANIFEST = "manifest.json"
RUN = "companion run"
"""Value of "what" in the manifest of a run that may be deleted."""
_RUN_NAME = re.compile(r"(\d{8}T\d{6}Z)-.+?(?:-(\d+))?")
"""Time at which the run began; then its name, and a number if there are several of that name and time."""
_MB = 1_000_000


def free_mb(folder: Path) -> float:
    """Free disk space for this user at a folder that exists or will be made, in MB (10^6 bytes).

    Raises:
        OSError: the free space cannot be read.
    """
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return shutil.disk_usage(folder).free / _MB


def not_mounted(folder: Path) -> str | None:
    """Why record.folder is missing because its disk is missing, in words; None if it is there, or is a new
    folder.

    A new folder is made in a folder that exists. Where that one is missing too, or where a link leads
    nowhere, the disk is most likely not mounted, and what was stored on it is unknown rather than unset.
    """
    if not os.path.exists(folder.parent):
        return f"there is no folder {folder.parent}; mount its disk, or make that folder"
    if folder.is_symlink() and not os.path.exists(folder):
        return f"{folder} is a link to {os.readlink(folder)}, which is missing; mount its disk, or make it"
    return None


def lock(file: int) -> None:
    """Mark an open file as being written, until it is closed or its process ends in any way.

    Args:
        file: descriptor of the open file.

    Raises:
        OSError: the file system has no locks.
    """
    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def write_all(file: int, data: bytes | bytearray) -> None:
    """Write all of `data` to an open file.

    Python's file objects are not used for writes that a hung disk may block: if the process ends while a
    thread is inside one of them, the process crashes.

    Args:
        file: descriptor of the open file.

    Raises:
        OSError: writing failed; some of the data may have been written.
    """
    left = memoryview(data)
    while left:
        left = left[os.write(file, left) :]


def replace_file(path: Path, data: bytes) -> None:
    """Replace a small file atomically: afterwards it is either complete or as it was before.

    The draft beside it is this process's own: of two that wrote the same draft, one would publish what the
    other has not written to its end. A link that somebody put in its place is not followed.

    Raises:
        OSError: the file cannot be written.
    """
    new = path.with_name(f"{path.name}.{os.getpid()}.new")
    file = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    try:
        write_all(file, data)
        os.fsync(file)
    except OSError:
        # Restarts on a full disk must not leave a draft each.
        with contextlib.suppress(OSError):
            new.unlink()
        raise
    finally:
        os.close(file)
    new.replace(path)
    # The new name is on disk only after the folder is synced.
    folder = os.open(path.parent, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def finished_runs(root: Path) -> list[Path]:
    """Run folders that may be deleted, ordered by the time in their names, oldest first."""
    try:
        names = [name for name in os.listdir(root) if _RUN_NAME.fullmatch(name)]
    except OSError:
        return []
    # The name that the configuration gives may itself end in a number: others then continue it with theirs.
    first = {name.rpartition("-")[0] for name in names}
    found = sorted((_begun(name, first), name) for name in names)
    return [root / name for _, name in found if _is_finished_run(root / name)]


def _begun(name: str, first: Set[str]) -> tuple[str, int]:
    """Time and number in the name of a run; `first`: names without one. Without a clock, many runs begin at
    the same time."""
    match = _RUN_NAME.fullmatch(name)
    assert match is not None
    return match[1], 1 if name in first else int(match[2] or 1)


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
    """Keeps `record.keep_free_mb` of disk space free.

    Args:
        own: the run folder that is being written; it is never deleted.
    """

    def __init__(self, config: RecordConfig, own: Path) -> None:
        self._config = config
        self._own = own
        self.deleted: list[str] = []
        """Names of the run folders that were deleted."""

    def trouble(self) -> str | None:
        """Reason why nothing more may be written; None if writing is allowed. Deletes old runs first, if the
        configuration allows that and space is short.

        Raises:
            OSError: the free space cannot be read.
        """
        floor = self._config.keep_free_mb
        if free_mb(self._own) >= floor:
            return None
        if self._config.delete_oldest:
            for folder in finished_runs(self._own.parent):
                if folder.name == self._own.name:
                    continue
                # `rmtree` does not follow links; a folder that cannot be removed completely is not counted.
                shutil.rmtree(folder, ignore_errors=True)
                if not folder.exists():
                    self.deleted.append(folder.name)
                if free_mb(self._own) >= floor:
                    return None
        return f"less than {floor:g} MB are free on the disk (record.keep_free_mb)"
