"""Result files that are written line by line, so that an interrupted run can be continued.

The first line of a file states the settings with which its rows were made; a file made with other settings is
refused. An incomplete line, left by a killed process, is ignored.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

import msgspec

from companion.errors import ConfigError

Row = TypeVar("Row", bound=msgspec.Struct)
_SOFTWARE: Final = "software"


class Kept(Generic[Row]):
    """One result file.

    Args:
        path: The file; its folder must exist.
        made_with: Everything on which the rows depend.
        software: Digest of the software that makes the rows. If it is given, rows of other software may be
            read, but no new rows are added to them.
        row: Type of the rows.
        key: Gives the number of a row. A later row replaces an earlier one with the same number.

    Raises:
        ConfigError: The file was made with other settings, or cannot be read.
    """

    def __init__(
        self,
        path: Path,
        made_with: dict[str, Any],
        row: type[Row],
        key: Callable[[Row], int],
        software: str | None = None,
    ) -> None:
        self.path = path
        self._made_with, self._row, self._key = made_with, row, key
        self._software = self._flown_by = software
        self.rows: dict[int, Row] = {}
        """Rows by number."""
        if path.exists():
            self._read()

    def add(self, rows: Sequence[Row]) -> None:
        """Append rows to the file.

        Raises:
            ConfigError: The file cannot be written, or its rows were made by other software.
        """
        if self._flown_by != self._software:
            raise ConfigError(
                f"--out: {self.path}: its rows were made by other software, and are not mixed with new ones; "
                "remove the file or choose another folder"
            )
        try:
            begun = self.path.exists()
            with self.path.open("a") as file:
                if not begun:
                    software = {} if self._software is None else {_SOFTWARE: self._software}
                    file.write(json.dumps({**self._made_with, **software}) + "\n")
                file.write("".join(msgspec.json.encode(row).decode() + "\n" for row in rows))
        except OSError as error:
            raise ConfigError(f"--out: {self.path}: cannot be written: {error.strerror}") from error
        self.rows.update((self._key(row), row) for row in rows)

    def _read(self) -> None:
        header, rows = read_lines(self.path, self._row)
        if self._software is not None and isinstance(header, dict):
            self._flown_by = header.pop(_SOFTWARE, None)
        if header != self._made_with:
            raise ConfigError(
                f"--out: {self.path} was made with other settings ({_difference(header, self._made_with)}); "
                "remove the file or choose another folder"
            )
        self.rows = {self._key(row): row for row in rows}
        if not self.path.read_bytes().endswith(b"\n"):
            with self.path.open("a") as file:
                file.write("\n")


def read_lines(path: Path, row: type[Row]) -> tuple[Any, list[Row]]:
    """Read a result file. Returns the settings in its first line, and its rows.

    Raises:
        ConfigError: The file cannot be read.
    """
    try:
        first, *lines = path.read_text().splitlines()
        header = json.loads(first)
    except (OSError, ValueError) as error:
        raise ConfigError(f"--out: {path}: cannot be read; remove the file to repeat its flights") from error
    rows = []
    for line in lines:
        try:
            rows.append(msgspec.json.decode(line, type=row))
        except msgspec.DecodeError:
            continue  # Incomplete line of a killed process.
    return header, rows


def _difference(found: Any, wanted: dict[str, Any]) -> str:
    if not isinstance(found, dict):
        return "the file has no header"
    keys = [key for key in {**wanted, **found} if found.get(key) != wanted.get(key)]
    return ", ".join(f"{key}: {found.get(key)}, now {wanted.get(key)}" for key in keys)
