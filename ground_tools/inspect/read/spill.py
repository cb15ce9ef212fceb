"""Numbers that are too many to be kept in memory for a whole flight: they lie in a temporary file.

The file has no name and goes when its rows do, or with the process. `TMPDIR` says where it lies.
"""

from __future__ import annotations

import mmap
import tempfile
from collections.abc import Iterable
from typing import IO

import numpy as np
from numpy.typing import NDArray

from companion.errors import ConfigError

Array = NDArray[np.float64]

BLOCK = 8192
"""Rows that are worked on at once; fewer are kept in memory."""


class Spill:
    """Takes rows of so many numbers in order, and gives them back as one array."""

    def __init__(self, columns: int) -> None:
        self._columns = columns
        self._file: IO[bytes] | None = None

    def __bool__(self) -> bool:
        return self._file is not None

    def write(self, rows: bytes | memoryview) -> None:
        """The next rows, as 64 bit floats.

        Raises:
            ConfigError: no room for them.
        """
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile()  # noqa: SIM115 - as long as its rows
            self._file.write(rows)
            self._file.flush()
        except OSError as error:
            raise ConfigError(
                f"{tempfile.gettempdir()}: no temporary file can be written: {error.strerror}; "
                "TMPDIR may name another folder"
            ) from error

    def rows(self) -> Array:
        """(n, columns) of all that was written. What is read of it stays in memory until `release`."""
        if self._file is None:
            return np.zeros((0, self._columns))
        table = np.memmap(self._file, dtype=np.float64, mode="r")
        return np.asarray(table).reshape(-1, self._columns)


def spilled(blocks: Iterable[Array], columns: int) -> Array:
    """(n, columns) of blocks one after the other, in a temporary file if there is more than one.

    Raises:
        ConfigError: no room for them.
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


def release(rows: Array) -> None:
    """Give back the memory of spilled rows; they are read anew when they are looked at."""
    base: object = rows
    while base is not None and not isinstance(base, mmap.mmap):
        base = getattr(base, "base", None)
    if base is not None and hasattr(mmap, "MADV_DONTNEED"):
        base.madvise(mmap.MADV_DONTNEED)
