"""Temporary files for arrays that are too large to keep in memory for a whole flight.

The file has no name. It disappears when its rows are no longer referenced, or when the process ends. The
environment variable `TMPDIR` sets its folder.
"""

from __future__ import annotations

import mmap
import tempfile
from collections.abc import Iterable
from typing import IO

import numpy as np

from companion.arrays import Floats
from companion.errors import ConfigError

BLOCK = 8192
"""Number of rows processed at once. Shorter tables stay in memory."""


class Spill:
    """Collects rows with a fixed number of columns, and returns them as one array."""

    def __init__(self, columns: int) -> None:
        self._columns = columns
        self._file: IO[bytes] | None = None

    def __bool__(self) -> bool:
        return self._file is not None

    def write(self, rows: bytes | memoryview) -> None:
        """Append rows of 64-bit floats.

        Raises:
            ConfigError: The temporary file cannot be written.
        """
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile()  # noqa: SIM115 - as long as its rows
            self._file.write(rows)
            self._file.flush()
        except OSError as error:
            raise ConfigError(
                f"{tempfile.gettempdir()}: a temporary file cannot be written: {error.strerror}; "
                "set TMPDIR to choose another folder"
            ) from error

    def rows(self) -> Floats:
        """Return all written rows as (n, columns). Rows that are read stay in memory until `release`."""
        if self._file is None:
            return np.zeros((0, self._columns))
        table = np.memmap(self._file, dtype=np.float64, mode="r")
        return np.asarray(table).reshape(-1, self._columns)


def spilled(blocks: Iterable[Floats], columns: int) -> Floats:
    """Concatenate blocks to one array of shape (n, columns). More than one block goes to a temporary file.

    Raises:
        ConfigError: The temporary file cannot be written.
    """
    spill, first = Spill(columns), None
    for block in blocks:
        if first is None:
            first = block
            continue
        if not spill:
            spill.write(np.ascontiguousarray(first).data)
        spill.write(np.ascontiguousarray(block).data)
    return spill.rows() if spill or first is None else first


def release(rows: Floats) -> None:
    """Free the memory of spilled rows. The next access reads them from the file again."""
    base: object = rows
    while base is not None and not isinstance(base, mmap.mmap):
        base = getattr(base, "base", None)
    if base is not None and hasattr(mmap, "MADV_DONTNEED"):
        base.madvise(mmap.MADV_DONTNEED)
