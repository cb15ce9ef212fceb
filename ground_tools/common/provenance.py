"""The provenance record beside a kept result: which command, code, data and packages made it."""

from __future__ import annotations

import hashlib
import platform
import tomllib
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path
from typing import Literal

import msgspec

from companion.errors import ConfigError
from companion.shipped import shipped
from ground_tools.common import sources


class CannotSampleError(Exception):
    """No sample of a kept file can be made here, because something is missing that the message names."""


class Provenance(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What made a file."""

    command: str
    """The command that makes it again."""
    evidence: Literal["made", "sample"]
    """How the sources are known: recorded when the file was made, or recorded later, after a sample of the
    file was made again with them and was the same."""
    sources: dict[str, str]
    """Digest of each module on which the content depends."""
    data: dict[str, str]
    """Digest of each data file on which it depends, by its path in the checkout."""
    packages: dict[str, str]
    """Versions of the packages that compute, and of Python."""
    content: str | None = None
    """Digest of the file itself (`content_of`); None in a record written before the file was whole."""


def now(command: str, roots: Iterable[str], data: Iterable[str], packages: Iterable[str]) -> Provenance:
    """The record of a file that the present software makes.

    Args:
        command: the command that makes it.
        roots: names of the modules that compute it.
        data: files that come with the software and on which the content depends, by their paths in the
            checkout.
        packages: names of the packages that compute.
    """
    return Provenance(
        command=command,
        evidence="made",
        sources=sources.digests(roots),
        data={name: _digest(shipped(name)) for name in data},
        packages={"python": platform.python_version(), **{name: _version(name) for name in packages}},
    )


def changes(old: Provenance, new: Provenance) -> list[str]:
    """Names of the modules and data files that differ between two records."""
    found = []
    for before, after in ((old.sources, new.sources), (old.data, new.data)):
        found += [name for name in sorted(before | after) if before.get(name) != after.get(name)]
    return found


def content_of(path: Path) -> str:
    """Digest of a file's content.

    Raises:
        ConfigError: the file cannot be read.
    """
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()[:12]
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error


def beside(path: Path) -> Path:
    """Path of the provenance record of a file."""
    return path.with_name(path.name + ".made.json")


def read(path: Path) -> Provenance | None:
    """Read the record of a file; None if it has none.

    Raises:
        ConfigError: the record cannot be read.
    """
    record = beside(path)
    try:
        return msgspec.json.decode(record.read_bytes(), type=Provenance)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.DecodeError) as error:
        raise ConfigError(f"{record}: {error}") from error


def write(path: Path, provenance: Provenance) -> None:
    """Write the record of a file.

    Raises:
        ConfigError: the record cannot be written.
    """
    record = beside(path)
    try:
        record.write_bytes(msgspec.json.format(msgspec.json.encode(provenance), indent=1) + b"\n")
    except OSError as error:
        raise ConfigError(f"{record}: cannot be written: {error.strerror}") from error


def _version(package: str) -> str:
    """Version of a package; "not installed" for a missing one, because verifying needs no training
    packages."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def _digest(path: Path) -> str:
    """Digest of a file's bytes; of a TOML file's values, so that a reworded comment does not make a result
    look old."""
    content = path.read_bytes()
    if path.suffix == ".toml":
        content = repr(tomllib.loads(content.decode())).encode()
    return hashlib.sha256(content).hexdigest()[:12]
