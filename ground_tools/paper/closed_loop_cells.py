"""What the closed loop found, by cell: a file for each condition and method, a line for each encounter.

The first line says what the cell was made with. A cell that is there is not flown again, and one that was
made with anything else is refused; so a method can be added later, and a run that was cut short goes on.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from companion.errors import ConfigError
from ground_tools.paper.closed_loop_flights import FILE, METHODS, Flight, Row


class Cell:
    """One file.

    Args:
        folder: is there.
        flight: any of the cell's; what it says beside its seeds must be the same for all.
        crowd: encounters side by side in one air.

    Raises:
        ConfigError: the file was made with other settings, or cannot be read.
    """

    def __init__(self, folder: Path, flight: Flight, crowd: int) -> None:
        self.path = folder / f"{flight.condition}-{flight.method}.jsonl"
        self._made_with = _made_with(flight, crowd)
        self.rows: dict[int, Row] = {}
        """By encounter."""
        if self.path.exists():
            self._read()

    def add(self, rows: Sequence[Row]) -> None:
        """Keep the rows of one run.

        Raises:
            ConfigError: the file cannot be written.
        """
        try:
            begun = self.path.exists()
            with self.path.open("a") as file:
                if not begun:
                    file.write(json.dumps(self._made_with) + "\n")
                file.write("".join(msgspec.json.encode(row).decode() + "\n" for row in rows))
        except OSError as error:
            raise ConfigError(f"--out: {self.path}: cannot be written: {error.strerror}") from error
        self.rows.update((row.encounter, row) for row in rows)

    def _read(self) -> None:
        try:
            text = self.path.read_text()
            first, *lines = text.splitlines()
            header = json.loads(first)
        except (OSError, ValueError) as error:
            raise ConfigError(f"--out: {self.path}: cannot be read; remove it to fly it anew") from error
        if header != self._made_with:
            raise ConfigError(
                f"--out: {self.path}: made with other settings ({_difference(header, self._made_with)}); "
                "remove it, or choose another folder"
            )
        for line in lines:
            try:
                row = msgspec.json.decode(line, type=Row)
            except msgspec.DecodeError:
                continue  # torn by a kill in the middle of a line
            self.rows[row.encounter] = row
        if not text.endswith("\n"):
            with self.path.open("a") as file:
                file.write("\n")


def _made_with(flight: Flight, crowd: int) -> dict[str, Any]:
    """What a cell's numbers hang on, beside the software."""
    method = METHODS[flight.method]
    return {
        "condition": flight.condition,
        "method": flight.method,
        "region": "none" if method.policy is None else flight.region.name,
        "channel": _digest(msgspec.json.encode(flight.channel)),
        "crowd": crowd,
        "policy": _digest(flight.policy) if method.policy == FILE and flight.policy is not None else None,
    }


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def _difference(found: Any, wanted: dict[str, Any]) -> str:
    if not isinstance(found, dict):
        return "no header"
    keys = [key for key in {**wanted, **found} if found.get(key) != wanted.get(key)]
    return ", ".join(f"{key}: {found.get(key)}, now {wanted.get(key)}" for key in keys)
