"""Tables of flights as JSON files (`--file`)."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import msgspec

from companion.errors import ConfigError

Table = TypeVar("Table", bound=msgspec.Struct)


def check_writable(path: Path | None) -> None:
    """Refuse the file of `--file` before hours of flights if it cannot be written. It is left as it is.

    Raises:
        ConfigError: the file cannot be written.
    """
    if path is None:
        return
    new = not path.exists()
    try:
        path.open("ab").close()
        if new:
            path.unlink()
    except OSError as error:
        raise ConfigError(f"--file: {path}: cannot be written: {error.strerror}") from error


def write(path: Path, table: msgspec.Struct) -> None:
    """Write a table to a file.

    Raises:
        ConfigError: the file cannot be written.
    """
    try:
        path.write_bytes(msgspec.json.format(msgspec.json.encode(table)) + b"\n")
    except OSError as error:
        raise ConfigError(f"--file: {path}: cannot be written: {error.strerror}") from error


def read(path: Path, kind: type[Table]) -> Table:
    """Read a table of this type.

    Raises:
        ConfigError: the file cannot be read, or it is damaged.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except msgspec.DecodeError as error:
        raise ConfigError(f"{path}: this is not a table of a campaign: {error}") from error
